"""Scene room, decomposition: a triangle mesh becomes convex pieces that together hold its whole surface.

Distances to a triangle soup are hollow: a robot deep inside a closed mesh would look free. So meshes become solids:

1. A mesh falls apart into its connected bodies. A closed body that is convex is one piece, exactly.
2. A flat body becomes one thin plate per triangle, `PLATE` thick on either side.
3. Any other body is decomposed by V-HACD, whose pieces cut corners by a few percent of the body's size. Therefore
   each small piece of surface is given to the piece that it sticks out of least, and that piece grows to hold it: **the
   pieces together hold every point of the surface** (to rounding, `TOLERANCE`). They may stick out of the mesh by
   V-HACD's voxel or what its pieces had cut off: up to 2.5 % of a closed body's diagonal was measured (ring, torus,
   L-profile), more where a body has holes in its surface, which the pieces bridge. Inside, thin gaps between pieces may
   remain below the surface.

A mesh that is not watertight is decomposed in the same way; the inside of an open body is free where it is reached from
the outside. The result is deterministic, and is kept in memory: the same mesh is decomposed once per process.
"""

from __future__ import annotations

import hashlib
import io
import logging
import threading
from collections import OrderedDict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elastic_strips.arrays import Array
from elastic_strips.errors import SceneError, nearest_name
from elastic_strips.files import read_input
from elastic_strips.hulls import convex_hull

from .parts import MIN_THICKNESS, flatness

if TYPE_CHECKING:
    import trimesh

# trimesh is imported where it is used: it takes half a second, and only scenes with meshes need it.
_log = logging.getLogger(__name__)

TOLERANCE = 1e-7
"""A surface point lies at most this far [m] (per metre of the mesh's size) outside of the union of the pieces."""

PLATE = 1e-3
"""A flat body becomes a plate that reaches this far [m] to either side."""

_MAX_MESH_BYTES = 200_000_000
_MAX_FACES = 500_000
_MAX_FLAT_FACES = 2_000
_SUFFIXES = (".dae", ".obj", ".ply", ".stl")

_RESOLUTION = 50_000  # voxels of V-HACD
_MAX_HULLS = 32
_SPLIT = 1.0 / 32.0  # surface pieces are smaller than this share of the body's size
_KEPT = 32  # meshes in memory

_Faces = NDArray[np.int64]
_cache: OrderedDict[bytes, tuple[Array, ...]] = OrderedDict()
_lock = threading.Lock()


def convex_pieces(vertices: Array, faces: _Faces) -> tuple[Array, ...]:
    """Vertices (V_i, 3) [m] of convex pieces whose hulls together hold the surface of the mesh.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
    """
    digest = hashlib.sha256(np.int64(len(vertices)).tobytes())
    digest.update(np.ascontiguousarray(vertices, dtype=np.float64).tobytes())
    digest.update(np.ascontiguousarray(faces, dtype=np.int64).tobytes())
    key = digest.digest()
    with _lock:
        if key in _cache:
            _cache.move_to_end(key)
            return _cache[key]
    pieces = tuple(_decompose(vertices, faces))
    for piece in pieces:
        piece.flags.writeable = False
    with _lock:
        _cache[key] = pieces
        while len(_cache) > _KEPT:
            _cache.popitem(last=False)
    return pieces


def load_mesh(path: Path) -> tuple[Array, _Faces]:
    """Vertices (V, 3), in the file's unit, and faces (F, 3) of a mesh file.

    Raises:
        SceneError: missing, unreadable, empty, of another kind, without triangles, or with vertices not finite.
    """
    import trimesh

    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise SceneError(f"{path}: mesh files of kind {suffix!r} are not read{nearest_name(suffix, _SUFFIXES)}")
    data = read_input(path, "mesh file", _MAX_MESH_BYTES, SceneError)
    if not data:
        raise SceneError(f"{path}: the mesh file is empty")
    options = {"skip_materials": True} if suffix == ".obj" else {}
    try:  # from memory: so no other file is opened by what this one names
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=suffix[1:], process=False, **options)
    except Exception as error:  # trimesh raises whatever its parsers trip over
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise SceneError(f"{path}: not a readable {suffix[1:].upper()} file: {said}") from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise SceneError(f"{path}: the file holds no triangles")
    vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
    if not np.isfinite(vertices).all():
        raise SceneError(f"{path}: the file holds vertices that are not finite")
    return vertices, faces


def _decompose(vertices: Array, faces: _Faces) -> list[Array]:
    import trimesh

    if len(faces) > _MAX_FACES:
        raise SceneError(f"the mesh has {len(faces)} triangles; at most {_MAX_FACES} are accepted: simplify it first")
    mesh = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-12))
    if len(mesh.faces) == 0:
        raise SceneError(f"the mesh has no triangle with an area ({len(faces)} triangles given)")
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    pieces: list[Array] = []
    for label in range(int(labels.max()) + 1):
        body = mesh.submesh([np.flatnonzero(labels == label)], append=True, repair=False)
        assert isinstance(body, trimesh.Trimesh)
        pieces += _body(np.array(body.vertices), np.array(body.faces), body)
    return pieces


def _body(vertices: Array, faces: _Faces, body: trimesh.Trimesh) -> list[Array]:
    """Pieces of one connected body."""
    import trimesh

    if flatness(vertices) < MIN_THICKNESS:
        return _plates(vertices, faces)
    if body.is_watertight and _fills_hull(vertices, faces, abs(float(body.volume))):
        return [vertices]
    hulls = []
    for found in trimesh.decomposition.convex_decomposition(
        body, resolution=_RESOLUTION, maxConvexHulls=_MAX_HULLS, asyncACD=False
    ):
        corners = np.asarray(found["vertices"], dtype=np.float64)
        if len(corners) >= 4 and np.isfinite(corners).all() and flatness(corners) >= MIN_THICKNESS:
            hulls.append(corners)
    if not hulls:
        _log.warning("no convex decomposition of a body of %d triangles: its convex hull is used", len(faces))
        return [vertices]
    return _covering(vertices, faces, hulls)


def _fills_hull(vertices: Array, faces: _Faces, volume: float) -> bool:
    """Whether the closed body is convex: all of its faces lie on its hull, and the volume is the hull's."""
    from scipy.spatial import QhullError  # late: slow to import

    try:
        hull = convex_hull(vertices)
    except QhullError:
        return False
    if abs(volume - hull.volume) > 1e-4 * hull.volume:
        return False
    depth = -(vertices[faces].mean(axis=1) @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    return bool(depth.max() <= 1e-3 * np.ptp(vertices, axis=0).max())


def _plates(vertices: Array, faces: _Faces) -> list[Array]:
    """One thin prism per triangle of a flat body."""
    if len(faces) > _MAX_FLAT_FACES:
        raise SceneError(
            f"a flat body has {len(faces)} triangles; at most {_MAX_FLAT_FACES} are accepted: give it a thickness, "
            "or simplify it"
        )
    corners = vertices[faces]  # (F, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal *= (PLATE / np.linalg.norm(normal, axis=1))[:, None]
    return [np.vstack([abc + n, abc - n]) for abc, n in zip(corners, normal, strict=True)]


def _covering(vertices: Array, faces: _Faces, hulls: list[Array]) -> list[Array]:
    """Grow ``hulls`` until they hold the surface: each small triangle goes to the hull that it sticks out of least."""
    import trimesh

    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    split = trimesh.remesh.subdivide_to_size(vertices, faces, max_edge=_SPLIT * size, max_iter=20)
    points, triangles = np.asarray(split[0]), np.asarray(split[1])
    owner = np.zeros(len(triangles), dtype=np.int64)
    least = np.full(len(triangles), np.inf)
    for k, corners in enumerate(hulls):
        equations = convex_hull(corners).equations
        out = np.full(len(points), -np.inf)
        for rows in range(0, len(points), 50_000):
            block = slice(rows, rows + 50_000)
            out[block] = (points[block] @ equations[:, :3].T + equations[:, 3]).max(axis=1)
        excess = out[triangles].max(axis=1)
        better = excess < least
        owner[better], least[better] = k, excess[better]
    grown = []
    for k, corners in enumerate(hulls):
        mine = triangles[owner == k]
        if len(mine):  # a piece that no surface belongs to lies inside or in the corners that V-HACD made up
            corners = np.vstack([corners, points[np.unique(mine)]])
        grown.append(corners)
    _log.debug("%d pieces; the surface stuck out of V-HACD's pieces by up to %.3g m", len(grown), max(0.0, least.max()))
    return grown
