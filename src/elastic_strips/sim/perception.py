"""Perception: the planner's view of the world, with delay and noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import ObstacleAssumptions
from elastic_strips.errors import ElasticStripsError
from elastic_strips.scene import Scene, Twist, UnknownMotion, World
from elastic_strips.validation import Bound, Checked, Fraction


class PerceptionError(ElasticStripsError):
    """There is no usable scene; the message has the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PerceptionParams(Checked):
    """Noise of the sensed scene: within the assumptions by construction.

    Attributes:
        delay: age of a sensed scene [s].
        noise: fraction of the assumed errors of position and velocity that the noise may reach, 0 to 1.
    """

    delay: Annotated[float, Bound(low=0.0, unit="s")] = 0.05
    noise: Fraction = 1.0


class Perception(Protocol):
    """A source of scenes for a planner."""

    params: PerceptionParams

    @property
    def contact(self) -> str:
        """Description of a felt contact; empty without one, or without a contact sensor."""
        ...

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Update simulated sensors; called at every control step.

        Args:
            t: time [s].
            coordinates: (nv,) true coordinate row of the robot; for simulated sensors only.
            estimate: (nv,) estimated coordinate row.
        """
        ...

    def known(self) -> Scene:
        """The scene that is known before the first step."""
        ...

    def sense(self, t: float) -> Scene:
        """The newest scene at time ``t`` [s], with the time at which it was sensed.

        Raises:
            PerceptionError: there is no usable scene.
        """
        ...


class NoisyGroundTruth:
    """Workspace: senses the true world with delay and noise.

    Static obstacles are known (a map); position and velocity of moving ones are sensed with a constant error within the
    assumed bounds.

    Args:
        world: the true obstacles.
        assumptions: bounds of the errors.
        params: parameters of the noise.
        rng: source of the noise.
    """

    contact = ""  # there is no contact sensor
    cost: float = 0.0  # [s] of simulated time: nothing is processed

    def __init__(
        self, world: World, assumptions: ObstacleAssumptions, params: PerceptionParams, rng: np.random.Generator
    ) -> None:
        self.world: World = world
        self.params: PerceptionParams = params
        self._position: dict[str, np.ndarray] = {}
        self._velocity: dict[str, np.ndarray] = {}
        for name in world.names_moving:
            for store, size in (
                (self._position, assumptions.position_error),
                (self._velocity, assumptions.velocity_error),
            ):
                error = rng.normal(size=3)
                error[2] = 0.0
                store[name] = error / np.linalg.norm(error) * size * params.noise * rng.uniform()

    def known(self) -> Scene:
        """The true scene at time 0."""
        return self.world.at(0.0)

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Nothing to do: there are no simulated sensors."""

    def sense(self, t: float) -> Scene:
        """The scene one delay before time ``t`` [s]; moving obstacles have noise in pose and velocity."""
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
