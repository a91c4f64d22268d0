"""Path files: configurations along a robot's path, with or without times, in the formats that planners write.

==================  ==========================================================================================
JSON, YAML          JointTrajectory, or what holds one (RobotTrajectory, DisplayTrajectory, what MoveIt prints)
CSV                 a line of names, then numbers; or numbers alone
NPZ, NPY            arrays called positions, path, q or qs, with times (or t, ts) and joint_names, where there are any
text                what OMPL prints: ``printAsMatrix``, or ``print`` with its states in brackets
==================  ==========================================================================================

Names say which column is which joint, in any order; ``x``, ``y`` and ``yaw`` are the base. Without names the columns
are the base's three, where it moves, and the planned joints in the robot's order.
"""

from __future__ import annotations

import csv
import os
import re
import zipfile
import zlib
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError
from elastic_strips.files import atomic_write, check_writable, open_input, read_input_text, write_json
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import LIMIT_TOLERANCE, wrap_angle
from elastic_strips.summary import Summary

from .nodes import MAX_JSON_BYTES, Node, Source, load_json, parse_yaml
from .npy_source import NpyError, NpzArrays, read_npy

_MAX_BYTES = 50_000_000
_MAX_ROWS = 200_000
_BASE = {"x": 0, "y": 1, "yaw": 2, "theta": 2, "heading": 2}
_TIMES = ("time", "times", "t", "ts", "time_from_start", "seconds", "sec")
_RATES, _RATE_ENDS = ("vx", "vy", "omega", "ax", "ay", "alpha"), ("_rate", "_acceleration")  # of trajectory files
_POSITIONS = ("positions", "path", "q", "qs", "waypoints", "samples", "states", "rows")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathFile(Summary):
    """What a path file holds.

    Attributes:
        q: (N, nq) configurations.
        times: (N,) when each is reached [s], or None.
        notes: what was assumed, and what was left out.
    """

    q: Array
    times: Array | None
    notes: tuple[str, ...]

    def _summary(self) -> dict[str, object]:
        timed = {} if self.times is None else {"seconds": float(self.times[-1] - self.times[0])}
        return {"configurations": len(self.q), **timed, "notes": "; ".join(self.notes)}


def load_path(path: str | os.PathLike[str], robot: RobotModel) -> PathFile:
    """Read a robot's path.

    Joints that the file does not name stay at home. Joints that the robot does not plan are left out, with a note.

    Args:
        path: the file; its name's ending says its format: ``.json``, ``.yaml``, ``.yml``, ``.csv``, ``.npz``,
            ``.npy``; anything else is text.
        robot: whose path it is.

    Raises:
        ConfigurationError: the file is missing, too large, or not sound; or its columns or values do not fit the robot.
            The message names file and place.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    source = Source(file, ConfigurationError)
    if suffix == ".json":
        return _trajectory(load_json(file, what="path file", error=ConfigurationError), robot, source)
    if suffix in (".yaml", ".yml"):
        text = read_input_text(file, "path file", MAX_JSON_BYTES, ConfigurationError)
        first = re.split(r"^---[ \t]*$", text, maxsplit=2, flags=re.MULTILINE)
        return _trajectory(parse_yaml(next((t for t in first if t.strip()), ""), source), robot, source)
    if suffix in (".npz", ".npy"):
        return _arrays(file, robot, source)
    text = read_input_text(file, "path file", _MAX_BYTES, ConfigurationError)
    if "[" in text:
        return _placed(robot, None, _ompl_states(text, source), None, source)
    return _table(text, robot, source)


def write_path(
    path: str | os.PathLike[str], robot: RobotModel, q: npt.ArrayLike, times: npt.ArrayLike | None = None
) -> Path:
    """Write a path for :func:`load_path`: as CSV, or as a JointTrajectory where the name ends in ``.json``.

    Args:
        path: the file.
        robot: whose path it is.
        q: (N, nq) configurations.
        times: (N,) when each is reached [s], or None.

    Raises:
        ConfigurationError: configurations that do not fit the robot.
        InputError: the file cannot be written.
    """
    rows = robot.space.to_coordinates(robot.check_q(q, what="path"))
    names = [*(("x", "y", "yaw") if robot.space.planar else ()), *robot.joint_names]
    when = None if times is None else np.asarray(times, dtype=float)
    if Path(path).suffix.lower() == ".json":
        stamped = [{} if when is None else {"time_from_start": t} for t in (range(len(rows)) if when is None else when)]
        points = [{"positions": row.tolist(), **stamp} for row, stamp in zip(rows, stamped, strict=True)]
        return write_json(path, {"joint_names": names, "points": points})
    table = rows if when is None else np.column_stack((when, rows))
    lines = [",".join(names if when is None else ["time", *names])]
    lines += [",".join(repr(float(value)) for value in row) for row in table]
    return atomic_write(check_writable(path), ("\n".join(lines) + "\n").encode())


def _trajectory(root: Node, robot: RobotModel, source: Source) -> PathFile:
    """The first JointTrajectory in a document."""
    found, base = _find(root, "points", "joint_names"), None
    if found is None:
        source.fail("has no JointTrajectory: a mapping with joint_names and points is needed")
    names = [entry.text() for entry in found["joint_names"].items()]
    points = found["points"].items()
    if not points:
        found["points"].fail("is empty; a path has at least two points")
    rows = np.array([p["positions"].vector(len(names)) for p in points])
    times = np.array([_seconds(p["time_from_start"]) for p in points]) if _has(points[0], "time_from_start") else None
    if robot.space.planar:
        base = _find(root, "points", "joint_names", beyond=found)
        if base is not None:
            poses = np.array([_planar(p["transforms"].items()[0]) for p in base["points"].items()])
            if len(poses) != len(rows):
                base.fail(f"has {len(poses)} points, the joints' trajectory {len(rows)}")
            names, rows = ["x", "y", "yaw", *names], np.hstack((poses, rows))
    return _placed(robot, names, rows, times, source)


def _find(node: Node, *keys: str, beyond: Node | None = None) -> Node | None:
    """The first mapping that has all keys; that of moving bases, whose points have transforms, where ``beyond``."""
    todo = deque([node])
    while todo:
        at = todo.popleft()
        if isinstance(at.value, list):
            todo += (entry for entry in at.items() if isinstance(entry.value, (list, dict)))
        elif isinstance(at.value, dict):
            points = at.value.get("points")
            poses = isinstance(points, list) and points and isinstance(points[0], dict) and "transforms" in points[0]
            if all(k in at.value for k in keys) and bool(poses) == (beyond is not None) and points:
                return at
            todo += [at[key] for key in at.value]
    return None


def _has(node: Node, key: str) -> bool:
    return isinstance(node.value, dict) and key in node.value


def _seconds(node: Node) -> float:
    """A duration as a number, or as ROS writes it."""
    if not isinstance(node.value, dict):
        return node.number(low=0.0, high=1e9, unit="s")
    whole = next((k for k in ("sec", "secs") if k in node.value), None)
    part = next((k for k in ("nanosec", "nsecs") if k in node.value), None)
    if whole is None:
        node.fail("has neither sec nor secs")
    return node[whole].number(low=0.0, high=1e9, unit="s") + (
        1e-9 * node[part].number(high=1e9, unit="ns") if part else 0.0
    )


def _planar(node: Node) -> list[float]:
    """x, y and yaw of a transform."""
    at, turn = node["translation"], node["rotation"]
    x, y, z, w = (turn[k].finite() for k in "xyzw")
    yaw = float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    return [at["x"].number(), at["y"].number(), yaw]


def _arrays(file: Path, robot: RobotModel, source: Source) -> PathFile:
    with open_input(file, "path file", _MAX_BYTES, ConfigurationError) as (stream, size):
        try:
            if file.suffix.lower() == ".npy":
                return _placed(robot, None, _numbers(read_npy(stream, size, _MAX_BYTES), source), None, source)
            arrays = NpzArrays(stream, size, _MAX_BYTES)
            name = next((n for n in _POSITIONS if n in arrays), None)
            if name is None:
                source.fail(
                    f"has the arrays {', '.join(sorted(arrays)) or 'none'}; one of {', '.join(_POSITIONS)} is needed"
                )
            rows = _numbers(arrays[name], source)
            when = next((n for n in _TIMES if n in arrays), None)
            times = None if when is None else np.asarray(arrays[when], dtype=float).reshape(-1)
            names = [str(n) for n in arrays["joint_names"].reshape(-1)] if "joint_names" in arrays else None
        except (NpyError, ValueError, OSError, zipfile.BadZipFile, zlib.error) as problem:
            if isinstance(problem, ConfigurationError):
                raise
            source.fail(f"the path file {problem}")
    columns = len(names) if names is not None else robot.nv
    if rows.shape[0] == columns != rows.shape[1] or (
        times is not None and len(times) == rows.shape[1] != rows.shape[0]
    ):
        rows = rows.T  # a column for each sample, as Drake has them
    return _placed(robot, names, rows, times, source)


def _numbers(array: np.ndarray, source: Source) -> Array:
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        source.fail(f"has an array of shape {array.shape} and type {array.dtype}; rows of numbers are needed")
    return np.asarray(array, dtype=float)


def _table(text: str, robot: RobotModel, source: Source) -> PathFile:
    """Numbers separated by commas, semicolons or blanks, with or without a line of names before them."""
    lines = [
        (n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        source.fail("is empty; a path has at least two configurations")
    first = lines[0][1]
    delimiter = next((d for d in (",", ";", "\t") if d in first), None)

    def split(line: str) -> list[str]:
        parts = next(csv.reader([line], delimiter=delimiter)) if delimiter else line.split()
        return [part.strip() for part in parts]

    names = None if re.fullmatch(_NUMBER, split(first)[0]) else split(first)
    rows = []
    for number, line in lines[0 if names is None else 1 :]:
        parts = split(line)
        wanted = len(names) if names is not None else len(split(first))
        if len(parts) != wanted:
            source.fail(f"has {len(parts)} columns, not {wanted}", number)
        try:
            rows.append([float(part) for part in parts])
        except ValueError:
            wrong = next(part for part in parts if not re.fullmatch(_NUMBER, part))
            source.fail(f"{wrong[:40]!r} is not a number", number)
    if not rows:
        source.fail("has no configurations")
    table, times = np.array(rows), None
    if names is not None:
        clock = [k for k, name in enumerate(names) if name.lower() in _TIMES]
        if clock:
            times = table[:, clock[0]]
            names = [n for k, n in enumerate(names) if k != clock[0]]
            table = np.delete(table, clock[0], axis=1)
    return _placed(robot, names, table, times, source)


def _ompl_states(text: str, source: Source) -> Array:
    """The numbers in brackets of each state that OMPL printed."""
    count = re.search(r"path with (\d+) states", text)
    groups = [[float(x) for x in part.split()] for part in re.findall(rf"\[\s*({_NUMBER}(?:\s+{_NUMBER})*)\s*\]", text)]
    numbers = [x for group in groups for x in group]
    states = int(count.group(1)) if count else len(groups)
    if not states or not numbers or len(numbers) % states:
        source.fail(f"has {len(numbers)} numbers in brackets, which are no {states} states of one size")
    return np.array(numbers).reshape(states, -1)


def _held_otherwise(robot: RobotModel, names: Sequence[str], rows: Array) -> list[str]:
    """A note of the joints that the robot holds still elsewhere than the path has them: it is proven as it is held."""
    found = []
    for k, name in enumerate(names):
        low, high, held = rows[:, k].min(), rows[:, k].max(), robot.locked.get(name)
        if held is not None and max(held - low, high - held) > LIMIT_TOLERANCE:
            span = f"{low:.6g}" if high - low <= LIMIT_TOLERANCE else f"{low:.6g} to {high:.6g}"
            found.append(f"{name} at {held:.6g}, in the file {span}")
    return [f"held still (locked=, --lock) otherwise than in the file: {'; '.join(found)}"] if found else []


def _check_followers(robot: RobotModel, names: Sequence[str], rows: Array, coordinates: Array, source: Source) -> None:
    """Refuse columns of joints that follow planned ones (``<mimic>``) where they are not where those put them."""
    for k, name in enumerate(names):
        if name not in robot.followers:
            continue
        leader, multiplier, constant = robot.followers[name]
        if leader not in names:
            source.fail(f"names {name!r}, but not {leader!r}, which it follows: where that is, is not known")
        i = robot.joint_names.index(leader)
        off = np.abs(rows[:, k] - multiplier * coordinates[:, robot.space.base_nv + i] - constant)
        if robot.space.circular[i]:
            off = np.abs(wrap_angle(off))
        worst = int(np.argmax(off))
        if off[worst] > LIMIT_TOLERANCE:
            wanted = multiplier * coordinates[worst, robot.space.base_nv + i] + constant
            source.fail(
                f"configuration {worst} has {name!r} at {rows[worst, k]:.6g}; it follows {leader!r}, which puts it at "
                f"{wanted:.6g}"
            )


def _placed(
    robot: RobotModel, names: Sequence[str] | None, rows: Array, times: Array | None, source: Source
) -> PathFile:
    """Configurations of the robot from columns, by their names where there are any."""
    notes: list[str] = []
    if len(rows) < 2 or len(rows) > _MAX_ROWS:
        source.fail(f"has {len(rows)} configurations; a path has 2 … {_MAX_ROWS}")
    if not np.isfinite(rows).all():
        source.fail(f"configuration {int(np.argmin(np.isfinite(rows).all(axis=1)))} has a value that is not finite")
    if names is not None and rows.shape[1] != len(names):
        source.fail(f"has {rows.shape[1]} columns for {len(names)} names")
    b = robot.space.base_nv
    if names is None:
        if rows.shape[1] == robot.nq != robot.nv:
            q = rows
        elif rows.shape[1] == robot.nv:
            q = robot.space.from_coordinates(rows)
        else:
            base = "x, y, yaw and " if b else ""
            source.fail(
                f"has {rows.shape[1]} columns without names; {robot.name!r} has {robot.nv}: {base}"
                f"{', '.join(robot.joint_names)}"
            )
        notes.append("columns without names: taken in the robot's order")
    else:
        columns = {**({name: k for name, k in _BASE.items()} if b else {})}
        columns.update({name: b + k for k, name in enumerate(robot.joint_names)})
        taken = [(k, columns[name]) for k, name in enumerate(names) if name in columns]
        rates = [name for name in names if name in _RATES or any(name.removesuffix(s) in columns for s in _RATE_ENDS)]
        left_out = [name for name in names if name not in (*columns, *robot.followers) and name not in rates]
        if not taken:
            source.fail(
                f"names {', '.join(map(str, names))[:120]}; {robot.name!r} plans {', '.join(robot.joint_names)}"
            )
        if len({column for _, column in taken}) < len(taken):
            source.fail(f"names a joint twice: {', '.join(names)[:200]}")
        coordinates = np.tile(robot.space.to_coordinates(robot.home_q), (len(rows), 1))
        for k, column in taken:
            coordinates[:, column] = rows[:, k]
        _check_followers(robot, names, rows, coordinates, source)
        missing = [name for name, column in columns.items() if column >= b and column not in {c for _, c in taken}]
        if set(rates) - set(columns):
            notes.append("velocities and accelerations are left out")
        if left_out:
            notes.append(f"left out, as {robot.name!r} does not plan them: {', '.join(left_out)}")
            notes += _held_otherwise(robot, names, rows)
        if missing:
            notes.append(f"at home, as the file does not name them: {', '.join(missing)}")
        q = robot.space.from_coordinates(coordinates)
    if times is not None and (len(times) != len(rows) or not np.isfinite(times).all() or (np.diff(times) < 0.0).any()):
        source.fail(f"has {len(times)} times for {len(rows)} configurations, or they decrease")
    try:
        q = robot.check_q(q, what="path")
    except ConfigurationError as problem:
        source.fail(str(problem))
    return PathFile(q, times, tuple(notes))
