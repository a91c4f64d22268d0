"""IO room, drive problems: a world, a start and goals, as the loaders of benchmark files give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.io.scenario_file import PoseSpec
from elastic_strips.robot import RobotModel
from elastic_strips.scene import World
from elastic_strips.summary import Summary

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriveProblem(Summary):
    """Drive from a start to one goal after another.

    Attributes:
        name: What it is called.
        world: Obstacles, and how they move.
        start: Where the robot starts.
        goals: Where it has to go, in this order.
        goal_tolerance: How far [m] from a goal's position the base may be when it counts as reached.
        heading_free: Whether a goal is reached with any heading; its yaw is then a suggestion.
        timeout: Longest time [s], or None.
        robot: Name of the robot that the problem is about.
        path: A path (K, 2) [m] from start to goal that comes with the problem, or None.
        path_length: Length [m] by which the problem measures time, or None.
        difficulty: The problem's own class, or None.
        limits: What the problem states of the robot's limits and the robot's description cannot hold, by the names of
            the arguments of ``MotionLimits.for_robot``.
    """

    name: str
    world: World
    start: PoseSpec
    goals: tuple[PoseSpec, ...]
    goal_tolerance: float
    heading_free: bool
    timeout: float | None
    robot: str
    path: Array | None = None
    path_length: float | None = None
    difficulty: str | None = None
    limits: Mapping[str, Any] = field(default_factory=dict)

    def configurations(self, robot: RobotModel) -> tuple[Array, ...]:
        """Start and goals as configurations (nq,) of a robot, the start first.

        Raises:
            ConfigurationError: A joint that the robot has not, or a value outside its limits.
        """
        return tuple(robot.home(p.x, p.y, p.yaw, p.joints) for p in (self.start, *self.goals))
