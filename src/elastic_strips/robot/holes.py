"""Holes of a robot: links that are drawn and have no collision shape, and their drawn shapes in its place."""

from __future__ import annotations

import logging

import numpy as np
import pinocchio as pin

from elastic_strips.coal_shapes import SIGNS, ShapeKind, convex_from_vertices, shape_of, vertices
from elastic_strips.errors import RobotError

from .cover import sticks_out
from .model import RobotModel
from .urdf import UrdfSource, pinocchio_geometry
from .urdf_shapes import PLATE_THICKNESS

_log = logging.getLogger(__name__)
_GROWTH_TOLD = 0.05  # [m] by which a piece of a drawn shape may reach out of it without a warning


def drawn_alone(source: UrdfSource, model: pin.Model) -> pin.GeometryModel | None:
    """Visual geometry of the links that have no collision shape; None where it cannot be read."""
    try:
        return pinocchio_geometry(source, model, pin.VISUAL, only=source.bare)
    except RobotError as error:
        _log.warning("%s", error)
        return None


def bare_links(source: UrdfSource, robot: RobotModel, drawn: pin.GeometryModel | None) -> tuple[str, ...]:
    """The links that are drawn and not covered; links whose shapes cannot be read count as not covered."""
    if drawn is None:
        return source.bare
    return tuple(link for link in source.bare if link in robot.bare_links or link in source.undrawn)


def thicken(collision: pin.GeometryModel, source: UrdfSource) -> None:
    """A drawn shape may be a sheet, which has no hull: as a collision shape it is the box about it, 0.1 mm thick."""
    for shape in collision.geometryObjects:
        if shape.name.rsplit("_", 1)[0] in source.from_visual and shape_of(shape.geometry)[0] is ShapeKind.MESH:
            points = vertices(shape.geometry)
            if not len(points) or not np.isfinite(points).all():
                continue  # which is refused
            thin = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
            if np.ptp(points @ thin) < PLATE_THICKNESS:
                half = np.maximum(0.5 * np.ptp(points, axis=0), 0.5 * PLATE_THICKNESS)
                middle = 0.5 * (points.max(axis=0) + points.min(axis=0))
                shape.geometry = convex_from_vertices(middle + SIGNS * half, name=shape.name)


def say_what_grew(robot: RobotModel, links: tuple[str, ...]) -> None:
    """Warn about pieces of some links that reach far out of the shapes that they stand for."""
    assert robot.shapes is not None
    for piece in robot.geometries if links else ():
        far = sticks_out(robot.model, robot.shapes, piece) if set(piece.links) & set(links) else 0.0
        if far > _GROWTH_TOLD:
            _log.warning(
                "%s: the convex piece %r of what is drawn reaches %.0f mm out of it, and so too much is refused",
                robot.name,
                piece.name,
                1e3 * far,
            )
