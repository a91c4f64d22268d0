"""The certificate of a motion: the motion-bound proof over intervals of many samples at once.

A pair that is far for the whole motion needs two distances, not two for each sample: what a body may travel between two
samples is the sum over the segments between them. Only where that is not enough is the interval halved, first at
samples, then between two of them. The first distance below the clearance ends the search.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from elastic_strips.arrays import Array, Indices, by_rows
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics
from elastic_strips.scene import Scene
from elastic_strips.work import count_work

from .bounds import BodySet, MotionBounds
from .candidates import CandidateParts, MovingParts, NodePrediction
from .certificate import (
    Bisection,
    BrokenSegment,
    Certificate,
    ObstaclePairs,
    OpenIntervals,
    Pairs,
    SegmentState,
    SelfPairs,
    half_turn,
)
from .narrowphase import Narrowphase
from .self_distance import SelfProximity

if TYPE_CHECKING:
    from elastic_strips.native import _native

_CANDIDATE_MARGIN = 0.6
"""How far [m] a motion may leave the boxes about the candidates before they are collected anew."""
_MOST_HALVINGS = 12
"""Most halvings between two samples."""


class MotionCertifier(OneThread):
    """Workspace: certifies motions given as samples, among obstacles that move meanwhile.

    Args:
        bodies: the robot's links.
        bounds: their motion radii.
        pairs: (S, 2) pairs of bodies that must not touch.
    """

    def __init__(self, bodies: BodySet, bounds: MotionBounds, pairs: Indices) -> None:
        self.bodies: BodySet = bodies
        self.bounds: MotionBounds = bounds
        self.candidates: CandidateParts | None = None
        self._narrow = Narrowphase(bodies)
        self._self = SelfProximity(bodies, pairs, bounds, influence=0.0)
        self._moving = MovingParts()
        self._kin = Kinematics(bodies.tree, 64)
        self._between = Kinematics(bodies.tree, 64)
        self.checks: int = 0

    @property
    def queries(self) -> int:
        """Exact distance queries made so far."""
        return self._narrow.queries + self._self.queries

    @exclusive
    def reset(self) -> None:
        """Forget the obstacles, as is needed after an exception."""
        self.candidates = None

    @exclusive
    def certify(
        self,
        coordinates: Array,
        v: Array,
        scene: Scene,
        prediction: NodePrediction,
        *,
        clearance: float,
        self_clearance: float,
    ) -> Certificate:
        """Certify the motion through samples.

        Args:
            coordinates: (N, nv) samples, N ≥ 2.
            v: (N−1, nv) tangents from each to the next: base and joints go on arcs and lines between them.
            scene: snapshot of the obstacles.
            prediction: where the moving obstacles are at each sample.
            clearance: required distance [m], > 0, to obstacles.
            self_clearance: required distance [m], > 0, between the robot's own links.

        Returns:
            The certificate. Its ``broken`` is the first pair found too near; then nothing is said about the other
            segments.
        """
        (v,) = by_rows(v)
        count_work(batches=1)
        self._kin.update(coordinates, jacobians=False)
        self.checks = 0
        travel = self.bounds.travel(v)
        self._look(scene, prediction, clearance, travel)
        turns = np.flatnonzero(self.bodies.tree.space.half_turn(v))
        broken = half_turn(self.bodies, int(turns[0])) if len(turns) else None
        if broken is None:
            broken = self._prove_obstacles(v, travel, clearance)
        if broken is None:
            broken = self._prove_self(v, self_clearance)
        states = np.full(len(v), SegmentState.CERTIFIED if broken is None else SegmentState.UNKNOWN, dtype=np.int8)
        if broken is not None and broken.certain:
            states[broken.segment] = SegmentState.COLLIDING
        return Certificate(clearance, states == SegmentState.CERTIFIED, states, broken, self.checks)

    def _look(self, scene: Scene, prediction: NodePrediction, clearance: float, travel: Array) -> None:
        """Candidates: all parts that come within the clearance of the motion, and all that move."""
        ends = self.bodies.capsule_ends(self._kin)
        radius = self.bodies.radius[:, None]
        # a point between two samples is no further from the nearer of them than half its travel
        grow = clearance + 0.5 * float(travel.max(initial=0.0)) + 1e-6
        low = (ends.min(axis=(0, 2)) - radius).min(axis=0, keepdims=True) - grow
        high = (ends.max(axis=(0, 2)) + radius).max(axis=0, keepdims=True) + grow
        candidates = self.candidates if self._moving.known(prediction) else None
        if candidates is None or candidates.follow(scene) is None or not candidates.covered(low, high).all():
            candidates = self.candidates = CandidateParts.build(
                scene, low, high, _CANDIDATE_MARGIN, always=self._moving.always
            )
            self._narrow.retain(candidates.parts)
        self._moving.begin(prediction, candidates)

    def _prove_obstacles(self, v: Array, travel: Array, clearance: float) -> BrokenSegment | None:
        candidates, count = self.candidates, len(self.bodies)
        assert candidates is not None
        approach = self._moving.travel()
        pairs = ObstaclePairs(self.bodies, self._narrow, candidates, self._moving)
        if self._narrow.native is not None:
            native = self._narrow.native
            found = native.calls.prove(
                self._kin.T,
                self._kin.coordinates[: self._kin.n],
                v,
                *native.scene(candidates, self._moving),
                travel,
                approach,
                clearance,
                _depth(len(travel)),
            )
            return self._proof(pairs, found, len(travel))
        total = np.zeros((len(travel) + 1, count, len(candidates)))
        np.cumsum(np.repeat(travel[:, :, None], len(candidates), axis=2), axis=0, out=total[1:])
        if approach is not None:
            total[1:] += np.cumsum(approach, axis=0)[:, None, :]
        return self._prove(pairs, v, total.reshape(len(total), count * len(candidates)), clearance)

    def _prove_self(self, v: Array, clearance: float) -> BrokenSegment | None:
        travel, pairs = self._self.travel(v), SelfPairs(self._self)
        if self._self.native is not None:
            found = self._self.native.calls.prove(
                self._kin.T, self._kin.coordinates[: self._kin.n], v, travel, clearance, _depth(len(v))
            )
            return self._proof(pairs, found, len(v))
        total = np.zeros((len(v) + 1, len(self._self.pairs)))
        np.cumsum(travel, axis=0, out=total[1:])
        return self._prove(pairs, v, total, clearance)

    def _proof(self, pairs: Pairs, found: _native.Proof, segments: int) -> BrokenSegment | None:
        """The certificate of the native kernel's findings."""
        broken, checks, (bounded, queries) = found
        self.checks += checks
        count_work(pairs=bounded, queries=queries)
        self._narrow.queries += queries
        if broken is None:
            return None
        place, pair, distance, certain = broken
        return pairs.broken(min(int(place), segments - 1), pair, distance, certain)

    def _prove(self, pairs: Pairs, v: Array, total: Array, clearance: float) -> BrokenSegment | None:
        """One interval for each pair, from the first sample to the last, is halved until all is proven."""
        last, pair = len(total) - 1, np.arange(total.shape[1])
        if len(pair) == 0:
            return None
        low = np.zeros(len(pair))
        high = low + last
        d_low, d_high = (pairs.lower_bounds(self._kin, at.astype(np.intp), at, pair) for at in (low, high))
        unknown = np.zeros(len(pair), dtype=bool)
        todo = OpenIntervals(pair, low, high, d_low, d_high, unknown, unknown, total[-1])
        search = _MotionSearch(pairs, clearance, last)
        todo = todo.take(todo.open(clearance))
        bisection = Bisection(self._kin, v, self._between)
        left = bisection.run(pairs, todo, search, _depth(last), total)
        self.checks += bisection.checks
        if search.broken is None and len(left):
            d = np.minimum(left.d_low, left.d_high)
            k = int(np.argmin(d))
            return pairs.broken(min(int(left.low[k]), last - 1), int(left.pair[k]), float(d[k]), False)
        return search.broken


def _depth(segments: int) -> int:
    """Largest number of halvings of a motion with this many segments."""
    return segments.bit_length() + _MOST_HALVINGS + 1


class _MotionSearch:
    """The first distance below the clearance ends the search."""

    decided = None

    def __init__(self, pairs: Pairs, clearance: float, segments: int) -> None:
        self.pairs, self.clearance, self.exact_below, self.segments = pairs, clearance, clearance, segments
        self.broken: BrokenSegment | None = None

    def found(self, place: Array, pair: Indices, d: Array) -> bool:
        k = int(np.argmin(d))
        if d[k] > self.clearance:
            return False
        segment = min(int(place[k]), self.segments - 1)
        self.broken = self.pairs.broken(segment, int(pair[k]), float(d[k]), True)
        return True
