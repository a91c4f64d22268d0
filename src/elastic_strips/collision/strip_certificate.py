"""What is known about a strip between its nodes: its certificate, its clearance, and the paper's protective hulls."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices, Mask, by_rows
from elastic_strips.constants import EXACT_WITHIN
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.robot.space import nonzero
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary

from .bounds import BodySet, MotionBounds
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
from .native_side import least_distance
from .obstacles import ObstacleProximity
from .self_distance import SelfProximity

_MOST_SAMPLES = 256
"""Most configurations of one segment about which obstacles are looked for."""
_SEARCH_REACHES = (0.3, 1.0, 3.0, 10.0, 100.0, 1e4)  # [m] within which the least distance is looked for, in turns
_MOST_SEARCH_HALVINGS = 60  # of a segment: more than floating point can divide it
_KNOWN = np.int8(-1)  # a segment that is certified already, while others are looked at


class Certifier(OneThread):
    """Workspace: certifies strips for which the two proximities are up to date.

    The distances at the nodes decide most pairs; only the pairs that they leave open are bisected.

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
        self.bodies: BodySet = bodies
        self.bounds: MotionBounds = bounds
        self.obstacles: ObstacleProximity = obstacles
        self.self_pairs: SelfProximity = self_pairs
        self.max_depth = max_depth
        self._between = Kinematics(bodies.tree, 64)

    @exclusive
    def certify(
        self,
        kin: Kinematics,
        v: Array,
        *,
        clearance: float,
        self_clearance: float,
        scene: Scene,
        known: Mask | None = None,
    ) -> Certificate:
        """Certify the segments between the nodes of ``kin``.

        Args:
            kin: kinematics of the nodes (N), as last given to the proximities.
            v: (N−1, nv) tangents of the segments.
            clearance: required distance [m], > 0, to obstacles.
            self_clearance: required distance [m], > 0, between the robot's own links.
            scene: the snapshot, as last given to the obstacle proximity.
            known: (N−1,) segments that are already certified with these very clearances, scene and ends; only the
                others are certified.
        """
        (v,) = by_rows(v)
        states = np.zeros(kin.n - 1, dtype=np.int8)
        if known is not None:
            states[known] = _KNOWN
        travel = self.bounds.travel(v)
        looked = self._look_along(kin, v, travel, clearance, scene)
        self.obstacles.reach_out(kin, travel + 2.0 * clearance)
        worst: list[BrokenSegment] = []
        for j in np.flatnonzero(self.bodies.tree.space.half_turn(v)).tolist():
            states[j] = SegmentState.UNKNOWN
            worst.append(half_turn(self.bodies, j))
        candidates = self.obstacles.candidates
        assert candidates is not None
        obstacle_pairs = ObstaclePairs(self.bodies, self.obstacles.narrow, candidates, self.obstacles.moving)
        searches = (
            _StripSearch(obstacle_pairs, clearance, states, worst),
            _StripSearch(SelfPairs(self.self_pairs), self_clearance, states, worst),
        )
        native = self._certify_native(kin, v, searches, states)
        if native is not None:
            return _certificate(clearance, self_clearance, states, worst, looked + native)
        self._colliding_nodes(kin, searches[0])
        todos = self._open_obstacles(kin, v, travel, clearance, states), self._open_self(kin, v, self_clearance, states)
        bisection = Bisection(kin, v, self._between)
        for search, todo in zip(searches, todos, strict=True):
            if todo is None or len(todo) == 0:
                continue
            search.found(todo.low, todo.pair, np.minimum(todo.d_low, todo.d_high))
            todo = todo.take(states[todo.segment] == 0)
            left = bisection.run(search.pairs, todo, search, self.max_depth)
            if len(left):
                search.report(left.low, left.pair, np.minimum(left.d_low, left.d_high), certain=False)
        return _certificate(clearance, self_clearance, states, worst, looked + bisection.checks)

    def _certify_native(
        self, kin: Kinematics, v: Array, searches: tuple[_StripSearch, _StripSearch], states: npt.NDArray[np.int8]
    ) -> int | None:
        """The rest of :meth:`certify` by the native kernel; returns its checks, or None where there is none."""
        obstacles, own, depth = self.obstacles, self.self_pairs, self.max_depth
        candidates, narrow = obstacles.candidates, obstacles.narrow
        if candidates is None or narrow.native is None or own.native is None:
            return None
        coordinates, checks = kin.coordinates[: kin.n], 0
        if len(candidates):
            broken, count, work = narrow.native.calls.certify(
                kin.T,
                kin.J,
                coordinates,
                v,
                *narrow.native.scene(candidates, obstacles.moving),
                self.bounds.of_motion,
                obstacles.moving.travel(),
                obstacles.arrays,
                searches[0].clearance,
                depth,
                states,
            )
            obstacles.account(*work)
            searches[0].note(broken)
            checks += count
        if len(own.pairs):
            broken, count, work = own.native.calls.certify(
                kin.T, coordinates, v, own.radius, own.arrays, searches[1].clearance, depth, states
            )
            own.account(*work)
            searches[1].note(broken)
            checks += count
        return checks

    def _colliding_nodes(self, kin: Kinematics, search: _StripSearch) -> None:
        """A node that is itself too close decides both its segments."""
        obstacles, clearance, states = self.obstacles, search.clearance, search.states
        at = obstacles.within(clearance)
        obstacles.refine_at(kin, at, np.full(len(at), clearance + EXACT_WITHIN))
        bound, (node, body, part) = obstacles.known_at(at)
        bad = bound <= clearance
        if not bad.any():
            return
        last = len(states) - 1
        states[np.minimum(node[bad], last)] = SegmentState.COLLIDING
        states[np.maximum(node[bad] - 1, 0)] = SegmentState.COLLIDING
        k = int(np.argmin(bound))
        assert obstacles.candidates is not None
        pair = int(body[k]) * len(obstacles.candidates) + int(part[k])
        search.worst.append(search.pairs.broken(min(int(node[k]), last), pair, float(bound[k]), True))

    def _open_obstacles(
        self, kin: Kinematics, v: Array, travel: Array, clearance: float, states: npt.NDArray[np.int8]
    ) -> OpenIntervals | None:
        obstacles, approach = self.obstacles, self.obstacles.moving.travel()
        assert obstacles.candidates is not None
        here, there = obstacles.open_at(states, travel + 2.0 * clearance, approach)
        if len(here) == 0:
            return None
        # second chance with the tight travel of these bodies, then with refreshed distances at the ends
        d_low, (segment, body, part) = obstacles.known_at(here)
        d_high = obstacles.known_at(there)[0]
        key = segment * len(self.bodies) + body
        unique, inverse = np.unique(key, return_inverse=True)
        s, g = unique // len(self.bodies), unique % len(self.bodies)
        tight = self.bounds.tight_travel(kin, s, g, v[s])[inverse]
        if approach is not None:
            tight = tight + approach[segment, part]
        keep = ~(d_low + d_high > tight + 2.0 * clearance)
        here, there, tight = here[keep], there[keep], tight[keep]
        if len(here) == 0:
            return None
        # what is far at one end is decided by the other: a bound up to the whole sum is good enough at each
        for end, other in ((here, there), (there, here)):
            obstacles.refine_at(kin, end, tight + 2.0 * clearance - obstacles.known_at(other)[0] + EXACT_WITHIN)
        d_low, (segment, body, part) = obstacles.known_at(here)
        pair = body * len(obstacles.candidates) + part
        todo = OpenIntervals.of_segments(pair, segment, d_low, obstacles.known_at(there)[0], tight)
        return todo.take(todo.open(clearance))

    def _open_self(
        self, kin: Kinematics, v: Array, clearance: float, states: npt.NDArray[np.int8]
    ) -> OpenIntervals | None:
        proximity, bound = self.self_pairs, self.self_pairs.bound
        if bound.shape[1] == 0:
            return None
        travel = proximity.travel(v)
        segment, pair = nonzero(~(bound[:-1] + bound[1:] > travel + 2.0 * clearance) & (states != _KNOWN)[:, None])
        if len(segment) == 0:
            return None
        travel = travel[segment, pair]
        for end in (0, 1):
            other = bound[segment + 1 - end, pair]
            proximity.refine_at(kin, segment + end, pair, travel + 2.0 * clearance - other + EXACT_WITHIN)
        todo = OpenIntervals.of_segments(pair, segment, bound[segment, pair], bound[segment + 1, pair], travel)
        return todo.take(todo.open(clearance))

    def _look_along(self, kin: Kinematics, v: Array, travel: Array, clearance: float, scene: Scene) -> int:
        """Make sure that the candidates hold all parts that long segments may come near; short ones need no others.

        A point of a long segment is no further from the nearest of some configurations on it than half the travel from
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
        self._between.update(space.integrate(kin.coordinates[s], fraction[:, None] * v[s]), jacobians=False)
        reach = clearance + 0.5 * np.repeat(longest[long] / counts, counts) + 1e-6
        self.obstacles.look_between(kin, self._between, reach)
        return len(s)


def _certificate(
    clearance: float,
    self_clearance: float,
    states: npt.NDArray[np.int8],
    worst: list[BrokenSegment],
    checks: int,
) -> Certificate:
    worst.sort(key=lambda b: (not b.certain, b.clearance))
    states[states == _KNOWN] = SegmentState.CERTIFIED
    broken = None
    if worst:
        broken = replace(worst[0], required=self_clearance if worst[0].kind == "self" else clearance)
    return Certificate(clearance, states == 0, states, broken, checks)


class _StripSearch:
    """The first distance below the clearance decides a segment; the others are searched on."""

    def __init__(
        self, pairs: Pairs, clearance: float, states: npt.NDArray[np.int8], worst: list[BrokenSegment]
    ) -> None:
        self.pairs, self.clearance, self.exact_below = pairs, clearance, clearance
        self.states, self.worst = states, worst

    @property
    def decided(self) -> Mask:
        return self.states != 0

    def found(self, place: Array, pair: Indices, d: Array) -> bool:
        bad = d <= self.clearance
        if bad.any():
            self.report(place[bad], pair[bad], d[bad], certain=True)
        return False

    def note(self, broken: tuple[float, int, float, bool] | None) -> None:
        """Note the place, pair and distance that the native kernel found worst."""
        if broken is not None:
            place, pair, distance, certain = broken
            self.worst.append(self.pairs.broken(int(place), pair, distance, certain))

    def report(self, place: Array, pair: Indices, d: Array, *, certain: bool) -> None:
        """Give segments their state and note the nearest pair."""
        segment = place.astype(np.intp)
        state = SegmentState.COLLIDING if certain else SegmentState.UNKNOWN
        self.states[segment] = np.maximum(self.states[segment], state)
        k = int(np.argmin(d))
        self.worst.append(self.pairs.broken(int(segment[k]), int(pair[k]), float(d[k]), certain))


def coordinate_clearance(robot: RobotModel, coordinates: Array, scene: Scene, *, tolerance: float) -> float:
    """:func:`elastic_strips.strip.strip_clearance` of nodes (N, nv)."""
    if len(scene) == 0:
        return float("inf")
    bodies, v = BodySet.links(robot), robot.space.difference(coordinates[:-1], coordinates[1:])
    bounds = MotionBounds(bodies)
    if not robot.space.half_turn(v).any():
        least = least_distance(bounds, scene, coordinates, v, tolerance=tolerance, most=_SEARCH_REACHES[-1])
        if least is not None:
            return least
    kin = Kinematics(bodies.tree, len(coordinates))
    kin.update(coordinates)
    travel = bounds.travel(v)
    for reach in _SEARCH_REACHES:
        proximity = ObstacleProximity(bodies, influence=reach)
        proximity.update(kin, scene)
        if proximity.bound.size == 0:
            continue
        lowest = float(proximity.bound.min(initial=reach))
        if lowest + 0.5 * float(travel.max(initial=0.0)) < reach or reach == _SEARCH_REACHES[-1]:
            return _smallest(kin, v, bounds, proximity, tolerance)
    return _SEARCH_REACHES[-1]


def _smallest(kin: Kinematics, v: Array, bounds: MotionBounds, proximity: ObstacleProximity, tolerance: float) -> float:
    bodies, bound, candidates = proximity.bodies, proximity.bound, proximity.candidates
    assert candidates is not None
    low = 0.5 * (bound[:-1] + bound[1:] - bounds.travel(v)[:, :, None])
    undefined = bodies.tree.space.half_turn(v)
    search = _ClearanceSearch(min(float(bound.min()), float(low[undefined].min(initial=np.inf))), tolerance)
    low[undefined] = np.inf
    segment, body, part = nonzero(low < search.clearance)
    if len(segment):
        tight = bounds.tight_travel(kin, segment, body, v[segment])
        d_low, d_high = bound[segment, body, part], bound[segment + 1, body, part]
        todo = OpenIntervals.of_segments(body * len(candidates) + part, segment, d_low, d_high, tight)
        bisection = Bisection(kin, v, Kinematics(bodies.tree, 64))
        pairs = ObstaclePairs(bodies, proximity.narrow, candidates, proximity.moving)
        bisection.run(pairs, todo.take(todo.open(search.clearance)), search, _MOST_SEARCH_HALVINGS)
    return search.clearance


class _ClearanceSearch:
    """Branch and bound: pairs that cannot be nearer than the nearest so far, by a tolerance [m], are not looked at.

    Lower bounds say nothing about how deep shapes penetrate, so distances that may be below 0 are measured exactly.
    """

    decided = None

    def __init__(self, nearest: float, tolerance: float) -> None:
        self.nearest, self.tolerance = nearest, tolerance

    @property
    def clearance(self) -> float:
        return self.nearest - self.tolerance

    @property
    def exact_below(self) -> float:
        return max(self.nearest, 0.0)

    def found(self, place: Array, pair: Indices, d: Array) -> bool:
        self.nearest = min(self.nearest, float(d.min()))
        return False


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ProtectiveHulls(Summary):
    """Protective hulls of a strip: spheres about its control points (the tunnel of Brock and Khatib).

    Attributes:
        points: (N, C, 3) control points [m].
        radius: (N, C) free distance of each, capped at the safe distance [m].
        overlap: (N−1, C) how much neighbouring hulls overlap [m]; negative where there is a gap.
    """

    points: Array
    radius: Array
    overlap: Array

    @property
    def connected(self) -> Mask:
        """(N−1,) whether all hulls of a node overlap those of the next."""
        return np.asarray(np.all(self.overlap > 0.0, axis=1), dtype=bool)


def protective_hulls(points: Array, distance: Array, *, cap: float) -> ProtectiveHulls:
    """Hulls of control points (N, C, 3) with free distances (N, C), capped at ``cap`` [m], the safe distance.

    Two neighbours are connected where their spheres overlap: then a point can go from one to the other inside free
    space.
    """
    radius = np.clip(distance, 0.0, cap)
    spacing = np.linalg.norm(points[1:] - points[:-1], axis=2)
    return ProtectiveHulls(points, radius, radius[1:] + radius[:-1] - spacing)
