"""Control room, base runner: a base driven by one of the methods that the paper names, on sensors alone."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter, sleep

import numpy as np
import numpy.typing as npt

from ..errors import ConfigurationError, RobotError
from ..execution import (
    MACHINE,
    DriveParams,
    DriveResult,
    KinematicPlant,
    MotionLimits,
    Plant,
    RunState,
    Tolerance,
)
from ..execution.bystanders import Bystanders
from ..execution.estimation import Estimator
from ..execution.recorder import Recorder
from ..execution.result import TickStatistics
from ..execution.tracking import Command
from ..methods import BaseCommand, BaseLimits, make_base_method
from ..robot import BaseKind, RobotModel
from ..scene import Scene, World
from ..sensing import SensorConfig, SensorSuite
from ..validation import check_able, check_count, check_type
from .bumper import Bumper
from .pose_history import PoseHistory

PATIENCE = 15.0
"""A method that has been blocked for so long [s] is given up."""
_TWIST_OVER = 5  # control steps over which the velocity is estimated


class BaseRunner:
    """Workspace: sense, steer, drive; the counterpart of :class:`~elastic_strips.execution.Runner` for base methods.

    The method sees what the simulated sensors read and the estimated pose; it knows no map. The arm stays as it is.
    The run ends at the goal, at a contact, after the method has been blocked for long, or when the time is over.

    Args:
        robot: with a differential drive and the sensors' frames.
        world: the true obstacles over time.
        start: configuration (nq,).
        goal: configuration (nq,); only the base's pose counts.
        method: ``"apf"``, ``"vff"``, ``"vfh"`` or ``"band"``.
        params: periods and time limit of the drive.
        limits: of the motors; read off the robot where None.
        sensors: what the sensors are like.
        base: what the method knows of the base; read off the limits where None.
        plant: the machine; a :class:`KinematicPlant` where None.
        seed: of the machine and the sensors.
        patience: a method that has been blocked for so long [s] is given up.
        watch: called after every tick of the method, with this runner.
        realtime: whether to wait for the wall clock.
        metadata: plain JSON values to keep with the record.

    Raises:
        ConfigurationError: the robot has no differential drive, or start or goal is not sound.
        ParameterError: an unknown method.
        RobotError: the robot has not the frames that the sensors sit on.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World | Scene,
        start: npt.ArrayLike,
        goal: npt.ArrayLike,
        method: str,
        *,
        params: DriveParams | None = None,
        limits: MotionLimits | None = None,
        sensors: SensorConfig | None = None,
        base: BaseLimits | None = None,
        plant: Plant | None = None,
        seed: int = 0,
        patience: float = PATIENCE,
        watch: Callable[[BaseRunner], object] | None = None,
        realtime: bool = False,
        metadata: dict[str, object] | None = None,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("params", params, DriveParams, none=True)
        check_type("limits", limits, MotionLimits, none=True)
        check_able("plant", plant, "reset", "step")
        check_able("watch", watch)
        check_count("seed", seed)
        if robot.base_kind is not BaseKind.DIFF_DRIVE:
            raise ConfigurationError(
                f"method={method!r} steers a differential drive; {robot.name!r} has a {robot.base_kind.value} base"
            )
        self.robot, self.params = robot, params or DriveParams()
        self.world = world if isinstance(world, World) else World(world)
        self.limits = limits or MotionLimits.for_robot(robot)
        self.watch, self.realtime, self.patience = watch, realtime, patience
        plant_seed, sense_seed = np.random.SeedSequence(seed).spawn(2)
        self.plant: Plant = plant or KinematicPlant(robot, self.limits, MACHINE, seed=np.random.default_rng(plant_seed))
        first = robot.space.to_chart(robot.check_q(start, what="start"))
        self.goal = robot.space.to_chart(robot.check_q(goal, what="goal"))
        self.method = make_base_method(method, BaseLimits.of(self.limits) if base is None else base)
        self.plant.reset(first)
        self.estimator = Estimator(robot, self.limits)
        self.estimator.reset(first, 0.0)
        self.estimate = first
        self.sensors = SensorSuite(robot, self.world, sensors, seed=np.random.default_rng(sense_seed))
        self.bystanders, self._bumper = Bystanders(robot, self.world), Bumper(robot)
        self.recorder = Recorder(robot, self.world, goal=self.goal, metadata={"method": method, **(metadata or {})})
        self.time = 0.0
        self.command = BaseCommand(0.0, 0.0, "moving")
        self.statistics = TickStatistics()
        self.state, self.reason = RunState.STOPPED, "not started"
        self.stops: list[tuple[float, str]] = []
        self._past = PoseHistory()
        self._past.add(0.0, first)
        self._stop = ""

    @property
    def tolerance(self) -> Tolerance:
        """How near counts as reached; of the base alone."""
        return Tolerance(position=0.15, yaw=0.2, joints=np.inf)

    def stop(self) -> None:
        """Ask the loop to end: the base brakes first."""
        self._stop = "asked to stop"

    def run(self, *, time_limit: float | None = None) -> DriveResult:
        """Drive until the goal is reached, or the run has ended otherwise."""
        params = self.params
        limit = params.time_limit if time_limit is None else time_limit
        began, step, blocked = perf_counter(), 0, 0.0
        while True:
            t = self.time = step * params.control_dt
            self._sense(t)
            if step % params.plan_every == 0:
                self._tick(t)
            blocked = blocked + params.control_dt if self.command.status == "blocked" else 0.0
            touched = self._bumper.touched(self.world.at(t), self.plant.chart)
            if touched:
                self._enter(t, RunState.STOPPED, f"touched {touched}")
            elif self.command.status == "arrived":
                self._enter(t, RunState.REACHED, "at rest at the goal")
            elif self.command.status == "blocked":
                self._enter(t, RunState.SLOWING, self.command.reason)
            else:
                self._enter(t, RunState.MOVING, self.command.reason)
            self._control(t)
            step += 1
            if touched or (self.state is RunState.REACHED and self._rests()):
                break
            if not self._stop and blocked > self.patience:
                self._stop = f"blocked: {self.command.reason}"
            if not self._stop and t >= limit:
                self._stop = f"time limit of {limit:g} s"
            if self._stop and self._rests():
                self._enter(t, RunState.STOPPED, self._stop)
                break
            if self.realtime:
                ahead = began + step * params.control_dt - perf_counter()
                if ahead > 0.0:
                    sleep(ahead)
        record = self.recorder.finish()
        return DriveResult(
            record, self.state, self.reason, tuple(self.stops), record.events, 0, self.statistics,
            perf_counter() - began,
        )  # fmt: skip

    def _sense(self, t: float) -> None:
        """Hand the readings that have come to the method, each with the pose that it was taken at."""
        for reading in self.sensors.observe(t, self.plant.chart):
            self.method.update(reading, self._past.at(reading.time))

    def _tick(self, t: float) -> None:
        began = perf_counter()
        self.command = (
            BaseCommand(0.0, 0.0, "moving", self._stop)
            if self._stop
            else self.method.command(t, self.estimate[:3], self._past.velocity(_TWIST_OVER), self.goal[:3])
        )
        seconds = perf_counter() - began
        self.statistics.add(seconds, self.params.latency * self.params.control_dt)
        self.recorder.planning(t, tick_ms=1e3 * seconds, status=self.command.status, reason=self.command.reason)
        if self.watch is not None:
            self.watch(self)

    def _control(self, t: float) -> None:
        drive = self.limits.to_drive(np.array([self.command.v, 0.0, self.command.omega]))
        drive /= max(1.0, float((np.abs(drive) / self.limits.drive_speed).max()))
        command = Command(drive, np.zeros(len(self.limits.joint_speed)))
        self.recorder.control(
            t, chart=self.plant.chart, v=self.plant.v, estimate=self.estimate, drive=drive, joints=command.joints,
            motors=self.plant.motors, state=int(self.state),
        )  # fmt: skip
        self.bystanders.step(t, self.plant.chart, self.plant.v)
        self.estimate = self.estimator.update(self.plant.step(command, self.params.control_dt))
        self._past.add(t + self.params.control_dt, self.estimate)

    def _enter(self, t: float, state: RunState, reason: str) -> None:
        if state is not self.state:
            if state is RunState.STOPPED or state is RunState.SLOWING:
                self.stops.append((t, reason))
            self.recorder.event(t, state.name.lower(), reason)
        self.state, self.reason = state, reason

    def _rests(self) -> bool:
        return bool(np.abs(self.plant.v).max(initial=0.0) < 1e-3)
