"""Joints of a URDF: the tree that they make, their limits, and which of them follow another one."""

from __future__ import annotations

import math
from pathlib import Path

from lxml import etree

from elastic_strips.errors import RobotError, nearest_name

from .xml_file import Mends, check_origins, fault, floats

_JOINT_TYPES = {"revolute", "continuous", "prismatic", "fixed", "floating", "planar"}


def check_tree(root: etree._Element, links: set[str], source: Path) -> dict[str, tuple[str, str]]:
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


def check_joints(
    root: etree._Element, joints: set[str], source: Path, mends: Mends
) -> tuple[dict[str, tuple[float, float]], set[str], dict[str, tuple[str, float, float]], set[str]]:
    limits: dict[str, tuple[float, float]] = {}
    mimic: set[str] = set()
    followers: dict[str, tuple[str, float, float]] = {}
    continuous: set[str] = set()
    for joint in root.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        what = f"joint {name!r}"
        if kind not in _JOINT_TYPES:
            hint = nearest_name(kind, _JOINT_TYPES)
            raise fault(source, joint, f"{what} has unknown type {kind!r}{hint}")
        check_origins(joint, source, what)
        if kind in ("revolute", "continuous", "prismatic"):
            axis = joint.find("axis")
            length = 1.0 if axis is None else math.hypot(*floats(axis, "xyz", 3, source, what, "1 0 0", bound=1e6))
            if axis is not None and length < 1e-9:
                raise fault(source, axis, f"{what} has the axis 0 0 0; give a direction")
            if axis is not None and axis.get("xyz") is None:
                mends.add("joints with an <axis> without xyz, taken as 1 0 0", name)
                axis.set("xyz", "1 0 0")
        _check_unused(joint, source, what)
        if kind == "continuous":
            continuous.add(name)
        limit = joint.find("limit")
        if kind in ("revolute", "prismatic") and limit is None:
            raise fault(source, joint, f"{what} is {kind} and has no <limit>")
        if limit is not None and kind not in ("revolute", "continuous", "prismatic"):
            joint.remove(limit)
        elif limit is not None:
            (lower,) = floats(limit, "lower", 1, source, what, "0", bound=1e100)
            (upper,) = floats(limit, "upper", 1, source, what, "0", bound=1e100)
            for key in ("velocity", "effort"):
                (value,) = floats(limit, key, 1, source, what, "0")
                if value < 0:
                    raise fault(source, limit, f"{what} has {key} limit {value}; it must be ≥ 0")
                if limit.get(key) is None:
                    mends.add(f"joints with a <limit> without {key}, taken as unknown", name)
                    limit.set(key, "0")
            if kind in ("revolute", "prismatic"):
                if lower > upper:
                    raise fault(source, limit, f"{what} has lower limit {lower} above upper limit {upper}")
                limits[name] = (lower, upper)
        follower = joint.find("mimic")
        if follower is not None:
            leader = follower.get("joint")
            mimic.add(name)
            if leader not in joints:
                mends.add("joints that mimic one which the robot has not, locked unless told otherwise", name)
                joint.remove(follower)
                continue
            if leader == name:
                raise fault(source, follower, f"{what} has a <mimic> of itself")
            (multiplier,) = floats(follower, "multiplier", 1, source, what, "1")
            (offset,) = floats(follower, "offset", 1, source, what, "0")
            if kind in ("revolute", "continuous", "prismatic"):
                followers[name] = leader, multiplier, offset
            else:
                mends.add("joints with a <mimic> that have no value of their own (fixed, floating, planar), held", name)
    for name, (leader, _, _) in followers.items():
        if leader not in limits and leader not in continuous:
            mends.add("joints that mimic one without a value of its own (fixed, floating, planar), held", name)
    for joint in root.findall("joint"):
        chain = [joint.get("name")]
        while chain[-1] in followers:
            chain.append(followers[chain[-1]][0])
            if chain[-1] in chain[:-1]:
                raise fault(source, joint, f"joint {chain[0]!r} has a <mimic> in a ring: {' → '.join(chain)}")
    return limits, mimic, followers, continuous


def _check_unused(joint: etree._Element, source: Path, what: str) -> None:
    """What no model is made of, but urdfdom refuses where it is faulty."""
    for tag in ("safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    for element in joint.findall("dynamics"):
        for key in ("damping", "friction"):
            floats(element, key, 1, source, what, "0")
        if not {"damping", "friction"} & set(element.attrib):
            joint.remove(element)
