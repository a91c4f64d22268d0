"""Joining: motions that turn a robot towards a strip that it is beside, or that leads another way than it moves.

A strip is timed from a velocity that points along it. Any other is turned first: the robot is steered to a point that
goes ahead of it on the strip, with speeds that change no faster than its motors can change them, and then brakes. Such
a motion exists from every state, and the next tick goes on from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, ceil, comb, copysign, cos, hypot, pi, sin, sqrt

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import ConfigurationSpace, RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.braking import brought_to_rest

from .progress import DETOUR_COST

_SPEED_SHARE, _ACCELERATION_SHARE = 0.95, 0.8
"""Parts of the motors' limits with which the robot is steered, and brakes."""
_LEAST_AHEAD, _AHEAD_TIME = 0.35, 0.8
"""It is steered to a point so far [m in the metric] ahead on the strip, or as far as it gets in this time [s]."""
_TURNING_GAIN = 2.5  # [1/s] rate of turn by the difference of heading, at that point or of a base that slides
_TURNING_SHARE = 0.7
"""Part of the fastest turn on the spot with which a differential drive is steered."""
_LEAST_CURVE_SPEED = 0.2
"""Part of its speed that a differential drive keeps where it turns most."""
_AT_POINT = 0.05  # [m] from that point, within which its heading alone counts
_STRAIGHT_ANGLE = 0.08  # [rad] by which a strip may lead to a side, and needs no curve
_LEAST_ROLLING = 0.25
"""A differential drive whose middle moves more slowly than this part of its rims turns on the spot."""
_STRAIGHT_COSINE = 0.9  # of the angle between the directions of two strips that go on without a curve
_CURVE_SPEED, _CURVE_ACCELERATION, _CURVE_STEP = 0.8, 0.6, 0.05
"""Parts of the limits with which a curve is made that turns a velocity, and time [s] between its rows."""
_BLEND_STEPS = 4
_CORNER_TIME = 1.0
"""Cost [s] of arriving at the strip at a right angle."""
_LENGTH_VALUE = 0.8
"""What a length of the strip that a curve leads past is worth, by the time that it takes at full speed."""
_JOINED_AHEAD = (0.5, 0.8, 1.2, 1.8, 2.5)  # [m] along the strip, where they may lead
_REACHES = (0.12, 0.2, 0.3, 0.4)
"""How far the tangents of a curve reach, as a part of the distance of its ends."""
_BRAKED_FIRST = (0.0, 0.35, 0.7, 0.95)
"""Parts of the way to rest for which a base goes straight on and brakes, before it turns."""
_LINE_SPACING = 0.06  # [m] between the rows of that line
_SHORTEST_CURVE = 0.1  # [m]
_SLOW = 0.1  # [m/s] so slow, a base has no bend
_SAMPLES = 33
_LEAST_SPEED = 0.3  # [m/s] of a base, by which its joints' pace is taken at least


def _bezier() -> tuple[Array, Array, Array]:
    """(SAMPLES, 6) of the basis of degree 5, and its first two derivatives."""
    t = np.linspace(0.0, 1.0, _SAMPLES)[:, None]

    def basis(n: int) -> Array:
        return np.hstack([comb(n, k) * t**k * (1.0 - t) ** (n - k) for k in range(n + 1)])

    def slope(rows: Array, n: int) -> Array:
        none = np.zeros((_SAMPLES, 1))
        return n * (np.hstack([none, rows]) - np.hstack([rows, none]))

    return basis(5), slope(basis(4), 5), slope(slope(basis(3), 4), 5)


_BEZIER = _bezier()


def steered(
    robot: RobotModel,
    limits: MotionLimits,
    start: ReferenceState,
    rows: Array,
    weight: Array,
    *,
    hold: float,
    dt: float,
    speed: float = 1.0,
) -> Trajectory | None:
    """A motion that is steered towards a strip for a while, and then brakes to rest; None where it would take a joint
    out of its range.

    Args:
        robot, limits: the robot, and the limits of its motors.
        start: first state.
        rows: (K, nv) nodes of the strip, K ≥ 2.
        weight: (nv,) metric of the strip.
        hold: time [s] for which it is steered.
        dt: time between the samples [s].
        speed: part of the speed limits.
    """
    space, scale = robot.space, np.sqrt(weight)
    way = _Way(space, rows, scale)
    top, change = speed * _SPEED_SHARE * limits.speed, dt * _ACCELERATION_SHARE * limits.acceleration
    state, rates = start.coordinates, [limits.to_coordinates(start.v)]
    passed = way.nearest(state)
    for _ in range(max(round(hold / dt), 1)):
        before = rates[-1]
        moved = scale * limits.to_tangent(before)
        pace = sqrt(float(moved @ moved))
        passed, off, onward = way.beside(state, passed)
        point = way.at(passed + max(_LEAST_AHEAD, _AHEAD_TIME * pace))
        left = space.difference(state, point)
        wanted = _wanted(limits, left, onward, top, pace, way.length - passed + off)
        rates.append(before + np.clip(wanted - before, -change, change))
        state = space.integrate(state, limits.to_tangent(0.5 * dt * (before + rates[-1])))
    return brought_to_rest(robot, limits, start, np.array(rates), change, dt)


def curves_onto(
    robot: RobotModel, limits: MotionLimits, here: Array, v: Array, rows: Array, weight: Array
) -> Iterator[tuple[Array, Array]]:
    """Rows that lead from a velocity onto a strip without a stop, as far as wheels can; the fastest way first.

    There are none where the strip leads on already, or no curve leads onto it.

    Args:
        robot, limits: the robot, and the limits of its motors.
        here: (nv,) coordinate row from which they lead.
        v: (nv,) velocity there.
        rows: (K, nv) nodes of the strip, K ≥ 2.
        weight: (nv,) metric of the strip.

    Yields:
        (R, nv) rows, ``here`` first, and (L, nv) the rest of the strip, from the last of these on.
    """
    way = _Way(robot.space, rows, np.sqrt(weight))
    left = robot.space.difference(here, way.at(_LEAST_AHEAD))
    if limits.drive_dim == 2:
        side = copysign(1.0, float(v[0]))
        off = max(abs(atan2(side * float(left[1]), side * float(left[0]))), 0.5 * abs(float(left[2])))
        if off < _STRAIGHT_ANGLE or abs(float(v[0])) < _LEAST_ROLLING * limits.track * abs(float(v[2])):
            return
        found = _rolled(limits, here, v, way)
    else:
        y, to = limits.to_coordinates(v), limits.to_coordinates(left)
        sizes = float(np.linalg.norm(y)) * float(np.linalg.norm(to))
        if sizes < 1e-9 or float(y @ to) > _STRAIGHT_COSINE * sizes:
            return
        found = _blended(robot, limits, here, v, way)
    for curve, at in found:
        end = way.at(at)
        if limits.drive_dim == 2:
            row = here + np.linspace(0.0, 1.0, len(curve))[:, None] * (end - here)
            row[:, :3] = curve
            curve = row
        curve[-1] = end
        yield curve, np.vstack([end, rows[way.after(at + 1e-6) :]])


def _blended(
    robot: RobotModel, limits: MotionLimits, here: Array, v: Array, way: _Way
) -> Iterator[tuple[Array, float]]:
    """Rows (R, nv), and the length of the strip where they end, of robots that can move in any direction: a constant
    acceleration turns the velocity into one towards a point of the strip."""
    space, base = robot.space, robot.space.base_nv
    rate = v.copy()
    if base:
        turn = float(here[2])
        rate[:2] = cos(turn) * v[0] - sin(turn) * v[1], sin(turn) * v[0] + cos(turn) * v[1]
    top, change = _CURVE_SPEED * limits.speed, _CURVE_ACCELERATION * limits.acceleration
    low, high = np.minimum(space.lower, here)[base:], np.maximum(space.upper, here)[base:]
    tried: list[tuple[float, float, Array, float]] = []
    for ahead in _JOINED_AHEAD:
        at = min(ahead, way.length)
        to = _unwrapped(way.at(at) - here, base)
        left, after, turning = to, rate, 0.0
        for _ in range(_BLEND_STEPS):
            after = left / max(float((np.abs(left) / top).max()), 1e-9)
            turning = float((np.abs(after - rate) / change).max())
            left = to - 0.5 * turning * (rate + after)  # beyond where the velocity has turned
        if float(left @ after) <= 0.0 or turning <= 0.0:
            continue
        onward = way.direction(at)
        cosine = float(onward @ after) / max(float(np.linalg.norm(onward) * np.linalg.norm(after)), 1e-9)
        straight = float((np.abs(left) / top).max())
        tried.append((turning + straight - _LENGTH_VALUE * at + _CORNER_TIME * (1.0 - cosine), at, after, turning))
    for _, at, after, turning in sorted(tried, key=lambda each: each[0]):
        tau = np.linspace(0.0, turning, max(ceil(turning / _CURVE_STEP), 2) + 1)[:, None]
        curve = here + rate * tau + (after - rate) * (0.5 / turning) * tau * tau
        if ((curve[:, base:] < low) | (curve[:, base:] > high)).any():
            continue
        line = curve[-1] + np.linspace(0.0, 1.0, 5)[1:, None] * _unwrapped(way.at(at) - curve[-1], base)
        yield np.vstack([curve, line]), at


def _unwrapped(to: Array, base: int) -> Array:
    """A difference of coordinate rows, by the shorter turn of the base."""
    if base:
        to[2] = atan2(sin(to[2]), cos(to[2]))
    return to


def _rolled(limits: MotionLimits, here: Array, v: Array, way: _Way) -> Iterator[tuple[Array, float]]:
    """(R, 3) poses of curves of a differential drive onto a strip, and the length of the strip where each ends, the
    fastest first; of those to one end with one line first, only the fastest.

    They are Bézier curves of degree 5, with the bend of the present motion at the beginning and none at the end. Some
    begin with a line, on which the base brakes.
    """
    now, half = abs(float(v[0])), 0.5 * limits.track
    top = max(_CURVE_SPEED * float(limits.drive_speed.min()), now)
    change = _CURVE_ACCELERATION * float(limits.drive_acceleration.min())
    back = pi if v[0] < 0.0 else 0.0
    first, _, _ = way.beside(here, 0.0)
    ends = np.minimum(first + np.array(_JOINED_AHEAD), way.length)
    poses = np.array([way.at(at)[:3] for at in ends.tolist()])
    poses[:, 2] += back
    grids = np.meshgrid(np.arange(len(ends)), _REACHES, _BRAKED_FIRST, indexing="ij")
    which, reach, braked = (grid.ravel() for grid in grids)
    to, yaw = poses[which], float(here[2]) + back
    onward, across = np.array([cos(yaw), sin(yaw)]), np.array([-sin(yaw), cos(yaw)])
    line = braked * now * now / (2.0 * change)
    begins = np.sqrt(np.maximum(now * now - 2.0 * change * line, 0.0))
    p, q = here[:2] + line[:, None] * onward, to[:, :2]
    apart = np.hypot(*(q - p).T)
    far = (reach * apart)[:, None]
    arriving = np.column_stack([np.cos(to[:, 2]), np.sin(to[:, 2])])
    bend = np.where(braked == 0.0, float(v[2]) / now if now > _SLOW else 0.0, 0.0)[:, None]
    points = np.stack(
        [
            p,
            p + far * onward,
            p + 2.0 * far * onward + 1.25 * bend * far * far * across,
            q - 2.0 * far * arriving,
            q - far * arriving,
            q,
        ],
        axis=1,
    )
    at, slope, second = (np.einsum("tk,nkd->ntd", basis, points) for basis in _BEZIER)
    size = np.maximum(np.hypot(slope[..., 0], slope[..., 1]), 1e-9)
    kappa = (slope[..., 0] * second[..., 1] - slope[..., 1] * second[..., 0]) / size**3
    step = 0.5 * (size[:, 1:] + size[:, :-1]) / (_SAMPLES - 1)
    sharper = np.abs(np.diff(kappa, axis=1)) / np.maximum(step, 1e-9)
    speed = top / (1.0 + half * np.abs(kappa))  # of the middle, where the faster rim has its limit
    speed[:, 1:] = np.minimum(speed[:, 1:], np.sqrt(change / (half * sharper + 1e-9)))
    for i in range(_SAMPLES - 2, -1, -1):
        speed[:, i] = np.minimum(speed[:, i], np.sqrt(speed[:, i + 1] ** 2 + 2.0 * change * step[:, i]))
    able = speed[:, 0] >= begins - 1e-6
    speed[:, 0] = np.minimum(speed[:, 0], np.maximum(begins, _SLOW))
    for i in range(_SAMPLES - 1):
        speed[:, i + 1] = np.minimum(speed[:, i + 1], np.sqrt(speed[:, i] ** 2 + 2.0 * change * step[:, i]))
    time = (2.0 * step / (speed[:, 1:] + speed[:, :-1])).sum(axis=1) - _LENGTH_VALUE * ends[which] / top
    time += (top - speed[:, -1]) / change * 0.5 + (now - begins) / change
    time[~able | (apart < _SHORTEST_CURVE)] = np.inf
    kinds: set[tuple[int, float]] = set()
    for k in np.argsort(time, kind="stable").tolist():
        kind = int(which[k]), float(braked[k])
        if not np.isfinite(time[k]) or kind in kinds:
            continue
        kinds.add(kind)
        turned = np.unwrap(np.arctan2(slope[k, :, 1], slope[k, :, 0]))
        out = np.column_stack([at[k], turned + (float(here[2]) - turned[0])])
        if line[k] > 0.0:
            steps = np.arange(0.0, 1.0, min(_LINE_SPACING / float(line[k]), 0.5))[:, None]
            before = np.hstack([here[:2] + steps * float(line[k]) * onward, np.full_like(steps, here[2])])
            out = np.vstack([before, out])
        yield out, float(ends[which[k]])


def _wanted(limits: MotionLimits, left: Array, onward: Array, top: Array, pace: float, room: float) -> Array:
    """(k + n,) speeds with which the robot is steered to a point.

    Args:
        limits: limits of its motors.
        left: (nv,) difference to the point.
        onward: (nv,) direction of the strip.
        top: (k + n,) largest speeds.
        pace: its present speed [m/s in the metric].
        room: what is left to the end of the strip [m in the metric].
    """
    k = limits.drive_dim
    if not k:
        return left / max(float((np.abs(left) / top).max(initial=0.0)), 1e-9)
    x, y, turn = left[:3].tolist()
    apart = hypot(x, y)
    slowing = float(limits.drive_acceleration[:2].min()) * _ACCELERATION_SHARE
    fastest = min(float(top[:2].min()), sqrt(2.0 * slowing * max(room, 0.0)))
    if k == 3:
        turning = min(max(_TURNING_GAIN * turn, -float(top[2])), float(top[2]))
        share = fastest / max(apart, 1e-9) if apart > _AT_POINT else _TURNING_GAIN
        drive = np.array([share * x, share * y, turning])
    else:
        most = _TURNING_SHARE * 2.0 * float(top[:2].min()) / limits.track
        sign = 1.0 if float(onward[0]) >= -1e-6 else -1.0
        if apart > _AT_POINT:
            angle = atan2(sign * y, sign * x)
            speed = fastest * max(cos(angle), _LEAST_CURVE_SPEED)
            bend = 2.0 * sin(min(max(angle, -0.5 * pi), 0.5 * pi)) / apart
            turning = min(max(speed * bend, -most), most) if abs(angle) < 0.5 * pi else copysign(most, angle)
        else:
            speed, turning = 0.0, min(max(_TURNING_GAIN * turn, -most), most)
        drive = limits.to_drive(np.array([sign * speed, 0.0, turning]))
        drive = drive / max(1.0, float((np.abs(drive) / top[:2]).max()))
    seconds = max(apart, 1e-3) / max(pace, _LEAST_SPEED) if apart > _AT_POINT else 1.0 / _TURNING_GAIN
    joints = left[3:] / max(seconds, float((np.abs(left[3:]) / top[k:]).max(initial=0.0)))
    return np.concatenate([drive, joints])


class _Way:
    """A strip as a line: in the plane for a base that moves, which may turn where it likes, else in the metric."""

    def __init__(self, space: ConfigurationSpace, rows: Array, scale: Array) -> None:
        self._space, self._rows = space, rows
        self._scale = scale.copy()
        if space.planar:
            self._scale[2:] = 0.0
        self._step = space.difference(rows[:-1], rows[1:])
        size = np.linalg.norm(self._scale * self._step, axis=1)
        self._passed = np.append(0.0, np.cumsum(size))
        self._size = np.maximum(size, 1e-9)
        self.length = float(self._passed[-1])

    def nearest(self, here: Array) -> float:
        """Length at the node from which the rest is shortest, the detour to it included."""
        to = self._space.difference(np.broadcast_to(here, self._rows.shape), self._rows)
        apart = np.linalg.norm(self._scale * to, axis=1)
        return float(self._passed[int((DETOUR_COST * apart - self._passed).argmin())])

    def beside(self, here: Array, passed: float) -> tuple[float, float, Array]:
        """Length of the point next to ``here`` at or after ``passed``, the distance from it, and the direction (nv,)
        there."""
        i = min(int(np.searchsorted(self._passed, passed, side="right")) - 1, len(self._step) - 1)
        while True:
            to = self._scale * self._space.difference(self._rows[i], here)
            onward = self._scale * self._step[i] / self._size[i]
            along = float(to @ onward)
            if along <= self._size[i] or i == len(self._step) - 1:
                break
            i += 1
        along = min(max(along, 0.0), float(self._size[i]))
        at = max(passed, float(self._passed[i]) + along)
        return at, float(np.linalg.norm(to - along * onward)), self._step[i] / self._size[i]

    def after(self, length: float) -> int:
        """Index of the first node at or after a length; the last one beyond the end."""
        return min(int(np.searchsorted(self._passed, length)), len(self._rows) - 1)

    def direction(self, length: float) -> Array:
        """(nv,) in which the rows change at a length, in coordinates; none at the end."""
        i = self.after(length + 1e-9)
        return _unwrapped(self._rows[i] - self._rows[max(i - 1, 0)], self._space.base_nv) if i else self._rows[0] * 0.0

    def at(self, length: float) -> Array:
        """(nv,) row at a length; the last one beyond the end."""
        if length >= self.length:
            return self._rows[-1]
        i = max(int(np.searchsorted(self._passed, length, side="right")) - 1, 0)
        part = (length - float(self._passed[i])) / float(self._size[i])
        return self._space.integrate(self._rows[i], part * self._step[i])
