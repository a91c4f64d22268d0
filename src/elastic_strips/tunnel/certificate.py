"""The motion-bound certificate: proof, segment by segment, that the interpolated strip keeps its clearance.

Between two configurations no point of a body travels further than Λ. So the body stays further than c from an obstacle
on the whole way if d_a + d_b − 2c > Λ, with d_a, d_b lower bounds of its distance at the two ends (Schwarzer, Saha and
Latombe). Where that fails for a (segment, body, obstacle part), this triple alone is measured half-way, and the
halves are asked again. At the depth floor the answer is *unknown*, never *safe*.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices, Mask

from ..proximity import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from ..robot import Kinematics
from ..robot.space import where_true
from ..scene import Scene
from ..summary import Summary

HALF_TURN = "half turn"


class SegmentState(int, Enum):
    """What is known of a segment."""

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
        clearance: smallest distance measured there [m]; below the required one, or too small to decide.
        kind: ``"obstacle"``, ``"self"``, or ``"half turn"`` where the segment's way is not defined.
        certain: True where a configuration below the required clearance was found, False where the depth floor was met.
    """

    segment: int
    link: str
    obstacle: str
    clearance: float
    kind: str
    certain: bool

    def __str__(self) -> str:
        if self.kind == HALF_TURN:
            return f"segment {self.segment}: {self.link} makes half a turn, and which way is not defined: add a node"
        what = "comes within" if self.certain else "could not be proven clear of"
        return f"segment {self.segment}: {self.link} {what} {self.obstacle} ({self.clearance * 1000:.1f} mm)"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(Summary):
    """Result of certifying a strip.

    Attributes:
        clearance: the distance [m] that was certified against.
        segments: (N−1,) True where certified.
        states: (N−1,) :class:`SegmentState` values.
        broken: the worst uncertified segment, or None.
        checks: number of configurations measured between nodes.
    """

    clearance: float
    segments: npt.NDArray[np.bool_]
    states: npt.NDArray[np.int8]
    broken: BrokenSegment | None
    checks: int

    def _summary(self) -> dict[str, object]:
        proven = f"{int(self.segments.sum())} of {len(self.segments)} segments"
        return {"certified": proven, "clearance": f"{self.clearance:g} m", "broken": str(self.broken)}

    @property
    def certified(self) -> bool:
        """Whether every segment is certified."""
        return bool(self.segments.all())


_MOST_SAMPLES = 256
"""Most configurations of one segment about which obstacles are looked for."""


@dataclass(slots=True)
class _Open:
    """Open triples of one bisection level (struct of arrays)."""

    segment: Indices
    body: Indices  # body, or self pair
    part: Indices  # obstacle part; −1 for a self pair
    low: Array  # fractions of the segment
    high: Array
    d_low: Array
    d_high: Array
    travel: Array  # Λ over the interval

    def take(self, mask: Mask) -> _Open:
        return _Open(*(getattr(self, name)[mask] for name in self.__slots__))

    def __len__(self) -> int:
        return len(self.segment)


class Certifier:
    """Workspace: certifies strips for which the two proximities are up to date.

    Args:
        bodies: the robot's links.
        bounds: their motion radii.
        obstacles, self_pairs: proximities of the strip's nodes.
        max_depth: most halvings of a segment.
    """

    def __init__(
        self,
        bodies: BodySet,
        bounds: MotionBounds,
        obstacles: ObstacleProximity,
        self_pairs: SelfProximity,
        *,
        max_depth: int = 12,
    ) -> None:
        self.bodies, self.bounds, self.obstacles, self.self_pairs = bodies, bounds, obstacles, self_pairs
        self.max_depth = max_depth
        self._between = Kinematics(bodies.tree, 64)

    def certify(
        self, kin: Kinematics, v: Array, *, clearance: float, self_clearance: float, scene: Scene
    ) -> Certificate:
        """Certify the segments between the nodes of ``kin``.

        Args:
            kin: kinematics of the nodes (N), as last given to the proximities.
            v: (N−1, nv) tangents of the segments.
            clearance: required distance [m], > 0, to obstacles.
            self_clearance: required distance [m], > 0, between the robot's own links.
            scene: the snapshot, as last given to the obstacle proximity.
        """
        n = kin.n - 1
        states = np.zeros(n, dtype=np.int8)
        travel = self.bounds.travel(v)
        checks = self._look_along(kin, v, travel, clearance, scene)
        worst: list[BrokenSegment] = []
        for j in np.flatnonzero(self.bodies.tree.space.half_turn(v)).tolist():
            states[j] = SegmentState.UNKNOWN
            worst.append(undefined(self.bodies, j))
        self._colliding_nodes(kin, clearance, states, worst)
        open_obstacles = self._open_obstacles(kin, v, travel, clearance, states)
        open_self = self._open_self(kin, v, self_clearance)
        for triples, is_self in ((open_obstacles, False), (open_self, True)):
            if len(triples):
                checks += self._bisect(
                    kin, v, triples, self_clearance if is_self else clearance, states, worst, is_self
                )
        worst.sort(key=lambda b: (not b.certain, b.clearance))
        return Certificate(clearance, states == 0, states, worst[0] if worst else None, checks)

    def _colliding_nodes(
        self, kin: Kinematics, clearance: float, states: npt.NDArray[np.int8], worst: list[BrokenSegment]
    ) -> None:
        """A node that is itself too close decides both its segments."""
        bound = self.obstacles.bound
        if bound.shape[2] == 0:
            return
        node, body, part = where_true(bound <= clearance)
        self.obstacles.refine_at(kin, node, body, part, np.full(len(node), clearance + 1e-4))
        nearest = bound.reshape(len(bound), -1).min(axis=1)
        bad = np.flatnonzero(nearest <= clearance)
        if len(bad) == 0:
            return
        last = len(states) - 1
        states[np.minimum(bad, last)] = SegmentState.COLLIDING
        states[np.maximum(bad - 1, 0)] = SegmentState.COLLIDING
        node = int(bad[np.argmin(nearest[bad])])
        body, part = np.unravel_index(int(np.argmin(bound[node])), bound.shape[1:])
        worst.append(
            BrokenSegment(
                min(node, last), self.bodies.names[body], self.obstacles.obstacle_name(int(part)), float(nearest[node]),
                "obstacle", True,
            )
        )  # fmt: skip

    def _open_obstacles(
        self, kin: Kinematics, v: Array, travel: Array, clearance: float, states: npt.NDArray[np.int8]
    ) -> _Open:
        bound = self.obstacles.bound
        slack = bound[:-1] + bound[1:]
        slack -= (travel + 2.0 * clearance)[:, :, None]
        approach = self.obstacles.movers.travel()
        if approach is not None:
            slack -= approach[:, None, :]
        slack[states != 0] = np.inf
        segment, body, part = where_true(slack <= 0.0)
        if len(segment) == 0:
            return _empty()
        # second chance with the tight travel of these bodies, then with refreshed distances at the ends
        key = segment * len(self.bodies) + body
        unique, inverse = np.unique(key, return_inverse=True)
        s, g = unique // len(self.bodies), unique % len(self.bodies)
        tight = self.bounds.tight_travel(kin, s, g, v[s])[inverse]
        if approach is not None:
            tight = tight + approach[segment, part]
        keep = bound[segment, body, part] + bound[segment + 1, body, part] <= tight + 2.0 * clearance
        segment, body, part, tight = segment[keep], body[keep], part[keep], tight[keep]
        if len(segment) == 0:
            return _empty()
        # what is far at one end is decided by the other: a bound up to the whole sum is good enough at each
        for end in (0, 1):
            other = bound[segment + 1 - end, body, part]
            self.obstacles.refine_at(kin, segment + end, body, part, tight + 2.0 * clearance - other + 1e-4)
        d_low, d_high = bound[segment, body, part], bound[segment + 1, body, part]
        count = len(segment)
        triples = _Open(segment, body, part, np.zeros(count), np.ones(count), d_low, d_high, tight)
        return triples.take(d_low + d_high <= tight + 2.0 * clearance)

    def _open_self(self, kin: Kinematics, v: Array, clearance: float) -> _Open:
        proximity = self.self_pairs
        if proximity.bound.shape[1] == 0:
            return _empty()
        b = self.bodies.tree.space.base_nv
        travel = np.abs(v[:, b:]) @ proximity.radius[b:]
        bound = proximity.bound
        segment, pair = where_true(bound[:-1] + bound[1:] <= travel + 2.0 * clearance)
        if len(segment) == 0:
            return _empty()
        for end in (0, 1):
            other = bound[segment + 1 - end, pair]
            need = travel[segment, pair] + 2.0 * clearance - other + 1e-4
            proximity.refine_at(kin, segment + end, pair, need)
        count = len(segment)
        triples = _Open(
            segment, pair, np.full(count, -1), np.zeros(count), np.ones(count),
            bound[segment, pair], bound[segment + 1, pair], travel[segment, pair],
        )  # fmt: skip
        return triples.take(triples.d_low + triples.d_high <= triples.travel + 2.0 * clearance)

    def _bisect(
        self,
        kin: Kinematics,
        v: Array,
        triples: _Open,
        clearance: float,
        states: npt.NDArray[np.int8],
        worst: list[BrokenSegment],
        is_self: bool,
    ) -> int:
        space = self.bodies.tree.space
        checks = 0
        d = np.minimum(triples.d_low, triples.d_high)
        bad = d <= clearance
        if bad.any():
            self._report(triples.take(bad), d[bad], states, worst, is_self, certain=True)
        triples = triples.take(states[triples.segment] == 0)
        for _depth in range(self.max_depth):
            if len(triples) == 0:
                return checks
            middle = 0.5 * (triples.low + triples.high)
            key, inverse = np.unique(triples.segment + 1j * middle, return_inverse=True)
            s = key.real.astype(np.intp)
            self._between.update(space.integrate(kin.chart[s], key.imag[:, None] * v[s]), jacobians=False)
            checks += len(key)
            limit = triples.travel * 0.5 + 2.0 * clearance  # a half passes if both its ends sum above this
            need = np.maximum(limit - np.minimum(triples.d_low, triples.d_high), clearance) + 1e-4
            d = self._measure(inverse, triples, need, is_self)
            bad = d <= clearance
            if bad.any():
                self._report(triples.take(bad), d[bad], states, worst, is_self, certain=True)
            half = 0.5 * triples.travel
            alive = states[triples.segment] == 0
            left = alive & (triples.d_low + d <= half + 2.0 * clearance)
            right = alive & (d + triples.d_high <= half + 2.0 * clearance)
            triples = _Open(
                segment=np.concatenate((triples.segment[left], triples.segment[right])),
                body=np.concatenate((triples.body[left], triples.body[right])),
                part=np.concatenate((triples.part[left], triples.part[right])),
                low=np.concatenate((triples.low[left], middle[right])),
                high=np.concatenate((middle[left], triples.high[right])),
                d_low=np.concatenate((triples.d_low[left], d[right])),
                d_high=np.concatenate((d[left], triples.d_high[right])),
                travel=np.concatenate((half[left], half[right])),
            )
        if len(triples):
            d = np.minimum(triples.d_low, triples.d_high)
            self._report(triples, d, states, worst, is_self, certain=False)
        return checks

    def _measure(self, node: Indices, triples: _Open, need: Array, is_self: bool) -> Array:
        """Lower bounds of the distances at the middles; exact where the box test does not already suffice."""
        if is_self:
            return self.self_pairs.measure(self._between, node, triples.body, need)
        fraction = 0.5 * (triples.low + triples.high)
        moved = self.obstacles.movers.between(triples.segment, fraction, triples.part)
        return self.obstacles.measure(self._between, node, triples.body, triples.part, need, moved)

    def _report(
        self,
        bad: _Open,
        d: Array,
        states: npt.NDArray[np.int8],
        worst: list[BrokenSegment],
        is_self: bool,
        *,
        certain: bool,
    ) -> None:
        state = SegmentState.COLLIDING if certain else SegmentState.UNKNOWN
        states[bad.segment] = np.maximum(states[bad.segment], state)
        k = int(np.argmin(d))
        names = self.bodies.names
        if is_self:
            one, two = self.self_pairs.pairs[bad.body[k]]
            link, other, kind = names[one], names[two], "self"
        else:
            link, other, kind = names[bad.body[k]], self.obstacles.obstacle_name(int(bad.part[k])), "obstacle"
        worst.append(BrokenSegment(int(bad.segment[k]), link, other, float(d[k]), kind, certain))

    def _look_along(self, kin: Kinematics, v: Array, travel: Array, clearance: float, scene: Scene) -> int:
        """Have the window hold all that long segments may come near; for short ones what is near the nodes will do.

        A point of a long segment is no further from the nearest of some configurations on it than half the way from
        one to the next.
        """
        if len(scene) == 0:
            return 0
        longest = travel.max(axis=1)
        margin = self.obstacles.margin
        long = np.flatnonzero(longest + 2.0 * clearance >= margin[:-1] + margin[1:])
        if len(long) == 0:
            return 0
        counts = np.clip(np.ceil(longest[long] / self.obstacles.influence), 1, _MOST_SAMPLES).astype(int)
        s = np.repeat(long, counts)
        fraction = np.concatenate([(np.arange(c) + 0.5) / c for c in counts.tolist()])
        space = self.bodies.tree.space
        self._between.update(space.integrate(kin.chart[s], fraction[:, None] * v[s]), jacobians=False)
        reach = clearance + 0.5 * np.repeat(longest[long] / counts, counts) + 1e-6
        self.obstacles.look_between(kin, self._between, reach)
        return len(s)


def undefined(bodies: BodySet, segment: int) -> BrokenSegment:
    """A segment that makes half a turn."""
    return BrokenSegment(segment, bodies.names[0], "", 0.0, HALF_TURN, False)


def _empty() -> _Open:
    none, ints = np.zeros(0), np.zeros(0, dtype=np.intp)
    return _Open(ints, ints, ints, none, none, none, none, none)
