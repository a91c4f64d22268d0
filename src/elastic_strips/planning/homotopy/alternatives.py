"""Alternatives: certified strips that pass the obstacles on different sides, and the search for them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from elastic_strips.arrays import Array
from elastic_strips.planning.initial_strip import STUCK_TICKS, PathSearch, line_strip, path_rows
from elastic_strips.planning.problem import PlanningProblem
from elastic_strips.strip import Strip
from elastic_strips.strip.params import DeformParams
from elastic_strips.strip.report import DeformReport
from elastic_strips.summary import Summary

from .classes import ClusterMap, HomotopyClass, cluster_map, homotopy_class, homotopy_paths

_log = logging.getLogger(__name__)
_NO_CLEARANCE_COST = 1.0  # [m] of a strip without any clearance
_FURTHER_TICKS = 12  # most ticks that a certified strip gets to become short and clear
_SEARCH_MARGINS = (0.04, 0.02, 0.01, 0.005)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Alternative(Summary):
    """One certified strip among others.

    Attributes:
        strip: the strip.
        report: the deformation report that certifies it.
        homotopy_class: its class among the clusters of obstacles.
        method: ``"path"``, ``"line"``, ``"grid"`` or ``"ompl"``.
        length: length of the base's path [m]; for a fixed base that of the joints' path [rad].
        cost: see :func:`strip_cost`.
    """

    strip: Strip
    report: DeformReport
    homotopy_class: HomotopyClass
    method: str
    length: float
    cost: float

    @property
    def clearance(self) -> float:
        """Smallest distance [m] to obstacles anywhere on the strip: :attr:`DeformReport.clearance`."""
        return self.report.clearance

    def _summary(self) -> dict[str, object]:
        return {
            "homotopy_class": self.homotopy_class,
            "method": self.method,
            "length": f"{self.length:.3f} m",
            "clearance": f"{self.clearance:.3f} m",
            "cost": self.cost,
            "nodes": len(self.strip),
        }


def strip_cost(report: DeformReport, params: DeformParams) -> float:
    """Cost of a strip [m]: its length, and up to 1 m more the less of the influence distance it keeps clear."""
    return report.strip.length + _NO_CLEARANCE_COST * max(0.0, 1.0 - report.node_clearance / params.influence)


def base_path(strip: Strip) -> Array:
    """(K, 2) path of the base [m], as it is followed between the nodes."""
    return strip.robot.space.to_coordinates(strip.sample(0.1))[:, :2]


class AlternativesSearch(PathSearch):
    """Workspace: looks for certified strips of different classes.

    It relaxes the straight line, paths over a grid that differ in class, and paths of OMPL with other seeds where these
    were not enough. A strip that relaxes into a known class replaces the strip there if it is cheaper.

    Args:
        problem: start, goal, scene, time and bounds.
        count: largest number of strips.
        without: classes among ``clusters`` that are not wanted, because the caller has them already.
        clusters: clusters of the scene, about start and goal; found where None.
        ompl_attempts: largest number of calls of OMPL.
        line: whether the straight line gets ticks, or is looked at as it is.
        given: rows (N, nv) to relax first, or None.
        grid: whether paths over a grid are looked for.
        watch: called with every tick's report.

    Attributes:
        found: class → its cheapest strip.
        initial: class → the strip that this was relaxed from.
        clusters: clusters of obstacles, among which the classes are.
        best: the clearest report without a certificate, and the strip that it was relaxed from.
        attempts: number of paths that were relaxed.
        ticks: number of ticks that this took.
        timings: seconds by phase: line, planner, relaxation.
        reason: how many strips there are, and why not more, in words.
    """

    def __init__(
        self,
        problem: PlanningProblem,
        count: int,
        *,
        without: Collection[HomotopyClass] = (),
        clusters: ClusterMap | None = None,
        ompl_attempts: int = 3,
        line: bool = True,
        given: Array | None = None,
        grid: bool = True,
        watch: Callable[[DeformReport], object] | None = None,
    ) -> None:
        super().__init__(problem, watch)
        self._count, self._line, self._grid = count, line, grid
        self._without, self._ompl_attempts, self._given = frozenset(without), ompl_attempts, given
        self.found: dict[HomotopyClass, Alternative] = {}
        self.initial: dict[HomotopyClass, Strip] = {}
        self.best: tuple[DeformReport, Strip] | None = None
        self.reason: str = ""
        self._notes: list[str] = []
        self._classes = 1  # that the grid knows
        if clusters is None and problem.region is not None:
            region = problem.region
            with self.timed("planner"):
                clusters = cluster_map(
                    problem.robot, problem.scene, region.endpoints, box=region.given, over=problem.deadline.over
                )
        self._map = clusters
        self.clusters = clusters.clusters if clusters is not None else ()

    @property
    def alternatives(self) -> tuple[Alternative, ...]:
        """The strips, the cheapest first."""
        return tuple(sorted(self.found.values(), key=lambda a: a.cost)[: self._count])

    def run(self) -> None:
        """Look for them, until there are enough or the time is over."""
        if self._given is not None:
            self._relax(self._given, "path", "given path")
        self._relax_line()
        if self._grid and self._map is not None and not self._over():
            self._relax_grid(self._map)
        self._relax_ompl()
        self.reason = self._told()
        if not self.found:
            _log.warning("%s", self.reason)

    def _over(self) -> bool:
        return len(self.found) >= self._count or self.problem.deadline.over()

    def _relax_line(self) -> None:
        """The straight line, which is given up early, unless its class is there already."""
        strip = line_strip(self.problem)
        if self._class(strip) not in self._without:
            self._add(strip, self.relax_line(strip, self._line), "line", "straight line")

    def _relax_grid(self, clusters: ClusterMap) -> None:
        problem, count = self.problem, 2 * self._count + len(self._without) + 1
        with self.timed("planner"):
            paths = homotopy_paths(
                problem.robot, problem.scene, problem.start, problem.goal, count=count, clusters=clusters
            )
        self._classes = len(paths)
        for path in paths:
            if self._over():
                return
            if path.homotopy_class in self._without or path.homotopy_class in self.found:
                continue
            for rows, what in path_rows(problem, path.points):
                if self._relax(rows, "grid", f"way of {path.cost:.1f} m{what}"):
                    break

    def _relax_ompl(self) -> None:
        region, hopeless = self.problem.region, bool(self.found or self._without) and not self.clusters
        for attempt in range(self._ompl_attempts):
            if hopeless or self._over():
                return
            margin = _SEARCH_MARGINS[min(attempt, len(_SEARCH_MARGINS) - 1)]
            box = region.box(2.0 * 1.6**attempt) if region else None
            path = self.ompl(attempt, margin, 1.0, box, self.problem.deadline)
            if path.rows is None:
                self._notes.append(path.reason)
            else:
                self._relax(path.rows, "ompl", f"OMPL path {attempt + 1}")

    def _class(self, strip: Strip) -> HomotopyClass:
        return homotopy_class(base_path(strip), self.clusters) if self.clusters else ()

    def _relax(self, rows: Array, method: str, what: str) -> bool:
        """Relax rows (N, nv); whether that gave a certified strip."""
        return self._add(*self.relax_rows(rows, STUCK_TICKS), method, what)

    def _add(self, strip: Strip, report: DeformReport, method: str, what: str) -> bool:
        """Take in the strip that another one was relaxed to; whether it is certified."""
        problem = self.problem
        self.attempts += 1
        if report.usable:
            with self.timed("relaxation"):
                report = self._shortened(report)
        self.ticks += report.ticks
        failure = problem.failure(report)
        if failure:
            self._notes.append(f"{what}: {failure}")
            if self.best is None or report.node_clearance > self.best[0].node_clearance:
                self.best = report, strip
            return False
        word = self._class(report.strip)
        cost = strip_cost(report, problem.params)
        if word in self._without or (word in self.found and self.found[word].cost <= cost):
            self._notes.append(f"{what}: relaxed into a class that has a strip already")
        else:
            self.found[word] = Alternative(report.strip, report, word, method, report.strip.length, cost)
            self.initial[word] = strip
        return True

    def _shortened(self, report: DeformReport) -> DeformReport:
        """A few ticks more, as long as they keep the strip usable and improve it."""
        problem = self.problem
        for _ in range(_FURTHER_TICKS):
            further = problem.deformer.step(report.strip, problem.scene)
            if not further.usable or problem.missed(further):
                break
            report = replace(further, ticks=report.ticks + 1)
            if further.moved < problem.params.rest_step or problem.deadline.over():
                break
        return report

    def _told(self) -> str:
        """How many there are, and why not more."""
        found, count = len(self.alternatives), self._count
        more = " more" if self._without else ""
        text = f"{found}{more} certified strip{'' if found == 1 else 's'} of different classes"
        if found >= count:
            return text
        if not self.problem.robot.space.planar:
            why = "the base is fixed: there is one class only"
        elif self.problem.deadline.over():
            why = "the time ran out"
        elif not self.clusters:
            why = "nothing stands in the way that could be passed on another side"
        else:
            why = f"the grid knows {self._classes} class{'' if self._classes == 1 else 'es'} of ways"
        notes = "; ".join(self._notes[-4:])
        return f"{text}, not {count}: {why}{'; ' if notes else ''}{notes}"
