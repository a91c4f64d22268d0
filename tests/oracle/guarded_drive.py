"""A guard and a simulated machine, step by step, with somebody's commands; what happened is kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import Desired, Guard, GuardedCommand, GuardOutcome, GuardParams
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Obstacle, Scene, World
from elastic_strips.sim import KinematicPlant
from elastic_strips.sim.closed_loop import MACHINE
from elastic_strips.sim.evaluation import Evaluation, evaluate
from elastic_strips.trajectory import Trajectory

DT = 0.01
WALL = Box((0.2, 40.0, 1.5), at=(1.6, 5.0, 0.75), name="wall")
FAR = Box((0.2, 2.0, 1.0), at=(30.0, 0.0, 0.5), name="far")


class GuardedDrive:
    """Workspace: a guard, a plant, and a world of obstacles."""

    def __init__(
        self,
        robot: RobotModel,
        world: World | list[Obstacle],
        start: Array | None = None,
        params: GuardParams | None = None,
        guard: Guard | None = None,
        seed: int = 1,
    ) -> None:
        self.world = world if isinstance(world, World) else World(Scene(world))
        self.guard = guard or Guard(robot, params=params, start=start)
        self.plant = KinematicPlant(robot, self.guard.limits, MACHINE, seed=seed)
        self.plant.reset(robot.space.to_coordinates(robot.home_q if start is None else start))
        self.measurement: Measurement | None = None
        self.k = 0
        self.answers: list[GuardedCommand] = []
        self.motions: list[Trajectory] = []
        self.rows: list[Array] = []
        self.speeds: list[Array] = []

    def see(self, t: float) -> Scene:
        """The scene as it is at time ``t`` [s]."""
        return Scene(list(self.world.at(t)), time=t)

    def note(self, command: Command) -> None:
        """Drive a command for a period."""
        self.rows.append(self.plant.coordinates)
        self.speeds.append(self.plant.v)
        self.measurement = self.plant.step(command, DT)
        self.k += 1

    def step(self, desired: Desired | None, *, sees: bool = True) -> GuardedCommand:
        """A period; every fifth one has a new scene, if it sees any."""
        t = self.k * DT
        seen = self.see(t) if sees and self.k % 5 == 0 else None
        answer = self.guard.step(t, self.measurement, seen, desired)
        self.answers.append(answer)
        self.motions.append(self.guard.executor.active)
        self.note(answer.command)
        return answer

    def run(
        self, seconds: float, desired: Desired | Callable[[float], Desired | None] | None, *, sees: bool = True
    ) -> GuardedDrive:
        """Some time [s] of a command, or of what a pilot says at each time."""
        for _ in range(round(seconds / DT)):
            self.step(desired(self.k * DT) if callable(desired) else desired, sees=sees)
        return self

    def evaluated(self) -> Evaluation:
        """What the true states say."""
        time = DT * np.arange(len(self.rows))
        return evaluate((time, np.array(self.rows), np.array(self.speeds)), self.guard.robot, self.world)

    def outcomes(self) -> set[GuardOutcome]:
        """All outcomes so far."""
        return {answer.outcome for answer in self.answers}

    def faults(self) -> list[str]:
        """What the executor complained of."""
        return [event.reason for event in self.guard.executor.run.events if event.kind == "fault"]
