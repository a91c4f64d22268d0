"""IO room, BARN: static worlds of cylinders, made for a Jackal (github.com/Daffan/the-barn-challenge)."""

from __future__ import annotations

import math
import os

import numpy as np

from elastic_strips.io.drive_problem import DriveProblem
from elastic_strips.io.json_source import entry_of_id, read_json
from elastic_strips.io.scenario_file import PoseSpec
from elastic_strips.scene import Cylinder, Scene, World

FILE = "barn_worlds.json"
ROBOT = "jackal-box"


def barn_ids(path: str | os.PathLike[str]) -> tuple[int, ...]:
    """Ids of the worlds in a file, ascending; those of the official test set are divisible by 6.

    Args:
        path: The file, or the folder that holds ``barn_worlds.json``.

    Raises:
        ScenarioError: The file is missing or no JSON, or an entry does not fit; the message names file and place.
    """
    return tuple(sorted(world["id"].integer() for world in read_json(path, FILE)["worlds"]))


def load_barn(path: str | os.PathLike[str], id: int) -> DriveProblem:
    """One of the static worlds. Every cylinder is an obstacle of its own, with its true shape.

    The goal is reached with any heading; its yaw is that of the last piece of the world's own path, which goes with the
    problem without the repeated points that the file has.

    Args:
        path: The file, or the folder that holds ``barn_worlds.json``.
        id: The world's number.

    Raises:
        ScenarioError: As for `barn_ids`, or there is no world of that id.
    """
    root = read_json(path, FILE)
    world = entry_of_id(root["worlds"], id)
    radius, length = root["cylinder_radius"].number(low=1e-3), root["cylinder_length"].number(low=1e-3)
    z = root["cylinder_center_z"].number()
    centers = world["cylinders_xy"].array(None, 2)
    scene = Scene([Cylinder(radius, length, at=(x, y, z), name=f"cylinder-{k}") for k, (x, y) in enumerate(centers)])
    start, goal = world["start"].array(3), world["goal"].array(2)
    way = world["path"].array(None, 2)
    fresh = np.concatenate([[True], np.any(np.diff(way, axis=0) != 0.0, axis=1)])
    way = way[fresh]
    way.flags.writeable = False
    last = way[-1] - way[-2] if len(way) > 1 else goal - start[:2]
    return DriveProblem(
        name=f"barn-{id}",
        world=World(scene),
        start=PoseSpec(*start.tolist()),
        goals=(PoseSpec(*goal.tolist(), yaw=math.atan2(last[1], last[0])),),
        goal_tolerance=root["goal_tolerance"].number(low=0.0),
        heading_free=True,
        timeout=root["timeout"].number(low=0.0, unit="s"),
        robot=ROBOT,
        path=way,
        path_length=world["path_length"].number(low=0.0),
    )
