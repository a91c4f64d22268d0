"""Lines: straight strips, and strips along waypoints of the base."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array

from ..errors import ParameterError
from ..robot import BaseKind, RobotModel
from ..robot.space import wrap_angle
from .grid_path import resample

_TURN = 0.35  # largest turn in place between two nodes [rad]


def straight_line(robot: RobotModel, start: Array, goal: Array, *, spacing: float, most: int | None = None) -> Array:
    """Chart rows (N, nv) of the straight way from ``start`` to ``goal`` (configurations (nq,)).

    A differential drive turns in place towards the goal, drives straight (backwards where that turns less),
    and turns in place at the goal; the joints move evenly along the drive. Every segment can be driven exactly.

    Args:
        robot: the robot.
        start, goal: configurations (nq,).
        spacing: largest distance between the base poses of neighbouring nodes [m].
        most: rows at most, at least 4; with fewer than it takes, they are further apart.
    """
    space = robot.space
    a, b = space.to_chart(start), space.to_chart(goal)
    offset = space.difference(a[None], b[None])[0]
    if robot.base_kind is BaseKind.DIFF_DRIVE and np.hypot(*(b[:2] - a[:2])) > 1e-9:
        rows = _turn_drive_turn(robot, a, b, offset, spacing, most)
    else:
        reach = np.abs(offset) * np.where(np.arange(space.nv) < space.base_nv, 1.0, 0.4)
        if space.planar:
            reach[0] = np.hypot(*(b[:2] - a[:2]))
        count = max(int(np.ceil(reach.max(initial=0.0) / spacing)), 4) + 1
        count = count if most is None else min(count, most)
        if space.planar:  # a straight base path, not the screw arc, for an omnidirectional base
            s = np.linspace(0.0, 1.0, count)[:, None]
            rows = a + s * _direct(robot, a, b)
        else:
            rows = space.interpolate(a[None], b[None], np.linspace(0.0, 1.0, count))
    rows[0], rows[-1] = a, b
    return rows


def _direct(robot: RobotModel, a: Array, b: Array) -> Array:
    delta = robot.space.difference(a[None], b[None])[0]
    delta[:2] = b[:2] - a[:2]
    return delta


def _turn_drive_turn(robot: RobotModel, a: Array, b: Array, offset: Array, spacing: float, most: int | None) -> Array:
    way = b[:2] - a[:2]
    length = float(np.hypot(*way))
    heading = float(np.arctan2(way[1], way[0]))
    forward = abs(float(wrap_angle(np.array(heading - a[2])))) + abs(float(wrap_angle(np.array(b[2] - heading))))
    back = float(wrap_angle(np.array(heading + np.pi)))
    backward = abs(float(wrap_angle(np.array(back - a[2])))) + abs(float(wrap_angle(np.array(b[2] - back))))
    drive_yaw = heading if forward <= backward + 0.5 else back
    turn_in = float(wrap_angle(np.array(drive_yaw - a[2])))
    turn_out = float(wrap_angle(np.array(b[2] - drive_yaw)))
    n_in = int(np.ceil(abs(turn_in) / _TURN - 1e-9))
    n_out = int(np.ceil(abs(turn_out) / _TURN - 1e-9))
    joints = np.abs(offset[3:]).max(initial=0.0)
    n_drive = max(int(np.ceil(max(length / spacing, 0.4 * joints / spacing))), 4)
    if most is not None:  # the drive needs one row, and so does a turn
        n_drive = max(min(n_drive, most - 1 - n_in - n_out), 1)
        n_in, n_out = (min(n, max((most - 1 - n_drive) // 2, 1)) for n in (n_in, n_out))
    rows = [a]
    rows += [_pose(a, a[0], a[1], a[2] + turn_in * k / n_in) for k in range(1, n_in + 1)]
    for k in range(1, n_drive + 1):
        s = k / n_drive
        row = a + s * offset
        row[:2] = a[:2] + s * way
        row[2] = a[2] + turn_in
        rows.append(row)
    rows += [_pose(b, b[0], b[1], a[2] + turn_in + turn_out * k / n_out) for k in range(1, n_out + 1)]
    return np.array(rows)


def _pose(row: Array, x: float, y: float, yaw: float) -> Array:
    out = row.copy()
    out[:3] = x, y, yaw
    return out


_BEND = 1.0  # [rad] a heading that differs by less from the way's is bent into it, without a turn in place
_LEAD = 0.8  # [m] over which it is bent
_FOLD = 0.3  # largest motion of a joint between two rows while the base stands [rad or m]


def waypoint_rows(robot: RobotModel, start: Array, goal: Array, way: npt.ArrayLike, *, spacing: float) -> Array:
    """Chart rows (N, nv) along waypoints of the base, from start to goal.

    A differential drive follows them forwards. Near an end the way is bent into its heading, or, where that is quite
    another one, the drive turns in place there. The joints move evenly along the way, and so does the heading of an
    omnidirectional base.

    Args:
        robot: the robot; its base must move.
        start, goal: configurations (nq,).
        way: waypoints (K, 2) [m], from the start's to the goal's position; or chart rows (K, nv), which stay as they
            are but for their ends.
        spacing: distance between rows [m].

    Raises:
        ParameterError: neither (K, 2) nor (K, nv), not finite, fewer than two, or a fixed base.
    """
    space = robot.space
    try:
        points = np.asarray(way, dtype=float)
    except (TypeError, ValueError):
        raise ParameterError(f"path={way!r:.80} must be an array of numbers, (K, 2) or (K, {space.nv})") from None
    if points.ndim != 2 or points.shape[1] not in (2, space.nv) or len(points) < 2:
        raise ParameterError(f"path has shape {points.shape}; it must be (K, 2) or (K, {space.nv}) with K ≥ 2")
    if not np.isfinite(points).all():
        raise ParameterError("path has entries that are not finite")
    if not space.planar:
        raise ParameterError(f"path: the base of {robot.name!r} is fixed, so that it follows no waypoints")
    ends = space.to_chart(np.stack((start, goal)))
    if points.shape[1] == space.nv:
        rows = points.copy()
        rows[0], rows[-1] = ends
        return rows
    points = np.vstack((ends[0, :2], points[1:-1], ends[1, :2]))
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        points = _bent(points, float(ends[0, 2]))
        points = _bent(points[::-1], float(ends[1, 2]) + np.pi)[::-1]
    points = resample(points, spacing)
    share = np.linspace(0.0, 1.0, len(points))
    rows = ends[0] + share[:, None] * space.difference(ends[:1], ends[1:])
    rows[:, :2] = points
    if robot.base_kind is not BaseKind.DIFF_DRIVE:
        rows[0], rows[-1] = ends
        return rows
    steps = np.diff(points, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    rows[:, 2] = np.unwrap(np.concatenate([heading[:1], _middles(heading), heading[-1:]]))
    first = _turn(rows[0], float(ends[0, 2]))[::-1]
    last = _turn(rows[-1], float(ends[1, 2]))
    rows = np.vstack((first[:-1], rows, last[1:]))
    rows[0], rows[-1] = ends
    rows[:, 2] = np.unwrap(rows[:, 2])
    return rows


def tucked_rows(robot: RobotModel, start: Array, goal: Array, way: npt.ArrayLike, *, spacing: float) -> Array:
    """Chart rows (N, nv) along waypoints of the base, on which the robot drives in its home posture.

    It folds into that posture at the start and unfolds from it at the goal, while the base stands.

    Args:
        robot, start, goal, way, spacing: as in :func:`waypoint_rows`; ``way`` (K, 2).

    Raises:
        ParameterError: as :func:`waypoint_rows`.
    """
    space = robot.space
    ends = space.to_chart(np.stack((start, goal)))
    folded = ends.copy()
    folded[:, space.base_nv :] = space.to_chart(robot.home_q)[space.base_nv :]
    first, last = space.from_chart(folded)
    rows = waypoint_rows(robot, first, last, way, spacing=spacing)
    folded = rows[[0, -1]]
    moves = space.difference(ends, folded)
    moves[:, : space.base_nv] = 0.0
    stands = []
    for move, row in zip(moves, folded, strict=True):
        count = int(np.ceil(float(np.abs(move).max(initial=0.0)) / _FOLD - 1e-9))
        stands.append(row + (np.arange(count)[:, None] / max(count, 1) - 1.0) * move)  # from the end's posture on
    return np.vstack((stands[0], rows, stands[1][::-1]))


def _bent(points: Array, yaw: float) -> Array:
    """The way (K, 2), its beginning bent so that it starts with the heading ``yaw`` where they do not differ much."""
    fine = resample(points, 0.02)
    length = 0.02 * (len(fine) - 1)
    count = int(min(_LEAD, 0.4 * length) / 0.02)
    if count < 3:
        return points
    chord = fine[count] - fine[0]
    if abs(float(wrap_angle(np.array(yaw - np.arctan2(chord[1], chord[0]))))) >= _BEND:
        return points
    reach = float(np.hypot(*chord))
    after = fine[count + 1] - fine[count]
    tangents = reach * np.array([np.cos(yaw), np.sin(yaw)]), reach * after / np.hypot(*after)
    s = np.linspace(0.0, 1.0, count + 1)[:, None]
    bow = (
        (2 * s**3 - 3 * s**2 + 1) * fine[0]
        + (s**3 - 2 * s**2 + s) * tangents[0]
        + (3 * s**2 - 2 * s**3) * fine[count]
        + (s**3 - s**2) * tangents[1]
    )
    return np.vstack((bow, fine[count + 1 :]))


def _middles(heading: Array) -> Array:
    """Heading half-way between each two pieces of the way."""
    return heading[:-1] + 0.5 * wrap_angle(np.diff(heading))


def _turn(row: Array, yaw: float) -> Array:
    """Rows that turn in place from ``row`` to the heading ``yaw``; the row alone where that is a small bend."""
    turn = float(wrap_angle(np.array(yaw - row[2])))
    if abs(turn) < _BEND:
        return row[None]
    count = int(np.ceil(abs(turn) / _TURN)) + 1
    rows = np.repeat(row[None], count, axis=0)
    rows[:, 2] += np.linspace(0.0, turn, count)
    return rows
