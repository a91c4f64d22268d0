"""Shapes of a URDF: checked one by one, with the files that their meshes mean, and mended where little is wrong."""

from __future__ import annotations

import os
from collections.abc import Collection
from copy import deepcopy
from pathlib import Path

from lxml import etree

from elastic_strips.errors import RobotError, nearest_name
from elastic_strips.files import check_input, note_input
from elastic_strips.packages import package_of
from elastic_strips.validation import MAX_LENGTH, MIN_LENGTH

from .collada import mesh_unit
from .xml_file import NUMBER, Mends, check_origins, fault, floats

Capsule = tuple[float, float]  # radius, length between the caps [m]
PLATE_THICKNESS = 1e-4
"""What is drawn or described without a thickness gets this one [m]."""
_MAX_MESH_BYTES = 100_000_000
_MAX_COLLISION_SHAPES = 500
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


def drawn_as_collision(root: etree._Element, source: Path, wanted: Collection[str] | str) -> tuple[str, ...]:
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
    return bool(words) and all(NUMBER.fullmatch(word) and float(word) == 0.0 for word in words)


def check_geometry(
    root: etree._Element, source: Path, folders: list[Path], mends: Mends
) -> tuple[dict[str, Capsule], frozenset[str]]:
    """Check all shapes; mesh names become paths, and a visual shape with a fault is left out.

    Returns:
        The capsules, which stand in the document as cylinders: ``"collision"`` or ``"visual"``, and the shape's name.
        And the links some of whose visual shapes were left out.

    Raises:
        RobotError: a collision shape with a fault, or too many of them.
    """
    count = len(root.findall("link/collision"))
    if count > _MAX_COLLISION_SHAPES:
        raise RobotError(
            f"{source}: the robot has {count} collision shapes; at most {_MAX_COLLISION_SHAPES} are accepted"
        )
    packages: dict[str, Path | None] = {}
    capsules: dict[str, Capsule] = {}
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


def check_materials(root: etree._Element, mends: Mends) -> None:
    """Take out the materials for which urdfdom refuses the whole file, or about which it complains outside the log."""
    names: set[str] = set()
    for material in root.findall("material"):
        name, texture, color = material.get("name"), material.find("texture"), material.find("color")
        if not name:  # nothing can refer to it
            root.remove(material)
            continue
        rgba = "" if color is None else color.get("rgba", "")
        sound = len(rgba.split()) == 4 and all(NUMBER.fullmatch(w) and 0.0 <= float(w) <= 1.0 for w in rgba.split())
        if name in names:
            mends.add("materials that are defined more than once, taken as they are first", name)
            root.remove(material)
        elif not sound and (texture is None or not texture.get("filename") or color is not None):
            mends.add("materials without a color (rgba: four numbers from 0 to 1), drawn grey", name)
            root.remove(material)
        names.add(name)


def _check_element(
    element: etree._Element,
    source: Path,
    folders: list[Path],
    packages: dict[str, Path | None],
    what: str,
    mends: Mends,
    link: str,
) -> bool:
    """Check a <collision> or <visual>; False where it has no size at all.

    Raises:
        RobotError: a fault of it.
    """
    check_origins(element, source, what)
    shape = _only_shape(element, source, what)
    if shape.tag == "mesh":
        _check_mesh(shape, source, folders, packages, what, mends)
        return True
    if shape.tag not in _SHAPES:
        hint = nearest_name(shape.tag, [*_SHAPES, "mesh"])
        raise fault(source, shape, f"{what} has unknown shape <{shape.tag!s:.60}>{hint}")
    return _check_sizes(shape, source, what, mends, link)


def _only_shape(element: etree._Element, source: Path, what: str) -> etree._Element:
    """The one shape that a <collision> or <visual> has."""
    geometry = element.find("geometry")
    if geometry is None or len(geometry) == 0:
        raise fault(source, element, f"{what} has no <geometry>")
    shapes = [shape for each in element.findall("geometry") for shape in each]
    if len(shapes) > 1:  # all but the first would be ignored in silence
        raise fault(
            source, shapes[1], f"{what} has a second shape <{shapes[1].tag!s:.60}>; give it its own <{element.tag}>"
        )
    return geometry[0]


def _check_sizes(shape: etree._Element, source: Path, what: str, mends: Mends, link: str) -> bool:
    """Check the sizes of a shape, and make a plate that has a thickness of one that has none; False if all are 0."""
    keys, count = _SHAPES[shape.tag]
    sizes = {key: floats(shape, key, count, source, what, bound=MAX_LENGTH) for key in keys.split()}
    for key, values in sizes.items():
        if any(value != 0.0 and value < MIN_LENGTH for value in values):
            least = "≥ 0" if min(values) < 0 else f"0 or at least {MIN_LENGTH:g} m"
            raise fault(source, shape, f"{what} has {key} {values}; it must be {least}")
    if not any(any(values) for values in sizes.values()):
        mends.add("links with a shape of size 0, left out", link)
        return False
    if shape.tag == "capsule" and sizes["length"] == [0.0]:
        shape.tag = "sphere"
        del shape.attrib["length"], sizes["length"]
    for key, values in sizes.items():
        if not all(values):  # a plate or a rod, which one can run into
            mends.add(f"links with a shape of no thickness, taken as {1e3 * PLATE_THICKNESS:g} mm thick", link)
            shape.set(key, " ".join(str(value or PLATE_THICKNESS) for value in values))
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
