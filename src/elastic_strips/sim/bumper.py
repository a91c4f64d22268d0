"""Sim room, bumper: whether a robot touches something, where it truly is."""

from __future__ import annotations

import numpy as np

from ..proximity import BodySet, ObstacleProximity
from ..robot import Kinematics, RobotModel
from ..robot.space import Array
from ..scene import Scene

_NEAR = 0.02  # [m] what is further off is not measured


class Bumper:
    """Workspace: what a robot touches.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._kin = Kinematics(robot.tree, 1)
        self._obstacles = ObstacleProximity(BodySet.links(robot), influence=_NEAR)

    def touched(self, scene: Scene, chart: Array) -> str:
        """The obstacle that is touched at a chart row (nv,), or ""."""
        self._kin.update(chart[None], jacobians=False)
        self._obstacles.update(self._kin, scene)
        exact = self._obstacles.exact
        if exact.size == 0 or exact.min() > 0.0:
            return ""
        part = int(np.unravel_index(int(exact.argmin()), exact.shape)[2])
        return self._obstacles.obstacle_name(part)
