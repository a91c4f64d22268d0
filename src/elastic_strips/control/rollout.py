"""Roll-outs: where many manoeuvres of two stages lead a base, all at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask, by_rows
from elastic_strips.native import kernel
from elastic_strips.trajectory import MotionLimits
from elastic_strips.trajectory.trajectory import ReferenceState

_SPEED_SHARE = 0.95
"""Largest speeds of manoeuvres, as a part of the limits."""
_DRIVE_SHARES = (-1.0, -0.6, -0.25, 0.0, 0.25, 0.6, 1.0)  # parts of the largest speed
_TURN_RATES = (-3.0, -1.5, -0.6, 0.0, 0.6, 1.5, 3.0)  # [rad/s]
_SECOND_TARGETS = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (1.0, 1.2), (1.0, -1.2), (-1.0, 1.2), (-1.0, -1.2))
_CHANGE_TIMES = (0.4, 1.0, 1.8)  # times [s] at which the second target replaces the first


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Two-stage manoeuvres: target speeds that are approached as fast as the motors allow, one after the other.

    Attributes:
        first, second: (N, k) speeds of the drive coordinates [m/s or rad/s].
        change: (N,) time from the beginning [s] at which the second replaces the first.
        kind: (N,) index of each one's first target among the different ones.
    """

    first: Array
    second: Array
    change: Array
    kind: Indices

    def __len__(self) -> int:
        return len(self.change)

    def take(self, which: Mask) -> Targets:
        """Those of a mask (N,)."""
        if which.all():
            return self
        return Targets(self.first[which], self.second[which], self.change[which], self.kind[which])

    @property
    def different(self) -> Array:
        """(D, k) the different first targets, in the order of their kinds."""
        return self.first[np.unique(self.kind, return_index=True)[1]]


def lattice(limits: MotionLimits, *, backward: bool = True, turn_speed: float = np.inf) -> Targets:
    """Grid of targets over all speeds of the base, rest included, each followed by several second targets.

    Args:
        limits: limits of the motors.
        backward: whether they lead backwards, too.
        turn_speed: how fast they turn at most [rad/s].
    """
    top = _SPEED_SHARE * limits.drive_speed
    if limits.drive_dim == 2:
        rates = np.clip(_TURN_RATES, -turn_speed, turn_speed)
        v, w = np.meshgrid(np.array(_DRIVE_SHARES) * top.min(), rates, indexing="ij")
        first = _within(limits.to_drive(np.stack([v.ravel(), 0.0 * v.ravel(), w.ravel()], axis=1)), top)
        ahead, turning = np.array(_SECOND_TARGETS).T
        onward = np.stack([ahead * top.min(), 0.0 * ahead, np.clip(turning, -turn_speed, turn_speed)], axis=1)
        second = _within(limits.to_drive(onward), top)
    else:
        angle = 2.0 * np.pi * np.arange(16) / 16
        around = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]) * top
        first = np.vstack([around, 0.4 * around, np.zeros((1, 3))])
        second = np.vstack([around[::4], np.zeros((1, 3))])
    if not backward:
        first, second = (each[limits.to_twist(each)[:, 0] >= -1e-9] for each in (first, second))
    first = np.unique(first.round(9), axis=0)
    kinds = np.arange(len(first))
    n, m = len(first), len(second)
    changes = np.concatenate([np.full(n, np.inf), np.repeat(_CHANGE_TIMES, n * m)])
    several = [np.repeat(first, m, axis=0), np.tile(second, (n, 1)), np.repeat(kinds, m)]
    times = len(_CHANGE_TIMES)
    return Targets(
        np.vstack([first, *[several[0]] * times]),
        np.vstack([first, *[several[1]] * times]),
        changes,
        np.concatenate([kinds, *[several[2]] * times]).astype(np.intp),
    )


def _within(drive: Array, top: Array) -> Array:
    """Speeds (N, k) scaled back to their limits (k,), in proportion: the curvature stays."""
    return np.asarray(drive / np.maximum((np.abs(drive) / top).max(axis=1), 1.0)[:, None], dtype=float)


class RollOuts:
    """Workspace: rolls out manoeuvres of a base in equal steps.

    Args:
        limits: limits of the motors.
        part: share of the acceleration limits that manoeuvres use.
        dt: step [s].
    """

    def __init__(self, limits: MotionLimits, *, part: float, dt: float) -> None:
        self._native = kernel()
        self._limits = limits
        self._dt = dt
        self._acceleration: Array = part * limits.drive_acceleration
        self._slowest = float((limits.drive_speed / self._acceleration).max())  # [s] to brake from the largest speeds
        self._twist: Array = dt * limits.to_twist(np.eye(limits.drive_dim))  # (k, 3) travel of each speed in a step

    def poses(self, start: ReferenceState, targets: Targets, *, horizon: float) -> Array:
        """(N, T, 3) poses [m, rad] after each step of N manoeuvres, over a horizon [s]."""
        steps = round(horizon / self._dt)
        done = np.minimum(np.ceil(targets.change / self._dt - 0.5), steps).astype(np.int64)
        rate = np.tile(self._acceleration * self._dt, (len(targets), 1))
        speed = self._limits.to_drive(start.v[:3])
        return self._rolled(start, speed, targets.first, done, targets.second, rate, steps)

    def to_rest(
        self, start: ReferenceState, target: Array, hold: Array, *, after: float | None = None
    ) -> tuple[Array, Array, Array]:
        """Roll out motions that approach a target speed for a while, and then brake to rest on their arcs.

        Args:
            start: first state.
            target: (N, k) speeds of the drive coordinates.
            hold: (N,) times [s] for which they are held before the base brakes.
            after: how long to go on after the last may come to rest [s]; one step where None.

        Returns:
            (T,) times [s] after the start, (N, T, 3) poses then, and (N,) times [s] at which the motions are at rest.
        """
        dt, acceleration = self._dt, self._acceleration
        longest = float(hold.max()) + self._slowest + (dt if after is None else after)
        time = dt * np.arange(1.0, round(longest / dt) + 1.0)
        done = np.floor(hold / dt + 0.5).astype(np.int64)  # steps before they brake
        speed = self._limits.to_drive(start.v[:3])
        now = np.abs(_nearer(speed, target, acceleration * dt * done[:, None]))
        duration = np.maximum((now / acceleration).max(axis=1), 1e-9)
        rate = now * (dt / duration)[:, None]
        return time, self._rolled(start, speed, target, done, np.zeros_like(now), rate, len(time)), done * dt + duration

    def _rolled(
        self, start: ReferenceState, speed: Array, first: Array, done: Indices, second: Array, rate: Array, steps: int
    ) -> Array:
        """(N, steps, 3) poses: speeds (k,) near the first targets (N, k) for ``done`` (N,) steps, then the second ones
        by at most ``rate`` (N, k) a step."""
        pose, change = np.empty((len(done), steps, 3)), self._acceleration * self._dt
        here = start.coordinates[:3]
        if self._native is not None:
            start_and_speeds = by_rows(here, speed, first, second, change, rate, self._twist)
            self._native.roll_out(*start_and_speeds, done, pose)
            return pose
        # The long axis, that of the manoeuvres, is the last: NumPy's loops run along it.
        passed = np.arange(steps + 1)[:, None]
        held = _nearer(speed[:, None], first.T, change[:, None] * done)
        speeds = np.where(
            passed <= done,
            _nearer(speed[:, None, None], first.T[:, None], change[:, None, None] * passed),
            _nearer(held[:, None], second.T[:, None], rate.T[:, None] * np.maximum(passed - done, 0)),
        )
        x, y, turn = np.tensordot(self._twist.T, 0.5 * (speeds[:, 1:] + speeds[:, :-1]), axes=1)
        yaw = here[2] + np.cumsum(turn, axis=0)
        middle = yaw - 0.5 * turn
        cos, sin = np.cos(middle), np.sin(middle)
        pose[..., 0] = (here[0] + np.cumsum(cos * x - sin * y, axis=0)).T
        pose[..., 1] = (here[1] + np.cumsum(sin * x + cos * y, axis=0)).T
        pose[..., 2] = yaw.T
        return pose


def _nearer(speed: Array, target: Array, most: Array) -> Array:
    """Speeds that have changed by at most ``most`` towards their targets."""
    return np.asarray(speed + np.minimum(np.maximum(target - speed, -most), most), dtype=float)
