"""Execution room, silhouette: the robot seen from above, each of its bodies with the heights that it takes up."""

from __future__ import annotations

import numpy as np

from ..proximity import BodySet
from ..robot import Kinematics, RobotModel
from ..robot.geometry import support_points
from ..robot.space import Array


class Silhouette:
    """Workspace: the robot's bodies as upright boxes in the base's frame, for one posture of its joints.

    Attributes:
        middle, half: (K, 2) centres and half sizes of the boxes seen from above [m].
        low, high: (K,) their lowest and highest points [m].
    """

    def __init__(self, robot: RobotModel) -> None:
        self._bodies = BodySet.links(robot)
        self._points = [support_points(g) for g in self._bodies.geometries]
        self._kin = Kinematics(robot.tree, 1)
        self._base = robot.space.base_nv
        self._posture: Array | None = None
        self._placed: list[Array] = []
        self.middle = self.half = np.zeros((0, 2))
        self.low = self.high = np.zeros(0)

    def update(self, chart: Array) -> None:
        """Take the joints of a chart row (nv,)."""
        row = np.array(chart, dtype=float)
        row[: self._base] = 0.0
        if self._posture is not None and np.array_equal(row, self._posture):
            return
        self._kin.update(row[None])
        count = len(self._bodies)
        index = np.arange(count, dtype=np.intp)
        turn, move = self._bodies.placements(self._kin, np.zeros(count, dtype=np.intp), index)
        boxes = np.empty((count, 2, 3))
        self._placed = [points @ turn[g].T + move[g] for g, (points, _) in enumerate(self._points)]
        for g, (_, radius) in enumerate(self._points):
            boxes[g] = self._placed[g].min(axis=0) - radius, self._placed[g].max(axis=0) + radius
        inside = (boxes[:, None, 0] >= boxes[None, :, 0]).all(axis=2) & (boxes[:, None, 1] <= boxes[None, :, 1]).all(2)
        inside &= ~np.eye(count, dtype=bool)
        boxes = boxes[~(inside & ~(inside.T & (index[:, None] < index))).any(axis=1)]
        self.middle, self.half = boxes.mean(axis=1)[:, :2], 0.5 * (boxes[:, 1] - boxes[:, 0])[:, :2]
        self.low, self.high = boxes[:, 0, 2], boxes[:, 1, 2]
        self._posture = row

    @property
    def reach(self) -> float:
        """Radius [m] about the base's origin that holds the robot, seen from above."""
        return self.reach_between(-np.inf, np.inf)

    def reach_between(self, low: float, high: float) -> float:
        """That of the bodies between two heights [m]."""
        at = (self.low <= high) & (self.high >= low)
        return float(np.hypot(*(np.abs(self.middle[at]) + self.half[at]).T).max(initial=0.0))

    def disc_below(self, height: float) -> float:
        """Radius [m] of the largest disc about the base that a body which reaches below ``height`` [m] covers."""
        angles = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        ways = np.stack((np.cos(angles), np.sin(angles)))
        best = 0.0
        for placed, (_, radius) in zip(self._placed, self._points, strict=True):
            if placed[:, 2].min() - radius < height:
                best = max(best, float((placed[:, :2] @ ways).max(axis=0).min()) + radius)
        return best


def beyond_box(x: Array, y: Array, a: Array | float, b: Array | float) -> Array:
    """Signed distances [m] of points from boxes of half sizes a, b about the origin."""
    x, y = np.abs(x) - a, np.abs(y) - b
    outside = np.sqrt(np.square(np.maximum(x, 0.0)) + np.square(np.maximum(y, 0.0)))
    return outside + np.minimum(np.maximum(x, y), 0.0)
