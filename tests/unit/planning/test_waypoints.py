"""Rows along a way of the base: with the arm tucked for the drive."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.planning.initial_strip import tucked_rows, waypoint_rows

WAY = np.column_stack((np.linspace(0.0, 3.0, 31), 0.4 * np.sin(np.linspace(0.0, np.pi, 31))))


@pytest.mark.parametrize("name", ["silvermate", "tiago", "jackal_box"])
def test_the_arm_is_tucked_while_the_base_moves(name, request) -> None:
    robot = request.getfixturevalue(name)
    space = robot.space
    rng = np.random.default_rng(3)
    ends = space.to_coordinates(np.stack((robot.home(), robot.home(x=3.0))))
    joints = ends[:, 3:] + rng.uniform(-0.7, 0.7, ends[:, 3:].shape)
    ends[:, 3:] = np.clip(joints, space.lower[3:], space.upper[3:])
    start, goal = space.from_coordinates(ends)
    rows = tucked_rows(robot, start, goal, WAY, spacing=0.13)
    np.testing.assert_allclose(rows[[0, -1]], ends, atol=1e-12)
    steps = np.abs(space.difference(rows[:-1], rows[1:]))
    assert steps[:, 3:].max(initial=0.0) <= 0.3 + 1e-9
    home = space.to_coordinates(robot.home_q)[3:]
    away = np.abs(rows[:, 3:] - home).max(axis=1, initial=0.0) > 1e-9
    moves = steps[:, :3].max(axis=1) > 1e-9
    assert not (moves & (away[:-1] | away[1:])).any()
    assert moves.sum() > 20
    assert (steps.max(axis=1) > 1e-9).all()  # no row twice


def test_an_end_that_is_tucked_already_adds_no_rows(silvermate) -> None:
    start, goal = silvermate.home(), silvermate.home(x=3.0)
    one, two = (rows(silvermate, start, goal, WAY, spacing=0.13) for rows in (tucked_rows, waypoint_rows))
    np.testing.assert_array_equal(one, two)
