"""Control room, sensed perception: the scene that a robot's own range sensors show, in place of the true one."""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt

from ..execution import PerceptionParams
from ..execution.params import ObstacleAssumptions
from ..execution.perception import PerceptionError
from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Scene, World
from ..sensing import SceneEstimator, SceneEstimatorParams, SensorConfig, SensorSuite

LASER_ASSUMPTIONS = ObstacleAssumptions(position_error=0.04, velocity_error=0.2)
"""What tracks of a laser at 20 Hz are taken to be wrong by at most; tests compare it with what they are wrong by."""
_STEP = 0.01  # [s] between looks while the robot stands at its start
_KEPT = 200  # estimates that are kept, so that a reading finds the pose that it was taken at


class SensedPerception:
    """Workspace: simulated sensors, and a scene of what they have seen.

    Before the robot sets out it stands at its start for a while and looks about.

    Args:
        robot: with the sensors' frames.
        world: that the sensors see.
        start: configuration (nq,).
        sensors: what they are like.
        params: of the scene.
        seed: of the sensors' noise.
        look: how long the robot looks about first [s].

    Attributes:
        suite, estimator: the sensors, and what becomes of their readings.
        params: the sensors' delay, for figures that depend on it.

    Raises:
        RobotError: the robot has not the frames that the sensors sit on.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World,
        start: npt.ArrayLike,
        *,
        sensors: SensorConfig | None = None,
        params: SceneEstimatorParams | None = None,
        seed: int | np.random.Generator = 0,
        look: float = 1.5,
    ) -> None:
        self.suite = SensorSuite(robot, world, sensors, seed=seed, time=-look)
        self.estimator = SceneEstimator(params)
        latency = max(sensor.latency + 1.0 / sensor.rate for sensor in self.suite.config.sensors)
        self.params = PerceptionParams(delay=latency)
        chart = robot.space.to_chart(robot.check_q(start, what="start"))
        self._past: deque[tuple[float, Array]] = deque(maxlen=_KEPT)
        for k in range(round(look / _STEP)):
            self.observe(-look + k * _STEP, chart, chart)

    def known(self) -> Scene:
        """What was seen from the start."""
        return self.sense(0.0)

    def observe(self, t: float, chart: Array, estimate: Array) -> None:
        """Take the readings that have come by the time ``t`` [s] into the scene."""
        self._past.append((t, np.array(estimate[:3])))
        for reading in self.suite.observe(t, chart):
            pose = min(self._past, key=lambda entry: abs(entry[0] - reading.time))[1]
            self.estimator.update(reading, pose)

    def sense(self, t: float) -> Scene:
        """The newest scene.

        Raises:
            PerceptionError: no reading has come yet.
        """
        if not self.estimator.times:
            raise PerceptionError(f"none of the sensors {', '.join(self.suite.names)} has read anything yet")
        return self.estimator.scene()
