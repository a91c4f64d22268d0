"""Sensors room, visibility: what a planar laser can see of the world, by height and field of view, and what it cannot.

A planar laser sees one plane. What hangs over it (a table's top) or lies below it (a pallet, a kerb) is not in its
readings, and nothing that is made of them knows about it; it has to come from elsewhere: a map, another sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.perception.readings import LaserScan, ScanRays, rays_of
from elastic_strips.scene import Scene


@dataclass(frozen=True, slots=True)
class Visibility:
    """What a laser can see of an obstacle.

    Attributes:
        name: of the obstacle.
        low, high: what heights it takes up [m].
        in_plane: whether the scan's plane cuts it.
        in_view: share of its parts that the plane cuts of which the middle or a corner of the bounding box
            lies within field of view and range, 0 to 1.
        hit: whether a ray of the scan ended at it (within the tolerance of its parts' bounding boxes).
    """

    name: str
    low: float
    high: float
    in_plane: bool
    in_view: float
    hit: bool


def visible_to(points: Array, scan: LaserScan, base_pose: Any, *, thickness: float = 0.02) -> Mask:
    """Which points a scan could have seen, were nothing else there.

    Args:
        points: (n, 3) in the world [m].
        scan: whose sensor it is; its ranges do not matter.
        base_pose: (x [m], y [m], yaw [rad]) of the base.
        thickness: of the plane, to either side [m].

    Returns:
        (n,) true where a point is at the plane's height, in the field of view, and within range.
    """
    rays = rays_of(scan, base_pose)
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    _, _, inside = rays.locate(points[:, :2])
    return inside & (np.abs(points[:, 2] - rays.height) <= thickness)


def seen_obstacles(scene: Scene, scan: LaserScan, base_pose: Any, *, tolerance: float = 0.05) -> tuple[Visibility, ...]:
    """What of a true scene a scan can see, obstacle by obstacle, by the bounding boxes of their parts.

    Args:
        scene: the true one, at the scan's time.
        scan: the scan.
        base_pose: (x [m], y [m], yaw [rad]) of the base.
        tolerance: a ray that ends within this distance [m] of a part's box has hit it.
    """
    rays, table = rays_of(scan, base_pose), scene.table
    at = np.flatnonzero(rays.hits)
    ends = rays.origin + rays.ranges[at, None] * rays.way[at]
    result = []
    for k, name in enumerate(scene.names):
        rows = slice(int(table.offsets[k]), int(table.offsets[k + 1]))
        center, half = table.center[rows], table.half_extents[rows]
        low, high = center[:, 2] - half[:, 2], center[:, 2] + half[:, 2]
        cut = (low <= rays.height) & (rays.height <= high)
        result.append(
            Visibility(
                name=name,
                low=float(low.min()),
                high=float(high.max()),
                in_plane=bool(cut.any()),
                in_view=_share(rays, center[cut], half[cut]),
                hit=_hit(ends, center[cut], half[cut], tolerance),
            )
        )
    return tuple(result)


def _share(rays: ScanRays, center: Array, half: Array) -> float:
    """Share of boxes with their middle or a corner in view."""
    if not len(center):
        return 0.0
    corners = np.array([[0, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]], dtype=np.float64)
    spots = center[:, None, :2] + corners * half[:, None, :2]
    _, _, inside = rays.locate(spots.reshape(-1, 2))
    return float(inside.reshape(-1, 5).any(axis=1).mean())


def _hit(ends: Array, center: Array, half: Array, tolerance: float) -> bool:
    return any(
        bool((np.abs(ends - c[:2]) <= h[:2] + tolerance).all(axis=1).any()) for c, h in zip(center, half, strict=True)
    )
