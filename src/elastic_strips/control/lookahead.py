"""Look-ahead: the obstacles around the robot, seen from above, and their motion at constant velocities."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Forecast
from elastic_strips.robot import PlanarFootprint
from elastic_strips.robot.footprint import box_distance
from elastic_strips.scene import Scene
from elastic_strips.work import count_work

FAR = 3.0
"""Largest separation that is returned [m]."""
_FASTEST = 3.0  # [m/s] faster obstacles are found late
_LOW = 0.02  # [m] lower obstacles are driven over


class ObstacleLookahead:
    """The obstacles around the robot, seen from above, and their motion at constant velocities.

    Args:
        footprint: of the robot.
        scene: sensed.
        forecast: of its moving obstacles.
        centre: (2,) position of the robot [m].
        reach: distance from there within which static obstacles count [m].
        horizon: time within which moving obstacles count [s].
        most: largest number of moving pieces, those first that come nearest soonest.
    """

    def __init__(
        self, footprint: PlanarFootprint, scene: Scene, forecast: Forecast, centre: Array, *, reach: float,
        horizon: float, most: int = 12,
    ) -> None:  # fmt: skip
        count_work(batches=1, obstacles=len(scene))
        self.body = footprint
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
                if high < _LOW or low > footprint.high.max():
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
        self._discs = found[order[soon[order] < footprint.reach()]]
        self._boxes = np.array(boxes).reshape(-1, 7)
        at = self._discs[:, 7].astype(int)
        self._error = np.stack([forecast.offset[at], forecast.speed[at], 0.5 * forecast.acceleration[at]])
        self._size = self._discs[:, 4] + [footprint.reach(*z) for z in self._discs[:, 5:7]]

    @property
    def movers(self) -> int:
        """Number of moving pieces that count."""
        return len(self._discs)

    def near(self, pose: Array, time: Array, lookahead: float) -> Array:
        """Approximate separations from moving obstacles.

        An obstacle counts at every place where it will be within the next ``lookahead`` [s]: a robot in front of it has
        to go on, and cannot be certified to stop. The robot is a disc that holds all of it at the obstacle's height.

        Args:
            pose: (N, T, 3) poses of the base [m, rad].
            time: (T,) times [s] after the scene.
            lookahead: see above [s].

        Returns:
            (N, T) separations [m].
        """
        count_work(outlooks=_pairs(pose, self._discs))
        x, y, vx, vy = self._discs[:, :4].T
        t = time[:, None]
        dx, dy = x + vx * t - pose[..., 0:1], y + vy * t - pose[..., 1:2]
        ahead = np.clip(-(dx * vx + dy * vy) / np.maximum(vx * vx + vy * vy, 1e-6), 0.0, lookahead)
        dx += vx * ahead
        dy += vy * ahead
        return (np.sqrt(dx * dx + dy * dy) - self._size).min(axis=-1, initial=FAR)

    def possible(self, pose: Array, time: Array) -> Array:
        """Separations (N, T) [m] from all places where moving obstacles can be then, as for a certificate.

        Args:
            pose: (N, T, 3) poses of the base [m, rad].
            time: (T,) times [s] after the scene.
        """
        result = np.full(pose.shape[:2], FAR)
        if not len(self._discs):
            return result
        count_work(outlooks=len(self.body.low) * _pairs(pose, self._discs))
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
                d = box_distance(ahead[..., at] - body.middle[k, 0], aside[..., at] - body.middle[k, 1], *body.half[k])
                np.minimum(result, (d - size[:, at]).min(axis=-1), out=result)
        return result

    def from_standing(self, pose: Array) -> Array:
        """Lower bounds (N, T) [m] of the separations from static obstacles, at poses (N, T, 3) [m, rad].

        They are a little too small, as discs cover the boxes of the robot.
        """
        result = np.full(pose.shape[:2], FAR)
        body = self.body
        count_work(outlooks=len(body.low) * _pairs(pose, self._boxes))
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
                d = box_distance(c * dx + s * dy, c * dy - s * dx, self._boxes[at, 2], self._boxes[at, 3])
                np.minimum(result, d.min(axis=-1) - radius, out=result)
        return result


def _pairs(pose: Array, pieces: Array) -> int:
    """Number of pairs of a pose (N, T, 3) and a piece (P, …)."""
    return pose.shape[0] * pose.shape[1] * len(pieces)
