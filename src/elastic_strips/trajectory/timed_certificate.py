"""Certificate of a motion: proof that it keeps its clearance to what moves and what stands."""

from __future__ import annotations

import numpy as np

from ..errors import ParameterError
from ..proximity import BodySet, Forecast, MotionBounds
from ..robot import RobotModel
from ..scene import Scene
from ..tunnel import Certificate, MotionCertifier
from .trajectory import Trajectory


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
        self._certifier = MotionCertifier(bodies, MotionBounds(bodies), robot.self_pairs)

    def reset(self) -> None:
        """Forget the obstacles; for after an exception."""
        self._certifier.reset()

    def certify(self, trajectory: Trajectory, scene: Scene, forecast: Forecast) -> Certificate:
        """Certify a trajectory, from its first sample until it has come to rest.

        Args:
            trajectory: ends at rest.
            scene: sensed at ``scene.time``, on the clock of ``trajectory.time``.
            forecast: of that scene; says for all its moving obstacles where they can be.

        Raises:
            ParameterError: the forecast's horizon is shorter than the motion.
        """
        chart = np.vstack([trajectory.chart, trajectory.chart[-1:]])
        times = np.append(trajectory.time, trajectory.time[-1] + self.settle_time) - scene.time
        if len(forecast) and times[-1] > forecast.horizon:
            raise ParameterError(
                f"the motion ends {times[-1]:.2f} s after the snapshot, beyond the forecast's {forecast.horizon:g} s"
            )
        v = np.vstack([trajectory.steps, np.zeros((1, self.robot.nv))])
        return self._certifier.certify(
            chart, v, scene, forecast.ahead(times), clearance=self.clearance, self_clearance=self.self_clearance
        )
