"""The certificate of a motion: the motion-bound proof over intervals of many samples at once.

A pair that is far for the whole motion needs two distances, not two a sample: the way that is left to travel between
two samples is the sum of the ways between those that lie between. Only where that does not do is the interval halved,
first at samples, then between two of them. The first distance below the clearance ends the search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask

from ..proximity import GJK_EXCESS, Ahead, BodySet, MotionBounds, Movers, Narrowphase, SelfProximity, Window
from ..robot import Kinematics
from ..scene import Scene
from .certificate import BrokenSegment, Certificate, SegmentState, undefined

_SLACK = 0.6
"""How far [m] a motion may leave the boxes of the window before it is collected anew."""
_LOOSE = 0.15
"""A box test may lie below the distance by the capsule's length and about this [m]; decides only what is asked."""

Measure = Callable[[Kinematics, Indices, Array, Indices], Array]
"""Distances (K,) at kinematics' nodes (K,), which are places (K,) of the motion, of pairs (K,)."""


@dataclass(slots=True)
class _Open:
    """Intervals of pairs that are not proven yet (struct of arrays); places are sample numbers, with fractions."""

    pair: Indices
    low: Array
    high: Array
    d_low: Array
    d_high: Array
    exact_low: Mask
    exact_high: Mask
    travel: Array

    def take(self, which: Mask) -> _Open:
        return _Open(*(getattr(self, name)[which] for name in self.__slots__))

    def __len__(self) -> int:
        return len(self.pair)

    def open(self, clearance: float) -> Mask:
        return self.d_low + self.d_high <= self.travel + 2.0 * clearance


@dataclass(frozen=True, slots=True, eq=False)
class _Family:
    """Pairs of one kind and how they are measured.

    Attributes:
        way: (N, K) how far the two of a pair can have come nearer to each other since the first sample [m].
        cheap: lower bounds at places; exact: distances there.
        loose: (K,) how far the lower bound may be off [m].
        clearance: to prove.
        broken: names the pair that comes too near, at a segment and with a distance.
    """

    way: Array
    cheap: Measure
    exact: Measure
    loose: Array
    clearance: float
    broken: Callable[[int, int, float, bool], BrokenSegment]

    def travel(self, low: Array, high: Array, pair: Indices) -> Array:
        return self._at(high, pair) - self._at(low, pair)

    def _at(self, place: Array, pair: Indices) -> Array:
        s = np.minimum(place.astype(np.intp), len(self.way) - 2)
        f = place - s
        return (1.0 - f) * self.way[s, pair] + f * self.way[s + 1, pair]


class MotionCertifier:
    """Workspace: certifies motions given as samples, among obstacles that move meanwhile.

    Args:
        bodies: the robot's links.
        bounds: their motion radii.
        pairs: (S, 2) pairs of bodies that must not touch.
        max_depth: most halvings between two samples.
    """

    def __init__(self, bodies: BodySet, bounds: MotionBounds, pairs: Indices, *, max_depth: int = 12) -> None:
        self.bodies, self.bounds, self.max_depth = bodies, bounds, max_depth
        self.window: Window | None = None
        self._narrow = Narrowphase(bodies)
        self._self = SelfProximity(bodies, pairs, bounds, influence=0.0)
        self._movers = Movers()
        self._kin, self._between = Kinematics(bodies.tree, 64), Kinematics(bodies.tree, 64)
        self._v = np.zeros((0, 0))
        self._checks = 0

    @property
    def queries(self) -> int:
        """Exact distance queries made so far."""
        return self._narrow.queries + self._self.queries

    def reset(self) -> None:
        """Forget the obstacles; for after an exception."""
        self.window = None

    def certify(
        self, chart: Array, v: Array, scene: Scene, ahead: Ahead, *, clearance: float, self_clearance: float
    ) -> Certificate:
        """Certify the way through samples.

        Args:
            chart: (N, nv) samples, N ≥ 2.
            v: (N−1, nv) tangents from each to the next: base and joints go on arcs and lines between them.
            scene: snapshot of the obstacles.
            ahead: where the moving ones are at each sample.
            clearance: required distance [m], > 0, to obstacles.
            self_clearance: required distance [m], > 0, between the robot's own links.

        Returns:
            Its ``broken`` is the first pair found too near; then nothing is said of the other segments.
        """
        n = len(v)
        self._checks = 0
        self._kin.update(chart, jacobians=False)
        self._v = np.vstack([v, np.zeros((1, v.shape[1]))])
        travel = self.bounds.travel(v)
        self._look(scene, ahead, clearance, travel)
        turns = np.flatnonzero(self.bodies.tree.space.half_turn(v))
        broken = undefined(self.bodies, int(turns[0])) if len(turns) else None
        if broken is None:
            broken = self._prove(self._obstacle_family(travel, clearance))
        if broken is None:
            broken = self._prove(self._self_family(v, self_clearance))
        states = np.full(n, SegmentState.CERTIFIED if broken is None else SegmentState.UNKNOWN, dtype=np.int8)
        if broken is not None and broken.certain:
            states[broken.segment] = SegmentState.COLLIDING
        return Certificate(clearance, states == SegmentState.CERTIFIED, states, broken, self._checks)

    def _look(self, scene: Scene, ahead: Ahead, clearance: float, travel: Array) -> None:
        """A window that holds all that comes within the clearance of the motion, and all that moves."""
        ends = self.bodies.capsule_ends(self._kin)
        radius = self.bodies.radius[:, None]
        # a point between two samples is no further from the nearer of them than half its way
        grow = clearance + 0.5 * float(travel.max(initial=0.0)) + 1e-6
        low = (ends.min(axis=(0, 2)) - radius).min(axis=0, keepdims=True) - grow
        high = (ends.max(axis=(0, 2)) + radius).max(axis=0, keepdims=True) + grow
        kept = self._movers.known(ahead) and self.window is not None and self.window.follow(scene) is not None
        if not kept or self.window is None or not self.window.covered(low, high).all():
            self.window = Window.build(scene, low, high, _SLACK, always=self._movers.always)
            self._narrow.retain(self.window.parts)
        self._movers.begin(ahead, self.window)

    def _obstacle_family(self, travel: Array, clearance: float) -> _Family:
        window, bodies, movers = self.window, self.bodies, self._movers
        assert window is not None
        g, p = len(bodies), len(window)
        body, part = np.repeat(np.arange(g), p), np.tile(np.arange(p), g)
        way = np.zeros((len(travel) + 1, g, p))
        np.cumsum(np.repeat(travel[:, :, None], p, axis=2), axis=0, out=way[1:])
        approach = movers.travel()
        if approach is not None:
            way[1:] += np.cumsum(approach, axis=0)[:, None, :]

        def moved(place: Array, pair: Indices) -> tuple[Array, Array] | None:
            s = np.minimum(place.astype(np.intp), len(travel) - 1)
            return movers.between(s, place - s, part[pair])

        def cheap(kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
            ends, radius = bodies.ends_at(kin, node, body[pair]), bodies.radius[body[pair]]
            by = moved(place, pair)
            if by is None:
                return window.capsule_distance(ends, radius, part[pair])
            return window.capsule_distance(ends - by[0][:, None], radius, part[pair]) - by[1]

        def exact(kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
            by = moved(place, pair)
            d = self._narrow.query(
                kin, node, body[pair], part[pair], window.parts, window.transforms, window.rotation,
                window.translation, -np.inf, None if by is None else by[0],
            )[0] - GJK_EXCESS  # fmt: skip
            return d if by is None else d - by[1]

        def broken(segment: int, pair: int, d: float, certain: bool) -> BrokenSegment:
            name = window.scene.names[int(window.obstacle[part[pair]])]
            return BrokenSegment(segment, bodies.names[int(body[pair])], name, d, "obstacle", certain)

        length = np.sqrt(((bodies.ends[:, 1] - bodies.ends[:, 0]) ** 2).sum(axis=1))
        return _Family(way.reshape(len(way), g * p), cheap, exact, length[body] + _LOOSE, clearance, broken)

    def _self_family(self, v: Array, clearance: float) -> _Family:
        proximity, b = self._self, self.bodies.tree.space.base_nv
        pairs = proximity.pairs
        way = np.zeros((len(v) + 1, len(pairs)))
        np.cumsum(np.abs(v[:, b:]) @ proximity.radius[b:], axis=0, out=way[1:])

        def exact(kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
            return proximity.distances(kin, node, pair) - GJK_EXCESS

        def broken(segment: int, pair: int, d: float, certain: bool) -> BrokenSegment:
            one, two = pairs[pair]
            return BrokenSegment(segment, self.bodies.names[one], self.bodies.names[two], d, "self", certain)

        def cheap(kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
            return proximity.cheap(kin, node, pair)

        return _Family(way, cheap, exact, np.full(len(pairs), _LOOSE), clearance, broken)

    def _prove(self, family: _Family) -> BrokenSegment | None:
        """Halve what is open until nothing is, something is too near, or it cannot be decided."""
        c, count, last = family.clearance, family.way.shape[1], float(len(family.way) - 1)
        if count == 0:
            return None
        pair, zero = np.arange(count), np.zeros(count)
        todo = _Open(
            pair, zero, zero + last, zero, zero, np.zeros(count, dtype=bool), np.zeros(count, dtype=bool),
            family.way[-1].copy(),
        )  # fmt: skip
        todo.d_low, todo.d_high = (self._measured(family.cheap, at, pair) for at in (todo.low, todo.high))
        todo = todo.take(todo.open(c))
        for _level in range(int(last).bit_length() + self.max_depth + 1):
            single = todo.high - todo.low <= 1.0
            for end in ("low", "high"):
                broken = self._settle(family, todo, end, single)
                if broken is not None:
                    return broken
            keep = todo.open(c)
            todo, single = todo.take(keep), single[keep]
            if len(todo) == 0:
                return None
            middle = 0.5 * (todo.low + todo.high)
            middle = np.where(single, middle, np.floor(middle))
            d = self._measured(family.cheap, middle, todo.pair)
            first, second = family.travel(todo.low, middle, todo.pair), family.travel(middle, todo.high, todo.pair)
            inexact = np.zeros(len(todo), dtype=bool)
            one = _Open(todo.pair, todo.low, middle, todo.d_low, d, todo.exact_low, inexact, first)
            two = _Open(todo.pair, middle, todo.high, d, todo.d_high, inexact, todo.exact_high, second)
            # an exact distance counts for both halves
            need = np.maximum(first - todo.d_low, second - todo.d_high) + 2.0 * c
            least = np.minimum(first - todo.d_low, second - todo.d_high) + 2.0 * c
            ask = np.flatnonzero((d < need) & (single | (d + family.loose[todo.pair] >= least) | (d <= c)))
            if len(ask):
                d[ask] = self._measured(family.exact, middle[ask], todo.pair[ask])
                inexact[ask] = True
                broken = self._too_near(family, middle[ask], todo.pair[ask], d[ask])
                if broken is not None:
                    return broken
            left, right = one.open(c), two.open(c)
            parts = (one.take(left), two.take(right))
            todo = _Open(*(np.concatenate([getattr(x, name) for x in parts]) for name in _Open.__slots__))
        if len(todo) == 0:
            return None
        d = np.minimum(todo.d_low, todo.d_high)
        k = int(np.argmin(d))
        return family.broken(self._segment(todo.low[k]), int(todo.pair[k]), float(d[k]), False)

    def _settle(self, family: _Family, todo: _Open, end: str, single: Mask) -> BrokenSegment | None:
        """Make distances at one end exact where that can close the interval, or where it is the last chance."""
        c = family.clearance
        d, exact, place = getattr(todo, f"d_{end}"), getattr(todo, f"exact_{end}"), getattr(todo, end)
        other = todo.d_high if end == "low" else todo.d_low
        gap = todo.travel + 2.0 * c - other - d
        ask = np.flatnonzero(~exact & (gap >= 0.0) & (single | (gap <= family.loose[todo.pair]) | (d <= c)))
        if len(ask) == 0:
            return None
        d[ask] = self._measured(family.exact, place[ask], todo.pair[ask])
        exact[ask] = True
        return self._too_near(family, place[ask], todo.pair[ask], d[ask])

    def _too_near(self, family: _Family, place: Array, pair: Indices, d: Array) -> BrokenSegment | None:
        k = int(np.argmin(d))
        if d[k] > family.clearance:
            return None
        return family.broken(self._segment(place[k]), int(pair[k]), float(d[k]), True)

    def _segment(self, place: float) -> int:
        return min(int(place), len(self._v) - 2)

    def _measured(self, measure: Measure, place: Array, pair: Indices) -> Array:
        """Distances at places, samples or between them."""
        sample = place.astype(np.intp)
        whole = place == sample
        if whole.all():
            return measure(self._kin, sample, place, pair)
        d = np.empty(len(place))
        d[whole] = measure(self._kin, sample[whole], place[whole], pair[whole])
        part = ~whole
        unique, inverse = np.unique(place[part], return_inverse=True)
        s = unique.astype(np.intp)
        q = self.bodies.tree.space.integrate(self._kin.chart[s], (unique - s)[:, None] * self._v[s])
        self._between.update(q, jacobians=False)
        self._checks += len(unique)
        d[part] = measure(self._between, inverse, place[part], pair[part])
        return d
