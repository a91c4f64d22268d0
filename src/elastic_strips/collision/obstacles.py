"""Obstacle proximity: lower bounds of every body–part distance along a strip, exact where they matter.

The workspace keeps, for each (node, body, part), a bound that is *never above* the true distance. When a node or a
part moves, the bound falls by at most how far it moved; only where it falls below the influence distance is a box
test made, and only where that fails too does Coal measure. So a tick measures what is near and has moved, and
nothing else. Where there are very many parts, each body has its own row of those that are near it, and one *floor* that
all others keep: it falls as the body moves, and before it comes down to the influence distance the rows are made anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.constants import FAR, GJK_EXCESS
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics
from elastic_strips.robot.space import rows_from
from elastic_strips.scene import Scene
from elastic_strips.work import count_work

from .bounds import BodySet
from .candidates import CandidateParts, MovingParts, NodePrediction
from .narrowphase import Contacts, Narrowphase, lower_bounds
from .near_parts import NearParts

if TYPE_CHECKING:
    from elastic_strips.native import _native

_FEW_PAIRS = 60_000
"""So many pairs of nodes, bodies and parts are all kept: rows of what is near pay only above."""
_ROOM = 0.15
"""Rows hold parts up to this much [m] beyond the influence distance: so far a body may move without others."""
_MOST_ALWAYS = 64
"""So many parts that move are in every row; where more do, the floor of all bodies falls instead."""
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
        margin: (N,) every part that is not a candidate is at least this far [m] from the node's bodies.
    """

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
        self._allocate(NearParts.all_of(0, len(bodies), 0))

    def _allocate(self, rows: NearParts) -> None:
        """Arrays for rows about which nothing is known."""
        n, g, p = rows.shape
        k = len(rows)
        self._rows = rows
        self._floor, self._wanted = np.full((n, g), np.inf), np.zeros((n, g))
        self._always = np.zeros(p, dtype=bool)
        self._bound, self._since, self._exact = np.full(k, -FAR), np.full(k, FAR), np.full(k, np.inf)
        self._direction, self._witness = np.empty((2, k, 3))  # read only where a distance is known
        self._ends, self._frames = np.zeros((n, g, 2, 3)), np.zeros((n, g, 3, 3))
        self._limit = np.full(p, self.tolerance)

    @property
    def bound(self) -> Array:
        """(N, G, P) lower bounds [m], made when they are asked for: of parts that are not near, one for all."""
        n, g, p = self._rows.shape
        bound = np.repeat(self._floor, p)
        bound[self._rows.row * p + self._rows.part] = self._bound
        return bound.reshape(n, g, p)

    @property
    def exact(self) -> Array:
        """(N, G, P) distances [m] where they were measured, else ∞; made when they are asked for."""
        n, g, p = self._rows.shape
        exact = np.full(n * g * p, np.inf)
        exact[self._rows.row * p + self._rows.part] = self._exact
        return exact.reshape(n, g, p)

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
        for name in ("_coordinates", "_ends", "margin", "_frames", "_floor", "_wanted"):
            setattr(self, name, getattr(self, name)[take])
        rows, (n, g, p) = self._rows, self._rows.shape
        if rows.full and not isinstance(take, slice):  # whole nodes are faster than single pairs
            known = self._bound, self._since, self._exact
            self._bound, self._since, self._exact = (a.reshape(n, g * p)[take].ravel() for a in known)
            self._rows = rows if len(take) == n else NearParts.all_of(len(take), g, p)
            at = np.flatnonzero(self._exact < np.inf)
            self._take_contacts(at, take[at // (g * p)] * (g * p) + at % (g * p) if p else at)
        else:
            self._rows, at = rows.nodes(take)
            self._take(at)
        if new.any():
            of_new = np.repeat(new, np.diff(self._rows.start[:: len(self.bodies)]))
            self._bound[of_new] = -FAR
            self._since[of_new] = FAR
            self._floor[new & (self._floor < np.inf).any(axis=1)] = -np.inf  # its rows are those of another node
        self._coordinates[new] = np.nan

    def _take(self, at: Indices | slice) -> None:
        """Take over what is known of pairs that were at places ``at`` (K,)."""
        self._bound, self._since, self._exact = self._bound[at], self._since[at], self._exact[at]
        if isinstance(at, slice):
            self._direction, self._witness = self._direction[at], self._witness[at]
        else:
            known = np.flatnonzero(self._exact < np.inf)
            self._take_contacts(known, at[known])

    def _take_contacts(self, known: Indices, at: Indices) -> None:
        """Take over directions and witnesses of measured pairs; of the others there is nothing to take over."""
        direction, witness = self._direction, self._witness
        self._direction, self._witness = np.empty((2, len(self._exact), 3))
        self._direction[known], self._witness[known] = direction[at], witness[at]

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
        if not self._rows.full and not (self._floor > self.influence).all():
            self._look_again(self._below(self.influence + 0.5 * _ROOM))  # what soon needs it as well: it is not often
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
            self._everywhere(moving.columns)
            self._mark(moving.columns, -FAR, FAR)
        else:
            before, former = moving.prediction, moving.columns
            moved = moving.advance(prediction, candidates, columns)
            if moved is not None:
                self._come_nearer(*moved)
            if before is not None and before.ignored.any():  # nothing is known of these
                self._mark(before.ignored[:, None] & former, -FAR, FAR)
        self._limit[:] = np.where(moving.columns, max(self.tolerance, _MOVING_TOLERANCE), self.tolerance)
        if moving.prediction is not None and moving.prediction.ignored.any():
            self._mark(moving.prediction.ignored[:, None] & moving.columns, FAR, 0.0)

    def _come_nearer(self, columns: Indices, travel: Array, uncertainty: Array) -> None:
        """Lower the bounds of parts ``columns`` (C,) by how far (N or 1, C) [m] they have moved, and got uncertain."""
        rows, nearer, since = self._rows, travel + uncertainty, travel + np.abs(uncertainty)
        if not rows.full:
            self._everywhere(self.moving.columns)
            aside = ~self._always[columns]
            if aside.any() and self._always.sum() + aside.sum() <= _MOST_ALWAYS:
                wanted = self._always.copy()
                wanted[columns] = True
                self._everywhere(wanted)
            elif aside.any():
                self._floor -= nearer[:, aside].max(axis=1, initial=0.0)[:, None]
            rows = self._rows
        if rows.full:
            n, g, p = rows.shape
            self._bound.reshape(n, g, p)[:, :, columns] -= nearer[:, None, :]
            self._since.reshape(n, g, p)[:, :, columns] += since[:, None, :]
            return
        number = np.full(rows.shape[2], -1)
        number[columns] = np.arange(len(columns))
        at = np.flatnonzero(number[rows.part] >= 0)
        node = rows.row[at] // rows.shape[1] if len(travel) > 1 else np.zeros(len(at), dtype=np.intp)
        self._bound[at] -= nearer[node, number[rows.part[at]]]
        self._since[at] += since[node, number[rows.part[at]]]

    def _everywhere(self, parts: Mask) -> None:
        """From now on these parts (P,) are in every row."""
        if self._rows.full or not (parts & ~self._always).any():
            return
        self._always = self._always | parts
        self._look_again(np.ones(self._rows.shape[0], dtype=bool))

    def _look_again(self, fresh: Mask, source: Indices | None = None) -> None:
        """Make the rows of nodes ``fresh`` (N,) anew: what is nearer than the influence distance, and some room.

        Args:
            fresh: the nodes.
            source: (P,) which part each was when the rows were made; −1 for a new one. All the same where None.
        """
        candidates, p = self.candidates, len(self._always)
        assert candidates is not None
        one, two = self._ends[:, :, 0], self._ends[:, :, 1]
        floor = np.maximum(self.influence, self._wanted) + _ROOM
        radius = 0.5 * np.sqrt(((two - one) ** 2).sum(axis=2)) + self.bodies.radius + floor
        self._rows, at = self._rows.again(
            0.5 * (one + two),
            radius,
            *candidates.boxes(),
            always=self._always,
            fresh=fresh,
            source=np.arange(p) if source is None else source,
        )
        new = at < 0
        if len(self._bound):
            self._take(np.maximum(at, 0))
        else:
            self._bound, self._since, self._exact = np.empty((3, len(at)))
            self._direction, self._witness = np.empty((2, len(at), 3))
        self._bound[new], self._since[new], self._exact[new] = -FAR, FAR, np.inf
        self._floor = np.where(fresh[:, None], floor, self._floor)

    @exclusive
    def reach_out(self, kin: Kinematics, need: Array) -> None:
        """Make sure that bounds at the ends of segments sum up to more than ``need`` (N−1, G) [m] for all parts that
        are not in the rows of both ends.

        Args:
            kin: kinematics of the nodes, as last given to :meth:`update`.
            need: what the two bounds of a body have to exceed [m].
        """
        if self._rows.full:
            return
        least = self._least(np.minimum(self._floor, self.influence))
        wanted = np.zeros(self._floor.shape)
        wanted[:-1] = need - least[1:]
        wanted[1:] = np.maximum(wanted[1:], need - least[:-1])
        if not (self._floor > wanted).all():
            self._wanted = np.maximum(wanted, 0.0)
            self._look_again(self._below(wanted))
            self.refine(kin)

    def _below(self, least: Array | float) -> Mask:
        """(N,) nodes with a floor that is not above ``least`` (N, G) [m]."""
        return np.asarray(~(self._floor > least).all(axis=1), dtype=bool)

    def _least(self, most: Array) -> Array:
        """(N, G) the smallest bound [m] of each row, or ``most`` (N, G) where none is below it."""
        if self._rows.full and self._rows.shape[2]:
            return np.minimum(self._bound.reshape(*most.shape, -1).min(axis=2), most)
        first, last = self._rows.start[:-1], self._rows.start[1:]
        least, some = most.ravel().copy(), last > first
        if some.any():
            least[some] = np.minimum(least[some], np.minimum.reduceat(self._bound, first[some]))
        return least.reshape(most.shape)

    @property
    def arrays(self) -> _native.Distances:
        """What is known, as the native half takes it."""
        of, kept, candidates = self._arrays_of, self._arrays, self.candidates
        if (
            kept is not None
            and of[0] is candidates
            and of[1] is self._bound
            and of[2] is self._since
            and of[3] is self._exact
            and of[4] is self._direction
            and of[5] is self._witness
            and of[6] is self._limit
            and of[7] is self._rows
            and of[8] is self._floor
        ):
            return kept
        assert candidates is not None
        assert self.narrow.native is not None
        known = self._bound, self._since, self._exact, self._direction, self._witness, self._limit
        rows = self._rows
        self._arrays_of = candidates, *known, rows, self._floor
        self._arrays = kept = self.narrow.native.distances(candidates, known, (rows.start, rows.part), self._floor)
        return kept

    def _mark(self, where: Mask, bound: float, since: float) -> None:
        """Set what is known of parts (P,), or of parts at nodes (N, P), which are in every row."""
        if not where.any():
            return
        rows = self._rows
        at = where[rows.part] if where.ndim == 1 else where[rows.row // rows.shape[1], rows.part]
        self._bound[at], self._exact[at], self._since[at] = bound, np.inf, since

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
        if self.narrow.native is None:
            self.narrow.retain(self.candidates.parts)
        n = kin.n
        inner = np.minimum(body_low - self.candidates.cover_low[:n], self.candidates.cover_high[:n] - body_high)
        self.margin, self._cover = inner.min(axis=1), np.arange(n)
        if carry and before is not None and len(before):
            self._carry(before, changed)
        else:
            all_parts = NearParts.all_of(n, len(self.bodies), 0 if self._many() else len(self.candidates))
            self._allocate(all_parts)
            self._remember(kin, ends, None)
            if self._many():
                self._apart(np.full(len(self.candidates), -1))

    def _many(self) -> bool:
        """Whether there are so many pairs that rows of what is near pay."""
        assert self.candidates is not None
        return len(self.margin) * len(self.bodies) * len(self.candidates) > _FEW_PAIRS

    def _apart(self, source: Indices) -> None:
        """Rows of what is near, where candidates were ``source`` (P,) in the rows that there are."""
        p = len(source)
        self._limit = np.full(p, self.tolerance)
        self._always = (source >= 0) & self._always[source] if len(self._always) else np.zeros(p, dtype=bool)
        self._look_again(np.ones(len(self.margin), dtype=bool), source)

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
        source[~known] = -1
        rows, p = self._rows, len(candidates)
        if self._many() or not rows.full:
            self._apart(source)
            return
        n, g, former = rows.shape
        self._limit = np.full(p, self.tolerance)
        if len(before) != p or (source[known] != np.flatnonzero(known)).any():  # columns have moved
            self._rows, self._always = NearParts.all_of(n, g, p), np.zeros(p, dtype=bool)
            self._take((np.arange(n * g)[:, None] * former + source).ravel())
        new = np.flatnonzero(~known)
        bound, since, exact = (a.reshape(n, g, p) for a in (self._bound, self._since, self._exact))
        bound[:, :, new], since[:, :, new], exact[:, :, new] = -FAR, FAR, np.inf

    def _drift(self, kin: Kinematics, ends: Array, moved: Indices) -> None:
        """Lower the bounds of moved nodes by how far any point of each body can have moved."""
        shift = np.sqrt(((ends[moved] - self._ends[moved]) ** 2).sum(axis=3)).max(axis=2)
        turn = self._rotations(kin, moved) - self._frames[moved]
        shift += self.bodies.radius * np.sqrt(0.5 * np.einsum("ngij,ngij->ng", turn, turn))
        shift[np.isnan(shift)] = FAR
        each = np.zeros(self._floor.shape)
        each[moved] = shift
        self._floor -= each
        by = np.repeat(each, np.diff(self._rows.start))
        self._bound -= by
        self._since += by

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
        need = (self._bound < self.influence) & (self._since > self._limit[self._rows.part])
        self._ask(kin, np.flatnonzero(need), self.influence)

    @exclusive
    def refine_at(self, kin: Kinematics, at: Indices, reach: Array) -> None:
        """Make the bounds of pairs at places ``at`` (K,) exact where they are below ``reach`` (K,) [m] and may be
        stale.
        """
        stale = (self._bound[at] < reach) & (self._since[at] > 0.0)
        self._ask(kin, at[stale], reach[stale])

    def account(self, pairs: int, queries: int) -> None:
        """Account the work of the native kernel."""
        self.narrow.queries += queries
        count_work(pairs=pairs, queries=queries)

    def _ask(self, kin: Kinematics, at: Indices, reach: Array | float) -> None:
        candidates = self.candidates
        assert candidates is not None
        if len(at) == 0:
            return
        node, body, part = self._rows.triple(at)
        moved = self.moving.displaced(node, part)
        cheap = lower_bounds(self.bodies, kin, (node, body, part), candidates, moved, reach)
        far = cheap >= reach
        self._bound[at[far]] = cheap[far]
        self._exact[at[far]] = np.inf
        self._since[at[far]] = FAR
        near = ~far
        at, node, body, part = at[near], node[near], body[near], part[near]
        if len(at) == 0:
            return
        shift, uncertainty = (None, 0.0) if moved is None else (moved[0][near], moved[1][near])
        distance, direction, witness = self.narrow.query(
            kin, node, body, part, candidates, self.influence + float(np.max(uncertainty)), shift
        )
        distance -= uncertainty
        self._exact[at] = distance
        self._bound[at] = distance - GJK_EXCESS
        self._since[at] = 0.0
        self._direction[at] = direction
        self._witness[at] = witness

    def contacts(self) -> Contacts:
        """All pairs within the influence distance, exact to the tolerance."""
        at = np.flatnonzero(self._exact < self.influence)
        at = at[self._since[at] <= self._limit[self._rows.part[at]]]
        return Contacts(*self._rows.triple(at), self._exact[at], self._direction[at], self._witness[at])

    def open_at(self, states: npt.NDArray[np.int8], need: Array, approach: Array | None) -> tuple[Indices, Indices]:
        """Pairs that the bounds at both ends of a segment leave open: their places (M,) at the one and at the other.

        Args:
            states: (N−1,) only segments of state 0 count.
            need: (N−1, G) what the two bounds of a body have to exceed [m].
            approach: (N−1, P) what is to be added to that for each part [m], if any moves.
        """
        here, there = self._rows.neighbours()
        slack = self._bound[here] + self._bound[there]
        row, g = self._rows.row[here], self._rows.shape[1]
        slack -= need.ravel()[row]
        if approach is not None:
            slack -= approach[row // g, self._rows.part[here]]
        left = ~(slack > 0.0) & (states[row // g] == 0)
        return here[left], there[left]

    def within(self, distance: float) -> Indices:
        """Places (M,) of pairs whose bound is at most this [m]."""
        return np.flatnonzero(self._bound <= distance)

    def known_at(self, at: Indices) -> tuple[Array, tuple[Indices, Indices, Indices]]:
        """Bounds (M,) [m] of pairs at places ``at`` (M,), and their nodes, bodies and parts (M,)."""
        return self._bound[at], self._rows.triple(at)

    def clearance(self) -> Array:
        """Lower bound (N, G) [m] of each body's distance to any obstacle, capped at the influence distance."""
        return self._least(np.full(self._floor.shape, self.influence))

    def least_clearance(self) -> float:
        """The smallest of :meth:`clearance` [m]."""
        return float(self._bound.min(initial=self.influence))

    def nearer_than(self, distance: float) -> bool:
        """Whether some body is surely nearer to an obstacle than this [m], below the influence distance."""
        return bool((self._exact + self._since < distance).any())

    def obstacle_name(self, part: int) -> str:
        """Name of the obstacle that a column belongs to."""
        assert self.candidates is not None
        return self.candidates.obstacle_name(part)
