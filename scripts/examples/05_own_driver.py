"""A controller on a robot of your own: a driver with motors and encoders, and the loop around Controller.step.

The driver here only pretends; put your own in its place. Run it: python scripts/examples/05_own_driver.py
"""

from __future__ import annotations

import numpy as np

import elastic_strips as es

PERIOD = 0.01  # [s] of the control loop, DriveParams.control_dt


class Driver:
    """Stands for two wheels and an arm, all with encoders: it does what it is told at once."""

    def __init__(self, joints: np.ndarray) -> None:
        self.joints, self.travel = joints, np.zeros(2)

    def send(self, command: es.Command) -> None:
        self.travel = command.drive * PERIOD  # of the rims, left and right [m]
        self.joints = self.joints + command.joints * PERIOD  # [rad]

    def measure(self, t: float) -> es.Measurement:
        return es.Measurement(t, self.travel, self.joints)  # and pose=, pose_time= where a localization has one


robot = es.load_robot("silvermate")
crate = es.Box((0.4, 0.4, 1.0), at=(1.6, 0.35, 0.5), name="crate")
driver = Driver(robot.space.to_coordinates(robot.home())[3:])

with es.Controller(robot, robot.home(), robot.home(x=3.0), es.Scene([crate])) as controller:
    t, measurement = 0.0, None  # before the first command the robot stands, and nothing is measured
    while not controller.ended:  # on a robot: once every PERIOD
        scene = es.Scene([crate], time=t)  # what your perception saw last, and when; None where that is nothing new
        driver.send(controller.step(t, measurement, scene))
        t += PERIOD
        measurement = driver.measure(t)
    print(f"{controller.state.label} after {t:.1f} s: {controller.reason}")
    print("the robot believes to be at", np.round(controller.estimate[:3], 3))
