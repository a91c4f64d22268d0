"""Control loop: base of all controllers: measurements and what is sensed in, commands out, step by step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState
from elastic_strips.validation import check_type

from .interfaces import Command, Event, Measurement, RunState
from .params import DriveParams, Tolerance
from .record import TickStatistics
from .strip_timer import PlanResult
from .supervisor import RunLog

_Sensed = TypeVar("_Sensed", contravariant=True)


@dataclass(frozen=True, slots=True, eq=False)
class Tick:
    """A finished planning tick.

    Attributes:
        time: time of the control step [s].
        seconds: duration by the wall clock [s].
        result: result of the planner; None where it gave none.
        strip: (N, nv) coordinate rows of the strip; None where there is none.
        horizon_end: time [s] at which the active trajectory comes to rest; NaN where it is unknown.
        status: status of the strip, or of the method that steers without one.
        reason: why there is no better result, or the reason of the robot's state.
    """

    time: float
    seconds: float
    result: PlanResult | None
    strip: Array | None
    horizon_end: float
    status: str
    reason: str


class ControlLoop(ABC, Generic[_Sensed]):
    """Workspace: base of all controllers: a robot and its limits, an estimate, planning ticks, and a stop.

    It is generic in what it senses: a scene, or readings.

    Args:
        robot: the robot.
        start: configuration (nq,) of the robot at rest.
        params: parameters of the drive.
        limits: limits of the motors; read off the robot where None.

    Attributes:
        method: name of the method that steers.
        goal: (nv,) coordinate row of the present goal.
        tolerance: how near counts as reached.
        time: time of the last step [s].
        tick: the last planning tick, or None.
        statistics: durations of the planning ticks.
        sensing_took: time [s] that perception took for the next scene, by the clock that computing is measured
            with.

    Raises:
        ConfigurationError: start is not a valid configuration.
    """

    method: str
    goal: Array
    tolerance: Tolerance
    _run: RunLog

    def __init__(
        self, robot: RobotModel, start: npt.ArrayLike, params: DriveParams | None, limits: MotionLimits | None
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
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
        self._steps = 0

    @property
    @abstractmethod
    def estimate(self) -> Array:
        """(nv,) estimated coordinate row of the robot."""

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
    def replans(self) -> int:
        """How often a strip was planned anew."""
        return 0

    @property
    def reference(self) -> ReferenceState | None:
        """State that the robot follows at the time of the last step; None where the method has no reference."""
        return None

    @property
    def plans_next(self) -> bool:
        """Whether the next step has a planning tick, and so uses what is sensed."""
        return True

    @property
    @abstractmethod
    def ended(self) -> bool:
        """Whether the robot has come to its last goal, or has stopped for good."""

    @abstractmethod
    def log(self, kind: str, reason: str) -> None:
        """Write down an event at the present time: its kind in one word, and a reason."""

    @abstractmethod
    def stop(self, reason: str = "asked to stop") -> None:
        """Bring the robot to rest; it stands until :meth:`resume`.

        Args:
            reason: becomes the reason of the state.
        """

    @abstractmethod
    def resume(self) -> None:
        """Continue after :meth:`stop`."""

    @abstractmethod
    def step(
        self, t: float, measurement: Measurement | None, sensed: _Sensed | None, /, *, trouble: str = ""
    ) -> Command:
        """One control period: the command of the motors from now on.

        Args:
            t: time [s].
            measurement: what has been measured since the last step; None at the first.
            sensed: what has been sensed since the last step; None where nothing came.
            trouble: why nothing came; empty where that is not known.
        """
