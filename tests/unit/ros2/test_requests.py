"""Requests: what is asked in other threads is done by the one that plans, and what became of a goal is told."""

from __future__ import annotations

import numpy as np
import pytest

import elastic_strips as es
from elastic_strips.control import Controller
from elastic_strips.robot import RobotModel
from elastic_strips.ros2.requests import GoalState, Request, Requests
from elastic_strips.sim import KinematicPlant
from elastic_strips.trajectory import MotionLimits


class Drive:
    """A controller in a room with nothing in it, that stands at its start."""

    def __init__(self, robot: RobotModel) -> None:
        limits = MotionLimits.for_robot(robot)
        self.machine = KinematicPlant(robot, limits, seed=1)
        self.machine.reset(robot.space.to_coordinates(robot.home()))
        self.controller = Controller(robot, robot.home(), robot.home(), None, limits=limits)
        self.requests, self.said = Requests(0.3), []
        self.t, self.measurement = 0.0, None

    def run(self, seconds: float, until: GoalState | None = None) -> None:
        end = self.t + seconds
        while self.t < end and self.requests.state is not until:
            self.requests.do(self.controller, self.said.append)
            command = self.controller.step(self.t, self.measurement, es.Scene([], time=self.t))
            self.measurement = self.machine.step(command, 0.02)
            self.t += 0.02


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
