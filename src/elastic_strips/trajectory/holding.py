"""Holding: motions that approach given speeds for a moment and brake to rest, as a guard certifies them."""

from __future__ import annotations

import math

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel

from .limits import MotionLimits
from .path import integrate_travel
from .trajectory import ReferenceState, Trajectory

_FIRST_BRAKING = 0.01  # [s] into braking there is a sample, so that the acceleration there is that of braking
_HELD_STEP = 0.025  # [s] longest time between samples before braking
_BRAKED_STEP = 0.04  # [s] and in braking: the middle of an arc is off by at most a tenth of a millimetre there
_STANDS = 1e-3  # [s] a motion that has nothing to brake ends this long after


def hold_and_brake(
    robot: RobotModel,
    limits: MotionLimits,
    start: ReferenceState,
    speed: Array,
    *,
    part: float,
    hold: float,
    together: bool = True,
) -> Trajectory:
    """A motion that changes its speeds evenly for a while, towards given ones, and then brakes to rest.

    The drive brakes in one time, so that the base stays on its arc, or each axis of a base that slides as soon as it
    can, so that it turns off along what it comes near to; each joint as soon as it can.

    Args:
        robot: the robot.
        limits: limits of its motors.
        start: first state, at ``start.time``.
        speed: (k + n,) wanted speeds of the drive coordinates and joints; those that cannot be reached while it is held
            are approached as far as possible.
        part: share of the acceleration limits.
        hold: time [s] from the start until it brakes.
        together: whether all axes of a base that slides brake in one time.
    """
    k, change = limits.drive_dim, part * limits.acceleration
    now = limits.to_coordinates(start.v)
    top = np.minimum(np.maximum(speed, now - change * hold), now + change * hold)
    braking = np.abs(top) / change
    if together or k != 3:
        braking[:k] = braking[:k].max(initial=0.0)
    longest = float(braking.max(initial=0.0))
    count = max(2, math.ceil(hold / _HELD_STEP))
    held = hold / count * np.arange(count + 1, dtype=float)
    first = min(_FIRST_BRAKING, max(longest, _STANDS))
    pieces = max(0, math.ceil((longest - first) / _BRAKED_STEP - 1e-9))
    after = (
        first + (longest - first) / max(pieces, 1) * np.arange(pieces + 1, dtype=float) if pieces else np.array([first])
    )
    lasted = np.maximum(braking, 1e-12)
    share = held[:, None] / hold
    left = np.maximum(1.0 - after[:, None] / lasted, 0.0)
    v = np.concatenate((now + share * (top - now), left * top))
    way = held[:, None] * (now + 0.5 * share * (top - now))
    braked = np.minimum(after[:, None], lasted)
    y = np.concatenate((way, way[-1] + top * braked * (1.0 - 0.5 * braked / lasted)))
    v[-1] = 0.0
    time = np.concatenate((held, hold + after))
    a = np.zeros_like(v)
    a[:-1] = (v[1:] - v[:-1]) / (time[1:] - time[:-1])[:, None]
    coordinates = integrate_travel(robot, limits, start.coordinates, y)
    return Trajectory(robot, limits, start.time + time, coordinates, limits.to_tangent(v), limits.to_tangent(a))


def fastest_towards(gap: Array, now: Array, change: Array, hold: float) -> Array:
    """The largest speeds (n,) towards stops that :func:`hold_and_brake` may be given without passing them.

    Asked for again and again, while it slows down to the stop, they lead up to half of ``change·hold²`` beyond it.

    Args:
        gap: (n,) way that is left to each stop [rad or m].
        now: (n,) present speeds towards it.
        change: (n,) acceleration with which they brake.
        hold: time [s] until they do.
    """
    room = 0.25 * hold * hold + 2.0 * (gap - 0.5 * now * hold) / change
    return change * (np.sqrt(np.maximum(room, 0.0)) - 0.5 * hold)
