"""What the kernel proves of whole segments: planes between shapes, ways that bend, the least distance along a path."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from brute_force import configuration, link_distances, make_scene, random_coordinates
from cases import each, each_robot

from elastic_strips import RobotModel, load_robot
from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet, MotionBounds, certify, strip_certificate
from elastic_strips.collision.native_side import proven_segments
from elastic_strips.collision.strip_certificate import coordinate_clearance
from elastic_strips.native import kernel
from elastic_strips.scene import Box, Scene

pytestmark = pytest.mark.skipif(kernel() is None, reason="only the native kernel proves so")

LEVER, BALL, SWING, CLEARANCE = 0.1, 0.01, 0.4, 0.01  # [m], [m], [rad], [m]
BENT = LEVER * (1.0 - np.cos(SWING))
"""How much nearer [m] to the axis's side the ball is at the ends of its swing than at the middle."""


FACE = LEVER - BALL - CLEARANCE - 0.5 * BENT
"""Where the wall's face is [m], which the ball goes straight along at the middle of its swing."""


def _link(name: str, shape: str, x: float, z: float = 0.0) -> str:
    body = f'<origin xyz="{x} 0 {z}"/><geometry>{shape}</geometry>'
    return f'<link name="{name}"><collision>{body}</collision></link>'


def _joint(name: str, parent: str, child: str, axis: str) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    )


def _swing(folder: Path, *, wall: bool) -> RobotModel:
    """A ball on a short lever, and a root that is the wall, or that is out of the way."""
    file = folder / "swing.urdf"
    file.write_text(
        '<robot name="swing">'
        + _link("root", '<box size="0.02 0.4 0.02"/>', FACE - 0.01, 0.0 if wall else -1.0)
        + '<link name="lever"/>'
        + _link("ball", f'<sphere radius="{BALL}"/>', LEVER)
        + _joint("turn", "root", "lever", "0 0 1")
        + _joint("roll", "lever", "ball", "1 0 0")
        + "</robot>"
    )
    return load_robot(file, base="fixed")


@each("wall", [False, True])
@each("clearance, proven", [(CLEARANCE - 0.55 * BENT, True), (CLEARANCE, False)])
def test_a_way_that_bends_towards_what_it_passes(tmp_path, wall, clearance, proven):
    """At the middle the ball is clear and goes along the wall; only the bend of its way takes it too near."""
    robot, rows = _swing(tmp_path, wall=wall), np.array([[-SWING, 0.0], [SWING, 0.0]])
    scene = Scene([] if wall else [Box((0.02, 0.4, 0.02), at=(FACE - 0.01, 0.0, 0.0))])
    pairs = np.array([[0, 1]] if wall else np.empty((0, 2)), dtype=np.intp)
    bounds, v = MotionBounds(BodySet.links(robot)), np.diff(rows, axis=0)
    found = proven_segments(bounds, scene, pairs, rows, v, clearance=clearance, self_clearance=clearance)
    assert found is not None
    assert found.tolist() == [proven]
    if not wall:
        least = coordinate_clearance(robot, rows, scene, tolerance=1e-5)
        assert least == pytest.approx(CLEARANCE - 0.5 * BENT, abs=1e-4)


def _path(robot: RobotModel, rng: np.random.Generator) -> Array:
    start = random_coordinates(robot, rng, 1)
    rows = [start[0]]
    for _ in range(3):
        rows.append(robot.space.integrate(rows[-1], rng.normal(size=robot.nv) * 0.2))
    return np.clip(rows, robot.space.lower, robot.space.upper)


@each_robot
def test_the_least_distance_is_that_of_numpy(robot, rng, monkeypatch):
    for count in (1, 3, 9, 9):
        scene, rows, tolerance = make_scene(rng, count), _path(robot, rng), 10.0 ** rng.uniform(-4.0, -2.0)
        native = coordinate_clearance(robot, rows, scene, tolerance=tolerance)
        with monkeypatch.context() as patch:
            patch.setattr(strip_certificate, "least_distance", lambda *_, **__: None)
            by_numpy = coordinate_clearance(robot, rows, scene, tolerance=tolerance)
        assert native == pytest.approx(by_numpy, abs=tolerance + 1e-4)
        here = [link_distances(robot, scene, configuration(robot, row)).min() for row in rows]
        assert native <= min(here) + 1e-6


def test_threads_that_certify_at_once_get_what_one_gets(silvermate):
    """The last proof is kept, and is used by one thread at a time."""
    rng = np.random.default_rng(3)
    todo = [(make_scene(rng, 3), _path(silvermate, rng)) for _ in range(4)] * 8
    alone = [certify(silvermate, scene, rows) for scene, rows in todo]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda one: certify(silvermate, *one), todo))
    assert [(one.verdict, one.least) for one in together] == [(one.verdict, one.least) for one in alone]
