"""Paths: nodes of a strip as smooth travel of wheels and joints, without a jump in speed.

A spline in drive coordinates rounds the polyline's corners. That leads the base aside by millimetres; small shapes in
the wheels' travel, one set for every half metre, lead it back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from elastic_strips.arrays import Array, Indices, by_rows
from elastic_strips.errors import ElasticStripsError
from elastic_strips.native import kernel
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import ConfigurationSpace
from elastic_strips.summary import Summary

from .limits import MotionLimits, sliding_joints

_ANGLE_LEVER = 0.25
"""Length that makes an angle comparable with a travel [m/rad]: of joints, and of the yaw of an omnidirectional base."""

_MERGED_DISTANCE = 2e-3  # nodes nearer to each other than this say nothing about a direction [m]
_CORNER_COSINE = float(np.cos(np.radians(50.0)))  # of a turn in drive coordinates: a sharper one needs a stop


def metric(robot: RobotModel, limits: MotionLimits) -> Array:
    """(k + n,) weights w of the length ‖w·dy‖ of a step dy in drive coordinates and joints, [m] per unit each.

    Driving straight counts the base's travel; turning in place that of a rim over √2; a joint counts its lever.
    """
    k = limits.drive_dim
    drive = {0: [], 2: [np.sqrt(0.5)] * 2, 3: [1.0, 1.0, _ANGLE_LEVER]}[k]
    return np.concatenate([drive, np.where(sliding_joints(robot), 1.0, _ANGLE_LEVER)])


@dataclass(frozen=True, eq=False)
class Polyline:
    """The nodes of a strip in drive coordinates.

    Attributes:
        coordinates: (K, nv) nodes.
        tangent: (K−1, nv) segments.
        y: (K, m) travel of drive and joints since the first node.
        s: (K,) length since the first node, in the metric [m].
        stops: nodes at which the robot has to stop, ascending; the last one is K−1.
    """

    coordinates: Array
    tangent: Array
    y: Array
    s: Array
    stops: Indices

    def travel(self, s: Array) -> Array:
        """Travel (G, m) at lengths ``s`` (G,)."""
        i, part = self._segment(s)
        return self.y[i] + part * (self.y[i + 1] - self.y[i])

    def pose(self, space: ConfigurationSpace, s: Array) -> Array:
        """Coordinate rows (G, nv) at lengths ``s`` (G,), on the arcs between the nodes."""
        i, part = self._segment(s)
        return space.integrate(self.coordinates[i], part * self.tangent[i])

    def _segment(self, s: Array) -> tuple[Indices, Array]:
        """The segment (G,) that each length is in, and which part (G, 1) of it lies behind."""
        i = np.searchsorted(self.s[1:-1], s, side="right")
        h = self.s[i + 1] - self.s[i]
        return i, ((s - self.s[i]) / np.where(h > 0.0, h, 1.0))[:, None]


def polyline(
    robot: RobotModel, limits: MotionLimits, weight: Array, coordinates: Array, heading: Array | None = None
) -> Polyline:
    """The nodes (K, nv), K ≥ 2, as travel of drive and joints.

    Args:
        robot, limits: the robot and its limits.
        weight: (m,) the metric.
        coordinates: (K, nv).
        heading: (m,) direction of the velocity with which the robot arrives at the first node; None where it rests
            there.
    """
    tangent = robot.space.difference(coordinates[:-1], coordinates[1:])
    dy = limits.to_coordinates(tangent)
    y = np.zeros((len(coordinates), dy.shape[1]))
    np.cumsum(dy, axis=0, out=y[1:])
    s = np.zeros(len(coordinates))
    np.cumsum(np.sqrt(((dy * weight) ** 2).sum(axis=1)), out=s[1:])
    return Polyline(coordinates, tangent, y, s, _stops(y * weight, s, None if heading is None else heading * weight))


def _stops(y: Array, s: Array, heading: Array | None) -> Indices:
    """Nodes where the path turns too sharply for wheels and joints to follow without a stop; and the last one.

    A change between forwards and backwards is one of them, unless the base turns so fast about it that no wheel and no
    joint changes its speed abruptly.
    """
    nodes = thinned(s, _MERGED_DISTANCE, merge_first=heading is None)
    points = y[nodes]
    if heading is not None:  # the robot comes from behind the first node, so a corner right ahead is still one
        points[0] = -0.05 * heading / np.linalg.norm(heading)
    step = points[1:] - points[:-1]
    length = np.linalg.norm(step, axis=1)
    stop = (step[:-1] * step[1:]).sum(axis=1) < _CORNER_COSINE * length[:-1] * length[1:]
    return np.append(nodes[1:-1][stop], nodes[-1])


def thinned(s: Array, gap: float, *, merge_first: bool = True) -> Indices:
    """Indices of the nodes that stay where those nearer than ``gap`` to the one before are dropped; both ends stay.

    Without ``merge_first`` the first node ahead stays even where it is nearer.
    """
    last = len(s) - 1
    if (s[1:] - s[:-1] >= gap).all():
        return np.arange(last + 1)
    kept = [0]
    for i in range(1, last):
        if s[i] - s[kept[-1]] >= gap or (len(kept) == 1 and not merge_first and s[i] > 0.0):
            kept.append(i)
    if len(kept) > 1 and s[last] - s[kept[-1]] < gap:
        kept.pop()
    return np.array([*kept, last])


# Powers of u in [0, 1], ascending: a step from 0 to 1, a bump, a bump that changes its sign; the bumps at most about 1
# high. First and second derivatives vanish at both ends, so a piece that has them joins its neighbours smoothly.
_SHAPES = np.array(
    [
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 64.0, -192.0, 192.0, -64.0, 0.0],
        [0.0, 0.0, 0.0, -256.0, 1280.0, -2304.0, 1792.0, -512.0],
    ]
)
_SLOPES = _SHAPES[:, 1:] * np.arange(1, _SHAPES.shape[1])
_BENDS = _SLOPES[:, 1:] * np.arange(1, _SLOPES.shape[1])
SHAPES = len(_SHAPES)


def shapes(u: Array) -> tuple[Array, Array, Array]:
    """(G, SHAPES) values at ``u`` (G,) in [0, 1] of the step, the bump and the odd bump, and two derivatives by u."""
    powers = np.vander(u, _SHAPES.shape[1], increasing=True)
    return powers @ _SHAPES.T, powers[:, :-1] @ _SLOPES.T, powers[:, :-2] @ _BENDS.T


def greville(knots: Array) -> Array:
    """(K + 2,) places of the control points of :meth:`Curve.near` over ``knots`` (K,)."""
    t = np.concatenate([[knots[0]] * 2, knots, [knots[-1]] * 2])
    return (t[:-2] + t[1:-1] + t[2:]) / 3.0


@dataclass(frozen=True, eq=False)
class Curve:
    """A twice continuously differentiable curve y(s), s in [0, length].

    Attributes:
        knots: (K,) ascending from 0.
        coefficients: (4, K−1, m) of the pieces, for powers 0 to 3 of s − knot.
        edges: (W + 1,) ends of the windows that have shapes, ascending from 0 to the length.
        weights: (W, SHAPES, m) of the shapes in each; None where there are none.
    """

    knots: Array
    coefficients: Array
    edges: Array
    weights: Array | None = None

    @staticmethod
    def near(knots: Array, control: Array) -> Curve:
        """The cubic spline with the control points (K + 2, m) at the places :func:`greville` of its knots (K,), K ≥ 2.

        With control points of a polyline this is Schoenberg's variation-diminishing spline: it meets both ends in the
        polyline's direction, reproduces straight parts and never leaves the convex hull of the control points; so it
        neither overshoots a joint's range nor swings, as a spline through the points would.
        """
        t = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
        h = (knots[1:] - knots[:-1])[:, None]
        first = 3.0 * (control[1:] - control[:-1]) / (t[4:-1] - t[1:-4])[:, None]  # control points of y′ (K + 1)
        bend = 2.0 * (first[1:] - first[:-1]) / (t[4:-2] - t[2:-4])[:, None]  # y″ at the knots (K)
        slope = np.empty_like(bend)  # y′ at the knots
        slope[0], slope[-1] = first[0], first[-1]
        slope[1:-1] = (h[1:] * first[1:-2] + h[:-1] * first[2:-1]) / (h[1:] + h[:-1])
        rise = h * (slope[:-1] + h * (2.0 * bend[:-1] + bend[1:]) / 6.0)
        value = control[0] + np.concatenate([np.zeros((1, control.shape[1])), np.cumsum(rise[:-1], axis=0)])
        cubic = (bend[1:] - bend[:-1]) / (6.0 * h)
        return Curve(knots, np.stack([value, slope[:-1], 0.5 * bend[:-1], cubic]), knots[[0, -1]])

    @property
    def length(self) -> float:
        """Where s ends [m in the metric]."""
        return float(self.knots[-1])

    def __call__(self, s: Array) -> tuple[Array, Array, Array]:
        """y, y′ and y″ (G, m) at ``s`` (G,)."""
        if (native := kernel()) is not None:
            out = np.empty((3, len(s), self.coefficients.shape[2]))
            weights = None if self.weights is None else by_rows(self.weights)[0]
            knots, coefficients, edges, at = by_rows(self.knots, self.coefficients, self.edges, s)
            native.travel_at(knots, coefficients, edges, weights, at, out)
            return out[0], out[1], out[2]
        i = np.searchsorted(self.knots[1:-1], s, side="right")
        x = (s - self.knots[i])[:, None]
        c0, c1, c2, c3 = self.coefficients[:, i]
        y = c0 + x * (c1 + x * (c2 + x * c3))
        y1 = c1 + x * (2.0 * c2 + 3.0 * x * c3)
        y2 = 2.0 * c2 + 6.0 * x * c3
        if self.weights is not None:
            j = np.searchsorted(self.edges[1:-1], s, side="right")
            u = (s - self.edges[j]) / (self.edges[j + 1] - self.edges[j])
            weight, width = self.weights[j], (self.edges[1:] - self.edges[:-1])[j, None]
            before = np.cumsum(self.weights[:, 0], axis=0) - self.weights[:, 0]  # a step stays
            value, rate, bend = (shape[:, None] for shape in shapes(u))
            y += before[j] + (value @ weight)[:, 0]
            y1 += (rate @ weight)[:, 0] / width
            y2 += (bend @ weight)[:, 0] / (width * width)
        return y, y1, y2


_LARGEST_SHAPE = 0.1  # largest shape, as a part of its window's length: more would swing
_NO_DISTANCE = 1e-6  # distance from the strip that counts as none [m]
_MOST_ITERATIONS = 6
_STALLED_SHARE = 0.9  # of the best so far: what is left has no room in any window
_TIE_RATIO = 1.0 + 1e-9  # the later of two that miss as much: the worst window may have no room, and others may
_INTEGRAL_PANELS = 12  # of the integral over a window

# Shapes to use, as (body's x, y or yaw; step, bump or odd bump). A step in yaw would turn all windows behind it.
_ROLLING = (0, 0), (0, 1), (0, 2), (2, 1), (2, 2)
_SLIDING = (0, 0), (1, 0)


def corrected(space: ConfigurationSpace, limits: MotionLimits, line: Polyline, curve: Curve, window: float) -> Curve:
    """The curve with shapes that bring the base onto the strip at the end of every window of its length.

    The yaw is a sum of travels: it depends on y alone, and no shape used changes it at the end of a window. So how far
    the base gets in a window depends on the shapes in it alone, and all windows are solved at once (Gauss–Newton), two
    equations each. What one has no room for is left to the next.

    Args:
        space: the robot's, with a planar root.
        limits: for the drive coordinates.
        line: the strip's polyline; the curve starts at its first node.
        curve: the travel over length; it has no shapes yet.
        window: about the length of a window [m].
    """
    count = max(round(curve.length / window), 1)
    edges = curve.length * np.arange(count + 1) / count
    width = curve.length / count
    start, k = line.coordinates[0], limits.drive_dim
    target = line.pose(space, edges[1:])[:, :2]
    points, value, rate = _gauss()
    y, y1, _ = curve((edges[:-1, None] + width * points).ravel())
    yaw = start[2] + limits.to_twist(y[:, :k])[:, 2].reshape(count, -1)
    twist = limits.to_twist(y1[:, :k]).reshape(count, -1, 3)
    lever = 0.5 * limits.track if k == 2 else _ANGLE_LEVER
    best = np.zeros((count, SHAPES, 3))  # of travel in the body's x and y, and of lever × yaw [m]
    if (native := kernel()) is not None:
        native.lead_base(
            *by_rows(yaw, twist, value, rate, target - start[:2]),
            width,
            lever,
            k == 2,
            _LARGEST_SHAPE,
            _NO_DISTANCE,
            _STALLED_SHARE,
            _MOST_ITERATIONS,
            best,
        )
    else:
        best = _lead_base(yaw, twist, target - start[:2], width, lever, _ROLLING if k == 2 else _SLIDING)
    if not best.any():
        return curve
    drive = np.zeros((count, SHAPES, y.shape[1]))
    drive[..., :k] = limits.to_drive(best / [1.0, 1.0, lever])
    return replace(curve, edges=edges, weights=drive)


def _lead_base(
    yaw: Array, twist: Array, target: Array, width: float, lever: float, parts: Sequence[tuple[int, int]]
) -> Array:
    """Weights (W, SHAPES, 3) that bring the base to ``target`` (W, 2) from where it starts; the twin of `lead_base`.

    Args:
        yaw: (W, Q) at the points of the windows.
        twist: (W, Q, 3) per length there.
        target: see above.
        width: length of a window.
        lever: that makes a yaw a travel [m/rad].
        parts: shapes to use.
    """
    _, value, rate = _gauss()
    part = np.full(len(value), 1.0 / len(value))
    count = len(target)
    weights = np.zeros((count, SHAPES, 3))
    full = np.zeros(count, dtype=bool)
    best, least = weights, np.inf
    for iteration in range(_MOST_ITERATIONS):
        angle = yaw + weights[:, :, 2] @ value.T / lever
        vx = twist[..., 0] + weights[:, :, 0] @ rate.T / width
        vy = twist[..., 1] + weights[:, :, 1] @ rate.T / width
        cos, sin = np.cos(angle), np.sin(angle)
        px, py = cos * vx - sin * vy, sin * vx + cos * vy  # the base's motion per length
        miss = target - width * np.cumsum(np.stack([px @ part, py @ part], axis=1), axis=0)
        worst = float(np.abs(miss).max())
        stalled = iteration > 1 and worst > _STALLED_SHARE * least
        if worst < _TIE_RATIO * least:
            best, least = weights, worst
        if worst < _NO_DISTANCE or stalled or iteration == _MOST_ITERATIONS - 1:
            break
        ask = miss.copy()
        ask[1:] -= np.where(full[:-1, None], 0.0, miss[:-1])
        jacobian = np.empty((count, 2, len(parts)))
        for i, (axis, c) in enumerate(parts):
            along = part * (rate[:, c] if axis < 2 else value[:, c] * (width / lever))
            directions = ((cos, sin), (-sin, cos), (-py, px))[axis]
            jacobian[:, 0, i], jacobian[:, 1, i] = directions[0] @ along, directions[1] @ along
        square = jacobian @ jacobian.transpose(0, 2, 1) + 1e-6 * np.eye(2)
        step = (np.linalg.solve(square, ask[..., None]).transpose(0, 2, 1) @ jacobian)[:, 0]
        weights = weights.copy()
        for i, (axis, c) in enumerate(parts):
            weights[:, c, axis] += step[:, i]
        size = np.abs(weights).max(axis=(1, 2)) / (_LARGEST_SHAPE * width)
        full = size > 1.0
        weights[full] /= size[full, None, None]
    return best


@cache
def _gauss() -> tuple[Array, Array, Array]:
    """Points (Q,) in [0, 1] of the two-point Gauss rule in equal panels, and the shapes (Q, SHAPES) and their rates."""
    offset = 0.5 / np.sqrt(3.0)
    points = (np.arange(_INTEGRAL_PANELS)[:, None] + [0.5 - offset, 0.5 + offset]).ravel() / _INTEGRAL_PANELS
    return (points, *shapes(points)[:2])


_LEAST_KNOT_GAP = 0.04  # knots are at least this far apart [m]
_AHEAD_COSINE = float(np.cos(np.radians(75.0)))  # of the angle between the velocity at the start and the path
_LARGEST_GRID_STEP = 0.03  # largest step of the grid on which a path is timed [m]
_MIN_GRID = 16
_RANGE_SLACK = 1e-6  # [rad or m]


class RetimingError(ElasticStripsError):
    """A path cannot be driven as requested: it has no room to brake, starts off the path, or limits are too low."""


@dataclass(frozen=True, eq=False, repr=False)
class DrivePath(Summary):
    """A smooth path in drive coordinates.

    Attributes:
        start: (nv,) coordinate row where it starts.
        curve: the travel of drive and joints over the length.
        grid: (G,) lengths at which it is timed, with every knot among them.
        y1, y2: (G, m) derivatives on the grid.
    """

    start: Array
    curve: Curve
    grid: Array
    y1: Array
    y2: Array

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
    lead: float = _LEAST_KNOT_GAP,
    window: float = 0.5,
) -> DrivePath:
    """A smooth path from the first node along a polyline.

    Args:
        robot, limits: whose.
        line: the polyline.
        length: length at which to end [m in the metric], at most at the first stop.
        weight: (m,) the metric.
        heading: (m,) direction of the velocity at the start, in which the path begins; None where it starts from rest.
        bend: (m,) second derivative by length with which it begins; None where any will do.
        lead: nodes nearer to the start than this [m] do not become knots.
        window: about the length of path in which the base is led back to the strip [m].

    Raises:
        RetimingError: the heading points away from the path, or would take a joint out of its range.
    """
    s = line.s[: int(np.searchsorted(line.s, length - 1e-12)) + 1].copy()
    s[-1] = length
    knots = s[thinned(s, _LEAST_KNOT_GAP)]
    knots = knots[(knots == 0.0) | (knots >= min(lead, length))]
    control = line.travel(greville(knots))
    if heading is not None:
        slope = heading / np.linalg.norm(heading * weight)
        first = line.travel(knots[1:2])[0] * weight
        if slope * weight @ first < _AHEAD_COSINE * np.linalg.norm(first):
            raise RetimingError(
                "the robot still moves away from where the path goes on, at an angle of more than 75°; it has to stop "
                "before it can follow that"
            )
        control[1] = slope * (knots[1] / 3.0)
        if bend is not None and len(knots) > 2:
            control[2] = control[1] + (slope + bend * (0.5 * knots[1])) * (knots[2] / 3.0)
        _keep_range(robot, limits, line.coordinates[0], control)
    curve = Curve.near(knots, control)
    if limits.drive_dim:
        curve = corrected(robot.space, limits, line, curve, window)
    grid = _grid(knots)
    _, y1, y2 = curve(grid)
    return DrivePath(line.coordinates[0], curve, grid, y1, y2)


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
    step = min(_LARGEST_GRID_STEP, float(knots[-1]) / _MIN_GRID)
    h = knots[1:] - knots[:-1]
    count = np.maximum(np.ceil(h / step - 1e-9), 2).astype(int)
    first = np.repeat(np.cumsum(count) - count, count)
    part = (np.arange(count.sum()) - first) / np.repeat(count, count)
    return np.append(np.repeat(knots[:-1], count) + part * np.repeat(h, count), knots[-1])


def integrate_travel(robot: RobotModel, limits: MotionLimits, start: Array, y: Array) -> Array:
    """Coordinate rows (G, nv) along travels ``y`` (G, m) from the coordinate row ``start``: exact arcs between them."""
    space = robot.space
    step = limits.to_tangent(y[1:] - y[:-1])
    coordinates = np.empty((len(y), space.nv))
    base = space.base_nv
    coordinates[:, base:] = start[base:] + (y[:, limits.drive_dim :] - y[0, limits.drive_dim :])
    if base:
        local = space.integrate(np.zeros_like(step), step)
        coordinates[0, :3] = start[:3]
        coordinates[1:, 2] = start[2] + np.cumsum(step[:, 2])
        cos, sin = np.cos(coordinates[:-1, 2]), np.sin(coordinates[:-1, 2])
        coordinates[1:, 0] = start[0] + np.cumsum(cos * local[:, 0] - sin * local[:, 1])
        coordinates[1:, 1] = start[1] + np.cumsum(sin * local[:, 0] + cos * local[:, 1])
    return coordinates
