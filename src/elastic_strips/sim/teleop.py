"""Teleoperation: somebody drives a simulated robot through the guard, step by step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.control import Desired, Guard, GuardedCommand, GuardParams
from elastic_strips.control.interfaces import Measurement
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.trajectory import MotionLimits

from .closed_loop import prepare, sensed_by
from .evaluation import Evaluation, evaluate
from .pedestrians import Pedestrians
from .perception import NoisyGroundTruth, PerceptionParams


class Teleop:
    """Workspace: a machine in a world, a guard, and whoever steers.

    Args:
        robot: the robot.
        world: the true obstacles over time.
        start: configuration (nq,) of the robot at rest.
        limits: limits of its motors; read off the robot where None.
        params: how commands are guarded.
        seed: seed of machine and perception.
        meter: the clock of the guard's budget, see :class:`~elastic_strips.control.Guard`.

    Attributes:
        guard: the guard.
        world: a copy of the world, in which obstacles yield.
        time: simulated time [s].
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World | Scene,
        start: ArrayLike,
        *,
        limits: MotionLimits | None = None,
        params: GuardParams | None = None,
        seed: int = 0,
        meter: Callable[[], float] | None = None,
    ) -> None:
        self.guard: Guard = Guard(robot, limits, params, start=start, meter=meter)
        self.robot: RobotModel = robot
        self.time: float = 0.0
        self.world: World
        self.world, self._plant, rng = prepare(robot, world, self.guard.limits, None, seed)
        drive = self.guard.params.drive
        self._perception = NoisyGroundTruth(self.world, drive.assumptions, PerceptionParams(), rng)
        self._pedestrians = Pedestrians(robot, self.world)
        self._plant.reset(robot.space.to_coordinates(robot.check_q(start, what="start")))
        self._measurement: Measurement | None = None
        self._steps, self._dt, self._every = 0, drive.control_dt, drive.plan_every
        self._rows: list[tuple[Array, Array]] = []

    @property
    def coordinates(self) -> Array:
        """(nv,) true coordinate row of the robot."""
        return self._plant.coordinates

    def step(self, desired: Desired | None) -> GuardedCommand:
        """One control period with what is wanted from now on; None: nothing."""
        t = self.time
        scene, trouble = sensed_by(self._perception, t) if self._steps % self._every == 0 else (None, "")
        answer = self.guard.step(t, self._measurement, scene, desired, trouble=trouble)
        self._rows.append((self._plant.coordinates, self._plant.v))
        self._pedestrians.step(t, self._plant.coordinates, self._plant.v)
        self._measurement = self._plant.step(answer.command, self._dt)
        self._steps += 1
        self.time = self._steps * self._dt
        return answer

    def evaluate(self) -> Evaluation:
        """What the true motion so far came to."""
        rows, speeds = zip(*self._rows, strict=True)
        return evaluate((self._dt * np.arange(len(rows)), rows, speeds), self.robot, self.world)
