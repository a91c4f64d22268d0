"""The validating URDF reader: every fault is one error that names the file and the element.

Pinocchio's own parser reports a fault as a line on standard error or a crash in C++; so a description is checked
here first, with yourdfpy as the reader, before Pinocchio and Coal build their models from it.
"""

from __future__ import annotations

import logging
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yourdfpy

from ..errors import RobotError, nearest_name
from .xml_source import read_xml

_log = logging.getLogger(__name__)
_JOINT_TYPES = {"revolute", "continuous", "prismatic", "fixed", "floating", "planar"}
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
_RESERVED = ("root_joint", "universe")  # names that Pinocchio's models give themselves
_MIN_SIZE, MAX_LENGTH = 1e-6, 1e6  # [m]; as in scenes
_SHAPES = {
    "box": ("size", 3),
    "sphere": ("radius", 1),
    "cylinder": ("radius length", 1),
    "capsule": ("radius length", 1),
}


@dataclass(frozen=True, slots=True)
class UrdfSource:
    """A checked URDF file.

    Attributes:
        path: the file.
        package_dirs: folders that Pinocchio searches for ``package://`` and relative mesh names.
        links, joints: all names.
        joint_limits: joint → (lower, upper) of revolute and prismatic joints.
        mimic: names of joints that mimic another.
        continuous: names of continuous joints.
        collisions: link → number of its collision shapes.
    """

    path: Path
    package_dirs: tuple[str, ...]
    links: frozenset[str]
    joints: frozenset[str]
    joint_limits: dict[str, tuple[float, float]]
    mimic: frozenset[str]
    continuous: frozenset[str]
    collisions: dict[str, int]


def read_urdf(path: str | Path, *, package_dirs: tuple[str | Path, ...] = ()) -> UrdfSource:
    """Check a URDF file and everything that it refers to.

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
    _check_tree(root, links, joints, source)
    limits, mimic, continuous = _check_joints(root, joints, source)
    _check_inertials(root, source)
    folders = _search_folders(source, package_dirs)
    _check_geometry(root, source, folders)
    _read_with_yourdfpy(source)
    return UrdfSource(
        path=source,
        package_dirs=tuple(str(f) for f in folders),
        links=frozenset(links),
        joints=frozenset(joints),
        joint_limits=limits,
        mimic=frozenset(mimic),
        continuous=frozenset(continuous),
        collisions={link.get("name"): len(link.findall("collision")) for link in root.findall("link")},
    )


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


def _check_tree(root: Any, links: set[str], joints: set[str], source: Path) -> None:
    parent_of: dict[str, str] = {}
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
    roots = links - set(parent_of)
    if len(roots) != 1:
        found = ", ".join(sorted(roots)) if roots else "none, so the joints form a loop"
        raise RobotError(f"{source}: a robot has exactly one root link; found {len(roots)} ({found})")
    for link in links:
        seen = {link}
        while link in parent_of:
            link = parent_of[link]
            if link in seen:
                raise RobotError(f"{source}: the joints form a loop through link {link!r}")
            seen.add(link)


def _shown(text: str) -> str:
    return repr(text if len(text) <= 80 else text[:77] + "...")


def _floats(
    element: Any, key: str, count: int, source: Path, what: str, default: str | None = None, *, bound: float = math.inf
) -> list[float]:
    text = element.get(key, default)
    where = f"{source}:{element.sourceline}: {what}"
    if text is None:
        raise RobotError(f"{where}: <{element.tag}> has no attribute {key!r}")
    try:
        words = text.split()
        if not all(_NUMBER.fullmatch(word) for word in words):  # float() reads more than a URDF may hold
            raise ValueError
        values = [float(word) for word in words]
    except ValueError:
        raise RobotError(f"{where}: <{element.tag} {key}={_shown(text)}> is not {count} number(s)") from None
    if len(values) != count or not all(math.isfinite(v) for v in values):
        raise RobotError(f"{where}: <{element.tag} {key}={_shown(text)}> is not {count} finite number(s)")
    if any(abs(v) > bound for v in values):
        raise RobotError(f"{where}: <{element.tag} {key}={_shown(text)}> is beyond ±{bound:g}")
    return values


def _check_joints(
    root: Any, joints: set[str], source: Path
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
            _floats(origin, "xyz", 3, source, what, "0 0 0", bound=MAX_LENGTH)
            _floats(origin, "rpy", 3, source, what, "0 0 0", bound=MAX_LENGTH)
        if kind in ("revolute", "continuous", "prismatic"):
            axis = joint.find("axis")
            if axis is not None and math.hypot(*_floats(axis, "xyz", 3, source, what, "1 0 0")) < 1e-9:
                raise RobotError(f"{source}:{axis.sourceline}: {what} has the axis 0 0 0; give a direction")
        if kind == "continuous":
            continuous.add(name)
        if kind in ("revolute", "prismatic"):
            limit = joint.find("limit")
            if limit is None:
                raise RobotError(f"{source}:{joint.sourceline}: {what} is {kind} and has no <limit>")
            (lower,) = _floats(limit, "lower", 1, source, what, "0")
            (upper,) = _floats(limit, "upper", 1, source, what, "0")
            for key in ("velocity", "effort"):
                (value,) = _floats(limit, key, 1, source, what, "0")
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
            if leader not in joints:
                hint = nearest_name(leader, joints)
                raise RobotError(f"{source}:{follower.sourceline}: {what} mimics unknown joint {leader!r}{hint}")
            if leader == name:
                raise RobotError(f"{source}:{follower.sourceline}: {what} has a <mimic> of itself")
            _floats(follower, "multiplier", 1, source, what, "1")
            _floats(follower, "offset", 1, source, what, "0")
            mimic.add(name)
    return limits, mimic, continuous


def _check_inertials(root: Any, source: Path) -> None:
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        what = f"link {link.get('name')!r}"
        mass = inertial.find("mass")
        if mass is None:
            raise RobotError(f"{source}:{inertial.sourceline}: {what} has <inertial> without <mass>")
        (value,) = _floats(mass, "value", 1, source, what)
        if value < 0:
            raise RobotError(f"{source}:{mass.sourceline}: {what} has mass {value} kg; it must be ≥ 0")
        for origin in inertial.findall("origin"):
            _floats(origin, "xyz", 3, source, what, "0 0 0", bound=MAX_LENGTH)
            _floats(origin, "rpy", 3, source, what, "0 0 0", bound=MAX_LENGTH)
        tensor = inertial.find("inertia")
        if tensor is None:
            raise RobotError(f"{source}:{inertial.sourceline}: {what} has <inertial> without <inertia>")
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            (moment,) = _floats(tensor, key, 1, source, what)
            if key in ("ixx", "iyy", "izz") and moment < 0:
                raise RobotError(f"{source}:{tensor.sourceline}: {what} has {key} = {moment}; it must be ≥ 0")


def _search_folders(source: Path, extra: tuple[str | Path, ...]) -> list[Path]:
    """Folders that may hold packages: given ones, the file's, its ancestors', and those of ROS and of cmeel."""
    import os

    folders = [Path(f).expanduser().absolute() for f in extra]
    folders += [source.parent, *list(source.parents)[1:6]]
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            folders += [Path(entry), Path(entry) / "share"]
    return list(dict.fromkeys(f for f in folders if f.is_dir()))


def resolve_mesh(name: str, source: Path, folders: list[Path]) -> Path | None:
    """The file that a URDF mesh name means, or None."""
    if name.startswith("file://"):
        candidate = Path(name[len("file://") :])
        return candidate if candidate.is_file() else None
    if name.startswith("package://"):
        rest = name[len("package://") :]
        return next((f / rest for f in folders if (f / rest).is_file()), None)
    candidate = Path(name)
    if candidate.is_absolute():
        return candidate if candidate.is_file() else None
    return next((f / name for f in [source.parent, *folders] if (f / name).is_file()), None)


def _check_geometry(root: Any, source: Path, folders: list[Path]) -> None:
    for link in root.findall("link"):
        for tag in ("collision", "visual"):
            for element in link.findall(tag):
                what = f"link {link.get('name')!r} <{tag}>"
                for origin in element.findall("origin"):
                    _floats(origin, "xyz", 3, source, what, "0 0 0", bound=MAX_LENGTH)
                    _floats(origin, "rpy", 3, source, what, "0 0 0", bound=MAX_LENGTH)
                for material in element.findall("material"):
                    if not material.get("name"):
                        raise RobotError(f"{source}:{material.sourceline}: {what} has a <material> without a name")
                geometry = element.find("geometry")
                if geometry is None or len(geometry) == 0:
                    raise RobotError(f"{source}:{element.sourceline}: {what} has no <geometry>")
                shapes = [shape for each in element.findall("geometry") for shape in each]
                if len(shapes) > 1:  # all but the first would be ignored in silence
                    raise RobotError(
                        f"{source}:{shapes[1].sourceline}: {what} has a second shape <{shapes[1].tag}>; "
                        f"give it its own <{tag}>"
                    )
                shape = geometry[0]
                if shape.tag == "mesh":
                    _check_mesh(shape, source, folders, what)
                elif shape.tag in _SHAPES:
                    keys, count = _SHAPES[shape.tag]
                    for key in keys.split():
                        values = _floats(shape, key, count, source, what, bound=MAX_LENGTH)
                        if min(values) < _MIN_SIZE:
                            least = "> 0" if min(values) <= 0 else f"at least {_MIN_SIZE:g} m"
                            raise RobotError(
                                f"{source}:{shape.sourceline}: {what} has {key} {values}; it must be {least}"
                            )
                else:
                    hint = nearest_name(shape.tag, [*_SHAPES, "mesh"])
                    raise RobotError(f"{source}:{shape.sourceline}: {what} has unknown shape <{shape.tag}>{hint}")


def _check_mesh(shape: Any, source: Path, folders: list[Path], what: str) -> None:
    name = shape.get("filename")
    if not name:
        raise RobotError(f"{source}:{shape.sourceline}: {what} has a <mesh> without filename")
    if min(_floats(shape, "scale", 3, source, what, "1 1 1")) == 0:
        raise RobotError(f"{source}:{shape.sourceline}: {what} has a mesh scale of 0")
    found = resolve_mesh(name, source, folders)
    if found is None:
        searched = ", ".join(str(f) for f in folders[:4])
        raise RobotError(f"{source}:{shape.sourceline}: {what}: mesh {name!r} not found (searched {searched}, …)")
    try:
        with found.open("rb") as handle:
            if not handle.read(16):
                raise RobotError(f"{source}:{shape.sourceline}: {what}: mesh file {found} is empty")
    except OSError as error:
        raise RobotError(f"{source}:{shape.sourceline}: {what}: mesh file {found}: {error.strerror}") from None


def _read_with_yourdfpy(source: Path) -> None:
    try:
        robot = yourdfpy.URDF.load(
            str(source),
            build_scene_graph=False,
            load_meshes=False,
            build_collision_scene_graph=False,
            load_collision_meshes=False,
            mesh_dir=str(source.parent),
        )
        robot.validate()
    except RobotError:
        raise
    except Exception as error:  # yourdfpy raises many kinds for what is simply a malformed description
        raise RobotError(f"{source}: not a valid URDF: {type(error).__name__}: {error}") from None
    if robot.errors:
        _log.debug("yourdfpy on %s: %s", source, "; ".join(str(e) for e in robot.errors))
