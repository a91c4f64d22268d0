"""Collision geometry of a robot: meshes become convex hulls that contain them, every shape gets a bounding capsule.

``BVHModel`` of Coal is hollow, so no mesh may reach the distance queries as such. What is contained in another shape of
the same body is dropped and hulls that hardly grow by being joined are joined: both keep containment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array

from ..errors import RobotError

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

_CIRCLE = np.column_stack(
    (np.cos(np.linspace(0, 2 * np.pi, 16, endpoint=False)), np.sin(np.linspace(0, 2 * np.pi, 16, endpoint=False)))
)
_FARTHEST = 1e3  # [m]
_THINNEST = 1e-6  # [m]
_FREE_GROWTH = 1e-4  # volume [m³] that a joint hull may always grow by
_MOST_NEIGHBOURS = 255  # of a corner of a Coal shape
_LARGE_FACE = 50  # triangles
_TIP = 1e-5  # [m]
_CIRCUMSCRIBED = 1.0 / np.cos(np.pi / 16)


@dataclass(frozen=True, slots=True)
class Capsule:
    """A sphere-swept segment [a, b] of radius r [m] that contains a shape; points in some frame."""

    a: Array
    b: Array
    r: float


@dataclass(frozen=True, slots=True)
class LinkGeometry:
    """One convex piece of the robot.

    Attributes:
        name: the collision object's name in the URDF (joined names for a joined hull).
        links: names of the URDF links that it covers.
        joint: index of the Pinocchio joint that carries it; 0 is the world.
        geometry: Coal shape.
        placement: (4, 4) pose of the shape in the joint's frame.
        capsule: a capsule that contains it, in the joint's frame.
    """

    name: str
    links: tuple[str, ...]
    joint: int
    geometry: coal.CollisionGeometry
    placement: Array
    capsule: Capsule


def _hull(points: Array) -> ConvexHull:
    from scipy.spatial import ConvexHull  # late: slow to import, and robots of primitives need none

    return ConvexHull(points)


def convex_from_vertices(vertices: Array, *, name: str = "mesh") -> coal.Convex:
    """Convex hull of points (V, 3) [m] as a Coal shape.

    The triangles come from scipy: ``coal.Convex.convexHull`` ends the process on points that are nearly flat.

    Raises:
        RobotError: a point is not finite or further than 1 km away, or the points are fewer than four or flat.
    """
    points = np.asarray(vertices, dtype=float)
    if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > _FARTHEST:
        raise RobotError(f"{name}: a vertex is not finite or further than {_FARTHEST:g} m from the origin")
    points = np.unique(points.round(12), axis=0)
    flat = RobotError(f"{name}: {len(points)} distinct vertices without volume; a convex hull needs 4, not coplanar")
    if len(points) < 4:
        raise flat
    middle = points.mean(axis=0)
    thin = np.linalg.svd(points - middle, full_matrices=False)[2][-1]
    if float(np.ptp((points - middle) @ thin)) < _THINNEST:
        raise flat
    from scipy.spatial import QhullError

    try:
        corners, triangles = _hull_triangles(points)
    except QhullError:
        raise flat from None
    shape = _coal_convex(corners, triangles)
    shape.computeLocalAABB()
    return shape


def _coal_convex(corners: Array, triangles: npt.NDArray[np.intp]) -> coal.Convex:
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(corners))
    faces.extend([coal.Triangle(*abc) for abc in triangles.tolist()])
    return coal.Convex(points, faces)


def _hull_triangles(points: Array) -> tuple[Array, npt.NDArray[np.intp]]:
    """Corners (V, 3) and triangles (T, 3) of a convex hull in which no corner has more neighbours than Coal takes.

    Where one has, as in a wheel's flat side that is cut into a fan, large flat faces are cut into strips: the same
    hull. An apex that still has too many becomes the corners of a tiny polygon about it: the hull grows by ``_TIP``.
    """
    hull = _hull(points)
    corners, triangles = _numbered(points, hull.vertices, hull.simplices)
    if _neighbours(triangles, len(corners)).max() <= _MOST_NEIGHBOURS:
        return corners, triangles
    for _ in range(4):
        corners, triangles = _numbered(points, hull.vertices, _strips(points, hull))
        count = _neighbours(triangles, len(corners))
        if count.max() <= _MOST_NEIGHBOURS:
            return corners, triangles
        grown = [corners[count <= _MOST_NEIGHBOURS]]
        for worst in np.flatnonzero(count > _MOST_NEIGHBOURS):
            sides = corners[triangles[(triangles == worst).any(axis=1)]]
            normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
            outward = np.sum(
                normals * np.sign(np.sum(normals * (sides[:, 0] - corners.mean(axis=0)), axis=1))[:, None], 0
            )
            across = np.linalg.svd(outward[None] / np.linalg.norm(outward))[2][1:]
            angles = np.linspace(0.0, 2.0 * np.pi, 3 + count[worst] // 100, endpoint=False)
            grown.append(corners[worst] + _TIP * np.column_stack((np.cos(angles), np.sin(angles))) @ across)
        points = np.vstack(grown)
        hull = _hull(points)
    raise RobotError(f"a corner of a convex hull has {count.max()} neighbours; Coal takes {_MOST_NEIGHBOURS}")


def _numbered(
    points: Array, used: npt.NDArray[np.integer], triangles: npt.NDArray[np.integer]
) -> tuple[Array, npt.NDArray[np.intp]]:
    """The used points alone, and triangles of their new numbers."""
    number = np.full(len(points), -1, dtype=np.intp)
    number[used] = np.arange(len(used))
    return points[used], number[triangles]


def _neighbours(triangles: npt.NDArray[np.intp], count: int) -> npt.NDArray[np.intp]:
    """Number of neighbours (V,) of each corner: in a closed surface, that of its triangles."""
    return np.bincount(triangles.ravel(), minlength=count)


def _strips(points: Array, hull: ConvexHull) -> npt.NDArray[np.intp]:
    """The hull's triangles (T, 3), those of each large flat face as one zigzag strip."""
    _, face, size = np.unique(hull.equations, axis=0, return_inverse=True, return_counts=True)
    face = face.ravel()  # triangles of one flat face share its plane exactly
    triangles = list(hull.simplices[size[face] < _LARGE_FACE])
    for large in np.flatnonzero(size >= _LARGE_FACE):
        around = np.unique(hull.simplices[face == large])
        local = points[around] - points[around].mean(axis=0)
        normal = hull.equations[int(np.argmax(face == large)), :3]
        first = local[0] / np.linalg.norm(local[0])
        around = around[np.argsort(np.arctan2(local @ np.cross(normal, first), local @ first))]
        low, high = 0, len(around) - 1
        while high - low >= 2:
            triangles.append(around[[low, low + 1, high]])
            low += 1
            if high - low >= 2:
                triangles.append(around[[low, high - 1, high]])
                high -= 1
    return np.array(triangles, dtype=np.intp)


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
    if isinstance(geometry, coal.Sphere):
        return np.zeros((1, 3)), float(geometry.radius)
    if isinstance(geometry, coal.Capsule):
        h = geometry.halfLength
        return np.array([[0, 0, -h], [0, 0, h]]), float(geometry.radius)
    if isinstance(geometry, coal.Box):
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return signs * np.asarray(geometry.halfSide), 0.0
    if isinstance(geometry, (coal.Cylinder, coal.Cone)):
        ring = _CIRCLE * (float(geometry.radius) * _CIRCUMSCRIBED)
        h = geometry.halfLength
        low = np.column_stack((ring, np.full(len(ring), -h)))
        if isinstance(geometry, coal.Cone):
            return np.vstack((low, [[0, 0, h]])), 0.0
        return np.vstack((low, low + np.array([0, 0, 2 * h]))), 0.0
    if isinstance(geometry, coal.Ellipsoid):
        return _core_points(coal.Box(*(2 * np.asarray(geometry.radii))))
    if isinstance(geometry, coal.ConvexBase):
        return np.asarray(geometry.points()).reshape(-1, 3).copy(), 0.0
    if isinstance(geometry, coal.BVHModelBase):
        return np.asarray(geometry.vertices()).reshape(-1, 3).copy(), 0.0
    raise RobotError(
        f"collision shape {type(geometry).__name__} is not supported. "
        "Valid: Box, Sphere, Cylinder, Capsule, Cone, Ellipsoid, Convex, mesh."
    )


def bounding_capsule(points: Array, radius: float = 0.0) -> Capsule:
    """A small capsule that contains the spheres of ``radius`` [m] about ``points`` (V, 3)."""
    if len(points) == 1:
        return Capsule(points[0].copy(), points[0].copy(), radius)
    center = points.mean(axis=0)
    axes = np.vstack((np.linalg.svd(points - center, full_matrices=False)[2], np.eye(3)))
    best: tuple[float, Capsule] | None = None
    for axis in axes:
        along = points @ axis
        flat = points - along[:, None] * axis
        middle = 0.5 * (flat.max(axis=0) + flat.min(axis=0))
        middle -= (middle @ axis) * axis
        rho = np.linalg.norm(flat - middle, axis=1)
        r = float(rho.max())
        reach = np.sqrt(np.maximum(r * r - rho * rho, 0.0))
        low, high = float((along + reach).min()), float((along - reach).max())
        if low > high:
            low = high = 0.5 * (low + high)
            r = float(np.sqrt(rho**2 + (along - low) ** 2).max())
        volume = np.pi * r * r * (high - low) + 4.0 / 3.0 * np.pi * r**3
        if best is None or volume < best[0]:
            best = (volume, Capsule(middle + low * axis, middle + high * axis, r + radius + 1e-9))
    assert best is not None
    return best[1]


def _inside(points: Array, radius: float, shape: coal.CollisionGeometry) -> bool:
    """Whether the spheres about ``points`` (in the shape's frame) all lie inside a convex shape."""
    if radius > 0 or len(points) > 400:
        return False
    if isinstance(shape, coal.Box):
        return bool(np.all(np.abs(points) <= np.asarray(shape.halfSide) + 1e-9))
    if isinstance(shape, coal.Sphere):
        return bool(np.all(np.linalg.norm(points, axis=1) <= shape.radius + 1e-9))
    if isinstance(shape, coal.Cylinder):
        return bool(
            np.all(np.linalg.norm(points[:, :2], axis=1) <= shape.radius + 1e-9)
            and np.all(np.abs(points[:, 2]) <= shape.halfLength + 1e-9)
        )
    if isinstance(shape, coal.ConvexBase):
        hull = _hull(np.asarray(shape.points()).reshape(-1, 3))
        return bool(np.all(hull.equations[:, :3] @ points.T + hull.equations[:, 3:] <= 1e-9))
    return False


def _transformed(points: Array, T: Array) -> Array:
    return points @ T[:3, :3].T + T[:3, 3]


def _piece(name: str, links: tuple[str, ...], joint: int, shape: coal.CollisionGeometry, T: Array) -> LinkGeometry:
    points, radius = support_points(shape)
    return LinkGeometry(name, links, joint, shape, T, bounding_capsule(_transformed(points, T), radius))


def _hull_volume(points: Array) -> float:
    return float(_hull(points).volume)


def link_geometries(model: pin.Model, collision: pin.GeometryModel, *, join_ratio: float = 1.06) -> list[LinkGeometry]:
    """The convex pieces of a collision model: meshes as hulls, contained ones dropped, neighbours joined.

    Args:
        model: the planned model.
        collision: its collision geometry, meshes as Coal loads them.
        join_ratio: two pieces of a body are joined where the joint hull's volume is at most this many times their
            sum (or a tenth of a litre more); robots of primitives only are left as they are.

    Raises:
        RobotError: an unsupported shape, or a mesh without volume.
    """
    pieces: list[LinkGeometry] = []
    meshes = False
    for obj in collision.geometryObjects:
        shape, T = obj.geometry, np.array(obj.placement.homogeneous)
        link = model.frames[obj.parentFrame].name if obj.parentFrame < len(model.frames) else obj.name
        points, _ = support_points(shape)
        if isinstance(shape, coal.BVHModelBase):
            meshes = True
            shape = convex_from_vertices(points, name=f"{obj.name} ({obj.meshPath})")
        elif isinstance(shape, coal.Ellipsoid):
            shape = coal.Box(*(2 * np.asarray(shape.radii)))
            shape.setSweptSphereRadius(obj.geometry.getSweptSphereRadius())
        shape.computeLocalAABB()
        pieces.append(_piece(obj.name, (link,), obj.parentJoint, shape, T))
    if not meshes:
        return pieces
    return _joined(_without_contained(pieces), join_ratio)


def _without_contained(pieces: list[LinkGeometry]) -> list[LinkGeometry]:
    dropped: set[int] = set()
    links = {i: set(p.links) for i, p in enumerate(pieces)}
    for i, p in enumerate(pieces):
        points, radius = support_points(p.geometry)
        if radius > 0:  # a sphere or capsule: test the box about it
            low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
            points = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        world = _transformed(points, p.placement)
        for k, other in enumerate(pieces):
            if k == i or k in dropped or other.joint != p.joint:
                continue
            T = np.asarray(np.linalg.inv(other.placement), dtype=float)
            if _inside(_transformed(world, T), 0.0, other.geometry):
                dropped.add(i)
                links[k] |= links[i]
                break
    return [
        LinkGeometry(p.name, tuple(sorted(links[i])), p.joint, p.geometry, p.placement, p.capsule)
        for i, p in enumerate(pieces)
        if i not in dropped
    ]


def _cloud(piece: LinkGeometry) -> Array:
    """Points in the joint's frame whose hull contains the piece."""
    points, radius = support_points(piece.geometry)
    if radius > 0:
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        points = (points[:, None, :] + radius * signs[None]).reshape(-1, 3)
    return _transformed(points, piece.placement)


def _joined(pieces: list[LinkGeometry], ratio: float) -> list[LinkGeometry]:
    """Join pieces of one body, the best pair first, as long as a joint hull grows little."""
    live = dict(enumerate(pieces))
    clouds = {i: _cloud(p) for i, p in live.items()}
    volumes = {i: _hull_volume(c) for i, c in clouds.items()}
    growth: dict[tuple[int, int], float] = {}

    def consider(i: int, k: int) -> None:
        if live[i].joint == live[k].joint:
            both = volumes[i] + volumes[k]
            grown = _hull_volume(np.vstack((clouds[i], clouds[k]))) - both
            if grown <= max((ratio - 1.0) * both, _FREE_GROWTH):
                growth[i, k] = grown

    for k in live:
        for i in range(k):
            consider(i, k)
    while growth:
        i, k = min(growth, key=growth.__getitem__)
        links = tuple(sorted(set(live[i].links) | set(live[k].links)))
        name = f"{live[max((i, k), key=volumes.__getitem__)].name.split('+')[0]}+{len(links) - 1}"
        hull = convex_from_vertices(np.vstack((clouds[i], clouds[k])), name=name)
        new = max(live) + 1
        live[new] = _piece(name, links, live[i].joint, hull, np.eye(4))
        clouds[new] = _cloud(live[new])
        volumes[new] = _hull_volume(clouds[new])
        del live[i], live[k]
        growth = {pair: g for pair, g in growth.items() if not {i, k} & set(pair)}
        for other in [n for n in live if n != new]:
            consider(other, new)
    return list(live.values())
