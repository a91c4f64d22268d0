"""IO room, path placing: rows of numbers become configurations of a robot, by what their columns are.

What a file says and the robot does not follow is a *doubt*: what is proven then is not what the file holds.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Sequence

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import LIMIT_TOLERANCE, MAX_TRAVEL

from .path_checks import MAX_ANGLE, angular_coordinates, check_values
from .path_columns import Column, identify_columns, with_headings
from .path_names import MAX_NAME, UNITS, clean_name, clock_of, namesake, readings_of
from .path_table import BASE_NAMES, RATES, Angles, PathTable, PlacedPath


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
        table = with_headings(table, ignore)
    said = (list(table.notes), list(table.doubts), list(table.time_doubts))
    placed = PlacedPath(np.empty((0, 0)), table.times, table.from_start, *said)
    units: dict[int, str | None] = {}
    if table.names is None:
        _unnamed(table, robot, placed, base_at, angles, ignore)
    else:
        units = _named(table, robot, placed, base_at, angles, ignore)
    check_values(table, robot, placed, units, angles)
    named = {stem for name in table.names or () for stem, _ in readings_of(clean_name(name))}
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
    table: PathTable,
    robot: RobotModel,
    placed: PlacedPath,
    base_at: Sequence[float] | None,
    angles: Angles | None,
    ignore: Collection[str],
) -> None:
    """Columns in the robot's order."""
    rows, space = table.rows, robot.space
    if ignore:
        raise ConfigurationError(f"ignore={list(ignore)!r}: the columns of {table.source.path} have no names")
    if base_at is not None and rows.shape[1] == space.nv - 3:
        rows = np.column_stack((np.tile(base_at, (len(rows), 1)), rows))
        placed.notes.append(f"base at {_said(base_at)}, as requested")
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
        base = "x, y, yaw (or --base-at X,Y,YAW, base_at=) and " if space.planar else ""
        table.source.fail(
            f"has {rows.shape[1]} columns without names; {robot.name!r} has {robot.nv}: {base}"
            f"{', '.join(robot.joint_names)}"
        )
    elif angles == "deg":
        rows = np.where(angular_coordinates(robot), rows * (np.pi / 180.0), rows)
    placed.coordinates = np.array(rows, dtype=float)
    placed.notes.append("columns without names: taken in the robot's order")


def _named(
    table: PathTable,
    robot: RobotModel,
    placed: PlacedPath,
    base_at: Sequence[float] | None,
    angles: Angles | None,
    ignore: Collection[str],
) -> dict[int, str | None]:
    """Columns by their names; returns the unit that the file names for each of the robot's coordinates."""
    assert table.names is not None
    columns = identify_columns(table, robot, ignore)
    b = robot.space.base_nv
    mine = [c for c in columns if c.kind == "joint" or (c.kind == "base" and b)]
    if not mine:
        shown = ", ".join(map(str, table.names))[:120]
        table.source.fail(f"names {shown}; {robot.name!r} plans {', '.join(robot.joint_names)}")
    coordinates = np.tile(robot.space.to_coordinates(robot.home_q), (len(table.rows), 1))
    angular, units = angular_coordinates(robot), {}
    for column in mine:
        factor = _factor(table, column, "angle" if angular[column.number] else "length", angles)
        coordinates[:, column.number] = table.rows[:, column.index] * factor
        units[column.number] = column.unit
    turned = [c.name for c in mine if c.unit is None and angular[c.number]]
    if angles is not None and turned:
        unit = "degrees" if angles == "deg" else "radians"
        placed.notes.append(f"taken in {unit}, as requested of all angles: {', '.join(turned)}")
    placed.coordinates = coordinates
    _clock(table, columns, placed)
    _left_out(table, robot, columns, placed, angles)
    if ignore:
        placed.notes.append(f"ignored, as requested: {', '.join(ignore)}")
    placed.at_home = {
        name: float(coordinates[0, b + k]) for k, name in enumerate(robot.joint_names) if b + k not in units
    }
    started = [c.name for c in mine if c.name in table.start]
    if started:
        placed.notes.append(f"as in the file's start state all along: {', '.join(started)}")
    if placed.at_home:
        still = ", ".join(f"{name} at {at:.6g}" for name, at in placed.at_home.items())
        placed.notes.append(f"at home, as the file does not name them: {still}")
    _place_base(table, placed, base_at, [k for k in range(b) if k not in units])
    return units


def _place_base(table: PathTable, placed: PlacedPath, base_at: Sequence[float] | None, open_: list[int]) -> None:
    """A base that can move has to be somewhere."""
    if base_at is not None:
        if not open_:
            table.source.fail(f"places the base itself; base_at={tuple(base_at)} (--base-at) is one place too many")
        placed.coordinates[:, open_] = [base_at[k] for k in open_]
        named = ", ".join(f"{BASE_NAMES[k]} = {base_at[k]:.6g}" for k in open_)
        placed.notes.append(f"base at {named}, as requested")
    elif open_:
        placed.doubts.append(
            f"the file does not say {', '.join(BASE_NAMES[k] for k in open_)} of the base, which can move: taken for "
            "0. Place it (--base-at X,Y,YAW, base_at=), or let it not move (--base fixed) where it stands at the origin"
        )


def _factor(table: PathTable, column: Column, of: str, angles: Angles | None = None) -> float:
    """How much of the SI unit one of the column's is."""
    if column.unit is None:
        return np.pi / 180.0 if of == "angle" and angles == "deg" else 1.0
    kind, factor = UNITS.get(column.unit.lower(), ("", 0.0))
    if kind != of:
        valid = ", ".join(unit for unit, (what, _) in UNITS.items() if what == of)
        table.source.fail(f"column {column.name!r}: {column.unit!r} is not a known unit of {of}. Valid: {valid}")
    return factor


_IN_SECONDS = ("seconds", "sec", "secs")  # names of columns that say their unit


def _clock(table: PathTable, columns: list[Column], placed: PlacedPath) -> None:
    """Times from their column, where the reader has found none."""
    assert table.names is not None
    clocks = [(clock_of(c.name), c, table.rows[:, c.index]) for c in columns if c.kind == "time"]
    parts = {of: (column, values) for (of, fine), column, values in clocks if fine}
    found: list[tuple[Column, Array]] = []
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
        first, name = found[0][0], found[0][0].name.lower()
        if first.unit is None and not table.metres and not placed.from_start and name not in _IN_SECONDS:
            placed.clock = first.name
    since = placed.times - placed.times[0]
    for column, times in found:
        if np.abs(times - times[0] - since).max() > 1e-3:
            placed.time_doubts.append(f"the times of {column.name} differ from those of {found[0][0].name}")


def _left_out(
    table: PathTable, robot: RobotModel, columns: list[Column], placed: PlacedPath, angles: Angles | None
) -> None:
    """What is not planned: said where it stands still as the robot has it, doubted where it does not."""
    rest = [c for c in columns if c.kind in ("held", "other") or (c.kind == "base" and not robot.space.planar)]
    if any(c.kind == "rate" for c in columns):
        placed.notes += ["velocities and accelerations are left out", RATES]
    said = [c.name for c in rest if c.name not in table.start and c.name not in robot.followers]
    if said:
        placed.notes.append(f"left out, as {robot.name!r} does not plan them: {', '.join(said)}")
    named = {column.number for column in columns if column.kind == "joint"}
    missing = [name for k, name in enumerate(robot.joint_names) if robot.space.base_nv + k not in named]
    if len(missing) == len(robot.joint_names):
        missing = []  # the table is of the base alone
    apart: dict[str, list[str]] = {"held": [], "base": [], "other": [], "named": []}
    wheels: list[str] = []
    for column in rest:
        if column.kind == "other":
            _compare_other(table, robot, column, missing, placed, apart)
        elif unlike := _unlike(table, robot, column, placed, angles):
            if column.name in robot.round_wheels:
                wheels.append(column.name)
            else:
                apart[column.kind].append(unlike)
    _check_floor(table, columns)
    if wheels:
        placed.notes.append(f"wheels turn, and are round: {', '.join(wheels)}")
    placed.doubts += [_UNLIKE[kind].format("; ".join(said)) for kind, said in apart.items() if said]


def _check_floor(table: PathTable, columns: list[Column]) -> None:
    """Refuse a base that is tilted, or not on the floor."""
    for column in columns:
        values = table.rows[:, column.index]
        if column.kind == "floor" and np.abs(values).max() > LIMIT_TOLERANCE:
            row = int(np.abs(values).argmax())
            table.fail(row, f"{column.name} = {values[row]:.6g}; a base stands upright on the floor, where that is 0")


def _compare_other(
    table: PathTable,
    robot: RobotModel,
    column: Column,
    missing: list[str],
    placed: PlacedPath,
    apart: dict[str, list[str]],
) -> None:
    """A column that is none of the robot's: whether it moves, or may be a joint that is called otherwise, by its name
    or because the table has columns of some planned joints and not of all."""
    values = table.rows[:, column.index]
    changes = bool(np.ptp(values) > LIMIT_TOLERANCE)
    if not column.of:
        if changes:
            alike = {name.lower(): name for name in missing}
            near = difflib.get_close_matches(column.name.lower(), alike, n=1, cutoff=_ALIKE)
            meant = f"; did you mean {alike[near[0]]!r}?" if near else ""
            apart["other"].append(f"{column.name} ({_span(values)}{meant})")
            return
        if namesake(column.name, {*robot.joint_names, *robot.locked, *robot.followers}):
            return  # the joint that it is called after has a column of its own
        elsewhere = [
            f"{name} is {_span(at)}"
            for name in missing
            if np.abs(values - (at := _whereabouts(robot, name, placed.coordinates))).max() > LIMIT_TOLERANCE
        ]
        if elsewhere:
            more = f" and {len(elsewhere) - _NAMED} more" if len(elsewhere) > _NAMED else ""
            apart["named"].append(f"{column.name} ({_span(values)}), where {', '.join(elsewhere[:_NAMED])}{more} here")
        return
    at = _whereabouts(robot, column.of, placed.coordinates)
    scaled = values * UNITS.get((column.unit or "").lower(), ("", 1.0))[1]
    if changes or np.abs(scaled - at).max() > LIMIT_TOLERANCE:
        apart["named"].append(f"{column.name} ({_span(values)}), where {column.of} is {_span(at)} here")


def _unlike(table: PathTable, robot: RobotModel, column: Column, placed: PlacedPath, angles: Angles | None) -> str:
    """Where a joint that is held, or a fixed base, is in the file, where that is not as here; empty where it is."""
    values, at = table.rows[:, column.index], _whereabouts(robot, column.name, placed.coordinates)
    known = column.unit is not None or angles != "deg"  # the kind of a joint that is held is not known here
    if column.unit is not None:
        of, factor = UNITS.get(column.unit.lower(), ("time", 0.0))
        if of == "time" or (column.kind == "base" and column.number < 3 and (of == "angle") != (column.number == 2)):
            table.source.fail(f"column {column.name!r}: {column.unit!r} is not a known unit for it")
        values = values * factor
    if np.abs(values - at).max() <= LIMIT_TOLERANCE and (known or np.abs(at).max() <= LIMIT_TOLERANCE):
        return ""
    unit = "" if known else " (degrees? name the unit)"
    return f"{column.name} at {_span(at)}, in the file {_span(values)}{unit}"


_NAMED = 3  # joints, in a message
_ALIKE = 0.6  # of two names, from which on one is asked whether the other was meant
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
