"""Timing natively and in NumPy: the same motions, and the same reasons where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each
from drivable import arcs, limits_of

from elastic_strips.native import kernel, twin
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import Retimer, RetimingError, Trajectory
from elastic_strips.trajectory.path import metric, polyline, smooth_path
from elastic_strips.trajectory.speed_profile import braked, fastest

pytestmark = pytest.mark.skipif(kernel() is None, reason="there is no native kernel")


def _timed(retimer: Retimer, nodes: np.ndarray, **options: object) -> Trajectory | str:
    try:
        return retimer.horizon(nodes, **options)
    except RetimingError as error:
        return str(error)


@each("name", ["silvermate", "rover", "gantry", "tiago"])
def test_motions_are_the_same(name: str, request: pytest.FixtureRequest) -> None:
    robot: RobotModel = request.getfixturevalue(name)
    retimer = Retimer(robot, limits_of(robot))
    rng = np.random.default_rng(5)
    moved = refused = 0
    for seed in range(12):
        nodes = arcs(robot, seed, 20, bend=0.15)
        state = None
        for speed, distance in ((1.0, 3.0), (0.7, 1.0), (0.4, 0.3)):
            options = {"distance": distance, "speed": speed}
            rows = nodes
            if state is not None:  # on from where the motion before was, to nodes ahead of it
                rows = np.vstack([state.coordinates, nodes[-int(rng.integers(2, 18)) :]])
                options |= {"v_start": state.v, "a_start": state.a}
            ours = _timed(retimer, rows, **options)
            with twin():
                theirs = _timed(retimer, rows, **options)
            if isinstance(ours, str) or isinstance(theirs, str):
                assert ours == theirs
                refused += 1
                continue
            assert len(ours) == len(theirs)
            for what in ("coordinates", "v", "a"):
                np.testing.assert_allclose(getattr(ours, what), getattr(theirs, what), atol=1e-8, err_msg=what)
            moved += 1
            state = ours.at(ours.start_time + float(rng.uniform(0.2, 0.6)) * ours.duration)
    assert moved > 12
    assert refused or not robot.space.base_nv, "what cannot be driven was among them"


@each("name", ["silvermate", "rover", "gantry"])
def test_parts_are_the_same(name: str, request: pytest.FixtureRequest) -> None:
    robot: RobotModel = request.getfixturevalue(name)
    limits, rng = limits_of(robot), np.random.default_rng(3)
    weight, led = metric(robot, limits), 0
    for seed in range(10):
        line = polyline(robot, limits, weight, arcs(robot, seed, 20, bend=0.1, step=0.2))
        path = smooth_path(robot, limits, line, float(line.s[line.stops[0]]), weight=weight)
        led += path.curve.weights is not None
        s = np.sort(rng.uniform(0.0, path.curve.length, 50))
        bound = rng.uniform(0.1, 4.0) * np.ones(len(path.grid))
        start = 0.3 * float(bound[0])
        way = (path.grid, path.y1, path.y2, limits.acceleration)
        ours = path.curve(s), fastest(path.grid, path.y1, path.y2, bound, limits.acceleration, start)
        fallen = braked(*way, start, 0.9)
        with twin():
            theirs = path.curve(s), fastest(path.grid, path.y1, path.y2, bound, limits.acceleration, start)
            np.testing.assert_allclose(fallen, braked(*way, start, 0.9), atol=1e-12)
            if robot.space.base_nv:
                again = smooth_path(robot, limits, line, float(line.s[line.stops[0]]), weight=weight).curve
                np.testing.assert_allclose(path.curve.weights, again.weights, atol=1e-9)
        np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-12, atol=1e-11)
        assert (ours[1] is None) == (theirs[1] is None)
        if ours[1] is not None and theirs[1] is not None:
            np.testing.assert_allclose(ours[1].x, theirs[1].x, rtol=1e-9, atol=1e-12)
    assert led == (10 if robot.space.base_nv else 0)


def test_what_is_no_path_has_no_profile() -> None:
    """A path that does not move, or is no number."""
    grid, acceleration = np.linspace(0.0, 1.0, 9), np.ones(2)
    bound = np.ones(9)
    for row in (np.zeros((9, 2)), np.full((9, 2), np.nan)):
        assert fastest(grid, row, np.zeros((9, 2)), bound, acceleration, 0.0) is None
        with twin():
            assert fastest(grid, row, np.zeros((9, 2)), bound, acceleration, 0.0) is None
