"""IO room, DynaBARN: arenas of moving discs, made for a Jackal (github.com/Daffan/the-barn-challenge)."""

from __future__ import annotations

import math
import os

import numpy as np

from elastic_strips.errors import SceneError
from elastic_strips.io.drive_problem import DriveProblem
from elastic_strips.io.json_source import Entry, entry_of_id, read_json
from elastic_strips.io.scenario_file import PoseSpec
from elastic_strips.scene import Box, Cylinder, Keyframes, Obstacle, Scene, World, checks

FILE = "dynabarn_worlds.json"
ROBOT = "jackal-box"


def dynabarn_ids(path: str | os.PathLike[str]) -> tuple[int, ...]:
    """Ids of the worlds in a file, ascending.

    Args:
        path: The file, or the folder that holds ``dynabarn_worlds.json``.

    Raises:
        ScenarioError: The file is missing or no JSON, or an entry does not fit; the message names file and place.
    """
    return tuple(sorted(world["id"].integer() for world in read_json(path, FILE)["worlds"]))


def load_dynabarn(path: str | os.PathLike[str], id: int) -> DriveProblem:
    """One of the arenas: walls are boxes, discs are cylinders with looped keyframes, straight from one to the next.

    Nearly all loops jump: at the end of its period a disc is back at its first keyframe, often on the other side of
    the arena. `World.speed_bound` is infinite for an interval of time with such a jump in it. (Gazebo, for which the
    files were made, puts a spline through the keyframes; it leaves the straight pieces by up to 2.5 m and is up to
    69 m/s fast where keyframes stand close, so that the discs' stated speeds hold for the straight pieces only.)

    Args:
        path: The file, or the folder that holds ``dynabarn_worlds.json``.
        id: The world's number.

    Raises:
        ScenarioError: As for `dynabarn_ids`, or there is no world of that id.
    """
    root = read_json(path, FILE)
    world = entry_of_id(root["worlds"], id)
    radius, length = root["cylinder_radius"].number(low=1e-3), root["cylinder_length"].number(low=1e-3)
    z = root["cylinder_center_z"].number()
    obstacles: list[Obstacle] = [_wall(wall) for wall in world["walls"]]
    for disc in world["obstacles"]:
        frames = disc["keyframes"].array(None, 3)
        if abs(frames[-1, 0] - frames[0, 0] - disc["period"].number(low=0.0, unit="s")) > 1e-6:
            disc.fail(
                f"the period is {disc['period'].value} s, but the keyframes last {frames[-1, 0] - frames[0, 0]:g} s"
            )
        positions = np.column_stack((frames[:, 1:], np.full(len(frames), z)))
        try:
            motion = Keyframes(frames[:, 0], positions, loop=True)
            obstacles.append(Cylinder(radius, length, name=disc["name"].text(), motion=motion))
        except SceneError as error:
            disc.fail(str(error))
    start, goal = world["start"].array(3), world["goal"].array(2)
    try:
        scene = Scene(obstacles)
    except SceneError as error:
        world.fail(str(error))
    return DriveProblem(
        name=f"dynabarn-{id}",
        world=World(scene),
        start=PoseSpec(*start.tolist()),
        goals=(PoseSpec(*goal.tolist(), yaw=math.atan2(goal[1] - start[1], goal[0] - start[0])),),
        goal_tolerance=root["goal_tolerance"].number(low=0.0),
        heading_free=True,
        timeout=root["timeout"].number(low=0.0, unit="s"),
        robot=ROBOT,
        difficulty=world["difficulty"].text(),
    )


def _wall(entry: Entry) -> Box:
    """A box from its size and its pose [x, y, z, roll, pitch, yaw]; walls stand upright."""
    pose, size = entry["pose"].array(6), entry["size"].array(3)
    if pose[3] != 0.0 or pose[4] != 0.0:
        entry["pose"].fail(f"a wall must stand upright, not with roll {pose[3]:g} and pitch {pose[4]:g} rad")
    half = 0.5 * float(pose[5])
    try:
        return Box(size, at=pose[:3], quat=(0.0, 0.0, math.sin(half), math.cos(half)), name=entry["name"].text())
    except SceneError as error:
        entry.fail(f"{error} (a size is at least {checks.MIN_LENGTH:g} m)")
