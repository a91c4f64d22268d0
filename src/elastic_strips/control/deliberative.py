"""Control room, deliberative layer: tasks become steps of navigation and manipulation.

The layer knows the map and the robot, and takes its time. The paths of its steps come from the motion planner, before
the robot sets out, and again where the layers below cannot go on.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Scene
from ..summary import Summary
from .reach import Reach
from .tasks import DriveAndReach, DriveTo, Task


class Part(str, Enum):
    """Which part of the robot a step is for; the strip moves the whole body in any case."""

    NAVIGATION = "navigation"
    MANIPULATION = "manipulation"
    WHOLE_BODY = "whole body"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Step(Summary):
    """One goal on the way to a task.

    Attributes:
        part: of the robot.
        q: (nq,) the goal.
        text: for people.
    """

    part: Part
    q: Array
    text: str

    def __str__(self) -> str:
        return f"{self.part.value}: {self.text}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Deliberation(Summary):
    """What the layer made of a task: its steps, none where it cannot be done, and why."""

    task: Task
    steps: tuple[Step, ...]
    reason: str


class DeliberativeLayer:
    """Workspace: divides tasks into steps; their paths are a :class:`~elastic_strips.control.Director`'s.

    Args:
        robot: the robot.
        seed: of all that is sampled.
        margin: distance that goals keep to obstacles [m].
    """

    def __init__(self, robot: RobotModel, *, seed: int = 0, margin: float = 0.03) -> None:
        self.robot = robot
        self._reach = Reach(robot, np.random.default_rng(seed), margin=margin)

    def divide(self, task: Task, q: npt.ArrayLike, scene: Scene) -> Deliberation:
        """Divide a task into steps that begin at a configuration.

        Args:
            task: what to do.
            q: (nq,) where the robot is.
            scene: what stands in the way of its goals.
        """
        robot = self.robot
        here = robot.check_q(q, what="q")
        if isinstance(task, DriveTo):
            step = Step(Part.NAVIGATION, self._driven(here, task), str(task))
            return Deliberation(task, (step,), "drive, the arm as it is")
        if isinstance(task, DriveAndReach):
            there = self._driven(here, task.drive)
            found = self._reach.with_arm(scene, there, task.reach)
            if found.q is None:
                return Deliberation(task, (), found.reason)
            return Deliberation(task, (Step(Part.WHOLE_BODY, found.q, str(task)),), found.reason)
        found = self._reach.with_arm(scene, here, task)
        if found.q is not None:
            return Deliberation(task, (Step(Part.MANIPULATION, found.q, str(task)),), f"from here; {found.reason}")
        found = self._reach.with_base(scene, here, task)
        if found.q is None:
            return Deliberation(task, (), found.reason)
        row = robot.space.to_chart(found.q)
        b = robot.space.base_nv
        before = robot.space.to_chart(here)
        before[:b] = row[:b]
        x, y, yaw = (float(value) for value in row[:3])
        drive = DriveTo(x, y, yaw)
        steps = (
            Step(Part.NAVIGATION, robot.space.from_chart(before[None])[0], str(drive)),
            Step(Part.MANIPULATION, found.q, str(task)),
        )
        return Deliberation(task, steps, f"the arm does not reach from here: {drive} first; {found.reason}")

    def _driven(self, q: Array, drive: DriveTo) -> Array:
        row = self.robot.space.to_chart(q)
        row[:3] = drive.x, drive.y, drive.yaw
        return self.robot.space.from_chart(row[None])[0]
