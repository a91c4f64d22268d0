"""Speed profiles: the fastest that keep the limits, against formulas and against toppra's own algorithm."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
import toppra
import toppra.algorithm
import toppra.constraint
from cases import each
from drivable import arcs, limits_of, most_used

from elastic_strips.native import twin
from elastic_strips.trajectory.path import metric, polyline, smooth_path
from elastic_strips.trajectory.retiming import Retimer
from elastic_strips.trajectory.speed_profile import Profile, broken_limit, fastest


def straight(length: float, speed: float, acceleration: float, start: float = 0.0) -> Profile | None:
    grid = np.linspace(0.0, length, 41)
    ones, zeros = np.ones((41, 1)), np.zeros((41, 1))
    return fastest(grid, ones, zeros, np.full(41, speed**2), np.array([acceleration]), start**2)


@each("length", [1e-4, 0.1, 5.0])
def test_a_straight_way_takes_what_it_has_to(length):
    """Up and down with full acceleration, or up to full speed and down: within the grid's resolution."""
    profile = straight(length, 1.0, 2.0)
    assert profile is not None
    ramp = min(np.sqrt(length / 2.0), 0.5)  # time to half way or to full speed
    exact = 2.0 * ramp + (length - 2.0 * ramp**2)
    assert exact - 1e-9 <= profile.duration <= 1.02 * exact
    s, rate, change = profile(np.linspace(0.0, profile.duration, 500))
    assert np.abs(change).max() <= 2.0 + 1e-6
    assert rate.max() <= 1.0 + 1e-9
    np.testing.assert_allclose([s[0], s[-1], rate[0], rate[-1]], [0.0, length, 0.0, 0.0], atol=1e-9)


def test_no_room_to_brake():
    assert straight(0.26, 1.0, 2.0, start=1.0) is not None
    assert straight(0.24, 1.0, 2.0, start=1.0) is None
    assert straight(1.0, 0.5, 2.0, start=1.0) is None, "too fast at the start"


@pytest.mark.parametrize("kernel", [nullcontext, twin], ids=["native", "twin"])
def test_a_bend_that_cannot_be_driven(kernel):
    with kernel():
        _bend()


def _bend():
    grid = np.linspace(0.0, 1.0, 21)
    y1, y2 = np.tile([1.0, 0.0], (21, 1)), np.tile([0.0, 5.0], (21, 1))
    y1[:, 1] = 1e-3
    bound, limits = np.full(21, 1.0), np.ones(2)
    assert fastest(grid, y1, y2, bound, limits, 0.19) is not None
    assert fastest(grid, y1, y2, bound, limits, 0.21) is None
    y2[10] = np.nan
    assert fastest(grid, y1, y2, bound, limits, 0.0) is None


@pytest.mark.parametrize("kernel", [nullcontext, twin], ids=["native", "twin"])
def test_where_a_joint_turns_back_only_the_speed_counts(kernel):
    """Its rate is 0 there whatever the acceleration along the path is: y'' alone bounds the start, at 1/5."""
    grid = np.linspace(0.0, 1.0, 21)
    y1, y2 = np.tile([1.0, 0.1], (21, 1)), np.zeros((21, 2))
    y1[0, 1], y2[0, 1] = 0.0, 5.0
    bound, limits = np.full(21, 1.0), np.ones(2)
    with kernel():
        assert fastest(grid, y1, y2, bound, limits, 0.199) is not None
        assert fastest(grid, y1, y2, bound, limits, 0.201) is None


@each("kernel", [nullcontext, twin], ids=["native", "twin"])
@each("name", ["silvermate", "tiago", "rover"])
def test_as_fast_as_toppra(name, kernel, request):
    """Its own algorithm with the same constraints at the same points is no faster."""
    robot = request.getfixturevalue(name)
    limits = limits_of(robot)
    weight = metric(robot, limits)
    for seed in range(4):
        line = polyline(robot, limits, weight, arcs(robot, seed))
        path = smooth_path(robot, limits, line, float(line.s[line.stops[0]]), weight=weight)

        class Geometry(toppra.interpolator.AbstractGeometricPath):
            dof = len(weight)
            path_interval = np.array([0.0, path.curve.length])
            duration = path.curve.length

            def __call__(self, s, order=0, curve=path.curve):
                rows = curve(np.atleast_1d(s))[order]
                return rows if np.ndim(s) else rows[0]

        def both(row: np.ndarray) -> np.ndarray:
            return np.stack([-row, row], axis=1)

        speed = toppra.constraint.JointVelocityConstraint(both(limits.speed))
        change = toppra.constraint.JointAccelerationConstraint(both(limits.acceleration))
        algorithm = toppra.algorithm.TOPPRA([speed, change], Geometry(), path.grid, solver_wrapper="seidel")
        _, reference, _ = algorithm.compute_parameterization(0.0, 0.0)
        bound = (limits.speed / np.maximum(np.abs(path.y1), 1e-12)).min(axis=1) ** 2
        with kernel():
            profile = fastest(path.grid, path.y1, path.y2, bound, limits.acceleration, 0.0)
        assert profile is not None
        np.testing.assert_allclose(np.sqrt(profile.x), reference, rtol=2e-3, atol=1e-3)
        assert profile.duration <= Profile.of(path.grid, reference**2).duration * 1.001


@pytest.mark.parametrize("kernel", [nullcontext, twin], ids=["native", "twin"])
def test_what_broken_limit_finds(silvermate, kernel):
    with kernel():
        _each_check(silvermate)


def _each_check(silvermate):
    """Each of its five checks, on samples that break it alone; and values that are not numbers."""
    limits = limits_of(silvermate)
    motion = Retimer(silvermate).full(arcs(silvermate, 1))
    y = np.zeros((len(motion), 9))
    y[1:] = np.cumsum(limits.to_coordinates(motion.steps), axis=0)
    v, a = limits.to_coordinates(motion.v), limits.to_coordinates(motion.a)
    speed, acceleration = limits.speed, limits.acceleration
    assert max(most_used(motion, limits)) <= 1.001
    assert broken_limit(motion.time, y, v, a, speed, acceleration) == ""
    jump = np.zeros_like(y)
    jump[100:, 3] = 5.0
    spike, shake = np.zeros_like(y), np.zeros_like(y)
    spike[100, 3], shake[100, 3] = 4.5, 1e-3
    ramp = 3.0 * motion.time[:, None] * (np.arange(9) == 5)
    assert "speed between" in broken_limit(motion.time, y + ramp, v, a, speed, 1e9 * acceleration)
    assert "the speed would" in broken_limit(motion.time, y, v + jump, a, speed, 1e9 * acceleration)
    assert "change of velocity" in broken_limit(motion.time, y, v + 0.2 * jump, a, speed, acceleration)
    assert "the acceleration would" in broken_limit(motion.time, y, v, a + spike, speed, acceleration)
    assert "acceleration between" in broken_limit(motion.time, y + shake, v, a, speed, acceleration)
    assert broken_limit(motion.time, y, v, a + np.where(spike > 0.0, np.nan, 0.0), speed, acceleration)
