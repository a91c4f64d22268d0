"""Figs. 5 to 11 of the paper as plots seen from above, in millimetres; extra ``study``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.coal_shapes import ShapeKind, shape_of, support_points
from elastic_strips.collision import BodySet
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Obstacle, Scene

from .simulation import PaperRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MM_PER_M = 1e3
_BASE, _ARM, _LINE, _PATH, _SENSED = "#3b6ea5", "#d9822b", "#999999", "#1a1a1a", "#b3261e"
_OBSTACLE, _SAFE = "#c9c9c9", "#e2b4b0"


class Outline:
    """Workspace: a robot seen from above.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._bodies = BodySet.links(robot)
        self._points = [support_points(g) for g in self._bodies.geometries]
        self._kin = Kinematics(robot.tree, 1)
        base = 1 if robot.space.planar else 0
        self._of_base = np.flatnonzero(self._bodies.joint == base)
        self._robot = robot

    def base(self, coordinates: Array) -> Array:
        """(K, 2) corners [m] of the hull of all bodies that are fixed to the base."""
        return self._hull(coordinates, self._of_base)

    def arm(self, coordinates: Array) -> Array:
        """(C, 2) the arm's control points [m], from the first joint to the hand."""
        q = self._robot.space.from_coordinates(coordinates)
        return np.asarray(self._robot.control_points(q))[1:, :2]

    def _hull(self, coordinates: Array, bodies: Indices) -> Array:
        self._kin.update(coordinates[None], jacobians=False)
        turn, move = self._bodies.placements(self._kin, np.zeros(len(bodies), dtype=np.intp), bodies)
        clouds = [
            _grown((self._points[g][0] @ turn[k].T + move[k])[:, :2], self._points[g][1]) for k, g in enumerate(bodies)
        ]
        return _outline(np.vstack(clouds))


def draw_scene(axes: Axes, scene: Scene, safe: float | None = None) -> None:
    """Draw obstacles, each with its safe distance [m] about it where that is given."""
    from matplotlib.patches import Circle, Polygon

    for obstacle in scene:
        for shape, size in _shapes(obstacle):
            if not isinstance(shape, np.ndarray):
                x, y = _MM_PER_M * size
                axes.add_patch(Circle((x, y), _MM_PER_M * shape, facecolor=_OBSTACLE, edgecolor="k", lw=0.8, zorder=2))
                if safe is not None:
                    axes.add_patch(
                        Circle((x, y), _MM_PER_M * (shape + safe), fill=False, edgecolor=_SAFE, ls="--", lw=0.8)
                    )
                continue
            axes.add_patch(Polygon(_MM_PER_M * shape, facecolor=_OBSTACLE, edgecolor="k", lw=0.8, zorder=2))
            if safe is not None:
                grown = _outline(_grown(shape, safe))
                axes.add_patch(Polygon(_MM_PER_M * grown, fill=False, edgecolor=_SAFE, ls="--", lw=0.8))
        x, y = _MM_PER_M * obstacle.pose[:2, 3]
        axes.annotate(obstacle.name or "", (x, y), fontsize=6, ha="center", va="center", zorder=6)


def _draw_postures(axes: Axes, robot: RobotModel, coordinates: Array, *, arm: bool, label: str) -> None:
    """Draw a robot at coordinate rows (T, nv), darker as time goes on."""
    from matplotlib.patches import Polygon

    outline = Outline(robot)
    for k, row in enumerate(coordinates):
        alpha = 0.25 + 0.75 * (k + 1) / len(coordinates)
        axes.add_patch(
            Polygon(_MM_PER_M * outline.base(row), fill=False, edgecolor=_BASE, alpha=alpha, lw=0.8, zorder=3)
        )
        if arm:
            points = _MM_PER_M * outline.arm(row)
            axes.plot(points[:, 0], points[:, 1], "-", color=_ARM, alpha=alpha, lw=0.9, zorder=4)
    axes.plot([], [], "-", color=_BASE, label=label)


def draw_paper_run(axes: Axes, run: PaperRun, *, every: int = 3) -> None:
    """Draw a run with preset ``paper``: original line, postures, detections, safe distances."""
    arm = not run.params.mobile_only
    draw_scene(axes, run.scenario.scene, run.params.influence)
    axes.plot(*(_MM_PER_M * run.line.T), ":", color=_LINE, lw=1.0, label="original line", zorder=1)
    axes.plot(*(_MM_PER_M * run.coordinates[:, :2].T), "-", color=_PATH, lw=1.0, label="way of the mobile", zorder=5)
    if len(run.ahead) > 2:
        axes.plot(*(_MM_PER_M * run.ahead[:, :2].T), ".-", color=_SENSED, lw=0.8, ms=3, label="strip ahead", zorder=5)
    rows = run.coordinates[:: max(1, every)]
    _draw_postures(axes, run.robot, np.vstack((rows, run.coordinates[-1:])), arm=arm, label="postures")
    for k, detection in enumerate(run.detections):
        here, there = _MM_PER_M * np.array(detection.robot), _MM_PER_M * np.array(detection.point[:2])
        axes.plot(*np.stack((here, there)).T, "-", color=_SENSED, lw=0.6, zorder=5)
        axes.plot(*there, "x", color=_SENSED, ms=4, zorder=6, label="sensed points" if k == 0 else None)
    _finish(axes, run.line)


def draw_drive(axes: Axes, robot: RobotModel, scene: Scene, line: Array, coordinates: Array, *, arm: bool) -> None:
    """Draw a drive with preset ``default``, from coordinate rows (T, nv) of its true states."""
    draw_scene(axes, scene)
    axes.plot(*(_MM_PER_M * line.T), ":", color=_LINE, lw=1.0, label="original line", zorder=1)
    axes.plot(*(_MM_PER_M * coordinates[:, :2].T), "-", color=_PATH, lw=1.0, label="way of the mobile", zorder=5)
    picked = np.linspace(0, len(coordinates) - 1, 21).round().astype(int)
    _draw_postures(axes, robot, coordinates[picked], arm=arm, label="postures")
    _finish(axes, line)


def _finish(axes: Axes, line: Array) -> None:
    """Start, target, labels, and a frame about the line (N, 2) [m]."""
    axes.plot(*(_MM_PER_M * line[0]), "s", color="k", ms=5, zorder=7)
    axes.plot(*(_MM_PER_M * line[-1]), "*", color="k", ms=9, zorder=7)
    low, high = _MM_PER_M * (line.min(axis=0) - 1.2), _MM_PER_M * (line.max(axis=0) + 1.2)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.tick_params(labelsize=7)
    axes.legend(fontsize=6, loc="lower right", framealpha=0.9)


def _shapes(obstacle: Obstacle) -> Iterable[tuple[float | Array, Array]]:
    """Outlines of an obstacle from above: (radius, middle) of round parts, or (corners, middle) [m]."""
    rotation, shift = obstacle.pose[:3, :3], obstacle.pose[:3, 3]
    upright = abs(float(rotation[2, 2])) > 0.999
    for part in obstacle.parts:
        middle = (rotation @ part.center + shift)[:2]
        kind, size = shape_of(part.geometry)
        if kind is ShapeKind.SPHERE or (upright and kind in (ShapeKind.CYLINDER, ShapeKind.CONE)):
            yield size[0], middle
            continue
        if part.geometry is None:
            signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
            points, radius = part.center + signs * part.half_extents, 0.0
        else:
            local, radius = support_points(part.geometry)
            points = local + part.T_obstacle_part[:3, 3]
        yield _outline(_grown((points @ rotation.T + shift)[:, :2], radius)), middle


def _grown(points: Array, radius: float) -> Array:
    """Points (K, 2) with a circle about each, where there is a radius [m]."""
    if radius <= 0.0:
        return points
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = radius * np.column_stack((np.cos(angle), np.sin(angle)))
    return (points[:, None] + circle[None]).reshape(-1, 2)


def _outline(points: Array) -> Array:
    """Corners of the convex hull of points (K, 2), in turn."""
    from scipy.spatial import ConvexHull  # late: slow to import

    return points[ConvexHull(points).vertices]
