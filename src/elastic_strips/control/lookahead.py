"""Look-ahead: what is around the robot, seen from above, and where constant velocities take it."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..proximity import BodySet, Forecast
from ..robot import Kinematics, RobotModel
from ..robot.geometry import support_points
from ..scene import Scene


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


FAR = 3.0
"""Separations are not told beyond this [m]."""
_FASTEST = 3.0  # [m/s] what is faster is noticed late
_LOW = 0.02  # [m] what lies lower is driven over


class Outlook:
    """What is around the robot, seen from above, and where constant velocities take it.

    Args:
        silhouette: of the robot.
        scene: sensed.
        forecast: its moving obstacles, with the bounds of the errors.
        centre: (2,) where the robot is [m].
        reach: how far from there it matters where things stand [m].
        horizon: how long it matters where things move [s].
        most: so many moving pieces at most, those first that come nearest soonest.
    """

    def __init__(
        self, silhouette: Silhouette, scene: Scene, forecast: Forecast, centre: Array, *, reach: float, horizon: float,
        most: int = 12,
    ) -> None:  # fmt: skip
        self.body = silhouette
        moving = dict(zip(forecast.obstacles.tolist(), range(len(forecast)), strict=True))
        discs, boxes = [], []
        for k, obstacle in enumerate(scene):
            pose, mover = obstacle.pose, moving.get(k)
            if (
                float(np.hypot(*(pose[:2, 3] - centre))) - obstacle.reach
                > reach + (mover is not None) * _FASTEST * horizon
            ):
                continue
            for part in obstacle.parts:
                middle = pose[:3, :3] @ part.center + pose[:3, 3]
                tall = float(np.abs(pose[2, :3]) @ part.half_extents)
                flat = min(float(np.hypot(*part.half_extents[:2])), part.radius)
                if type(part.geometry).__name__ in ("Cylinder", "Sphere", "Capsule", "Cone"):
                    flat = float(part.half_extents[:2].max())
                if abs(pose[2, 2]) < 0.999:  # it lies or leans
                    flat = part.radius
                low, high = middle[2] - tall, middle[2] + tall
                if high < _LOW or low > silhouette.high.max():
                    continue
                if mover is not None:
                    v = forecast.velocity[mover]
                    discs.append((*middle[:2], *v[:2], flat, low, high, mover))
                elif float(np.hypot(*(middle[:2] - centre))) - flat < reach:
                    yaw = np.arctan2(pose[1, 0], pose[0, 0])
                    boxes.append((*middle[:2], *part.half_extents[:2], low, high, yaw))
        found = np.array(discs).reshape(-1, 8)
        t = np.linspace(0.0, horizon, 7)[:, None]
        apart = np.hypot(found[:, 0] + found[:, 2] * t - centre[0], found[:, 1] + found[:, 3] * t - centre[1])
        soon = (apart - found[:, 4] - reach * t / horizon).min(axis=0)
        order = np.argsort(soon, kind="stable")[:most]
        self._discs = found[order[soon[order] < silhouette.reach]]
        self._boxes = np.array(boxes).reshape(-1, 7)
        at = self._discs[:, 7].astype(int)
        self._error = np.stack([forecast.offset[at], forecast.speed[at], 0.5 * forecast.acceleration[at]])
        self._size = self._discs[:, 4] + [silhouette.reach_between(*z) for z in self._discs[:, 5:7]]

    @property
    def movers(self) -> int:
        """How many moving pieces matter."""
        return len(self._discs)

    def near(self, pose: Array, time: Array, lead: float) -> Array:
        """About the separations (N, T) [m] from what moves, at poses (N, T, 3) and times (T,) [s] after the snapshot.

        What moves counts as where it is and will be within the next ``lead`` [s]: a robot that is in front of it has
        to go on, and cannot be certified to stop. The robot is a disc that holds all of it that the piece could touch.
        """
        x, y, vx, vy = self._discs[:, :4].T
        t = time[:, None]
        dx, dy = x + vx * t - pose[..., 0:1], y + vy * t - pose[..., 1:2]
        ahead = np.clip(-(dx * vx + dy * vy) / np.maximum(vx * vx + vy * vy, 1e-6), 0.0, lead)
        dx += vx * ahead
        dy += vy * ahead
        return (np.sqrt(dx * dx + dy * dy) - self._size).min(axis=-1, initial=FAR)

    def possible(self, pose: Array, time: Array) -> Array:
        """Separations (N, T) [m] from all places where what moves can be then, as for a certificate."""
        result = np.full(pose.shape[:2], FAR)
        if not len(self._discs):
            return result
        cos, sin = np.cos(pose[..., 2])[..., None], np.sin(pose[..., 2])[..., None]
        x, y, vx, vy, radius, low, high = self._discs[:, :7].T
        t = time[:, None]
        size = radius + self._error[0] + (self._error[1] + self._error[2] * t) * t
        dx, dy = x + vx * t - pose[..., 0:1], y + vy * t - pose[..., 1:2]
        ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
        body = self.body
        for k in range(len(body.low)):
            at = (low <= body.high[k]) & (high >= body.low[k])
            if at.any():
                d = beyond_box(ahead[..., at] - body.middle[k, 0], aside[..., at] - body.middle[k, 1], *body.half[k])
                np.minimum(result, (d - size[:, at]).min(axis=-1), out=result)
        return result

    def from_standing(self, pose: Array) -> Array:
        """Separations (N, T) [m] from what stands; the robot's boxes are covered by discs, so it is a little less."""
        result = np.full(pose.shape[:2], FAR)
        body = self.body
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        for k in range(len(body.low)):
            at = np.flatnonzero((self._boxes[:, 4] <= body.high[k]) & (self._boxes[:, 5] >= body.low[k]))
            if not len(at):
                continue
            count = np.ceil(body.half[k] / max(float(body.half[k].min()), 0.12)).astype(int)
            part = body.half[k] / count
            radius = float(np.hypot(*part))
            for i, j in np.ndindex(*count.tolist()):
                u, w = body.middle[k] - body.half[k] + part * (2 * np.array([i, j]) + 1)
                px, py = pose[..., 0] + cos * u - sin * w, pose[..., 1] + sin * u + cos * w
                c, s = np.cos(self._boxes[at, 6]), np.sin(self._boxes[at, 6])
                dx, dy = px[..., None] - self._boxes[at, 0], py[..., None] - self._boxes[at, 1]
                d = beyond_box(c * dx + s * dy, c * dy - s * dx, self._boxes[at, 2], self._boxes[at, 3])
                np.minimum(result, d.min(axis=-1) - radius, out=result)
        return result
