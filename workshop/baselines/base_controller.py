"""Base methods by name, a controller that uses one of them, and its simulation, on sensor readings alone, or shown the
obstacles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from types import MappingProxyType
from typing import cast

import numpy as np

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.control.controller import Controller, Tick
from elastic_strips.control.estimation import PoseBuffer, StateEstimator
from elastic_strips.control.interfaces import Command, Event, GoalReached, Measurement, RunState
from elastic_strips.control.params import DriveParams, ObstacleAssumptions, Tolerance
from elastic_strips.control.record import TickStatistics
from elastic_strips.control.supervisor import RunLog
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError, nearest_name
from elastic_strips.perception import LaserScan, RangeRing, Reading
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.sim.closed_loop import Simulation, prepare
from elastic_strips.sim.perception import NoisyGroundTruth, Perception, PerceptionParams
from elastic_strips.sim.plant import Plant
from elastic_strips.sim.sensed_perception import ContactSensor
from elastic_strips.sim.sensors import SensorConfig, SensorSuite
from elastic_strips.strip import Strip
from elastic_strips.trajectory import MotionLimits, ReferenceState
from elastic_strips.validation import check_able, check_type

from .base_method import BaseCommand, BaseLimits, BaseMethod
from .dynamic_window import DynamicWindow, DynamicWindowParams
from .elastic_band import ElasticBand, SensedPath
from .force_fields import PotentialField, VirtualForceField
from .histogram import VectorFieldHistogram
from .reciprocal import ReciprocalAvoidance
from .scene_method import SceneMethod


def _band(limits: BaseLimits) -> BaseMethod:
    return ElasticBand(limits, planner=SensedPath(limits.radius))


BASE_METHODS: Mapping[str, Callable[[BaseLimits], BaseMethod]] = MappingProxyType(
    {"apf": PotentialField, "vff": VirtualForceField, "vfh": VectorFieldHistogram, "band": _band}
)
"""Name → factory of the method with its default parameters; the band's planner uses sensed points alone."""


def _predicting(limits: BaseLimits) -> SceneMethod:
    return DynamicWindow(limits, DynamicWindowParams(predicts=True))


SCENE_METHODS: Mapping[str, Callable[[BaseLimits], SceneMethod]] = MappingProxyType(
    {"orca": ReciprocalAvoidance, "dwa": DynamicWindow, "dwa-predicting": _predicting}
)
"""Name → factory of a method that is shown the obstacles as they are, with its default parameters; ``dwa`` takes all to
stand where they are now, as published, ``dwa-predicting`` takes what moves to go on as it does."""


def make_base_method(name: str, limits: BaseLimits) -> BaseMethod:
    """A base method by its name, with its default parameters.

    Raises:
        ParameterError: no such method.
    """
    if name not in BASE_METHODS:
        raise ParameterError(f"base method {name!r} is unknown{nearest_name(name, BASE_METHODS)}")
    return BASE_METHODS[name](limits)


def make_scene_method(name: str, limits: BaseLimits) -> SceneMethod:
    """A method that is shown obstacles, by its name, with its default parameters.

    Raises:
        ParameterError: no such method.
        MissingExtraError: it needs a package that is not installed.
    """
    if name not in SCENE_METHODS:
        raise ParameterError(f"method {name!r} is unknown{nearest_name(name, SCENE_METHODS)}")
    return SCENE_METHODS[name](limits)


BLOCKED_PATIENCE = 15.0
"""Time [s] after which a blocked method is given up."""
_TWIST_OVER = 5  # control steps over which the velocity is estimated


class BaseController:
    """Workspace: the counterpart of :class:`~elastic_strips.control.Controller` for base methods.

    It is no subclass, for it senses readings rather than a scene, and has no strip to speak of: it has what a
    :class:`~elastic_strips.sim.Simulation` asks of its controller, under the same names.

    The method gets readings, each with the estimated pose at its time; it has no map. The arm does not move. The run
    ends at the goal, at a contact, or when the method has been blocked for :attr:`patience`.

    Args:
        robot: the robot, with a differential drive.
        start: configuration (nq,).
        goal: configuration (nq,); only the base's pose counts.
        method: a name of `BASE_METHODS` or `SCENE_METHODS`.
        params: periods of the drive.
        limits: limits of the motors; read off the robot where None.
        base: limits of the base that the method steers; a slow one of the Silvermate's size where None.
        patience: time [s] after which a blocked method is given up.

    Raises:
        ConfigurationError: the robot has no differential drive, or start or goal is not valid.
        ParameterError: an unknown method.
    """

    tolerance: Tolerance = Tolerance(position=0.15, yaw=0.2, joints=np.inf)
    """How near counts as reached, for the base alone."""

    def __init__(
        self,
        robot: RobotModel,
        start: ArrayLike,
        goal: ArrayLike,
        method: str,
        *,
        params: DriveParams | None = None,
        limits: MotionLimits | None = None,
        base: BaseLimits | None = None,
        patience: float = BLOCKED_PATIENCE,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        if robot.base_kind is not BaseKind.DIFF_DRIVE:
            raise ConfigurationError(
                f"method={method!r} steers a differential drive; {robot.name!r} has a {robot.base_kind.value} base"
            )
        check_type("params", params, DriveParams, none=True)
        check_type("limits", limits, MotionLimits, none=True)
        self.robot: RobotModel = robot
        self.params: DriveParams = params or DriveParams()
        self.limits: MotionLimits = limits or MotionLimits.for_robot(robot)
        self.time: float = 0.0
        self.start: Array = robot.space.to_coordinates(robot.check_q(start, what="start"))
        self.tick: Tick | None = None
        self.statistics: TickStatistics = TickStatistics()
        self.sensing_took: float = 0.0
        self.result: None = None
        self.replans: int = 0
        self.goals: list[Array] = []
        self.goals_reached: list[GoalReached] = []
        self.plans_next: bool = True
        self._steps = 0
        self.goal: Array = robot.space.to_coordinates(robot.check_q(goal, what="goal"))
        base = BaseLimits.of(self.limits) if base is None else base
        make = make_scene_method if method in SCENE_METHODS else make_base_method
        self.steering: BaseMethod | SceneMethod = make(method, base)
        self.method = self.steering.name
        self.patience = patience
        self.command: BaseCommand = BaseCommand(0.0, 0.0, "moving")
        self._run = RunLog()
        nowhere = np.full(robot.nv, np.nan)
        self.reference: ReferenceState = ReferenceState(np.nan, nowhere, nowhere, nowhere)  # it follows none
        self.estimator: StateEstimator = StateEstimator(robot, self.limits)
        self.estimator.reset(self.start, 0.0)
        self._estimate = self.start
        self._past = PoseBuffer()
        self._past.add(0.0, self.estimate)
        self._contact = self._stopping = ""
        self._blocked = 0.0

    @property
    def state(self) -> RunState:
        """State of the robot."""
        return self._run.state

    @property
    def reason(self) -> str:
        """Reason of the state."""
        return self._run.reason

    @property
    def events(self) -> list[Event]:
        """Events so far, in order of time."""
        return self._run.events

    @property
    def stops(self) -> list[tuple[float, str]]:
        """(time [s], reason) of every stop short of the goal."""
        return self._run.stops

    @property
    def strip(self) -> Strip:
        """From where the robot is to where it wants to go, to look at."""
        return Strip.from_coordinates(self.robot, np.stack((self.estimate, self.goal)))

    @property
    def ended(self) -> bool:
        """Whether the robot has arrived, or is in contact."""
        return bool(self._contact) or self.state is RunState.REACHED

    @property
    def halted(self) -> bool:
        """Whether the robot stands after :meth:`stop`."""
        return bool(self._stopping) and not (self.command.v or self.command.omega)

    @property
    def estimate(self) -> Array:
        """(nv,) estimated coordinate row of the robot."""
        return self._estimate

    def stop(self, reason: str = "asked to stop") -> None:
        """Bring the robot to rest; it stands until :meth:`resume`."""
        self._stopping = self._stopping or reason

    def resume(self) -> None:
        """Continue after :meth:`stop`."""
        self._stopping = ""

    def log(self, kind: str, reason: str) -> None:
        """Write down an event at the present time: its kind in one word, and a reason."""
        self.events.append(Event(self.time, kind, reason))

    def step(
        self, t: float, measurement: Measurement | None, seen: Sequence[Reading] | Scene | None, *, trouble: str = ""
    ) -> Command:
        """One control period, on the readings since the last step, or on a scene; see :meth:`Controller.step`."""
        self.time = t
        if measurement is not None:
            self._estimate = self.estimator.update(measurement)
            self._contact = self._contact or measurement.contact
            self._past.add(t, self.estimate)
        if isinstance(self.steering, SceneMethod):
            if isinstance(seen, Scene):
                self.steering.see(seen)
        elif not isinstance(seen, Scene):
            for reading in seen or ():
                if not isinstance(reading, (LaserScan, RangeRing)):
                    continue  # methods of the plane understand no images
                self.steering.update(reading, self._past.at(reading.time))
        if self._steps % self.params.plan_every == 0:
            self._steer(t)
        self._steps += 1
        if self._contact or self._stopping:
            self.command = BaseCommand(0.0, 0.0, "moving", self._stopping)
        command, blocked = self.command, self.command.status == "blocked"
        self._blocked = self._blocked + self.params.control_dt if blocked else 0.0
        if self._contact:
            self._enter(RunState.STOPPED, f"touched {self._contact}")
        elif command.status == "arrived":
            self._enter(RunState.REACHED, "at rest at the goal")
        elif self.halted:
            self._enter(RunState.STOPPED, self._stopping)
        else:
            self._enter(RunState.BRAKING if blocked else RunState.MOVING, command.reason)
        if self._blocked > self.patience:
            self.stop(f"blocked: {command.reason}")
        drive = self.limits.to_drive(np.array([command.v, 0.0, command.omega]))
        drive /= max(1.0, float((np.abs(drive) / self.limits.drive_speed).max()))
        return Command(drive, np.zeros(len(self.limits.joint_speed)))

    def _steer(self, t: float) -> None:
        began = perf_counter()
        self.command = self.steering.command(t, self.estimate[:3], self._past.velocity(_TWIST_OVER), self.goal[:3])
        seconds = perf_counter() - began
        self.tick = Tick(t, seconds, None, None, np.nan, self.command.status, self.command.reason)
        self.statistics.add(seconds, late=seconds > self.params.latency * self.params.control_dt)

    def _enter(self, state: RunState, reason: str) -> None:
        if state is not self.state:
            if state is RunState.STOPPED or state is RunState.BRAKING:
                self.stops.append((self.time, reason))
            self.log(state.label, reason)
        self._run.state, self._run.reason = state, reason


class _RawReadings:
    """Workspace: readings of a robot's simulated sensors, and the obstacle that it touches."""

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
        self.sensors = self.suite.config
        self._world, self._plant, self._contact_sensor = world, plant, ContactSensor(robot)

    @property
    def contact(self) -> str:
        """The obstacle that is touched."""
        return self._contact_sensor.touched(self._world.at(self._plant.time), self._plant.coordinates)

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Nothing to do: :meth:`sense` reads the sensors."""

    def sense(self, t: float) -> Sequence[Reading]:
        """Readings that are available at time ``t`` [s], and were not before."""
        return self.suite.observe(t, self._plant.coordinates)


def base_simulation(
    robot: RobotModel,
    world: World | Scene,
    start: ArrayLike,
    goal: ArrayLike,
    method: str,
    *,
    params: DriveParams | None = None,
    limits: MotionLimits | None = None,
    base: BaseLimits | None = None,
    patience: float = BLOCKED_PATIENCE,
    sensors: SensorConfig | None = None,
    plant: Plant | None = None,
    seed: int = 0,
    watch: Callable[[Simulation[Controller]], object] | None = None,
    realtime: bool = False,
    metadata: dict[str, object] | None = None,
) -> Simulation[Controller]:
    """A base method in a world, ready to run; as :func:`~elastic_strips.sim.simulation`.

    Args:
        robot, start, goal, method, params, limits, base, patience: as for the :class:`BaseController`.
        world: the true obstacles over time. Methods that are shown obstacles see them as they are, at once and without
            errors, and feel no contact: they drive on.
        sensors: their parameters; the Silvermate's where None. For methods that are shown obstacles there are none.
        plant: the machine; a :class:`KinematicPlant` where None.
        seed: seed of the plant and the sensors.
        watch, realtime, metadata: as for the :class:`~elastic_strips.sim.Simulation`.

    Raises:
        RobotError: the robot lacks a frame of a sensor.
        ParameterError: sensors for a method that is shown obstacles.
    """
    check_able("watch", watch)
    shown = method in SCENE_METHODS
    if shown and sensors is not None:
        raise ParameterError(
            f"sensors={','.join(sensors.names)!r}: method={method!r} is shown the obstacles and reads none; leave out"
        )
    controller = BaseController(robot, start, goal, method, params=params, limits=limits, base=base, patience=patience)
    world, machine, rng = prepare(robot, world, controller.limits, plant, seed)
    machine.reset(controller.estimate)
    senses: NoisyGroundTruth | _RawReadings
    if shown:
        senses = NoisyGroundTruth(world, ObstacleAssumptions(), PerceptionParams(delay=0.0, noise=0.0), rng)
    else:
        senses = _RawReadings(robot, world, machine, sensors, seed=rng)
    return Simulation(
        cast("Controller", controller),
        world,
        machine,
        cast("Perception", senses),
        watch=watch,
        realtime=realtime,
        metadata={"method": method, **(metadata or {})},
    )
