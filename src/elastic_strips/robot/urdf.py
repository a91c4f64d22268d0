"""The validating URDF reader: every fault is one error that names the file and the element.

Pinocchio's own parser reports a fault as a line on standard error or a crash in C++, and some small faults too; so a
description is checked here first, and Pinocchio and Coal build their models from a copy with small faults mended.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import coal
import pinocchio as pin
from lxml import etree

from elastic_strips.errors import RobotError
from elastic_strips.files import note_input
from elastic_strips.summary import shortened

from .mimic import Following
from .urdf_joints import check_joints, check_tree
from .urdf_shapes import Capsule, check_geometry, check_materials, drawn_as_collision, resolve_mesh, search_folders
from .xml_file import Mends, check_origins, fault, floats, read_xml

_INERTIA_ROUNDING = 1e-12  # a moment of inertia [kg m²] below 0 by at most this was 0 before it was rounded
_RESERVED = ("root_joint", "universe")  # names that Pinocchio's models give themselves


@dataclass(frozen=True, slots=True)
class UrdfSource:
    """A checked URDF file.

    Attributes:
        path: the file.
        name: the robot's.
        document: the description as Pinocchio gets it: small faults mended, mesh files by their paths.
        links, joints: all names.
        parents: link → (joint, link) that carry it; the root has none.
        joint_limits: joint → (lower, upper), for revolute and prismatic joints.
        mimic: names of joints that mimic another one, whether that exists or not.
        followers: joint that mimics an existing one → (that one, multiplier, offset [rad or m]).
        continuous, prismatic: names of such joints.
        collisions: link → number of its collision shapes.
        bare: links that are drawn and have no collision shape, in the order of the file.
        undrawn: links with a faulty visual shape.
        from_visual: links whose visual shapes are their collision shapes.
        capsules: the capsules, which stand in the document as cylinders: ``"collision"`` or ``"visual"``, a blank and
            the shape's name → radius, length between the caps [m].
    """

    path: Path
    name: str
    document: str
    links: frozenset[str]
    joints: frozenset[str]
    parents: dict[str, tuple[str, str]]
    joint_limits: dict[str, tuple[float, float]]
    mimic: frozenset[str]
    followers: dict[str, tuple[str, float, float]]
    continuous: frozenset[str]
    prismatic: frozenset[str]
    collisions: dict[str, int]
    bare: tuple[str, ...] = ()
    undrawn: frozenset[str] = frozenset()
    from_visual: tuple[str, ...] = ()
    capsules: Mapping[str, Capsule] = field(default_factory=dict)

    def following(self) -> dict[str, Following]:
        """What each joint of ``followers`` does, by the first leader of its chain, which follows no joint itself."""
        found = {}
        for name in self.followers:
            leader, multiplier, constant = self.followers[name]
            while leader in self.followers:
                leader, more, offset = self.followers[leader]
                multiplier, constant = multiplier * more, multiplier * offset + constant
            found[name] = Following(leader, multiplier, constant)
        return found


def read_urdf(
    path: str | Path,
    *,
    package_dirs: tuple[str | Path, ...] = (),
    visual_as_collision: Collection[str] | str = (),
) -> UrdfSource:
    """Check a URDF file and everything that it refers to.

    Faults that ``docs/robots.md`` lists are mended with a warning.

    Args:
        path: the file.
        package_dirs: further folders to search for ``package://name/…`` (each holds the folder ``name``, or one whose
            ``package.xml`` gives that name).
        visual_as_collision: links whose visual shapes are taken as their collision shapes, or ``"missing"``: those
            that have none.

    Raises:
        RobotError: a fault; the message names the file, the element and what would be valid.
    """
    source = Path(path).expanduser().absolute()
    root = read_xml(source, root="robot", kind="URDF")
    links = _names(root, "link", source)
    joints = _names(root, "joint", source)
    mends = Mends(source)
    parents = check_tree(root, links, source)
    checked = check_joints(root, joints, source, mends)
    _check_inertials(root, source, mends)
    from_visual = drawn_as_collision(root, source, visual_as_collision)
    folders = search_folders(source, package_dirs)
    capsules, undrawn = check_geometry(root, source, folders, mends)
    for texture in root.iter("texture"):
        note_input(resolve_mesh(texture.get("filename", ""), source, folders) or source)
    check_materials(root, mends)
    if not re.fullmatch(r"1\.[0-2]", root.get("version", "1.0")):
        mends.add("version of URDF that is not known (1.0 to 1.2 are), passed over", root.attrib.pop("version"))
    if not root.get("name"):
        mends.add("robot without a name, called", source.stem)
        root.set("name", source.stem)
    mends.say()
    return UrdfSource(
        path=source,
        name=root.get("name"),
        document=_bare(root),
        links=frozenset(links),
        joints=frozenset(joints),
        parents=parents,
        joint_limits=checked.limits,
        mimic=frozenset(checked.mimic),
        followers=checked.followers,
        continuous=frozenset(checked.continuous),
        prismatic=frozenset(j.get("name") for j in root.findall("joint") if j.get("type") == "prismatic"),
        collisions={link.get("name"): len(link.findall("collision")) for link in root.findall("link")},
        bare=tuple(
            link.get("name")
            for link in root.findall("link")
            if link.find("collision") is None and (link.find("visual") is not None or link.get("name") in undrawn)
        ),
        undrawn=undrawn,
        from_visual=from_visual,
        capsules=capsules,
    )


def pinocchio_model(source: UrdfSource, *, planar: bool = False) -> pin.Model:
    """Pinocchio's model of a checked URDF file, on a planar root or a fixed one.

    Raises:
        RobotError: Pinocchio refuses the file; the message quotes it.
    """
    try:
        root = (pin.JointModelPlanar(),) if planar else ()
        return pin.buildModelFromXML(source.document, *root)
    except Exception as error:  # C++ exceptions arrive as ValueError, RuntimeError, IndexError …
        raise RobotError(
            f"{source.path}: Pinocchio cannot build the model: {_words(error)} (urdfdom says why on standard error)"
        ) from None


def pinocchio_geometry(
    source: UrdfSource, model: pin.Model, kind: pin.GeometryType, *, only: Collection[str] | None = None
) -> pin.GeometryModel:
    """Collision or visual geometry of a checked URDF file; where ``only`` is given, of these links.

    Raises:
        RobotError: Pinocchio or Coal refuses it; the message quotes them.
    """
    document = source.document if only is None else _shapes_of(source.document, only)
    try:
        geometry = pin.buildGeomFromUrdfString(model, document, kind, mesh_loader=coal.CachedMeshLoader())
    except Exception as error:
        raise RobotError(f"{source.path}: Pinocchio cannot read the geometry: {_words(error)}") from None
    tag = "collision" if kind == pin.COLLISION else "visual"
    for shape in geometry.geometryObjects:
        if (capsule := source.capsules.get(f"{tag} {shape.name}")) is not None:
            shape.geometry, shape.meshPath = coal.Capsule(*capsule), "CAPSULE"
    return geometry


def _shapes_of(document: str, links: Collection[str]) -> str:
    """A description in which only these links have shapes."""
    root = etree.fromstring(document)
    for link in root.findall("link"):
        if link.get("name") not in links:
            for shape in [*link.findall("collision"), *link.findall("visual")]:
                link.remove(shape)
    return etree.tostring(root, encoding="unicode")


def _words(error: Exception) -> str:
    """What Pinocchio, Coal or Assimp say, which may quote a whole file."""
    return shortened(" ".join(str(error).split()), 300)


def _bare(root: etree._Element) -> str:
    """The description without elements that no model needs: plugins, transmissions."""
    for element in list(root):
        if element.tag not in ("link", "joint", "material"):
            root.remove(element)
    return etree.tostring(root, encoding="unicode")


def _names(root: etree._Element, tag: str, source: Path) -> set[str]:
    names: set[str] = set()
    for element in root.findall(tag):
        name = element.get("name")
        if not name:
            raise fault(source, element, f"a <{tag}> has no name")
        if tag == "joint" and name in _RESERVED:
            raise fault(source, element, f"<joint> {name!r}: this name is reserved; give it another")
        if name in names:
            raise fault(source, element, f"<{tag}> {name!r} is defined twice")
        names.add(name)
    if tag == "link" and not names:
        raise RobotError(f"{source}: the robot has no <link>")
    return names


def _check_inertials(root: etree._Element, source: Path, mends: Mends) -> None:
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        what = f"link {link.get('name')!r}"
        mass = inertial.find("mass")
        if mass is None:
            raise fault(source, inertial, f"{what} has <inertial> without <mass>")
        (value,) = floats(mass, "value", 1, source, what)
        if value < 0:
            raise fault(source, mass, f"{what} has mass {value} kg; it must be ≥ 0")
        check_origins(inertial, source, what)
        tensor = inertial.find("inertia")
        if tensor is None:
            raise fault(source, inertial, f"{what} has <inertial> without <inertia>")
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            (moment,) = floats(tensor, key, 1, source, what)
            if key in ("ixx", "iyy", "izz") and moment < 0:
                if moment >= -_INERTIA_ROUNDING:
                    mends.add("links with a moment of inertia below 0 by rounding, taken as 0", link.get("name"))
                    tensor.set(key, "0")
                    continue
                raise fault(source, tensor, f"{what} has {key} = {moment}; it must be ≥ 0")
