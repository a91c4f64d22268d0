"""Obstacle proximity: lower bounds of every body–part distance along a strip, exact where they matter.

The workspace keeps, for each (node, body, part), a bound that is *never above* the true distance. When a node or a
part moves, the bound falls by at most how far it moved; only where it falls below the influence distance is a box
test made, and only where that fails too does Coal measure. So a tick measures what is near and has moved, and
nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.constants import FAR, GJK_EXCESS
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics
from elastic_strips.robot.space import nonzero, rows_from
from elastic_strips.scene import Scene
from elastic_strips.work import count_work

from .bounds import BodySet
from .candidates import CandidateParts, MovingParts, NodePrediction
from .narrowphase import Contacts, Narrowphase

if TYPE_CHECKING:
    from elastic_strips.native import _native

_MOVING_TOLERANCE = 2e-3
"""Predictions are never as exact as this [m]: distances to moving parts are measured again only beyond it."""


class ObstacleProximity(OneThread):
    """Workspace: distances of a strip's bodies to a scene's parts, kept from tick to tick.

    Args:
        bodies: the bodies of the robot that are measured.
        influence: distances below this [m] are computed exactly.
        tolerance: an exact distance is measured again once its body or part has moved by more than this [m].
        slack: how far [m] the strip may drift before the candidates are collected anew.

    Attributes:
        bound: (N, G, P) lower bounds [m].
        exact: (N, G, P) distances [m] where they were measured, else ∞.
        direction, witness: (N, G, P, 3) direction away from the obstacle, and nearest point on the robot.
        margin: (N,) every part that is not a candidate is at least this far [m] from the node's bodies.
    """

    bound: Array
    exact: Array
    direction: Array
    witness: Array

    def __init__(self, bodies: BodySet, *, influence: float, tolerance: float = 3e-4, slack: float = 0.4) -> None:
        self.bodies = bodies
        self.influence = influence
        self.tolerance = tolerance
        self.slack = slack
        self.narrow: Narrowphase = Narrowphase(bodies)
        self.candidates: CandidateParts | None = None
        self.margin: Array = np.zeros(0)
        self.moving: MovingParts = MovingParts()
        self._cover = np.zeros(0, dtype=np.intp)
        self._coordinates = np.zeros((0, 0))
        self._arrays: _native.Distances | None = None
        self._arrays_of: tuple[object, ...] = ()
        self._allocate(0, 0)

    def _allocate(self, n: int, p: int) -> None:
        """Arrays for n nodes and p parts about which nothing is known."""
        g = len(self.bodies)
        self.bound, self._since = np.full((n, g, p), -FAR), np.full((n, g, p), FAR)
        self.exact = np.full((n, g, p), np.inf)
        self.direction, self.witness = np.zeros((n, g, p, 3)), np.zeros((n, g, p, 3))
        self._ends, self._frames = np.zeros((n, g, 2, 3)), np.zeros((n, g, 3, 3))
        self._limit = np.full(p, self.tolerance)

    @exclusive
    def reset(self) -> None:
        """Forget everything; the next update starts from nothing."""
        self.candidates = None
        self._coordinates = np.zeros((0, 0))

    def knows(self, scene: Scene) -> bool:
        """Whether the last update was for the same obstacles, wherever they were, and with a forecast."""
        candidates = self.candidates
        return candidates is not None and self.moving.prediction is not None and candidates.scene.names == scene.names

    @exclusive
    def remap(self, source: Indices) -> None:
        """Carry the bounds over to a strip whose node i was node ``source[i]``; −1 marks a new node.

        A new node starts with unknown bounds; call :meth:`update` next.
        """
        if self.candidates is None:
            return
        take, new = rows_from(source), source < 0
        self.moving.remap(take)
        self._cover = np.where(new, -1, self._cover[take])
        for name in ("_coordinates", "_ends", "margin", "_frames", "bound", "exact", "_since"):
            setattr(self, name, getattr(self, name)[take])
        if isinstance(take, slice):
            self.direction, self.witness = self.direction[take], self.witness[take]
        else:
            self._take_contacts(take, None)
        self.bound[new] = -FAR
        self._since[new] = FAR
        self._coordinates[new] = np.nan

    @exclusive
    def update(self, kin: Kinematics, scene: Scene, prediction: NodePrediction | None = None) -> None:
        """Bring all bounds and exact distances up to date with the nodes of ``kin`` and a scene snapshot.

        Args:
            kin: kinematics of the nodes (N).
            scene: the snapshot.
            prediction: where some of its obstacles will be when each node is reached; None where all of them stay.
        """
        columns = None if self.candidates is None else self.candidates.follow(scene)
        same = self.candidates is not None and self._coordinates.shape == kin.coordinates[: kin.n].shape
        inside = same and self._follow(kin)
        unknown = prediction is not None and not self.moving.known(prediction)
        if columns is None or not inside or unknown:
            self._rebuild(kin, scene, columns, carry=same)
            columns = None
        self._predict(prediction, columns)
        self.refine(kin)

    def _follow(self, kin: Kinematics) -> bool:
        """Lower the bounds of nodes that moved; False where the candidates may not hold all that is near them."""
        coordinates = kin.coordinates[: kin.n]
        candidates, native = self.candidates, self.narrow.native
        assert candidates is not None
        if native is None:
            moved = np.flatnonzero((coordinates != self._coordinates).any(axis=1))
            if len(moved) == 0:
                return True
            ends = self.bodies.capsule_ends(kin)
            self._drift(kin, ends, moved)
            self._remember(kin, ends, moved)
            return self._keep_margin(ends, moved)
        lost = native.calls.follow(
            kin.T,
            coordinates,
            self.influence,
            self._coordinates,
            self._ends,
            self._frames,
            candidates.cover_low,
            candidates.cover_high,
            self._cover,
            self.margin,
            self.arrays,
        )
        return not lost or self._cover_anew(*self._boxes(self._ends[lost]), np.array(lost))

    def _predict(self, prediction: NodePrediction | None, columns: Indices | None) -> None:
        """Lower the bounds by how far parts have moved, or are now expected to have moved when a node is reached."""
        candidates, moving = self.candidates, self.moving
        assert candidates is not None
        if columns is not None and not len(columns) and prediction is None and moving.prediction is None:
            return
        if columns is None:
            moving.begin(prediction, candidates)
            self._mark(moving.columns, -FAR, FAR)
        else:
            before, former = moving.prediction, moving.columns
            moved = moving.advance(prediction, candidates, columns)
            if moved is not None:
                at, travel, uncertainty = moved
                nearer, since = np.zeros((2, len(travel), 1, self.bound.shape[2]))  # whole rows: no gaps in between
                nearer[:, 0, at], since[:, 0, at] = travel + uncertainty, travel + np.abs(uncertainty)
                self.bound -= nearer
                self._since += since
            if before is not None and before.ignored.any():  # nothing is known of these
                self._mark(before.ignored[:, None, None] & former, -FAR, FAR)
        self._limit[:] = np.where(moving.columns, max(self.tolerance, _MOVING_TOLERANCE), self.tolerance)
        if moving.prediction is not None and moving.prediction.ignored.any():
            self._mark(moving.prediction.ignored[:, None, None] & moving.columns, FAR, 0.0)

    @property
    def arrays(self) -> _native.Distances:
        """What is known, as the native half takes it."""
        of, kept, candidates = self._arrays_of, self._arrays, self.candidates
        if (
            kept is not None
            and of[0] is candidates
            and of[1] is self.bound
            and of[2] is self._since
            and of[3] is self.exact
            and of[4] is self.direction
            and of[5] is self.witness
            and of[6] is self._limit
        ):
            return kept
        assert candidates is not None
        assert self.narrow.native is not None
        known = self.bound, self._since, self.exact, self.direction, self.witness, self._limit
        self._arrays_of = candidates, *known
        self._arrays = kept = self.narrow.native.distances(candidates, known)
        return kept

    def _mark(self, where: Mask, bound: float, since: float) -> None:
        """Set what is known of pairs of a mask that broadcasts to (N, G, P)."""
        for array, value in ((self.bound, bound), (self.exact, np.inf), (self._since, since)):
            np.copyto(array, value, where=where)

    def _boxes(self, ends: Array) -> tuple[Array, Array]:
        """Boxes (M, 3) that hold all bodies at configurations with these capsule ends (M, G, 2, 3)."""
        radius = self.bodies.radius[:, None]
        low = (np.minimum(ends[:, :, 0], ends[:, :, 1]) - radius).min(axis=1)
        high = (np.maximum(ends[:, :, 0], ends[:, :, 1]) + radius).max(axis=1)
        return low, high

    def _keep_margin(self, ends: Array, moved: Indices) -> bool:
        """Update how deep moved nodes are inside the candidates' boxes; False where one is not deep enough in any."""
        candidates = self.candidates
        assert candidates is not None
        low, high = self._boxes(ends[moved])
        cover = self._cover[moved]
        depth = np.minimum(
            (low - candidates.cover_low[cover]).min(axis=1), (candidates.cover_high[cover] - high).min(axis=1)
        )
        depth[cover < 0] = -1.0
        lost = np.flatnonzero(depth < self.influence)
        self.margin[moved] = depth
        return len(lost) == 0 or self._cover_anew(low[lost], high[lost], moved[lost])

    def _cover_anew(self, low: Array, high: Array, nodes: Indices) -> bool:
        """Nodes that left their box of candidates; whether others hold all that is near their own boxes (M, 3)."""
        assert self.candidates is not None
        grow = self.influence
        if not self.candidates.covered(low - grow, high + grow).all():
            return False
        self.margin[nodes], self._cover[nodes] = grow, -1
        return True

    @exclusive
    def look_between(self, kin: Kinematics, between: Kinematics, reach: Array) -> bool:
        """Make sure that the candidates hold all parts within ``reach`` (M,) [m] of configurations between the nodes.

        Args:
            kin: kinematics of the nodes, as last given to :meth:`update`.
            between: kinematics of the M configurations.
            reach: (M,) [m].

        Returns:
            Whether the candidates had to be collected anew; then all bounds have been measured again.
        """
        candidates = self.candidates
        assert candidates is not None
        low, high = self._boxes(self.bodies.capsule_ends(between))
        low, high = low - reach[:, None], high + reach[:, None]
        new = ~candidates.covered(low, high)
        if not new.any():
            return False
        self._rebuild(kin, candidates.scene, np.zeros(0, dtype=np.intp), low[new], high[new], carry=True)
        self._predict(self.moving.prediction, None)
        self.refine(kin)
        return True

    def _rebuild(self, kin: Kinematics, scene: Scene, changed: Indices | None, *more: Array, carry: bool) -> None:
        """Collect the candidates about the nodes, and about ``more`` boxes: two arrays (M, 3), low and high.

        Args:
            kin, scene, more: as described above.
            changed: the candidates' columns whose pose has changed already; None where the scene has other obstacles.
            carry: whether the known distances belong to these nodes; they stay then for parts that are where they were.
        """
        before = self.candidates
        ends = self._ends if carry else self.bodies.capsule_ends(kin)
        body_low, body_high = self._boxes(ends)
        low, high = body_low - self.influence, body_high + self.influence
        low[:-1], high[:-1] = np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])  # and what lies between
        if more:
            low, high = np.vstack((low, more[0])), np.vstack((high, more[1]))
        self.candidates = CandidateParts.build(scene, low, high, self.slack, always=self.moving.always)
        self.narrow.retain(self.candidates.parts)
        n = kin.n
        inner = np.minimum(body_low - self.candidates.cover_low[:n], self.candidates.cover_high[:n] - body_high)
        self.margin, self._cover = inner.min(axis=1), np.arange(n)
        if carry and before is not None and len(before):
            self._carry(before, changed)
        else:
            self._allocate(n, len(self.candidates))
            self._remember(kin, ends, None)

    def _carry(self, before: CandidateParts, changed: Indices | None) -> None:
        """Take over what is known of candidates that are still there, stand where they stood, and are not forecast."""
        candidates = self.candidates
        assert candidates is not None
        stands = ~self.moving.columns
        if changed is not None:
            stands[changed] = False
        at = {id(part): c for c, part in enumerate(before.parts) if stands[c]}
        source = np.array([at.get(id(part), -1) for part in candidates.parts], dtype=np.intp)
        known = source >= 0
        known &= (candidates.translation == before.translation[source]).all(axis=1)
        known &= (candidates.rotation == before.rotation[source]).all(axis=(1, 2))
        if len(before) != len(candidates) or (source[known] != np.flatnonzero(known)).any():  # columns have moved
            self.bound, self._since, self.exact = (
                a.take(source, axis=2) for a in (self.bound, self._since, self.exact)
            )
            self._take_contacts(None, source)
        new = np.flatnonzero(~known)
        self.bound[:, :, new], self._since[:, :, new], self.exact[:, :, new] = -FAR, FAR, np.inf
        self._limit = np.full(len(candidates), self.tolerance)

    def _take_contacts(self, nodes: Indices | None, parts: Indices | None) -> None:
        """Directions and witness points of nodes, or parts, that were these: only where a distance is known."""
        node, body, part = nonzero(self.exact < np.inf)
        at = (node if nodes is None else nodes[node], body, part if parts is None else parts[part])
        direction, witness = self.direction, self.witness
        self.direction, self.witness = np.zeros((2, *self.exact.shape, 3))
        self.direction[node, body, part], self.witness[node, body, part] = direction[at], witness[at]

    def _drift(self, kin: Kinematics, ends: Array, moved: Indices) -> None:
        """Lower the bounds of moved nodes by how far any point of each body can have moved."""
        shift = np.sqrt(((ends[moved] - self._ends[moved]) ** 2).sum(axis=3)).max(axis=2)
        turn = self._rotations(kin, moved) - self._frames[moved]
        shift += self.bodies.radius * np.sqrt(0.5 * np.einsum("ngij,ngij->ng", turn, turn))
        shift[np.isnan(shift)] = FAR
        if len(moved) == len(self.bound):
            self.bound -= shift[:, :, None]
            self._since += shift[:, :, None]
        else:
            self.bound[moved] -= shift[:, :, None]
            self._since[moved] += shift[:, :, None]

    def _rotations(self, kin: Kinematics, nodes: Indices) -> Array:
        return kin.T[self.bodies.joint[None, :], nodes[:, None]][..., :3]

    def _remember(self, kin: Kinematics, ends: Array, moved: Indices | None) -> None:
        if moved is None:
            self._ends = np.ascontiguousarray(ends)
            self._frames = np.ascontiguousarray(self._rotations(kin, np.arange(kin.n)))
            self._coordinates = kin.coordinates[: kin.n].copy()
        elif len(moved):
            self._ends[moved] = ends[moved]
            self._frames[moved] = self._rotations(kin, moved)
            self._coordinates[moved] = kin.coordinates[moved]

    @exclusive
    def refine(self, kin: Kinematics) -> None:
        """Make every pair exact whose bound is below the influence distance and that moved since it was measured."""
        candidates, narrow = self.candidates, self.narrow
        assert candidates is not None
        if narrow.native is not None:
            scene = narrow.native.scene(candidates, self.moving)
            self.account(*narrow.native.calls.refine(kin.T, *scene, self.influence, self.arrays))
            return
        need = (self.bound < self.influence) & (self._since > self._limit)
        node, body, part = nonzero(need)
        self._ask(kin, node, body, part, self.influence)

    @exclusive
    def refine_at(self, kin: Kinematics, node: Indices, body: Indices, part: Indices, reach: Array) -> None:
        """Make the bounds of single pairs exact where they are below ``reach`` (K,) [m] and may be stale."""
        stale = (self.bound[node, body, part] < reach) & (self._since[node, body, part] > 0.0)
        self._ask(kin, node[stale], body[stale], part[stale], reach[stale])

    def account(self, pairs: int, queries: int) -> None:
        """Account the work of the native kernel."""
        self.narrow.queries += queries
        count_work(pairs=pairs, queries=queries)

    def _ask(self, kin: Kinematics, node: Indices, body: Indices, part: Indices, reach: Array | float) -> None:
        candidates = self.candidates
        assert candidates is not None
        if len(node) == 0:
            return
        moved = self.moving.displaced(node, part)
        cheap = candidates.capsule_distance(self._ends[node, body], self.bodies.radius[body], part, moved)
        far = cheap >= reach
        self.bound[node[far], body[far], part[far]] = cheap[far]
        self.exact[node[far], body[far], part[far]] = np.inf
        self._since[node[far], body[far], part[far]] = FAR
        near = ~far
        node, body, part = node[near], body[near], part[near]
        if len(node) == 0:
            return
        shift, uncertainty = (None, 0.0) if moved is None else (moved[0][near], moved[1][near])
        distance, direction, witness = self.narrow.query(
            kin, node, body, part, candidates, self.influence + float(np.max(uncertainty)), shift
        )
        distance -= uncertainty
        self.exact[node, body, part] = distance
        self.bound[node, body, part] = distance - GJK_EXCESS
        self._since[node, body, part] = 0.0
        self.direction[node, body, part] = direction
        self.witness[node, body, part] = witness

    def contacts(self) -> Contacts:
        """All pairs within the influence distance, exact to the tolerance."""
        node, body, part = at = nonzero((self.exact < self.influence) & (self._since <= self._limit))
        return Contacts(node, body, part, self.exact[at], self.direction[at], self.witness[at])

    def clearance(self) -> Array:
        """Lower bound (N, G) [m] of each body's distance to any obstacle, capped at the influence distance."""
        if self.bound.shape[2] == 0:
            return np.full(self.bound.shape[:2], self.influence)
        return np.minimum(self.bound.min(axis=2), self.influence)

    def least_clearance(self) -> float:
        """The smallest of :meth:`clearance` [m]."""
        return float(self.bound.min(initial=self.influence))

    def nearer_than(self, distance: float) -> bool:
        """Whether some body is surely nearer to an obstacle than this [m], below the influence distance."""
        return bool((self.exact + self._since < distance).any())

    def obstacle_name(self, part: int) -> str:
        """Name of the obstacle that a column belongs to."""
        assert self.candidates is not None
        return self.candidates.obstacle_name(part)
