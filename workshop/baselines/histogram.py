"""Vector field histogram: polar histograms, and steering by them.

Sector k has its middle at the bearing k·α in the world's frame.

Sources:
    J. Borenstein, Y. Koren (1991), The vector field histogram: fast obstacle avoidance for mobile robots, IEEE Trans.
    Robotics and Automation 7(3): the original, and the speed's law, of both.
    I. Ulrich, J. Borenstein (1998), VFH+: reliable obstacle avoidance for fast mobile robots, IEEE ICRA.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.errors import ParameterError
from elastic_strips.validation import Bound, Count, NonNegative, Positive, check_fields

from .base_method import BaseCommand, BaseLimits, CommandLimiter, GoalParams, angle_between
from .certainty_grid import CertaintyGrid, Flags, GridParams, PlanarReading, make_grid


def primary_histogram(
    offsets: Array, certainty: Array, *, sectors: int, cell: float, reach: float, a: float, enlarged: float
) -> Array:
    """(K,) VFH+: sum of m = c² (a − b d²) of the cells that, enlarged by the base, reach into a sector.

    b is such that a cell at the rim of the circular active region has the factor a − b d_max² = 1; a cell spans the
    bearings β ± γ with sin γ = r/d. A cell that the enlarged base holds spans the half plane on its side.

    Args:
        offsets: (C, 2) from the base to the cells' middles [m].
        certainty: (C,) c.
        sectors: K = 2π/α.
        cell: edge of a cell [m]; d counts in cells.
        reach: d_max [cells].
        a: a of the formula.
        enlarged: r: radius of the base plus the distance it keeps [m].
    """
    distance = np.hypot(offsets[:, 0], offsets[:, 1])
    near = distance <= reach * cell + 1e-9
    distance, offsets = distance[near], offsets[near]
    b = (a - 1.0) / reach**2
    magnitude = certainty[near] ** 2 * (a - b * (distance / cell) ** 2)
    spread = np.arcsin(np.minimum(enlarged / np.maximum(distance, 1e-9), 1.0))
    spread = np.maximum(spread, math.pi / sectors)
    middles = np.arange(sectors) * (2.0 * np.pi / sectors)
    off = np.abs(np.mod(np.arctan2(offsets[:, 1], offsets[:, 0])[:, None] - middles + np.pi, 2.0 * np.pi) - np.pi)
    return magnitude @ (off <= spread[:, None] + 1e-9)


def original_histogram(
    offsets: Array, certainty: Array, *, sectors: int, cell: float, reach: float, smoothing: int
) -> Array:
    """(K,) VFH: sum of m = c² (a − b d) of the cells in a sector, smoothed over 2l + 1 sectors.

    b = 1 and a = d_max, the distance of the corner of the square active region, so that m vanishes there. The
    smoothing's weights are 1, 2, … l towards the middle, divided by 2l + 1.
    """
    d = np.hypot(offsets[:, 0], offsets[:, 1]) / cell
    magnitude = certainty**2 * np.maximum(math.sqrt(2.0) * reach - d, 0.0)
    sector = np.rint(np.arctan2(offsets[:, 1], offsets[:, 0]) * (sectors / (2.0 * np.pi))).astype(int) % sectors
    raw = np.bincount(sector, magnitude, minlength=sectors)
    weights = [min(smoothing, smoothing + 1 - abs(i)) for i in range(-smoothing, smoothing + 1)]
    total = sum(w * np.roll(raw, i) for i, w in zip(range(-smoothing, smoothing + 1), weights, strict=True))
    return np.asarray(total) / (2 * smoothing + 1)


def binary_histogram(density: Array, before: Flags, low: float, high: float) -> Flags:
    """(K,) which sectors are blocked: above ``high`` yes, below ``low`` no, between as ``before``."""
    return np.where(density > high, True, np.where(density < low, False, before))


def masked_histogram(
    blocked: Flags, offsets: Array, heading: float, *, turning_radius: float, enlarged: float
) -> Flags:
    """(K,) which sectors are blocked, or cannot be reached without touching something on the turn to them.

    The base turns about a point at ``turning_radius`` to its right or left. A cell on that side, nearer to that point
    than the turning radius and the enlarged base together, blocks its own bearing and all beyond.

    Args:
        blocked: (K,) the binary histogram.
        offsets: (C, 2) from the base to the middles of the occupied cells [m].
        heading: heading of the base [rad].
        turning_radius: smallest radius of its turns [m]; at 0 it turns in place, and nothing is masked.
        enlarged: radius of the base plus the distance it keeps [m].
    """
    if turning_radius <= 0.0:
        return blocked
    cos, sin = math.cos(heading), math.sin(heading)
    ahead, left = offsets @ np.array([cos, sin]), offsets @ np.array([-sin, cos])
    bearing = np.arctan2(left, ahead)
    limits = []
    for side in (-1.0, 1.0):
        meets = (np.hypot(ahead, left - side * turning_radius) < turning_radius + enlarged) & (side * left > 0.0)
        limits.append(float(np.abs(bearing[meets]).min()) if meets.any() else np.pi)
    middles = np.arange(len(blocked)) * (2.0 * np.pi / len(blocked))
    off = np.mod(middles - heading + np.pi, 2.0 * np.pi) - np.pi
    return blocked | (off < -limits[0] - 1e-9) | (off > limits[1] + 1e-9)


@dataclass(frozen=True, slots=True)
class Valley:
    """A run of open sectors, from ``right`` to ``left`` (counter-clockwise; ``left`` may exceed K − 1)."""

    right: int
    left: int

    @property
    def width(self) -> int:
        """Number of sectors."""
        return self.left - self.right + 1


def valleys(blocked: Flags) -> list[Valley]:
    """The runs of open sectors; one of all sectors where nothing is blocked."""
    count = len(blocked)
    if not blocked.any():
        return [Valley(0, count - 1)]
    starts = np.flatnonzero(~blocked & np.roll(blocked, 1)).tolist()
    ends = np.flatnonzero(blocked & ~np.roll(blocked, 1)).tolist()
    return [Valley(i, min((j - i - 1) % count for j in ends) + i) for i in starts]


def candidates(blocked: Flags, target: float, wide: int) -> list[float]:
    """Candidate directions [sectors]: the middles of narrow valleys; of wide ones a little in from both borders, and
    the target where it is between those two.

    Args:
        blocked: (K,) the masked histogram.
        target: direction of the goal [sectors].
        wide: s_max: a valley of more sectors is wide.
    """
    count = len(blocked)
    found: list[float] = []
    for valley in valleys(blocked):
        if valley.width == count:
            return [target % count]
        if valley.width <= wide:
            found.append(0.5 * (valley.right + valley.left) % count)
            continue
        first, last = valley.right + 0.5 * wide, valley.left - 0.5 * wide
        found += [first % count, last % count]
        if (target - first) % count <= last - first:
            found.append(target % count)
    return found


def sector_distance(a: float, b: float, count: int) -> float:
    """Δ: the smaller number of sectors between two directions."""
    off = abs(a - b) % count
    return min(off, count - off)


def cheapest(found: list[float], weighed: list[tuple[float, float]], count: int) -> float:
    """The candidate with the least g = Σ μ Δ(c, reference); ``weighed`` holds pairs of μ and reference."""
    return min(found, key=lambda c: sum(weight * sector_distance(c, other, count) for weight, other in weighed))


@dataclass(frozen=True, slots=True, kw_only=True)
class HistogramParams:
    """Parameters; densities are in units of c² times (a − b d²), or of c² times cells for the original.

    Attributes:
        variant: ``"vfh+"``, or ``"vfh"``: the original; its values are in :meth:`original`.
        sectors: number of directions; 72 of 5° as published.
        active: edge of the active region in cells, 33 as published; odd.
        magnitude: a; b follows, so that a − b d_max² = 1. Ours: b = 1.
        safety: distance [m] that is kept from obstacles, beside the radius of the base; ours.
        low, high: thresholds of the binary histogram; ours: a cell that was seen once (c = 3) blocks nothing.
        wide: s_max: valleys of more sectors are wide [sectors]; 16 as published.
        target_weight, heading_weight, previous_weight: μ1, μ2, μ3 of the candidate's distance to the goal's direction,
            to the heading, and to the last choice; 5, 2, 2 as published: μ1 > μ2 + μ3.
        turning_radius: smallest radius of turns at rest [m]; 0 for a differential drive. At a speed v it is at least
            v / max_turn.
        mask_certainty: cells at least as certain restrict turns [−]; ours.
        smoothing: l of the original [sectors]; 5 as published.
        stop_density: h_m: density along the heading at which the base stands; ours.
        turn_gain: yaw rate per angle between heading and choice [1/s]; ours.
        min_speed: V_min [m/s], 0.04 as published.
    """

    variant: Literal["vfh+", "vfh"] = "vfh+"
    sectors: Annotated[int, Bound(low=8)] = 72
    active: Annotated[int, Bound(low=3)] = 33
    magnitude: Annotated[float, Bound(low=1.0)] = 257.0
    safety: NonNegative = 0.06
    low: Positive = 2500.0
    high: Positive = 5000.0
    wide: Count = 16
    target_weight: Positive = 5.0
    heading_weight: NonNegative = 2.0
    previous_weight: NonNegative = 2.0
    turning_radius: NonNegative = 0.0
    mask_certainty: Positive = 6.0
    smoothing: Count = 5
    stop_density: Positive = 300000.0
    turn_gain: Positive = 2.0
    min_speed: NonNegative = 0.04

    def __post_init__(self) -> None:
        check_fields(self)
        if self.active % 2 != 1:
            raise ParameterError(f"HistogramParams.active={self.active!r} must be odd")
        if self.low > self.high:
            raise ParameterError(f"HistogramParams.low={self.low!r} must not exceed high={self.high!r}")

    @staticmethod
    def original() -> HistogramParams:
        """The values of the method of 1991: one threshold, the opening nearest to the goal's direction, s_max = 18."""
        return HistogramParams(
            variant="vfh",
            low=1500.0,
            high=1500.0,
            wide=18,
            heading_weight=0.0,
            previous_weight=0.0,
            stop_density=12000.0,
        )


class VectorFieldHistogram:
    """Workspace: VFH+ of Ulrich and Borenstein, or, by its parameters, the original of Borenstein and Koren.

    Added here: cells further away than the goal are ignored, so that a goal in front of a wall can be reached. The base
    stands, and counts as blocked, where no direction is open; where one is open but cannot be reached by a turn at the
    present speed, it stops and turns in place.

    Args:
        limits: limits of the base.
        params: parameters of the histograms.
        grid: parameters of the certainty grid.
        goal: when a goal is reached.
    """

    name = "vfh"

    def __init__(
        self,
        limits: BaseLimits,
        params: HistogramParams | None = None,
        *,
        grid: GridParams | None = None,
        goal: GoalParams | None = None,
    ) -> None:
        self.params: HistogramParams = HistogramParams() if params is None else params
        self.limits: BaseLimits = limits
        self.grid: CertaintyGrid = make_grid(grid)
        self._limiter = CommandLimiter(limits, goal)
        self.blocked: Mask = np.zeros(self.params.sectors, dtype=bool)
        self.direction: float | None = None

    def update(self, reading: PlanarReading, pose: Array) -> None:
        """Take in a reading, taken at ``pose`` (x, y, yaw)."""
        self.grid.update(reading, pose)

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """Speed and yaw rate now."""
        p, limiter, yaw = self.params, self._limiter, float(pose[2])
        done = limiter.at_goal(t, pose, velocity, goal)
        if done is not None:
            self.direction = None
            return done
        remaining = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        enlarged = self.limits.radius + p.safety
        offsets, certainty = self.grid.active(pose, p.active)
        before = np.hypot(offsets[:, 0], offsets[:, 1]) <= remaining + enlarged
        offsets, certainty = offsets[before], certainty[before]
        density = self._density(offsets, certainty, enlarged)
        self.blocked = binary_histogram(density, self.blocked, p.low, p.high)
        radius = max(p.turning_radius, abs(float(velocity[0])) / self.limits.max_turn)
        sure = offsets[certainty >= p.mask_certainty]
        masked = self.blocked
        if p.variant == "vfh+":
            masked = masked_histogram(self.blocked, sure, yaw, turning_radius=radius, enlarged=enlarged)
        sector = 2.0 * math.pi / p.sectors
        target = math.atan2(goal[1] - pose[1], goal[0] - pose[0]) / sector
        found, stop = candidates(masked, target, p.wide), False
        if not found:
            found, stop = candidates(self.blocked, target, p.wide), True
        if not found:
            self.direction = None
            return limiter.halt(t, velocity, "no direction is open")
        last = yaw / sector if self.direction is None else self.direction
        weighed = [(p.target_weight, target), (p.heading_weight, yaw / sector), (p.previous_weight, last)]
        self.direction = cheapest(found, weighed, p.sectors)
        turn = p.turn_gain * angle_between(self.direction * sector, yaw)
        if stop:
            return limiter.drive(t, velocity, 0.0, turn, remaining, "stops to turn")
        here = round(yaw / sector) % p.sectors
        speed = min(
            self._speed(float(density[here]), turn, bool(self.blocked[here])), limiter.approach_speed(remaining)
        )
        return limiter.drive(t, velocity, speed, turn, remaining)

    def _density(self, offsets: Array, certainty: Array, enlarged: float) -> Array:
        """(K,) the density of each direction, of the variant."""
        p = self.params
        reach, cell = 0.5 * (p.active - 1), self.grid.params.cell
        if p.variant == "vfh":
            return original_histogram(
                offsets, certainty, sectors=p.sectors, cell=cell, reach=reach, smoothing=p.smoothing
            )
        return primary_histogram(
            offsets, certainty, sectors=p.sectors, cell=cell, reach=reach, a=p.magnitude, enlarged=enlarged
        )

    def _speed(self, density: float, turn: float, blocked: bool) -> float:
        """V = V_max (1 − min(h, h_m)/h_m)(1 − |Ω|/Ω_max) + V_min [m/s]; without V_min where the heading is blocked."""
        slowed = self.limits.max_speed * (1.0 - min(density / self.params.stop_density, 1.0))
        slowed *= 1.0 - min(abs(turn) / self.limits.max_turn, 1.0)
        return slowed if blocked else slowed + self.params.min_speed
