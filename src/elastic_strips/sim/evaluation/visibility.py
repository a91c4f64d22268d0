"""Visibility: which obstacles of the true world a robot's sensors can see, and which contacts were with unseen ones.

A planar laser sees one plane. Obstacles above it (a table's top) or below it (a pallet, a kerb) are not in its
readings; they have to be known from a map or another sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
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
    return bool(_at_boxes(ends, center[:, :2], half[:, :2], tolerance).any())


def _at_boxes(ends: Array, center: Array, half: Array, tolerance: float) -> Mask:
    """Which ends of rays (n, d) lie within a distance [m] of one of some boxes (b, d)."""
    at = np.zeros(len(ends), dtype=bool)
    for c, h in zip(center, half, strict=True):
        at |= (np.abs(ends - c) <= h + tolerance).all(axis=1)
    return at


_LOOK_BACK = 1.0  # [s] before a contact
_LOOK_STEP = 0.1  # [s]
_AT_IT, _AT_BOX = 0.02, 0.05  # [m] a pixel, or a laser's ray, that ends so near to a part's box has met it
_LEAST_PIXELS = 6
_ABOUT_SPOT = 0.6  # [m] from the link that touched it, within which that has to be, of what stands still


def unseen_contacts(
    record: Record,
    evaluation: Evaluation,
    robot: RobotModel,
    world: World,
    sensors: SensorConfig,
    *,
    glass: Callable[[float], Collection[str]] | None = None,
) -> tuple[Contact, ...]:
    """Contacts with obstacles that had not been in view, without regard to noise.

    An obstacle was in view if it was met in at least half of the looks in the second before the contact: by a ray of a
    laser, the middle of a moving one being within its field of view, or by some pixels of an image. One that stands
    still has to be met near the place of the contact: of a long wall, much is always in view. What no sensor can see
    (above or below a scan's plane, behind the robot or its arm) is no failure of their processing.

    Args:
        record, evaluation: record and evaluation of the run.
        robot: the robot that drove.
        world: the true obstacles.
        sensors: the robot's sensors; rings do not count.
        glass: time [s] → names of the obstacles that light passes through then.
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

    def coordinates_at(t: float) -> Array:
        return rows.coordinates[min(int(np.searchsorted(rows.time, t)), len(rows.time) - 1)]

    unseen = []
    for contact in evaluation.contacts:
        name, first = contact.obstacle, contact.time
        times = np.arange(max(first - _LOOK_BACK, float(rows.time[0])), first + 1e-9, _LOOK_STEP)
        looks, spot = [], None
        if name in world.at(first) and world.at(first).obstacle(name).motion is None:
            spot = _place_of(robot, contact.link, coordinates_at(first))
        for t in times.tolist():
            coordinates = coordinates_at(t)
            suite.reset(t)
            suite.obstacles.make_of_glass(() if glass is None else glass(t))
            readings, scene = suite.observe(t, coordinates), world.at(t)
            looks.append(name in scene and any(_in_view(scene, name, x, coordinates[:3], mask, spot) for x in readings))
        if sum(looks) < 0.5 * len(looks):
            unseen.append(contact)
    return tuple(unseen)


def _place_of(robot: RobotModel, piece: str, coordinates: Array) -> Array:
    """(2,) where the link of a collision piece is; the base's place where there is no such piece [m]."""
    links = next((each.links for each in robot.geometries if each.name == piece), ())
    if not links:
        return coordinates[:2]
    return robot.frame_pose(robot.space.from_coordinates(coordinates), links[0])[:2, 3]


def _in_view(scene: Scene, name: str, reading: Reading, base_pose: Array, mask: BodyMask, spot: Array | None) -> bool:
    """Whether a reading meets an obstacle, near the place (2,) in question where there is one."""
    obstacle = scene.obstacle(name)
    table = Scene([obstacle], time=scene.time).table
    cut = np.ones(len(table), dtype=bool)  # which of its parts can be met
    if isinstance(reading, (DepthImage, RangeImage)):
        T, least, tolerance, columns = pose_matrix(base_pose), _LEAST_PIXELS, _AT_IT, slice(3)
        ends = mask.without(reading).points() @ T[:3, :3].T + T[:3, 3]
    elif isinstance(reading, LaserScan):
        rays, least, tolerance, columns = rays_of(reading, base_pose), 1, _AT_BOX, slice(2)
        if obstacle.motion is not None and not rays.locate(obstacle.pose[None, :2, 3])[2][0]:
            return False
        hit = np.flatnonzero(rays.hits)
        ends = rays.origin + rays.ranges[hit, None] * rays.direction[hit]
        cut &= np.abs(table.center[:, 2] - rays.height) <= table.half_extents[:, 2]
    else:
        return False
    if spot is not None:
        ends = ends[np.hypot(*(ends[:, :2] - spot).T) <= _ABOUT_SPOT]
    met = _at_boxes(ends, table.center[cut][:, columns], table.half_extents[cut][:, columns], tolerance)
    return int(met.sum()) >= least
