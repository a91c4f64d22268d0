"""Controller: the control loop of a robot; measurements and scenes in, commands out, step by step.

It has no access to a simulator's true state: the robot's state is estimated from measurements, obstacles come from
sensed scenes.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import ConfigurationError, ElasticStripsError, ParameterError, RobotError, SceneError
from elastic_strips.planning import PlanReport
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.trajectory import stationary
from elastic_strips.validation import check_able, check_count, check_number, check_type

from .estimation import StateEstimator
from .interfaces import Command, Event, Measurement, RunState
from .local_planner import LocalPlanner
from .monitor import Monitor
from .params import DriveParams, Tolerance
from .record import TickStatistics
from .replanning import Replanner
from .strip_timer import PlanOutcome, PlanResult
from .supervisor import RunLog, Supervisor
from .tracking import TrackingController, TrackingGains

_log = logging.getLogger(__name__)
KEPT_EVENTS = 500
"""Events that are kept by default: a robot may run for days."""
_STEP = 0.005  # [m] in which the tracking error grows
_RESTS = 0.05  # [m/s, rad/s] a measured speed below this counts as standing
_Planned = TypeVar("_Planned")
_Sensed = TypeVar("_Sensed", contravariant=True)
PlanTick = Callable[[float, Scene, Trajectory, float], PlanResult]
"""Time, scene, the active trajectory, and when a new one is to begin; see :meth:`LocalPlanner.tick`."""


@dataclass(frozen=True, slots=True, eq=False)
class Tick:
    """A finished planning tick.

    Attributes:
        time: of the control step [s].
        seconds: duration by the wall clock [s].
        result: of the planner; None where it gave none.
        strip: (N, nv) coordinate rows of the strip; None where there is none.
        horizon_end: time [s] at which the active trajectory comes to rest; NaN where it is unknown.
        status: of the strip, or of the method that steers without one.
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
        params: of the drive.
        limits: of the motors; read off the robot where None.

    Attributes:
        method: name of the method that steers.
        goal: (nv,) coordinate row of the present goal.
        tolerance: how near counts as reached.
        time: of the last step [s].
        estimate: (nv,) estimated coordinate row of the robot.
        tick: the last planning tick, or None.
        statistics: durations of the planning ticks.
        estimator: of the robot's state, from measurements.

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
        self.estimate: Array = robot.space.to_coordinates(robot.check_q(start, what="start"))
        self.estimator: StateEstimator = StateEstimator(robot, self.limits)
        self.estimator.reset(self.estimate, 0.0)
        self.tick: Tick | None = None
        self.statistics: TickStatistics = TickStatistics()
        self._contact = self._stopping = ""
        self._steps = 0

    @property
    def state(self) -> RunState:
        """What the robot is doing."""
        return self._run.state

    @property
    def reason(self) -> str:
        """Why it does so."""
        return self._run.reason

    @property
    def events(self) -> list[Event]:
        """What happened, in order of time."""
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
        """Whether the next step has a planning tick, and so makes use of what is sensed."""
        return True

    @property
    @abstractmethod
    def ended(self) -> bool:
        """Whether the robot has come to its last goal, or has stopped for good."""

    @abstractmethod
    def log(self, kind: str, reason: str) -> None:
        """Write down an event at the present time: its kind in one word, and a reason."""

    @abstractmethod
    def step(
        self, t: float, measurement: Measurement | None, sensed: _Sensed | None, /, *, trouble: str = ""
    ) -> Command:
        """One control period: the command of the motors from now on.

        Args:
            t: time [s].
            measurement: what has been measured since the last step; None at the first.
            sensed: what has been sensed since the last step; None where nothing came.
            trouble: why nothing came.
        """

    def stop(self, reason: str = "asked to stop") -> None:
        """Bring the robot to rest; it stands until :meth:`resume`.

        Args:
            reason: becomes the reason of the state.
        """
        self._stopping = self._stopping or reason

    def resume(self) -> None:
        """Continue after :meth:`stop`."""
        self._stopping = ""

    def _take_in(self, measurement: Measurement) -> None:
        self.estimate = self.estimator.update(measurement)
        self._contact = self._contact or measurement.contact

    def _finish_tick(self, tick: Tick) -> None:
        self.tick = tick
        self.statistics.add(tick.seconds, self.params.latency * self.params.control_dt)


class Controller(ControlLoop[Scene]):
    """Workspace: drives a robot along an elastic strip to its goals.

    In every control period :meth:`step` takes measurements and scenes, and returns the command of the motors. In every
    ``plan_every``-th one the strip is deformed, and a motion along it is certified up to its stop. On any failure the
    active trajectory is driven to its end, and the reason is in :attr:`events`.

    Args:
        robot: the robot.
        start: configuration (nq,) of the robot at rest.
        goal: configuration (nq,), or several of them (G, nq), one after the other.
        scene: obstacles known before the first step; none where None.
        params: of the drive.
        limits: of the motors; read off the robot where None.
        strip: first strip; planned where None.
        path: waypoints (K, 2) [m] that the first plan tries first.
        grid: whether plans may use a path over a grid.
        replanner: decides when a strip is planned anew, and plans it; a :class:`Replanner` where None.
        executor: runs plans while the control loop goes on; an own thread where None.
        seed: of the planner.
        events: the newest events and stops that are kept at least; all where None.

    Attributes:
        first_plan: report of the first strip's plan; None where the strip was given.
        scene: the newest one that was planned with.
        goals: configurations (nq,) after the present goal.
        goal_q: configuration (nq,) of the present goal; ``goal``: its coordinate row (nv,).
        result: of the last planning tick; None where it gave none.
        plan_tick: function that plans in a tick; it may be replaced by a wrapper.
        planner, supervisor, replanner, tracker, monitor: the parts; other attributes as of :class:`ControlLoop`.

    Raises:
        ConfigurationError: start or goal is not valid, or in collision.
    """

    method = "strip"

    def __init__(
        self,
        robot: RobotModel,
        start: npt.ArrayLike,
        goal: npt.ArrayLike,
        scene: Scene | None = None,
        *,
        params: DriveParams | None = None,
        limits: MotionLimits | None = None,
        strip: Strip | None = None,
        path: npt.ArrayLike | None = None,
        grid: bool = True,
        replanner: Replanner | None = None,
        executor: Executor | None = None,
        seed: int = 0,
        events: int | None = KEPT_EVENTS,
    ) -> None:
        super().__init__(robot, start, params, limits)
        check_type("scene", scene, Scene, SceneError, none=True)
        check_type("strip", strip, Strip, none=True)
        check_able("replanner", replanner, "plan")
        check_able("executor", executor, "submit")
        check_count("seed", seed)
        goals = np.atleast_2d(robot.check_q(goal, what="goal"))
        self.goals: list[ArrayLike] = list(goals[1:])
        self.goal_q: Array = goals[0]
        self.goal: Array = robot.space.to_coordinates(self.goal_q)
        self.scene: Scene = Scene([]) if scene is None else scene
        self.first_plan: PlanReport | None = None
        self.replanner: Replanner = replanner or Replanner(robot, self.params, seed=seed, grid=grid)
        if strip is None:
            self.first_plan = self.replanner.plan(self.scene, start, self.goal_q, path=path)
            strip = self.first_plan.strip
        self.planner: LocalPlanner = LocalPlanner(robot, self.limits, self.params, strip)
        self.plan_tick: PlanTick = self.planner.tick
        self.tracker: TrackingController = TrackingController(robot, self.limits, TrackingGains(headroom=1.0))
        self.tolerance = self.params.tolerance
        resting = stationary(robot, self.limits, self.estimate, 0.0, self.params.control_dt)
        self.supervisor: Supervisor = Supervisor(resting, keep=events)
        self.monitor: Monitor = Monitor(robot, self.limits, self.params.monitor, self.params.control_dt)
        self._halt = ""  # why the robot has to stand before it goes on from where it is
        self._power_cut: float | None = None  # since when [s]
        self._run = self.supervisor
        self._passed = 0
        self._executor = executor
        self._own: ThreadPoolExecutor | None = None
        self._replan_task: Future[tuple[Strip | None, str]] | None = None  # replans a strip to the same goal
        self._next_plan: Future[PlanReport] | None = None  # plans the first strip to another goal
        self._ready: list[tuple[float, PlanResult]] = []
        self._newest, self._trouble = scene, "" if scene is not None else "no scene has come yet"
        self._no_path = ""
        self.result: PlanResult | None = None
        self._speed = 0.0

    def __enter__(self) -> Controller:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the planning thread; a running plan is waited for."""
        if self._own is not None:
            self._own.shutdown()

    @property
    def replans(self) -> int:
        """How often a strip was planned anew."""
        return self.replanner.count

    @property
    def reference(self) -> ReferenceState:
        """State that the robot follows at the time of the last step."""
        return self.supervisor.reference(self.time)

    @property
    def strip(self) -> Strip:
        """The strip that is followed."""
        return self.planner.strip

    @property
    def settled(self) -> bool:
        """Whether the robot stands, by its measured speed."""
        return self._speed < _RESTS

    @property
    def reached(self) -> int:
        """How many of the goals have been reached."""
        return self._passed + (self.state is RunState.REACHED)

    @property
    def plans_next(self) -> bool:
        """Whether the next step has a planning tick, which needs a scene."""
        return not self._stopping and self._steps % self.params.plan_every == 0

    @property
    def ended(self) -> bool:
        """Whether the last goal is reached, or the robot was to stop, and the active trajectory is over."""
        if self._stopping:
            return self.supervisor.at_rest(self.time)
        return self.state is RunState.REACHED and not self.goals and self._next_plan is None

    def log(self, kind: str, reason: str) -> None:
        """Write down an event at the present time: its kind in one word, and a reason."""
        self.supervisor.log(self.time, kind, reason)

    def retarget(self, goal: npt.ArrayLike) -> None:
        """At rest, take another goal, and start planning a strip to it.

        Args:
            goal: configuration (nq,).

        Raises:
            ConfigurationError: the robot moves, or the goal is not a valid configuration.
        """
        if self.reference.v.any():
            raise ConfigurationError("retarget: the robot moves; stop it, and give it another goal when it stands")
        self.goal_q = self.robot.check_q(goal, what="goal")
        self.goal = self.robot.space.to_coordinates(self.goal_q)
        self._no_path = ""
        self._replan_task, self.replanner.pending = None, False  # the running plan leads to the previous goal
        self._ready.clear()
        self.supervisor.restart("new goal", self.time)
        q = self.robot.space.from_coordinates(self.reference.coordinates)
        self._next_plan = self._submit(self.replanner.plan, self.scene, q, self.goal_q)

    def step(self, t: float, measurement: Measurement | None, scene: Scene | None, *, trouble: str = "") -> Command:
        """One control period: the command of the motors from now on.

        Args:
            t: time [s], later than at the last step by about ``params.control_dt``.
            measurement: since the last step; None at the first, when the robot stands.
            scene: the newest sensed scene, with the time at which it was sensed; None where no newer one came.
            trouble: why no scene came, where that is known; the robot comes to rest then.

        Returns:
            Speeds within ``limits``.

        Raises:
            ParameterError: a time that does not ascend.
            SceneError: not a scene.
        """
        if self._steps and not check_number("t", t, unit="s") > self.time:
            raise ParameterError(f"t={t!r} s must be later than the last step, at {self.time!r} s")
        check_type("scene", scene, Scene, SceneError, none=True)
        began, self.time = self.time, t
        self._measure(t, began, measurement)
        if scene is not None:
            doubt = self.monitor.scene(t, scene, at_rest=self.supervisor.at_rest(t))
            if doubt:
                self.log("fault", doubt)
            else:
                self._newest, self._trouble = scene, ""
        if trouble:
            self._trouble = trouble
        if self.state is RunState.REACHED and self.goals and self.settled:
            self._passed += 1
            self.retarget(self.goals.pop(0))
        if self._steps % self.params.plan_every == 0:
            if not self._stopping:
                self._planning_tick(t)
            elif self.state in (RunState.MOVING, RunState.BRAKING):  # a robot at rest has another reason
                self.supervisor.reject(self._stopping, t)
        self._publish(t)
        self._check_proof(t)
        self._check_arrival(t)
        self.supervisor.update(t)
        self._steps += 1
        command = self._command(t)
        self.monitor.commanded(command)
        return command

    def _measure(self, t: float, began: float, raw: Measurement | None) -> None:
        """Take in what can be true of a measurement."""
        measurement = None
        if raw is not None:
            measurement, faults = self.monitor.measurement(t, raw, self.estimate)
            for fault in faults:
                self.log("fault", fault)
        elif self._steps:
            self.monitor.nothing(t)
        if measurement is None:
            return
        before = self.estimate
        self._take_in(measurement)
        step = self.robot.space.difference(before, self.estimate)
        self._speed = float(np.abs(step).max(initial=0.0)) / max(t - began, 1e-9)
        if measurement.drive is None:
            self.log("fault", "odometry lost")
        if self.estimator.doubt:
            self.log("fault", self.estimator.doubt)

    def _check_proof(self, t: float) -> None:
        """Brake where what the active trajectory was proven with holds no longer."""
        monitor, supervisor, params = self.monitor, self.supervisor, self.params
        monitor.follow(self.reference.coordinates, self.estimate, self.estimator)
        if monitor.motor_fault and self._power_cut is None:
            self.log("fault", monitor.motor_fault)
            self._power_cut = t
        off, known = monitor.deviation, monitor.uncertainty
        reason = monitor.motor_fault
        if not reason and monitor.silent is not None and t - monitor.silent >= params.monitor.silence:
            reason = f"no usable measurement for {t - monitor.silent:.2f} s"
        proven = self.planner.params.tracking_error
        if monitor.silent is not None:  # where the robot is now is not known
            off = 0.0
        if not reason and off + known > params.monitor.brake_at * proven:
            reason = f"{1e3 * off:.0f} mm off the reference, known to {1e3 * known:.0f} mm, of {1e3 * proven:.0f} mm"
            if self.estimator.doubt:
                reason += f": {self.estimator.doubt}"
        if reason and not self._halt and (not supervisor.at_rest(t) or off > proven):
            self._halt = reason
            slipped = self.estimator.slipped
            self.log("fault", f"wheels slip: odometry is {1e3 * slipped:.0f} mm off; {reason}" if slipped else reason)
            self._ready.clear()
            if not supervisor.at_rest(t):
                supervisor.brake(self.planner.timer.hard.brake(supervisor.active, self._begin(t)), reason, t)
        if self._halt and off > proven:
            supervisor.log(t, "unproven", f"the robot is further off its reference than was proven with: {self._halt}")

    def _tracking_error(self) -> float:
        """How far [m] the robot may be off its reference, as exact as its estimate is now; in steps of 5 mm."""
        params = self.params
        needed = params.monitor.control_share * params.tracking_error + self.monitor.uncertainty
        return params.tracking_error if needed <= params.tracking_error else math.ceil(needed / _STEP) * _STEP

    def _check_arrival(self, t: float) -> None:
        """At rest at the end of a motion to the goal, look whether the robot is there, too."""
        supervisor, off = self.supervisor, np.abs(self.robot.space.difference(self.goal, self.estimate))
        if self._halt or not supervisor.at_goal or not supervisor.at_rest(t) or self.state is RunState.REACHED:
            return
        base, wide = self.robot.space.base_nv, self.tolerance
        apart = float(np.hypot(*off[:2])) if base else 0.0
        turned = float(off[2]) if base else 0.0
        if apart <= wide.position and turned <= wide.yaw and float(off[base:].max(initial=0.0)) <= wide.joints:
            return
        self._halt = f"at rest {apart:.2f} m and {math.degrees(turned):.0f}° from the goal"
        self.log("fault", self._halt)
        supervisor.restart(self._halt, t)

    def _recovers(self, t: float) -> bool:
        """After a halt, go on from where the robot is, as soon as it stands and that is known; False until then."""
        supervisor, monitor, params = self.supervisor, self.monitor, self.params
        cut, known = self._power_cut, monitor.uncertainty
        why = ""
        cooling = cut is not None and t < max(cut, supervisor.active.end_time) + params.monitor.motor_wait
        if cooling or not (supervisor.at_rest(t) and self.settled):
            why = self._halt
        elif monitor.silent is not None or self.estimator.lost_for > 0.0:
            why = "nothing is measured"
        elif self.estimator.doubt:
            why = self.estimator.doubt
        elif self._tracking_error() > max(params.monitor.largest, params.tracking_error):
            why = f"the robot's place is known to {1e3 * known:.0f} mm only"
        if why:
            supervisor.reject(why, t)
            return False
        self._power_cut = None
        self.log("recovered", f"goes on from {monitor.deviation:.2f} m beside its reference, after: {self._halt}")
        self._halt = ""
        supervisor.reset(stationary(self.robot, self.limits, np.array(self.estimate), t, params.control_dt))
        supervisor.restart("recovered", t)
        self.replanner.pending, self.replanner.due = True, t + params.replan_time
        return True

    def _command(self, t: float) -> Command:
        """Speeds that follow the reference; the base and joints that are not measured are not fed back."""
        reference, estimate, base = self.reference, self.estimate, self.robot.space.base_nv
        if self._power_cut is not None:
            return replace(self.tracker.rest, stop=True)
        if self.estimator.lost_for > 0.0:  # feedback on a frozen estimate would drive the base away
            estimate = np.concatenate((reference.coordinates[:base], estimate[base:]))
        if self.monitor.silent is not None:
            estimate = reference.coordinates
        return self.tracker.command(reference, estimate)

    # the planning loop

    def _planning_tick(self, t: float) -> None:
        """Plan; on any failure the active trajectory is driven to its end, and the reason is logged."""
        began = perf_counter()
        supervisor = self.supervisor
        self.result = None
        try:
            self._plan(t)
        except ElasticStripsError as error:
            supervisor.reject(f"{type(error).__name__}: {error}", t)
            supervisor.log(t, "fault", str(error))
        except Exception as error:
            _log.exception("planning tick failed")
            self.planner.reset()
            supervisor.reject(f"planning failed: {type(error).__name__}: {error}", t)
            supervisor.log(t, "fault", f"planning exception: {type(error).__name__}: {error}")
        seconds = perf_counter() - began
        result = self.result
        reason = (result.reason if result else "") or supervisor.reason
        status = result.report.status.value if result else ""
        self._finish_tick(Tick(t, seconds, result, self.strip.coordinates, supervisor.active.end_time, status, reason))

    def _plan(self, t: float) -> None:
        params, supervisor = self.params, self.supervisor
        if self._contact:
            contact, self._contact = self._contact, ""
            supervisor.log(t, "fault", contact)
            self._ready.clear()
            supervisor.brake(self.planner.timer.hard.brake(supervisor.active, self._begin(t)), contact, t)
            return
        if self._halt and not self._recovers(t):
            return
        if self._trouble or self._newest is None:
            supervisor.reject(self._trouble, t)
            supervisor.log(t, "fault", self._trouble)
            return
        scene = self._newest
        age = t - scene.time
        if age > params.max_scene_age:
            supervisor.reject(f"stale scene: {age:.2f} s old, at most {params.max_scene_age:g} s", t)
            supervisor.log(t, "fault", "stale scene")
            return
        self.scene = scene
        if self.estimator.lost_for > 0.1:
            supervisor.reject("odometry lost", t)
            return
        if self._no_path:  # the strip leads to the previous goal
            supervisor.reject(self._no_path, t)
            return
        waiting = self._replan(t)
        if (waiting and self.planner.evasion is None) or self._rest_of_goal(t, scene):
            return
        allowed = min(self._tracking_error(), max(params.monitor.largest, params.tracking_error))
        before = self.planner.params.tracking_error
        if allowed != before:
            if min(before, allowed) == params.tracking_error:
                coarse = f"coarse: known to {1e3 * self.monitor.uncertainty:.0f} mm"
                self.log("localization", coarse if allowed > before else "as good as assumed again")
            self.planner.allow(allowed)
            self.replanner.deform = self.planner.params.strip
        begin = self._begin(t)
        at_rest = supervisor.at_rest(t)
        if at_rest and t >= supervisor.active.end_time + params.settle_time:
            supervisor.reset(stationary(self.robot, self.limits, np.array(self.estimate), begin, params.control_dt))
        result = self.result = self.plan_tick(t, scene, supervisor.active, begin)
        if result.late:
            supervisor.log(t, "fault", f"late tick: it is ready only after {result.late:.2f} s")
        due = "" if waiting else self.replanner.watch(t, result, scene, at_rest=at_rest)
        if due:
            supervisor.log(t, "replanning", due)
        if not waiting or result.outcome is PlanOutcome.EVADE:
            self._decide(t, result)

    def _decide(self, t: float, result: PlanResult) -> None:
        """Replace, brake or hold the active trajectory, or let it go on to its end."""
        outcome = result.outcome
        if self.replanner.halted and outcome not in (PlanOutcome.BRAKE, PlanOutcome.EVADE):
            self.supervisor.reject(f"the strip is broken: {result.report.certificate.broken}", t)
        elif outcome is PlanOutcome.BRAKE or result.accepted:
            self._ready.append((t + result.late, result))
        elif outcome is PlanOutcome.UNCHANGED:
            self.supervisor.hold(t, result.reason)
        else:
            self.supervisor.reject(result.reason, t)

    def _begin(self, t: float) -> float:
        """Start time [s] of a motion that is planned now."""
        return t + self.params.latency * self.params.control_dt

    def _publish(self, t: float) -> None:
        """Submit planned motions that are ready by now to the supervisor."""
        ready = [result for due, result in self._ready if due <= t + 1e-9]
        self._ready = [(due, result) for due, result in self._ready if due > t + 1e-9]
        for result in ready:
            if result.motion is None or result.certificate is None:
                continue
            if result.motion.start_time < t - 1e-9:
                self.supervisor.log(t, "fault", "late tick")
            if result.outcome is PlanOutcome.BRAKE:
                self.supervisor.brake(result.motion, result.reason, t)
            else:
                at_goal = result.outcome is PlanOutcome.ARRIVE
                self.supervisor.submit(result.motion, result.certificate, t, at_goal=at_goal)

    def _rest_of_goal(self, t: float, scene: Scene) -> bool:
        """Whether the active trajectory ends at the goal and is still certified: then there is nothing to plan."""
        supervisor = self.supervisor
        if not supervisor.at_goal or supervisor.at_rest(t):
            return supervisor.at_goal
        certificate = self.planner.certify(supervisor.active.tail(self._begin(t)), scene)
        if certificate.certified:
            supervisor.hold(t, "the motion ends at the goal")
        return certificate.certified

    def _replan(self, t: float) -> bool:
        """Start planning a strip where that is due, and take it when it is ready; True while the robot waits for it."""
        replanner, supervisor = self.replanner, self.supervisor
        if self._next_plan is not None:
            if not self._next_plan.done():
                return True
            found, self._next_plan = self._next_plan, None
            try:
                report = found.result()
            except Exception as error:  # on any error: the present strip leads to another goal
                self._no_path = f"no way to the goal: {error}"
                raise
            supervisor.log(t, "goal", report.reason)
            self.planner.take(report.strip)
        if not replanner.pending and self._replan_task is None:
            return False
        if self._replan_task is None and t >= replanner.due:
            q = self.robot.space.from_coordinates(self.reference.coordinates)
            self._replan_task = self._submit(replanner.plan_anew, self.scene, q, self.goal_q)
        if self._replan_task is not None and self._replan_task.done():
            planned, self._replan_task = self._replan_task, None
            replanner.pending = False
            strip, reason = planned.result()
            supervisor.log(t, "replanned", reason)
            if strip is not None:
                self.planner.take(strip)
        return True

    def _submit(self, plan: Callable[..., _Planned], *arguments: object) -> Future[_Planned]:
        if self._executor is None:
            self._executor = self._own = ThreadPoolExecutor(1, thread_name_prefix="planner")
        return self._executor.submit(plan, *arguments)
