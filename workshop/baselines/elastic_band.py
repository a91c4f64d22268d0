"""Elastic band: a deformable path of bubbles of free space.

Source: S. Quinlan, O. Khatib (1993), Elastic bands: connecting path planning and control, IEEE ICRA. The base follows
the band by pure pursuit: R. C. Coulter (1992), Implementation of the pure pursuit path tracking algorithm, CMU.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.planning.grid_path import cheapest_path
from elastic_strips.validation import Bound, Count, Positive, check_fields

from .base_method import BaseCommand, BaseLimits, CommandLimiter, GoalParams, angle_between
from .certainty_grid import PlanarReading, SensedPoints


class FreeDistance:
    """ρ(b): how far a round base at b is from the nearest sensed point.

    Args:
        points: (P, 2) sensed points [m].
        radius: radius of the base [m].
        most: largest ρ [m].
    """

    def __init__(self, points: Array, radius: float, most: float) -> None:
        from scipy.spatial import cKDTree  # late: slow to import

        self._tree = cKDTree(points) if len(points) else None
        self._radius = radius
        self.most: float = most

    def __call__(self, at: Array) -> Array:
        """(…,) ρ [m] at points (…, 2); negative where the base would overlap a point."""
        if self._tree is None:
            return np.full(at.shape[:-1], self.most)
        distance, _ = self._tree.query(at, distance_upper_bound=self.most + self._radius)
        return np.minimum(distance - self._radius, self.most)

    def gradient(self, at: Array, step: Array) -> Array:
        """(N, 2) ∂ρ/∂b at points (N, 2) by central differences over ``step`` (N,) [m]."""
        h = step[:, None]
        x, y = h * np.array([1.0, 0.0]), h * np.array([0.0, 1.0])
        ahead, behind, left, right = self(np.stack((at + x, at - x, at + y, at - y)))
        return np.stack((ahead - behind, left - right), axis=1) / (2.0 * h)


def bubble_contraction(chain: Array, gain: float) -> Array:
    """(N − 2, 2) k_c ((b₋ − b)/|b₋ − b| + (b₊ − b)/|b₊ − b|) on the inner bubbles of a chain (N, 2)."""
    step = np.diff(chain, axis=0)
    unit = step / np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)[:, None]
    return gain * (unit[1:] - unit[:-1])


def bubble_repulsion(free: FreeDistance, centers: Array, rho: Array, gain: float, influence: float) -> Array:
    """(M, 2) k_r (ρ0 − ρ) ∂ρ/∂b where ρ < ρ0, else zero: minus the gradient of ½ k_r (ρ0 − ρ)².

    The gradient is taken over the bubble's own size, so that in the middle of a gap it vanishes.
    """
    force = np.zeros_like(centers)
    near = rho < influence
    if near.any():
        slope = free.gradient(centers[near], np.maximum(rho[near], 0.02))
        force[near] = gain * (influence - rho[near])[:, None] * slope
    return force


def without_tangent(force: Array, chain: Array) -> Array:
    """(N − 2, 2) f − (f·e) e, e along b₋ − b₊: forces on the inner bubbles that do not push them along the chain."""
    along = chain[:-2] - chain[2:]
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    return force - ((force * along).sum(axis=1) / square)[:, None] * along


def relaxed(chain: Array, free: FreeDistance, *, contraction: float, repulsion: float, influence: float) -> Array:
    """The chain (N, 2) after one step along its forces; its ends stay.

    A bubble moves by its size times its force. Added here: a nearer neighbour bounds the step instead of the size, and
    no step is longer than half of that; else small bubbles among large ones would oscillate.
    """
    if len(chain) < 3:
        return chain
    rho = free(chain[1:-1])
    force = bubble_contraction(chain, contraction) + bubble_repulsion(free, chain[1:-1], rho, repulsion, influence)
    force = without_tangent(force, chain)
    gap = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    scale = np.minimum(np.maximum(rho, 0.05), np.minimum(gap[1:], gap[:-1]))
    size = np.linalg.norm(force, axis=1)
    move = scale * np.minimum(1.0, 0.5 / np.maximum(size, 1e-12))
    out = chain.copy()
    out[1:-1] += move[:, None] * force
    return out


def connected(chain: Array, free: FreeDistance, *, least: float, overlap: float, most: int) -> Array | None:
    """The chain with inserted bubbles where neighbours do not overlap; None where it is broken.

    It is broken where a bubble (except the first, where the base is) is smaller than ``least``, or where it would
    need more than ``most`` bubbles.

    Args:
        chain: (N, 2) centers [m].
        free: ρ.
        least: smallest bubble [m].
        overlap: neighbours are at most this times the sum of their sizes apart; < 1.
        most: largest number of bubbles.
    """
    rho = free(chain)
    while True:
        if (rho[1:] < least).any():
            return None
        size = np.maximum(rho, least)
        gap = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        wide = np.flatnonzero(gap > overlap * (size[1:] + size[:-1]))
        if not len(wide):
            return chain
        if len(chain) + len(wide) > most:
            return None
        middles = 0.5 * (chain[wide] + chain[wide + 1])
        rho = np.insert(rho, wide + 1, free(middles))
        chain = np.insert(chain, wide + 1, middles, axis=0)


def thinned(chain: Array, free: FreeDistance, *, least: float, overlap: float) -> Array:
    """The chain without the bubbles whose neighbours overlap without them."""
    if len(chain) < 3:
        return chain
    size = np.maximum(free(chain), least).tolist()
    points = chain.tolist()
    kept = [0]
    for i in range(1, len(points) - 1):
        (x0, y0), (x1, y1) = points[kept[-1]], points[i + 1]
        if (x1 - x0) ** 2 + (y1 - y0) ** 2 > (overlap * (size[kept[-1]] + size[i + 1])) ** 2:
            kept.append(i)
    return chain[[*kept, len(points) - 1]]


_Planner = Callable[[Array, Array, Array], "Array | None"]
"""Sensed points (P, 2), start (2,), goal (2,) → waypoints (K, 2) from start to goal [m], or None."""
_REPLAN_PERIOD = 0.5  # [s] between two calls of the planner
_MOST_GRID_CELLS = 20000  # of the planner's grid at most, about
_SMALLEST_CELL = 0.1  # [m] edge of its cells; larger where the goal is so far that there would be too many
_PATH_CLEARANCE = 0.04  # [m] clearance that a path must have
_USEFUL_CLEARANCE = 0.3  # [m] clearance beyond that from which on more of it is worth nothing
_GRID_MARGIN = 2.0  # [m] how far beyond start and goal the grid reaches
_REMOVAL_OVERLAP = 0.75  # bubbles are removed where the others overlap by more than required


@dataclass(frozen=True, slots=True, kw_only=True)
class ElasticBandParams:
    """Parameters; all values are ours.

    Attributes:
        contraction: k_c [−].
        repulsion: k_r [1/m].
        influence: ρ0: free distance beyond which nothing repels [m].
        largest, least: largest and smallest bubble [m].
        overlap: neighbours are at most this times the sum of their sizes apart [−].
        bubbles: largest number of bubbles.
        iterations: iterations of the forces per command.
        look_ahead: largest distance of the point that is driven to [m]; in a small bubble it is that bubble's size,
            but at least ``look_least``.
        look_least: least distance of that point [m].
        bubble_time: the base takes at least this long to cross the radius of the bubble that it is in, or of the next
            ones [s].
        min_speed: least speed along the band [m/s].
        turn_in_place: angle between heading and way from which on it turns in place [rad].
        turn_gain: yaw rate per angle when turning in place [1/s].
    """

    contraction: Positive = 0.3
    repulsion: Positive = 0.8
    influence: Positive = 0.7
    largest: Positive = 1.0
    least: Positive = 0.02
    overlap: Annotated[float, Bound(above=0.0, high=1.0)] = 0.9
    bubbles: Count = 150
    iterations: Count = 2
    look_ahead: Positive = 0.5
    look_least: Positive = 0.2
    bubble_time: Positive = 0.5
    min_speed: Positive = 0.08
    turn_in_place: Positive = 1.0
    turn_gain: Positive = 2.0

    def __post_init__(self) -> None:
        check_fields(self)
        for small, large in (("least", "largest"), ("look_least", "look_ahead")):
            low, high = getattr(self, small), getattr(self, large)
            if low > high:
                raise ParameterError(f"ElasticBandParams.{small}={low!r} must not exceed {large}={high!r}")


class SensedPath:
    """Plans a path on a grid among the sensed points; unseen space counts as free.

    Args:
        radius: radius of the base [m].
    """

    def __init__(self, radius: float) -> None:
        self._inner = radius + _PATH_CLEARANCE

    def __call__(self, points: Array, start: Array, goal: Array) -> Array | None:
        """Waypoints (K, 2) from start to goal, or None."""
        ends = np.stack((start, goal))
        low = ends.min(axis=0) - _GRID_MARGIN
        size = ends.max(axis=0) + _GRID_MARGIN - low
        cell = max(_SMALLEST_CELL, math.sqrt(float(size.prod()) / _MOST_GRID_CELLS))
        axes = [low[k] + cell * np.arange(math.ceil(size[k] / cell) + 1) for k in range(2)]
        at = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        clear = FreeDistance(points, 0.0, self._inner + _USEFUL_CLEARANCE)(at)
        return cheapest_path(clear, low, cell, ends, inner=self._inner, comfort=_USEFUL_CLEARANCE)


class ElasticBand:
    """Workspace: Quinlan and Khatib's elastic band for a round base.

    The band starts as a straight line to the goal. Where it is broken (a bubble is too small, or neighbours cannot be
    made to overlap) another path is planned; without one the base stands, is blocked, and tries again.

    Args:
        limits: limits of the base.
        params: parameters of the band.
        planner: plans a path where the band is broken.
        goal: when a goal is reached.
    """

    name = "band"

    def __init__(
        self,
        limits: BaseLimits,
        params: ElasticBandParams | None = None,
        *,
        planner: _Planner | None = None,
        goal: GoalParams | None = None,
    ) -> None:
        self.params: ElasticBandParams = ElasticBandParams() if params is None else params
        self.limits: BaseLimits = limits
        self._planner = planner
        self._limiter = CommandLimiter(limits, goal)
        self._sensed = SensedPoints()
        self.chain: Array | None = None
        self._goal: Array | None = None
        self._planned_at = -math.inf

    def update(self, reading: PlanarReading, pose: Array) -> None:
        """Take in a reading, taken at ``pose`` (x, y, yaw)."""
        self._sensed.update(reading, pose)

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """Speed and yaw rate now."""
        done = self._limiter.at_goal(t, pose, velocity, goal)
        if done is not None:
            return done
        position, target = np.array(pose[:2], dtype=float), np.array(goal[:2], dtype=float)
        if self._goal is not None and not np.allclose(self._goal, target, rtol=0.0, atol=1e-6):
            self.chain = None
        self._goal = target
        free = FreeDistance(self._sensed.points, self.limits.radius, self.params.largest)
        self.chain = self._deformed(position, target, free)
        if self.chain is None:
            self.chain = self._planned(t, position, target, free)
        if self.chain is None:
            return self._limiter.halt(t, velocity, "the band is broken")
        return self._follow(t, pose, velocity, self.chain, free)

    def _deformed(self, position: Array, target: Array, free: FreeDistance) -> Array | None:
        """The band from the base on, after some steps along its forces; None where it is broken."""
        if self.chain is not None:
            chain = np.concatenate((position[None], self.chain[1:]))
        else:
            chain = np.stack((position, target))
        return self._settled(chain, free)

    def _settled(self, chain: Array, free: FreeDistance) -> Array | None:
        p = self.params
        joined = connected(chain, free, least=p.least, overlap=p.overlap, most=p.bubbles)
        for _ in range(int(p.iterations)):
            if joined is None:
                return None
            joined = thinned(joined, free, least=p.least, overlap=_REMOVAL_OVERLAP * p.overlap)
            joined = relaxed(joined, free, contraction=p.contraction, repulsion=p.repulsion, influence=p.influence)
            joined = connected(joined, free, least=p.least, overlap=p.overlap, most=p.bubbles)
        return joined

    def _planned(self, t: float, position: Array, target: Array, free: FreeDistance) -> Array | None:
        if self._planner is None or t - self._planned_at < _REPLAN_PERIOD:
            return None
        self._planned_at = t
        path = self._planner(self._sensed.points, position, target)
        if path is None:
            return None
        self._limiter.restart_watch()
        return self._settled(np.concatenate((position[None], path[1:-1], target[None])), free)

    def _follow(self, t: float, pose: Array, velocity: Array, chain: Array, free: FreeDistance) -> BaseCommand:
        """Pure pursuit: the curvature 2 sin α / L of the arc to the point on the band at the distance L."""
        p, limits = self.params, self.limits
        length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))))
        rho = free(chain)
        look = min(max(float(rho[0]), p.look_least), p.look_ahead, float(length[-1]))
        to = np.array([np.interp(look, length, chain[:, k]) for k in range(2)]) - pose[:2]
        alpha = angle_between(math.atan2(to[1], to[0]), float(pose[2]))
        remaining = float(length[-1])
        if abs(alpha) > p.turn_in_place:
            return self._limiter.drive(t, velocity, 0.0, p.turn_gain * alpha, remaining)
        room = float(rho[: int(np.searchsorted(length, p.look_ahead)) + 1].min())
        speed = min(max(room / p.bubble_time, p.min_speed), self._limiter.approach_speed(remaining))
        bend = 2.0 * math.sin(alpha) / max(float(np.hypot(*to)), 1e-6)
        speed = min(speed, limits.max_speed, limits.max_turn / max(abs(bend), 1e-9))
        return self._limiter.drive(t, velocity, speed, bend * speed, remaining)
