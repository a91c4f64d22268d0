"""Which joints are planned, which follow them, and which are held still, where, and why."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from elastic_strips.errors import RobotError, listed, nearest_name
from elastic_strips.validation import MAX_LENGTH

from .mimic import Following, with_followers
from .model import RobotModel
from .space import LIMIT_TOLERANCE
from .srdf import Srdf, within_limits
from .urdf import UrdfSource
from .wheels import wheel_joints

_log = logging.getLogger(__name__)
_LONGEST_FINGER_WAY = 0.15  # [m] of a joint that slides a finger
_FINGER_WORDS = ("finger", "jaw", "gripper")
_LARGEST_RATIO = 1e6  # of a follower's speed and its leader's, or the other way round
_SELDOM_PLANNED = (
    "wheel", "caster", "roller", "finger", "thumb", "gripper", "knuckle", "palm", "jaw", "hand_", "index", "middle",
    "ring_", "pinky", "little", "head", "neck", "eye",
)  # fmt: skip
"""Words in the names of joints that an arm's motion can do without."""


def planned_joints(
    source: UrdfSource,
    semantics: Srdf | None,
    joints: Iterable[str] | None,
    group: str | None,
    locked: Mapping[str, float] | None,
) -> frozenset[str] | None:
    """The joints to plan, or None where all are planned but those that are locked."""
    if joints is not None and group is not None:
        raise RobotError(f"joints={joints!r} and group={group!r} both say what is planned; give one of them")
    if group is not None:
        joints = _of_group(group, source, semantics)
    if joints is None:
        return None
    if isinstance(joints, str):
        raise RobotError(f"joints={joints!r} is one text; give a list of joint names")
    named = list(joints)
    _check_planned(source, named)
    planned = frozenset(joint for joint in named if joint not in source.followers)
    both = sorted(planned & set(locked or {}))
    if both:
        raise RobotError(f"joints that are to be planned and locked: {', '.join(both)}; name each in one of the two")
    return planned


def _of_group(group: str, source: UrdfSource, semantics: Srdf | None) -> list[str]:
    """The joints of an SRDF's group that can be planned; the log names the others.

    Raises:
        RobotError: no such group, or none can.
    """
    groups = {} if semantics is None else semantics.groups
    if group not in groups:
        where = "no SRDF is given" if semantics is None else str(semantics.path)
        raise RobotError(f"unknown group {group!r} ({where}){nearest_name(group, groups)}")
    joints: list[str] = []
    for joint in groups[group]:
        if why := _cannot_lead(source, joint):
            _log.warning("group %r: joint %r is held still: %s", group, joint, why)
        else:
            joints.append(joint)
    if not joints:
        raise RobotError(f"group {group!r} of {semantics and semantics.path} has no joint that can be planned")
    return joints


def _check_planned(source: UrdfSource, joints: Collection[str]) -> None:
    """Raise a `RobotError` where one of the joints does not move, cannot lead, or follows one that is not named."""
    movable, following = set(source.joint_limits) | set(source.continuous), source.following()
    for joint in joints:
        if joint not in movable:
            hint = " is fixed, floating or planar" if joint in source.joints else nearest_name(joint, movable)
            raise RobotError(f"joints: cannot plan {joint!r}{hint}")
        if why := _cannot_lead(source, joint):
            raise RobotError(f"joints: cannot plan {joint!r}: {why}. Hold it still (locked={{{joint!r}: …}}, --lock)")
        if joint in source.followers and following[joint].leader not in joints:
            leader = following[joint].leader
            raise RobotError(
                f"joints: cannot plan {joint!r} alone: it has to <mimic> {leader!r}. Plan that one, and it follows; or "
                f"hold that one still (locked={{{leader!r}: …}}, --lock), and it is held where that puts it"
            )


def resting_joints(model: pin.Model, source: UrdfSource) -> frozenset[str]:
    """The joints that are held still where the caller says nothing about any.

    Joints that others mimic are held if they carry no more than these: grippers. A lift that carries an arm is planned.
    Fingers that move each by itself are held, too.
    """
    wheels, following = wheel_joints(model, source), source.following()
    resting, movable = wheels | source.mimic, {*source.joint_limits, *source.continuous}
    held = set()
    for leader in {follower.leader for follower in following.values()} - wheels:
        own = [leader, *(name for name, follower in following.items() if follower.leader == leader)]
        ids = [model.getJointId(name) for name in own if model.existJointName(name)]
        carries = leader in movable and {model.names[k] for i in ids for k in model.subtrees[i]} - set(own) - resting
        why = _cannot_lead(source, leader)
        if carries and why:
            _log.warning("%s: joint %r is held still: %s", source.path, leader, why)
        if why or not carries:
            held.add(leader)
    resting = resting | held | _fingers_alone(model, source)
    return frozenset(joint for joint in resting if model.existJointName(joint))


def _fingers_alone(model: pin.Model, source: UrdfSource) -> set[str]:
    """The fingers of grippers of which none mimics another: two or more joints at the end of an arm that carry no
    further joint, hang on one link, and slide a little or are called fingers or jaws."""
    at: dict[int, list[str]] = {}
    for name, (low, high) in source.joint_limits.items():
        i = model.getJointId(name) if model.existJointName(name) else 0
        on = model.parents[i] if i else 0
        if not on or model.joints[on].shortname() == "JointModelPlanar" or len(model.subtrees[i]) > 1:
            continue
        slides = model.joints[i].shortname().startswith("JointModelP") and high - low <= _LONGEST_FINGER_WAY
        if slides or any(word in name.lower() for word in _FINGER_WORDS):
            at.setdefault(on, []).append(name)
    return {name for fingers in at.values() if len(fingers) > 1 for name in fingers}


def _cannot_lead(source: UrdfSource, leader: str) -> str:
    """Why joints cannot follow a leader wherever it goes; empty where they can, or where no joint has to."""
    low, high = source.joint_limits.get(leader, (-math.inf, math.inf))
    for name, (first, multiplier, constant) in source.following().items():
        if first != leader or multiplier == 0.0:
            continue
        if not (1.0 / _LARGEST_RATIO <= abs(multiplier) <= _LARGEST_RATIO and abs(constant) <= MAX_LENGTH):
            return f"{name!r} has to <mimic> it {multiplier:g} times plus {constant:g}: neither gear nor lift does that"
        if leader in source.continuous and not (name in source.continuous and multiplier == round(multiplier)):
            how = f"{multiplier:g} times" if name in source.continuous else "within limits"
            return f"it is continuous, and {name!r}, which has to <mimic> it {how}, would not go around with it"
        if name in source.joint_limits:
            least, most = sorted((limit - constant) / multiplier for limit in source.joint_limits[name])
            low, high = max(low, least), min(high, most)
            if low > high:
                return f"{name!r}, which has to <mimic> it, is nowhere within its own limits"
    return ""


def with_leaders(source: UrdfSource, locked: Mapping[str, float]) -> dict[str, float]:
    """Locked values, with the values that the leaders of locked joints must have.

    Raises:
        RobotError: a leader has no such value, or it is outside the leader's limits.
    """
    found: dict[str, float] = {}
    for first in locked:
        name, value = first, locked[first]
        while name in source.followers and source.followers[name][0] not in locked:
            leader, multiplier, constant = source.followers[name]
            where = f"locked: joint {first!r} at {locked[first]:.6g} mimics {leader!r}, which"
            if multiplier == 0.0 or leader not in {*source.joint_limits, *source.continuous}:
                if abs(value - constant) > LIMIT_TOLERANCE:
                    raise RobotError(f"{where} holds it at {constant:.6g}")
                break
            name, value = leader, (value - constant) / multiplier + 0.0  # no −0
            if not within_limits(value, source, leader):
                low, high = source.joint_limits[leader]
                raise RobotError(f"{where} would be at {value:.6g}, outside its limits [{low:.6g}, {high:.6g}]")
            if abs(found.setdefault(leader, value) - value) > LIMIT_TOLERANCE:
                raise RobotError(f"{where} would be at {value:.6g} for it, and at {found[leader]:.6g} for another")
            above, multiplier, constant = source.followers.get(leader, ("", 0.0, 0.0))
            if above in locked and abs(multiplier * locked[above] + constant - value) > LIMIT_TOLERANCE:
                put = multiplier * locked[above] + constant
                raise RobotError(f"{where} would be at {value:.6g} for it; {above!r}, locked too, puts it at {put:.6g}")
    return {**found, **locked}


def following_planned(source: UrdfSource, planned: frozenset[str], locked: Mapping[str, float]) -> dict[str, Following]:
    """The joints that follow planned ones.

    Raises:
        RobotError: one of them was to be held still.
    """
    following = {name: f for name, f in source.following().items() if f.leader in planned and f.multiplier != 0.0}
    for name, follower in following.items():
        if name in locked:
            raise RobotError(
                f"locked: {name!r} follows {follower.leader!r}, which is planned: lock that one, or neither"
            )
    return following


def with_their_limits(
    model: pin.Model, source: UrdfSource, following: Mapping[str, Following]
) -> tuple[pin.Model, UrdfSource]:
    """The model in which joints follow, and the description with the limits that they leave their leaders."""
    if not following:
        return model, source
    model, limits = with_followers(model, following), dict(source.joint_limits)
    for leader in {follower.leader for follower in following.values()} & set(limits):
        k = model.joints[model.getJointId(leader)].idx_q
        limits[leader] = float(model.lowerPositionLimit[k]), float(model.upperPositionLimit[k])
    return model, replace(source, joint_limits=limits)


def compare_states(robot: str, semantics: Srdf | None, followers: Mapping[str, Following]) -> None:
    """Warn about states that have followers elsewhere than where their leaders put them."""
    for state, values in ({} if semantics is None else semantics.states).items():
        for name, (leader, multiplier, constant) in followers.items():
            wanted = multiplier * values.get(leader, np.nan) + constant
            if name in values and abs(values[name] - wanted) > LIMIT_TOLERANCE:
                _log.warning(
                    "%s: state %r has %r at %.6g; it follows %r, which puts it at %.6g",
                    robot,
                    state,
                    name,
                    values[name],
                    leader,
                    wanted,
                )


def held_still(
    source: UrdfSource, names: frozenset[str], locked: Mapping[str, float], home: Mapping[str, float]
) -> dict[str, float]:
    """Values of the joints that are held still: given ones, where those put what mimics them, and those of home."""

    def value(joint: str) -> float:
        if joint in locked:
            return locked[joint]
        if joint not in source.followers:
            return _clip(home.get(joint, 0.0), source, joint)
        leader, multiplier, offset = source.followers[joint]
        return _clip(multiplier * value(leader) + offset, source, joint)

    return {joint: value(joint) for joint in sorted(names - set(locked))} | dict(locked)


def what_to_lock(robot: RobotModel) -> str:
    """Which of a robot's many joints might better be held still."""
    names = robot.joint_names
    ends = [name for name in names if any(word in name.lower() for word in _SELDOM_PLANNED)] or _fingers(robot)
    said = f"Name those to plan with joints=[…]{' or group=…' if robot.groups else ''}, or hold some still: "
    if ends:
        return f"{said}locked={{{', '.join(f'{name!r}: {0.0:g}' for name in ends[:12])}{', …' * (len(ends) > 12)}}}"
    if robot.groups:
        return f"{said}the SRDF's groups are {quoted(tuple(robot.groups), 12)}"
    return f"{said}locked={{…}}, of {quoted(names, 40)}"


def _fingers(robot: RobotModel) -> list[str]:
    """The joints of what branches off several times from one body at the end of a chain, as fingers do."""
    model = robot.model
    first = model.njoints - len(robot.joint_names)
    leaves = {i: [k for k in model.subtrees[i] if k != i] for i in range(first, model.njoints)}
    chains = [i for i, inner in leaves.items() if len(inner) <= 3 and all(len(leaves[k]) <= 3 for k in inner)]
    parents = Counter(model.parents[i] for i in chains if model.parents[i] not in chains)
    roots = [i for i in chains if parents.get(model.parents[i], 0) >= 3 and model.parents[i] >= first]
    return [model.names[k] for i in roots for k in (i, *leaves[i])]


def why_held(
    source: UrdfSource,
    still: Mapping[str, float],
    locked: Mapping[str, float],
    wheels: set[str],
    planned: frozenset[str] | None,
) -> dict[str, str]:
    """Why each held joint is held still."""

    def why(joint: str) -> str:
        if joint in locked:
            return "locked by the caller"
        if joint in wheels:
            return "a wheel or a caster"
        if joint in source.followers:
            return f"mimics {source.followers[joint][0]}"
        if joint in source.mimic:
            return "mimics a joint that is not there"
        if followers := [name for name, follower in source.following().items() if follower.leader == joint]:
            return f"mimicked by {', '.join(followers)}"
        return "not among the joints to plan" if planned is not None else "a finger of a gripper"

    return {joint: why(joint) for joint in still}


def _clip(value: float, source: UrdfSource, joint: str) -> float:
    low, high = source.joint_limits.get(joint, (-float("inf"), float("inf")))
    return min(max(value, low), high)


def quoted(names: Sequence[str], most: int) -> str:
    return listed([repr(name) for name in names], most)
