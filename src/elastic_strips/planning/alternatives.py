"""Alternatives: certified strips that pass the obstacles on different sides, the best first."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array

from ..errors import ParameterError
from ..robot import RobotModel
from ..scene import Scene
from ..strip import Deformer, DeformParams, DeformReport, Strip
from ..summary import Summary
from .deadline import Deadline
from .ends import check_ends, check_search, workspace
from .homotopy import BaseClass, Component, ComponentMap, base_class, component_map, distinct_ways
from .line import straight_line
from .ompl_planner import Region, ompl_path
from .relaxation import path_strip, relax_line, relax_while_clearer, way_rows

_log = logging.getLogger(__name__)
_TIGHT = 1.0  # cost [m] of no clearance at all against all that counts
_POLISH = 12  # most ticks that a certified strip gets to become short and clear
_LINE_TICKS = 6
_MARGINS = (0.04, 0.02, 0.01, 0.005)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Alternative(Summary):
    """One certified strip among others.

    Attributes:
        strip: the strip; report: the deformation report that certifies it.
        base_class: its class among the components of the scene.
        method: ``"line"``, ``"grid"`` or ``"ompl"``.
        length: of the base's path [m]; of the joints' path [rad] for a fixed base.
        cost: see :func:`strip_cost`.
    """

    strip: Strip
    report: DeformReport
    base_class: BaseClass
    method: str
    length: float
    cost: float

    @property
    def clearance(self) -> float:
        """Smallest distance [m] to obstacles anywhere on the strip: :attr:`DeformReport.clearance`."""
        return self.report.clearance

    def _summary(self) -> dict[str, object]:
        return {
            "base_class": self.base_class, "method": self.method, "length": f"{self.length:.3f} m",
            "clearance": f"{self.clearance:.3f} m", "cost": self.cost, "nodes": len(self.strip),
        }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class AlternativesReport(Summary):
    """Strips of different classes.

    Attributes:
        alternatives: the cheapest first; empty where nothing was certified.
        components: among which the classes are.
        reason: how many there are, and why not more, for people.
        attempts: paths that were relaxed.
        seconds: what it took; timings: seconds by phase: search, relaxation.
    """

    alternatives: tuple[Alternative, ...]
    components: tuple[Component, ...]
    reason: str
    attempts: int
    seconds: float
    timings: dict[str, float] = field(default_factory=dict)

    def _summary(self) -> dict[str, object]:
        return {
            "alternatives": len(self.alternatives), "costs": [round(a.cost, 3) for a in self.alternatives],
            "reason": self.reason, "attempts": self.attempts, "seconds": self.seconds,
        }  # fmt: skip


def strip_cost(report: DeformReport, params: DeformParams) -> float:
    """What a strip costs [m]: its length, and up to 1 m more the less of the influence distance it keeps clear."""
    return report.strip.length + _TIGHT * max(0.0, 1.0 - report.node_clearance / params.influence)


def strip_path(strip: Strip) -> Array:
    """(K, 2) path of the base [m], as it is followed between the nodes."""
    return strip.robot.space.to_chart(strip.sample(0.1))[:, :2]


def plan_alternatives(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    *,
    count: int = 3,
    seed: int = 0,
    params: DeformParams | None = None,
    timeout: float = 5.0,
    bounds: npt.ArrayLike | None = None,
    ompl_attempts: int = 3,
    without: Collection[BaseClass] = (),
    field: ComponentMap | None = None,
    deformer: Deformer | None = None,
) -> AlternativesReport:
    """Certified strips of different classes: the straight line, ways over a grid, and paths of OMPL, each relaxed.

    The ways over the grid differ in class before they are relaxed; OMPL, with another seed at each attempt, is asked
    where they were not enough. What relaxes into a class that is there already replaces it where it is cheaper. A fixed
    base has one class only.

    Args:
        robot: the robot.
        scene: the obstacles, as they stand.
        start, goal: configurations (nq,).
        count: so many strips at most.
        seed: of OMPL's random numbers.
        params: of the relaxation; the default preset where None.
        timeout: after this time [s] nothing goes on; it is exceeded by at most a tick of the deformer or a step of
            OMPL.
        bounds: as in :func:`plan_report`; where None, OMPL looks ever further about start and goal.
        ompl_attempts: most calls of OMPL.
        without: classes among ``field``'s components that are not wanted, because they are there already.
        field: the components of the scene, about start and goal; found where None.
        deformer: a workspace of the same robot to use again; its parameters count, not ``params``.

    Raises:
        RobotError, SceneError: not a robot, or not a scene.
        ConfigurationError: start or goal is not sound, in collision, too far away or outside of the bounds; names the
            pair, or the distance.
        ParameterError: a count, seed, timeout, number of attempts or bounds outside its range.
    """
    for name, value, least in (("count", count, 1), ("ompl_attempts", ompl_attempts, 0)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise ParameterError(f"{name}={value!r} must be an integer ≥ {least}")
    deadline = check_search(seed, timeout)
    deformer = workspace(robot, scene, params, deformer)
    q_start, q_goal = check_ends(robot, scene, start, goal, deformer.params)
    ends = np.stack((q_start, q_goal))
    region = Region.of(robot, scene, q_start, q_goal, bounds)
    if field is None and region is not None:
        field = component_map(robot, scene, region.ends, box=region.given, over=deadline.over)
    components = field.components if field is not None else ()
    search = _Search(robot, scene, deformer, ends, components, frozenset(without), region, deadline)
    search.timings["search"] += deadline.spent
    spacing, most = min(0.13, deformer.params.max_spacing), deformer.params.max_nodes

    def over() -> bool:
        return len(search.found) >= count or deadline.over()

    search.line(straight_line(robot, q_start, q_goal, spacing=spacing, most=most))
    classes = 1
    if field is not None and not over():
        mark = perf_counter()
        ways = distinct_ways(robot, scene, q_start, q_goal, count=2 * count + len(search.done) + 1, field=field)
        search.timings["search"] += perf_counter() - mark
        classes = len(ways)
        for way in ways:
            if over():
                break
            if way.base_class in search.done or way.base_class in search.found:
                continue
            for rows, what in way_rows(robot, q_start, q_goal, way.points, spacing, most):
                if search.relax(rows, "grid", f"way of {way.cost:.1f} m{what}"):
                    break
    hopeless = bool(search.found or search.done) and not search.components
    for attempt in range(ompl_attempts):
        if hopeless or over():
            break
        mark = perf_counter()
        path = ompl_path(
            robot, scene, q_start, q_goal, seed=seed + 7919 * attempt, margin=_MARGINS[min(attempt, len(_MARGINS) - 1)],
            timeout=1.0, spacing=spacing, box=region.box(2.0 * 1.6**attempt) if region else None, most=most,
            deadline=deadline,
        )  # fmt: skip
        search.timings["search"] += perf_counter() - mark
        if path.chart is None:
            search.notes.append(path.reason)
        else:
            search.relax(path.chart, "ompl", f"OMPL path {attempt + 1}")
    best = tuple(sorted(search.found.values(), key=lambda a: a.cost)[:count])
    reason = _reason(robot, search, len(best), count, classes)
    if not best:
        _log.warning("%s", reason)
    return AlternativesReport(best, search.components, reason, search.attempts, deadline.spent, search.timings)


class _Search:
    """What is found while it is looked for."""

    def __init__(
        self, robot: RobotModel, scene: Scene, deformer: Deformer, ends: Array, components: tuple[Component, ...],
        done: frozenset[BaseClass], region: Region | None, deadline: Deadline,
    ) -> None:  # fmt: skip
        self.robot, self.scene, self.deformer, self._ends = robot, scene, deformer, ends
        self.components, self.done, self._region, self._deadline = components, done, region, deadline
        self.found: dict[BaseClass, Alternative] = {}
        self.notes: list[str] = []
        self.attempts = 0
        self.timings = {"search": 0.0, "relaxation": 0.0}

    def late(self) -> bool:
        """Whether the time is over."""
        return self._deadline.over()

    def line(self, rows: Array) -> None:
        """Relax the straight line, which is given up early, unless its class is there already."""
        strip = Strip.from_chart(self.robot, rows, ends=self._ends)
        if self._class(strip) not in self.done:
            self._add(
                strip, "line", "straight line",
                lambda s: relax_line(self.deformer, s, self.scene, _LINE_TICKS, None, over=self.late),
            )  # fmt: skip

    def _class(self, strip: Strip) -> BaseClass:
        return base_class(strip_path(strip), self.components) if self.components else ()

    def relax(self, rows: Array, method: str, what: str) -> bool:
        """Relax chart rows; whether that gave a certified strip."""
        strip = path_strip(self.robot, rows, self._ends)
        return self._add(
            strip, method, what, lambda s: relax_while_clearer(self.deformer, s, self.scene, over=self.late)
        )

    def _add(self, strip: Strip, method: str, what: str, relaxed: Callable[[Strip], DeformReport]) -> bool:
        mark = perf_counter()
        self.attempts += 1
        report = relaxed(strip)
        if report.usable:
            report = self._polished(report)
        self.timings["relaxation"] += perf_counter() - mark
        aside = self._region.left_by(report.strip) if self._region else 0.0
        if not report.usable or aside > 0.0:
            why = report.reason if not report.usable else f"the base leaves the bounds by {aside:.3f} m"
            self.notes.append(f"{what}: {why}")
            return False
        word = self._class(report.strip)
        cost = strip_cost(report, self.deformer.params)
        if word in self.done or (word in self.found and self.found[word].cost <= cost):
            self.notes.append(f"{what}: relaxed into a class that is there already")
        else:
            self.found[word] = Alternative(report.strip, report, word, method, report.strip.length, cost)
        return True

    def _polished(self, report: DeformReport) -> DeformReport:
        """A few ticks more, as long as they keep the strip usable and are of use."""
        for _ in range(_POLISH):
            further = self.deformer.step(report.strip, self.scene)
            if not further.usable:
                break
            report = replace(further, ticks=report.ticks + 1)
            if further.moved < self.deformer.params.rest_step or self.late():
                break
        return report


def _reason(robot: RobotModel, search: _Search, found: int, count: int, classes: int) -> str:
    """How many there are, and why not more."""
    more = " more" if search.done else ""
    text = f"{found}{more} certified strip{'' if found == 1 else 's'} of different classes"
    if found >= count:
        return text
    if not robot.space.planar:
        why = "the base is fixed: there is one class only"
    elif search.late():
        why = "the time was over"
    elif not search.components:
        why = "nothing stands in the way that could be passed on another side"
    else:
        why = f"the grid knows {classes} class{'' if classes == 1 else 'es'} of ways"
    notes = "; ".join(search.notes[-4:])
    return f"{text}, not {count}: {why}{'; ' if notes else ''}{notes}"
