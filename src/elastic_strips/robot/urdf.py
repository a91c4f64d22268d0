"""The validating URDF reader: every fault is one error that names the file and the element.

Pinocchio's own parser reports a fault as a line on standard error or a crash in C++, and some small faults too; so a
description is checked here first, and Pinocchio and Coal build their models from a copy with small faults mended.
"""

from __future__ import annotations

import logging
import math
import os
import re
from collections.abc import Collection, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path

import coal
import pinocchio as pin
from lxml import etree

from elastic_strips.errors import RobotError, nearest_name
from elastic_strips.files import check_input, note_input, read_input
from elastic_strips.packages import package_of
from elastic_strips.summary import shortened

from .collada import mesh_unit
from .mimic import Following

_log = logging.getLogger(__name__)
_SHOWN = 12


class Mends:
    """Faults of one file, counted by kind."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self._found: dict[str, list[str]] = {}

    def add(self, kind: str, name: object) -> None:
        """Note a fault: its kind, in words that follow a count ("links that the robot does not have"), and where."""
        names = self._found.setdefault(kind, [])
        if repr(name) not in names:
            names.append(repr(name))

    def say(self) -> None:
        """Log one warning for each kind of fault, with the names."""
        for kind, names in self._found.items():
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            _log.warning("%s: %d %s: %s%s", self._source, len(names), kind, ", ".join(names[:_SHOWN]), more)


_MAX_BYTES = 8_000_000
_MAX_TEXT = 500  # characters of an attribute


def read_xml(path: Path, *, root: str, kind: str) -> etree._Element:
    """Parse a file and return its root element (``lxml``).

    Args:
        path: the file.
        root: the tag that the root element must have.
        kind: what to call the file in messages ("URDF", "SRDF").

    Raises:
        RobotError: missing, unreadable, too large, with a document type or entities, malformed, or another root.
    """
    text = read_input(path, f"{kind} file", _MAX_BYTES, RobotError)
    if not text.strip():
        raise RobotError(f"{path}: the {kind} file is empty")
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise RobotError(f"{path}: the {kind} file has a document type or entities, which are not accepted")
    try:
        try:
            element = etree.fromstring(text, _parser())
        except etree.XMLSyntaxError as error:
            if error.code != etree.ErrorTypes.ERR_UNSUPPORTED_ENCODING or (known := _in_utf8(text)) is None:
                raise
            element = etree.fromstring(known, _parser("utf-8"))
    except (etree.XMLSyntaxError, ValueError) as error:
        said = " ".join(str(error).split())
        raise RobotError(f"{path}: the {kind} file is not well-formed XML: {said}") from None
    docinfo = element.getroottree().docinfo
    if docinfo.doctype or docinfo.internalDTD is not None:  # another encoding hides it from the search above
        raise RobotError(f"{path}: the {kind} file has a document type, which is not accepted")
    _check_encoding(text, path, kind)
    if element.tag != root:
        raise RobotError(f"{path}:{element.sourceline}: root element is <{element.tag}>; a {kind} file has <{root}>")
    for each in element.iter():  # so that every message that quotes a name stays readable
        for key, value in each.attrib.items():
            if len(value) > _MAX_TEXT:
                where = f"{path}:{each.sourceline}: <{each.tag!s:.60}>"
                raise RobotError(f"{where}: attribute {key!s:.60} has {len(value)} characters; at most {_MAX_TEXT}")
    return element


_DECLARED = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]+)["']""")
_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def _parser(encoding: str | None = None) -> etree.XMLParser:
    return etree.XMLParser(
        encoding=encoding, resolve_entities=False, no_network=True, huge_tree=False, remove_comments=True,
        remove_pis=True,
    )  # fmt: skip


def _in_utf8(text: bytes) -> bytes | None:
    """A file whose declared encoding Python knows and the parser does not (``latin-1``), in UTF-8; else None."""
    found = _DECLARED.search(text[:1000])
    try:
        return None if found is None else text.decode(found[1].decode("ascii")).encode("utf-8")
    except (LookupError, UnicodeError):
        return None


def _check_encoding(text: bytes, path: Path, kind: str) -> None:
    """Check that a file is written as its mark or its first line says, and in UTF-8 where neither says anything.

    The parser is less strict: it guesses, and may guess other names than those that were meant.

    Raises:
        RobotError: it is written differently.
    """
    mark = next((name for start, name in _MARKS.items() if text.startswith(start)), None)
    found = _DECLARED.search(text[:1000].replace(b"\0", b""))
    declared = None if found is None else found[1].decode("ascii").lower()
    encoding = mark or declared or "utf-8"
    agree = mark is None or declared is None or declared.replace("_", "-").startswith(mark)
    try:
        readable = agree and "\0" not in text.decode(encoding)
    except (LookupError, UnicodeDecodeError):
        readable = False
    if not agree:
        raise RobotError(f"{path}: the {kind} file is {mark} by its mark, and its first line declares {declared}")
    if not readable:
        said = f"{declared} text, which its first line declares" if declared else "UTF-8 text"
        raise RobotError(f"{path}: the {kind} file is not {said}")


_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)


def fault(source: Path, element: etree._Element, text: str) -> RobotError:
    """The error about an element of a file: the message begins with file and line."""
    return RobotError(f"{source}:{element.sourceline}: {text}")


def floats(
    element: etree._Element, key: str, count: int, source: Path, what: str, default: str | None = None, *,
    bound: float = math.inf,
) -> list[float]:  # fmt: skip
    """The numbers of an attribute.

    Args:
        element: the XML element.
        key: the attribute's name.
        count: how many numbers it has to hold.
        source: the file; what: the link or joint that it belongs to, for messages.
        default: text where the attribute is missing; it is needed where None.
        bound: largest magnitude.

    Raises:
        RobotError: missing, not ``count`` finite numbers, or beyond ``bound``.
    """
    text = element.get(key, default)
    if text is None:
        raise fault(source, element, f"{what}: <{element.tag}> has no attribute {key!r}")
    quoted = repr(text if len(text) <= 80 else text[:77] + "...")
    where = f"{what}: <{element.tag} {key}={quoted}>"
    words = text.split()
    if not all(_NUMBER.fullmatch(word) for word in words):  # float() reads more than a URDF may hold
        raise fault(source, element, f"{where} is not {count} number(s)")
    values = [float(word) for word in words]
    if len(values) != count or not all(math.isfinite(v) for v in values):
        raise fault(source, element, f"{where} is not {count} finite number(s)")
    if any(abs(v) > bound for v in values):
        raise fault(source, element, f"{where} is beyond ±{bound:g}")
    if count == 1 and key in element.attrib:
        element.set(key, words[0])  # urdfdom takes no blanks about a single number
    return values


def _check_origins(element: etree._Element, source: Path, what: str) -> None:
    for origin in element.findall("origin"):
        for key in ("xyz", "rpy"):
            floats(origin, key, 3, source, what, "0 0 0", bound=MAX_LENGTH)


_MIN_SIZE, MAX_LENGTH = 1e-6, 1e6  # [m]; as in scenes
_PLATE = 1e-4  # [m]: a plate or a rod of no thickness gets this one
_MAX_MESH_BYTES = 100_000_000
_MAX_SHAPES = 500
_MESH_SUFFIXES = (".dae", ".mesh", ".obj", ".stl")  # a damaged .ply ends the process within Assimp
_SHAPES = {
    "box": ("size", 3),
    "sphere": ("radius", 1),
    "cylinder": ("radius length", 1),
    "capsule": ("radius length", 1),
}


def search_folders(source: Path, extra: tuple[str | Path, ...]) -> list[Path]:
    """Folders that may hold packages: given ones, the file's, its ancestors', and those of ROS and of cmeel."""

    folders = [Path(f).expanduser().absolute() for f in extra]
    folders += [source.parent, *list(source.parents)[1:6]]
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            folders += [Path(entry), Path(entry) / "share"]
    return list(dict.fromkeys(f for f in folders if os.path.isdir(f)))


def resolve_mesh(
    name: str, source: Path, folders: list[Path], packages: dict[str, Path | None] | None = None
) -> Path | None:
    """The file that a URDF mesh name means, or None.

    Args:
        name: as the file has it.
        source: the file.
        folders: what `search_folders` found.
        packages: packages that were found by their ``package.xml``, to be asked for once; filled here.
    """
    # os.path.isfile is false where Path.is_file raises: a name that is too long, a folder that may not be entered
    if name.startswith("file://"):
        candidate = Path(name[len("file://") :])
        return candidate if os.path.isfile(candidate) else None
    if name.startswith("package://"):
        rest = name[len("package://") :].lstrip("/")  # some name no package
        found = next((f / rest for f in folders if os.path.isfile(f / rest)), None)
        if found is not None:
            return found
        package, _, inside = rest.partition("/")
        known = {} if packages is None else packages
        if package not in known:
            known[package] = package_of(package, folders)
        folder = known[package]
        return folder / inside if folder is not None and os.path.isfile(folder / inside) else None
    candidate = Path(name)
    if candidate.is_absolute():
        return candidate if os.path.isfile(candidate) else None
    return next((f / name for f in [source.parent, *folders] if os.path.isfile(f / name)), None)


def _as_collision(root: etree._Element, source: Path, wanted: Collection[str] | str) -> tuple[str, ...]:
    """Give links their visual shapes as collision shapes, instead of their own; returns the links that got some.

    Raises:
        RobotError: a link that does not exist, or has no visual shape.
    """
    links = {link.get("name"): link for link in root.findall("link")}
    if wanted == "missing":
        names = [name for name, link in links.items() if all(map(_of_no_size, link.findall("collision")))]
    elif isinstance(wanted, str) or not isinstance(wanted, Collection):
        raise RobotError(f'visual_as_collision={wanted!r}: give a list of links, or "missing" for those without shapes')
    else:
        names = list(dict.fromkeys(wanted))
    for name in names:
        if name not in links:
            raise RobotError(f"{source}: visual_as_collision: unknown link {name!r}{nearest_name(name, links)}")
        visuals = links[name].findall("visual")
        if not visuals and wanted != "missing":
            raise RobotError(f"{source}: visual_as_collision: link {name!r} has no <visual>")
        for own in links[name].findall("collision") if visuals else []:
            links[name].remove(own)
        for visual in visuals:
            shape = deepcopy(visual)
            shape.tag, shape.tail = "collision", None
            for material in shape.findall("material"):
                shape.remove(material)
            links[name].append(shape)
    return tuple(name for name in names if links[name].find("visual") is not None)


def _of_no_size(element: etree._Element) -> bool:
    """Whether the shape of a <collision> has size 0, so that it is left out."""
    shape = element.find("geometry/*")
    if shape is None or shape.tag not in _SHAPES:
        return False
    words = [word for key in _SHAPES[shape.tag][0].split() for word in shape.get(key, "").split()]
    return bool(words) and all(_NUMBER.fullmatch(word) and float(word) == 0.0 for word in words)


def _check_geometry(
    root: etree._Element, source: Path, folders: list[Path], mends: Mends
) -> tuple[dict[str, _Capsule], frozenset[str]]:
    """Check all shapes; mesh names become paths, and a visual shape with a fault is left out.

    Returns:
        The capsules, which stand in the document as cylinders: ``"collision"`` or ``"visual"``, and the shape's name.
        And the links some of whose visual shapes were left out.

    Raises:
        RobotError: a collision shape with a fault, or too many of them.
    """
    count = len(root.findall("link/collision"))
    if count > _MAX_SHAPES:
        raise RobotError(f"{source}: the robot has {count} collision shapes; at most {_MAX_SHAPES} are accepted")
    packages: dict[str, Path | None] = {}
    capsules: dict[str, _Capsule] = {}
    undrawn: set[str] = set()
    for link in root.findall("link"):
        name = link.get("name")
        for tag in ("collision", "visual"):
            for element in link.findall(tag):
                what = f"link {name!r} <{tag}>"
                try:
                    extended = _check_element(element, source, folders, packages, what, mends, name)
                except RobotError:
                    if tag == "collision":
                        raise
                    mends.add("links with a visual shape or mesh that cannot be read, not drawn", name)
                    undrawn.add(name)
                    extended = False
                if not extended:
                    link.remove(element)
            for number, element in enumerate(link.findall(tag)):
                shape = element.find("geometry")[0]
                if shape.tag == "capsule":
                    radius, length = (float(shape.get(key)) for key in ("radius", "length"))
                    capsules[f"{tag} {name}_{number}"] = radius, length
                    shape.tag = "cylinder"
        for number, material in enumerate(link.iter("material")):
            if not material.get("name"):
                mends.add("links with a <material> without a name, given one", name)
                material.set("name", f"{name} {number}")
    return capsules, frozenset(undrawn)


def _check_materials(root: etree._Element, mends: Mends) -> None:
    """Take out the materials for which urdfdom refuses the whole file, or about which it complains outside the log."""
    names: set[str] = set()
    for material in root.findall("material"):
        name, texture, color = material.get("name"), material.find("texture"), material.find("color")
        if not name:  # nothing can refer to it
            root.remove(material)
            continue
        rgba = "" if color is None else color.get("rgba", "")
        sound = len(rgba.split()) == 4 and all(_NUMBER.fullmatch(w) and 0.0 <= float(w) <= 1.0 for w in rgba.split())
        if name in names:
            mends.add("materials that are defined more than once, taken as they are first", name)
            root.remove(material)
        elif not sound and (texture is None or not texture.get("filename") or color is not None):
            mends.add("materials without a color (rgba: four numbers from 0 to 1), drawn grey", name)
            root.remove(material)
        names.add(name)


def _check_element(
    element: etree._Element, source: Path, folders: list[Path], packages: dict[str, Path | None], what: str,
    mends: Mends, link: str,
) -> bool:  # fmt: skip
    """Check a <collision> or <visual>; False where it has no size at all.

    Raises:
        RobotError: a fault of it.
    """
    _check_origins(element, source, what)
    geometry = element.find("geometry")
    if geometry is None or len(geometry) == 0:
        raise fault(source, element, f"{what} has no <geometry>")
    shapes = [shape for each in element.findall("geometry") for shape in each]
    if len(shapes) > 1:  # all but the first would be ignored in silence
        raise fault(
            source, shapes[1], f"{what} has a second shape <{shapes[1].tag!s:.60}>; give it its own <{element.tag}>"
        )
    shape = geometry[0]
    if shape.tag == "mesh":
        _check_mesh(shape, source, folders, packages, what, mends)
        return True
    if shape.tag not in _SHAPES:
        hint = nearest_name(shape.tag, [*_SHAPES, "mesh"])
        raise fault(source, shape, f"{what} has unknown shape <{shape.tag!s:.60}>{hint}")
    keys, count = _SHAPES[shape.tag]
    sizes = {key: floats(shape, key, count, source, what, bound=MAX_LENGTH) for key in keys.split()}
    for key, values in sizes.items():
        if any(value != 0.0 and value < _MIN_SIZE for value in values):
            least = "≥ 0" if min(values) < 0 else f"0 or at least {_MIN_SIZE:g} m"
            raise fault(source, shape, f"{what} has {key} {values}; it must be {least}")
    if not any(any(values) for values in sizes.values()):
        mends.add("links with a shape of size 0, left out", link)
        return False
    if shape.tag == "capsule" and sizes["length"] == [0.0]:
        shape.tag = "sphere"
        del shape.attrib["length"], sizes["length"]
    for key, values in sizes.items():
        if not all(values):  # a plate or a rod, which one can run into
            mends.add(f"links with a shape of no thickness, taken as {1e3 * _PLATE:g} mm thick", link)
            shape.set(key, " ".join(str(value or _PLATE) for value in values))
    return True


def _check_mesh(
    shape: etree._Element, source: Path, folders: list[Path], packages: dict[str, Path | None], what: str, mends: Mends
) -> None:
    name = shape.get("filename")
    if not name:
        raise fault(source, shape, f"{what} has a <mesh> without filename")
    scale = floats(shape, "scale", 3, source, what, "1 1 1")
    if 0.0 in scale:
        raise fault(source, shape, f"{what} has a mesh scale of 0")
    found = resolve_mesh(name, source, folders, packages)
    if found is None:
        raise fault(source, shape, f"{what}: mesh {name!r} not found{_remedy(name, folders)}")
    if found.suffix.lower() not in _MESH_SUFFIXES:
        hint = nearest_name(found.suffix.lower(), _MESH_SUFFIXES)
        raise fault(source, shape, f"{what}: mesh files of kind {found.suffix!r} are not read ({found}){hint}")
    note_input(found.with_suffix(".mtl"))  # the colours of an .obj
    if not check_input(found, "mesh file", _MAX_MESH_BYTES, RobotError):
        raise fault(source, shape, f"{what}: mesh file {found} is empty")
    shape.set("filename", f"file://{found}")
    unit = mesh_unit(found)
    if unit != 1.0:
        mends.add(f"meshes in another unit than a metre, scaled by the {unit:g} m that their <unit> states", found.name)
        shape.set("scale", " ".join(repr(unit * value) for value in scale))


def _remedy(name: str, folders: list[Path]) -> str:
    """Where a mesh was searched, and what to give so that it is found."""
    if name.startswith("file://") or os.path.isabs(name):
        return ""
    searched = ", ".join(str(f) for f in folders[:3])
    holds = f"holds {name.removeprefix('package://').lstrip('/').split('/')[0]!r}"
    return (
        f" (searched {searched}, …). Name the folder that {holds}: package_dirs=[…], --package-dir on the command "
        "line, or ROS_PACKAGE_PATH"
    )


_JOINT_TYPES = {"revolute", "continuous", "prismatic", "fixed", "floating", "planar"}
_ROUNDING = 1e-12  # a moment of inertia [kg m²] below 0 by at most this was 0 before it was rounded
_RESERVED = ("root_joint", "universe")  # names that Pinocchio's models give themselves


_Capsule = tuple[float, float]  # radius, length between the caps [m]


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
    capsules: Mapping[str, _Capsule] = field(default_factory=dict)

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
    parents = _check_tree(root, links, source)
    limits, mimic, followers, continuous = _check_joints(root, joints, source, mends)
    _check_inertials(root, source, mends)
    from_visual = _as_collision(root, source, visual_as_collision)
    folders = search_folders(source, package_dirs)
    capsules, undrawn = _check_geometry(root, source, folders, mends)
    for texture in root.iter("texture"):
        note_input(resolve_mesh(texture.get("filename", ""), source, folders) or source)
    _check_materials(root, mends)
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
        joint_limits=limits,
        mimic=frozenset(mimic),
        followers=followers,
        continuous=frozenset(continuous),
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


def _check_tree(root: etree._Element, links: set[str], source: Path) -> dict[str, tuple[str, str]]:
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


def _check_joints(
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
        _check_origins(joint, source, what)
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
                mends.add("joints that mimic one that the robot does not have, locked unless told otherwise", name)
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
    """Check elements that no model needs, but for whose faults urdfdom refuses the file."""
    for tag in ("safety_controller", "calibration"):
        for element in joint.findall(tag):
            joint.remove(element)
    for element in joint.findall("dynamics"):
        for key in ("damping", "friction"):
            floats(element, key, 1, source, what, "0")
        if not {"damping", "friction"} & set(element.attrib):
            joint.remove(element)


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
        _check_origins(inertial, source, what)
        tensor = inertial.find("inertia")
        if tensor is None:
            raise fault(source, inertial, f"{what} has <inertial> without <inertia>")
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            (moment,) = floats(tensor, key, 1, source, what)
            if key in ("ixx", "iyy", "izz") and moment < 0:
                if moment >= -_ROUNDING:
                    mends.add("links with a moment of inertia below 0 by rounding, taken as 0", link.get("name"))
                    tensor.set(key, "0")
                    continue
                raise fault(source, tensor, f"{what} has {key} = {moment}; it must be ≥ 0")
