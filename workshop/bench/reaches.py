"""Reaches above the furniture of a house that the robot does not know, by its own sensors, among people who walk."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import DriveParams
from elastic_strips.errors import ElasticStripsError, ScenarioError
from elastic_strips.perception import VolumeMapParams
from elastic_strips.planning import HandPose, find_goals
from elastic_strips.planning.grid_path import grid_path
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Cylinder, Keyframes, PedestrianMotion, Scene, World
from elastic_strips.sim import SensorPerception
from elastic_strips.sim.closed_loop import simulation
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.evaluation.visibility import unseen_contacts
from elastic_strips.sim.jobs import cached, parallel_map
from elastic_strips.sim.sensed_perception import sensing_params
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.strip import DeformParams
from workshop.datasets import house_scene, load_house

from .measure import Figures, Note, head, percentiles, silent
from .picks import Pick, hand_poses, house_pick

LOOKING = {
    "tiago": ("head_1_joint", "head_2_joint"),
    "fetch": ("head_pan_joint", "head_tilt_joint"),
}
"""The joints of heads, by the robot's name."""
_ABOVE = 0.16  # [m] of what is reached for, over the furniture
_BEFORE = 0.02  # [m] from the end of the hand to that
_PERSON = (0.25, 1.7)  # [m] radius and height of a person
_ROOM = 0.35  # [m] radius of what has to fit where people walk
_PACE, _SET_OUT = 0.7, 0.05  # [m/s] their speed, and that at the ends of their ways
_ACCELERATION = 1.0  # [m/s²]
_SMOOTH = 0.8  # [m] over which the corners of their ways are rounded
_APART = 2.0  # [m] of the ways' ends from the robot's start, at least
_FIRST = 1.0  # [m] of a person from the robot at first, at least: who begins in touch with it is no one's fault
_TRIES = 50
_GOALS = 6  # ways to be at a reach that are looked at, whether the base can drive to one
_NEXT = 100_000  # added to a seed where its start or goal is none
_TO_SPARE = DeformParams(clearance=VolumeMapParams().cell)  # what is seen is known to a voxel
_ARM = 2.5  # [m] about a goal, within which the robot stands when it reaches it
_TALL, _FLAT = 1.6, 0.02  # [m] what hangs higher, and what is flatter, is in no robot's way


@dataclass(frozen=True, slots=True)
class _Reach:
    """One drive; a worker's task. The house is known where ``sensors`` is None."""

    root: str
    robot: str
    seed: int
    walkers: int
    sensors: SensorConfig | None
    compute: str
    seconds: float


def people(root: str, robot: RobotModel, scene: Scene, start: Array, count: int, seed: int) -> list[Cylinder]:
    """People who walk to and fro in the house along ways that are free, and stop for whom they would run into.

    Raises:
        ScenarioError: there are not so many ways.
    """
    rng, found = np.random.default_rng((seed, 41)), []
    _, inside = house_scene(root)
    radius, height = _PERSON
    for _ in range(_TRIES):
        if len(found) == count:
            return found
        places = load_house(root, robot, int(rng.integers(1 << 30))).configurations(robot)[:2]
        ends = robot.space.to_coordinates(np.array(places))[:, :2]
        if np.hypot(*(ends - start[:2]).T).min() < _APART:
            continue
        way = grid_path(robot, scene, *places, box=(inside[0], inside[1]), inner=_ROOM).points
        if way is None:
            continue
        points, times = _walked(np.asarray(way, dtype=float)[:, :2])
        there_and_back = np.vstack((points, points[-2::-1]))
        times = np.concatenate((times, 2.0 * times[-1] - times[-2::-1]))
        z = np.full((len(times), 1), 0.5 * height)
        shift = float(rng.uniform(0.0, times[-1]))
        at_first = [np.interp(shift, times, there_and_back[:, k]) for k in (0, 1)]
        if np.hypot(*(at_first - start[:2])) < _FIRST:
            continue
        track = Keyframes(times - shift, np.hstack((there_and_back, z)), loop=True)
        found.append(
            Cylinder(
                radius,
                height,
                name=f"person-{len(found)}",
                motion=PedestrianMotion(track, acceleration=2.0),
            )
        )
    raise ScenarioError(f"{root}: no ways for {count} people among {_TRIES}")


def _walked(way: Array) -> tuple[Array, Array]:
    """Points (K, 2) along a way (n, 2) with round corners, and the times [s] at which they are passed."""
    step = 0.1
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))))
    at = np.linspace(0.0, along[-1], max(int(along[-1] / step), 2) + 1)
    points = np.column_stack([np.interp(at, along, way[:, k]) for k in (0, 1)])
    n = max(int(_SMOOTH / step), 1)
    padded = np.vstack((np.repeat(points[:1], n, axis=0), points, np.repeat(points[-1:], n, axis=0)))
    kernel = np.ones(2 * n + 1) / (2 * n + 1)
    points = np.column_stack([np.convolve(padded[:, k], kernel, mode="valid") for k in (0, 1)])
    length = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    left = np.minimum(length, length[-1] - length)
    speed = np.minimum(_PACE, np.sqrt(_SET_OUT**2 + _ACCELERATION * left))
    dt = np.diff(length) / (0.5 * (speed[1:] + speed[:-1]))
    return points, np.concatenate(([0.0], np.cumsum(np.maximum(dt, 1e-3))))


def _drive(task: _Reach) -> Figures:
    looking = LOOKING.get(task.robot, ())
    robot = cached(f"{task.robot} looking", partial(load_robot, task.robot, looking=looking))
    row: Figures = {"seed": task.seed, "on": "", "state": "", "reason": "", "reached": False}
    try:
        return row | _driven(robot, task)
    except ElasticStripsError as error:
        return row | {"state": "error", "reason": f"{type(error).__name__}: {error}"}


def reach(root: str, robot: RobotModel, seed: int) -> tuple[Pick, list[HandPose]]:
    """A start, and hand poses above furniture elsewhere that the robot drives to and reaches where it knows the house,
    with a voxel to spare.

    The start is one that the sensed scenes ask for: within `VolumeMapParams.start_radius` of it nothing stands.

    Raises:
        ScenarioError: there is none among so many.
    """
    nowhere: ScenarioError | None = None
    for k in range(_TRIES):
        try:
            pick = house_pick(root, robot, seed + k * _NEXT)
        except ScenarioError as error:  # a start from which it found nothing to pick
            nowhere = error
            continue
        start = robot.space.to_coordinates(pick.start)
        if _room(pick.scene, start[:2]) < VolumeMapParams().start_radius:
            continue
        at = np.array(pick.can.pose[:3, 3])
        at[2] = pick.surface + _ABOVE
        poses = hand_poses(robot, at, before=_BEFORE)
        about = Scene([o for o in pick.scene if _room(Scene([o]), at[:2]) < _ARM])
        goals = find_goals(robot, about, pick.start, poses, count=_GOALS, params=_TO_SPARE).configurations
        # One that starts outside may stand before a wall, with what it reaches for behind it.
        if any(grid_path(robot, pick.scene, pick.start, goal).points is not None for goal in goals):
            return pick, poses
    raise ScenarioError(f"{root}: no start with room and no reach among {_TRIES}") from nowhere


def _room(scene: Scene, place: Array) -> float:
    """How far [m] from a place (2,) something stands or hangs, above the floor and no higher than a robot."""
    table = scene.table
    low, high = table.center[:, 2] - table.half_extents[:, 2], table.center[:, 2] + table.half_extents[:, 2]
    off = np.maximum(np.abs(table.center[:, :2] - place) - table.half_extents[:, :2], 0.0)
    return float(np.hypot(*off[(low < _TALL) & (high > _FLAT)].T).min(initial=np.inf))


def _driven(robot: RobotModel, task: _Reach) -> Figures:
    pick, poses = reach(task.root, robot, task.seed)
    start = robot.space.to_coordinates(pick.start)
    walkers = people(task.root, robot, pick.scene, start, task.walkers, task.seed) if task.walkers else []
    world, sensors = World(Scene([*pick.scene, *walkers])), task.sensors
    params, perception = DriveParams(), None
    if sensors is not None:
        params = sensing_params(params, robot, sensors)
        perception = SensorPerception(robot, world, pick.start, sensors=sensors, seed=task.seed)
    driven = simulation(
        robot,
        world,
        pick.start,
        [poses],
        params=params,
        perception=perception,
        seed=task.seed,
        compute=task.compute,
    )
    result = driven.run(time_limit=task.seconds)
    found = evaluate(result.record, robot, driven.world, driven.limits)
    unseen = () if sensors is None else unseen_contacts(result.record, found, robot, driven.world, sensors)
    return {
        "on": pick.on,
        "at": list(poses[0].position),
        "state": result.state.name,
        "reason": result.reason,
        "reached": result.reached > 0 and result.state.name == "REACHED",
        "time_s": float(result.record.control.time[-1]),
        "stops": [[time, why] for time, why in result.stops],
        "replans": result.replans,
        "contacts_seen": sum(contact not in unseen for contact in found.collisions),
        "contacts_unseen": sum(contact in unseen for contact in found.collisions),
        "contacts_at_rest": len(found.rest_contacts),
        "tick_ms": result.statistics.percentiles(),
    }


def bench_reaches(
    robot: str,
    seeds: Iterable[int],
    step: Note = silent,
    *,
    root: str,
    walkers: int = 0,
    sensors: SensorConfig | None = None,
    compute: str = "work",
    seconds: float = 180.0,
    processes: int | None = None,
) -> Figures:
    """Reach for places above the furniture of the house, from starts elsewhere in it.

    Args:
        robot: name of the robot; the joints of its head look, where it has one.
        seeds: one for each drive.
        step: called after each.
        root: folder that holds ``house/house.json``.
        walkers: how many people walk about.
        sensors: simulated sensors, from which alone the scene is estimated; a known scene where None.
        compute: cost of computing; see :func:`~elastic_strips.sim.simulation`.
        seconds: longest drive [s].
        processes: number of processes; one for each core where None.

    Raises:
        ScenarioError: the data are missing or damaged.
    """
    folder = str(Path(root) / "house")
    house_scene(folder)  # what is wrong with the file is wrong with all drives
    tasks = [_Reach(folder, robot, int(seed), walkers, sensors, compute, seconds) for seed in seeds]
    runs = []
    for run in parallel_map(_drive, tasks, processes):
        runs.append(run)
        step(f"seed {run['seed']}: {run['state'].lower()}")
    runs.sort(key=lambda run: run["seed"])
    reached = [run for run in runs if run["reached"]]
    return {
        **head("reaches", robot=robot, compute=compute),
        "sensors": [] if sensors is None else list(sensors.names),
        "walkers": walkers,
        "count": len(runs),
        "reached": len(reached),
        "contacts_seen": sum(run.get("contacts_seen", 0) for run in runs),
        "contacts_unseen": sum(run.get("contacts_unseen", 0) for run in runs),
        "contacts_at_rest": sum(run.get("contacts_at_rest", 0) for run in runs),
        "stops": sum(len(run.get("stops", ())) for run in runs),
        "time_s": percentiles([run["time_s"] for run in reached]),
        "failures": dict(Counter(_kind(run) for run in runs if not run["reached"])),
        "runs": runs,
    }


def _kind(run: Figures) -> str:
    """What a drive failed at, in a few words."""
    reason = str(run["reason"])
    for word, kind in (
        ("unseen-", "before what was not seen"),
        ("goal is in collision", "the goal was taken"),
        ("would touch something", "no configuration that reaches the goal was free"),
        ("walled in", "the start or the goal was walled in"),
        ("no way", "no way was found"),
        ("not certified", "a motion was not certified"),
    ):
        if word in reason:
            return kind
    return reason.split(":")[0] or run["state"].lower()
