"""Path objects: what planners hand over in Python, as one table of numbers; known by its attributes, nothing imported.

==============  ======================================================================================================
arrays          (N, C) numbers of any library, with the names of their columns
ROS, MoveIt     JointTrajectory, RobotTrajectory and what holds them; MoveItPy's own; the tuple of a MoveGroupCommander
OMPL            SimpleSetup, or PathGeometric with its space
VAMP            PlanningResult, Path
cuRobo          JointState, and what has ``get_interpolated_plan``
RoboPlan        JointPath, JointTrajectory
Drake           trajectories with ``value``
==============  ======================================================================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.validation import shown

from .nodes import MAX_DEPTH, MAX_NODES, Node, Source
from .path_message import message_table
from .path_table import BASE_NAMES, RATES, PathTable

_MESSAGES = ("joint_trajectory", "multi_dof_joint_trajectory", "trajectory", "planned_trajectory", "robot_trajectory")
_CURVED = ("Dubins", "ReedsShepp", "Owen", "Vana", "Trochoid")
"""Names of OMPL's spaces between whose states the way is no straight line."""
_UNIT = 1e-3  # by which (cos, sin) may be off the circle
_CURVE_BOW = 1e-4  # [rad or m] by which a curve may leave the straight pieces that it is taken as
_MOST_PIECES = 20_000
_SHORTEST_PIECE = 1e-7  # of the whole curve: what is still bent there jumps
_STRAIGHT = 1e-9  # [rad or m] what a curve leaves its pieces by where they are the curve


def object_table(
    given: object,
    robot: RobotModel,
    space: object | None,
    ignore: tuple[str, ...],
) -> tuple[PathTable, tuple[str, ...]]:
    """The table of a planner's result; and what of ``ignore`` is no key of a message.

    Args:
        given: the result.
        robot: the robot of the path.
        space: OMPL's space of a PathGeometric, or the information that knows it.
        ignore: as for ``load_path``.

    Raises:
        ConfigurationError: it is none that is known, or one that says that no path was found.
    """
    source = Source(Path(f"<{type(given).__name__}>"), ConfigurationError)
    if given is None:
        source.fail("there is no path: the planner has found none")
    result = _unwrapped(given, source)
    if (messages := _messages(result)) is not None:
        nodes = [Node(_Plain(source).of(message), f"[{k}]" if k else "", source) for k, message in enumerate(messages)]
        return message_table(nodes, source, ignore)
    names, doubts, notes, times = None, (), (), None
    if _has(result, "getStates") or _has(result, "getSolutionPath"):
        names, rows, doubts = _ompl(result, space, source)
    elif _has(result, "get_interpolated_plan"):
        names, rows, times = _curobo(result, source)
    elif _has(result, "value", "start_time", "end_time"):
        rows, times, notes = _curve(result, source)
    elif _has(result, "positions", "joint_names"):
        names, rows = list(result.joint_names), _array(result.positions, source)
        times = _column(getattr(result, "times", None), source)
        rates = getattr(result, "velocities", None)
        notes = (RATES,) if rates is not None and len(rates) else ()
        rows, names = _roboplan_columns(rows, names, robot, source)
    elif _has(result, "position", "joint_names"):
        names, rows = result.joint_names, _array(result.position, source)
    else:
        rows = _array(result, source)
    table = PathTable(
        source,
        None if names is None else tuple(map(str, names)),
        rows,
        lambda k: (f"configuration {k}", None),
        times,
        notes=notes,
        doubts=doubts,
    )
    return table, ignore


def with_names(table: PathTable, names: Sequence[str] | None) -> PathTable:
    """The table with names of its columns that are given beside it.

    Raises:
        ConfigurationError: it has other names already, or the names are no sequence of texts.
    """
    if names is None:
        return table
    named = isinstance(names, Iterable) and not isinstance(names, (str, bytes, Mapping))
    if not named or not all(isinstance(name, str) for name in names):
        table.source.fail(f"joint_names={shown(names)} must be the columns' names, one for each")
    if table.names not in (None, tuple(names)):
        table.source.fail(
            f"names its columns itself: {', '.join(table.names or ())[:300]}; joint_names= is for one without"
        )
    return replace(table, names=tuple(names))


def with_times(table: PathTable, times: object | None) -> PathTable:
    """The table with times that are given beside it.

    Raises:
        ConfigurationError: it has times already, or these are no numbers.
    """
    if times is None:
        return table
    if table.times is not None:
        table.source.fail("has times of its own; times= is for a path without")
    return replace(table, times=_column(times, table.source))


def _has(value: Any, *names: str) -> bool:
    return not isinstance(value, Mapping) and all(hasattr(value, name) for name in names)


def _unwrapped(given: Any, source: Source) -> Any:
    """The path in a result that says whether one was found.

    Raises:
        ConfigurationError: none was.
    """
    if isinstance(given, tuple) and given and isinstance(given[0], (bool, np.bool_)):  # of MoveIt's commander
        found, given = bool(given[0]), [given[1]] if len(given) > 1 else None
    elif _has(given, "solved", "path"):
        found, given = bool(given.solved), given.path
    elif _has(given, "success", "get_interpolated_plan"):
        found = bool(np.asarray(_plain_array(given.success)).all())
    elif _has(given, "haveExactSolutionPath", "haveSolutionPath"):
        found = bool(given.haveExactSolutionPath())
        if not found and given.haveSolutionPath():
            source.fail(
                "its path is approximate and does not reach the goal; hand over getSolutionPath() to look at it"
            )
    else:
        code = getattr(getattr(given, "error_code", None), "val", 1)
        found = given is not None and (code == 1 or not isinstance(code, int))
    if not found:
        source.fail("there is no path: the planner says that it has found none")
    inner = getattr(given, "trajectory", None)
    for one in (given, inner):
        if callable(as_message := getattr(one, "get_robot_trajectory_msg", None)):
            return as_message()
    return given


def _messages(result: Any) -> list[object] | None:
    """The ROS messages in a result, or what looks like some; None where there are none."""

    def one(value: object) -> bool:
        if isinstance(value, Mapping):
            return True
        return _has(value, "points", "joint_names") or any(_has(value, name) for name in _MESSAGES)

    if isinstance(result, (list, tuple)) and result and all(one(entry) for entry in result):
        return list(result)
    return [result] if one(result) else None


class _Plain:
    """Messages as plain data, of a bounded size."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.left = MAX_NODES

    def of(self, value: Any, depth: int = 0) -> object:
        """A message's fields, lists and numbers."""
        self.left -= 1
        if depth > MAX_DEPTH or self.left < 0:
            self.source.fail(f"is nested more than {MAX_DEPTH} deep, or has more than {MAX_NODES} values")
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, Mapping):
            return {str(key): self.of(entry, depth + 1) for key, entry in value.items()}
        names = _fields(value)
        if names is not None:
            return {name: self.of(getattr(value, name), depth + 1) for name in names}
        if isinstance(value, (bytes, bytearray)):
            return None  # pictures and the like are of no path
        try:
            return [self.of(entry, depth + 1) for entry in value]
        except TypeError:
            self.source.fail(f"has a {type(value).__name__}, which is no part of a message: {shown(value)}")


def _fields(message: Any) -> list[str] | None:
    """Names of a message's fields; None where it is none: rclpy, rosbags, genpy and plain objects have them so."""
    ask = getattr(message, "get_fields_and_field_types", None)
    if callable(ask):
        return list(cast("Mapping[str, str]", ask()))
    if is_dataclass(message):
        return [one.name for one in fields(message) if not one.name.startswith("_")]
    slots = getattr(type(message), "__slots__", None)
    if isinstance(slots, (list, tuple)) and slots and hasattr(message, "_slot_types"):
        return list(slots)
    inner = getattr(message, "__dict__", None)
    return None if inner is None else [name for name in inner if not name.startswith("_")]


def _plain_array(value: Any) -> Any:
    """Numbers of a tensor, wherever it lives, for NumPy."""
    for step in ("detach", "cpu", "numpy"):
        if callable(getattr(value, step, None)):
            value = getattr(value, step)()
    return value


def _array(value: Any, source: Source) -> Array:
    """Rows (N, C) of numbers.

    Raises:
        ConfigurationError: it is nothing that has rows.
    """
    value = _plain_array(value)
    try:
        if not isinstance(value, np.ndarray):
            value = [np.asarray(_plain_array(value[k])).reshape(-1) for k in range(len(value))]
        rows = np.asarray(value)
        if rows.dtype.kind not in "fiu":
            raise ValueError(f"numbers of kind {rows.dtype}")
        rows = rows.astype(float)
    except Exception as problem:  # of a type that nobody here knows
        source.fail(
            f"{shown(value)} is not a known kind of path ({problem}). Known are rows of numbers with joint_names=, a "
            "JointTrajectory or RobotTrajectory, OMPL's SimpleSetup or PathGeometric, VAMP's PlanningResult, cuRobo's "
            "JointState, RoboPlan's JointPath and JointTrajectory, and Drake's trajectories"
        )
    if rows.ndim == 3 and len(rows) == 1:  # a batch of one
        rows = rows[0]
    if rows.ndim != 2:
        more = f": {len(rows)} paths of a batch; pass one of them" if rows.ndim == 3 else ""
        source.fail(f"has an array of shape {rows.shape}{more}; rows (N, joints) are needed")
    return rows


def _column(value: Any, source: Source) -> Array | None:
    """Times (N,) [s]; None where there are none."""
    if value is None:
        return None
    try:
        return np.asarray(_plain_array(value), dtype=float).reshape(-1)
    except (TypeError, ValueError) as problem:
        source.fail(f"has times that are not numbers: {problem}")


# --- OMPL ------------------------------------------------------------------------------------------------------------


def _ompl(result: Any, space: Any, source: Source) -> tuple[list[str] | None, Array, tuple[str, ...]]:
    """Names of the columns where the space has some, rows, and doubts.

    A state does not know how long it is, and gives what lies behind it in memory where it is asked for more: so its
    space has to be known.
    """
    path = result
    if _has(result, "getSolutionPath"):
        path, space = result.getSolutionPath(), result if space is None else space
    for name in ("getSpaceInformation", "getStateSpace"):
        holder = space if space is not None else path
        if _has(holder, name):
            space = getattr(holder, name)()
    if not _has(space, "getDimension", "isCompound"):
        source.fail(
            "states do not say how many numbers they have: hand over the SimpleSetup, or the space with it "
            "(space=setup.getStateSpace())"
        )
    names: list[str] = []
    rows: list[list[float]] = []
    for state in path.getStates():
        row: list[float] = []
        names = []
        _read_state(state, space, names, row, source)
        rows.append(row)
    if not rows:
        source.fail("has no states")
    kind = type(space).__name__
    doubts = (
        (f"{kind}: its ways between states are no straight lines; interpolate(), and hand over rows of the states",)
        if kind.startswith(_CURVED)
        else ()
    )
    return (names if all(names) and names else None), np.array(rows, dtype=float), doubts


def _read_state(state: Any, space: Any, names: list[str], row: list[float], source: Source) -> None:
    """Append the numbers of a state, and their names, which are empty where the space has none."""
    if _has(state, "getX", "getYaw"):
        names += BASE_NAMES
        row += [state.getX(), state.getY(), state.getYaw()]
    elif _has(space, "getDimensionName"):
        count = int(space.getDimension())
        values = state[0:count]
        names += [space.getDimensionName(k) or "" for k in range(count)]
        row += [float(value) for value in values]
    elif _has(state, "value") and int(space.getDimension()) == 1:
        names.append("")
        row.append(float(state.value))
    elif _has(space, "getSubspaceCount", "getSubspace") and not _has(state, "getX"):
        for k in range(int(space.getSubspaceCount())):
            _read_state(state[k], space.getSubspace(k), names, row, source)
    else:
        source.fail(
            f"has states of {type(space).__name__}, which are not known; RealVector, SO2, SE2 and what is made "
            "of these are read. Give rows of numbers"
        )


# --- cuRobo, RoboPlan, Drake -----------------------------------------------------------------------------------------


def _curobo(result: Any, source: Source) -> tuple[list[str] | None, Array, Array | None]:
    """Names, rows and times of a plan at even steps of time."""
    plan = result.get_interpolated_plan()
    rows, step = _array(plan.position, source), getattr(result, "interpolation_dt", None)
    return plan.joint_names, rows, None if step is None else float(step) * np.arange(len(rows), dtype=np.float64)


def _roboplan_columns(rows: Array, names: list[str], robot: RobotModel, source: Source) -> tuple[Array, list[str]]:
    """Rows with a column for each name.

    RoboPlan names joints that mimic others and gives no number for them, and gives (cos, sin) of joints without limits.
    """
    space = robot.space
    turning = {name for name, turns in zip(robot.joint_names, space.turning[space.base_nv :], strict=True) if turns}
    turning |= robot.round_wheels
    own = [n for n in names if n not in robot.followers and not robot.held.get(n, "").startswith("mimics ")]
    widths = [2 if name in turning else 1 for name in own]
    if rows.shape[1] == sum(widths):
        starts = np.concatenate(([0], np.cumsum(widths)[:-1])).astype(int)
        pairs = [k for k, width in zip(starts, widths, strict=True) if width == 2]
        if all((np.abs(np.hypot(rows[:, k], rows[:, k + 1]) - 1.0) <= _UNIT).all() for k in pairs):
            columns = [
                np.unwrap(np.arctan2(rows[:, k + 1], rows[:, k])) if width == 2 else rows[:, k]
                for k, width in zip(starts, widths, strict=True)
            ]
            return np.column_stack(columns), own
    for kept in (own, names):
        if rows.shape[1] == len(kept):
            return rows, kept
    follow = sorted(set(names) - set(own))
    source.fail(
        f"has {rows.shape[1]} numbers for {len(names)} joints ({', '.join(names)[:300]}). Of {robot.name!r} "
        f"{', '.join(sorted(turning & set(names))) or 'none'} have (cos, sin), and {', '.join(follow) or 'none'} "
        f"follow others and have none, which makes {sum(widths)}. Give rows, and joint_names="
    )


def _curve(curve: Any, source: Source) -> tuple[Array, Array, tuple[str, ...]]:
    """Straight pieces of a curve over time, halved until its middles and quarters are near them; times [s]; notes."""
    start, end = float(curve.start_time()), float(curve.end_time())
    if not (np.isfinite(start) and np.isfinite(end) and end > start):
        source.fail(f"goes from {start:g} s to {end:g} s")

    def at(t: Array) -> Array:
        return np.array([np.asarray(curve.value(float(one)), dtype=float).reshape(-1) for one in t])

    breaks = getattr(curve, "get_segment_times", None)
    knots = np.asarray(breaks(), dtype=float) if callable(breaks) else np.linspace(start, end, 33)
    times, rows, worst = knots, at(knots), 0.0
    while True:
        inner = [times[:-1] + part * np.diff(times) for part in (0.25, 0.5, 0.75)]
        values = [at(t) for t in inner]
        bows = [
            np.abs(value - (rows[:-1] + part * np.diff(rows, axis=0))).max(axis=1, initial=0.0)
            for value, part in zip(values, (0.25, 0.5, 0.75), strict=True)
        ]
        bow = np.max(bows, axis=0)
        worst = float(bow.max(initial=0.0))
        if worst <= _CURVE_BOW:
            break
        wide = np.flatnonzero(bow > _CURVE_BOW)
        shortest = float(np.diff(times)[wide].min())
        if len(times) + len(wide) > _MOST_PIECES or shortest < _SHORTEST_PIECE * (end - start):
            source.fail(
                f"jumps, or takes more than {_MOST_PIECES} straight pieces within {_CURVE_BOW:g} of it: give rows"
            )
        times, rows = np.insert(times, wide + 1, inner[1][wide]), np.insert(rows, wide + 1, values[1][wide], axis=0)
    notes = () if worst <= _STRAIGHT else (f"a curve, taken as {len(times) - 1} straight pieces", RATES)
    return rows, times, notes
