"""IO room, path columns: what each column of a table is of the robot: a joint, a base's, a time, a rate, a counter."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, nearest_name
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import LIMIT_TOLERANCE

from .path_names import BASE_WORDS, OTHER_WORDS, clean_name, is_time, namesake, pose_of, quaternion_part, readings_of
from .path_table import BASE_NAMES, PathTable

_UNIT_TOLERANCE = 1e-3  # by which a quaternion's length may be off: files round to three digits
_RATE = r"rate|velocity|velocities|vel|speed|acceleration|accel|acc|dot|ddot|jerk|effort|torque|tau"
_RATES = re.compile(
    rf"(?:(?:{_RATE})[_/.\s])?(?P<stem>.+?)(?:[_/.\s](?:{_RATE}|(?P<drawn>current|temperature)))?", re.IGNORECASE
)
"""``drawn``: of a motor; of a pose, ``x_current`` is where it is."""
_BASE_RATES = ("vx", "vy", "omega", "ax", "ay", "alpha")
_COUNTERS = ("", "index", "idx", "i", "k", "n", "no", "nr", "row", "seq", "step", "waypoint", "unnamed: 0")


@dataclass(frozen=True, slots=True)
class Column:
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


def identify_columns(table: PathTable, robot: RobotModel, ignore: Collection[str]) -> list[Column]:
    """What each column is."""
    kept = _named_columns(table, ignore)
    joints = {name: robot.space.base_nv + k for k, name in enumerate(robot.joint_names)}
    found: list[Column] = []
    poses: list[tuple[Column, str, int]] = []
    for k, name, below in kept:
        column, pose = _by_name(k, name, below, robot, joints)
        if pose is not None:
            poses.append((column, *pose))
        else:
            found.append(column)
    found += _base_columns(table, poses, robot.space.planar)
    _check_joints_once(table, found)
    names = {name for _, name, _ in kept}
    own = {*joints, *robot.locked, *robot.followers}
    stems = names.union(joints, robot.locked)
    nameless = own.difference(stem for name in names for stem, _ in readings_of(name))
    found = [_told_apart(column, table, stems, own) for column in found]
    found = [replace(c, of=namesake(c.name, nameless)) if c.kind == "other" else c for c in found]
    return sorted(found, key=lambda column: column.index)


def _named_columns(table: PathTable, ignore: Collection[str]) -> list[tuple[int, str, str]]:
    """Number, name and unit (of a line below the names) of each column that is not ignored."""
    assert table.names is not None
    names = [clean_name(name) for name in table.names]
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
    return kept


def _check_joints_once(table: PathTable, columns: Collection[Column]) -> None:
    """Refuse a table with two columns of one joint."""
    joints = [column for column in columns if column.kind == "joint"]
    taken = Counter(column.number for column in joints)
    for column in joints:
        if taken[column.number] > 1:
            table.source.fail(f"names a joint twice: {column.name}")


def _by_name(
    k: int, name: str, below: str, robot: RobotModel, joints: Mapping[str, int]
) -> tuple[Column, tuple[str, int] | None]:
    """What a column is by its name alone; of a pose also whose, and which coordinate of it.

    Args:
        k: number of the column.
        name: its name.
        below: the unit that stands below the name; empty where there is none.
        robot: the robot.
        joints: joint → its number in a row of coordinates.
    """
    for stem, unit in readings_of(name):
        unit = unit or below or None
        if stem in joints:
            return Column(k, name, "joint", unit, joints[stem]), None
        if stem in robot.locked or stem in robot.followers:
            return Column(k, stem, "held", unit), None
        if is_time(stem):
            return Column(k, name, "time", unit), None
        if (pose := pose_of(stem)) is not None:
            return Column(k, name, "other", unit), pose
    return Column(k, name, "other", below or None), None


def with_headings(table: PathTable, ignore: Collection[str]) -> PathTable:
    """The table with a yaw in the place of each quaternion: columns called after its x, y (or neither), z and w."""
    assert table.names is not None
    parts = _quaternions(table.names, ignore)
    if not parts:
        return table
    yaws = np.column_stack([_yaws(table, at) for at in parts.values()])
    gone = {k for at in parts.values() for k in at.values()}
    kept = [k for k in range(len(table.names)) if k not in gone]
    named = len(table.units) == len(table.names)
    return replace(
        table,
        names=(*(table.names[k] for k in kept), *(f"{whose} orientation yaw".strip() for whose in parts)),
        units=(*(table.units[k] for k in kept), *("rad" for _ in parts)) if named else table.units,
        rows=np.column_stack((table.rows[:, kept], np.unwrap(yaws, axis=0))),
    )


def _quaternions(names: Collection[str], ignore: Collection[str]) -> dict[str, dict[str, int]]:
    """Whose quaternion → its parts, of which z and w are there → the column of each; none of what the base is not."""
    parts: dict[str, dict[str, int]] = {}
    for k, name in enumerate(map(clean_name, names)):
        found = quaternion_part(name)
        if found is not None and name not in ignore:
            whose, part = found
            parts.setdefault(whose, {}).setdefault(part, k)
    return {whose: at for whose, at in parts.items() if {"z", "w"} <= set(at) and OTHER_WORDS.isdisjoint(whose.split())}


def _yaws(table: PathTable, at: Mapping[str, int]) -> Array:
    """(N,) yaws [rad] of the quaternions in columns ``at``."""
    assert table.names is not None
    zero = np.zeros(len(table.rows))
    turns = np.column_stack([table.rows[:, at[k]] if k in at else zero for k in "xyzw"])
    yaws = np.empty(len(turns))
    for row, turn in enumerate(turns):
        try:
            yaws[row] = heading_of(turn)
        except ConfigurationError as problem:
            table.fail(row, f"{table.names[at['w']]}: {problem}")
    return yaws


def heading_of(turn: Array) -> float:
    """Yaw [rad] of a quaternion (x, y, z, w) of a base that stands upright.

    Raises:
        ConfigurationError: its length is not 1 within 1e-3, or it tilts the base.
    """
    length = float(np.linalg.norm(turn))
    if not abs(length - 1.0) <= _UNIT_TOLERANCE:
        raise ConfigurationError(f"is a quaternion of length {length:.6g}; 1 within {_UNIT_TOLERANCE:g} is needed")
    x, y, z, w = turn / length
    tilt = float(2.0 * np.arctan2(np.hypot(x, y), np.hypot(z, w)))
    if tilt > LIMIT_TOLERANCE:
        raise ConfigurationError(f"tilts the base by {tilt:.6g} rad; it stands upright, within {LIMIT_TOLERANCE:g} rad")
    return float(2.0 * np.arctan2(z, w))


def _base_columns(table: PathTable, poses: list[tuple[Column, str, int]], planar: bool) -> list[Column]:
    """Which columns of poses are the base's: those called so; or else the only whole pose in the plane.

    Of a base that is ``planar`` also those that have to be 0.
    """
    sets: dict[str, set[int]] = {}
    for _, prefix, number in poses:
        sets.setdefault(prefix, set()).add(number)

    own = {prefix for prefix in sets if set(prefix.split()) <= BASE_WORDS}
    if not any(number < 3 for prefix in own for number in sets[prefix]):
        whole = [p for p, numbers in sets.items() if numbers >= {0, 1, 2} and not set(p.split()) & OTHER_WORDS]
        own = set(whole) if len(whole) == 1 else set()
    out: list[Column] = []
    first: dict[int, Column] = {}
    for column, prefix, number in poses:
        if prefix not in own:
            out.append(column)
        elif number == 3:
            out.append(Column(column.index, column.name, "floor" if planar else "base", column.unit, number))
        elif number not in first:
            first[number] = Column(column.index, column.name, "base", column.unit, number)
        else:
            other = first[number]
            same = np.abs(table.rows[:, column.index] - table.rows[:, other.index]).max(initial=0.0) <= LIMIT_TOLERANCE
            if not same or column.unit != other.unit:
                table.source.fail(
                    f"names a joint twice: {BASE_NAMES[number]} of the base is in the columns {other.name!r} and "
                    f"{column.name!r}, which differ; one of them can be left out (ignore=, --ignore)"
                )
    return [*out, *first.values()]


def _told_apart(column: Column, table: PathTable, stems: set[str], own: Collection[str]) -> Column:
    """Rates and counters among the columns that are nothing of the robot."""
    if column.kind != "other":
        return column
    plain = next((stem for stem, unit in readings_of(column.name) if unit is not None), column.name)
    kind = "other"
    for name in (column.name, plain):
        match = _RATES.fullmatch(name)
        stem = name if match is None else match["stem"]
        pose = pose_of(stem) is not None
        known = (match is not None and match["drawn"] is None) if pose else stem in stems or bool(namesake(stem, own))
        if name in _BASE_RATES or (stem != name and known):
            kind = "rate"
    values = table.rows[:, column.index]
    if column.name.lower() in _COUNTERS and (np.diff(values) == 1.0).all() and values[0] in (0.0, 1.0):
        kind = "counter"
    return Column(column.index, column.name, kind, column.unit)
