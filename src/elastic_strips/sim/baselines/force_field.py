"""Virtual force field: every cell of the certainty grid near the base repels it, the goal attracts it.

Source: J. Borenstein, Y. Koren (1989), Real-time obstacle avoidance for fast mobile robots, IEEE Trans. Systems, Man,
and Cybernetics 19(5). Their recovery from traps by following walls is left out: a trapped base oscillates or stands,
and is reported as blocked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.perception import Reading
from elastic_strips.validation import check_numbers

from .base_method import BaseCommand, BaseLimits
from .certainty_grid import GridParams, make_grid
from .helm import GoalParams, Helm, angle_between

_LEAST = 0.05  # [m] a cell that is nearer counts as this near


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceFieldParams:
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

    repulsion: float = 0.03
    attraction: float = 1.0
    power: float = 2.0
    weight: float = 0.25
    active: int = 33
    turn_gain: float = 2.0
    filter_time: float = 0.4
    full_force: float = 1.0
    min_speed: float = 0.04

    def __post_init__(self) -> None:
        check_numbers(self, zero=("repulsion", "weight", "filter_time", "full_force", "min_speed"))
        if self.active % 2 != 1:
            raise ParameterError(f"ForceFieldParams.active={self.active!r} must be odd")
        if self.weight > 1.0:
            raise ParameterError(f"ForceFieldParams.weight={self.weight!r} must be ≤ 1")


def cell_forces(offsets: Array, certainty: Array, width: float, params: ForceFieldParams) -> Array:
    """(K, 2) F_cr · CV · Wⁿ/dⁿ, each away from its cell.

    Args:
        offsets: (K, 2) from the base to the cells' middles [m].
        certainty: (K,) CV.
        width: W of the base [m].
        params: F_cr and n.
    """
    distance = np.maximum(np.hypot(offsets[:, 0], offsets[:, 1]), _LEAST)
    return -(params.repulsion * certainty * (width / distance) ** params.power / distance)[:, None] * offsets


def cosine(a: Array, b: Array) -> float:
    """Cosine of the angle between two vectors (2,); 0 where one of them vanishes."""
    size = float(np.hypot(*a) * np.hypot(*b))
    return float(a @ b) / size if size > 1e-12 else 0.0


def damped(force: Array, heading: Array, weight: float) -> Array:
    """(2,) F′ = w F + (1 − w)(−cos θ) F, θ the angle from the heading to the force.

    What is beside the base repels it by w only, so that it oscillates less along walls. So does, here, what is behind
    it: by the formula alone it would attract.
    """
    return (weight + (1.0 - weight) * max(-cosine(heading, force), 0.0)) * force


class ForceField:
    """Borenstein and Koren's virtual force field.

    The base is steered by Ω = K_s (δ − θ), δ the direction of the resultant of the attraction and the damped
    repulsion, through a low-pass filter; its speed is V_max (1 − |cos|) of the angle between velocity and repulsion,
    milder where the repulsion is weak.

    Args:
        limits: of the base.
        params: of the field.
        grid: of the certainty grid.
        goal: when a goal is reached.
    """

    name = "vff"

    def __init__(
        self,
        limits: BaseLimits,
        params: ForceFieldParams | None = None,
        *,
        grid: GridParams | None = None,
        goal: GoalParams | None = None,
    ) -> None:
        self.params = ForceFieldParams() if params is None else params
        self.limits, self.grid, self._helm = limits, make_grid(grid), Helm(limits, goal)
        self._turn = 0.0

    def reset(self) -> None:
        """Forget all that was sensed and done."""
        self._helm.reset()
        self.grid.reset()
        self._turn = 0.0

    def update(self, reading: Reading, pose: Array) -> None:
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
        p, helm, yaw = self.params, self._helm, float(pose[2])
        done = helm.at_goal(t, pose, velocity, goal)
        if done is not None:
            self._turn = 0.0
            return done
        repulsion, attraction = self.forces(pose, goal)
        heading = np.array([math.cos(yaw), math.sin(yaw)])
        total = attraction + damped(repulsion, heading, p.weight)
        wanted = p.turn_gain * angle_between(math.atan2(total[1], total[0]), yaw)
        share = min(helm.period(t) / max(p.filter_time, 1e-9), 1.0)
        self._turn += share * (wanted - self._turn)
        remaining = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        strength = min(float(np.hypot(*repulsion)) / max(p.full_force, 1e-9), 1.0)
        speed = self.limits.max_speed * (1.0 - strength * abs(cosine(heading, repulsion)))
        speed = min(max(speed, p.min_speed), helm.approach_speed(remaining))
        return helm.drive(t, velocity, speed, self._turn, remaining)
