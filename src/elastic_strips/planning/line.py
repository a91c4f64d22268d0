"""Straight initial strips: the geodesic of the manifold, or turn – drive – turn for a differential drive."""

from __future__ import annotations

import numpy as np

from ..robot import BaseKind, RobotModel
from ..robot.space import Array, wrap_angle

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
