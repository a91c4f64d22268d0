"""Paths: polylines made smooth enough for wheels and joints to follow without a jump in speed.

A spline in drive coordinates rounds the polyline's corners. That leads the base aside by millimetres; small shapes in
the wheels' travel, one set for every half metre, lead it back (:mod:`.following`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import ElasticStripsError
from ..robot import RobotModel
from ..robot.space import Array
from ..summary import Summary
from .following import follow
from .limits import MotionLimits
from .polyline import Polyline, spread
from .spline import Curve, greville

_GAP = 0.04  # knots are at least this far apart [m]
_AHEAD = float(np.cos(np.radians(75.0)))  # of the angle between the velocity at the start and the path
_GRID = 0.03  # largest step of the grid on which a path is timed [m]
_MIN_GRID = 16
_RANGE_SLACK = 1e-6  # [rad or m]


class RetimingError(ElasticStripsError):
    """A path cannot be driven as asked: no room to brake, a start velocity off the path, limits that cannot be kept."""


@dataclass(frozen=True, eq=False, repr=False)
class DrivePath(Summary):
    """A smooth path in drive coordinates.

    Attributes:
        start: (nv,) chart row where it starts.
        curve: the travel of drive and joints over the length.
        grid: (G,) lengths on which it is timed, with every knot among them.
        y1, y2: (G, m) derivatives on the grid.
        target: (nv,) chart row on the strip where it is to end.
    """

    start: Array
    curve: Curve
    grid: Array
    y1: Array
    y2: Array
    target: Array

    @property
    def length(self) -> float:
        return self.curve.length

    def finer(self, count: int) -> DrivePath:
        """The same path on a grid with ``count`` steps for each of its own."""
        part = np.arange(count) / count
        step = self.grid[1:] - self.grid[:-1]
        grid = np.append((self.grid[:-1, None] + part * step[:, None]).ravel(), self.grid[-1])
        _, y1, y2 = self.curve(grid)
        return replace(self, grid=grid, y1=y1, y2=y2)


def smooth_path(
    robot: RobotModel,
    limits: MotionLimits,
    line: Polyline,
    length: float,
    *,
    weight: Array,
    heading: Array | None = None,
    bend: Array | None = None,
    lead: float = _GAP,
    window: float = 0.5,
    refine: int = 1,
) -> DrivePath:
    """A smooth path from the first node along a polyline.

    Args:
        robot, limits: whose.
        line: the polyline.
        length: where to end [m in the metric], at most at the first stop.
        weight: (m,) the metric.
        heading: (m,) direction of the velocity at the start, in which the path begins; None from rest.
        bend: (m,) second derivative by length with which it begins; None for any.
        lead: nodes nearer to the start than this are no knots [m].
        window: about the length of way in which the base is led back to the strip [m].
        refine: knots per node; more of them round the corners less, and slow the robot there.

    Raises:
        RetimingError: the heading points away from the path, or would take a joint out of its range.
    """
    s = line.s[: int(np.searchsorted(line.s, length - 1e-12)) + 1].copy()
    s[-1] = length
    knots = s[spread(s, _GAP)]
    knots = knots[(knots == 0.0) | (knots >= min(lead, length))]
    if refine > 1:
        part = np.arange(refine) / refine
        knots = np.append((knots[:-1, None] + part * np.diff(knots)[:, None]).ravel(), knots[-1])
    control = line.travel(greville(knots))
    if heading is not None:
        slope = heading / np.linalg.norm(heading * weight)
        first = line.travel(knots[1:2])[0] * weight
        if slope * weight @ first < _AHEAD * np.linalg.norm(first):
            raise RetimingError(
                "the velocity at the start points away from the path, by more than 75° in drive coordinates; keep to "
                "the trajectory that the robot drives until it is slower"
            )
        control[1] = slope * (knots[1] / 3.0)
        if bend is not None and len(knots) > 2:
            control[2] = control[1] + (slope + bend * (0.5 * knots[1])) * (knots[2] / 3.0)
        _keep_range(robot, limits, line.chart[0], control)
    curve = Curve.near(knots, control)
    if limits.drive_dim:
        curve = follow(robot.space, limits, line, curve, window, panels=12 * refine)
    grid = _grid(knots)
    _, y1, y2 = curve(grid)
    return DrivePath(line.chart[0], curve, grid, y1, y2, line.pose(robot.space, np.array([length]))[0])


def _keep_range(robot: RobotModel, limits: MotionLimits, start: Array, control: Array) -> None:
    """Keep the control points off the polyline within the joints' range: no others could lie outside it.

    The first of them is the velocity, which may change by no more than 1e-4; the second is only the bend.
    """
    base = robot.space.base_nv
    joints = control[1:3, limits.drive_dim :]
    low = np.minimum(robot.space.lower[base:] - start[base:], 0.0)
    high = np.maximum(robot.space.upper[base:] - start[base:], 0.0)
    outside = (joints[0] < low - _RANGE_SLACK) | (joints[0] > high + _RANGE_SLACK)
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        raise RetimingError(
            f"joint {robot.joint_names[i]!r} moves so fast at the start that it would leave its range "
            f"[{robot.space.lower[base + i]:.4g}, {robot.space.upper[base + i]:.4g}]; keep to the trajectory that the "
            "robot drives"
        )
    np.clip(joints, low, high, out=joints)


def _grid(knots: Array) -> Array:
    """Lengths for timing: steps of about equal size with every knot among them."""
    step = min(_GRID, float(knots[-1]) / _MIN_GRID)
    h = knots[1:] - knots[:-1]
    count = np.maximum(np.ceil(h / step - 1e-9), 2).astype(int)
    first = np.repeat(np.cumsum(count) - count, count)
    part = (np.arange(count.sum()) - first) / np.repeat(count, count)
    return np.append(np.repeat(knots[:-1], count) + part * np.repeat(h, count), knots[-1])


def integrate_travel(robot: RobotModel, limits: MotionLimits, start: Array, y: Array) -> Array:
    """Chart rows (G, nv) along travels ``y`` (G, m) from the chart row ``start``: exact arcs between them."""
    space = robot.space
    step = limits.to_tangent(y[1:] - y[:-1])
    chart = np.empty((len(y), space.nv))
    base = space.base_nv
    chart[:, base:] = start[base:] + (y[:, limits.drive_dim :] - y[0, limits.drive_dim :])
    if base:
        local = space.integrate(np.zeros_like(step), step)
        chart[0, :3] = start[:3]
        chart[1:, 2] = start[2] + np.cumsum(step[:, 2])
        cos, sin = np.cos(chart[:-1, 2]), np.sin(chart[:-1, 2])
        chart[1:, 0] = start[0] + np.cumsum(cos * local[:, 0] - sin * local[:, 1])
        chart[1:, 1] = start[1] + np.cumsum(sin * local[:, 0] + cos * local[:, 1])
    return chart
