"""Collision geometry of a robot: convex pieces with bounding capsules.

Meshes become convex hulls that contain them. Shapes inside another shape of the same body are dropped, and hulls
that hardly grow by being joined are joined: both keep containment.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Mask
from elastic_strips.coal_shapes import (
    SIGNS,
    ShapeKind,
    box_about,
    contains,
    convex_from_vertices,
    faces,
    shape_of,
    support_points,
    vertices,
)
from elastic_strips.decompose import few_pieces
from elastic_strips.hulls import convex_hull
from elastic_strips.progress import LoggedProgress

_JOIN_RATIO = 1.06  # two pieces of a body are joined where the joint hull has at most this many times their volume
_FREE_GROWTH = 1e-4  # volume [m³] that a joint hull may always grow by


@dataclass(frozen=True, slots=True)
class Capsule:
    """A sphere-swept segment [a, b] of radius r [m] that contains a shape; its points are in some frame."""

    a: Array
    b: Array
    r: float


@dataclass(frozen=True, slots=True)
class LinkGeometry:
    """One convex piece of the robot.

    Attributes:
        name: the collision object's name in the URDF (joined names for a joined hull).
        links: names of the URDF links that it covers.
        joint: index of the Pinocchio joint that carries it; 0 is the world.
        geometry: Coal shape.
        placement: (4, 4) pose of the shape in the joint's frame.
        capsule: a capsule that contains it, in the joint's frame.
    """

    name: str
    links: tuple[str, ...]
    joint: int
    geometry: coal.CollisionGeometry
    placement: Array
    capsule: Capsule


def link_labels(pieces: Sequence[LinkGeometry]) -> tuple[str, ...]:
    """Name of each piece in messages: the URDF's link where it is that link's only piece, else the piece's own name."""
    covered = Counter(link for piece in pieces for link in piece.links)
    return tuple(
        piece.links[0]
        if covered[piece.links[0]] == 1 and piece.name.removeprefix(f"{piece.links[0]}_").isdecimal()
        else piece.name
        for piece in pieces
    )


def collision_data(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Room for the answers of ``pin.computeCollisions`` about a geometry model.

    Contacts are asked for: without them Coal 3.0.3 calls about one in thirty thousand overlapping pairs apart, some of
    them centimetres deep in each other.
    """
    data = geometry.createData()
    for request in data.collisionRequests:
        request.enable_contact = True
    return data


def bounding_capsule(points: Array, radius: float = 0.0) -> Capsule:
    """A small capsule that contains the spheres of ``radius`` [m] about ``points`` (V, 3)."""
    if len(points) == 1:
        return Capsule(points[0].copy(), points[0].copy(), radius)
    center = points.mean(axis=0)
    axes = np.vstack((np.linalg.svd(points - center, full_matrices=False)[2], np.eye(3)))
    found: list[tuple[float, Capsule]] = []
    for axis in axes:
        along = points @ axis
        flat = points - along[:, None] * axis
        middle = 0.5 * (flat.max(axis=0) + flat.min(axis=0))
        middle -= (middle @ axis) * axis
        rho = np.linalg.norm(flat - middle, axis=1)
        r = float(rho.max())
        reach = np.sqrt(np.maximum(r * r - rho * rho, 0.0))
        low, high = float((along + reach).min()), float((along - reach).max())
        if low > high:
            low = high = 0.5 * (low + high)
            r = float(np.sqrt(rho**2 + (along - low) ** 2).max())
        volume = np.pi * r * r * (high - low) + 4.0 / 3.0 * np.pi * r**3
        found.append((volume, Capsule(middle + low * axis, middle + high * axis, r + radius + 1e-9)))
    return min(found, key=lambda each: each[0])[1]


def transformed(points: Array, T: Array) -> Array:
    """Points (N, 3) moved by a pose (4, 4)."""
    return points @ T[:3, :3].T + T[:3, 3]


def piece_of(name: str, links: tuple[str, ...], joint: int, shape: coal.CollisionGeometry, T: Array) -> LinkGeometry:
    """A convex piece of a robot: a shape at a pose (4, 4) in a joint's frame."""
    points, radius = support_points(shape)
    return LinkGeometry(name, links, joint, shape, T, bounding_capsule(transformed(points, T), radius))


def convex_shapes(model: pin.Model, collision: pin.GeometryModel) -> list[LinkGeometry]:
    """The shapes of a collision model, each convex: meshes as their hulls, ellipsoids as boxes.

    Args:
        model: the model.
        collision: its collision geometry, meshes as Coal loads them.

    Raises:
        RobotError: an unsupported shape, or a mesh without volume.
    """
    shapes: list[LinkGeometry] = []
    progress = LoggedProgress("making convex hulls of the robot's meshes", "shapes", len(collision.geometryObjects))
    for obj in collision.geometryObjects:
        progress.step()
        shape, T = obj.geometry, np.array(obj.placement.homogeneous)
        link = model.frames[obj.parentFrame].name if obj.parentFrame < len(model.frames) else obj.name
        kind = shape_of(shape)[0]
        if kind is ShapeKind.MESH:
            shape = convex_from_vertices(support_points(shape)[0], name=f"{obj.name} ({obj.meshPath})")
        elif kind is ShapeKind.ELLIPSOID:
            shape = box_about(shape)
        shape.computeLocalAABB()
        shapes.append(piece_of(obj.name, (link,), obj.parentJoint, shape, T))
    return shapes


def parts_of(shape: LinkGeometry, mesh: coal.CollisionGeometry, most: int) -> list[LinkGeometry]:
    """A mesh's hull as a few smaller pieces that together hold the mesh and what it encloses; other shapes as they are.

    Args:
        shape: the convex shape.
        mesh: the mesh that it was made of.
        most: largest number of pieces.
    """
    if not isinstance(mesh, coal.BVHModelBase):
        return [shape]
    pieces = few_pieces(vertices(mesh), faces(mesh), most)
    if len(pieces) == 1:
        return [shape]
    names = [f"{shape.name}_part{k}" for k in range(len(pieces))]
    return [
        piece_of(name, shape.links, shape.joint, convex_from_vertices(corners, name=name), shape.placement)
        for name, corners in zip(names, pieces, strict=True)
    ]


def joined_pieces(
    shapes: Sequence[LinkGeometry], unchecked: Mask, alone: Collection[int] = ()
) -> tuple[list[LinkGeometry], list[int]]:
    """Fewer pieces that contain the shapes: contained ones dropped, neighbours of one joint joined.

    Only shapes that are kept apart from the same others are joined, so that no pair is lost and none is added.

    Args:
        shapes: convex shapes.
        unchecked: (n, n) pairs of them that are not kept apart.
        alone: numbers of shapes to leave as they are.

    Returns:
        The pieces, and for each the number of a shape whose row of ``unchecked`` is the piece's.
    """
    joint = np.array([shape.joint for shape in shapes])
    elsewhere = joint[:, None] != joint[None, :]
    live = dict(enumerate(shapes))
    for i, k in _contained(shapes, unchecked, elsewhere, alone):
        live[k] = replace(live[k], links=tuple(sorted({*live[k].links, *live[i].links})))
        del live[i]
    return _joined(live, unchecked & elsewhere, alone)


def _contained(
    shapes: Sequence[LinkGeometry], unchecked: Mask, elsewhere: Mask, alone: Collection[int]
) -> list[tuple[int, int]]:
    """Shapes that lie in another one of their joint, which is kept apart from all that they are; and which."""
    dropped: dict[int, int] = {}
    for i, p in enumerate(shapes):
        if i in alone:
            continue
        points, radius = support_points(p.geometry)
        if radius > 0:  # a sphere or capsule: test the box about it
            low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
            points = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        placed = transformed(points, p.placement)
        for k, other in enumerate(shapes):
            if k == i or k in dropped or k in alone or other.joint != p.joint:
                continue
            if (unchecked[k] & ~unchecked[i] & elsewhere[i]).any():
                continue
            T = np.asarray(np.linalg.inv(other.placement), dtype=float)
            if contains(other.geometry, transformed(placed, T)):
                dropped[i] = k
                break
    return list(dropped.items())


def _cloud(piece: LinkGeometry) -> Array:
    """Points in the joint's frame whose hull contains the piece."""
    points, radius = support_points(piece.geometry)
    if radius > 0:
        points = (points[:, None, :] + radius * SIGNS[None]).reshape(-1, 3)
    return transformed(points, piece.placement)


def _joined(
    live: dict[int, LinkGeometry], unchecked: Mask, alone: Collection[int]
) -> tuple[list[LinkGeometry], list[int]]:
    """Join pieces of one body, the best pair first, as long as a joint hull grows little."""
    of = {i: i for i in live}
    whole = {i: p.name for i, p in live.items()}  # the shape that a joined hull is called after: each after another
    clouds = {i: _cloud(p) for i, p in live.items()}
    volumes = {i: float(convex_hull(c).volume) for i, c in clouds.items()}
    growth: dict[tuple[int, int], float] = {}

    def consider(i: int, k: int) -> None:
        if live[i].joint != live[k].joint or not np.array_equal(unchecked[of[i]], unchecked[of[k]]):
            return
        if of[i] in alone or of[k] in alone:
            return
        both = volumes[i] + volumes[k]
        grown = float(convex_hull(np.vstack((clouds[i], clouds[k]))).volume) - both
        if grown <= max((_JOIN_RATIO - 1.0) * both, _FREE_GROWTH):
            growth[i, k] = grown

    order = list(live)
    for n, k in enumerate(order):
        for i in order[:n]:
            consider(i, k)
    new = max(live, default=0)
    while growth:
        i, k = min(growth, key=growth.__getitem__)
        links = tuple(sorted(set(live[i].links) | set(live[k].links)))
        larger = max((i, k), key=volumes.__getitem__)
        whole[new + 1] = whole[larger]
        name = f"{whole[larger]}+{len(links) - 1}"
        hull = convex_from_vertices(np.vstack((clouds[i], clouds[k])), name=name)
        new += 1
        live[new] = piece_of(name, links, live[i].joint, hull, np.eye(4))
        of[new] = of[i]
        clouds[new] = _cloud(live[new])
        volumes[new] = float(convex_hull(clouds[new]).volume)
        del live[i], live[k]
        growth = {pair: g for pair, g in growth.items() if not {i, k} & set(pair)}
        for other in [n for n in live if n != new]:
            consider(other, new)
    return list(live.values()), [of[i] for i in live]


def joint_pose(data: pin.Data, joint: int) -> coal.Transform3s:
    """Where a joint is in the world, once the joints' poses are computed."""
    T = data.oMi[joint]
    return coal.Transform3s(T.rotation, T.translation)


def pose_in_joint(piece: LinkGeometry) -> coal.Transform3s:
    """Where a piece is in its joint's frame."""
    return coal.Transform3s(piece.placement[:3, :3], piece.placement[:3, 3])
