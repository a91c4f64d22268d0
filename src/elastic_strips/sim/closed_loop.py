"""Closed loop: a controller, a plant and perception in a simulated world, with a record."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from time import perf_counter, sleep
from typing import Generic, TypeVar, cast

import numpy as np

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.control import DriveParams
from elastic_strips.control.controller import KEPT_EVENTS, Controller, Tick
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.itinerary import Goals, configuration_of, goals_in_order
from elastic_strips.control.record import DriveResult, Recorder
from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import check_able, check_count, check_number, check_type

from .computing import ChargedExecutor, Computing
from .faults import Fault, FaultPlan, FaultyPerception, FaultyPlant, faulty_planning
from .pedestrians import Pedestrians
from .perception import NoisyGroundTruth, Perception, PerceptionError, PerceptionParams
from .plant import STANDING_SPEED, KinematicPlant, Plant, PlantParams
from .sensed_perception import SensorPerception

_log = logging.getLogger(__name__)
MACHINE = PlantParams(speed_margin=1.0, acceleration_margin=1.0)
"""A plant that reaches exactly its limits; motions are planned with less (``DriveParams.speed_scale``)."""
LONGEST_OVERTIME = 30.0
"""Time [s] after the time limit for which a robot that does not come to rest is simulated."""

_STEPS_KEPT = 100  # of a run that is not recorded
_Driver = TypeVar("_Driver", bound=Controller)


class Simulation(Generic[_Driver]):
    """Workspace: advances plant, moving obstacles and sensors, steps the controller, and records the run.

    Obstacles of the world that yield are reset, and this simulation sets their clocks.

    Args:
        controller: the robot's controller.
        world: the true obstacles over time.
        plant: the machine, at the controller's start.
        perception: what the controller senses of the world.
        goal: (nv,) coordinate row of the last goal, for a run that ends before the robot sets out for it.
        watch: called after every planning tick, with this simulation; its exceptions are logged.
        realtime: whether to wait for the wall clock.
        record: whether to record every step; without it a result has a record of the last steps only.
        metadata: plain JSON values to keep with the record.
        computing: cost of the controller's computing, for the result.

    Attributes:
        time: time of the present step [s].
        period: of the control loop [s]; the parameters' own, unless it is set before the first step: the controller
            measures it.
        stays: whether a run goes on when the last goal is reached, for another one may come.
    """

    def __init__(
        self,
        controller: _Driver,
        world: World,
        plant: Plant,
        perception: Perception,
        *,
        goal: Array | None = None,
        watch: Callable[[Simulation[_Driver]], object] | None = None,
        realtime: bool = False,
        record: bool = True,
        metadata: dict[str, object] | None = None,
        computing: Computing | None = None,
    ) -> None:
        check_able("plant", plant, "reset", "step")
        check_able("perception", perception, "observe", "sense")
        check_able("watch", watch)
        self.controller = controller
        self.world: World = world
        self.plant: Plant = plant
        self.perception: Perception = perception
        self.robot: RobotModel = controller.robot
        self.limits: MotionLimits = controller.limits
        self.pedestrians: Pedestrians = Pedestrians(self.robot, world)
        self.watch = watch
        self.realtime: bool = realtime
        self.computing: Computing = computing or Computing()
        self.time: float = 0.0
        self.period: float = controller.params.control_dt
        self.stays: bool = False
        self._goal = goal
        self._new_recorder = lambda: Recorder(self.robot, world, metadata=metadata or {})
        self.recorder: Recorder = self._new_recorder()
        self._recording = record
        attend = getattr(perception, "attend", None)
        if callable(attend):
            attend(controller.ahead)
        self._step = 0
        self._measurement: Measurement | None = None

    @property
    def params(self) -> DriveParams:
        """The controller's parameters."""
        return self.controller.params

    def stop(self) -> None:
        """End the run as soon as the robot has come to rest."""
        self.controller.stop()

    def run(self, *, time_limit: float | None = None) -> DriveResult:
        """Drive until the last goal is reached (unless the run :attr:`stays`), the time is up, or :meth:`stop` was
        called.

        Args:
            time_limit: longest run [s]; ``params.time_limit`` where None.
        """
        params, controller = self.params, self.controller
        limit = params.time_limit if time_limit is None else check_number("time_limit", time_limit, low=0.0, unit="s")
        began, first, over = perf_counter(), self._step, False
        while True:
            t = self.time = self._step * self.period
            if t >= limit and not over:
                over = True
                controller.stop(f"time limit of {limit:g} s")
            command = self._control(t)
            self._advance(t, command)
            self._step += 1
            done = controller.halted or (controller.ended and not self.stays)
            if (done and self._settled()) or t > limit + LONGEST_OVERTIME:
                break
            if self.realtime:
                ahead = began + (self._step - first) * self.period - perf_counter()
                if ahead > 0.0:
                    sleep(ahead)
        if over:
            controller.resume()
        return self._result(perf_counter() - began)

    def _control(self, t: float) -> Command:
        """One step of the controller, on measured and sensed data alone."""
        controller, measurement = self.controller, self._measurement
        if measurement is None and self.perception.contact:  # in contact from the beginning
            joints = self.plant.coordinates[self.robot.space.base_nv :]
            still = np.zeros(len(self.limits.drive_speed))
            measurement = Measurement(t, still, joints, contact=self.perception.contact)
        sensed: Scene | None = None
        trouble = ""
        if controller.plans_next:
            sensed, trouble = sensed_by(self.perception, t)
            controller.sensing_took = float(getattr(self.perception, "cost", 0.0))
        command = controller.step(t, measurement, sensed, trouble=trouble)
        if controller.tick is not None and controller.tick.time == t:
            self._after_tick(controller.tick)
        return command

    def _advance(self, t: float, command: Command) -> None:
        """Record the step, and advance the world by a control period."""
        controller, plant = self.controller, self.plant
        if not self._recording and len(self.recorder) > _STEPS_KEPT:
            self.recorder = self._new_recorder()
        reference = controller.reference
        self.recorder.control(
            t,
            coordinates=plant.coordinates,
            v=plant.v,
            reference=reference.coordinates,
            reference_v=reference.v,
            estimate=controller.estimate,
            drive=command.drive,
            joints=command.joints,
            motors=plant.motors,
            state=int(controller.state),
        )
        self.perception.observe(t, plant.coordinates, controller.estimate)
        self.pedestrians.step(t, plant.coordinates, plant.v)
        self._measurement = None
        try:
            self._measurement = plant.step(command, self.period)
        except Exception as error:  # of a driver: the controller gets no measurement
            _log.exception("the plant's driver failed")
            controller.log("fault", f"driver exception: {type(error).__name__}: {error}")
        contact = self.perception.contact
        if contact and self._measurement is not None:
            self._measurement = replace(self._measurement, contact=contact)

    def _settled(self) -> bool:
        """Whether the robot truly stands; only to end the recording."""
        return bool(np.abs(self.plant.v).max(initial=0.0) < STANDING_SPEED)

    def _after_tick(self, tick: Tick) -> None:
        result = tick.result
        self.recorder.planning(
            tick.time,
            tick_ms=1e3 * tick.seconds,
            phase_ms={k: 1e3 * s for k, s in result.timings.items()} if result else {},
            status=tick.status,
            certified=bool(result and result.report.certified),
            clearance=result.report.node_clearance if result else np.nan,
            horizon_end=tick.horizon_end,
            strip=tick.strip,
            reason=tick.reason,
        )
        seen = getattr(self.perception, "sensed", None)  # of what faults are wrapped about, too
        if self._recording and isinstance(seen, Scene):
            self.recorder.seen(tick.time, seen)
        if self.watch is not None:
            try:
                self.watch(self)
            except Exception:  # a failing viewer does not stop the robot
                _log.exception("the watcher failed")
                self.watch = None
                self.controller.log("fault", "viewer lost")

    def _result(self, seconds: float) -> DriveResult:
        controller = self.controller
        last = controller.goal if self._goal is None or not controller.goals else self._goal
        self.recorder.lead_to(last)
        for event in controller.events:
            self.recorder.event(event.time, event.kind, event.reason)
        return DriveResult(
            record=self.recorder.finish(),
            state=controller.state,
            reason=controller.reason,
            stops=tuple(controller.stops),
            events=tuple(controller.events),
            replans=controller.replans,
            statistics=controller.statistics,
            seconds=seconds,
            compute=self.computing.label,
            goals=tuple(controller.goals_reached),
        )


def sensed_by(perception: Perception, t: float) -> tuple[Scene | None, str]:
    """The scene or readings at time ``t`` [s], or None and why there are none."""
    try:
        return perception.sense(t), ""
    except PerceptionError as error:
        return None, str(error)
    except Exception as error:  # of whoever wrote it: the robot has to come to rest
        _log.exception("sensing failed")
        return None, f"sensing exception: {type(error).__name__}: {error}"


def prepare(
    robot: RobotModel,
    world: World | Scene,
    limits: MotionLimits,
    plant: Plant | None,
    seed: int,
    *,
    shared: bool = False,
) -> tuple[World, Plant, np.random.Generator]:
    """World, plant and random generator of a simulation.

    The world is copied, so that simulations of one world are independent, unless a given perception, or plant with
    contact, refers to it.

    Args:
        robot, limits: robot and limits of the plant that is made where none is given.
        world: the true obstacles.
        plant: the machine, or None.
        seed: seed of plant and perception.
        shared: whether a perception refers to this world.

    Returns:
        The world, the plant, and the random generator of the perception's noise.
    """
    check_able("plant", plant, "reset", "step")
    check_count("seed", seed)
    world = world if isinstance(world, World) else World(world)
    if not shared and (plant is None or isinstance(plant, KinematicPlant)):
        world = world.copied(history=False)
    plant_seed, sense_seed = np.random.SeedSequence(seed).spawn(2)
    machine = plant or KinematicPlant(robot, limits, MACHINE, seed=np.random.default_rng(plant_seed))
    return world, machine, np.random.default_rng(sense_seed)


def simulation(
    robot: RobotModel,
    world: World | Scene,
    start: ArrayLike,
    goal: Goals,
    *,
    limits: MotionLimits | None = None,
    params: DriveParams | None = None,
    plant: Plant | None = None,
    perception: PerceptionParams | Perception | None = None,
    faults: Iterable[Fault] = (),
    seed: int = 0,
    watch: Callable[[Simulation[_Driver]], object] | None = None,
    realtime: bool = False,
    record: bool = True,
    metadata: dict[str, object] | None = None,
    make: Callable[..., _Driver] | None = None,
    compute: str | float = "free",
    **options: object,
) -> Simulation[_Driver]:
    """A controller of the elastic strip in a world, ready to run.

    Args:
        robot: the robot.
        world: the true obstacles over time; those of a :class:`Scene` move by their motions. Obstacles yield in a copy
            of it, ``Simulation.world``, in which the result has to be evaluated.
        start: configuration (nq,).
        goal: as for the :class:`Controller`.
        limits, params, **options: as for the :class:`Controller`.
        plant: the machine; a :class:`KinematicPlant` where None.
        perception: noise and delay of the sensed scene, or a perception of one's own.
        faults: injected faults.
        seed: seed of the first plan, the plant and the perception.
        watch, realtime, record, metadata: as for the :class:`Simulation`.
        make: makes the controller, from the known scene and its other arguments; a :class:`Controller` of ``start``
            and ``goal`` where None.
        compute: what computing costs in simulated time: ``"free"``: nothing, and equal seeds give equal runs; a factor:
            this many times the processor time that it takes here; ``"work"``: the time that is modelled for the work
            that was counted, the same everywhere.

    Raises:
        ConfigurationError: start or goal is not valid, or in collision.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("params", params, DriveParams, none=True)
    check_type("limits", limits, MotionLimits, none=True)
    check_able("watch", watch)
    if not isinstance(perception, PerceptionParams):
        check_able("perception", perception, "known", "sense")
    params, limits = params or DriveParams(), limits or MotionLimits.for_robot(robot)
    computing = Computing.parse(compute)
    workers, meter = ChargedExecutor(computing, lambda: 0.0), None
    if computing.label != "free":
        params, meter = replace(params, replan_time=0.0), computing.reading
    fault_plan = FaultPlan(faults)
    noise = PerceptionParams() if perception is None else perception
    world, machine, rng = prepare(robot, world, limits, plant, seed, shared=not isinstance(noise, PerceptionParams))
    senses: Perception = (
        NoisyGroundTruth(world, params.assumptions, noise, rng) if isinstance(noise, PerceptionParams) else noise
    )
    begin = make or cast("Callable[..., _Driver]", partial(Controller, robot, start, goal))
    controller = begin(
        senses.known(),
        params=params,
        limits=limits,
        seed=seed,
        workers=workers,
        meter=meter,
        events=None if record else KEPT_EVENTS,
        **options,
    )
    if meter is not None:
        controller.warm_up()
    if fault_plan.faults:
        senses = cast("Perception", FaultyPerception(senses, fault_plan, seed))
        machine = cast("Plant", FaultyPlant(machine, fault_plan, seed))
        controller.plan_tick = faulty_planning(controller.plan_tick, fault_plan, params)
    machine.reset(robot.space.to_coordinates(robot.check_q(start, what="start")))
    last_q = configuration_of(robot, goals_in_order(robot, goal)[-1])
    if isinstance(noise, SensorPerception):
        noise.computing = computing
    driven = Simulation(
        controller,
        world,
        machine,
        senses,
        goal=None if last_q is None else robot.space.to_coordinates(last_q),
        watch=watch,
        realtime=realtime,
        record=record,
        metadata=metadata,
        computing=computing,
    )
    workers.clock = lambda: driven.time
    return driven
