"""Sensed points and rays: readings as they lie in the plane of the base, in the world's frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..perception import LaserScan, Reading
from ..robot.space import Array

Flags = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.int_]
_CONE, _DEPTH = 0.05, 0.15  # [rad, m] how far a scanned point may be off a sonar's cone and range to explain them


@dataclass(frozen=True, slots=True, eq=False)
class PlanarRays:
    """Rays of one reading, seen from above, in the world's frame; rays of which nothing is known are left out.

    Attributes:
        start: (R, 2) where they begin [m].
        bearing: (R,) their directions [rad].
        length: (R,) how far they are free [m].
        hit: (R,) whether there is something at their end.
    """

    start: Array
    bearing: Array
    length: Array
    hit: Flags

    @property
    def ends(self) -> Array:
        """(R, 2) where they end [m]."""
        return self.start + self.length[:, None] * np.stack((np.cos(self.bearing), np.sin(self.bearing)), axis=1)


def planar_rays(reading: Reading, pose: Array) -> PlanarRays:
    """The rays of a reading, taken at a pose (x, y, yaw) of the base; heights are left out."""
    if isinstance(reading, LaserScan):
        a, T = reading.angles, reading.T_base_sensor
        along = np.stack((np.cos(a), np.sin(a)), axis=1) @ T[:2, :2].T
        start = np.broadcast_to(T[:2, 3], along.shape)
    else:
        along, start = reading.T_base_sensor[:, :2, 0], reading.T_base_sensor[:, :2, 3]
    known = ~np.isnan(reading.ranges)
    along, start, ranges = along[known], start[known], reading.ranges[known]
    x, y, yaw = (float(p) for p in pose[:3])
    cos, sin = math.cos(yaw), math.sin(yaw)
    hit = np.isfinite(ranges)
    length = np.where(hit, ranges, reading.range_max) * np.hypot(along[:, 0], along[:, 1])
    return PlanarRays(
        np.stack((x + cos * start[:, 0] - sin * start[:, 1], y + sin * start[:, 0] + cos * start[:, 1]), axis=1),
        np.arctan2(along[:, 1], along[:, 0]) + yaw,
        length,
        hit,
    )


class SensedPoints:
    """The points that each sensor saw last, in the world's frame. A reading without any answer changes nothing.

    A sonar does not say where in its cone something is. Where a scan shows a point in the cone at about the sonar's
    range, that point explains the echo; else it is taken to be on the axis, for the scan may not see it: it may be low.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget them."""
        self._scans: dict[str, Array] = {}
        self._rings: dict[str, tuple[PlanarRays, float]] = {}
        self._points: Array | None = np.zeros((0, 2))

    def update(self, reading: Reading, pose: Array) -> None:
        """Replace what its sensor saw last; ``pose`` is the base's (x, y, yaw) at the time of the reading."""
        rays = planar_rays(reading, pose)
        if not len(rays.hit):
            return
        if isinstance(reading, LaserScan):
            self._scans[reading.sensor] = rays.ends[rays.hit]
        else:
            self._rings[reading.sensor] = rays, reading.half_angle
        self._points = None

    @property
    def points(self) -> Array:
        """(P, 2) all of them [m]."""
        if self._points is None:
            scanned = np.concatenate([np.zeros((0, 2)), *self._scans.values()])
            echoes = [rays.ends[rays.hit & ~_explained(rays, half, scanned)] for rays, half in self._rings.values()]
            self._points = np.concatenate([scanned, *echoes])
        return self._points


def _explained(rays: PlanarRays, half_angle: float, points: Array) -> Flags:
    """(R,) whether one of the points (P, 2) is in a ray's cone at about the ray's length."""
    out = np.zeros(len(rays.hit), dtype=bool)
    to = points - rays.start[:, None]
    ray, point = np.nonzero(np.abs(np.hypot(to[..., 0], to[..., 1]) - rays.length[:, None]) <= _DEPTH)
    bearing = np.arctan2(to[ray, point, 1], to[ray, point, 0])
    off = np.mod(bearing - rays.bearing[ray] + np.pi, 2.0 * np.pi) - np.pi
    out[ray[np.abs(off) <= half_angle + _CONE]] = True
    return out
