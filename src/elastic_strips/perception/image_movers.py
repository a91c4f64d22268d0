"""What moves in images of depths and ranges: points that lie where it was surely free, grouped from above.

Because what the volume map calls free is free, a point there is evidence that something has come. Points beside it that
the map does not know as standing belong to the same thing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask

from .clusters import Cluster
from .params import SceneEstimatorParams
from .readings import DepthImage, RangeImage

_GROUP_CELL = 0.1  # [m] points in cells of this size that touch belong together, seen from above
_LEAST_EVIDENCE = 6  # points of a thing where it was free before
_LEVELS = (0.0, 0.5, 1.0)  # from the lowest to the highest place at which it is asked whether something is still there
_KEPT_POINTS = 40  # of a thing, as seen from above
_BESIDE = np.array([0.04, 0.08, 0.12])  # [m] beside a thing's end, where it is asked what hides it
_AS_FAR = 0.1  # [m] what is nearer than a thing by more than this hides it


@dataclass(frozen=True, slots=True, eq=False)
class ImageView:
    """An image in the world, as tracks are judged by it.

    Attributes:
        image: the image, without the robot.
        T_world_sensor: (4, 4) pose of its sensor.
    """

    image: DepthImage | RangeImage
    T_world_sensor: Array

    @property
    def time(self) -> float:
        """When it was taken [s]."""
        return self.image.time

    def beyond(self, points: Array, margin: float, heights: Array) -> tuple[Mask, Mask]:
        """Which places (n, 2) of the floor the image sees through where something would be, and which it does not see.

        It must look past a place by more than ``margin`` [m] at two of three heights at least, and at none end before
        or there. They lie between ``heights`` (n, 2) [m]: below what hangs, and over what is low, an image sees past.
        """
        through = np.zeros((len(_LEVELS), len(points)), dtype=np.intp)
        ends = np.zeros((len(_LEVELS), len(points)), dtype=bool)
        for k, level in enumerate(_LEVELS):
            height = heights[:, 0] + level * (heights[:, 1] - heights[:, 0])
            local = np.column_stack((points, height)) - self.T_world_sensor[:3, 3]
            distance, range_ = measured(self.image, local @ self.T_world_sensor[:3, :3])
            through[k] = range_ > distance + margin  # NaN is no answer, and neither
            ends[k] = range_ <= distance + margin
        seen = through.sum(axis=0)
        return (seen >= 2) & ~ends.any(axis=0), ~ends.any(axis=0) & (seen == 0)


def measured(image: DepthImage | RangeImage, points: Array) -> tuple[Array, Array]:
    """How far points (n, 3) in the sensor's frame are by the image's measure, and what it says along them [m].

    It says NaN where it says nothing, and beside its borders.
    """
    rows, columns = image.ranges.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(image, DepthImage):
            distance = points[:, 2]
            u = image.center[0] + image.focal[0] * points[:, 0] / distance
            v = image.center[1] + image.focal[1] * points[:, 1] / distance
            there = distance > 0.0
        else:
            flat = np.hypot(points[:, 0], points[:, 1])
            distance = np.hypot(flat, points[:, 2])
            u = (np.arctan2(points[:, 1], points[:, 0]) - image.azimuth[0]) / image.steps[0]
            v = (np.arctan2(points[:, 2], flat) - image.elevation[0]) / image.steps[1]
            if image.closed:
                u = np.mod(u, columns)
            there = np.ones(len(points), dtype=bool)
    there &= np.isfinite(u) & np.isfinite(v)
    at, row = np.rint(np.where(there, u, -1.0)).astype(np.intp), np.rint(np.where(there, v, -1.0)).astype(np.intp)
    if isinstance(image, RangeImage) and image.closed:
        at = np.where(at == columns, 0, at)
    there &= (at >= 0) & (at < columns) & (row >= 0) & (row < rows)
    out = np.full(len(points), np.nan)
    out[there] = image.ranges[row[there], at[there]]
    return distance, out


def moving_clusters(
    points: Array, evidence: Mask, standing: Mask, view: ImageView, params: SceneEstimatorParams
) -> list[Cluster]:
    """Things of which some lies where it was free before, as they are seen from above.

    Args:
        points: (n, 3) points of an image over the floor, in the world [m].
        evidence: (n,) which of them lie where it was surely free.
        standing: (n,) which of them lie on what has stood there for long.
        view: the image that they are of.
        params: sizes of what may move.
    """
    if int(evidence.sum()) < _LEAST_EVIDENCE:
        return []
    loose = np.flatnonzero(~standing)
    found = []
    for group in _groups(points[loose, :2], evidence[loose]):
        cluster = _cluster(points[loose[group]], view)
        if cluster.extent <= params.max_mover_size:
            found.append(cluster)
            continue
        # It touches what is not known to stand yet, such as a wall that was never seen before: what has come is alone.
        come = loose[group][evidence[loose[group]]]
        for part in _groups(points[come, :2], evidence[come]):
            cluster = _cluster(points[come[part]], view)
            if cluster.extent <= params.max_mover_size:
                found.append(cluster)
    return found


def _groups(flat: Array, evidence: Mask) -> list[Indices]:
    """Which of the points (n, 2) belong together, for each group that has evidence enough."""
    from scipy.ndimage import label  # late: slow to import

    if not len(flat):
        return []
    cells = np.floor(flat / _GROUP_CELL).astype(np.intp)
    cells -= cells.min(axis=0) - 1
    grid = np.zeros(cells.max(axis=0) + 2, dtype=bool)
    grid[cells[:, 0], cells[:, 1]] = True
    groups = np.empty(grid.shape, dtype=np.int32)
    label(grid, structure=np.ones((3, 3)), output=groups)
    group = groups[cells[:, 0], cells[:, 1]]
    count = np.bincount(group, weights=evidence)
    return [np.flatnonzero(group == k) for k in np.flatnonzero(count >= _LEAST_EVIDENCE)]


def _cluster(solid: Array, view: ImageView) -> Cluster:
    """A thing (n, 3), as it is seen from above."""
    origin = view.T_world_sensor[:2, 3].copy()
    away = solid[:, :2] - origin
    bearing = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    order = np.argsort(bearing, kind="stable")
    outline = _outline(solid[order, :2], bearing[order], origin)
    covered = _covered(view, solid[order[0]], -1.0), _covered(view, solid[order[-1]], 1.0)
    return Cluster(outline, origin, covered, True, solid)


def _covered(view: ImageView, end: Array, side: float) -> bool:
    """Whether a thing whose last point to one side is ``end`` (3,) may go on there, unseen: nowhere right beside it the
    image sees past it."""
    away = end[:2] - view.T_world_sensor[:2, 3]
    across = side * np.array([-away[1], away[0]]) / max(float(np.hypot(*away)), 1e-9)
    beside = np.repeat(end[None], len(_BESIDE), axis=0)
    beside[:, :2] += np.outer(_BESIDE, across)
    distance, range_ = measured(view.image, (beside - view.T_world_sensor[:3, 3]) @ view.T_world_sensor[:3, :3])
    return not bool((range_ > distance - _AS_FAR).any())  # NaN is no answer


def _outline(points: Array, bearing: Array, origin: Array) -> Array:
    """Of points (n, 2) ordered by bearing, the nearest in each of some equal parts of what they span."""
    wide = max(float(bearing[-1] - bearing[0]), 1e-9)
    part = np.minimum((bearing - bearing[0]) / wide * _KEPT_POINTS, _KEPT_POINTS - 1).astype(np.intp)
    away = np.hypot(*(points - origin).T)
    order = np.lexsort((away, part))
    first = np.concatenate(([True], np.diff(part[order]) > 0))
    return points[order[first]]
