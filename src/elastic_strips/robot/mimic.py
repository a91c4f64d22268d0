"""Joints that follow another one (``<mimic>``): Pinocchio's models in which a leader moves its followers.

A follower has no coordinate of its own. Pinocchio wants a leader before its followers, and both with numbers of one
kind; so a leader that comes later is moved by a joint of its name in front of all others, which carries nothing.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Mask
from elastic_strips.errors import RobotError

from .space import LIMIT_TOLERANCE, UNLIMITED_SPEED, is_follower

_log = logging.getLogger(__name__)


class Following(NamedTuple):
    """What a follower does: its value is ``multiplier`` times that of its leader plus ``constant`` [rad or m]."""

    leader: str
    multiplier: float
    constant: float


def followers_of(model: pin.Model) -> dict[str, Following]:
    """The followers of a Pinocchio model, by name."""
    names = {joint.idx_q: name for joint, name in zip(model.joints, model.names, strict=True) if joint.nq > 0}
    found = {}
    for joint, name in zip(model.joints, model.names, strict=True):
        if is_follower(joint):
            follower = joint.extract()
            found[name] = Following(names[joint.idx_q], float(follower.scaling), float(follower.offset))
    return found


def carrier_name(leader: str) -> str:
    """Name of a leader's own joint in a model where another joint has its name and moves it."""
    return f"{leader} (moved)"


def with_followers(model: pin.Model, following: Mapping[str, Following]) -> pin.Model:
    """A model in which joints follow others, within the limits of them all.

    Args:
        model: a model of independent joints.
        following: follower → what it does; no leader is a follower, and no multiplier is 0.

    Raises:
        RobotError: the limits of a leader and its followers leave no value.
    """
    late = [
        leader
        for leader in dict.fromkeys(f.leader for f in following.values())
        if any(model.getJointId(leader) > model.getJointId(name) for name, f in following.items() if f.leader == leader)
    ]
    made = _rebuilt(model, following, late)
    for leader in late:
        made = _transformed(made, carrier_name(leader), Following(leader, 1.0, 0.0))
    for name, follower in following.items():
        made = _transformed(made, name, follower)
    for leader in dict.fromkeys(f.leader for f in following.values()):
        _narrow(model, made, leader, {name: f for name, f in following.items() if f.leader == leader})
    return made


def _transformed(model: pin.Model, name: str, follower: Following) -> pin.Model:
    return pin.transformJointIntoMimic(
        model, model.getJointId(follower.leader), model.getJointId(name), follower.multiplier, follower.constant
    )


def _rebuilt(model: pin.Model, following: Mapping[str, Following], late: list[str]) -> pin.Model:
    """The model with joints in front that move late leaders. A continuous joint becomes one that turns where its
    leader has one number, and not the two of a continuous joint."""
    out = pin.Model()
    out.name = model.name
    planar = model.njoints > 1 and model.joints[1].shortname() == "JointModelPlanar"
    new = [0]

    def add(parent: int, kind: pin.JointModel, placement: pin.SE3, name: str, i: int) -> int:
        joint = model.joints[i]
        at, along = slice(joint.idx_q, joint.idx_q + kind.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
        low, high = model.lowerPositionLimit[at], model.upperPositionLimit[at]
        if kind.nq != joint.nq:
            low, high = np.full(kind.nq, -np.finfo(float).max), np.full(kind.nq, np.finfo(float).max)
        return out.addJoint(
            parent, kind, placement, name, model.effortLimit[along], model.velocityLimit[along], low, high
        )

    def drive() -> None:
        for leader in late:
            i = model.getJointId(leader)
            add(new[-1] if planar else 0, model.joints[i], pin.SE3.Identity(), leader, i)

    if not planar:
        drive()
    for i in range(1, model.njoints):
        kind, name = model.joints[i], model.names[i]
        if name in following and kind.nq > model.joints[model.getJointId(following[name].leader)].nq:
            kind = _limited(kind)
        placement = model.jointPlacements[i]
        new.append(add(new[model.parents[i]], kind, placement, carrier_name(name) if name in late else name, i))
        out.inertias[new[i]] = model.inertias[i]
        if planar and i == 1:
            drive()
    for frame in list(model.frames)[1:]:
        out.addFrame(
            pin.Frame(
                frame.name, new[frame.parentJoint], frame.parentFrame, frame.placement, frame.type, frame.inertia
            ),
            False,
        )
    return out


def _limited(kind: pin.JointModel) -> pin.JointModel:
    """The joint that turns like a continuous one, by one number."""
    aligned = {"RUBX": pin.JointModelRX, "RUBY": pin.JointModelRY, "RUBZ": pin.JointModelRZ}
    found = aligned.get(kind.shortname().removeprefix("JointModel"))
    if found is not None:
        return pin.JointModel(found())
    alone = pin.Model()  # the joint does not say what its axis is
    alone.addJoint(0, kind, pin.SE3.Identity(), "turns")
    columns = pin.computeJointJacobians(alone, alone.createData(), pin.neutral(alone))
    return pin.JointModel(pin.JointModelRevoluteUnaligned(np.reshape(columns, -1)[3:]))


def _narrow(plain: pin.Model, model: pin.Model, leader: str, following: Mapping[str, Following]) -> None:
    """Give a leader the limits that its followers leave it."""
    joint = model.joints[model.getJointId(leader)]
    speed = [float(model.velocityLimit[joint.idx_v])]
    low = high = None
    if joint.nq == 1:
        low, high = float(model.lowerPositionLimit[joint.idx_q]), float(model.upperPositionLimit[joint.idx_q])
    for name, (_, multiplier, constant) in following.items():
        own = plain.joints[plain.getJointId(name)]
        velocity = float(plain.velocityLimit[own.idx_v])
        if 0.0 < velocity < UNLIMITED_SPEED:
            speed.append(velocity / abs(multiplier))
        if own.nq != 1 or low is None or high is None:
            continue
        ends = [float(limit[own.idx_q]) for limit in (plain.lowerPositionLimit, plain.upperPositionLimit)]
        least, most = sorted((end - constant) / multiplier for end in ends)
        if max(least - low, high - most) > LIMIT_TOLERANCE:
            _log.warning(
                "joint %r is planned from %.6g to %.6g: %r follows it, and has limits",
                leader,
                max(low, least),
                min(high, most),
                name,
            )
        low, high = max(low, least), min(high, most)
        if low > high:
            raise RobotError(f"joint {leader!r}: {name!r}, which follows it, is nowhere within its own limits")
    if low is not None and high is not None:
        model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q] = low, high
    if speed[0] > 0.0:  # what the leader does not state is asked for, and not guessed of its followers
        model.velocityLimit[joint.idx_v] = model.lowerVelocityLimit[joint.idx_v] = min(speed)  # as its reader sets both


def repaired(model: pin.Model, slides: Mask, axes: Array) -> None:
    """Make the followers of a model anew, in place: Pinocchio loses what they follow when it pickles a model, and ends
    the process at their first use.

    Args:
        model: as it was unpickled.
        slides: (njoints,) whether each joint slides.
        axes: (njoints, 3) the axis of each in its own frame.
    """
    for name, (leader, multiplier, constant) in followers_of(model).items():
        i, lead = model.getJointId(name), model.joints[model.getJointId(leader)]
        kind = "prismatic" if slides[i] else "continuous" if lead.nq == 2 else "revolute"
        alone = pin.buildModelFromXML(  # not every kind of joint can be made with an axis in Python
            f'<robot name="alone"><link name="a"/><link name="b"/><joint name="j" type="{kind}"><parent link="a"/>'
            f'<child link="b"/><axis xyz="{" ".join(map(repr, axes[i].tolist()))}"/>'
            '<limit effort="0" velocity="0"/></joint></robot>'
        )
        base, lost = alone.joints[1], model.joints[i]
        indices = lost.id, lost.idx_q, lost.idx_v, lost.idx_vExtended
        base.setIndexes(lead.id, lead.idx_q, lead.idx_v, lead.idx_vExtended)
        made = pin.JointModelMimic(base, multiplier, constant)
        made.setIndexes(*indices)
        model.joints[i] = pin.JointModel(made)
