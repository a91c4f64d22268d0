"""Shapes and meshes of a URDF: every size is sound and every mesh file is there; what cannot be drawn is left out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..errors import RobotError, nearest_name
from ..input_file import check_input
from .mends import Mends
from .xml_source import floats

_MIN_SIZE, MAX_LENGTH = 1e-6, 1e6  # [m]; as in scenes
MAX_MESH_BYTES = 100_000_000
MAX_SHAPES = 500
MESH_SUFFIXES = (".dae", ".mesh", ".obj", ".stl")  # a damaged .ply ends the process within Assimp
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


def resolve_mesh(name: str, source: Path, folders: list[Path]) -> Path | None:
    """The file that a URDF mesh name means, or None."""
    # os.path.isfile is false where Path.is_file raises: a name that is too long, a folder that may not be entered
    if name.startswith("file://"):
        candidate = Path(name[len("file://") :])
        return candidate if os.path.isfile(candidate) else None
    if name.startswith("package://"):
        rest = name[len("package://") :].lstrip("/")  # some name no package
        return next((f / rest for f in folders if os.path.isfile(f / rest)), None)
    candidate = Path(name)
    if candidate.is_absolute():
        return candidate if os.path.isfile(candidate) else None
    return next((f / name for f in [source.parent, *folders] if os.path.isfile(f / name)), None)


def check_geometry(root: Any, source: Path, folders: list[Path], mends: Mends) -> None:
    """Check all shapes; mesh names become paths, and a visual shape with a fault is left out.

    Raises:
        RobotError: a collision shape with a fault, or too many of them.
    """
    count = len(root.findall("link/collision"))
    if count > MAX_SHAPES:
        raise RobotError(f"{source}: the robot has {count} collision shapes; at most {MAX_SHAPES} are accepted")
    for link in root.findall("link"):
        for tag in ("collision", "visual"):
            for element in link.findall(tag):
                what = f"link {link.get('name')!r} <{tag}>"
                try:
                    _check_element(element, source, folders, what)
                except RobotError:
                    if tag == "collision":
                        raise
                    mends.add("links with a visual shape or mesh that cannot be read, not drawn", link.get("name"))
                    link.remove(element)
        for number, material in enumerate(link.iter("material")):
            if not material.get("name"):
                mends.add("links with a <material> without a name, given one", link.get("name"))
                material.set("name", f"{link.get('name')} {number}")
    for material in root.findall("material"):
        if not material.get("name"):  # nothing can refer to it
            root.remove(material)


def _check_element(element: Any, source: Path, folders: list[Path], what: str) -> None:
    for origin in element.findall("origin"):
        floats(origin, "xyz", 3, source, what, "0 0 0", bound=MAX_LENGTH)
        floats(origin, "rpy", 3, source, what, "0 0 0", bound=MAX_LENGTH)
    geometry = element.find("geometry")
    if geometry is None or len(geometry) == 0:
        raise RobotError(f"{source}:{element.sourceline}: {what} has no <geometry>")
    shapes = [shape for each in element.findall("geometry") for shape in each]
    if len(shapes) > 1:  # all but the first would be ignored in silence
        raise RobotError(
            f"{source}:{shapes[1].sourceline}: {what} has a second shape <{shapes[1].tag}>; give it its own "
            f"<{element.tag}>"
        )
    shape = geometry[0]
    if shape.tag == "mesh":
        _check_mesh(shape, source, folders, what)
    elif shape.tag in _SHAPES:
        keys, count = _SHAPES[shape.tag]
        for key in keys.split():
            values = floats(shape, key, count, source, what, bound=MAX_LENGTH)
            if min(values) < _MIN_SIZE:
                least = "> 0" if min(values) <= 0 else f"at least {_MIN_SIZE:g} m"
                raise RobotError(f"{source}:{shape.sourceline}: {what} has {key} {values}; it must be {least}")
        if shape.tag == "capsule":
            raise RobotError(
                f"{source}:{shape.sourceline}: {what}: Pinocchio reads no <capsule> from a URDF; give a <cylinder> and "
                "two <sphere>s"
            )
    else:
        hint = nearest_name(shape.tag, [*_SHAPES, "mesh"])
        raise RobotError(f"{source}:{shape.sourceline}: {what} has unknown shape <{shape.tag}>{hint}")


def _check_mesh(shape: Any, source: Path, folders: list[Path], what: str) -> None:
    name = shape.get("filename")
    if not name:
        raise RobotError(f"{source}:{shape.sourceline}: {what} has a <mesh> without filename")
    if 0.0 in floats(shape, "scale", 3, source, what, "1 1 1"):
        raise RobotError(f"{source}:{shape.sourceline}: {what} has a mesh scale of 0")
    found = resolve_mesh(name, source, folders)
    if found is None:
        searched = ", ".join(str(f) for f in folders[:4])
        raise RobotError(f"{source}:{shape.sourceline}: {what}: mesh {name!r} not found (searched {searched}, …)")
    if found.suffix.lower() not in MESH_SUFFIXES:
        hint = nearest_name(found.suffix.lower(), MESH_SUFFIXES)
        raise RobotError(
            f"{source}:{shape.sourceline}: {what}: mesh files of kind {found.suffix!r} are not read ({found}){hint}"
        )
    if not check_input(found, "mesh file", MAX_MESH_BYTES, RobotError):
        raise RobotError(f"{source}:{shape.sourceline}: {what}: mesh file {found} is empty")
    shape.set("filename", f"file://{found}")
