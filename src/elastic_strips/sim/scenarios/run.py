"""Runs of scenarios: plan, deform, certify, and measure the result; their document (docs/result-format.md)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TypeVar, get_type_hints

import numpy as np

from elastic_strips._version import __version__
from elastic_strips.arrays import Array, Document
from elastic_strips.catalogue import PRESETS
from elastic_strips.collision import BrokenSegment
from elastic_strips.collision.path_certificate import changes
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError, ScenarioError
from elastic_strips.io.obstacle_document import obstacle_documents
from elastic_strips.planning import check_endpoints, ompl_path, plan_report, straight_line
from elastic_strips.planning.leaving import Departure
from elastic_strips.planning.ompl_planner import PathResult
from elastic_strips.planning.problem import SEED_STRIDE
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformParams, DeformReport, Strip
from elastic_strips.strip.paper import PaperDeformer, PaperParams, PaperReport
from elastic_strips.summary import Summary
from elastic_strips.validation import check_able, check_choice, check_count, check_number, check_type, named_arguments

from .scenario import Scenario

_MOST_FRAMES = 400  # of a deformation that are kept
_PAPER_SPACING = 0.216  # [m] of nodes: 59 segments for the 12.7 m of the paper's line
_OMPL_TRIES, _OMPL_MARGIN = 4, 0.04  # where the paper's line is not free; [m] that its paths keep


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RunResult(Summary):
    """Result of running a scenario.

    Attributes:
        scenario, robot, params: what was run.
        initial: the strip before its deformation.
        report: last report; its strip is the result.
        method: source of the initial strip: ``"line"``, ``"grid"``, ``"ompl"`` or ``"none"``.
        reason: reason of the result, in words.
        passing_side: see :func:`passing_side`.
        seed: seed of the planner.
        ticks: number of all ticks.
        tick_seconds: duration of each tick [s].
        time_to_certified: time until the first certified strip [s], or None.
        frames: strips along the deformation, for animation (first and last included).
        departure: the way out of a start that touches, before the strip; else None. With it the strip and its
            certificate are from where the robot is free, and the result is not certified as a whole.
    """

    scenario: Scenario
    robot: RobotModel
    params: DeformParams | PaperParams
    initial: Strip
    report: DeformReport
    method: str
    reason: str
    passing_side: str | None
    seed: int
    ticks: int
    tick_seconds: Array
    time_to_certified: float | None
    frames: tuple[Strip, ...] = field(default_factory=tuple)
    departure: Departure | None = None

    def _summary(self) -> dict[str, object]:
        return {
            "scenario": self.scenario.name,
            "robot": self.robot.name,
            "preset": self.params.preset,
            "status": self.report.status.value,
            "certified": self.certified,
            "reason": self.reason,
            "nodes": len(self.report.strip),
            "ticks": self.ticks,
            "passage": self.passing_side,
        }

    def _measured(self) -> dict[str, object]:
        return {"clearance": f"{self.clearance:.3f} m", "length": f"{self.report.strip.length:.3f} m"}

    @property
    def clearance(self) -> float:
        """Smallest distance [m] to obstacles anywhere on the strip: the report's."""
        return self.report.clearance

    @property
    def certified(self) -> bool:
        """Whether the strip is certified and its hulls connected, and begins at the start."""
        return self.report.usable and self.departure is None


@named_arguments
def run_scenario(
    scenario: Scenario,
    *,
    robot: RobotModel | None = None,
    preset: str | None = None,
    seed: int | None = None,
    overrides: Mapping[str, object] | None = None,
    watch: Callable[[DeformReport], object] | None = None,
    timeout: float = 20.0,
    start_depth: float = 0.0,
) -> RunResult:
    """Plan an initial strip, deform it until it has converged, and measure it.

    Args:
        scenario: the problem.
        robot: a robot other than the scenario's.
        preset: ``"default"`` or ``"paper"``; the scenario's where None.
        seed: seed of the planner; the scenario's where None.
        overrides: further parameter overrides.
        watch: called with every tick's report.
        timeout: longest planning [s].
        start_depth: a start that touches by at most this much [m] is left first: see :func:`plan_report`.

    Raises:
        InputError: start or goal in collision, unknown parameters, …
    """
    check_type("scenario", scenario, Scenario, ScenarioError)
    check_type("robot", robot, RobotModel, RobotError, none=True)
    check_type("overrides", overrides, dict, none=True)
    check_able("watch", watch)
    if preset is not None:
        check_choice("preset", preset, tuple(PRESETS))
    if seed is not None:
        check_count("seed", seed)
    check_number("timeout", timeout, above=0.0, unit="s")
    preset = preset or scenario.preset
    robot = scenario.load_robot(preset=preset) if robot is None else robot
    values = {**scenario.params.get(preset, {}), **(overrides or {})}
    params = _parameters(scenario, PaperParams() if preset == "paper" else DeformParams(), values)
    seed = scenario.seed if seed is None else seed
    note = _Ticks(watch)
    try:
        if isinstance(params, PaperParams):
            if start_depth != 0.0:
                raise ParameterError(f"start_depth={start_depth!r} is for the default preset")
            outcome, departure = _run_paper(scenario, robot, params, seed, note, timeout), None
        else:
            outcome, departure = _run_default(scenario, robot, params, seed, note, timeout, start_depth)
    except ConfigurationError as error:
        if scenario.name in str(error):
            raise
        raise ConfigurationError(f"scenario {scenario.name!r}: {error}") from None
    initial, report, method, reason, first = outcome
    return RunResult(
        scenario=scenario,
        robot=robot,
        params=params,
        initial=initial,
        report=report,
        method=method,
        reason=reason,
        passing_side=passing_side(report.strip, scenario.scene, scenario.gap),
        seed=seed,
        ticks=len(note.seconds),
        tick_seconds=np.asarray(note.seconds),
        time_to_certified=first,
        frames=(initial, *note.strips),
        departure=departure,
    )


class _Ticks:
    """Takes note of ticks: how long each took [s], and the strips of the first of them."""

    def __init__(self, watch: Callable[[DeformReport], object] | None) -> None:
        self.seconds: list[float] = []
        self.strips: list[Strip] = []
        self._watch = watch

    def __call__(self, report: DeformReport) -> None:
        self.seconds.append(report.seconds)
        if len(self.strips) < _MOST_FRAMES:
            self.strips.append(report.strip)
        if self._watch is not None:
            self._watch(report)


_P = TypeVar("_P", bound="DeformParams | PaperParams")


def _parameters(scenario: Scenario, params: _P, values: dict[str, object]) -> _P:
    whole = {name for name, kind in get_type_hints(type(params)).items() if kind is int}
    try:
        for name, value in values.items():
            if name == "preset":
                raise ParameterError(f"preset={value!r} is not a parameter; choose the preset separately")
            if name in whole and isinstance(value, float):  # numbers of a file are floats
                if not value.is_integer():
                    raise ParameterError(f"{name}={value!r} must be a whole number")
                values = {**values, name: int(value)}
        return params.replaced(**values)
    except ParameterError as error:
        raise ParameterError(f"scenario {scenario.name!r}: {error}") from None


_Outcome = tuple[Strip, DeformReport, str, str, float | None]


def _run_default(
    scenario: Scenario,
    robot: RobotModel,
    params: DeformParams,
    seed: int,
    note: Callable[[DeformReport], None],
    timeout: float,
    start_depth: float,
) -> tuple[_Outcome, Departure | None]:
    start, goal = scenario.ends(robot)
    deformer = Deformer(robot, params)
    planned = plan_report(
        robot,
        scenario.scene,
        start,
        goal,
        seed=seed,
        deformer=deformer,
        timeout=timeout,
        watch=note,
        start_depth=start_depth,
    )
    departure, strip, before = planned.departure, planned.strip, planned.report
    if departure is not None and departure.rest is not None:
        strip = departure.rest
        before = deformer.assess(strip, scenario.scene)
    elif not planned.certified:
        return (planned.initial, planned.report, planned.method, planned.reason, None), departure
    report = deformer.settle(strip, scenario.scene, watch=note)
    if not report.certified:  # settling must not lose the certified strip
        report = before
    reason = report.reason if departure is None else f"{departure}; from there on {report.reason}"
    return (planned.initial, report, planned.method, reason, planned.seconds), departure


def _run_paper(
    scenario: Scenario,
    robot: RobotModel,
    params: PaperParams,
    seed: int,
    note: Callable[[DeformReport], None],
    timeout: float,
) -> _Outcome:
    """As in the paper, the initial trajectory is planned: the straight line, or OMPL's path where the line is not free
    and does not settle to a certified strip.
    """
    began = perf_counter()
    start, goal = scenario.ends(robot)
    deformer = PaperDeformer(robot, params)
    bounds = DeformParams(influence=params.influence, clearance=params.clearance, self_clearance=params.self_clearance)
    ends = np.stack(check_endpoints(robot, scenario.scene, start, goal, bounds))
    rows = straight_line(robot, start, goal, spacing=_PAPER_SPACING)
    if robot.space.planar:
        rows[:-1, 2] = rows[0, 2]  # Table 1: the direction of the initial robot
    initial, method = Strip.from_coordinates(robot, rows, ends=ends), "line"
    first: list[float] = []

    def watch(report: PaperReport) -> None:
        if not first and report.usable:
            first.append(perf_counter() - began)
        note(report)

    def relax(strip: Strip) -> PaperReport:
        first.clear()
        return deformer.settle(strip, scenario.scene, watch=watch)

    attempts: list[str] = []
    free = deformer.assess(initial, scenario.scene).certified
    report = relax(initial)
    if not free and not report.usable:
        attempts.append(f"straight line, which is not free: {report.reason}")
        for found in _ompl_paths(scenario, robot, seed, timeout):
            if found.rows is None:
                attempts.append(found.reason)
                continue
            initial, method = Strip.from_coordinates(robot, found.rows, ends=ends), "ompl"
            report = relax(initial)
            if report.usable:
                break
            attempts.append(report.reason)
    certified = report.usable
    reason = report.reason if not attempts or certified else "; ".join(attempts)
    return initial, report, method, reason, first[0] if first and certified else None


def _ompl_paths(scenario: Scenario, robot: RobotModel, seed: int, timeout: float) -> Iterator[PathResult]:
    start, goal = scenario.ends(robot)
    for k in range(_OMPL_TRIES):
        yield ompl_path(
            robot,
            scenario.scene,
            start,
            goal,
            seed=seed + SEED_STRIDE * k,
            margin=_OMPL_MARGIN,
            timeout=timeout / _OMPL_TRIES,
            spacing=_PAPER_SPACING,
        )


def passing_side(strip: Strip, scene: Scene, gap: tuple[str, str] | None) -> str | None:
    """``"between"`` two obstacles, ``"around-left"`` or ``"around-right"`` of both (seen along the path), or None.

    The base's path is followed across the straight line through the obstacles' centres; its last crossing decides.
    """
    if gap is None or not strip.robot.space.planar or any(name not in scene for name in gap):
        return None
    one, two = (scene.obstacle(name).pose[:2, 3] for name in gap)
    path = strip.robot.space.to_coordinates(strip.sample(0.05))[:, :2]
    along = two - one
    normal = np.array([-along[1], along[0]])
    side = (path - one) @ normal
    crossings = np.flatnonzero(np.sign(side[:-1]) * np.sign(side[1:]) <= 0)
    if len(crossings) == 0 or along @ along == 0.0:
        return None
    k = int(crossings[-1])
    denominator = side[k] - side[k + 1]
    s = side[k] / denominator if denominator != 0 else 0.5
    point = path[k] + s * (path[k + 1] - path[k])
    fraction = float((point - one) @ along / (along @ along))
    if 0.0 < fraction < 1.0:
        return "between"
    course = path[-1] - path[0]
    offset = point - 0.5 * (one + two)
    return "around-left" if course[0] * offset[1] - course[1] * offset[0] > 0 else "around-right"


FORMAT = "elastic-strips-result"
FORMAT_VERSION = 1


def result_document(result: RunResult) -> Document:
    """A run as plain values, ready for JSON. Lengths in metres, angles in radians."""
    check_type("result", result, RunResult)
    report, robot, strip = result.report, result.robot, result.report.strip
    broken = report.certificate.broken
    paper = isinstance(report, PaperReport)
    base = BaseKind.OMNI if paper and robot.base_kind is BaseKind.DIFF_DRIVE else robot.base_kind
    ticks = 1e3 * result.tick_seconds
    return {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "elastic_strips": __version__,
        "scenario": result.scenario.name,
        "preset": result.params.preset,
        "robot": robot.name,
        "seed": result.seed,
        "status": report.status.value if result.departure is None or not report.usable else "departed",
        "reason": result.reason,
        "certified": result.certified,
        "segments": [bool(s) for s in report.certificate.segments],
        "certified_clearance_m": result.params.clearance,
        "clearance_m": float(result.clearance) if np.isfinite(result.clearance) else None,
        "max_lateral_slip_m": float(strip.lateral_slip.max(initial=0.0)) if base is BaseKind.DIFF_DRIVE else 0.0,
        "length_m": strip.length,
        "nodes": len(strip),
        "ticks": result.ticks,
        "initial": result.method,
        "time_to_certified_ms": None if result.time_to_certified is None else 1e3 * result.time_to_certified,
        "tick_ms": {f"p{p}": float(np.percentile(ticks, p)) if len(ticks) else None for p in (50, 95, 99)},
        "passage": result.passing_side,
        "max_heading_step_rad": report.heading_step if isinstance(report, PaperReport) else None,
        "broken": None if result.certified or broken is None else _place(broken),
        "departure": None if result.departure is None else result.departure.document(),
        "base": base.value,
        "strip": {"joint_names": list(robot.joint_names), "q": strip.q.tolist()},
        "locked": {name: float(value) for name, value in robot.locked.items()},
        "obstacles": obstacle_documents(result.scenario.scene),
        "changes_with_time": list(changes(result.scenario.world)),
        "urdf": None if robot.urdf_path is None else str(Path(robot.urdf_path).absolute()),
        "params": _all_parameters(result.params),
    }


def _place(broken: BrokenSegment) -> Document:
    place = asdict(broken)
    del place["labels"]  # words of messages
    return place


def _all_parameters(params: DeformParams | PaperParams) -> Document:
    """All parameters by name; those that only the other preset has, with their values there."""
    if isinstance(params, DeformParams):
        return PaperParams().as_dict() | params.as_dict()
    return DeformParams(max_spacing=0.25, min_spacing=0.0).as_dict() | params.as_dict()
