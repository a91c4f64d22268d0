"""Pinocchio's models with joints held still, and what has to hold of them to become a robot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import RobotError, nearest_name

from .kinematics import find_frame
from .mimic import followers_of
from .space import LIMIT_TOLERANCE

LONGEST_SLIDE = 1e3
"""How far a sliding joint without limits may go to either side [m]."""


def without_shapes(visual: pin.GeometryModel, collision: pin.GeometryModel) -> pin.GeometryModel:
    """The visual geometry of frames that have no collision geometry."""
    shaped = {obj.parentFrame for obj in collision.geometryObjects}
    out = pin.GeometryModel()
    for obj in visual.geometryObjects:
        if obj.parentFrame not in shaped:
            out.addGeometryObject(obj)
    return out


def followers_held(model: pin.Model, locked: Mapping[str, float], home: Mapping[str, float]) -> dict[str, float]:
    """Followers of joints that are locked, where those put them.

    Raises:
        RobotError: a follower that is to be locked, or to be elsewhere at home than where its leader puts it.
    """
    held = {}
    for name, (leader, multiplier, constant) in followers_of(model).items():
        if name in locked:
            raise RobotError(f"locked: {name!r} follows {leader!r}: lock that one, or neither")
        if leader in locked:
            held[name] = multiplier * locked[leader] + constant
        elif name in home and not abs(home[name] - multiplier * home.get(leader, np.nan) - constant) <= LIMIT_TOLERANCE:
            raise RobotError(f"home: {name!r} = {home[name]:.6g} is not where {leader!r}, which it follows, puts it")
    return held


def check_wrapping(model: pin.Model) -> None:
    """Check that a whole turn of a continuous joint leaves its followers where they were."""
    for name, (leader, multiplier, _) in followers_of(model).items():
        if model.joints[model.getJointId(leader)].nq == 2 and multiplier != round(multiplier):
            raise RobotError(
                f"joint {name!r} follows {leader!r}, which is continuous, {multiplier:g} times: it would be elsewhere "
                f"after a whole turn. Give {leader!r} limits, or lock it"
            )


def bound_sliders(model: pin.Model) -> None:
    """Give sliding joints without limits wide ones: how far a link can be from a joint before it must be known."""
    for i in range(1, model.njoints):
        kind, k = model.joints[i].shortname(), model.joints[i].idx_q
        if kind.startswith("JointModelP") and kind != "JointModelPlanar":
            model.lowerPositionLimit[k] = max(model.lowerPositionLimit[k], -LONGEST_SLIDE)
            model.upperPositionLimit[k] = min(model.upperPositionLimit[k], LONGEST_SLIDE)


def reduced_model(model: pin.Model, ids: list[int], reference: Array) -> pin.Model:
    """The model with joints held still.

    ``pin.buildReducedModel`` looks frames up by name, which fails where a link is called like a joint: so such links
    are called otherwise for as long as that takes.
    """
    kinds: dict[str, set[pin.FrameType]] = {}
    for frame in model.frames:
        kinds.setdefault(frame.name, set()).add(frame.type)
    twice = {f"{name} (link)": name for name, types in kinds.items() if len(types) > 1}
    if not twice:
        return pin.buildReducedModel(model, ids, reference)
    own = model.copy()
    for frame in own.frames:
        if frame.type == pin.FrameType.BODY and f"{frame.name} (link)" in twice:
            frame.name = f"{frame.name} (link)"
    reduced = pin.buildReducedModel(own, ids, reference)
    for frame in reduced.frames:
        frame.name = twice.get(frame.name, frame.name)
    return reduced


def carried_over(model: pin.Model, reduced: pin.Model, geometry: pin.GeometryModel) -> pin.GeometryModel:
    """The geometry of a model on its reduced model.

    ``pin.buildReducedModel`` does it too, but looks frames up by name alone, which fails where a link is called like
    its joint, and ends the process where an object has no frame.
    """
    bodies = {f.name: i for i, f in reversed(list(enumerate(reduced.frames))) if f.type == pin.FrameType.BODY}
    fixed = {f.name: f for f in reduced.frames if f.type == pin.FrameType.FIXED_JOINT}
    frames, names = list(model.frames), list(model.names)
    joints = {name: i for i, name in enumerate(reduced.names)}
    out = pin.GeometryModel()
    for obj in geometry.geometryObjects:
        own, joint = obj.copy(), names[obj.parentJoint]
        if joint in joints:
            own.parentJoint = joints[joint]
        else:  # locked: what is left of it is a frame
            own.parentJoint = fixed[joint].parentJoint
            own.placement = fixed[joint].placement * obj.placement
        on = next((i for i, f in enumerate(frames) if f.parentJoint == obj.parentJoint), 0)
        frame = frames[obj.parentFrame if obj.parentFrame < len(frames) else on]
        own.parentFrame = bodies.get(frame.name, find_frame(reduced, frame.name) or 0)
        out.addGeometryObject(own)
    return out


def check_joint_names(model: pin.Model, values: Mapping[str, float], what: str) -> None:
    names = [name for name in list(model.names)[1:] if name != "root_joint"]
    for joint, value in values.items():
        if joint not in names:
            raise RobotError(f"{what}: unknown joint {joint!r}{nearest_name(joint, names)}")
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not np.isfinite(value):
            raise RobotError(f"{what}: joint {joint!r} has value {value!r}; it must be a finite number [rad or m]")
        if (count := model.joints[model.getJointId(joint)].nv) > 1 and value != 0.0:
            raise RobotError(
                f"{what}: joint {joint!r} has {count} degrees of freedom, so that {value!r} says nothing about it; "
                "it can only be held where it is neutral (0)"
            )


def reference_configuration(model: pin.Model, values: Mapping[str, float]) -> Array:
    """The neutral configuration moved inside the limits, with some joints set."""
    q = pin.neutral(model)
    for i in range(1, model.njoints):
        joint, name = model.joints[i], model.names[i]
        if joint.nv != 1:
            continue
        if joint.nq == 2:
            angle = float(values.get(name, 0.0))
            q[joint.idx_q : joint.idx_q + 2] = np.cos(angle), np.sin(angle)
            continue
        low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        value = float(values.get(name, min(max(0.0, low), high)))
        if name in values and not low - LIMIT_TOLERANCE <= value <= high + LIMIT_TOLERANCE:
            raise RobotError(f"joint {name!r} = {value:.6g} is outside its limits [{low:.6g}, {high:.6g}]")
        q[joint.idx_q] = min(max(value, low), high)
    return q
