"""Replanning benchmark: the nearest obstacle is pushed towards the strip, which has to be certified again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.deform import Deformer, DeformReport
from elastic_strips.proximity import BodySet
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.tunnel import strip_clearance

from .measure import machine, percentiles
from .plan import planned_corridors

PUSH = 0.05
"""How far the obstacle is pushed each time [m]."""
PUSHES = 4
_MAX_TICKS = 40


def bench_replan(robot: RobotModel, seeds: int, step: Callable[[str], object] = lambda note: None) -> dict[str, Any]:
    """From each certified corridor strip: push the nearest obstacle 5 cm towards it, 4 times; time to certified again.

    The time is that of all ticks from the push to the first certified strip, one tick at least. The jump is the largest
    displacement of any control point at the same node (or, where nodes came or went, at the same share of the path).
    """
    runs = []
    for seed, scene, report in planned_corridors(robot, seeds, step):
        if not report.certified:
            continue
        deformer = Deformer(robot)
        strip = deformer.settle(report.strip, scene, max_ticks=10).strip
        for push in range(PUSHES):
            moved = push_nearest(deformer, strip, scene)
            if moved is None:
                break
            scene = moved
            before = strip
            seconds, ticks, last = _recover(deformer, strip, scene)
            strip = last.strip
            runs.append(
                {
                    "seed": seed,
                    "push": push,
                    "certified": last.certified,
                    "ms": 1e3 * seconds,
                    "ticks": ticks,
                    "jump_m": jump(robot, before, strip),
                    "clearance_m": float(strip_clearance(strip, scene)),
                    "reason": last.reason,
                }
            )
            if not last.certified:
                break
    good = [r for r in runs if r["certified"]]
    return {
        "benchmark": "replan",
        "machine": machine(),
        "robot": robot.name,
        "seeds": seeds,
        "pushes": len(runs),
        "certified": len(good) / max(len(runs), 1),
        "time_to_certified_ms": percentiles([r["ms"] for r in good]),
        "ticks": percentiles([r["ticks"] for r in good]),
        "jump_m": percentiles([r["jump_m"] for r in good]),
        "clearance_m": {"min": min((r["clearance_m"] for r in good), default=None)},
        "failures": [r for r in runs if not r["certified"]],
        "runs": runs,
    }


def _recover(deformer: Deformer, strip: Strip, scene: Scene) -> tuple[float, int, DeformReport]:
    seconds = 0.0
    for tick in range(1, _MAX_TICKS + 1):
        report = deformer.step(strip, scene)
        strip = report.strip
        seconds += report.seconds
        if report.certified:
            return seconds, tick, report
    return seconds, _MAX_TICKS, report


def push_nearest(deformer: Deformer, strip: Strip, scene: Scene, distance: float = PUSH) -> Scene | None:
    """The scene with the obstacle nearest to the strip moved ``distance`` [m] towards it; None where none is near."""
    deformer.assess(strip, scene)
    contacts = deformer.workspace.obstacles.contacts()
    # what is nearest to the ends, which cannot give way, is left alone
    inner = (contacts.node > 0) & (contacts.node < len(strip) - 1)
    ends = {int(p) for p in contacts.part[~inner]}
    free = np.array([i and int(p) not in ends for i, p in zip(inner, contacts.part, strict=True)], dtype=bool)
    if not free.any():
        return None
    k = np.flatnonzero(free)[int(np.argmin(contacts.distance[free]))]
    name = deformer.workspace.obstacles.obstacle_name(int(contacts.part[k]))
    pose = scene.obstacle(name).pose.copy()
    pose[:3, 3] += distance * contacts.direction[k]
    return scene.moved(name, pose)


def jump(robot: RobotModel, before: Strip, after: Strip) -> float:
    """Largest displacement [m] of any control point between two strips."""
    one, two = _points(robot, before.chart), _points(robot, after.chart)
    if len(one) != len(two):
        count = max(len(one), len(two))
        one, two = _resampled(one, count), _resampled(two, count)
    return float(np.linalg.norm(one - two, axis=2).max())


def _points(robot: RobotModel, chart: Array) -> Array:
    kin = Kinematics(robot.tree, len(chart))
    kin.update(chart, jacobians=False)
    return BodySet.control_points(robot).capsule_ends(kin)[:, :, 0]


def _resampled(points: Array, count: int) -> Array:
    along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points[:, 0], axis=0), axis=1))]
    along = along / along[-1] if along[-1] > 0 else np.linspace(0, 1, len(points))
    at = np.linspace(0, 1, count)
    flat = points.reshape(len(points), -1)
    return np.column_stack([np.interp(at, along, c) for c in flat.T]).reshape(count, *points.shape[1:])
