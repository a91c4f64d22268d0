"""Artificial potential field: the goal attracts, what is near repels; the base follows the force.

Source: O. Khatib (1986), Real-time obstacle avoidance for manipulators and mobile robots, Int. J. Robotics Research
5(1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.perception import Reading
from elastic_strips.validation import check_numbers

from .base_method import BaseCommand, BaseLimits
from .certainty_grid import SensedPoints
from .helm import GoalParams, Helm, angle_between

_BINS = 72  # sectors of 5 degrees in which only the nearest point counts
_APART = 9  # sectors (45 degrees) within which a point must be the nearest to count as an obstacle's nearest
_LEAST = 0.01  # [m] a smaller distance to an obstacle counts as this one


@dataclass(frozen=True, slots=True, kw_only=True)
class PotentialFieldParams:
    """Parameters; Khatib gives none for a mobile base, so that all values are ours.

    Attributes:
        attraction: k_p of the goal's potential ½ k_p |x − x_d|² [1/s²].
        conic: distance [m] from the goal beyond which its force stays as large as there.
        repulsion: η of the obstacles' potential ½ η (1/ρ − 1/ρ0)² [m⁴/s²].
        influence: distance ρ0 [m] from the base's circle beyond which an obstacle exerts no force.
        turn_gain: yaw rate per angle between heading and force [1/s].
    """

    attraction: float = 1.0
    conic: float = 1.0
    repulsion: float = 0.03
    influence: float = 1.0
    turn_gain: float = 2.0

    def __post_init__(self) -> None:
        check_numbers(self)


def attractive_force(position: Array, goal: Array, params: PotentialFieldParams) -> Array:
    """(2,) −k_p (x − x_d) up to the distance ``conic`` from the goal, beyond of constant size [m/s²]."""
    to_goal = np.asarray(goal, dtype=float)[:2] - np.asarray(position, dtype=float)[:2]
    distance = float(np.hypot(*to_goal))
    return params.attraction * min(1.0, params.conic / max(distance, _LEAST)) * to_goal


def repulsive_force(away: Array, distance: Array, params: PotentialFieldParams) -> Array:
    """(K, 2) η (1/ρ − 1/ρ0)/ρ² · ∂ρ/∂x where ρ < ρ0, else zero [m/s²].

    Args:
        away: (K, 2) ∂ρ/∂x: unit vectors away from the obstacles.
        distance: (K,) ρ [m].
        params: η and ρ0.
    """
    rho = np.maximum(distance, _LEAST)
    size = params.repulsion * np.maximum(1.0 / rho - 1.0 / params.influence, 0.0) / rho**2
    return size[:, None] * away


def nearest_points(offsets: Array) -> Array:
    """(K, 2) of points (P, 2) about the origin, those that are the nearest within 45° of their bearing.

    They stand for the obstacles' nearest points: Khatib's obstacles are known bodies, ours are points. In a corridor
    each wall has one; two at the same distance both count.
    """
    from scipy.ndimage import minimum_filter1d  # late: slow to import

    if not len(offsets):
        return offsets
    distance = np.hypot(offsets[:, 0], offsets[:, 1])
    sector = np.floor(np.arctan2(offsets[:, 1], offsets[:, 0]) * (_BINS / (2.0 * np.pi)) + 0.5).astype(int) % _BINS
    order = np.lexsort((distance, sector))
    _, first = np.unique(sector[order], return_index=True)
    of_sector = order[first]
    profile = np.full(_BINS, np.inf)
    profile[sector[of_sector]] = distance[of_sector]
    least = minimum_filter1d(profile, 2 * _APART + 1, mode="wrap")
    return offsets[of_sector[distance[of_sector] <= least[sector[of_sector]] + 1e-9]]


class PotentialField:
    """Khatib's artificial potential field for a base.

    The force is turned into a velocity as by Khatib's damping: at rest in it, the base moves with F/k_v, where k_v is
    such that the far goal alone asks for the largest speed. The base turns towards that velocity and drives by its
    part along the heading.

    Args:
        limits: of the base.
        params: of the field.
        goal: when a goal is reached.
    """

    name = "apf"

    def __init__(
        self, limits: BaseLimits, params: PotentialFieldParams | None = None, *, goal: GoalParams | None = None
    ) -> None:
        self.params = PotentialFieldParams() if params is None else params
        self.limits, self._helm, self._sensed = limits, Helm(limits, goal), SensedPoints()
        self._damping = self.params.attraction * self.params.conic / limits.max_speed

    def reset(self) -> None:
        """Forget all that was sensed and done."""
        self._helm.reset()
        self._sensed.reset()

    def update(self, reading: Reading, pose: Array) -> None:
        """Take in a reading, taken at ``pose`` (x, y, yaw)."""
        self._sensed.update(reading, pose)

    def force(self, pose: Array, goal: Array) -> Array:
        """(2,) sum of the forces on the base at a pose, in the world's frame [m/s²]."""
        position = np.asarray(pose, dtype=float)[:2]
        offsets = nearest_points(self._sensed.points - position)
        distance = np.hypot(offsets[:, 0], offsets[:, 1])
        away = -offsets / np.maximum(distance, 1e-9)[:, None]
        total = repulsive_force(away, distance - self.limits.radius, self.params).sum(axis=0)
        return attractive_force(position, goal, self.params) + total

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """Speed and yaw rate now."""
        done = self._helm.at_goal(t, pose, velocity, goal)
        if done is not None:
            return done
        wanted = self.force(pose, goal) / self._damping
        speed = min(float(np.hypot(*wanted)), self.limits.max_speed)
        error = angle_between(math.atan2(wanted[1], wanted[0]), float(pose[2])) if speed > 1e-6 else 0.0
        remaining = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        return self._helm.drive(
            t, velocity, speed * max(math.cos(error), 0.0), self.params.turn_gain * error, remaining
        )
