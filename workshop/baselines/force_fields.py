"""Artificial potential field and virtual force field: the goal attracts, near obstacles repel; the base follows the
resultant.

Sources:
    O. Khatib (1986), Real-time obstacle avoidance for manipulators and mobile robots, Int. J. Robotics Research 5(1).
    J. Borenstein, Y. Koren (1989), Real-time obstacle avoidance for fast mobile robots, IEEE Trans. Systems, Man, and
    Cybernetics 19(5): the certainty grid's cells repel. Their recovery from traps by following walls is left out: a
    trapped base oscillates or stands, and is reported as blocked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.validation import Checked, Count, Fraction, NonNegative, Positive, check_fields

from .base_method import BaseCommand, BaseLimits, CommandLimiter, GoalParams, angle_between
from .certainty_grid import CertaintyGrid, GridParams, PlanarReading, SensedPoints, make_grid

_SECTOR_COUNT = 72  # sectors of 5 degrees in which only the nearest point counts
_SECTORS_OF_NEAREST = 9  # sectors (45 degrees) within which a point must be the nearest one
_MIN_DISTANCE = 0.01  # [m] a smaller distance to an obstacle counts as this one


@dataclass(frozen=True, slots=True, kw_only=True)
class PotentialFieldParams(Checked):
    """Parameters; Khatib gives none for a mobile base, so that all values are ours.

    Attributes:
        attraction: k_p of the goal's potential ½ k_p |x − x_d|² [1/s²].
        conic: distance [m] from the goal beyond which its force stays as large as there.
        repulsion: η of the obstacles' potential ½ η (1/ρ − 1/ρ0)² [m⁴/s²].
        influence: distance ρ0 [m] from the base's circle beyond which an obstacle exerts no force.
        turn_gain: yaw rate per angle between heading and force [1/s].
    """

    attraction: Positive = 1.0
    conic: Positive = 1.0
    repulsion: Positive = 0.03
    influence: Positive = 1.0
    turn_gain: Positive = 2.0


def attractive_force(position: Array, goal: Array, params: PotentialFieldParams) -> Array:
    """(2,) −k_p (x − x_d) up to the distance ``conic`` from the goal, beyond of constant size [m/s²]."""
    to_goal = np.asarray(goal, dtype=float)[:2] - np.asarray(position, dtype=float)[:2]
    distance = float(np.hypot(*to_goal))
    return params.attraction * min(1.0, params.conic / max(distance, _MIN_DISTANCE)) * to_goal


def repulsive_force(away: Array, distance: Array, params: PotentialFieldParams) -> Array:
    """(K, 2) η (1/ρ − 1/ρ0)/ρ² · ∂ρ/∂x where ρ < ρ0, else zero [m/s²].

    Args:
        away: (K, 2) ∂ρ/∂x: unit vectors away from the obstacles.
        distance: (K,) ρ [m].
        params: η and ρ0.
    """
    rho = np.maximum(distance, _MIN_DISTANCE)
    size = params.repulsion * np.maximum(1.0 / rho - 1.0 / params.influence, 0.0) / rho**2
    return size[:, None] * away


def nearest_points(offsets: Array) -> Array:
    """(K, 2) of points (P, 2) about the origin, those that are the nearest within 45° of their bearing.

    They replace the nearest points of Khatib's obstacles, which are known bodies. In a corridor each wall has one; two
    at the same distance both count.
    """
    from scipy.ndimage import minimum_filter1d  # late: slow to import

    if not len(offsets):
        return offsets
    distance = np.hypot(offsets[:, 0], offsets[:, 1])
    sector = (
        np.floor(np.arctan2(offsets[:, 1], offsets[:, 0]) * (_SECTOR_COUNT / (2.0 * np.pi)) + 0.5).astype(int)
        % _SECTOR_COUNT
    )
    order = np.lexsort((distance, sector))
    _, first = np.unique(sector[order], return_index=True)
    of_sector = order[first]
    profile = np.full(_SECTOR_COUNT, np.inf)
    profile[sector[of_sector]] = distance[of_sector]
    least = minimum_filter1d(profile, 2 * _SECTORS_OF_NEAREST + 1, mode="wrap")
    return offsets[of_sector[distance[of_sector] <= least[sector[of_sector]] + 1e-9]]


class PotentialField:
    """Workspace: Khatib's artificial potential field for a base.

    By Khatib's damping the wanted velocity is F/k_v, with k_v such that a far goal alone gives the largest speed. The
    base turns towards that velocity and drives by its component along the heading.

    Args:
        limits: limits of the base.
        params: parameters of the field.
        goal: when a goal is reached.
    """

    name = "apf"

    def __init__(
        self, limits: BaseLimits, params: PotentialFieldParams | None = None, *, goal: GoalParams | None = None
    ) -> None:
        self.params: PotentialFieldParams = PotentialFieldParams() if params is None else params
        self.limits: BaseLimits = limits
        self._limiter = CommandLimiter(limits, goal)
        self._sensed = SensedPoints()
        self._damping = self.params.attraction * self.params.conic / limits.max_speed

    def update(self, reading: PlanarReading, pose: Array) -> None:
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
        done = self._limiter.at_goal(t, pose, velocity, goal)
        if done is not None:
            return done
        wanted = self.force(pose, goal) / self._damping
        speed = min(float(np.hypot(*wanted)), self.limits.max_speed)
        error = angle_between(math.atan2(wanted[1], wanted[0]), float(pose[2])) if speed > 1e-6 else 0.0
        remaining = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        return self._limiter.drive(
            t, velocity, speed * max(math.cos(error), 0.0), self.params.turn_gain * error, remaining
        )


_MIN_CELL_DISTANCE = 0.05  # [m] a cell that is nearer counts as this near


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualForceFieldParams:
    """Parameters.

    Attributes:
        repulsion: F_cr [−]; ours (only its ratio to ``attraction`` counts).
        attraction: F_ct [−]; ours.
        power: n of the distance, 2 as published.
        weight: w of the damping across the way, 0.25 as published; 1 is no damping.
        active: edge of the active region in cells, 33 as published; odd.
        turn_gain: K_s, yaw rate per angle between heading and resultant [1/s]; ours.
        filter_time: τ of the low-pass filter of the yaw rate [s], 0.4 as published.
        full_force: repulsion [−] from which on the speed is reduced in full; below it, in proportion. As published any
            repulsion reduces it in full, which is 0 here; a base that heads straight for something far off then stands.
        min_speed: least speed [m/s], 0.04; of Borenstein and Koren's later method (1991).
    """

    repulsion: NonNegative = 0.03
    attraction: Positive = 1.0
    power: Positive = 2.0
    weight: Fraction = 0.25
    active: Count = 33
    turn_gain: Positive = 2.0
    filter_time: NonNegative = 0.4
    full_force: NonNegative = 1.0
    min_speed: NonNegative = 0.04

    def __post_init__(self) -> None:
        check_fields(self)
        if self.active % 2 != 1:
            raise ParameterError(f"VirtualForceFieldParams.active={self.active!r} must be odd")


def cell_forces(offsets: Array, certainty: Array, width: float, params: VirtualForceFieldParams) -> Array:
    """(K, 2) F_cr · CV · Wⁿ/dⁿ, each away from its cell.

    Args:
        offsets: (K, 2) from the base to the cells' middles [m].
        certainty: (K,) CV.
        width: W of the base [m].
        params: F_cr and n.
    """
    distance = np.maximum(np.hypot(offsets[:, 0], offsets[:, 1]), _MIN_CELL_DISTANCE)
    return -(params.repulsion * certainty * (width / distance) ** params.power / distance)[:, None] * offsets


def cosine(a: Array, b: Array) -> float:
    """Cosine of the angle between two vectors (2,); 0 where one of them vanishes."""
    size = float(np.hypot(*a) * np.hypot(*b))
    return float(a @ b) / size if size > 1e-12 else 0.0


def damped(force: Array, heading: Array, weight: float) -> Array:
    """(2,) F′ = w F + (1 − w)(−cos θ) F, θ the angle from the heading to the force.

    Obstacles beside the base repel it by w only, so that it oscillates less along walls. Those behind it, too: by the
    formula alone they would attract.
    """
    return (weight + (1.0 - weight) * max(-cosine(heading, force), 0.0)) * force


class VirtualForceField:
    """Workspace: Borenstein and Koren's virtual force field.

    The base is steered by Ω = K_s (δ − θ), δ the direction of the resultant of the attraction and the damped
    repulsion, through a low-pass filter; its speed is V_max (1 − |cos|) of the angle between velocity and repulsion,
    milder where the repulsion is weak.

    Args:
        limits: limits of the base.
        params: parameters of the field.
        grid: parameters of the certainty grid.
        goal: when a goal is reached.
    """

    name = "vff"

    def __init__(
        self,
        limits: BaseLimits,
        params: VirtualForceFieldParams | None = None,
        *,
        grid: GridParams | None = None,
        goal: GoalParams | None = None,
    ) -> None:
        self.params: VirtualForceFieldParams = VirtualForceFieldParams() if params is None else params
        self.limits: BaseLimits = limits
        self.grid: CertaintyGrid = make_grid(grid)
        self._limiter = CommandLimiter(limits, goal)
        self._turn = 0.0

    def update(self, reading: PlanarReading, pose: Array) -> None:
        """Take in a reading, taken at ``pose`` (x, y, yaw)."""
        self.grid.update(reading, pose)

    def forces(self, pose: Array, goal: Array) -> tuple[Array, Array]:
        """(2,) repulsion, undamped, and (2,) attraction, in the world's frame."""
        offsets, certainty = self.grid.active(pose, self.params.active)
        repulsion = cell_forces(offsets, certainty, 2.0 * self.limits.radius, self.params).sum(axis=0)
        to_goal = np.asarray(goal[:2], dtype=float) - np.asarray(pose[:2], dtype=float)
        return repulsion, self.params.attraction * to_goal / max(float(np.hypot(*to_goal)), 1e-9)

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """Speed and yaw rate now."""
        p, limiter, yaw = self.params, self._limiter, float(pose[2])
        done = limiter.at_goal(t, pose, velocity, goal)
        if done is not None:
            self._turn = 0.0
            return done
        repulsion, attraction = self.forces(pose, goal)
        heading = np.array([math.cos(yaw), math.sin(yaw)])
        total = attraction + damped(repulsion, heading, p.weight)
        wanted = p.turn_gain * angle_between(math.atan2(total[1], total[0]), yaw)
        share = min(limiter.period(t) / max(p.filter_time, 1e-9), 1.0)
        self._turn += share * (wanted - self._turn)
        remaining = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        strength = min(float(np.hypot(*repulsion)) / max(p.full_force, 1e-9), 1.0)
        speed = self.limits.max_speed * (1.0 - strength * abs(cosine(heading, repulsion)))
        speed = min(max(speed, p.min_speed), limiter.approach_speed(remaining))
        return limiter.drive(t, velocity, speed, self._turn, remaining)
