"""A pretended machine for tests of executors: it does what it is told at once, and fails when it is told to."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from elastic_strips.collision import Certificate
from elastic_strips.control.guard import Desired
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.process.executor_process import ExecutorProcess
from elastic_strips.planning import straight_line
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, Retimer, Trajectory


class Machine:
    """Wheels and joints without inertia.

    Args:
        robot: that they are of.
        ended: file that is written when the driver is closed.
        wrong: from when [s], after it set off, how many calls fail: ``measure`` and ``send`` raise, ``nan`` measures
            what is no number. A busy machine leaves out periods, but none of these.
        fixes: whether it is localized, while it drives straight on.
    """

    def __init__(
        self,
        robot: RobotModel,
        ended: Path,
        wrong: Mapping[str, tuple[float, int]] | None = None,
        *,
        fixes: bool = False,
    ) -> None:
        self.joints = robot.space.to_coordinates(robot.home_q)[robot.space.base_nv :]
        self.command = Command.rest(MotionLimits.for_robot(robot))
        self.travel = np.zeros_like(self.command.drive)
        self.time = self.x = 0.0
        self.fixes = fixes
        self.moves: float | None = None  # since when [s]
        self.ended, self.wrong = ended, dict(wrong or {})
        self.contact = self.emergency = ""

    def fails(self, what: str, t: float) -> bool:
        begin, left = self.wrong.get(what, (np.inf, 0))
        if self.moves is None or left == 0 or t - self.moves < begin:
            return False
        self.wrong[what] = begin, left - 1
        return True

    def measure(self, t: float) -> Measurement:
        if not (self.command.stop or self.emergency):
            self.travel = self.travel + self.command.drive * (t - self.time)
            self.joints = self.joints + self.command.joints * (t - self.time)
            self.x += float(self.command.drive.mean()) * (t - self.time)
        self.time = t
        if self.fails("measure", t):
            raise OSError("no answer from the wheels")
        travel, self.travel = self.travel, np.zeros_like(self.travel)
        if self.fails("nan", t):
            travel = travel * np.nan
        pose = np.array([self.x, 0.0, 0.0]) if self.fixes else None
        return Measurement(
            t, travel, self.joints, pose, None if pose is None else t, contact=self.contact, emergency=self.emergency
        )

    def send(self, t: float, command: Command) -> None:
        if self.fails("send", t):
            raise OSError("no answer from the motors")
        self.command = command
        if self.moves is None and command.drive.any():
            self.moves = t

    def close(self) -> None:
        self.ended.write_text("closed")


class Unsendable(Machine):
    """One that cannot be sent to a process."""

    def __getstate__(self) -> object:
        raise TypeError("a serial port stays where it is")


class Unmakeable(Machine):
    """One that cannot be received by a process."""

    def __setstate__(self, state: object) -> None:
        raise OSError("the serial port is taken")


class Opened(Machine):
    """One that takes its time to open; what it says of its bus where that is missing."""

    missing = ""

    def open(self) -> None:
        time.sleep(0.3)
        if self.missing:
            raise OSError(self.missing)
        self.ended.with_suffix(".opened").write_text("opened")


def straight(robot: RobotModel, far: float, begin: float, *, near: float = 0.0) -> Trajectory:
    """From rest at ``near`` [m] straight ahead to ``far`` [m], from time ``begin`` [s] on."""
    line = straight_line(robot, robot.home(x=near), robot.home(x=far), spacing=0.1)
    return Retimer(robot, MotionLimits.for_robot(robot), dt=0.02).horizon(line, start_time=begin)


def certificate_of(motion: Trajectory, *, good: bool = True) -> Certificate:
    """One that says what is asked for; nobody looked."""
    n = len(motion)
    return Certificate(0.02, np.full(n, good), np.zeros(n, dtype=np.int8), None, 0)


def set_off(executor: ExecutorProcess, far: float) -> None:
    """Let it drive straight on to ``far`` [m], and wait until it does; a busy machine may take several attempts."""
    for _ in range(10):
        near = float(executor.active.coordinates[-1, 0])
        motion = straight(executor.robot, far, 0.0, near=near)
        motion = replace(motion, time=motion.time + executor.now + 0.2)
        executor.submit(motion, certificate_of(motion), at_goal=True, proven=0.02)
        end = time.monotonic() + 5.0
        while time.monotonic() < end:
            if executor.reference(0.0).v[0] > 0.4:
                return
            time.sleep(0.01)
    raise AssertionError(executor.run.events)


def plan(robot: RobotModel, driver: Machine, log: Path, told: Connection) -> None:
    """A planner: sends one long motion, and then nothing but heartbeats, until somebody kills it."""
    with ExecutorProcess(robot, robot.home(), robot.home(x=12.0), log=log) as executor:
        executor.start(driver)
        executor.begin(time.monotonic())
        set_off(executor, 12.0)
        told.send(executor.pid)
        time.sleep(300.0)


class Piloted(Machine):
    """One whose pilot wants to drive straight on, from `begins` [s] on, and says so until `ends` [s]."""

    begins, ends = 1.0, 1e9

    def desired(self, t: float) -> Desired | None:
        if t < self.begins:
            return None
        return Desired(twist=np.array([0.8, 0.0, 0.0]), time=min(t, self.ends))

    def notes(self) -> list[str]:
        return ["the pilot is in another frame"]
