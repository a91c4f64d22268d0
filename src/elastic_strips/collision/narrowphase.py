"""Narrow phase: exact distances and witness points of pairs, by Coal, to the last digits.

With Coal's own tolerance of 1e-6 a distance between round shapes is up to 5e-5 m too large, and its normal good only to
1e-3. Rounding sets the other bound: at 1e-12 one answer in ten thousand is wrong by centimetres, too large as well as
too small. So GJK is asked for 1e-10, and no positive distance is believed but proven: along its normal the shapes'
supports have to leave as much room (``_gap``), which holds whoever found the normal. The solver for penetration (EPA)
does not always reach a tight tolerance and then returns nonsense: its answer counts only where it agrees with the one
at Coal's own.

Conventions that callers see (tests pin them): the witness lies on the robot, and the direction is the unit vector
along which the robot moves *away* from the obstacle, so that ∂d/∂witness = direction, separated or penetrating.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.coal_shapes import for_penetration, sphere_as_capsule, supporter
from elastic_strips.constants import (
    COARSE_EPA_TOLERANCES,
    DEPTH_AGREEMENT,
    EPA_TOLERANCE,
    GJK_EXCESS,
    GJK_TOLERANCE,
    NO_DEPTH,
    NORMAL_EXCESS,
    UNIT_EXCESS,
)
from elastic_strips.errors import NumericalError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics
from elastic_strips.scene.parts import Part
from elastic_strips.work import count_work

from .bounds import BodySet
from .candidates import CandidateParts
from .native_side import NativeNarrowphase

__all__ = ["GJK_EXCESS", "Contacts", "Narrowphase", "PairSolver", "ShapePair"]

_QUERIES_PER_FUNCTORS = 4  # queries take as long as to make the functors of a pair


def _distance_request(*, gjk: float | None = None, epa: float | None = None) -> coal.DistanceRequest:
    """A request for a signed distance with witness points and normal, at Coal's own tolerances or at these."""
    request = coal.DistanceRequest(True)
    if gjk is not None:
        request.gjk_tolerance = gjk
    if epa is not None:
        request.epa_tolerance = epa
    return request


class ShapePair(NamedTuple):
    """Coal's functors for two shapes: ``apart`` to begin with; ``deep`` and ``fine`` once they penetrate.

    They are three because a functor that failed at a fine tolerance may go on failing at any. ``shapes`` are kept
    because a functor does not keep what it was made of. ``one`` and ``two`` say how far the shapes extend.
    """

    apart: coal.ComputeDistance
    deep: coal.ComputeDistance
    fine: coal.ComputeDistance
    shapes: tuple[coal.CollisionGeometry, ...]
    one: Callable[[float, float, float], float]
    two: Callable[[float, float, float], float]

    @staticmethod
    def of(one: coal.CollisionGeometry, two: coal.CollisionGeometry) -> ShapePair:
        """The functors of two shapes."""
        count_work(queries=_QUERIES_PER_FUNCTORS)
        shapes = for_penetration(one, two)
        deep, fine = (coal.ComputeDistance(*shapes) for _ in range(2))
        return ShapePair(
            coal.ComputeDistance(one, two), deep, fine, (one, two, *shapes), supporter(one), supporter(two)
        )


class PairSolver:
    """Workspace: requests and one result object."""

    def __init__(self) -> None:
        self.result: coal.DistanceResult = coal.DistanceResult()
        self._apart = _distance_request(gjk=GJK_TOLERANCE)
        self._deep = _distance_request()
        self._fine = _distance_request(gjk=GJK_TOLERANCE, epa=EPA_TOLERANCE)
        self._coarse = [_distance_request(epa=tolerance) for tolerance in COARSE_EPA_TOLERANCES]

    def ask(self, pair: ShapePair, one: coal.Transform3s, two: coal.Transform3s) -> float:
        """Signed distance [m] of two shapes at poses; ``result`` then holds the normal and the witness points.

        It exceeds the true distance by at most 5e-6 m, whatever Coal says.
        """
        result = self.result
        result.clear()
        d = pair.apart(one, two, self._apart, result)
        if d <= 0.0:
            d = self._penetration(pair, one, two)
            if d <= 0.0:
                return d
        apart = _gap(pair, one, two, result.normal)
        if d <= apart + NORMAL_EXCESS:
            return d
        result.clear()
        pair.deep(one, two, self._deep, result)
        return max(_gap(pair, one, two, result.normal), apart, 0.0)

    def _penetration(self, pair: ShapePair, one: coal.Transform3s, two: coal.Transform3s) -> float:
        result = self.result
        result.clear()
        deep = pair.deep(one, two, self._deep, result)
        result.clear()
        fine = pair.fine(one, two, self._fine, result)
        if fine > NO_DEPTH and abs(fine - deep) < DEPTH_AGREEMENT:
            return fine
        for request in (self._deep, *self._coarse):  # even Coal's own tolerance is not always reached
            result.clear()
            deep = pair.deep(one, two, request, result)
            if deep > NO_DEPTH:
                return deep
        raise NumericalError("Coal finds no penetration depth of two shapes at any tolerance")


def _gap(pair: ShapePair, one: coal.Transform3s, two: coal.Transform3s, normal: Array) -> float:
    """How far two shapes are apart [m] along a unit vector from one to the other; −inf where it is not a unit vector.

    This is at most their distance, wherever the vector comes from.
    """
    x, y, z = normal.tolist()
    if not x * x + y * y + z * z < 1.0 + UNIT_EXCESS:
        return -inf
    a, b, c = (normal @ one.getRotation()).tolist()
    d, e, f = (normal @ two.getRotation()).tolist()
    (px, py, pz), (qx, qy, qz) = one.getTranslation().tolist(), two.getTranslation().tolist()
    return x * (qx - px) + y * (qy - py) + z * (qz - pz) - pair.one(a, b, c) - pair.two(-d, -e, -f)


@dataclass(frozen=True, slots=True)
class Contacts:
    """Body–part pairs of a strip that are within the influence distance.

    Attributes:
        node, body, part: (K,) indices; ``part`` counts in the candidates.
        distance: (K,) signed distance [m].
        direction: (K, 3) unit vectors away from the obstacle, world frame.
        witness: (K, 3) nearest points on the robot, world frame [m].
    """

    node: Indices
    body: Indices
    part: Indices
    distance: Array
    direction: Array
    witness: Array

    def __len__(self) -> int:
        return len(self.node)


def lower_bounds(
    bodies: BodySet,
    kin: Kinematics,
    at: tuple[Indices, Indices, Indices],
    candidates: CandidateParts,
    moved: tuple[Array, Array] | None,
    reach: Array | float = inf,
) -> Array:
    """Cheap distances (K,) [m] of bodies to parts, never above the true ones: by capsules and by boxes.

    Args:
        bodies, kin: the bodies, and where they are.
        at: node, body and part (K,) of each.
        candidates: the parts.
        moved: shift (K, 3) and uncertainty (K,) of the parts [m]; None where nothing moves.
        reach: boxes are only looked at where the capsules' bounds are not so large [m].
    """
    node, body, part = at
    cheap = candidates.capsule_distance(bodies.ends_at(kin, node, body), bodies.radius[body], part, moved)
    left = np.flatnonzero(~(cheap >= reach))
    if len(left):
        rotation, translation = bodies.placements(kin, node[left], body[left])
        center, half = (each[body[left]] for each in bodies.boxes)
        center = np.matmul(rotation, center[..., None])[..., 0] + translation
        still = None if moved is None else (moved[0][left], moved[1][left])
        cheap[left] = np.fmax(cheap[left], candidates.apart(center, rotation, half, part[left], still) + bodies.skin)
    return cheap


class Narrowphase(OneThread):
    """Workspace: exact distances between bodies and obstacle parts; keeps Coal's functors of each pair."""

    def __init__(self, bodies: BodySet) -> None:
        self.bodies = bodies
        self.queries: int = 0
        self._solver = PairSolver()
        self._normal = self._solver.result.normal  # a live view of the result's memory
        self._parts: dict[int, Part] = {}  # keeps alive what the caches below know by id()
        self._functors: dict[tuple[int, int], ShapePair] = {}
        self._blocks: dict[int, _Block] = {}
        self._probes: dict[int, coal.CollisionObject] = {}
        self._transform = coal.Transform3s()
        self.native: NativeNarrowphase | None = NativeNarrowphase.of(bodies)

    @exclusive
    def retain(self, parts: Sequence[Part]) -> None:
        """Forget what is cached for all other parts."""
        self._parts = {id(part): part for part in parts}
        self._functors = {key: f for key, f in self._functors.items() if key[1] in self._parts}
        self._blocks = {key: b for key, b in self._blocks.items() if key in self._parts}

    @exclusive
    def query(
        self,
        kin: Kinematics,
        node: Indices,
        body: Indices,
        part: Indices,
        candidates: CandidateParts,
        reach: float,
        shift: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """Signed distances of (node, body, part) triples.

        Args:
            kin: kinematics of the nodes.
            node, body, part: (K,) index arrays, best sorted by node and body.
            candidates: the parts that ``part`` indexes.
            reach: witness and direction are read only where the distance is below this [m].
            shift: (K, 3) displacement of the part at the node [m]; None where no part moves.

        Returns:
            distance (K,), direction (K, 3), witness (K, 3) in the world frame; the last two are zero beyond ``reach``.
        """
        count = len(node)
        self.queries += count
        count_work(queries=count)
        distance = np.empty(count)
        direction, witness = np.zeros((count, 3)), np.zeros((count, 3))
        if self.native is not None:
            parts = self.native.parts(candidates)
            self.native.calls.query(kin.T, node, body, part, parts, shift, distance, direction, witness)
            return distance, direction, witness
        rotation, translation = self.bodies.placements(kin, node, body)
        if shift is not None:
            translation -= shift  # the obstacle moves one way, or the robot the other
        functors, geometries = self._functors, self.bodies.geometries
        ask, normal, transform = self._solver.ask, self._normal, self._transform
        nearest = self._solver.result.getNearestPoint1
        previous = (-1, -1)
        shapes, transforms = candidates.parts, candidates.transforms
        nodes, body_list, part_list = node.tolist(), body.tolist(), part.tolist()
        for k in range(count):  # the hot loop of the twin in Python: a call for each pair would cost as much as Coal
            g, p = body_list[k], part_list[k]
            shape = shapes[p]
            if shape.geometry is None:
                distance[k], direction[k], witness[k] = self._cluster(
                    g, shape, rotation[k], translation[k], candidates.rotation[p], candidates.translation[p]
                )
                continue
            if (nodes[k], g) != previous or shift is not None:
                previous = (nodes[k], g)
                transform.setTransform(rotation[k], translation[k])
            key = (g, id(shape))
            functor = functors.get(key)
            if functor is None:
                functor = functors[key] = ShapePair.of(geometries[g], shape.geometry)
                self._parts[id(shape)] = shape
            distance[k] = d = ask(functor, transform, transforms[p])
            if d < reach:
                direction[k] = normal
                witness[k] = nearest()
        if shift is not None:
            witness += shift
        direction *= -1.0
        distance += self.bodies.skin
        return distance, direction, witness

    def _cluster(
        self, g: int, part: Part, rotation: Array, translation: Array, part_rotation: Array, part_translation: Array
    ) -> tuple[float, Array, Array]:
        """Nearest box of a block, through the block's AABB tree, in the block's own frame."""
        block = self._blocks.get(id(part))
        if block is None:
            block = self._blocks[id(part)] = _Block(part)
            self._parts[id(part)] = part
        probe = self._probes.get(g)
        if probe is None:
            # Coal's box–sphere special case does not keep the smallest of several distances
            probe = self._probes[g] = coal.CollisionObject(sphere_as_capsule(self.bodies.geometries[g]))
        pose = coal.Transform3s(part_rotation.T @ rotation, part_rotation.T @ (translation - part_translation))
        distance, direction, witness = block.nearest(probe, pose)
        # the caller turns directions of its own queries around; this one already points away
        return distance, -(part_rotation @ direction), part_rotation @ witness + part_translation


class _Block:
    """The boxes of one part in a Coal tree, in the part's frame."""

    def __init__(self, part: Part) -> None:
        self.members = [coal.CollisionObject(box, np.eye(3), np.asarray(at)) for box, at in part.boxes]
        self.manager = coal.DynamicAABBTreeCollisionManager()
        for member in self.members:
            self.manager.registerObject(member)
        self.manager.setup()

    def nearest(self, probe: coal.CollisionObject, pose: coal.Transform3s) -> tuple[float, Array, Array]:
        """Distance, direction away from the boxes, and witness on the probe."""
        probe.setTransform(pose)
        probe.computeAABB()
        callback = coal.DistanceCallBackDefault()
        callback.data.request = _distance_request(gjk=GJK_TOLERANCE)
        self.manager.distance(probe, callback)
        result = callback.data.result
        if result.min_distance > 0.0:
            # here shape 1 is the tree's box and shape 2 the robot: the opposite of a direct query
            return float(result.min_distance), np.array(result.normal), np.array(result.getNearestPoint2())
        # the tree stops at the first box that penetrates; the deepest one is wanted
        deepest = np.inf, np.zeros(3), np.zeros(3)
        request = _distance_request()
        for member in self.members:
            result = coal.DistanceResult()
            coal.distance(member, probe, request, result)
            if result.min_distance < deepest[0]:
                deepest = float(result.min_distance), np.array(result.normal), np.array(result.getNearestPoint2())
        return deepest
