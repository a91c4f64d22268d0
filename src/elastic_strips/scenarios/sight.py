"""Scenarios room, sight: whether what a robot touched had been seen by its sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..execution import Record, Verdict
from ..robot import RobotModel
from ..scene import World
from ..sensing import LaserParams, LaserScan, SensorConfig, SensorSuite, seen_obstacles

_LOOK_BACK = 1.0  # [s] before a contact
_STEP = 0.1  # [s]


def unseen_contacts(
    record: Record, verdict: Verdict, robot: RobotModel, world: World, sensors: SensorConfig
) -> tuple[str, ...]:
    """Obstacles that were touched without a ray of a laser having met them in the second before, noise aside.

    What a planar scan cannot see (what hangs over its plane, lies below it, or comes from behind) is no failure of what
    is made of the scan; it is to be told apart.

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
    names = dict.fromkeys(contact.obstacle for contact in verdict.contacts)
    if not names or not lasers:
        return tuple(names)
    suite = SensorSuite(robot, world, SensorConfig(sensors=lasers, self_padding=sensors.self_padding))
    rows = record.control
    unseen = []
    for name in names:
        first = min(contact.time for contact in verdict.contacts if contact.obstacle == name)
        times = np.arange(max(first - _LOOK_BACK, float(rows.time[0])), first + 1e-9, _STEP)
        for t in times.tolist():
            chart = rows.chart[min(int(np.searchsorted(rows.time, t)), len(rows.time) - 1)]
            suite.reset(t)
            scene = world.at(t)
            scans = [scan for scan in suite.observe(t, chart) if isinstance(scan, LaserScan)]
            if any(v.hit for scan in scans for v in seen_obstacles(scene, scan, chart[:3]) if v.name == name):
                break
        else:
            unseen.append(name)
    return tuple(unseen)
