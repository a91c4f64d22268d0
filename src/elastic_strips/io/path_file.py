"""Path files: configurations along a robot's path, with or without times, in the formats that planners write.

What planners hand over in Python is read by :mod:`elastic_strips.io.path_object`, and placed as files are.

==================  ==========================================================================================
JSON, YAML          JointTrajectory, or a message with one (RobotTrajectory, DisplayTrajectory, MoveIt's output)
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
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.collision.path_rows import PathLike, path_rows
from elastic_strips.errors import ConfigurationError, RobotError, plural
from elastic_strips.files import atomic_write, check_writable, open_input, read_input_text, write_json
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import LIMIT_TOLERANCE
from elastic_strips.summary import Summary
from elastic_strips.validation import check_choice, check_number, check_type, named_arguments, shown

from .nodes import MAX_JSON_BYTES, Source, load_json
from .npy_source import NpyError, NpzArrays, read_npy
from .path_checks import check_times
from .path_message import message_table, parse_documents
from .path_names import TIMES, is_unit, known_name, of_base, of_robot
from .path_object import object_table, with_names, with_times
from .path_placing import place_table
from .path_table import BASE_NAMES, RATES, Angles, PathTable

_MAX_BYTES = 50_000_000
_MAX_ROWS = 200_000
_MAX_LINE = 1_000_000  # characters
_MAX_NUMBERS = 10_000_000
_POSITIONS = ("positions", "path", "q", "qs", "waypoints", "samples", "states", "rows")
_RATES = {
    "velocities", "velocity", "v", "vs", "qd", "qds", "dq", "accelerations", "acceleration", "a", "qdd", "qdds",
    "ddq", "efforts", "effort", "tau", "torques",
}  # fmt: skip
_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_NO_NUMBER = r"[-+]?(?:nan|inf|infinity)"
_WITH_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+(?:[eE][-+]?[0-9]+)?")
_OMPL = re.compile(r"path with \d+ states|State\s*\[")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathFile(Summary):
    """The content of a path file, or of a path that a planner has handed over.

    Attributes:
        q: (N, nq) configurations.
        times: (N,) when each is reached [s], or None.
        notes: what was assumed, and what was left out.
        rows: (N, nv) values of the coordinates as the file has them, or None where it has (cos, sin) of angles.
        robot: robot of the columns, with whose held joints the file was compared; `certify` takes no other robot.
        held: joints [rad or m] that the robot holds still and that the file does not name: nothing says whether the
            file's robot has them there. Wheels do not count, which look the same wherever they are.
        at_home: planned joints [rad or m] that the file does not name, and that are at home all along.
        rates: whether the file has velocities or accelerations, by which it may be executed as splines.
        doubts: why the file's robot may not follow ``q``; `certify` calls no such path certified.
        time_doubts: the same for ``times``; these count among obstacles that move.
    """

    q: Array
    times: Array | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    time_doubts: tuple[str, ...] = ()
    rows: Array | None = None
    robot: RobotModel | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    at_home: Mapping[str, float] = field(default_factory=dict)
    rates: bool = False

    def _summary(self) -> dict[str, object]:
        timed = {} if self.times is None else {"seconds": float(self.times[-1] - self.times[0])}
        said = {"notes": self.notes, "doubts": self.doubts, "time_doubts": self.time_doubts}
        return {"configurations": len(self.q), **timed, **{key: "; ".join(value) for key, value in said.items()}}


@named_arguments
def load_path(
    path: object,
    robot: RobotModel,
    *,
    joint_names: Sequence[str] | None = None,
    times: npt.ArrayLike | None = None,
    space: object | None = None,
    base_at: Sequence[float] | None = None,
    angles: Angles | None = None,
    ignore: Collection[str] = (),
    starts_at: float | None = None,
) -> PathFile:
    """Read a robot's path: a file, or what a planner hands over in Python.

    Joints that it does not name stay at home, with a note; joints that the robot does not plan are left out.
    Joints that move in it and not here, or are held elsewhere here, and a base that can move and that it does not
    place: such things are doubts. ``docs/formats.md`` lists all of them, ``docs/others-planners.md`` the planners.

    Args:
        path: the file; its name's ending says its format: ``.json``, ``.yaml``, ``.yml``, ``.csv``, ``.npz``,
            ``.npy``; anything else is text. Or rows of numbers (N, C) of any library; a JointTrajectory or
            RobotTrajectory, or what holds one, as messages or as dictionaries like them; OMPL's SimpleSetup or
            PathGeometric; VAMP's PlanningResult; cuRobo's JointState; RoboPlan's JointPath or JointTrajectory; a
            trajectory of Drake's.
        robot: the robot of the path.
        joint_names: (C,) names of the columns, in their order, where the path has none; ``x``, ``y`` and ``yaw`` are
            the base.
        times: (N,) when each configuration is reached [s], where the path has none.
        space: the state space of an OMPL PathGeometric, whose states do not know how long they are.
        base_at: where the base stands, x, y [m], yaw [rad], as far as the path does not say.
        angles: unit of angles where the path names none: ``"rad"`` or ``"deg"``; None: radians, with a doubt where
            they turn by more than two turns.
        ignore: names of columns, arrays (NPZ) or keys (messages) that do not matter.
        starts_at: when the first configuration is reached [s], in the scene's time; the others follow as in the path.

    Raises:
        ConfigurationError: the file is missing, too large or damaged; the planner found no path, or it is of no type
            that is known; or its columns or values do not fit the robot. The message names file and place.
        ParameterError: unknown ``angles``, or a ``starts_at`` that is not a number.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> names = ["x", "y", "yaw", *robot.joint_names]
        >>> rows = [robot.space.to_coordinates(robot.home(x=x)).tolist() for x in (0.0, 0.5, 1.0)]
        >>> points = [{"positions": row, "time_from_start": 2.0 * k} for k, row in enumerate(rows)]
        >>> path = es.load_path({"joint_names": names, "points": points}, robot)  # a JointTrajectory; or a file's name
        >>> path.times.tolist(), es.certify(robot, es.Scene(), path).certified
        ([0.0, 2.0, 4.0], True)
    """
    check_type("robot", robot, RobotModel, RobotError)
    if angles is not None:
        check_choice("angles", angles, ("rad", "deg"))
    if starts_at is not None:
        starts_at = check_number("starts_at", starts_at, low=-1e9, high=1e9, unit="s")
    ignore = (ignore,) if isinstance(ignore, str) else ignore
    if not isinstance(ignore, Collection) or not all(isinstance(name, str) for name in ignore):
        raise ConfigurationError(f"ignore={shown(ignore)} must be names of columns, arrays or keys")
    ignore = tuple(ignore)
    if isinstance(path, (str, os.PathLike)):
        table, ignore = _file_table(Path(path), robot, ignore)
    else:
        table, ignore = object_table(path, robot, space, ignore)
    table = with_names(table, joint_names)
    table = with_times(table, times)
    source = table.source
    if len(table.rows) < 2 or len(table.rows) > _MAX_ROWS:
        source.fail(f"has {plural(len(table.rows), 'configuration')}; a path has 2 … {_MAX_ROWS}")
    placed = place_table(table, robot, base_at=base_at, angles=angles, ignore=ignore)
    check_times(table, placed, starts_at)
    try:
        q = robot.check_q(robot.space.from_coordinates(placed.coordinates), what="path")
    except ConfigurationError as problem:
        source.fail(str(problem))
    return PathFile(
        q=q,
        times=placed.times,
        notes=tuple(note for note in placed.notes if note != RATES),
        doubts=tuple(placed.doubts),
        time_doubts=tuple(placed.time_doubts),
        rows=placed.coordinates if placed.valued else None,
        robot=robot,
        held=placed.held,
        at_home=placed.at_home,
        rates=RATES in placed.notes,
    )


def _file_table(file: Path, robot: RobotModel, ignore: tuple[str, ...]) -> tuple[PathTable, tuple[str, ...]]:
    """The table of a file; and what of ``ignore`` is none of its arrays or keys."""
    suffix = file.suffix.lower()
    source = Source(file, ConfigurationError)
    if suffix == ".json":
        root = load_json(file, what="path file", error=ConfigurationError)
        return message_table([root], source, ignore)
    if suffix in (".yaml", ".yml"):
        text = read_input_text(file, "path file", MAX_JSON_BYTES, ConfigurationError)
        return message_table(parse_documents(text, source), source, ignore)
    if suffix in (".npz", ".npy"):
        return _arrays(file, robot, source, ignore)
    text = read_input_text(file, "path file", _MAX_BYTES, ConfigurationError)
    states = _OMPL.search(text) or (suffix != ".csv" and re.search(rf"\[\s*{_NUMBER}", text))
    return (_ompl_states(text, source) if states else _table(text, robot, source)), ignore


def write_path(
    path: str | os.PathLike[str], robot: RobotModel, q: PathLike, times: npt.ArrayLike | None = None
) -> Path:
    """Write a path for :func:`load_path`: as CSV, or as a JointTrajectory where the name ends in ``.json``.

    Args:
        path: the file.
        robot: the robot of the path.
        q: configurations (N, nq), or rows (N, nv), or an object with either. Angles are written as continuous values,
            so that they go the way that the path goes.
        times: (N,) when each is reached [s], or None.

    Raises:
        ConfigurationError: configurations that do not fit the robot.
        InputError: the file cannot be written.
    """
    rows = path_rows(robot, q).within_limits(robot)
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


def _row(k: int) -> tuple[str, int | None]:
    return f"configuration {k}", None


@dataclass(slots=True)
class _Taken:
    """What is taken of a file of arrays.

    Attributes:
        name: of the array of rows.
        rows: (N, C) numbers.
        when: name of the array of times, or None; times: (N,) [s], or None.
        names: (C,) of the columns, or None.
        beside: array → (N,) one number for each configuration.
        doubts: what is said of arrays that are left out.
    """

    name: str
    rows: Array
    when: str | None
    times: Array | None
    names: tuple[str, ...] | None
    beside: dict[str, Array] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)


def _arrays(
    file: Path, robot: RobotModel, source: Source, ignore: tuple[str, ...]
) -> tuple[PathTable, tuple[str, ...]]:
    """The table of a NumPy file; and what of ``ignore`` is none of its arrays."""
    with open_input(file, "path file", _MAX_BYTES, ConfigurationError) as (stream, size):
        try:
            if file.suffix.lower() == ".npy":
                rows = _numbers(read_npy(stream, size, _MAX_BYTES), source)
                return PathTable(source, None, _upright(rows, robot.nv, None), _row), ignore
            arrays = NpzArrays(stream, size, _MAX_BYTES)
            taken = _take(arrays, robot, source, ignore)
        except (NpyError, ValueError, OSError, zipfile.BadZipFile, zlib.error) as problem:
            if isinstance(problem, ConfigurationError):
                raise
            source.fail(f"the path file {problem}")
    asked = [each for each in ignore if each in arrays]
    notes = (f"ignored, as requested: {', '.join(asked)}",) if asked else ()
    notes = (*notes, RATES) if set(arrays) & _RATES - set(ignore) else notes
    if taken.names is None and taken.beside and taken.rows.shape[1] == robot.nv:
        taken.names = (*(BASE_NAMES if robot.space.planar else ()), *robot.joint_names)
        notes = (*notes, "columns without names: taken in the robot's order")
    _add_beside(taken, robot)
    table = PathTable(
        source,
        taken.names,
        taken.rows,
        _row,
        taken.times,
        from_start=taken.when == "time_from_start",
        notes=notes,
        doubts=tuple(taken.doubts),
    )
    return table, tuple(each for each in ignore if each not in asked)


def _take(arrays: NpzArrays, robot: RobotModel, source: Source, ignore: tuple[str, ...]) -> _Taken:
    """Rows, times and names among the arrays, and what stands beside them."""
    name = next((n for n in _POSITIONS if n in arrays), None)
    if name is None:
        source.fail(f"has the arrays {', '.join(sorted(arrays)) or 'none'}; one of {', '.join(_POSITIONS)} is needed")
    rows = _numbers(arrays[name], source)
    when = next((n for n in TIMES if n in arrays), None)
    times = None if when is None else _numbers(arrays[when].reshape(-1, 1), source)[:, 0]
    named = _names_of(arrays, rows.shape, robot, source)
    names = None if named is None else tuple(str(n) for n in arrays[named].reshape(-1))
    rows = _upright(rows, len(names) if names is not None else robot.nv, times)
    taken = _Taken(name, rows, when, times, names)
    for other in sorted(set(arrays) - {name, when, named, *ignore} - _RATES):
        values = arrays[other]
        if values.dtype.kind not in "fiu":
            continue
        if values.size in (1, len(rows)):
            taken.beside[other] = np.broadcast_to(values.reshape(-1).astype(float), len(rows))
        elif _tells(other, values, rows):
            taken.doubts.append(
                f"the array {other} is left out, for the path is {name}. Say that it does not matter (--ignore NAME, "
                "ignore=), or make it columns of that with joint_names"
            )
    return taken


def _add_beside(taken: _Taken, robot: RobotModel) -> None:
    """One number for each configuration is one column more, where columns have names; else it may be a doubt."""
    names, rows = taken.names, taken.rows
    if names is None:
        taken.doubts += [
            f"the array {other} ({values.min():.6g} to {values.max():.6g}) is left out, for the path is {taken.name}"
            for other, values in taken.beside.items()
            if np.ptp(values) > LIMIT_TOLERANCE or (of_robot(other, robot) and bool(values.any()))
        ]
    elif len(names) == rows.shape[1]:
        columns = dict(zip(names, rows.T, strict=True))
        for other, values in taken.beside.items():
            if other not in columns or np.abs(values - columns[other]).max() > LIMIT_TOLERANCE:
                names, rows = (*names, other), np.column_stack((rows, values))
        taken.names, taken.rows = names, rows


def _names_of(arrays: NpzArrays, shape: tuple[int, ...], robot: RobotModel, source: Source) -> str | None:
    """The array of names: that called so, or the only one of texts that has one for each column."""
    if "joint_names" in arrays:
        return "joint_names"
    texts = {n: arrays[n] for n in arrays if arrays[n].dtype.kind == "U" and arrays[n].size in shape}
    found = [
        n for n, names in texts.items() if names.size == shape[1] or any(known_name(str(t), robot) for t in names.flat)
    ]
    if len(found) > 1:
        source.fail(f"has several arrays of names: {', '.join(sorted(found))}; call the columns' joint_names")
    return found[0] if found else None


def _tells(name: str, values: np.ndarray, rows: Array) -> bool:
    """Whether an array that is left out may say where the robot is: it changes with the path, or is called so."""
    if name in _POSITIONS:
        return not np.array_equal(values, rows)
    if (of_base(name) or name.lower() in ("gripper", "fingers")) and bool(np.any(values)):
        return True
    if len(rows) not in values.shape:
        return False
    along = np.moveaxis(values, values.shape.index(len(rows)), 0).astype(float)
    return not bool((np.abs(along - along[:1]) <= LIMIT_TOLERANCE).all())


def _upright(rows: Array, columns: int, times: Array | None) -> Array:
    """A row for each sample, of what has a column for each, as Drake has them."""
    across = rows.shape[0] == columns != rows.shape[1]
    timed = times is not None and len(times) == rows.shape[1] != rows.shape[0]
    return rows.T if across or timed else rows


def _numbers(array: np.ndarray, source: Source) -> Array:
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        source.fail(f"has an array of shape {array.shape} and type {array.dtype}; rows of numbers are needed")
    return np.asarray(array, dtype=float)


class _Lines:
    """The lines of a table of text, numbered from 1: what holds something, and comments apart.

    Raises:
        ConfigurationError: there are none.
    """

    def __init__(self, text: str, source: Source) -> None:
        lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
        self.source = source
        self.comments = [(n, line.lstrip()[1:]) for n, line in lines if line.lstrip().startswith("#")]
        self.rows = [(n, line) for n, line in lines if not line.lstrip().startswith("#")]
        if not self.rows:
            source.fail("is empty; a path has at least two configurations")
        self.first = self.rows[0][0]
        self.delimiter = next((d for d in (";", "\t", ",") if d in self.rows[0][1]), None)

    def split(self, number: int, line: str) -> list[str]:
        """The cells of a line."""
        if len(line) > _MAX_LINE:
            self.source.fail(f"a line of {len(line)} characters; at most {_MAX_LINE} are read", number)
        try:
            if self.delimiter:
                parts = next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True))
            else:
                parts = line.split()
        except (csv.Error, StopIteration) as problem:
            self.source.fail(f"is not a line of a table: {problem}", number)
        return [part.strip() for part in parts]

    def take_head(self, robot: RobotModel) -> tuple[list[str] | None, tuple[str, ...], list[str]]:
        """Names of the columns where there are any, their units, and the first line's cells; both lines are taken."""
        head = self.split(*self.rows[0])
        if len(head) > 1 and head[-1] == "":  # a separator at the end of each line
            head.pop()
        if _is_number(head[0], self.delimiter):
            above = [self.split(n, line) for n, line in self.comments if n < self.first][-1:]
            if above and len(above[0]) == len(head) and any(known_name(name, robot) for name in above[0]):
                return above[0], (), head
            return None, (), head
        units: tuple[str, ...] = ()
        del self.rows[0]
        below = self.split(*self.rows[0])[: len(head)] if self.rows else []
        if any(map(is_unit, below)) and all(is_unit(part) or part in ("", "-") for part in below):
            units = tuple("" if part == "-" else part for part in below)
            del self.rows[0]
        return head, units, head

    def numbers(self, width: int, names: list[str] | None) -> tuple[list[list[float]], bool]:
        """The rows, and whether commas are decimal points in any of them."""
        rows, comma = [], False
        if width * len(self.rows) > _MAX_NUMBERS:
            self.source.fail(f"has {len(self.rows)} lines of {width} columns; at most {_MAX_NUMBERS} numbers are read")
        for number, line in self.rows:
            parts = self.split(number, line)
            if len(parts) == width + 1 and parts[-1] == "":
                parts = parts[:-1]
            if len(parts) != width:
                self.source.fail(f"has {len(parts)} columns, not {width}", number)
            if self.delimiter != "," and "," in line:
                comma = True
                if "." in line:
                    self.source.fail("mixes decimal points and decimal commas", number)
                parts = [part.replace(",", ".") if _WITH_COMMA.fullmatch(part) else part for part in parts]
            try:
                if "_" in (said := "".join(parts)) or not said.isascii():  # Python takes them for parts of numbers
                    raise ValueError
                rows.append([float(part) for part in parts])
            except ValueError:
                wrong = next((k for k, p in enumerate(parts) if not re.fullmatch(_NUMBER, p)), 0)
                called = f", {names[wrong][:40]}" if names is not None else ""
                self.source.fail(f"{parts[wrong][:40]!r} is not a number (column {wrong + 1}{called})", number)
        return rows, comma


def _table(text: str, robot: RobotModel, source: Source) -> PathTable:
    """Numbers separated by commas, semicolons or blanks, with or without a line of names before them.

    A comment in front of the numbers is a line of names where it has as many as there are columns, and one of them is
    the robot's: NumPy writes them so.
    """
    lines = _Lines(text, source)
    names, units, head = lines.take_head(robot)
    width = len(names) if names is not None else len(head)
    rows, comma = lines.numbers(width, names)
    if not rows:
        source.fail("has no configurations")
    if names is None and width > 2 and head == [str(k) for k in range(width)]:
        source.fail(f"begins with the numbers 0 … {width - 1}: column numbers are not a configuration", lines.first)
    if comma and any("." in line for _, line in lines.rows):
        source.fail("mixes decimal points and decimal commas")
    numbers = [number for number, _ in lines.rows]
    return PathTable(
        source,
        None if names is None else tuple(names),
        np.array(rows, dtype=float).reshape(len(rows), width),
        lambda k: (f"configuration {k}", numbers[k]),
        units=units,
        notes=("commas are decimal points",) if comma else (),
    )


def _is_number(text: str, delimiter: str | None) -> bool:
    """Whether a cell is no name: a number, or what is written in its place."""
    pattern = f"{_NUMBER}|{_NO_NUMBER}" + (f"|{_WITH_COMMA.pattern}" if delimiter != "," else "")
    return re.fullmatch(pattern, text, re.IGNORECASE) is not None


def _ompl_states(text: str, source: Source) -> PathTable:
    """The numbers in brackets of each state that OMPL printed."""
    count = re.search(r"path with ([0-9]{1,9}) states", text)
    groups: list[Array] = []
    for found in re.finditer(r"\[([^\[\]]*)\]", text):
        if found.end() - found.start() > _MAX_LINE:
            source.fail(f"has a state of {found.end() - found.start()} characters; at most {_MAX_LINE} are read")
        parts = found[1].split()
        if parts and all(re.fullmatch(_NUMBER, part) for part in parts):
            groups.append(np.array(parts, dtype=float))
    states = int(count.group(1)) if count else len(groups)
    numbers = np.concatenate(groups) if groups else np.empty(0)
    if not states or not numbers.size or numbers.size % states:
        source.fail(f"has {numbers.size} numbers in brackets, which are no {states} states of one size")
    return PathTable(source, None, numbers.reshape(states, -1), _row)
