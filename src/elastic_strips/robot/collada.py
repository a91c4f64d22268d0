"""What a Collada file says about itself: its unit, and which of its axes is up."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import ShapeKind, shape_of, vertices

_log = logging.getLogger(__name__)
_TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # takes y, where that is up, to z
_CENTRE_SLACK = 5e-3  # [m] by which a centre of mass may lie beside what is drawn of its link


def mesh_unit(path: Path) -> float:
    """The unit of length [m] of a mesh file: a Collada file may state one, which Coal ignores; else it is a metre."""
    unit = _of_asset(path, "unit")
    if unit is None:
        return 1.0
    stated = unit.get("meter", "1")
    try:
        value = float(stated)
    except ValueError:
        value = math.nan
    if math.isfinite(value) and value > 0.0:
        return value
    _log.warning("%s: its <unit> of %.40r m is not a length; taken as a metre", path, stated)
    return 1.0


def meant_turned(document: str, model: pin.Model, geometry: pin.GeometryModel) -> tuple[str, ...]:
    """Links whose Collada meshes hold their centres of mass only if ``<up_axis>Y_UP</up_axis>`` turned them.

    The element is ignored, as in RViz: nearly all URDF files are written for that. Where such links are more than twice
    as many as those of which it is the other way round, this file is not; else there are none.

    Args:
        document: the URDF.
        model, geometry: made of it.
    """
    centres = _centres_of_mass(document)
    ups: dict[str, bool] = {}
    now: set[str] = set()
    turned: set[str] = set()
    for shape in geometry.geometryObjects:
        name, file = shape.name.rsplit("_", 1)[0], shape.meshPath
        if (
            name not in centres
            or not file.lower().endswith(".dae")
            or shape_of(shape.geometry)[0] is not ShapeKind.MESH
        ):
            continue
        if file not in ups:
            axis = _of_asset(Path(file), "up_axis")
            ups[file] = axis is not None and (axis.text or "").strip() == "Y_UP"
        points = vertices(shape.geometry)
        if not ups[file] or not len(points):
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        centre = shape.placement.actInv(frame.placement.act(centres[name]))
        as_read, as_turned = _holds(points, centre), _holds(points @ _TURN.T, centre)
        if as_read != as_turned:
            (now if as_read else turned).add(name)
    return tuple(sorted(turned - now)) if len(turned) > 2 * len(now) else ()


def said_of_turned(links: tuple[str, ...]) -> str:
    """A sentence about them."""
    return (
        f"the Collada meshes of {len(links)} links hold their centres of mass only if <up_axis>Y_UP</up_axis> counted, "
        f"which is ignored, as in RViz: {', '.join(links[:8])}{', …' * (len(links) > 8)}. If they look turned, write "
        "the meshes again with Z_UP"
    )


def _holds(points: Array, centre: Array) -> bool:
    """Whether the box about points (N, 3) holds a centre (3,) [m]."""
    return bool(((points.min(axis=0) - _CENTRE_SLACK <= centre) & (centre <= points.max(axis=0) + _CENTRE_SLACK)).all())


def _centres_of_mass(document: str) -> dict[str, Array]:
    """Centres of mass of the links that have a mass, in their own frames [m]."""
    found = {}
    for link in etree.fromstring(document.encode()).findall("link"):
        mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
        if mass is not None and float(mass.get("value", "0")) > 0.0:
            at = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
            found[str(link.get("name"))] = np.array([float(x) for x in at.split()])
    return found


def _of_asset(path: Path, tag: str) -> etree._Element | None:
    """An element of a Collada file's own asset; None where there is none, or the file is another or not to be read."""
    if path.suffix.lower() != ".dae":
        return None
    try:
        events = etree.iterparse(str(path), events=("end",), resolve_entities=False, no_network=True, huge_tree=False)
        for _, element in events:
            parent = element.getparent()
            outermost = parent is not None and parent.getparent() is None
            if outermost:  # the asset comes first, or not at all
                return element.find(f"{{*}}{tag}") if etree.QName(element).localname == "asset" else None
    except (etree.XMLSyntaxError, OSError, ValueError):  # who reads the mesh will say so
        pass
    return None
