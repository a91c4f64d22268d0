"""Base methods that are shown the obstacles themselves, with their velocities; and a scene seen from above."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import support_points
from elastic_strips.hulls import convex_hull
from elastic_strips.scene import Obstacle, Scene

from .base_method import BaseCommand


@runtime_checkable
class SceneMethod(Protocol):
    """A method that steers a base to a goal among obstacles that it is shown, not the readings of sensors."""

    name: str

    def see(self, scene: Scene) -> None:
        """Take in the newest scene."""
        ...

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """The command for now; see :meth:`BaseMethod.command`."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SceneFromAbove:
    """Obstacles from above: what is round or moves as discs, the rest as convex polygons. Heights are left out.

    Attributes:
        time: time [s] that the centres belong to.
        center: (M, 2) of the discs [m].
        radius: (M,) [m].
        velocity: (M, 2) [m/s].
        polygons: corners (K, 2) [m] of each polygon, counter-clockwise.
    """

    time: float
    center: Array
    radius: Array
    velocity: Array
    polygons: tuple[Array, ...]

    @staticmethod
    def of(scene: Scene) -> SceneFromAbove:
        """A scene, each part of an obstacle by itself."""
        discs: list[tuple[Array, float, Array]] = []
        polygons: list[Array] = []
        for obstacle in scene:
            moves, velocity = obstacle.motion is not None, obstacle.velocity()[0][:2]
            upright = abs(float(obstacle.pose[2, 2])) > 1.0 - 1e-9
            if obstacle.shape == "sphere" or (obstacle.shape == "cylinder" and upright):
                discs.append((obstacle.pose[:2, 3], float(str(obstacle.spec["radius"])), velocity))
                continue
            for corners in _outlines(obstacle):
                if moves:
                    middle = corners.mean(axis=0)
                    discs.append((middle, float(np.hypot(*(corners - middle).T).max()), velocity))
                else:
                    polygons.append(corners)
        return SceneFromAbove(
            scene.time,
            np.array([center for center, _, _ in discs]).reshape(-1, 2),
            np.array([radius for _, radius, _ in discs]),
            np.array([velocity for _, _, velocity in discs]).reshape(-1, 2),
            tuple(polygons),
        )

    def centers_at(self, t: float) -> Array:
        """(M, 2) where the discs are at time ``t`` [s] if they go on as they go [m]."""
        return self.center + (t - self.time) * self.velocity

    def from_polygons(self, points: Array) -> Array:
        """(P,) distance [m] of points (P, 2) from the nearest polygon; 0 inside of one, infinite without any."""
        least = np.full(len(points), np.inf)
        for corners in self.polygons:
            edge = np.roll(corners, -1, axis=0) - corners
            offset = points[:, None] - corners
            along = (offset * edge).sum(axis=2) / (edge * edge).sum(axis=1)
            nearest = offset - np.clip(along, 0.0, 1.0)[..., None] * edge
            inside = (edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0] >= 0.0).all(axis=1)
            distance = np.hypot(nearest[..., 0], nearest[..., 1]).min(axis=1)
            least = np.minimum(least, np.where(inside, 0.0, distance))
        return least


def _outlines(obstacle: Obstacle) -> list[Array]:
    """Corners (K, 2) of the convex polygon about each part, seen from above, counter-clockwise."""
    found = []
    for part in obstacle.parts:
        shift = part.T_obstacle_part[:3, 3]
        members = [(g, shift) for g in part.members] if not part.boxes else list(part.boxes)
        for geometry, translation in members:
            points, radius = support_points(geometry)
            placed = (points + translation) @ obstacle.pose[:3, :3].T + obstacle.pose[:3, 3]
            if radius > 0.0:  # corners of a square about each rounded one
                square = radius * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
                flat = (placed[:, None, :2] + square).reshape(-1, 2)
            else:
                flat = placed[:, :2]
            found.append(flat[convex_hull(flat).vertices])
    return found
