"""Geometry: the content of a picture as arrays: meshes of robots and obstacles, and where they are."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from weakref import WeakKeyDictionary

import coal
import numpy as np
import trimesh
from numpy.typing import NDArray

from elastic_strips.arrays import Array, ArrayLike, Indices
from elastic_strips.coal_shapes import ShapeKind, faces, shape_of, vertices
from elastic_strips.robot import ConfigurationSpace, Kinematics, RobotModel
from elastic_strips.scene import Obstacle

Floats = NDArray[np.float32]
_GREY = "#a9b0b8"
BARE = "#f0b400"
"""The colour of the stripes of links that no collision shape covers."""
_SLANT = np.array([0.48, 0.36, 0.8])
_STRIPES, _MOST_STRIPES = (0.006, 0.06), 40  # [m] how wide; of a link
_CREASE_ANGLE = float(np.radians(35.0))  # [rad] sharper edges are not smoothed


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
        return replace(self, colors=np.tile(np.asarray(rgb, dtype=np.float32), (len(self.vertices), 1)))

    def scaled(self, factors: ArrayLike) -> MeshData:
        """Return the mesh scaled along its axes."""
        f = np.asarray(factors, dtype=np.float32)
        normals = self.normals / f
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return MeshData(self.vertices * f, normals, self.faces, self.colors)


def linear(color: str | Sequence[float]) -> tuple[float, float, float]:
    """Turn an sRGB colour, ``"#rrggbb"`` or three floats in [0, 1], into the linear RGB that lighting works in."""
    rgb = [byte / 255 for byte in bytes.fromhex(color[1:])] if isinstance(color, str) else color
    r, g, b = (float(c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4) for c in rgb)
    return r, g, b


def _shaded(vertices: ArrayLike, faces: ArrayLike, crease: float = _CREASE_ANGLE) -> MeshData:
    """Compute normals: smooth within patches of faces that meet at less than the crease angle [rad], sharp between."""
    mesh = trimesh.Trimesh(np.asarray(vertices, dtype=float), np.asarray(faces), process=False)
    mesh.merge_vertices(digits_vertex=6)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-9))
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles < crease]
    patch = trimesh.graph.connected_component_labels(smooth, node_count=len(mesh.faces))
    corners = np.column_stack((np.repeat(patch, 3), mesh.faces.ravel()))
    first, index = _distinct(corners)
    corners = corners[first]
    split = trimesh.Trimesh(mesh.vertices[corners[:, 1]], index.reshape(-1, 3), process=False)
    return MeshData(
        split.vertices.astype(np.float32), split.vertex_normals.astype(np.float32), split.faces.astype(np.uint32)
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
    """Return a coarser mesh: vertices of one colour that share a cell of edge ``cell`` [m] become one."""
    if mesh.colors is not None:
        first, shade = _distinct(np.rint(255 * mesh.colors).astype(np.int64))
        shades, shade = mesh.colors[first], shade[mesh.faces[:, 0]]
        parts = [replace(mesh, faces=mesh.faces[shade == k], colors=None) for k in range(len(shades))]
        colored = [
            clustered(part, cell).colored((float(r), float(g), float(b)))
            for part, (r, g, b) in zip(parts, shades, strict=True)
            if len(part.faces)
        ]
        return merged(colored) if colored else mesh
    first, inverse = _distinct(np.floor(mesh.vertices / cell).astype(np.int64))
    faces = inverse[mesh.faces]
    keep = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    if not keep.any():
        return mesh
    faces = faces[keep]
    return _shaded(mesh.vertices[first], faces[_distinct(faces)[0]])


def _distinct(rows: NDArray[np.integer]) -> tuple[Indices, Indices]:
    """Where each distinct one of integer rows (N, d) comes first, in the order of the rows, and which of them each is.

    ``np.unique(rows, axis=0)`` says the same, five times as slowly: a row becomes one number here.
    """
    low = rows.min(axis=0)
    size = (rows.max(axis=0) - low + 1).tolist()
    fits = math.prod(size) < 2**63  # all but robots of kilometres
    number = np.ravel_multi_index(tuple((rows - low).T), size) if fits else rows
    _, first, inverse = np.unique(number, axis=0, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)


# Unit meshes


@cache
def box() -> MeshData:
    """Unit cube about the origin."""
    cube = trimesh.creation.box()
    return _shaded(cube.vertices, cube.faces)


@cache
def sphere(segments: int = 20) -> MeshData:
    """Unit sphere about the origin."""
    angle = np.linspace(0.0, np.pi, segments // 2 + 1)
    return _revolved(np.column_stack((np.sin(angle), -np.cos(angle))), segments, crease=np.pi)


@cache
def cylinder() -> MeshData:
    """Cylinder of radius 1 and length 1 about the origin, along z."""
    return _revolved([(0.0, -0.5), (1.0, -0.5), (1.0, 0.5), (0.0, 0.5)], 24)


@cache
def cone() -> MeshData:
    """Cone of radius 1 and length 1 along z, apex up, origin at mid-height.

    The ring below the apex has the normals of the side, which the apex cannot have.
    """
    return _revolved([(0.0, -0.5), (1.0, -0.5), (0.002, 0.498), (0.0, 0.5)], 24)


@cache
def rod() -> MeshData:
    """Cylinder of radius 1 without end faces, along z from 0 to 1."""
    return _revolved([(1.0, 0.0), (1.0, 1.0)], 6, crease=np.pi)


@cache
def arrow() -> MeshData:
    """Arrow along z from 0 to 1; its head has radius 1."""
    return _revolved([(0.0, 0.0), (0.38, 0.0), (0.38, 0.62), (1.0, 0.62), (0.003, 0.999), (0.0, 1.0)], 10)


@cache
def ring(inner: float, outer: float) -> MeshData:
    """Flat ring on the floor with an arrow head that points along x."""
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.column_stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)))
    tip, width = outer + 0.22, 0.11
    head = np.array([[tip, 0, 0], [outer + 0.03, width, 0], [outer + 0.03, -width, 0]])
    i = np.arange(48)
    faces = np.vstack((np.column_stack((i, i + 49, i + 50)), np.column_stack((i, i + 50, i + 1)), [[98, 99, 100]]))
    return _flat(np.vstack((inner * circle, outer * circle, head)), faces)


def _capsule(radius: float, length: float) -> MeshData:
    """Capsule along z: a cylinder of ``length`` [m] between two half spheres of ``radius`` [m]."""
    angle = np.linspace(0.0, np.pi / 2, 7)
    upper = np.column_stack((radius * np.cos(angle), radius * np.sin(angle) + length / 2))
    return _revolved(np.vstack((upper[::-1] * [1.0, -1.0], upper)), 24, crease=np.pi)


def _revolved(profile: ArrayLike, segments: int, crease: float = _CREASE_ANGLE) -> MeshData:
    """Turn a profile of (radius, z) about z."""
    turned = trimesh.creation.revolve(np.asarray(profile, dtype=float), sections=segments)
    return _shaded(turned.vertices, turned.faces, crease)


def _flat(vertices: Array, faces: NDArray[np.intp], colors: Array | None = None) -> MeshData:
    """A mesh (V, 3), (F, 3) that lies on the floor and is seen from above."""
    normals = np.tile(np.array([0, 0, 1], dtype=np.float32), (len(vertices), 1))
    tint = None if colors is None else colors.astype(np.float32)
    return MeshData(vertices.astype(np.float32), normals, faces.astype(np.uint32), tint)


# Bodies: robots and obstacles, each as few meshes as can be


def from_coal(geometry: coal.CollisionGeometry) -> MeshData | None:
    """Triangles of a Coal shape in its own frame, or None for a shape that has no surface to draw (a plane)."""
    kind, size = shape_of(geometry)
    if kind.value in UNIT_MESHES:
        return UNIT_MESHES[kind.value]().scaled(_factors(geometry))
    if kind is ShapeKind.ELLIPSOID:
        return sphere().scaled(size)
    if kind is ShapeKind.CAPSULE:
        return _capsule(size[0], 2 * size[1])
    if kind is ShapeKind.CONVEX:
        hull = trimesh.convex.convex_hull(vertices(geometry))
        return _shaded(hull.vertices, hull.faces)
    return _shaded(vertices(geometry), faces(geometry)) if kind is ShapeKind.MESH else None


@dataclass(frozen=True, slots=True)
class Body:
    """Everything that moves with one joint, as one mesh with vertex colours in the joint's aligned frame."""

    joint: int
    mesh: MeshData


def robot_bodies(robot: RobotModel) -> tuple[Body, ...]:
    """Merge a robot's visual geometry per joint; each distinct mesh is read once.

    Where there is no visual geometry the collision geometry is drawn instead. Objects without a colour are grey:
    Pinocchio's geometry objects are black until they are given one. Links about which nothing is proven are hatched.
    """
    model = robot.visual_model if robot.visual_model.ngeoms else robot.collision_model
    read: dict[object, MeshData | None] = {}
    parts: dict[int, list[MeshData]] = defaultdict(list)
    for item in model.geometryObjects:
        is_file = "." in item.meshPath  # of a primitive it is BOX, CYLINDER, …
        name = (item.meshPath, *np.round(item.meshScale, 9)) if is_file else item.name
        if name not in read:
            read[name] = from_coal(item.geometry)
        mesh = read[name]
        if mesh is not None and len(mesh.faces):
            uncoloured = not item.overrideMaterial and not np.any(item.meshColor[:3])
            color = linear(_GREY if uncoloured else [float(c) for c in item.meshColor[:3]])
            placement = robot.tree.to_aligned(item.parentJoint, item.placement.homogeneous)
            mesh = mesh.transformed(placement)
            bare = str(robot.model.frames[item.parentFrame].name) in robot.bare_links
            parts[item.parentJoint].append(_hatched(mesh, color) if bare else mesh.colored(color))
    return tuple(Body(joint, merged(found)) for joint, found in sorted(parts.items()))


def _hatched(mesh: MeshData, color: Sequence[float]) -> MeshData:
    """The mesh in its colour with slanting stripes."""
    along = mesh.vertices @ _SLANT
    low, high = float(along.min()), float(along.max())
    width = float(np.clip((high - low) / 9, *_STRIPES))
    count = min(int(np.ceil((high - low) / width)), _MOST_STRIPES)
    edges = np.linspace(low, high, count + 1)
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    bands: list[MeshData] = []
    for k in range(count):
        band = whole
        for sign, edge, needed in ((1.0, edges[k], k > 0), (-1.0, edges[k + 1], k < count - 1)):
            if needed and len(band.faces):
                band = band.slice_plane(edge * _SLANT, sign * _SLANT)
        if len(band.faces):
            bands.append(_shaded(band.vertices, band.faces).colored(linear(BARE) if k % 2 else color))
    return merged(bands) if bands else mesh.colored(linear(BARE))


def plain_bodies(bodies: tuple[Body, ...]) -> tuple[Body, ...]:
    """Return the bodies without colours."""
    return tuple(Body(body.joint, replace(body.mesh, colors=None)) for body in bodies)


def coarse_bodies(bodies: tuple[Body, ...], faces: int) -> tuple[Body, ...]:
    """Return the bodies, coarser until all of them have at most ``faces`` faces, or cells are 2 cm wide."""
    coarse = bodies
    for cell in (0.004, 0.008, 0.012, 0.016, 0.02):
        if sum(len(body.mesh.faces) for body in coarse) <= faces:
            break
        coarse = tuple(Body(body.joint, clustered(body.mesh, cell)) for body in bodies)
    return coarse


_DRAWN: WeakKeyDictionary[RobotModel, dict[tuple[int | None, bool], tuple[Body, ...]]] = WeakKeyDictionary()


def drawn_bodies(robot: RobotModel, *, faces: int | None = None, plain: bool = False) -> tuple[Body, ...]:
    """A robot's bodies with at most ``faces`` faces, and ``plain`` without colours; made once for each robot,
    as a notebook has many pictures of one."""
    known = _DRAWN.setdefault(robot, {})
    if (faces, plain) not in known:
        if faces is None and not plain:
            known[faces, plain] = robot_bodies(robot)
        else:
            bodies = drawn_bodies(robot)
            bodies = plain_bodies(bodies) if plain else bodies
            known[faces, plain] = bodies if faces is None else coarse_bodies(bodies, faces)
    return known[faces, plain]


UNIT_MESHES: dict[str, Callable[[], MeshData]] = {"box": box, "sphere": sphere, "cylinder": cylinder, "cone": cone}
"""By the shape of an obstacle, which is also the kind of its Coal shape."""


def unit_shape(obstacle: Obstacle) -> tuple[str, Array] | None:
    """Name and scale factors (3,) of the unit mesh that an obstacle is; None if it is none of them."""
    if obstacle.shape not in UNIT_MESHES or len(obstacle.parts) != 1:
        return None
    return obstacle.shape, _factors(obstacle.parts[0].members[0])


def _factors(geometry: coal.CollisionGeometry) -> Array:
    """By what a unit mesh is scaled along its axes to be this box, sphere, cylinder or cone."""
    kind, size = shape_of(geometry)
    if kind is ShapeKind.BOX:
        return 2 * np.array(size)
    return np.full(3, size[0]) if kind is ShapeKind.SPHERE else np.array([size[0], size[0], 2 * size[1]])


def obstacle_mesh(obstacle: Obstacle) -> MeshData | None:
    """Merge an obstacle's parts into one mesh in the obstacle's frame; None if nothing of it can be drawn.

    The picture shows what is avoided: the convex parts of a mesh, the merged boxes of voxels.
    """
    found: list[MeshData] = []
    boxes: list[tuple[Array, Array]] = []
    for part in obstacle.parts:
        origin = np.asarray(part.T_obstacle_part)[:3, 3]  # a part is never turned
        shapes = [(part.geometry, origin)] if part.geometry is not None else []
        shapes += [(shape, origin + np.asarray(offset)) for shape, offset in part.boxes]
        for shape, center in shapes:
            if isinstance(shape, coal.Box):
                boxes.append((center, 2.0 * np.asarray(shape.halfSide)))
                continue
            mesh = from_coal(shape)
            if mesh is not None:
                pose = np.eye(4)
                pose[:3, 3] = center
                found.append(mesh.transformed(pose))
    if boxes:
        found.append(_boxes(*(np.array(column) for column in zip(*boxes, strict=True))))
    return merged(found) if found else None


def _boxes(centers: Array, sizes: Array) -> MeshData:
    """Axis-aligned boxes (K, 3) as one mesh: voxels are thousands of them."""
    unit = box()
    vertices = centers[:, None, :] + sizes[:, None, :] * unit.vertices[None]
    offsets = (np.arange(len(centers), dtype=np.uint32) * np.uint32(len(unit.vertices)))[:, None, None]
    normals = np.tile(unit.normals, (len(centers), 1))
    return MeshData(vertices.reshape(-1, 3).astype(np.float32), normals, (unit.faces[None] + offsets).reshape(-1, 3))


# Placement: where bodies, rods, arrows, balls and bands are


class RobotPoses:
    """Workspace: where a robot's bodies and control points are, for many configurations at once; one per thread.

    Bodies are placed by the *aligned* joint frames of ``elastic_strips.robot.Kinematics``.
    """

    def __init__(self, robot: RobotModel) -> None:
        """Allocate for a robot."""
        self.space: ConfigurationSpace = robot.space
        self._kinematics = Kinematics(robot.tree)
        points = robot.control_point_set
        self._joint = points.joint
        align = robot.tree.align[points.joint]
        self._local = np.matmul(np.swapaxes(align, -1, -2), points.local[..., None])[..., 0]

    def update(self, coordinates: Array) -> None:
        """Place coordinate rows (N, nv)."""
        self._kinematics.update(coordinates, jacobians=False)

    def points(self) -> Array:
        """Control points, (N, C, 3) [m]."""
        return self._kinematics.points(self._joint, self._local)

    def matrices(self, joints: Sequence[int], nodes: Sequence[int] | None = None) -> Floats:
        """Matrices of the bodies of some joints at some nodes (all by default), (N, B, 16) column-major."""
        T = self._kinematics.T[list(joints), : self._kinematics.n]
        if nodes is not None:
            T = T[:, list(nodes)]
        result = np.zeros((T.shape[1], T.shape[0], 4, 4), dtype=np.float32)
        result[..., :3] = T.transpose(1, 0, 3, 2)
        result[..., 3, 3] = 1.0
        return result.reshape(T.shape[1], T.shape[0], 16)


def between(starts: ArrayLike, ends: ArrayLike, radius: ArrayLike) -> Floats:
    """Matrices (K, 16) that put a unit mesh along z between pairs of points (K, 3), with a radius [m] or (K,) radii."""
    starts, ends = np.asarray(starts, dtype=np.float32), np.asarray(ends, dtype=np.float32)
    along = ends - starts
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
    along = np.where(length > 1e-6, along, np.array([0, 0, 1e-6], dtype=np.float32))
    unit = along / length
    helper = np.where(
        np.abs(unit[:, 2:]) < 0.9, np.array([0, 0, 1], dtype=np.float32), np.array([1, 0, 0], dtype=np.float32)
    )
    x = np.cross(helper, unit)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(unit, x)
    width = np.broadcast_to(np.asarray(radius, dtype=np.float32).reshape(-1, 1), (len(starts), 1))
    result = np.zeros((len(starts), 4, 4), dtype=np.float32)
    result[:, 0, :3], result[:, 1, :3], result[:, 2, :3], result[:, 3, :3] = x * width, y * width, along, starts
    result[:, 3, 3] = 1.0
    return result.reshape(-1, 16)


def spheres(centers: ArrayLike, radii: ArrayLike) -> Floats:
    """Matrices (K, 16) that put unit spheres at centres (K, 3) [m], or one (3,), with radii (K,) [m]."""
    centers = np.asarray(centers, dtype=np.float32).reshape(-1, 3)
    result = np.zeros((len(centers), 16), dtype=np.float32)
    result[:, 0] = result[:, 5] = result[:, 10] = np.asarray(radii, dtype=np.float32).reshape(-1)
    result[:, 12:15], result[:, 15] = centers, 1.0
    return result


def arrows(points: ArrayLike, vectors: ArrayLike) -> Floats:
    """Matrices (K, 16) of arrows, the longest of them 0.45 m; very small ones are left out."""
    points, vectors = np.asarray(points, dtype=float).reshape(-1, 3), np.asarray(vectors, dtype=float).reshape(-1, 3)
    size = np.linalg.norm(vectors, axis=1)
    size = np.where(np.isfinite(size), size, 0.0)
    keep = (size > 0.03 * size.max(initial=0.0)) & (size > 1e-9)
    if not keep.any():
        return np.zeros((0, 16), dtype=np.float32)
    scale = 0.45 / size[keep].max()
    length = size[keep] * scale
    return between(points[keep], points[keep] + vectors[keep] * scale, np.clip(0.09 * length, 0.008, 0.03))


def spaced(points: Array, count: int) -> list[int]:
    """Choose at most ``count`` nodes, the last among them, evenly along the motion of control points (N, C, 3)."""
    n = len(points)
    if n - 1 <= count:
        return list(range(1, n))
    travelled = arc_length(points)
    chosen = np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count + 1)[1:-1])
    return sorted({*(int(i) for i in np.clip(chosen, 1, n - 2)), n - 1})


def arc_length(points: Array) -> Array:
    """How far the farthest control point has moved up to each node, (N,) [m], strictly growing."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=1e-9)
    return np.concatenate(([0.0], np.cumsum(np.maximum(step, 1e-9))))


def interpolated(space: ConfigurationSpace, coordinates: Array, at: Array, where: Array) -> Array:
    """Coordinate rows (M, nv) at places ``where`` (M,) along nodes (N, nv) that lie at ``at`` (N,)."""
    if len(coordinates) == 1:
        return np.repeat(coordinates, len(where), axis=0)
    index = np.clip(np.searchsorted(at, where, side="right") - 1, 0, len(coordinates) - 2)
    s = np.clip((where - at[index]) / (at[index + 1] - at[index]), 0.0, 1.0)
    return space.interpolate(coordinates[index], coordinates[index + 1], s)


def ribbon(
    space: ConfigurationSpace,
    coordinates: Array,
    colors: Array,
    *,
    width: float = 0.06,
    height: float = 0.0,
    steps: int = 4,
) -> MeshData | None:
    """A flat band on the floor under a planar base, coloured per segment, along the arcs that the base drives.

    Args:
        space: The robot's configuration space.
        coordinates: Nodes (N, nv).
        colors: (N - 1, 3) linear RGB.
        width: Width of the band [m].
        height: Height above the floor [m].
        steps: Pieces of a segment, so that arcs look like arcs.

    Returns:
        None where the base does not move.
    """
    if len(coordinates) < 2 or not space.planar:
        return None
    s = np.broadcast_to(np.linspace(0.0, 1.0, steps + 1), (len(coordinates) - 1, steps + 1))
    path = space.interpolate(coordinates[:-1, None], coordinates[1:, None], s)[..., :2]
    flat = path.reshape(-1, 2)  # ((N - 1) (steps + 1), 2): the ends of a segment appear twice, once for each colour
    along = np.zeros_like(flat)
    along[1:-1] = flat[2:] - flat[:-2]
    along[0], along[-1] = flat[1] - flat[0], flat[-1] - flat[-2]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    if size.max() < 1e-9:
        return None
    along = np.divide(along, size, out=np.zeros_like(along), where=size > 1e-9)
    side = 0.5 * width * np.column_stack((-along[:, 1], along[:, 0]))
    vertices = np.zeros((2 * len(flat), 3))
    vertices[0::2, :2], vertices[1::2, :2], vertices[:, 2] = flat + side, flat - side, height
    i = 2 * (np.arange(len(coordinates) - 1)[:, None] * (steps + 1) + np.arange(steps)[None]).reshape(-1)
    faces = np.vstack((np.column_stack((i, i + 1, i + 3)), np.column_stack((i, i + 3, i + 2))))
    return _flat(vertices, faces, np.repeat(colors, 2 * (steps + 1), axis=0))
