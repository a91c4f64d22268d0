"""Sensor perception: scenes from a robot's simulated range sensors, and a contact sensor."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.collision import BodySet, ObstacleProximity
from elastic_strips.control.estimation import PoseBuffer
from elastic_strips.control.params import CAMERA_EASE, LASER_ASSUMPTIONS, LASER_EASE, DriveParams, seen_turn_speed
from elastic_strips.perception import (
    DepthImage,
    LaserScan,
    RangeImage,
    Reading,
    SceneEstimator,
    SceneEstimatorParams,
    VolumeMapParams,
)
from elastic_strips.perception.body_mask import BodyMask
from elastic_strips.perception.gaze import Gaze
from elastic_strips.robot import Kinematics, PlanarFootprint, RobotModel
from elastic_strips.scene import Scene, World

from .computing import Computing
from .perception import PerceptionError, PerceptionParams
from .sensors import SensorConfig, SensorSuite
from .sensors.params import DepthParams, LaserParams, LidarParams, RingParams

_CONTACT_REACH = 0.02  # [m] larger distances are not measured


class ContactSensor:
    """Workspace: finds the obstacle that a robot touches.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._kin = Kinematics(robot.tree, 1)
        self._obstacles = ObstacleProximity(BodySet.links(robot), influence=_CONTACT_REACH)

    def touched(self, scene: Scene, coordinates: Array) -> str:
        """The obstacle that is touched at a coordinate row (nv,), or ""."""
        self._kin.update(coordinates[None], jacobians=False)
        self._obstacles.update(self._kin, scene)
        exact = self._obstacles.exact
        if exact.size == 0 or exact.min() > 0.0:
            return ""
        part = int(np.unravel_index(int(exact.argmin()), exact.shape)[2])
        return self._obstacles.obstacle_name(part)


_REAR = math.radians(120.0)  # azimuth beyond which is behind the robot
_REAR_PARTS, _REAR_SEEN = 20, 0.8
"""Parts of the directions there, and the share of them into which something has to look."""


def sees_behind(robot: RobotModel, sensors: SensorConfig) -> bool:
    """Whether sensors look behind a robot: a ring, or lasers and 3-D lidars together, from which the robot's own
    bodies, as they are at home, hide little there."""
    if any(isinstance(sensor, RingParams) for sensor in sensors.sensors):
        return True
    turning = tuple(s for s in sensors.sensors if isinstance(s, (LaserParams, LidarParams)))
    if not turning:
        return False
    suite, mask = SensorSuite(robot.seeing, World(Scene([])), SensorConfig(sensors=turning)), BodyMask(robot.seeing)
    row = robot.seeing.space.to_coordinates(robot.seeing.home())
    first: dict[str, Reading] = {}
    for k in range(round(max(s.latency + 1.0 / s.rate for s in turning) / _STANDING_UPDATE_PERIOD) + 2):
        first |= {reading.sensor: reading for reading in suite.observe(k * _STANDING_UPDATE_PERIOD, row)}
    looks = np.zeros(_REAR_PARTS, dtype=bool)
    for reading in first.values():
        if isinstance(reading, RangeImage):
            angles = np.linspace(*reading.azimuth, reading.ranges.shape[1])
            free: Mask = np.asarray(np.isinf(mask.apart(reading)[1]).any(axis=0))
        elif isinstance(reading, LaserScan):
            angles, free = reading.angles, ~np.isnan(reading.ranges)
        else:
            continue
        turned = math.atan2(reading.T_base_sensor[1, 0], reading.T_base_sensor[0, 0])
        behind = (turned + angles - _REAR) % (2.0 * math.pi)  # from the left round to the right
        part = np.floor(behind / (2.0 * (math.pi - _REAR)) * _REAR_PARTS).astype(int)
        looks[part[free & (part < _REAR_PARTS)]] = True
    return bool(looks.mean() >= _REAR_SEEN)


def sensing_params(
    params: DriveParams, robot: RobotModel, sensors: SensorConfig, *, moving: bool = True
) -> DriveParams:
    """Parameters of a drive for what a robot's sensors see: how right tracks are, how old a scene may be, and how fast
    the robot drives and turns.

    Args:
        params: the others.
        robot: the robot.
        sensors: its sensors.
        moving: whether anything may move; else what is behind the robot is as it was seen before.
    """
    behind = not moving or sees_behind(robot, sensors)
    camera = any(isinstance(sensor, DepthParams) for sensor in sensors.sensors)
    return replace(
        params,
        assumptions=LASER_ASSUMPTIONS,
        speed_scale=CAMERA_EASE if camera else LASER_EASE,
        backward=behind,
        turn_speed=seen_turn_speed(behind=behind, arm=robot.nv > robot.space.base_nv),
        max_scene_age=max(params.max_scene_age, sensors.oldest + params.plan_every * params.control_dt),
    )


_LASER_PLANE_HEIGHT = 0.3
"""Pieces that reach below this height [m] are in the plane of a base's laser."""
_STANDING_UPDATE_PERIOD = 0.01  # [s] between sensor updates while the robot stands at its start
_HEAD_SPEED = 1.5  # [rad/s] at most, of joints that look
_GLANCE_PERIOD = 0.1  # [s] between choices of where to look
LOOK_AHEAD = 5.0  # [s] of the way that is looked at
_LOOK, _LOOK_ABOUT = 1.5, 8.0
"""Time [s] of reading before the first step, and that of a robot that looks about."""
_BLIND = 0.5  # part of an image's pixels that say nothing where it is not believed for that
_CONTACT_PERIOD = 0.05  # [s] between queries of the contact sensor


class SensorPerception:
    """Workspace: simulated sensors, and the scene that is estimated from their readings.

    Before the first step the sensors read from the start for a while.

    Args:
        robot: the robot with the sensors' frames.
        world: the world that the sensors see.
        start: configuration (nq,).
        sensors: their parameters.
        params: parameters of the scene; defaults with the robot's `body_radius` where None.
        seed: seed of the sensors' noise.
        look: time of reading before the first step [s]; more where None and joints look.
        bumper: whether the robot has a contact sensor.
        computing: cost of processing readings.
        volume: parameters of the layer of images; where joints look, what was not seen is blocked unless these say
            otherwise.

    Attributes:
        suite: the sensors.
        gaze: chooses where the first depth camera looks, where joints look; else None.
        head: (L,) values of these joints [rad or m].
        estimator: estimates the scene.
        params: the sensors' delay, for figures that depend on it.
        computing: the cost; it may be replaced.
        newest: sensor → its newest reading, and the base's estimated pose then.
        sensed: the newest scene; None before the first.
        cost: simulated time [s] that processing took for the last scene: that of its readings since the scene before is
            included, that of simulating the sensors is not.
        looked_at: sensor → how many of its readings were looked at so far.

    Raises:
        RobotError: the robot lacks a frame of a sensor.
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
        look: float | None = None,
        bumper: bool = True,
        computing: Computing | None = None,
        volume: VolumeMapParams | None = None,
    ) -> None:
        if look is None:
            look = _LOOK_ABOUT if robot.looking else _LOOK
        self._world, self._contact_sensor = world, ContactSensor(robot) if bumper else None
        self._looked, self._touched = -np.inf, ""
        self._robot = robot
        self.gaze: Gaze | None = None
        self.suite: SensorSuite = SensorSuite(robot.seeing, world, sensors, seed=seed, time=-look)
        camera = next((s for s in self.suite.config.sensors if isinstance(s, DepthParams)), None)
        self._camera = "" if camera is None else camera.name
        if robot.looking and camera is not None:
            wide = camera.field_of_view
            high = 2.0 * math.atan(math.tan(0.5 * wide) * camera.rows / camera.columns)
            self.gaze = Gaze(
                robot, camera.frame, camera.T_frame_camera, (wide, high), (camera.range_min, min(camera.range_max, 3.5))
            )
            volume = volume or VolumeMapParams(unseen="blocked")
        self.head: Array = np.array([robot.locked[name] for name in robot.looking])
        self._ahead: Callable[[float], Array] | None = None
        self._observed = self._glanced = -look
        blocked = volume is not None and volume.unseen == "blocked"
        if params is None:
            params = SceneEstimatorParams(body_radius=body_radius(robot))
            if blocked:  # what a scan meets is no higher than what the camera then sees, or does not see
                params = replace(params, height=_LASER_PLANE_HEIGHT + 0.1)
        required = self.suite.config.required or None
        self.estimator: SceneEstimator = SceneEstimator(params, robot=robot.seeing, volume=volume, required=required)
        latency = max(sensor.latency + 1.0 / sensor.rate for sensor in self.suite.config.sensors)
        self.params: PerceptionParams = PerceptionParams(delay=latency)
        coordinates = robot.space.to_coordinates(robot.check_q(start, what="start"))
        self.computing: Computing = computing or Computing()
        self.newest: dict[str, tuple[Reading, Array]] = {}
        self.sensed: Scene | None = None
        self.cost: float = 0.0
        self.looked_at: Counter[str] = Counter()
        self._come: list[tuple[Reading, Array]] = []  # not looked at yet, with the base's pose
        self._spent = 0.0  # [s] since the last scene
        self._past = PoseBuffer()
        for k in range(round(look / _STANDING_UPDATE_PERIOD)):
            self.observe(-look + k * _STANDING_UPDATE_PERIOD, coordinates, coordinates)

    @property
    def contact(self) -> str:
        """Description of a felt contact; empty without one."""
        return "the bumper is pressed" if self._touched else ""

    @property
    def sensors(self) -> SensorConfig:
        """The sensors' parameters."""
        return self.suite.config

    @property
    def target(self) -> Array | None:
        """What a camera is turned to, (3,) [m]; None where none turns."""
        return None if self.gaze is None else self.gaze.target

    def known(self) -> Scene:
        """The scene that was sensed from the start."""
        return self.sense(0.0)

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Add the readings that are available at time ``t`` [s] to the scene; see :meth:`Perception.observe`."""
        self.measure(t, coordinates, estimate)
        self.work(t, estimate)

    def measure(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Let the sensors measure, as :meth:`observe`, but leave their readings for :meth:`work`."""
        self._past.add(t, estimate)
        if self._contact_sensor is not None and t - self._looked >= _CONTACT_PERIOD - 1e-9:
            self._looked, self._touched = t, self._contact_sensor.touched(self._world.at(t), coordinates)
        if self.gaze is not None:
            most = np.minimum(self.gaze.speed, _HEAD_SPEED) * max(t - self._observed, 0.0)
            self.head = self.head + np.clip(self.gaze.wanted - self.head, -most, most)
        self._observed = t
        looks = self._robot.looking
        readings = self.suite.observe(t, self._robot.seeing_row(coordinates, self.head) if looks else coordinates)
        self._come.extend((reading, self._past.at(reading.time)) for reading in readings)

    def work(self, t: float, estimate: Array, *, newest: bool = False) -> bool:
        """Choose where to look, at time ``t`` [s], and look at the readings that have come since, or at the newest of
        each sensor alone.

        Returns:
            Whether there were any.
        """
        began = self.computing.reading()
        if self.gaze is not None and t - self._glanced >= _GLANCE_PERIOD - 1e-9 and self.estimator.volume is not None:
            self._glanced = t
            ahead = np.zeros((0, self._robot.nv)) if self._ahead is None else self._ahead(LOOK_AHEAD)
            self.gaze.look(t, estimate, ahead, self.head, self.estimator.volume)
        come, self._come = self._come, []
        last = {reading.sensor: reading for reading, _ in come}
        for reading, pose in come:
            if newest and last[reading.sensor] is not reading:
                continue
            self.looked_at[reading.sensor] += 1
            self.estimator.update(reading, pose)
            self._mind(t, reading)
            self.newest[reading.sensor] = reading, pose
        self._spent += self.computing.reading() - began
        return bool(come)

    def _mind(self, t: float, reading: Reading) -> None:
        """Tell the gaze whether the image of its camera shows anything."""
        if self.gaze is None or not isinstance(reading, DepthImage) or reading.q is None:
            return
        report = self.estimator.watched.get(reading.sensor)
        if reading.sensor == self._camera and report is not None and (not report.reason or report.unanswered > _BLIND):
            self.gaze.note(t, reading.q, blind=bool(report.reason))

    def attend(self, ahead: Callable[[float], Array]) -> None:
        """Be told what gives the coordinate rows (K, nv) that the robot comes through in so many seconds, the next one
        first, such as :meth:`.Controller.ahead`: there the camera looks."""
        self._ahead = ahead

    def sense(self, t: float) -> Scene:
        """The newest scene.

        Raises:
            PerceptionError: there is no reading yet.
        """
        if not self.estimator.times:
            raise PerceptionError(f"none of the sensors {', '.join(self.suite.config.names)} has read anything yet")
        began = self.computing.reading()
        self.sensed = scene = self.estimator.scene()
        self.cost, self._spent = self._spent + self.computing.reading() - began, 0.0
        return scene


def body_radius(robot: RobotModel) -> float:
    """Radius [m] of the largest disc about the base's origin within the robot at the height of a base's laser."""
    return PlanarFootprint.of(robot, robot.home()).inner_below(_LASER_PLANE_HEIGHT)
