"""Others' paths: planned by OMPL and RoboPlan, certified as they come, repaired, and followed while something comes.

Each planner plans in an environment of its own, as for `workshop.bench.peers`. Its path is taken as it is handed over,
by `load_path`. What comes is a person, or a ball where the base stands, that goes at a constant velocity to where the
robot would be in the middle of its way at the time when it would be there.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import certify
from elastic_strips.errors import ElasticStripsError, ParameterError
from elastic_strips.io import PathFile, load_path
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Twist, World
from elastic_strips.sim.closed_loop import simulation
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Strip, repair
from elastic_strips.trajectory import retime

from .measure import Figures, Note, head, percentiles, silent
from .peers import Problem, asked, environment, export_robot

OTHERS = ("ompl", "ompl_simplified", "roboplan")
"""Planners of `workshop.bench.peers` whose paths are looked at."""
_SPEED = 0.25  # [m/s] of what comes
_ROOM = 0.15  # [m] that it leaves the robot at the start
_DIRECTIONS = 24  # from which it may come
_BOXES = 6  # about an arm
_TRIES = 2000


def bench_others(
    robot: RobotModel,
    seeds: Sequence[int],
    step: Note = silent,
    *,
    planners: Sequence[str] = OTHERS,
    environments: str | os.PathLike[str],
    timeout: float = 10.0,
    compute: str | float = "work",
) -> Figures:
    """Paths of other planners: how many are certified, refuted, repaired, and reach their end online.

    Args:
        robot: the robot; a base that moves drives through corridors, an arm that stands is among boxes.
        seeds: of the scenes.
        step: called after each piece of work with a note, for a progress bar.
        planners: names of ``OTHERS``.
        environments: folder for the planners' environments; made where it is missing.
        timeout: longest time for each path [s].
        compute: what computing costs in the drives, as for :func:`simulation`.

    Raises:
        ParameterError: an unknown planner.
    """
    unknown = [name for name in planners if name not in OTHERS]
    if unknown:
        raise ParameterError(f"planners: no planner {unknown[0]!r}; there are {', '.join(OTHERS)}")
    problems = [_corridor(robot, seed) if robot.space.planar else _boxes(robot, seed) for seed in seeds]
    rows: Figures = {}
    for name in planners:
        python, reason = environment(Path(environments), name)
        step(f"{name}: {reason or 'ready'}")
        if python is None:
            rows[name] = {"skipped": reason}
            continue
        with tempfile.TemporaryDirectory() as folder:
            joints = export_robot(Path(folder), robot, problems)
            try:
                told, paths = asked(python, name, Path(folder), joints, problems, timeout)
            except ElasticStripsError as error:
                rows[name] = {"skipped": str(error)}
                continue
        names = [{"base_x": "x", "base_y": "y", "base_yaw": "yaw"}.get(name, name) for name in joints]
        runs = []
        for seed, problem, (found, ms, why) in zip(seeds, problems, paths, strict=True):
            run: Figures = {"seed": seed, "solved": found is not None, "ms": ms, "why": why}
            if found is not None:
                run |= _looked_at(robot, problem.scene, load_path(found, robot, joint_names=names), seed, compute)
            runs.append(run)
            step(f"{name}: {seed}")
        rows[name] = {**told, **_figures(runs)}
    return {**head("others", robot=robot.name, base=robot.base_kind.value), "seeds": list(seeds), "planners": rows}


def _corridor(robot: RobotModel, seed: int) -> Problem:
    found = get_scenario("corridor", seed=seed)
    return Problem(found.scene, robot.space.to_coordinates(np.array(found.ends(robot))))


def _boxes(robot: RobotModel, seed: int) -> Problem:
    """Boxes about an arm, and two postures that are free, between which the straight line is not.

    Raises:
        ParameterError: none were found.
    """
    rng = np.random.default_rng(seed)
    for _ in range(_TRIES):
        turn, far = rng.uniform(-np.pi, np.pi, _BOXES), rng.uniform(0.35, 0.7, _BOXES)
        at = np.column_stack((far * np.cos(turn), far * np.sin(turn), rng.uniform(0.1, 0.9, _BOXES)))
        sizes = rng.uniform(0.05, 0.2, (_BOXES, 3))
        scene = Scene([Box(s, at=p, name=f"box-{k}") for k, (s, p) in enumerate(zip(sizes, at, strict=True))])
        ends = rng.uniform(robot.space.lower, robot.space.upper, (2, robot.nv))
        standing = [certify(robot, scene, [q, q], clearance=0.02, measure=False).certified for q in ends]
        if all(standing) and not certify(robot, scene, ends, measure=False).certified:
            return Problem(scene, ends)
    raise ParameterError(f"seed={seed}: no problem among {_TRIES}")


def _looked_at(robot: RobotModel, scene: Scene, path: PathFile, seed: int, compute: str | float) -> Figures:
    """What a path is worth as it is, repaired, and driven."""
    found = certify(robot, scene, path, interpolation="line")
    mended = repair(robot, scene, path)
    run: Figures = {
        "configurations": len(path.q),
        "verdict": found.verdict.value,
        "reason": found.reason,
        "depth_m": None if found.distance is None else -found.distance,
        "least_m": found.least if found.least is not None and np.isfinite(found.least) else None,
        "repaired": mended.certified,
        "repair_reason": mended.reason,
        "moved_m": mended.moved,
    }
    comer = _comer(robot, scene, mended.strip, seed)
    if comer is None:
        return run | {"driven": None}
    world = World(scene.with_obstacle(comer))
    timed = retime(mended.strip)
    blind = certify(robot, world, timed.q, times=timed.time, measure=False)
    driven = simulation(robot, world, path.q[0], path.q[-1], strip=mended.strip, seed=seed, compute=compute).run()
    judged = evaluate(driven.record, robot)
    return run | {
        "blind": blind.verdict.value,
        "driven": {
            "reached": bool(judged.reached),
            "state": driven.state.label,
            "reason": driven.reason,
            "seconds": judged.time_s,
            "path_seconds": timed.duration,
            "contacts_at_speed": len(judged.collisions),
            "contacts_at_rest": len(judged.rest_contacts),
            "clearance_m": judged.min_clearance_m,
            "replans": driven.replans,
        },
    }


def _comer(robot: RobotModel, scene: Scene, strip: Strip, seed: int) -> Cylinder | Sphere | None:
    """What meets the robot in the middle of its way; None where it would start too near from everywhere."""
    timed = retime(strip)
    half = 0.5 * timed.duration
    k = int(np.searchsorted(timed.time, half))
    place = _foremost(robot, timed.q[k])
    rng = np.random.default_rng(1000 + seed)
    for turn in rng.permutation(_DIRECTIONS) * (2.0 * np.pi / _DIRECTIONS):
        velocity = _SPEED * np.array([np.cos(turn), np.sin(turn), 0.0])
        at, motion = place - half * velocity, Twist(linear=velocity)
        if robot.space.planar:
            comer: Cylinder | Sphere = Cylinder(0.25, 1.7, at=(at[0], at[1], 0.85), name="comer", motion=motion)
        else:
            comer = Sphere(0.08, at=tuple(at.tolist()), name="comer", motion=motion)
        first = certify(robot, Scene([comer]), strip.q[[0, 0]], clearance=_ROOM, measure=False)
        if first.certified:
            return comer
    return None


def _foremost(robot: RobotModel, q: Array) -> Array:
    """(3,) middle of a base that moves, or the last control point of an arm."""
    if robot.space.planar:
        return np.array([q[0], q[1], 0.0])
    return robot.control_points(q)[-1]


def _figures(runs: list[Figures]) -> Figures:
    solved = [run for run in runs if run["solved"]]
    drives = [run["driven"] for run in solved if run["driven"] is not None]
    return {
        "count": len(runs),
        "solved": len(solved),
        "certified": sum(run["verdict"] == "certified" for run in solved),
        "refuted": sum(run["verdict"] == "refuted" for run in solved),
        "unknown": sum(run["verdict"] == "unknown" for run in solved),
        "repaired": sum(run["repaired"] for run in solved),
        "moved_m": percentiles([run["moved_m"] for run in solved if run["repaired"] and run["moved_m"] > 0.0]),
        "depth_m": percentiles([run["depth_m"] for run in solved if run["depth_m"] is not None]),
        "blind_refuted": sum(run.get("blind") == "refuted" for run in solved),
        "drives": len(drives),
        "reached": sum(drive["reached"] for drive in drives),
        "contacts_at_speed": sum(drive["contacts_at_speed"] for drive in drives),
        "contacts_at_rest": sum(drive["contacts_at_rest"] for drive in drives),
        "replans": sum(drive["replans"] for drive in drives),
        "seconds": percentiles([drive["seconds"] for drive in drives if drive["reached"]]),
        "runs": runs,
    }
