"""Relaxing of first strips: how rows along a way are made, and how long each attempt gets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..deform import Deformer, DeformReport
from ..relax import project_rolling
from ..robot import BaseKind, RobotModel
from ..robot.space import Array
from ..scene import Scene
from ..strip import Strip
from .waypoints import tucked_rows, waypoint_rows

_LINE_DEPTH = (-0.15, -0.08, 0.0)  # a line whose nodes are deeper than this [m] after tick 1, 2, 3 … is given up
_TUCKED = 0.05  # [rad or m] joints that differ by less from the home posture are in it
_STUCK = 6  # most ticks in a row in which a strip gets no clearer
_GAIN = 1e-3  # [m] by which it must get clearer to count


def relax_line(
    deformer: Deformer, strip: Strip, scene: Scene, ticks: int, watch: Callable[[DeformReport], object] | None
) -> DeformReport:
    """A few ticks of the straight line; it is given up where nodes stay deep inside an obstacle."""
    report = deformer.assess(strip, scene)
    for tick in range(1, ticks + 1):
        if report.usable:
            break
        step = deformer.step(report.strip, scene, nodes=tick > 3)
        report = replace(step, ticks=tick)
        if watch is not None:
            watch(step)
        if step.node_clearance < _LINE_DEPTH[min(tick, len(_LINE_DEPTH)) - 1]:
            break  # nodes on both sides of an obstacle: more ticks would not bring them together
    return report


def way_rows(robot: RobotModel, start: Array, goal: Array, way: Array, spacing: float) -> Iterator[tuple[Array, str]]:
    """Chart rows (N, nv) to relax along a way (K, 2) of the base, with what is particular about them.

    The joints move in step with the base; and, where start or goal is in another posture than home, the robot folds
    into that one for the drive.
    """
    yield waypoint_rows(robot, start, goal, way, spacing=spacing), ""
    joints = robot.space.to_chart(np.stack((robot.home_q, start, goal)))[:, robot.space.base_nv :]
    if np.abs(joints[1:] - joints[0]).max(initial=0.0) > _TUCKED:
        yield tucked_rows(robot, start, goal, way, spacing=spacing), " with the arm tucked"


def path_strip(robot: RobotModel, chart: Array) -> Strip:
    """A planner's waypoints (N, nv) as a strip; drivable for a differential drive."""
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        chart, _ = project_rolling(robot.space, chart)
    return Strip.from_chart(robot, chart)


def relax_path(
    deformer: Deformer,
    strip: Strip,
    scene: Scene,
    *,
    max_ticks: int = 30,
    extra_ticks: int = 4,
    watch: Callable[[DeformReport], object] | None = None,
) -> DeformReport:
    """Relax a strip until it is certified, and a few ticks more where it is still very near an obstacle."""
    report = deformer.settle(strip, scene, until="certified", max_ticks=max_ticks, watch=watch)
    return _cleared(deformer, report, scene, extra_ticks, watch)


def relax_while_clearer(
    deformer: Deformer,
    strip: Strip,
    scene: Scene,
    *,
    max_ticks: int = 30,
    extra_ticks: int = 4,
    over: Callable[[], bool] = lambda: False,
    watch: Callable[[DeformReport], object] | None = None,
) -> DeformReport:
    """As :func:`relax_path`, but given up where the strip gets no clearer for some ticks, or ``over()`` says so.

    A strip that is broken on both sides of something grows nodes and gets slower with each tick that it is given.
    """
    clearest, since, ticks = -np.inf, 0, 0
    while True:
        report = replace(deformer.step(strip, scene), ticks=ticks + 1)
        ticks, strip = ticks + 1, report.strip
        if watch is not None:
            watch(report)
        since = 0 if report.node_clearance > clearest + _GAIN else since + 1
        clearest = max(clearest, report.node_clearance)
        if report.usable:
            return _cleared(deformer, report, scene, extra_ticks, watch)
        rest = report.moved < deformer.params.rest_step
        if rest or since >= _STUCK or ticks >= max_ticks or over():
            return replace(report, reason=f"{report.reason} (after {ticks} ticks)")


def _cleared(
    deformer: Deformer, report: DeformReport, scene: Scene, ticks: int, watch: Callable[[DeformReport], object] | None
) -> DeformReport:
    """A few ticks more where a certified strip is still very near an obstacle."""
    for _ in range(ticks):
        if not report.usable or report.node_clearance >= deformer.params.near:
            break
        further = deformer.step(report.strip, scene)
        if watch is not None:
            watch(further)
        if not further.usable or further.node_clearance <= report.node_clearance:
            break
        report = replace(further, ticks=report.ticks + 1, reason=report.reason)
    return report
