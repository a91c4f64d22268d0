"""Nodes that a robot can drive, and what its motors have to do along a trajectory, by formulas of their own."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.trajectory.trajectory import Trajectory


def limits_of(robot: RobotModel) -> MotionLimits:
    """Its limits, with a speed for the one joint of the tests' robots that states none."""
    return MotionLimits.for_robot(robot, joint_speed={"spin": 2.0} if "spin" in robot.joint_names else None)


def arcs(
    robot: RobotModel, seed: int, nodes: int = 30, *, step: float = 0.13, bend: float = 0.06, swing: float = 0.3
) -> np.ndarray:
    """Nodes (nodes, nv) joined by exact arcs: the turn per segment wanders by ``bend`` [rad], the joints swing.

    A fixed base stays; an omnidirectional one also slides.
    """
    rng = np.random.default_rng(seed)
    coordinates = np.tile(robot.space.to_coordinates(robot.home_q), (nodes, 1))
    first = robot.space.base_nv
    t = np.linspace(0.0, 1.0, nodes)[:, None]
    for k in (1, 2, 3):
        coordinates[:, first:] += swing / 3.0 * rng.normal(size=robot.nv - first) * np.sin(0.5 * np.pi * k * t)
    coordinates[:, first:] = coordinates[:, first:].clip(robot.space.lower[first:], robot.space.upper[first:])
    if not robot.space.planar:
        return coordinates
    turns = np.cumsum(rng.normal(size=nodes) * bend).clip(-0.3, 0.3)
    slides = np.cumsum(rng.normal(size=nodes) * 0.3 * bend).clip(-0.1, 0.1)
    for j in range(1, nodes):
        v = robot.space.difference(coordinates[j - 1], coordinates[j])
        v[:3] = rng.uniform(0.6, 1.4) * step, 0.0, turns[j]
        if robot.base_kind is BaseKind.OMNI:
            v[1] = slides[j]
        coordinates[j] = robot.space.integrate(coordinates[j - 1], v)
    return coordinates


def motor_travel(robot: RobotModel, limits: MotionLimits, v: np.ndarray) -> np.ndarray:
    """(…, k + n) travel of wheels and joints for tangent vectors (…, nv)."""
    if robot.base_kind is not BaseKind.DIFF_DRIVE:
        return v
    half = 0.5 * limits.track * v[..., 2]
    return np.concatenate([(v[..., 0] - half)[..., None], (v[..., 0] + half)[..., None], v[..., 3:]], axis=-1)


def most_used(trajectory: Trajectory, limits: MotionLimits) -> tuple[float, float]:
    """Largest part of a speed limit and of an acceleration limit that a trajectory uses.

    By its own v and a, and by differences of its coordinate rows and of v.
    """
    robot = trajectory.robot
    speed = np.concatenate([limits.drive_speed, limits.joint_speed])
    acceleration = np.concatenate([limits.drive_acceleration, limits.joint_acceleration])
    h = np.diff(trajectory.time)[:, None]
    steps = robot.space.difference(trajectory.coordinates[:-1], trajectory.coordinates[1:])
    mean = motor_travel(robot, limits, steps) / h
    v = motor_travel(robot, limits, trajectory.v)
    speeds = [np.abs(v).max(axis=0) / speed, np.abs(mean).max(axis=0) / speed]
    changes = [
        np.abs(motor_travel(robot, limits, trajectory.a)).max(axis=0) / acceleration,
        np.abs(np.diff(v, axis=0) / h).max(axis=0) / acceleration,
    ]
    if len(mean) > 1:
        bend = 2.0 * np.diff(mean, axis=0) / (h[1:] + h[:-1])
        changes.append(np.abs(bend).max(axis=0) / acceleration)
    return float(np.max(speeds)), float(np.max(changes))


def distance_from_strip(robot: RobotModel, coordinates: np.ndarray, nodes: np.ndarray) -> tuple[float, float, float]:
    """Farthest that rows (M, nv) come from the arcs between nodes: base [m], yaw [rad], joints [rad or m].

    Each row is compared with the point of the strip that is nearest in all coordinates, to a fraction of a millimetre.
    """
    first = robot.space.base_nv
    v = robot.space.difference(nodes[:-1], nodes[1:])
    s = np.linspace(0.0, 1.0, 257)[:, None]
    dense = np.vstack(
        [robot.space.integrate(np.repeat(a[None], 257, axis=0), s * b) for a, b in zip(nodes, v, strict=False)]
    )

    def features(rows: np.ndarray) -> np.ndarray:
        base = [rows[:, 0], rows[:, 1], 0.25 * np.cos(rows[:, 2]), 0.25 * np.sin(rows[:, 2])] if first else []
        return np.column_stack([*base, 0.25 * rows[:, first:]])

    _, near = cKDTree(features(dense)).query(features(coordinates))
    gap = np.abs(robot.space.difference(coordinates, dense[near]))
    base = np.hypot(gap[:, 0], gap[:, 1]).max() if first else 0.0
    yaw = gap[:, 2].max() if first else 0.0
    return float(base), float(yaw), float(gap[:, first:].max(initial=0.0))
