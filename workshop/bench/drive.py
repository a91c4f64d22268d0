"""Driving benchmarks: seeded runs among moving obstacles, faults, reaction times, and an endurance run."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from elastic_strips.control.controller import Controller
from elastic_strips.control.interfaces import RunState
from elastic_strips.control.params import DriveParams
from elastic_strips.control.record import DriveResult
from elastic_strips.errors import ElasticStripsError, InputError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Keyframes, Obstacle, Scene, World
from elastic_strips.sim.closed_loop import Simulation, simulation
from elastic_strips.sim.faults import FAULTS, IMAGE_FAULTS, SENSOR_FAULTS, Fault
from elastic_strips.sim.jobs import cached, parallel_map
from elastic_strips.sim.perception import PerceptionParams
from elastic_strips.sim.scenarios import Scenario, get_scenario, make_simulation
from elastic_strips.sim.scenarios.drive import STRIP, DriveOutcome
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.sim.sensors.params import ImageParams
from elastic_strips.strip.params import DeformParams
from workshop.baselines import drive_by
from workshop.datasets import load_house

from .measure import Figures, Note, head, percentiles, resident, silent

_SPEED_CLASSES = ((0.2, 0.5), (0.5, 0.8), (0.8, 1.1), (1.1, 1.5))
"""Classes of the movers' largest speed [m/s]."""
_FAULT_SECONDS = {
    "slip": 2.0,
    "slip_left": 2.0,
    "slip_right": 2.0,
    "spin": 2.0,
    "localization_lost": 2.0,
    "localization_jump": 2.0,
    "localization_coarse": 100.0,
    "fix_drift": 4.0,
    "lost_odometry": 0.5,
    "scene_frozen": 2.0,
    "scene_without_motion": 100.0,
    "scene_reversed": 100.0,
    "glass": 100.0,
}
"""Durations of the faults [s]; one second for the others."""
_REST_SPEED = 0.01
"""A robot that is slower [m/s, rad/s] does not move."""
_TICK_BUDGET_MS = 20.0
"""Time [ms] that a planning tick may take, by default."""
_SLOW = "late tick"
"""Reported of planning on a slow machine, whatever else is wrong."""


@dataclass(frozen=True, slots=True)
class _DriveTask:
    """One run; the scene is known where ``sensors`` is None."""

    scenario: str
    seed: int
    robot: str
    plant: str = "kinematic"
    fault: str = ""
    evade: bool = True
    time_limit: float = 90.0
    method: str = STRIP
    sensors: SensorConfig | None = None
    compute: str = "1"
    alternatives: int = 1
    level: str = ""
    root: str = ""  # the house's data, for a pair in it

    def problem(self, robot: RobotModel) -> Scenario:
        """What is driven."""
        if not self.root:
            return get_scenario(self.scenario, seed=self.seed)
        house = load_house(Path(self.root) / "house", robot, self.seed)
        return Scenario(
            house.name,
            "a furnished house",
            house.world.at(0.0),
            house.start,
            house.goals[0],
            robot=house.robot,
            seed=self.seed,
        )

    def options(self) -> Figures:
        """What only some methods can do, and the fault."""
        options: Figures = {"sensors": self.sensors}
        faults = []
        if self.fault:
            faults = [Fault(self.fault, _fault_start(self.seed), _FAULT_SECONDS.get(self.fault, 1.0))]
        if self.method == STRIP:
            options |= {
                "evade": self.evade,
                "faults": faults,
                "compute": self.compute,
                "alternatives": self.alternatives,
                "level": self.level,
            }
        if self.fault == "viewer_killed":
            options |= {"watch": _doomed_viewer(faults[0].start), "faults": []}
        return options


def _drive_once(task: _DriveTask) -> Figures:
    """Drive and evaluate; a worker's task."""
    robot = cached(task.robot, lambda: load_robot(task.robot))
    try:
        scenario = task.problem(robot)
        outcome = drive_by(
            scenario,
            task.method,
            robot=robot,
            seed=task.seed,
            plant=task.plant,
            time_limit=task.time_limit,
            **task.options(),
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
    return _run_figures(task, scenario, outcome)


def _run_figures(task: _DriveTask, scenario: Scenario, outcome: DriveOutcome) -> Figures:
    """Figures of one run."""
    result, evaluation = outcome.result, outcome.evaluation
    rows = result.record.control
    return {
        "seed": task.seed,
        "fault": task.fault,
        "compute": result.compute,
        "speed_class": scenario.speed_class,
        "movers": len(scenario.world.names_moving),
        "state": result.state.label,
        "reached": outcome.reached,
        "collisions": len(evaluation.collisions),
        "collisions_standing": sum(c.obstacle not in scenario.world.names_moving for c in evaluation.collisions),
        "collisions_seen": outcome.seen_collisions,
        "unseen": list(outcome.unseen),
        "contacts": evaluation.as_dict()["collisions"],
        "contacts_at_rest": len(evaluation.rest_contacts),
        "min_clearance_m": evaluation.min_clearance_m if evaluation.closest else None,
        "time_s": evaluation.time_s,
        "path_m": evaluation.path_m,
        "stops": [[time, reason] for time, reason in result.stops],
        "stops_without_reason": sum(not reason for _, reason in result.stops),
        "at_rest_at_end": bool(np.abs(rows.v[-1]).max() < 0.01),
        "replans": result.replans,
        "limit_excess": dict(evaluation.excess),
        "max_lateral_slip": evaluation.max_lateral_slip_m,
        "tracking_m": outcome.tracking_error,
        "constraint_rad": outcome.constraint_error,
        "physical_contacts": list(outcome.physical_contacts),
        "tick_ms": result.statistics.percentiles(),
        "ticks": _ticks(result),
        "planned_anew_s": _planned_anew(result),
        "faults": [[e.time, e.reason] for e in result.events if e.kind in ("fault", "localization")],
        "wall_s": result.seconds,
    }


def _ticks(result: DriveResult) -> Figures:
    """Durations [ms] of all planning ticks of a run, and which of them began while the robot moved."""
    control, ticks = result.record.control, result.record.planning
    row = np.searchsorted(control.time, ticks.time).clip(max=len(control) - 1)
    return {
        "ms": ticks.tick_ms.round(2).tolist(),
        "moving": (np.abs(control.v[row]).max(axis=1) > _REST_SPEED).astype(int).tolist(),
    }


def _planned_anew(result: DriveResult) -> list[float]:
    """Simulated times [s] for which the robot stood and waited for each strip that was replanned."""
    control = result.record.control
    stands = np.abs(control.v).max(axis=1) < _REST_SPEED
    begun: float | None = None
    took = []
    for event in result.events:
        if event.kind == "replanning":
            begun = event.time
        elif event.kind == "replanned" and begun is not None:
            waited = (control.time >= begun) & (control.time <= event.time) & stands
            took.append(float(waited.sum() * (control.time[1] - control.time[0])))
            begun = None
    return took


def bench_drive(
    robot: str,
    seeds: Sequence[int],
    step: Note = silent,
    *,
    scenario: str = "moving-corridor",
    plant: str = "kinematic",
    evade: bool = True,
    method: str = STRIP,
    sensors: SensorConfig | None = None,
    compute: str = "1",
    alternatives: int = 1,
    level: str = "",
    time_limit: float = 90.0,
    root: str | Path = "",
    processes: int | None = None,
) -> Figures:
    """Drive a scenario of many seeds.

    Args:
        robot: name or URDF file.
        seeds: seeds of the runs.
        step: called after each finished run.
        scenario, plant, evade, method, sensors, compute, alternatives, level, time_limit: as for the drive.
        root: folder that holds ``house``: its pairs are driven then.
        processes: runs at once.

    Returns:
        Figures: how many reached, contacts at speed, by class of the movers' speed; the runs themselves.

    Raises:
        InputError: no run could begin, all for one reason.
    """
    # Long by its options alone, which stand three times: in the signature, a task and the figures.
    tasks = [
        _DriveTask(
            scenario,
            int(seed),
            robot,
            plant,
            evade=evade,
            method=method,
            sensors=sensors,
            compute=compute,
            alternatives=alternatives,
            level=level,
            time_limit=time_limit,
            root=str(root),
        )
        for seed in seeds
    ]
    runs = []
    for run in parallel_map(_drive_once, tasks, processes):
        runs.append(run)
        step(f"seed {run['seed']}: {'reached' if run['reached'] else 'not reached'}")
    errors = {run.get("error") for run in runs}
    if len(errors) == 1 and (error := errors.pop()) is not None:
        raise InputError(f"none of {len(runs)} runs could begin: {error}")
    runs.sort(key=lambda r: r["seed"])
    return {
        **head("drive", robot=robot),
        "scenario": scenario,
        "plant": plant,
        "evade": evade,
        "alternatives": alternatives,
        "level": level,
        "method": method,
        "compute": compute if method == STRIP else "free",
        "sensors": [] if sensors is None else list(sensors.names),
        **_summary(runs),
        "classes": _by_speed(runs),
        "runs": runs,
    }


def _by_speed(runs: list[Figures]) -> list[Figures]:
    """Figures by class of the movers' speed; of the last one the upper end is part."""
    classes = []
    for low, high in _SPEED_CLASSES:
        mine = [r for r in runs if r.get("speed_class") and low <= r["speed_class"] < high + (high == 1.5) * 1e-6]
        if mine:
            classes.append({"from": low, "to": high, **_summary(mine)})
    return classes


def bench_disturb(
    robot: str,
    seeds: Sequence[int],
    step: Note = silent,
    *,
    kinds: Sequence[str] | None = None,
    scenario: str = "corridor",
    sensors: SensorConfig | None = None,
    compute: str = "1",
    processes: int | None = None,
) -> Figures:
    """Put each kind of fault into many seeded runs: goal reached after it, no contact at speed, fault named in the log.

    Args:
        robot: name or URDF file.
        seeds: seeds of the runs.
        step: called after each finished run.
        kinds: kinds of `FAULTS`; all where None, without those of sensors or cameras where there are none.
        scenario: the scenario that is driven.
        sensors: the robot's sensors; a known scene where None.
        compute: cost of computing; see :func:`~elastic_strips.sim.simulation`.
        processes: runs at once.
    """
    if kinds is None:
        images = sensors is not None and any(isinstance(sensor, ImageParams) for sensor in sensors.sensors)
        missing = () if images else IMAGE_FAULTS if sensors is not None else SENSOR_FAULTS
        kinds = tuple(kind for kind in FAULTS if kind not in missing)
    tasks = [
        _DriveTask(scenario, int(s), robot, fault=kind, time_limit=60.0, sensors=sensors, compute=compute)
        for kind in kinds
        for s in seeds
    ]
    runs = []
    for run in parallel_map(_drive_once, tasks, processes):
        runs.append(run)
        step(f"{run['fault']}, seed {run['seed']}")
    summary = {}
    for kind in kinds:
        mine = [r for r in runs if r["fault"] == kind]
        summary[kind] = {
            **_summary(mine),
            "at_rest_or_goal": float(np.mean([r.get("at_rest_at_end", False) for r in mine])),
            "named": float(np.mean([any(reason != _SLOW for _, reason in r.get("faults", ())) for r in mine])),
        }
    rows = [
        {
            "disturbance": r["fault"],
            "seed": r["seed"],
            "reached": r["reached"],
            "contacts_at_speed": r["collisions"],
            "contacts_at_speed_standing": r.get("collisions_standing", 0),
            "contacts_at_rest": r.get("contacts_at_rest", 0),
            "off_reference_m": r.get("tracking_m"),
            "named_after_s": _named_after(r),
            "faults_named": [reason for _, reason in r.get("faults", ())],
        }
        for r in runs
    ]
    return head("disturb", robot=robot, scenario=scenario, compute=compute, kinds=summary, rows=rows, runs=runs)


def _fault_start(seed: int) -> float:
    """When the fault of a run begins [s]."""
    return float(np.random.default_rng(seed).uniform(1.0, 6.0))


def _named_after(run: Figures) -> float | None:
    """Time [s] from a fault's beginning until one is named, without those of slow planning."""
    begin = _fault_start(run["seed"])
    times = (t - begin for t, reason in run.get("faults", ()) if not reason.startswith(_SLOW) and t >= begin)
    return min(times, default=None)


def _summary(runs: list[Figures]) -> Figures:
    """Figures of some runs."""
    done = [r for r in runs if "error" not in r]
    return {
        "count": len(runs),
        "reached": float(np.mean([r["reached"] for r in runs])),
        "collisions": int(sum(r["collisions"] for r in runs)),
        "collisions_seen": int(sum(r["collisions_seen"] for r in runs)),
        "collisions_standing": int(sum(r.get("collisions_standing", 0) for r in runs)),
        "physical_contacts": int(sum(len(r["physical_contacts"]) for r in done)),
        "largest_excess": max((max(r["limit_excess"].values(), default=0.0) for r in done), default=0.0),
        "runs_with_contacts_at_rest": int(sum(r["contacts_at_rest"] > 0 for r in done)),
        "stops": int(sum(len(r["stops"]) for r in done)),
        "stops_without_reason": int(sum(r["stops_without_reason"] for r in done)),
        "time_s": percentiles([r["time_s"] for r in done if r["reached"]]),
        "tracking_m": _where_known(done, "tracking_m"),
        "constraint_rad": _where_known(done, "constraint_rad"),
        "tick_ms_p50": percentiles([r["tick_ms"]["p50"] for r in done]),
        "tick_ms_p99": percentiles([r["tick_ms"]["p99"] for r in done]),
        "ticks": _tick_figures(done),
        "planned_anew_s": percentiles([s for r in done for s in r["planned_anew_s"]]),
        "errors": [r["error"] for r in runs if "error" in r],
    }


def _where_known(runs: list[Figures], key: str) -> Figures:
    """Percentiles of a figure that not every run has."""
    return percentiles([run[key] for run in runs if run[key] is not None])


def _tick_figures(runs: list[Figures]) -> Figures:
    """Of all planning ticks of the runs together, by the wall clock."""
    ms = np.array([value for run in runs for value in run["ticks"]["ms"]])
    moving = np.array([value for run in runs for value in run["ticks"]["moving"]], dtype=bool)
    return {
        "ms": percentiles(ms),
        "count": len(ms),
        "over_20_ms": float((ms > _TICK_BUDGET_MS).mean()) if len(ms) else None,
        "moving_max_ms": float(ms[moving].max()) if moving.any() else None,
    }


def _doomed_viewer(time: float) -> Callable[[Simulation[Controller]], None]:
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


_POST_LEAD_TIME = 1.8
"""Time [s] ahead on the path, where the obstacle appears."""
_POST_RADIUS = 0.15  # [m]
_BASE_HALF_WIDTH = 0.27
"""Of the base [m]; the obstacle reaches into its path from the side."""


def bench_reaction(robot: RobotModel, seeds: Sequence[int], step: Note = silent, *, depth: float = 0.1) -> Figures:
    """Planning at 100 Hz: a post appears on the strip; ticks until a motion along a new certified strip is followed.

    The post stands beside the path and reaches ``depth`` [m] into the area that the base sweeps, left or right by seed;
    every other one is low (0.3 m), the rest as high as the robot.

    The scene is sensed without delay, so that the time is the planner's own. In ticks: from the first tick with the
    post to the one whose command follows the new motion. In milliseconds: those ticks, the last one up to the end of
    the computation by the wall clock.
    """
    rows = []
    for seed in seeds:
        step(f"seed {seed}")
        try:
            row = _once(robot, int(seed), depth)
        except ElasticStripsError as error:
            row = {"seed": int(seed), "error": str(error)}
        rows.append(row)
    good = [r for r in rows if "ticks" in r]
    return {
        **head("reaction", robot=robot.name),
        "depth_m": depth,
        "count": len(rows),
        "reacted": len(good),
        "ticks": percentiles([r["ticks"] for r in good]),
        "ms": percentiles([r["ms"] for r in good]),
        "tick_ms": percentiles([r["tick_ms"] for r in good]),
        "runs": rows,
    }


def _once(robot: RobotModel, seed: int, depth: float) -> Figures:
    params = replace(DriveParams(), plan_every=1, latency=1)
    scenario = get_scenario("corridor", seed=seed)
    options: Figures = {
        "robot": robot,
        "seed": seed,
        "params": params,
        "perception": PerceptionParams(delay=0.0),
        "compute": "1",
    }
    free = make_simulation(scenario, **options)
    track = free.run(time_limit=7.0).record.control
    appears = float(np.random.default_rng(seed).uniform(2.0, 4.0))
    k = min(int((appears + _POST_LEAD_TIME) / params.control_dt), len(track) - 1)
    x, y, yaw = track.reference[k, :3]
    side = (_BASE_HALF_WIDTH + _POST_RADIUS - depth) * (1.0 if seed % 2 else -1.0)
    height = 0.3 if seed % 4 < 2 else 1.6
    at = (x - side * np.sin(yaw), y + side * np.cos(yaw), 0.5 * height)
    post = Cylinder(_POST_RADIUS, height, at=at, name="post")
    world = World(Scene([*scenario.scene, post]), appears={"post": appears})
    seen: Figures = {}

    def watch(driven: Simulation[Controller]) -> None:
        result = driven.controller.result
        if driven.time < appears or "ticks" in seen:
            return
        seen.setdefault("at", driven.time)
        if result is None or not result.accepted or not result.report.certified:
            return
        latency = round((result.motion.start_time - driven.time) / params.control_dt) if result.motion else 0
        ticks = round((driven.time - seen["at"]) / params.control_dt) + latency
        last = driven.controller.statistics.seconds[-1]
        seen["ticks"] = ticks
        seen["tick_ms"] = 1e3 * last
        seen["ms"] = 1e3 * ((ticks - latency) * params.control_dt + last)
        driven.stop()

    driven = make_simulation(replace(scenario, scene=world.scene, timeline=world), **options, watch=watch)
    driven.run(time_limit=appears + 3.0)
    return {"seed": seed, "appears_s": appears, **{k: seen[k] for k in ("ticks", "ms", "tick_ms") if k in seen}}


_ROW_SECONDS = 120.0
"""Simulated time [s] of one row of figures."""


def bench_soak(robot: RobotModel, hours: float = 1.0, step: Note = silent, *, seed: int = 0) -> Figures:
    """Drive back and forth for ``hours`` of simulated time.

    Returns:
        Resident memory [MB] and percentiles of the ticks, window by window; ``growth`` is that of the memory from the
        end of the first tenth to the end.
    """
    world = hall_world(seed)
    ends = [robot.home(x=-3.5), robot.home(x=3.5)]
    rows: list[Figures] = []
    params = DriveParams(deform=DeformParams(max_nodes=200), time_limit=3600.0 * hours)
    begin = {"tick": 0, "time": 0.0}
    legs = 0

    def watch(driven: Simulation[Controller]) -> None:
        nonlocal legs
        if driven.time - begin["time"] < _ROW_SECONDS:
            return
        seconds = driven.controller.statistics.seconds
        mine = 1e3 * np.array(seconds[int(begin["tick"]) :])
        begin.update(tick=len(seconds), time=driven.time)
        gc.collect()
        rows.append({"time_s": driven.time, "memory_mb": resident(), "tick_ms": percentiles(mine)})
        step(f"{driven.time / 60:.0f} min, {rows[-1]['memory_mb']:.0f} MB")

    driven = simulation(
        robot, world, ends[0], ends[1], params=params, seed=seed, watch=watch, record=False, compute=1.0
    )
    controller = driven.controller
    while driven.time < 3600.0 * hours:
        driven.run(time_limit=3600.0 * hours)
        legs += controller.executor.at_goal
        if not controller.executor.at_goal:
            break
        controller.retarget(ends[legs % 2])
    warm = rows[max(len(rows) // 10, 1) - 1] if rows else None
    return {
        **head("soak", robot=robot.name),
        "hours": driven.time / 3600.0,
        "legs": legs,
        "stops": len(controller.stops),
        "memory_mb": {"warm": warm and warm["memory_mb"], "end": rows[-1]["memory_mb"] if rows else None},
        "growth": rows[-1]["memory_mb"] / warm["memory_mb"] - 1.0 if warm else None,
        "tick_ms_first_half": percentiles([r["tick_ms"]["p99"] for r in rows[: len(rows) // 2]]),
        "tick_ms_second_half": percentiles([r["tick_ms"]["p99"] for r in rows[len(rows) // 2 :]]),
        "windows": rows,
    }


def hall_world(seed: int) -> World:
    """A hall with pillars, and pedestrians that cross it on endless loops."""
    rng = np.random.default_rng(seed)
    obstacles: list[Obstacle] = [
        Box((0.4, 0.4, 1.2), at=(x, y, 0.6)) for x, y in ((-2.0, 1.1), (-0.7, -1.0), (0.8, 1.2), (2.2, -1.1))
    ]
    for k in range(5):
        obstacles.append(crossing(f"person-{k}", rng.uniform(-2.5, 2.5), rng.uniform(14.0, 22.0)))
    return World(Scene(obstacles))


def crossing(name: str, x: float, period: float, reach: float = 3.2) -> Cylinder:
    """A pedestrian that crosses the line y = 0 near ``x`` [m] for ever, up to ``reach`` [m] to both sides, once in
    ``period`` [s]."""
    t = np.arange(0.0, period + 0.05, 0.1) * (period / (np.ceil(period / 0.1) * 0.1))
    phase = 2.0 * np.pi * t / t[-1]
    track = np.column_stack([x + 0.4 * np.cos(phase), reach * np.sin(phase), np.full_like(t, 0.85)])
    track[-1] = track[0]
    return Cylinder(0.25, 1.7, name=name, motion=Keyframes(t, track, loop=True))
