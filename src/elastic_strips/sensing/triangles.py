"""Sensing room, triangles: where beams meet hulls, meshes, voxels and points: closed triangle meshes in Embree."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import coal as _coal
import numpy as np
import numpy.typing as npt

from ..errors import missing_extra
from ..robot.geometry import support_points
from ..robot.space import Array
from ..scene.parts import Part
from .rays import Nearest, Rays

coal: Any = _coal  # compiled, without type stubs

Corners = tuple[Array, npt.NDArray[np.int64]]
"""Vertices (V, 3) [m] and triangles (F, 3)."""

_FARTHEST = 1e30  # [m] Embree says 1e37 where a ray meets nothing
_BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def import_embree() -> tuple[Any, Any]:
    """The classes ``EmbreeScene`` and ``TriangleMesh`` of the package ``embreex``.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        from embreex.mesh_construction import TriangleMesh  # pyright: ignore[reportMissingImports]
        from embreex.rtcore_scene import EmbreeScene  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise missing_extra("seeing hulls, meshes, voxels and points by rays", "embreex", "sensing") from error
    return EmbreeScene, TriangleMesh


class TriangleBody:
    """Workspace: closed meshes in one frame, in one tree of boxes that is built once.

    Args:
        meshes: their corners; the triangles' order says which side is outside (right-handed).
    """

    def __init__(self, meshes: Iterable[Corners]) -> None:
        vertices, faces, count = [], [], 0
        for points, triangles in meshes:
            vertices.append(points)
            faces.append(triangles + count)
            count += len(points)
        points, triangles = np.concatenate(vertices), np.concatenate(faces)
        low, high = points.min(axis=0), points.max(axis=0)
        self.center = 0.5 * (low + high)
        self.radius = float(np.linalg.norm(points - self.center, axis=1).max())
        a, b, c = ((points - self.center)[triangles[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        self._normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        make_scene, make_mesh = import_embree()
        self._scene = make_scene(robust=True)  # no beam slips through between two triangles
        self._mesh = make_mesh(
            self._scene, (points - self.center).astype(np.float32), np.ascontiguousarray(triangles, dtype=np.int32)
        )

    def cast(self, T: Array, rays: Rays, nearest: Nearest, *, reach: float, inside: float) -> bool:
        """Look where rays meet the meshes.

        Args:
            T: (4, 4) pose of the meshes' frame in the rays' frame.
            rays: the beams.
            nearest: takes what is nearer than what it has.
            reach: how far the beams go [m]; what is further may be left out.
            inside: distance [m] that a beam gets that begins inside a mesh, which it first meets from behind.

        Returns:
            Whether any beam came near.
        """
        rotation = T[:3, :3]
        center = rotation @ self.center + T[:3, 3]
        _, index = rays.near(center[None], np.array([self.radius]), reach)
        if len(index) == 0:
            return False
        local = rays.some(index).seen_from(rotation, center)
        direction = local.direction.astype(np.float32)
        origin = np.empty_like(direction)
        origin[:] = local.origin
        met = self._scene.run(origin, direction, output=True)
        hit = np.flatnonzero(met["tfar"] < _FARTHEST)
        if len(hit) == 0:
            return True
        distance = met["tfar"][hit].astype(np.float64)
        normal = self._normal[met["primID"][hit]]
        distance[np.einsum("ij,ij->i", normal, local.direction[hit]) > 0.0] = inside
        ray = index[hit]
        won = nearest.closer(ray, distance)
        if nearest.normal is not None:
            nearest.normal[ray[won]] = normal[won] @ rotation.T
        return True


def part_meshes(part: Part) -> list[Corners]:
    """Triangles of a part of an obstacle, in the obstacle's frame."""
    shift = part.T_obstacle_part[:3, 3]
    if part.geometry is not None:
        points, faces = hull_mesh(part.geometry)
        return [(points + shift, faces)]
    half = np.array([box.halfSide for box, _ in part.boxes])
    middle = np.array([at for _, at in part.boxes]) + shift
    points = (middle[:, None] + half[:, None] * _BOX_CORNERS).reshape(-1, 3)
    faces = (_BOX_FACES + 8 * np.arange(len(half))[:, None, None]).reshape(-1, 3)
    return [(points, faces)]


def hull_mesh(geometry: Any, padding: float = 0.0) -> Corners:
    """Triangles of a convex Coal shape, in its frame.

    Args:
        geometry: the shape; round ones become polyhedra that contain them.
        padding: by how much it shall be thicker at least [m]; corners grow by √3 times that.
    """
    if padding == 0.0 and isinstance(geometry, coal.ConvexBase) and not isinstance(geometry, coal.Cone):
        points = np.asarray(geometry.points(), dtype=float).reshape(-1, 3)
    else:
        points, radius = support_points(geometry)
        points = (points[:, None] + (radius + padding) * _BOX_CORNERS).reshape(-1, 3)
    return _hull(points)


def joined(bodies: Sequence[tuple[Array, Sequence[Corners]]]) -> TriangleBody:
    """One body of meshes that stand still, each with the pose (4, 4) of its frame in the world."""
    placed = [(points @ T[:3, :3].T + T[:3, 3], faces) for T, meshes in bodies for points, faces in meshes]
    return TriangleBody(placed)


def _hull(points: Array) -> Corners:
    """Triangles of the convex hull of points (V, 3), outside to the right hand."""
    from scipy.spatial import ConvexHull  # late: slow to import

    hull = ConvexHull(points)
    faces = hull.simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    number = np.full(len(points), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    return points[hull.vertices], number[faces]
