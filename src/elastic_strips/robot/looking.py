"""Joints that look: a head's pan and tilt, which may turn at any time while the planner holds them still.

Whatever hangs on them is taken as large as the space that it passes through: so what is proven of the robot holds
wherever it looks.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import support_points
from elastic_strips.errors import RobotError, nearest_name
from elastic_strips.hulls import convex_hull, convex_shape, few_corners

_ARC_STEP = 0.12  # [rad] at most, of a turn that is taken as the polygon about it
_MOST_CORNERS = 300  # of a shape that is swept
_BALL = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # the cube about a ball of radius 1


def swept(model: pin.Model, collision: pin.GeometryModel, looking: Collection[str]) -> pin.GeometryModel:
    """Collision geometry in which what hangs on joints that look is as large as the space that it passes through.

    Args:
        model: the model with those joints.
        collision: its collision geometry.
        looking: names of the joints.

    Raises:
        RobotError: a joint that is unknown or neither turns nor slides between limits; one that carries others which
            do not look.
    """
    joints = [_joint(model, name) for name in looking]
    for joint in joints:
        carried = [model.names[k] for k in model.subtrees[joint] if k not in joints]
        if carried:
            raise RobotError(
                f"looking: {model.names[joint]!r} carries {', '.join(map(repr, carried[:6]))}; a joint that looks may "
                "carry others that look alone"
            )
    out = pin.GeometryModel()
    for item in collision.geometryObjects:
        out.addGeometryObject(_swept(model, item, joints) if item.parentJoint in joints else item.copy())
    return out


def _joint(model: pin.Model, name: str) -> int:
    names = [n for n in list(model.names)[1:] if n != "root_joint"]
    if name not in names:
        raise RobotError(f"looking: unknown joint {name!r}{nearest_name(name, names)}")
    index = model.getJointId(name)
    kind = model.joints[index].shortname()
    bounded = kind.startswith(("JointModelR", "JointModelP")) and model.joints[index].nq == 1
    k = model.joints[index].idx_q
    if not bounded or not np.isfinite((model.lowerPositionLimit[k], model.upperPositionLimit[k])).all():
        raise RobotError(f"looking: {name!r} ({kind}) must turn or slide between limits")
    return int(index)


def _swept(model: pin.Model, item: pin.GeometryObject, joints: Sequence[int]) -> pin.GeometryObject:
    corners, radius = support_points(item.geometry)
    points = (corners[:, None] + radius * _BALL).reshape(-1, 3) if radius > 0.0 else corners
    points = points @ item.placement.rotation.T + item.placement.translation
    joint, parent = item.parentJoint, item.parentJoint
    while joint in joints:
        parent, placement = model.parents[joint], model.jointPlacements[joint]
        points = _hull(_along(model, joint, points) @ placement.rotation.T + placement.translation, item.name)
        joint = parent
    shape, _ = convex_shape(points, f"what {item.name!r} passes through while it looks about", RobotError)
    made = item.copy()
    made.geometry, made.parentJoint, made.placement = shape, parent, pin.SE3.Identity()
    made.meshScale = np.ones(3)
    return made


def _hull(points: Array, name: str) -> Array:
    few, _ = few_corners(points, f"what {name!r} passes through", RobotError, most=_MOST_CORNERS)
    return few[convex_hull(few).vertices]


def _along(model: pin.Model, joint: int, points: Array) -> Array:
    """Points (n, 3) in the frame before a joint, whose hull holds ``points`` behind it wherever the joint is."""
    kind, k = model.joints[joint], model.joints[joint].idx_q
    data, q = kind.createData(), pin.neutral(model)

    def pose(value: float) -> pin.SE3:
        q[k] = value
        kind.calc(data, q)
        return data.M

    low, high = float(model.lowerPositionLimit[k]), float(model.upperPositionLimit[k])
    turns, count = kind.shortname().startswith("JointModelR"), 2
    if turns:
        count += math.ceil((high - low) / _ARC_STEP)
        turn = pin.log3(pose(0.1).rotation)
        axis = turn / np.linalg.norm(turn)
        out = 1.0 / np.cos(0.5 * (high - low) / (count - 1))  # the polygon is about the arc
        along = (points @ axis)[:, None] * axis
        points = np.vstack((points, along + out * (points - along)))
    poses = ((M.rotation, M.translation) for M in map(pose, np.linspace(low, high, count).tolist()))
    return np.vstack([points @ R.T + t for R, t in poses])
