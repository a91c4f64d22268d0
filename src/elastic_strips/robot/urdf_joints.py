"""Joints of a URDF: the tree that they make, their limits, and which of them follow another one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from lxml import etree

from elastic_strips.errors import RobotError, nearest_name

from .xml_file import Mends, check_origins, fault, floats

_MOVABLE = ("revolute", "continuous", "prismatic")
_JOINT_TYPES = {*_MOVABLE, "fixed", "floating", "planar"}


def check_tree(root: etree._Element, links: set[str], source: Path) -> dict[str, tuple[str, str]]:
    """Which joint and link carry each link but the root.

    Raises:
        RobotError: the joints make no tree.
    """
    parents: dict[str, tuple[str, str]] = {}
    for joint in root.findall("joint"):
        name = joint.get("name")
        ends = []
        for tag in ("parent", "child"):
            element = joint.find(tag)
            link = None if element is None else element.get("link")
            if link is None:
                raise fault(source, joint, f"joint {name!r} has no <{tag} link=…>")
            if link not in links:
                hint = nearest_name(link, links)
                raise fault(source, joint, f"joint {name!r} has unknown {tag} link {link!r}{hint}")
            ends.append(link)
        if ends[1] in parents:
            raise fault(source, joint, f"link {ends[1]!r} is the child of two joints")
        parents[ends[1]] = (name, ends[0])
    roots = links - set(parents)
    if len(roots) != 1:
        found = ", ".join(sorted(roots)[:10]) if roots else "none, so the joints form a loop"
        raise RobotError(f"{source}: a robot has exactly one root link; found {len(roots)} ({found})")
    for link in links:
        seen = {link}
        while link in parents:
            link = parents[link][1]
            if link in seen:
                raise RobotError(f"{source}: the joints form a loop through link {link!r}")
            seen.add(link)
    return parents


@dataclass(slots=True)
class Joints:
    """What a file says of its joints.

    Attributes:
        limits: joint → (lower, upper) of revolute and prismatic joints.
        mimic: joints that mimic another, be it there or not.
        followers: joint that mimics one that is there → (that one, multiplier, offset [rad or m]).
        continuous: joints that turn without end.
    """

    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    mimic: set[str] = field(default_factory=set)
    followers: dict[str, tuple[str, float, float]] = field(default_factory=dict)
    continuous: set[str] = field(default_factory=set)


def check_joints(root: etree._Element, names: set[str], source: Path, mends: Mends) -> Joints:
    """Check all joints; what urdfdom would refuse without need is taken out or mended.

    Raises:
        RobotError: a joint with a fault.
    """
    found = Joints()
    for joint in root.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        what = f"joint {name!r}"
        if kind not in _JOINT_TYPES:
            hint = nearest_name(kind, _JOINT_TYPES)
            raise fault(source, joint, f"{what} has unknown type {kind!r}{hint}")
        check_origins(joint, source, what)
        if kind in _MOVABLE:
            _check_axis(joint, source, mends)
        _check_unused(joint, source, what)
        if kind == "continuous":
            found.continuous.add(name)
        limits = _check_limit(joint, source, mends)
        if limits is not None:
            found.limits[name] = limits
        _check_mimic(joint, names, found, source, mends)
    for name, (leader, _, _) in found.followers.items():
        if leader not in found.limits and leader not in found.continuous:
            mends.add("joints that mimic one without a value of its own (fixed, floating, planar), held", name)
    _refuse_rings(root, found.followers, source)
    return found


def _check_axis(joint: etree._Element, source: Path, mends: Mends) -> None:
    axis = joint.find("axis")
    if axis is None:
        return
    what = f"joint {joint.get('name')!r}"
    if math.hypot(*floats(axis, "xyz", 3, source, what, "1 0 0", bound=1e6)) < 1e-9:
        raise fault(source, axis, f"{what} has the axis 0 0 0; give a direction")
    if axis.get("xyz") is None:
        mends.add("joints with an <axis> without xyz, taken as 1 0 0", joint.get("name"))
        axis.set("xyz", "1 0 0")


def _check_limit(joint: etree._Element, source: Path, mends: Mends) -> tuple[float, float] | None:
    """The limits of a revolute or prismatic joint; a <limit> of what does not move is taken out."""
    name, kind, limit = joint.get("name"), joint.get("type"), joint.find("limit")
    what = f"joint {name!r}"
    bounded = kind in ("revolute", "prismatic")
    if limit is None:
        if bounded:
            raise fault(source, joint, f"{what} is {kind} and has no <limit>")
        return None
    if kind not in _MOVABLE:
        joint.remove(limit)
        return None
    (lower,) = floats(limit, "lower", 1, source, what, "0", bound=1e100)
    (upper,) = floats(limit, "upper", 1, source, what, "0", bound=1e100)
    for key in ("velocity", "effort"):
        (value,) = floats(limit, key, 1, source, what, "0")
        if value < 0:
            raise fault(source, limit, f"{what} has {key} limit {value}; it must be ≥ 0")
        if limit.get(key) is None:
            mends.add(f"joints with a <limit> without {key}, taken as unknown", name)
            limit.set(key, "0")
    if bounded and lower > upper:
        raise fault(source, limit, f"{what} has lower limit {lower} above upper limit {upper}")
    return (lower, upper) if bounded else None


def _check_mimic(joint: etree._Element, names: set[str], found: Joints, source: Path, mends: Mends) -> None:
    """Whom a joint mimics, if it does."""
    follower = joint.find("mimic")
    if follower is None:
        return
    name, leader = joint.get("name"), follower.get("joint")
    what = f"joint {name!r}"
    found.mimic.add(name)
    if leader not in names:
        mends.add("joints that mimic one that the robot does not have, locked unless told otherwise", name)
        joint.remove(follower)
        return
    if leader == name:
        raise fault(source, follower, f"{what} has a <mimic> of itself")
    (multiplier,) = floats(follower, "multiplier", 1, source, what, "1")
    (offset,) = floats(follower, "offset", 1, source, what, "0")
    if joint.get("type") in _MOVABLE:
        found.followers[name] = leader, multiplier, offset
    else:
        mends.add("joints with a <mimic> that have no value of their own (fixed, floating, planar), held", name)


def _refuse_rings(root: etree._Element, followers: Mapping[str, tuple[str, float, float]], source: Path) -> None:
    for joint in root.findall("joint"):
        chain = [joint.get("name")]
        while chain[-1] in followers:
            chain.append(followers[chain[-1]][0])
            if chain[-1] in chain[:-1]:
                raise fault(source, joint, f"joint {chain[0]!r} has a <mimic> in a ring: {' → '.join(chain)}")


def _check_unused(joint: etree._Element, source: Path, what: str) -> None:
    """Check elements that no model needs, but for whose faults urdfdom refuses the file."""
    for tag in ("safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    for element in joint.findall("dynamics"):
        for key in ("damping", "friction"):
            floats(element, key, 1, source, what, "0")
        if not {"damping", "friction"} & set(element.attrib):
            joint.remove(element)
