"""Planning and replanning benchmarks: time to a certified strip, from scratch and after an obstacle has moved."""

from __future__ import annotations

import numpy as np

from elastic_strips.control.local_planner import BROKEN_STEPS
from elastic_strips.planning import PlanReport, plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, DeformReport, Strip, displacement, strip_clearance

from .measure import Figures, Note, head, percentiles, silent

_SHORT_PLANNING_TIME = 2.0
"""Time [s] within which a strip should be certified."""


def _planned_corridors(
    robot: RobotModel, seeds: int, step: Note, *, scenario: str = "corridor", grid: bool = True
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
    robot: RobotModel, seeds: int, step: Note = silent, *, scenario: str = "corridor", grid: bool = True
) -> Figures:
    """Success, time to the first certified strip, clearance and slip on a seeded scenario.

    Args:
        robot: the robot.
        seeds: number of corridors.
        step: called after each with a note, for a progress bar.
        scenario: name of the scenario.
        grid: whether a path over a grid is tried before OMPL.
    """
    runs = []
    for seed, scene, report in _planned_corridors(robot, seeds, step, scenario=scenario, grid=grid):
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
        **head("plan", robot=robot.name, scenario=scenario, grid=grid),
        "base": robot.base_kind.value,
        "seeds": seeds,
        "certified": len(good) / max(len(runs), 1),
        "certified_within_2_s": sum(r["ms"] <= 1e3 * _SHORT_PLANNING_TIME for r in good) / max(len(runs), 1),
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


_PUSH_STEP = 0.05
"""How far the obstacle is pushed each time [m]."""
_PUSH_COUNT = 4  # of each strip
_MAX_TICKS = 40  # after a push


def bench_replan(robot: RobotModel, seeds: int, step: Note = silent, *, into: float | None = None) -> Figures:
    """From each certified corridor strip: push the nearest obstacle 5 cm towards it, 4 times; time to certified again.

    The time is that of all ticks from the push to the first certified strip, one tick at least. The jump is the largest
    displacement of any control point at the same node (or, where nodes came or went, at the same share of the path).

    Args:
        robot: the robot.
        seeds: number of corridors.
        step: called after each with a note, for a progress bar.
        into: depth [m] to which the obstacle is pushed into the strip instead. A strip that stays broken for as many
            ticks as the controller would have patience is replanned then, from its start; that is in the time.
    """
    runs = []
    for seed, scene, report in _planned_corridors(robot, seeds, step):
        if not report.certified:
            continue
        deformer, looker = Deformer(robot), Deformer(robot)
        strip = deformer.settle(report.strip, scene, max_ticks=10).strip
        for push in range(_PUSH_COUNT):
            moved = push_nearest(looker, strip, scene, into)
            if moved is None:
                break
            scene = moved
            before = strip
            seconds, ticks, last = recover(deformer, strip, scene, _MAX_TICKS if into is None else BROKEN_STEPS)
            strip, certified, reason, anew = last.strip, last.certified, last.reason, False
            if into is not None and not certified:
                plan = plan_report(robot, scene, strip.q[0], strip.q[-1], seed=seed, deformer=Deformer(robot))
                strip, certified, reason, anew = plan.strip, plan.certified, plan.reason, True
                seconds += plan.seconds
            runs.append(
                {
                    "seed": seed,
                    "push": push,
                    "certified": certified,
                    "anew": anew,
                    "ms": 1e3 * seconds,
                    "ticks": ticks,
                    "jump_m": displacement(before, strip),
                    "clearance_m": float(strip_clearance(strip, scene)),
                    "reason": reason,
                }
            )
            if not certified:
                break
    good = [r for r in runs if r["certified"]]
    return {
        **head("replan", robot=robot.name),
        "seeds": seeds,
        "into_m": into,
        "anew": sum(r["anew"] for r in runs),
        "pushes": len(runs),
        "certified": len(good) / max(len(runs), 1),
        "time_to_certified_ms": percentiles([r["ms"] for r in good]),
        "ticks": percentiles([r["ticks"] for r in good]),
        "jump_m": percentiles([r["jump_m"] for r in good]),
        "clearance_m": {"min": min((r["clearance_m"] for r in good), default=None)},
        "failures": [r for r in runs if not r["certified"]],
        "runs": runs,
    }


def recover(deformer: Deformer, strip: Strip, scene: Scene, most: int) -> tuple[float, int, DeformReport]:
    seconds = 0.0
    for tick in range(1, most + 1):
        report = deformer.step(strip, scene)
        strip = report.strip
        seconds += report.seconds
        if report.certified:
            return seconds, tick, report
    return seconds, most, report


def push_nearest(looker: Deformer, strip: Strip, scene: Scene, into: float | None) -> Scene | None:
    """The scene with the obstacle nearest to a strip moved towards it, or ``into`` it [m]; None where none is near."""
    looker.assess(strip, scene)
    contacts = looker.workspace.obstacles.contacts()
    # not those nearest to the ends, which cannot move
    inner = (contacts.node > 0) & (contacts.node < len(strip) - 1)
    ends = {int(p) for p in contacts.part[~inner]}
    free = np.array([i and int(p) not in ends for i, p in zip(inner, contacts.part, strict=True)], dtype=bool)
    if not free.any():
        return None
    k = np.flatnonzero(free)[int(np.argmin(contacts.distance[free]))]
    name = looker.workspace.obstacles.obstacle_name(int(contacts.part[k]))
    pose = scene.obstacle(name).pose.copy()
    pose[:3, 3] += (_PUSH_STEP if into is None else contacts.distance[k] + into) * contacts.direction[k]
    return scene.moved(name, pose)
