"""Sight: a point is seen where no box lies on the line to it, but for its end."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.scene import Box, Obstacle, Scene, Voxels
from elastic_strips.scene.sight import sight_shares

STEPS = 4000  # along a line
GRAZING = 2e-3  # [m] so far from all boxes, or so deep in one, a line is surely free, or not


def boxes(obstacle):
    """Poses and half sizes of the boxes that an obstacle consists of."""
    for part in obstacle.parts:
        middles, sizes = (part.middles, part.sizes) if len(part.sizes) else (np.zeros((1, 3)), 2.0 * part.half_extents)
        for middle, size in zip(middles, np.atleast_2d(sizes), strict=True):
            yield middle + part.T_obstacle_part[:3, 3], 0.5 * size


def deepest(scene: Scene, line: np.ndarray) -> float:
    """How deep [m] points (n, 3) get into boxes at most; less than 0 where they stay out."""
    depth = -np.inf
    for obstacle in scene:
        local = (line - obstacle.pose[:3, 3]) @ obstacle.pose[:3, :3]
        for middle, half in boxes(obstacle):
            depth = max(depth, float((half - np.abs(local - middle)).min(axis=1).max()))
    return depth


def test_it_is_what_points_along_the_lines_say(rng):
    seen = hidden = 0
    for _ in range(40):
        obstacles: list[Obstacle] = []
        for k in range(4):
            turned, at = rng.normal(size=4), tuple(rng.uniform(-1, 1, 3))
            turned /= np.linalg.norm(turned)
            obstacles.append(Box(tuple(rng.uniform(0.2, 1.0, 3)), at=at, quat=tuple(turned), name=f"box-{k}"))
        cells = np.unique(rng.integers(0, 8, (150, 3)), axis=0)
        scene = Scene([*obstacles, Voxels(cells, 0.1, at=tuple(rng.uniform(-1, 0.2, 3)))])
        eye, point = rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3)
        far = float(np.linalg.norm(point - eye))
        line = eye + (point - eye) * np.linspace(0.0, max(1.0 - 0.2 / far, 0.0), STEPS)[:, None]
        depth = deepest(scene, line)
        if abs(depth) < GRAZING:
            continue
        share = sight_shares(scene, eye[None], point[None], 0.2)
        assert share.shape == (1,)
        assert share[0] == float(depth < 0.0)
        seen, hidden = seen + (depth < 0.0), hidden + (depth > 0.0)
    assert min(seen, hidden) > 5


def test_of_several_points_it_says_how_many():
    wall = Box((0.1, 4.0, 1.0), at=(1.0, 0.0, 0.5), name="wall")
    points = np.array([[2.0, 0.0, z] for z in (0.2, 0.3, 0.8, 1.9)])
    eyes = np.array([[0.0, 0.0, 1.5], [2.0, 1.0, 1.5]])
    assert sight_shares(Scene([wall]), eyes, points, 0.1).tolist() == pytest.approx([0.5, 1.0])
    assert sight_shares(Scene([]), eyes, points, 0.1).tolist() == [1.0, 1.0]
    assert sight_shares(Scene([wall]), eyes[:0], points, 0.1).tolist() == []


def test_what_stands_at_a_point_does_not_hide_it():
    crate, at = Box((0.3, 0.3, 0.3), at=(2.0, 0.0, 0.5), name="crate"), np.array([[2.0, 0.0, 0.5]])
    eye = np.array([[0.0, 0.0, 0.5]])
    assert sight_shares(Scene([crate]), eye, at, 0.2).tolist() == [1.0]
    assert sight_shares(Scene([crate]), eye, at, 0.1).tolist() == [0.0]
    assert sight_shares(Scene([crate]), at + 0.05, at, 0.2).tolist() == [0.0], "from within it nothing is seen"
