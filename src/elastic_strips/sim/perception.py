"""What the planner gets to see of the world: late, with noise, and sometimes wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import ObstacleAssumptions
from elastic_strips.errors import ElasticStripsError
from elastic_strips.scene import Scene, Twist, UnknownMotion, World
from elastic_strips.validation import check_number


class PerceptionError(ElasticStripsError):
    """No usable scene came; the message says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PerceptionParams:
    """Noise of the sensed scene: within the assumptions by construction.

    Attributes:
        delay: age of a sensed scene [s].
        noise: fraction of the assumed errors of position and velocity that the noise may reach, 0 to 1.
    """

    delay: float = 0.05
    noise: float = 1.0

    def __post_init__(self) -> None:
        check_number("PerceptionParams.noise", self.noise, low=0.0, high=1.0)
        check_number("PerceptionParams.delay", self.delay, low=0.0, unit="s")


class Sensing(Protocol):
    """What a simulated robot senses: a scene (:class:`Perception`), or readings."""

    @property
    def contact(self) -> str:
        """What the robot feels that it touches, in words; empty where nothing, or where it feels nothing."""
        ...

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Look at the world, at every control step.

        Args:
            t: time [s].
            coordinates: (nv,) where the robot truly is; for what simulates sensors, and nobody else.
            estimate: (nv,) where it believes to be.
        """
        ...

    def sense(self, t: float) -> object:
        """What a controller takes at time ``t`` [s]."""
        ...


class Perception(Sensing, Protocol):
    """A source of scenes for a planner."""

    params: PerceptionParams

    def known(self) -> Scene:
        """What is known before the robot sets out."""
        ...

    def sense(self, t: float) -> Scene:
        """The newest scene at time ``t`` [s]; its ``time`` says how old it is.

        Raises:
            PerceptionError: what came is no scene.
        """
        ...


class NoisyGroundTruth:
    """Workspace: turns a world into what is sensed of it.

    Static obstacles are known (a map); of moving ones position and velocity are sensed, each off by a constant within
    the assumed bounds.

    Args:
        world: the true one.
        assumptions: bounds of the errors.
        params: of the noise.
        rng: source of the noise.
    """

    contact = ""  # nobody feels anything

    def __init__(
        self, world: World, assumptions: ObstacleAssumptions, params: PerceptionParams, rng: np.random.Generator
    ) -> None:
        self.world, self.params = world, params
        self._position: dict[str, np.ndarray] = {}
        self._velocity: dict[str, np.ndarray] = {}
        for name in world.names_moving:
            for store, size in (
                (self._position, assumptions.position_error),
                (self._velocity, assumptions.velocity_error),
            ):
                way = rng.normal(size=3)
                way[2] = 0.0
                store[name] = way / np.linalg.norm(way) * size * params.noise * rng.uniform()

    def known(self) -> Scene:
        """All that is there at time 0."""
        return self.world.at(0.0)

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Nothing: this perception knows the world."""

    def sense(self, t: float) -> Scene:
        """The world at time ``t`` [s] less the delay: of what moves a pose and a velocity, both a little off."""
        scene, seen = self.world.at(t - self.params.delay), []
        for obstacle in scene:
            if obstacle.motion is None:
                continue
            name = obstacle.name or ""
            pose = np.array(obstacle.pose)
            pose[:3, 3] += self._position[name]
            if isinstance(obstacle.motion, UnknownMotion):
                seen.append(obstacle.observed(pose, obstacle.motion))
                continue
            linear, angular = obstacle.velocity()
            seen.append(obstacle.observed(pose, Twist(linear + self._velocity[name], angular)))
        return scene.with_observations(seen) if seen else scene
