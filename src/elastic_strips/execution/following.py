"""Following: small shapes in the wheels' travel that bring the base of a smooth path back to its strip."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..robot.space import Array, ConfigurationSpace
from .limits import MotionLimits
from .polyline import LEVER, Polyline
from .spline import SHAPES, Curve, shapes

_LARGEST = 0.1  # largest shape, as a part of its window's length: more would swing
_NEAR = 1e-6  # distance from the strip that counts as none [m]
_ITERATIONS = 6

# Shapes to use, as (body's x, y or yaw; step, bump or odd bump). A step in yaw would turn all windows behind it.
_ROLLING = (0, 0), (0, 1), (0, 2), (2, 1), (2, 2)
_SLIDING = (0, 0), (1, 0)


def follow(
    space: ConfigurationSpace, limits: MotionLimits, line: Polyline, curve: Curve, window: float, *, panels: int = 12
) -> Curve:
    """The curve with shapes that bring the base onto the strip at the end of every window of its length.

    The yaw is a sum of travels: it depends on y alone, and no shape used changes it at the end of a window. So how far
    the base gets in a window depends on the shapes in it alone, and all windows are solved at once (Gauss–Newton), two
    equations each. What one has no room for is left to the next.

    Args:
        space: of the robot, with a planar root.
        limits: for the drive coordinates.
        line: the strip's polyline; the curve starts at its first node.
        curve: of travel over length; it has no shapes yet.
        window: about the length of a window [m].
        panels: for the integral over a window; at least one per knot.
    """
    count = max(round(curve.length / window), 1)
    edges = curve.length * np.arange(count + 1) / count
    width = curve.length / count
    start, k = line.chart[0], limits.drive_dim
    target = line.pose(space, edges[1:])[:, :2]
    points, value, rate = _gauss(panels)
    part = np.full(len(points), 1.0 / len(points))
    y, y1, _ = curve((edges[:-1, None] + width * points).ravel())
    yaw = start[2] + limits.to_twist(y[:, :k])[:, 2].reshape(count, -1)
    twist = limits.to_twist(y1[:, :k]).reshape(count, -1, 3)
    lever = 0.5 * limits.track if k == 2 else LEVER
    parts = _ROLLING if k == 2 else _SLIDING
    weights = np.zeros((count, SHAPES, 3))  # of travel in the body's x and y, and of lever × yaw [m]
    full = np.zeros(count, dtype=bool)
    best, least = weights, np.inf
    for iteration in range(_ITERATIONS):
        angle = yaw + weights[:, :, 2] @ value.T / lever
        vx = twist[..., 0] + weights[:, :, 0] @ rate.T / width
        vy = twist[..., 1] + weights[:, :, 1] @ rate.T / width
        cos, sin = np.cos(angle), np.sin(angle)
        px, py = cos * vx - sin * vy, sin * vx + cos * vy  # the base's way per length
        miss = target - start[:2] - width * np.cumsum(np.stack([px @ part, py @ part], axis=1), axis=0)
        worst = float(np.abs(miss).max())
        if worst < least:
            best, least = weights, worst
        if worst < _NEAR or iteration == _ITERATIONS - 1:
            break
        ask = miss.copy()
        ask[1:] -= np.where(full[:-1, None], 0.0, miss[:-1])
        jacobian = np.empty((count, 2, len(parts)))
        for i, (axis, c) in enumerate(parts):
            along = part * (rate[:, c] if axis < 2 else value[:, c] * (width / lever))
            ways = ((cos, sin), (-sin, cos), (-py, px))[axis]
            jacobian[:, 0, i], jacobian[:, 1, i] = ways[0] @ along, ways[1] @ along
        square = jacobian @ jacobian.transpose(0, 2, 1) + 1e-6 * np.eye(2)
        step = (np.linalg.solve(square, ask[..., None]).transpose(0, 2, 1) @ jacobian)[:, 0]
        weights = weights.copy()
        for i, (axis, c) in enumerate(parts):
            weights[:, c, axis] += step[:, i]
        size = np.abs(weights).max(axis=(1, 2)) / (_LARGEST * width)
        full = size > 1.0
        weights[full] /= size[full, None, None]
    if not best.any():
        return curve
    drive = np.zeros((count, SHAPES, y.shape[1]))
    drive[..., :k] = limits.to_drive(best / [1.0, 1.0, lever])
    return curve.shaped(edges, drive)


@cache
def _gauss(panels: int) -> tuple[Array, Array, Array]:
    """Points (Q,) in [0, 1] of the two-point Gauss rule in equal panels, and the shapes (Q, SHAPES) and their rates."""
    offset = 0.5 / np.sqrt(3.0)
    points = (np.arange(panels)[:, None] + [0.5 - offset, 0.5 + offset]).ravel() / panels
    return (points, *shapes(points)[:2])
