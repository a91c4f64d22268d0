"""Driving a scenario: the closed loop, judged from the true states."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..deform import DeformParams
from ..errors import ParameterError, nearest_name
from ..execution import (
    DRIVE_STRIP,
    MACHINE,
    DriveParams,
    DriveResult,
    EvasionParams,
    Fault,
    KinematicPlant,
    MotionLimits,
    Plant,
    Runner,
    Tolerance,
    Verdict,
    judge,
    protective_separation,
)
from ..robot import RobotModel
from .scenario import Scenario

PLANTS = ("kinematic", "mujoco")


@dataclass(frozen=True, slots=True, eq=False)
class DriveOutcome:
    """What driving a scenario came to.

    Attributes:
        scenario, robot, plant, seed: what was driven.
        result: of the loop, with its record.
        verdict: of the judge, who knows the true states.
        separation: protective separation distance [m] at the robot's largest speed.
        physical_contacts: what a physical plant saw the robot touch, wheels and casters on the floor aside.
    """

    scenario: Scenario
    robot: RobotModel
    plant: str
    seed: int
    result: DriveResult
    verdict: Verdict
    separation: float
    physical_contacts: tuple[str, ...] = ()

    @property
    def reached(self) -> bool:
        """Whether the robot stands at the goal, by its own account and in truth."""
        return self.result.reached and bool(self.verdict.reached)


def make_runner(
    scenario: Scenario,
    *,
    robot: RobotModel | None = None,
    seed: int | None = None,
    plant: str = "kinematic",
    evade: bool = False,
    params: DriveParams | None = None,
    faults: Iterable[Fault] = (),
    **options: Any,
) -> Runner:
    """A closed loop for a scenario, ready to run.

    Args:
        scenario: the problem.
        robot: another robot than the scenario's.
        seed: of plan, plant and noise; the scenario's where None.
        plant: ``"kinematic"``, or ``"mujoco"`` (extra ``sim``).
        evade: whether to leave the strip where something comes, rather than only to brake and wait.
        params: of the drive; the scenario's parameters of the strip are put into the default ones where None.
        faults: what goes wrong on purpose.
        **options: of :class:`~elastic_strips.execution.Runner`.

    Raises:
        InputError: start or goal in collision, an unknown plant, …
    """
    if plant not in PLANTS:
        raise ParameterError(f"plant={plant!r} is unknown{nearest_name(plant, PLANTS)}")
    robot = scenario.load_robot(preset="default") if robot is None else robot
    seed = scenario.seed if seed is None else seed
    if params is None:
        values = {**DRIVE_STRIP, **scenario.params.get("default", {})}
        deform = DeformParams.for_preset("default", **values)
        params = DriveParams(deform=deform, evasion=EvasionParams() if evade else None)
    limits = MotionLimits.for_robot(robot)
    world = scenario.world
    machine: Plant
    if plant == "mujoco":
        from ..execution.mujoco_plant import MujocoPlant

        machine = MujocoPlant(robot, limits, world, seed=seed)
    else:
        machine = KinematicPlant(robot, limits, MACHINE, seed=seed)
    start, goal = scenario.ends(robot)
    metadata = {"scenario": scenario.name, "seed": seed, "plant": plant}
    return Runner(
        robot, world, start, goal, params=params, limits=limits, plant=machine, faults=faults, seed=seed,
        metadata=metadata, **options,
    )  # fmt: skip


def conclude(scenario: Scenario, runner: Runner, result: DriveResult, *, plant: str, seed: int) -> DriveOutcome:
    """Judge a run."""
    params = runner.params
    verdict = judge(
        result.record, runner.robot, runner.world, runner.limits,
        tolerance=Tolerance(position=params.goal_position, yaw=params.goal_angle, joints=params.goal_angle),
    )  # fmt: skip
    separation = protective_separation(runner.limits, params, runner.perception.params)
    touched = tuple(str(event) for event in getattr(runner.plant, "contact_events", ()))
    return DriveOutcome(scenario, runner.robot, plant, seed, result, verdict, separation, touched)


def drive_scenario(
    scenario: Scenario,
    *,
    robot: RobotModel | None = None,
    seed: int | None = None,
    plant: str = "kinematic",
    time_limit: float | None = None,
    **options: Any,
) -> DriveOutcome:
    """Drive a scenario from start to goal, and judge it; arguments as in :func:`make_runner`."""
    seed = scenario.seed if seed is None else seed
    runner = make_runner(scenario, robot=robot, seed=seed, plant=plant, **options)
    try:
        result = runner.run(time_limit=time_limit)
    finally:
        runner.plant.close()
    return conclude(scenario, runner, result, plant=plant, seed=seed)
