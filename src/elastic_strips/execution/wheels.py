"""Wheels: the driven pair of a differential drive, read off its URDF."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from ..errors import ParameterError, RobotError, SceneError
from ..robot import RobotModel
from ..robot.urdf_geometry import resolve_mesh, search_folders
from ..robot.xml_source import floats, read_xml
from ..scene.decompose import load_mesh

_ASK = "give wheel_speed=…, track=… and wheel_radius=…"
_SAME = 2e-3  # wheels of a pair are mirror images to within this [m]


@dataclass(frozen=True, slots=True)
class Wheels:
    """The driven pair.

    Attributes:
        track: distance between the wheels [m].
        radius: [m].
        speed: the lower of their speed limits [rad/s], as the file states it.
    """

    track: float
    radius: float
    speed: float


def read_wheels(robot: RobotModel) -> Wheels:
    """The driven wheels of a robot's URDF: two continuous joints named ``*wheel*``, about ±y, mirror images in y.

    Raises:
        ParameterError: no URDF, no such pair, pairs that differ, or a wheel without a round shape.
    """
    if robot.urdf_path is None:
        raise ParameterError(f"robot {robot.name!r} was not made of a URDF file, so its wheels are unknown: {_ASK}")
    path = Path(robot.urdf_path)
    try:
        root = read_xml(path, root="robot", kind="URDF")
        model = pin.buildModelFromXML(_skeleton(root))
    except (RobotError, ValueError, RuntimeError) as error:
        raise ParameterError(f"{path} cannot be read for its wheels ({error}): {_ASK}") from None
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    wheels, others = [], []
    for joint in root.findall("joint"):
        name = joint.get("name")
        if joint.get("type") != "continuous" or "wheel" not in name.lower():
            continue
        pose = data.oMi[model.getJointId(name)]
        element = joint.find("axis")
        local = [1.0, 0.0, 0.0] if element is None else floats(element, "xyz", 3, path, f"joint {name!r}", "1 0 0")
        axis = pose.rotation @ np.array(local)
        if abs(axis[1]) > 0.999 * np.linalg.norm(axis):
            wheels.append((name, pose, joint.find("child").get("link")))
        else:
            others.append(name)
    pairs = [
        (a, b)
        for a, b in combinations(wheels, 2)
        if np.allclose(a[1].translation * [1.0, -1.0, 1.0], b[1].translation, atol=_SAME)
        and abs(a[1].translation[1]) > _SAME
    ]
    if not pairs:
        raise ParameterError(
            f"{path} has no two continuous joints named *wheel* about ±y, mirrored in y (continuous and named so: "
            f"{', '.join([w[0] for w in wheels] + others) or 'none'}): {_ASK}"
        )
    found = []
    for a, b in pairs:
        radii = [_radius(root, link, path) for _, _, link in (a, b)]
        if radii[0] is None or radii[1] is None or abs(radii[0] - radii[1]) > _SAME:
            raise ParameterError(f"{path}: the radii of wheels {a[0]!r} and {b[0]!r} are {radii} [m]: {_ASK}")
        speeds = [float(model.velocityLimit[model.joints[model.getJointId(name)].idx_v]) for name, _, _ in (a, b)]
        found.append(Wheels(2.0 * abs(float(a[1].translation[1])), radii[0], min(speeds)))
    if any(abs(w.track - found[0].track) > _SAME or abs(w.radius - found[0].radius) > _SAME for w in found):
        names = "; ".join(f"{a[0]}, {b[0]}" for a, b in pairs)
        raise ParameterError(f"{path} has several different pairs of wheels ({names}): {_ASK}")
    return found[0]


def _skeleton(root: Any) -> str:
    """The URDF's joints alone: what else it holds may not be strict."""
    bare = deepcopy(root)
    bare.set("name", bare.get("name") or "robot")
    for element in list(bare):
        if element.tag not in ("link", "joint"):
            bare.remove(element)
            continue
        for child in list(element):
            if child.tag in ("visual", "collision", "inertial", "mimic"):
                element.remove(child)
    return etree.tostring(bare, encoding="unicode")


def _radius(root: Any, link_name: str, path: Path) -> float | None:
    """Radius [m] of a wheel's link: of its round collision shape, then of its visual one, then of its meshes."""
    link = next((link for link in root.findall("link") if link.get("name") == link_name), None)
    if link is None:
        return None
    for tag in ("collision", "visual"):
        shapes = [shape for element in link.findall(tag) for shape in element.findall("geometry/*")]
        radii = [
            floats(shape, "radius", 1, path, f"link {link_name!r}")[0]
            for shape in shapes
            if shape.tag in ("cylinder", "sphere", "capsule")
        ]
        if radii:
            return float(max(radii))
    folders = search_folders(path, ())
    sizes = []
    for mesh in link.findall(".//geometry/mesh"):
        file = resolve_mesh(mesh.get("filename", ""), path, folders)
        if file is None:
            continue
        scale = np.array(floats(mesh, "scale", 3, path, f"link {link_name!r}", "1 1 1"))
        try:
            vertices, _ = load_mesh(file)
        except SceneError as error:
            raise ParameterError(f"{path}: a wheel's mesh cannot be read ({error}): {_ASK}") from None
        extents = np.sort(np.ptp(vertices, axis=0) * np.abs(scale))
        sizes.append(0.5 * float(extents[-1]))  # a wheel is a disc: its two larger extents are its diameter
    return max(sizes, default=None)
