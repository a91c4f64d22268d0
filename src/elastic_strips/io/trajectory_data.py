"""A timed motion as columns of numbers, and as plain data in the field names of ROS 2's messages."""

from __future__ import annotations

import importlib

import numpy as np

from elastic_strips.arrays import Array, Document
from elastic_strips.errors import missing_extra
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import Trajectory

_BASE = (("x", "y", "yaw"), ("vx", "vy", "omega"), ("ax", "ay", "alpha"))
BASE_JOINT = "world_joint"
"""Name of the base's joint in MultiDOFJointTrajectory."""


def trajectory_columns(trajectory: Trajectory) -> dict[str, Array]:
    """The samples by column name: arrays (M,).

    ``time`` [s]; ``x``, ``y`` [m] and ``yaw`` [rad] of a base that moves, and the joints by their names [rad or m];
    ``vx``, ``vy``, ``omega`` of the base in its own frame and ``JOINT_rate``; ``ax``, ``ay``, ``alpha`` and
    ``JOINT_acceleration``.
    """
    joints, planar = trajectory.robot.joint_names, trajectory.robot.space.planar
    columns = {"time": trajectory.time}
    arrays = (trajectory.coordinates, trajectory.v, trajectory.a)
    for base, suffix, rows in zip(_BASE, ("", "_rate", "_acceleration"), arrays, strict=True):
        names = (*(base if planar else ()), *(joint + suffix for joint in joints))
        columns.update(zip(names, rows.T, strict=True))
    return columns


def trajectory_frame(trajectory: Trajectory) -> object:
    """The samples as a ``pandas.DataFrame`` with the columns of `trajectory_columns`.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        pandas = importlib.import_module("pandas")
    except ModuleNotFoundError:
        raise missing_extra("trajectory_frame (trajectory_columns gives plain arrays)", "pandas") from None
    return pandas.DataFrame(trajectory_columns(trajectory))


def trajectory_document(trajectory: Trajectory, *, frame: str = "map") -> Document:
    """The samples as plain data in the field names of ROS 2's messages.

    Times are whole nanoseconds. The base's velocities and accelerations are those of its own frame; its yaw becomes a
    quaternion, and so forgets whole turns.

    Args:
        trajectory: the motion.
        frame: ``frame_id`` of the world.
    """
    robot, b = trajectory.robot, trajectory.robot.space.base_nv
    header = {"stamp": stamp(trajectory.start_time), "frame_id": frame}
    rows = [array.tolist() for array in (trajectory.coordinates, trajectory.v, trajectory.a)]
    times = trajectory.time.tolist()
    passed = [stamp(t - times[0]) for t in times]
    joints: list[Document] = [
        {"positions": q[b:], "velocities": v[b:], "accelerations": a[b:], "effort": [], "time_from_start": dt}
        for q, v, a, dt in zip(*rows, passed, strict=True)
    ]
    document: Document = {
        "joint_trajectory": {"header": header, "joint_names": list(robot.joint_names), "points": joints}
    }
    if robot.space.planar:
        base: list[Document] = [
            {
                "transforms": [{"translation": _vector(q[0], q[1]), "rotation": heading(q[2])}],
                "velocities": [{"linear": _vector(v[0], v[1]), "angular": _vector(z=v[2])}],
                "accelerations": [{"linear": _vector(a[0], a[1]), "angular": _vector(z=a[2])}],
                "time_from_start": dt,
            }
            for q, v, a, dt in zip(*rows, passed, strict=True)
        ]
        document["multi_dof_joint_trajectory"] = {"header": header, "joint_names": [BASE_JOINT], "points": base}
        poses = [
            {
                "header": {"stamp": stamp(t), "frame_id": frame},
                "pose": {"position": _vector(q[0], q[1]), "orientation": heading(q[2])},
            }
            for t, q in zip(times, rows[0], strict=True)
        ]
        document["path"] = {"header": header, "poses": poses}
    return document


def row_names(robot: RobotModel) -> tuple[str, ...]:
    """Names of the columns of a coordinate row (nv,)."""
    return (*(_BASE[0] if robot.space.planar else ()), *robot.joint_names)


def stamp(t: float) -> dict[str, int]:
    """A time [s] as ROS 2 writes it."""
    sec, nanosec = divmod(nanoseconds(t), 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}


def nanoseconds(t: float) -> int:
    """A time [s] in whole nanoseconds."""
    return round(t * 1e9)


def heading(yaw: float) -> dict[str, float]:
    """A quaternion about z."""
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(0.5 * yaw)), "w": float(np.cos(0.5 * yaw))}


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}
