"""The helm, alike for all methods: limits of speed and acceleration, the end of the way, whether there is progress."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.validation import check_numbers

from .base_method import BaseCommand, BaseLimits, Status

_FIRST_PERIOD = 0.1  # [s] taken as time since the last command where there was none, or none for long
_LONG = 0.5  # [s] since the last command
_LAG = 0.3  # [s] the last command may be ahead of the measured velocity by what the base can gain in this time
_TURN_GAIN = 2.0  # [1/s] of the heading's error when turning in place


def angle_between(target: float, heading: float) -> float:
    """Shortest turn from ``heading`` to ``target`` in [−π, π] [rad]."""
    return math.remainder(target - heading, 2.0 * math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalParams:
    """When a goal is reached, and when there is no progress. All values are ours; no publication states any.

    Attributes:
        position_tolerance: distance from the goal that counts as reached [m].
        yaw_tolerance: of the heading [rad].
        progress: the remaining way has to become shorter by this much [m] …
        patience: … within this time [s]; else the base counts as blocked.
    """

    position_tolerance: float = 0.1
    yaw_tolerance: float = 0.08
    progress: float = 0.1
    patience: float = 6.0

    def __post_init__(self) -> None:
        check_numbers(self)


class Helm:
    """Turns what a method wants into a command that the base can follow.

    Args:
        limits: of the base.
        goal: when a goal is reached.
    """

    def __init__(self, limits: BaseLimits, goal: GoalParams | None = None) -> None:
        self.limits, self.params = limits, GoalParams() if goal is None else goal
        self.reset()

    def reset(self) -> None:
        """Forget what was commanded, and the progress."""
        self._time: float | None = None
        self._last = (0.0, 0.0)
        self._goal: tuple[float, ...] | None = None
        self._there = False
        self.restart_watch()

    def restart_watch(self) -> None:
        """Measure progress from now on, as with a new goal."""
        self._best, self._since = math.inf, 0.0

    def period(self, t: float) -> float:
        """Time since the last command [s]."""
        if self._time is None or not 0.0 < t - self._time < _LONG:
            return _FIRST_PERIOD
        return t - self._time

    def approach_speed(self, distance: float) -> float:
        """Speed [m/s] at which the base can still stop within a distance [m] with half of its deceleration."""
        return min(self.limits.max_speed, math.sqrt(self.limits.acceleration * max(distance, 0.0)))

    def at_goal(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand | None:
        """The command of a base that has reached the goal's position, or None where it has not."""
        marked = tuple(np.nan_to_num(np.asarray(goal, dtype=float), nan=1e9).tolist())
        if marked != self._goal:
            self._goal, self._there = marked, False
            self.restart_watch()
        distance = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        # once there, the base may drift a little while it turns, without setting off again
        self._there = distance <= self.params.position_tolerance * (2.0 if self._there else 1.0)
        if not self._there:
            return None
        error = 0.0 if math.isnan(goal[2]) else angle_between(float(goal[2]), float(pose[2]))
        turning = abs(error) > self.params.yaw_tolerance
        v, omega = self._limited(t, velocity, 0.0, _TURN_GAIN * error if turning else 0.0)
        if turning or v != 0.0 or omega != 0.0:
            return BaseCommand(v, omega, "moving", "turns to the goal's heading" if turning else "comes to rest")
        return BaseCommand(0.0, 0.0, "arrived", "at the goal")

    def drive(
        self, t: float, velocity: Array, v: float, omega: float, remaining: float, reason: str = ""
    ) -> BaseCommand:
        """The command for a wanted speed and yaw rate, with the remaining way [m], by which progress is measured."""
        if remaining < self._best - self.params.progress:
            self._best, self._since = remaining, t
        stuck = t - self._since > self.params.patience
        status: Status = "blocked" if stuck else "moving"
        if stuck:
            reason = f"no progress for {t - self._since:.1f} s" + (f"; {reason}" if reason else "")
        return BaseCommand(*self._limited(t, velocity, v, omega), status, reason)

    def halt(self, t: float, velocity: Array, reason: str, omega: float = 0.0) -> BaseCommand:
        """The command of a base that knows no way: it brakes, and may turn."""
        return BaseCommand(*self._limited(t, velocity, 0.0, omega), "blocked", reason)

    def _limited(self, t: float, velocity: Array, v: float, omega: float) -> tuple[float, float]:
        """Speed and yaw rate within the limits, no further from the last ones than the accelerations allow."""
        limits, period = self.limits, self.period(t)
        fresh = self._time is None or t - self._time >= _LONG
        wanted = (
            (min(max(v, 0.0), limits.max_speed), limits.acceleration),
            (min(max(omega, -limits.max_turn), limits.max_turn), limits.turn_acceleration),
        )
        out = []
        for (value, change), last, now in zip(wanted, self._last, velocity, strict=True):
            base = float(now) if fresh else min(max(last, now - change * _LAG), now + change * _LAG)
            out.append(float(min(max(value, base - change * period), base + change * period)))
        self._time, self._last = t, (out[0], out[1])
        return self._last
