"""Sensing room, clusters: the points of a scan that belong to one thing, as far as one scan can tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..robot.space import Array
from .estimator_params import SceneEstimatorParams
from .scan_rays import ScanRays


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Neighbouring points of a scan without a gap between them.

    Attributes:
        points: (n, 2) in the world's plane, counter-clockwise about the sensor [m].
        origin: (2,) of the sensor [m].
        hidden_first, hidden_last: whether the thing may go on, unseen, beyond its first or last point: something
            nearer covers it, a reading is missing, or the field of view ends there.
    """

    points: Array
    origin: Array
    hidden_first: bool
    hidden_last: bool

    @property
    def hidden(self) -> bool:
        """Whether one of the ends may not be the thing's own."""
        return self.hidden_first or self.hidden_last

    @property
    def extent(self) -> float:
        """Diagonal of the points' bounding box [m]."""
        return float(np.hypot(*np.ptp(self.points, axis=0)))


def clusters_of(rays: ScanRays, params: SceneEstimatorParams) -> tuple[Cluster, ...]:
    """Split a scan where neighbouring points are further apart than points of one surface would be.

    On a surface that meets the ray at the angle λ = ``break_angle``, the next point after range r, at an angle Δ, is
    r·sin Δ / sin(λ − Δ) away; beyond that and three standard deviations of the range a new cluster begins. Missing
    readings are passed over, free ones separate.
    """
    hit = np.flatnonzero(rays.hits)
    if not len(hit):
        return ()
    r = rays.ranges[hit]
    points = rays.origin + r[:, None] * rays.way[hit]
    count, empty = len(rays.ranges), np.isposinf(rays.ranges)
    free = np.concatenate(([0], np.cumsum(empty)))  # free rays before each ray
    turn = np.diff(rays.bearing[hit], append=rays.bearing[hit[0]] + 2.0 * math.pi)  # the last one: round to the first
    nearer = np.minimum(r, np.roll(r, -1))
    lean = np.maximum(params.break_angle - turn, 0.5 * params.break_angle)
    reach = nearer * np.sin(np.minimum(turn, 0.5)) / np.sin(lean) + 3.0 * params.range_noise
    gap = np.roll(points, -1, axis=0) - points
    apart = np.hypot(gap[:, 0], gap[:, 1]) > reach
    apart[:-1] |= free[hit[1:]] - free[hit[:-1] + 1] > 0
    apart[-1] |= not rays.closed or bool(empty[hit[-1] + 1 :].any() or empty[: hit[0]].any())
    order = np.arange(len(hit))
    ends = np.flatnonzero(apart)
    if not len(ends):  # one thing all around
        groups = [order]
    else:
        order = np.roll(order, -(ends[-1] + 1))
        groups = np.split(order, (ends[:-1] - ends[-1]) % len(hit)) if len(ends) > 1 else [order]
    result = []
    for group in groups:
        first, last = int(group[0]), int(group[-1])
        result.append(
            Cluster(
                points[group],
                rays.origin,
                _covered(rays, int(hit[first]), -1, count),
                _covered(rays, int(hit[last]), 1, count),
            )
        )
    return tuple(result)


def _covered(rays: ScanRays, ray: int, step: int, count: int) -> bool:
    """Whether what ends at a ray may go on beyond: the next ray is shorter, unknown, or not there."""
    beside = ray + step
    if not 0 <= beside < count:
        if not rays.closed:
            return True
        beside %= count
    return not rays.ranges[beside] > rays.ranges[ray]
