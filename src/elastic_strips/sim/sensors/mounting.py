"""Sensors room, mounting: where a robot's sensors are, on which links, and where these are at one time."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, RobotError, nearest_name
from elastic_strips.robot import RobotModel
from elastic_strips.robot.control_points import find_frame

_NAMES = {"laser": r"laser(_\d+)?_frame", "sonar": r"sonar_\d+_frame", "infrared": r"ir_\d+_frame"}


def sensor_frames(robot: RobotModel) -> dict[str, tuple[str, ...]]:
    """Links that by their names are range sensors, in the order of their numbers.

    Args:
        robot: whose links.

    Returns:
        ``"laser"`` (``laser_frame``, ``laser_0_frame``, …), ``"sonar"`` (``sonar_0_frame``, …) and ``"infrared"``
        (``ir_0_frame``, …) with the names found; empty where there are none.
    """
    names = _links(robot)
    return {
        kind: tuple(sorted((n for n in names if re.fullmatch(pattern, n)), key=_number))
        for kind, pattern in _NAMES.items()
    }


def _number(name: str) -> int:
    digits = re.search(r"\d+", name)
    return int(digits[0]) if digits else -1


def _links(robot: RobotModel) -> list[str]:
    return sorted({f.name for f in robot.model.frames if f.type == pin.FrameType.BODY})


class Posture:
    """Workspace: where a robot's joints are in the world, at one chart row.

    Args:
        robot: the robot.

    Attributes:
        T_world_joint: (njoints, 4, 4) poses of the joints' frames.
        T_base_world: (4, 4) pose of the world in the base's frame, which is the world's for a fixed base.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self._data = robot.model.createData()
        self.T_world_joint = np.tile(np.eye(4), (robot.model.njoints, 1, 1))
        self.T_base_world = np.eye(4)

    def place(self, chart: Array) -> None:
        """Put the robot at a chart row (nv,).

        Raises:
            ConfigurationError: the row has another size or is not finite.
        """
        row = np.asarray(chart, dtype=float)
        if row.shape != (self.robot.nv,) or not np.isfinite(row).all():
            raise ConfigurationError(f"chart={row!r} must be {self.robot.nv} finite numbers for {self.robot.name!r}")
        pin.forwardKinematics(self.robot.model, self._data, self.robot.space.from_chart(row))
        for j in range(1, len(self.T_world_joint)):
            self.T_world_joint[j] = self._data.oMi[j].homogeneous
        if self.robot.space.planar:
            T = self.T_world_joint[1]
            self.T_base_world[:3, :3] = T[:3, :3].T
            self.T_base_world[:3, 3] = -T[:3, :3].T @ T[:3, 3]


class Mount:
    """Sensors that are fixed to links of a robot.

    Args:
        posture: of the robot.
        frames: names of the links.

    Attributes:
        joint: (S,) joints that carry them.
        T_joint_sensor: (S, 4, 4) their poses in the joints' frames.

    Raises:
        RobotError: the robot has no such link; the message lists those it has.
    """

    def __init__(self, posture: Posture, frames: Sequence[str]) -> None:
        self._posture = posture
        robot, joint, local = posture.robot, [], []
        for name in frames:
            index = find_frame(robot.model, name)
            if index is None:
                links = _links(robot)
                near = nearest_name(name, links).split(" Valid:")[0]
                raise RobotError(f"{robot.name!r} has no link {name!r} for a sensor{near} It has: {', '.join(links)}.")
            frame = robot.model.frames[index]
            joint.append(frame.parentJoint)
            local.append(frame.placement.homogeneous)
        self.joint: npt.NDArray[np.intp] = np.array(joint, dtype=np.intp)
        self.T_joint_sensor = np.array(local)

    def poses(self) -> tuple[Array, Array]:
        """Poses (S, 4, 4) of the sensors in the world and in the base's frame."""
        world = self._posture.T_world_joint[self.joint] @ self.T_joint_sensor
        return world, self._posture.T_base_world @ world
