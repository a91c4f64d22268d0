"""The scene that a robot's own range sensors show, and whether it touches something."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.collision import BodySet, ObstacleProximity
from elastic_strips.control import ObstacleAssumptions
from elastic_strips.control.estimation import PoseBuffer
from elastic_strips.perception import SceneEstimator, SceneEstimatorParams
from elastic_strips.robot import Kinematics, PlanarFootprint, RobotModel
from elastic_strips.scene import Scene, World

from .perception import PerceptionError, PerceptionParams
from .sensors import SensorConfig, SensorSuite

_NEAR = 0.02  # [m] what is further off is not measured


class ContactSensor:
    """Workspace: what a robot touches.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._kin = Kinematics(robot.tree, 1)
        self._obstacles = ObstacleProximity(BodySet.links(robot), influence=_NEAR)

    def touched(self, scene: Scene, coordinates: Array) -> str:
        """The obstacle that is touched at a coordinate row (nv,), or ""."""
        self._kin.update(coordinates[None], jacobians=False)
        self._obstacles.update(self._kin, scene)
        exact = self._obstacles.exact
        if exact.size == 0 or exact.min() > 0.0:
            return ""
        part = int(np.unravel_index(int(exact.argmin()), exact.shape)[2])
        return self._obstacles.obstacle_name(part)


LASER_ASSUMPTIONS = ObstacleAssumptions(position_error=0.04, velocity_error=0.2)
"""What tracks of a laser at 20 Hz are taken to be wrong by at most; tests compare it with what they are wrong by."""
LASER_EASE = 0.6
"""Share of its speeds that a robot drives with that sees by a laser alone: what comes out from behind something is
known to move only some tenths of a second later, and the robot has to stand by the time it is there."""
_LOW = 0.3
"""A piece that reaches lower than this [m] is where a laser of a base looks."""
_STEP = 0.01  # [s] between looks while the robot stands at its start
_FEEL = 0.05  # [s] between questions to the bumper


class SensorPerception:
    """Workspace: simulated sensors, and a scene of what they have seen.

    Before the robot sets out it stands at its start for a while and looks about.

    Args:
        robot: with the sensors' frames.
        world: that the sensors see.
        start: configuration (nq,).
        sensors: what they are like.
        params: of the scene; defaults with the robot's `body_radius` where None.
        seed: of the sensors' noise.
        look: how long the robot looks about first [s].
        bumper: whether the robot feels what it touches; while it does, it stands, and no reading counts: what runs
            into a standing robot covers its laser.

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
        start: ArrayLike,
        *,
        sensors: SensorConfig | None = None,
        params: SceneEstimatorParams | None = None,
        seed: int | np.random.Generator = 0,
        look: float = 1.5,
        bumper: bool = True,
    ) -> None:
        self._world, self._contact_sensor = world, ContactSensor(robot) if bumper else None
        self._looked, self._touched = -np.inf, ""
        self.suite: SensorSuite = SensorSuite(robot, world, sensors, seed=seed, time=-look)
        if params is None:
            params = SceneEstimatorParams(body_radius=body_radius(robot))
        self.estimator: SceneEstimator = SceneEstimator(params)
        latency = max(sensor.latency + 1.0 / sensor.rate for sensor in self.suite.config.sensors)
        self.params: PerceptionParams = PerceptionParams(delay=latency)
        coordinates = robot.space.to_coordinates(robot.check_q(start, what="start"))
        self._past = PoseBuffer()
        for k in range(round(look / _STEP)):
            self.observe(-look + k * _STEP, coordinates, coordinates)

    @property
    def contact(self) -> str:
        """What the robot feels."""
        return "the bumper is pressed" if self._touched else ""

    def known(self) -> Scene:
        """What was seen from the start."""
        return self.sense(0.0)

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Take the readings that have come by the time ``t`` [s] into the scene."""
        self._past.add(t, estimate)
        if self._contact_sensor is not None and t - self._looked >= _FEEL - 1e-9:
            self._looked, self._touched = t, self._contact_sensor.touched(self._world.at(t), coordinates)
        readings = self.suite.observe(t, coordinates)
        if self._touched:  # what covers the sensors would stay in the map where they cannot see
            return
        for reading in readings:
            self.estimator.update(reading, self._past.at(reading.time))

    def sense(self, t: float) -> Scene:
        """The newest scene.

        Raises:
            PerceptionError: no reading has come yet.
        """
        if not self.estimator.times:
            raise PerceptionError(f"none of the sensors {', '.join(self.suite.config.names)} has read anything yet")
        return self.estimator.scene()


def body_radius(robot: RobotModel) -> float:
    """Radius of the largest disc about the base's origin that the robot fills where a laser of its base looks [m]."""
    return PlanarFootprint.of(robot, robot.home()).inner_below(_LOW)
