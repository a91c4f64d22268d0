"""Covering: convex pieces grow until they hold a body's surface and what it encloses.

Space is cut into cubes, and the surface along their faces. The part of a closed body in one cube is held by the convex
hull of the surface in it and of those of its corners that are inside. So the pieces hold the body where each cube's
points all lie in one of them: each cube is given to the piece that it sticks out of least, and that piece grows.

A place is inside if it is not reached from outside through cubes without surface. Of a body with holes only the surface
is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_strips.arrays import Array, Indices
from elastic_strips.hulls import convex_hull

_CUBE_SHARE = 1.0 / 32.0  # edge of a cube, as a share of the body's diagonal
_MOST_CUT_TRIANGLES = 800_000  # triangles that the surface gets by being cut; with more, cubes are larger
_FACE_TOLERANCE = 1e-9  # of a cube's edge, within which a point counts as on its face
_GRID_SHIFT = np.array([0.37, 0.41, 0.43])  # of a cube's edge: bodies have faces at round numbers
_POINTS_AT_ONCE = 50_000  # points that are measured at once

_Faces = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """The cubes that a body lies in.

    Attributes:
        points: (P, 3) [m] points of the surface, then corners of cubes.
        members: (M,) numbers of points, cube by cube.
        starts: (C,) where the members of each cube begin.
        centers: (C, 3) [m].
        radius: radius [m] of a ball about a cube.
    """

    points: Array
    members: Indices
    starts: Indices
    centers: Array
    radius: float


def grown_pieces(vertices: Array, faces: _Faces, pieces: list[Array], *, closed: bool) -> tuple[list[Array], float]:
    """Points whose hulls hold a body, and how far [m] it stuck out of the given pieces at most.

    Args:
        vertices: (V, 3) [m].
        faces: (F, 3) triangles, each with an area.
        pieces: corners (C_k, 3) [m] of the convex pieces to grow, none of them flat.
        closed: whether the surface encloses something, that is, each edge belongs to two triangles.
    """
    cells = _cells_of(vertices, faces, closed)
    planes = [convex_hull(piece).equations for piece in pieces]
    excess = np.array([_outside(cells.centers, plane) for plane in planes])
    most = excess.min(axis=0) + cells.radius  # of others a cube hardly sticks out less
    counts = np.diff(np.append(cells.starts, len(cells.members)))
    owner, least = np.zeros(len(counts), dtype=np.int64), np.full(len(counts), np.inf)
    for k, plane in enumerate(planes):
        near = np.flatnonzero(excess[k] <= most)
        if not len(near):
            continue
        which = cells.members[_ranges(cells.starts[near], counts[near])]
        out = _outside(cells.points[which], plane)
        worst = np.maximum.reduceat(out, np.concatenate(([0], np.cumsum(counts[near])[:-1])))
        better = worst < least[near]
        owner[near[better]], least[near[better]] = k, worst[better]
    grown = []
    for k, (piece, plane) in enumerate(zip(pieces, planes, strict=True)):
        mine = np.flatnonzero((owner == k) & (least > 0.0))
        which = _sorted_once(cells.members[_ranges(cells.starts[mine], counts[mine])])
        which = which[_outside(cells.points[which], plane) > 0.0]
        grown.append(np.vstack((piece, cells.points[which])))
    return grown, max(0.0, float(least.max(initial=0.0)))


def surface_cells(vertices: Array, faces: _Faces) -> list[Array]:
    """Points (K_i, 3) [m] whose hulls hold the surface, cube by cube."""
    cells = _cells_of(vertices, faces, False)
    return [cells.points[members] for members in np.split(cells.members, cells.starts[1:])]


def _cells_of(vertices: Array, faces: _Faces, closed: bool) -> _Cells:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    edge = _CUBE_SHARE * float(np.linalg.norm(high - low))
    while _pieces_of(vertices[faces], edge) > len(faces) + _MOST_CUT_TRIANGLES:
        edge *= 1.25
    scaled = (vertices - low) / edge + _GRID_SHIFT + 1.0  # a layer of empty cubes about the body
    points, triangles = _cut(scaled, faces)
    size = np.floor(points.max(axis=0)).astype(np.int64) + 2
    cell, point = _touched(points, triangles, size)
    filled = np.zeros(int(size.prod()), dtype=bool)
    filled[cell] = True
    if closed:
        cells, corners, at = _enclosed(filled.reshape(size))
        cell, point = np.concatenate((cell, cells)), np.concatenate((point, corners + len(points)))
        points = np.vstack((points, at))
    order = np.argsort(cell, kind="stable")
    cell, point = cell[order], point[order]
    starts = np.flatnonzero(np.concatenate(([True], cell[1:] != cell[:-1])))
    centers = np.column_stack(np.unravel_index(cell[starts], tuple(size))) + 0.5
    points, centers = ((each - _GRID_SHIFT - 1.0) * edge + low for each in (points, centers))
    points[: len(vertices)] = vertices  # exactly
    return _Cells(points, point, starts, centers, edge * float(np.sqrt(0.75)) * (1.0 + 1e-6))


def _pieces_of(corners: Array, edge: float) -> float:
    """About how many triangles (F, 3, 3) [m] become once they are cut by cubes."""
    sides = corners - np.roll(corners, 1, axis=1)
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    longest = np.sqrt(np.sum(sides * sides, axis=2).max(axis=1))
    return float(np.sum(1.0 + 2.0 * area / edge**2 + 2.0 * longest / edge))


def _cut(points: Array, faces: _Faces) -> tuple[Array, _Faces]:
    """The same surface, no triangle of which passes through a plane of whole coordinates."""
    done: list[_Faces] = []
    for axis in range(3):
        open_faces = np.vstack([faces, *done]) if done else faces
        done = []
        while len(open_faces):
            x = points[open_faces, axis]
            first, last = np.floor(x.min(axis=1) + _FACE_TOLERANCE), np.ceil(x.max(axis=1) - _FACE_TOLERANCE)
            through = last - first > 1.5
            done.append(open_faces[~through])
            crossing, x = open_faces[through], x[through]
            plane = np.floor(0.5 * (first + last))[through]
            above = x > plane[:, None]
            alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), above.argmin(axis=1))
            turn = (alone[:, None] + np.arange(3)) % 3
            a, b, c = np.take_along_axis(crossing, turn, axis=1).T
            xa, xb, xc = np.take_along_axis(x, turn, axis=1).T
            ends, xs = np.concatenate((np.column_stack((a, b)), np.column_stack((a, c)))), np.concatenate((xb, xc))
            share = ((np.tile(plane, 2) - np.tile(xa, 2)) / (xs - np.tile(xa, 2)))[:, None]
            new = points[ends[:, 0]] + share * (points[ends[:, 1]] - points[ends[:, 0]])
            new[:, axis] = np.tile(plane, 2)
            first, number = _distinct(np.sort(ends, axis=1) @ np.array([len(points), 1]))  # two triangles share an edge
            p, q = np.split(len(points) + number, 2)
            points = np.vstack((points, new[first]))
            open_faces = np.vstack([np.column_stack(abc) for abc in ((a, p, q), (p, b, c), (p, c, q))])
        faces = np.zeros((0, 3), dtype=np.int64)
    return points, np.vstack(done)


def _touched(points: Array, triangles: _Faces, size: Indices) -> tuple[Indices, Indices]:
    """Numbers of cubes, and of points of triangles that touch them: each pair once."""
    strides = np.array([size[1] * size[2], size[2], 1])
    pairs = []
    for begin in range(0, len(triangles), 4 * _POINTS_AT_ONCE):
        some = triangles[begin : begin + 4 * _POINTS_AT_ONCE]
        corners = points[some]
        low = np.floor(corners.min(axis=1) - _FACE_TOLERANCE).astype(np.int64)
        high = np.floor(corners.max(axis=1) + _FACE_TOLERANCE).astype(np.int64)
        keys = []
        for step in np.ndindex(2, 2, 2):
            cube = low + step
            here = (cube <= high).all(axis=1)
            keys.append(((cube[here] @ strides)[:, None] * len(points) + some[here]).ravel())
        pairs.append(_sorted_once(np.concatenate(keys)))
    cell, point = np.divmod(_sorted_once(np.concatenate(pairs)), len(points))
    return cell.astype(np.intp), point.astype(np.intp)


def _sorted_once(keys: Indices) -> Indices:
    """Sorted, each once; quicker than NumPy's own for many."""
    keys = np.sort(keys)
    return keys[np.concatenate(([True], keys[1:] != keys[:-1]))[: len(keys)]]


def _distinct(keys: Indices) -> tuple[Indices, Indices]:
    """Where each different key comes first, and which of them each is."""
    order = np.argsort(keys, kind="stable")
    fresh = np.concatenate(([True], keys[order][1:] != keys[order][:-1]))[: len(keys)]
    number = np.empty(len(keys), dtype=np.intp)
    number[order] = np.cumsum(fresh) - 1
    return order[fresh], number


def _enclosed(filled: NDArray[np.bool_]) -> tuple[Indices, Indices, Array]:
    """Cubes, and corners that belong to what the body has in them; then all such corners (K, 3).

    Of a cube without surface that is not reached from outside they are all eight, of one with surface those that no
    cube outside has.
    """
    from scipy import ndimage  # late: slow to import

    label = np.zeros(filled.shape, dtype=np.int32)
    ndimage.label(~filled, structure=np.ones((3, 3, 3)), output=label)
    outside = label == label[0, 0, 0]
    free = np.zeros([n + 1 for n in filled.shape], dtype=bool)
    nx, ny, nz = filled.shape
    corner_views = [
        (slice(i, i + nx), slice(j, j + ny), slice(k, k + nz)) for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    for view in corner_views:
        free[view] |= outside
    number = np.cumsum(~free).reshape(free.shape) - 1
    cells, corners = [], []
    for view in corner_views:
        wanted = ~free[view] & ~outside
        cells.append(np.flatnonzero(wanted))
        corners.append(number[view][wanted])
    return np.concatenate(cells), np.concatenate(corners), np.argwhere(~free).astype(np.float64)


def _outside(points: Array, planes: Array) -> Array:
    """How far [m] points lie outside planes (K, 4); negative inside of all."""
    out = np.empty(len(points))
    for begin in range(0, len(points), _POINTS_AT_ONCE):
        rows = slice(begin, begin + _POINTS_AT_ONCE)
        out[rows] = (points[rows] @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return out


def _ranges(starts: Indices, counts: Indices) -> Indices:
    """The numbers of ranges that begin at ``starts`` and are ``counts`` long, one after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - (ends - counts), counts)
