"""Base methods in the scenarios of the package, and all steering methods by name."""

from __future__ import annotations

from collections.abc import Callable

from elastic_strips.robot import RobotModel
from elastic_strips.sim.closed_loop import Simulation
from elastic_strips.sim.scenarios import DriveOutcome, Scenario, drive_scenario
from elastic_strips.sim.scenarios.drive import STRIP, DrivenProblem, driven_to_its_end
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import check_choice

from .base_controller import BASE_METHODS, PATIENCE, BaseController, base_simulation

DRIVE_METHODS = (STRIP, *BASE_METHODS)
"""Names of methods: the elastic strip, and the base methods that the paper names."""


def make_base_simulation(
    scenario: Scenario,
    method: str,
    *,
    robot: RobotModel | None = None,
    seed: int | None = None,
    plant: str = "kinematic",
    sensors: SensorConfig | None = None,
    limits: MotionLimits | None = None,
    patience: float = PATIENCE,
    watch: Callable[[Simulation[BaseController]], object] | None = None,
    realtime: bool = False,
) -> Simulation[BaseController]:
    """A closed loop of a base method for a scenario, ready to run.

    Args:
        scenario: the problem.
        method: ``"apf"``, ``"vff"``, ``"vfh"`` or ``"band"``.
        robot: a robot other than the scenario's.
        seed: seed of plant and sensors; the scenario's where None.
        plant: ``"kinematic"``, or ``"mujoco"``.
        sensors: sensors of the method; the Silvermate's where None.
        limits: limits of the robot; those of its description where None.
        patience, watch, realtime: as for :func:`base_simulation`.
    """
    problem = DrivenProblem.of(scenario, robot, seed, plant, limits)
    return base_simulation(
        problem.robot, problem.world, problem.start, problem.goal, method, limits=problem.limits,
        plant=problem.machine, sensors=sensors, seed=problem.seed, metadata=problem.metadata, patience=patience,
        watch=watch, realtime=realtime,
    )  # fmt: skip


def drive_by(
    scenario: Scenario,
    method: str,
    *,
    robot: RobotModel | None = None,
    seed: int | None = None,
    plant: str = "kinematic",
    time_limit: float | None = None,
    **options: object,
) -> DriveOutcome:
    """Drive a scenario by one of `DRIVE_METHODS`; see :func:`~elastic_strips.sim.scenarios.drive_scenario`.

    Args:
        scenario, robot, seed, plant, time_limit: what is driven.
        method: the method that steers.
        **options: as for :func:`~elastic_strips.sim.scenarios.make_simulation` or :func:`make_base_simulation`.
    """
    check_choice("method", method, DRIVE_METHODS)
    if method == STRIP:
        return drive_scenario(scenario, robot=robot, seed=seed, plant=plant, time_limit=time_limit, **options)
    make: Callable[..., Simulation[BaseController]] = make_base_simulation
    driven = make(scenario, method, robot=robot, seed=seed, plant=plant, **options)
    return driven_to_its_end(driven, scenario, plant, seed, time_limit)
