"""The search for a plan: one kind of path after the other, each relaxed until it is certified, and why each was not."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformParams, DeformReport, Strip

from .grid_path import MOST_CELLS, grid_path
from .initial_strip import STUCK_TICKS, PathSearch, line_strip, path_rows, staged_rows
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
_EDGE_STEP = 0.1  # [m] that a point moves at most between looks at an edge, to begin with
_JOINT_NODE_SPACING = 0.4  # [m or rad] of the nodes along a path of the joints
_JOINT_PATH_MARGIN = 0.01  # [m] that a path of the joints keeps, where start and goal have twice as much
_STAGING_TRIES = 2  # tries of each posture
_LONGEST_STAGE_SEARCH = 0.6  # [s] longest search for a path of the joints at either end of a drive
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
        self.box: tuple[Array, Array] | None = None  # where the base was last looked for
        self.paths: dict[float | None, Array | None] = {}  # the grid's, by the radius that fits
        self.relaxed_paths: set[float | None] = set()
        self.staged: bool = False  # whether a path was tried on which joints and base move one after the other
        self.put_off: bool = False  # whether a path is longer than others should be looked for first
        self.calls: int = 0  # of OMPL
        self.searches: int = 0  # of OMPL
        self.fineness: float = 1.0

    def straight(self, relax: bool) -> PlanReport | None:
        """The straight line, which gets a few ticks, or is looked at as it is."""
        initial = line_strip(self.problem)
        self.initial = initial  # shown where nothing is certified
        hopeless = self.hopeless(initial)
        if hopeless:
            self.reasons.append(f"straight line: {hopeless}")
            return None
        report = self.relax_line(initial, relax)
        self.ticks += report.ticks if relax else 0
        return self._judged(initial, report, "line", "straight line")

    def over_the_grid(self, longest: float) -> PlanReport | None:
        """The path over a grid: first as narrow as the base, then, where that did not relax, as wide as the robot.

        A path longer than ``longest`` [m] is put off.
        """
        problem = self.problem
        over = self.deadline.within(_GRID_SHARE * self.deadline.left).over
        assert problem.region is not None
        for inner in (None, problem.region.folded + self.params.clearance):
            if inner not in self.paths:
                self.paths[inner] = self._grid_path(inner, over)
            path = self.paths[inner]
            if path is None:
                return None  # nor is there a wider one
            self.put_off = float(np.hypot(*np.diff(path, axis=0).T).sum()) > longest
            if self.put_off:
                return None
            if inner in self.relaxed_paths:
                continue
            self.relaxed_paths.add(inner)
            for rows, what in path_rows(problem, path):
                report = self.relaxed(rows, "grid", f"grid's path{what}", STUCK_TICKS, over)
                if report is None and not over():
                    report = self.in_stages(path)
                if report is not None or over():
                    return report
        return None

    def _grid_path(self, inner: float | None, over: Callable[[], bool]) -> Array | None:
        """A path (K, 2) on the smallest grid that has one."""
        problem = self.problem
        none = "the time was over before the grid was searched"
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
            none = found.reason + ("" if inner is None else f", {2.0 * inner:.2f} m wide")
        self.reasons.append(none)
        return None

    def _validity(self) -> tuple[ValidityChecker, SatisfyingChecker | None]:
        """The checker of the joints' paths, with the constraint where there is one."""
        margin = max(min(_JOINT_PATH_MARGIN, 0.5 * self.problem.room), self.params.clearance)
        valid = ValidityChecker(self.robot, self.scene, margin=margin, bounds=self.deformer.workspace.bounds)
        constraint = self.problem.constraint
        return valid, None if constraint is None else SatisfyingChecker(valid, constraint)

    def in_stages(self, path: Array) -> PlanReport | None:
        """A path (K, 2) of the base in one posture; before and after it, where the base stands, the joints find theirs.

        It is tried once, if start and goal differ in more than the place of the base.
        """
        problem, space = self.problem, self.robot.space
        b, ends = space.base_nv, space.to_coordinates(problem.endpoints)
        home = space.to_coordinates(self.robot.home_q)
        if self.staged or np.array_equal(ends[0, b:], ends[1, b:]):
            return None
        self.staged = True
        valid, satisfying = self._validity()
        postures = ("as at the start", ends[0, b:]), ("at home", home[b:]), ("as at the goal", ends[1, b:])
        for attempt, (what, joints) in product(range(_STAGING_TRIES), postures):
            drive = ends.copy()
            drive[:, b:] = joints
            constraint = problem.constraint
            missed = constraint is not None and constraint.errors_at(drive).max() > constraint.constraint.tolerance
            if missed or not (valid.at(drive[0]) and valid.at(drive[1])):
                continue
            stages: list[Array] = []
            for pair in ((ends[0], drive[0]), (drive[1], ends[1])):
                self.attempts += 1
                with self.timed("planner"):
                    stage = self._stand(satisfying or valid, np.stack(pair), attempt)
                if stage is None:
                    break
                stages.append(stage)
            if self.deadline.over():
                break
            if len(stages) < 2:
                self.reasons.append(f"OMPL found no path of the joints from or to where they are {what}")
                continue
            rows = staged_rows(problem, path, drive, stages[0], stages[1])
            report = self.relaxed(rows, "grid", f"grid's path, the joints {what}, and their own before and after,")
            if report is not None:
                return report
        return None

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
        futile, step, seconds = 0, _EDGE_STEP, _FIRST_SEARCH
        valid, satisfying = self._validity()
        ends = self.robot.space.to_coordinates(problem.endpoints)
        while not self.deadline.over():
            attempt = self.attempts
            self.attempts += 1
            with self.timed("planner"):
                corners = search_joints(
                    satisfying if satisfying is not None and attempt % 2 else valid,
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
            report = self.relaxed(
                divided(corners, _JOINT_NODE_SPACING), "ompl", f"path {self.attempts} of the joints", 3
            )
            if report is not None:
                return report
            step *= 0.5
        if futile:
            self.reasons.append(f"OMPL found no path of the joints in {futile} searches")
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
            report = self.relaxed(found.rows, "ompl", f"OMPL path {self.attempts}")
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
            assert self.initial is not None
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
        return self._done(self.best, "none", reason)

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
            eased = f"; {self.problem.eased}" if self.problem.eased else ""
            return self._done(report, method, f"the {what} relaxed to a certified strip in {report.ticks} ticks{eased}")
        if report.usable:
            report = replace(report, reason=failure)
        broken = report.certificate.broken
        self.hit = str(broken) if broken is not None else report.reason
        self.reasons.append(f"{what}: {report.reason}")
        if self.best is None or report.node_clearance > self.best.node_clearance:
            self.best = report
        self.initial = self.initial or initial
        return None

    def _done(self, report: DeformReport, method: str, reason: str) -> PlanReport:
        assert self.initial is not None
        return PlanReport(
            strip=report.strip,
            initial=self.initial,
            certified=method != "none",
            method=method,
            reason=reason,
            report=report,
            attempts=self.attempts,
            ticks=self.ticks,
            seconds=self.deadline.spent,
            timings=self.timings,
        )
