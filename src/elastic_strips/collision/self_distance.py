"""Self proximity: the distances between the robot's own links along a strip, with bounds as for obstacles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.constants import FAR, GJK_EXCESS, POINT_LENGTH2
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics
from elastic_strips.robot.space import nonzero, rows_from
from elastic_strips.work import count_work

from .bounds import BodySet, MotionBounds
from .narrowphase import PairSolver, ShapePair
from .native_side import NativeSelfPairs

if TYPE_CHECKING:
    from elastic_strips.native import _native


@dataclass(frozen=True, slots=True)
class SelfContacts:
    """Self pairs of a strip within the self influence distance.

    Attributes:
        node, pair: (K,) indices.
        distance: (K,) [m].
        direction: (K, 3) unit vectors that move the first body away from the second.
        first, second: (K, 3) witness points on the two bodies [m].
    """

    node: Indices
    pair: Indices
    distance: Array
    direction: Array
    first: Array
    second: Array

    def __len__(self) -> int:
        return len(self.node)


def segment_distance(one: Array, two: Array) -> Array:
    """Distances (K,) between line segments given by their end points (K, 2, 3)."""
    u, v, w = one[:, 1] - one[:, 0], two[:, 1] - two[:, 0], one[:, 0] - two[:, 0]
    a, b, c = (u * u).sum(axis=1), (u * v).sum(axis=1), (v * v).sum(axis=1)
    d, e = (u * w).sum(axis=1), (v * w).sum(axis=1)
    det = a * c - b * b
    s = np.where(det > POINT_LENGTH2, (b * e - c * d) / np.where(det > POINT_LENGTH2, det, 1.0), 0.0)
    s = np.clip(s, 0.0, 1.0)
    t = np.clip((b * s + e) / np.maximum(c, POINT_LENGTH2), 0.0, 1.0)
    s = np.clip((b * t - d) / np.maximum(a, POINT_LENGTH2), 0.0, 1.0)
    t = np.clip((b * s + e) / np.maximum(c, POINT_LENGTH2), 0.0, 1.0)
    gap = w + s[:, None] * u - t[:, None] * v
    return np.sqrt((gap * gap).sum(axis=1))


class SelfProximity(OneThread):
    """Workspace: bounds on the distances of self pairs, exact below the influence distance.

    Args:
        bodies: the robot's links.
        pairs: (S, 2) index pairs of bodies.
        bounds: motion radii of ``bodies``.
        influence: distances below this [m] are computed exactly.
        repulsion: (S,) distances [m] below which the pairs push each other apart; at most ``influence``.
        reach: (S,) less than ``influence`` for pairs that need not be exact below it, but only below this [m].
        tolerance: an exact distance is measured again after this much relative motion [m].
    """

    bound: Array
    exact: Array
    direction: Array
    first: Array
    second: Array

    def __init__(
        self,
        bodies: BodySet,
        pairs: Indices,
        bounds: MotionBounds,
        *,
        influence: float,
        repulsion: Array | None = None,
        reach: Array | None = None,
        tolerance: float = 3e-4,
    ) -> None:
        self.repulsion: Array = (
            np.full(len(pairs), influence) if repulsion is None else np.minimum(repulsion, influence)
        )
        self.bodies: BodySet = bodies
        self.pairs: Indices = pairs
        self.reach: Array = np.full(len(pairs), influence) if reach is None else np.minimum(reach, influence)
        self.tolerance: float = tolerance
        self.radius: Array = bounds.pair_radius(pairs)
        self.queries: int = 0
        self._coordinates = np.zeros((0, 0))
        self._base = np.zeros((0, 3, 4))
        self.native: NativeSelfPairs | None = NativeSelfPairs.of(bodies, pairs)
        self._arrays: _native.SelfDistances | None = None
        self._arrays_of: tuple[object, ...] = ()
        self._allocate(0)
        self._functors: dict[int, ShapePair] = {}  # made when the twin first asks
        self._solver = PairSolver()
        self._one, self._two = coal.Transform3s(), coal.Transform3s()

    def _allocate(self, n: int) -> None:
        """Arrays for n nodes about which nothing is known."""
        s = len(self.pairs)
        self.bound, self.exact, self._since = np.full((n, s), -FAR), np.full((n, s), np.inf), np.full((n, s), FAR)
        self.direction, self.first, self.second = np.zeros((n, s, 3)), np.zeros((n, s, 3)), np.zeros((n, s, 3))

    @property
    def arrays(self) -> _native.SelfDistances:
        """What is known, as the native half takes it."""
        of, kept = self._arrays_of, self._arrays
        if (
            kept is not None
            and of[0] is self.bound
            and of[1] is self._since
            and of[2] is self.exact
            and of[3] is self.direction
            and of[4] is self.first
            and of[5] is self.second
        ):
            return kept
        assert self.native is not None
        self._arrays_of = known = self.bound, self._since, self.exact, self.direction, self.first, self.second
        self._arrays = kept = self.native.distances(known, self.tolerance)
        return kept

    @exclusive
    def reset(self) -> None:
        """Forget everything; the next update starts from nothing."""
        self._coordinates = np.zeros((0, 0))

    @exclusive
    def remap(self, source: Indices) -> None:
        """Carry over to a strip whose node i was node ``source[i]``; −1 marks a new node."""
        if len(self._coordinates) == 0:
            return
        take, new = rows_from(source), source < 0
        for name in ("_coordinates", "_base", "bound", "exact", "direction", "first", "second", "_since"):
            setattr(self, name, getattr(self, name)[take])
        self.bound[new] = -FAR
        self._since[new] = FAR
        self._coordinates[new] = np.nan

    @exclusive
    def update(self, kin: Kinematics) -> None:
        """Bring bounds and exact distances up to date with the nodes of ``kin``."""
        coordinates = kin.coordinates[: kin.n]
        fresh = self._coordinates.shape != coordinates.shape
        if fresh:
            self._allocate(kin.n)
        self._base = kin.T[1 if self.bodies.tree.space.planar else 0, : kin.n].copy()
        before, self._coordinates = coordinates if fresh else self._coordinates, coordinates.copy()
        if self.native is not None:
            pairs, queries = self.native.calls.update(
                kin.T, self._coordinates, before, self.radius, self.reach, self.arrays
            )
            self.account(pairs, queries)
            return
        if not fresh:
            b = self.bodies.tree.space.base_nv
            delta = np.abs(coordinates[:, b:] - before[:, b:])
            shift = delta @ self.radius[b:]
            shift[np.isnan(shift)] = FAR
            self.bound -= shift
            self._since += shift
        done = 0
        for n in np.flatnonzero((self.bound[1:] <= -0.5 * FAR).any(axis=1)).tolist():
            self._refine(kin, done, n + 1)  # the node before has to be known
            self._learn(n + 1)
            done = n + 1
        self._refine(kin, done, kin.n)

    def _refine(self, kin: Kinematics, begin: int, end: int) -> None:
        """Make pairs at nodes ``begin`` to ``end`` exact that are below their reach and have moved."""
        nodes = slice(begin, end)
        node, pair = nonzero((self.bound[nodes] < self.reach) & (self._since[nodes] > self.tolerance))
        self._ask(kin, node + begin, pair, self.reach[pair])

    def _learn(self, n: int) -> None:
        """What the bounds at the node before say of pairs of which nothing is known: often that they are far apart."""
        known = self.bound[n - 1] - self.travel(self._coordinates[n : n + 1] - self._coordinates[n - 1 : n])[0]
        far = (self.bound[n] <= -0.5 * FAR) & (known >= self.reach)
        self.bound[n, far], self._since[n, far], self.exact[n, far] = known[far], FAR, np.inf

    @exclusive
    def refine_at(self, kin: Kinematics, node: Indices, pair: Indices, reach: Array) -> None:
        """Make the bounds of single pairs exact where they are below ``reach`` (K,) [m] and may be stale."""
        stale = (self.bound[node, pair] < reach) & (self._since[node, pair] > self.tolerance)
        self._ask(kin, node[stale], pair[stale], reach[stale])

    def _ask(self, kin: Kinematics, node: Indices, pair: Indices, reach: Array) -> None:
        if len(node) == 0:
            return
        cheap = self.cheap(kin, node, pair)
        far = cheap >= reach
        self.bound[node[far], pair[far]] = cheap[far]
        self._since[node[far], pair[far]] = FAR
        self.exact[node[far], pair[far]] = np.inf
        node, pair = node[~far], pair[~far]
        if len(node) == 0:
            return
        distance, direction, first, second = self.query(kin, node, pair)
        self.exact[node, pair] = distance
        self.bound[node, pair] = distance - GJK_EXCESS
        self._since[node, pair] = 0.0
        # kept in the base's frame: the base carries all links alike, and needs no new measurement
        rotation, translation = self._base[node, :, :3], self._base[node, :, 3]
        self.direction[node, pair] = _into(rotation, direction)
        self.first[node, pair] = _into(rotation, first - translation)
        self.second[node, pair] = _into(rotation, second - translation)

    def cheap(self, kin: Kinematics, node: Indices, pair: Indices) -> Array:
        """Lower bounds (K,) [m]: the distance between the capsules that contain the two bodies."""
        count_work(pairs=len(pair))
        bodies, one, two = self.bodies, self.pairs[pair, 0], self.pairs[pair, 1]
        ends = bodies.ends_at(kin, node, one), bodies.ends_at(kin, node, two)
        return segment_distance(*ends) - bodies.radius[one] - bodies.radius[two]

    @exclusive
    def query(self, kin: Kinematics, node: Indices, pair: Indices) -> tuple[Array, Array, Array, Array]:
        """Exact signed distances (K,) [m], directions (K, 3) and witness points (K, 3) on either body, world frame."""
        count = len(node)
        distance = np.empty(count)
        direction, first, second = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
        result = self._solver.result
        for k, d in enumerate(self._each(kin, node, pair)):
            distance[k] = d
            direction[k] = result.normal
            first[k] = result.getNearestPoint1()
            second[k] = result.getNearestPoint2()
        return distance, -direction, first, second

    def account(self, pairs: int, queries: int) -> None:
        """Account the work of the native kernel."""
        self.queries += queries
        count_work(pairs=pairs, queries=queries)

    @exclusive
    def distances(self, kin: Kinematics, node: Indices, pair: Indices) -> Array:
        """Exact signed distances (K,) [m]; cheaper than :meth:`query`, which reads the nearest points, too."""
        return np.fromiter(self._each(kin, node, pair), dtype=float, count=len(node))

    def _each(self, kin: Kinematics, node: Indices, pair: Indices) -> Iterator[float]:
        """Measure one pair after the other; the solver's result is that of the last."""
        self.queries += len(node)
        count_work(queries=len(node))
        r1, t1 = self.bodies.placements(kin, node, self.pairs[pair, 0])
        r2, t2 = self.bodies.placements(kin, node, self.pairs[pair, 1])
        one, two, ask, functors = self._one, self._two, self._solver.ask, self._functors
        for k, s in enumerate(pair.tolist()):
            one.setTransform(r1[k], t1[k])
            two.setTransform(r2[k], t2[k])
            if s not in functors:
                functors[s] = ShapePair.of(*(self.bodies.geometries[k] for k in self.pairs[s]))
            yield ask(functors[s], one, two)

    def travel(self, v: Array) -> Array:
        """Bounds (N, S) [m] on how far the two of each pair come nearer to each other along tangents (N, nv)."""
        b = self.bodies.tree.space.base_nv
        return np.abs(v[:, b:]) @ self.radius[b:]

    def nearer_than(self, distance: float) -> bool:
        """Whether some pair is surely nearer to each other than this [m], below their reach."""
        return bool((self.exact + self._since < distance).any())

    def contacts(self) -> SelfContacts:
        """All self pairs within their repulsion distance."""
        node, pair = at = np.nonzero((self.exact < self.repulsion) & (self._since <= self.tolerance))
        rotation, translation = self._base[node, :, :3], self._base[node, :, 3]
        direction = _out_of(rotation, self.direction[at])
        first, second = (_out_of(rotation, points[at]) + translation for points in (self.first, self.second))
        return SelfContacts(node, pair, self.exact[at], direction, first, second)


def _into(rotation: Array, vectors: Array) -> Array:
    """Rᵀ v for each of K rotations (K, 3, 3) and vectors (K, 3)."""
    return np.matmul(vectors[:, None, :], rotation)[:, 0, :]


def _out_of(rotation: Array, vectors: Array) -> Array:
    """R v for each of K rotations (K, 3, 3) and vectors (K, 3)."""
    return np.matmul(rotation, vectors[:, :, None])[:, :, 0]
