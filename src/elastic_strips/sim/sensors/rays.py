"""Rays: beams in space, and where each first meets an obstacle of a scene, or the robot that sends it.

Boxes, spheres, cylinders, capsules and cones are met by formulas: a function of a shape takes K beams (origin,
direction) in the frames of K shapes and their sizes (K, 3), and returns where they enter and where they leave [m along
the beam]; a beam that misses enters at infinity. All other obstacles are triangles: those that never move, appear or
vanish share one tree of boxes, each other one has its own, in its frame, so that no tree is built anew as it moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import coal as _coal
import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices
from elastic_strips.errors import missing_extra
from elastic_strips.robot.geometry import LinkGeometry, support_points
from elastic_strips.scene import Obstacle, Scene, World
from elastic_strips.scene.parts import Part

from .mounting import Posture

_SLACK = 1e-6  # [m] bounding spheres are taken larger by this, so that rounding drops no touching pair


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Beams.

    Attributes:
        origin: (R, 3) where they begin [m]; (1, 3) where all begin at one point.
        direction: (R, 3) of unit length.
    """

    origin: Array
    direction: Array

    def __len__(self) -> int:
        return len(self.direction)

    def moved(self, T: Array) -> Rays:
        """Those of a frame, given in another one in which the frame has the pose ``T`` (4, 4)."""
        turn = T[:3, :3].T
        return Rays(self.origin @ turn + T[:3, 3], self.direction @ turn)

    def seen_from(self, rotation: Array, translation: Array) -> Rays:
        """These rays in the frame that has this pose."""
        return Rays((self.origin - translation) @ rotation, self.direction @ rotation)

    def some(self, index: Indices) -> Rays:
        """Those of these indices."""
        return Rays(self.origin if len(self.origin) == 1 else self.origin[index], self.direction[index])

    def near(self, center: Array, radius: Array, reach: float) -> tuple[Indices, Indices]:
        """Pairs (sphere, ray), spheres ascending, whose ray may meet the sphere within ``reach`` [m].

        Args:
            center: (P, 3) centres of the spheres [m].
            radius: (P,) their radii [m].
            reach: length of the rays [m].
        """
        middle = self.origin.mean(axis=0) if len(self.origin) > 1 else self.origin[0]
        c, o = center - middle, self.origin - middle  # coordinates stay small
        spread = math.sqrt(float(np.einsum("ij,ij->i", o, o).max()))
        close = np.flatnonzero(np.linalg.norm(c, axis=1) <= reach + radius + (spread + _SLACK))
        if len(close) == 0:
            return close, close
        c, r = c[close], (radius[close] + _SLACK)[:, None]
        along = c @ self.direction.T
        square = np.einsum("ij,ij->i", c, c)[:, None]
        if len(o) > 1:
            along -= np.einsum("ij,ij->i", o, self.direction)
            square = square - 2.0 * (c @ o.T) + np.einsum("ij,ij->i", o, o)
        ahead = np.maximum(along, 0.0)
        meets = (square - ahead * (2.0 * along - ahead) <= r * r) & (along <= reach + r)
        sphere, ray = np.divmod(np.flatnonzero(meets), len(self.direction))
        return close[sphere], ray


class Nearest:
    """Workspace: for each of ``count`` rays the nearest thing that it meets.

    Args:
        count: number of rays.
        normals: whether the surfaces' normals are wanted.

    Attributes:
        distance: (count,) [m]; infinite where a ray meets nothing.
        normal: (count, 3) outward normals where rays meet something, in the rays' frame; None if not wanted.
    """

    def __init__(self, count: int, *, normals: bool = False) -> None:
        self.distance = np.full(count, np.inf)
        self.normal = np.zeros((count, 3)) if normals else None

    def closer(self, ray: Indices, distance: Array) -> Indices:
        """Take what is closer than everything so far, and say which of these it is.

        Args:
            ray: (K,) rays, each as often as it meets something.
            distance: (K,) where [m]; infinite where it does not.
        """
        before = self.distance[ray]
        np.minimum.at(self.distance, ray, distance)
        if self.normal is None:
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero((distance < before) & (distance == self.distance[ray]))


coal: Any = _coal  # compiled, without type stubs

_TINY = 1e-14
_BOX, _SPHERE, _CYLINDER, _CAPSULE, _CONE = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class Primitives:
    """Shapes that formulas exist for, in the order of their kinds.

    Attributes:
        row: (P,) which of the geometries they were made of each is.
        kind: (P,) ascending.
        size: (P, 3) half lengths of a box; else radius, half length along z, 0 [m].
        radius: (P,) of spheres about the shapes' origins that hold them [m].
    """

    row: Indices
    kind: npt.NDArray[np.intp]
    size: Array
    radius: Array

    @staticmethod
    def of(geometries: Sequence[Any], padding: float = 0.0) -> Primitives:
        """The primitives among Coal geometries, each thicker by ``padding`` [m]; of cones only unpadded ones."""
        found = [(kind, k, size) for k, g in enumerate(geometries) for kind, size in _measured(g, padding)]
        found.sort()
        kind = np.array([f[0] for f in found], dtype=np.intp)
        size = np.array([f[2] for f in found]).reshape(-1, 3)
        radius = np.linalg.norm(size, axis=1)
        radius[kind == _CAPSULE] = size[kind == _CAPSULE, :2].sum(axis=1)
        return Primitives(np.array([f[1] for f in found], dtype=np.intp), kind, size, radius)

    def __len__(self) -> int:
        return len(self.kind)

    def cast(
        self, rotation: Array, translation: Array, rays: Rays, nearest: Nearest, *, reach: float, inside: float
    ) -> bool:
        """Look where rays meet these shapes.

        Args:
            rotation: (P, 3, 3) of the shapes' frames in the rays' frame.
            translation: (P, 3) their origins [m].
            rays: the beams.
            nearest: takes what is nearer than what it has.
            reach: how far the beams go [m]; what is further may be left out.
            inside: distance [m] that a beam gets that begins inside a shape.

        Returns:
            Whether any beam came near any of them.
        """
        piece, ray = rays.near(translation, self.radius, reach)
        if len(piece) == 0:
            return False
        bounds = np.searchsorted(self.kind[piece], np.arange(len(_SHAPES) + 1))
        origins = rays.origin if len(rays.origin) > 1 else np.broadcast_to(rays.origin, rays.direction.shape)
        for (interval, normal), begin, end in zip(_SHAPES, bounds[:-1], bounds[1:], strict=True):
            if begin == end:
                continue
            p, r = piece[begin:end], ray[begin:end]
            turn, size = rotation[p], self.size[p]
            o = np.matmul((origins[r] - translation[p])[:, None, :], turn)[:, 0]
            d = np.matmul(rays.direction[r][:, None, :], turn)[:, 0]
            enter, leave = interval(o, d, size)
            distance = np.where(enter < 0.0, inside, enter)
            distance[~((leave >= 0.0) & (leave >= enter))] = np.inf
            won = nearest.closer(r, distance)
            if nearest.normal is not None and len(won):
                local = normal(o[won] + distance[won, None] * d[won], size[won])
                nearest.normal[r[won]] = np.matmul(turn[won], local[:, :, None])[..., 0]
        return True


def is_primitive(geometry: Any, padding: float = 0.0) -> bool:
    """Whether a Coal geometry, made thicker by ``padding`` [m], has formulas here."""
    return bool(_measured(geometry, padding))


def _measured(geometry: Any, padding: float) -> list[tuple[int, tuple[float, float, float]]]:
    """Kind and size of a Coal geometry; empty where there are no formulas."""
    if isinstance(geometry, coal.Box):
        x, y, z = (float(h) + padding for h in geometry.halfSide)
        return [(_BOX, (x, y, z))]
    if isinstance(geometry, coal.Sphere):
        return [(_SPHERE, (float(geometry.radius) + padding, 0.0, 0.0))]
    for kind, form in ((_CYLINDER, coal.Cylinder), (_CAPSULE, coal.Capsule), (_CONE, coal.Cone)):
        if isinstance(geometry, form):
            r, h = float(geometry.radius), float(geometry.halfLength)
            if kind == _CONE and padding > 0.0:
                return []  # a thicker one would have another origin
            return [(kind, (r + padding, h + (padding if kind == _CYLINDER else 0.0), 0.0))]
    return []


def _slab(o: Array, d: Array, half: Array) -> tuple[Array, Array]:
    """Between the planes at ± half; arrays of any shape."""
    inverse = 1.0 / np.where(np.abs(d) < _TINY, np.copysign(_TINY, d), d)
    a, b = (-half - o) * inverse, (half - o) * inverse
    return np.minimum(a, b), np.maximum(a, b)


def _disc(o: Array, d: Array, radius: Array) -> tuple[Array, Array]:
    """Within a radius of the origin, in two or three dimensions: o, d (K, n)."""
    a, b = np.einsum("ij,ij->i", d, d), np.einsum("ij,ij->i", o, d)
    along = a > _TINY
    c = np.einsum("ij,ij->i", o, o) - radius * radius
    a = np.where(along, a, 1.0)
    foot = o - (b / a)[:, None] * d  # where the line is nearest; better than b² − a c, which cancels far away
    depth = (radius * radius - np.einsum("ij,ij->i", foot, foot)) / a
    hit = depth >= 0.0
    root = np.sqrt(np.where(hit, depth, 0.0))
    enter, leave = -b / a - root, -b / a + root
    still = ~along
    enter[~hit], leave[~hit] = np.inf, -np.inf
    enter[still] = np.where(c[still] <= 0.0, -np.inf, np.inf)
    leave[still] = np.where(c[still] <= 0.0, np.inf, -np.inf)
    return enter, leave


def _box(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    enter, leave = _slab(o, d, size)
    return enter.max(axis=1), leave.min(axis=1)


def _sphere(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    return _disc(o, d, size[:, 0])


def _cylinder(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    enter, leave = _disc(o[:, :2], d[:, :2], size[:, 0])
    low, high = _slab(o[:, 2], d[:, 2], size[:, 1])
    return _both(enter, leave, low, high)


def _capsule(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    enter, leave = _cylinder(o, d, size)
    for sign in (-1.0, 1.0):
        end = o.copy()
        end[:, 2] -= sign * size[:, 1]
        first, last = _disc(end, d, size[:, 0])
        enter, leave = np.minimum(enter, first), np.maximum(leave, last)
    return enter, leave


def _cone(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    """ρ ≤ k w, where w is how far below the apex: the borders that a beam crosses, side (twice) and base."""
    r, half = size[:, 0], size[:, 1]
    k = r / (2.0 * half)
    w, dw = half - o[:, 2], -d[:, 2]
    a = d[:, 0] ** 2 + d[:, 1] ** 2 - (k * dw) ** 2
    b = o[:, 0] * d[:, 0] + o[:, 1] * d[:, 1] - k * k * w * dw
    c = o[:, 0] ** 2 + o[:, 1] ** 2 - (k * w) ** 2
    straight = np.abs(a) < 1e-12  # parallel to the side
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    real = (b * b - a * c >= 0.0) | straight
    big = -(b + np.copysign(root, b))  # the root that does not cancel
    t1 = big / np.where(straight, 1.0, a)
    t2 = c / np.where(np.abs(big) < _TINY, _TINY, big)
    t3 = (2.0 * half - w) / np.where(np.abs(dw) < _TINY, np.copysign(_TINY, dw), dw)
    enter, leave = np.full(len(o), np.inf), np.full(len(o), -np.inf)
    for t, side in ((t1, real & ~straight), (t2, real)):
        at = w + t * dw
        good = side & (at >= -1e-12) & (at <= 2.0 * half + 1e-12)
        enter, leave = np.where(good, np.minimum(enter, t), enter), np.where(good, np.maximum(leave, t), leave)
    rim = np.hypot(o[:, 0] + t3 * d[:, 0], o[:, 1] + t3 * d[:, 1]) <= r
    return np.where(rim, np.minimum(enter, t3), enter), np.where(rim, np.maximum(leave, t3), leave)


def _both(enter: Array, leave: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """What two intervals share; nothing is an interval that enters at infinity."""
    enter, leave = np.maximum(enter, low), np.minimum(leave, high)
    none = ~(enter <= leave)
    enter[none], leave[none] = np.inf, -np.inf
    return enter, leave


def _unit(v: Array) -> Array:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), _TINY)


def _box_normal(p: Array, size: Array) -> Array:
    axis = np.argmin(size - np.abs(p), axis=1)
    out = np.zeros_like(p)
    rows = np.arange(len(p))
    out[rows, axis] = np.sign(p[rows, axis])
    return out


def _sphere_normal(p: Array, size: Array) -> Array:
    return _unit(p)


def _cylinder_normal(p: Array, size: Array) -> Array:
    side = p * (1.0, 1.0, 0.0)
    cap = size[:, 1] - np.abs(p[:, 2]) < size[:, 0] - np.hypot(p[:, 0], p[:, 1])
    return _unit(np.where(cap[:, None], p * (0.0, 0.0, 1.0), side))


def _capsule_normal(p: Array, size: Array) -> Array:
    out = p.copy()
    out[:, 2] -= np.clip(p[:, 2], -size[:, 1], size[:, 1])
    return _unit(out)


def _cone_normal(p: Array, size: Array) -> Array:
    r, half = size[:, 0], size[:, 1]
    rho = np.hypot(p[:, 0], p[:, 1])
    slope = np.hypot(r, 2.0 * half)
    to_side = (r * (half - p[:, 2]) / (2.0 * half) - rho) * 2.0 * half / slope
    side = _unit(p * (1.0, 1.0, 0.0)) * (2.0 * half / slope)[:, None]
    side[:, 2] = r / slope
    base = (p[:, 2] + half < to_side)[:, None]
    return np.where(base, np.array([0.0, 0.0, -1.0]), _unit(side))  # at the apex the side has no direction of its own


_Interval = Callable[[Array, Array, Array], tuple[Array, Array]]
_SHAPES: tuple[tuple[_Interval, Callable[[Array, Array], Array]], ...] = (
    (_box, _box_normal),
    (_sphere, _sphere_normal),
    (_cylinder, _cylinder_normal),
    (_capsule, _capsule_normal),
    (_cone, _cone_normal),
)


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


class ObstacleRays:
    """Workspace: the obstacles of a world as beams meet them.

    Args:
        world: where the obstacles are; what it holds is made ready here.

    Raises:
        MissingExtraError: an obstacle is a hull, a mesh, voxels or points, and Embree is not installed.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._primitives: tuple[tuple[Part, ...], Primitives] = (), Primitives.of([])
        self._own: dict[str, TriangleBody] = {}
        made: dict[int, TriangleBody] = {}
        still: list[tuple[Array, list[Corners]]] = []
        for obstacle in world.scene:
            name, meshes = obstacle.name or "", _meshes(obstacle)
            if not meshes:
                continue
            if obstacle.motion is None and name not in world.appears and name not in world.vanishes:
                still.append((obstacle.pose, meshes))
                continue
            shape = id(obstacle.solid)  # copies share it, and the world keeps it
            if shape not in made:
                made[shape] = TriangleBody(meshes)
            self._own[name] = made[shape]
        self._still = joined(still) if still else None

    def cast(self, t: float, rays: Rays, reach: float, *, normals: bool = False) -> Nearest:
        """Where rays, given in the world, first meet an obstacle at time ``t`` [s].

        Args:
            t: the time.
            rays: the beams; one that begins inside an obstacle has the distance 0.
            reach: how far they go [m].
            normals: whether the normals of the surfaces are wanted.

        Returns:
            Distances are infinite beyond ``reach``.
        """
        scene, nearest = self.world.at(t), Nearest(len(rays), normals=normals)
        table = scene.table
        primitives = self._of(scene)
        rows = primitives.row
        primitives.cast(table.rotation[rows], table.translation[rows], rays, nearest, reach=reach, inside=0.0)
        if self._still is not None:
            self._still.cast(np.eye(4), rays, nearest, reach=reach, inside=0.0)
        for name, body in self._own.items():
            if name in scene:
                body.cast(scene.obstacle(name).pose, rays, nearest, reach=reach, inside=0.0)
        nearest.distance[nearest.distance > reach] = np.inf
        return nearest

    def _of(self, scene: Scene) -> Primitives:
        """The primitives among a scene's parts; made anew where other obstacles exist than the last time."""
        parts = scene.table.parts
        if self._primitives[0] is not parts:
            self._primitives = parts, Primitives.of([p.geometry for p in parts])
        return self._primitives[1]


def _meshes(obstacle: Obstacle) -> list[Corners]:
    """Triangles of an obstacle's parts that are no primitives, in its frame."""
    return [m for part in obstacle.parts if not is_primitive(part.geometry) for m in part_meshes(part)]


_FAR = 1e3  # [m] beyond any robot


class OwnBody:
    """Workspace: a robot's own collision bodies before the beams of one sensor or ring.

    Bodies that are fixed to the joint that carries a sensor never move before it: they are looked at once, as they are.
    The others may be thicker by the padding. A body in which a beam begins is the sensor's housing, and hides nothing.

    Args:
        posture: of the robot.
        joint: (R,) joints that carry the beams.
        local: the beams in the joints' frames.
        padding: of the bodies that move before the sensor [m].

    Raises:
        MissingExtraError: a body has no formulas, and Embree is not installed.
    """

    def __init__(self, posture: Posture, joint: npt.NDArray[np.intp], local: Rays, padding: float) -> None:
        self._posture = posture
        pieces = posture.robot.geometries
        at_rest = np.tile(np.eye(4), (len(posture.T_world_joint), 1, 1))
        self._fixed = np.full(len(local), np.inf)
        self._groups: list[tuple[npt.NDArray[np.intp], list[_Bodies]]] = []
        for j in np.unique(joint):
            rays = np.flatnonzero(joint == j)
            nearest = Nearest(len(rays))
            _Bodies([p for p in pieces if p.joint == j], 0.0).cast(at_rest, local.some(rays), nearest, _FAR)
            self._fixed[rays] = nearest.distance
            others = [p for p in pieces if p.joint != j]
            paddings = (padding, 0.0) if padding > 0.0 else (0.0,)
            self._groups.append((rays, [_Bodies(others, thick) for thick in paddings]))

    def distances(self, rays: Rays, reach: float) -> Array:
        """How far (R,) [m] the beams, now given in the world, go before they meet the robot; infinite beyond reach."""
        out = self._fixed.copy()
        for index, layers in self._groups:
            nearest = Nearest(len(index))
            some = rays if len(index) == len(out) else rays.some(index)
            for bodies in layers:  # the bare ones for beams that begin within the padding
                if not bodies.cast(self._posture.T_world_joint, some, nearest, reach):
                    break
            out[index] = np.minimum(out[index], nearest.distance)
        out[out > reach] = np.inf
        return out


class _Bodies:
    """Some of a robot's collision bodies, thicker by a padding [m], as beams meet them."""

    def __init__(self, pieces: Sequence[LinkGeometry], padding: float) -> None:
        simple = [p for p in pieces if is_primitive(p.geometry, padding)]
        self._primitives = Primitives.of([p.geometry for p in simple], padding)
        order = self._primitives.row
        self._joint = np.array([p.joint for p in simple], dtype=np.intp)[order]
        self._local = np.array([p.placement for p in simple]).reshape(-1, 4, 4)[order]
        self._hulls = [
            (p.joint, p.placement, TriangleBody([hull_mesh(p.geometry, padding)]))
            for p in pieces
            if not is_primitive(p.geometry, padding)
        ]

    def cast(self, T_joint: Array, rays: Rays, nearest: Nearest, reach: float) -> bool:
        """Look where rays meet the bodies, whose joints are at ``T_joint`` (njoints, 4, 4) in the rays' frame.

        Returns:
            Whether any beam came near any of them.
        """
        T = T_joint[self._joint] @ self._local
        near = self._primitives.cast(T[:, :3, :3], T[:, :3, 3], rays, nearest, reach=reach, inside=np.inf)
        for joint, placement, body in self._hulls:
            near |= body.cast(T_joint[joint] @ placement, rays, nearest, reach=reach, inside=np.inf)
        return near
