"""Planar poses (x, y, yaw) on plain floats: one pose at a time, several times as fast as small arrays."""

from __future__ import annotations

import math

Pose = tuple[float, float, float]
"""x, y [m], yaw [rad], or a twist v_x, v_y, ω in the body's frame that takes unit time."""


def exp(twist: Pose) -> Pose:
    """The pose reached along a twist in unit time."""
    vx, vy, turn = twist
    if abs(turn) < 1e-4:
        s, k = 1.0 - turn * turn / 6.0, 0.5 * turn
    else:
        s, k = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
    return s * vx - k * vy, k * vx + s * vy, turn


def log(pose: Pose) -> Pose:
    """The twist that leads to a pose in unit time, by the shorter turn."""
    x, y, turn = pose
    turn = math.atan2(math.sin(turn), math.cos(turn))
    half = 0.5 * turn
    alpha = 1.0 - turn * turn / 12.0 if abs(turn) < 1e-4 else half / math.tan(half)
    return alpha * x + half * y, alpha * y - half * x, turn


def compose(a: Pose, b: Pose) -> Pose:
    """The pose ``b`` in the frame of the pose ``a``."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return a[0] + cos * b[0] - sin * b[1], a[1] + sin * b[0] + cos * b[1], a[2] + b[2]


def inverse(a: Pose) -> Pose:
    """The pose of the world in the frame of ``a``."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return -cos * a[0] - sin * a[1], sin * a[0] - cos * a[1], -a[2]
