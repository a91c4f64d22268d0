"""Pilots of a guard's runs: those who mean harm, and one who does not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import Desired
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.trajectory import MotionLimits


@dataclass(frozen=True, slots=True)
class Seen:
    """What a pilot sees: time [s], the robot's estimated coordinate row (nv,), and the last sensed scene."""

    time: float
    coordinates: Array
    scene: Scene


Pilot = Callable[[Seen], Desired | None]


def _held(rng: np.random.Generator, low: float, high: float, draw: Callable[[Seen], Desired | None]) -> Pilot:
    """What ``draw`` gives, each for a random time [s]."""
    until, now = -1.0, None

    def pilot(seen: Seen) -> Desired | None:
        nonlocal until, now
        if seen.time >= until:
            until, now = seen.time + float(rng.uniform(low, high)), draw(seen)
        return now

    return pilot


def _full(robot: RobotModel, limits: MotionLimits, rng: np.random.Generator) -> tuple[Array, Array]:
    """A twist and joint velocities, some of them at their limits."""
    top, twist = limits.drive_speed, np.zeros(3)
    if limits.drive_dim == 2:
        twist[:] = top[0], 0.0, 2.0 * top[0] / limits.track
    elif limits.drive_dim == 3:
        twist[:] = top
    signs = rng.integers(-1, 2, 3 + len(limits.joint_speed)).astype(float)
    return twist * signs[:3], limits.joint_speed * signs[3:]


def drive_towards(robot: RobotModel, limits: MotionLimits, at: Array, target: Array) -> Array:
    """The twist at full speed towards a point (2,)."""
    dx, dy = target - at[:2]
    bearing = math.remainder(math.atan2(dy, dx) - at[2], 2.0 * math.pi)
    speed = float(limits.drive_speed[0])
    if limits.drive_dim == 3:
        return np.array([speed * math.cos(bearing), speed * math.sin(bearing), bearing])
    ahead = abs(bearing) < 0.5 * math.pi
    turn = bearing if ahead else math.remainder(bearing - math.pi, 2.0 * math.pi)
    return np.array([(1.0 if ahead else -1.0) * speed * max(math.cos(turn), 0.0), 0.0, 2.0 * turn])


def _rammer(robot: RobotModel, limits: MotionLimits, rng: np.random.Generator) -> Pilot:
    """Full speed at one of the nearest things, the arm out or anywhere."""
    target, until, joints = "", -1.0, np.zeros(len(limits.joint_speed))

    def pilot(seen: Seen) -> Desired:
        nonlocal target, until, joints
        where = {o.name or "": _nearest_point(o, seen.coordinates[:2]) for o in seen.scene}
        if seen.time >= until or target not in where:
            near = sorted(where, key=lambda name: float(np.hypot(*(where[name] - seen.coordinates[:2]))))
            target, until = near[int(rng.integers(min(4, len(near))))], seen.time + float(rng.uniform(2.0, 4.0))
            joints = limits.joint_speed * rng.integers(-1, 2, len(joints)) * (rng.random() < 0.5)
        twist = drive_towards(robot, limits, seen.coordinates, where[target]) if limits.drive_dim else None
        return Desired(twist=twist if limits.drive_dim else None, joints=joints)

    return pilot


def _nearest_point(obstacle: Obstacle, at: Array) -> Array:
    """About the nearest point (2,) of an obstacle, seen from above."""
    turn, middle = obstacle.pose[:2, :2], obstacle.pose[:2, 3]
    if obstacle.shape != "box":
        return middle
    half = 0.5 * np.asarray(obstacle.spec["size"], dtype=float)[:2]
    return middle + turn @ np.clip(turn.T @ (at - middle), -half, half)


def _jerks(robot: RobotModel, limits: MotionLimits, rng: np.random.Generator) -> Pilot:
    """Everything at its limits, another way every moment."""

    def draw(_: Seen) -> Desired:
        twist, joints = _full(robot, limits, rng)
        return Desired(twist=twist if limits.drive_dim else None, joints=joints)

    return _held(rng, 0.03, 0.6, draw)


def _broken(robot: RobotModel, limits: MotionLimits, rng: np.random.Generator) -> Pilot:
    """Full speed, silence, values that are no numbers, and old commands."""

    def draw(seen: Seen) -> Desired | None:
        twist, joints = _full(robot, limits, rng)
        kind = int(rng.integers(6))
        if kind == 0:
            return None
        if kind == 1:
            twist[int(rng.integers(3))] = math.nan
        if kind == 2:
            joints[int(rng.integers(len(joints)))] = math.inf
        return Desired(
            twist=twist if limits.drive_dim else None, joints=joints, time=seen.time - 1.0 if kind == 3 else None
        )

    return _held(rng, 0.05, 1.0, draw)


def _spinner(robot: RobotModel, limits: MotionLimits, rng: np.random.Generator) -> Pilot:
    """Turns as fast as it can while the arm goes out, and drives into things meanwhile."""

    def draw(_: Seen) -> Desired:
        twist, joints = _full(robot, limits, rng)
        twist[0] = float(rng.uniform(-0.6, 0.6))
        twist[2] = float(rng.choice((-2.0, 2.0)))
        return Desired(twist=twist if limits.drive_dim else None, joints=joints)

    return _held(rng, 1.0, 2.5, draw)


def wanderer(robot: RobotModel, limits: MotionLimits, rng: np.random.Generator) -> Pilot:
    """Random commands that change smoothly."""
    size = 3 + len(limits.joint_speed)
    state, last = np.zeros(size), 0.0
    twist = np.array([*limits.drive_speed[:1], *limits.drive_speed[:1], 1.5]) if limits.drive_dim else np.zeros(3)
    top = np.concatenate((twist, 0.5 * limits.joint_speed))

    def pilot(seen: Seen) -> Desired:
        nonlocal state, last
        step, last = seen.time - last, seen.time
        state = state * math.exp(-step / 1.5) + math.sqrt(1.0 - math.exp(-2.0 * step / 1.5)) * rng.standard_normal(size)
        v = np.clip(state, -1.0, 1.0) * top
        return Desired(twist=v[:3] if limits.drive_dim else None, joints=v[3:])

    return pilot


PILOTS: dict[str, Callable[[RobotModel, MotionLimits, np.random.Generator], Pilot]] = {
    "rammer": _rammer,
    "jerks": _jerks,
    "broken": _broken,
    "spinner": _spinner,
    "wanderer": wanderer,
}
"""Pilots by name; all but the last are hostile."""
