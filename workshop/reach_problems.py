"""Reach problems: a start and a goal of an arm among shelves, tables and cages, as MotionBenchMaker's data has them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ScenarioError
from elastic_strips.io.nodes import Node, load_json
from elastic_strips.robot import BaseKind, RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Obstacle, Scene, Sphere
from elastic_strips.scene.quantities import MAX_LENGTH, MIN_LENGTH
from elastic_strips.summary import Summary

MBM_ROBOTS = ("fetch", "panda")
_PROBLEMS = "problems.json.gz"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ReachProblem(Summary):
    """Bring the arm from one posture to another.

    Attributes:
        name: the scene's kind and the problem's number in it.
        kind: kind of scene, such as ``"cage"``.
        scene: the obstacles.
        start, goal: values (J,) of the joints ``joints`` [rad or m].
        joints: names of the joints, in this order.
    """

    name: str
    kind: str
    scene: Scene
    start: Array
    goal: Array
    joints: tuple[str, ...]

    def ends(self, robot: RobotModel, off: tuple[float, float] = (0.0, 0.0)) -> tuple[Array, Array]:
        """Start and goal as configurations (nq,); values that rounding puts beyond a limit are at it.

        A base that can move starts ``off`` [m] away from where the problem has it.
        """
        start, goal = (
            robot.home(joints=dict(zip(self.joints, values.tolist(), strict=True)))
            for values in (self.start, self.goal)
        )
        if robot.space.planar:
            start[:2] += off
        return start, goal


def load_mbm(
    root: str | os.PathLike[str], robot: str, *, base: str | BaseKind = BaseKind.FIXED
) -> tuple[RobotModel, tuple[ReachProblem, ...]]:
    """A robot of MotionBenchMaker's data, and its problems.

    Args:
        root: folder with ``mbm``, or that folder itself: a folder for each robot, with URDF, SRDF, meshes and
            ``problems.json.gz``.
        robot: ``"fetch"`` (lift and arm) or ``"panda"``.
        base: the robot's base kind.

    Raises:
        ScenarioError: there is no such robot, or a file is missing or does not fit; the message names the place.
        RobotError: the URDF or SRDF has a fault.
    """
    folder = next((f for f in (Path(root, "mbm", robot), Path(root, robot)) if Path(f, _PROBLEMS).is_file()), None)
    if robot not in MBM_ROBOTS or folder is None:
        raise ScenarioError(
            f"{os.fspath(root)}: no problems of robot {robot!r}; a folder with mbm/{'|'.join(MBM_ROBOTS)}/{_PROBLEMS} "
            "is needed"
        )
    document = load_json(folder / _PROBLEMS, what="problems")
    names = tuple(entry.text() for entry in document["joints"])
    model = load_robot(folder / f"{robot}.urdf", base=base, srdf=folder / f"{robot}.srdf", joints=names)
    return model, tuple(_problem(entry, names) for entry in document["problems"])


def _problem(entry: Node, joints: tuple[str, ...]) -> ReachProblem:
    kind = entry["scene"].text()
    scene = entry.checked(Scene, [_obstacle(items) for items in entry["obstacles"]])
    start, goal = (entry[key].vector(len(joints)) for key in ("start", "goal"))
    return ReachProblem(f"{kind}-{entry['n'].integer()}", kind, scene, start, goal, joints)


def _obstacle(entry: Node) -> Obstacle:
    """``[name, shape, sizes, [x, y, z, qx, qy, qz, qw]]``; a cylinder's sizes are its height and radius."""
    items = entry.items()
    if len(items) != 4:
        entry.fail(f"has {len(items)} entries; name, shape, sizes and pose are needed")
    name, shape = items[0].text(), items[1].text(valid=("box", "cylinder", "sphere"))
    sizes = {"box": 3, "cylinder": 2, "sphere": 1}[shape]
    size = [s.number(low=MIN_LENGTH, high=MAX_LENGTH) for s in items[2]]
    if len(size) != sizes:
        items[2].fail(f"a {shape} has {sizes} sizes, not {len(size)}")
    pose = items[3].vector(7, limit=MAX_LENGTH)
    turn = np.linalg.norm(pose[3:])
    if not 0.9 < turn < 1.1:
        items[3].fail(f"the quaternion has the norm {turn:g}, not 1")
    placed = {"at": pose[:3], "quat": pose[3:] / turn, "name": name}
    if shape == "box":
        return entry.checked(Box, tuple(size), **placed)
    if shape == "cylinder":
        return entry.checked(Cylinder, size[1], size[0], **placed)
    return entry.checked(Sphere, size[0], **placed)
