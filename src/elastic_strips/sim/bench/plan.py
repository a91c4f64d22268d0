"""Planning benchmark: from nothing to a certified strip on seeded corridors, or on another seeded scenario."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from elastic_strips.deform import Deformer
from elastic_strips.planning import PlanReport, plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.tunnel import strip_clearance

from ..scenarios import get_scenario
from .measure import machine, percentiles

SOON = 2.0
"""Time [s] within which a strip should be certified."""


def planned_corridors(
    robot: RobotModel, seeds: int, step: Callable[[str], object], *, scenario: str = "corridor", grid: bool = True
) -> list[tuple[int, Scene, PlanReport]]:
    """Plan the corridors of seeds 0 … ``seeds`` − 1, each with a new workspace; one warm-up is not counted."""
    _plan(robot, 10_000, scenario, grid)
    out = []
    for seed in range(seeds):
        scene, report = _plan(robot, seed, scenario, grid)
        out.append((seed, scene, report))
        step(f"seed {seed}: {report.method}")
    return out


def _plan(robot: RobotModel, seed: int, scenario: str, grid: bool) -> tuple[Scene, PlanReport]:
    problem = get_scenario(scenario, seed=seed)
    start, goal = problem.ends(robot)
    report = plan_report(robot, problem.scene, start, goal, seed=seed, deformer=Deformer(robot), grid=grid)
    return problem.scene, report


def bench_plan(
    robot: RobotModel, seeds: int, step: Callable[[str], object] = lambda note: None, *, scenario: str = "corridor",
    grid: bool = True,
) -> dict[str, Any]:  # fmt: skip
    """Success, time to the first certified strip, clearance and slip on a seeded scenario.

    Args:
        robot: the robot.
        seeds: number of corridors.
        step: called after each with a note, for a progress bar.
        scenario: name of the scenario.
        grid: whether a way over a grid is tried before OMPL.
    """
    runs = []
    for seed, scene, report in planned_corridors(robot, seeds, step, scenario=scenario, grid=grid):
        strip = report.strip
        runs.append(
            {
                "seed": seed,
                "certified": report.certified,
                "method": report.method,
                "ms": 1e3 * report.seconds,
                "phases_ms": {k: 1e3 * t for k, t in report.timings.items()},
                "attempts": report.attempts,
                "ticks": report.ticks,
                "nodes": len(strip),
                "clearance_m": float(strip_clearance(strip, scene)),
                "max_lateral_slip_m": float(strip.lateral_slip.max(initial=0.0)),
                "length_m": strip.length,
                "reason": report.reason,
            }
        )
    good = [r for r in runs if r["certified"]]
    return {
        "benchmark": "plan",
        "scenario": scenario,
        "grid": grid,
        "machine": machine(),
        "robot": robot.name,
        "base": robot.base_kind.value,
        "seeds": seeds,
        "certified": len(good) / max(len(runs), 1),
        "certified_within_2_s": sum(r["ms"] <= 1e3 * SOON for r in good) / max(len(runs), 1),
        "line_alone": sum(r["method"] == "line" for r in runs) / max(len(runs), 1),
        "time_to_certified_ms": percentiles([r["ms"] for r in good]),
        "clearance_m": {
            "min": float(min((r["clearance_m"] for r in good), default=np.nan)),
            "p50": float(np.median([r["clearance_m"] for r in good])) if good else None,
            "at_least_2cm": sum(r["clearance_m"] >= 0.02 for r in good) / max(len(good), 1),
        },
        "max_lateral_slip_m": float(max((r["max_lateral_slip_m"] for r in good), default=0.0)),
        "failures": [{"seed": r["seed"], "reason": r["reason"]} for r in runs if not r["certified"]],
        "runs": runs,
    }
