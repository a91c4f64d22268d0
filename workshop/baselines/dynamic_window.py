"""Dynamic window approach: pairs of speed and yaw rate that the base can reach soon, compared by where they lead.

Source:
    D. Fox, W. Burgard, S. Thrun (1997), The dynamic window approach to collision avoidance, IEEE Robotics & Automation
    Magazine 4(1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.scene import Scene
from elastic_strips.validation import Bound, Checked, NonNegative, Positive

from .base_method import BaseCommand, BaseLimits, CommandLimiter, GoalParams
from .scene_method import SceneFromAbove

_NEARER = 1e-3  # [m] by which something has to come nearer
_Samples = Annotated[int, Bound(low=2, high=1000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class DynamicWindowParams(Checked):
    """Parameters of the comparison.

    Attributes:
        heading_weight, distance_weight, speed_weight: α, β, γ of the objective; ours: with 2.0, 0.2, 0.2 as published
            it stands before a pillar that is straight ahead.
        interval: time [s] in which a pair has to be reached: the window's size; 0.25 as published.
        horizon: how far ahead the arcs are followed [s]; ours. What is met later counts as free.
        step: time [s] between the looks along an arc; ours.
        speeds, turns: number of speeds and yaw rates in the window; ours.
        safety: distance [m] that is kept from obstacles, beside the radius of the base; ours.
        predicts: whether discs go on at their velocities while an arc is followed; as published they stand where they
            are now.
    """

    heading_weight: NonNegative = 1.0
    distance_weight: NonNegative = 1.0
    speed_weight: NonNegative = 0.5
    interval: Positive = 0.25
    horizon: Positive = 3.0
    step: Positive = 0.1
    speeds: _Samples = 11
    turns: _Samples = 31
    safety: NonNegative = 0.05
    predicts: bool = False


def arcs(pose: Array, pairs: Array, times: Array) -> Array:
    """(N, T, 2) where a base from ``pose`` (3,) is at times (T,) [s] if it keeps pairs (N, 2) of speed and yaw rate."""
    v, omega = pairs[:, :1], pairs[:, 1:]
    half = 0.5 * omega * times
    chord = v * times * np.sinc(half / np.pi)
    return pose[:2] + chord[..., None] * np.stack((np.cos(pose[2] + half), np.sin(pose[2] + half)), axis=-1)


def admissible(pairs: Array, distance: Array, limits: BaseLimits) -> Mask:
    """(N,) V_a: pairs at which the base can stop before it has come as far as the distances (N,) [m] along its arc."""
    stops = pairs[:, 0] <= np.sqrt(2.0 * distance * limits.acceleration)
    return stops & (np.abs(pairs[:, 1]) <= np.sqrt(2.0 * distance * limits.turn_acceleration))


class DynamicWindow:
    """Workspace: the dynamic window approach of Fox, Burgard and Thrun, on obstacles that it is shown.

    The objective is α·heading + β·dist + γ·velocity, each between 0 and 1, of the admissible pairs of the window; it is
    not smoothed. The base counts as a disc. A pair that meets nothing within the horizon has the largest distance.

    Args:
        limits: limits of the base.
        params: parameters of the comparison.
        goal: when a goal is reached.
    """

    name = "dwa"

    def __init__(
        self, limits: BaseLimits, params: DynamicWindowParams | None = None, *, goal: GoalParams | None = None
    ) -> None:
        self.params: DynamicWindowParams = DynamicWindowParams() if params is None else params
        self.limits: BaseLimits = limits
        self._limiter = CommandLimiter(limits, goal)
        self._seen = SceneFromAbove.of(Scene([]))
        count = max(round(self.params.horizon / self.params.step), 1)
        self._times = self.params.step * np.arange(1, count + 1, dtype=float)

    def see(self, scene: Scene) -> None:
        """Take in the newest scene."""
        self._seen = SceneFromAbove.of(scene)

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """Speed and yaw rate now."""
        limiter = self._limiter
        done = limiter.at_goal(t, pose, velocity, goal)
        if done is not None:
            return done
        remaining = math.hypot(goal[0] - pose[0], goal[1] - pose[1])
        pairs = self.window(velocity)
        pairs = pairs[pairs[:, 0] <= max(limiter.approach_speed(remaining), float(pairs[0, 0]))]
        distance = self.distance(t, pose, pairs)
        able = admissible(pairs, distance, self.limits)
        if not able.any():
            return limiter.halt(t, velocity, "no speed of the window is admissible")
        value = np.where(able, self._objective(pose, goal, pairs, distance), -np.inf)
        v, omega = pairs[int(value.argmax())]
        return limiter.drive(t, velocity, float(v), float(omega), remaining)

    def window(self, velocity: Array) -> Array:
        """(N, 2) V_s ∩ V_d: pairs of speed and yaw rate that are possible, and reached from a velocity (2,) within the
        interval."""
        p, limits = self.params, self.limits
        v, omega = float(velocity[0]), float(velocity[1])
        dv, dw = limits.acceleration * p.interval, limits.turn_acceleration * p.interval
        low, high = np.clip((v - dv, v + dv), 0.0, limits.max_speed).tolist()
        right, left = np.clip((omega - dw, omega + dw), -limits.max_turn, limits.max_turn).tolist()
        speeds, turns = np.linspace(low, high, p.speeds), np.linspace(right, left, p.turns)
        return np.stack(np.meshgrid(speeds, turns, indexing="ij"), axis=-1).reshape(-1, 2)

    def distance(self, t: float, pose: Array, pairs: Array) -> Array:
        """(N,) dist: way [m] along each pair's arc until something is met; the longest way of all where nothing is.

        What is too near already is met only where it comes nearer: the base may turn beside it, and leave it.
        """
        p, limits, seen, times = self.params, self.limits, self._seen, self._times
        at = np.concatenate((np.broadcast_to(pose[:2], (len(pairs), 1, 2)), arcs(pose, pairs, times)), axis=1)
        times = np.append(0.0, times)
        apart = seen.from_polygons(at.reshape(-1, 2)).reshape(at.shape[:2])
        now, course = seen.centers_at(t), seen.velocity if p.predicts else np.zeros_like(seen.velocity)
        for center, radius, along in zip(now, seen.radius, course, strict=True):
            off = at - (center + times[:, None] * along)
            apart = np.minimum(apart, np.hypot(off[..., 0], off[..., 1]) - radius)
        met = apart[:, 1:] <= np.minimum(limits.radius + p.safety, apart[:, :1] - _NEARER)
        before = times[met.argmax(axis=1)]  # the last look at which it was free
        return np.where(met.any(axis=1), pairs[:, 0] * before, limits.max_speed * p.horizon)

    def _objective(self, pose: Array, goal: Array, pairs: Array, distance: Array) -> Array:
        """(N,) G of pairs, of which the distance is known."""
        p, limits = self.params, self.limits
        v, omega = pairs.T
        turned = omega * p.interval + 0.5 * omega * np.abs(omega) / limits.turn_acceleration  # and stopped turning
        way, yaw = v * (p.interval + 0.5 * v / limits.acceleration), pose[2] + turned
        x, y = pose[0] + way * np.cos(pose[2] + 0.5 * turned), pose[1] + way * np.sin(pose[2] + 0.5 * turned)
        error = np.arctan2(goal[1] - y, goal[0] - x) - yaw
        error = np.abs(np.remainder(error + np.pi, 2.0 * np.pi) - np.pi)
        return (
            p.heading_weight * (1.0 - error / np.pi)
            + p.distance_weight * distance / (limits.max_speed * p.horizon)
            + p.speed_weight * v / limits.max_speed
        )
