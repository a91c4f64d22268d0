"""Sensing room, rays: a scan laid out in the world's plane, and what it says about points there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ParameterError
from ..robot.space import Array, Mask
from .readings import LaserScan

_LEVEL = math.cos(math.radians(5.0))


@dataclass(frozen=True, slots=True, eq=False)
class ScanRays:
    """A planar scan in the world.

    Attributes:
        time: of the scan [s].
        origin: (2,) where its rays start [m].
        height: of its plane over the floor [m].
        way: (R, 2) unit directions.
        bearing: (R,) their angles, ascending, not wrapped [rad].
        ranges: (R,) as in the scan [m].
        range_min, range_max: of the sensor [m].
        closed: whether the rays go all the way round.
    """

    time: float
    origin: Array
    height: float
    way: Array
    bearing: Array
    ranges: Array
    range_min: float
    range_max: float
    closed: bool

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
        ray = np.interp(turn, self.bearing - first, np.arange(len(self.bearing)))
        return distance, ray, inside & (distance >= self.range_min) & (distance <= self.range_max)

    def beyond(self, points: Array, margin: float) -> tuple[Mask, Mask]:
        """Which of the points (n, 2) the scan sees through, and which it could not see, for something is before them.

        Rays within half of ``margin`` to either side of a point, and the next ones, must all end more than ``margin``
        [m] behind it for the point to be free. A point is hidden where the ray to it ends that much before it, or says
        nothing, or there is none.
        """
        distance, ray, inside = self.locate(points)
        step = (self.bearing[-1] - self.bearing[0]) / (len(self.bearing) - 1)
        spread = np.minimum(0.5 * margin / np.maximum(distance, 1e-6), 0.5) / step + 1.0
        count = len(self.bearing)
        reach = np.where(np.isnan(self.ranges), -1.0, np.minimum(self.ranges, self.range_max))
        offsets = np.linspace(-1.0, 1.0, 9)
        index = np.rint(ray[:, None] + offsets * spread[:, None]).astype(np.intp)
        index = index % count if self.closed else np.minimum(np.maximum(index, 0), count - 1)
        seen = reach[index]
        # a range that is not known says nothing; the ranges that are known must all be long enough
        known = np.where(seen < 0.0, np.inf, seen)
        through = inside & (known.min(axis=1) > distance + margin) & (seen[:, 4] > 0.0)
        at_point = seen[:, 4]
        hidden = ~inside | (at_point < distance - margin)
        return through, hidden


def pose_matrix(base_pose: Any) -> Array:
    """T_world_base (4, 4) of a base's pose (x [m], y [m], yaw [rad]) on the floor."""
    try:
        x, y, yaw = (float(v) for v in base_pose)
    except (TypeError, ValueError):
        raise ParameterError(f"base_pose={base_pose!r} must be three numbers: x [m], y [m], yaw [rad]") from None
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(yaw)):
        raise ParameterError(f"base_pose={(x, y, yaw)} must be finite")
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def rays_of(scan: LaserScan, base_pose: Any) -> ScanRays:
    """Lay a scan out in the world.

    Args:
        scan: of a level sensor, the right way up or upside down.
        base_pose: (x [m], y [m], yaw [rad]) of the base when it was measured.

    Raises:
        ParameterError: the sensor is tilted by more than 5°, the scan has fewer than two rays, or its angles do not
            ascend.
    """
    T = pose_matrix(base_pose) @ scan.T_base_sensor
    if abs(T[2, 2]) < _LEVEL:
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
        way=np.column_stack((np.cos(bearing), np.sin(bearing))),
        bearing=bearing,
        ranges=ranges,
        range_min=scan.range_min,
        range_max=scan.range_max,
        closed=bool(angles[-1] - angles[0] > 2.0 * math.pi - 1.5 * step),
    )
