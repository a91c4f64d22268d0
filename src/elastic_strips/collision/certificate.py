"""The certificate: proof that a robot keeps its clearance all along a path, by one branch and bound for all of it.

Between two configurations no point of a body travels further than Λ. So the body stays further than c from an obstacle
all along if d_a + d_b − 2c > Λ, with d_a, d_b lower bounds of its distance at the two ends (Schwarzer, Saha and
Latombe). Where that fails for a pair of body and obstacle part, or of two bodies, this pair alone is measured half-way,
and the halves are tested again. At the depth floor the answer is *unknown*, never *safe*.

A proof gives three things to the :class:`Bisection`: the pairs and how they are measured (:class:`Pairs`), the
intervals that are open at first, with what is known about them, and the purpose of the distances (:class:`Search`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.constants import CAPSULE_LOOSE, EXACT_WITHIN, GJK_EXCESS, MOST_OPEN_INTERVALS, OPEN_INTERVALS_A_PAIR
from elastic_strips.errors import plural
from elastic_strips.robot import Kinematics
from elastic_strips.summary import Summary

from .bounds import BodySet
from .candidates import CandidateParts, MovingParts
from .narrowphase import Narrowphase, lower_bounds
from .self_distance import SelfProximity

_HALF_TURN = "half turn"
LEFT_PATH = "path"


class SegmentState(int, Enum):
    """What is known about a segment."""

    CERTIFIED = 0
    UNKNOWN = 1
    COLLIDING = 2


@dataclass(frozen=True, slots=True)
class BrokenSegment:
    """Where and why a strip is not certified.

    Attributes:
        segment: index j of the segment between nodes j and j + 1.
        link: name of the robot's collision piece.
        obstacle: name of the obstacle, or of the other link for self-collision.
        clearance: smallest distance measured there [m]; it is below the required one, or too small to decide.
        kind: ``"obstacle"``, ``"self"``, ``"half turn"`` where the segment's path is not defined, or ``"path"`` where
            the base leaves a path that it was to keep to: then ``clearance`` is minus the distance beyond what is
            allowed.
        certain: True where a configuration below the required clearance was found, False where the depth floor was met.
        labels: names of link and obstacle in messages; a link that is one piece has the URDF's name there.
        required: the clearance that was to be kept [m]; None where that is not known here.
    """

    segment: int
    link: str
    obstacle: str
    clearance: float
    kind: str
    certain: bool
    labels: tuple[str, str] | None = field(default=None, repr=False, compare=False)
    required: float | None = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        link, obstacle = self.labels or (self.link, self.obstacle)
        said = f"{abs(self.clearance) * 1000:.1f} mm"
        if self.kind == _HALF_TURN:
            return f"segment {self.segment}: {link} makes half a turn, and which way is not defined: add a node"
        if self.kind == LEFT_PATH:
            return f"segment {self.segment}: {link} is up to {said} further from {obstacle} than allowed"
        if not self.certain:
            return f"segment {self.segment}: {link} could not be proven clear of {obstacle} ({said})"
        if self.clearance < 0.0:
            return f"segment {self.segment}: {link} is {said} deep in {obstacle}"
        asked = f", nearer than the {self.required * 1000:g} mm to be kept" if self.required else ""
        return f"segment {self.segment}: {link} comes within {said} of {obstacle}{asked}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(Summary):
    """Result of certifying a strip.

    Attributes:
        clearance: the distance [m] that was certified against.
        segments: (N−1,) True where certified.
        states: (N−1,) :class:`SegmentState` values.
        broken: the worst uncertified segment, or None.
        checks: number of configurations measured between nodes.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> scene = es.Scene([es.Box((0.4, 0.4, 1.0), at=(2.0, 0.0, 0.5), name="crate")])
        >>> strip = es.Strip(robot, [robot.home(x=0.2 * k) for k in range(16)])
        >>> certificate = es.Deformer(robot).step(strip, scene).certificate
        >>> certificate.certified, certificate.broken.obstacle  # a line through an obstacle gives no certificate
        (False, 'crate')
    """

    clearance: float
    segments: Mask
    states: npt.NDArray[np.int8]
    broken: BrokenSegment | None
    checks: int

    def _summary(self) -> dict[str, object]:
        proven = f"{int(self.segments.sum())} of {plural(len(self.segments), 'segment')}"
        return {"certified": proven, "clearance": f"{self.clearance:g} m", "broken": str(self.broken)}

    @property
    def certified(self) -> bool:
        """Whether every segment is certified."""
        return bool(self.segments.all())


_Measure = Callable[[Kinematics, Indices, Array, Indices], Array]


class Pairs(Protocol):
    """Numbered pairs that have to stay apart, and how they are measured.

    The measures give distances (K,) [m] of ``pair`` (K,) at nodes (K,) of ``kin``; ``place`` (K,) is where on the path.
    """

    def lower_bounds(self, kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
        """Cheap distances, never above the true ones."""
        ...

    def distances(self, kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
        """Distances, less the most by which Coal's may be too large."""
        ...

    def loose(self, pair: Indices) -> Array:
        """How far (K,) [m] the lower bounds may be off."""
        ...

    def broken(self, segment: int, pair: int, distance: float, certain: bool) -> BrokenSegment:
        """The report of a pair that is too near, or that could not be decided."""
        ...


@dataclass(frozen=True, slots=True)
class ObstaclePairs:
    """Pairs of a body and one of P obstacle parts, numbered body·P + part."""

    bodies: BodySet
    narrow: Narrowphase
    candidates: CandidateParts
    moving: MovingParts

    def lower_bounds(self, kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
        body, part = self._split(pair)
        return lower_bounds(self.bodies, kin, (node, body, part), self.candidates, self.moving.between(place, part))

    def distances(self, kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
        body, part = self._split(pair)
        moved = self.moving.between(place, part)
        shift = None if moved is None else moved[0]
        d = self.narrow.query(kin, node, body, part, self.candidates, -np.inf, shift)[0] - GJK_EXCESS
        return d if moved is None else d - moved[1]

    def _split(self, pair: Indices) -> tuple[Indices, Indices]:
        body = pair // len(self.candidates)
        return body, pair - body * len(self.candidates)

    def loose(self, pair: Indices) -> Array:
        ends = self.bodies.ends
        length = np.sqrt(((ends[:, 1] - ends[:, 0]) ** 2).sum(axis=1))
        return length[pair // len(self.candidates)] + CAPSULE_LOOSE

    def broken(self, segment: int, pair: int, distance: float, certain: bool) -> BrokenSegment:
        body, part = divmod(pair, len(self.candidates))
        link, obstacle = self.bodies.names[body], self.candidates.obstacle_name(part)
        labels = self.bodies.labels[body], obstacle
        return BrokenSegment(segment, link, obstacle, distance, "obstacle", certain, labels)


@dataclass(frozen=True, slots=True)
class SelfPairs:
    """Pairs of the robot's own bodies, numbered as in the proximity."""

    proximity: SelfProximity

    def lower_bounds(self, kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
        return self.proximity.cheap(kin, node, pair)

    def distances(self, kin: Kinematics, node: Indices, place: Array, pair: Indices) -> Array:
        return self.proximity.distances(kin, node, pair) - GJK_EXCESS

    def loose(self, pair: Indices) -> Array:
        return np.full(len(pair), CAPSULE_LOOSE)

    def broken(self, segment: int, pair: int, distance: float, certain: bool) -> BrokenSegment:
        bodies, (one, two) = self.proximity.bodies, self.proximity.pairs[pair]
        labels = bodies.labels[one], bodies.labels[two]
        return BrokenSegment(segment, bodies.names[one], bodies.names[two], distance, "self", certain, labels)


@dataclass(slots=True)
class OpenIntervals:
    """Intervals of pairs that are not proven yet (struct of arrays).

    Attributes:
        pair: (K,) numbers of the pairs.
        low, high: (K,) places on the path: node numbers with fractions. An interval lies within one segment or goes
            from a node to a node.
        d_low, d_high: (K,) lower bounds of the distances there [m].
        exact_low, exact_high: (K,) whether ``d_low`` and ``d_high`` were measured exactly.
        travel: (K,) Λ, how far the two of a pair can come nearer to each other on the interval [m].
    """

    pair: Indices
    low: Array
    high: Array
    d_low: Array
    d_high: Array
    exact_low: Mask
    exact_high: Mask
    travel: Array

    @staticmethod
    def of_segments(pair: Indices, segment: Indices, d_low: Array, d_high: Array, travel: Array) -> OpenIntervals:
        """Whole segments ``segment`` (K,) of pairs; the distances at their nodes need not be measured again."""
        known, low = np.ones(len(pair), dtype=bool), segment.astype(float)
        return OpenIntervals(pair, low, low + 1.0, d_low, d_high, known, known, travel)

    @property
    def segment(self) -> Indices:
        """(K,) the segment that the interval begins in."""
        return self.low.astype(np.intp)

    def take(self, which: Mask | Indices) -> OpenIntervals:
        """The intervals of a selection."""
        return OpenIntervals(*(getattr(self, name)[which] for name in self.__slots__))

    def joined(self, other: OpenIntervals) -> OpenIntervals:
        """These intervals, and then the others."""
        return OpenIntervals(*(np.concatenate((getattr(self, x), getattr(other, x))) for x in self.__slots__))

    def open(self, clearance: float) -> Mask:
        """Which intervals the lemma does not prove; a value that is not a number proves nothing."""
        return ~(self.d_low + self.d_high > self.travel + 2.0 * clearance)

    def __len__(self) -> int:
        return len(self.pair)


class Search(Protocol):
    """The purpose of a search, which says which distances are wanted."""

    @property
    def clearance(self) -> float:
        """Intervals are open as long as they may hold a distance up to this [m]."""
        ...

    @property
    def exact_below(self) -> float:
        """Distances that may be below this [m] are measured exactly, even where a lower bound closes the interval."""
        ...

    @property
    def decided(self) -> Mask | None:
        """(N−1,) segments about which nothing more is wanted, or None where all are wanted to the end."""
        ...

    def found(self, place: Array, pair: Indices, d: Array) -> bool:
        """Take exact distances (K,) [m]; True ends the search."""
        ...


class Bisection:
    """Workspace that halves open intervals along one path until none is left.

    Args:
        kin: kinematics of the path's nodes (N).
        v: (N−1, nv) tangents from each to the next.
        between: workspace for configurations between them.

    Attributes:
        checks: number of configurations measured between nodes of the path.
    """

    def __init__(self, kin: Kinematics, v: Array, between: Kinematics) -> None:
        self.checks: int = 0
        self._kin, self._v, self._between = kin, v, between

    def run(
        self, pairs: Pairs, todo: OpenIntervals, search: Search, depth: int, total: Array | None = None
    ) -> OpenIntervals:
        """Halve the open intervals, level by level; returns those that are open after ``depth`` levels, or too many.

        Args:
            pairs: how the intervals' pairs are measured.
            todo: the intervals; one that spans several segments is halved at nodes first.
            search: the search that takes the distances.
            depth: largest number of levels.
            total: (N, pairs) how far the two of each pair can have come nearer to each other since the first node [m];
                None where all intervals lie in one segment.
        """
        most = OPEN_INTERVALS_A_PAIR * len(todo) + MOST_OPEN_INTERVALS
        for _level in range(depth):
            single = todo.high - todo.low <= 1.0
            if not (todo.exact_low.all() and todo.exact_high.all()):
                if self._settle(pairs, todo, search, single, "low") or self._settle(
                    pairs, todo, search, single, "high"
                ):
                    break
                keep = todo.open(search.clearance)
                todo, single = todo.take(keep), single[keep]
            if len(todo) == 0:
                break
            middle = 0.5 * (todo.low + todo.high)
            first = second = 0.5 * todo.travel
            if total is not None and not single.all():
                middle = np.where(single, middle, np.floor(middle))
                many = np.flatnonzero(~single)
                low, at, high = (x[many].astype(np.intp) for x in (todo.low, middle, todo.high))
                first, second, pair = first.copy(), second.copy(), todo.pair[many]
                first[many], second[many] = total[at, pair] - total[low, pair], total[high, pair] - total[at, pair]
            where = self._locate(middle)
            d = self._measure(pairs.lower_bounds, where, middle, todo.pair)
            c = search.clearance
            one, two = first - todo.d_low + 2.0 * c, second - todo.d_high + 2.0 * c  # from here on, a half is proven
            need = d < np.maximum(np.maximum(one, two), search.exact_below) + EXACT_WITHIN
            if total is not None:  # of a long interval, only what can close a half; it is halved anyway
                need &= single | (d + pairs.loose(todo.pair) >= np.minimum(one, two)) | (d <= c)
            ask = np.flatnonzero(need)
            exact = np.zeros(len(todo), dtype=bool)
            if len(ask):
                d[ask] = self._measure(pairs.distances, where, middle, todo.pair, ask)
                exact[ask] = True
                if search.found(middle[ask], todo.pair[ask], d[ask]):
                    return todo.take(ask[:0])
            left = OpenIntervals(todo.pair, todo.low, middle, todo.d_low, d, todo.exact_low, exact, first)
            right = OpenIntervals(todo.pair, middle, todo.high, d, todo.d_high, exact, todo.exact_high, second)
            keep_left, keep_right = left.open(search.clearance), right.open(search.clearance)
            decided = search.decided
            if decided is not None:
                alive = ~decided[todo.segment]
                keep_left &= alive
                keep_right &= alive
            todo = left.take(keep_left).joined(right.take(keep_right))
            if total is not None and len(todo) > most:
                break
        return todo

    def _settle(self, pairs: Pairs, todo: OpenIntervals, search: Search, single: Mask, end: str) -> bool:
        """Make distances at one end exact where that can close the interval, or where it is the last chance."""
        place, d, exact = getattr(todo, end), getattr(todo, f"d_{end}"), getattr(todo, f"exact_{end}")
        gap = todo.travel + 2.0 * search.clearance - todo.d_low - todo.d_high
        ask = np.flatnonzero(
            ~exact & (gap >= 0.0) & (single | (gap <= pairs.loose(todo.pair)) | (d <= search.clearance))
        )
        if len(ask) == 0:
            return False
        d[ask] = self._measure(pairs.distances, self._locate(place[ask]), place[ask], todo.pair[ask])
        exact[ask] = True
        return search.found(place[ask], todo.pair[ask], d[ask])

    def _locate(self, place: Array) -> tuple[Indices, Mask | None]:
        """Locate places: numbers of nodes, or of configurations between nodes where the mask says so or is None."""
        node = place.astype(np.intp)
        between = place != node
        if between.all():
            return self._interpolate(place), None
        if between.any():
            node[between] = self._interpolate(place[between])
        return node, between

    def _interpolate(self, place: Array) -> Indices:
        """Bring the configurations between nodes up to date; returns their numbers (K,)."""
        unique, inverse = np.unique(place, return_inverse=True)
        s = unique.astype(np.intp)
        q = self._kin.tree.space.integrate(self._kin.coordinates[s], (unique - s)[:, None] * self._v[s])
        self._between.update(q, jacobians=False)
        self.checks += len(unique)
        return inverse

    def _measure(
        self,
        measure: _Measure,
        where: tuple[Indices, Mask | None],
        place: Array,
        pair: Indices,
        only: Indices | None = None,
    ) -> Array:
        """Distances at places that are located, or at some of them only."""
        node, between = where
        if only is not None:
            node, between = node[only], None if between is None else between[only]
            place, pair = place[only], pair[only]
        if between is None:
            return measure(self._between, node, place, pair)
        d = np.empty(len(place))
        for kin, at in ((self._kin, ~between), (self._between, between)):
            if at.any():
                d[at] = measure(kin, node[at], place[at], pair[at])
        return d


def half_turn(bodies: BodySet, segment: int) -> BrokenSegment:
    """The report of a segment that makes half a turn."""
    return BrokenSegment(segment, bodies.names[0], "", 0.0, _HALF_TURN, False, (bodies.labels[0], ""))
