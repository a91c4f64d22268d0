"""The search for a plan: one kind of path after the other, each relaxed until it is certified, and why each was not."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import plural
from elastic_strips.robot import BaseKind, PlanarFootprint, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformParams, DeformReport, Strip
from elastic_strips.strip.report import SLIP_LIMIT

from .grid_path import MOST_CELLS, grid_path
from .initial_strip import STUCK_TICKS, PathSearch, forward_rows, line_strip, path_rows, path_strip, staged_rows
from .joint_search import PLANNERS, divided, search_joints
from .ompl_planner import certify_path
from .problem import SEED_STRIDE, Deadline, PlanningProblem, Region
from .report import PlanReport
from .validity import Checker, SatisfyingChecker, ValidityChecker

_log = logging.getLogger(__name__)
_MOST_FINENESS = 4.0  # times as many samples on an edge as usual, at most
_SEARCH_MARGINS = (0.04, 0.04, 0.02, 0.02, 0.01, 0.005)
_GRID_SHARE = 0.5  # of the time that is left goes to the grid, at most; the rest is OMPL's
_MOST_CALLS = 64  # of OMPL
_CELLS_PER_SECOND = 150_000  # that a slow machine searches
_EDGE_STEP = 0.08  # [m] that a point moves at most between looks at a motion of the joints, to begin with
_JOINT_NODE_SPACING = 0.4  # [m or rad] of the nodes along a path of the joints
_MOST_TOUCHING = (
    0.2  # of the nodes along a path that touch something; where there are more, relaxing is not tried first
)
_STAGING_TRIES = 2  # tries of each posture
_LONGEST_STAGE_SEARCH = 0.3  # [s] longest search for a path of the joints at either end of a drive
_FIRST_SEARCH, _SEARCH_GROWTH = 0.3, 1.5  # [s], and each search that finds nothing is followed by a longer one
_FIRST_GRID_REACH = 3.0  # [m] the first grid reaches so far beyond start and goal


class PlanSearch(PathSearch):
    """Tries one kind of path after another; each method returns the report of a certified strip, or None."""

    def __init__(self, problem: PlanningProblem, watch: Callable[[DeformReport], object] | None) -> None:
        super().__init__(problem, watch)
        self.robot: RobotModel = problem.robot
        self.scene: Scene = problem.scene
        self.deformer: Deformer = problem.deformer
        self.params: DeformParams = problem.params
        self.deadline: Deadline = problem.deadline
        self.region: Region | None = problem.region
        self.reasons: list[str] = []
        self.best: DeformReport | None = None
        self.hit: str = ""  # what was last in the way
        self.initial: Strip | None = None
        self.line_touching: float = 0.0  # share of the straight line's nodes that touch something
        self.line_tried: bool = False
        self.walled_in: str = ""  # what stands about goal or start
        self.box: tuple[Array, Array] | None = None  # where the base was last looked for
        self.paths: dict[float | None, Array | None] = {}  # the grid's, by the radius that fits
        self.relaxed_paths: set[float | None] = set()
        self.put_off: bool = False  # whether a path is longer than others should be looked for first
        self.calls: int = 0  # of OMPL
        self.searches: int = 0  # of OMPL
        self.fineness: float = 1.0

    def at_once(self, longest: float, *, line: bool, grid: bool) -> PlanReport | None:
        """What needs little: the straight line as it is, or relaxed where the base is clear all along it and only the
        joints' links are in the way; or else the path over a grid as it is.

        A path longer than ``longest`` [m] is put off.
        """
        initial = self.initial = line_strip(self.problem)  # shown where nothing is certified
        if self.problem.constraint is not None:
            return None
        rows, report, checker = initial.coordinates, None, self._valid[0]
        touching = ~checker.each(rows)
        self.line_touching = float(touching.mean())
        if not touching.any():
            report = self.as_found(rows, "line", "straight line")
        elif line and checker.each(rows[touching], base=True).all():
            report = self.straight(line)
        if grid and report is None:
            path = self._path(None, longest, self._grid_over())
            report = None if path is None else self._clear(path)
        return report

    def straight(self, relax: bool) -> PlanReport | None:
        """The straight line, which gets a few ticks, or is looked at as it is; once."""
        if self.line_tried:
            return None
        self.line_tried = True
        initial = self.initial = line_strip(self.problem)
        hopeless = self.hopeless(initial)
        if not hopeless and self._joints_move and self.line_touching > _MOST_TOUCHING:
            hopeless = f"the robot touches something for {100 * self.line_touching:.0f} % of the way"
        if hopeless:
            self.reasons.append(f"straight line: {hopeless}")
            return None
        report = self.relax_line(initial, relax)
        self.ticks += report.ticks if relax else 0
        return self._judged(initial, report, "line", "straight line")

    def over_the_grid(self, longest: float) -> PlanReport | None:
        """The path over a grid: first as narrow as the base, then, where that did not do, as wide as the robot.

        A path longer than ``longest`` [m] is put off.
        """
        over = self._grid_over()
        assert self.problem.region is not None
        narrowest = PlanarFootprint.of(self.robot, self.problem.start).inner
        for inner in (None, narrowest + self.params.clearance, self.problem.region.folded + self.params.clearance):
            path = self._path(inner, longest, over)
            if path is None:
                return None  # nor is there a wider one
            if inner in self.relaxed_paths:
                continue
            self.relaxed_paths.add(inner)
            report = (None if inner is None else self._clear(path)) or self._along(path, over)
            if report is not None or over():
                return report
        return None

    def _grid_over(self) -> Callable[[], bool]:
        return self.deadline.within(_GRID_SHARE * self.deadline.left).over

    def _path(self, inner: float | None, longest: float, over: Callable[[], bool]) -> Array | None:
        """The grid's path (K, 2) where a disc of this radius fits; None where there is none, or it is put off."""
        if inner not in self.paths:
            self.paths[inner] = self._grid_path(inner, over)
        path = self.paths[inner]
        self.put_off = path is not None and float(np.hypot(*np.diff(path, axis=0).T).sum()) > longest
        return None if self.put_off else path

    def _clear(self, path: Array) -> PlanReport | None:
        """A strip along a path (K, 2) of the base whose nodes are clear and that is certified as it is."""
        for rows, what in path_rows(self.problem, path) if self.problem.constraint is None else ():
            report = self.as_found(rows, "grid", f"grid's path{what}") if self._touching(rows) == 0.0 else None
            if report is not None:
                return report
        return None

    def _along(self, path: Array, over: Callable[[], bool]) -> PlanReport | None:
        """A strip along a path (K, 2) of the base: relaxed where few of its nodes touch, else with the
        joints' own paths where the base stands; after that the others are relaxed as well."""
        late = []
        for rows, what in path_rows(self.problem, path):
            if what or self._touching(rows) > _MOST_TOUCHING:
                late.append((rows, what))
                continue
            report = self.relaxed(rows, "grid", f"grid's path{what}", STUCK_TICKS, over)
            if report is not None or over():
                return report
        report = self.in_stages(path)
        for rows, what in late:
            if report is None and not over():
                report = self.relaxed(rows, "grid", f"grid's path{what}", STUCK_TICKS, over)
        return report

    def _grid_path(self, inner: float | None, over: Callable[[], bool]) -> Array | None:
        """A path (K, 2) on the smallest grid that has one."""
        problem = self.problem
        none = "the time ran out before the grid was searched"
        for box in self.region.boxes(_FIRST_GRID_REACH) if self.region else ():
            if over():
                break
            self.attempts += 1
            self.box = box
            cells = int(min(MOST_CELLS, _CELLS_PER_SECOND * max(self.deadline.left, 0.0)))
            with self.timed("planner"):
                found = grid_path(
                    self.robot,
                    self.scene,
                    problem.start,
                    problem.goal,
                    box=box,
                    inner=inner,
                    most_cells=cells,
                    over=over,
                )
            if found.points is not None:
                return found.points
            if inner is None:  # of a larger disc than the robot's it says nothing of the robot
                self.walled_in = found.walled_in
            none = found.reason + ("" if inner is None else f", {2.0 * inner:.2f} m wide")
        self.reasons.append(none)
        return None

    @cached_property
    def _joints_move(self) -> bool:
        """Whether start and goal differ in more than the place of the base."""
        joints = self.robot.space.to_coordinates(self.problem.endpoints)[:, self.robot.space.base_nv :]
        return not np.array_equal(joints[0], joints[1])

    def _touching(self, rows: Array) -> float:
        """Share of rows (N, nv) that are not valid; not looked at, and 0, where there is a constraint."""
        valid, satisfying = self._valid
        return 0.0 if satisfying is not None else 1.0 - float(valid.each(rows).mean())

    @cached_property
    def _valid(self) -> tuple[ValidityChecker, SatisfyingChecker | None]:
        """The checker of the joints' paths, with the constraint where there is one."""
        problem, params = self.problem, self.params
        valid = ValidityChecker(
            self.robot,
            self.scene,
            margin=max(0.5 * problem.room, params.clearance),
            self_margin=max(0.5 * problem.self_room, params.self_clearance),
            bounds=self.deformer.workspace.bounds,
        )
        constraint = self.problem.constraint
        return valid, None if constraint is None else SatisfyingChecker(valid, constraint)

    def in_stages(self, path: Array) -> PlanReport | None:
        """A path (K, 2) of the base in one posture; before and after it, where the base stands, the joints find theirs.

        There is none where start and goal differ in no more than the place of the base.
        """
        problem, space = self.problem, self.robot.space
        b, ends = space.base_nv, space.to_coordinates(problem.endpoints)
        home = space.to_coordinates(self.robot.home_q)
        if not self._joints_move:
            return None
        valid, _satisfying = self._valid
        postures = ("as at the start", ends[0, b:]), ("at home", home[b:]), ("as at the goal", ends[1, b:])
        for what, joints in postures:
            drive = ends.copy()
            drive[:, b:] = joints
            constraint = problem.constraint
            missed = constraint is not None and constraint.errors_at(drive).max() > constraint.constraint.tolerance
            if missed or not (valid.at(drive[0]) and valid.at(drive[1])):
                continue
            if self._touching(staged_rows(problem, path, drive, drive[:1], drive[1:])) > 0.0:
                self.reasons.append(f"grid's path: the robot touches something with the joints {what}")
                continue
            report = self._staged(path, np.stack((ends[0], drive[0])), np.stack((drive[1], ends[1])), what)
            if report is not None or self.deadline.over():
                return report
        return None

    def _staged(self, path: Array, before: Array, after: Array, joints: str) -> PlanReport | None:
        """A path of the base, and the joints' paths between configurations (2, nv) before and after it."""
        valid, satisfying = self._valid
        what, rows = f"grid's path, the joints {joints}, and their own before and after,", None
        for attempt in range(_STAGING_TRIES):
            stages: list[Array] = []
            for ends in (before, after):
                self.attempts += 1
                with self.timed("planner"):
                    stage = self._stand(satisfying or valid, ends, attempt)
                if stage is None:
                    break
                stages.append(stage)
            if len(stages) < 2:
                self.reasons.append(f"no path of the joints was found from or to their values {joints}")
                break
            rows = staged_rows(self.problem, path, np.stack((before[1], after[0])), stages[0], stages[1])
            report = self.as_found(rows, "grid", what)
            if report is not None or self.deadline.over():
                return report
        return None if rows is None else self.relaxed(rows, "grid", what)

    def _stand(self, valid: Checker, ends: Array, attempt: int) -> Array | None:
        """Rows (N, nv) between two configurations (2, nv) with the same base, by the joints alone."""
        if np.array_equal(ends[0], ends[1]):
            return ends[:1]
        corners = search_joints(
            valid,
            ends,
            seed=self.problem.seed + SEED_STRIDE * attempt,
            planner=PLANNERS[0],
            step=_EDGE_STEP * 0.5**attempt,
            timeout=_LONGEST_STAGE_SEARCH,
            deadline=self.deadline,
        )
        return None if corners is None else divided(corners, _JOINT_NODE_SPACING)

    def of_the_joints(self) -> PlanReport | None:
        """Paths of the joints alone, the base as it stands; ever longer searches, and looked at ever more closely."""
        problem = self.problem
        futile, found, step, seconds = 0, 0, _EDGE_STEP, _FIRST_SEARCH
        valid, satisfying = self._valid
        ends = self.robot.space.to_coordinates(problem.endpoints)
        while not self.deadline.over():
            attempt = self.attempts
            self.attempts += 1
            asked = satisfying if satisfying is not None and attempt % 2 else valid
            with self.timed("planner"):
                corners = search_joints(
                    asked,
                    ends,
                    seed=problem.seed + SEED_STRIDE * attempt,
                    planner=PLANNERS[attempt % len(PLANNERS)],
                    step=step,
                    timeout=seconds,
                    deadline=self.deadline,
                )
            if corners is None:
                futile += 1
                seconds *= _SEARCH_GROWTH
                continue
            rows, what = divided(corners, _JOINT_NODE_SPACING), f"path {self.attempts} of the joints"
            method = "line" if len(corners) == 2 else "trees" if asked is valid else "ompl"
            report, found = self.as_found(rows, method, what), found + 1
            if report is None and (found > 1 or problem.constraint is not None):  # else looking again is cheaper
                report = self.relaxed(rows, method, what, 3)
            if report is not None:
                return report
            step *= 0.5
        if futile:
            self.reasons.append(f"no path of the joints was found in {futile} search{'es' * (futile != 1)}")
        return None

    def with_ompl(self, seconds: float = np.inf) -> PlanReport | None:
        """Paths of RRTConnect, each with another seed, in boxes of several sizes, for some of the time."""
        deadline = self.deadline.within(seconds)
        futile, last = 0, ""
        while self.calls < _MOST_CALLS and not deadline.over():
            attempt, searches = self.calls, self.searches
            self.calls += 1
            self.attempts += 1
            self.box = self._ompl_box(searches)
            margin = (
                _SEARCH_MARGINS[attempt]
                if attempt < len(_SEARCH_MARGINS)
                else min(_SEARCH_MARGINS[-1], self.params.clearance)
            )
            found = self.ompl(attempt, margin, 1.0 + 0.5 * searches, self.box, deadline, self.fineness)
            self.searches += found.searched
            if found.rows is None:
                futile += found.searched
                last = found.reason
                continue
            ways = [found.rows]
            if self.problem.robot.base_kind is BaseKind.DIFF_DRIVE and not self.problem.backward:
                ways.insert(0, forward_rows(self.problem.robot, found.rows))
            for rows in ways:
                if len(rows) <= self.params.max_nodes:
                    report = self.relaxed(rows, "ompl", f"OMPL path {self.attempts}")
                    if report is not None:
                        return report
            if self.fineness < _MOST_FINENESS and not certify_path(self.deformer, self.scene, found.rows).certified:
                self.fineness *= 2.0  # the planner's samples had missed something on an edge
        if futile:
            self.reasons.append(f"{last} ({futile} searches without a path)" if futile > 1 else last)
        return None

    def _ompl_box(self, search: int) -> tuple[Array, Array] | None:
        """Small boxes, in which narrow doors are hit sooner, and ever larger boxes; each holds the grid's paths."""
        if self.region is None:
            return None
        low, high = self.region.box(2.0 + 0.5 * (search % 4) if search % 3 == 0 else 2.0 * 1.6**search)
        if self.region.given is None and not self.put_off:
            for path in self.paths.values():
                if path is not None:
                    low, high = np.minimum(low, path.min(axis=0) - 1.0), np.maximum(high, path.max(axis=0) + 1.0)
        return low, high

    def failed(self) -> PlanReport:
        """The report if nothing was certified: what is in the way, what was tried, and what to try."""
        if self.best is None:
            self.initial = self.initial or line_strip(self.problem)
            self._judged(self.initial, self.relax_line(self.initial, False), "line", "straight line")
        assert self.best is not None
        where = ""
        if self.box is not None:
            (x, y), (u, w) = self.box
            where = f"; the base was last looked for within x {x:.1f} … {u:.1f} m, y {y:.1f} … {w:.1f} m"
        tries = [
            "more work" if self.deadline.of_work else "a larger timeout",
            "another seed",
            "a smaller clearance (DeformParams(clearance=…), down to 0 m)",
        ]
        if self.region is not None:
            tries.insert(1, "bounds= about a way that is known" if self.region.given is None else "wider bounds=")
        reason = (
            f"no certified strip in {self.deadline.spent:.1f} s: {'; '.join(self.reasons[-4:])}; "
            f"last in the way: {self.hit or self.best.reason}{where}. Try {', '.join(tries[:-1])} or {tries[-1]}, now "
            f"{self.params.clearance:g} m"
        )
        _log.warning("%s", reason)
        return self._done(self.best.strip, self.best, "none", reason)

    def as_found(self, rows: Array, method: str, what: str) -> PlanReport | None:
        """The report of rows (N, nv) along a path if they are certified as they are; None with a constraint."""
        if self.problem.constraint is not None:
            return None
        with self.timed("relaxation"):
            strip = path_strip(self.problem, rows)
            drivable = float(strip.lateral_slip.max(initial=0.0)) <= SLIP_LIMIT and not self.problem.aside(strip)
            proven = drivable and self.deformer.workspace.proves(strip, self.scene)
            relaxed = None if proven else self.deformer.assess(strip, self.scene)
        if relaxed is not None and self.problem.failure(relaxed):
            return None
        self.initial = strip
        return self._done(strip, relaxed, method, f"the {what} is certified as it was found{self._eased}")

    def relaxed(
        self, rows: Array, method: str, what: str, stuck: int | None = None, over: Callable[[], bool] | None = None
    ) -> PlanReport | None:
        """The report of relaxing rows (N, nv) along a path."""
        strip, report = self.relax_rows(rows, stuck, over)
        self.ticks += report.ticks
        return self._judged(strip, report, method, what)

    def _judged(self, initial: Strip, report: DeformReport, method: str, what: str) -> PlanReport | None:
        """The plan's report if a strip is certified and within the bounds; otherwise the reason is noted."""
        failure = self.problem.failure(report)
        if not failure:
            self.initial = initial
            reason = f"the {what} relaxed to a certified strip in {plural(report.ticks, 'tick')}{self._eased}"
            return self._done(report.strip, report, method, reason)
        if report.usable:
            report = replace(report, reason=failure)
        broken = report.certificate.broken
        self.hit = str(broken) if broken is not None else report.reason
        self.reasons.append(f"{what}: {report.reason}")
        if self.best is None or report.node_clearance > self.best.node_clearance:
            self.best = report
        self.initial = self.initial or initial
        return None

    @property
    def _eased(self) -> str:
        return f"; {self.problem.eased}" if self.problem.eased else ""

    def _done(self, strip: Strip, relaxed: DeformReport | None, method: str, reason: str) -> PlanReport:
        assert self.initial is not None
        return PlanReport(
            strip=strip,
            initial=self.initial,
            certified=method != "none",
            method=method,
            reason=reason,
            scene=self.scene,
            params=self.params,
            relaxed=relaxed,
            attempts=self.attempts,
            ticks=self.ticks,
            seconds=self.deadline.spent,
            timings=self.timings,
            walled_in=self.walled_in if method == "none" else "",
        )
