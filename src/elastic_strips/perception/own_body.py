"""A robot's own bodies before its sensors: its posture, where sensors are mounted, and rays that meet the robot."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, RobotError, nearest_name
from elastic_strips.robot import RobotModel
from elastic_strips.robot.geometry import LinkGeometry
from elastic_strips.robot.kinematics import find_frame

from .rays import Nearest, RayBodies, Rays

_NAMES = {"laser": r"laser(_\d+)?_frame", "sonar": r"sonar_\d+_frame", "infrared": r"ir_\d+_frame"}


def sensor_frames(robot: RobotModel) -> dict[str, tuple[str, ...]]:
    """Links that by their names are range sensors, in the order of their numbers.

    Args:
        robot: the robot of the links.

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
    """Workspace: poses of a robot's joints in the world, at one coordinate row.

    Args:
        robot: the robot.

    Attributes:
        coordinates: (nv,) that row.
        T_world_joint: (njoints, 4, 4) poses of the joints' frames.
        T_base_world: (4, 4) pose of the world in the base's frame, which is the world's for a fixed base.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self._data = robot.model.createData()
        self.T_world_joint: Array = np.tile(np.eye(4), (robot.model.njoints, 1, 1))
        self.T_base_world: Array = np.eye(4)
        self.coordinates: Array = np.zeros(robot.nv)

    def place(self, coordinates: Array) -> None:
        """Put the robot at a coordinate row (nv,).

        Raises:
            ConfigurationError: the row has another size or is not finite.
        """
        row = np.asarray(coordinates, dtype=float)
        if row.shape != (self.robot.nv,) or not np.isfinite(row).all():
            raise ConfigurationError(
                f"coordinates={row!r} must be {self.robot.nv} finite numbers for {self.robot.name!r}"
            )
        self.coordinates = row.copy()
        pin.forwardKinematics(self.robot.model, self._data, self.robot.space.from_coordinates(row))
        for j in range(1, len(self.T_world_joint)):
            self.T_world_joint[j] = self._data.oMi[j].homogeneous
        if self.robot.space.planar:
            T = self.T_world_joint[1]
            self.T_base_world[:3, :3] = T[:3, :3].T
            self.T_base_world[:3, 3] = -T[:3, :3].T @ T[:3, 3]


class SensorMount:
    """Sensors that are fixed to links of a robot.

    Args:
        posture: posture of the robot.
        frames: names of the links.
        T_frame_sensor: (4, 4) pose of each sensor on its link; the link's own where None.

    Attributes:
        joint: (S,) joints that carry them.
        T_joint_sensor: (S, 4, 4) their poses in the joints' frames.

    Raises:
        RobotError: the robot has no such link; the message lists its links.
    """

    def __init__(self, posture: Posture, frames: Sequence[str], T_frame_sensor: Array | None = None) -> None:
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
        self.T_joint_sensor: Array = np.array(local) @ (np.eye(4) if T_frame_sensor is None else T_frame_sensor)

    def poses(self) -> tuple[Array, Array]:
        """Poses (S, 4, 4) of the sensors in the world and in the base's frame."""
        world = self._posture.T_world_joint[self.joint] @ self.T_joint_sensor
        return world, self._posture.T_base_world @ world


_BEYOND_ROBOT = 1e3  # [m] beyond any robot


class SelfFilter:
    """Workspace: a robot's own collision bodies in the rays of one sensor or ring.

    Bodies on a sensor's own joint never move relative to it: rays are cast against them once, without padding. The
    others are thicker by the padding. A body in which a ray begins is the sensor's housing, and ignored.

    Args:
        posture: posture of the robot.
        joint: (R,) joints that carry the rays.
        local: the rays in the joints' frames.
        padding: padding of the bodies that move before the sensor [m].
    """

    def __init__(self, posture: Posture, joint: npt.NDArray[np.intp], local: Rays, padding: float) -> None:
        self._posture = posture
        pieces = posture.robot.geometries
        at_rest = np.tile(np.eye(4), (len(posture.T_world_joint), 1, 1))
        self._fixed = np.full(len(local), np.inf)
        self._groups: list[tuple[npt.NDArray[np.intp], list[OwnBodies]]] = []
        for j in np.unique(joint):
            rays = np.flatnonzero(joint == j)
            nearest = Nearest(len(rays))
            OwnBodies([p for p in pieces if p.joint == j], 0.0).cast(at_rest, local.some(rays), nearest, _BEYOND_ROBOT)
            self._fixed[rays] = nearest.distance
            others = [p for p in pieces if p.joint != j]
            paddings = (padding, 0.0) if padding > 0.0 else (0.0,)
            self._groups.append((rays, [OwnBodies(others, thick) for thick in paddings]))

    def distances(self, rays: Rays, reach: float) -> Array:
        """Distances (R,) [m] at which the rays, now in the world frame, hit the robot; infinite beyond reach."""
        out = self._fixed.copy()
        for index, layers in self._groups:
            nearest = Nearest(len(index))
            some = rays if len(index) == len(out) else rays.some(index)
            for bodies in layers:  # without padding for rays that begin within it
                bodies.cast(self._posture.T_world_joint, some, nearest, reach)
            out[index] = np.minimum(out[index], nearest.distance)
        out[out > reach] = np.inf
        return out


class OwnBodies:
    """Some of a robot's collision bodies, thicker by a padding [m], to cast rays against."""

    def __init__(self, pieces: Sequence[LinkGeometry], padding: float) -> None:
        self._bodies = RayBodies([p.geometry for p in pieces], padding)
        self._joint = np.array([p.joint for p in pieces], dtype=np.intp)
        self._local = np.array([p.placement for p in pieces]).reshape(-1, 4, 4)

    def cast(self, T_joint: Array, rays: Rays, nearest: Nearest, reach: float) -> None:
        """Intersect rays with the bodies; their joints are at ``T_joint`` (njoints, 4, 4) in the rays' frame."""
        T = T_joint[self._joint] @ self._local
        self._bodies.place(np.ascontiguousarray(T[:, :3, :3]), T[:, :3, 3])
        self._bodies.cast(rays, nearest, reach=reach, inside=np.inf)
