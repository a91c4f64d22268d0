"""How high a robot reaches, whatever its joints do: walls that are only known in plan have to be as high as this."""

from __future__ import annotations

from itertools import product

import numpy as np

from elastic_strips.arrays import Array

from .model import RobotModel
from .reduced import LONGEST_SLIDE

_UPRIGHT_TOLERANCE = 1e-9  # how far an axis may be from the vertical, and count as vertical


def highest_reach(robot: RobotModel) -> float:
    """A height [m] over the floor that no point of the robot's shapes exceeds, in any configuration.

    It is exact up to the first joint that turns about an axis other than the vertical; from there on lengths add up.
    """
    tree, model = robot.tree, robot.model
    turned: list[Array | None] = [np.eye(3)]  # orientation up to a yaw; None where it can be any
    height = [0.0]  # of the last origin whose orientation is known, at most
    length = [0.0]  # from there to the joint's origin, at most
    for i in range(1, model.njoints):
        parent = int(tree.parents[i])
        placement = model.jointPlacements[i]
        rotation, up, far = turned[parent], height[parent], length[parent]
        if rotation is None:
            far += float(np.linalg.norm(placement.translation))
        else:
            up += float((rotation @ placement.translation)[2])
            rotation = rotation @ placement.rotation
        column = int(tree.coordinate_index[i])
        if column >= 0:
            axis = tree.align[i][:, 2]
            if tree.prismatic[i]:
                ends = np.clip((robot.space.lower[column], robot.space.upper[column]), -LONGEST_SLIDE, LONGEST_SLIDE)
                if rotation is None:
                    far += float(np.abs(ends).max())
                else:
                    up += float((ends * (rotation @ axis)[2]).max())
            elif rotation is not None and np.hypot(*(rotation @ axis)[:2]) > _UPRIGHT_TOLERANCE:
                rotation = None
        turned.append(rotation)
        height.append(up)
        length.append(far)
    most = 0.0
    for piece in robot.geometries:
        box, i = piece.geometry.aabb_local, piece.joint
        ends = zip(np.ravel(box.min_), np.ravel(box.max_), strict=True)
        corners = np.array(list(product(*ends))) @ piece.placement[:3, :3].T + piece.placement[:3, 3]
        rotation = turned[i]
        above = np.linalg.norm(corners, axis=1) if rotation is None else (corners @ rotation.T)[:, 2]
        most = max(most, height[i] + length[i] + float(above.max()))
    return most
