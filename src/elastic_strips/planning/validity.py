"""Validity: whether configurations, and the motions between them, are clear of the scene and of the robot itself."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Mask, by_rows
from elastic_strips.collision import BodySet, MotionBounds
from elastic_strips.collision.candidates import CandidateParts
from elastic_strips.collision.native_side import native_parts, scene_parts
from elastic_strips.native import kernel
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import RobotModel
from elastic_strips.robot.geometry import collision_data
from elastic_strips.scene import Scene
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.work import count_work

if TYPE_CHECKING:
    from elastic_strips.native import _native

_MAX_PAIRED_SHAPES = 400  # of obstacles that are paired with links; more become one tree
_LONGEST_REACH = 2.0  # [m] that a robot extends from its base, at most
_CHECKED_TOGETHER = 8  # configurations of a motion
_LARGEST_PROJECTED_MOTION = 3.0  # times as far as a straight motion's points, those of what it is projected to may move


class ValidityChecker(OneThread):
    """Workspace: checks whether a configuration keeps its distance to every obstacle and from itself.

    If there are few parts, they are paired with the links in one Pinocchio geometry model, whose tree broadphase
    answers in C++; many parts (voxels) form one Coal tree that each link asks.

    Args:
        robot: the robot.
        scene: the obstacles.
        margin: distance to keep to obstacles [m].
        self_margin: distance to keep between the robot's own links [m]; 0 where they may not touch.
        low, high: (2,) region of the base that will be queried [m]; parts that the robot cannot reach from there
            are left out. None takes all.
        bounds: bounds of the robot's links, if the caller has some already.
    """

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        *,
        margin: float,
        self_margin: float = 0.0,
        low: Array | None = None,
        high: Array | None = None,
        bounds: MotionBounds | None = None,
    ) -> None:
        self.robot: RobotModel = robot
        self.bounds: MotionBounds = bounds or MotionBounds(BodySet.links(robot))
        self._checks = self._counted = 0
        self.native: _native.Validity | None = None
        module, bodies = kernel(), self.bounds.bodies.native()
        if module is not None and bodies is not None:
            pairs = robot.pairs_within(self_margin)
            if low is None or high is None:
                parts = scene_parts(scene)
            else:
                least, most = np.full((1, 3), -np.inf), np.full((1, 3), np.inf)
                least[0, :2], most[0, :2] = low - _LONGEST_REACH, high + _LONGEST_REACH
                parts = native_parts(CandidateParts.build(scene, least, most, 0.0))
            self.native = module.Validity(bodies, parts, pairs, self.bounds.of_motion, margin, self_margin)
            return
        shapes = _shapes_within(scene, low, high)
        self._data = robot.model.createData()
        self._model = robot.collision_model.clone()
        self._links = len(robot.geometries)
        self._manager = None
        if len(shapes) <= _MAX_PAIRED_SHAPES:
            for k, (geometry, R, t) in enumerate(shapes):
                pose = pin.SE3(np.asarray(R), np.asarray(t))
                index = self._model.addGeometryObject(
                    pin.GeometryObject(f"obstacle-part-{k}", 0, 0, pose, _grown(geometry, margin))
                )
                for link in range(self._links):
                    self._model.addCollisionPair(pin.CollisionPair(link, index))
        else:
            self._keep = [coal.CollisionObject(g, np.asarray(R), np.asarray(t)) for g, R, t in shapes]
            self._manager = coal.DynamicAABBTreeCollisionManager()
            for item in self._keep:
                self._manager.registerObject(item)
            self._manager.setup()
            self._queries = [coal.CollisionObject(_grown(piece.geometry, margin)) for piece in robot.geometries]
        self._geometry = collision_data(self._model)
        for request in itertools.islice(self._geometry.collisionRequests, len(robot.self_pairs)):
            request.security_margin = self_margin
        self._broadphase = pin.TreeBroadPhaseManager_DynamicAABBTreeCollisionManager(
            robot.model, self._model, self._geometry
        )

    @property
    def checks(self) -> int:
        """Configurations checked so far."""
        return self._checks if self.native is None else self.native.checks

    @exclusive
    def count(self, *, by_trees: bool = False) -> None:
        """Count the checks since the last time as work of the calling thread: of a tree search, or of another one."""
        checks = self.checks - self._counted
        count_work(looks=checks) if by_trees else count_work(checks=checks)
        self._counted += checks

    @exclusive
    def account(self, checks: int) -> None:
        """Say how many checks were made so far, where some of them count once; without the kernel."""
        self._checks = checks

    @exclusive
    def __call__(self, q: Array) -> bool:
        """Whether the configuration (nq,) is valid."""
        if self.native is not None:
            return self.at(self.robot.space.to_coordinates(q))
        self._checks += 1
        return self._valid(q)

    @exclusive
    def _valid(self, q: Array) -> bool:
        """The same without the kernel, which has a lock of its own, and not counted."""
        if pin.computeCollisions(self.robot.model, self._data, self._broadphase, q, True):
            return False
        return self._manager is None or not self._hits_tree()

    @exclusive
    def at(self, coordinates: Array) -> bool:
        """Whether the configuration with these coordinates (nv,) is valid."""
        if self.native is None:
            return self(self.robot.space.from_coordinates(coordinates))
        return self.native.valid(*by_rows(coordinates))

    @exclusive
    def each(self, rows: Array, *, base: bool = False) -> Mask:
        """Which of the configurations with coordinates (N, nv) are valid; with ``base``, at which the links that no
        joint moves keep clear of all obstacles."""
        if self.native is None:
            valid = self._base_is_clear if base else self.at
            return np.array([valid(row) for row in rows], dtype=bool)
        states = np.empty(len(rows), dtype=np.int8)
        (rows,) = by_rows(rows)
        self.native.each(rows, base, states)
        return states == 0

    @exclusive
    def _base_is_clear(self, row: Array) -> bool:
        """:meth:`each` of one row and the base without the kernel."""
        self._checks += 1
        tree, q = self.robot.tree, self.robot.space.from_coordinates(row)
        joints = np.flatnonzero(tree.coordinate >= self.robot.space.base_nv)
        base = [k for k, piece in enumerate(self.robot.geometries) if not tree.support[piece.joint, joints].any()]
        pin.computeCollisions(self.robot.model, self._data, self._model, self._geometry, q, False)
        results = self._geometry.collisionResults
        pairs = enumerate(self._model.collisionPairs)
        if any(p.first in base and p.second >= self._links and results[k].isCollision() for k, p in pairs):
            return False
        return self._manager is None or not self._hits_tree(base)

    @exclusive
    def motion(self, a: Array, b: Array, step: float) -> bool:
        """Whether the motion between coordinates (nv,) is valid: its end and places between, but not its start.

        It goes straight, along the tangent, and is checked wherever some point of the robot may have moved by
        ``step`` [m], the middle first. This is not a proof; the certificate is.
        """
        if self.native is not None:
            a, b = by_rows(a, b)
            return self.native.motion(a, b, step)
        space = self.robot.space
        v = space.difference(a, b)
        count = max(1, math.ceil(float(self.bounds.travel(v[None]).max(initial=0.0)) / step))
        rows, stride = [b], 1 << (count - 1).bit_length()
        while stride > 1:
            rows += [space.integrate(a, k / count * v) for k in range(stride // 2, count, stride)]
            stride //= 2
        for k in range(0, len(rows), _CHECKED_TOGETHER):  # as many are counted as the kernel looks at together
            some = rows[k : k + _CHECKED_TOGETHER]
            valid = all(self._valid(space.from_coordinates(row)) for row in some)
            self._checks += len(some)
            if not valid:
                return False
        return True

    def in_chart(self, row: Array, unit: Array) -> Callable[[Sequence[float], Sequence[float], float], bool]:
        """:meth:`motion` for a planner, whose states are the last coordinates.

        Args:
            row: (nv,) the other coordinates.
            unit: (K,) how much of the last K coordinates one unit of a state is.
        """
        if self.native is not None:
            return self.native.chart(*by_rows(row, unit)).motion
        return _in_chart(self.motion, row, unit)

    def _hits_tree(self, links: Sequence[int] | None = None) -> bool:
        """Whether links, all where None, touch the many parts."""
        assert self._manager is not None
        for link in range(self._links) if links is None else links:
            query, pose = self._queries[link], self._geometry.oMg[link]
            query.setTransform(coal.Transform3s(pose.rotation, pose.translation))
            query.computeAABB()
            callback = coal.CollisionCallBackDefault()
            self._manager.collide(query, callback)
            if callback.data.result.isCollision():
                return True
        return False


class SatisfyingChecker(OneThread):
    """Workspace: checks configurations after the joints have moved to where they satisfy a constraint.

    A planner of the joints asks about straight motions, on which nothing satisfies the constraint. Instead the motion
    is checked that they are projected to, and the rows of its path are projected as well.

    Args:
        valid: the checker of validity.
        constraint: constraint to satisfy.
    """

    def __init__(self, valid: ValidityChecker, constraint: ConstraintForce) -> None:
        self.robot: RobotModel = valid.robot
        self.bounds: MotionBounds = valid.bounds
        self._valid, self._constraint = valid, constraint

    @exclusive
    def count(self) -> None:
        """As :meth:`ValidityChecker.count`."""
        self._valid.count()

    @exclusive
    def at(self, coordinates: Array) -> bool:
        """Whether the configuration that these coordinates (nv,) are projected to is valid."""
        return self._all(coordinates[None], np.inf)

    @exclusive
    def each(self, rows: Array) -> Mask:
        """Which of the configurations with coordinates (N, nv) are valid."""
        if self.native is None:
            return np.array([self.at(row) for row in rows], dtype=bool)
        states = np.empty(len(rows), dtype=np.int8)
        (rows,) = by_rows(rows)
        self.native.each(rows, states)
        return states == 0

    @exclusive
    def motion(self, a: Array, b: Array, step: float) -> bool:
        """As :meth:`ValidityChecker.motion`, of the motion that the straight one is projected to."""
        space = self.robot.space
        v = space.difference(a, b)
        count = max(1, math.ceil(float(self.bounds.travel(v[None]).max(initial=0.0)) / step))
        rows = space.integrate(a[None], np.arange(count + 1)[:, None] / count * v)
        return self._all(rows, _LARGEST_PROJECTED_MOTION * step)

    def in_chart(self, row: Array, unit: Array) -> Callable[[Sequence[float], Sequence[float], float], bool]:
        """As :meth:`ValidityChecker.in_chart`."""
        return _in_chart(self.motion, row, unit)

    def _all(self, coordinates: Array, jump: float) -> bool:
        """Whether rows (N, nv) are valid once projected, and no point moves further than ``jump`` [m] between two."""
        rows, off = self._constraint.project(coordinates)
        if off.max() > 0.5 * self._constraint.constraint.tolerance:
            return False
        if self.bounds.travel(self.robot.space.difference(rows[:-1], rows[1:])).max(initial=0.0) > jump:
            return False
        return all(self._valid.at(row) for row in rows)


Checker = ValidityChecker | SatisfyingChecker


def _in_chart(
    motion: Callable[[Array, Array, float], bool], row: Array, unit: Array
) -> Callable[[Sequence[float], Sequence[float], float], bool]:
    """``motion`` of coordinates, for states that are the last of these in units of their own."""

    def of_states(a: Sequence[float], b: Sequence[float], step: float) -> bool:
        one, two = row.copy(), row.copy()
        one[-len(unit) :], two[-len(unit) :] = np.multiply(a, unit), np.multiply(b, unit)
        return motion(one, two, step)

    return of_states


def _shapes_within(
    scene: Scene, low: Array | None, high: Array | None
) -> list[tuple[coal.CollisionGeometry, Array, Array]]:
    """Shape, rotation and place of every part of a scene that the robot can reach from a region of its base."""
    table = scene.table
    rows = np.arange(len(table.parts))
    if low is not None and high is not None and len(rows):
        c, h = table.center[:, :2], table.half_extents[:, :2]
        near = ((c - h <= high + _LONGEST_REACH) & (c + h >= low - _LONGEST_REACH)).all(axis=1)
        rows = rows[near]
    shapes = []
    for r in rows:
        part, R, t = table.parts[r], table.rotation[r], table.translation[r]
        if part.geometry is None:
            shapes += [(box, R, t + R @ np.asarray(at)) for box, at in part.boxes]
        else:
            shapes.append((part.geometry, R, t))
    return shapes


def _grown(geometry: coal.CollisionGeometry, margin: float) -> coal.CollisionGeometry:
    grown = geometry.clone()
    grown.setSweptSphereRadius(grown.getSweptSphereRadius() + margin)
    grown.computeLocalAABB()
    return grown
