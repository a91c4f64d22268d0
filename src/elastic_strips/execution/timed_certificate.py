"""Execution room, certificate of a motion: proof that it keeps its clearance to what moves and what stands."""

from __future__ import annotations

import numpy as np

from ..proximity import BodySet, Forecast, MotionBounds, ObstacleProximity, SelfProximity
from ..robot import Kinematics, RobotModel
from ..scene import Scene
from ..tunnel import Certificate, Certifier
from .trajectory import Trajectory

_REACH = 0.1
"""Distances are exact below the clearance and this [m]; further off a bound is enough."""


class TrajectoryCertifier:
    """Workspace: certifies trajectories of one robot against snapshots and their forecasts.

    Args:
        robot: whose trajectories.
        clearance: distance [m] to keep from obstacles: at least the tracking error.
        self_clearance: distance [m] to keep between the robot's own links.
        settle_time: how long [s] the robot may take to come to rest after the end.
    """

    def __init__(
        self, robot: RobotModel, *, clearance: float, self_clearance: float = 1e-3, settle_time: float = 0.0
    ) -> None:
        self.robot, self.clearance, self.self_clearance = robot, clearance, self_clearance
        self.settle_time = settle_time
        bodies = BodySet.links(robot)
        bounds = MotionBounds(bodies)
        self._kin = Kinematics(robot.tree, 64)
        self._obstacles = ObstacleProximity(bodies, influence=clearance + _REACH, slack=0.6)
        self._self_pairs = SelfProximity(bodies, robot.self_pairs, bounds, influence=0.02)
        self._certifier = Certifier(bodies, bounds, self._obstacles, self._self_pairs)

    def certify(self, trajectory: Trajectory, scene: Scene, forecast: Forecast) -> Certificate:
        """Certify a trajectory, from its first sample until it has come to rest.

        Args:
            trajectory: ends at rest.
            scene: sensed at ``scene.time``, on the clock of ``trajectory.time``.
            forecast: of that scene; says for all its moving obstacles where they can be.
        """
        chart = np.vstack([trajectory.chart, trajectory.chart[-1:]])
        times = np.append(trajectory.time, trajectory.time[-1] + self.settle_time) - scene.time
        self._kin.update(chart)
        self._obstacles.update(self._kin, scene, forecast.ahead(times))
        self._self_pairs.update(self._kin)
        v = np.vstack([trajectory.steps, np.zeros((1, self.robot.nv))])
        return self._certifier.certify(
            self._kin, v, clearance=self.clearance, self_clearance=self.self_clearance, scene=scene
        )
