"""Drives of scenarios in the closed loop, evaluated from the true states; their document (docs/drive-format.md)."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from functools import partial
from time import monotonic, sleep
from typing import cast

import numpy as np

from elastic_strips._version import __version__
from elastic_strips.arrays import Array, Document
from elastic_strips.collision.bounds import Displacement
from elastic_strips.control import Controller, DriveParams, DriveResult, EvasionParams
from elastic_strips.control.itinerary import configurations
from elastic_strips.control.params import DRIVE_STRIP
from elastic_strips.control.process.executor_process import ExecutorProcess
from elastic_strips.control.replanning import Replanner, SwitchingReplanner
from elastic_strips.errors import ParameterError, RobotError, ScenarioError, nearest_name
from elastic_strips.planning import Goal, StripSetParams
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.sim import Perception, PerceptionParams, SensorPerception
from elastic_strips.sim.closed_loop import MACHINE, Simulation, prepare, simulation
from elastic_strips.sim.evaluation import Contact, Evaluation, evaluate, protective_separation
from elastic_strips.sim.evaluation.visibility import unseen_contacts
from elastic_strips.sim.faults import Fault, FaultPlan, FaultyPerception, faulty_planning
from elastic_strips.sim.machine_process import faulty_plant
from elastic_strips.sim.perception import NoisyGroundTruth
from elastic_strips.sim.plant import KinematicPlant, Plant
from elastic_strips.sim.realtime import RealtimeSimulation
from elastic_strips.sim.sensed_perception import sensing_params
from elastic_strips.sim.sensing_process import SENSING_TIME, SensedWorld, SensingProcess
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.strip import LookAt, OrientationConstraint
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.summary import Summary
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import check_choice, check_count, check_type

from .scenario import Scenario

PLANTS = ("kinematic", "mujoco")
STRIP = "strip"


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
            "scenario": self.scenario.name,
            "robot": self.robot.name,
            "plant": self.plant,
            "method": self.method,
            "reached": self.reached,
            "collisions": len(self.evaluation.collisions),
            "least_clearance": clearance,
            "time": f"{self.evaluation.time_s:.1f} s",
            "stops": len(self.result.stops),
            "reason": self.result.reason,
        }

    @property
    def tracking_error(self) -> float | None:
        """Bound [m] of the largest distance of any point of the robot from its place by the reference; None without
        one."""
        rows = self.result.record.control
        if not np.isfinite(rows.reference).all():
            return None
        return float(Displacement(self.robot)(rows.coordinates, rows.reference).max())

    @property
    def reached(self) -> bool:
        """Whether the robot stands at the goal, by its estimate and in truth."""
        return self.result.reached and bool(self.evaluation.reached)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriveSetup:
    """How a scenario is driven.

    Attributes:
        robot: another robot than the scenario's.
        seed: of plan, plant and noise; the scenario's where None.
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
        compute: what computing costs; see :func:`~elastic_strips.sim.simulation`.
        goals: goals in place of the scenario's, one after the other.
        goal_within: how near counts as reached: base [m], and heading and joints [rad or m]; as ``params`` say where
            None.

    Raises:
        InputError: a value of another type, an unknown plant, a negative seed.
    """

    robot: RobotModel | None = None
    seed: int | None = None
    plant: str = "kinematic"
    evade: bool = True
    sensors: SensorConfig | None = None
    alternatives: int = 1
    level: str = ""
    params: DriveParams | None = None
    limits: MotionLimits | None = None
    faults: Iterable[Fault] = ()
    perception: PerceptionParams | None = None
    compute: str | float = "free"
    goals: Sequence[Goal] = ()
    goal_within: float | None = None

    def __post_init__(self) -> None:
        check_type("robot", self.robot, RobotModel, RobotError, none=True)
        check_type("limits", self.limits, MotionLimits, none=True)
        check_choice("plant", self.plant, PLANTS)
        if self.seed is not None:
            check_count("seed", self.seed)
        check_type("params", self.params, DriveParams, none=True)
        check_type("sensors", self.sensors, SensorConfig, none=True)
        check_count("alternatives", self.alternatives, low=1)

    def replaced(self, options: Mapping[str, object]) -> DriveSetup:
        """A copy with some values replaced.

        Raises:
            ParameterError: a name that no value has.
        """
        valid = {f.name for f in fields(self)}
        for name in options:
            if name not in valid:
                raise ParameterError(f"unknown option of a drive: {name!r}{nearest_name(name, valid)}")
        return replace(self, **options)


def make_simulation(
    scenario: Scenario,
    setup: DriveSetup | None = None,
    *,
    watch: Callable[[Simulation[Controller]], object] | None = None,
    realtime: bool = False,
    **options: object,
) -> Simulation[Controller]:
    """A closed loop of the elastic strip for a scenario, ready to run.

    Args:
        scenario: the problem.
        setup: how it is driven; **options: values of it by name.
        watch, realtime: of :func:`~elastic_strips.sim.simulation`.

    Raises:
        InputError: start or goal in collision, an unknown plant, …
    """
    setup = (setup or DriveSetup()).replaced(options)
    problem = DrivenProblem.of(scenario, setup)
    params, seen = problem.params, problem.seen()
    return simulation(
        problem.robot,
        problem.world,
        problem.start,
        problem.goals,
        params=params,
        limits=problem.limits,
        plant=problem.machine,
        perception=setup.perception if seen is None else seen,
        faults=setup.faults,
        seed=problem.seed,
        watch=watch,
        realtime=realtime,
        metadata=problem.metadata,
        replanner=problem.replanner(),
        compute=setup.compute,
    )


def make_realtime(
    scenario: Scenario,
    setup: DriveSetup | None = None,
    *,
    watch: Callable[[RealtimeSimulation], object] | None = None,
    log: str | os.PathLike[str] | None = None,
    eager: bool = False,
    **options: object,
) -> RealtimeSimulation:
    """As :func:`make_simulation`, but by the wall clock: machine, executor and sensors run in processes of their own.

    Args:
        scenario: the problem.
        setup: how it is driven, with the kinematic plant, a known scene as it is, and computing that takes what it
            takes; **options: values of it by name.
        watch, eager: of :class:`~elastic_strips.sim.realtime.RealtimeSimulation`.
        log: file that the executor writes while it drives; a temporary one where None.

    Raises:
        InputError: start or goal in collision, a plant, perception or cost of computing of its own, …
    """
    setup = (setup or DriveSetup()).replaced(options)
    for name in ("plant", "perception", "compute"):
        if (given := getattr(setup, name)) != getattr(DriveSetup(), name):
            raise ParameterError(f"{name}={given!r}: a drive against the wall clock has none of its own; leave it out")
    problem = DrivenProblem.of(scenario, setup)
    params, replanner = problem.params, problem.replanner()
    model, limits, seed = problem.robot, problem.limits, problem.seed
    world, machine, rng = prepare(model, problem.world, limits, None, seed)
    make: Callable[[], Plant] = partial(KinematicPlant, model, limits, MACHINE, seed=seed)
    plan = FaultPlan(setup.faults)
    senses: Perception
    if setup.sensors is not None:
        senses = SensingProcess(SensedWorld(model, world, problem.start, setup.sensors, seed, plan))
    else:
        senses = NoisyGroundTruth(world, params.assumptions, PerceptionParams(), rng)
        if plan.faults:
            senses = cast("Perception", FaultyPerception(senses, plan, seed))
    if plan.faults:
        make = partial(faulty_plant, make, plan, seed)
    age = params.max_scene_age if setup.sensors is None else params.max_scene_age + SENSING_TIME
    params = replace(params, replan_time=0.0, max_scene_age=age)
    temporary = log is None
    with ExitStack() as begun:  # what is to be ended where the rest cannot be made
        if isinstance(senses, SensingProcess):
            begun.callback(senses.close)
        if log is None:
            number, log = tempfile.mkstemp(prefix="elastic-strips-", suffix=".jsonl")
            os.close(number)
            begun.callback(os.unlink, log)
        goals = configurations(model, senses.known() or Scene([]), problem.start, problem.goals)
        executor = ExecutorProcess(model, problem.start, goals[0], params=params, limits=limits, log=log)
        controller = Controller(
            model,
            problem.start,
            goals,
            senses.known(),
            params=params,
            limits=limits,
            replanner=replanner,
            seed=seed,
            executor=executor,
            meter=monotonic,
        )
        machine.reset(model.space.to_coordinates(problem.start))
        if plan.faults:
            controller.plan_tick = faulty_planning(controller.plan_tick, plan, params, wait=sleep)
        driven = RealtimeSimulation(
            controller,
            executor,
            world,
            make,
            machine,
            senses,
            goal=controller.goal,
            watch=watch,
            metadata=problem.metadata,
            log=log,
            temporary=temporary,
            eager=eager,
        )
        begun.pop_all()
    return driven


def drive_params(
    scenario: Scenario, *, evade: bool = True, sensors: SensorConfig | None = None, robot: RobotModel | None = None
) -> DriveParams:
    """The parameters that a scenario is driven with, unless others are given.

    Args:
        scenario: the problem, with its own parameters of the strip.
        evade: whether to leave the strip to avoid moving obstacles.
        sensors: the robot's sensors; a known scene where None.
        robot: the robot that has them; the scenario's where None.
    """
    deform = DRIVE_STRIP.replaced(**scenario.params.get("default", {}))
    params = DriveParams(deform=deform, evasion=EvasionParams() if evade else None)
    if sensors is not None:
        params = sensing_params(params, robot or scenario.load_robot(preset="default"), sensors)
    return params


@dataclass(frozen=True, slots=True, eq=False)
class DrivenProblem:
    """A scenario with all parts of a closed loop."""

    setup: DriveSetup
    robot: RobotModel
    world: World
    start: Array
    goals: list[Goal]
    limits: MotionLimits
    machine: Plant
    seed: int
    params: DriveParams
    metadata: dict[str, object]

    @classmethod
    def of(cls, scenario: Scenario, setup: DriveSetup) -> DrivenProblem:
        check_type("scenario", scenario, Scenario, ScenarioError)
        robot = scenario.load_robot(preset="default") if setup.robot is None else setup.robot
        seed = scenario.seed if setup.seed is None else setup.seed
        limits = MotionLimits.for_robot(robot) if setup.limits is None else setup.limits
        machine: Plant
        if setup.plant == "mujoco":
            from elastic_strips.sim.mujoco.plant import MujocoPlant

            machine = MujocoPlant(robot, limits, scenario.world, seed=seed)
        else:
            machine = KinematicPlant(robot, limits, MACHINE, seed=seed)
        start = scenario.start_of(robot)
        goals = list(setup.goals) or scenario.goals(robot)
        params = setup.params or drive_params(scenario, evade=setup.evade, sensors=setup.sensors, robot=robot)
        if setup.level:
            params = replace(params, constraint=OrientationConstraint.from_configuration(robot, start, setup.level))
        if setup.goal_within is not None:
            params = replace(params, goal_position=setup.goal_within, goal_angle=setup.goal_within)
        metadata: dict[str, object] = {"scenario": scenario.name, "seed": seed, "plant": setup.plant}
        return cls(setup, robot, scenario.world, start, goals, limits, machine, seed, params, metadata)

    def seen(self) -> Perception | None:
        """The perception where sensors are given."""
        sensors = self.setup.sensors
        if sensors is None:
            return None
        return SensorPerception(self.robot, self.world, self.start, sensors=sensors, seed=self.seed)

    def replanner(self) -> Replanner | None:
        """The replanner where it is not the usual one."""
        if self.setup.alternatives == 1:
            return None
        family = StripSetParams(count=self.setup.alternatives, backward=self.params.backward)
        return SwitchingReplanner(self.robot, self.params, seed=self.seed, grid=True, family=family)


def conclude(scenario: Scenario, driven: Simulation[Controller], result: DriveResult) -> DriveOutcome:
    """Evaluate the finished run of a simulation of a scenario; plant, seed and method are those of its record."""
    perception, tolerance = driven.perception, driven.controller.tolerance
    evaluation = evaluate(result.record, driven.robot, driven.world, driven.limits, tolerance=tolerance)
    sensors: SensorConfig | None = getattr(perception, "sensors", None)
    about = result.record.metadata
    method, separation = str(about.get("method", STRIP)), None
    plant, seed = str(about.get("plant", PLANTS[0])), int(str(about.get("seed", scenario.seed)))
    if method == STRIP:
        separation = protective_separation(driven.limits, driven.params, perception.params)
    touched = tuple(str(event) for event in getattr(driven.plant, "contact_events", ()))
    unseen: tuple[Contact, ...] = ()
    if sensors is not None:
        glass = getattr(perception, "glass", None)
        unseen = unseen_contacts(result.record, evaluation, driven.robot, driven.world, sensors, glass=glass)
    return DriveOutcome(
        scenario,
        driven.robot,
        plant,
        seed,
        result,
        evaluation,
        separation,
        method=method,
        physical_contacts=touched,
        sensors=() if sensors is None else sensors.names,
        unseen=tuple(dict.fromkeys(contact.obstacle for contact in unseen)),
        seen_collisions=sum(contact not in unseen for contact in evaluation.collisions),
        constraint_error=_missed(driven, result),
    )


def _missed(driven: Simulation[Controller], result: DriveResult) -> float | None:
    """Largest angle [rad] by which the true robot missed the drive's constraint, by where obstacles truly were."""
    constraint = getattr(driven.params, "constraint", None)
    if constraint is None:
        return None
    control, force = result.record.control, ConstraintForce(driven.robot, constraint)
    if not (isinstance(constraint, LookAt) and isinstance(constraint.at, str)):
        return float(force.errors_at(control.coordinates).max())
    rows, places = [], []
    for row, t in zip(control.coordinates, control.time, strict=True):
        there = driven.world.at(float(t))
        if constraint.at in there:  # what is not in the world then, nobody can look at
            rows.append(row)
            places.append(there.obstacle(constraint.at).pose[:3, 3])
    return float(force.errors_at(np.array(rows), np.array(places)).max()) if rows else None


def drive_scenario(
    scenario: Scenario, setup: DriveSetup | None = None, *, time_limit: float | None = None, **options: object
) -> DriveOutcome:
    """Drive a scenario from start to goal, and evaluate it.

    Args:
        scenario: the problem.
        setup: how it is driven.
        time_limit: longest run [s of simulated time].
        **options: values of the setup by name, and others of :func:`make_simulation`.
    """
    check_type("scenario", scenario, Scenario, ScenarioError)
    make = cast("Callable[..., Simulation[Controller]]", make_simulation)
    return driven_to_its_end(make(scenario, setup, **options), scenario, time_limit)


def driven_to_its_end(driven: Simulation[Controller], scenario: Scenario, time_limit: float | None) -> DriveOutcome:
    """Run a simulation of a scenario, and evaluate it; see :func:`drive_scenario`."""
    try:
        result = driven.run(time_limit=time_limit)
    finally:
        driven.plant.close()
    return conclude(scenario, driven, result)


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
        "goals": [
            {
                "time_s": goal.time,
                "passed": goal.passed,
                "position_m": goal.position,
                "yaw_rad": goal.yaw,
                "joints": goal.joints,
                "hand": goal.frame,
                "hand_m": goal.hand,
            }
            for goal in result.goals
        ],
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
