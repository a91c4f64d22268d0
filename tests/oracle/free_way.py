"""Free way: how far points on a beam are outside a scene or a robot, by the shapes' own inequalities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from brute_force import configuration, link_poses, outside, scene_pieces

from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene

Array = npt.NDArray[np.float64]


def outside_scene(points: Array, scene: Scene) -> Array:
    """How far (V,) [m] points are outside all obstacles (a lower bound), 0 on a surface, negative inside."""
    out = np.full(len(points), np.inf)
    for piece in scene_pieces(scene):
        out = np.minimum(out, outside((points - piece.T[:3, 3]) @ piece.T[:3, :3], piece.geometry))
    return out


def outside_robot(points: Array, robot: RobotModel, coordinates: Array) -> Array:
    """The same of a robot's collision bodies."""
    out = np.full(len(points), np.inf)
    for piece, T in zip(robot.geometries, link_poses(robot, configuration(robot, coordinates)), strict=True):
        out = np.minimum(out, outside((points - T[:3, 3]) @ T[:3, :3], piece.geometry))
    return out


def along(origin: Array, direction: Array, end: float, count: int = 160) -> Array:
    """Points (count, 3) on a beam, from its origin to ``end`` [m]."""
    return origin + np.linspace(0.0, end, count)[:, None] * direction
