"""Reaching benchmark: MotionBenchMaker's problems of an arm among shelves, tables, boxes and cages."""

from __future__ import annotations

import os
from collections.abc import Iterable
from time import perf_counter

import numpy as np

from elastic_strips.errors import ConfigurationError
from elastic_strips.planning import plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.strip import strip_clearance
from workshop.reach_problems import ReachProblem, load_mbm

from .measure import Figures, Note, head, percentiles, silent

_START_DISTANCE = 2.0  # [m] that a base begins off where it is to stand
_START_DIRECTIONS = tuple(k * np.pi / 4.0 for k in (0, 1, -1, 2, -2, 3, -3, 4))  # [rad] from straight behind


def bench_mbm(
    root: str | os.PathLike[str],
    robot: str,
    step: Note = silent,
    *,
    stride: int = 1,
    timeout: float = 2.0,
    seed: int = 0,
    base: str = "fixed",
) -> Figures:
    """Plan the problems: how many of the valid ones are certified, how fast, how long and how clear.

    A problem is not valid where its start or goal is in collision. One problem that is not counted is planned first.
    The time is all of :func:`plan_report`, from robot and scene to a certified strip. A base that can move begins two
    metres away: behind where it is to stand, or in the next of eight directions in which nothing is in the way.

    Args:
        root: folder with ``mbm``.
        robot: ``"fetch"`` or ``"panda"``.
        step: called after each with a note, for a progress bar.
        stride: only every problem of this number is planned.
        timeout: longest time for each [s].
        seed: seed of the planner's random numbers.
        base: ``"fixed"``, ``"diff_drive"`` or ``"omni"``.

    Raises:
        ScenarioError, RobotError: the data are missing or faulty.
    """
    model, problems = load_mbm(root, robot, base=base)
    chosen = problems[::stride]
    _plan(model, problems[-1], timeout, seed)
    runs: list[Figures] = []
    for problem in chosen:
        runs.append(_plan(model, problem, timeout, seed))
        step(f"{problem.name}: {runs[-1]['method']}")
    valid = [r for r in runs if r["valid"]]
    good = [r for r in valid if r["certified"]]
    ms = [r["ms"] for r in good]
    return {
        **head("mbm", robot=robot),
        "base": base,
        "total": len(runs),
        "valid": len(valid),
        "certified": len(good),
        "timeout_s": timeout,
        "seed": seed,
        "ms": {**percentiles(ms), "mean": float(np.mean(ms)) if ms else None, "quartiles": _quartiles(ms)},
        "by_the_line": sum(r["method"] == "line" for r in good),
        "length_rad": percentiles([r["length_rad"] for r in good]),
        "clearance_m": percentiles([r["clearance_m"] for r in good if r["clearance_m"] is not None]),
        "proven_m": {"least": min((r["proven_m"] for r in good), default=None)},
        "kinds": _by_kind(valid, dict.fromkeys(problem.kind for problem in chosen)),
        "failures": [{"name": r["name"], "reason": r["reason"]} for r in valid if not r["certified"]],
        "invalid": [{"name": r["name"], "reason": r["reason"]} for r in runs if not r["valid"]],
        "runs": runs,
    }


def _by_kind(valid: list[Figures], kinds: Iterable[str]) -> Figures:
    """How many problems of each kind are valid, and how many of these are certified."""
    of = {kind: [run for run in valid if run["kind"] == kind] for kind in kinds}
    return {
        kind: {"valid": len(some), "certified": sum(r["certified"] for r in some)} for kind, some in of.items() if some
    }


def _quartiles(ms: list[float]) -> list[float] | None:
    return [float(np.percentile(ms, p)) for p in (25, 50, 75)] if ms else None


def _plan(model: RobotModel, problem: ReachProblem, timeout: float, seed: int) -> Figures:
    run: Figures = {"name": problem.name, "kind": problem.kind}
    reason, turns = "", _START_DIRECTIONS if model.space.planar else (0.0,)
    for turn in turns:
        off = (-_START_DISTANCE * float(np.cos(turn)), -_START_DISTANCE * float(np.sin(turn)))
        try:
            start, goal = problem.ends(model, off)
            began = perf_counter()
            report = plan_report(model, problem.scene, start, goal, timeout=timeout, seed=seed)
            seconds = perf_counter() - began
            break
        except ConfigurationError as error:
            reason = reason or str(error)
    else:
        return {**run, "valid": False, "certified": False, "method": "none", "reason": reason}
    rows = model.space.to_coordinates(report.strip.q)
    clearance = strip_clearance(report.strip, problem.scene) if report.certified else None
    return {
        **run,
        "valid": True,
        "certified": report.certified,
        "method": report.method,
        "reason": report.reason,
        "ms": 1e3 * seconds,
        "attempts": report.attempts,
        "nodes": len(report.strip),
        "length_rad": float(np.linalg.norm(np.diff(rows, axis=0), axis=1).sum()),
        "clearance_m": clearance if clearance is None or np.isfinite(clearance) else None,
        "proven_m": report.report.certificate.clearance,
    }
