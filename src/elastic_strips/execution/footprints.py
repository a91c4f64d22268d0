"""Execution room, footprints: robot and obstacles seen from above, each piece with the heights that it takes up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Obstacle

_SIGNS = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
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
    """Workspace: a robot where it stands, each of its pieces as an upright box that is turned as the base is.

    Args:
        robot: whose pieces these are.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot, self._data = robot, robot.model.createData()
        corners = []
        for piece in robot.geometries:
            piece.geometry.computeLocalAABB()
            low, high = np.array(piece.geometry.aabb_local.min_), np.array(piece.geometry.aabb_local.max_)
            local = 0.5 * (low + high) + 0.5 * _SIGNS * (high - low)
            corners.append(local @ piece.placement[:3, :3].T + piece.placement[:3, 3])
        self._corners = np.array(corners)  # (G, 8, 3) in the joints' frames

    def place(self, chart: Array) -> None:
        """Put the robot at a chart row (nv,)."""
        robot, data = self._robot, self._data
        pin.forwardKinematics(robot.model, data, robot.space.from_chart(chart[None])[0])
        joints = [data.oMi[piece.joint] for piece in robot.geometries]
        rotation, shift = np.array([T.rotation for T in joints]), np.array([T.translation for T in joints])
        world = self._corners @ rotation.transpose(0, 2, 1) + shift[:, None]
        yaw = float(chart[2]) if robot.space.planar else 0.0
        self._origin = np.array(chart[:2]) if robot.space.planar else np.zeros(2)
        self._turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        local = (world[..., :2] - self._origin) @ self._turn
        low, high = local.min(axis=1), local.max(axis=1)
        self._centre, self._half = 0.5 * (low + high), 0.5 * (high - low)  # (G, 2)
        self._bottom, self._top = world[..., 2].min(axis=1), world[..., 2].max(axis=1)

    def distances(self, discs: Discs, poses: Array) -> Array:
        """Distances (P,) [m] seen from above of an obstacle at poses (P, 4, 4); infinite where no heights overlap."""
        rotation = poses[:, None, :3, :3]
        centre = np.matmul(rotation, discs.centre[:, :, None])[..., 0] + poses[:, None, :3, 3]  # (P, D, 3)
        tall = (np.abs(rotation[..., 2, :]) * discs.half).sum(axis=-1) + _OVERLAP  # (P, D)
        local = (centre[..., :2] - self._origin) @ self._turn
        beyond = np.abs(local[:, :, None] - self._centre) - self._half  # (P, D, G, 2)
        outside = np.sqrt(np.square(np.maximum(beyond, 0.0)).sum(axis=-1)) + np.minimum(beyond.max(axis=-1), 0.0)
        z = centre[..., 2, None]
        level = (z - tall[..., None] <= self._top) & (z + tall[..., None] >= self._bottom)
        apart = np.where(level, outside - discs.radius[:, None], np.inf)
        return apart.reshape(len(poses), -1).min(axis=1)
