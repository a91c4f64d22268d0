"""The goal of a running drive, dragged with the mouse."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.control import RunState
from elastic_strips.robot import load_robot
from elastic_strips.scene import Scene, Sphere
from elastic_strips.sim import simulation
from elastic_strips.viewer import Viewer
from elastic_strips.viewer.drag import Drag
from elastic_strips.viewer.dragged_goal import DraggedGoal


@pytest.fixture(scope="module")
def robot():
    return load_robot("bridge-arm")


def driven_and_dragged(robot, drags, scene=None, time_limit=30.0):
    """Drive 2 m, drag the goal from 1 s on, and stop once the robot is at the goal and nothing is dragged."""
    with Viewer(server=False) as viewer:

        def watch(driven):
            if driven.time >= 1.0 and drags:
                dragged._hear(drags.pop(0))
            dragged.tell()
            shown.append(dragged.shown)
            if driven.controller.state is RunState.REACHED and not drags:
                driven.stop()

        driven = simulation(robot, scene or Scene([]), robot.home(), robot.home(x=2.0), watch=watch)
        dragged, shown = DraggedGoal(viewer, driven.controller), []
        driven.stays = True
        with driven.controller:
            return driven, driven.run(time_limit=time_limit), dragged, shown


def test_the_robot_goes_to_where_the_ring_is_dragged(robot):
    drags = [Drag("grab", None), *(Drag("drag", None, (0.0, 0.1 * k, 0.0), 0.05 * k) for k in range(1, 11))]
    driven, result, dragged, shown = driven_and_dragged(robot, [*drags, Drag("release", None)])
    assert driven.controller.state is RunState.REACHED
    np.testing.assert_allclose(driven.controller.estimate[:3], [2.0, 1.0, 0.5], atol=0.05)
    assert not result.stops  # of its own: it has not stopped for the new goals
    assert dragged.shown is None  # it is the drive's own goal
    assert any(row is not None for row in shown)


def test_the_robot_reaches_for_where_the_hand_is_dragged(robot):
    drags = [Drag("grab", None, hand=True), Drag("drag", None, (0.3, 1.0, 0.1), hand=True), Drag("release", None)]
    driven, _, dragged, _ = driven_and_dragged(robot, drags)
    hand = dragged._hand
    before, after = hand.pose(robot.space.to_coordinates(robot.home(x=2.0))), hand.pose(driven.controller.estimate)
    np.testing.assert_allclose(after[:3, 3], before[:3, 3] + [0.3, 1.0, 0.1], atol=0.03)


def test_a_goal_in_an_obstacle_is_not_driven_to(robot):
    scene = Scene([Sphere(0.5, at=(2.0, 2.0, 0.3), name="ball")])
    drags = [Drag("grab", None), Drag("drag", None, (0.0, 2.0, 0.0)), Drag("release", None)]
    _, result, dragged, _ = driven_and_dragged(robot, drags, scene, time_limit=6.0)
    assert not result.goals
    assert any("ball" in reason for _, reason in result.stops)
    np.testing.assert_allclose(dragged.shown[:2], [2.0, 2.0])  # it is still drawn where it was left


def test_obstacles_are_not_the_goal(robot):
    driven, _, _, shown = driven_and_dragged(robot, [Drag("grab", "box"), Drag("drag", "box", (1.0, 1.0, 0.0))])
    assert driven.controller.state is RunState.REACHED
    assert driven.controller.estimate[1] == pytest.approx(0.0, abs=0.05)
    assert shown
    assert all(row is None for row in shown)
