"""Benchmarks of published problems: BARN, DynaBARN and the bridge, driven in the closed loop and evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import DriveParams, DriveResult, ObstacleAssumptions, Tolerance
from elastic_strips.errors import ElasticStripsError
from elastic_strips.planning import PlanReport, plan_report
from elastic_strips.robot import PlanarFootprint, RobotModel, load_robot
from elastic_strips.sim.closed_loop import simulation
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.jobs import cached, parallel_map
from elastic_strips.sim.scenarios.drive import STRIP
from elastic_strips.sim.sensed_perception import SensorPerception, sensing_params
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.strip import DeformParams
from elastic_strips.trajectory import MotionLimits
from workshop.baselines import SCENE_METHODS, BaseLimits, base_simulation
from workshop.datasets import DriveProblem, barn_ids, dynabarn_ids, load_barn, load_bridge, load_dynabarn

from .measure import Figures, Note, head, percentiles, silent

_BARN_SPEED = 2.0
"""Largest speed [m/s] of the robot of BARN's record, which its score is made for."""
_PHASE_SECONDS = 10.0
"""Time [s] by which the loops of moving obstacles are further on from one phase to the next."""
_DWA = {"success": 0.85, "collisions": 0.056, "score": 0.159}
"""Results of the reference planner on the official worlds, from the data's own log."""


@dataclass(frozen=True, slots=True)
class _ProblemTask:
    """One run of one problem; obstacles are known where ``sensors`` is None."""

    kind: str
    root: str
    id: int
    seed: int
    robot: str
    compute: str
    sensors: SensorConfig | None = None
    method: str = STRIP
    phase: int = 0  # of the moving obstacles' loops

    def problem(self) -> DriveProblem:
        """What is driven."""
        folder = Path(self.root) / self.kind
        if self.kind == "barn":
            return load_barn(folder, self.id)
        return load_dynabarn(folder, self.id, begin=self.phase * _PHASE_SECONDS)


def _drive_problem(task: _ProblemTask) -> Figures:
    """Drive and evaluate one problem; a worker's task."""
    robot = cached(task.robot, lambda: load_robot(task.robot))
    problem = task.problem()
    row: Figures = {"id": task.id, "seed": task.seed, "phase": task.phase, "difficulty": problem.difficulty}
    try:
        return row | _driven(problem, robot, task)
    except ElasticStripsError as error:
        return row | {"success": False, "collisions": 0, "reason": str(error), "time_s": None}


def _problem_params(
    problem: DriveProblem, robot: RobotModel, sensors: SensorConfig | None
) -> tuple[DriveParams, MotionLimits]:
    """Parameters for a problem: the robot's full speed, and a clearance for narrow passages."""
    speed = _BARN_SPEED if robot.name.startswith("jackal") else None
    values: Figures = {"wheel_speed": speed, "wheel_acceleration": 2.0, **problem.limits}
    limits = MotionLimits.for_robot(robot, **values)
    moving = any(o.motion is not None for o in problem.world.scene)
    params = DriveParams(
        deform=DeformParams(max_nodes=200, influence=0.3 if not moving else 0.6),
        assumptions=ObstacleAssumptions(acceleration=0.5),
        time_limit=problem.timeout or 120.0,
        replan_after=0.4,
    )
    if sensors is not None:
        params = sensing_params(params, robot, sensors, moving=moving)
    return params, limits


def _driven(problem: DriveProblem, robot: RobotModel, task: _ProblemTask) -> Figures:
    sensors = task.sensors
    params, limits = _problem_params(problem, robot, sensors)
    start, *goals = problem.configurations(robot)
    if task.method != STRIP:
        return _driven_by_base(problem, robot, task, params, limits)
    seen = None
    if sensors is not None:
        seen = SensorPerception(robot, problem.world, start, sensors=sensors, seed=task.seed)
    driven = simulation(
        robot,
        problem.world,
        start,
        np.array(goals),
        params=params,
        limits=limits,
        perception=seen,
        seed=task.seed,
        grid=True,
        path=problem.path if seen is None else None,  # the given path is made of what only a map knows
        compute=task.compute,
    )
    plan = driven.controller.first_plan
    result = driven.run()
    return _evaluated(problem, robot, limits, np.array(robot.space.to_coordinates(goals[-1])), plan, result)


def _driven_by_base(
    problem: DriveProblem, robot: RobotModel, task: _ProblemTask, params: DriveParams, limits: MotionLimits
) -> Figures:
    """The same with a base method, as a disc about the base that may use all that the wheels can do."""
    start, *goals = problem.configurations(robot)
    most = float(limits.drive_speed.max())
    base = BaseLimits.of(
        limits,
        radius=PlanarFootprint.of(robot, start).reach(),
        max_speed=most,
        max_reverse=most if task.method in SCENE_METHODS else 0.0,
        max_turn=np.inf,
    )
    driven = base_simulation(
        robot,
        problem.world,
        start,
        goals[-1],
        task.method,
        params=params,
        limits=limits,
        base=base,
        patience=params.time_limit,  # blocked by what moves, it goes on trying
        sensors=task.sensors,
        seed=task.seed,
    )
    result = driven.run(time_limit=params.time_limit)
    return _evaluated(problem, robot, limits, robot.space.to_coordinates(goals[-1]), None, result)


def _evaluated(
    problem: DriveProblem,
    robot: RobotModel,
    limits: MotionLimits,
    goal: Array,
    plan: PlanReport | None,
    result: DriveResult,
) -> Figures:
    """Figures of a drive, of which only what comes before its goal counts."""
    rows = result.record.control
    near = np.hypot(*(rows.coordinates[:, :2] - goal[:2]).T) <= problem.goal_tolerance
    arrived = int(np.argmax(near)) if near.any() else len(rows) - 1
    end = max(arrived, 1) + 1
    evaluation = evaluate(
        (rows.time[:end], rows.coordinates[:end], rows.v[:end]),
        robot,
        problem.world,
        limits,
        goal=goal,
        tolerance=Tolerance(position=problem.goal_tolerance, yaw=np.pi, joints=np.pi),
    )
    passive = bool(near.any()) and not evaluation.collisions
    success = passive and not evaluation.rest_contacts  # the problems count any contact, the robot's fault or not
    time = float(rows.time[arrived] - rows.time[0])
    row = {
        "success": success,
        "success_passive": passive,
        "reached": bool(near.any()),
        "collisions": len(evaluation.collisions),
        "contacts_at_rest": len(evaluation.rest_contacts),
        "contacts": [[c.time, c.end, c.obstacle, c.depth, c.speed] for c in evaluation.contacts],
        "min_clearance_m": evaluation.min_clearance_m,
        "time_s": time,
        "path_m": evaluation.path_m,
        "planned_by": plan.method if plan else "",
        "plan_s": plan.seconds if plan else None,
        "replans": result.replans,
        "stops": len(result.stops),
        "reason": "" if success else result.reason,
        "tick_ms": result.statistics.percentiles(),
        "wall_s": result.seconds,
    }
    if problem.path_length:
        best = problem.path_length / _BARN_SPEED
        for name, low in (("score", 4.0), ("score_2_8", 2.0)):
            row[name] = float(success) * best / float(np.clip(time, low * best, 8.0 * best))
    return row


def bench_problems(
    kind: str,
    root: str | Path,
    step: Note = silent,
    *,
    robot: str = "jackal-box",
    seeds: int = 1,
    ids: Sequence[int] | None = None,
    difficulty: str = "",
    phases: int = 1,
    method: str = STRIP,
    sensors: SensorConfig | None = None,
    compute: str = "1",
    processes: int | None = None,
) -> Figures:
    """Drive the BARN or DynaBARN problems of a folder.

    Args:
        kind: ``"barn"`` or ``"dynabarn"``.
        root: folder that holds ``barn`` and ``dynabarn``.
        step: called after each run.
        robot: name or URDF of the robot.
        seeds: runs of each problem.
        ids: numbers of the problems; where None the official ones of BARN (divisible by 6), or all of DynaBARN.
        difficulty: only problems of this class; of all where empty.
        phases: runs of each problem and seed, in which the robot sets out at other times of the obstacles' loops.
        method: what steers: the strip, or a base method.
        sensors: simulated sensors, from which alone the scene is estimated; a known scene where None.
        compute: cost of computing; see :func:`~elastic_strips.sim.simulation`.
        processes: number of processes; one for each core where None.

    Raises:
        ScenarioError: the data are missing or damaged.
    """
    folder = Path(root) / kind
    if ids is None:
        ids = [i for i in barn_ids(folder) if i % 6 == 0] if kind == "barn" else list(dynabarn_ids(folder))
    tasks = [
        _ProblemTask(kind, str(root), int(i), seed, robot, compute, sensors, method, phase)
        for i in ids
        for seed in range(seeds)
        for phase in range(phases)
    ]
    if difficulty:
        tasks = [task for task in tasks if task.problem().difficulty == difficulty]
    runs = []
    for run in parallel_map(_drive_problem, tasks, processes):
        runs.append(run)
        step(f"world {run['id']}, seed {run['seed']}: {'success' if run['success'] else 'failed'}")
    runs.sort(key=lambda r: (r["id"], r["seed"], r["phase"]))
    groups = sorted({r["difficulty"] for r in runs if r["difficulty"]})
    return {
        **head(kind, robot=robot, compute=compute if method == STRIP else "free"),
        "method": method,
        "sensors": [] if sensors is None else list(sensors.names),
        "worlds": len({task.id for task in tasks}),
        **_figures(runs),
        "by_difficulty": {g: _figures([r for r in runs if r["difficulty"] == g]) for g in groups},
        "reference": {"DWA": _DWA} if kind == "barn" else {},
        "runs": runs,
    }


def _figures(runs: list[Figures]) -> Figures:
    good = [r for r in runs if r["success"]]
    figures: Figures = {
        "count": len(runs),
        "success": len(good) / max(len(runs), 1),
        "success_passive": sum(r.get("success_passive", False) for r in runs) / max(len(runs), 1),
        "reached": sum(r.get("reached", False) for r in runs) / max(len(runs), 1),
        "contacts_at_speed": sum(r["collisions"] for r in runs),
        "contacts_per_s": _per_second(runs),
        "collisions": sum(r["collisions"] > 0 for r in runs) / max(len(runs), 1),
        "run_into_at_rest": sum(r.get("contacts_at_rest", 0) > 0 for r in runs) / max(len(runs), 1),
        "time_s": percentiles([r["time_s"] for r in good]),
        "clearance_m": {"min": min((r["min_clearance_m"] for r in good), default=None)},
    }
    for name in ("score", "score_2_8"):
        scores = [r.get(name, 0.0) for r in runs]
        if any(name in r for r in runs):
            figures[name] = float(np.mean(scores))
    return figures


def _per_second(runs: list[Figures]) -> float:
    """Contacts, at speed and at rest, in each second that was driven [1/s]."""
    contacts = sum(r["collisions"] + r.get("contacts_at_rest", 0) for r in runs)
    return contacts / max(sum(r["time_s"] or 0.0 for r in runs), 1e-9)


def bench_bridge(root: str | Path, *, robot: str = "bridge-arm", seed: int = 0, compute: str = "1") -> Figures:
    """Plan both legs of the bridge, and drive them one after the other.

    Raises:
        ScenarioError: the data are missing or damaged.
    """
    model = load_robot(robot)
    problem = load_bridge(Path(root) / "bridge")
    start, *goals = problem.configurations(model)
    legs = []
    for leg, (a, b) in enumerate(zip([start, *goals[:-1]], goals, strict=True)):
        report = plan_report(model, problem.world.at(0.0), a, b, seed=seed, timeout=60.0)
        legs.append(
            {
                "leg": leg,
                "certified": report.certified,
                "method": report.method,
                "seconds": report.seconds,
                "clearance_m": report.report.clearance,
                "nodes": len(report.strip),
                "length_m": report.strip.length,
                "reason": report.reason,
            }
        )
    stated: Figures = dict(problem.limits)
    limits = MotionLimits.for_robot(model, **stated)
    driven = simulation(model, problem.world, start, np.array(goals), seed=seed, limits=limits, compute=compute)
    result = driven.run(time_limit=240.0)
    evaluation = evaluate(result.record, model, problem.world, driven.limits)
    return {
        **head("bridge", robot=robot, compute=compute),
        "legs": legs,
        "reached": bool(evaluation.reached),
        "collisions": len(evaluation.collisions),
        "min_clearance_m": evaluation.min_clearance_m,
        "time_s": evaluation.time_s,
        "path_m": evaluation.path_m,
        "stops": [[time, reason] for time, reason in result.stops],
        "replans": result.replans,
    }
