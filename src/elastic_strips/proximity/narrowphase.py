"""Exact distances by Coal: one functor a pair of shapes, results read only where they matter.

Conventions that callers see (tests pin them): the witness lies on the robot, and the direction is the unit vector
along which the robot moves *away* from the obstacle, so that ∂d/∂witness = direction, separated or penetrating.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import numpy.typing as npt

from ..robot import Kinematics
from ..robot.space import Array
from ..scene.parts import Part
from .bodies import BodySet

GJK_EXCESS = 1e-5
"""Coal's GJK over-reports clearance by up to 3.2e-6 m; every bound here subtracts this much [m]."""


class Narrowphase:
    """Workspace: Coal functors, transforms and one result object for body–part queries."""

    def __init__(self, bodies: BodySet) -> None:
        self.bodies = bodies
        self.queries = 0
        self._request = coal.DistanceRequest(True)
        self._result = coal.DistanceResult()
        self._normal = self._result.normal  # a live view of the result's memory
        self._functors: dict[tuple[int, int], coal.ComputeDistance] = {}
        self._objects: dict[int, coal.CollisionObject] = {}
        self._tree_of: dict[int, coal.DynamicAABBTreeCollisionManager] = {}
        self._keep: dict[int, Any] = {}
        self._transform = coal.Transform3s()

    def query(
        self,
        kin: Kinematics,
        node: npt.NDArray[np.intp],
        body: npt.NDArray[np.intp],
        part: npt.NDArray[np.intp],
        parts: Sequence[Part],
        transforms: Sequence[Any],
        rotations: Array,
        translations: Array,
        reach: float,
    ) -> tuple[Array, Array, Array]:
        """Signed distances of (node, body, part) triples.

        Args:
            kin: kinematics of the nodes.
            node, body, part: (K,) index arrays, best sorted by node and body.
            parts: the parts that ``part`` indexes.
            transforms: their Coal transforms, world frame.
            rotations, translations: (P, 3, 3), (P, 3) the same as arrays.
            reach: witness and direction are read only where the distance is below this [m].

        Returns:
            distance (K,), direction (K, 3), witness (K, 3) in the world frame; the last two are zero beyond ``reach``.
        """
        count = len(node)
        self.queries += count
        distance = np.empty(count)
        direction, witness = np.zeros((count, 3)), np.zeros((count, 3))
        rotation, translation = self.bodies.placements(kin, node, body)
        functors, geometries = self._functors, self.bodies.geometries
        request, result, normal, transform = self._request, self._result, self._normal, self._transform
        clear, nearest = result.clear, result.getNearestPoint1
        previous = (-1, -1)
        nodes, body_list, part_list = node.tolist(), body.tolist(), part.tolist()
        for k in range(count):
            g, p = body_list[k], part_list[k]
            shape = parts[p]
            if shape.geometry is None:
                distance[k], direction[k], witness[k] = self._cluster(
                    g, shape, rotation[k], translation[k], rotations[p], translations[p]
                )
                continue
            if (nodes[k], g) != previous:
                previous = (nodes[k], g)
                transform.setTransform(rotation[k], translation[k])
            key = (g, id(shape))
            functor = functors.get(key)
            if functor is None:
                functor = functors[key] = coal.ComputeDistance(geometries[g], shape.geometry)
                self._keep[id(shape)] = shape
            clear()
            d = functor(transform, transforms[p], request, result)
            distance[k] = d
            if d < reach:
                direction[k] = normal
                witness[k] = nearest()
        np.negative(direction, out=direction)
        distance += self.bodies.skin
        if len(self._functors) > 200_000:
            self._functors.clear()
            self._keep.clear()
        return distance, direction, witness

    def _cluster(
        self, g: int, part: Part, rotation: Array, translation: Array, part_rotation: Array, part_translation: Array
    ) -> tuple[float, Array, Array]:
        """Nearest box of a block, through the block's AABB tree, in the block's own frame."""
        manager = self._tree_of.get(id(part))
        if manager is None:
            manager = coal.DynamicAABBTreeCollisionManager()
            members = [coal.CollisionObject(box, np.eye(3), np.asarray(at)) for box, at in part.boxes]
            for member in members:
                manager.registerObject(member)
            manager.setup()
            self._tree_of[id(part)] = manager
            self._keep[id(part)] = (part, members)
        query = self._objects.get(g)
        if query is None:
            query = self._objects[g] = coal.CollisionObject(self.bodies.geometries[g])
        local = part_rotation.T @ (translation - part_translation)
        query.setTransform(coal.Transform3s(part_rotation.T @ rotation, local))
        query.computeAABB()
        callback = coal.DistanceCallBackDefault()
        callback.data.request.enable_signed_distance = True
        manager.distance(query, callback)
        result = callback.data.result
        # here shape 1 is the tree's box and shape 2 the robot: the opposite of the direct query
        direction = part_rotation @ np.asarray(result.normal)
        witness = part_rotation @ np.asarray(result.getNearestPoint2()) + part_translation
        return float(result.min_distance), -direction, witness
