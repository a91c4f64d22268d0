"""Readings: measurements of range sensors as frozen values, and the rays of a scan in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Image, Mask
from elastic_strips.errors import ParameterError
from elastic_strips.summary import Summary

NOTHING = np.inf
"""The range of a ray that meets nothing as far as the sensor reaches."""
NO_ANSWER = np.nan
"""The range of a ray about which nothing is known: it dropped out, or the robot itself is in the way."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LaserScan(Summary):
    """One scan of a planar laser range finder.

    Attributes:
        sensor: name of the sensor.
        time: when it was measured [s].
        T_base_sensor: (4, 4) pose of the sensor in the base's frame when it was measured.
        angles: (R,) directions of the rays in the sensor's xy plane, from its x axis, ascending [rad].
        ranges: (R,) [m]; ``NOTHING`` where nothing is within ``range_max``, ``NO_ANSWER`` where nothing is known.
        range_min, range_max: shortest and longest range that the sensor can tell [m].
    """

    sensor: str
    time: float
    T_base_sensor: Array
    angles: Array
    ranges: Array
    range_min: float
    range_max: float

    def __post_init__(self) -> None:
        _freeze(self, "T_base_sensor", (4, 4))
        _freeze(self, "angles", (-1,))
        _freeze(self, "ranges", self.angles.shape)

    @property
    def hits(self) -> Mask:
        """(R,) whether a ray met something."""
        return np.isfinite(self.ranges)

    def points(self) -> Array:
        """(H, 3) points where rays met something, in the base's frame [m]."""
        at = self.hits
        r, a = self.ranges[at], self.angles[at]
        local = np.stack((r * np.cos(a), r * np.sin(a), np.zeros_like(r)), axis=1)
        return local @ self.T_base_sensor[:3, :3].T + self.T_base_sensor[:3, 3]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RangeRing(Summary):
    """One round of a ring of single-range sensors: sonars, or infrared distance sensors.

    Attributes:
        sensor: name of the ring.
        kind: ``"sonar"`` or ``"infrared"``.
        time: when it was measured [s].
        T_base_sensor: (S, 4, 4) poses of the sensors in the base's frame; each looks along its x axis.
        ranges: (S,) [m]; ``NOTHING`` where nothing is within ``range_max``, ``NO_ANSWER`` where nothing is known.
        half_angle: half angle of the cone that a sensor sees [rad]; the range does not say where in it something is.
        range_min, range_max: shortest and longest range that a sensor can tell [m].
    """

    sensor: str
    kind: str
    time: float
    T_base_sensor: Array
    ranges: Array
    half_angle: float
    range_min: float
    range_max: float

    def __post_init__(self) -> None:
        if self.kind not in ("sonar", "infrared"):
            raise ParameterError(f"RangeRing.kind={self.kind!r} is neither 'sonar' nor 'infrared'")
        _freeze(self, "T_base_sensor", (-1, 4, 4))
        _freeze(self, "ranges", self.T_base_sensor.shape[:1])

    @property
    def hits(self) -> Mask:
        """(S,) whether a sensor sees something."""
        return np.isfinite(self.ranges)

    def points(self) -> Array:
        """(H, 3) points on the axes of the sensors that see something, at their ranges, in the base's frame [m]."""
        at = self.hits
        T = self.T_base_sensor[at]
        return T[:, :3, 3] + self.ranges[at, None] * T[:, :3, 0]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DepthImage(Summary):
    """An image of a depth camera.

    Attributes:
        sensor: name of the sensor.
        time: when it was exposed [s].
        T_base_sensor: (4, 4) pose of the camera's optical frame in the base's frame when it was exposed: z looks
            forward, x to the right, y down.
        depth: (H, W) float32 distances along z [m], row by row from the upper left; ``NOTHING`` where nothing is within
            ``depth_max``, ``NO_ANSWER`` where nothing is known.
        focal: focal lengths of columns and rows [px].
        center: column and row of the optical axis [px]; the middle of the first pixel is (0, 0).
        depth_min, depth_max: shortest and longest depth that the camera can tell [m].
        q: (nq,) configuration of the robot then, or None: where it is known, what the robot itself covers can be told.
    """

    sensor: str
    time: float
    T_base_sensor: Array
    depth: Image
    focal: tuple[float, float]
    center: tuple[float, float]
    depth_min: float
    depth_max: float
    q: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "T_base_sensor", (4, 4))
        _freeze(self, "depth", (-1, -1), np.float32)
        if self.q is not None:
            _freeze(self, "q", (-1,))
        if not (min(self.focal) > 0.0 and math.isfinite(sum(self.focal) + sum(self.center))):
            raise ParameterError(f"DepthImage.focal={self.focal!r}, center={self.center!r}: lengths in pixels, above 0")

    @property
    def ranges(self) -> Image:
        """(H, W) the depths."""
        return self.depth

    @property
    def hits(self) -> Mask:
        """(H, W) whether a pixel met something."""
        return np.isfinite(self.depth)

    def directions(self) -> Array:
        """(H, W, 3) where the pixels' middles look, in the camera's frame: a depth of one along z."""
        rows, columns = self.depth.shape
        return camera_directions(rows, columns, tuple(self.focal), tuple(self.center))

    def points(self) -> Array:
        """(n, 3) points where pixels met something, row by row, in the base's frame [m]."""
        return _image_points(self)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RangeImage(Summary):
    """One round of a range finder of many rays that turns, a 3-D lidar: one row for each elevation.

    Attributes:
        sensor: name of the sensor.
        time: when it was measured, as if at once [s].
        T_base_sensor: (4, 4) pose of the sensor in the base's frame then: it turns about z.
        ranges: (H, W) float32 [m]; ``NOTHING`` where nothing is within ``range_max``, ``NO_ANSWER`` where nothing is
            known.
        azimuth: azimuths of the first column and of the last one, from x on towards y [rad]; the columns between are
            evenly spread.
        elevation: elevations of the first row and of the last one [rad].
        range_min, range_max: shortest and longest range that it can tell [m].
        q: (nq,) configuration of the robot then, or None.
    """

    sensor: str
    time: float
    T_base_sensor: Array
    ranges: Image
    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    range_min: float
    range_max: float
    q: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "T_base_sensor", (4, 4))
        _freeze(self, "ranges", (-1, -1), np.float32)
        if self.q is not None:
            _freeze(self, "q", (-1,))
        if min(self.ranges.shape) < 2 or self.azimuth[0] == self.azimuth[1] or self.elevation[0] == self.elevation[1]:
            raise ParameterError(f"the range image of {self.sensor!r} needs at least two rows and two columns, apart")
        if abs(self.azimuth[1] - self.azimuth[0]) > 2.0 * math.pi + 1e-9:
            raise ParameterError(f"RangeImage.azimuth={self.azimuth!r} is more than a turn")

    @property
    def hits(self) -> Mask:
        """(H, W) whether a ray met something."""
        return np.isfinite(self.ranges)

    @property
    def steps(self) -> tuple[float, float]:
        """From column to column, and from row to row [rad]."""
        rows, columns = self.ranges.shape
        return (
            (self.azimuth[1] - self.azimuth[0]) / (columns - 1),
            (self.elevation[1] - self.elevation[0]) / (rows - 1),
        )

    @property
    def closed(self) -> bool:
        """Whether the last column is beside the first."""
        return abs(self.azimuth[1] - self.azimuth[0]) + 1.5 * abs(self.steps[0]) > 2.0 * math.pi

    def directions(self) -> Array:
        """(H, W, 3) unit vectors along the rays, in the sensor's frame."""
        rows, columns = self.ranges.shape
        return turning_directions(rows, columns, tuple(self.azimuth), tuple(self.elevation))

    def points(self) -> Array:
        """(n, 3) points where rays met something, row by row, in the base's frame [m]."""
        return _image_points(self)


def _image_points(image: DepthImage | RangeImage) -> Array:
    at, T = image.hits, image.T_base_sensor
    return (image.directions()[at] * image.ranges[at, None]) @ T[:3, :3].T + T[:3, 3]


@lru_cache(maxsize=16)
def camera_directions(rows: int, columns: int, focal: tuple[float, float], center: tuple[float, float]) -> Array:
    """(H, W, 3) where the middles of a camera's pixels look, in its frame: a depth of one along z."""
    u = (np.arange(columns) - center[0]) / focal[0]
    v = (np.arange(rows) - center[1]) / focal[1]
    directions = np.stack(np.broadcast_arrays(u, v[:, None], 1.0), axis=-1)
    directions.flags.writeable = False  # those of one camera are the same array
    return directions


@lru_cache(maxsize=16)
def turning_directions(rows: int, columns: int, azimuth: tuple[float, float], elevation: tuple[float, float]) -> Array:
    """(H, W, 3) unit vectors along the rays of a range finder that turns, in its frame."""
    a, e = np.meshgrid(np.linspace(*azimuth, columns), np.linspace(*elevation, rows))
    directions = np.stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)), axis=-1)
    directions.flags.writeable = False
    return directions


Reading = LaserScan | RangeRing | DepthImage | RangeImage


def _freeze(reading: Reading, name: str, shape: tuple[int, ...], dtype: type = np.float64) -> None:
    """Keep a field as a read-only array of this shape (−1: any)."""
    array = np.array(getattr(reading, name), dtype=dtype)
    if array.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
        raise ParameterError(f"{type(reading).__name__}.{name} has shape {array.shape}; it needs {shape}")
    array.flags.writeable = False
    object.__setattr__(reading, name, array)


_LEVEL_COSINE = math.cos(math.radians(5.0))  # of the tilt up to which a scan counts as level


_BESIDE = np.linspace(-1.0, 1.0, 9)  # where rays are asked for, as parts of how far to either side


@dataclass(frozen=True, slots=True, eq=False)
class ScanRays:
    """A planar scan in the world.

    Attributes:
        time: time of the scan [s].
        origin: (2,) point where its rays start [m].
        height: height of its plane over the floor [m].
        direction: (R, 2) unit vectors along the rays.
        bearing: (R,) their angles, ascending, not wrapped [rad].
        ranges: (R,) as in the scan [m].
        range_min, range_max: shortest and longest range of the sensor [m].
        closed: whether the rays go all the way round.
    """

    time: float
    origin: Array
    height: float
    direction: Array
    bearing: Array
    ranges: Array
    range_min: float
    range_max: float
    closed: bool
    _reach: Array = field(init=False, repr=False)  # (R,) how far each ray sees [m]; −1 where that is not known
    _turns: Array = field(init=False, repr=False)  # (R,) from the first ray [rad]
    _numbers: Array = field(init=False, repr=False)  # (R,) of the rays

    def __post_init__(self) -> None:
        reach = np.where(np.isnan(self.ranges), -1.0, np.minimum(self.ranges, self.range_max))
        object.__setattr__(self, "_reach", reach)
        object.__setattr__(self, "_turns", self.bearing - self.bearing[0])
        object.__setattr__(self, "_numbers", np.arange(len(self.bearing)))

    @property
    def hits(self) -> Mask:
        """(R,) whether a ray met something."""
        return np.isfinite(self.ranges)

    def locate(self, points: Array) -> tuple[Array, Array, Mask]:
        """Distance (n,) [m], nearest ray (n, as float), and whether in the field of view (n,), of points (n, 2)."""
        d = points - self.origin
        distance = np.hypot(d[:, 0], d[:, 1])
        first, last = self.bearing[0], self.bearing[-1]
        step = (last - first) / (len(self.bearing) - 1)
        turn = np.mod(np.arctan2(d[:, 1], d[:, 0]) - first + 0.5 * step, 2.0 * math.pi) - 0.5 * step
        inside = turn <= last - first + 0.5 * step
        ray = np.interp(turn, self._turns, self._numbers)
        return distance, ray, inside & (distance >= self.range_min) & (distance <= self.range_max)

    def beyond(self, points: Array, margin: float, heights: Array | None = None) -> tuple[Mask, Mask]:
        """Which of the points (n, 2) the scan sees through, and which it could not see, because something is in front.

        Rays within half of ``margin`` to either side of a point, and the next ones, must all end more than ``margin``
        [m] behind it for the point to be free. A point is hidden where the ray to it ends that far in front of it, or
        says nothing, or does not exist. A scan has one height, whatever the ``heights`` are of what would be there.
        """
        distance, ray, inside = self.locate(points)
        step = (self.bearing[-1] - self.bearing[0]) / (len(self.bearing) - 1)
        spread = np.minimum(0.5 * margin / np.maximum(distance, 1e-6), 0.5) / step + 1.0
        count = len(self.bearing)
        index = np.rint(ray[:, None] + _BESIDE * spread[:, None]).astype(np.intp)
        index = index % count if self.closed else np.minimum(np.maximum(index, 0), count - 1)
        seen = self._reach[index]
        # a range that is not known says nothing; the ranges that are known must all be long enough
        known = np.where(seen < 0.0, np.inf, seen)
        through = inside & (known.min(axis=1) > distance + margin) & (seen[:, 4] > 0.0)
        at_point = seen[:, 4]
        hidden = ~inside | (at_point < distance - margin)
        return through, hidden


def pose_matrix(base_pose: ArrayLike) -> Array:
    """T_world_base (4, 4) of a base's pose (x [m], y [m], yaw [rad]) on the floor; else `ParameterError`."""
    try:
        x, y, yaw = (float(v) for v in np.asarray(base_pose, dtype=float).tolist())
    except (TypeError, ValueError):
        raise ParameterError(f"base_pose={base_pose!r} must be three numbers: x [m], y [m], yaw [rad]") from None
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(yaw)):
        raise ParameterError(f"base_pose={(x, y, yaw)} must be finite")
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def rays_of(scan: LaserScan, base_pose: ArrayLike) -> ScanRays:
    """Lay a scan out in the world.

    Args:
        scan: scan of a level sensor, the right way up or upside down.
        base_pose: (x [m], y [m], yaw [rad]) of the base when it was measured.

    Raises:
        ParameterError: the sensor is tilted by more than 5°, the scan has fewer than two rays, or its angles do not
            ascend.
    """
    T = pose_matrix(base_pose) @ scan.T_base_sensor
    if abs(T[2, 2]) < _LEVEL_COSINE:
        raise ParameterError(f"the laser {scan.sensor!r} is tilted; only level scans say where in the plane things are")
    if len(scan.angles) < 2 or not (np.diff(scan.angles) > 0.0).all():
        raise ParameterError(f"the scan of {scan.sensor!r} needs at least two rays, their angles ascending")
    up = T[2, 2] > 0.0
    angles, ranges = (scan.angles, scan.ranges) if up else (-scan.angles[::-1], scan.ranges[::-1])
    bearing = math.atan2(T[1, 0], T[0, 0]) + angles
    step = (angles[-1] - angles[0]) / (len(angles) - 1)
    return ScanRays(
        time=scan.time,
        origin=T[:2, 3].copy(),
        height=float(T[2, 3]),
        direction=np.column_stack((np.cos(bearing), np.sin(bearing))),
        bearing=bearing,
        ranges=ranges,
        range_min=scan.range_min,
        range_max=scan.range_max,
        closed=bool(angles[-1] - angles[0] > 2.0 * math.pi - 1.5 * step),
    )
