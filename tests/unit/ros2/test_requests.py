"""Requests: what is asked in other threads is done by the one that plans, and what became of a goal is told."""

from __future__ import annotations

import numpy as np
import pytest
from asked import Drive

import elastic_strips as es
from elastic_strips.robot import RobotModel
from elastic_strips.ros2.requests import GoalState, Request
from elastic_strips.trajectory import MotionLimits


@pytest.fixture
def drive(jackal_box: RobotModel) -> Drive:
    made = Drive(jackal_box)
    made.run(0.5)
    return made


def goal(x: float, y: float = 0.0) -> Request:
    return Request("goal", np.array([x, y, 0.0]))


def test_a_goal_is_reached(drive: Drive):
    drive.requests.ask(goal(1.0))
    drive.run(20.0, GoalState.REACHED)
    assert drive.requests.state is GoalState.REACHED
    assert drive.machine.coordinates[0] == pytest.approx(1.0, abs=0.1)
    assert drive.requests.wait(1, 0.0) == (GoalState.REACHED, drive.requests.reason)


def test_another_goal_takes_the_place_of_one(drive: Drive):
    drive.requests.ask(goal(3.0))
    drive.run(1.0)
    assert drive.requests.wait(1, 0.0) is None
    drive.requests.ask(goal(1.5))
    drive.run(20.0, GoalState.REACHED)
    assert drive.requests.wait(1, 0.0) == (GoalState.CANCELLED, "another goal took its place")
    assert drive.machine.coordinates[0] == pytest.approx(1.5, abs=0.1)


def test_stop_resume_and_cancel(drive: Drive):
    drive.requests.ask(goal(3.0))
    drive.run(1.5)
    assert drive.machine.v[0] > 0.2
    drive.requests.ask(Request("stop", reason="asked to stop"))
    drive.run(3.0)
    assert drive.machine.v[0] == pytest.approx(0.0, abs=0.01)
    assert "asked to stop" in drive.controller.reason
    drive.requests.ask(Request("resume"))
    drive.run(1.5)
    assert drive.machine.v[0] > 0.1
    drive.requests.ask(Request("cancel", reason="changed my mind"))
    drive.run(3.0)
    assert drive.machine.v[0] == pytest.approx(0.0, abs=0.01)
    assert drive.requests.wait(1, 0.0) == (GoalState.CANCELLED, "changed my mind")


def test_a_path_is_followed_and_one_that_begins_elsewhere_is_refused(drive: Drive):
    drive.requests.ask(Request("path", np.array([[5.0, 5.0, 0.0], [6.0, 5.0, 0.0]])))
    drive.run(0.1)
    assert drive.requests.state is GoalState.REFUSED
    assert drive.said
    drive.requests.ask(Request("path", np.array([[0.0, 0.0, 0.0], [1.0, 0.2, 0.0], [2.0, 0.2, 0.0]])))
    drive.run(20.0, GoalState.REACHED)
    assert drive.requests.state is GoalState.REACHED
    np.testing.assert_allclose(drive.machine.coordinates[:2], [2.0, 0.2], atol=0.1)


def test_a_goal_that_is_refused_leaves_the_one_before(drive: Drive):
    kept = drive.requests.ask(goal(1.5))
    drive.run(1.0)
    refused = drive.requests.ask(Request("path", np.array([[5.0, 5.0, 0.0], [6.0, 5.0, 0.0]])))
    drive.run(0.1)
    assert (drive.requests.outcome(refused) or ("",))[0] is GoalState.REFUSED
    assert drive.requests.state is GoalState.DRIVING
    assert drive.requests.outcome(kept) is None
    drive.run(20.0, GoalState.REACHED)
    assert (drive.requests.outcome(kept) or ("",))[0] is GoalState.REACHED
    assert drive.machine.coordinates[0] == pytest.approx(1.5, abs=0.1)


def test_what_is_cancelled_is_over_when_the_robot_stands(drive: Drive):
    number = drive.requests.ask(goal(3.0))
    drive.run(1.5)
    drive.requests.ask(Request("cancel", reason="not that one", number=number + 1))
    drive.run(0.1)
    assert drive.requests.state is GoalState.DRIVING, "another goal's cancel"
    drive.requests.ask(Request("cancel", reason="enough", number=number))
    drive.run(0.04)
    assert drive.requests.state is GoalState.CANCELLED
    assert drive.speeds[-1] > 0.2
    while drive.requests.outcome(number) is None and drive.t < 10.0:
        drive.run(0.02)
    assert drive.requests.outcome(number) == (GoalState.CANCELLED, "enough")
    assert drive.speeds[-1] < 0.02


def test_a_goal_to_which_nothing_leads_is_given_up_with_the_reason(drive: Drive):
    drive.walls = [es.Box((0.2, 6.0, 1.5), at=(1.5, 0.0, 0.75), name="wall")]
    drive.run(0.1)
    number = drive.requests.ask(goal(1.5))  # within it
    drive.run(20.0, GoalState.REFUSED)
    state, reason = drive.requests.outcome(number) or ("", "")
    assert state is GoalState.REFUSED
    assert "wall" in reason
    assert drive.controller.keeper.cancelled == reason, "it does not set out later by itself"
    drive.requests.ask(goal(0.4))
    drive.run(20.0, GoalState.REACHED)
    assert drive.requests.state is GoalState.REACHED


def test_it_is_known_how_far_it_still_is(drive: Drive):
    number = drive.requests.ask(goal(2.0))
    drive.run(1.0)
    first = drive.requests.progress
    drive.run(1.0)
    second = drive.requests.progress
    assert first is not None
    assert second is not None
    assert first.number == number
    assert first.distance == pytest.approx(2.0 - first.place[0], abs=0.1)
    assert 0.1 < first.distance - second.distance < 1.5
    assert 0.0 < second.seconds < first.seconds
    assert second.speed == pytest.approx(drive.speeds[-1], abs=0.1)
    drive.run(20.0, GoalState.REACHED)
    drive.requests.note_progress(drive.controller)
    assert drive.requests.progress is None


def test_goals_that_are_open_end_with_the_node(drive: Drive):
    numbers = [drive.requests.ask(goal(2.0)), drive.requests.ask(goal(1.0))]
    drive.run(0.5)
    later = drive.requests.ask(goal(3.0))
    assert drive.requests.close("the node ends")
    assert drive.requests.outcome(numbers[1]) == drive.requests.outcome(later) == (GoalState.CANCELLED, "the node ends")
    assert drive.requests.outcome(numbers[0]) != (GoalState.CANCELLED, "the node ends")
    assert not drive.requests.close("the node ends")


def test_it_drives_more_slowly_while_that_is_asked_for(drive: Drive):
    top = drive.controller.params.speed_scale * float(MotionLimits.for_robot(drive.controller.robot).drive_speed[0])
    drive.requests.ask(Request("goal", np.array([20.0, 0.0, 0.0])))
    drive.requests.ask(Request("speed", np.array([0.2])))
    drive.run(3.0)
    assert 0.1 * top < float(drive.machine.v[0]) < 0.25 * top
    drive.requests.ask(Request("speed", np.array([1.0])))
    drive.run(3.0)
    assert float(drive.machine.v[0]) > 0.4 * top
    drive.requests.ask(Request("speed", np.array([0.0])))
    drive.run(3.0)
    assert abs(float(drive.machine.v[0])) < 0.01
