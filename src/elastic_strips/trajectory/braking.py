"""Braking: speeds that a robot is to have for a while, continued until it rests, as a trajectory."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel

from .limits import MotionLimits
from .path import integrate_travel
from .trajectory import ReferenceState, Trajectory


def brought_to_rest(
    robot: RobotModel, limits: MotionLimits, start: ReferenceState, rates: Array, change: Array, dt: float
) -> Trajectory | None:
    """The trajectory of rates, continued to rest; None where a joint would leave its range.

    Velocities are linear and travels quadratic between samples, so that no limit is exceeded anywhere. The speeds of
    the base keep their proportion, so that it stays on its arc; each joint brakes for itself.

    Args:
        robot, limits: the robot, and the limits of its motors.
        start: first state.
        rates: (N, k + n) speeds of drive and joints at times ``dt`` [s] apart; those of ``start`` first.
        change: (k + n,) by which they change at most from one time to the next.
        dt: see above.
    """
    k, last = limits.drive_dim, rates[-1]
    steps = np.maximum(np.ceil(np.abs(last) / change - 1e-9), 1.0)
    if k:
        steps[:k] = steps[:k].max()
    after = np.arange(1.0, steps.max(initial=1.0) + 1.0)[:, None]
    v = np.concatenate([rates, last * np.maximum(1.0 - after / steps, 0.0)])
    y, a = np.zeros_like(v), np.zeros_like(v)
    np.cumsum(0.5 * dt * (v[1:] + v[:-1]), axis=0, out=y[1:])
    a[:-1] = (v[1:] - v[:-1]) / dt
    coordinates = integrate_travel(robot, limits, start.coordinates, y)
    base, here = robot.space.base_nv, start.coordinates[robot.space.base_nv :]
    low, high = np.minimum(robot.space.lower[base:], here), np.maximum(robot.space.upper[base:], here)
    joints = coordinates[:, base:]
    if ((joints < low - 1e-6) | (joints > high + 1e-6)).any():
        return None
    time = start.time + dt * np.arange(len(v), dtype=float)
    return Trajectory(robot, limits, time, coordinates, limits.to_tangent(v), limits.to_tangent(a))
