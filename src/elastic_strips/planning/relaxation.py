"""Relaxing of first strips: how rows along a way are made, and how long each attempt gets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array

from ..robot import BaseKind, RobotModel
from ..scene import Scene
from ..strip import Deformer, DeformReport, DeformStatus, Strip
from ..strip.report import settled_report
from ..strip.solver import project_rolling
from .line import tucked_rows, waypoint_rows

_LINE_DEPTH = (-0.15, -0.08, 0.0)  # a line whose nodes are deeper than this [m] after tick 1, 2, 3 … is given up
_TUCKED = 0.05  # [rad or m] joints that differ by less from the home posture are in it
_STUCK = 6  # most ticks in a row in which a strip gets no clearer
_GAIN = 1e-3  # [m] by which it must get clearer to count


def relax_line(
    deformer: Deformer,
    strip: Strip,
    scene: Scene,
    ticks: int,
    watch: Callable[[DeformReport], object] | None,
    *,
    over: Callable[[], bool] = lambda: False,
) -> DeformReport:
    """A few ticks of the straight line; it is given up where nodes stay deep inside an obstacle, or ``over()``."""
    report = deformer.assess(strip, scene)
    for tick in range(1, ticks + 1):
        if report.usable or over():
            break
        step = deformer.step(report.strip, scene, nodes=tick > 3)
        report = replace(step, ticks=tick)
        if watch is not None:
            watch(step)
        if step.node_clearance < _LINE_DEPTH[min(tick, len(_LINE_DEPTH)) - 1]:
            break  # nodes on both sides of an obstacle: more ticks would not bring them together
    return report


def way_rows(
    robot: RobotModel, start: Array, goal: Array, way: Array, spacing: float, most: int | None = None
) -> Iterator[tuple[Array, str]]:
    """Chart rows (N, nv) to relax along a way (K, 2) of the base, with what is particular about them.

    The joints move in step with the base; and, where start or goal is in another posture than home, the robot folds
    into that one for the drive. Where that took more than ``most`` rows, they are further apart.
    """

    def rows(make: Callable[..., Array]) -> Array:
        return at_most(lambda apart: make(robot, start, goal, way, spacing=apart), spacing, most)

    yield rows(waypoint_rows), ""
    joints = robot.space.to_chart(np.stack((robot.home_q, start, goal)))[:, robot.space.base_nv :]
    if np.abs(joints[1:] - joints[0]).max(initial=0.0) > _TUCKED:
        yield rows(tucked_rows), " with the arm tucked"


def at_most(make: Callable[[float], Array], spacing: float, most: int | None) -> Array:
    """``most`` of the rows that ``make(spacing)`` gives (all where None), further apart where there were more."""
    rows = make(spacing)
    for _ in range(6):
        if most is None or len(rows) <= most:
            return rows
        spacing *= 1.02 * len(rows) / most
        rows = make(spacing)
    keep = np.linspace(0, len(rows) - 1, most or len(rows)).round().astype(int)  # turns and folds are too many
    return rows if most is None or len(rows) <= most else rows[keep]


def path_strip(robot: RobotModel, chart: Array, ends: Array) -> Strip:
    """A planner's waypoints (N, nv) as a strip between start and goal (2, nq); drivable for a differential drive."""
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        chart, _ = project_rolling(robot.space, chart)
    return Strip.from_chart(robot, chart, ends=ends)


def relax_path(
    deformer: Deformer,
    strip: Strip,
    scene: Scene,
    *,
    max_ticks: int = 30,
    extra_ticks: int = 4,
    stuck: int | None = None,
    over: Callable[[], bool] = lambda: False,
    watch: Callable[[DeformReport], object] | None = None,
) -> DeformReport:
    """Relax a strip until it is certified, and a few ticks more where it is still very near an obstacle.

    It is given up at rest, after ``max_ticks``, after ``stuck`` ticks in a row in which it got no clearer (None: not
    for that), or where ``over()`` says so.
    """
    clearest, since, ticks = -np.inf, 0, 0
    timings: dict[str, float] = {}
    seconds, queries = 0.0, 0
    while True:
        report = deformer.step(strip, scene)
        ticks, strip = ticks + 1, report.strip
        seconds, queries = seconds + report.seconds, queries + report.queries
        for phase, value in report.timings.items():
            timings[phase] = timings.get(phase, 0.0) + value
        if watch is not None:
            watch(report)
        since = 0 if report.node_clearance > clearest + _GAIN else since + 1
        clearest = max(clearest, report.node_clearance)
        rest = report.status is not DeformStatus.DEFORMING
        hopeless = rest or ticks >= max_ticks or (stuck is not None and since >= stuck) or over()
        if report.usable or hopeless:
            ended = settled_report(report, ticks, timings, seconds, queries)
            return _cleared(deformer, ended, scene, extra_ticks, over, watch) if report.usable else ended


def relax_while_clearer(
    deformer: Deformer,
    strip: Strip,
    scene: Scene,
    *,
    max_ticks: int = 30,
    over: Callable[[], bool] = lambda: False,
    watch: Callable[[DeformReport], object] | None = None,
) -> DeformReport:
    """As :func:`relax_path`, but given up where the strip gets no clearer for some ticks.

    A strip that is broken on both sides of something grows nodes and gets slower with each tick that it is given.
    """
    return relax_path(deformer, strip, scene, max_ticks=max_ticks, stuck=_STUCK, over=over, watch=watch)


def _cleared(
    deformer: Deformer,
    report: DeformReport,
    scene: Scene,
    ticks: int,
    over: Callable[[], bool],
    watch: Callable[[DeformReport], object] | None,
) -> DeformReport:
    """A few ticks more where a certified strip is still very near an obstacle."""
    for _ in range(ticks):
        if not report.usable or report.node_clearance >= deformer.params.near or over():
            break
        further = deformer.step(report.strip, scene)
        if watch is not None:
            watch(further)
        if not further.usable or further.node_clearance <= report.node_clearance:
            break
        report = replace(further, ticks=report.ticks + 1, reason=report.reason)
    return report
