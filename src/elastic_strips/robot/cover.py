"""Cover: parts of a robot that no convex piece holds, so that nothing is proven about them; how far pieces stick out.

Both are found by points all over a surface, so the largest distance is at least the one that is given.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import ShapeKind, box_about, faces, outside, shape_of, support, support_points, vertices
from elastic_strips.decompose import Surface
from elastic_strips.hulls import convex_hull

from .geometry import LinkGeometry

_COVER_SLACK = 0.005  # [m]: what reaches beyond the pieces by less is covered
_MOST_POINTS = 4000  # of a shape that are looked at
_SURFACE_SPOTS = 250  # on the surface of a piece, by area, and as many middles of triangles
_DIRECTIONS = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


def uncovered(model: pin.Model, drawn: pin.GeometryModel, pieces: Sequence[LinkGeometry]) -> tuple[str, ...]:
    """The links whose drawn shapes reach out of all pieces that move with them, by more than 5 mm.

    Args:
        model: the planned model.
        drawn: visual geometry on it of the links that have no collision shape.
        pieces: the convex pieces of the robot.
    """
    own: dict[int, list[LinkGeometry]] = defaultdict(list)
    for piece in pieces:
        own[piece.joint].append(piece)
    found: dict[str, None] = {}
    for item in drawn.geometryObjects:
        link = str(model.frames[item.parentFrame].name)
        if link in found:
            continue
        points = _points(item)
        T = np.array(item.placement.homogeneous)
        if len(points) and _reach(points @ T[:3, :3].T + T[:3, 3], own[item.parentJoint]) > _COVER_SLACK:
            found[link] = None
    return tuple(found)


def _points(item: pin.GeometryObject) -> Array:
    """Points (V, 3) all over a shape, its outermost ones among them, in its frame."""
    rng = np.random.default_rng(0)
    if shape_of(item.geometry)[0] is ShapeKind.MESH:
        corners, triangles = vertices(item.geometry), faces(item.geometry)
        if not len(triangles) or not np.isfinite(corners).all():
            return np.zeros((0, 3))
        some = rng.choice(len(triangles), min(len(triangles), _MOST_POINTS), replace=False)
        outermost = corners[np.unique(np.argmax(corners @ _DIRECTIONS.T, axis=0))]
        weights = rng.dirichlet(np.ones(3), len(some))
        within = np.einsum("tk,tkx->tx", weights, corners[triangles[some]])
        return np.vstack((outermost, corners[triangles[some, 0]], within))
    corners, radius = support_points(item.geometry)
    if radius > 0.0:
        corners = (corners[:, None, :] + radius * _DIRECTIONS[None]).reshape(-1, 3)
    return np.vstack((corners, rng.dirichlet(np.ones(len(corners)), 200) @ corners))


def _reach(points: Array, pieces: Sequence[LinkGeometry]) -> float:
    """How far [m] the farthest of points (V, 3) in a joint's frame is out of all of its pieces; inf without any."""
    least = np.full(len(points), np.inf)
    for piece in pieces:
        local = (points - piece.placement[:3, 3]) @ piece.placement[:3, :3]
        least = np.minimum(least, outside(piece.geometry, local))
    return float(least.max())


def sticks_out(model: pin.Model, shapes: pin.GeometryModel, piece: LinkGeometry) -> float:
    """How far [m] a piece reaches out of the shapes that it stands for: the largest distance found.

    Args:
        model: the planned model.
        shapes: its collision geometry as the file describes it.
        piece: one of the robot's pieces.
    """
    own = [
        item
        for item in shapes.geometryObjects
        if item.parentJoint == piece.joint and str(model.frames[item.parentFrame].name) in piece.links
    ]
    if not own:
        return 0.0
    points = _surface(piece.geometry)
    points = points @ piece.placement[:3, :3].T + piece.placement[:3, 3]
    request, result, dot = coal.DistanceRequest(False), coal.DistanceResult(), coal.Sphere(1e-9)
    least = np.full(len(points), np.inf)
    for item in own:
        pose = coal.Transform3s(item.placement.rotation, item.placement.translation)
        if shape_of(item.geometry)[0] is not ShapeKind.MESH:
            T = np.array(item.placement.homogeneous)
            least = np.minimum(least, np.maximum(outside(_solid(item.geometry), (points - T[:3, 3]) @ T[:3, :3]), 0.0))
            continue
        for k, point in enumerate(points):
            result.clear()
            distance = coal.distance(dot, coal.Transform3s(np.eye(3), point), item.geometry, pose, request, result)
            least[k] = min(least[k], max(distance, 0.0))
    # meshes are hollow to Coal: what is deep inside of one does not reach out of it
    meshes = [item for item in own if shape_of(item.geometry)[0] is ShapeKind.MESH and _is_part(piece, item)]
    surfaces = [(item.placement, Surface.of(vertices(item.geometry), faces(item.geometry))) for item in meshes]
    for k in np.argsort(-least):
        if not any(surface.encloses(pose.inverse().act(points[k])) for pose, surface in surfaces):
            return float(least[k])
    return 0.0


def _is_part(piece: LinkGeometry, item: pin.GeometryObject) -> bool:
    """Whether a mesh reaches beyond a piece: a piece that holds all of it has none of its surface inside the mesh."""
    R, t = piece.placement[:3, :3], piece.placement[:3, 3]
    corners = vertices(item.geometry) @ np.asarray(item.placement.rotation).T + np.asarray(item.placement.translation)
    reach = support(piece.geometry, _DIRECTIONS @ R) + _DIRECTIONS @ t
    return bool(((corners @ _DIRECTIONS.T).max(axis=0) > reach + 1e-6).any())


def _solid(geometry: coal.CollisionGeometry) -> coal.CollisionGeometry:
    return box_about(geometry) if shape_of(geometry)[0] is ShapeKind.ELLIPSOID else geometry


def _surface(geometry: coal.CollisionGeometry) -> Array:
    """Points (V, 3) all over the surface of a convex shape, in its frame."""
    rng, (kind, size) = np.random.default_rng(0), shape_of(geometry)
    if kind is not ShapeKind.CONVEX:
        corners, radius = support_points(geometry)
        if kind in (ShapeKind.CYLINDER, ShapeKind.CONE):  # whose corners are around the circle, and not on it
            corners = corners * [*[size[0] / np.hypot(*corners[:, :2].T).max()] * 2, 1.0]
        return (corners[:, None, :] + radius * _DIRECTIONS[None]).reshape(-1, 3) if radius else corners
    corners = vertices(geometry)
    hull = convex_hull(corners)
    sides = corners[hull.simplices]  # (T, 3, 3)
    area = np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    chosen = rng.choice(len(sides), _SURFACE_SPOTS, p=area / area.sum())
    largest = np.argsort(area)[-_SURFACE_SPOTS:]
    spread = np.einsum("tk,tkx->tx", rng.dirichlet(np.ones(3), _SURFACE_SPOTS), sides[chosen])
    return np.vstack((sides[largest].mean(axis=1), spread))
