"""Execution room, manoeuvres: many short motions of the base at once, in drive coordinates, and one of them in full."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robot import RobotModel
from ..robot.space import Array, Indices, Mask
from .limits import MotionLimits
from .path import integrate_travel
from .trajectory import ReferenceState, Trajectory

_REACH = 0.95
"""Part of the largest speeds that manoeuvres go to."""
_DRIVES = (-1.0, -0.6, -0.25, 0.0, 0.25, 0.6, 1.0)  # parts of the largest speed
_TURNS = (-3.0, -1.5, -0.6, 0.0, 0.6, 1.5, 3.0)  # [rad/s]
_ONWARD = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (1.0, 1.2), (1.0, -1.2))
_CHANGES = (0.4, 1.0)  # times [s] at which the first target gives way to the second


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Two-stage manoeuvres: speeds to go to as fast as the motors allow, one after the other.

    Attributes:
        first, second: (N, k) speeds of the drive coordinates [m/s or rad/s].
        change: (N,) time from the beginning [s] at which the second takes over.
        kind: (N,) which of the different first targets each has.
    """

    first: Array
    second: Array
    change: Array
    kind: Indices

    def __len__(self) -> int:
        return len(self.change)

    def take(self, which: Mask) -> Targets:
        """Those of a mask (N,)."""
        return Targets(self.first[which], self.second[which], self.change[which], self.kind[which])

    @property
    def different(self) -> Array:
        """(D, k) the different first targets, in the order of their kinds."""
        return self.first[np.unique(self.kind, return_index=True)[1]]


@dataclass(frozen=True, slots=True, eq=False)
class Rollouts:
    """Where the base gets in each of N manoeuvres at T times.

    Attributes:
        time: (T,) since the beginning [s], the first of them a step after it.
        pose: (N, T, 3) x, y [m], yaw [rad].
    """

    time: Array
    pose: Array


def lattice(limits: MotionLimits) -> Targets:
    """Targets over all speeds that the base can reach, rest among them; each with several ways to go on."""
    top = _REACH * limits.drive_speed
    if limits.drive_dim == 2:
        v, w = np.meshgrid(np.array(_DRIVES) * top.min(), np.array(_TURNS), indexing="ij")
        first = _within(limits.to_drive(np.stack([v.ravel(), 0.0 * v.ravel(), w.ravel()], axis=1)), top)
        onward = np.array([[v * top.min(), 0.0, w] for v, w in _ONWARD])
        second = _within(limits.to_drive(onward), top)
    else:
        angle = 2.0 * np.pi * np.arange(16) / 16
        around = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]) * top
        first = np.vstack([around, 0.4 * around, np.zeros((1, 3))])
        second = np.vstack([around[::4], np.zeros((1, 3))])
    first = np.unique(first.round(9), axis=0)
    kinds = np.arange(len(first))
    n, m = len(first), len(second)
    changes = np.concatenate([np.full(n, np.inf), np.repeat(_CHANGES, n * m)])
    several = [np.repeat(first, m, axis=0), np.tile(second, (n, 1)), np.repeat(kinds, m)]
    times = len(_CHANGES)
    return Targets(
        np.vstack([first, *[several[0]] * times]),
        np.vstack([first, *[several[1]] * times]),
        changes,
        np.concatenate([kinds, *[several[2]] * times]).astype(np.intp),
    )


def roll_out(
    limits: MotionLimits, start: ReferenceState, targets: Targets, *, part: float, horizon: float, dt: float
) -> Rollouts:
    """Follow all targets for a while; the base goes on arcs from time to time.

    Args:
        limits: of the motors.
        start: where and how fast the robot is.
        targets: N of them.
        part: of the acceleration limits.
        horizon: how long [s]; dt: step [s].
    """
    time = dt * np.arange(1.0, round(horizon / dt) + 1.0)
    step = part * limits.drive_acceleration * dt
    speed = np.empty((len(time) + 1, *targets.first.shape))
    speed[0] = limits.to_drive(start.v[:3])
    for i, t in enumerate(time):
        goal = np.where((t - 0.5 * dt < targets.change)[:, None], targets.first, targets.second)
        speed[i + 1] = speed[i] + np.clip(goal - speed[i], -step, step)
    return Rollouts(time, _poses(limits, start, speed, dt))


def roll_to_rest(
    limits: MotionLimits, start: ReferenceState, target: Array, hold: Array, *, part: float, dt: float
) -> tuple[Rollouts, Array]:
    """Motions as :func:`motion_to` makes them, to targets (N, k), each held for a time (N,) [s] before it brakes.

    Returns them and the times (N,) [s] at which they are at rest.
    """
    change = part * limits.drive_acceleration
    longest = float(hold.max()) + float((limits.drive_speed / change).max()) + dt
    time = dt * np.arange(1.0, round(longest / dt) + 1.0)
    speed = np.empty((len(time) + 1, *target.shape))
    speed[0] = limits.to_drive(start.v[:3])
    fall = np.zeros_like(target)
    braking = np.zeros(len(target), dtype=bool)
    rest = np.zeros(len(target))
    for i, t in enumerate(time):
        now = speed[i]
        begin = ~braking & (t > hold + 0.5 * dt)
        if begin.any():
            duration = np.maximum((np.abs(now[begin]) / change).max(axis=1), 1e-9)
            fall[begin] = now[begin] / duration[:, None] * dt
            rest[begin] = time[i] - dt + duration
            braking |= begin
        going = now + np.clip(target - now, -change * dt, change * dt)
        slower = np.sign(now) * np.maximum(np.abs(now) - np.abs(fall), 0.0)
        speed[i + 1] = np.where(braking[:, None], slower, going)
    return Rollouts(time, _poses(limits, start, speed, dt)), rest


def _poses(limits: MotionLimits, start: ReferenceState, speed: Array, dt: float) -> Array:
    """Poses (N, T, 3) for speeds (T + 1, N, k) of the drive coordinates."""
    twist = limits.to_twist(0.5 * (speed[1:] + speed[:-1])) * dt
    yaw = start.chart[2] + np.cumsum(twist[..., 2], axis=0)
    middle = yaw - 0.5 * twist[..., 2]
    cos, sin = np.cos(middle), np.sin(middle)
    pose = np.empty((speed.shape[1], len(speed) - 1, 3))
    pose[..., 0] = (start.chart[0] + np.cumsum(cos * twist[..., 0] - sin * twist[..., 1], axis=0)).T
    pose[..., 1] = (start.chart[1] + np.cumsum(sin * twist[..., 0] + cos * twist[..., 1], axis=0)).T
    pose[..., 2] = yaw.T
    return pose


def motion_to(
    robot: RobotModel,
    limits: MotionLimits,
    start: ReferenceState,
    target: Array,
    *,
    part: float,
    duration: float,
    dt: float,
) -> Trajectory | None:
    """A motion that goes to a target speed for a short while and then brakes to rest; the joints only brake.

    Velocities are linear and travels quadratic between samples, so that no limit is exceeded anywhere. Braking keeps
    the proportion of the speeds: the base stays on its arc. None where a joint would leave its range.

    Args:
        robot, limits: whose.
        start: state that it goes on from; ``start.time`` is its first sample's.
        target: (k,) speeds of the drive coordinates.
        part: of the acceleration limits.
        duration: until it begins to brake [s]; dt: distance of the samples [s].
    """
    k = limits.drive_dim
    change = limits.acceleration.copy()
    change[:k] *= part
    goal = np.concatenate([target, np.zeros(len(change) - k)])
    rows = [limits.to_coordinates(start.v)]
    for _ in range(max(round(duration / dt), 1)):
        rows.append(rows[-1] + np.clip(goal - rows[-1], -change * dt, change * dt))
    steps = max(int(np.ceil(float((np.abs(rows[-1]) / change).max()) / dt - 1e-9)), 1)
    rows += [rows[-1] * (1.0 - j / steps) for j in range(1, steps + 1)]
    v = np.array(rows)
    y = np.vstack([np.zeros(v.shape[1]), np.cumsum(0.5 * dt * (v[1:] + v[:-1]), axis=0)])
    a = np.vstack([np.diff(v, axis=0) / dt, np.zeros(v.shape[1])])
    chart = integrate_travel(robot, limits, start.chart, y)
    space, base = robot.space, robot.space.base_nv
    low, high = np.minimum(space.lower, start.chart) - 1e-6, np.maximum(space.upper, start.chart) + 1e-6
    if ((chart < low) | (chart > high))[:, base:].any():
        return None
    return Trajectory(
        robot,
        limits,
        start.time + dt * np.arange(len(v), dtype=float),
        chart,
        limits.to_tangent(v),
        limits.to_tangent(a),
    )


def _within(drive: Array, top: Array) -> Array:
    """Speeds (N, k) scaled back to their limits (k,), in proportion: the curvature stays."""
    return np.asarray(drive / np.maximum((np.abs(drive) / top).max(axis=1), 1.0)[:, None], dtype=float)
