"""SRDF: the self-collision pairs to ignore, the named postures and the groups of joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from lxml import etree

from elastic_strips.errors import RobotError

from .space import LIMIT_TOLERANCE
from .urdf import UrdfSource
from .xml_file import Mends, fault, read_xml

_KNOWN = {
    "robot", "group", "joint", "link", "chain", "group_state", "end_effector", "virtual_joint", "passive_joint",
    "disable_collisions", "enable_collisions", "disable_default_collisions", "link_sphere_approximation", "sphere",
    "joint_property", "group_property",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Srdf:
    """What an SRDF file says that planning uses.

    Attributes:
        path: the file.
        name: name of the robot that it is written for.
        disabled: unordered link pairs whose collisions are not checked, and the reason that the file gives.
        enabled: pairs that it asks for, of links that it leaves out otherwise.
        states: posture name → joint → value [rad or m].
        groups: group name → its joints that can be planned.
    """

    path: Path
    name: str
    disabled: dict[frozenset[str], str] = field(default_factory=dict)
    enabled: frozenset[frozenset[str]] = frozenset()
    states: dict[str, dict[str, float]] = field(default_factory=dict)
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)


def read_srdf(path: str | Path, robot: UrdfSource) -> Srdf:
    """Read an SRDF file against the links and joints of its robot.

    It may name links, joints and groups that the robot does not have. They are ignored with a warning: such files are
    written for whole families of robots.

    Raises:
        RobotError: unreadable or malformed.
    """
    source = Path(path)
    root = read_xml(source, root="robot", kind="SRDF")
    mends = Mends(source)
    for element in root.iter():
        if element.tag not in _KNOWN:
            mends.add("unknown elements", element.tag)
    disabled, enabled = _collisions(root, source, robot, mends)
    states = _states(root, source, robot, mends)
    passive = {element.get("name") for element in root.findall("passive_joint")}
    elements = {element.get("name"): element for element in root.findall("group")}
    single = (set(robot.joint_limits) | set(robot.continuous)) - robot.mimic - passive
    virtual = _virtual(root)
    groups = {}
    for name in filter(None, elements):
        found = _group(elements, name, robot, mends, virtual)
        groups[name] = tuple(joint for joint in dict.fromkeys(found) if joint in single)
    mends.say()
    return Srdf(source, root.get("name", ""), disabled, enabled, states, groups)


def _collisions(
    root: etree._Element, source: Path, robot: UrdfSource, mends: Mends
) -> tuple[dict[frozenset[str], str], frozenset[frozenset[str]]]:
    """The pairs that are left out, with reasons, and those that are asked for.

    As MoveIt reads it: a link of ``disable_default_collisions`` is left out of all pairs, but those that
    ``enable_collisions`` asks for; ``disable_collisions`` has the last word.
    """

    def named(element: etree._Element, *keys: str) -> list[str]:
        names = []
        for key in keys:
            name = element.get(key)
            if name is None:
                raise fault(source, element, f"<{element.tag}> has no attribute {key!r}")
            if name not in robot.links:
                mends.add(f"links in <{element.tag}> that the robot does not have", name)
            names.append(name)
        return names

    disabled: dict[frozenset[str], str] = {}
    enabled = {frozenset(named(element, "link1", "link2")) for element in root.iter("enable_collisions")}
    for element in root.iter("disable_default_collisions"):
        (link,) = named(element, "link")
        disabled.update({frozenset((link, other)): "by default" for other in robot.links if other != link})
    for pair in enabled:
        disabled.pop(pair, None)
    for element in root.iter("disable_collisions"):
        disabled[frozenset(named(element, "link1", "link2"))] = element.get("reason", "")
    return disabled, frozenset(enabled - set(disabled))


def _states(root: etree._Element, source: Path, robot: UrdfSource, mends: Mends) -> dict[str, dict[str, float]]:
    virtual = _virtual(root)
    states: dict[str, dict[str, float]] = {}
    for element in root.iter("group_state"):
        name = element.get("name")
        if not name:
            raise fault(source, element, "<group_state> has no name")
        values = states.setdefault(name, {})
        for joint in element.iter("joint"):
            key = joint.get("name")
            if key in virtual:
                continue  # the base's pose, which the caller gives
            if key not in robot.joints:
                mends.add("joints in <group_state> that the robot does not have", key)
            elif key not in robot.joint_limits and key not in robot.continuous:
                mends.add("joints in <group_state> that are not prismatic, revolute or continuous", key)
            else:
                values[key] = _value(joint, robot, f"{source}:{joint.sourceline}: state {name!r}")
                if not within_limits(values[key], robot, key):
                    mends.add("joints outside their limits in a state, which cannot be taken", f"{name}: {key}")
    return {name: values for name, values in states.items() if values}


def _virtual(root: etree._Element) -> set[str]:
    """Joints of the base, which no URDF has: ``root_joint`` is Pinocchio's name for it."""
    return {element.get("name") for element in root.findall("virtual_joint")} | {"root_joint"}


def within_limits(value: float, robot: UrdfSource, joint: str) -> bool:
    """Whether a joint's value is within its limits, or outside by rounding."""
    low, high = robot.joint_limits.get(joint, (-math.inf, math.inf))
    return low - LIMIT_TOLERANCE <= value <= high + LIMIT_TOLERANCE


def _value(joint: etree._Element, robot: UrdfSource, where: str) -> float:
    """The value [rad or m] of a joint: a full turn away from the written one where only that is within its limits.

    A continuous joint may have a cosine and a sine, as Pinocchio writes it.
    """
    name, text = joint.get("name"), joint.get("value")
    try:
        numbers = [float(word) for word in (text or "").split()]
    except ValueError:
        numbers = []
    if name in robot.continuous and len(numbers) == 2:
        numbers = [math.atan2(numbers[1], numbers[0])]
    if len(numbers) != 1 or not math.isfinite(numbers[0]):
        raise RobotError(f"{where}: joint {name!r} has value {text!r}, not a number")
    turns = (0.0,) if name in robot.prismatic else (0.0, 2.0 * math.pi, -2.0 * math.pi)
    fitting = (numbers[0] + turn for turn in turns if within_limits(numbers[0] + turn, robot, name))
    return next(fitting, numbers[0])


def _group(
    elements: dict[str, etree._Element], name: str, robot: UrdfSource, mends: Mends, passed: set[str]
) -> list[str]:
    """Joints of a group: its own, those that carry its links, those along its chains, and those of its sub-groups.

    Args:
        elements: all groups.
        name: which one.
        robot: the robot.
        mends: takes the names that the robot does not have.
        passed: joints, and groups that hold this one, to pass over in silence.
    """
    joints: list[str] = []
    for member in elements[name]:
        own = member.get("name")
        if member.tag == "joint" and own in robot.joints:
            joints.append(own)
        elif member.tag == "joint" and own not in passed:
            mends.add("joints in <group> that the robot does not have", own)
        elif member.tag == "link" and own not in robot.links:
            mends.add("links in <group> that the robot does not have", own)
        elif member.tag == "link" and own in robot.parents:
            joints.append(robot.parents[own][0])
        elif member.tag == "chain":
            joints += _chain(member, robot, mends)
        elif member.tag == "group" and own not in elements:
            mends.add("sub-groups that the file does not have", own)
        elif member.tag == "group" and own not in passed and own != name:  # a group cannot hold itself
            joints += _group(elements, own, robot, mends, passed | {name})
    return joints


def _chain(member: etree._Element, robot: UrdfSource, mends: Mends) -> list[str]:
    """The joints from one link to another one."""
    ends = [member.get("base_link"), member.get("tip_link")]
    missing = [end for end in ends if end not in robot.links]
    for end in missing:
        mends.add("links in <group> that the robot does not have", end)
    if missing:
        return []
    base, tip = (_joints_above(robot, end) for end in ends)
    return [j for j in reversed(tip) if j not in base] + [j for j in base if j not in tip]


def _joints_above(robot: UrdfSource, link: str) -> list[str]:
    """Joints from a link up to the root."""
    joints = []
    while link in robot.parents:
        joint, link = robot.parents[link]
        joints.append(joint)
    return joints
