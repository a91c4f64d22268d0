"""A second reader of URDF files, yourdfpy, which shares no code with Pinocchio, urdfdom and Assimp: what it reads
differently is a fault of one of the two, or something that the file leaves open."""

from __future__ import annotations

import io
import logging
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from lxml import etree

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import ShapeKind, shape_of, vertices

from .urdf import UrdfSource
from .urdf_shapes import PLATE_THICKNESS
from .xml_file import read_xml

if TYPE_CHECKING:
    import yourdfpy

_log = logging.getLogger(__name__)
_POSTURES_COMPARED = 2  # any one finds what is placed or turned otherwise; the other is for luck
_NUMBER_TOLERANCE = 1e-6  # [m], [rad], entries of rotations; relative of what is large
_JOINT_RANGE = 3.0  # [rad] or [m]: values of joints that are tried are within it
_MESH_ROUNDING = 1e-3  # of a mesh's size: what the readers of meshes may round
_MESHES = (".dae", ".obj", ".stl")  # that trimesh reads as well
_MOVING = ("revolute", "continuous", "prismatic")


def differences(source: UrdfSource, model: pin.Model) -> tuple[str, ...] | None:
    """What yourdfpy reads differently about joints: placements of links at random postures, limits, speeds, mimics.

    Args:
        source: a file as it was read here.
        model: Pinocchio's model of it, with all joints, on a planar root or a fixed one.

    Returns:
        One sentence for each difference, or None where yourdfpy does not read the file.
    """
    try:
        with _silent():
            second = _skeleton(source)
            return tuple(_joints(source, model, second)) or tuple(_placements(model, second))
    except Exception as error:  # of yourdfpy, lxml, NumPy: whatever it trips over
        _log.info("%s: yourdfpy does not read it: %s: %s", source.path, type(error).__name__, error)
        return None


def shape_differences(source: UrdfSource, model: pin.Model, shapes: pin.GeometryModel) -> tuple[str, ...] | None:
    """What yourdfpy, and trimesh for meshes, read differently about collision shapes: number, kind, place and size.

    Args:
        source: a file as it was read here.
        model: Pinocchio's model of it, with all joints.
        shapes: its collision geometry on that.

    Returns:
        One sentence for each difference, or None where yourdfpy does not read the file.
    """
    try:
        with _silent():
            return tuple(_shapes(source, model, shapes))
    except Exception as error:
        _log.info("%s: yourdfpy does not read its shapes: %s: %s", source.path, type(error).__name__, error)
        return None


@contextmanager
def _silent() -> Iterator[None]:
    """Silences what yourdfpy says about files that were checked already."""
    logger = logging.getLogger("yourdfpy")
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)


def _root(source: UrdfSource) -> etree._Element:
    """The file itself, and not what was made of it here."""
    root = read_xml(source.path, root="robot", kind="URDF")
    root.set("name", root.get("name") or "robot")
    return root


def _skeleton(source: UrdfSource) -> yourdfpy.URDF:
    """The file's links and joints as yourdfpy reads them; joints that mimic are free, as it follows no chains."""
    import yourdfpy  # late: slow to import

    root = _root(source)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
        elif element.tag == "link":
            for inner in list(element):
                element.remove(inner)
    read = yourdfpy.URDF.load(
        io.BytesIO(etree.tostring(root, encoding="utf-8")), build_scene_graph=False, load_meshes=False
    )
    return read


def _joints(source: UrdfSource, model: pin.Model, second: yourdfpy.URDF) -> Iterator[str]:
    mine = {str(name) for name in list(model.names)[1:]} - {"root_joint"}
    other = {j.name: j for j in second.robot.joints if j.type in _MOVING}
    floating = {j.name for j in second.robot.joints if j.type in ("floating", "planar")}
    for name in sorted((mine - floating) ^ set(other)):
        yield f"joint {name!r} moves {'here' if name in mine else 'there'} alone"
    for name in sorted(mine & set(other)):
        joint, own = other[name], model.joints[model.getJointId(name)]
        if (joint.type == "continuous") != (own.nq == 2):
            yield f"joint {name!r} is {joint.type} there"
            continue
        if joint.limit is not None:
            yield from _limits(name, model, joint.limit, own)
        ours = source.followers.get(name)
        ours = ours if ours is None or ours[0] in other else None  # what has no value of its own is no leader there
        follows = _followed(joint.mimic, other)
        if not _alike(ours, follows):
            yield f"joint {name!r} mimics {ours or 'nothing'} here, {follows or 'nothing'} there"


def _limits(name: str, model: pin.Model, limit: yourdfpy.Limit, own: pin.JointModel) -> Iterator[str]:
    """What differs in a joint's limits, of one that has some, and its speed."""
    if own.nq == 1:  # not continuous
        limits = [float(model.lowerPositionLimit[own.idx_q]), float(model.upperPositionLimit[own.idx_q])]
        theirs = [limit.lower or 0.0, limit.upper or 0.0]
        if not np.allclose(limits, theirs, rtol=_NUMBER_TOLERANCE, atol=_NUMBER_TOLERANCE):
            yield f"joint {name!r} has limits {_span(limits)} here, {_span(theirs)} there"
    if limit.velocity is not None:
        speed = float(model.velocityLimit[own.idx_v])
        if not np.isclose(speed, limit.velocity, rtol=_NUMBER_TOLERANCE, atol=_NUMBER_TOLERANCE):
            yield f"joint {name!r} has speed {speed:g} here, {limit.velocity:g} there"


def _followed(mimic: yourdfpy.Mimic | None, joints: Collection[str]) -> tuple[str, float, float] | None:
    """Leader, multiplier and offset of a joint that mimics one of the joints there."""
    if mimic is None or mimic.joint not in joints:
        return None
    return mimic.joint, float(mimic.multiplier or 0.0), float(mimic.offset or 0.0)


def _alike(one: tuple[str, float, float] | None, two: tuple[str, float, float] | None) -> bool:
    """Whether two ways to mimic (leader, multiplier, offset) are the same."""
    if one is None or two is None:
        return one is two
    return one[0] == two[0] and bool(np.allclose(one[1:], two[1:], rtol=_NUMBER_TOLERANCE, atol=_NUMBER_TOLERANCE))


def _placements(model: pin.Model, second: yourdfpy.URDF) -> Iterator[str]:
    import yourdfpy

    for joint in second.robot.joints:
        joint.mimic = None
    free = yourdfpy.URDF(robot=second.robot, load_meshes=False)
    frames = {f.name: i for i, f in enumerate(model.frames) if f.type == pin.FrameType.BODY}
    for link in sorted(set(free.link_map) ^ set(frames)):
        yield f"link {link!r} is {'here' if link in frames else 'there'} alone"
    data, rng = model.createData(), np.random.default_rng(0)
    told: set[str] = set()
    for _ in range(_POSTURES_COMPARED):
        q, values = _posture(model, rng)
        pin.framesForwardKinematics(model, data, q)
        free.update_cfg({j.name: values.get(j.name, 0.0) for j in free.robot.joints if j.type in _MOVING})
        wrong = {
            link: gap
            for link, frame in frames.items()
            if link in free.link_map and (gap := _gap(np.array(data.oMf[frame].homogeneous), free.get_transform(link)))
        }
        parents = {j.child: j.parent for j in free.robot.joints}
        for link, gap in wrong.items():
            if parents.get(link) not in wrong and link not in told:  # what hangs on it is elsewhere as well
                told.add(link)
                yield f"link {link!r} is {gap} elsewhere there"


def _posture(model: pin.Model, rng: np.random.Generator) -> tuple[Array, dict[str, float]]:
    """A random configuration (nq,), its root at the origin, and the values of its joints."""
    q, values = pin.neutral(model), {}
    for i in range(1, model.njoints):
        joint = model.joints[i]
        if joint.nv != 1:
            continue
        value = float(rng.uniform(-_JOINT_RANGE, _JOINT_RANGE))
        values[str(model.names[i])] = value
        if joint.nq == 2:
            q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
        else:
            q[joint.idx_q] = value
    return q, values


def _gap(one: Array, two: Array) -> str:
    """How far two poses (4, 4) are from each other, in words; empty where they are equal."""
    far = float(np.linalg.norm(one[:3, 3] - two[:3, 3]))
    if far > _NUMBER_TOLERANCE * max(1.0, float(np.linalg.norm(one[:3, 3]))):
        return f"{1e3 * far:.3g} mm"
    turned = float(np.linalg.norm(one[:3, :3] - two[:3, :3])) / np.sqrt(2.0)
    return f"turned by {turned:.3g} rad, so" if turned > _NUMBER_TOLERANCE else ""


def _shapes(source: UrdfSource, model: pin.Model, shapes: pin.GeometryModel) -> Iterator[str]:
    second, capsules = _only_shapes(source)
    own = {str(item.name): item for item in shapes.geometryObjects}
    for link in second.robot.links:
        read: list[tuple[_Shape, Array]] = []
        for k, collision in enumerate(link.collisions):
            shape = capsules.get((link.name, k)) or _read_shape(collision.geometry)
            if any(shape.sizes):
                read.append((shape, np.eye(4) if collision.origin is None else collision.origin))
        if len(read) != source.collisions.get(link.name, 0):
            yield f"link {link.name!r} has {source.collisions.get(link.name, 0)} shapes here, {len(read)} there"
            continue
        for k, (shape, pose) in enumerate(read):
            item = own[f"{link.name}_{k}"]
            found = model.frames[item.parentFrame].placement.actInv(item.placement)
            if gap := _gap(np.array(found.homogeneous), pose):
                yield f"collision shape {item.name!r} is {gap} elsewhere there"
            yield from _sizes(item, shape)


@dataclass(frozen=True, slots=True)
class _Shape:
    """Kind and half sizes [m] of a shape, radii in whole, and the mesh that it is."""

    kind: str
    sizes: list[float]
    mesh: yourdfpy.Mesh | None = None


def _only_shapes(source: UrdfSource) -> tuple[yourdfpy.URDF, dict[tuple[str, int], _Shape]]:
    """The file's links with their collision shapes as yourdfpy reads them, and what it does not read.

    These are capsules, by their link and number: it gets spheres in their place. One without length is a sphere.
    """
    import yourdfpy

    root = _root(source)
    capsules: dict[tuple[str, int], _Shape] = {}
    for element in list(root):
        if element.tag != "link":
            root.remove(element)
            continue
        tag = "visual" if element.get("name") in source.from_visual else "collision"
        for inner in list(element):
            if inner.tag != tag:
                element.remove(inner)
        for k, inner in enumerate(element):
            inner.tag = "collision"
            for material in inner.findall("material"):
                inner.remove(material)
            for capsule in inner.findall("geometry/capsule"):
                half = 0.5 * float(capsule.get("length"))
                if half:
                    capsules[element.get("name"), k] = _Shape("capsule", [float(capsule.get("radius")), half])
                capsule.tag = "sphere"
    data = io.BytesIO(etree.tostring(root, encoding="utf-8"))
    return yourdfpy.URDF.load(data, build_scene_graph=False, load_meshes=False), capsules


def _sizes(item: pin.GeometryObject, shape: _Shape) -> Iterator[str]:
    """What differs in the kind and size of a shape."""
    mine, half = shape_of(item.geometry)
    if shape.mesh is not None and mine in (ShapeKind.MESH, ShapeKind.CONVEX):
        yield from _mesh(item, shape.mesh)
    elif mine.value != shape.kind or not np.allclose(half, shape.sizes, rtol=_NUMBER_TOLERANCE, atol=PLATE_THICKNESS):
        ours = ", ".join(f"{1e3 * x:.4g}" for x in half)
        theirs = ", ".join(f"{1e3 * x:.4g}" for x in shape.sizes)
        yield f"collision shape {item.name!r}: {mine.value} of {ours} mm here, {shape.kind} of {theirs} mm there"


def _read_shape(shape: yourdfpy.Geometry) -> _Shape:
    if shape.box is not None:
        return _Shape("box", [0.5 * float(x) for x in shape.box.size])
    if shape.sphere is not None:
        return _Shape("sphere", [shape.sphere.radius])
    if shape.cylinder is not None:
        return _Shape("cylinder", [shape.cylinder.radius, 0.5 * shape.cylinder.length])
    return _Shape("mesh", [1.0], shape.mesh)


def _mesh(item: pin.GeometryObject, mesh: yourdfpy.Mesh) -> Iterator[str]:
    """What trimesh reads differently in a mesh file: its name and how large it is."""
    import trimesh

    file = Path(item.meshPath)
    if Path(mesh.filename).name != file.name:
        yield f"collision shape {item.name!r} is {file.name} here, {mesh.filename} there"
    if file.suffix.lower() not in _MESHES:
        return
    data = io.BytesIO(file.read_bytes())  # from memory: so no other file is opened by what this one names
    kind = file.suffix[1:].lower()
    obj = kind == "obj"
    scene = trimesh.load_scene(data, "obj", skip_materials=True) if obj else trimesh.load_scene(data, kind)
    unit = trimesh.units.unit_conversion(scene.units, "meters") if scene.units else 1.0
    scale = np.ones(3) if mesh.scale is None else np.broadcast_to(np.asarray(mesh.scale, dtype=float), 3)
    theirs = np.sort(np.asarray(scene.bounds) * unit * scale, axis=0)
    points = vertices(item.geometry)
    ours = np.array([points.min(axis=0), points.max(axis=0)])
    if np.abs(ours - theirs).max() > _MESH_ROUNDING * max(1e-3, float(np.ptp(theirs, axis=0).max())):
        yield f"mesh {file.name} is {_size(ours)} m here, {_size(theirs)} m there, or lies elsewhere"


def _size(bounds: Array) -> str:
    return " x ".join(f"{x:.4g}" for x in np.ptp(bounds, axis=0))


def _span(limits: list[float]) -> str:
    return f"[{limits[0]:.6g}, {limits[1]:.6g}]"
