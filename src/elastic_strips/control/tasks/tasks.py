"""Tasks of a robot, and the deliberative layer, which decomposes them into steps with goals.

The layer has the map and the robot, and no deadline. The paths of its steps come from the motion planner, before the
first step and again where the layers below cannot go on.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.planning import GoalSearch, HandPose, find_goals
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import DeformParams
from elastic_strips.summary import Summary
from elastic_strips.validation import Checked, Finite, check_array, check_fields


@dataclass(frozen=True, slots=True)
class DriveTo(Checked):
    """Drive the base to a pose, with the arm as it is.

    Attributes:
        x, y: place of the base in the world [m].
        yaw: its heading in the world [rad].
    """

    x: Finite
    y: Finite
    yaw: Finite

    def __str__(self) -> str:
        return f"drive to ({self.x:g}, {self.y:g}) m, {self.yaw:g} rad"


@dataclass(frozen=True, slots=True)
class ReachHand:
    """Bring a frame of the robot to a pose; the base moves where the arm alone does not reach.

    Attributes:
        position: (x, y, z) position in the world [m].
        quaternion: (x, y, z, w) orientation of the frame in the world; None leaves it free.
        frame: frame of the robot.
    """

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None = None
    frame: str = "hand_frame"

    def __post_init__(self) -> None:
        check_fields(self)
        check_array("ReachHand.position", self.position, (3,))
        if self.quaternion is None:
            return
        if not 0.99 < np.linalg.norm(check_array("ReachHand.quaternion", self.quaternion, (4,))) < 1.01:
            raise ParameterError(f"ReachHand.quaternion={self.quaternion!r} must have unit length")

    def __str__(self) -> str:
        turned = "" if self.quaternion is None else " turned as asked"
        return f"reach ({', '.join(f'{v:g}' for v in self.position)}) m with {self.frame!r}{turned}"


@dataclass(frozen=True, slots=True)
class DriveAndReach(Checked):
    """Bring the base to a pose and the hand to another one: one goal for the whole body."""

    drive: DriveTo
    reach: ReachHand

    def __str__(self) -> str:
        return f"{self.drive} and {self.reach}"


Task = DriveTo | ReachHand | DriveAndReach


_MOST_GOALS = 24  # configurations that reach, of which one is wanted that the base can drive to as it is


class StepKind(str, Enum):
    """Purpose of a step; the strip moves the whole body in any case."""

    NAVIGATION = "navigation"
    MANIPULATION = "manipulation"
    WHOLE_BODY = "whole body"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TaskStep(Summary):
    """A step of a task.

    Attributes:
        kind: its purpose.
        q: (nq,) its goal.
        text: description.
    """

    kind: StepKind
    q: Array
    text: str

    def __str__(self) -> str:
        return f"{self.kind.value}: {self.text}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TaskPlan(Summary):
    """Steps of a task, or no steps where it cannot be done, and the reason."""

    task: Task
    steps: tuple[TaskStep, ...]
    reason: str


class DeliberativeLayer:
    """Workspace: decomposes tasks into steps; their paths come from a :class:`PathService`.

    Args:
        robot: the robot.
        seed: seed of the search for goals.
        margin: distance that goals keep to obstacles [m].
    """

    def __init__(self, robot: RobotModel, *, seed: int = 0, margin: float = 0.03) -> None:
        self.robot = robot
        self.seed = seed
        self._params = DeformParams(clearance=margin)

    def decompose(self, task: Task, q: npt.ArrayLike, scene: Scene) -> TaskPlan:
        """Decompose a task into steps.

        Args:
            task: the task to do.
            q: (nq,) present configuration.
            scene: static obstacles.

        Returns:
            The plan; without steps where no goal is found.
        """
        robot = self.robot
        here: Array = robot.check_q(q, what="q")
        if isinstance(task, DriveTo):
            step = TaskStep(StepKind.NAVIGATION, self._driven(here, task), str(task))
            return TaskPlan(task, (step,), "drive, the arm as it is")
        if isinstance(task, DriveAndReach):
            there = self._driven(here, task.drive)
            found = self._reaching(scene, there, task.reach, base=False)
            if len(found.configurations) == 0:
                return TaskPlan(task, (), found.reason)
            step = TaskStep(StepKind.WHOLE_BODY, found.configurations[0], str(task))
            return TaskPlan(task, (step,), found.reason)
        found = self._reaching(scene, here, task, base=True)
        if len(found.configurations) == 0:
            return TaskPlan(task, (), found.reason)
        space = robot.space
        near = space.to_coordinates(here)
        b = space.base_nv
        rows = space.to_coordinates(found.configurations)
        for there in found.configurations:
            if not space.planar or np.array_equal(there[:4], here[:4]):
                step = TaskStep(StepKind.MANIPULATION, there, str(task))
                return TaskPlan(task, (step,), f"from here; {found.reason}")
        free = ValidityChecker(robot, scene, margin=self._params.clearance)
        for there, row in zip(found.configurations, rows, strict=True):
            before = space.from_coordinates(np.concatenate((row[:b], near[b:])))
            if not free(before):
                continue
            x, y, yaw = (float(value) for value in row[:3])
            drive = DriveTo(x, y, yaw)
            steps = (
                TaskStep(StepKind.NAVIGATION, before, str(drive)),
                TaskStep(StepKind.MANIPULATION, there, str(task)),
            )
            return TaskPlan(task, steps, f"the arm does not reach from here: {drive} first; {found.reason}")
        return TaskPlan(task, (), f"{task}: where the arm reaches it, the base cannot stand with the arm as it is")

    def _reaching(self, scene: Scene, q: Array, task: ReachHand, *, base: bool) -> GoalSearch:
        goal = HandPose(task.frame, task.position, task.quaternion)
        return find_goals(self.robot, scene, q, goal, count=_MOST_GOALS, seed=self.seed, params=self._params, base=base)

    def _driven(self, q: Array, drive: DriveTo) -> Array:
        row = self.robot.space.to_coordinates(q)
        row[:3] = drive.x, drive.y, drive.yaw
        return self.robot.space.from_coordinates(row)
