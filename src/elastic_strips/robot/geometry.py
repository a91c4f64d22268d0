"""Collision geometry of a robot: convex pieces with bounding capsules, and the pairs of them that must not touch.

Meshes become convex hulls that contain them. What is contained in another shape of the same body is dropped and hulls
that hardly grow by being joined are joined: both keep containment.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Indices
from elastic_strips.hulls import convex_hull

from .coal_shapes import SIGNS, ShapeKind, box_about, contains, convex_from_vertices, shape_of, support_points

_log = logging.getLogger(__name__)
_JOIN_RATIO = 1.06  # two pieces of a body are joined where the joint hull has at most this many times their volume
_FREE_GROWTH = 1e-4  # volume [m³] that a joint hull may always grow by
_SAMPLES = 300
_ALWAYS = 0.95
_TOUCH = 1.5e-3  # pieces nearer than this [m] count as touching
_APART = 1e-4  # distance [m] below which a proof that two pieces never touch gives up


@dataclass(frozen=True, slots=True)
class Capsule:
    """A sphere-swept segment [a, b] of radius r [m] that contains a shape; points in some frame."""

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


class WhyUnchecked(str, Enum):
    """Why collisions of two links are not looked at."""

    JOINED = "one joint joins them"


@dataclass(frozen=True, slots=True)
class UncheckedPair:
    """Two links of a robot whose collisions with each other are not looked at.

    Attributes:
        links: names of the links, sorted.
        why: the reason.
        note: what is known besides.
    """

    links: tuple[str, str]
    why: WhyUnchecked
    note: str = ""


def link_labels(pieces: Sequence[LinkGeometry]) -> tuple[str, ...]:
    """What messages call each piece: the URDF's link where it is that link's only one, else the piece's own name."""
    covered = Counter(link for piece in pieces for link in piece.links)
    return tuple(
        piece.links[0]
        if covered[piece.links[0]] == 1 and piece.name.removeprefix(f"{piece.links[0]}_").isdecimal()
        else piece.name
        for piece in pieces
    )


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


def _transformed(points: Array, T: Array) -> Array:
    return points @ T[:3, :3].T + T[:3, 3]


def piece_of(name: str, links: tuple[str, ...], joint: int, shape: coal.CollisionGeometry, T: Array) -> LinkGeometry:
    """A convex piece of a robot: a shape at a pose (4, 4) in a joint's frame."""
    points, radius = support_points(shape)
    return LinkGeometry(name, links, joint, shape, T, bounding_capsule(_transformed(points, T), radius))


def link_geometries(model: pin.Model, collision: pin.GeometryModel) -> list[LinkGeometry]:
    """The convex pieces of a collision model: meshes as hulls, contained ones dropped, neighbours joined.

    Robots of primitives only are left as they are.

    Args:
        model: the planned model.
        collision: its collision geometry, meshes as Coal loads them.

    Raises:
        RobotError: an unsupported shape, or a mesh without volume.
    """
    pieces: list[LinkGeometry] = []
    meshes = False
    for obj in collision.geometryObjects:
        shape, T = obj.geometry, np.array(obj.placement.homogeneous)
        link = model.frames[obj.parentFrame].name if obj.parentFrame < len(model.frames) else obj.name
        points, _ = support_points(shape)
        kind = shape_of(shape)[0]
        if kind is ShapeKind.MESH:
            meshes = True
            shape = convex_from_vertices(points, name=f"{obj.name} ({obj.meshPath})")
        elif kind is ShapeKind.ELLIPSOID:
            shape = box_about(shape)
        shape.computeLocalAABB()
        pieces.append(piece_of(obj.name, (link,), obj.parentJoint, shape, T))
    if not meshes:
        return pieces
    return _joined(_without_contained(pieces))


def _without_contained(pieces: list[LinkGeometry]) -> list[LinkGeometry]:
    dropped: set[int] = set()
    links = {i: set(p.links) for i, p in enumerate(pieces)}
    for i, p in enumerate(pieces):
        points, radius = support_points(p.geometry)
        if radius > 0:  # a sphere or capsule: test the box about it
            low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
            points = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        world = _transformed(points, p.placement)
        for k, other in enumerate(pieces):
            if k == i or k in dropped or other.joint != p.joint:
                continue
            T = np.asarray(np.linalg.inv(other.placement), dtype=float)
            if contains(other.geometry, _transformed(world, T)):
                dropped.add(i)
                links[k] |= links[i]
                break
    return [replace(p, links=tuple(sorted(links[i]))) for i, p in enumerate(pieces) if i not in dropped]


def _cloud(piece: LinkGeometry) -> Array:
    """Points in the joint's frame whose hull contains the piece."""
    points, radius = support_points(piece.geometry)
    if radius > 0:
        points = (points[:, None, :] + radius * SIGNS[None]).reshape(-1, 3)
    return _transformed(points, piece.placement)


def _joined(pieces: list[LinkGeometry]) -> list[LinkGeometry]:
    """Join pieces of one body, the best pair first, as long as a joint hull grows little."""
    live = dict(enumerate(pieces))
    clouds = {i: _cloud(p) for i, p in live.items()}
    volumes = {i: float(convex_hull(c).volume) for i, c in clouds.items()}
    growth: dict[tuple[int, int], float] = {}

    def consider(i: int, k: int) -> None:
        if live[i].joint == live[k].joint:
            both = volumes[i] + volumes[k]
            grown = float(convex_hull(np.vstack((clouds[i], clouds[k]))).volume) - both
            if grown <= max((_JOIN_RATIO - 1.0) * both, _FREE_GROWTH):
                growth[i, k] = grown

    for k in live:
        for i in range(k):
            consider(i, k)
    while growth:
        i, k = min(growth, key=growth.__getitem__)
        links = tuple(sorted(set(live[i].links) | set(live[k].links)))
        name = f"{live[max((i, k), key=volumes.__getitem__)].name.split('+')[0]}+{len(links) - 1}"
        hull = convex_from_vertices(np.vstack((clouds[i], clouds[k])), name=name)
        new = max(live) + 1
        live[new] = piece_of(name, links, live[i].joint, hull, np.eye(4))
        clouds[new] = _cloud(live[new])
        volumes[new] = float(convex_hull(clouds[new]).volume)
        del live[i], live[k]
        growth = {pair: g for pair, g in growth.items() if not {i, k} & set(pair)}
        for other in [n for n in live if n != new]:
            consider(other, new)
    return list(live.values())


def self_pairs(
    model: pin.Model, pieces: Sequence[LinkGeometry], home: Array, disabled: Iterable[Iterable[str]] | None
) -> Indices:
    """Pairs (S, 2) of pieces to keep apart.

    Pieces of one joint never move relative to each other and those of neighbouring joints touch by design: both are
    left out. A pair of links is left out where ``disabled`` names it. Pairs that touch in nearly every sampled posture
    are left out: hulls of meshes do where the bodies do not. Without ``disabled``, so are those that touch at home and
    those that never can. The log says so, with a warning where ``disabled`` or other postures tell otherwise.
    """
    ignored = None if disabled is None else {frozenset(p) for p in disabled}
    pairs = []
    for i in range(len(pieces)):
        for k in range(i + 1, len(pieces)):
            a, b = pieces[i].joint, pieces[k].joint
            if a == b or (model.parents[a] == b and a > 0) or (model.parents[b] == a and b > 0):
                continue
            if ignored is not None and all(
                frozenset((la, lb)) in ignored for la in pieces[i].links for lb in pieces[k].links
            ):
                continue
            pairs.append((i, k))
    if ignored is not None:
        pairs, _ = _without_permanent(model, pieces, None, pairs)
    else:
        pairs, touched = _without_permanent(model, pieces, home, pairs)
        pairs = [p for p in pairs if p in touched or not never_touch(model, pieces, *p)]
    return np.asarray(pairs, dtype=np.intp).reshape(-1, 2)


def _without_permanent(
    model: pin.Model, pieces: Sequence[LinkGeometry], home: Array | None, pairs: list[tuple[int, int]]
) -> tuple[list[tuple[int, int]], set[tuple[int, int]]]:
    """The pairs that do not always touch, nor at a home posture, and those among them that were seen to.

    Without a home only the pairs that always touch are looked for.
    """
    data = model.createData()
    rng = np.random.default_rng(0)
    hits = np.zeros(len(pairs), dtype=int)
    at_home = np.zeros(len(pairs), dtype=bool)
    touched = np.zeros(len(pairs), dtype=bool)
    first, second = np.asarray(pairs, dtype=np.intp).reshape(-1, 2).T
    # a ball about each piece: most pairs are too far apart to be measured
    center = [0.5 * (p.capsule.a + p.capsule.b) for p in pieces]
    radius = np.array([0.5 * np.linalg.norm(p.capsule.b - p.capsule.a) + p.capsule.r for p in pieces])
    reach = radius[first] + radius[second] + _TOUCH
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    wide = ~((np.abs(lower) < 1e6) & (np.abs(upper) < 1e6))
    lower[wide], upper[wide] = -np.pi, np.pi
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.security_margin = _TOUCH
    for sample in range(_SAMPLES + 1):
        if home is None and sample > 0 and not np.any(hits >= sample - (1.0 - _ALWAYS) * _SAMPLES):
            break
        q = home if sample == 0 and home is not None else pin.normalize(model, rng.uniform(lower, upper))
        pin.forwardKinematics(model, data, q)
        at = np.array([data.oMi[p.joint].act(c) for p, c in zip(pieces, center, strict=True)])
        near = np.flatnonzero(np.linalg.norm(at[first] - at[second], axis=1) <= reach)
        poses = {n: _pose(data, pieces[n]) for n in {*first[near].tolist(), *second[near].tolist()}}
        for n in near:
            i, k = pairs[n]
            result.clear()
            if coal.collide(pieces[i].geometry, poses[i], pieces[k].geometry, poses[k], request, result):
                hits[n] += 1
                at_home[n] |= sample == 0 and home is not None
                touched[n] |= result.getContact(0).penetration_depth < _APART
    drop = at_home | (hits > _ALWAYS * _SAMPLES)
    surprising: dict[str, list[str]] = {}
    for n in np.flatnonzero(drop):
        i, k = pairs[n]
        why = "touch at home" if at_home[n] else "touch nearly always"
        _log.info("self-collision of %s and %s is not checked: they %s", pieces[i].name, pieces[k].name, why)
        if home is None or hits[n] < 0.5 * _SAMPLES:
            surprising.setdefault(why, []).append(f"{pieces[i].name} and {pieces[k].name}")
    for why, names in surprising.items():
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        _log.warning(
            "self-collision of %d pairs is not checked, though %s: they %s (%s%s)",
            len(names), "the SRDF asks for it" if home is None else "they seldom touch elsewhere", why,
            "; ".join(names[:8]), more,
        )  # fmt: skip
    left = [p for n, p in enumerate(pairs) if not drop[n]]
    return left, {p for n, p in enumerate(pairs) if touched[n]}


def _pose(data: pin.Data, piece: LinkGeometry) -> coal.Transform3s:
    T = data.oMi[piece.joint] * pin.SE3(piece.placement[:3, :3], piece.placement[:3, 3])
    return coal.Transform3s(T.rotation, T.translation)


def never_touch(model: pin.Model, pieces: Sequence[LinkGeometry], i: int, k: int, *, cells: int = 4000) -> bool:
    """Whether two pieces are proven apart in every posture: only tried where at most two joints lie between them.

    The box of these joints' limits is divided until, in each cell, the distance at its middle exceeds what the
    pieces can move towards each other inside it. True is a proof; False means that they touch somewhere or that
    ``cells`` did not suffice.
    """
    between = _joints_between(model, pieces[i].joint, pieces[k].joint)
    if not 1 <= len(between) <= 2:
        return False
    low, high, radius = [], [], []
    for j in between:
        joint = model.joints[j]
        if joint.nq != 1:
            return False
        low.append(float(model.lowerPositionLimit[joint.idx_q]))
        high.append(float(model.upperPositionLimit[joint.idx_q]))
        revolute = not joint.shortname().startswith("JointModelP")
        lever = max(_chain_reach(model, pieces[n], j) for n in (i, k))
        radius.append(lever if revolute else 1.0)
    reach = np.asarray(radius)
    data, q = model.createData(), pin.neutral(model)
    request, result = coal.DistanceRequest(True), coal.DistanceResult()
    open_cells = [(np.asarray(low), np.asarray(high))]
    if not np.isfinite(np.asarray(low + high)).all():
        return False
    for _ in range(cells):
        if not open_cells:
            return True
        a, b = open_cells.pop()
        for value, j in zip(0.5 * (a + b), between, strict=True):
            q[model.joints[j].idx_q] = value
        pin.forwardKinematics(model, data, q)
        poses = [_pose(data, p) for p in (pieces[i], pieces[k])]
        result.clear()
        d = coal.distance(pieces[i].geometry, poses[0], pieces[k].geometry, poses[1], request, result)
        if d <= _APART:
            return False
        travel = 0.5 * (b - a) * reach
        if d - _APART > travel.sum():
            continue
        axis = int(np.argmax(travel))
        middle = 0.5 * (a[axis] + b[axis])
        left, right = b.copy(), a.copy()
        left[axis] = right[axis] = middle
        open_cells += [(a, left), (right, b)]
    return not open_cells


def _joints_between(model: pin.Model, a: int, b: int) -> list[int]:
    """Joints that move one of the bodies of joints ``a`` and ``b`` and not the other."""
    chains = []
    for joint in (a, b):
        chain = set()
        while joint > 0:
            chain.add(joint)
            joint = model.parents[joint]
        chains.append(chain)
    return sorted(chains[0] ^ chains[1])


def _chain_reach(model: pin.Model, piece: LinkGeometry, joint: int) -> float:
    """Bound [m] of a piece's distance from a joint's origin in any posture; 0 where the joint does not carry it."""
    far = max(float(np.linalg.norm(piece.capsule.a)), float(np.linalg.norm(piece.capsule.b))) + piece.capsule.r
    at = piece.joint
    while at > 0 and at != joint:
        far += float(np.linalg.norm(model.jointPlacements[at].translation))
        if model.joints[at].shortname().startswith("JointModelP"):
            index = model.joints[at].idx_q
            far += max(abs(float(model.lowerPositionLimit[index])), abs(float(model.upperPositionLimit[index])))
        at = model.parents[at]
    return far if at == joint else 0.0
