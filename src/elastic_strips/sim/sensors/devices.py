"""Range sensors of a robot in a world: laser, sonars and infrared sensors, and all of them at their rates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Image
from elastic_strips.errors import ParameterError, RobotError, SceneError
from elastic_strips.perception.own_body import Posture, SelfFilter, SensorMount
from elastic_strips.perception.rays import Rays
from elastic_strips.perception.readings import (
    NO_ANSWER,
    NOTHING,
    DepthImage,
    LaserScan,
    RangeImage,
    RangeRing,
    Reading,
    camera_directions,
    turning_directions,
)
from elastic_strips.robot import RobotModel
from elastic_strips.scene import World
from elastic_strips.validation import check_count, check_number, check_type

from .obstacle_rays import ObstacleRays
from .params import DepthParams, ImageParams, LaserParams, LidarParams, RangeParams, RingParams, SensorConfig

_NOISE_CUT = 3.0
"""Noise is cut off at this many standard deviations."""


def noisy_ranges(distance: Array, params: RangeParams, rng: np.random.Generator) -> Array:
    """Ranges (R,) [m] that a device reports.

    As many random numbers are drawn whatever the distances are, so that one range does not change the noise of another.

    Args:
        distance: (R,) true ranges [m]; infinite without a hit, NaN where unknown.
        params: parameters of the device.
        rng: source of noise and dropouts.

    Returns:
        ``NOTHING`` beyond the longest range, ``NO_ANSWER`` where the range is lost or unknown; else within
        ``range_min`` and ``range_max``.
    """
    white = np.clip(rng.standard_normal(distance.shape), -_NOISE_CUT, _NOISE_CUT)
    lost = rng.random(distance.shape) < params.dropout
    there = np.where(np.isfinite(distance), distance, 0.0)
    ranges = np.clip(there + (params.noise + params.noise_ratio * there) * white, params.range_min, params.range_max)
    near = distance < params.range_min
    ranges[near] = params.range_min if params.near_reads_min else NO_ANSWER
    ranges[distance > params.range_max] = NOTHING
    ranges[lost | np.isnan(distance)] = NO_ANSWER
    return ranges


def noisy_image(distance: Array, depth: Array, params: ImageParams, bias: float, rng: np.random.Generator) -> Image:
    """Depths or ranges (H, W) [m] that a camera or a lidar reports.

    Args:
        distance: (H, W) true depths or ranges [m]; infinite without a hit, NaN where nothing comes back.
        depth: (H, W) true ranges along the rays [m], by which edges are found.
        params: parameters of the device.
        bias: part of the largest common error, −1 to 1.
        rng: source of noise and dropouts.
    """
    white = np.clip(rng.standard_normal(distance.shape), -_NOISE_CUT, _NOISE_CUT)
    luck = rng.random(distance.shape)
    there = np.where(np.isfinite(distance), distance, 0.0)
    sigma = params.noise + params.noise_ratio * there + params.noise_growth * there * there
    ranges = there + sigma * white + bias * (params.bias + params.bias_ratio * there)
    edge = np.zeros(distance.shape, dtype=bool)
    far = np.where(np.isnan(depth), np.inf, np.minimum(depth, 10.0 * params.range_max))
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            jump = np.abs(np.diff(far, axis=axis)) > params.edge_step
        for side in (slice(1, None), slice(None, -1)):
            edge[(side, slice(None)) if axis == 0 else (slice(None), side)] |= jump
    lost = luck < np.where(edge, params.edge_dropout, params.dropout)
    ranges[distance < params.range_min] = params.range_min if params.near_reads_min else NO_ANSWER
    ranges[distance > params.range_max] = NOTHING
    ranges[lost | np.isnan(distance)] = NO_ANSWER
    return ranges.astype(np.float32)


class _Imager:
    """Workspace: what depth cameras and lidars do alike: rays that meet the world, the floor and the robot itself.

    Unlike a planar laser, they report the robot's own body where it is nearest: what they carry it in has to know it.
    """

    def __init__(
        self,
        params: ImageParams,
        posture: Posture,
        obstacles: ObstacleRays,
        rng: np.random.Generator,
        T_frame_sensor: Array,
        directions: Array,
    ) -> None:
        self.params: ImageParams = params
        self._posture, self._obstacles, self._rng = posture, obstacles, rng
        self._mount = SensorMount(posture, (params.frame,), T_frame_sensor)
        self._shape = directions.shape[:2]
        self._stretch = np.linalg.norm(directions, axis=-1)  # from the depth to the range
        unit = (directions / self._stretch[..., None]).reshape(-1, 3)
        self._local = Rays(np.zeros((1, 3)), unit)
        joint = np.full(len(unit), self._mount.joint[0])
        self._own = SelfFilter(posture, joint, self._local.moved(self._mount.T_joint_sensor[0]), 0.0)
        self._bias = float(rng.uniform(-1.0, 1.0))
        self.tilted: float = 0.0  # [rad] by how much it looks further down than its pose says

    def _down(self, angle: float) -> Array:
        """(4, 4) the sensor's frame turned downwards by an angle [rad]."""
        raise NotImplementedError

    def image(self, t: float) -> tuple[Image, Array, Array]:
        """Depths or ranges (H, W), the sensor's pose (4, 4) on the base, and the configuration (nq,) then."""
        p = self.params
        T_world_sensor, T_base_sensor = self._mount.poses()
        rays = self._local.moved(T_world_sensor[0] @ self._down(self.tilted))
        reach = p.range_max * float(self._stretch.max())
        met = self._obstacles.cast(t, rays, reach, normals=True)
        assert met.normal is not None
        own = self._own.distances(rays, reach)
        distance, facing = met.distance, -np.einsum("ij,ij->i", met.normal, rays.direction)
        mine = own < distance
        distance[mine], facing[mine] = own[mine], 1.0
        if p.floor:
            height, falls = rays.origin[0, 2], -rays.direction[:, 2]
            with np.errstate(divide="ignore"):
                ground = np.where((falls > 0.0) & (height > 0.0), height / falls, np.inf)
            nearer = (ground < distance) & (ground <= reach)
            distance[nearer], facing[nearer] = ground[nearer], falls[nearer]
        grazing = np.isfinite(distance) & (distance > 0.0) & (facing < math.cos(p.max_incidence))
        ranges = distance.reshape(self._shape)
        depth = ranges / self._stretch
        depth[grazing.reshape(self._shape)] = NO_ANSWER
        q = self._posture.robot.space.from_coordinates(self._posture.coordinates)
        return noisy_image(depth, ranges, p, self._bias, self._rng), T_base_sensor[0], q


class DepthCamera(_Imager):
    """Workspace: one depth camera on a robot; see :class:`SonarArray` for the arguments and errors."""

    def __init__(
        self,
        params: DepthParams,
        posture: Posture,
        obstacles: ObstacleRays,
        rng: np.random.Generator,
        self_padding: float,
    ) -> None:
        focal = 0.5 * params.columns / math.tan(0.5 * params.field_of_view)
        self._focal = focal, focal
        self._center = 0.5 * (params.columns - 1), 0.5 * (params.rows - 1)
        directions = camera_directions(params.rows, params.columns, self._focal, self._center)
        super().__init__(params, posture, obstacles, rng, params.T_frame_camera, directions)

    def _down(self, angle: float) -> Array:
        """(4, 4) the optical frame turned downwards by an angle [rad]: z towards y."""
        T, c, s = np.eye(4), math.cos(angle), math.sin(angle)
        T[:3, :3] = [[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]
        return T

    def measure(self, t: float) -> DepthImage:
        """The image at time ``t`` [s] from the robot's posture."""
        p = self.params
        depth, T, q = self.image(t)
        return DepthImage(p.name, t, T, depth, self._focal, self._center, p.range_min, p.range_max, q)


class Lidar(_Imager):
    """Workspace: one lidar that turns, on a robot; a turn is as if measured at once."""

    def __init__(
        self,
        params: LidarParams,
        posture: Posture,
        obstacles: ObstacleRays,
        rng: np.random.Generator,
        self_padding: float,
    ) -> None:
        self._azimuth = -math.pi, math.pi - 2.0 * math.pi / params.columns
        self._elevation = params.elevation_min, params.elevation_max
        directions = turning_directions(params.rows, params.columns, self._azimuth, self._elevation)
        super().__init__(params, posture, obstacles, rng, params.T_frame_lidar, directions)

    def _down(self, angle: float) -> Array:
        """(4, 4) the frame turned downwards by an angle [rad]: x towards −z."""
        T, c, s = np.eye(4), math.cos(angle), math.sin(angle)
        T[:3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
        return T

    def measure(self, t: float) -> RangeImage:
        """The round at time ``t`` [s] from the robot's posture."""
        p = self.params
        ranges, T, q = self.image(t)
        return RangeImage(p.name, t, T, ranges, self._azimuth, self._elevation, p.range_min, p.range_max, q)


class LaserRangefinder:
    """Workspace: one laser range finder on a robot; see :class:`SonarArray` for the arguments and errors."""

    def __init__(
        self,
        params: LaserParams,
        posture: Posture,
        obstacles: ObstacleRays,
        rng: np.random.Generator,
        self_padding: float,
    ) -> None:
        self.params: LaserParams = params
        self._obstacles = obstacles
        self._rng = rng
        self._mount = SensorMount(posture, (params.frame,))
        half, full = 0.5 * params.field_of_view, params.field_of_view >= 2.0 * math.pi - 1e-9
        self.angles: Array = (
            np.linspace(-half, half, params.rays, endpoint=not full) if params.rays > 1 else np.zeros(1)
        )
        fan = np.stack((np.cos(self.angles), np.sin(self.angles), np.zeros(params.rays)), axis=1)
        self._local = Rays(np.zeros((1, 3)), fan)
        joint = np.full(params.rays, self._mount.joint[0])
        self._own = SelfFilter(posture, joint, self._local.moved(self._mount.T_joint_sensor[0]), self_padding)

    def measure(self, t: float) -> LaserScan:
        """The scan at time ``t`` [s] from the robot's posture; ``NO_ANSWER`` where the robot itself is nearest."""
        p = self.params
        T_world_sensor, T_base_sensor = self._mount.poses()
        rays = self._local.moved(T_world_sensor[0])
        distance = self._obstacles.cast(t, rays, p.range_max).distance
        own = self._own.distances(rays, p.range_max)
        distance[np.isfinite(own) & (own <= distance)] = NO_ANSWER
        ranges = noisy_ranges(distance, p, self._rng)
        return LaserScan(p.name, t, T_base_sensor[0], self.angles, ranges, p.range_min, p.range_max)


_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))  # [rad] turn from one ray to the next


def cone_rays(half_angle: float, count: int) -> Array:
    """Directions (count, 3) that fill a cone about the x axis evenly; the first is the axis, the last on the rim.

    Args:
        half_angle: half angle of the cone [rad].
        count: number of directions.
    """
    k = np.arange(count)
    tilt, turn = half_angle * np.sqrt(k / max(count - 1, 1)), _GOLDEN_ANGLE * k
    return np.stack((np.cos(tilt), np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)), axis=1)


class SonarArray:
    """Workspace: one ring of sonars or infrared sensors on a robot; one group of them fires at a time.

    Args:
        params: parameters of the devices.
        posture: posture of the robot, placed by the caller before a reading.
        obstacles: the world's obstacles.
        rng: source of noise, dropouts and crosstalk.
        self_padding: padding of the links that move before the sensors [m].

    Raises:
        RobotError: the robot has no such link.
    """

    def __init__(
        self,
        params: RingParams,
        posture: Posture,
        obstacles: ObstacleRays,
        rng: np.random.Generator,
        self_padding: float,
    ) -> None:
        self.params: RingParams = params
        self._obstacles = obstacles
        self._rng = rng
        self._mount = SensorMount(posture, params.frames)
        self._cone = cone_rays(params.half_angle, params.rays)
        self._groups: list[tuple[npt.NDArray[np.intp], SelfFilter]] = []
        for g in range(params.groups):
            members = np.arange(g, len(params.frames), params.groups)
            joint = np.repeat(self._mount.joint[members], params.rays)
            local = self._rays(self._mount.T_joint_sensor[members])
            self._groups.append((members, SelfFilter(posture, joint, local, self_padding)))
        self.restart()

    def restart(self) -> None:
        """The first group fires next."""
        self._next = 0

    def measure(self, t: float) -> RangeRing:
        """The reading at time ``t`` [s] of the group whose turn it is: the nearest echo in each sensor's cone.

        It is ``NO_ANSWER`` for all other sensors, and where the robot itself is nearest.
        """
        p = self.params
        members, own = self._groups[self._next]
        self._next = (self._next + 1) % p.groups
        T_world_sensor, T_base_sensor = self._mount.poses()
        distance = self._distances(t, self._rays(T_world_sensor[members]), own)
        ranges = np.full(len(p.frames), NO_ANSWER)
        ranges[members] = noisy_ranges(self._overheard(distance), p, self._rng)
        return RangeRing(p.name, p.kind, t, T_base_sensor, ranges, p.half_angle, p.range_min, p.range_max)

    def _rays(self, T: Array) -> Rays:
        """All rays of sensors at ``T`` (S, 4, 4), sensor by sensor."""
        direction = np.matmul(self._cone, T[:, :3, :3].transpose(0, 2, 1)).reshape(-1, 3)
        return Rays(np.repeat(T[:, :3, 3], self.params.rays, axis=0), direction)

    def _distances(self, t: float, rays: Rays, own: SelfFilter) -> Array:
        """Nearest true echo (S,) [m] of each sensor; infinite without one, NaN where it is the robot's own."""
        p = self.params
        met = self._obstacles.cast(t, rays, p.range_max, normals=True, light=p.kind == "infrared")
        body = own.distances(rays, p.range_max)
        blocked = np.isfinite(body) & (body <= met.distance)
        assert met.normal is not None
        facing = -np.einsum("ij,ij->i", met.normal, rays.direction)
        heard = (facing >= math.cos(p.max_incidence) - 1e-9) | (met.distance == 0.0)
        echo = np.where(heard, met.distance, np.inf).reshape(-1, p.rays).min(axis=1)
        self_echo = np.where(blocked, body, np.inf).reshape(-1, p.rays).min(axis=1)
        echo[np.isfinite(self_echo) & (self_echo <= echo)] = NO_ANSWER
        return echo

    def _overheard(self, distance: Array) -> Array:
        """Crosstalk: some sensors receive the echo of a neighbour in their group, if it is earlier than their own."""
        n = len(distance)
        side = np.where(self._rng.random(n) < 0.5, -1, 1)
        hears = self._rng.random(n) < self.params.crosstalk
        if n < 2 or not hears.any():
            return distance
        neighbour = distance[(np.arange(n) + side) % n]
        return np.where(hears & (neighbour < distance), neighbour, distance)


_SAME_TIME = 1e-9  # [s] times that differ by less are the same


@dataclass(slots=True)
class _Clocked:
    """A sensor and its next time; it fires at whole periods after the start."""

    device: LaserRangefinder | SonarArray | DepthCamera | Lidar
    period: float
    due: float = 0.0


_DEVICES = (
    (LaserParams, LaserRangefinder),
    (RingParams, SonarArray),
    (DepthParams, DepthCamera),
    (LidarParams, Lidar),
)


class SensorSuite:
    """Workspace: simulated range sensors of a robot in a world.

    Args:
        robot: the robot that carries them.
        world: the obstacles over time.
        config: configuration of the sensors.
        seed: seed of noise, dropouts and crosstalk, or a source of random numbers; each sensor draws from a stream of
            its own.
        time: time at which the sensors begin [s].

    Attributes:
        obstacles: what they are cast against, and what of it is of glass.

    Raises:
        RobotError: the robot lacks a link of a sensor.
        MissingExtraError: the extra ``sensing`` is needed for the world's shapes, and not installed.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World,
        config: SensorConfig | None = None,
        *,
        seed: int | np.random.Generator = 0,
        time: float = 0.0,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("world", world, World, SceneError)
        check_type("config", config, SensorConfig, none=True)
        if not isinstance(seed, np.random.Generator):
            check_count("seed", seed)
        self.config: SensorConfig = SensorConfig() if config is None else config
        self._posture = Posture(robot)
        self.obstacles: ObstacleRays = ObstacleRays(world)
        streams = np.random.default_rng(seed).spawn(len(self.config.sensors))
        self._sensors: list[_Clocked] = []
        for params, rng in zip(self.config.sensors, streams, strict=True):
            make = next(device for kind, device in _DEVICES if isinstance(params, kind))
            device = make(params, self._posture, self.obstacles, rng, self.config.self_padding)  # type: ignore[arg-type]
            self._sensors.append(_Clocked(device, 1.0 / params.rate))
        self.reset(time)

    @property
    def imagers(self) -> tuple[DepthCamera | Lidar, ...]:
        """The depth cameras and 3-D lidars."""
        return tuple(s.device for s in self._sensors if isinstance(s.device, (DepthCamera, Lidar)))

    def reset(self, t: float) -> None:
        """Restart at ``t`` [s]: all sensors fire then, delayed readings are lost, and the noise continues.

        Raises:
            ParameterError: the time is not finite.
        """
        self._start = self._now = check_number("t", t, unit="s")
        self._pending: list[tuple[float, int, float, Reading]] = []  # time, sensor, arrival, reading
        for sensor in self._sensors:
            sensor.due = self._start
            if isinstance(sensor.device, SonarArray):
                sensor.device.restart()

    def observe(self, t: float, coordinates: Array) -> tuple[Reading, ...]:
        """The readings that are available at ``t`` [s] and were not before, in order of time.

        To be called in every control step: a sensor fires at the first call at or after each of its times, once if
        several have passed.

        Args:
            t: the time [s], not before that of the last call.
            coordinates: (nv,) the robot's true coordinate row then.

        Raises:
            ParameterError: the time is not finite, or goes back.
            ConfigurationError: the coordinate row has another size, or is not finite.
        """
        now = check_number("t", t, unit="s")
        if now < self._now - _SAME_TIME:
            raise ParameterError(f"observe at t={now!r} s after t={self._now!r} s; time must not go back: reset first")
        self._now = now
        due = [k for k, sensor in enumerate(self._sensors) if now >= sensor.due - _SAME_TIME]
        if due:
            self._posture.place(coordinates)
        for k in due:
            sensor = self._sensors[k]
            reading = sensor.device.measure(now)
            self._pending.append((now, k, now + sensor.device.params.latency, reading))
            passed = math.floor((now - self._start + _SAME_TIME) / sensor.period)
            sensor.due = self._start + (passed + 1) * sensor.period
        ready = [entry for entry in self._pending if entry[2] <= now + _SAME_TIME]
        if not ready:
            return ()
        self._pending = [entry for entry in self._pending if entry[2] > now + _SAME_TIME]
        return tuple(entry[3] for entry in sorted(ready, key=lambda e: e[:2]))
