"""Convex hulls of points, by Qhull, and as Coal shapes.

``coal.Convex.convexHull`` ends the process on points that are nearly flat, so the triangles come from Qhull. And Coal
counts the neighbours of a corner in 8 bits: it refuses a hull where a corner has more than 255.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import coal
import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices
from elastic_strips.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

_MOST_NEIGHBOURS = 255  # of a corner of a Coal shape
_LARGE_FACE = 50  # triangles
_TIP = 1e-5  # [m]


def convex_hull(points: Array) -> ConvexHull:
    """Qhull's convex hull of points (V, 3)."""
    from scipy.spatial import ConvexHull  # late: slow to import

    return ConvexHull(points)


def convex_shape(points: Array, what: str, error: type[InputError]) -> tuple[coal.Convex, Array]:
    """Convex hull of points as a Coal shape in which no corner has more than 255 neighbours.

    Args:
        points: (V, 3) [m].
        what: what to call them in messages.
        error: type of the error that is raised about them.

    Returns:
        The shape, its local AABB computed, and its corners (C, 3). It is the hull itself, or, where a corner has too
        many neighbours that lie on no flat face, larger than it by up to 1e-5 m about that corner.

    Raises:
        scipy.spatial.QhullError: the points are flat.
        InputError: (of the type ``error``) a corner still has too many neighbours.
    """
    corners, triangles = _hull_triangles(points, what, error)
    vertices, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    vertices.extend(list(corners))
    faces.extend([coal.Triangle(*abc) for abc in triangles.tolist()])
    shape = coal.Convex(vertices, faces)
    shape.computeLocalAABB()
    return shape, corners


def _hull_triangles(points: Array, what: str, error: type[InputError]) -> tuple[Array, Indices]:
    """Corners (V, 3) and triangles (T, 3) of a convex hull in which no corner has more neighbours than Coal takes.

    Where one has, as in a wheel's flat side that is cut into a fan, large flat faces are cut into strips: the same
    hull. An apex that still has too many becomes the corners of a tiny polygon about it: the hull grows by ``_TIP``.
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
            grown.append(corners[worst] + _TIP * np.column_stack((np.cos(angles), np.sin(angles))) @ across)
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
