"""Decomposition: a triangle mesh becomes convex pieces that together hold its surface and its inside.

Distances to a triangle soup are hollow: a robot deep inside a closed mesh would look free. So meshes become solids:

1. A mesh falls apart into its connected bodies. A closed body that is convex, but for dents of 0.1 % of its size, is
   one piece: its convex hull, or, of more than 3,000 corners, a slightly larger one
   (:func:`elastic_strips.hulls.few_corners`).
2. A flat body becomes thin plates, `PLATE_REACH` thick on either side: one where it is convex, else one per triangle,
   or per cube of space where there are many.
3. A small or thin body, of less than `SMALL_BODY` of the mesh's diagonal across, becomes its convex hull.
4. Any other body is decomposed by V-HACD, whose pieces cut corners by a few percent of the body's size. Therefore they
   grow (:mod:`elastic_strips.covering`) until **together they hold every point of the surface, and of a closed
   body every point inside** (to rounding, `SURFACE_TOLERANCE`). They may stick out of the mesh by V-HACD's voxel or
   what its pieces had cut off: up to 3 % of a closed body's diagonal was measured (ring, torus, L-profile), more
   where a body has holes in its surface, which the pieces bridge.
5. Of more than `MANY_BODIES` bodies those near each other are taken together, as their common hull; the log says how
   large these are.

A mesh that is not watertight is decomposed in the same way; the inside of an open body is free where it is reached from
the outside. Triangles without an area are bars, unless they lie along an edge of another one. The result is
deterministic, and is kept in memory: the same mesh is decomposed once per process.
"""

from __future__ import annotations

import hashlib
import io
import logging
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elastic_strips.arrays import Array
from elastic_strips.covering import grown_pieces, surface_cells
from elastic_strips.errors import SceneError, nearest_name
from elastic_strips.files import read_input
from elastic_strips.hulls import MIN_THICKNESS, convex_hull, few_corners, flatness
from elastic_strips.progress import LoggedProgress

# trimesh is imported where it is used: it takes half a second, and only scenes with meshes need it.
_log = logging.getLogger(__name__)

SURFACE_TOLERANCE = 1e-7
"""A surface point lies at most this far [m] (per metre of the mesh's size) outside the union of the pieces."""

PLATE_REACH = 1e-3
"""A flat body becomes a plate that reaches this far [m] to either side."""

SMALL_BODY = 0.02
"""A body that is at most this share of the mesh's diagonal across its longest direction becomes its convex hull, which
sticks out of it by no more: it has points all along that direction."""

MANY_BODIES = 1_000
"""Of more bodies those near each other are taken together."""

_MAX_MESH_BYTES = 200_000_000
_MAX_FACES = 500_000
_MAX_PLATES = 200  # of a flat body, one per triangle
_SUFFIXES = (".dae", ".obj", ".ply", ".stl")

_VOXELS_OF_FEW, _VOXELS_OF_MORE = 50_000, 10_000  # voxels of V-HACD, of few bodies and of more
_FEW_BODIES, _SOME_BODIES = 3, 12
_VHACD_EFFORTS = ((0.5, 32, 10), (0.2, 16, 5), (0.0, 8, 4))
"""Hulls and depth of V-HACD's recursion: the first; of more than some bodies by their share of the mesh's diagonal."""

_MOST_PIECE_CORNERS = 600  # of one of V-HACD's pieces, which stick out of the body anyway
_MANY_FACES = 50_000  # with more, V-HACD gets the body with vertices that are near each other taken together
_CLUSTER_SHARE = 1.0 / 200.0  # of the body's diagonal, within which vertices are taken together
_DENT_SHARE = 1e-3  # of a body's diagonal: dents that may be filled where it counts as convex
_DEPTH_SHARE = 0.02  # of a body's diagonal: what is so far beyond a plane is no dent
_AREA_TOLERANCE = 1e-2  # by which the areas of a convex body and of its hull may differ
_LEAST_TRIANGLE_HEIGHT = 1e-12  # [m] height of a triangle that counts as without an area
_ENCLOSING_SHARE = 0.95  # of all sides, from which an open mesh shuts in what counts as inside of it
_MESHES_KEPT = 32  # meshes in memory

_Faces = NDArray[np.int64]
_cache: OrderedDict[bytes, tuple[Array, ...]] = OrderedDict()
_lock = threading.Lock()


def convex_pieces(vertices: Array, faces: _Faces) -> tuple[Array, ...]:
    """Vertices (V_i, 3) [m] of convex pieces whose hulls together hold the surface of the mesh.

    Args:
        vertices: Vertices (V, 3) [m].
        faces: Triangles (F, 3).
    """
    return _once(vertices, faces, 0, _decompose)


def _once(vertices: Array, faces: _Faces, most: int, make: Callable[[Array, _Faces], list[Array]]) -> tuple[Array, ...]:
    """The pieces of a mesh, at most ``most`` if that is not 0: made, or still in memory."""
    digest = hashlib.sha256(np.array([len(vertices), most], dtype=np.int64).tobytes())
    digest.update(np.ascontiguousarray(vertices, dtype=np.float64).tobytes())
    digest.update(np.ascontiguousarray(faces, dtype=np.int64).tobytes())
    key = digest.digest()
    with _lock:
        if key in _cache:
            _cache.move_to_end(key)
            return _cache[key]
    pieces = tuple(make(vertices, faces))
    for piece in pieces:
        piece.flags.writeable = False
    with _lock:
        _cache[key] = pieces
        while len(_cache) > _MESHES_KEPT:
            _cache.popitem(last=False)
    return pieces


def few_pieces(vertices: Array, faces: _Faces, most: int) -> tuple[Array, ...]:
    """Corners (V_i, 3) [m] of at most ``most`` convex pieces that together hold a mesh's surface, and its inside.

    All bodies of the mesh are taken together. A place is inside if it cannot be reached from outside through an opening
    of about a thirtieth of the mesh's size, whether the mesh is closed or not.

    Args:
        vertices: (V, 3) [m], which are not flat.
        faces: triangles (F, 3).
        most: largest number of pieces.
    """
    return _once(vertices, faces, most, lambda points, triangles: _few(points, triangles, most))


def _few(vertices: Array, faces: _Faces, most: int) -> list[Array]:
    points, triangles, kept = _merged(vertices, faces)
    body = triangles[kept]
    closed = len(body) > 0 and bool(_closed(body, np.zeros(len(body), dtype=np.int64))[0])
    if not len(body) or len(_bars(points, body, triangles[~kept])) or (closed and _convex(points, body)):
        return [few_corners(vertices, "Mesh piece", SceneError)[0]]
    return _solid_pieces(points, body, True, most, _VHACD_EFFORTS[0][2], _VOXELS_OF_MORE)


def load_mesh(path: Path) -> tuple[Array, _Faces]:
    """Vertices (V, 3), in the file's unit, and faces (F, 3) of a mesh file.

    Raises:
        SceneError: the file is missing, unreadable, empty, of another kind, without triangles, or has vertices that are
            not finite.
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
    points, triangles, kept = _merged(vertices, faces)
    if not kept.any():
        raise SceneError(f"the mesh has no triangle with an area ({len(faces)} triangles given)")
    solid = trimesh.Trimesh(points, triangles[kept], process=False)
    labels = trimesh.graph.connected_component_labels(solid.face_adjacency, node_count=len(solid.faces))
    labels = _joined_shells(triangles[kept], labels.astype(np.int64))
    bars = _bars(points, triangles[kept], triangles[~kept])
    triangles = np.vstack((triangles[kept], bars))
    labels = np.concatenate((labels, labels.max() + 1 + np.arange(len(bars))))
    del solid
    groups, alone = _grouped(points, triangles, labels)
    closed = _closed(triangles, groups)
    order = np.argsort(groups, kind="stable")
    bodies = np.split(triangles[order], np.flatnonzero(np.diff(groups[order])) + 1)
    whole = float(np.linalg.norm(np.ptp(points[triangles.ravel()], axis=0)))
    progress = LoggedProgress(f"making convex pieces of a mesh of {len(faces)} triangles", "bodies", len(bodies))
    pieces: list[Array] = []
    waiting: list[tuple[Array, _Faces, bool]] = []
    for k, body in enumerate(bodies):
        used, local = np.unique(body, return_inverse=True)
        corners, local = points[used], local.reshape(body.shape)
        found = _simple_body(corners, local, bool(closed[k]), whole, bool(alone[k]))
        if found is None:
            waiting.append((corners, local, bool(closed[k])))
        else:
            pieces += found
            progress.step()
    for corners, local, tight in waiting:
        pieces += _decomposed(corners, local, tight, len(waiting), whole)
        progress.step()
    return pieces


def _merged(vertices: Array, faces: _Faces) -> tuple[Array, _Faces, NDArray[np.bool_]]:
    """A mesh with each corner and each triangle once, and which of its triangles have an area."""
    import trimesh

    mesh = trimesh.Trimesh(vertices=vertices, faces=faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    points, triangles = np.array(mesh.vertices), np.array(mesh.faces)
    triangles = triangles[np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]]  # each once
    kept = np.asarray(
        trimesh.triangles.nondegenerate(points[triangles], areas=None, height=_LEAST_TRIANGLE_HEIGHT), dtype=bool
    )
    return points, triangles, kept


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The triangles of a mesh, each once, and neighbours turned the same way round.

    So a body that is drawn from both sides, or whose triangles lie either way, still encloses its inside. Which way a
    body is turned as a whole stays as it is: that distinguishes a hollow in another body from a body of its own.

    Attributes:
        corners: (T, 3, 3) [m].
        closed: whether each edge belongs to two triangles at least.
    """

    corners: Array
    closed: bool

    @classmethod
    def of(cls, vertices: Array, faces: _Faces) -> Surface:
        """The surface of vertices (V, 3) [m] and triangles (F, 3)."""
        import trimesh

        points, triangles, kept = _merged(vertices, faces)
        body = triangles[kept]
        mesh = trimesh.Trimesh(points, body, process=False)
        if not mesh.is_winding_consistent:
            trimesh.repair.fix_winding(mesh)
        closed = len(body) > 0 and bool(_closed(body, np.zeros(len(body), dtype=np.int64))[0])
        return cls(np.asarray(mesh.triangles, dtype=np.float64).reshape(-1, 3, 3), closed)

    def encloses(self, point: Array) -> bool:
        """Whether a point (3,) is inside: an open surface has to be about it on nearly all sides.

        The surface winds about once around a point inside, and about 0 times around one outside.
        """
        a, b, c = np.moveaxis(self.corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        around = la * lb * lc + lc * (a * b).sum(axis=1) + la * (b * c).sum(axis=1) + lb * (c * a).sum(axis=1)
        times = abs(float(np.arctan2(volume, around).sum() / (2.0 * np.pi)))
        return times > (0.5 if self.closed else _ENCLOSING_SHARE)


def one_of_each_body(vertices: Array, faces: _Faces) -> Array:
    """A corner (B, 3) [m] of each body of a mesh."""
    from scipy.sparse import coo_matrix  # late: slow to import
    from scipy.sparse.csgraph import connected_components

    points, triangles, _ = _merged(vertices, faces)
    one, two = triangles[:, :2].ravel(), triangles[:, 1:].ravel()
    links = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(points), len(points)))
    body = connected_components(links, directed=False)[1]
    used = np.unique(triangles)
    return points[used[np.unique(body[used], return_index=True)[1]]]


def _bars(points: Array, faces: _Faces, thin: _Faces) -> _Faces:
    """Triangles without an area that lie along no edge of another one: (B, 3), from end to end."""
    if not len(thin):
        return np.zeros((0, 3), dtype=np.int64)
    sides = np.stack([thin, np.roll(thin, -1, axis=1)], axis=2)  # (F, 3, 2)
    lengths = np.linalg.norm(points[sides[..., 0]] - points[sides[..., 1]], axis=2)
    longest = np.sort(sides[np.arange(len(thin)), lengths.argmax(axis=1)], axis=1)
    longest = longest[lengths.max(axis=1) > 0.0]
    keys = np.unique(_edge_keys(faces, len(points)))
    own = np.unique(longest[:, 0] * len(points) + longest[:, 1])
    first, second = np.divmod(own[~np.isin(own, keys)], len(points))
    if len(first):
        _log.warning(
            "%d triangles of a mesh have no area and lie along no other one: they are taken as bars, %g m thick",
            len(first),
            2.0 * PLATE_REACH,
        )
    return np.column_stack((first, second, second)).astype(np.int64)


def _edge_keys(faces: _Faces, count: int) -> _Faces:
    """One number per edge (3 F,), the same from both sides."""
    edges = np.sort(np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])), axis=1)
    return edges[:, 0] * count + edges[:, 1]


def _joined_shells(faces: _Faces, labels: _Faces) -> _Faces:
    """Labels (F,) of bodies, where those that are closed together, such as the two halves of a box with a wall between
    them, are one: three triangles share an edge there, and the bodies are told apart by edges of two."""
    from scipy.sparse import coo_matrix  # late: slow to import
    from scipy.sparse.csgraph import connected_components

    alone = _closed(faces, labels)
    if alone.all():
        return labels
    open_faces = np.flatnonzero(~alone[labels])
    keys, body = _edge_keys(faces[open_faces], int(faces.max()) + 1), np.tile(labels[open_faces], 3)
    order = np.argsort(keys, kind="stable")
    keys, body = keys[order], body[order]
    same = np.flatnonzero(keys[1:] == keys[:-1])
    links = coo_matrix((np.ones(len(same)), (body[same], body[same + 1])), shape=(len(alone), len(alone)))
    joined = connected_components(links, directed=False)[1].astype(np.int64)[labels]
    together = _closed(faces, joined)
    numbers = np.where(together[joined], joined, labels + joined.max() + 1)
    return np.unique(numbers, return_inverse=True)[1].ravel().astype(np.int64)


def _closed(faces: _Faces, groups: _Faces) -> NDArray[np.bool_]:
    """Whether in each group each edge belongs to two triangles at least."""
    keys, body = _edge_keys(faces, int(faces.max()) + 1), np.tile(groups, 3)
    order = np.lexsort((keys, body))
    keys, body = keys[order], body[order]
    starts = np.flatnonzero(np.concatenate(([True], (keys[1:] != keys[:-1]) | (body[1:] != body[:-1]))))
    twice = np.diff(np.append(starts, len(keys))) >= 2
    closed = np.ones(int(groups.max()) + 1, dtype=bool)
    np.logical_and.at(closed, body[starts], twice)
    return closed


def _grouped(points: Array, faces: _Faces, labels: _Faces) -> tuple[_Faces, NDArray[np.bool_]]:
    """Number (F,) of the group that each triangle belongs to, and of each group whether it is one body.

    Each body is its own, unless there are more than `MANY_BODIES`: then bodies are together whose boxes have their
    middle in one cube of space, of such a size that few enough are left; larger bodies stay alone.
    """
    count = int(labels.max()) + 1
    if count <= MANY_BODIES:
        return labels, np.ones(count, dtype=bool)
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(count))
    corners = points[faces[order]]
    low = np.minimum.reduceat(corners.min(axis=1), starts)
    high = np.maximum.reduceat(corners.max(axis=1), starts)
    size, middle = np.linalg.norm(high - low, axis=1), 0.5 * (low + high) - low.min(axis=0)
    edge = SMALL_BODY * float(np.linalg.norm(high.max(axis=0) - low.min(axis=0)))
    while True:
        cell = np.column_stack((np.floor(middle / edge).astype(np.int64), np.where(size > edge, np.arange(count), -1)))
        _, group = np.unique(cell, axis=0, return_inverse=True)
        group = group.ravel()
        if group.max() < MANY_BODIES:
            break
        edge *= 1.25
    _log.warning(
        "a mesh of %d bodies: those within %.2g m are taken together, as %d convex hulls; give a mesh each to "
        "what is to be told apart",
        count,
        edge,
        int(group.max()) + 1,
    )
    return group[labels], np.bincount(group) == 1


def _simple_body(corners: Array, faces: _Faces, closed: bool, whole: float, alone: bool) -> list[Array] | None:
    """Pieces of a body that is flat, small or convex, or of several; None for another one."""
    if flatness(corners) < MIN_THICKNESS:
        return _plates(corners, faces)
    centred = corners - corners.mean(axis=0)
    across = np.ptp(centred @ np.linalg.eigh(centred.T @ centred)[1], axis=0)
    if alone and np.hypot(*np.sort(across)[:2]) > SMALL_BODY * whole and not (closed and _convex(corners, faces)):
        return None
    return [few_corners(corners, "Mesh piece", SceneError)[0]]


def _convex(corners: Array, faces: _Faces) -> bool:
    """Whether a closed body is convex: it lies along a hull that holds it, and has its area."""
    from scipy.spatial import QhullError, cKDTree  # late: slow to import

    if _dented(corners, faces):
        return False
    try:
        few, sticks_out = few_corners(corners, "Mesh piece", SceneError)
        hull = convex_hull(few)
    except QhullError:
        return False
    sides = corners[faces]
    normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    if abs(0.5 * float(lengths.sum()) - hull.area) > _AREA_TOLERANCE * hull.area:
        return False
    size = float(np.linalg.norm(np.ptp(corners, axis=0)))
    middle, planes = few.mean(axis=0), np.unique(hull.equations, axis=0)
    normals /= lengths[:, None]
    normals *= np.where(np.sum(normals * (sides.mean(axis=1) - middle), axis=1) < 0.0, -1.0, 1.0)[:, None]
    along = np.sum(normals * (sides[:, 0] - middle), axis=1)
    tree = cKDTree(np.column_stack((planes[:, :3], -(planes[:, 3] + planes[:, :3] @ middle) / size)))
    left = np.arange(len(faces))
    for near in (1, min(8, len(planes))):  # the planes of the hull that are most like the triangle's own
        _, found = tree.query(np.column_stack((normals[left], along[left] / size)), k=near)
        plane = planes[found.reshape(len(left), -1)]
        depth = -(np.einsum("fni,fki->fkn", sides[left], plane[..., :3]) + plane[..., None, 3])
        left = left[depth.max(axis=2).min(axis=1) > _DENT_SHARE * size + sticks_out]
        if not len(left):
            return True
    return False


def _dented(corners: Array, faces: _Faces) -> bool:
    """Whether much of a body is beyond the planes of its triangles, as far as some of both are looked at."""
    some = corners[faces[:: 1 + len(faces) // 400]]
    normals = np.cross(some[:, 1] - some[:, 0], some[:, 2] - some[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    beyond = normals @ corners[:: 1 + len(corners) // 2000].T - np.sum(normals * some[:, 0], axis=1)[:, None]
    either = np.minimum(beyond.max(axis=1), -beyond.min(axis=1))  # a surface may be inside out
    return bool(np.mean(either > _DEPTH_SHARE * float(np.linalg.norm(np.ptp(corners, axis=0)))) > 0.2)


def _plates(corners: Array, faces: _Faces) -> list[Array]:
    """Thin plates of a flat body, or of bars."""
    if len(faces) <= _MAX_PLATES:
        return [_plate(corners[face]) for face in faces]
    middle = corners.mean(axis=0)
    across = np.linalg.svd((corners - middle).T @ (corners - middle))[0]
    flat = (corners - middle) @ across[:, :2]
    sides = flat[faces]
    first, second = sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]
    area = 0.5 * float(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum())
    if abs(area - convex_hull(flat).volume) <= _DENT_SHARE * area:
        outline = corners[convex_hull(flat).vertices]
        return [few_corners(_plate(outline), "Mesh piece", SceneError)[0]]
    return [_plate(points) for points in surface_cells(corners, faces)]


def _plate(corners: Array) -> Array:
    """Points about flat ones (V, 3), `PLATE_REACH` to either side; to all sides where they lie on a line."""
    _, size, across = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)
    if len(size) > 1 and size[1] > MIN_THICKNESS:
        return np.vstack((corners + PLATE_REACH * across[2], corners - PLATE_REACH * across[2]))
    return (
        corners[:, None] + PLATE_REACH * np.array([(-1, -1, 1), (1, -1, -1), (-1, 1, -1), (1, 1, 1)])[None]
    ).reshape(-1, 3)


def _decomposed(vertices: Array, faces: _Faces, closed: bool, bodies: int, whole: float) -> list[Array]:
    """Pieces of a body that is neither flat nor convex, one of several in a mesh of a diagonal ``whole`` [m]."""
    share = float(np.linalg.norm(np.ptp(vertices, axis=0))) / whole
    most, depth = next(
        (hulls, deep) for least, hulls, deep in _VHACD_EFFORTS if bodies <= _SOME_BODIES or share >= least
    )
    return _solid_pieces(
        vertices, faces, closed, most, depth, _VOXELS_OF_FEW if bodies <= _FEW_BODIES else _VOXELS_OF_MORE
    )


def _solid_pieces(vertices: Array, faces: _Faces, closed: bool, most: int, depth: int, resolution: int) -> list[Array]:
    """V-HACD's pieces, ``most`` at most, grown until they hold a body."""
    import trimesh

    hulls = []
    coarse = trimesh.Trimesh(*_clustered(vertices, faces), process=False)
    for found in trimesh.decomposition.convex_decomposition(
        coarse, resolution=resolution, maxConvexHulls=most, maxRecursionDepth=depth, asyncACD=False
    ):
        corners = np.asarray(found["vertices"], dtype=np.float64)
        if len(corners) >= 4 and np.isfinite(corners).all() and flatness(corners) >= MIN_THICKNESS:
            hulls.append(corners)
    if not hulls:
        _log.warning("no convex decomposition of a body of %d triangles: its convex hull is used", len(faces))
        return [few_corners(vertices, "Mesh piece", SceneError)[0]]
    grown, stuck_out = grown_pieces(vertices, faces, hulls, closed=closed)
    _log.debug("%d pieces; the body stuck out of V-HACD's pieces by up to %.3g m", len(grown), stuck_out)
    return [few_corners(piece, "Mesh piece", SceneError, most=_MOST_PIECE_CORNERS)[0] for piece in grown]


def _clustered(vertices: Array, faces: _Faces) -> tuple[Array, _Faces]:
    """A body as it is; of very many triangles one of fewer, whose voxels are much the same."""
    if len(faces) <= _MANY_FACES:
        return vertices, faces
    low = vertices.min(axis=0)
    edge = _CLUSTER_SHARE * float(np.linalg.norm(vertices.max(axis=0) - low))
    cube = np.floor((vertices - low) / edge).astype(np.int64)
    size = cube.max(axis=0) + 1
    _, first, number = np.unique(
        (cube[:, 0] * size[1] + cube[:, 1]) * size[2] + cube[:, 2], return_index=True, return_inverse=True
    )
    few = number.ravel()[faces]
    few = few[(few[:, 0] != few[:, 1]) & (few[:, 1] != few[:, 2]) & (few[:, 2] != few[:, 0])]
    _, once = np.unique(np.sort(few, axis=1) @ np.array([len(first) ** 2, len(first), 1]), return_index=True)
    return vertices[first], few[once]
