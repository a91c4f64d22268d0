"""Visibility: which obstacles of the true world a robot's sensors can see, and which contacts were with unseen ones.

A planar laser sees one plane. Obstacles above it (a table's top) or below it (a pallet, a kerb) are not in its
readings; they have to be known from a map or another sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.control.record import Record
from elastic_strips.perception.body_mask import BodyMask
from elastic_strips.perception.readings import (
    DepthImage,
    LaserScan,
    RangeImage,
    Reading,
    ScanRays,
    pose_matrix,
    rays_of,
)
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.sim.sensors import DepthParams, LaserParams, LidarParams, SensorConfig, SensorSuite

from .drive_evaluation import Contact, Evaluation


@dataclass(frozen=True, slots=True)
class Visibility:
    """Visibility of an obstacle to a laser.

    Attributes:
        name: name of the obstacle.
        low, high: its range of heights [m].
        in_plane: whether the scan's plane cuts it.
        in_view: share of those of its parts that the plane cuts whose bounding box has its middle or a corner
            within field of view and range, 0 to 1.
        hit: whether a ray of the scan ended at it (within the tolerance of its parts' bounding boxes).
    """

    name: str
    low: float
    high: float
    in_plane: bool
    in_view: float
    hit: bool


def visible_to(points: Array, scan: LaserScan, base_pose: ArrayLike, *, thickness: float = 0.02) -> Mask:
    """Which points a scan could have seen without occlusion.

    Args:
        points: (n, 3) points in the world [m].
        scan: a scan of the sensor; its ranges do not matter.
        base_pose: (x [m], y [m], yaw [rad]) of the base.
        thickness: thickness of the plane, to either side [m].

    Returns:
        (n,) true where a point is at the plane's height, in the field of view, and within range.
    """
    rays = rays_of(scan, base_pose)
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    _, _, inside = rays.locate(points[:, :2])
    return inside & (np.abs(points[:, 2] - rays.height) <= thickness)


def seen_obstacles(
    scene: Scene, scan: LaserScan, base_pose: ArrayLike, *, tolerance: float = 0.05
) -> tuple[Visibility, ...]:
    """Visibility of each obstacle of a true scene to a scan, by the bounding boxes of their parts.

    Args:
        scene: the true scene at the scan's time.
        scan: the scan.
        base_pose: (x [m], y [m], yaw [rad]) of the base.
        tolerance: a ray that ends within this distance [m] of a part's box has hit it.
    """
    rays, table = rays_of(scan, base_pose), scene.table
    at = np.flatnonzero(rays.hits)
    ends = rays.origin + rays.ranges[at, None] * rays.direction[at]
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


_LOOK_BACK = 1.0  # [s] before a contact
_LOOK_STEP = 0.1  # [s]
_AT_IT = 0.02  # [m] a pixel that ends within this distance of a part's box has met it
_LEAST_PIXELS = 6


def unseen_contacts(
    record: Record, evaluation: Evaluation, robot: RobotModel, world: World, sensors: SensorConfig
) -> tuple[Contact, ...]:
    """Contacts with obstacles that had not been in view, without regard to noise.

    An obstacle was in view if it was met in at least half of the looks in the second before the contact: by a ray of a
    laser, the middle of a moving one being within its field of view, or by some pixels of an image. What no sensor can
    see (above or below a scan's plane, behind the robot or its arm) is no failure of their processing.

    Args:
        record, evaluation: record and evaluation of the run.
        robot: the robot that drove.
        world: the true obstacles.
        sensors: the robot's sensors; rings do not count.
    """
    exact: list[LaserParams | DepthParams | LidarParams] = []
    for sensor in sensors.sensors:
        if isinstance(sensor, LaserParams):
            exact.append(replace(sensor, noise=0.0, noise_ratio=0.0, dropout=0.0, latency=0.0))
        elif isinstance(sensor, (DepthParams, LidarParams)):
            no_noise = replace(sensor, noise=0.0, noise_ratio=0.0, noise_growth=0.0, bias=0.0, bias_ratio=0.0)
            exact.append(replace(no_noise, dropout=0.0, edge_dropout=0.0, latency=0.0))
    if not evaluation.contacts or not exact:
        return evaluation.contacts
    suite = SensorSuite(robot, world, SensorConfig(sensors=tuple(exact), self_padding=sensors.self_padding))
    rows, mask = record.control, BodyMask(robot)
    unseen = []
    for contact in evaluation.contacts:
        name, first = contact.obstacle, contact.time
        times = np.arange(max(first - _LOOK_BACK, float(rows.time[0])), first + 1e-9, _LOOK_STEP)
        looks = []
        for t in times.tolist():
            coordinates = rows.coordinates[min(int(np.searchsorted(rows.time, t)), len(rows.time) - 1)]
            suite.reset(t)
            readings, scene = suite.observe(t, coordinates), world.at(t)
            looks.append(name in scene and any(_in_view(scene, name, x, coordinates[:3], mask) for x in readings))
        if sum(looks) < 0.5 * len(looks):
            unseen.append(contact)
    return tuple(unseen)


def _in_view(scene: Scene, name: str, reading: Reading, base_pose: Array, mask: BodyMask) -> bool:
    obstacle = scene.obstacle(name)
    if isinstance(reading, (DepthImage, RangeImage)):
        T, alone = pose_matrix(base_pose), Scene([obstacle], time=scene.time).table
        ends = mask.without(reading).points() @ T[:3, :3].T + T[:3, 3]
        near = np.zeros(len(ends), dtype=bool)
        for center, half in zip(alone.center, alone.half_extents, strict=True):
            near |= (np.abs(ends - center) <= half + _AT_IT).all(axis=1)
        return int(near.sum()) >= _LEAST_PIXELS
    if not isinstance(reading, LaserScan):
        return False
    if obstacle.motion is not None:
        _, _, inside = rays_of(reading, base_pose).locate(obstacle.pose[None, :2, 3])
        if not inside[0]:
            return False
    return any(v.hit for v in seen_obstacles(Scene([obstacle], time=scene.time), reading, base_pose))
