"""Scene room, parts: the convex Coal geometries that obstacles consist of, with bounds for culling.

Everything here is in the obstacle's own frame, so that all copies of an obstacle that is moved share one `Solid`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal as _coal
import numpy as np

from elastic_strips.errors import SceneError
from elastic_strips.scene.checks import Array

coal: Any = _coal  # compiled, without type stubs

MIN_THICKNESS = 1e-6
"""A convex hull thinner than this [m] counts as flat and is refused."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One convex piece of an obstacle, or one block of boxes; all in the obstacle's frame.

    Attributes:
        geometry: Coal geometry, its local AABB computed; None for a block of boxes.
        T_obstacle_part: Pose (4, 4) of the geometry in the obstacle's frame; the rotation always is the identity.
        center: Centre (3,) of the part's axis-aligned bounding box [m].
        half_extents: Half sizes (3,) of that box [m].
        radius: Radius of a sphere about ``center`` that holds the part [m].
        boxes: For a block: the (coal.Box, translation (3,)) of its members; empty otherwise.
    """

    geometry: Any
    T_obstacle_part: Array
    center: Array
    half_extents: Array
    radius: float
    boxes: tuple[tuple[Any, Array], ...] = ()

    def __post_init__(self) -> None:
        for array in (self.T_obstacle_part, self.center, self.half_extents):
            array.flags.writeable = False

    @property
    def members(self) -> tuple[Any, ...]:
        """The Coal objects of the part: one geometry, or those of a block's boxes."""
        return tuple(g for g, _ in self.boxes) if self.geometry is None else (self.geometry,)

    def __reduce__(self) -> tuple[Any, ...]:
        state = (self.geometry, self.T_obstacle_part, self.center, self.half_extents, self.radius, self.boxes)
        return _restored, state


def _restored(geometry: Any, *rest: Any) -> Part:
    """Rebuild a pickled part: Coal pickles a primitive without its local AABB."""
    part = Part(geometry, *rest)
    for member in part.members:
        member.computeLocalAABB()
    return part


class Solid:
    """The parts of one shape and their bounds as arrays; shared by all obstacles of that shape.

    Attributes:
        parts: The parts (p).
        translation: Part origins in the obstacle's frame (p, 3) [m].
        center: Bounding box centres (p, 3) [m].
        half_extents: Bounding box half sizes (p, 3) [m].
        radius: Bounding sphere radii (p,) [m].
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)
        self.translation = np.array([p.T_obstacle_part[:3, 3] for p in self.parts])
        self.center = np.array([p.center for p in self.parts])
        self.half_extents = np.array([p.half_extents for p in self.parts])
        self.radius = np.array([p.radius for p in self.parts])

    @cached_property
    def reach(self) -> float:
        """Radius [m] of a sphere about the obstacle's origin that holds all parts."""
        return float((np.linalg.norm(self.center, axis=1) + self.radius).max())

    def __reduce__(self) -> tuple[Any, ...]:
        return Solid, (self.parts,)


def primitive(geometry: Any, half_extents: Sequence[float], radius: float) -> Solid:
    """Solid of one Coal primitive that is centred at the obstacle's origin."""
    geometry.computeLocalAABB()
    return Solid([Part(geometry, np.eye(4), np.zeros(3), np.array(half_extents, dtype=np.float64), float(radius))])


def hull_part(vertices: Array, what: str = "vertices") -> Part:
    """Part of the convex hull of ``vertices`` (V, 3) [m]; `SceneError` if they are flat or fewer than four.

    The Coal geometry is built from Qhull's triangles: ``coal.Convex.convexHull`` crashes the process on coplanar input.
    """
    if len(vertices) < 4:
        raise SceneError(f"{what}: {len(vertices)} points given; a convex hull needs at least 4")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    center = 0.5 * (low + high)
    local = vertices - center
    thickness = flatness(local)
    if thickness < MIN_THICKNESS:
        raise SceneError(
            f"{what}: the {len(vertices)} points are flat ({thickness:.3g} m thick); a convex hull needs at least 4 "
            f"points that do not lie in one plane (thickness at least {MIN_THICKNESS:g} m)"
        )
    from scipy.spatial import ConvexHull, QhullError  # late: slow to import

    try:
        hull = ConvexHull(local)
    except QhullError as error:
        raise SceneError(f"{what}: no convex hull of {len(vertices)} points: {str(error).splitlines()[0]}") from None
    corners = local[hull.vertices]
    number = np.empty(len(local), dtype=np.int64)
    number[hull.vertices] = np.arange(len(corners))
    points = coal.StdVec_Vec3s()
    points.extend(list(corners))
    triangles = coal.StdVec_Triangle()
    triangles.extend([coal.Triangle(*abc) for abc in number[hull.simplices].tolist()])
    geometry = coal.Convex(points, triangles)
    geometry.computeLocalAABB()
    placement = np.eye(4)
    placement[:3, 3] = center
    return Part(geometry, placement, center, 0.5 * (high - low), float(np.linalg.norm(corners, axis=1).max()))


def flatness(points: Array) -> float:
    """Extent [m] of ``points`` (V, 3) along their thinnest principal direction."""
    centred = points - points.mean(axis=0)
    _, directions = np.linalg.eigh(centred.T @ centred)
    return float(np.ptp(centred @ directions[:, 0]))
