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
from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import numpy.typing as npt

from elastic_strips._version import __version__
from elastic_strips.arrays import Array, Document
from elastic_strips.catalogue import recorded_robot
from elastic_strips.control.interfaces import Event
from elastic_strips.control.record import DRIVE_NAMES, ControlRows, PlanningRows, Record, RecordError, frozen
from elastic_strips.control.seen_rows import SEEN_SHAPES, SeenLog, SeenRows
from elastic_strips.errors import InputError, RobotError, missing_extra
from elastic_strips.files import atomic_write, check_writable, open_input
from elastic_strips.robot import BaseKind, RobotModel, load_robot
from elastic_strips.validation import check_type, named_arguments

from .nodes import Node, Source
from .npy_source import NpzArrays
from .obstacle_document import TrackedPiece, world_documents, world_from_documents

_UNITS = {
    "time": "s",
    "chart": "m, m, rad (base); rad or m (joints)",
    "velocity": "m/s, m/s, rad/s (base, in its own frame); rad/s or m/s (joints)",
    "drive": "m/s (rad/s for an omnidirectional base's yaw)",
    "tick_ms": "ms",
    "clearance": "m",
    "position": "m, world",
    "quaternion": "x, y, z, w, world",
}


def _row_columns(record: Record) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the columns of a configuration (nv) and of a velocity (nv): a base that moves, then the joints."""
    rates = tuple(f"{joint}_rate" for joint in record.joint_names)
    if not record.drive_names:
        return record.joint_names, rates
    return ("x", "y", "yaw", *record.joint_names), ("vx", "vy", "omega", *rates)


def _control_columns(record: Record) -> tuple[str, ...]:
    """Names of all columns of a control row, in the order of a CSV file."""
    configuration, velocity = _row_columns(record)
    reference = (f"reference_{name}" for name in (*configuration, *velocity))
    estimate = (f"estimate_{name}" for name in configuration)
    commands = (f"command_{name}" for name in (*record.drive_names, *(f"{joint}_rate" for joint in record.joint_names)))
    motors = (f"motor_{name}" for name in record.drive_names)
    return ("time", "state", *configuration, *velocity, *reference, *estimate, *commands, *motors)


def record_columns(record: Record) -> dict[str, npt.NDArray[np.generic]]:
    """The control rows by column name: arrays (T,); ``state`` holds names."""
    rows = record.control
    arrays: list[Array] = [getattr(rows, name) for name in _CONTROL if name not in ("time", "state")]
    columns = [rows.time, np.array(record.states)[rows.state], *chain.from_iterable(array.T for array in arrays)]
    return dict(zip(_control_columns(record), columns, strict=True))


def record_frame(record: Record) -> object:
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
    writer.writerow(_control_columns(record))
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


def _key(name: str) -> str:
    """Name of a field of the control rows in files."""
    return "chart" if name == "coordinates" else name


_SEEN = {f.name: () for f in fields(SeenRows)} | {"size": (3,), "position": (3,), "quaternion": (4,)}
_TABLES = ("phases", "statuses", "reasons")
_Arrays: TypeAlias = Mapping[str, npt.NDArray[np.generic]]


def check_record_file(path: str | os.PathLike[str]) -> Path:
    """The path, if a record can be written there.

    Raises:
        InputError: as for `check_writable`, or a suffix that is neither ``.npz`` nor ``.csv``.
    """
    target = check_writable(path)
    if target.suffix.lower() not in (".npz", ".csv"):
        raise RecordError(
            f"{target}: a record is written to .npz (everything) or .csv (control rows), not {target.suffix!r}"
        )
    return target


def write_record(record: Record, path: str | os.PathLike[str]) -> Path:
    """Write a record, whole or not at all: everything into a ``.npz`` file, the control rows into a ``.csv`` file.

    Returns:
        The file's path.

    Raises:
        InputError: another suffix, a file that cannot be written, or metadata that is not plain JSON values.
    """
    check_type("record", record, Record)
    target = check_record_file(path)
    data = record_csv(record).encode() if target.suffix.lower() == ".csv" else _packed(record)
    return atomic_write(target, data)


@named_arguments
def read_record(path: str | os.PathLike[str]) -> Record:
    """Read a ``.npz`` record; its world holds convex obstacles that follow the recorded poses.

    An obstacle of several pieces is several obstacles, ``name#0``, ``name#1``, ….

    Raises:
        RecordError: no such file, not a record, another version, an array that is missing or does not fit, a file that
            is cut off or damaged; the message names the file and what is wrong with it.
    """
    file = Path(path)
    with open_input(file, "record", MAX_BYTES, RecordError) as (stream, size):
        try:
            if stream.read(2) != b"PK":
                if file.suffix.lower() == ".csv":
                    raise RecordError("a .csv file holds the control rows alone; a .npz file holds the whole record")
                raise RecordError("is not a record, nor a .npz file at all")
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
    found = load_robot(name, base=record.base.value, joints=record.joint_names, locked=dict(record.locked))
    record.check_robot(found)
    return found


def _packed(record: Record) -> bytes:
    documents, names, position, quaternion = world_documents(record.world, record.control.time)
    text = _metadata_text(record, names, documents)
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "metadata": np.array(text),
        **{f"control_{_key(name)}": getattr(record.control, name) for name in _CONTROL},
        **{f"planning_{name}": getattr(record.planning, name) for name in _PLANNING},
        "track_position": position,
        "track_quaternion": quaternion,
        **{f"seen_{name}": getattr(record.seen, name) for name in _SEEN if len(record.seen)},
    }
    size = sum(array.nbytes for array in arrays.values())
    if size > MAX_ARRAY_BYTES or len(text) > MAX_TEXT:
        _log.warning(
            "the record's arrays have %d bytes and its metadata %d characters; read_record takes at most %d and %d",
            size,
            len(text),
            MAX_ARRAY_BYTES,
            MAX_TEXT,
        )
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def _metadata_text(record: Record, names: list[str], documents: list[TrackedPiece]) -> str:
    """What a record holds besides arrays, as JSON."""
    configuration, velocity = _row_columns(record)
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
        **{name: list(getattr(record.planning, name)) for name in _TABLES},
        "columns": {
            "chart": configuration,
            "velocity": velocity,
            "drive": record.drive_names,
            "joints": record.joint_names,
        },
        "units": _UNITS,
        "events": [[event.time, event.kind, event.reason] for event in record.events],
        "tracks": names,
        "obstacles": documents,
        "metadata": dict(record.metadata),
    }
    try:
        return json.dumps(metadata, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise RecordError(f"metadata must be plain JSON values: {error}") from None


def _metadata(loaded: _Arrays) -> Document:
    if "metadata" not in loaded:
        raise RecordError("holds no array 'metadata': it is not a record")
    text = loaded["metadata"]
    if text.nbytes > 4 * MAX_TEXT:
        raise RecordError(f"the metadata have {text.nbytes // 4} characters; at most {MAX_TEXT} are read")
    try:
        document = json.loads(str(text)) if text.ndim == 0 and text.dtype.kind == "U" else None
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise RecordError(f"is not a record (format {FORMAT!r})")
    if document.get("version") != FORMAT_VERSION:
        raise RecordError(f"has format version {document.get('version')!r}; this program reads {FORMAT_VERSION}")
    return document


def _unpacked(document: Document, loaded: _Arrays) -> Record:
    root = Node(document, "", Source(Path("metadata"), RecordError))
    base = BaseKind(root["base"].text(valid=[kind.value for kind in BaseKind]))
    joints, states = _names(root["joint_names"]), _names(root["states"])
    nv = len(joints) + (3 if base.planar else 0)
    phases, statuses, reasons = (_names(root[name]) for name in _TABLES)
    goal = None if root["goal"].value is None else root["goal"].vector(nv, limit=math.inf)
    locked = {name: entry.finite() for name, entry in root["locked"].mapping().items()}
    urdf, tracks = root["urdf"].value, len(root["tracks"].items())
    T = _array(loaded, "control_time", (None,)).shape[0]
    widths = {"drive": len(DRIVE_NAMES[base]), "joints": len(joints), "motors": len(DRIVE_NAMES[base])}
    shapes = {name: (T,) if name in ("time", "state") else (T, widths.get(name, nv)) for name in _CONTROL}
    control = ControlRows(**{name: _array(loaded, f"control_{_key(name)}", shape) for name, shape in shapes.items()})
    P = _array(loaded, "planning_time", (None,)).shape[0]
    special = {"phase_ms": (P, len(phases)), "node_offset": (P + 1,), "nodes": (None, nv)}
    rows = {name: _array(loaded, f"planning_{name}", special.get(name, (P,))) for name in _PLANNING}
    planning = PlanningRows(**rows, phases=phases, statuses=statuses, reasons=reasons)
    _check_rows(control, planning, states)
    position = _array(loaded, "track_position", (T, tracks, 3))
    quaternion = _array(loaded, "track_quaternion", (T, tracks, 4))
    pieces = cast("Sequence[TrackedPiece]", root["obstacles"].value)
    return Record(
        robot=str(root["robot"].value),
        base=base,
        joint_names=joints,
        locked=locked,
        urdf=None if urdf is None else str(urdf),
        control=control,
        planning=planning,
        events=tuple(map(_event, root["events"])),
        world=world_from_documents(pieces, control.time, position, quaternion),
        goal=None if goal is None else frozen(goal),
        seen=_seen(loaded),
        states=states,
        metadata={key: entry.value for key, entry in root["metadata"].mapping().items()},
    )


def _seen(loaded: _Arrays) -> SeenRows:
    """What was seen, where the robot drove by sensors."""
    if "seen_begin" not in loaded:
        return SeenLog().rows(0.0)
    count = _array(loaded, "seen_begin", (None,)).shape[0]
    seen = SeenRows(**{name: _array(loaded, f"seen_{name}", (count, *width)) for name, width in _SEEN.items()})
    if len(seen) and seen.shape.max() >= len(SEEN_SHAPES):
        raise RecordError(
            f"'seen_shape' goes to {seen.shape.max()}; there are {len(SEEN_SHAPES)}: {', '.join(SEEN_SHAPES)}"
        )
    if (seen.end < seen.begin).any() or (seen.size < 0.0).any():
        raise RecordError("'seen_end' must not be before 'seen_begin', and 'seen_size' not below 0")
    if not np.allclose(np.linalg.norm(seen.quaternion, axis=1), 1.0, atol=1e-6):
        raise RecordError("'seen_quaternion' must hold unit quaternions")
    return seen


def _event(node: Node) -> Event:
    entries = node.items()
    if len(entries) != 3:
        node.fail(f"must be a list of time, kind and reason, not {node.kind}")
    return Event(entries[0].finite(), str(entries[1].value), str(entries[2].value))


def _names(node: Node) -> tuple[str, ...]:
    if not isinstance(node.value, list) or not all(isinstance(name, str) for name in node.value):
        node.fail(f"must be a list of names, not {node.kind}")
    return tuple(node.value)


_KINDS = {
    "state": "u", "status": "u", "certified": "b", "node_offset": "i", "reason": "i", "shape": "u", "moves": "b",
}  # fmt: skip
_MAY_BE_NAN = {
    "reference", "reference_v", "estimate", "drive", "joints", "motors", "tick_ms", "phase_ms", "clearance",
    "horizon_end",
}  # fmt: skip
_KIND_NAMES = {"u": "unsigned integers", "b": "truth values", "i": "integers", "f": "floating point numbers"}


def _array(loaded: _Arrays, key: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
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
