"""Straight lines: drivable to the last digit for a differential drive, straight for the others."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from brute_force import random_configurations
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.planning import plan_report, straight_line
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip

SPACING = 0.15


def rows_of(robot, a, b, spacing=SPACING):
    rows = straight_line(robot, a, b, spacing=spacing)
    Strip(robot, robot.space.from_coordinates(rows))  # sound configurations
    return rows


@settings(max_examples=80, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([1e-12, 1e-6, 0.01, 1.0, 5.0]))
def test_a_differential_drive_can_follow_exactly(silvermate, seed, scale):
    rng = np.random.default_rng(seed)
    a, b = random_configurations(silvermate, rng, 2)
    b[:2] = a[:2] + scale * rng.normal(size=2)
    rows = rows_of(silvermate, a, b)
    q = silvermate.space.from_coordinates(rows)
    np.testing.assert_allclose(q[0], a, atol=1e-15)
    np.testing.assert_allclose(q[-1], b, atol=1e-15)
    v = np.array([pin.difference(silvermate.model, x, y) for x, y in pairwise(q)])
    assert np.abs(v[:, 1]).max() <= 2e-9
    assert np.hypot(v[:, 0], v[:, 1]).max() <= SPACING + 1e-9
    assert np.abs(v[:, 2]).max() <= np.pi / 2
    assert len(rows) >= 3


def test_driving_is_straight_and_turning_in_place(silvermate):
    rows = rows_of(silvermate, silvermate.home(yaw=1.0), silvermate.home(x=2.0, y=2.0, yaw=-0.5))
    at_start = np.linalg.norm(rows[:, :2], axis=1) < 1e-12
    at_goal = np.linalg.norm(rows[:, :2] - 2.0, axis=1) < 1e-12
    assert at_start.sum() > 1
    assert at_goal.sum() > 1
    np.testing.assert_allclose(rows[:, 0], rows[:, 1], atol=1e-12)
    driving = ~at_start & ~at_goal
    np.testing.assert_allclose(rows[driving, 2], np.pi / 4, atol=1e-12)
    assert np.abs(np.diff(rows[:, 2])).max() < 0.36


def test_it_backs_up_where_that_turns_less(silvermate):
    rows = rows_of(silvermate, silvermate.home(), silvermate.home(x=-2.0))
    np.testing.assert_allclose(rows[:, 2], 0.0, atol=1e-12)
    assert (np.diff(rows[:, 0]) < 0).all()


def test_who_does_not_look_back_turns_instead(silvermate):
    start, goal = silvermate.home(), silvermate.home(x=-2.0)
    rows = straight_line(silvermate, start, goal, spacing=SPACING, backward=False)
    drives = np.abs(np.diff(rows[:, 0])) > 1e-9
    np.testing.assert_allclose(np.cos(rows[1:][drives, 2]), -1.0, atol=1e-12)
    for backward, sign in ((False, 1.0), (True, -1.0)):
        report = plan_report(silvermate, Scene([]), start, goal, backward=backward)
        assert report.certified
        nodes = report.strip.coordinates
        assert (sign * silvermate.space.difference(nodes[:-1], nodes[1:])[:, 0] > -1e-9).all()


def test_turning_in_place_stays_in_place(silvermate):
    rows = rows_of(silvermate, silvermate.home(x=1.0, y=2.0), silvermate.home(x=1.0, y=2.0, yaw=3.0))
    np.testing.assert_allclose(rows[:, :2], [[1.0, 2.0]] * len(rows), atol=1e-12)
    assert len(rows) >= 5


def test_joints_move_along_the_drive(silvermate):
    rows = rows_of(silvermate, silvermate.home(arm_1_joint=0.0), silvermate.home(x=3.0, arm_1_joint=1.0))
    np.testing.assert_allclose(rows[:, 3], rows[:, 0] / 3.0, atol=1e-9)
    only = rows_of(silvermate, silvermate.home(arm_1_joint=0.0), silvermate.home(arm_1_joint=1.0))
    assert (np.diff(only[:, 3]) > 0).all()
    np.testing.assert_array_equal(only[:, :3], 0.0)


def test_an_omnidirectional_base_slides(rover):
    rows = rows_of(rover, rover.home(), rover.home(x=1.0, y=2.0, yaw=1.0))
    s = rows[:, 0]
    np.testing.assert_allclose(rows[:, 1], 2.0 * s, atol=1e-12)
    np.testing.assert_allclose(rows[:, 2], s, atol=1e-12)


def test_an_omnidirectional_base_keeps_the_spacing(rover):
    rows = rows_of(rover, rover.home(), rover.home(x=1.0, y=2.0))
    assert np.hypot(*np.diff(rows[:, :2], axis=0).T).max() <= SPACING + 1e-9


def test_a_fixed_base_moves_its_joints(gantry, rng):
    a, b = random_configurations(gantry, rng, 2)
    rows = rows_of(gantry, a, b)
    expected = [pin.interpolate(gantry.model, a, b, s) for s in np.linspace(0, 1, len(rows))]
    np.testing.assert_allclose(gantry.space.from_coordinates(rows), expected, atol=1e-9)


@pytest.mark.parametrize("name", ["silvermate", "rover"])
def test_continuous_angles_take_the_short_way(name, request):
    robot = request.getfixturevalue(name)
    rows = rows_of(robot, robot.home(yaw=3.0), robot.home(yaw=-3.0))
    assert np.abs(np.diff(np.unwrap(rows[:, 2]))).sum() < 0.3 + 1e-6
