"""A robot that is asked for goals as the ROS 2 node is, without ROS."""

from __future__ import annotations

from simulated_time import planning_at_once

import elastic_strips as es
from elastic_strips.control import Controller
from elastic_strips.robot import RobotModel
from elastic_strips.ros2.requests import GoalState, Requests
from elastic_strips.sim import KinematicPlant
from elastic_strips.trajectory import MotionLimits


class Drive:
    """A controller in a room with nothing in it, that stands at its start."""

    def __init__(self, robot: RobotModel) -> None:
        limits = MotionLimits.for_robot(robot)
        self.machine = KinematicPlant(robot, limits, seed=1)
        self.machine.reset(robot.space.to_coordinates(robot.home()))
        workers = planning_at_once()  # time is simulated: how far it has come must not depend on the machine
        self.controller = Controller(robot, robot.home(), robot.home(), None, limits=limits, workers=workers)
        self.requests, self.said = Requests(0.3), []
        self.t, self.measurement, self.speeds = 0.0, None, []
        self.walls = []

    def run(self, seconds: float, until: GoalState | None = None) -> None:
        end = self.t + seconds
        while self.t < end and self.requests.state is not until:
            self.requests.do(self.controller, self.said.append)
            command = self.controller.step(self.t, self.measurement, es.Scene(self.walls, time=self.t))
            self.measurement = self.machine.step(command, 0.02)
            self.t += 0.02
            self.requests.note_progress(self.controller)
            self.speeds.append(abs(float(self.machine.v[0])))
