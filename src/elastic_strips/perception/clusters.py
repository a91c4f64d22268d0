"""Clusters: the points of a scan that belong to one thing, and circles, segments and boxes that hold them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.scene import Box, Cylinder, Obstacle

from .params import SceneEstimatorParams
from .readings import ScanRays


@dataclass(frozen=True, slots=True, eq=False)
class Cluster:
    """Neighbouring points of a scan without a gap between them.

    Attributes:
        points: (n, 2) in the world's plane, counter-clockwise about the sensor [m].
        origin: (2,) of the sensor [m].
        covered: whether the thing may continue, unseen, beyond its first and beyond its last point: something nearer
            covers it, a reading is missing, or the field of view ends there.
        displaced: whether it is known to lie where it was free before; None where scans have to be compared.
        solid: (n, 3) points that it was seen at, in the world [m]; none where only a plane was seen.
    """

    points: Array
    origin: Array
    covered: tuple[bool, bool]
    displaced: bool | None = None
    solid: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def hidden(self) -> bool:
        """Whether it may continue beyond either end."""
        return any(self.covered)

    @property
    def extent(self) -> float:
        """Diagonal of the points' bounding box [m]."""
        return float(np.hypot(*np.ptp(self.points, axis=0)))


def clusters_of(rays: ScanRays, params: SceneEstimatorParams) -> tuple[Cluster, ...]:
    """Split a scan where neighbouring points are further apart than points of one surface would be.

    On a surface that meets the ray at the angle λ = ``break_angle``, the next point after range r, at an angle Δ, is
    r·sin Δ / sin(λ − Δ) away; beyond that and three standard deviations of the range a new cluster begins. Missing
    readings are skipped, free ones separate.
    """
    hit = np.flatnonzero(rays.hits)
    if not len(hit):
        return ()
    r = rays.ranges[hit]
    points = rays.origin + r[:, None] * rays.direction[hit]
    empty = np.isposinf(rays.ranges)
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
        first, last = int(hit[group[0]]), int(hit[group[-1]])
        covered = _covered(rays, first, -1), _covered(rays, last, 1)
        result.append(Cluster(points[group], rays.origin, covered))
    return tuple(result)


def _covered(rays: ScanRays, ray: int, step: int) -> bool:
    """Whether a thing that ends at a ray may continue beyond: the next ray is shorter, unknown, or does not exist."""
    beside, count = ray + step, len(rays.ranges)
    if not 0 <= beside < count:
        if not rays.closed:
            return True
        beside %= count
    return not rays.ranges[beside] > rays.ranges[ray]


ROUND, STRAIGHT, OTHER = "round", "straight", "other"


@dataclass(frozen=True, slots=True)
class ClusterShape:
    """The shape that a cluster is taken for.

    Attributes:
        kind: ``"round"``, ``"straight"`` or ``"other"``.
        center: (x, y) of a circle or a box [m].
        radius: radius of the circle, or of the one about the box [m]; without padding.
        size: (length, depth) of the box [m]; for a circle both are its diameter.
        yaw: direction of the box's length [rad].
    """

    kind: str
    center: tuple[float, float]
    radius: float
    size: tuple[float, float]
    yaw: float


def fit_circle(points: Array) -> tuple[float, float, float]:
    """Centre x, y and radius [m] of a circle through points (n ≥ 3, 2), by Taubin's algebraic fit.

    The radius is infinite where the points lie on a line.
    """
    mean = points.mean(axis=0)
    x, y = (points - mean).T
    z = x * x + y * y
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    xz, yz, zz = float(x @ z), float(y @ z), float(z @ z)
    n = len(x)
    xx, yy, xy, xz, yz, zz = xx / n, yy / n, xy / n, xz / n, yz / n, zz / n
    mz = xx + yy
    cov = xx * yy - xy * xy
    if not cov > 1e-12 * mz * mz:
        return float(mean[0]), float(mean[1]), math.inf
    var = zz - mz * mz
    a3, a2 = 4.0 * mz, -3.0 * mz * mz - zz
    a1 = var * mz + 4.0 * cov * mz - xz * xz - yz * yz
    a0 = xz * (xz * yy - yz * xy) + yz * (yz * xx - xz * xy) - var * cov
    t, value = 0.0, a0
    for _ in range(30):  # Newton from zero runs into the smallest root
        slope = a1 + t * (2.0 * a2 + 3.0 * a3 * t)
        if slope == 0.0:
            break
        new = t - value / slope
        if not math.isfinite(new) or new == t:
            break
        at_new = a0 + new * (a1 + new * (a2 + new * a3))
        if abs(at_new) >= abs(value):
            break
        t, value = new, at_new
    det = t * t - t * mz + cov
    if abs(det) < 1e-300:
        return float(mean[0]), float(mean[1]), math.inf
    cx = (xz * (yy - t) - yz * xy) / det / 2.0
    cy = (yz * (xx - t) - xz * xy) / det / 2.0
    return float(mean[0] + cx), float(mean[1] + cy), math.sqrt(cx * cx + cy * cy + mz)


def fit_shape(cluster: Cluster, params: SceneEstimatorParams) -> ClusterShape:
    """A circle or one box that holds a cluster's points and, plausibly, the back of the thing."""
    points = cluster.points
    tolerance = 3.0 * params.range_noise
    chord = points[-1] - points[0]
    length = float(np.hypot(chord[0], chord[1]))
    off = float(_offsets(points).max()) if len(points) > 2 else 0.0
    circle = _circle(cluster, params, off, length)
    if circle is not None:
        return circle
    if off <= tolerance or len(points) < 3:
        return _box(points, math.atan2(chord[1], chord[0]), cluster, params, STRAIGHT)
    pieces = _split_points(points, tolerance)
    a, b = max(pieces, key=lambda p: float(np.hypot(*(points[p[1]] - points[p[0]]))))
    along = points[b] - points[a]
    return _box(points, math.atan2(along[1], along[0]), cluster, params, OTHER)


def _split_points(points: Array, tolerance: float) -> list[tuple[int, int]]:
    """Pieces (first, last) of a chain of points (n, 2) that are straight to ``tolerance`` [m]: split, then merge.

    Neighbouring pieces share a point, so that no surface is left out between them.
    """
    cuts, todo = {0, len(points) - 1}, [(0, len(points) - 1)]
    while todo:
        first, last = todo.pop()
        if last - first < 2:
            continue
        off = _offsets(points[first : last + 1])
        worst = int(np.argmax(off))
        if off[worst] > tolerance:
            middle = first + worst
            cuts.add(middle)
            todo += [(first, middle), (middle, last)]
    marks = sorted(cuts)
    k = 1
    while k < len(marks) - 1:  # a cut whose neighbours are in line is none
        if _offsets(points[marks[k - 1] : marks[k + 1] + 1]).max() <= tolerance:
            del marks[k]
        else:
            k += 1
    return list(pairwise(marks)) if len(marks) > 1 else [(0, 0)]


def cluster_obstacles(cluster: Cluster, params: SceneEstimatorParams, name: str) -> tuple[Obstacle, ...]:
    """Upright solids, from the floor to ``params.height``, that hold a cluster's points and their padding.

    There is one for a cluster that is round, straight, or small and bulging towards the sensor; otherwise (a room's
    corner, a curved wall) one box for every straight piece: ``name``, or ``name.0``, ``name.1``, ….
    """
    shape = fit_shape(cluster, params)
    bulging = cluster.extent <= params.max_mover_size and _bulges(cluster)
    if shape.kind in (ROUND, STRAIGHT) or bulging:
        return (_solid(shape, params, name),)
    points, pieces = cluster.points, _split_points(cluster.points, 3.0 * params.range_noise)
    solids = []
    for k, (a, b) in enumerate(pieces):
        along = points[b] - points[a]
        box = _box(points[a : b + 1], math.atan2(along[1], along[0]), cluster, params, STRAIGHT)
        solids.append(_solid(box, params, f"{name}.{k}"))
    return tuple(solids)


def _solid(shape: ClusterShape, params: SceneEstimatorParams, name: str) -> Obstacle:
    at = (*shape.center, 0.5 * params.height)
    if shape.kind == ROUND:
        return Cylinder(shape.radius + params.padding, params.height, at=at, name=name)
    size = (shape.size[0] + 2.0 * params.padding, shape.size[1] + 2.0 * params.padding, params.height)
    quat = (0.0, 0.0, math.sin(0.5 * shape.yaw), math.cos(0.5 * shape.yaw))
    return Box(np.maximum(size, 1e-3), at=at, quat=quat, name=name)


def _circle(cluster: Cluster, params: SceneEstimatorParams, off: float, length: float) -> ClusterShape | None:
    """The circle of a cluster, if it is round: enough of it is seen, all of it near a circle, on its near side."""
    points = cluster.points
    mean = points.mean(axis=0)
    view = mean - cluster.origin
    far = max(float(np.hypot(view[0], view[1])), 1e-9)
    if len(points) < 5:  # too few to fit: a thin pole
        extent = cluster.extent
        if extent > 0.25 or (len(points) > 2 and off < 0.15 * length and extent > 0.12):
            return None
        center = mean + view / far * 0.5 * extent
        radius = max(float(np.hypot(*(points - center).T).max()), 0.01)
        return ClusterShape(ROUND, (float(center[0]), float(center[1])), radius, (2.0 * radius, 2.0 * radius), 0.0)
    x, y, radius = fit_circle(points)
    if not radius <= params.max_round_radius:
        return None
    arms = points - (x, y)
    distance = np.hypot(arms[:, 0], arms[:, 1])
    error = distance - radius
    if math.sqrt(float(error @ error) / len(error)) > 1.7 * params.range_noise + 0.002:
        return None
    if (np.array([x, y]) - mean) @ view < 0.0:  # hollow towards the sensor
        return None
    if length < 0.8 * radius or off < max(2.0 * params.range_noise, 0.12 * length):  # too little of the circle is seen
        return None
    radius = max(radius, float(distance.max()))
    return ClusterShape(ROUND, (x, y), radius, (2.0 * radius, 2.0 * radius), 0.0)


def _box(points: Array, yaw: float, cluster: Cluster, params: SceneEstimatorParams, kind: str) -> ClusterShape:
    """Box along ``yaw`` that holds the points and the space behind them that the parameters say."""
    c, s = math.cos(yaw), math.sin(yaw)
    u, v = points @ (c, s), points @ (-s, c)
    u0, u1, v0, v1 = float(u.min()), float(u.max()), float(v.min()), float(v.max())
    length = u1 - u0
    thin = params.wall_thickness if length > params.max_mover_size else min(params.unseen_depth, max(length, 0.02))
    if v1 - v0 < thin:  # grow away from the sensor
        if float(cluster.origin @ (-s, c)) > 0.5 * (v0 + v1):
            v0 = v1 - thin
        else:
            v1 = v0 + thin
    mu, mv = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    center = (c * mu - s * mv, s * mu + c * mv)
    return ClusterShape(kind, center, 0.5 * math.hypot(length, v1 - v0), (length, v1 - v0), yaw)


def _bulges(cluster: Cluster) -> bool:
    """Whether a chain's middle is nearer to the sensor than the line between its ends."""
    points = cluster.points
    along = points[-1] - points[0]
    side = np.array([-along[1], along[0]])
    return float((points - points[0]).mean(axis=0) @ side) * float((cluster.origin - points[0]) @ side) > 0.0


def _offsets(points: Array) -> Array:
    """(n,) distances [m] of a chain's points from the line through its ends."""
    along = points[-1] - points[0]
    length = math.hypot(along[0], along[1])
    d = points - points[0]
    if length < 1e-9:
        return np.hypot(d[:, 0], d[:, 1])
    return np.abs(d[:, 0] * along[1] - d[:, 1] * along[0]) / length
