"""Optimal reciprocal collision avoidance (ORCA), by the authors' library RVO2 in the package ``pyrvo``.

Sources:
    J. van den Berg, S. J. Guy, M. Lin, D. Manocha (2011), Reciprocal n-body collision avoidance, in Robotics Research,
    STAR 70.
    J. Snape, J. van den Berg, S. J. Guy, D. Manocha (2010), Smooth and collision-free navigation for multiple robots
    under differential-drive constraints, IEEE/RSJ IROS: the effective centre.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Annotated, Protocol, cast

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import missing_extra
from elastic_strips.scene import Scene
from elastic_strips.validation import Bound, Checked, Positive

from .base_method import BaseCommand, BaseLimits, CommandLimiter, GoalParams
from .scene_method import SceneFromAbove

_PACKAGE = "pyrvo"
_SIDES = 8  # of the polygon about a round obstacle that stands
_STEP = 0.05  # [s] that the library takes; velocities do not depend on it without contacts
_Pair = tuple[float, float]


class _Vector(Protocol):
    x: float
    y: float


class _Simulator(Protocol):
    """What is used here of ``pyrvo.RVOSimulator``."""

    def add_agent(
        self,
        position: _Pair,
        neighbor_dist: float,
        max_neighbors: int,
        time_horizon: float,
        time_horizon_obst: float,
        radius: float,
        max_speed: float,
        velocity: _Pair,
        /,
    ) -> int: ...

    def add_obstacle(self, corners: list[_Pair], /) -> int: ...

    def process_obstacles(self) -> None: ...

    def set_time_step(self, step: float, /) -> None: ...

    def set_agent_pref_velocity(self, agent: int, velocity: _Pair, /) -> None: ...

    def do_step(self) -> None: ...

    def get_agent_velocity(self, agent: int, /) -> _Vector: ...


class _Library(Protocol):
    def RVOSimulator(self) -> _Simulator: ...


def _library() -> _Library:
    """The package.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        return cast("_Library", importlib.import_module(_PACKAGE))
    except ImportError as error:
        raise missing_extra("method='orca'", _PACKAGE) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class ReciprocalParams(Checked):
    """Parameters of RVO2, and of the differential drive.

    Attributes:
        ahead: distance [m] of the effective centre ahead of the base's origin; the disc about it is larger by as much.
        horizon: τ: time [s] for which the chosen velocity avoids what moves.
        standing_horizon: the same for what stands [s].
        range: distance [m] within which discs count; 15 in the library's examples.
        neighbors: largest number of discs that count; 10 in the library's examples.
        safety: distance [m] that is kept from obstacles; ours.
    """

    ahead: Positive = 0.15
    horizon: Positive = 5.0
    standing_horizon: Positive = 1.0
    range: Positive = 15.0
    neighbors: Annotated[int, Bound(low=1, high=1000)] = 10
    safety: Positive = 0.02


class ReciprocalAvoidance:
    """Workspace: ORCA of a point ahead of the axle, which goes any way at once, on obstacles that it is shown.

    Speed and yaw rate follow from that point's velocity u: v = u·e, ω = u·n / D, D ahead of the origin, so that the
    base drives backwards, too, where its limits allow that. Discs are agents as the base is, of which ORCA expects that
    they do half of the avoiding.

    Args:
        limits: limits of the base.
        params: parameters of the library.
        goal: when a goal is reached.

    Raises:
        MissingExtraError: ``pyrvo`` is not installed.
    """

    name = "orca"

    def __init__(
        self, limits: BaseLimits, params: ReciprocalParams | None = None, *, goal: GoalParams | None = None
    ) -> None:
        self.params: ReciprocalParams = ReciprocalParams() if params is None else params
        self.limits: BaseLimits = limits
        self._library = _library()
        self._limiter = CommandLimiter(limits, goal)
        self._seen = SceneFromAbove.of(Scene([]))

    def see(self, scene: Scene) -> None:
        """Take in the newest scene."""
        self._seen = SceneFromAbove.of(scene)

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """Speed and yaw rate now."""
        limiter, ahead = self._limiter, self.params.ahead
        done = limiter.at_goal(t, pose, velocity, goal)
        if done is not None:
            return done
        e = np.array([math.cos(pose[2]), math.sin(pose[2])])
        n = np.array([-e[1], e[0]])
        center = pose[:2] + ahead * e
        offset = np.asarray(goal[:2], dtype=float) - pose[:2]
        remaining = float(np.hypot(*offset))
        wanted = offset * (limiter.approach_speed(remaining) / max(remaining, 1e-9))
        u = self.velocity(t, center, velocity[0] * e + velocity[1] * ahead * n, wanted)
        return limiter.drive(t, velocity, float(u @ e), float(u @ n) / ahead, remaining)

    def velocity(self, t: float, center: Array, now: Array, wanted: Array) -> Array:
        """(2,) the velocity [m/s] of a point (2,) nearest to the wanted one (2,) that ORCA allows; ``now`` (2,) is its
        present one."""
        p, seen = self.params, self._seen
        simulator = self._library.RVOSimulator()
        simulator.set_time_step(_STEP)
        radius = self.limits.radius + p.ahead + p.safety
        top = self.limits.max_speed

        def add(at: Array, size: float, along: Array, speed: float) -> int:
            horizons = p.horizon, p.standing_horizon
            return simulator.add_agent(_pair(at), p.range, p.neighbors, *horizons, size, speed, _pair(along))

        own = add(center, radius, now, top)
        simulator.set_agent_pref_velocity(own, _pair(wanted))
        for at, size, along in zip(seen.centers_at(t), seen.radius.tolist(), seen.velocity, strict=True):
            if along.any():
                other = add(at, size, along, max(float(np.hypot(*along)), 1e-3))
                simulator.set_agent_pref_velocity(other, _pair(along))
            else:
                simulator.add_obstacle(_polygon(at, size))
        for corners in seen.polygons:
            simulator.add_obstacle([_pair(corner) for corner in corners])
        simulator.process_obstacles()
        simulator.do_step()
        chosen = simulator.get_agent_velocity(own)
        return np.array([chosen.x, chosen.y])


def _pair(point: Array) -> _Pair:
    return float(point[0]), float(point[1])


def _polygon(center: Array, radius: float) -> list[_Pair]:
    """Corners of the polygon about a disc, counter-clockwise."""
    angles = np.arange(_SIDES) * (2.0 * np.pi / _SIDES)
    ring = np.column_stack((np.cos(angles), np.sin(angles))) * (radius / math.cos(math.pi / _SIDES))
    return [_pair(corner) for corner in center + ring]
