"""A driver of your own, and the control loop in a process of its own: it keeps its rate, and stops the robot by itself.

The machine here only pretends, in a thread; put yours in its place.
Run it: python scripts/examples/16_executor_process.py
"""

from __future__ import annotations

import threading
import time

import numpy as np

import elastic_strips as es
from elastic_strips.control.driver import COMMAND_TIMEOUT
from elastic_strips.control.process import ExecutorProcess


class Driver:
    """Wheels and an arm that do what they are told, for as long as a command is young; see control.driver.Driver."""

    def __init__(self, joints: np.ndarray, track: float) -> None:
        self.joints, self.travel, self.told = joints, np.zeros(2), np.zeros(2)  # [rad], of the rims so far [m]
        self.track, self.pose = track, np.zeros(3)  # x, y [m], yaw [rad], as a localization would tell it
        self.command, self.until, self.machine = es.Command(np.zeros(2), 0.0 * joints), 0.0, None

    def measure(self, t: float) -> es.Measurement:
        if self.machine is None:  # here, and not in __init__: the driver is sent to the process that controls
            self.machine = threading.Thread(target=self.run, daemon=True)
            self.machine.start()
        before, self.told = self.told, self.travel
        return es.Measurement(t, self.told - before, self.joints, pose=self.pose, pose_time=t)

    def send(self, t: float, command: es.Command) -> None:
        self.command, self.until = command, time.monotonic() + COMMAND_TIMEOUT

    def close(self) -> None:
        self.until = 0.0

    def run(self) -> None:
        """The machine; a real one outlives the process that controls, and stops where no command comes."""
        before = time.monotonic()
        while True:
            time.sleep(0.002)
            now = time.monotonic()
            if now < self.until and not self.command.stop:
                left, right = step = self.command.drive * (now - before)
                yaw, way = self.pose[2], 0.5 * (left + right)
                self.pose = self.pose + np.array([way * np.cos(yaw), way * np.sin(yaw), (right - left) / self.track])
                self.travel = self.travel + step
                self.joints = self.joints + self.command.joints * (now - before)
            before = now


def main() -> None:
    robot = es.load_robot("silvermate")
    limits, start, goal = es.MotionLimits.for_robot(robot), robot.home(), robot.home(x=2.0)
    crate = es.Box((0.4, 0.4, 1.0), at=(1.0, 0.7, 0.5), name="crate")
    scene = es.Scene([crate])
    executor = ExecutorProcess(robot, start, goal, limits=limits)  # log="drive.jsonl": what it did, while it does it
    controller = es.Controller(robot, start, goal, scene, limits=limits, executor=executor, meter=time.monotonic)
    with executor, controller:
        executor.start(Driver(robot.space.to_coordinates(start)[3:], limits.track))
        executor.begin(time.monotonic())
        while not controller.ended and executor.now < 60.0:
            t = executor.now
            controller.plan(t, es.Scene([crate], time=t))  # what your perception saw last, and when
            time.sleep(max(0.0, t + 0.05 - executor.now))
        print(f"{controller.state.label}: {controller.reason}")
        print("the robot believes to be at", np.round(controller.estimate[:3], 2))


if __name__ == "__main__":  # the other process reads this file, too
    main()
