"""Smooth motions in time for tests: made of wheel and joint speeds, so that they are drivable by construction."""

from __future__ import annotations

import numpy as np

from elastic_strips.robot import RobotModel
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.trajectory.trajectory import Trajectory


def trajectory_of(robot: RobotModel, limits: MotionLimits, speeds: np.ndarray, *, dt: float = 0.01, start=None):
    """The motion of drive and joint speeds (M, k + n) held evenly between samples, from home or ``start`` (nv,)."""
    coordinates = np.empty((len(speeds), robot.nv))
    coordinates[0] = robot.space.to_coordinates(robot.home_q) if start is None else start
    v, a = limits.to_tangent(speeds), limits.to_tangent(np.gradient(speeds, dt, axis=0))
    for i in range(len(speeds) - 1):
        coordinates[i + 1] = robot.space.integrate(coordinates[i], 0.5 * dt * (v[i] + v[i + 1]))
    return Trajectory(robot=robot, limits=limits, time=dt * np.arange(len(speeds)), coordinates=coordinates, v=v, a=a)


def smooth_motion(
    robot: RobotModel, limits: MotionLimits, seed: int, *, seconds: float = 6.0, turn: bool = False, dt: float = 0.01
) -> Trajectory:
    """A motion from rest to rest that takes the drive to one of its limits; in place where ``turn``."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(round(seconds / dt) + 1)
    k = limits.drive_dim
    w, phase = 2.0 * np.pi * rng.uniform(0.1, 0.7, (4, k + limits.joint_speed.size)), rng.uniform(0.0, 6.0, 4)
    y = np.sin(t[:, None, None] * w + phase[:, None]).mean(axis=1) * limits.speed
    if k == 2:
        half = y[:, 0] * rng.uniform(0.2, 0.6)
        common = 0.0 if turn else rng.choice([1.0, 1.0, -1.0]) * limits.speed[0] * (0.7 + 0.2 * np.sin(0.6 * t))
        y[:, 0], y[:, 1] = common - half, common + half
    ease = np.clip(np.minimum(t, seconds - t) / 1.5, 0.0, 1.0)
    y *= (ease * ease * (3.0 - 2.0 * ease))[:, None]
    change = np.abs(np.gradient(y, dt, axis=0)).max(axis=0) / limits.acceleration
    load = np.maximum(np.abs(y).max(axis=0) / limits.speed, change)
    if k:
        load[:k] = load[:k].max()
    y /= load
    first = robot.space.base_nv
    home = robot.space.to_coordinates(robot.home_q)[first:]
    way = np.cumsum(y[:, k:], axis=0) * dt
    room = np.minimum(robot.space.upper[first:] - home, home - robot.space.lower[first:])
    y[:, k:] *= np.minimum(1.0, 0.95 * room / np.abs(way).max(axis=0))
    return trajectory_of(robot, limits, y, dt=dt)
