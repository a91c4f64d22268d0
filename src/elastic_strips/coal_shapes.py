"""Coal's shapes: the only module that knows their kinds, and what follows from a kind.

``BVHModel`` of Coal is hollow, so no mesh may reach the distance queries as such; :func:`convex_from_vertices` makes
the convex hull that contains it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from functools import cache
from math import hypot

import coal
import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import RobotError
from elastic_strips.hulls import MIN_THICKNESS, convex_hull, convex_shape

_CIRCLE = np.column_stack(
    (np.cos(np.linspace(0, 2 * np.pi, 16, endpoint=False)), np.sin(np.linspace(0, 2 * np.pi, 16, endpoint=False)))
)
_FARTHEST_VERTEX = 1e3  # [m] from the origin
_CIRCUMSCRIBED_RATIO = 1.0 / np.cos(np.pi / 16)  # of a 16-gon about a circle, to that circle
SIGNS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
"""(8, 3) signs of the corners of a box."""


class ShapeKind(str, Enum):
    """Kinds of shapes that the library tells apart."""

    BOX = "box"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    CAPSULE = "capsule"
    CONE = "cone"
    ELLIPSOID = "ellipsoid"
    CONVEX = "convex"
    MESH = "mesh"
    OTHER = "other"


_KINDS = (
    (coal.Box, ShapeKind.BOX),
    (coal.Sphere, ShapeKind.SPHERE),
    (coal.Cylinder, ShapeKind.CYLINDER),
    (coal.Capsule, ShapeKind.CAPSULE),
    (coal.Cone, ShapeKind.CONE),
    (coal.Ellipsoid, ShapeKind.ELLIPSOID),
    (coal.ConvexBase, ShapeKind.CONVEX),
    (coal.BVHModelBase, ShapeKind.MESH),
)
LONG_ROUND = (ShapeKind.CYLINDER, ShapeKind.CAPSULE, ShapeKind.CONE)
"""Kinds of shapes that are round about their z axis and have a length."""


@cache
def _kind_of(form: type) -> ShapeKind:
    return next((kind for base, kind in _KINDS if issubclass(form, base)), ShapeKind.OTHER)


def shape_of(geometry: coal.CollisionGeometry | None) -> tuple[ShapeKind, tuple[float, ...]]:
    """Kind and half sizes [m] of a shape.

    The sizes are (x, y, z) of a box or an ellipsoid, (radius,) of a sphere, (radius, half length) of a cylinder,
    capsule or cone; other kinds have none. The kind of None, a block of boxes, is ``OTHER``.
    """
    if geometry is None:
        return ShapeKind.OTHER, ()
    kind = _kind_of(type(geometry))
    if kind is ShapeKind.BOX:
        return kind, tuple(np.asarray(geometry.halfSide).tolist())
    if kind is ShapeKind.SPHERE:
        return kind, (float(geometry.radius),)
    if kind in LONG_ROUND:
        return kind, (float(geometry.radius), float(geometry.halfLength))
    if kind is ShapeKind.ELLIPSOID:
        return kind, tuple(np.asarray(geometry.radii).tolist())
    return kind, ()


def vertices(geometry: coal.CollisionGeometry) -> Array:
    """Corners (V, 3) [m] of a convex shape or a mesh."""
    points = geometry.vertices() if isinstance(geometry, coal.BVHModelBase) else geometry.points()
    return np.array(points, dtype=float).reshape(-1, 3)


def faces(geometry: coal.CollisionGeometry) -> npt.NDArray[np.int64]:
    """Triangles (T, 3) of a mesh: numbers of its corners."""
    triangles = [geometry.tri_indices(i) for i in range(geometry.num_tris)]
    return np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.int64).reshape(-1, 3)


def sphere_as_capsule(geometry: coal.CollisionGeometry) -> coal.CollisionGeometry:
    """A sphere as a capsule of no length, which keeps out of Coal's closed forms for spheres; others as they are."""
    return coal.Capsule(geometry.radius, 0.0) if isinstance(geometry, coal.Sphere) else geometry


def for_penetration(
    one: coal.CollisionGeometry, two: coal.CollisionGeometry
) -> tuple[coal.CollisionGeometry, coal.CollisionGeometry]:
    """Two shapes in the form in which Coal finds their depth of penetration.

    Its closed form for a sphere and a cylinder forgets the cylinder's caps once the sphere's centre is inside.
    """
    if {type(one), type(two)} == {coal.Sphere, coal.Cylinder}:
        return sphere_as_capsule(one), sphere_as_capsule(two)
    return one, two


def box_about(ellipsoid: coal.Ellipsoid) -> coal.Box:
    """The box that holds an ellipsoid, with its swept-sphere radius."""
    box = coal.Box(*(2 * np.asarray(ellipsoid.radii)))
    box.setSweptSphereRadius(ellipsoid.getSweptSphereRadius())
    return box


def support(geometry: coal.CollisionGeometry, directions: Array) -> Array:
    """Support (K,) [m] of a convex shape: how far it extends along each of ``directions`` (K, 3), in its frame."""
    return supports((geometry,), directions[None])[0]


def supports(geometries: Sequence[coal.CollisionGeometry], directions: Array) -> Array:
    """Supports (N, K) [m] of N convex shapes: how far each extends along ``directions`` (N, K, 3) in its own frame."""
    result = np.empty(directions.shape[:2])
    alike: dict[ShapeKind, tuple[list[int], list[tuple[float, ...]]]] = {}
    for k, geometry in enumerate(geometries):
        kind, size = shape_of(geometry)
        if size:
            which, sizes = alike.setdefault(kind, ([], []))
            which.append(k)
            sizes.append(size)
        else:
            result[k] = (directions[k] @ vertices(geometry).T).max(axis=1)
    for kind, (which, sizes) in alike.items():
        result[which] = _support(kind, np.array(sizes).T[..., None], directions[which])
    return result


def _support(kind: ShapeKind, size: Array, directions: Array) -> Array:
    """The same (N, K) of shapes of one kind with sizes (S, N, 1), which :func:`shape_of` gives."""
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    if kind is ShapeKind.BOX:
        return size[0] * np.abs(x) + size[1] * np.abs(y) + size[2] * np.abs(z)
    if kind is ShapeKind.SPHERE:
        return np.broadcast_to(size[0], x.shape)
    if kind is ShapeKind.ELLIPSOID:
        return np.sqrt(np.square(size[0] * x) + np.square(size[1] * y) + np.square(size[2] * z))
    if kind is ShapeKind.CAPSULE:
        return size[0] + size[1] * np.abs(z)
    flat = size[0] * np.hypot(x, y)
    if kind is ShapeKind.CYLINDER:
        return flat + size[1] * np.abs(z)
    return np.maximum(flat - size[1] * z, size[1] * z)  # a cone, its tip above


def supporter(geometry: coal.CollisionGeometry) -> Callable[[float, float, float], float]:
    """How far a convex shape extends [m] along a unit vector (x, y, z) of its frame: quick for one vector."""
    kind, size = shape_of(geometry)
    swept = float(geometry.getSweptSphereRadius())
    if kind is ShapeKind.CONVEX:
        points = vertices(geometry)
        return lambda x, y, z: float(points.dot((x, y, z)).max()) + swept
    if kind is ShapeKind.BOX:
        a, b, c = size
        return lambda x, y, z: a * abs(x) + b * abs(y) + c * abs(z) + swept
    if kind is ShapeKind.SPHERE:
        radius = size[0] + swept
        return lambda x, y, z: radius
    if kind is ShapeKind.ELLIPSOID:
        a, b, c = size
        return lambda x, y, z: hypot(a * x, b * y, c * z) + swept
    radius, half = size
    if kind is ShapeKind.CAPSULE:
        return lambda x, y, z: half * abs(z) + radius + swept
    if kind is ShapeKind.CYLINDER:
        return lambda x, y, z: half * abs(z) + radius * hypot(x, y) + swept
    return lambda x, y, z: max(half * z, radius * hypot(x, y) - half * z) + swept  # a cone, its tip above


def support_points(geometry: coal.CollisionGeometry) -> tuple[Array, float]:
    """Points (V, 3) and a radius [m] whose sphere-swept convex hull contains the shape, in the shape's frame.

    Raises:
        RobotError: the shape has no convex description here.
    """
    points, radius = _core_points(geometry)
    if isinstance(geometry, coal.ShapeBase):
        radius += float(geometry.getSweptSphereRadius())
    return points, radius


def _core_points(geometry: coal.CollisionGeometry) -> tuple[Array, float]:
    """The same for a shape without its swept-sphere radius."""
    kind, size = shape_of(geometry)
    if kind is ShapeKind.SPHERE:
        return np.zeros((1, 3)), size[0]
    if kind is ShapeKind.CAPSULE:
        return np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), size[0]
    if kind in (ShapeKind.BOX, ShapeKind.ELLIPSOID):
        return SIGNS * np.array(size), 0.0
    if kind in (ShapeKind.CYLINDER, ShapeKind.CONE):
        ring = _CIRCLE * (size[0] * _CIRCUMSCRIBED_RATIO)
        low = np.column_stack((ring, np.full(len(ring), -size[1])))
        if kind is ShapeKind.CONE:
            return np.vstack((low, [[0, 0, size[1]]])), 0.0
        return np.vstack((low, low + np.array([0, 0, 2 * size[1]]))), 0.0
    if kind in (ShapeKind.CONVEX, ShapeKind.MESH):
        return vertices(geometry), 0.0
    raise RobotError(
        f"collision shape {type(geometry).__name__} is not supported. "
        "Valid: Box, Sphere, Cylinder, Capsule, Cone, Ellipsoid, Convex, mesh."
    )


def outside(geometry: coal.CollisionGeometry, points: Array) -> Array:
    """Lower bounds (V,) [m] of how far points (V, 3) in a convex shape's frame lie outside it; negative inside."""
    kind, size = shape_of(geometry)
    around, up = np.hypot(points[:, 0], points[:, 1]), np.abs(points[:, 2])
    if kind is ShapeKind.BOX:
        return (np.abs(points) - np.array(size)).max(axis=1)
    if kind is ShapeKind.SPHERE:
        return np.linalg.norm(points, axis=1) - size[0]
    if kind is ShapeKind.CAPSULE:
        return np.hypot(around, np.maximum(up - size[1], 0.0)) - size[0]
    if kind is ShapeKind.CYLINDER:
        return np.maximum(around - size[0], up - size[1])
    if kind is ShapeKind.CONE:
        radius, half = size
        side = (2.0 * half * around - radius * (half - points[:, 2])) / hypot(2.0 * half, radius)
        return np.maximum(side, -half - points[:, 2])
    if kind is ShapeKind.CONVEX:
        planes = convex_hull(vertices(geometry)).equations
        chunks = np.array_split(points, max(1, len(points) // 500))
        return np.concatenate([(planes[:, :3] @ p.T + planes[:, 3:]).max(axis=0) for p in chunks])
    return np.full(len(points), np.inf)


def contains(geometry: coal.CollisionGeometry, points: Array) -> bool:
    """Whether points (V, 3) in a shape's frame surely all lie inside it; False for more than 400 points."""
    sure = (ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.CONVEX)
    kind = shape_of(geometry)[0]
    if len(points) > 400 or kind not in sure:
        return False
    if kind is ShapeKind.CONVEX:  # most are beside the box about it, which is told without its planes
        corners = vertices(geometry)
        if ((points < corners.min(axis=0) - 1e-6) | (points > corners.max(axis=0) + 1e-6)).any():
            return False
    return bool(np.all(outside(geometry, points) <= 1e-9))


def convex_from_vertices(vertices: Array, *, name: str = "mesh") -> coal.Convex:
    """Convex hull of points (V, 3) [m] as a Coal shape.

    Raises:
        RobotError: a point is not finite or further than 1 km away, or the points are fewer than four or flat.
    """
    points = np.asarray(vertices, dtype=float)
    if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > _FARTHEST_VERTEX:
        raise RobotError(f"{name}: a vertex is not finite or further than {_FARTHEST_VERTEX:g} m from the origin")
    points = np.unique(points.round(12), axis=0)
    flat = RobotError(f"{name}: {len(points)} distinct vertices without volume; a convex hull needs 4, not coplanar")
    if len(points) < 4:
        raise flat
    middle = points.mean(axis=0)
    thin = np.linalg.svd(points - middle, full_matrices=False)[2][-1]
    if float(np.ptp((points - middle) @ thin)) < MIN_THICKNESS:
        raise flat
    from scipy.spatial import QhullError  # late: slow to import, and robots of primitives need none

    try:
        return convex_shape(points, name, RobotError)[0]
    except QhullError:
        raise flat from None
