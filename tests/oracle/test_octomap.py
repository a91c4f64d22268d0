"""The map of images beside OctoMap's, on the same images without noise of a room of boxes.

OctoMap walks along each ray and knows of nothing else. So of what is called free here, where pixels lie closer than
the edge of a voxel, a ray has passed every voxel, and none has ended there; and what rays have ended in again and again
is an obstacle.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from elastic_strips.native import twin
from elastic_strips.perception import DepthImage, VolumeMap, VolumeMapParams, volume_twin

octomap = pytest.importorskip("octomap", reason="there is no wheel of octomap-python for this machine")

CELL, NEAR = 0.05, 3.0  # [m]; pixels of these cameras lie 3 cm apart there
PARAMS = VolumeMapParams(length=12.0, height=2.8, noise=0.0, noise_growth=0.0, bias=1e-3, hole=0.0, fine_range=0.0)
ROWS, COLUMNS, FOCAL = 90, 120, 104.0
LOOKS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # of a camera that looks along x
FREE, FULL = 0, 1


def room(rng: np.random.Generator) -> np.ndarray:
    """Low and high corners (n, 2, 3) of boxes: floor, ceiling, four walls, and things that stand and hang about; none
    of them on the border of a voxel, but for the floor."""
    middle, half = rng.uniform(-4.0, 4.0, (30, 3)), rng.uniform(0.02, 0.4, (30, 3))
    middle[:, 2] = rng.uniform(0.0, 2.4, 30)
    middle[np.hypot(middle[:, 0], middle[:, 1]) < 1.1] += (3.0, 0.0, 0.0)  # the camera is there
    boxes = [np.stack((middle - half, middle + half), axis=1)]
    for axis, low, high in ((0, -4.17, 4.17), (1, -4.17, 4.17), (2, 0.0, 2.57)):
        for inner, side in ((low, -1.0), (high, 1.0)):
            wall = np.tile([[-9.0], [9.0]], (1, 3))
            wall[:, axis] = sorted((inner, inner + side))
            boxes.append(wall[None])
    return np.concatenate(boxes)


def ranges(boxes: np.ndarray, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Where rays (R, 3) meet boxes first, in their own lengths: by slabs."""
    first = np.full(len(rays), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for low, high in boxes:
            a, b = (low - origin) / rays, (high - origin) / rays
            enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            first = np.where((enter <= leave) & (leave > 0.0), np.minimum(first, np.maximum(enter, 0.0)), first)
    return first


def images(rng: np.random.Generator, count: int) -> list[tuple[DepthImage, np.ndarray]]:
    """Images of a room from its middle, and where their pixels end (n, 3)."""
    boxes, found = room(rng), []
    v, u = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    center = 0.5 * (COLUMNS - 1), 0.5 * (ROWS - 1)
    own = np.stack(((u - center[0]) / FOCAL, (v - center[1]) / FOCAL, np.ones(u.shape)), axis=-1).reshape(-1, 3)
    for _ in range(count):
        yaw, tilt = rng.uniform(-math.pi, math.pi), rng.uniform(-0.4, 0.7)
        c, s, ct, st = math.cos(yaw), math.sin(yaw), math.cos(tilt), math.sin(tilt)
        T = np.eye(4)
        T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [[ct, 0, st], [0, 1, 0], [-st, 0, ct]] @ LOOKS
        T[:3, 3] = *rng.uniform(-0.5, 0.5, 2), rng.uniform(0.9, 1.5)
        rays = own @ T[:3, :3].T
        depth = ranges(boxes, T[:3, 3], rays).astype(np.float32)
        image = DepthImage("eye", 0.0, T, depth.reshape(ROWS, COLUMNS), (FOCAL, FOCAL), center, 0.1, 20.0)
        found.append((image, T[:3, 3] + depth[:, None] * rays))
    return found


def maps(seed: int, count: int = 24) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Voxels near, what is known of each here and there, and OctoMap's log-odds of it."""
    volume, tree = VolumeMap(PARAMS), octomap.OcTree(CELL)
    for image, points in images(np.random.default_rng(seed), count):
        volume.add(image, np.eye(4))
        tree.insertPointCloud(points, image.T_base_sensor[:3, 3].copy())
    axes = np.arange(-70, 70), np.arange(-70, 70), np.arange(2, 52)
    voxels = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * CELL
    voxels = voxels[np.linalg.norm(voxels - (0.0, 0.0, 1.2), axis=1) < NEAR]
    odds = np.zeros(len(voxels))
    label = np.asarray(tree.getLabels(voxels))
    for k in np.flatnonzero(label == FULL).tolist():
        odds[k] = tree.search(voxels[k]).getLogOdds()
    return voxels, volume.known(voxels), label, odds


@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_free_is_free_to_octomap_and_what_it_finds_full_is_an_obstacle(seed):
    _, ours, theirs, odds = maps(seed)
    free, full = ours == 0, odds > 2.0  # three rays ended there and none has passed since
    assert free.sum() > 50_000
    assert full.sum() > 200
    assert (theirs[free] == FREE).all()
    assert (ours[full] == 1).all()


def test_carving_by_the_pixel_over_the_middle_is_found_out(monkeypatch):
    cover = volume_twin._Sight.cover

    def middle_alone(sight, c, radius):
        columns, rows, near, far, known = cover(sight, c, radius)
        middles = [np.repeat(span.mean(axis=1, keepdims=True), 2, axis=1) for span in (columns, rows)]
        return *middles, near, far, known

    monkeypatch.setattr(volume_twin._Sight, "cover", middle_alone)
    with twin():
        _, ours, theirs, _ = maps(1, 6)
    assert (theirs[ours == 0] != FREE).sum() > 1000
