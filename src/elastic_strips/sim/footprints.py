"""Sim room, footprints: robot and obstacles seen from above, each piece with the heights that it takes up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import coal
import numpy as np

from ..execution.silhouette import Silhouette, beyond_box
from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Obstacle

_OVERLAP = 0.05
"""What passes above or below by less than this [m] counts as being at the same height."""
_ROUND = (coal.Sphere, coal.Cylinder, coal.Capsule, coal.Cone)


@dataclass(frozen=True, slots=True, eq=False)
class Discs:
    """An obstacle as upright discs in its own frame.

    Attributes:
        centre: (D, 3) [m].
        radius: (D,) [m].
        half: (D, 3) half sizes of the pieces that the discs stand for [m].
    """

    centre: Array
    radius: Array
    half: Array

    @staticmethod
    def of(obstacle: Obstacle) -> Discs:
        """The discs of an obstacle: one for each round part, of others as many as lie side by side along it."""
        rows: list[tuple[Array, float, Array]] = []
        upright = abs(float(obstacle.pose[2, 2])) > 0.999
        for part in obstacle.parts:
            half = part.half_extents
            along = int(half[1] > half[0])
            long, wide = float(half[along]), float(half[1 - along])
            if not upright:
                rows.append((part.center, part.radius, np.full(3, part.radius)))
            elif isinstance(part.geometry, _ROUND):
                rows.append((part.center, long, half))
            else:
                count = min(math.ceil(long / max(wide, 1e-3)), 8)
                for k in range(count):
                    centre = part.center.copy()
                    centre[along] += long * ((2 * k + 1) / count - 1.0)
                    rows.append((centre, math.hypot(long / count, wide), half))
        centre, radius, half = zip(*rows, strict=True)
        return Discs(np.array(centre), np.array(radius), np.array(half))


class Footprint:
    """Workspace: a robot where it stands, each of its bodies as an upright box that is turned as the base is.

    Args:
        robot: whose bodies these are.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._body, self._planar = Silhouette(robot), robot.space.planar
        self._origin, self._turn = np.zeros(2), np.eye(2)

    def place(self, chart: Array) -> None:
        """Put the robot at a chart row (nv,)."""
        self._body.update(chart)
        if self._planar:
            cos, sin = math.cos(chart[2]), math.sin(chart[2])
            self._origin, self._turn = np.array(chart[:2]), np.array([[cos, -sin], [sin, cos]])

    def distances(self, discs: Discs, poses: Array) -> Array:
        """Distances (P,) [m] seen from above of an obstacle at poses (P, 4, 4); infinite where no heights overlap."""
        body, rotation = self._body, poses[:, None, :3, :3]
        centre = np.matmul(rotation, discs.centre[:, :, None])[..., 0] + poses[:, None, :3, 3]  # (P, D, 3)
        tall = (np.abs(rotation[..., 2, :]) * discs.half).sum(axis=-1) + _OVERLAP  # (P, D)
        local = (centre[..., :2] - self._origin) @ self._turn
        offset = local[:, :, None] - body.middle  # (P, D, K, 2)
        outside = beyond_box(offset[..., 0], offset[..., 1], *body.half.T)
        z = centre[..., 2, None]
        level = (z - tall[..., None] <= body.high) & (z + tall[..., None] >= body.low)
        apart = np.where(level, outside - discs.radius[:, None], np.inf)
        return apart.reshape(len(poses), -1).min(axis=1)
