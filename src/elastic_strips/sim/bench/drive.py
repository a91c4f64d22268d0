"""Driving benchmark: many seeded runs among moving obstacles, each judged from its true states."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_strips.errors import ElasticStripsError
from elastic_strips.execution import Controller, RunState
from elastic_strips.robot import load_robot

from ..closed_loop import Simulation
from ..faults import FAULTS, Fault
from ..scenarios import STRIP, drive_scenario, get_scenario
from ..sensors import SensorConfig
from .measure import machine, percentiles
from .pool import cached, spread

CLASSES = ((0.2, 0.5), (0.5, 0.8), (0.8, 1.1), (1.1, 1.5))
"""Classes of the movers' largest speed [m/s]."""
FAULT_SECONDS = {"lost_odometry": 0.5, "scene_frozen": 2.0, "slow_tick": 1.0}
"""Durations of the faults; one second for the others."""


@dataclass(frozen=True, slots=True)
class DriveTask:
    """One run: scenario, seed, robot, plant, perhaps a fault, whether it evades, its longest time [s], method, sensors
    (the robot knows the scene where None)."""

    scenario: str
    seed: int
    robot: str
    plant: str = "kinematic"
    fault: str = ""
    evade: bool = False
    time_limit: float = 90.0
    method: str = STRIP
    sensors: SensorConfig | None = None


def drive_once(task: DriveTask) -> dict[str, Any]:
    """Drive and judge; a worker's task."""
    robot = cached(task.robot, lambda: load_robot(task.robot))
    faults = []
    if task.fault:
        start = float(np.random.default_rng(task.seed).uniform(1.0, 6.0))
        faults = [Fault(task.fault, start, FAULT_SECONDS.get(task.fault, 1.0))]
    scenario = get_scenario(task.scenario, seed=task.seed)
    options: dict[str, Any] = {"sensors": task.sensors}
    if task.method == STRIP:
        options |= {"evade": task.evade, "faults": faults}
    if task.fault == "viewer_killed":
        options |= {"watch": _doomed_viewer(faults[0].start), "faults": []}
    try:
        outcome = drive_scenario(
            scenario,
            method=task.method,
            robot=robot,
            seed=task.seed,
            plant=task.plant,
            time_limit=task.time_limit,
            **options,
        )
    except ElasticStripsError as error:
        return {
            "seed": task.seed,
            "fault": task.fault,
            "error": str(error),
            "reached": False,
            "collisions": 0,
            "collisions_seen": 0,
        }
    result, verdict = outcome.result, outcome.verdict
    rows = result.record.control
    return {
        "seed": task.seed,
        "fault": task.fault,
        "speed_class": scenario.speed_class,
        "movers": len(scenario.world.names_moving),
        "state": result.state.name.lower(),
        "reached": outcome.reached,
        "collisions": len(verdict.collisions),
        "collisions_seen": outcome.seen_collisions,
        "unseen": list(outcome.unseen),
        "contacts": verdict.as_dict()["collisions"],
        "contacts_at_rest": len(verdict.rest_contacts),
        "min_clearance_m": verdict.min_clearance_m if verdict.closest else None,
        "time_s": verdict.time_s,
        "path_m": verdict.path_m,
        "stops": [[time, reason] for time, reason in result.stops],
        "stops_without_reason": sum(not reason for _, reason in result.stops),
        "at_rest_at_end": bool(np.abs(rows.v[-1]).max() < 0.01),
        "replans": result.replans,
        "limit_excess": dict(verdict.excess),
        "max_lateral_slip": verdict.max_lateral_slip_m,
        "tracking_m": outcome.tracking_error,
        "physical_contacts": list(outcome.physical_contacts),
        "tick_ms": result.statistics.percentiles(),
        "faults": [[e.time, e.reason] for e in result.events if e.kind == "fault"],
        "wall_s": result.seconds,
    }


def bench_drive(
    robot: str,
    seeds: Sequence[int],
    step: Callable[[str], object] = lambda note: None,
    *,
    scenario: str = "moving-corridor",
    plant: str = "kinematic",
    evade: bool = False,
    method: str = STRIP,
    sensors: SensorConfig | None = None,
    processes: int | None = None,
) -> dict[str, Any]:
    """Drive a scenario of many seeds.

    Returns:
        Figures: how many reached, contacts at speed, by class of the movers' speed; the runs themselves.
    """
    tasks = [
        DriveTask(scenario, int(seed), robot, plant, evade=evade, method=method, sensors=sensors) for seed in seeds
    ]
    runs = []
    for run in spread(drive_once, tasks, processes):
        runs.append(run)
        step(f"seed {run['seed']}: {'reached' if run['reached'] else 'not reached'}")
    runs.sort(key=lambda r: r["seed"])
    classes = []
    for low, high in CLASSES:
        mine = [r for r in runs if r.get("speed_class") and low <= r["speed_class"] < high + (high == 1.5) * 1e-6]
        if mine:
            classes.append({"from": low, "to": high, **_summary(mine)})
    return {
        "benchmark": "drive",
        "machine": machine(),
        "robot": robot,
        "scenario": scenario,
        "plant": plant,
        "evade": evade,
        "method": method,
        "sensors": [] if sensors is None else list(sensors.names),
        **_summary(runs),
        "classes": classes,
        "runs": runs,
    }


def bench_faults(
    robot: str,
    seeds: Sequence[int],
    step: Callable[[str], object] = lambda note: None,
    *,
    scenario: str = "moving-corridor",
    processes: int | None = None,
) -> dict[str, Any]:
    """Each kind of fault in many seeded runs: at rest or at the goal in the end, no contact at speed, fault named."""
    tasks = [DriveTask(scenario, int(s), robot, fault=kind, time_limit=45.0) for kind in FAULTS for s in seeds]
    runs = []
    for run in spread(drive_once, tasks, processes):
        runs.append(run)
        step(f"{run['fault']}, seed {run['seed']}")
    kinds = {}
    for kind in FAULTS:
        mine = [r for r in runs if r["fault"] == kind]
        kinds[kind] = {
            **_summary(mine),
            "at_rest_or_goal": float(np.mean([r.get("at_rest_at_end", False) for r in mine])),
            "named": float(np.mean([bool(r.get("faults")) for r in mine])),
        }
    return {"benchmark": "faults", "machine": machine(), "robot": robot, "kinds": kinds, "runs": runs}


def _summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of some runs."""
    done = [r for r in runs if "error" not in r]
    return {
        "count": len(runs),
        "reached": float(np.mean([r["reached"] for r in runs])),
        "collisions": int(sum(r["collisions"] for r in runs)),
        "collisions_seen": int(sum(r["collisions_seen"] for r in runs)),
        "physical_contacts": int(sum(len(r["physical_contacts"]) for r in done)),
        "largest_excess": max((max(r["limit_excess"].values(), default=0.0) for r in done), default=0.0),
        "runs_with_contacts_at_rest": int(sum(r["contacts_at_rest"] > 0 for r in done)),
        "stops": int(sum(len(r["stops"]) for r in done)),
        "stops_without_reason": int(sum(r["stops_without_reason"] for r in done)),
        "time_s": percentiles([r["time_s"] for r in done if r["reached"]]),
        "tracking_m": percentiles([r["tracking_m"] for r in done if r["tracking_m"] is not None]),
        "tick_ms_p50": percentiles([r["tick_ms"]["p50"] for r in done]),
        "tick_ms_p99": percentiles([r["tick_ms"]["p99"] for r in done]),
        "errors": [r["error"] for r in runs if "error" in r],
    }


def _doomed_viewer(time: float) -> Callable[[Any], None]:
    """A watcher with a live viewer whose server is killed at a time [s]."""
    from elastic_strips.viewer import Viewer

    viewer = Viewer(server=True, open_browser=False)
    state = {"killed": False}

    def watch(driven: Simulation[Controller]) -> None:
        if driven.time >= time and not state["killed"]:
            state["killed"] = True
            if viewer.server_pid is not None:
                os.kill(viewer.server_pid, signal.SIGKILL)
            driven.controller.log("fault", "viewer killed")
        viewer.update(driven.controller.strip, driven.world.at(driven.time))
        if driven.controller.state is RunState.REACHED:
            viewer.close()

    return watch
