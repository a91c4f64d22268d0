"""Polar histograms: how much is in each direction from the base, and which directions are open.

Sector k has its middle at the bearing k·α in the world's frame. Sources: see :mod:`.histogram`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..robot.space import Array
from .sensed import Flags


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
        a: see above.
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
        heading: of the base [rad].
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
