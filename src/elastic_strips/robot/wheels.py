"""Wheels of a description: which joints are wheels and casters, which of them are round, and which pair is driven."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import ShapeKind, shape_of, support, vertices
from elastic_strips.decompose import load_mesh
from elastic_strips.errors import RobotError, SceneError

from .urdf import UrdfSource, pinocchio_model
from .urdf_shapes import resolve_mesh
from .xml_file import floats

_WHEEL_TILT = 0.05  # sine of the angle by which a wheel's axis may be off level, and a caster's off upright
_CASTER_HEIGHT = 0.05  # [m] by which a caster's wheel may be higher than the others
_WHEEL_ROUNDNESS = 0.003  # [m] by which a wheel may stick out farther on one side: its mesh has corners
_MIRROR_TOLERANCE = 2e-3  # [m] within which the wheels of a pair are mirror images, and several pairs are alike
_LEAST_SIDEWAYS = 0.999  # cosine of the angle between a driven wheel's axis and y


@dataclass(frozen=True, slots=True)
class DrivenWheels:
    """The pair of wheels that a differential drive drives.

    Attributes:
        track: distance between them [m].
        radius: [m].
        speed: the lower of their speed limits [rad/s], as the file states it.
        joints: names of their joints.
    """

    track: float
    radius: float
    speed: float
    joints: tuple[str, str]


def wheel_joints(model: pin.Model, source: UrdfSource) -> set[str]:
    """Continuous joints that are called wheel or caster, or that move the base by what hangs on them.

    A wheel turns about a level axis, hangs on the root link by fixed joints, and carries nothing that moves. A caster
    turns about an upright axis and carries nothing but wheels, no higher than the other wheels; without others there
    are at least two of them. So an arm's first joint is neither of them, nor is a head that pans and tilts.
    """
    named = {j for j in source.continuous if any(word in j.lower() for word in ("wheel", "caster", "castor"))}
    if model.njoints < 2 or model.joints[1].shortname() != "JointModelPlanar":
        return named
    return named | {model.names[i] for i in _wheels_by_motion(model, source)}


def _wheels_by_motion(model: pin.Model, source: UrdfSource) -> set[int]:
    """The joints of wheels and casters on a planar root, whatever they are called."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    height = [float(pose.translation[2]) for pose in data.oMi]
    turning = {  # joint → z of its axis
        i: abs(float(data.J[5, model.joints[i].idx_v]))
        for i in range(2, model.njoints)
        if model.names[i] in source.continuous
    }
    carried = {i: _carried(i, model, source) for i in turning}
    rolling = {i for i, up in turning.items() if up < _WHEEL_TILT and not carried[i]}
    wheels = {i for i in rolling if model.parents[i] == 1}
    casters = {
        i
        for i, up in turning.items()
        if model.parents[i] == 1 and up > 1.0 - _WHEEL_TILT and carried[i] and rolling.issuperset(carried[i])
    }
    top = max((height[i] for i in wheels), default=float("inf") if len(casters) > 1 else -float("inf"))
    for i in casters:
        if max(height[k] for k in carried[i]) <= top + _CASTER_HEIGHT:
            wheels |= {i, *carried[i]}
    return wheels


def _carried(i: int, model: pin.Model, source: UrdfSource) -> list[int]:
    """The joints that a joint carries, but for those that mimic another one."""
    return [k for k in model.subtrees[i] if k != i and model.names[k] not in source.mimic]


def round_wheels(model: pin.Model, collision: pin.GeometryModel, wheels: Iterable[str]) -> frozenset[str]:
    """The joints whose collision shapes are bodies of revolution about their axes, within 3 mm."""
    round_, elevation = set(), np.linspace(-1.2, 1.2, 7)[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    for name in wheels:
        i = model.getJointId(name)
        if model.joints[i].nv != 1 or len(model.subtrees[i]) > 1:  # what swivels carries its wheel about
            continue
        axis = np.asarray(model.joints[i].createData().S).ravel()[3:]
        side = np.linalg.svd(axis[None])[2][1:]
        flat = np.cos(turn)[:, None] * side[0] + np.sin(turn)[:, None] * side[1]
        directions = np.cos(elevation)[..., None] * flat + np.sin(elevation)[..., None] * axis
        extents = (
            _extent(shape, directions.reshape(-1, 3)).reshape(directions.shape[:2])
            for shape in collision.geometryObjects
            if shape.parentJoint == i
        )
        if all(np.ptp(extent, axis=1).max() <= _WHEEL_ROUNDNESS for extent in extents):
            round_.add(name)
    return frozenset(round_)


def _extent(shape: pin.GeometryObject, directions: Array) -> Array:
    """How far a shape extends along directions (K, 3) from its joint [m]."""
    local = directions @ shape.placement.rotation
    if shape_of(shape.geometry)[0] is ShapeKind.MESH and not len(vertices(shape.geometry)):
        return np.zeros(len(directions))
    few = np.array_split(local, len(local) // 8)  # a mesh of a million corners has as many numbers for each direction
    return np.concatenate([support(shape.geometry, d) for d in few]) + directions @ shape.placement.translation


def driven_wheels(source: UrdfSource, locked: Container[str]) -> DrivenWheels:
    """The driven wheels of a description: two continuous joints named ``*wheel*``, about ±y, mirror images in y.

    Where none is named so, two of those that are not planned. Casters, which may be named so too, are left out: what is
    called a caster, or is carried by a joint that moves, where the others are not.

    Args:
        source: the description.
        locked: joints that planning holds still.

    Raises:
        RobotError: no such pair, pairs that differ, or a wheel without a round shape.
    """
    root, path = etree.fromstring(source.document), source.path
    model = pinocchio_model(source)
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    sideways, others = [], []
    for joint in _candidates(root, model, locked):
        name = joint.get("name")
        pose = data.oMi[model.getJointId(name)]
        if _points_sideways(joint, pose, path):
            sideways.append((name, pose.translation, joint.find("child").get("link")))
        else:
            others.append(name)
    pairs = [(a, b) for a, b in combinations(sideways, 2) if _mirrored(a[1], b[1])]
    if not pairs:
        raise RobotError(
            f"{path} has no two continuous joints named *wheel* about ±y, mirrored in y (continuous and named so: "
            f"{', '.join([name for name, _, _ in sideways] + others) or 'none'})"
        )
    found = []
    for (a, at, one), (b, _, two) in pairs:
        radii = [_wheel_radius(root, link, path) for link in (one, two)]
        if radii[0] is None or radii[1] is None or abs(radii[0] - radii[1]) > _MIRROR_TOLERANCE:
            raise RobotError(f"{path}: the radii of wheels {a!r} and {b!r} are {radii} [m]")
        speeds = [float(model.velocityLimit[model.joints[model.getJointId(name)].idx_v]) for name in (a, b)]
        found.append(DrivenWheels(2.0 * abs(float(at[1])), radii[0], min(speeds), (a, b)))
    first = found[0]
    if any(max(abs(w.track - first.track), abs(w.radius - first.radius)) > _MIRROR_TOLERANCE for w in found):
        names = "; ".join(", ".join(w.joints) for w in found)
        raise RobotError(f"{path} has several different pairs of wheels ({names})")
    return first


def _candidates(root: etree._Element, model: pin.Model, locked: Container[str]) -> list[etree._Element]:
    """The continuous joints that are called wheels and are no casters; where none is, those that are locked."""
    turning = [joint for joint in root.findall("joint") if joint.get("type") == "continuous"]
    called = _without_casters([joint for joint in turning if "wheel" in joint.get("name").lower()], model)
    return called or [joint for joint in turning if joint.get("name") in locked]


def _points_sideways(joint: etree._Element, pose: pin.SE3, path: Path) -> bool:
    """Whether a joint at a pose turns about ±y."""
    element, what = joint.find("axis"), f"joint {joint.get('name')!r}"
    axis = pose.rotation @ np.array([1.0, 0.0, 0.0] if element is None else floats(element, "xyz", 3, path, what))
    return bool(abs(axis[1]) > _LEAST_SIDEWAYS * np.linalg.norm(axis))


def _mirrored(a: Array, b: Array) -> bool:
    """Whether two places (3,) are mirror images in y, and not both in the middle."""
    alike = np.allclose(a * [1.0, -1.0, 1.0], b, atol=_MIRROR_TOLERANCE)
    return alike and abs(a[1]) > _MIRROR_TOLERANCE


def _without_casters(wheels: list[etree._Element], model: pin.Model) -> list[etree._Element]:
    """The wheels that are not casters; all of them where none is left."""
    for caster in (lambda name: "cast" in name.lower(), lambda name: model.parents[model.getJointId(name)] != 0):
        wheels = [joint for joint in wheels if not caster(joint.get("name"))] or wheels
    return wheels


def _wheel_radius(root: etree._Element, link_name: str, path: Path) -> float | None:
    """Radius [m] of a wheel's link: of its round collision shape, then of its visual one, then of its meshes."""
    link = next(link for link in root.findall("link") if link.get("name") == link_name)
    for tag in ("collision", "visual"):
        radii = [
            floats(shape, "radius", 1, path, f"link {link_name!r}")[0]
            for shape in link.findall(f"{tag}/geometry/*")
            if shape.tag in ("cylinder", "sphere")
        ]
        if radii:
            return float(max(radii))
    sizes = []
    for mesh in link.findall(".//geometry/mesh"):
        file = resolve_mesh(mesh.get("filename", ""), path, [])
        if file is None:
            continue
        scale = np.array(floats(mesh, "scale", 3, path, f"link {link_name!r}", "1 1 1"))
        try:
            corners, _ = load_mesh(file)
        except SceneError as error:
            raise RobotError(f"{path}: a wheel's mesh cannot be read ({error})") from None
        extents = np.sort(np.ptp(corners, axis=0) * np.abs(scale))
        sizes.append(0.5 * float(extents[-1]))  # a wheel is a disc: its two larger extents are its diameter
    return max(sizes, default=None)
