"""IO room, bridge: a base with an arm has to duck under a bridge; numbers of REMANI-Planner's first experiment."""

from __future__ import annotations

import math
import os

from elastic_strips.errors import SceneError
from elastic_strips.io.drive_problem import DriveProblem
from elastic_strips.io.json_source import Entry, read_json
from elastic_strips.io.scenario_file import PoseSpec
from elastic_strips.scene import Box, Scene, World

FILE = "bridge.json"
ROBOT = "bridge-arm"
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""Joints of the robot ``bridge-arm`` that the file's six arm angles belong to."""

TOLERANCE = 0.1
"""Goal tolerance [m]; the source states none."""


def load_bridge(path: str | os.PathLike[str]) -> DriveProblem:
    """The bridge: from the start to the goals, one after the other; the arm is held at each as at the start.

    Args:
        path: The file, or the folder that holds ``bridge.json``.

    Raises:
        ScenarioError: The file is missing or no JSON, or an entry does not fit; the message names file and place.
    """
    root = read_json(path, FILE)
    boxes = []
    for entry in root["boxes"]:
        try:
            boxes.append(Box(entry["size"].array(3), at=entry["position"].array(3), name=entry["name"].text()))
        except SceneError as error:
            entry.fail(str(error))
    try:
        scene = Scene(boxes)
    except SceneError as error:
        root["boxes"].fail(str(error))
    angles = root["start"]["arm_deg"].array(len(JOINTS))
    joints = {name: math.radians(angle) for name, angle in zip(JOINTS, angles.tolist(), strict=True)}
    goals = tuple(_pose(entry, joints) for entry in root["goals"])
    if not goals:
        root["goals"].fail("is empty; at least one goal is needed")
    return DriveProblem(
        name="bridge",
        world=World(scene),
        start=_pose(root["start"], joints),
        goals=goals,
        goal_tolerance=TOLERANCE,
        heading_free=False,
        timeout=None,
        robot=ROBOT,
        limits={"joint_acceleration": root["robot"]["max_joint_acc"].number(low=1e-3, unit="rad/s²")},
    )


def _pose(entry: Entry, joints: dict[str, float]) -> PoseSpec:
    x, y = entry["xy"].array(2).tolist()
    return PoseSpec(x, y, math.radians(entry["yaw_deg"].number(low=-720.0, high=720.0, unit="deg")), joints)
