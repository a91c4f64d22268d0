"""Base methods in the scenarios of the package, and all steering methods by name."""

from __future__ import annotations

from collections.abc import Callable

from elastic_strips.control import Controller
from elastic_strips.sim.closed_loop import Simulation
from elastic_strips.sim.scenarios import DriveOutcome, Scenario, drive_scenario
from elastic_strips.sim.scenarios.drive import STRIP, DrivenProblem, DriveSetup, driven_to_its_end
from elastic_strips.validation import check_choice

from .base_controller import BASE_METHODS, BLOCKED_PATIENCE, SCENE_METHODS, base_simulation

DRIVE_METHODS = (STRIP, *BASE_METHODS, *SCENE_METHODS)
"""Names of methods: the elastic strip, the base methods that the paper names, and those that are shown obstacles."""


def make_base_simulation(
    scenario: Scenario,
    method: str,
    setup: DriveSetup | None = None,
    *,
    patience: float = BLOCKED_PATIENCE,
    watch: Callable[[Simulation[Controller]], object] | None = None,
    realtime: bool = False,
    **options: object,
) -> Simulation[Controller]:
    """A closed loop of a base method for a scenario, ready to run.

    Args:
        scenario: the problem.
        method: a name of `DRIVE_METHODS` other than the strip's.
        setup: robot, seed, plant, sensors (the Silvermate's where None) and limits; **options: values of it by name.
        patience, watch, realtime: of :func:`base_simulation`.
    """
    setup = (setup or DriveSetup()).replaced(options)
    problem = DrivenProblem.of(scenario, setup)
    return base_simulation(
        problem.robot,
        problem.world,
        problem.start,
        problem.robot.check_q(problem.goals[-1], what="goal"),  # type: ignore[arg-type]
        method,
        limits=problem.limits,
        plant=problem.machine,
        sensors=setup.sensors,
        seed=problem.seed,
        metadata=problem.metadata,
        patience=patience,
        watch=watch,
        realtime=realtime,
    )


def drive_by(
    scenario: Scenario,
    method: str,
    setup: DriveSetup | None = None,
    *,
    time_limit: float | None = None,
    **options: object,
) -> DriveOutcome:
    """Drive a scenario by one of `DRIVE_METHODS`; see :func:`~elastic_strips.sim.scenarios.drive_scenario`.

    Args:
        scenario, setup, time_limit: of the drive.
        method: what steers.
        **options: of :func:`~elastic_strips.sim.scenarios.make_simulation` or :func:`make_base_simulation`.
    """
    check_choice("method", method, DRIVE_METHODS)
    if method == STRIP:
        return drive_scenario(scenario, setup, time_limit=time_limit, **options)
    make: Callable[..., Simulation[Controller]] = make_base_simulation
    return driven_to_its_end(make(scenario, method, setup, **options), scenario, time_limit)
