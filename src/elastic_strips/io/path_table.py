"""IO room, path tables: rows of numbers become configurations: what each column is of the robot, and in which unit.

Something that a file says and the robot does not follow is a *doubt*: a proof would not be about the file's path.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NoReturn

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.errors import ConfigurationError, nearest_name
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import LIMIT_TOLERANCE, MAX_TRAVEL

from .nodes import Source

Angles = Literal["rad", "deg"]
TIMES = (
    "time", "times", "t", "ts", "time_from_start", "seconds", "sec", "secs", "timestamp", "stamp", "elapsed",
    "elapsed_time",
)  # fmt: skip
_UNIT_LENGTH = 1e-3  # by which a quaternion's length may be off: files round to three digits
_CLOCKS = ("nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds")
_OF_CLOCKS = {"header", "ros", "sim", "wall", "stamp", "time", "log", "recording", "rec", "elapsed", "unix", "field"}
MAX_NAME = 300  # characters
MAX_ANGLE = 1e4
"""Largest yaw, or value of a joint without limits [rad]."""
_MAX_TIME = 1e10  # [s] after 1970 in seconds is less, in milliseconds more
_NOW = 1e-9  # [s]
_TURNS = 4.0 * np.pi  # [rad] what turns farther, of a file that names no unit, may be in degrees
_WIDE = 500.0  # [m] what goes farther, of a file that names no unit, may be in millimetres
RATES = "the file has velocities or accelerations"
"""Stands among a reader's notes for ``PathFile.rates``."""
BASE_NAMES = ("x", "y", "yaw")
_COORDINATES = {
    **dict.fromkeys(("x", "px", "tx"), 0), **dict.fromkeys(("y", "py", "ty"), 1),
    **dict.fromkeys(("yaw", "theta", "heading", "th", "t", "phi", "psi", "rz", "orientation"), 2),
    **dict.fromkeys(("z", "pz", "tz", "roll", "pitch", "rx", "ry"), 3),
}  # fmt: skip
"""Column of a pose: x, y, yaw, or what has to be 0 of a base on the floor."""
_TURNS_OF = {"orientation", "rot", "rotation", "quaternion", "quat"}
_FILLERS = {*_TURNS_OF, "position", "pos", "trans", "translation", "joint", "axis"}
"""What a coordinate's name may have beside that of whose it is."""
_NAME = re.compile(r"[\w/.:\s~%][\w/.:\[\]\s~%-]*", re.ASCII)  # else it has a unit, or what is not known
_WORDS = re.compile(r"[A-Z]?[a-z]+\d*|[A-Z]+\d*(?![a-z])|\d+")
_OF_BASES = {
    "base", "odom", "odometry", "position", "pos", "world", "virtual", "planar", "mobile", "root", "robot", "map",
    "chassis", "platform", "cart", "vehicle", "joint", "link", "footprint", "frame", "pose", "mobilebase",
    "floating", "state", "agv", "amr", "dummy",
}  # fmt: skip
_OF_OTHERS = {
    "goal", "target", "cmd", "twist", "command", "desired", "ref", "reference", "ee", "eef", "tcp", "tool", "hand",
    "gripper", "object", "obstacle", "camera", "error", "human", "person", "next", "previous", "wrist", "head",
    "neck", "torso", "waist", "arm", "leg", "foot",
}  # fmt: skip
_RATE = r"rate|velocity|velocities|vel|speed|acceleration|accel|acc|dot|ddot|jerk|effort|torque|tau"
_RATES = re.compile(
    rf"(?:(?:{_RATE})[_/.\s])?(?P<stem>.+?)(?:[_/.\s](?:{_RATE}|(?P<drawn>current|temperature)))?", re.IGNORECASE
)
"""``drawn``: of a motor; of a pose, ``x_current`` is where it is."""
_BASE_RATES = ("vx", "vy", "omega", "ax", "ay", "alpha")
_COUNTERS = ("", "index", "idx", "i", "k", "n", "no", "nr", "row", "seq", "step", "waypoint", "unnamed: 0")
_UNITS: dict[str, tuple[str, float]] = {
    **dict.fromkeys(("rad", "radian", "radians"), ("angle", 1.0)),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), ("angle", np.pi / 180.0)),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), ("length", 1.0)),
    **dict.fromkeys(("cm",), ("length", 1e-2)), **dict.fromkeys(("mm",), ("length", 1e-3)),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), ("time", 1.0)), **dict.fromkeys(("ms",), ("time", 1e-3)),
    **dict.fromkeys(("us", "µs", "μs"), ("time", 1e-6)), **dict.fromkeys(("ns", "nsec"), ("time", 1e-9)),
}  # fmt: skip
"""Unit → what it is of, and how much of its SI unit it is."""
_BRACKETS = re.compile(r"(?P<stem>.*?)[\s_]*[\[(]\s*(?P<unit>[^\])\d]+?)\s*[\])]")
_SUFFIX = re.compile(rf"(?P<stem>.+)[_\s](?P<unit>{'|'.join(map(re.escape, _UNITS))})", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class PathTable:
    """The content of a file, before its columns are assigned to a robot.

    Attributes:
        source: the file.
        names: (C,) names of the columns, or None.
        rows: (N, C) numbers.
        place: name of row ``k`` in messages, and its line if that is known.
        times: (N,) times [s], or None.
        units: (C,) units of the columns from a line below the names; empty without such a line.
        from_start: whether times are counted from when the robot sets off, as in a JointTrajectory.
        metres: whether lengths are in metres, as in messages of ROS.
        stamp: when it sets off, in the file's own time [s].
        start: names for which the file has only a start state.
        notes, doubts, time_doubts: the reader's own, as for ``PathFile``.
    """

    source: Source
    names: tuple[str, ...] | None
    rows: Array
    place: Callable[[int], tuple[str, int | None]]
    times: Array | None = None
    units: tuple[str, ...] = ()
    from_start: bool = False
    metres: bool = False
    stamp: float = 0.0
    start: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    time_doubts: tuple[str, ...] = ()

    def fail(self, row: int, message: str) -> NoReturn:
        """Raise the source's error about a row."""
        label, line = self.place(row)
        self.source.fail(f"{label}: {message}", line)


@dataclass(slots=True)
class PlacedPath:
    """Coordinates of a robot, and findings on the way.

    Attributes:
        coordinates: (N, nv), as in the file: angles are not wrapped.
        valued: whether the file has values of angles, and not their (cos, sin).
        times: (N,) times [s], or None.
        from_start: as for `PathTable`.
        notes, doubts, time_doubts, held: as for ``PathFile``.
    """

    coordinates: Array
    times: Array | None
    from_start: bool
    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    time_doubts: list[str] = field(default_factory=list)
    valued: bool = True
    held: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Column:
    """A column, and what it is: ``joint`` or ``base`` (with its number in a row of coordinates; 3 is what has to be 0),
    ``floor`` (what has to be 0 of a base), ``held``, ``time``, ``rate``, ``counter`` or ``other``.

    ``of`` is the joint that another column may mean.
    """

    index: int
    name: str
    kind: str
    unit: str | None = None
    number: int = -1
    of: str = ""


def place_table(
    table: PathTable,
    robot: RobotModel,
    *,
    base_at: Sequence[float] | None,
    angles: Angles | None,
    ignore: Collection[str],
) -> PlacedPath:
    """Configurations of the robot from columns, by their names where there are any.

    Args: as for ``load_path``.

    Raises:
        ConfigurationError: the columns or values do not fit the robot.
    """
    if not np.isfinite(table.rows).all():
        table.fail(int(np.argmin(np.isfinite(table.rows).all(axis=1))), "has a value that is not finite")
    if table.names is not None and table.rows.shape[1] != len(table.names):
        table.source.fail(f"has {table.rows.shape[1]} columns for {len(table.names)} names")
    if base_at is not None:
        base_at = _checked_base(robot, base_at)
    longest = max(table.names or ("",), key=len)
    if len(longest) > MAX_NAME:
        table.source.fail(f"has a name of {len(longest)} characters, {longest[:40]}…; at most {MAX_NAME} are read")
    if table.names is not None:
        table = _headed(table, ignore)
    said = (list(table.notes), list(table.doubts), list(table.time_doubts))
    placed = PlacedPath(np.empty((0, 0)), table.times, table.from_start, *said)
    units: dict[int, str | None] = {}
    if table.names is None:
        _unnamed(table, robot, placed, base_at, angles, ignore)
    else:
        units = _named(table, robot, placed, base_at, angles, ignore)
    _check_values(table, robot, placed, units, angles)
    named = {stem for name in table.names or () for stem, _ in _readings(_clean(name))}
    placed.held = {joint: at for joint, at in robot.locked.items() if joint not in named | robot.round_wheels}
    return placed


def _checked_base(robot: RobotModel, base_at: Sequence[float]) -> Sequence[float]:
    if not robot.space.planar:
        raise ConfigurationError(
            f"base_at={tuple(base_at)!r} places a base that moves; that of {robot.name!r} is fixed at the origin"
        )
    try:
        given = np.asarray(base_at, dtype=float)
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape != (3,) or not (np.abs(given) <= [MAX_TRAVEL, MAX_TRAVEL, MAX_ANGLE]).all():
        raise ConfigurationError(
            f"base_at={base_at!r} must be x, y, yaw: three numbers within ±{MAX_TRAVEL:g} m and ±{MAX_ANGLE:g} rad"
        )
    if abs(given[2]) > 2.0 * np.pi + LIMIT_TOLERANCE:
        raise ConfigurationError(
            f"base_at={base_at!r}: the yaw of {given[2]:g} rad is more than a turn, and of no use where a base stands. "
            f"Are these degrees? {given[2]:g} degrees are {np.radians(given[2]):.6g} rad"
        )
    return given.tolist()


def _unnamed(
    table: PathTable, robot: RobotModel, placed: PlacedPath, base_at: Sequence[float] | None, angles: Angles | None,
    ignore: Collection[str],
) -> None:  # fmt: skip
    """Columns in the robot's order."""
    rows, space = table.rows, robot.space
    if ignore:
        raise ConfigurationError(f"ignore={list(ignore)!r}: the columns of {table.source.path} have no names")
    if base_at is not None and rows.shape[1] == space.nv - 3:
        rows = np.column_stack((np.tile(base_at, (len(rows), 1)), rows))
        placed.notes.append(f"base at {_said(base_at)}, as was asked")
    elif base_at is not None:
        table.source.fail(
            f"has {rows.shape[1]} columns without names; with base_at= (--base-at) it has to have {space.nv - 3}, the "
            "joints alone"
        )
    if rows.shape[1] == robot.nq != robot.nv:
        if angles is not None:
            raise ConfigurationError(f"angles={angles!r}: the columns of {table.source.path} are (cos, sin) of angles")
        placed.valued = False
        try:
            rows = space.to_coordinates(robot.check_q(rows, what="path", limits=False))
        except ConfigurationError as problem:
            table.source.fail(str(problem))
    elif rows.shape[1] != robot.nv:
        base = "x, y, yaw (or --base-at X Y YAW, base_at=) and " if space.planar else ""
        table.source.fail(
            f"has {rows.shape[1]} columns without names; {robot.name!r} has {robot.nv}: {base}"
            f"{', '.join(robot.joint_names)}"
        )
    elif angles == "deg":
        rows = np.where(_angular(robot), rows * (np.pi / 180.0), rows)
    placed.coordinates = np.array(rows, dtype=float)
    placed.notes.append("columns without names: taken in the robot's order")


def _named(
    table: PathTable, robot: RobotModel, placed: PlacedPath, base_at: Sequence[float] | None, angles: Angles | None,
    ignore: Collection[str],
) -> dict[int, str | None]:  # fmt: skip
    """Columns by their names; returns the unit that the file names for each of the robot's coordinates."""
    assert table.names is not None
    columns = _identified(table, robot, ignore)
    b = robot.space.base_nv
    mine = [c for c in columns if c.kind == "joint" or (c.kind == "base" and b)]
    if not mine:
        shown = ", ".join(map(str, table.names))[:120]
        table.source.fail(f"names {shown}; {robot.name!r} plans {', '.join(robot.joint_names)}")
    coordinates = np.tile(robot.space.to_coordinates(robot.home_q), (len(table.rows), 1))
    angular, units = _angular(robot), {}
    for column in mine:
        factor = _factor(table, column, "angle" if angular[column.number] else "length", angles)
        coordinates[:, column.number] = table.rows[:, column.index] * factor
        units[column.number] = column.unit
    placed.coordinates = coordinates
    _clock(table, columns, placed)
    _left_out(table, robot, columns, placed, angles)
    if ignore:
        placed.notes.append(f"not looked at, as was asked: {', '.join(ignore)}")
    missing = [
        f"{name} at {coordinates[0, b + k]:.6g}" for k, name in enumerate(robot.joint_names) if b + k not in units
    ]
    started = [c.name for c in mine if c.name in table.start]
    if started:
        placed.notes.append(f"as in the file's start state all along: {', '.join(started)}")
    if missing:
        placed.notes.append(f"at home, as the file does not name them: {', '.join(missing)}")
    _place_base(table, robot, placed, base_at, [k for k in range(b) if k not in units])
    return units


def _place_base(
    table: PathTable, robot: RobotModel, placed: PlacedPath, base_at: Sequence[float] | None, open_: list[int]
) -> None:
    """A base that can move has to be somewhere."""
    if base_at is not None:
        if not open_:
            table.source.fail(f"places the base itself; base_at={tuple(base_at)} (--base-at) is one place too many")
        placed.coordinates[:, open_] = [base_at[k] for k in open_]
        named = ", ".join(f"{BASE_NAMES[k]} = {base_at[k]:.6g}" for k in open_)
        placed.notes.append(f"base at {named}, as was asked")
    elif open_:
        placed.doubts.append(
            f"the file does not say {', '.join(BASE_NAMES[k] for k in open_)} of the base, which can move: taken for "
            "0. Place it (--base-at X Y YAW, base_at=), or let it not move (--base fixed) where it stands at the origin"
        )


def _identified(table: PathTable, robot: RobotModel, ignore: Collection[str]) -> list[_Column]:
    """What each column is."""
    assert table.names is not None
    names = [_clean(name) for name in table.names]
    for name in ignore:
        if name not in names:
            raise ConfigurationError(
                f"ignore={name!r}: {table.source.path} has no such column{nearest_name(name, names)}"
            )
    units = [unit.strip("[]() ") for unit in table.units] or [""] * len(names)
    if len(units) != len(names):
        table.source.fail(f"has {len(units)} units for {len(names)} names")
    kept = [(k, name, units[k]) for k, name in enumerate(names) if name not in ignore]
    twice = [name for name, count in Counter(name for _, name, _ in kept if name).items() if count > 1]
    if twice:
        table.source.fail(f"names a joint twice, or another column: {', '.join(twice)[:200]}")
    joints = {name: robot.space.base_nv + k for k, name in enumerate(robot.joint_names)}
    found: list[_Column] = []
    poses: list[tuple[_Column, str, int]] = []
    for k, name, below in kept:
        column, pose = _Column(k, name, "other", below or None), None
        for stem, unit in _readings(name):
            unit = unit or below or None
            if stem in joints:
                column = _Column(k, name, "joint", unit, joints[stem])
            elif stem in robot.locked or stem in robot.followers:
                column = _Column(k, stem, "held", unit)
            elif is_time(stem):
                column = _Column(k, name, "time", unit)
            else:
                said = _pose(stem)
                if said is None:
                    continue
                column = _Column(k, name, "other", unit)
                pose = (column, *said)
            break
        if pose is not None:
            poses.append(pose)
        else:
            found.append(column)
    found += _base_columns(table, poses, robot.space.planar)
    taken = Counter(c.number for c in found if c.kind == "joint")
    for c in found:
        if c.kind == "joint" and taken[c.number] > 1:
            table.source.fail(f"names a joint twice: {c.name}")
    stems = {*joints, *robot.locked, *(name for _, name, _ in kept)}
    own = {*joints, *robot.locked, *robot.followers}
    named = {stem for _, name, _ in kept for stem, _ in _readings(name)}
    found = [_told_apart(c, table, stems, own) for c in found]
    found = [replace(c, of=_namesake(c.name, own - named)) if c.kind == "other" else c for c in found]
    return sorted(found, key=lambda c: c.index)


def is_time(stem: str) -> bool:
    """Whether a name is that of times: ``t``, ``header.stamp``, ``sim_time``."""
    words = words_of(stem)
    if stem.lower() in TIMES or (len(words) == 1 and words[0] in _CLOCKS):
        return True
    last = ("time", "stamp", "timestamp", "sec", "secs", *_CLOCKS)
    return len(words) > 1 and words[-1] in last and set(words[:-1]) <= _OF_CLOCKS


def is_unit(text: str) -> bool:
    """Whether a cell below a name is a unit that is known."""
    return text.strip().strip("[]()").strip().lower() in _UNITS


def known_name(name: str, robot: RobotModel) -> bool:
    """Whether a name is one of the robot's, with or without a unit."""
    own = {*robot.joint_names, *robot.locked}
    return any(stem in own or _pose(stem) for stem, _ in _readings(_clean(name)))


def words_of(name: str) -> list[str]:
    """A name's words: ``robot1/baseX`` has robot1, base and x."""
    return [word.lower() for word in _WORDS.findall(name)]


def _pose(stem: str) -> tuple[str, int] | None:
    """Whose coordinate a name says, and which; None where it is no coordinate of a pose."""
    words = words_of(stem)
    if len(words) == 2 and words[0] in _COORDINATES and words[1] == "base":
        words.reverse()
    while len(words) > 1 and words[-1] in ("joint", "axis"):
        words.pop()
    number = _COORDINATES.get(words[-1]) if words and _NAME.fullmatch(stem) else None
    if words[-2:] in (["z", "rotation"], ["rot", "z"], ["rotation", "z"]):
        number = 2
    elif len(words) > 1 and number in (0, 1) and words[-2] in _TURNS_OF:
        number = 3
    if number is None or words == ["t"]:
        return None
    return " ".join(word for word in words[:-1] if word not in _FILLERS and word not in "xyz"), number


def _quaternion(name: str) -> tuple[str, str] | None:
    """Whose quaternion a name says, and which of x, y, z and w of it."""
    words = words_of(name)
    last = words[-1] if words else ""
    if not (last in ("qx", "qy", "qz", "qw") or (len(last) == 1 and last in "xyzw" and _TURNS_OF & set(words))):
        return None
    return " ".join(word for word in words[:-1] if word not in _FILLERS), last[-1]


def _headed(table: PathTable, ignore: Collection[str]) -> PathTable:
    """The table with a yaw in the place of each quaternion: columns called after its x, y (or neither), z and w."""
    assert table.names is not None
    parts: dict[str, dict[str, int]] = {}
    for k, name in enumerate(table.names):
        found = _quaternion(_clean(name))
        if found is not None and _clean(name) not in ignore:
            parts.setdefault(found[0], {}).setdefault(found[1], k)
    parts = {p: at for p, at in parts.items() if {"z", "w"} <= set(at) and not set(p.split()) & _OF_OTHERS}
    if not parts:
        return table
    yaws = np.empty((len(table.rows), len(parts)))
    for column, at in zip(yaws.T, parts.values(), strict=True):
        turns = np.column_stack([table.rows[:, at[k]] if k in at else np.zeros(len(table.rows)) for k in "xyzw"])
        for row, turn in enumerate(turns):
            try:
                column[row] = heading_of(turn)
            except ConfigurationError as problem:
                table.fail(row, f"{table.names[at['w']]}: {problem}")
    gone = {k for at in parts.values() for k in at.values()}
    kept = [k for k in range(len(table.names)) if k not in gone]
    named = len(table.units) == len(table.names)
    return replace(
        table,
        names=(*(table.names[k] for k in kept), *(f"{whose} orientation yaw".strip() for whose in parts)),
        units=(*(table.units[k] for k in kept), *("rad" for _ in parts)) if named else table.units,
        rows=np.column_stack((table.rows[:, kept], np.unwrap(yaws, axis=0))),
    )


def heading_of(turn: Array) -> float:
    """Yaw [rad] of a quaternion (x, y, z, w) of a base that stands upright.

    Raises:
        ConfigurationError: its length is not 1 within 1e-3, or it tilts the base.
    """
    length = float(np.linalg.norm(turn))
    if not abs(length - 1.0) <= _UNIT_LENGTH:
        raise ConfigurationError(f"is a quaternion of length {length:.6g}; 1 within {_UNIT_LENGTH:g} is needed")
    x, y, z, w = turn / length
    tilt = float(2.0 * np.arctan2(np.hypot(x, y), np.hypot(z, w)))
    if tilt > LIMIT_TOLERANCE:
        raise ConfigurationError(f"tilts the base by {tilt:.6g} rad; it stands upright, within {LIMIT_TOLERANCE:g} rad")
    return float(2.0 * np.arctan2(z, w))


def _namesake(name: str, joints: Collection[str]) -> str:
    """The joint that a name may mean which is not quite its own: in another namespace, other letters, with a word more.

    Empty where there is none.
    """
    words = words_of(name)
    best = ""
    for joint in joints:
        own = words_of(joint)
        within = any(words[k : k + len(own)] == own for k in range(len(words) - len(own) + 1))
        ending = len(words) < len(own) and own[-len(words) :] == words
        if words and own and (within or ending) and len(joint) > len(best):
            best = joint
    return best


def of_robot(name: str, robot: RobotModel) -> bool:
    """Whether a name may be that of a joint of the robot, or of its base."""
    found = _pose(name)
    own = {*robot.joint_names, *robot.locked, *robot.followers}
    return bool(_namesake(name, own)) or (found is not None and set(found[0].split()) <= _OF_BASES)


def of_base(name: str) -> bool:
    """Whether a name is made of the words by which bases go."""
    words = set(words_of(name))
    return bool(words) and words <= _OF_BASES


def of_something_else(name: str) -> bool:
    """Whether a name says that it is of a goal, a tool, an object …, and so not of the base."""
    return bool(set(words_of(name)) & _OF_OTHERS)


def _clean(name: str) -> str:
    return str(name).strip().strip("\"'").strip().removeprefix("%").strip()


def _readings(name: str) -> list[tuple[str, str | None]]:
    """A name as it stands, and without the unit at its end."""
    readings: list[tuple[str, str | None]] = [(name, None)]
    for pattern in (_BRACKETS, _SUFFIX) if len(name) <= MAX_NAME else ():  # they take long where there is much
        match = pattern.fullmatch(name)
        if match is not None and match["stem"].strip():
            readings.append((match["stem"].strip(), match["unit"].strip()))
    return readings


def _base_columns(table: PathTable, poses: list[tuple[_Column, str, int]], planar: bool) -> list[_Column]:
    """Which columns of poses are the base's: those called so; or else the only whole pose in the plane.

    Of a base that is ``planar`` also those that have to be 0.
    """
    sets: dict[str, set[int]] = {}
    for _, prefix, number in poses:
        sets.setdefault(prefix, set()).add(number)

    own = {prefix for prefix in sets if set(prefix.split()) <= _OF_BASES}
    if not any(number < 3 for prefix in own for number in sets[prefix]):
        whole = [p for p, numbers in sets.items() if numbers >= {0, 1, 2} and not set(p.split()) & _OF_OTHERS]
        own = set(whole) if len(whole) == 1 else set()
    out: list[_Column] = []
    first: dict[int, _Column] = {}
    for column, prefix, number in poses:
        if prefix not in own:
            out.append(column)
        elif number == 3:
            out.append(_Column(column.index, column.name, "floor" if planar else "base", column.unit, number))
        elif number not in first:
            first[number] = _Column(column.index, column.name, "base", column.unit, number)
        else:
            other = first[number]
            same = np.abs(table.rows[:, column.index] - table.rows[:, other.index]).max(initial=0.0) <= LIMIT_TOLERANCE
            if not same or column.unit != other.unit:
                table.source.fail(
                    f"names a joint twice: {BASE_NAMES[number]} of the base is in the columns {other.name!r} and "
                    f"{column.name!r}, which differ; one of them can be left out (ignore=, --ignore)"
                )
    return [*out, *first.values()]


def _told_apart(column: _Column, table: PathTable, stems: set[str], own: Collection[str]) -> _Column:
    """Rates and counters among the columns that are nothing of the robot."""
    if column.kind != "other":
        return column
    plain = next((stem for stem, unit in _readings(column.name) if unit is not None), column.name)
    kind = "other"
    for name in (column.name, plain):
        match = _RATES.fullmatch(name)
        stem = name if match is None else match["stem"]
        pose = _pose(stem) is not None
        known = (match is not None and match["drawn"] is None) if pose else stem in stems or bool(_namesake(stem, own))
        if name in _BASE_RATES or (stem != name and known):
            kind = "rate"
    values = table.rows[:, column.index]
    if column.name.lower() in _COUNTERS and (np.diff(values) == 1.0).all() and values[0] in (0.0, 1.0):
        kind = "counter"
    return _Column(column.index, column.name, kind, column.unit)


def _factor(table: PathTable, column: _Column, of: str, angles: Angles | None = None) -> float:
    """How much of the SI unit one of the column's is."""
    if column.unit is None:
        return np.pi / 180.0 if of == "angle" and angles == "deg" else 1.0
    kind, factor = _UNITS.get(column.unit.lower(), ("", 0.0))
    if kind != of:
        valid = ", ".join(unit for unit, (what, _) in _UNITS.items() if what == of)
        table.source.fail(f"column {column.name!r}: {column.unit!r} is not a known unit of {of}. Valid: {valid}")
    return factor


def _clock(table: PathTable, columns: list[_Column], placed: PlacedPath) -> None:
    """Times from their column, where the reader has found none."""
    assert table.names is not None
    clocks = [(_split(c.name), c, table.rows[:, c.index]) for c in columns if c.kind == "time"]
    parts = {of: (column, values) for (of, fine), column, values in clocks if fine}
    found: list[tuple[_Column, Array]] = []
    for (of, fine), column, values in clocks:
        if fine and any(of == whole for (whole, other), _, _ in clocks if not other):
            continue  # it belongs to the seconds beside it
        plain = column.unit is None and str(table.names[column.index]).strip().startswith("%")  # rostopic echo -p
        factor = 1e-9 if fine or plain else _factor(table, column, "time")
        more = parts[of][1] * 1e-9 if of in parts and not fine else 0.0
        found.append((column, values * factor + more))
    if not found:
        return
    if placed.times is None:
        placed.from_start = "from_start" in found[0][0].name.lower()
        placed.times = found[0][1]
    since = placed.times - placed.times[0]
    for column, times in found:
        if np.abs(times - times[0] - since).max() > 1e-3:
            placed.time_doubts.append(f"the times of {column.name} differ from those of {found[0][0].name}")


def _split(name: str) -> tuple[str, bool]:
    """What a column of times is of; and whether it has the nanoseconds of those alone."""
    words = words_of(name)
    fine = words[-1] in _CLOCKS
    return " ".join(words[:-1] if fine or words[-1] in ("sec", "secs") else words), fine


def _left_out(
    table: PathTable, robot: RobotModel, columns: list[_Column], placed: PlacedPath, angles: Angles | None
) -> None:
    """What is not planned: said where it stands still as the robot has it, doubted where it does not."""
    rest = [c for c in columns if c.kind in ("held", "other") or (c.kind == "base" and not robot.space.planar)]
    if any(c.kind == "rate" for c in columns):
        placed.notes += ["velocities and accelerations are left out", RATES]
    said = [c.name for c in rest if c.name not in table.start and c.name not in robot.followers]
    if said:
        placed.notes.append(f"left out, as {robot.name!r} does not plan them: {', '.join(said)}")
    apart: dict[str, list[str]] = {"held": [], "base": [], "other": [], "named": []}
    wheels: list[str] = []
    for column in rest:
        values, at = table.rows[:, column.index], _whereabouts(robot, column.name, placed.coordinates)
        if column.kind == "other":
            changes = bool(np.ptp(values) > LIMIT_TOLERANCE)
            if column.of:
                at = _whereabouts(robot, column.of, placed.coordinates)
                scaled = values * _UNITS.get((column.unit or "").lower(), ("", 1.0))[1]
                if changes or np.abs(scaled - at).max() > LIMIT_TOLERANCE:
                    apart["named"].append(f"{column.name} ({_span(values)}), where {column.of} is {_span(at)} here")
            elif changes:
                apart["other"].append(f"{column.name} ({_span(values)})")
            continue
        known = column.unit is not None or angles != "deg"  # the kind of a joint that is held is not known here
        if column.unit is not None:
            of, factor = _UNITS.get(column.unit.lower(), ("time", 0.0))
            if of == "time" or (
                column.kind == "base" and column.number < 3 and (of == "angle") != (column.number == 2)
            ):
                table.source.fail(f"column {column.name!r}: {column.unit!r} is not a known unit for it")
            values = values * factor
        if np.abs(values - at).max() <= LIMIT_TOLERANCE and (known or np.abs(at).max() <= LIMIT_TOLERANCE):
            continue
        if column.name in robot.round_wheels:
            wheels.append(column.name)
        else:
            unit = "" if known else " (degrees? name the unit)"
            apart[column.kind].append(f"{column.name} at {_span(at)}, in the file {_span(values)}{unit}")
    for column in columns:
        values = table.rows[:, column.index]
        if column.kind == "floor" and np.abs(values).max() > LIMIT_TOLERANCE:
            row = int(np.abs(values).argmax())
            table.fail(row, f"{column.name} = {values[row]:.6g}; a base stands upright on the floor, where that is 0")
    if wheels:
        placed.notes.append(f"wheels turn, and are round: {', '.join(wheels)}")
    for kind, said in apart.items():
        if said:
            placed.doubts.append(_UNLIKE[kind].format("; ".join(said)))


_UNLIKE = {
    "held": "held still elsewhere than in the file: {}. Hold them there (--lock NAME=VALUE, locked=), or plan those "
    "that move (--joints, joints=)",
    "base": "the base is fixed elsewhere than in the file: {}. Let it move (--base omni or diff_drive), or say that "
    "these are not the base's (--ignore NAME, ignore=)",
    "named": "columns may be joints of the robot under other names: {}. Name them as the robot does, or say "
    "that they do not matter (--ignore NAME, ignore=)",
    "other": "columns that are left out change: {}. Plan what they move (--joints, joints=), or say that they do not "
    "matter (--ignore NAME, ignore=)",
}
"""What is to be said of columns that the robot does not follow, by their kind."""


def _whereabouts(robot: RobotModel, name: str, coordinates: Array) -> Array:
    """(N,) or (1,) where the robot has a joint; 0 for a base that is fixed."""
    if name in robot.joint_names:
        return coordinates[:, robot.space.base_nv + robot.joint_names.index(name)]
    if name not in robot.followers:
        return np.array([robot.locked.get(name, 0.0)])
    leader, multiplier, constant = robot.followers[name]
    return multiplier * coordinates[:, robot.space.base_nv + robot.joint_names.index(leader)] + constant


def _span(values: Array) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.6g}" if high - low <= LIMIT_TOLERANCE else f"{low:.6g} to {high:.6g}"


def _said(base_at: Sequence[float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in zip(BASE_NAMES, base_at, strict=True))


def _angular(robot: RobotModel) -> Mask:
    """(nv,) whether a coordinate is an angle."""
    base = [False, False, True] if robot.space.planar else []
    model = robot.model
    kinds = [model.joints[i].shortname() for i in range(1, model.njoints) if model.nvs[i]]
    return np.array([*base, *(not kind.startswith("JointModelP") for kind in kinds[bool(base) :])], dtype=bool)


def _check_values(
    table: PathTable, robot: RobotModel, placed: PlacedPath, units: dict[int, str | None], angles: Angles | None
) -> None:
    """Values within bounds and limits; what is beyond these by what files round is taken to the limit."""
    values, space, angular = placed.coordinates, robot.space, _angular(robot)
    names = (*BASE_NAMES[: space.base_nv], *robot.joint_names)
    unnamed = np.array([units.get(k) is None for k in range(space.nv)], dtype=bool)
    unsaid = unnamed & (angles is None)
    endless = np.isinf(space.upper) & angular
    for far, bound, unit in (
        (np.isinf(space.upper) & ~angular, MAX_TRAVEL, "m"), (endless, MAX_ANGLE, "rad"),
    ):  # fmt: skip
        beyond = np.argwhere((np.abs(values) > bound) & far)
        if len(beyond):
            k, column = (int(i) for i in beyond[0])
            table.fail(k, f"{names[column]} = {values[k, column]:.6g}, beyond ±{bound:g} {unit}")
    excess = np.maximum(space.lower - values, values - space.upper)
    outside = excess > LIMIT_TOLERANCE
    if outside.any():
        k, column = (int(i) for i in np.argwhere(outside)[0])
        wrong = outside.any(axis=0)
        hint = ""
        for kind, scale, most, ask in (
            (angular, np.pi / 180.0, 2.0 * np.pi, "Are these degrees? Name the unit (--angles deg, angles='deg')"),
            (~angular, 1e-3, 2.0, f"Are these millimetres? Name the unit ({names[column]}_mm)"),
        ):
            these = wrong & kind & unsaid
            scaled = values[:, these] * scale
            fits = ((scaled >= space.lower[these]) & (scaled <= space.upper[these])).all()
            if these[column] and fits and np.abs(values[:, these]).max() > most:
                hint = f". {ask}"
        unit = "rad" if angular[column] else "m"
        table.fail(
            k, f"joint {names[column]!r} = {values[k, column]:.6g} is outside its limits [{space.lower[column]:.6g}, "
            f"{space.upper[column]:.6g}] by {excess[k, column]:.3g} {unit}; up to {LIMIT_TOLERANCE:g} is taken to the "
            f"limit{hint}",
        )  # fmt: skip
    clipped = np.flatnonzero((excess > 0.0).any(axis=0))
    if len(clipped):
        named = ", ".join(f"{names[i]} by {excess[:, i].max():.2g}" for i in clipped)
        placed.notes.append(f"taken to the limit: {named}")
        placed.coordinates = np.clip(values, space.lower, space.upper)
    jumps = np.flatnonzero((np.abs(np.diff(values, axis=0)) > np.pi + LIMIT_TOLERANCE).any(axis=0) & endless)
    if len(jumps):
        named = ", ".join(names[i] for i in jumps)
        placed.notes.append(f"changes by more than half a turn from one configuration to the next: {named}")
    wide = float(np.ptp(values[:, :2], axis=0).max()) if space.planar else 0.0
    if wide > _WIDE and not table.metres and unnamed[:2].any():
        placed.doubts.append(
            f"millimetres? The base goes {wide:.6g} m, and the file names no unit. Name it (x_m, y_m or x_mm, y_mm)"
        )
    turning = [names[i] for i in np.flatnonzero(endless & unsaid) if np.abs(values[:, i]).max() > _TURNS]
    if turning:
        placed.doubts.append(
            f"degrees? {', '.join(turning)} turn by more than two turns, and the file names no unit. Name it "
            "(--angles rad or deg, angles=)"
        )


def check_times(table: PathTable, placed: PlacedPath, starts_at: float | None) -> None:
    """Times that do not fall; what they do not say is a doubt where something moves."""
    times = placed.times
    if times is None:
        if starts_at is not None:
            table.source.fail(f"has no times; starts_at={starts_at:g} (--starts-at) says when those begin")
        return
    if len(times) != len(table.rows) or not (np.abs(times) <= _MAX_TIME).all():
        table.source.fail(
            f"has {len(times)} times for {len(table.rows)} configurations, or they are not within ±{_MAX_TIME:g} s; "
            "name the unit of nanoseconds (time_ns)"
        )
    step = np.diff(times)
    if (step < 0.0).any():
        k = int(np.argmax(step < 0.0))
        table.fail(k + 1, f"the times decrease, from {times[k]:.9g} s to {times[k + 1]:.9g} s")
    moved = np.abs(np.diff(placed.coordinates, axis=0)).max(axis=1, initial=0.0) > LIMIT_TOLERANCE
    leap = moved & (step == 0.0)
    if not step.any():
        placed.time_doubts.append(f"all times are {times[0]:.9g} s: they do not say when the robot is where")
    elif leap.any():
        k = int(np.argmax(leap))
        label, line = table.place(k + 1)
        where = label if line is None else f"line {line}"
        placed.time_doubts.append(f"{where}: the robot is at two places at {times[k]:.9g} s")
    if starts_at is not None:
        placed.times = times - times[0] + starts_at
        placed.notes.append(f"the path begins at {starts_at:g} s, as was asked")
    elif abs(times[0]) > _NOW:
        said = (
            f"the first configuration is reached at {times[0]:.9g} s, and the file does not say from where; begin it "
            "at 0 s, or say when the robot is there (--starts-at SECONDS, starts_at=)"
        )
        (placed.doubts if placed.from_start else placed.time_doubts).append(said)
    elif abs(table.stamp) > _NOW:
        placed.time_doubts.append(
            f"the header's stamp is {table.stamp:.9g} s, which may be when the robot sets off; say when that is "
            "(--starts-at SECONDS, starts_at=)"
        )
