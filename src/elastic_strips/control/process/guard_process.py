"""Guard process: a guard and its driver in a process of their own; scenes come from the process that started it.

The pilot's commands come by the driver, straight into this process. Whoever makes the scenes may be late, hang or die:
then the scene grows old, and the robot comes to rest.
"""

from __future__ import annotations

import os
import socket
from collections import deque
from itertools import count
from typing import Protocol

import numpy as np
import numpy.typing as npt

from elastic_strips.control.driver import Driver
from elastic_strips.control.guard import Desired, Guard, GuardParams
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Scene
from elastic_strips.scene.difference import difference, with_difference
from elastic_strips.trajectory import MotionLimits

from .channel import put
from .executor_loop import Loop, run_loop
from .executor_process import ExecutorProcess
from .log_stream import LogStream

_REMEMBERED_SCENES = 20  # that another one may refer to
_WARM_PERIODS = 5  # that a guard steps through before the first one that counts: it loads modules, and makes tables

GuardTask = tuple[RobotModel, MotionLimits, GuardParams, npt.NDArray[np.float64]]
"""The parts that a guard is made of: robot, limits, parameters, configuration of the robot."""


class PilotedDriver(Driver, Protocol):
    """A driver that also hears what somebody wants the robot to do."""

    def desired(self, t: float) -> Desired | None:
        """What is wanted from ``t`` [s] on, with the time at which it was said; None: nothing."""
        ...


def serve_guard(link: socket.socket, driver: PilotedDriver, task: GuardTask, log: str | None) -> None:
    """Main function of the process; as `serve` of the executor's."""
    run_loop(link, driver, lambda stream: _GuardLoop(link, _warmed(task), driver, stream), log)


def _warmed(task: GuardTask) -> Guard:
    """A guard that has not begun, in a process where one has worked already."""
    robot, limits, params, q = task
    wall = Box((0.1, 4.0, 1.0), at=(2.0, 0.0, 0.5), name="wall")
    trial = Guard(robot, limits, params, start=q)
    for k in range(_WARM_PERIODS):
        twist = np.array([0.1, 0.0, 0.0]) if robot.space.base_nv else None
        rates = 0.1 * limits.joint_speed
        trial.step(0.01 * k, None, Scene([wall], time=0.01 * k), Desired(twist=twist, joints=rates))
    return Guard(robot, limits, params, start=q, events=500)


class _GuardLoop(Loop):
    """Workspace: the guard's control loop in its process, on the wall clock."""

    driver: PilotedDriver

    def __init__(self, link: socket.socket, guard: Guard, driver: PilotedDriver, log: LogStream | None) -> None:
        super().__init__(link, guard.executor, driver, log)
        self.guard = guard
        self.newest: Scene | None = None  # until it is taken
        self.scenes: dict[int, Scene] = {}  # the last ones, by number

    def command(self, t: float, measurement: Measurement | None) -> Command:
        desired: Desired | None = None
        try:
            desired = self.driver.desired(t)
        except Exception as error:
            self.executor.log("fault", f"driver exception: {type(error).__name__}: {error}")
        self.check_planner(t)
        scene, self.newest = self.newest, None
        answer = self.guard.step(t, measurement, scene, None if self.closing or self.gone else desired)
        what = answer.outcome.value + ("" if answer.share in (0.0, 1.0) else f" ({100.0 * answer.share:.0f} %)")
        self.pilot = f"{what}: {answer.reason}" if answer.reason else what
        return answer.command

    def obey(self, message: object) -> None:
        if not isinstance(message, tuple) or message[:1] != ("scene",):
            super().obey(message)
            return
        _, number, base, new = message
        scene = with_difference(self.scenes[base] if base else None, new)
        self.newest = self.scenes[number] = scene
        self.taken = number
        self.scenes = {k: each for k, each in self.scenes.items() if k > number - _REMEMBERED_SCENES}


class GuardProcess(ExecutorProcess):
    """Workspace: a guard in a process of its own, as an executor is.

    Args:
        robot: the robot.
        start: configuration (nq,) of the robot at rest.
        params: how commands are guarded.
        limits: limits of the motors; read off the robot where None.
        log: file of the log; None writes no log.
    """

    _serve = staticmethod(serve_guard)

    def __init__(
        self,
        robot: RobotModel,
        start: npt.ArrayLike,
        params: GuardParams,
        *,
        limits: MotionLimits | None = None,
        log: str | os.PathLike[str] | None = None,
    ) -> None:
        super().__init__(robot, start, start, params=params.drive, limits=limits, log=log)
        self._task = (robot, self.limits, params, robot.check_q(start, what="start"))
        self._numbers = count(1)
        self._scenes: deque[tuple[int, Scene]] = deque(maxlen=_REMEMBERED_SCENES - 1)  # sent last, by number

    def see(self, scene: Scene) -> bool:
        """Hand over a newer scene; False where it was too large, or the process is behind.

        What was in the last one that is known to have come is not sent again, if it is the same object.
        """
        number = next(self._numbers)
        base, before = next(((k, s) for k, s in self._scenes if k == self._status.scene), (0, None))
        if not put(self._link, ("scene", number, base, difference(scene, before))):
            return False
        self._scenes.append((number, scene))
        return True
