"""Base methods: their interface, limits of the base, and a limiter of their commands.

They steer the base alone: a disc with a differential drive. The arm is ignored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.validation import Checked, NonNegative, Positive

from .certainty_grid import PlanarReading

Status = Literal["moving", "arrived", "blocked"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseLimits(Checked):
    """The base that a method steers.

    Attributes:
        radius: radius of a circle about the base's origin that holds the base [m]; 0.27 holds the Silvermate's.
        max_speed: largest speed forwards [m/s].
        max_reverse: largest speed backwards [m/s]; 0: the base is not driven backwards.
        max_turn: largest yaw rate [rad/s].
        acceleration: largest change of the speed [m/s²], speeding up as well as braking.
        turn_acceleration: largest change of the yaw rate [rad/s²].
    """

    radius: Positive = 0.27
    max_speed: Positive = 0.6
    max_reverse: NonNegative = 0.0
    max_turn: Positive = 1.5
    acceleration: Positive = 0.8
    turn_acceleration: Positive = 3.0

    @staticmethod
    def of(
        motion: MotionLimits,
        *,
        radius: float = 0.27,
        max_speed: float = 0.6,
        max_reverse: float = 0.0,
        max_turn: float = 1.5,
    ) -> BaseLimits:
        """Limits of a differential drive's wheels, at most these speeds forwards and backwards [m/s] and yaw rate
        [rad/s].

        Speed and yaw rate are bounded separately. Both together may exceed the limit of a rim; the controller scales
        them alike then.

        Raises:
            ParameterError: no differential drive, or a value out of range.
        """
        if motion.drive_dim != 2:
            raise ParameterError(f"BaseLimits.of: {motion.drive_dim} drive coordinates; a differential drive has 2")
        speed, change = float(motion.drive_speed.min()), float(motion.drive_acceleration.min())
        arm = 0.5 * motion.track
        return BaseLimits(
            radius=radius,
            max_speed=min(max_speed, speed),
            max_reverse=min(max_reverse, speed),
            max_turn=min(max_turn, speed / arm),
            acceleration=change,
            turn_acceleration=change / arm,
        )


@dataclass(frozen=True, slots=True)
class BaseCommand:
    """Command of a base method.

    Attributes:
        v: speed forwards [m/s].
        omega: yaw rate [rad/s].
        status: ``"moving"``; ``"arrived"``: at the goal, at rest; ``"blocked"``: no path is known, or there is no
            progress for some time. A blocked method goes on trying.
        reason: reason of the status, in words; may be empty.
    """

    v: float
    omega: float
    status: Status
    reason: str = ""


@runtime_checkable
class BaseMethod(Protocol):
    """A method that steers a base to a goal among sensed obstacles."""

    name: str

    def update(self, reading: PlanarReading, pose: Array) -> None:
        """Take in a reading.

        Args:
            reading: reading of any sensor.
            pose: (3,) estimated x, y [m], yaw [rad] of the base when it was measured.
        """
        ...

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """The command for now.

        Args:
            t: time [s]; it must not go back.
            pose: (3,) estimated x, y [m], yaw [rad].
            velocity: (2,) estimated speed [m/s] and yaw rate [rad/s].
            goal: (3,) x, y [m], yaw [rad]; a yaw of nan: any.
        """
        ...


_FIRST_PERIOD = 0.1  # [s] taken as time since the last command where there was none, or none for long
_LONGEST_COMMAND_AGE = 0.5  # [s] longest time since the last command
_COMMAND_LEAD = 0.3  # [s] the last command may be ahead of the measured velocity by what the base can gain in this time
_TURN_GAIN = 2.0  # [1/s] of the heading's error when turning in place


def angle_between(target: float, heading: float) -> float:
    """Shortest turn from ``heading`` to ``target`` in [−π, π] [rad]."""
    return math.remainder(target - heading, 2.0 * math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalParams(Checked):
    """When a goal is reached, and when there is no progress. All values are ours; no publication states any.

    Attributes:
        position_tolerance: distance from the goal that counts as reached [m].
        yaw_tolerance: tolerance of the heading [rad].
        progress: length [m] by which the remaining way has to become shorter within ``patience``.
        patience: time [s] after which a base without such progress counts as blocked.
    """

    position_tolerance: Positive = 0.1
    yaw_tolerance: Positive = 0.08
    progress: Positive = 0.1
    patience: Positive = 6.0


class CommandLimiter:
    """Workspace: limits the wanted speeds of a method to those that the base can follow.

    Args:
        limits: limits of the base.
        goal: when a goal is reached.
    """

    def __init__(self, limits: BaseLimits, goal: GoalParams | None = None) -> None:
        self.limits: BaseLimits = limits
        self.params: GoalParams = GoalParams() if goal is None else goal
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
        if self._time is None or not 0.0 < t - self._time < _LONGEST_COMMAND_AGE:
            return _FIRST_PERIOD
        return t - self._time

    def approach_speed(self, distance: float) -> float:
        """Speed [m/s] at which the base can still stop within a distance [m] with half of its deceleration."""
        return min(self.limits.max_speed, math.sqrt(self.limits.acceleration * max(distance, 0.0)))

    def at_goal(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand | None:
        """The command at the goal's position, until the heading is reached, too; None elsewhere."""
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
        """The command for a wanted speed and yaw rate; the remaining path [m] measures progress."""
        if remaining < self._best - self.params.progress:
            self._best, self._since = remaining, t
        stuck = t - self._since > self.params.patience
        status: Status = "blocked" if stuck else "moving"
        if stuck:
            reason = f"no progress for {t - self._since:.1f} s" + (f"; {reason}" if reason else "")
        return BaseCommand(*self._limited(t, velocity, v, omega), status, reason)

    def halt(self, t: float, velocity: Array, reason: str, omega: float = 0.0) -> BaseCommand:
        """The command of a base without a path: it brakes, and may turn."""
        return BaseCommand(*self._limited(t, velocity, 0.0, omega), "blocked", reason)

    def _limited(self, t: float, velocity: Array, v: float, omega: float) -> tuple[float, float]:
        """Speed and yaw rate within the limits, no further from the last ones than the accelerations allow."""
        limits, period = self.limits, self.period(t)
        fresh = self._time is None or t - self._time >= _LONGEST_COMMAND_AGE
        wanted = (
            (min(max(v, -limits.max_reverse), limits.max_speed), limits.acceleration),
            (min(max(omega, -limits.max_turn), limits.max_turn), limits.turn_acceleration),
        )
        out = []
        for (value, change), last, now in zip(wanted, self._last, velocity, strict=True):
            base = float(now) if fresh else min(max(last, now - change * _COMMAND_LEAD), now + change * _COMMAND_LEAD)
            out.append(float(min(max(value, base - change * period), base + change * period)))
        self._time, self._last = t, (out[0], out[1])
        return self._last
