"""Convex hulls of points, by Qhull, and as Coal shapes.

``coal.Convex.convexHull`` ends the process on points that are nearly flat, so the triangles come from Qhull. And Coal
counts the neighbours of a corner in 8 bits: it refuses a hull where a corner has more than 255. Its distance queries
grow with the number of corners, and so does the memory: a hull of very many becomes a slightly larger one of few.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import coal
import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices
from elastic_strips.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

_log = logging.getLogger(__name__)

MOST_CORNERS = 3000
"""A hull of more corners is taken as a slightly larger one of fewer: :func:`few_corners`."""

MIN_THICKNESS = 1e-6
"""A convex hull thinner than this [m] counts as flat and is refused."""

_DIRECTIONS_PER_CORNER = 0.15  # in which a hull's outermost corners are looked for, per corner that it may have
_MOST_POINTS_EXACT = 4000  # points that Qhull is asked about: a flat face of n corners takes it a time of n²
_MOST_CUTS = 3  # times that corners which stick out further than that are cut off
_CORNER_SHARE = 2e-3  # of a hull's diagonal, by which corners that are cut off stick out
_PLANE_ROUNDING = 1e-11  # of a hull's size, by which planes are moved outwards, and a point is not outside

_MOST_NEIGHBOURS = 255  # of a corner of a Coal shape
_LARGE_FACE = 50  # triangles of a face
_TIP_EDGE = 1e-5  # [m]


def convex_hull(points: Array) -> ConvexHull:
    """Qhull's convex hull of points (V, 3)."""
    from scipy.spatial import ConvexHull  # late: slow to import

    return ConvexHull(points)


def flatness(points: Array) -> float:
    """Extent [m] of ``points`` (V, 3) along their thinnest principal direction."""
    centred = points - points.mean(axis=0)
    _, directions = np.linalg.eigh(centred.T @ centred)
    return float(np.ptp(centred @ directions[:, 0]))


def few_corners(points: Array, what: str, error: type[InputError], *, most: int = MOST_CORNERS) -> tuple[Array, float]:
    """Points whose hull holds points (V, 3), and how far [m] it sticks out of theirs at most.

    Where the hull of the points has at most ``most`` corners, it is that hull. Else it is cut out by some hundred
    planes that touch it: along the faces of a hull of its outermost points in directions all around, so that large flat
    faces stay as they are. What sticks out is measured against a hull inside, so that it is no less than said; it
    seldom is more than 0.2 % of the diagonal, with `MOST_CORNERS`.

    Args:
        points: (V, 3) [m].
        what: what to call them in messages.
        error: type of the error that is raised about them.
        most: corners, at least 100; with fewer more sticks out, in inverse proportion.

    Raises:
        scipy.spatial.QhullError: the points are flat.
        InputError: (of the type ``error``) as :func:`convex_shape`.
    """
    from scipy.spatial import QhullError  # late: slow to import

    if len(points) <= most:
        return points, 0.0
    middle = points.mean(axis=0)
    axes = np.linalg.svd((points - middle).T @ (points - middle))[0].T
    local = (points - middle) @ axes.T
    size = np.ptp(local, axis=0)
    if size.min() <= 0.0:
        return points, 0.0  # flat: Qhull says so
    scaled = local / size  # as thick as it is long, so that directions are spread evenly over it
    coarse = scaled[np.unique(_outermost(scaled, _sphere(int(_DIRECTIONS_PER_CORNER * most))))]
    planes = _planes(coarse)
    touching = _outermost(scaled, planes[:, :3])
    fine = np.vstack((coarse, scaled[np.unique(touching)]))
    some = max(1, len(points) // _MOST_POINTS_EXACT)
    if np.count_nonzero(_largest(scaled[::some], planes) > _PLANE_ROUNDING) * some <= 2 * _MOST_POINTS_EXACT:
        outside = _largest(scaled, planes) > _PLANE_ROUNDING
        few = np.vstack((fine, scaled[outside])) if np.count_nonzero(outside) <= _MOST_POINTS_EXACT else scaled
    else:
        few = scaled
    if len(few) < len(scaled):
        few = few[convex_hull(few).vertices]
        if len(few) <= most:
            return (few * size) @ axes + middle, 0.0
    normals = planes[:, :3] / size
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    inside = convex_shape(fine * size, what, error)[0]
    allowed = _CORNER_SHARE * MOST_CORNERS / most * float(np.linalg.norm(size))
    for k in range(_MOST_CUTS + 1):
        reach = np.sum(normals * local[touching], axis=1) + _PLANE_ROUNDING * np.abs(local).max()
        try:
            corners = _cut_out(normals, reach, coarse.mean(axis=0) * size)
        except QhullError:  # not seen either
            return points, 0.0
        away = _ways_to(inside, corners)
        sticks_out = np.linalg.norm(away, axis=1)
        far = sticks_out > allowed
        if k == _MOST_CUTS or not far.any() or len(corners) + 2 * np.count_nonzero(far) > most:
            break
        normals = np.vstack((normals, away[far] / sticks_out[far][:, None]))
        touching = np.concatenate((touching, _outermost(local, normals[len(touching) :])))
    sides = _planes(corners)
    out = np.sum(sides[:, :3] * local[_outermost(local, sides[:, :3])], axis=1) + sides[:, 3]
    if len(corners) > most or out.max() > 0.0:
        return points, 0.0  # not seen: then it is the hull itself
    return corners @ axes + middle, float(sticks_out.max()) + _TIP_EDGE


def _planes(points: Array) -> Array:
    """Planes (K, 4), each once, of the hull of points: unit normal, offset."""
    return np.unique(convex_hull(points).equations, axis=0)  # triangles of one flat face share its plane exactly


def _outermost(points: Array, directions: Array) -> Indices:
    """The number (K,) of the point that is outermost in each direction (K, 3).

    Points are looked at by cubes of space, and only those whose box reaches as far as what has been found.
    """
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    count = int(np.clip(np.sqrt(len(points) / 1000.0), 1, 20))
    cube = np.minimum((points - low) * (count / np.where(size > 0.0, size, 1.0)), count - 1).astype(np.intp)
    cube = (cube[:, 0] * count + cube[:, 1]) * count + cube[:, 2]
    order = np.argsort(cube, kind="stable")
    sorted_points, cube = points[order], cube[order]
    starts = np.flatnonzero(np.concatenate(([True], cube[1:] != cube[:-1])))
    ends = np.append(starts[1:], len(cube))
    low, high = np.minimum.reduceat(sorted_points, starts), np.maximum.reduceat(sorted_points, starts)
    reach = directions @ (0.5 * (low + high)).T + np.abs(directions) @ (0.5 * (high - low)).T  # (K, cubes)
    reach += 1e-12 * np.abs(reach).max()
    best, found = np.full(len(directions), -np.inf), np.zeros(len(directions), dtype=np.intp)
    first = reach.argmax(axis=1)  # the likeliest cube, then those that may have more
    wanted = np.zeros(reach.shape, dtype=bool)
    wanted[np.arange(len(directions)), first] = True
    for _ in range(2):
        for k in np.flatnonzero(wanted.any(axis=0)):
            asking = np.flatnonzero(wanted[:, k])
            along = directions[asking] @ sorted_points[starts[k] : ends[k]].T
            at = along.argmax(axis=1)
            value = along[np.arange(len(asking)), at]
            better = value > best[asking]
            best[asking[better]], found[asking[better]] = value[better], order[starts[k] + at[better]]
        wanted = ~wanted & (reach > best[:, None])
    return found


def _largest(points: Array, planes: Array) -> Array:
    """How far (V,) [m] each point lies outside the farthest of planes (K, 4); negative inside of all."""
    blocks = np.array_split(points, 1 + len(points) * len(planes) // 1_000_000)  # each stays in the processor's cache
    return np.concatenate([(block @ planes[:, :3].T + planes[:, 3]).max(axis=1) for block in blocks])


def _sphere(count: int) -> Array:
    """Directions (count + 6, 3) all around, evenly, and those of the axes."""
    z = (2.0 * np.arange(count) + 1.0) / count - 1.0
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    flat = np.sqrt(1.0 - z * z)
    return np.vstack((np.column_stack((flat * np.cos(turn), flat * np.sin(turn), z)), np.eye(3), -np.eye(3)))


def _cut_out(normals: Array, reach: Array, within: Array) -> Array:
    """Corners (C, 3) of what planes of unit ``normals`` (K, 3), so far out, leave about a point."""
    from scipy.spatial import HalfspaceIntersection  # late: slow to import

    corners = HalfspaceIntersection(np.column_stack((normals, -reach)), within).intersections
    corners = corners[np.isfinite(corners).all(axis=1)]
    _, first = np.unique((corners / np.abs(corners).max()).round(9), axis=0, return_index=True)
    return corners[first]


def _ways_to(body: coal.Convex, points: Array) -> Array:
    """The shortest ways (K, 3) [m] from a convex body to points outside it."""
    dot, still, point = coal.Sphere(0.0), coal.Transform3s.Identity(), coal.Transform3s()
    request, result = coal.DistanceRequest(True), coal.DistanceResult()
    ways = []
    for at in points:
        point.setTranslation(at)
        result.clear()
        coal.distance(body, still, dot, point, request, result)
        ways.append(at - result.getNearestPoint1())
    return np.array(ways)


def convex_shape(points: Array, what: str, error: type[InputError]) -> tuple[coal.Convex, Array]:
    """Convex hull of points as a Coal shape in which no corner has more than 255 neighbours.

    Args:
        points: (V, 3) [m].
        what: what to call them in messages.
        error: type of the error that is raised about them.

    Returns:
        The shape, its local AABB computed, and its corners (C, 3). It is the hull itself; or what :func:`few_corners`
        makes of one with very many corners; or, where a corner has too many neighbours that lie on no flat face, larger
        by up to 1e-5 m about that corner.

    Raises:
        scipy.spatial.QhullError: the points are flat.
        InputError: (of the type ``error``) a corner still has too many neighbours.
    """
    few, sticks_out = few_corners(points, what, error)
    if sticks_out > 0.0:
        _log.info(
            "%s: a convex hull of more than %d corners is taken as one of %d that sticks out by up to %.2g mm",
            what,
            MOST_CORNERS,
            len(few),
            1e3 * sticks_out,
        )
    return _plain_shape(*_hull_triangles(few, what, error))


def _plain_shape(corners: Array, triangles: Indices) -> tuple[coal.Convex, Array]:
    """A Coal shape of corners (C, 3) and triangles (T, 3) that are convex, its local AABB computed, and the corners."""
    vertices, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    vertices.extend(list(corners))
    faces.extend([coal.Triangle(*abc) for abc in triangles.tolist()])
    shape = coal.Convex(vertices, faces)
    shape.computeLocalAABB()
    return shape, corners


def _hull_triangles(points: Array, what: str, error: type[InputError]) -> tuple[Array, Indices]:
    """Corners (V, 3) and triangles (T, 3) of a convex hull in which no corner has more neighbours than Coal takes.

    Where one has, as in a wheel's flat side that is cut into a fan, large flat faces are cut into strips: the same
    hull. An apex that still has too many becomes the corners of a tiny polygon about it: the hull grows by `_TIP_EDGE`.
    """
    hull = convex_hull(points)
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
            grown.append(corners[worst] + _TIP_EDGE * np.column_stack((np.cos(angles), np.sin(angles))) @ across)
        points = np.vstack(grown)
        hull = convex_hull(points)
    raise error(f"{what}: a corner of a convex hull has {count.max()} neighbours; Coal takes {_MOST_NEIGHBOURS}")


def _numbered(
    points: Array, used: npt.NDArray[np.integer], triangles: npt.NDArray[np.integer]
) -> tuple[Array, Indices]:
    """The used points alone, and triangles of their new numbers."""
    number = np.full(len(points), -1, dtype=np.intp)
    number[used] = np.arange(len(used))
    return points[used], number[triangles]


def _neighbours(triangles: Indices, count: int) -> Indices:
    """Number of neighbours (V,) of each corner: in a closed surface, that of its triangles."""
    return np.bincount(triangles.ravel(), minlength=count)


def _strips(points: Array, hull: ConvexHull) -> Indices:
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
