"""Virtual force field: the published forces by hand, damping and filter; narrow doors are its known weakness."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each
from flat_world import World, door, drive, patience, placed
from hypothesis import given
from hypothesis import strategies as st

from elastic_strips.errors import ParameterError
from elastic_strips.perception import RangeRing
from workshop.baselines import BaseLimits, VirtualForceField, VirtualForceFieldParams
from workshop.baselines.force_fields import cell_forces, damped

GOAL = np.array([5.05, 0.05, 0.0])
HERE = np.array([0.05, 0.05, 0.0])


def test_forces_of_cells_by_hand():
    p = VirtualForceFieldParams(repulsion=0.1)
    force = cell_forces(np.array([[0.0, 2.0], [3.0, 4.0]]), np.array([6.0, 15.0]), 0.5, p)
    np.testing.assert_allclose(force[0], [0.0, -0.1 * 6.0 * 0.25 / 4.0])
    np.testing.assert_allclose(force[1], 0.1 * 15.0 * 0.25 / 25.0 * np.array([-0.6, -0.8]))


@given(st.floats(0.1, 3.0), st.floats(-3.0, 3.0), st.floats(1.0, 3.0))
def test_twice_the_distance_is_a_force_weaker_by_the_power(distance, angle, power):
    p = VirtualForceFieldParams(power=power)
    at = distance * np.array([math.cos(angle), math.sin(angle)])
    near, far = cell_forces(np.stack((at, 2.0 * at)), np.array([15.0, 15.0]), 0.54, p)
    np.testing.assert_allclose(near, far * 2.0**power, rtol=1e-9, atol=1e-12)


def test_attraction_is_constant():
    method = VirtualForceField(BaseLimits())
    for goal in (GOAL, np.array([0.05, 9.0, 0.0])):
        assert np.hypot(*method.forces(HERE, goal)[1]) == pytest.approx(1.0)


def test_damping_by_the_direction():
    ahead = np.array([1.0, 0.0])
    np.testing.assert_allclose(damped(np.array([-2.0, 0.0]), ahead, 0.25), [-2.0, 0.0])
    np.testing.assert_allclose(damped(np.array([0.0, 2.0]), ahead, 0.25), [0.0, 0.5])
    slanted = 2.0 * np.array([-0.5, math.sqrt(0.75)])
    np.testing.assert_allclose(damped(slanted, ahead, 0.25), (0.25 + 0.75 * 0.5) * slanted)
    np.testing.assert_allclose(damped(slanted, ahead, 1.0), slanted)


def test_a_seen_cell_repels():
    method = VirtualForceField(BaseLimits(radius=0.25), VirtualForceFieldParams(repulsion=0.1))
    method.update(RangeRing("s", "sonar", 0.0, np.eye(4)[None], [1.0], 0.2, 0.0, 2.0), HERE)
    np.testing.assert_allclose(method.forces(HERE, GOAL)[0], [-0.1 * 3.0 * 0.25, 0.0], atol=1e-12)


def test_speed_falls_with_the_cosine():
    limits = BaseLimits(acceleration=100.0)
    for bearing, share in ((0.5 * math.pi, 1.0), (math.pi / 3.0, 0.5)):
        method = VirtualForceField(limits, VirtualForceFieldParams(full_force=0.0, min_speed=0.0))
        T = placed(0.0, 0.0, bearing)[None]
        method.update(RangeRing("s", "sonar", 0.0, T, [1.0], 0.2, 0.0, 2.0), HERE)
        force = method.forces(HERE, GOAL)[0]
        cos = abs(force[0]) / np.hypot(*force)  # of the cell's middle, not quite of the bearing
        command = method.command(0.0, HERE, np.zeros(2), GOAL)
        assert command.v == pytest.approx(limits.max_speed * (1.0 - cos))
        assert command.v == pytest.approx(limits.max_speed * share, abs=0.05)


def test_the_yaw_rate_is_low_pass_filtered():
    method = VirtualForceField(
        BaseLimits(turn_acceleration=1000.0), VirtualForceFieldParams(turn_gain=1.0, filter_time=0.4)
    )
    pose = np.array([0.0, 0.0, -0.5])  # the goal is 0.5 rad to the left
    goal = np.array([5.0, 0.0, 0.0])
    rates = [method.command(0.1 * k, pose, np.zeros(2), goal).omega for k in range(3)]
    np.testing.assert_allclose(rates, 0.5 * (1.0 - 0.75 ** np.arange(1, 4)), rtol=1e-9)


def test_it_does_not_pass_a_narrow_door():
    start, goal = (0.6, 0.0, 0.0), (5.0, 0.0, 0.0)
    run = drive(
        VirtualForceField(BaseLimits()),
        door(0.8),
        start,
        goal,
        seconds=patience(start, goal),
        rate=10.0,
        until_blocked=True,
    )
    assert not run.arrived
    assert run.blocked
    assert run.poses[:, 0].max() < 2.5
    turns = np.sign([c.omega for c in run.commands if abs(c.omega) > 0.2])
    assert {-1.0, 1.0} <= set(turns)  # it swings to and fro in front of it
    assert run.clearance > 0.0


def test_it_passes_a_wide_gap():
    run = drive(
        VirtualForceField(BaseLimits()), door(3.0), (0.0, 0.0, 0.0), np.array([5.0, 0.0, 0.0]), seconds=20.0, rate=10.0
    )
    assert run.poses[-1, 0] > 3.0
    assert run.clearance > 0.0


def test_without_repulsion_it_drives_straight():
    run = drive(
        VirtualForceField(BaseLimits(), VirtualForceFieldParams(repulsion=0.0)),
        World(),
        (0, 0, 0),
        GOAL - HERE,
        rate=10.0,
    )
    assert run.arrived
    assert np.abs(run.poses[:, 1]).max() < 1e-9


@each(
    "given_, message",
    [
        ({"weight": 1.5}, r"weight=1.5 must be a finite number ≥ 0 and ≤ 1"),
        ({"active": 32}, r"active=32 must be odd"),
        ({"attraction": 0.0}, r"attraction=0.0 must be a finite number > 0"),
    ],
)
def test_parameters_are_checked(given_, message):
    with pytest.raises(ParameterError, match=message):
        VirtualForceFieldParams(**given_)
