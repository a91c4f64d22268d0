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

from elastic_strips.errors import InputError, missing_extra, nearest_name
from elastic_strips.files import atomic_write, check_writable, write_json
from elastic_strips.scene import Scene
from elastic_strips.trajectory import Trajectory
from elastic_strips.validation import check_type, named_arguments

from .trajectory_data import row_names, trajectory_columns, trajectory_document


@named_arguments
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
    """Check that `write_trajectory` knows the ending of a name, and has what writes it.

    Raises:
        InputError: it does not; the message names the endings that it knows.
        MissingExtraError: an ``.mcap`` file, and rosbags is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _WRITERS:
        raise InputError(f"{path}: trajectories are not written as {suffix!r}{nearest_name(suffix, _WRITERS)}")
    if suffix == ".mcap":
        try:
            importlib.import_module("rosbags")
        except ModuleNotFoundError:
            raise missing_extra("an MCAP file", "rosbags", "ros") from None


def _csv(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    columns = trajectory_columns(trajectory)
    rows = np.column_stack(list(columns.values())).tolist()
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    return atomic_write(target, ("\n".join(lines) + "\n").encode())


def _npz(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    stream = io.BytesIO()
    np.savez(  # NumPy before 2.1 would save ``allow_pickle`` as an array
        stream,
        time=trajectory.time,
        joint_names=np.array(row_names(trajectory.robot), dtype=str),
        positions=trajectory.coordinates,
        velocities=trajectory.v,
        accelerations=trajectory.a,
    )
    return atomic_write(target, stream.getvalue())


def _json(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    return write_json(target, trajectory_document(trajectory, frame=frame))


def _mcap(target: Path, trajectory: Trajectory, scene: Scene | None, frame: str) -> Path:
    from .bag_writer import write_bag  # late: it takes trimesh and the control room to import

    return write_bag(target, trajectory, scene=scene, frame=frame)


_WRITERS: dict[str, Callable[[Path, Trajectory, Scene | None, str], Path]] = {
    ".csv": _csv,
    ".json": _json,
    ".mcap": _mcap,
    ".npz": _npz,
}
