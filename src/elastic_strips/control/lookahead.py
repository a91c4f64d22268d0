"""Look-ahead: the obstacles around the robot, seen from above, and their motion at constant velocities."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from elastic_strips.arrays import Array, Mask, by_rows
from elastic_strips.collision import Forecast
from elastic_strips.native import kernel
from elastic_strips.planning.grid_path import DRIVEN_OVER_HEIGHT
from elastic_strips.robot import PlanarFootprint
from elastic_strips.robot.footprint import box_distance
from elastic_strips.scene import Scene
from elastic_strips.scene.parts import Part
from elastic_strips.work import count_work

FARTHEST_SEPARATION = 3.0
"""Largest separation that is returned [m]."""
_TREND_TIMES = (0.5, 1.0)  # [s] until which obstacles go on with their accelerations, in straight courses
_ROUND_SHAPES = ("Cylinder", "Sphere", "Capsule", "Cone")
_LEAST_DISC = 0.12  # [m] radius of the smallest discs that cover the robot's boxes
_HORIZON_SHARES = np.linspace(0.0, 1.0, 7)[:, None]  # of the horizon, at which moving pieces are looked at


class ObstacleLookahead:
    """The obstacles around the robot, seen from above, and their motion at constant velocities.

    Args:
        footprint: footprint of the robot.
        scene: sensed.
        forecast: forecast of its moving obstacles.
        centre: (2,) position of the robot [m].
        reach: distance from there within which static obstacles count [m].
        horizon: time within which moving obstacles count [s].
        most: largest number of moving pieces, beginning with those that come nearest soonest.
        trend: (M, 3) accelerations [m/s²] with which the forecast's obstacles are expected to go on for a little while;
            for :meth:`near` alone.
    """

    def __init__(
        self,
        footprint: PlanarFootprint,
        scene: Scene,
        forecast: Forecast,
        centre: Array,
        *,
        reach: float,
        horizon: float,
        most: int = 12,
        trend: Array | None = None,
    ) -> None:
        count_work(batches=1, obstacles=len(scene))
        self.body = footprint
        self._native = kernel()
        table, number = scene.table, np.full(len(scene), -1)
        number[forecast.obstacles] = np.arange(len(forecast))
        mover = number[table.obstacle_index]
        turn, middle, half = table.rotation, table.center, table.local_half
        x, y = middle[:, 0], middle[:, 1]
        flat = np.minimum(np.hypot(half[:, 0], half[:, 1]), table.radius)
        flat = np.where(_round(table.parts), np.maximum(half[:, 0], half[:, 1]), flat)
        flat = np.where(np.abs(turn[:, 2, 2]) < 0.999, table.radius, flat)  # those lie or lean
        tall = (np.abs(turn[:, 2]) * half).sum(axis=1)
        low, high = middle[:, 2] - tall, middle[:, 2] + tall
        counts = (high >= DRIVEN_OVER_HEIGHT) & (low <= footprint.high.max())
        near = np.hypot(x - centre[0], y - centre[1]) - flat < reach
        at = np.flatnonzero(counts & near & (mover < 0))
        yaw = np.arctan2(turn[at, 1, 0], turn[at, 0, 0])
        self._boxes: Array = np.array([x[at], y[at], half[at, 0], half[at, 1], low[at], high[at], yaw]).T.copy()
        at = np.flatnonzero(counts & (mover >= 0))
        vx, vy = forecast.velocity[mover[at], :2].T
        found = np.array([x[at], y[at], vx, vy, flat[at], low[at], high[at], mover[at]]).T
        t = horizon * _HORIZON_SHARES
        apart = np.hypot(found[:, 0] + vx * t - centre[0], found[:, 1] + vy * t - centre[1])
        soon = (apart - found[:, 4] - reach * _HORIZON_SHARES).min(axis=0)
        order = np.argsort(soon, kind="stable")[:most]
        self._discs: Array = found[order[soon[order] < footprint.reach()]].copy()
        at = self._discs[:, 7].astype(int)
        self._courses: tuple[tuple[float, Array], ...] = ((np.inf, self._discs),)
        if trend is not None and trend[at].any():
            self._courses = tuple(_courses(self._discs, trend[at, :2]))
        self._error: Array = np.array([forecast.offset[at], forecast.speed[at], 0.5 * forecast.acceleration[at]])
        self._size: Array = self._discs[:, 4] + footprint.reaches(self._discs[:, 5], self._discs[:, 6])

    @property
    def growth(self) -> float:
        """Half the largest acceleration [m/s²] that is possible for any of the moving pieces."""
        return float(self._error[2].max(initial=0.0))

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
            lookahead: as described above [s].

        Returns:
            (N, T) separations [m].
        """
        count_work(outlooks=_pairs(pose, self._discs))
        if len(self._courses) == 1:
            return self._near(pose, time, lookahead, self._discs)
        result, begin = np.empty(pose.shape[:2]), -np.inf
        for end, discs in self._courses:
            at = (time >= begin) & (time < end)
            begin = end
            if at.any():
                result[:, at] = self._near(pose[:, at], time[at], lookahead, discs)
        return result

    def _near(self, pose: Array, time: Array, lookahead: float, discs: Array) -> Array:
        """As :meth:`near`, of discs that go straight on."""
        if self._native is not None:
            result = np.empty(pose.shape[:2])
            self._native.near_discs(*by_rows(pose, time, discs, self._size), lookahead, FARTHEST_SEPARATION, result)
            return result
        x, y, vx, vy = discs[:, :4].T
        t = time[:, None]
        dx, dy = x + vx * t - pose[..., 0:1], y + vy * t - pose[..., 1:2]
        ahead = np.clip(-(dx * vx + dy * vy) / np.maximum(vx * vx + vy * vy, 1e-6), 0.0, lookahead)
        dx += vx * ahead
        dy += vy * ahead
        return (np.sqrt(dx * dx + dy * dy) - self._size).min(axis=-1, initial=FARTHEST_SEPARATION)

    def possible(self, pose: Array, time: Array, far: float = FARTHEST_SEPARATION) -> Array:
        """Separations (N, T) [m] from all places where moving obstacles can be then, as for a certificate.

        Args:
            pose: (N, T, 3) poses of the base [m, rad].
            time: (T,) times [s] after the scene.
            far: largest separation that is returned [m].
        """
        result = np.full(pose.shape[:2], far)
        if not len(self._discs):
            return result
        count_work(outlooks=len(self.body.low) * _pairs(pose, self._discs))
        if self._native is not None:
            seen = by_rows(pose, time, self._discs, self._error, *self.body.boxes())
            self._native.possible_discs(*seen, far, result)
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
                d = box_distance(ahead[..., at] - body.middle[k, 0], aside[..., at] - body.middle[k, 1], *body.half[k])
                np.minimum(result, (d - size[:, at]).min(axis=-1), out=result)
        return result

    def from_behind(self, pose: Array, time: Array, within: float) -> Array:
        """How much comes up to the base from behind, where a robot that sees only ahead loses sight of it.

        Args:
            pose: (N, T, 3) poses of the base [m, rad].
            time: (T,) times [s] after the scene.
            within: distance [m] from which on it counts.

        Returns:
            (N, T) from 0, where nothing does, to 1, where something is about to touch the base from behind.
        """
        count_work(outlooks=_pairs(pose, self._discs))
        x, y, vx, vy, radius = self._discs[:, :5].T
        t = time[:, None]
        dx, dy = x + vx * t - pose[..., 0:1], y + vy * t - pose[..., 1:2]
        ahead = np.cos(pose[..., 2:]) * dx + np.sin(pose[..., 2:]) * dy
        apart = np.sqrt(dx * dx + dy * dy)
        speed = np.maximum(np.hypot(vx, vy), 1e-6)
        towards = -(dx * (vx / speed) + dy * (vy / speed)) / np.maximum(apart, 1e-6)  # the cosine of its course
        near = np.clip(1.0 - (apart - radius) / within, 0.0, 1.0) * np.maximum(towards, 0.0)
        return np.where(ahead < 0.0, near, 0.0).max(axis=-1, initial=0.0)

    def from_standing(self, pose: Array, far: float = FARTHEST_SEPARATION) -> Array:
        """Lower bounds (N, T) [m] of the separations from static obstacles, at poses (N, T, 3) [m, rad], up to ``far``.

        They are a little too small, as discs cover the boxes of the robot.
        """
        result = np.full(pose.shape[:2], far)
        body = self.body
        count_work(outlooks=len(body.low) * _pairs(pose, self._boxes))
        if self._native is not None:
            self._native.standing_boxes(*by_rows(pose, self._boxes, *self.body.boxes()), _LEAST_DISC, far, result)
            return result
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        for k in range(len(body.low)):
            at = np.flatnonzero((self._boxes[:, 4] <= body.high[k]) & (self._boxes[:, 5] >= body.low[k]))
            if not len(at):
                continue
            count = np.ceil(body.half[k] / max(float(body.half[k].min()), _LEAST_DISC)).astype(int)
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


def _courses(discs: Array, trend: Array) -> Iterator[tuple[float, Array]]:
    """Straight courses that follow discs (P, 8) with accelerations (P, 2) [m/s²], each with the time [s] until which it
    is followed."""
    place, velocity, begin = discs[:, :2], discs[:, 2:4], 0.0
    for end in _TREND_TIMES:
        span = end - begin
        mean = velocity + 0.5 * span * trend
        course = discs.copy()
        course[:, :2], course[:, 2:4] = place - begin * mean, mean
        yield end, course
        place, velocity, begin = place + span * mean, velocity + span * trend, end
    course = discs.copy()
    course[:, :2], course[:, 2:4] = place - begin * velocity, velocity
    yield np.inf, course


@lru_cache(maxsize=4)
def _round(parts: tuple[Part, ...]) -> Mask:
    """(P,) which parts are round; scenes that differ in poses have the same."""
    return np.array([type(part.geometry).__name__ in _ROUND_SHAPES for part in parts], dtype=bool)


def _pairs(pose: Array, pieces: Array) -> int:
    """Number of pairs of a pose (N, T, 3) and a piece (P, …)."""
    return pose.shape[0] * pose.shape[1] * len(pieces)
