"""Hand: the frame of a robot's last control point, by which a goal is dragged."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSolver, PoseTarget


class Hand:
    """Workspace: where a robot's hand is, and what brings it to a pose; used by one thread."""

    def __init__(self, robot: RobotModel, frame: str) -> None:
        self.frame: str = frame
        self._solver = PoseSolver(robot, frame)
        self._joints, self._all = np.ones(robot.nv), np.ones(robot.nv)
        self._joints[: robot.space.base_nv] = 0.0

    def pose(self, row: Array) -> Array:
        """Of the hand (4, 4) at a coordinate row (nv,)."""
        at, rotation = self._solver.place(row[None])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation[0], at[0]
        return pose

    def reached(self, row: Array, pose: Array, *, base: bool = False) -> Array:
        """Coordinates (nv,) that come as near to a pose (4, 4) as the joints do, and the base where it may, from those
        of ``row``."""
        target = PoseTarget(self._solver.frames[0], pose[:3, 3], pose[:3, :3], np.zeros(3))
        rows, _ = self._solver.solve(row[None], [target], self._all if base else self._joints)
        return rows[0]


def hand_solvers(robot: RobotModel) -> tuple[Hand, Hand] | None:
    """Two for the frame of the last control point; None where no joint but the base's moves that."""
    points, model = robot.control_point_set, robot.model
    joint, at = int(points.joint[-1]), points.local[-1]
    off = {
        frame.name: float(np.linalg.norm(frame.placement.translation - at))
        for frame in model.frames
        if frame.parentJoint == joint
    }
    if not off or not robot.tree.support[joint][robot.space.base_nv :].any():
        return None
    frame = min(off, key=lambda name: off[name])
    return Hand(robot, frame), Hand(robot, frame)
