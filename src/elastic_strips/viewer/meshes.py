"""Meshes: triangles with normals and colours, made from primitives, from Coal shapes and by merging."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..robot.coal_shapes import ShapeKind, faces, shape_of, vertices

Floats = NDArray[np.float32]
_CREASE = np.cos(np.radians(35.0))


@dataclass(frozen=True, slots=True)
class MeshData:
    """An indexed triangle mesh as the browser wants it.

    Attributes:
        vertices: (V, 3) positions [m].
        normals: (V, 3) unit normals; a vertex on a crease appears once for each side.
        faces: (F, 3) vertex indices.
        colors: (V, 3) linear RGB in [0, 1], or None where the material has one colour.
    """

    vertices: Floats
    normals: Floats
    faces: NDArray[np.uint32]
    colors: Floats | None = None

    def transformed(self, T: ArrayLike) -> MeshData:
        """Return the mesh seen from the parent frame; ``T`` is (4, 4) and rigid."""
        T = np.asarray(T, dtype=float)
        vertices = (self.vertices @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
        return MeshData(vertices, (self.normals @ T[:3, :3].T).astype(np.float32), self.faces, self.colors)

    def colored(self, rgb: ArrayLike) -> MeshData:
        """Return the mesh with one linear RGB colour at every vertex."""
        colors = np.tile(np.asarray(rgb, dtype=np.float32), (len(self.vertices), 1))
        return MeshData(self.vertices, self.normals, self.faces, colors)


def linear(color: int | Sequence[float]) -> tuple[float, float, float]:
    """Turn an sRGB colour, ``0xrrggbb`` or three floats in [0, 1], into the linear RGB that lighting works in."""
    rgb = ((color >> 16) / 255, (color >> 8 & 255) / 255, (color & 255) / 255) if isinstance(color, int) else color[:3]
    r, g, b = (float(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4) for c in rgb)
    return r, g, b


def shaded(vertices: ArrayLike, faces: ArrayLike, crease: float = float(_CREASE)) -> MeshData:
    """Compute normals: smooth within the crease angle, sharp across it.

    Args:
        vertices: (V, 3) positions [m].
        faces: (F, 3) indices.
        crease: Cosine of the angle between two faces above which their common edge is drawn sharp.
    """
    points, inverse = np.unique(np.round(np.asarray(vertices, dtype=float), 6), axis=0, return_inverse=True)
    triangles = inverse.reshape(-1)[np.asarray(faces, dtype=np.int64)].reshape(-1, 3)
    corner = points[triangles]  # (F, 3, 3)
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(area, axis=1)
    keep = size > 1e-14
    triangles, area, size = triangles[keep], area[keep], size[keep]
    flat = area / size[:, None]
    # Every pair of faces that meet in a vertex adds its normal to the other's corner if the two are alike.
    owner = triangles.reshape(-1)
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(len(points) + 1))
    normals = np.repeat(area, 3, axis=0)
    face_of = np.repeat(np.arange(len(triangles)), 3)
    for shift in range(1, int(min(np.diff(start).max(initial=0), 64))):
        other = np.arange(len(order)) + shift
        begin, end = start[owner[order]], start[owner[order] + 1]
        other = begin + (other - begin) % np.maximum(end - begin, 1)
        valid = shift < end - begin
        mine, theirs = face_of[order[valid]], face_of[order[other[valid]]]
        alike = np.einsum("ij,ij->i", flat[mine], flat[theirs]) > crease
        np.add.at(normals, order[valid][alike], area[theirs[alike]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    corners = np.hstack((owner[:, None], np.round(normals * 64).astype(np.int64)))
    _, first, index = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    return MeshData(
        points[owner[first]].astype(np.float32),
        normals[first].astype(np.float32),
        index.reshape(-1, 3).astype(np.uint32),
    )


def merged(meshes: Iterable[MeshData]) -> MeshData:
    """Merge meshes into one; colours are kept where every mesh has them.

    Raises:
        ValueError: There is no mesh.
    """
    parts = list(meshes)
    offsets = np.cumsum([0, *(len(m.vertices) for m in parts[:-1])])
    colors = [m.colors for m in parts if m.colors is not None]
    return MeshData(
        np.concatenate([m.vertices for m in parts]),
        np.concatenate([m.normals for m in parts]),
        np.concatenate([m.faces + np.uint32(o) for m, o in zip(parts, offsets, strict=True)]),
        np.concatenate(colors) if len(colors) == len(parts) else None,
    )


def clustered(mesh: MeshData, cell: float) -> MeshData:
    """Return a coarser mesh: vertices that share a cell of edge ``cell`` [m] become one."""
    key = np.floor(mesh.vertices / cell).astype(np.int64)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[mesh.faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    if not keep.any():
        return mesh
    return shaded(mesh.vertices[first], np.unique(faces[keep], axis=0))


@cache
def box() -> MeshData:
    """Unit cube about the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return hull(corners)


@cache
def sphere(segments: int = 24) -> MeshData:
    """Unit sphere about the origin."""
    half = segments // 2
    profile = [(np.sin(a), -np.cos(a)) for a in np.linspace(0.0, np.pi, half + 1)]
    return _revolved(profile, segments, crease=0.0)


@cache
def cylinder(segments: int = 32) -> MeshData:
    """Cylinder of radius 1 and length 1 about the origin, along z."""
    return _revolved([(0.0, -0.5), (1.0, -0.5), (1.0, 0.5), (0.0, 0.5)], segments)


@cache
def cone(segments: int = 32) -> MeshData:
    """Cone of radius 1 and length 1 along z, apex up, origin at mid-height."""
    return _revolved([(0.0, -0.5), (1.0, -0.5), (0.0, 0.5)], segments)


@cache
def rod(sides: int = 6) -> MeshData:
    """Cylinder of radius 1 without end faces, along z from 0 to 1."""
    return _revolved([(1.0, 0.0), (1.0, 1.0)], sides, crease=0.0)


@cache
def arrow() -> MeshData:
    """Arrow along z from 0 to 1; its head has radius 1."""
    return _revolved([(0.0, 0.0), (0.38, 0.0), (0.38, 0.62), (1.0, 0.62), (0.0, 1.0)], 10)


@cache
def ring(inner: float, outer: float) -> MeshData:
    """Flat ring on the floor with an arrow head that points along x."""
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.column_stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)))
    vertices = np.vstack((inner * circle, outer * circle))
    i = np.arange(48)
    faces = np.vstack((np.column_stack((i, i + 49, i + 50)), np.column_stack((i, i + 50, i + 1))))
    tip, width = outer + 0.22, 0.11
    head = np.array([[tip, 0, 0], [outer + 0.03, width, 0], [outer + 0.03, -width, 0]])
    vertices, faces = np.vstack((vertices, head)), np.vstack((faces, [[98, 99, 100]]))
    normals = np.tile(np.array([0, 0, 1], dtype=np.float32), (len(vertices), 1))
    return MeshData(vertices.astype(np.float32), normals, faces.astype(np.uint32))


def capsule(radius: float, length: float, segments: int = 24) -> MeshData:
    """Capsule along z: a cylinder of ``length`` [m] between two half spheres of ``radius`` [m]."""
    upper = [
        (radius * np.cos(a), radius * np.sin(a) + length / 2) for a in np.linspace(0.0, np.pi / 2, segments // 4 + 1)
    ]
    lower = [(r, -z) for r, z in reversed(upper)]
    return _revolved(lower + upper, segments, crease=0.5)


def hull(points: ArrayLike) -> MeshData:
    """Convex hull of (V, 3) points."""
    from scipy.spatial import ConvexHull  # late: slow to import

    points = np.asarray(points, dtype=float)
    found = ConvexHull(points)
    a, b, c = (points[found.simplices[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0
    faces = np.where(inward[:, None], found.simplices[:, ::-1], found.simplices)
    return shaded(points, faces)


def scaled(mesh: MeshData, factors: ArrayLike) -> MeshData:
    """Scale along the axes."""
    f = np.asarray(factors, dtype=np.float32)
    normals = mesh.normals / f
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return MeshData(mesh.vertices * f, normals, mesh.faces, mesh.colors)


def from_coal(geometry: coal.CollisionGeometry) -> MeshData | None:
    """Triangles of a Coal shape in its own frame, or None for a shape that has no surface to draw (a plane)."""
    kind, size = shape_of(geometry)
    if kind is ShapeKind.BOX:
        return scaled(box(), 2 * np.array(size))
    if kind is ShapeKind.SPHERE:
        return scaled(sphere(), np.full(3, size[0]))
    if kind is ShapeKind.ELLIPSOID:
        return scaled(sphere(), size)
    if kind is ShapeKind.CAPSULE:
        return capsule(size[0], 2 * size[1])
    if kind in (ShapeKind.CYLINDER, ShapeKind.CONE):
        return scaled(cylinder() if kind is ShapeKind.CYLINDER else cone(), (size[0], size[0], 2 * size[1]))
    if kind is ShapeKind.CONVEX:
        return hull(vertices(geometry))
    return shaded(vertices(geometry), faces(geometry)) if kind is ShapeKind.MESH else None


def _revolved(profile: Sequence[tuple[float, float]], segments: int, crease: float = float(_CREASE)) -> MeshData:
    """Turn a profile of (radius, z) about z."""
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    rings = [np.column_stack((r * np.cos(angle), r * np.sin(angle), np.full(segments, z))) for r, z in profile]
    i = np.arange(segments)
    j = (i + 1) % segments
    faces = []
    for k in range(len(profile) - 1):
        low, high = k * segments, (k + 1) * segments
        faces += [np.column_stack((low + i, low + j, high + j)), np.column_stack((low + i, high + j, high + i))]
    return shaded(np.vstack(rings), np.vstack(faces), crease)
