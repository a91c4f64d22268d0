"""Drives of scenarios in the closed loop, evaluated from the true states; their document (docs/drive-format.md)."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from time import monotonic, sleep
from typing import TypeVar, cast

import numpy as np

from elastic_strips._version import __version__
from elastic_strips.arrays import Array, Document
from elastic_strips.collision.bounds import Displacement
from elastic_strips.control import Controller, DriveParams, DriveResult, EvasionParams
from elastic_strips.control.control_loop import ControlLoop
from elastic_strips.control.executor_process import ExecutorProcess
from elastic_strips.control.params import DRIVE_STRIP
from elastic_strips.control.replanning import Replanner, SwitchingReplanner
from elastic_strips.errors import RobotError, ScenarioError
from elastic_strips.planning import StripSetParams
from elastic_strips.robot import RobotModel
from elastic_strips.scene import World
from elastic_strips.sim import Perception, PerceptionParams, SensorPerception
from elastic_strips.sim.closed_loop import MACHINE, Simulation, prepare, simulation
from elastic_strips.sim.evaluation import Contact, Evaluation, evaluate, protective_separation
from elastic_strips.sim.evaluation.visibility import unseen_contacts
from elastic_strips.sim.faults import Fault, FaultPlan, FaultyPerception, faulty_planning
from elastic_strips.sim.machine_process import faulty_plant
from elastic_strips.sim.perception import NoisyGroundTruth
from elastic_strips.sim.plant import KinematicPlant, Plant
from elastic_strips.sim.realtime import RealtimeSimulation
from elastic_strips.sim.sensed_perception import LASER_ASSUMPTIONS, LASER_EASE
from elastic_strips.sim.sensors import SensorConfig, SensorSuite
from elastic_strips.strip import OrientationConstraint
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.summary import Summary
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import check_choice, check_count, check_type

from .scenario import Scenario

PLANTS = ("kinematic", "mujoco")
STRIP = "strip"
_Driver = TypeVar("_Driver", bound=ControlLoop)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriveOutcome(Summary):
    """Result of driving a scenario.

    Attributes:
        scenario, robot, plant, seed: what was driven.
        result: result of the loop, with its record.
        evaluation: evaluation of the true states.
        separation: protective separation distance [m] at the robot's largest speed; None for a method without certified
            stops.
        method: the method that steered: `STRIP`, or another method's name.
        sensors: names of the simulated sensors; empty where the scene was known.
        physical_contacts: contacts in a physical plant, without wheels and casters on the floor.
        unseen: touched obstacles that had not been in a laser's view.
        seen_collisions: contacts at speed with obstacles that were in view or known; see `unseen_contacts`.
        constraint_error: largest angle [rad] by which the robot missed the drive's constraint; None without one.
    """

    scenario: Scenario
    robot: RobotModel
    plant: str
    seed: int
    result: DriveResult
    evaluation: Evaluation
    separation: float | None
    method: str = STRIP
    sensors: tuple[str, ...] = ()
    physical_contacts: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    seen_collisions: int = 0
    constraint_error: float | None = None

    def _summary(self) -> dict[str, object]:
        clearance = f"{self.evaluation.min_clearance_m:.3f} m"
        return {
            "scenario": self.scenario.name, "robot": self.robot.name, "plant": self.plant, "method": self.method,
            "reached": self.reached, "collisions": len(self.evaluation.collisions), "least_clearance": clearance,
            "time": f"{self.evaluation.time_s:.1f} s", "stops": len(self.result.stops), "reason": self.result.reason,
        }  # fmt: skip

    @property
    def tracking_error(self) -> float | None:
        """Bound [m] of the largest distance of any point of the robot from its place by the reference; None without
        one."""
        rows = self.result.record.control
        error = float(Displacement(self.robot)(rows.coordinates, rows.reference).max())
        return error if np.isfinite(error) else None

    @property
    def reached(self) -> bool:
        """Whether the robot stands at the goal, by its estimate and in truth."""
        return self.result.reached and bool(self.evaluation.reached)


def make_simulation(
    scenario: Scenario,
    *,
    robot: RobotModel | None = None,
    seed: int | None = None,
    plant: str = "kinematic",
    evade: bool = True,
    sensors: SensorConfig | None = None,
    alternatives: int = 1,
    level: str = "",
    params: DriveParams | None = None,
    limits: MotionLimits | None = None,
    faults: Iterable[Fault] = (),
    perception: PerceptionParams | None = None,
    watch: Callable[[Simulation[Controller]], object] | None = None,
    realtime: bool = False,
    compute: str | float = "free",
) -> Simulation[Controller]:
    """A closed loop of the elastic strip for a scenario, ready to run.

    Args:
        scenario: the problem.
        robot: a robot other than the scenario's.
        seed: seed of plan, plant and noise; the scenario's where None.
        plant: ``"kinematic"``, or ``"mujoco"`` (extra ``sim``).
        evade: whether to leave the strip to avoid moving obstacles, rather than only brake and wait; where
            ``params`` are given, they say so.
        sensors: simulated sensors, from which alone the scene is estimated; a known scene where None.
        alternatives: number of strips on different sides of the obstacles that are deformed in parallel; the robot
            switches to another one where its strip is given up.
        level: a frame of the robot that is to stay as level as it is at the start; none where empty.
        params: parameters of the drive; the defaults with the scenario's parameters of the strip where None.
        limits: limits of the robot; those of its description where None.
        faults: injected faults.
        perception: noise and delay of a known scene.
        watch, realtime, compute: as for :func:`~elastic_strips.sim.simulation`.

    Raises:
        InputError: start or goal in collision, an unknown plant, …
    """
    problem = DrivenProblem.of(scenario, robot, seed, plant, limits)
    params, seen, replanner = _planned_with(problem, scenario, evade, sensors, alternatives, level, params)
    return simulation(
        problem.robot, problem.world, problem.start, problem.goal, params=params, limits=problem.limits,
        plant=problem.machine, perception=perception if seen is None else seen, faults=faults, seed=problem.seed,
        watch=watch, realtime=realtime, metadata=problem.metadata, replanner=replanner, compute=compute,
    )  # fmt: skip


def make_realtime(
    scenario: Scenario,
    *,
    robot: RobotModel | None = None,
    seed: int | None = None,
    evade: bool = True,
    sensors: SensorConfig | None = None,
    alternatives: int = 1,
    level: str = "",
    params: DriveParams | None = None,
    limits: MotionLimits | None = None,
    faults: Iterable[Fault] = (),
    watch: Callable[[RealtimeSimulation], object] | None = None,
    log: str | os.PathLike[str] | None = None,
    eager: bool = False,
) -> RealtimeSimulation:
    """As :func:`make_simulation`, but against the wall clock: machine and executor run in processes of their own.

    Args:
        scenario, robot, seed, evade, sensors, alternatives, level, params, limits, faults: as for
            :func:`make_simulation`.
        watch, eager: as for :class:`~elastic_strips.sim.realtime.RealtimeSimulation`.
        log: file that the executor writes while it drives; a temporary file where None.

    Raises:
        InputError: start or goal in collision, …
    """
    problem = DrivenProblem.of(scenario, robot, seed, "kinematic", limits)
    params, seen, replanner = _planned_with(problem, scenario, evade, sensors, alternatives, level, params)
    model, limits = problem.robot, problem.limits
    world, machine, rng = prepare(model, problem.world, limits, None, problem.seed, shared=seen is not None)
    senses: Perception = NoisyGroundTruth(world, params.assumptions, PerceptionParams(), rng) if seen is None else seen
    make: Callable[[], Plant] = partial(KinematicPlant, model, limits, MACHINE, seed=problem.seed)
    plan = FaultPlan(faults)
    if plan.faults:
        make = partial(faulty_plant, make, plan, problem.seed)
        senses = cast("Perception", FaultyPerception(senses, plan))
    params = replace(params, replan_time=0.0)
    temporary = log is None
    if log is None:
        number, log = tempfile.mkstemp(prefix="elastic-strips-", suffix=".jsonl")
        os.close(number)
    executor = ExecutorProcess(model, problem.start, problem.goal, params=params, limits=limits, log=log)
    controller = Controller(
        model, problem.start, problem.goal, senses.known(), params=params, limits=limits, replanner=replanner,
        seed=problem.seed, executor=executor, meter=monotonic,
    )  # fmt: skip
    machine.reset(model.space.to_coordinates(problem.start))
    if plan.faults:
        slow = 10.0 * params.latency * params.control_dt
        controller.plan_tick = faulty_planning(controller.plan_tick, plan, slow=slow, wait=sleep)
    return RealtimeSimulation(
        controller, executor, world, make, machine, senses, goal=controller.goal, watch=watch,
        metadata=problem.metadata, log=log, temporary=temporary, eager=eager,
    )  # fmt: skip


def drive_params(scenario: Scenario, *, evade: bool = True, sensors: SensorConfig | None = None) -> DriveParams:
    """The parameters that a scenario is driven with, unless others are given.

    Args:
        scenario: the problem, with its own parameters of the strip.
        evade: whether to leave the strip to avoid moving obstacles.
        sensors: the robot's sensors; a known scene where None.
    """
    deform = DRIVE_STRIP.replaced(**scenario.params.get("default", {}))
    params = DriveParams(deform=deform, evasion=EvasionParams() if evade else None)
    if sensors is not None:
        params = replace(params, assumptions=LASER_ASSUMPTIONS, speed_scale=LASER_EASE, backward=sensors.all_round)
    return params


def _planned_with(
    problem: DrivenProblem,
    scenario: Scenario,
    evade: bool,
    sensors: SensorConfig | None,
    alternatives: int,
    level: str,
    params: DriveParams | None,
) -> tuple[DriveParams, Perception | None, Replanner | None]:
    """Parameters, the perception where sensors are given, and the replanner where it is not the usual one."""
    check_type("params", params, DriveParams, none=True)
    check_type("sensors", sensors, SensorConfig, none=True)
    check_count("alternatives", alternatives, low=1)
    if params is None:
        params = drive_params(scenario, evade=evade, sensors=sensors)
    if level:
        constraint = OrientationConstraint.from_configuration(problem.robot, problem.start, level)
        params = replace(params, constraint=constraint)
    seen = None
    if sensors is not None:
        seen = SensorPerception(problem.robot, problem.world, problem.start, sensors=sensors, seed=problem.seed)
    replanner = None
    if alternatives > 1:
        family = StripSetParams(count=alternatives, backward=params.backward)
        replanner = SwitchingReplanner(problem.robot, params, seed=problem.seed, grid=True, family=family)
    return params, seen, replanner


@dataclass(frozen=True, slots=True, eq=False)
class DrivenProblem:
    """A scenario with all parts of a closed loop."""

    robot: RobotModel
    world: World
    start: Array
    goal: Array
    limits: MotionLimits
    machine: Plant
    seed: int
    metadata: dict[str, object]

    @classmethod
    def of(
        cls, scenario: Scenario, robot: RobotModel | None, seed: int | None, plant: str, limits: MotionLimits | None
    ) -> DrivenProblem:
        check_type("scenario", scenario, Scenario, ScenarioError)
        check_type("robot", robot, RobotModel, RobotError, none=True)
        check_type("limits", limits, MotionLimits, none=True)
        check_choice("plant", plant, PLANTS)
        if seed is not None:
            check_count("seed", seed)
        robot = scenario.load_robot(preset="default") if robot is None else robot
        seed = scenario.seed if seed is None else seed
        limits, world = MotionLimits.for_robot(robot) if limits is None else limits, scenario.world
        machine: Plant
        if plant == "mujoco":
            from elastic_strips.sim.mujoco.plant import MujocoPlant

            machine = MujocoPlant(robot, limits, world, seed=seed)
        else:
            machine = KinematicPlant(robot, limits, MACHINE, seed=seed)
        metadata: dict[str, object] = {"scenario": scenario.name, "seed": seed, "plant": plant}
        return cls(robot, world, *scenario.ends(robot), limits, machine, seed, metadata)


def conclude(
    scenario: Scenario, driven: Simulation[_Driver], result: DriveResult, *, plant: str, seed: int
) -> DriveOutcome:
    """Evaluate the finished run of a simulation, with the name of its plant and its seed."""
    controller, perception = driven.controller, driven.perception
    evaluation = evaluate(result.record, driven.robot, driven.world, driven.limits, tolerance=controller.tolerance)
    suite: SensorSuite | None = getattr(perception, "suite", None)
    separation = None
    if isinstance(controller, Controller):
        separation = protective_separation(driven.limits, driven.params, cast("Perception", perception).params)
    touched = tuple(str(event) for event in getattr(driven.plant, "contact_events", ()))
    unseen: tuple[Contact, ...] = ()
    if suite is not None:
        unseen = unseen_contacts(result.record, evaluation, driven.robot, driven.world, suite.config)
    return DriveOutcome(
        scenario, driven.robot, plant, seed, result, evaluation, separation, method=controller.method,
        physical_contacts=touched, sensors=() if suite is None else suite.config.names,
        unseen=tuple(dict.fromkeys(contact.obstacle for contact in unseen)),
        seen_collisions=sum(contact not in unseen for contact in evaluation.collisions),
        constraint_error=_missed(driven, result),
    )  # fmt: skip


def _missed(driven: Simulation[_Driver], result: DriveResult) -> float | None:
    """Largest angle [rad] by which the true robot missed the drive's constraint."""
    constraint = getattr(driven.params, "constraint", None)
    if constraint is None:
        return None
    return float(ConstraintForce(driven.robot, constraint).errors_at(result.record.control.coordinates).max())


def drive_scenario(
    scenario: Scenario,
    *,
    robot: RobotModel | None = None,
    seed: int | None = None,
    plant: str = "kinematic",
    time_limit: float | None = None,
    **options: object,
) -> DriveOutcome:
    """Drive a scenario from start to goal, and evaluate it.

    Args:
        scenario: the problem.
        robot, seed, plant, **options: as in :func:`make_simulation`.
        time_limit: longest run [s of simulated time].
    """
    check_type("scenario", scenario, Scenario, ScenarioError)
    make = cast("Callable[..., Simulation[Controller]]", make_simulation)
    driven = make(scenario, robot=robot, seed=seed, plant=plant, **options)
    return driven_to_its_end(driven, scenario, plant, seed, time_limit)


def driven_to_its_end(
    driven: Simulation[_Driver], scenario: Scenario, plant: str, seed: int | None, time_limit: float | None
) -> DriveOutcome:
    """Run a simulation of a scenario, and evaluate it; see :func:`drive_scenario`."""
    try:
        result = driven.run(time_limit=time_limit)
    finally:
        driven.plant.close()
    return conclude(scenario, driven, result, plant=plant, seed=scenario.seed if seed is None else seed)


DRIVE_FORMAT = "elastic-strips-drive"
DRIVE_FORMAT_VERSION = 1


def drive_document(outcome: DriveOutcome) -> Document:
    """A drive as plain values, ready for JSON. Lengths in metres, angles in radians, times in seconds."""
    check_type("outcome", outcome, DriveOutcome)
    result, evaluation = outcome.result, outcome.evaluation
    figures = evaluation.as_dict()
    return {
        "format": DRIVE_FORMAT,
        "version": DRIVE_FORMAT_VERSION,
        "elastic_strips": __version__,
        "scenario": outcome.scenario.name,
        "robot": outcome.robot.name,
        "plant": outcome.plant,
        "method": outcome.method,
        "sensors": list(outcome.sensors),
        "seed": outcome.seed,
        "compute": result.compute,
        "state": result.state.label,
        "reason": result.reason,
        "reached": outcome.reached,
        "collisions": len(evaluation.collisions),
        "contacts": figures["collisions"],
        "unseen_contacts": list(outcome.unseen),
        "contacts_at_rest": figures["rest_contacts"],
        "physical_contacts": list(outcome.physical_contacts),
        "min_clearance_m": figures["min_clearance_m"],
        "time_s": evaluation.time_s,
        "path_m": evaluation.path_m,
        "stops": [{"time_s": time, "reason": reason} for time, reason in result.stops],
        "replans": result.replans,
        "tick_ms": {k: _number(v) for k, v in result.statistics.percentiles().items()},
        "ticks": len(result.statistics.seconds),
        "deadline_misses": result.statistics.misses,
        "max_lateral_slip": evaluation.max_lateral_slip_m,
        "limit_excess": figures["excess"],
        "max_tracking_error_m": outcome.tracking_error,
        "max_constraint_error_rad": outcome.constraint_error,
        "protective_separation_m": outcome.separation,
        "events": [{"time_s": e.time, "kind": e.kind, "reason": e.reason} for e in result.events],
        "wall_s": result.seconds,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
