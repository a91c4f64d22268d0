"""The validating URDF reader: every fault is one error that names the file and the element.

Pinocchio's own parser reports a fault as a line on standard error or a crash in C++, and some trifles as one; so a
description is checked here first, and Pinocchio and Coal build their models from a copy in which trifles are mended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import pinocchio as pin
from lxml import etree

from ..errors import RobotError, nearest_name
from ..summary import shortened
from .mends import Mends
from .urdf_geometry import MAX_LENGTH, check_geometry, search_folders
from .xml_source import floats, read_xml

_JOINT_TYPES = {"revolute", "continuous", "prismatic", "fixed", "floating", "planar"}
_ROUNDING = 1e-12  # a moment of inertia [kg m²] below 0 by at most this was 0 before it was rounded
_RESERVED = ("root_joint", "universe")  # names that Pinocchio's models give themselves


@dataclass(frozen=True, slots=True)
class UrdfSource:
    """A checked URDF file.

    Attributes:
        path: the file.
        document: the description as Pinocchio gets it: trifles mended, mesh files by their paths.
        links, joints: all names.
        parents: link → (joint, link) that carry it; the root has none.
        joint_limits: joint → (lower, upper) of revolute and prismatic joints.
        mimic: names of joints that mimic another.
        continuous, prismatic: names of such joints.
        collisions: link → number of its collision shapes.
    """

    path: Path
    document: str
    links: frozenset[str]
    joints: frozenset[str]
    parents: dict[str, tuple[str, str]]
    joint_limits: dict[str, tuple[float, float]]
    mimic: frozenset[str]
    continuous: frozenset[str]
    prismatic: frozenset[str]
    collisions: dict[str, int]


def read_urdf(path: str | Path, *, package_dirs: tuple[str | Path, ...] = ()) -> UrdfSource:
    """Check a URDF file and everything that it refers to.

    Mended, with a warning: materials and robots without a name, visual shapes that cannot be drawn, joints that mimic
    one that is not there, moments of inertia below 0 by rounding.

    Args:
        path: the file.
        package_dirs: further folders to search for ``package://name/…`` (each holds the folder ``name``).

    Raises:
        RobotError: a fault; the message names the file, the element and what would be valid.
    """
    source = Path(path).expanduser().absolute()
    root = read_xml(source, root="robot", kind="URDF")
    links = _names(root, "link", source)
    joints = _names(root, "joint", source)
    mends = Mends(source)
    parents = _check_tree(root, links, source)
    limits, mimic, continuous = _check_joints(root, joints, source, mends)
    _check_inertials(root, source, mends)
    check_geometry(root, source, search_folders(source, package_dirs), mends)
    if not root.get("name"):
        mends.add("robot without a name, called", source.stem)
        root.set("name", source.stem)
    mends.say()
    return UrdfSource(
        path=source,
        document=_bare(root),
        links=frozenset(links),
        joints=frozenset(joints),
        parents=parents,
        joint_limits=limits,
        mimic=frozenset(mimic),
        continuous=frozenset(continuous),
        prismatic=frozenset(j.get("name") for j in root.findall("joint") if j.get("type") == "prismatic"),
        collisions={link.get("name"): len(link.findall("collision")) for link in root.findall("link")},
    )


def pinocchio_model(source: UrdfSource, *, planar: bool = False) -> pin.Model:
    """Pinocchio's model of a checked URDF file, on a planar root or a fixed one.

    Raises:
        RobotError: Pinocchio refuses it, in its words.
    """
    try:
        return (
            pin.buildModelFromXML(source.document, pin.JointModelPlanar())
            if planar
            else pin.buildModelFromXML(source.document)
        )
    except Exception as error:  # C++ exceptions arrive as ValueError, RuntimeError, IndexError …
        raise RobotError(f"{source.path}: Pinocchio cannot build the model: {_words(error)}") from None


def pinocchio_geometry(source: UrdfSource, model: pin.Model, kind: pin.GeometryType) -> pin.GeometryModel:
    """Collision or visual geometry of a checked URDF file.

    Raises:
        RobotError: Pinocchio or Coal refuse it, in their words.
    """
    try:
        return pin.buildGeomFromUrdfString(model, source.document, kind, mesh_loader=coal.CachedMeshLoader())
    except Exception as error:
        raise RobotError(f"{source.path}: Pinocchio cannot read the geometry: {_words(error)}") from None


def _words(error: Exception) -> str:
    """What Pinocchio, Coal or Assimp say, which may quote a whole file."""
    return shortened(" ".join(str(error).split()), 300)


def _bare(root: Any) -> str:
    """The description without what no model is made of: plugins, transmissions."""
    for element in list(root):
        if element.tag not in ("link", "joint", "material"):
            root.remove(element)
    return etree.tostring(root, encoding="unicode")


def _names(root: Any, tag: str, source: Path) -> set[str]:
    names: set[str] = set()
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise RobotError(f"{source}:{element.sourceline}: a <{tag}> has no name")
        if tag == "joint" and name in _RESERVED:
            raise RobotError(f"{source}:{element.sourceline}: <joint> {name!r}: this name is reserved; give it another")
        if name in names:
            raise RobotError(f"{source}:{element.sourceline}: <{tag}> {name!r} is defined twice")
        names.add(name)
    if tag == "link" and not names:
        raise RobotError(f"{source}: the robot has no <link>")
    return names


def _check_tree(root: Any, links: set[str], source: Path) -> dict[str, tuple[str, str]]:
    parent_of: dict[str, str] = {}
    parents: dict[str, tuple[str, str]] = {}
    for joint in root.findall("joint"):
        name = joint.get("name")
        ends = []
        for tag in ("parent", "child"):
            element = joint.find(tag)
            link = None if element is None else element.get("link")
            if link is None:
                raise RobotError(f"{source}:{joint.sourceline}: joint {name!r} has no <{tag} link=…>")
            if link not in links:
                raise RobotError(
                    f"{source}:{joint.sourceline}: joint {name!r} has unknown {tag} link {link!r}"
                    + nearest_name(link, links)
                )
            ends.append(link)
        if ends[1] in parent_of:
            raise RobotError(f"{source}:{joint.sourceline}: link {ends[1]!r} is the child of two joints")
        parent_of[ends[1]] = ends[0]
        parents[ends[1]] = (name, ends[0])
    roots = links - set(parent_of)
    if len(roots) != 1:
        found = ", ".join(sorted(roots)[:10]) if roots else "none, so the joints form a loop"
        raise RobotError(f"{source}: a robot has exactly one root link; found {len(roots)} ({found})")
    for link in links:
        seen = {link}
        while link in parent_of:
            link = parent_of[link]
            if link in seen:
                raise RobotError(f"{source}: the joints form a loop through link {link!r}")
            seen.add(link)
    return parents


def _check_joints(
    root: Any, joints: set[str], source: Path, mends: Mends
) -> tuple[dict[str, tuple[float, float]], set[str], set[str]]:
    limits: dict[str, tuple[float, float]] = {}
    mimic: set[str] = set()
    continuous: set[str] = set()
    for joint in root.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        what = f"joint {name!r}"
        if kind not in _JOINT_TYPES:
            hint = nearest_name(kind, _JOINT_TYPES)
            raise RobotError(f"{source}:{joint.sourceline}: {what} has unknown type {kind!r}{hint}")
        for origin in joint.findall("origin"):
            floats(origin, "xyz", 3, source, what, "0 0 0", bound=MAX_LENGTH)
            floats(origin, "rpy", 3, source, what, "0 0 0", bound=MAX_LENGTH)
        if kind in ("revolute", "continuous", "prismatic"):
            axis = joint.find("axis")
            length = 1.0 if axis is None else math.hypot(*floats(axis, "xyz", 3, source, what, "1 0 0", bound=1e6))
            if axis is not None and length < 1e-9:
                raise RobotError(f"{source}:{axis.sourceline}: {what} has the axis 0 0 0; give a direction")
        if kind == "continuous":
            continuous.add(name)
        if kind in ("revolute", "prismatic"):
            limit = joint.find("limit")
            if limit is None:
                raise RobotError(f"{source}:{joint.sourceline}: {what} is {kind} and has no <limit>")
            (lower,) = floats(limit, "lower", 1, source, what, "0", bound=1e100)
            (upper,) = floats(limit, "upper", 1, source, what, "0", bound=1e100)
            for key in ("velocity", "effort"):
                (value,) = floats(limit, key, 1, source, what, "0")
                if value < 0:
                    raise RobotError(f"{source}:{limit.sourceline}: {what} has {key} limit {value}; it must be ≥ 0")
            if lower > upper:
                raise RobotError(
                    f"{source}:{limit.sourceline}: {what} has lower limit {lower} above upper limit {upper}"
                )
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
                raise RobotError(f"{source}:{follower.sourceline}: {what} has a <mimic> of itself")
            floats(follower, "multiplier", 1, source, what, "1")
            floats(follower, "offset", 1, source, what, "0")
    return limits, mimic, continuous


def _check_inertials(root: Any, source: Path, mends: Mends) -> None:
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        what = f"link {link.get('name')!r}"
        mass = inertial.find("mass")
        if mass is None:
            raise RobotError(f"{source}:{inertial.sourceline}: {what} has <inertial> without <mass>")
        (value,) = floats(mass, "value", 1, source, what)
        if value < 0:
            raise RobotError(f"{source}:{mass.sourceline}: {what} has mass {value} kg; it must be ≥ 0")
        for origin in inertial.findall("origin"):
            floats(origin, "xyz", 3, source, what, "0 0 0", bound=MAX_LENGTH)
            floats(origin, "rpy", 3, source, what, "0 0 0", bound=MAX_LENGTH)
        tensor = inertial.find("inertia")
        if tensor is None:
            raise RobotError(f"{source}:{inertial.sourceline}: {what} has <inertial> without <inertia>")
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            (moment,) = floats(tensor, key, 1, source, what)
            if key in ("ixx", "iyy", "izz") and moment < 0:
                if moment >= -_ROUNDING:
                    mends.add("links with a moment of inertia below 0 by rounding, taken as 0", link.get("name"))
                    tensor.set(key, "0")
                    continue
                raise RobotError(f"{source}:{tensor.sourceline}: {what} has {key} = {moment}; it must be ≥ 0")
