"""Data sets: worlds, starts and goals from published benchmarks: BARN, DynaBARN, the bridge, and a furnished house.

BARN (static worlds of cylinders) and DynaBARN (arenas of moving discs) were made for a Jackal
(github.com/Daffan/the-barn-challenge). At the bridge, a base with an arm has to duck under an obstacle; its numbers are
those of REMANI-Planner's first experiment. The house is that of AWS RoboMaker (aws-robomaker-small-house-world), as
convex pieces.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, RobotError, ScenarioError, SceneError
from elastic_strips.io import PoseSpec
from elastic_strips.io.nodes import Node, load_json
from elastic_strips.planning.grid_path import grid_path
from elastic_strips.planning.problem import check_endpoints
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.scene import Box, ConvexHull, Cylinder, Keyframes, Obstacle, Scene, World
from elastic_strips.scene.quantities import MAX_LENGTH, MIN_LENGTH
from elastic_strips.strip import DeformParams
from elastic_strips.summary import Summary
from elastic_strips.validation import check_number, shown

_BARN_FILE, _DYNABARN_FILE, _BRIDGE_FILE = "barn_worlds.json", "dynabarn_worlds.json", "bridge.json"
_HOUSE_FILE = "house.json"
_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)  # of the robot "bridge-arm" that the bridge's six arm angles belong to
_BRIDGE_TOLERANCE = 0.1  # goal tolerance [m]; the source states none
_HOUSE_TOLERANCE = 0.05  # goal tolerance [m]
_HOUSE_CLEARANCE = 0.05  # of the whole robot at a start or goal in the house [m]
_MOST_TRIES = 2000  # pairs in the house that are tried
_HOUSE_SLACK = 0.07  # [m] that cells of 5 cm take off a passage, at most
_HOUSE_APART = 3.0  # least distance from start to goal in the house [m]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriveProblem(Summary):
    """Drive from a start to one goal after another.

    Attributes:
        name: Name of the problem.
        world: The obstacles over time.
        start: Start of the robot.
        goals: Goals of the robot, in this order.
        goal_tolerance: Largest distance [m] of the base from a reached goal's position.
        heading_free: Whether a goal is reached with any heading; its yaw is then a suggestion.
        timeout: Longest time [s], or None.
        robot: Name of the problem's robot.
        path: Given path (K, 2) [m] from start to goal, or None.
        path_length: Length [m] by which the problem's score measures time, or None.
        difficulty: The problem's own class, or None.
        limits: Limits stated by the problem that the robot's description cannot hold, by the names of the arguments of
            ``MotionLimits.for_robot``.
    """

    name: str
    world: World
    start: PoseSpec
    goals: tuple[PoseSpec, ...]
    goal_tolerance: float
    heading_free: bool
    timeout: float | None
    robot: str
    path: Array | None = None
    path_length: float | None = None
    difficulty: str | None = None
    limits: Mapping[str, float] = field(default_factory=dict)

    def configurations(self, robot: RobotModel) -> tuple[Array, ...]:
        """Start and goals as configurations (nq,) of a robot, the start first.

        Raises:
            ConfigurationError: A joint that the robot lacks, or a value outside its limits.
        """
        return tuple(robot.home(p.x, p.y, p.yaw, p.joints) for p in (self.start, *self.goals))


def barn_ids(path: str | os.PathLike[str]) -> tuple[int, ...]:
    """Ids of the worlds in a file, ascending; those of the official test set are divisible by 6.

    Args:
        path: The file, or the folder that holds ``barn_worlds.json``.

    Raises:
        ScenarioError: The file is missing or not JSON, or an entry does not fit; the message names file and place.
    """
    return _ids(path, _BARN_FILE)


def load_barn(path: str | os.PathLike[str], id: int) -> DriveProblem:
    """One of the static worlds; every cylinder is an obstacle with its true shape.

    The goal is reached with any heading; its yaw is that of the last segment of the world's path, which is part of the
    problem, without the repeated points of the file.

    Args:
        path: The file, or the folder that holds ``barn_worlds.json``.
        id: The world's number.

    Raises:
        ScenarioError: As for `barn_ids`, or there is no world of that id.
    """
    root, world, radius, length, z = _read(path, _BARN_FILE, id)
    centers = world["cylinders_xy"].rows(2, limit=MAX_LENGTH)
    scene = Scene([Cylinder(radius, length, at=(x, y, z), name=f"cylinder-{k}") for k, (x, y) in enumerate(centers)])
    given = world["path"].rows(2, limit=MAX_LENGTH)
    path_xy = given[np.concatenate([[True], np.any(np.diff(given, axis=0) != 0.0, axis=1)])]
    path_xy.flags.writeable = False
    heading = path_xy[-1] - path_xy[-2] if len(path_xy) > 1 else None
    problem = _jackal_problem(f"barn-{id}", root, world, scene, heading)
    return replace(problem, path=path_xy, path_length=world["path_length"].number(low=0.0))


def dynabarn_ids(path: str | os.PathLike[str]) -> tuple[int, ...]:
    """Ids of the worlds in ``dynabarn_worlds.json``, ascending; else as `barn_ids`."""
    return _ids(path, _DYNABARN_FILE)


def load_dynabarn(path: str | os.PathLike[str], id: int, *, begin: float = 0.0) -> DriveProblem:
    """One of the arenas: walls are boxes, discs are cylinders with looped keyframes, straight from one to the next.

    Nearly all loops jump: at the end of its period a disc is back at its first keyframe, often on the other side of
    the arena. `World.speed_bound` is infinite for an interval of time with such a jump in it. (Gazebo, for which the
    files were made, interpolates the keyframes by a spline; it leaves the straight segments by up to 2.5 m and is up to
    69 m/s fast where keyframes are close, so that the discs' stated speeds hold for the straight segments only.)

    Args:
        path: The file, or the folder that holds ``dynabarn_worlds.json``.
        id: The world's number.
        begin: Time of the loops [s] at which the robot sets out.

    Raises:
        ScenarioError: As for `dynabarn_ids`, or there is no world of that id.
        ParameterError: A time to begin at that is negative or not finite.
    """
    check_number("begin", begin, low=0.0, unit="s")
    root, world, radius, length, z = _read(path, _DYNABARN_FILE, id)
    obstacles: list[Obstacle] = [_wall(wall) for wall in world["walls"]]
    for disc in world["obstacles"]:
        frames = disc["keyframes"].rows(3, limit=MAX_LENGTH)
        last = frames[-1, 0] - frames[0, 0]
        if abs(last - disc["period"].number(low=0.0, unit="s")) > 1e-6:
            disc.fail(f"the period is {disc['period'].value} s, but the keyframes last {last:g} s")
        positions = np.column_stack((frames[:, 1:], np.full(len(frames), z)))
        motion = disc.checked(Keyframes, frames[:, 0] - begin, positions, loop=True)
        obstacles.append(disc.checked(Cylinder, radius, length, name=disc["name"].text(), motion=motion))
    problem = _jackal_problem(f"dynabarn-{id}", root, world, world.checked(Scene, obstacles))
    return replace(problem, difficulty=world["difficulty"].text())


def _read(path: str | os.PathLike[str], file: str, id: int) -> tuple[Node, Node, float, float, float]:
    """Root and world of a file; radius, length, and height of the middle [m] of its cylinders."""
    root = load_json(path, file)
    world = _world_of_id(root["worlds"], id)
    radius, length = root["cylinder_radius"].number(low=1e-3), root["cylinder_length"].number(low=1e-3)
    return root, world, radius, length, root["cylinder_center_z"].number()


def _jackal_problem(name: str, root: Node, world: Node, scene: Scene, heading: Array | None = None) -> DriveProblem:
    """The problem of a world; ``heading`` (2,) is a direction at the goal, that from the start to it where None."""
    start, goal = world["start"].vector(3, limit=MAX_LENGTH), world["goal"].vector(2, limit=MAX_LENGTH)
    x, y = goal - start[:2] if heading is None else heading
    return DriveProblem(
        name=name,
        world=World(scene),
        start=PoseSpec(*start.tolist()),
        goals=(PoseSpec(*goal.tolist(), yaw=math.atan2(y, x)),),
        goal_tolerance=root["goal_tolerance"].number(low=0.0),
        heading_free=True,
        timeout=root["timeout"].number(low=0.0, unit="s"),
        robot="jackal-box",
    )


def _wall(entry: Node) -> Box:
    """A box from its size and its pose [x, y, z, roll, pitch, yaw]; walls stand upright."""
    pose, size = entry["pose"].vector(6, limit=MAX_LENGTH), entry["size"].vector(3)
    if pose[3] != 0.0 or pose[4] != 0.0:
        entry["pose"].fail(f"a wall must stand upright, not with roll {pose[3]:g} and pitch {pose[4]:g} rad")
    half = 0.5 * float(pose[5])
    try:
        return Box(size, at=pose[:3], quat=(0.0, 0.0, math.sin(half), math.cos(half)), name=entry["name"].text())
    except SceneError as error:
        entry.fail(f"{error} (a size is at least {MIN_LENGTH:g} m)")


def load_bridge(path: str | os.PathLike[str]) -> DriveProblem:
    """The bridge: from the start to the goals, one after the other, each with the arm as at the start.

    Args:
        path: The file, or the folder that holds ``bridge.json``.

    Raises:
        ScenarioError: The file is missing or not JSON, or an entry does not fit; the message names file and place.
    """
    root = load_json(path, _BRIDGE_FILE)
    boxes = [
        entry.checked(
            Box, entry["size"].vector(3), at=entry["position"].vector(3, limit=MAX_LENGTH), name=entry["name"].text()
        )
        for entry in root["boxes"]
    ]
    scene = root["boxes"].checked(Scene, boxes)
    angles = root["start"]["arm_deg"].vector(len(_JOINTS))
    joints = {name: math.radians(angle) for name, angle in zip(_JOINTS, angles.tolist(), strict=True)}
    goals = tuple(_pose(entry, joints) for entry in root["goals"])
    if not goals:
        root["goals"].fail("is empty; at least one goal is needed")
    return DriveProblem(
        name="bridge",
        world=World(scene),
        start=_pose(root["start"], joints),
        goals=goals,
        goal_tolerance=_BRIDGE_TOLERANCE,
        heading_free=False,
        timeout=None,
        robot="bridge-arm",
        limits={"joint_acceleration": root["robot"]["max_joint_acc"].number(low=1e-3, unit="rad/s²")},
    )


def house_scene(path: str | os.PathLike[str]) -> tuple[Scene, Array]:
    """The house, and the low and high corner (2, 2) [m] of the ground to drive on.

    Args:
        path: The file, or the folder that holds ``house.json``.

    Raises:
        ScenarioError: The file is missing or not JSON, or an entry does not fit.
    """
    file = Path(path) / _HOUSE_FILE if Path(path).is_dir() else Path(path)
    return _house_scene(os.fspath(path), file.stat().st_mtime_ns if file.exists() else 0)


@lru_cache(maxsize=2)
def _house_scene(path: str, _changed: int) -> tuple[Scene, Array]:
    """See :func:`house_scene`; its hulls take seconds."""
    root = load_json(path, _HOUSE_FILE)
    pieces = [
        entry.checked(ConvexHull, entry["vertices"].rows(3, limit=MAX_LENGTH), name=entry["name"].text())
        for entry in root["obstacles"]
    ]
    inside = root["inside"].rows(2, limit=MAX_LENGTH)
    inside.flags.writeable = False
    return root["obstacles"].checked(Scene, pieces), inside


def load_house(path: str | os.PathLike[str], robot: RobotModel, seed: int) -> DriveProblem:
    """The house with one of many pairs of start and goal: the robot at home, anywhere where it keeps 5 cm of clearance.

    A way leads from one to the other for a disc a little smaller than the base; whether for the robot is not known.
    The corners of the ground are left out, because they lie outside the walls.

    Args:
        path: The file, or the folder that holds ``house.json``.
        robot: The robot that has to fit there; its base moves.
        seed: Seed of the pair.

    Raises:
        ScenarioError: The file is missing or not JSON, an entry does not fit, or no place is found.
        RobotError: A fixed base.
    """
    if not robot.space.planar:
        raise RobotError(f"the base of {robot.name!r} is fixed; in the house it moves: use diff_drive or omni")
    scene, (low, high) = house_scene(path)
    rng = np.random.default_rng(seed)
    params = DeformParams(clearance=_HOUSE_CLEARANCE)
    for _ in range(_MOST_TRIES):
        start, goal = (PoseSpec(*rng.uniform(low, high).tolist(), yaw=rng.uniform(-math.pi, math.pi)) for _ in range(2))
        if math.hypot(goal.x - start.x, goal.y - start.y) < _HOUSE_APART:
            continue
        with suppress(ConfigurationError):
            q_start, q_goal = (robot.home(p.x, p.y, p.yaw) for p in (start, goal))
            check_endpoints(robot, scene, q_start, q_goal, params)
            disc = max(PlanarFootprint.of(robot, q_start).inner - _HOUSE_SLACK, 0.01)  # what is taken stays closed
            if grid_path(robot, scene, q_start, q_goal, box=(low, high), inner=disc).points is None:
                continue
            return DriveProblem(
                name=f"house-{seed}",
                world=World(scene),
                start=start,
                goals=(goal,),
                goal_tolerance=_HOUSE_TOLERANCE,
                heading_free=False,
                timeout=None,
                robot=robot.name,
            )
    raise ScenarioError(f"{os.fspath(path)}: no free places for {robot.name!r} among {_MOST_TRIES} pairs")


def _pose(entry: Node, joints: dict[str, float]) -> PoseSpec:
    x, y = entry["xy"].vector(2, limit=MAX_LENGTH).tolist()
    return PoseSpec(x, y, math.radians(entry["yaw_deg"].number(low=-720.0, high=720.0, unit="deg")), joints)


def _ids(path: str | os.PathLike[str], file: str) -> tuple[int, ...]:
    return tuple(sorted(world["id"].integer() for world in load_json(path, file)["worlds"]))


def _world_of_id(worlds: Node, number: int) -> Node:
    """The world of a list whose ``id`` is ``number``.

    Raises:
        ScenarioError: None has that id; the message lists near ids.
    """
    if isinstance(number, bool) or not isinstance(number, (int, np.integer)):
        raise ScenarioError(f"{worlds.source.path}: id={shown(number)} must be an integer")
    known = {world["id"].integer(): world for world in worlds}
    if number in known:
        return known[number]
    if not known:
        worlds.fail("holds no world")
    ids = sorted(known)
    near = ", ".join(map(str, [i for i in ids if i < number][-2:] + [i for i in ids if i > number][:2]))
    worlds.fail(f"there is no world {number}; {len(ids)} worlds have ids from {ids[0]} to {ids[-1]}, next to it {near}")
