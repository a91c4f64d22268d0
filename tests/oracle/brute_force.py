"""Brute force: every distance by Coal at Pinocchio's placements, sharing nothing with the library's proximity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy import spatial

from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Capsule, Cone, ConvexHull, Cylinder, Mesh, Obstacle, Points, Scene, Sphere, Voxels

Array = npt.NDArray[np.float64]
SHAPES = ("box", "sphere", "cylinder", "capsule", "cone", "convex", "mesh", "voxels", "points")
_REQUEST, _FINE = coal.DistanceRequest(True), coal.DistanceRequest(True)
_RESULTS = coal.DistanceResult(), coal.DistanceResult()
_FINE.gjk_tolerance = _FINE.epa_tolerance = 1e-12


@dataclass(frozen=True, slots=True)
class Piece:
    """One convex Coal shape of a scene in the world; ``part`` is its row of ``scene.table``."""

    obstacle: str
    part: int
    geometry: Any
    T: Array


def distance(one: Any, T_one: Array, two: Any, T_two: Array) -> tuple[float, Array, Array, Array]:
    """Signed distance, Coal's normal (from one to two) and the witness points on one and on two."""
    d, result = _measure(one, transform(T_one), two, transform(T_two))
    return d, np.array(result.normal), np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())


def _measure(one: Any, pose_one: Any, two: Any, pose_two: Any) -> tuple[float, Any]:
    """Signed distance, and Coal's result, which the next call overwrites."""
    if type(one) is coal.Sphere and type(two) is coal.Cylinder:  # their closed form forgets the caps
        one = coal.Capsule(one.radius, 0.0)
    elif type(one) is coal.Cylinder and type(two) is coal.Sphere:
        two = coal.Capsule(two.radius, 0.0)
    for result in _RESULTS:
        result.clear()
    usual = coal.distance(one, pose_one, two, pose_two, _REQUEST, _RESULTS[0])
    fine = coal.distance(one, pose_one, two, pose_two, _FINE, _RESULTS[1])
    # the fine solver does not always converge where shapes penetrate, and then returns nonsense
    return (fine, _RESULTS[1]) if abs(fine - usual) < 1e-4 else (usual, _RESULTS[0])


def transform(T: Array) -> Any:
    """A homogeneous matrix (4, 4) for Coal."""
    return coal.Transform3s(np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]))


def outside(points: Array, shape: Any) -> Array:
    """How far (V,) [m] points in a shape's frame stick out of it, 0 on its surface: without Coal's solvers."""
    if isinstance(shape, coal.Box):
        return (np.abs(points) - np.asarray(shape.halfSide)).max(axis=1)
    if isinstance(shape, coal.Sphere):
        return np.linalg.norm(points, axis=1) - shape.radius
    around = np.hypot(points[:, 0], points[:, 1])
    if isinstance(shape, coal.Capsule):
        return np.hypot(around, np.maximum(np.abs(points[:, 2]) - shape.halfLength, 0.0)) - shape.radius
    if isinstance(shape, coal.Cylinder):
        return np.maximum(around - shape.radius, np.abs(points[:, 2]) - shape.halfLength)
    if isinstance(shape, coal.Cone):
        height = 2.0 * shape.halfLength
        side = (around - shape.radius * (shape.halfLength - points[:, 2]) / height) * height
        return np.maximum(side / np.hypot(height, shape.radius), -shape.halfLength - points[:, 2])
    hull = spatial.ConvexHull(np.asarray(shape.points()))
    return (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)


def support(shape: Any, n: Array) -> Array:
    """Support values (K,) [m] of a shape in unit directions (K, 3) of its frame, by the textbook formulas."""
    flat = np.hypot(n[:, 0], n[:, 1])
    if isinstance(shape, coal.Box):
        return np.abs(n) @ np.asarray(shape.halfSide)
    if isinstance(shape, coal.Sphere):
        return np.full(len(n), shape.radius)
    if isinstance(shape, coal.Cylinder):
        return flat * shape.radius + np.abs(n[:, 2]) * shape.halfLength
    if isinstance(shape, coal.Capsule):
        return shape.radius + np.abs(n[:, 2]) * shape.halfLength
    if isinstance(shape, coal.Cone):
        return np.maximum(n[:, 2] * shape.halfLength, flat * shape.radius - n[:, 2] * shape.halfLength)
    if isinstance(shape, coal.Ellipsoid):
        return np.linalg.norm(n * np.asarray(shape.radii), axis=1)
    return (n @ np.asarray(shape.points()).T).max(axis=1)


def scene_pieces(scene: Scene) -> list[Piece]:
    """All convex shapes of a scene, blocks of boxes taken apart; from the obstacles, not from the scene's table."""
    pieces: list[Piece] = []
    row = 0
    for obstacle in scene:
        for part in obstacle.parts:
            T = obstacle.pose @ part.T_obstacle_part
            if part.geometry is not None:
                pieces.append(Piece(str(obstacle.name), row, part.geometry, T))
            for box, at in part.boxes:
                shift = np.eye(4)
                shift[:3, 3] = at
                pieces.append(Piece(str(obstacle.name), row, box, T @ shift))
            row += 1
    return pieces


def link_poses(robot: RobotModel, q: Array, data: Any = None) -> Array:
    """World poses (G, 4, 4) of the robot's convex pieces, by Pinocchio."""
    data = robot.model.createData() if data is None else data
    pin.forwardKinematics(robot.model, data, q)
    joints = [data.oMi[i].homogeneous for i in range(robot.model.njoints)]
    return np.array([joints[g.joint] @ g.placement for g in robot.geometries])


def link_distances(robot: RobotModel, scene: Scene, q: Array) -> Array:
    """Signed distances (G, P) [m] of every link to every part; of a block, to its nearest box."""
    links = [(link.geometry, transform(T)) for link, T in zip(robot.geometries, link_poses(robot, q), strict=True)]
    out = np.full((len(links), len(scene.table.parts)), np.inf)
    for piece in scene_pieces(scene):
        pose = transform(piece.T)
        for g, (link, at) in enumerate(links):
            d = _measure(link, at, piece.geometry, pose)[0]
            out[g, piece.part] = min(out[g, piece.part], d)
    return out


def self_distances(robot: RobotModel, q: Array) -> Array:
    """Signed distances (S,) [m] of the robot's self pairs."""
    links = [(link.geometry, transform(T)) for link, T in zip(robot.geometries, link_poses(robot, q), strict=True)]
    return np.array([_measure(*links[i], *links[k])[0] for i, k in robot.self_pairs])


def random_pose(rng: np.random.Generator, low: Any, high: Any) -> tuple[Array, Array]:
    """Position (3,) in a box and a uniform unit quaternion (4,)."""
    quat = rng.normal(size=4)
    return rng.uniform(low, high), quat / np.linalg.norm(quat)


_L_PROFILE = np.array([[0, 0], [0.5, 0], [0.5, 0.15], [0.15, 0.15], [0.15, 0.5], [0, 0.5]])


def l_profile() -> tuple[Array, npt.NDArray[np.int64]]:
    """Vertices and faces of a closed L-shaped prism 0.3 m high: the smallest solid mesh that is not convex."""
    n = len(_L_PROFILE)
    vertices = np.vstack([np.column_stack((_L_PROFILE, np.full(n, z))) for z in (0.0, 0.3)])
    top = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    faces = [[a, c, b] for a, b, c in top] + [[a + n, b + n, c + n] for a, b, c in top]
    for i in range(n):
        j = (i + 1) % n
        faces += [[i, j, j + n], [i, j + n, i + n]]
    return vertices, np.array(faces)


def make_obstacle(shape: str, rng: np.random.Generator, low: Any, high: Any) -> Obstacle:
    """A random obstacle of a shape, its origin in the box ``low``, ``high``, turned at random."""
    at, quat = random_pose(rng, low, high)
    where = {"at": at, "quat": quat}
    size = rng.uniform(0.05, 0.4, 3)
    if shape == "box":
        return Box(size, **where)
    if shape == "sphere":
        return Sphere(size[0] / 2, **where)
    if shape == "cylinder":
        return Cylinder(size[0] / 2, 2 * size[1], **where)
    if shape == "capsule":
        return Capsule(size[0] / 3, 2 * size[1], **where)
    if shape == "cone":
        return Cone(size[0] / 2, 2 * size[1], **where)
    if shape == "convex":
        return ConvexHull(rng.normal(size=(12, 3)) * size / 2, **where)
    if shape == "mesh":
        return Mesh(*l_profile(), **where)
    cells = np.unique(rng.integers(0, 6, (60, 3)), axis=0) * 0.1 - 0.3
    if shape == "voxels":
        return Voxels(cells, 0.1, **where)
    if shape == "points":
        return Points(rng.uniform(-0.3, 0.3, (25, 3)), 0.02, **where)
    raise ValueError(f"no shape {shape!r}")


def make_scene(
    rng: np.random.Generator,
    count: int = len(SHAPES),
    *,
    low: Any = (-1.5, -1.5, 0.0),
    high: Any = (1.5, 1.5, 1.5),
    shapes: tuple[str, ...] = SHAPES,
) -> Scene:
    """A random scene of ``count`` obstacles, all shapes in turn."""
    return Scene([make_obstacle(shapes[k % len(shapes)], rng, low, high) for k in range(count)])


def random_coordinates(
    robot: RobotModel, rng: np.random.Generator, count: int, *, low: Any = (-1.0, -1.0), high: Any = (1.0, 1.0)
) -> Array:
    """Coordinate rows (count, nv): joints anywhere within their limits, the base in a rectangle at any heading."""
    space = robot.space
    lower, upper = space.lower.copy(), space.upper.copy()
    wide = ~np.isfinite(lower) | ~np.isfinite(upper)
    lower[wide], upper[wide] = -np.pi, np.pi
    if space.planar:
        lower[:2], upper[:2] = low, high
    return rng.uniform(lower, upper, (count, space.nv))


def random_configurations(robot: RobotModel, rng: np.random.Generator, count: int, **region: Any) -> Array:
    """Configurations (count, nq), built without the library's own coordinates."""
    coordinates = random_coordinates(robot, rng, count, **region)
    return np.array([configuration(robot, row) for row in coordinates])


def configuration(robot: RobotModel, coordinates: Array) -> Array:
    """Pinocchio's configuration (nq,) of a coordinate row (nv,), joint by joint."""
    q = np.zeros(robot.model.nq)
    for joint in robot.model.joints:
        iq, iv = joint.idx_q, joint.idx_v
        if joint.nv == 3:
            q[iq : iq + 4] = (
                coordinates[iv],
                coordinates[iv + 1],
                np.cos(coordinates[iv + 2]),
                np.sin(coordinates[iv + 2]),
            )
        elif joint.nq == 2:
            q[iq : iq + 2] = np.cos(coordinates[iv]), np.sin(coordinates[iv])
        elif joint.nq == 1:
            q[iq] = coordinates[iv]
    return q
