"""Sim room, base: a base method in a world, on what its simulated sensors read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.execution import MotionLimits
from elastic_strips.perception import Reading
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.validation import check_able, check_count

from ..closed_loop import MACHINE, Simulation
from ..pedestrians import Bystanders
from ..plant import KinematicPlant, Plant
from ..sensed_perception import Bumper
from ..sensors import SensorConfig, SensorSuite
from .base_controller import BaseController


class RawReadings:
    """Workspace: what a robot's simulated sensors read, as it is; and whether the robot touches something.

    Args:
        robot: with the sensors' frames.
        world: that the sensors see.
        plant: where the robot truly is.
        sensors: what they are like; the Silvermate's where None.
        seed: of their noise.

    Raises:
        RobotError: the robot has not the frames that the sensors sit on.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World,
        plant: Plant,
        sensors: SensorConfig | None = None,
        *,
        seed: int | np.random.Generator = 0,
    ) -> None:
        self.suite = SensorSuite(robot, world, sensors, seed=seed)
        self._world, self._plant, self._bumper = world, plant, Bumper(robot)

    @property
    def contact(self) -> str:
        """The obstacle that is touched."""
        return self._bumper.touched(self._world.at(self._plant.time), self._plant.chart)

    def observe(self, t: float, chart: Array, estimate: Array) -> None:
        """Nothing: what is read is handed over as soon as it comes."""

    def sense(self, t: float) -> Sequence[Reading]:
        """Readings that have come by the time ``t`` [s]."""
        return self.suite.observe(t, self._plant.chart)


def base_simulation(
    robot: RobotModel,
    world: World | Scene,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    method: str,
    *,
    limits: MotionLimits | None = None,
    sensors: SensorConfig | None = None,
    plant: Plant | None = None,
    seed: int = 0,
    watch: Callable[[Any], object] | None = None,
    realtime: bool = False,
    metadata: dict[str, object] | None = None,
    **options: Any,
) -> Simulation[BaseController]:
    """A method for a base alone in a world, ready to run; as :func:`~elastic_strips.sim.simulation`.

    Args:
        robot, start, goal, method, limits, **options: of the :class:`BaseController`.
        world: the true obstacles over time.
        sensors: what the sensors are like.
        plant: the machine; a :class:`KinematicPlant` where None.
        seed: of the machine and the sensors.
        watch, realtime, metadata: of the :class:`~elastic_strips.sim.Simulation`.
    """
    check_able("plant", plant, "reset", "step")
    check_able("watch", watch)
    check_count("seed", seed)
    controller = BaseController(robot, start, goal, method, limits=limits, **options)
    world = world if isinstance(world, World) else World(world)
    plant_seed, sense_seed = np.random.SeedSequence(seed).spawn(2)
    machine = plant or KinematicPlant(robot, controller.limits, MACHINE, seed=np.random.default_rng(plant_seed))
    machine.reset(controller.estimate)
    Bystanders(robot, world)  # whoever has a clock of their own begins anew
    senses = RawReadings(robot, world, machine, sensors, seed=np.random.default_rng(sense_seed))
    return Simulation(
        controller, world, machine, senses, watch=watch, realtime=realtime,
        metadata={"method": method, **(metadata or {})},
    )  # fmt: skip
