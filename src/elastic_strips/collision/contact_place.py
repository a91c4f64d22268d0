"""Contact place: where a robot and what is in its way touch, or come nearest, for whoever points at it."""

from __future__ import annotations

from collections.abc import Iterator

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import for_penetration
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle, Scene

from .certificate import BrokenSegment

_MOST_BOXES = 64  # of a block, those with the nearest middles


def contact_place(robot: RobotModel, q: Array, broken: BrokenSegment, scene: Scene) -> Array | None:
    """Where (3,) [m] a link and what it is too near to are nearest to each other, or deepest in each other.

    Args:
        robot: the robot.
        q: its configuration (nq,).
        broken: names of the two.
        scene: the obstacles; none is known where it lacks the one that is named.

    Returns:
        The middle between the nearest points; None where one of the two is not known.
    """
    pieces = {piece.name: k for k, piece in enumerate(robot.geometries)}
    if broken.link not in pieces:
        return None
    data, placed = robot.model.createData(), robot.collision_model.createData()
    pin.updateGeometryPlacements(robot.model, data, robot.collision_model, placed, q)

    def at(k: int) -> coal.Transform3s:
        pose = placed.oMg[k]
        return coal.Transform3s(pose.rotation, pose.translation)

    one = pieces[broken.link]
    if broken.obstacle in pieces:
        k = pieces[broken.obstacle]
        others = [(robot.geometries[k].geometry, at(k))]
    elif broken.obstacle in scene:
        others = list(_shapes(scene.obstacle(broken.obstacle), placed.oMg[one].translation))
    else:
        return None
    nearest: tuple[float, Array | None] = np.inf, None
    for shape, pose in others:
        result = coal.DistanceResult()
        link, other = for_penetration(robot.geometries[one].geometry, shape)
        distance = coal.distance(link, at(one), other, pose, coal.DistanceRequest(True), result)
        middle = 0.5 * (np.array(result.getNearestPoint1()) + np.array(result.getNearestPoint2()))
        if distance < nearest[0] and np.isfinite(middle).all():
            nearest = distance, middle
    return nearest[1]


def _shapes(obstacle: Obstacle, near: Array) -> Iterator[tuple[coal.CollisionGeometry, coal.Transform3s]]:
    """The convex shapes of an obstacle and their poses; of many boxes those that are near a point (3,)."""
    rotation, origin = obstacle.pose[:3, :3], obstacle.pose[:3, 3]
    for part in obstacle.solid.parts:
        if part.geometry is not None:
            yield part.geometry, coal.Transform3s(rotation, origin + rotation @ part.T_obstacle_part[:3, 3])
            continue
        middles = origin + part.middles @ rotation.T
        for k in np.argsort(np.linalg.norm(middles - near, axis=1))[:_MOST_BOXES].tolist():
            yield part.boxes[k][0], coal.Transform3s(rotation, middles[k])
