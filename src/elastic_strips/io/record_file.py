"""Record files: NPZ and CSV records in and out, as tables too."""

from __future__ import annotations

import csv
import importlib
import io
import json
import logging
import math
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elastic_strips._version import __version__
from elastic_strips.arrays import Array
from elastic_strips.control.interfaces import Event
from elastic_strips.control.record import DRIVE_NAMES, ControlRows, PlanningRows, Record, RecordError, frozen
from elastic_strips.errors import InputError, RobotError, missing_extra
from elastic_strips.input_file import open_input
from elastic_strips.io.files import check_writable, write_whole
from elastic_strips.io.npy_source import NpzArrays
from elastic_strips.io.scene_file import obstacle_documents
from elastic_strips.robot import BaseKind, RobotModel, load_robot, recorded_robot
from elastic_strips.scene import Box, Capsule, Cone, ConvexHull, Cylinder, Keyframes, Obstacle, Scene, Sphere, World
from elastic_strips.validation import check_type

MAX_ROWS = 4_000_000
"""Most poses of moving pieces that a record's world is made of: their number times the control rows."""


def world_documents(world: World, time: Array) -> tuple[list[dict[str, Any]], list[str], Array, Array]:
    """A world as obstacle documents and tracks.

    Args:
        world: the obstacles.
        time: (T,) when moving ones are looked at [s].

    Returns:
        Documents as of ``obstacle_documents``, each with ``appears`` and ``vanishes`` [s] (None: always, never) and
        ``track``: None for a fixed one, else its place among the tracks, whose pose its own ``pose`` is relative to;
        the names of the obstacles that move (M), their positions (T, M, 3) [m] and quaternions (T, M, 4).
    """
    from scipy.spatial.transform import Rotation  # late: slow to import

    documents: list[dict[str, Any]] = []
    moving: list[Obstacle] = []
    taken: set[str] = set()
    for obstacle in world.scene:
        name = obstacle.name or ""
        when = {"appears": world.appears.get(name), "vanishes": world.vanishes.get(name)}
        moves = obstacle.motion is not None and not obstacle.motion.still
        for document in obstacle_documents(Scene([obstacle], time=obstacle.time)):
            while document["name"] in taken:  # "a#0" may be a piece of "a", or an obstacle's name
                document["name"] += "'"
            taken.add(document["name"])
            if moves:
                document["pose"] = _vector(
                    np.asarray(np.linalg.solve(obstacle.pose, _matrix(document["pose"])), dtype=float)
                )
            documents.append({**document, **when, "track": len(moving) if moves else None})
        if moves:
            moving.append(obstacle)
    poses = np.array([[o.at(float(t)).pose for o in moving] for t in time]).reshape(len(time), len(moving), 4, 4)
    quaternions = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat() if moving else np.zeros((0, 4))
    names = [o.name or "" for o in moving]
    return documents, names, poses[..., :3, 3].copy(), quaternions.reshape(len(time), len(moving), 4)


def world_from_documents(documents: Any, time: Array, position: Array, quaternion: Array) -> World:
    """The world of what `world_documents` gave: convex obstacles that follow the recorded poses.

    Raises:
        RecordError: the documents are damaged; a `SceneError` where an obstacle cannot be made.
    """
    from scipy.spatial.transform import Rotation

    obstacles: list[Obstacle] = []
    appears: dict[str, float] = {}
    vanishes: dict[str, float] = {}
    try:
        rows = len(time) * sum(document["track"] is not None for document in documents)
        if rows > MAX_ROWS:
            raise RecordError(f"the pieces of the obstacles that move need {rows} rows; at most {MAX_ROWS} are read")
        for document in documents:
            name, track = document["name"], document["track"]
            place = _matrix(document["pose"])
            if track is None:
                where: dict[str, Any] = {"at": place[:3, 3], "quat": document["pose"][3:]}
            elif isinstance(track, int) and 0 <= track < position.shape[1]:
                turned = Rotation.from_quat(quaternion[:, track])
                positions = position[:, track] + turned.apply(place[:3, 3])
                quats = (turned * Rotation.from_matrix(place[:3, :3])).as_quat()
                where = {"motion": Keyframes(time, positions, quats=quats)}
            else:
                raise RecordError(f"obstacle {name!r} follows track {track!r}; there are {position.shape[1]}")
            obstacles.append(_obstacle(document["shape"], document["size"], {**where, "name": name}))
            for times, key in ((appears, "appears"), (vanishes, "vanishes")):
                if document[key] is not None:
                    times[name] = document[key]
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"an obstacle is damaged: {type(error).__name__}: {error}") from None
    return World(Scene(obstacles, time=float(time[0])), appears, vanishes)


def _obstacle(shape: str, size: Any, where: dict[str, Any]) -> Obstacle:
    if shape == "box":
        return Box(size, **where)
    if shape == "convex":
        return ConvexHull(size, **where)
    return {"sphere": Sphere, "cylinder": Cylinder, "capsule": Capsule, "cone": Cone}[shape](*size, **where)


def _matrix(pose: Any) -> Array:
    from scipy.spatial.transform import Rotation

    values = np.array(pose, dtype=float)
    if values.shape != (7,) or not np.isfinite(values).all() or not math.isclose(np.linalg.norm(values[3:]), 1.0):
        raise RecordError(f"a pose is seven finite numbers with a unit quaternion, not {pose!s:.80}")
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = Rotation.from_quat(values[3:]).as_matrix(), values[:3]
    return result


def _vector(T: Array) -> list[float]:
    from scipy.spatial.transform import Rotation

    return [*map(float, T[:3, 3]), *map(float, Rotation.from_matrix(T[:3, :3]).as_quat())]


UNITS = {
    "time": "s",
    "chart": "m, m, rad (base); rad or m (joints)",
    "velocity": "m/s, m/s, rad/s (base, in its own frame); rad/s or m/s (joints)",
    "drive": "m/s (rad/s for an omnidirectional base's yaw)",
    "tick_ms": "ms",
    "clearance": "m",
    "position": "m, world",
    "quaternion": "x, y, z, w, world",
}


def chart_columns(record: Record, prefix: str = "") -> tuple[str, ...]:
    """Names of the columns of a chart row (nv): x, y, yaw of a base that moves, then the joints."""
    base = ("x", "y", "yaw") if record.drive_names else ()
    return tuple(prefix + name for name in (*base, *record.joint_names))


def velocity_columns(record: Record, prefix: str = "") -> tuple[str, ...]:
    """Names of the columns of a velocity (nv)."""
    base = ("vx", "vy", "omega") if record.drive_names else ()
    return tuple(prefix + name for name in (*base, *(f"{joint}_rate" for joint in record.joint_names)))


def control_columns(record: Record) -> tuple[str, ...]:
    """Names of all columns of a control row, in the order of a CSV file."""
    return (
        "time",
        "state",
        *chart_columns(record),
        *velocity_columns(record),
        *chart_columns(record, "reference_"),
        *velocity_columns(record, "reference_"),
        *chart_columns(record, "estimate_"),
        *(f"command_{name}" for name in record.drive_names),
        *(f"command_{name}_rate" for name in record.joint_names),
        *(f"motor_{name}" for name in record.drive_names),
    )


def record_columns(record: Record) -> dict[str, Any]:
    """The control rows by column name: arrays (T,); ``state`` holds names."""
    rows = record.control
    arrays = (rows.chart, rows.v, rows.reference, rows.reference_v, rows.estimate, rows.drive, rows.joints, rows.motors)
    columns = [rows.time, np.array(record.states)[rows.state], *chain.from_iterable(array.T for array in arrays)]
    return dict(zip(control_columns(record), columns, strict=True))


def record_frame(record: Record) -> Any:
    """The control rows as a ``pandas.DataFrame``.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        pandas = importlib.import_module("pandas")
    except ModuleNotFoundError:
        raise missing_extra("record_frame (record_columns gives plain arrays)", "pandas") from None
    return pandas.DataFrame(record_columns(record))


def record_csv(record: Record) -> str:
    """The control rows as CSV: a line of column names, numbers that read back to the last bit, nothing for NaN."""
    columns = record_columns(record)
    states = columns.pop("state")
    numbers = np.column_stack(list(columns.values())).tolist()
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(control_columns(record))
    for (time, *rest), state in zip(numbers, states, strict=True):
        writer.writerow([repr(time), state, *("" if x != x else repr(x) for x in rest)])
    return stream.getvalue()


_log = logging.getLogger(__name__)
FORMAT = "elastic-strips-record"
FORMAT_VERSION = 1
MAX_BYTES = 250_000_000
MAX_ARRAY_BYTES = 250_000_000  # of all arrays, uncompressed: with 30 movers a quarter of an hour
MAX_TEXT = 10_000_000  # characters of the metadata
_CONTROL = tuple(f.name for f in fields(ControlRows))
_PLANNING = tuple(f.name for f in fields(PlanningRows) if f.name not in ("phases", "statuses", "reasons"))
_TABLES = ("phases", "statuses", "reasons")


def check_record_file(path: str | os.PathLike[str]) -> Path:
    """The path, if a record can be written there.

    Raises:
        InputError: as of `check_writable`, or a suffix that is neither ``.npz`` nor ``.csv``.
    """
    target = check_writable(path)
    if target.suffix.lower() not in (".npz", ".csv"):
        raise RecordError(
            f"{target}: a record is written to .npz (everything) or .csv (control rows), not {target.suffix!r}"
        )
    return target


def write_record(record: Record, path: str | os.PathLike[str]) -> Path:
    """Write a record, whole or not at all: everything into a ``.npz`` file, the control rows into a ``.csv`` file.

    Raises:
        InputError: another suffix, a file that cannot be written, or metadata that is not plain JSON values.
    """
    check_type("record", record, Record)
    target = check_record_file(path)
    data = record_csv(record).encode() if target.suffix.lower() == ".csv" else _packed(record)
    return write_whole(target, data)


def read_record(path: str | os.PathLike[str]) -> Record:
    """Read a ``.npz`` record.

    Its world holds convex obstacles that follow the recorded poses, ``name#k`` where one had several pieces.

    Raises:
        RecordError: no such file, no record, another version, an array that is missing or does not fit, a file that
            is cut off or damaged; the message names the file and what is wrong with it.
    """
    file = Path(path)
    with open_input(file, "record", MAX_BYTES, RecordError) as (stream, size):
        try:
            if stream.read(2) != b"PK":
                if file.suffix.lower() == ".csv":
                    raise RecordError("a .csv file holds the control rows alone; a .npz file holds the whole record")
                raise RecordError("is no record, and no .npz file at all")
            loaded = NpzArrays(stream, size, MAX_ARRAY_BYTES)
            return _unpacked(_metadata(loaded), loaded)
        except zipfile.BadZipFile as error:
            raise RecordError(f"{file}: is damaged or cut off: {error}") from None
        except InputError as error:
            raise RecordError(f"{file}: {error}") from None
        except (EOFError, ValueError, KeyError, zlib.error, NotImplementedError) as error:
            raise RecordError(f"{file}: cannot read: {error}") from None


def record_robot(record: Record, robot: str | None = None) -> RobotModel:
    """Load the robot of a record.

    Args:
        record: the record.
        robot: name or URDF to take instead of the recorded one, which may have moved.

    Raises:
        RobotError: it cannot be loaded, or is another robot.
    """
    name = robot or recorded_robot(record.robot, record.urdf)
    if name is None:
        raise RobotError(f"the record names no URDF of {record.robot!r}; give one")
    found = load_robot(name, base=record.base.value, locked=dict(record.locked))
    record.check_robot(found)
    return found


def _packed(record: Record) -> bytes:
    documents, names, position, quaternion = world_documents(record.world, record.control.time)
    planning = record.planning
    metadata = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "elastic_strips": __version__,
        "robot": record.robot,
        "urdf": None if record.urdf is None else str(Path(record.urdf).absolute()),
        "base": record.base.value,
        "joint_names": list(record.joint_names),
        "locked": {name: float(value) for name, value in record.locked.items()},
        "goal": None if record.goal is None else record.goal.tolist(),
        "states": list(record.states),
        **{name: list(getattr(planning, name)) for name in _TABLES},
        "columns": {
            "chart": chart_columns(record),
            "velocity": velocity_columns(record),
            "drive": record.drive_names,
            "joints": record.joint_names,
        },
        "units": UNITS,
        "events": [[event.time, event.kind, event.reason] for event in record.events],
        "tracks": names,
        "obstacles": documents,
        "metadata": dict(record.metadata),
    }
    try:
        text = json.dumps(metadata, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise RecordError(f"metadata must be plain JSON values: {error}") from None
    arrays: dict[str, npt.NDArray[Any]] = {
        "metadata": np.array(text),
        **{f"control_{name}": getattr(record.control, name) for name in _CONTROL},
        **{f"planning_{name}": getattr(planning, name) for name in _PLANNING},
        "track_position": position,
        "track_quaternion": quaternion,
    }
    size = sum(array.nbytes for array in arrays.values())
    if size > MAX_ARRAY_BYTES or len(text) > MAX_TEXT:
        _log.warning(
            "the record's arrays have %d bytes and its metadata %d characters; read_record takes at most %d and %d",
            size, len(text), MAX_ARRAY_BYTES, MAX_TEXT,
        )  # fmt: skip
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def _metadata(loaded: Mapping[str, Any]) -> dict[str, Any]:
    if "metadata" not in loaded:
        raise RecordError("holds no array 'metadata': it is no record")
    text = loaded["metadata"]
    if text.nbytes > 4 * MAX_TEXT:
        raise RecordError(f"the metadata have {text.nbytes // 4} characters; at most {MAX_TEXT} are read")
    try:
        document = json.loads(str(text)) if text.ndim == 0 and text.dtype.kind == "U" else None
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise RecordError(f"is no record (format {FORMAT!r})")
    if document.get("version") != FORMAT_VERSION:
        raise RecordError(f"has format version {document.get('version')!r}; this program reads {FORMAT_VERSION}")
    return document


def _unpacked(document: dict[str, Any], loaded: Mapping[str, Any]) -> Record:
    try:
        base = BaseKind(document["base"])
        joints, states = _names(document, "joint_names"), _names(document, "states")
        nv = len(joints) + (3 if base.planar else 0)
        tables = {name: _names(document, name) for name in _TABLES}
        goal = None if document["goal"] is None else np.array(document["goal"], dtype=float)
        if goal is not None and not np.isfinite(goal).all():
            raise ValueError(f"goal {goal.tolist()!s:.80} must be finite")
        events = tuple(
            Event(_finite("an event's time", time), str(kind), str(reason)) for time, kind, reason in document["events"]
        )
        locked = {str(name): _finite(f"locked[{name!r}]", value) for name, value in document["locked"].items()}
        obstacles, tracks, metadata = document["obstacles"], len(document["tracks"]), dict(document["metadata"])
        robot, urdf = document["robot"], document["urdf"]
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise RecordError(f"the metadata are damaged: {type(error).__name__}: {error}") from None
    if goal is not None and goal.shape != (nv,):
        raise RecordError(f"the goal has shape {goal.shape}; it must be ({nv},)")
    T = _array(loaded, "control_time", (None,)).shape[0]
    widths = {"drive": len(DRIVE_NAMES[base]), "joints": len(joints), "motors": len(DRIVE_NAMES[base])}
    shapes = {name: (T,) if name in ("time", "state") else (T, widths.get(name, nv)) for name in _CONTROL}
    control = ControlRows(**{name: _array(loaded, f"control_{name}", shape) for name, shape in shapes.items()})
    P = _array(loaded, "planning_time", (None,)).shape[0]
    special = {"phase_ms": (P, len(tables["phases"])), "node_offset": (P + 1,), "nodes": (None, nv)}
    rows = {name: _array(loaded, f"planning_{name}", special.get(name, (P,))) for name in _PLANNING}
    planning = PlanningRows(**rows, **tables)  # type: ignore[arg-type]
    _check_rows(control, planning, states)
    position = _array(loaded, "track_position", (T, tracks, 3))
    quaternion = _array(loaded, "track_quaternion", (T, tracks, 4))
    return Record(
        robot=str(robot),
        base=base,
        joint_names=joints,
        locked=locked,
        urdf=None if urdf is None else str(urdf),
        control=control,
        planning=planning,
        events=events,
        world=world_from_documents(obstacles, control.time, position, quaternion),
        goal=None if goal is None else frozen(goal),
        states=states,
        metadata=metadata,
    )


def _finite(what: str, value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{what} is {number}; it must be finite")
    return number


def _names(document: dict[str, Any], key: str) -> tuple[str, ...]:
    names = document[key]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"{key} must be a list of names")
    return tuple(names)


_KINDS = {"state": "u", "status": "u", "certified": "b", "node_offset": "i", "reason": "i"}
_MAY_BE_NAN = frozenset(
    (
        "reference",
        "reference_v",
        "estimate",
        "drive",
        "joints",
        "motors",
        "tick_ms",
        "phase_ms",
        "clearance",
        "horizon_end",
    )
)
_KIND_NAMES = {"u": "unsigned integers", "b": "truth values", "i": "integers", "f": "floating point numbers"}


def _array(loaded: Mapping[str, Any], key: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    if key not in loaded:
        raise RecordError(f"the array {key!r} is missing")
    array = loaded[key]
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise RecordError(f"the array {key!r} has shape {array.shape}, not ({wanted})")
    name = key.partition("_")[2]
    kind = _KINDS.get(name, "f")
    if array.dtype.kind != kind:
        raise RecordError(f"the array {key!r} holds {array.dtype}, not {_KIND_NAMES[kind]}")
    if kind == "f":
        bad = np.isinf(array) if name in _MAY_BE_NAN else ~np.isfinite(array)
        if bad.any():
            at = [int(i) for i in np.unravel_index(int(np.argmax(bad)), bad.shape)]
            others = "" if name in _MAY_BE_NAN else "; NaN may stand for what was not known, but not here"
            raise RecordError(f"the array {key!r} holds {array[tuple(at)]} at {at}{others}")
    return array


def _check_rows(control: ControlRows, planning: PlanningRows, states: tuple[str, ...]) -> None:
    if not len(control) or not np.isfinite(control.time).all() or not (np.diff(control.time) > 0.0).all():
        raise RecordError("'control_time' must be finite and ascend, with one row at least")
    offset = planning.node_offset
    if offset[0] != 0 or offset[-1] != len(planning.nodes) or (np.diff(offset) < 0).any():
        raise RecordError(f"'planning_node_offset' must ascend from 0 to the {len(planning.nodes)} nodes")
    for name, codes, count in (
        ("control_state", control.state, len(states)),
        ("planning_status", planning.status, len(planning.statuses)),
        ("planning_reason", planning.reason, len(planning.reasons)),
    ):
        if len(codes) and not 0 <= codes.min() <= codes.max() < count:
            raise RecordError(
                f"{name!r} goes from {codes.min()} to {codes.max()}; there are names for 0 to {count - 1}"
            )
