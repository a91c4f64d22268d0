"""plan: an initial strip, by the straight line where that relaxes to a certified strip, else by OMPL.

A path that is given comes before both; a path over a grid, where it is asked for, between them: with the joints in
step, and with the arm tucked.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
import numpy.typing as npt

from ..deform import Deformer, DeformParams, DeformReport
from ..errors import ParameterError
from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Scene
from ..strip import Strip
from ..summary import Summary
from .edges import certify_path
from .ends import check_ends
from .grid_path import grid_path
from .line import straight_line
from .ompl_planner import ompl_path
from .relaxation import path_strip, relax_line, relax_path, relax_while_clearer, way_rows
from .waypoints import waypoint_rows

_log = logging.getLogger(__name__)
_FINEST = 4.0  # times as many samples on an edge as usual, at most
_MARGINS = (0.04, 0.04, 0.02, 0.02, 0.01, 0.005)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlanReport(Summary):
    """How an initial strip came about.

    Attributes:
        strip: the strip; initial: what it was relaxed from. It is certified if
            ``certified``, else the best that was reached, as it is.
        certified: whether every segment is certified.
        method: ``"path"``, ``"line"``, ``"grid"``, ``"ompl"``, or ``"none"`` where nothing was certified.
        reason: what happened, for people.
        report: the last deformation report.
        attempts: planner calls made.
        ticks: deformation ticks made.
        seconds: from nothing to the first certified strip (or to giving up).
        timings: seconds by phase: line, planner, relaxation.
    """

    strip: Strip
    initial: Strip
    certified: bool
    method: str
    reason: str
    report: DeformReport
    attempts: int
    ticks: int
    seconds: float
    timings: dict[str, float] = field(default_factory=dict)

    def _summary(self) -> dict[str, object]:
        return {
            "certified": self.certified, "method": self.method, "reason": self.reason, "robot": self.strip.robot.name,
            "nodes": len(self.strip), "attempts": self.attempts, "ticks": self.ticks, "seconds": self.seconds,
        }  # fmt: skip

    def _measured(self) -> dict[str, object]:
        return {"clearance": f"{self.report.clearance:.3f} m"}


def plan_report(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    *,
    seed: int = 0,
    params: DeformParams | None = None,
    timeout: float = 10.0,
    line_ticks: int = 6,
    deformer: Deformer | None = None,
    line: bool = True,
    path: npt.ArrayLike | None = None,
    grid: bool = False,
    watch: Callable[[DeformReport], object] | None = None,
) -> PlanReport:
    """Plan an initial strip and tell how it went.

    Args:
        robot: the robot.
        scene: the obstacles, standing still.
        start, goal: configurations (nq,).
        seed: of the planner's random numbers.
        params: of the relaxation; the default preset where None.
        timeout: longest time [s] for all planner calls.
        line_ticks: most ticks that the straight line gets.
        deformer: a workspace of the same robot to use again.
        line: whether to try the straight line at all.
        path: what to try first: waypoints (K, 2) of the base [m], or chart rows (K, nv), from start to goal.
        grid: whether to try the way that :func:`grid_path` finds before OMPL is asked; not for a fixed base.
        watch: called with every tick's report.

    Raises:
        ConfigurationError: start or goal is not sound, or in collision; names the pair.
        ParameterError: a seed, timeout or number of ticks outside its range, or a path of another shape.
    """
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ParameterError(f"seed={seed!r} must be an integer ≥ 0")
    if not timeout > 0:
        raise ParameterError(f"timeout={timeout!r} must be > 0 s")
    began = perf_counter()
    deformer = Deformer(robot, params or DeformParams()) if deformer is None else deformer
    params = deformer.params
    q_start, q_goal = check_ends(robot, scene, start, goal, params)
    spacing = min(0.13, params.max_spacing)
    timings = {"line": 0.0, "planner": 0.0, "relaxation": 0.0}
    ticks, attempts = 0, 0
    best: DeformReport | None = None
    reasons: list[str] = []

    def done(report: DeformReport, method: str, reason: str) -> PlanReport:
        return PlanReport(
            report.strip,
            initial,
            report.usable,
            method,
            reason,
            report,
            attempts,
            ticks,
            perf_counter() - began,
            timings,
        )

    def relaxed(rows: Array, *, patient: bool = True) -> tuple[Strip, DeformReport]:
        nonlocal ticks
        mark = perf_counter()
        strip = path_strip(robot, rows)
        relax = relax_path if patient else relax_while_clearer
        report = relax(deformer, strip, scene, watch=watch)
        ticks += report.ticks
        timings["relaxation"] += perf_counter() - mark
        return strip, report

    if path is not None:
        initial, report = relaxed(waypoint_rows(robot, q_start, q_goal, path, spacing=spacing))
        if report.usable:
            return done(report, "path", f"the given path relaxed to a certified strip in {report.ticks} ticks")
        reasons.append(f"given path: {report.reason}")
        best = report

    mark = perf_counter()
    rows = straight_line(robot, q_start, q_goal, spacing=spacing)
    initial = Strip.from_chart(robot, rows)
    report = relax_line(deformer, initial, scene, line_ticks if line else 0, watch)
    ticks += report.ticks if line else 0
    timings["line"] += perf_counter() - mark
    if report.usable:
        return done(report, "line", f"the straight line relaxed to a certified strip in {report.ticks} ticks")
    best = report if best is None or report.node_clearance > best.node_clearance else best
    reasons.append(f"straight line: {report.reason}")

    if grid and robot.space.planar:
        attempts += 1
        way = grid_path(robot, scene, q_start, q_goal)
        timings["planner"] += way.seconds
        if way.way is None:
            reasons.append(way.reason)
        else:
            for rows, what in way_rows(robot, q_start, q_goal, way.way, spacing):
                strip, report = relaxed(rows, patient=False)
                if report.usable:
                    initial = strip
                    return done(
                        report, "grid", f"the grid's path{what} relaxed to a certified strip in {report.ticks} ticks"
                    )
                reasons.append(f"grid's path{what}: {report.reason}")
                best = report if report.node_clearance > best.node_clearance else best

    fineness = 1.0
    for attempt in range(64):
        left = timeout - (perf_counter() - began)
        if left <= 0.0:
            break
        attempts += 1
        mark = perf_counter()
        margin = _MARGINS[min(attempt, len(_MARGINS) - 1)]
        found = ompl_path(
            robot, scene, q_start, q_goal, seed=seed + 7919 * attempt, margin=margin,
            timeout=min(left, 1.0 + 0.5 * attempt), spacing=spacing, widen=2.0 + 0.5 * (attempt % 4),
            fineness=fineness,
        )  # fmt: skip
        timings["planner"] += perf_counter() - mark
        if found.chart is None:
            reasons.append(found.reason)
            continue
        strip, report = relaxed(found.chart)
        if report.usable:
            initial = strip
            return done(report, "ompl", f"OMPL path {attempts} relaxed to a certified strip in {report.ticks} ticks")
        reasons.append(f"path {attempts}: {report.reason}")
        if fineness < _FINEST and not certify_path(deformer, scene, found.chart).certified:
            fineness *= 2.0  # the planner's samples had missed something on an edge
        best = report if report.node_clearance > best.node_clearance else best
    reason = "no certified strip: " + "; ".join(reasons[-4:])
    _log.warning("%s", reason)
    return done(best, "none", reason)


def plan(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    *,
    seed: int = 0,
    params: DeformParams | None = None,
    timeout: float = 10.0,
) -> Strip:
    """An initial strip from ``start`` to ``goal``: the straight line if it relaxes to a certified strip, else OMPL's
    path.

    Where neither gives a certified strip, the best one is returned *as it is*, a warning is logged, and every report
    on it says where it is broken; :func:`plan_report` tells all.

    Args:
        robot, scene, start, goal, seed, params, timeout: as in :func:`plan_report`.

    Raises:
        ConfigurationError: start or goal is not sound, or in collision; names the pair.
    """
    return plan_report(robot, scene, start, goal, seed=seed, params=params, timeout=timeout).strip
