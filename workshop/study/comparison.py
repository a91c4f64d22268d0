"""Comparison: every method on every case, with the same plant and the same sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import Controller, RunState
from elastic_strips.errors import ElasticStripsError, ParameterError, nearest_name
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.sim import Simulation
from elastic_strips.sim.jobs import cached, parallel_map
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.sim.scenarios.drive import STRIP
from elastic_strips.sim.sensors import SensorConfig
from workshop.baselines import BASE_METHODS, drive_by
from workshop.baselines.base_controller import BLOCKED_PATIENCE

_STRIP_SENSED = "strip-sensed"
METHODS = (*BASE_METHODS, _STRIP_SENSED, STRIP)
"""Names of the methods; ``strip-sensed`` has the sensors of the base methods, ``strip`` knows the obstacles."""
CASES = ("case-1", "case-2", "case-3", "case-4", "case-5", "case-6", "bottleneck", "dead-end")
_TRIAL_TIME_LIMIT = 90.0  # [s] of one drive


@dataclass(frozen=True, slots=True)
class Trial:
    """One method on one case."""

    case: str
    method: str
    seed: int = 0
    time_limit: float = _TRIAL_TIME_LIMIT


@dataclass(frozen=True, slots=True)
class TrialResult:
    """Result of a trial.

    Attributes:
        case, method, seed: what was tried.
        reached: whether the robot truly is at the goal: a base within 0.15 m, a strip within 0.05 m.
        contacts: obstacles that were touched, each once.
        clearance: least distance of the whole robot to an obstacle [m]; ∞ without any, NaN where it did not start.
        path: length of the base's path [m].
        time: duration [s].
        turning: sum of all turns of the base [rad].
        roughness: root mean square of the base's yaw acceleration [rad/s²].
        reason: reason of the final state.
    """

    case: str
    method: str
    seed: int
    reached: bool
    contacts: tuple[str, ...]
    clearance: float
    path: float
    time: float
    turning: float
    roughness: float
    reason: str


def compare(
    cases: Sequence[str] = CASES,
    methods: Sequence[str] = METHODS,
    *,
    seeds: Sequence[int] = (0,),
    processes: int | None = None,
    step: Callable[[str], object] = lambda note: None,
) -> tuple[TrialResult, ...]:
    """Drive every case by every method, in the order of cases and methods.

    Args:
        cases: names of scenarios.
        methods: names of :data:`METHODS`.
        seeds: seeds of the scenarios and the noise.
        processes: number of processes; one for each core where None.
        step: called after every trial with its name.

    Raises:
        ScenarioError: an unknown case.
        ParameterError: an unknown method.
    """
    for case in cases:
        get_scenario(case)
    check_methods(methods)
    trials = [Trial(case, method, seed) for case in cases for method in methods for seed in seeds]
    rows: dict[Trial, TrialResult] = {}
    for row in parallel_map(attempt, trials, processes):
        rows[Trial(row.case, row.method, row.seed)] = row
        step(f"{row.case}, {row.method}")
    return tuple(rows[trial] for trial in trials)


def attempt(trial: Trial) -> TrialResult:
    """Drive a case by a method; where the drive cannot start, the goal is not reached.

    Raises:
        ScenarioError: an unknown case.
        ParameterError: an unknown method.
    """
    check_methods([trial.method])
    robot: RobotModel = cached("silvermate", lambda: load_robot("silvermate"))
    scenario = get_scenario(trial.case, seed=trial.seed)
    try:
        outcome = drive_by(
            scenario,
            STRIP if trial.method == _STRIP_SENSED else trial.method,
            robot=robot,
            seed=trial.seed,
            time_limit=trial.time_limit,
            sensors=None if trial.method == STRIP else SensorConfig(),
            **({"watch": _Patience(), "compute": "1"} if trial.method in (STRIP, _STRIP_SENSED) else {}),
        )
    except ElasticStripsError as error:
        nothing = float("nan")
        return TrialResult(trial.case, trial.method, trial.seed, False, (), nothing, 0.0, 0.0, 0.0, nothing, str(error))
    record, reason, evaluation = outcome.result.record, outcome.result.reason, outcome.evaluation
    rows = record.control
    turning, roughness = _turns(rows.time, rows.coordinates[:, 2])
    touched = tuple(dict.fromkeys(contact.obstacle for contact in evaluation.contacts))
    return TrialResult(
        trial.case,
        trial.method,
        trial.seed,
        bool(evaluation.reached),
        touched,
        float(evaluation.min_clearance_m),
        evaluation.path_m,
        evaluation.time_s,
        turning,
        roughness,
        reason,
    )


class _Patience:
    """Workspace: ends the drive of a robot that has stood for as long as a base method may be blocked."""

    def __init__(self) -> None:
        self._since: float | None = None

    def __call__(self, driven: Simulation[Controller]) -> None:
        if driven.controller.state is not RunState.STOPPED:
            self._since = None
        elif self._since is None:
            self._since = driven.time
        elif driven.time - self._since > BLOCKED_PATIENCE:
            driven.stop()


def check_methods(methods: Sequence[str]) -> None:
    """Check names of methods.

    Raises:
        ParameterError: an unknown method.
    """
    for method in methods:
        if method not in METHODS:
            raise ParameterError(f"method {method!r} is unknown{nearest_name(method, METHODS)}")


def _turns(time: Array, yaw: Array) -> tuple[float, float]:
    """Sum of all turns [rad], and root mean square of the yaw acceleration [rad/s²] over tenths of a second."""
    yaw = np.unwrap(yaw)
    at = np.arange(time[0], time[-1], 0.1)
    if len(at) < 3:
        return 0.0, 0.0
    rate = np.diff(np.interp(at, time, yaw)) / 0.1
    return float(np.abs(np.diff(yaw)).sum()), float(np.sqrt(np.mean((np.diff(rate) / 0.1) ** 2)))
