"""Scenarios room, sight: whether what a robot touched had been seen by its sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.execution import Record
from elastic_strips.perception import LaserScan, rays_of
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World

from ..sensors import LaserParams, SensorConfig, SensorSuite
from .laser_view import seen_obstacles
from .verdict import Contact, Verdict

_LOOK_BACK = 1.0  # [s] before a contact
_STEP = 0.1  # [s]


def unseen_contacts(
    record: Record, verdict: Verdict, robot: RobotModel, world: World, sensors: SensorConfig
) -> tuple[Contact, ...]:
    """The contacts with what had not been in view, noise aside.

    In view is what a ray of a laser met in at least half of the looks in the second before the contact; of what moves,
    only the looks count in which its middle lay within the laser's field of view as well. What a planar scan cannot see
    (what hangs over its plane, lies below it, or comes from behind) is no failure of what is made of the scan; it is to
    be told apart.

    Args:
        record, verdict: of the run.
        robot: that drove.
        world: the true obstacles.
        sensors: the robot's; only its lasers count.
    """
    lasers = tuple(
        replace(sensor, noise=0.0, noise_ratio=0.0, dropout=0.0, latency=0.0)
        for sensor in sensors.sensors
        if isinstance(sensor, LaserParams)
    )
    if not verdict.contacts or not lasers:
        return verdict.contacts
    suite = SensorSuite(robot, world, SensorConfig(sensors=lasers, self_padding=sensors.self_padding))
    rows = record.control
    unseen = []
    for contact in verdict.contacts:
        name, first = contact.obstacle, contact.time
        times = np.arange(max(first - _LOOK_BACK, float(rows.time[0])), first + 1e-9, _STEP)
        looks = []
        for t in times.tolist():
            chart = rows.chart[min(int(np.searchsorted(rows.time, t)), len(rows.time) - 1)]
            suite.reset(t)
            scans = [scan for scan in suite.observe(t, chart) if isinstance(scan, LaserScan)]
            scene = world.at(t)
            looks.append(name in scene and any(_in_view(scene, name, scan, chart[:3]) for scan in scans))
        if sum(looks) < 0.5 * len(looks):
            unseen.append(contact)
    return tuple(unseen)


def _in_view(scene: Scene, name: str, scan: LaserScan, base_pose: Array) -> bool:
    obstacle = scene.obstacle(name)
    if obstacle.motion is not None:
        _, _, inside = rays_of(scan, base_pose).locate(obstacle.pose[None, :2, 3])
        if not inside[0]:
            return False
    return any(v.hit for v in seen_obstacles(Scene([obstacle], time=scene.time), scan, base_pose))
