"""Bodies that rays are cast against: the obstacles of a world, and the robot that carries the sensors.

Primitive shapes are intersected in closed form (`rays`). All other obstacles are triangles: static ones share one tree
of boxes, each other one has its own in its frame, so that no tree is rebuilt as it moves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import ShapeKind, shape_of, support_points, vertices
from elastic_strips.errors import ConfigurationError, RobotError, missing_extra, nearest_name
from elastic_strips.robot import RobotModel
from elastic_strips.robot.geometry import LinkGeometry
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.scene import Obstacle, Scene, World
from elastic_strips.scene.parts import Part

from .rays import Nearest, Primitives, Rays, is_primitive

_NAMES = {"laser": r"laser(_\d+)?_frame", "sonar": r"sonar_\d+_frame", "infrared": r"ir_\d+_frame"}


def sensor_frames(robot: RobotModel) -> dict[str, tuple[str, ...]]:
    """Links that by their names are range sensors, in the order of their numbers.

    Args:
        robot: the robot of the links.

    Returns:
        ``"laser"`` (``laser_frame``, ``laser_0_frame``, …), ``"sonar"`` (``sonar_0_frame``, …) and ``"infrared"``
        (``ir_0_frame``, …) with the names found; empty where there are none.
    """
    names = _links(robot)
    return {
        kind: tuple(sorted((n for n in names if re.fullmatch(pattern, n)), key=_number))
        for kind, pattern in _NAMES.items()
    }


def _number(name: str) -> int:
    digits = re.search(r"\d+", name)
    return int(digits[0]) if digits else -1


def _links(robot: RobotModel) -> list[str]:
    return sorted({f.name for f in robot.model.frames if f.type == pin.FrameType.BODY})


class Posture:
    """Workspace: poses of a robot's joints in the world, at one coordinate row.

    Args:
        robot: the robot.

    Attributes:
        T_world_joint: (njoints, 4, 4) poses of the joints' frames.
        T_base_world: (4, 4) pose of the world in the base's frame, which is the world's for a fixed base.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self._data = robot.model.createData()
        self.T_world_joint: Array = np.tile(np.eye(4), (robot.model.njoints, 1, 1))
        self.T_base_world: Array = np.eye(4)

    def place(self, coordinates: Array) -> None:
        """Put the robot at a coordinate row (nv,).

        Raises:
            ConfigurationError: the row has another size or is not finite.
        """
        row = np.asarray(coordinates, dtype=float)
        if row.shape != (self.robot.nv,) or not np.isfinite(row).all():
            raise ConfigurationError(
                f"coordinates={row!r} must be {self.robot.nv} finite numbers for {self.robot.name!r}"
            )
        pin.forwardKinematics(self.robot.model, self._data, self.robot.space.from_coordinates(row))
        for j in range(1, len(self.T_world_joint)):
            self.T_world_joint[j] = self._data.oMi[j].homogeneous
        if self.robot.space.planar:
            T = self.T_world_joint[1]
            self.T_base_world[:3, :3] = T[:3, :3].T
            self.T_base_world[:3, 3] = -T[:3, :3].T @ T[:3, 3]


class SensorMount:
    """Sensors that are fixed to links of a robot.

    Args:
        posture: posture of the robot.
        frames: names of the links.

    Attributes:
        joint: (S,) joints that carry them.
        T_joint_sensor: (S, 4, 4) their poses in the joints' frames.

    Raises:
        RobotError: the robot has no such link; the message lists its links.
    """

    def __init__(self, posture: Posture, frames: Sequence[str]) -> None:
        self._posture = posture
        robot, joint, local = posture.robot, [], []
        for name in frames:
            index = find_frame(robot.model, name)
            if index is None:
                links = _links(robot)
                near = nearest_name(name, links).split(" Valid:")[0]
                raise RobotError(f"{robot.name!r} has no link {name!r} for a sensor{near} It has: {', '.join(links)}.")
            frame = robot.model.frames[index]
            joint.append(frame.parentJoint)
            local.append(frame.placement.homogeneous)
        self.joint: npt.NDArray[np.intp] = np.array(joint, dtype=np.intp)
        self.T_joint_sensor: Array = np.array(local)

    def poses(self) -> tuple[Array, Array]:
        """Poses (S, 4, 4) of the sensors in the world and in the base's frame."""
        world = self._posture.T_world_joint[self.joint] @ self.T_joint_sensor
        return world, self._posture.T_base_world @ world


_Corners = tuple[Array, npt.NDArray[np.int64]]
"""Vertices (V, 3) [m] and triangles (F, 3)."""

_FARTHEST_HIT = 1e30  # [m] Embree returns 1e37 without a hit
_BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def _import_embree() -> tuple[Any, Any]:
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


class _TriangleBody:
    """Workspace: closed meshes in one frame (outside right-handed), in one tree of boxes that is built once."""

    def __init__(self, meshes: Iterable[_Corners]) -> None:
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
        make_scene, make_mesh = _import_embree()
        self._scene = make_scene(robust=True)  # no beam slips through between two triangles
        self._mesh = make_mesh(
            self._scene, (points - self.center).astype(np.float32), np.ascontiguousarray(triangles, dtype=np.int32)
        )

    def cast(self, T: Array, rays: Rays, nearest: Nearest, *, reach: float, inside: float) -> bool:
        """Intersect rays with the meshes, whose frame has the pose T (4, 4); as :meth:`Primitives.cast`."""
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
        hit = np.flatnonzero(met["tfar"] < _FARTHEST_HIT)
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


def _part_meshes(part: Part) -> list[_Corners]:
    """Triangles of a part of an obstacle, in the obstacle's frame."""
    shift = part.T_obstacle_part[:3, 3]
    if part.geometry is not None:
        points, faces = _hull_mesh(part.geometry)
        return [(points + shift, faces)]
    half = np.array([box.halfSide for box, _ in part.boxes])
    middle = np.array([at for _, at in part.boxes]) + shift
    points = (middle[:, None] + half[:, None] * _BOX_CORNERS).reshape(-1, 3)
    faces = (_BOX_FACES + 8 * np.arange(len(half))[:, None, None]).reshape(-1, 3)
    return [(points, faces)]


def _hull_mesh(geometry: coal.CollisionGeometry, padding: float = 0.0) -> _Corners:
    """Triangles of a convex Coal shape, in its frame.

    Args:
        geometry: the shape; round ones become polyhedra that contain them.
        padding: by how much it is made thicker at least [m]; corners grow by √3 times that.
    """
    if padding == 0.0 and shape_of(geometry)[0] is ShapeKind.CONVEX:
        points = vertices(geometry)
    else:
        points, radius = support_points(geometry)
        points = (points[:, None] + (radius + padding) * _BOX_CORNERS).reshape(-1, 3)
    return _hull(points)


def _hull(points: Array) -> _Corners:
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
    """Workspace: the obstacles of a world, to cast rays against.

    Args:
        world: the obstacles over time.

    Raises:
        MissingExtraError: an obstacle is a hull, a mesh, voxels or points, and Embree is not installed.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._primitives: tuple[tuple[Part, ...], Primitives] = (), Primitives.of([])
        self._own: dict[str, _TriangleBody] = {}
        made: dict[int, _TriangleBody] = {}
        still: list[_Corners] = []
        for obstacle in world.scene:
            name, meshes = obstacle.name or "", _meshes(obstacle)
            if not meshes:
                continue
            if obstacle.motion is None and name not in world.appears and name not in world.vanishes:
                T = obstacle.pose
                still += [(points @ T[:3, :3].T + T[:3, 3], faces) for points, faces in meshes]
                continue
            shape = id(obstacle.solid)  # copies share it, and the world keeps it
            if shape not in made:
                made[shape] = _TriangleBody(meshes)
            self._own[name] = made[shape]
        self._still = _TriangleBody(still) if still else None

    def cast(self, t: float, rays: Rays, reach: float, *, normals: bool = False) -> Nearest:
        """First hits of rays in the world frame, at time ``t`` [s].

        Args:
            t: the time [s].
            rays: rays to cast; one that begins inside an obstacle has the distance 0.
            reach: their length [m].
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
        """The primitives among a scene's parts; kept while the same obstacles exist."""
        parts = scene.table.parts
        if self._primitives[0] is not parts:
            self._primitives = parts, Primitives.of([p.geometry for p in parts])
        return self._primitives[1]


def _meshes(obstacle: Obstacle) -> list[_Corners]:
    """Triangles of an obstacle's parts that are not primitives, in its frame."""
    return [m for part in obstacle.parts if not is_primitive(part.geometry) for m in _part_meshes(part)]


_BEYOND_ROBOT = 1e3  # [m] beyond any robot


class SelfFilter:
    """Workspace: a robot's own collision bodies in the rays of one sensor or ring.

    Bodies on a sensor's own joint never move relative to it: rays are cast against them once, without padding. The
    others are thicker by the padding. A body in which a ray begins is the sensor's housing, and ignored.

    Args:
        posture: posture of the robot.
        joint: (R,) joints that carry the rays.
        local: the rays in the joints' frames.
        padding: padding of the bodies that move before the sensor [m].

    Raises:
        MissingExtraError: a body is not a primitive, and Embree is not installed.
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
            _Bodies([p for p in pieces if p.joint == j], 0.0).cast(at_rest, local.some(rays), nearest, _BEYOND_ROBOT)
            self._fixed[rays] = nearest.distance
            others = [p for p in pieces if p.joint != j]
            paddings = (padding, 0.0) if padding > 0.0 else (0.0,)
            self._groups.append((rays, [_Bodies(others, thick) for thick in paddings]))

    def distances(self, rays: Rays, reach: float) -> Array:
        """Distances (R,) [m] at which the rays, now in the world frame, hit the robot; infinite beyond reach."""
        out = self._fixed.copy()
        for index, layers in self._groups:
            nearest = Nearest(len(index))
            some = rays if len(index) == len(out) else rays.some(index)
            for bodies in layers:  # without padding for rays that begin within it
                if not bodies.cast(self._posture.T_world_joint, some, nearest, reach):
                    break
            out[index] = np.minimum(out[index], nearest.distance)
        out[out > reach] = np.inf
        return out


class _Bodies:
    """Some of a robot's collision bodies, thicker by a padding [m], to cast rays against."""

    def __init__(self, pieces: Sequence[LinkGeometry], padding: float) -> None:
        simple = [p for p in pieces if is_primitive(p.geometry, padding)]
        self._primitives = Primitives.of([p.geometry for p in simple], padding)
        order = self._primitives.row
        self._joint = np.array([p.joint for p in simple], dtype=np.intp)[order]
        self._local = np.array([p.placement for p in simple]).reshape(-1, 4, 4)[order]
        self._hulls = [
            (p.joint, p.placement, _TriangleBody([_hull_mesh(p.geometry, padding)]))
            for p in pieces
            if not is_primitive(p.geometry, padding)
        ]

    def cast(self, T_joint: Array, rays: Rays, nearest: Nearest, reach: float) -> bool:
        """Intersect rays with the bodies; their joints are at ``T_joint`` (njoints, 4, 4) in the rays' frame."""
        T = T_joint[self._joint] @ self._local
        near = self._primitives.cast(T[:, :3, :3], T[:, :3, 3], rays, nearest, reach=reach, inside=np.inf)
        for joint, placement, body in self._hulls:
            near |= body.cast(T_joint[joint] @ placement, rays, nearest, reach=reach, inside=np.inf)
        return near
