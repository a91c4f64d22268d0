"""Tree search: a path of the joints by two trees that grow towards each other, and its detours taken out.

RRT-Connect: the smaller tree grows towards a place that is drawn, and the other one towards where that has led. A node
from which a motion was not valid grows only to near places (its dynamic domain), and to farther ones again each time
that it is passed over. Where that is not lucky for a while, a second search with other numbers races with it, and the
one that needs fewer checks wins: on two cores the time of the shorter one is enough. This is the readable twin of the
kernel's ``TreeSearch``, one search after the other: equal seeds give equal paths.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, by_rows

from .problem import Deadline
from .validity import ValidityChecker

_FIRST_RADIUS, _LEAST_RADIUS = 2.0, 0.5  # scaled, of a node from which a motion was not valid
_REGROWTH = 1e-3  # of such a radius each time that a place is too far for it
_LEAST_GAIN = 0.98  # of a shortcut: the new length by the old one
_MOST_TURN = 0.49  # of a circular joint's period that it goes evenly, at most
_LEAST_LENGTH = 1e-12  # scaled, that is divided by
_DRAWN_BITS = 2**64
_HEAD_START = 2000  # checks that the first search makes alone
_OTHER_SEED = 2**32  # from the first search's seed to the second's


@dataclass(frozen=True, slots=True)
class TreeSpace:
    """What is planned are the last K coordinates, each times its scale; the others stay as they are at the start.

    Attributes:
        scale: (K,) what a unit of each counts.
        low, high: (K,) bounds, scaled.
        period: (K,) scaled turn after which a circular one is the same; 0 for others.
        reach: longest motion of a tree, scaled.
        step: motions are checked wherever a point may have moved by this [m].
    """

    scale: Array
    low: Array
    high: Array
    period: Array
    reach: float
    step: float


def search_by_trees(
    valid: ValidityChecker, endpoints: Array, space: TreeSpace, *, seed: int, deadline: Deadline, tries: int
) -> Array | None:
    """Corners (N, nv) of a path between two configurations (2, nv), or None where the deadline ends the search.

    Args:
        valid: the checker of validity.
        endpoints: valid coordinates of start and goal.
        space: what is searched.
        seed: of the numbers that are drawn.
        deadline: when everything must end.
        tries: most tries to shorten the path.
    """
    seed %= _DRAWN_BITS
    if valid.native is not None:
        ends, scale, low, high, period = by_rows(endpoints, space.scale, space.low, space.high, space.period)
        most, seconds = int(min(deadline.looks_left, 2**62)), deadline.time_left
        found = valid.native.search(ends, scale, low, high, period, seed, space.step, space.reach, most, seconds, tries)
        valid.count(by_trees=True)
        return np.array(found).reshape(-1, endpoints.shape[1]) if found else None
    before, first = valid.checks, _Search(valid, endpoints, space, seed, deadline, 0)
    best, points, spent = first, first.path(), first.spent
    if spent >= _HEAD_START:
        second = _Search(valid, endpoints, space, seed + _OTHER_SEED, deadline, _HEAD_START)
        second.most = math.inf if points is None else spent
        other, its_spent = second.path(), second.spent
        if other is not None and (points is None or its_spent < spent):
            best, points, spent = second, other, its_spent
        elif points is None:
            spent = max(spent, its_spent)
    valid.account(before + spent)  # what both make at once counts once
    rows = None if points is None else np.array([best.row(at) for at in best.shortened(points, tries, spent)])
    valid.count(by_trees=True)
    if rows is not None:
        rows[[0, -1]] = endpoints
    return rows


@dataclass(slots=True)
class _Tree:
    """Nodes, scaled; how far beyond each it is worth growing to; and the node that each was reached from."""

    at: list[Array] = field(default_factory=list)
    single: npt.NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.float32))
    radius: list[float] = field(default_factory=list)
    parent: list[int] = field(default_factory=list)

    def add(self, at: Array, parent: int) -> None:
        n = len(self.at)
        if n == len(self.single):  # room for twice as many
            grown = np.full((max(2 * n, 64), len(at)), np.inf, dtype=np.float32)
            grown[:n] = self.single.reshape(n, len(at))
            self.single = grown
        self.single[n] = at
        self.at.append(at)
        self.radius.append(math.inf)
        self.parent.append(parent)


class _Search:
    """One search, and what it has drawn and counted so far.

    Attributes:
        spent: checks of it, and those that count as made before.
        most: checks after which the other one has won.
    """

    def __init__(
        self, valid: ValidityChecker, ends: Array, space: TreeSpace, seed: int, deadline: Deadline, head_start: int
    ) -> None:
        self.valid, self.space, self.deadline = valid, space, deadline
        self.most = math.inf
        self._ends = ends
        self._first = ends.shape[1] - len(space.scale)
        self._state = seed
        self._begun = valid.checks - head_start
        self._limit = deadline.looks_left
        self._along: list[float] = []

    @property
    def spent(self) -> int:
        return self.valid.checks - self._begun

    def over(self) -> bool:
        return self.spent >= min(self._limit, self.most) or self.deadline.time_left <= 0.0

    def drawn(self) -> float:
        """The next number in [0, 1): SplitMix64, a counter with its bits mixed."""
        self._state = (self._state + 0x9E3779B97F4A7C15) % _DRAWN_BITS
        z = self._state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) % _DRAWN_BITS
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) % _DRAWN_BITS
        return ((z ^ (z >> 31)) >> 11) * 2.0**-53

    def towards(self, a: Array, b: Array) -> Array:
        v, period = b - a, self.space.period
        turning = period > 0.0
        v[turning] -= period[turning] * np.rint(v[turning] / period[turning])
        return v

    def row(self, at: Array) -> Array:
        out = self._ends[0].copy()
        out[self._first :] = at / self.space.scale
        return out

    def motion(self, a: Array, b: Array) -> bool:
        return self.valid.motion(self.row(a), self.row(b), self.space.step)

    def nearest(self, tree: _Tree, to: Array) -> tuple[int, float]:
        """The nearest node, and its distance; in single precision, as the kernel has it."""
        total = np.zeros(len(tree.at), dtype=np.float32)
        for k, x in enumerate(to.astype(np.float32)):
            d = np.abs(tree.single[: len(tree.at), k] - x)
            period = np.float32(self.space.period[k])
            if period > 0.0:
                d = np.minimum(d, np.abs(period - d))
            total += d * d
        best = int(np.argmin(total))
        return best, math.sqrt(float(total[best]))

    def path(self) -> list[Array] | None:
        """Corners, scaled."""
        trees, ends = (_Tree(), _Tree()), [end[self._first :] * self.space.scale for end in self._ends]
        for tree, end in zip(trees, ends, strict=True):
            tree.add(end, -1)
        if self.motion(ends[0], ends[1]):
            return ends
        which = 1
        while not self.over():
            if len(trees[1 - which].at) <= len(trees[which].at):  # in turns, and the smaller one again
                which = 1 - which
            met = self._grown(trees[which], trees[1 - which])
            if met is not None:
                nodes = met if which == 0 else met[::-1]
                one, two = (self._back(tree, k) for tree, k in zip(trees, nodes, strict=True))
                return [*one[::-1], *two]
        return None

    def _grown(self, tree: _Tree, other: _Tree) -> tuple[int, int] | None:
        """Grow one tree towards a place that is drawn and the other one to where that led; the nodes that meet."""
        space = self.space
        place = space.low + np.array([self.drawn() for _ in space.scale]) * (space.high - space.low)
        near, distance = self.nearest(tree, place)
        if distance > tree.radius[near]:
            tree.radius[near] *= 1.0 + _REGROWTH
            return None
        if distance == 0.0:
            return None
        target = tree.at[near] + min(1.0, space.reach / distance) * self.towards(tree.at[near], place)
        radius = tree.radius[near]
        if not self.motion(tree.at[near], target):
            tree.radius[near] = _FIRST_RADIUS if math.isinf(radius) else max(_LEAST_RADIUS, radius * (1.0 - _REGROWTH))
            return None
        if not math.isinf(radius):
            tree.radius[near] *= 1.0 + _REGROWTH
        tree.add(target, near)
        reached = len(tree.at) - 1
        at, distance = self.nearest(other, target)
        begin, v = other.at[at], self.towards(other.at[at], target)
        steps = max(1, math.ceil(distance / space.reach))
        for k in range(1, steps + 1):
            if self.over():
                return None
            after = begin + v * (float(k) / float(steps))
            if not self.motion(other.at[at], after):
                return None
            if k == steps:
                return reached, at
            other.add(after, at)
            at = len(other.at) - 1
        return None

    @staticmethod
    def _back(tree: _Tree, k: int) -> list[Array]:
        nodes = []
        while k >= 0:
            nodes.append(tree.at[k])
            k = tree.parent[k]
        return nodes

    def shortened(self, points: list[Array], tries: int, spent: int) -> list[Array]:
        """A path with fewer corners and without detours: in turns straight between two of its places, and with one
        joint that goes evenly between them, wherever that is valid and shorter; after so many checks."""
        self.most, self._begun = math.inf, self.valid.checks - spent
        points = self._skipped(points)
        self._measure(points)
        for k in range(tries):
            if len(points) < 3 or self.over():
                break
            first, last = sorted((self.drawn() * self._along[-1], self.drawn() * self._along[-1]))
            (i, one), (j, two) = (self._place(points, s) for s in (first, last))
            new: list[Array] | None = [one, two]
            drawn = self.drawn() if k % 2 else 0.0
            if i == j or (k % 2 == 0 and _length(self.towards(one, two)) > _LEAST_GAIN * (last - first)):
                continue
            if k % 2:
                new = self._evened([one, *points[i + 1 : j + 1], two], first, last, i + 1, drawn)
            if new is None or not all(self.motion(a, b) for a, b in pairwise(new)):
                continue
            points = [*points[: i + 1], *new, *points[j + 1 :]]
            self._measure(points)
        return self._skipped(points)

    def _skipped(self, points: list[Array]) -> list[Array]:
        """Leave out each corner whose neighbours are joined by a valid motion."""
        points, k = list(points), 1
        while k + 1 < len(points) and not self.over():
            if self.motion(points[k - 1], points[k + 1]):
                del points[k]
            else:
                k += 1
        return points

    def _measure(self, points: list[Array]) -> None:
        """Lengths along a path, from its start to each of its corners."""
        self._along = [0.0]
        for a, b in pairwise(points):
            self._along.append(self._along[-1] + _length(self.towards(a, b)))

    def _place(self, points: list[Array], s: float) -> tuple[int, Array]:
        """The segment that a place is in, and the place."""
        along = self._along
        k = min(max(bisect_right(along, s), 1), len(along) - 1) - 1
        part = (s - along[k]) / max(along[k + 1] - along[k], _LEAST_LENGTH)
        return k, points[k] + part * self.towards(points[k], points[k + 1])

    def _evened(self, middle: list[Array], first: float, last: float, before: int, drawn: float) -> list[Array] | None:
        """Corners from ``first`` to ``last``, the second of which is number ``before`` of the path, with one joint that
        goes evenly; it is drawn by how much of its motion that saves. None where that is too little."""
        space = self.space
        net, total = np.zeros(len(space.scale)), np.zeros(len(space.scale))
        for a, b in pairwise(middle):
            v = self.towards(a, b)
            net += v
            total += np.abs(v)
        saved = ((total - np.abs(net)) / space.scale).tolist()
        left, joint = drawn * _sum(saved), 0
        while joint + 1 < len(saved):  # the last one where rounding leaves a rest
            left -= saved[joint]
            if left < 0.0:
                break
            joint += 1
        way, period = abs(float(net[joint])), float(space.period[joint])
        if way > _LEAST_GAIN * total[joint] or (period > 0.0 and way > _MOST_TURN * period):
            return None
        out = [at.copy() for at in middle]
        for k in range(1, len(middle) - 1):
            share = (self._along[before + k - 1] - first) / (last - first)
            out[k][joint] = middle[0][joint] + share * net[joint]
        out[-1][joint] = middle[0][joint] + net[joint]
        return out


def _sum(numbers: list[float]) -> float:
    total = 0.0  # one by one, as the kernel adds
    for x in numbers:
        total += x
    return total


def _length(v: Array) -> float:
    return math.sqrt(_sum([x * x for x in v.tolist()]))
