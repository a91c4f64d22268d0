"""Polylines: the nodes of a strip as travel of wheels and joints, and where on them the robot has to stop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..robot import RobotModel
from ..robot.space import Array, ConfigurationSpace
from .limits import MotionLimits, prismatic_joints

LEVER = 0.25
"""Length that makes an angle comparable with a travel [m/rad]: of joints, and of the yaw of an omnidirectional base."""

_MERGE = 2e-3  # nodes nearer to each other than this say nothing about a direction [m]
_CORNER = float(np.cos(np.radians(50.0)))  # of a turn in drive coordinates: a sharper one needs a stop


def metric(robot: RobotModel, limits: MotionLimits) -> Array:
    """(k + n,) weights w of the length ‖w·dy‖ of a step dy in drive coordinates and joints, [m] per unit each.

    Driving straight counts the base's travel; turning in place that of a rim over √2; a joint counts its lever.
    """
    k = limits.drive_dim
    drive = {0: [], 2: [np.sqrt(0.5)] * 2, 3: [1.0, 1.0, LEVER]}[k]
    return np.concatenate([drive, np.where(prismatic_joints(robot), 1.0, LEVER)])


@dataclass(frozen=True, eq=False)
class Polyline:
    """The nodes of a strip in drive coordinates.

    Attributes:
        chart: (K, nv) nodes.
        tangent: (K−1, nv) segments.
        y: (K, m) travel of drive and joints since the first node.
        s: (K,) length since the first node, in the metric [m].
        stops: nodes at which the robot has to stop, ascending; the last one is K−1.
    """

    chart: Array
    tangent: Array
    y: Array
    s: Array
    stops: npt.NDArray[np.intp]

    def travel(self, s: Array) -> Array:
        """Travel (G, m) at lengths ``s`` (G,)."""
        i = np.searchsorted(self.s[1:-1], s, side="right")
        h = self.s[i + 1] - self.s[i]
        part = (s - self.s[i]) / np.where(h > 0.0, h, 1.0)
        return self.y[i] + part[:, None] * (self.y[i + 1] - self.y[i])

    def pose(self, space: ConfigurationSpace, s: Array) -> Array:
        """Chart rows (G, nv) at lengths ``s`` (G,), on the arcs between the nodes."""
        i = np.searchsorted(self.s[1:-1], s, side="right")
        h = self.s[i + 1] - self.s[i]
        part = (s - self.s[i]) / np.where(h > 0.0, h, 1.0)
        return space.integrate(self.chart[i], part[:, None] * self.tangent[i])


def polyline(
    robot: RobotModel, limits: MotionLimits, weight: Array, chart: Array, heading: Array | None = None
) -> Polyline:
    """The nodes (K, nv), K ≥ 2, as travel of drive and joints.

    Args:
        robot, limits: whose.
        weight: (m,) the metric.
        chart: (K, nv).
        heading: (m,) direction of the velocity with which the robot arrives at the first node; None at rest.
    """
    tangent = robot.space.difference(chart[:-1], chart[1:])
    dy = limits.to_coordinates(tangent)
    y = np.zeros((len(chart), dy.shape[1]))
    np.cumsum(dy, axis=0, out=y[1:])
    s = np.zeros(len(chart))
    np.cumsum(np.sqrt(((dy * weight) ** 2).sum(axis=1)), out=s[1:])
    return Polyline(chart, tangent, y, s, _stops(y * weight, s, None if heading is None else heading * weight))


def _stops(y: Array, s: Array, heading: Array | None) -> npt.NDArray[np.intp]:
    """Nodes where the way turns too sharply for wheels and joints to follow without a stop; and the last one.

    A change between forwards and backwards is one of them, unless the base turns so fast about it that no wheel and no
    joint changes its speed abruptly.
    """
    nodes = spread(s, _MERGE, merge_first=heading is None)
    points = y[nodes]
    if heading is not None:  # the robot comes from behind the first node, so a corner right ahead is still one
        points[0] = -0.05 * heading / np.linalg.norm(heading)
    step = points[1:] - points[:-1]
    length = np.linalg.norm(step, axis=1)
    stop = (step[:-1] * step[1:]).sum(axis=1) < _CORNER * length[:-1] * length[1:]
    return np.append(nodes[1:-1][stop], nodes[-1])


def spread(s: Array, gap: float, *, merge_first: bool = True) -> npt.NDArray[np.intp]:
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
