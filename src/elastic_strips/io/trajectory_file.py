"""IO room, trajectory files: a timed motion as CSV, NPZ, JSON in ROS' field names, a table, or a bag.

=======  =====================================================================================================
CSV      a line of names, then numbers that read back to the last bit
NPZ      ``time``, ``joint_names``, ``positions``, ``velocities``, ``accelerations``, a column for each name
JSON     ``joint_trajectory`` and ``multi_dof_joint_trajectory`` as MoveIt's RobotTrajectory has them, and the
         base's ``path`` as nav_msgs/Path: field by field as in ROS 2's messages
MCAP     as `write_bag` writes it
=======  =====================================================================================================

`load_path` reads the first three again.
"""

from __future__ import annotations

import importlib
import io
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array, Document
from elastic_strips.errors import InputError, missing_extra, nearest_name
from elastic_strips.files import atomic_write, check_writable, write_json
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.trajectory import Trajectory
from elastic_strips.validation import check_type

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
            {"transforms": [{"translation": _vector(q[0], q[1]), "rotation": heading(q[2])}],
             "velocities": [{"linear": _vector(v[0], v[1]), "angular": _vector(z=v[2])}],
             "accelerations": [{"linear": _vector(a[0], a[1]), "angular": _vector(z=a[2])}], "time_from_start": dt}
            for q, v, a, dt in zip(*rows, passed, strict=True)
        ]  # fmt: skip
        document["multi_dof_joint_trajectory"] = {"header": header, "joint_names": [BASE_JOINT], "points": base}
        poses = [
            {"header": {"stamp": stamp(t), "frame_id": frame},
             "pose": {"position": _vector(q[0], q[1]), "orientation": heading(q[2])}}
            for t, q in zip(times, rows[0], strict=True)
        ]  # fmt: skip
        document["path"] = {"header": header, "poses": poses}
    return document


def write_trajectory(
    path: str | os.PathLike[str], trajectory: Trajectory, *, scene: Scene | None = None, frame: str = "map"
) -> Path:
    """Write a timed motion; the name's ending says how: ``.csv``, ``.npz``, ``.json`` or ``.mcap``.

    Args:
        path: the file; an existing one is replaced in one step.
        trajectory: the motion, such as ``retime(report.strip)``.
        scene: obstacles for an ``.mcap`` file; the other formats hold none.
        frame: ``frame_id`` of the world, in JSON and MCAP.

    Raises:
        InputError: another ending, or a file that cannot be written.
        MissingExtraError: an ``.mcap`` file, and rosbags is not installed.
    """
    check_type("trajectory", trajectory, Trajectory, InputError)
    check_trajectory_file(path)
    return _WRITERS[Path(path).suffix.lower()](check_writable(path), trajectory, scene, frame)


def check_trajectory_file(path: str | os.PathLike[str]) -> None:
    """Check that `write_trajectory` knows the ending of a name.

    Raises:
        InputError: it does not; the message names the endings that it knows.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _WRITERS:
        raise InputError(f"{path}: trajectories are not written as {suffix!r}{nearest_name(suffix, _WRITERS)}")


def _csv(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    columns = trajectory_columns(trajectory)
    rows = np.column_stack(list(columns.values())).tolist()
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    return atomic_write(target, ("\n".join(lines) + "\n").encode())


def _npz(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    stream = io.BytesIO()
    np.savez(  # NumPy before 2.1 would save ``allow_pickle`` as an array
        stream, time=trajectory.time, joint_names=np.array(row_names(trajectory.robot), dtype=str),
        positions=trajectory.coordinates, velocities=trajectory.v, accelerations=trajectory.a,
    )  # fmt: skip
    return atomic_write(target, stream.getvalue())


def _json(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    return write_json(target, trajectory_document(trajectory, frame=frame))


def _mcap(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    from .bag_writer import write_bag

    return write_bag(target, trajectory, scene=scene, frame=frame)


_WRITERS: dict[str, Callable[[Path, Trajectory, Scene | None, str], Path]] = {
    ".csv": _csv, ".json": _json, ".mcap": _mcap, ".npz": _npz,
}  # fmt: skip


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
