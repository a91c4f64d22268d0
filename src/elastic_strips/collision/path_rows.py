"""The rows of a path from anywhere, and which way it goes between two of them.

A turning column (the yaw of a base, a joint without limits) has a value, and where a path is given as configurations
only (cos, sin) of it. From 3 to −3 is 6 rad by the values and 0.28 rad the shorter way; programs that execute paths go
the one way or the other. A certificate says which one it is about.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Mask
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import HALF_TURN, LIMIT_TOLERANCE, wrap_angle

INTERPOLATIONS = ("arc", "line", "values", "shortest")
_FARTHEST_BASE = 1e6  # [m] from the origin
_MOST_TURN = 1e4  # [rad] of a turning column's values
_ARC_BOW = 1e-4  # [m] by which arcs may leave the line that they stand for
_YAW_PIECE, _JOINT_PIECE = 1.5, 3.0  # [rad] longest turn of a piece, below half a turn
_MOST_PIECES = 1_000_000


class HasConfigurations(Protocol):
    """A path that knows its configurations, such as a strip: between two of them it goes along the tangent."""

    @property
    def q(self) -> Array:
        """(N, nq) configurations."""
        ...


class HasRows(Protocol):
    """A path that knows its values, such as a :class:`elastic_strips.io.PathFile`."""

    @property
    def q(self) -> Array:
        """(N, nq) configurations."""
        ...

    @property
    def rows(self) -> Array | None:
        """(N, nv) values of the coordinates, or None where the path has configurations only."""
        ...


PathLike = npt.ArrayLike | HasConfigurations | HasRows


@dataclass(frozen=True, slots=True, eq=False)
class PathRows:
    """A path's rows.

    Attributes:
        rows: (N, nv) as they were given; turning columns that were given as (cos, sin) continue the shorter way.
        stated: whether the values of turning columns were given.
        tangent: whether the path itself goes along the tangent, as strips do.
    """

    rows: Array
    stated: bool
    tangent: bool

    def within_limits(self, robot: RobotModel) -> Array:
        """The rows; joints that are outside their limits by a rounding are taken to the limit.

        Raises:
            ConfigurationError: a joint is outside by more.
        """
        q = robot.check_q(robot.space.from_coordinates(self.rows), what="path")
        return np.where(robot.space.turning, self.rows, robot.space.to_coordinates(q))


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
    """A path as arcs.

    Attributes:
        rows: (M, nv) rows; between two of them base and joints go along the tangent, the shorter way.
        whole: (M,) segment of the path plus place on it, as one number.
        known: (M − 1,) False where it is not known which way the path goes.
        unknown: what is not known, for each such segment of the path.
        bow: how far [m] the arcs may leave the path; 0 where they are the path.
        way: which way turning columns were taken, in words; empty where nothing turns.
    """

    rows: Array
    whole: Array
    known: Mask
    unknown: dict[int, str]
    bow: float
    way: str


def path_rows(robot: RobotModel, path: PathLike) -> PathRows:
    """The rows of a path: configurations (N, nq), coordinate rows (N, nv), or what has ``rows`` or ``q``.

    Raises:
        ConfigurationError: a path of another robot or shape, with less than two configurations, not finite, or too far
            away.
    """
    _check_owner(robot, path)
    space, turning = robot.space, robot.space.turning
    values, own = getattr(path, "rows", None), getattr(path, "q", None)
    tangent = own is not None and not hasattr(path, "rows")
    given = path if own is None and values is None else own if values is None else values
    try:
        array = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise ConfigurationError(
            f"path is a {type(path).__name__}, which is no array of numbers; elastic_strips.load_path makes one of "
            "what planners hand over"
        ) from None
    stated = space.nq == space.nv or (array.ndim == 2 and array.shape[1] == space.nv)
    if array.ndim != 2 or len(array) < 2:
        raise ConfigurationError(
            f"path has shape {array.shape}; at least two configurations (N, {robot.nq}) are needed"
        )
    if stated and array.shape[1] == space.nv:
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            raise ConfigurationError(f"path{bad[0].tolist()} = {array[tuple(bad[0])]} is not finite")
        rows = array
    else:
        if array.shape[1] != robot.nq:
            also = f"; or (N, {robot.nq}), as Pinocchio has them, with cosine and sine of what turns"
            raise ConfigurationError(
                f"path has shape {array.shape}; {robot.name!r} wants (N, {robot.nv}): "
                f"{', '.join(column_names(robot))}{also if robot.nq != robot.nv else ''}"
            )
        robot.check_q(array, what="path", limits=False)
        rows = space.to_coordinates(array)
        rows[:, turning] = np.unwrap(rows[:, turning], axis=0)
        stated = not turning.any()
    most = np.where(turning, _MOST_TURN, np.inf)
    most[: 2 if space.planar else 0] = _FARTHEST_BASE
    far = np.argwhere(np.abs(rows) > most)
    if len(far):
        i, k = (int(n) for n in far[0])
        raise ConfigurationError(f"path[{i}]: {column_names(robot)[k]} = {rows[i, k]:g} is beyond ±{most[k]:g}")
    return PathRows(rows, stated, tangent)


def _check_owner(robot: RobotModel, path: PathLike) -> None:
    """Refuse a path that knows its robot, unless this robot has the same columns and held joints as when it was read.

    Raises:
        ConfigurationError: the path is another robot's.
    """
    owner = getattr(path, "robot", None)
    if owner is robot or not isinstance(owner, RobotModel):
        return
    own, others = column_names(robot), column_names(owner)
    if own != others:
        raise ConfigurationError(
            f"the path is of {owner.name!r}, whose columns are {', '.join(others)}; those of {robot.name!r} are "
            f"{', '.join(own)}"
        )
    if not hasattr(path, "rows"):  # a strip holds configurations and nothing else; a file was read for its robot
        return
    for name in sorted({*robot.locked, *owner.locked}):
        here, there = (of.locked.get(name, np.nan) for of in (robot, owner))
        if not abs(here - there) <= LIMIT_TOLERANCE:
            raise ConfigurationError(
                f"the path's file was read for a robot that holds {name} at {there:.6g}; {robot.name!r} has it at "
                f"{here:.6g} (nan: not held still): read it again for this one"
            )


def column_names(robot: RobotModel) -> tuple[str, ...]:
    """(nv) names of the columns of a robot's rows."""
    return (*(("x", "y", "yaw") if robot.space.planar else ()), *robot.joint_names)


def as_arcs(robot: RobotModel, path: PathRows, interpolation: str, *, bow: float = _ARC_BOW) -> Arcs:
    """A path as arcs, along which distances are measured; see :func:`certify` for the interpolations.

    Arcs leave the line that they stand for by at most ``bow`` [m].

    Raises:
        ConfigurationError: joints outside their limits, or a path that is too long.
    """
    rows, turning = path.within_limits(robot), robot.space.turning
    v = stated = np.diff(rows, axis=0)
    short = np.where(turning, wrap_angle(v), v)
    unknown = _unknown(robot, path, v, interpolation)
    if interpolation != "values":
        v = short
    known = np.ones(len(v), dtype=bool)
    known[list(unknown)] = False
    v[~known] = 0.0
    line = robot.space.planar and interpolation != "arc"
    pieces = np.ceil(np.abs(np.where(turning, v, 0.0)).max(axis=1, initial=0.0) / _JOINT_PIECE)
    pieces[np.abs(np.where(turning, v, 0.0)).max(axis=1, initial=0.0) < HALF_TURN] = 1.0
    if line:
        # an arc of constant speed leaves its chord by no more than an eighth of its acceleration, speed times turn; the
        # speed is at most pi/2 times the chord for turns below half a circle
        length, turn = np.hypot(v[:, 0], v[:, 1]), np.abs(v[:, 2])
        bowed = np.sqrt(np.pi / 16.0 * length * turn / bow)
        pieces = np.ceil(np.maximum.reduce((pieces, bowed, turn / _YAW_PIECE)))
    count = np.maximum(pieces, 1.0)
    if count.sum() > _MOST_PIECES:
        raise ConfigurationError(
            f"the path turns so far on its way that {count.sum():.0f} pieces would be looked at; at most "
            f"{_MOST_PIECES} are. Certify it in parts."
        )
    whole = np.arange(len(rows), dtype=float)
    if (count > 1.0).any():
        source = np.repeat(np.arange(len(v)), count.astype(int))
        part = (np.arange(len(source)) - np.searchsorted(source, source)) / count[source]
        rows = np.vstack((rows[source] + part[:, None] * v[source], rows[-1:]))
        whole, known = np.concatenate((source + part, whole[-1:])), known[source]
    return Arcs(rows, whole, known, unknown, bow if line else 0.0, _way(robot, path, stated, interpolation))


def _unknown(robot: RobotModel, path: PathRows, v: Array, interpolation: str) -> dict[int, str]:
    """Segments of which it is not known which way they go."""
    turning, names = robot.space.turning, column_names(robot)
    if interpolation == "values":
        if path.stated:
            return {}
        lost = ", ".join(names[k] for k in np.flatnonzero(turning).tolist())
        why = f"configurations have (cos, sin) of {lost}, and no values: give rows (N, {robot.nv})"
        return dict.fromkeys(range(len(v)), why)
    half = turning & (np.abs(wrap_angle(v)) >= HALF_TURN)
    beyond = turning & (np.abs(v) > np.pi) & (path.stated and interpolation != "shortest")
    found = {}
    for j, k in np.argwhere(half | beyond).tolist():
        if beyond[j, k] and not half[j, k]:
            why = f"{names[k]} changes by {v[j, k]:.4g} rad, more than half a turn: interpolation 'values' goes so, "
            why += f"'shortest' by {wrap_angle(v[j, k]):.4g} rad"
        else:
            why = f"{names[k]} turns by half a turn, and which way is not known: add a configuration between"
            why += ", or take interpolation 'values'" if path.stated else ""
        found.setdefault(j, why)
    return found


def _way(robot: RobotModel, path: PathRows, v: Array, interpolation: str) -> str:
    """Which way angles turn; empty where a path's numbers leave one way only, by less than half a turn."""
    least = np.pi if path.stated else 1e-9
    turns = robot.space.turning & (np.abs(v).max(axis=0, initial=0.0) > least)
    if path.tangent or not turns.any():
        return ""
    names = [name for name, turns_here in zip(column_names(robot), turns, strict=True) if turns_here]
    said = ", ".join(names[:4]) + (", …" if len(names) > 4 else "")
    by_values = path.stated and interpolation != "shortest"
    return f"{said} by the difference of its values" if by_values else f"{said} the shorter way"
