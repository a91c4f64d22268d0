"""Controller: the planning loop of a robot, around an executor; measurements and scenes in, commands out, step by step.

It has no access to a simulator's true state: the robot's state is estimated from measurements, obstacles come from
sensed scenes.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Executor as Workers
from concurrent.futures import Future
from dataclasses import dataclass
from time import perf_counter
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import ConfigurationError, ElasticStripsError, RobotError, SceneError
from elastic_strips.planning import PlanReport
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.trajectory import stationary
from elastic_strips.validation import check_able, check_count, check_type

from .executor import ExecutorLink, MotionExecutor
from .interfaces import Command, Event, Measurement, RunState
from .local_planner import LocalPlanner
from .monitor import SceneMonitor
from .pace import Pace
from .params import DriveParams, Tolerance
from .plan_queue import PlanQueue
from .process.priority import keep_memory, undisturbed
from .record import TickStatistics
from .replanning import Replanned, Replanner
from .strip_timer import PlanOutcome, PlanResult

_log = logging.getLogger(__name__)
KEPT_EVENTS = 500
"""Events that are kept by default: a robot may run for days."""
_STRIP_START_OFFSET = 0.02
"""A robot at least this far [m, rad] from the beginning of a strip that was planned while it braked stands
elsewhere."""
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
        status: of the strip.
        reason: why there is no better result, or the reason of the robot's state.
    """

    time: float
    seconds: float
    result: PlanResult | None
    strip: Array | None
    horizon_end: float
    status: str
    reason: str


def stale(t: float, scene: Scene, most: float) -> str:
    """Why a scene is too old to be driven on; empty where it is not, or is a map, which has no time and no motions."""
    age = t - scene.time
    if age <= most or (scene.stamp is None and all(obstacle.motion is None for obstacle in scene)):
        return ""
    if scene.stamp is None:
        return "a scene in which something moves has no time: Scene(…, time=t) says when it was seen"
    return f"stale scene: {age:.2f} s old, at most {most:g} s"


class ControllerOptions(TypedDict, total=False):
    """Arguments of the :class:`Controller` that those which are made of one pass on."""

    limits: MotionLimits | None
    strip: Strip | None
    path: npt.ArrayLike | None
    workers: Workers | None
    meter: Callable[[], float] | None
    events: int | None


class Controller:
    """Workspace: drives a robot along an elastic strip to its goals.

    In every control period :meth:`step` takes measurements and scenes, and returns the command of the motors. At the
    planning rate the strip is deformed, and a motion along it is certified up to its stop. On any failure the active
    trajectory is driven to its end, and the reason is in :attr:`events`.

    Where the executor runs elsewhere, :meth:`plan` does the planning alone.

    Args:
        robot: the robot.
        start: configuration (nq,) of the robot at rest.
        goal: configuration (nq,), or several of them (G, nq), one after the other.
        scene: obstacles known before the first step; none where None.
        params: parameters of the drive.
        limits: limits of the motors; read off the robot where None.
        strip: first strip; planned where None.
        path: waypoints (K, 2) [m] that the first plan tries first.
        grid: whether plans may use a path over a grid.
        replanner: decides when a strip is planned anew, and how; a :class:`Replanner` where None.
        workers: run plans while the control loop goes on, one after the other; an own thread where None.
        seed: of the planner.
        events: the newest events and stops that are kept at least; all where None.
        executor: one that runs elsewhere, with the same robot, limits, start and goal; one of its own where None.
        meter: reading [s] of the clock that computing is measured with; motions begin later where planning takes
            longer. None where it takes no time.

    Attributes:
        first_plan: report of the first strip's plan; None where the strip was given.
        scene: the newest scene that was planned with.
        goals: configurations (nq,) after the present goal.
        goal_q: configuration (nq,) of the present goal.
        goal: its coordinate row (nv,).
        result: result of the last planning tick; None where it gave none.
        plan_tick: function that plans in a tick; it may be replaced by a wrapper.
        tolerance: how near counts as reached.
        time: of the last step [s].
        tick: the last planning tick, or None.
        statistics: durations of the planning ticks.
        sensing_took: time [s] that the perception took for what comes next, by the clock that computing is measured
            with.
        executor, planner, replanner, pace: the parts.

    Raises:
        ConfigurationError: start or goal is not valid, or in collision.
    """

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
        workers: Workers | None = None,
        seed: int = 0,
        events: int | None = KEPT_EVENTS,
        executor: ExecutorLink | None = None,
        meter: Callable[[], float] | None = None,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("params", params, DriveParams, none=True)
        check_type("limits", limits, MotionLimits, none=True)
        check_type("scene", scene, Scene, SceneError, none=True)
        check_type("strip", strip, Strip, none=True)
        check_able("replanner", replanner, "first", "another")
        check_able("workers", workers, "submit")
        check_able("meter", meter)
        check_count("seed", seed)
        self.robot: RobotModel = robot
        self._params: DriveParams = params or DriveParams()
        self.limits: MotionLimits = limits or MotionLimits.for_robot(robot)
        self.time: float = 0.0
        self.start: Array = robot.space.to_coordinates(robot.check_q(start, what="start"))
        self.tick: Tick | None = None
        self.statistics: TickStatistics = TickStatistics()
        self.sensing_took: float = 0.0
        self._steps = 0
        goals = np.atleast_2d(robot.check_q(goal, what="goal"))
        self.goals: list[ArrayLike] = list(goals[1:])
        self.goal_q: Array = goals[0]
        self.goal: Array = robot.space.to_coordinates(self.goal_q)
        self.scene: Scene = Scene([]) if scene is None else scene
        self.first_plan: PlanReport | None = None
        self.replanner: Replanner = replanner or Replanner(robot, self.params, seed=seed, grid=grid)
        if strip is None:
            self.first_plan = self.replanner.first(self.scene, start, self.goal_q, path=path)()
            self.replanner.begin(self.first_plan)
            strip = self.first_plan.strip
        self.pace: Pace = Pace(self.params, meter, transfer=0 if executor is None else 1)
        self.planner: LocalPlanner = LocalPlanner(robot, self.limits, self.params, strip, self.pace)
        self.plan_tick: PlanTick = self.planner.tick
        self.tolerance: Tolerance = self.params.tolerance
        self._here: MotionExecutor | None = None
        if executor is None:
            executor = self._here = MotionExecutor(
                robot, self.limits, self.params, self.start, self.goal, self.tolerance, keep=events
            )
        self.executor: ExecutorLink = executor
        self.result: PlanResult | None = None
        self._doubts = SceneMonitor(self.params.monitor)
        self._passed = self._recoveries = 0
        self._plans = PlanQueue(workers)
        self._replan_task: Future[Replanned] | None = None  # replans a strip to the same goal
        self._replan_from: Array = self.start  # (nv,) where that strip begins
        self._next_plan: Future[PlanReport] | None = None  # plans the first strip to another goal
        self._ready: list[tuple[float, PlanResult, float]] = []  # due when [s], what, proven with [m]
        self._newest, self._trouble = scene, "" if scene is not None else "no scene has come yet"
        self._no_path = self._stopping = ""
        self._next_tick = 0  # number of the step with the next planning tick

    def __enter__(self) -> Controller:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the planning thread; a running plan is waited for."""
        self._plans.close()

    @property
    def params(self) -> DriveParams:
        """The parameters, which stay as they were given."""
        return self._params

    @property
    def state(self) -> RunState:
        """State of the robot."""
        return self.executor.run.state

    @property
    def reason(self) -> str:
        """Reason of the state."""
        return self.executor.run.reason

    @property
    def events(self) -> list[Event]:
        """Events so far, in order of time."""
        return self.executor.run.events

    @property
    def stops(self) -> list[tuple[float, str]]:
        """(time [s], reason) of every stop short of the goal."""
        return self.executor.run.stops

    @property
    def estimate(self) -> Array:
        """(nv,) estimated coordinate row of the robot."""
        return self.executor.estimate

    @property
    def replans(self) -> int:
        """How often a strip was planned anew."""
        return self.replanner.count

    @property
    def reference(self) -> ReferenceState:
        """State that the robot follows at the time of the last step."""
        return self.executor.reference(self.time)

    @property
    def strip(self) -> Strip:
        """The strip that is followed."""
        return self.planner.strip

    @property
    def reached(self) -> int:
        """How many of the goals have been reached."""
        return self._passed + (self.state is RunState.REACHED)

    @property
    def plans_next(self) -> bool:
        """Whether the next step has a planning tick, which needs a scene."""
        return not self._stopping and self._steps >= self._next_tick

    @property
    def ended(self) -> bool:
        """Whether the last goal is reached."""
        return self.state is RunState.REACHED and not self.goals and self._next_plan is None

    @property
    def halted(self) -> bool:
        """Whether the robot was to :meth:`stop`, and stands; :meth:`resume` lets it go on."""
        return bool(self._stopping) and self.executor.at_rest(self.time)

    def log(self, kind: str, reason: str) -> None:
        """Write down an event at the present time: its kind in one word, and a reason."""
        self.executor.log(kind, reason)

    def stop(self, reason: str = "asked to stop") -> None:
        """Bring the robot to rest; it stands until :meth:`resume`.

        Args:
            reason: becomes the reason of the state.
        """
        self._stopping = self._stopping or reason
        self._ready.clear()
        self.executor.stop(self._stopping)

    def resume(self) -> None:
        """Continue after :meth:`stop`, or after an emergency stop that is no longer pressed."""
        self._stopping = ""
        self.executor.resume()

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
        self._replan_task = None  # the running plan leads to the previous goal
        self._ready.clear()
        self.executor.retarget(self.goal, self.tolerance)
        q = self.robot.space.from_coordinates(self.reference.coordinates)
        self._next_plan = self._plans.submit(self.replanner.first(self.scene, q, self.goal_q))

    def lend(self) -> MotionExecutor:
        """Let somebody else drive the robot with this controller's executor, until :meth:`take_back`.

        Raises:
            ConfigurationError: the executor runs elsewhere.
        """
        if self._here is None:
            raise ConfigurationError("lend: the executor of this controller runs elsewhere")
        self._ready.clear()
        return self._here

    def take_back(self) -> None:
        """Drive on after :meth:`lend`, from wherever the robot is, moving or not: it joins the strip from there."""
        self._ready.clear()
        self._replan_task = None  # it leads from where the robot would have come to rest
        self.planner.take(self.strip, beside=True)

    def warm_up(self) -> None:
        """Plan without using the result, while the robot stands: then modules are loaded when time is 0, and it is
        known how long a tick takes. Garbage collection only looks through later objects (:func:`keep_memory`)."""
        try:
            for warm in (False, True):
                self.pace.begin()
                self.planner.tick(0.0, self.scene, self.executor.active, self.pace.latency)
                self.pace.finish(full=warm)
        except ElasticStripsError as error:  # the first tick that counts will say so, too
            _log.info("warming up: %s", error)
        keep_memory()

    def step(self, t: float, measurement: Measurement | None, scene: Scene | None, *, trouble: str = "") -> Command:
        """One control period: the command of the motors from now on.

        Args:
            t: time [s], later than at the last step; the period is measured, and need not be ``params.control_dt``.
            measurement: since the last step; None at the first, when the robot stands.
            scene: the newest sensed scene, with the time at which it was sensed; None where no newer one came. One
                without a time, in which nothing moves, is a map: it counts until another scene comes.
            trouble: why no scene came, where that is known; the robot comes to rest then.

        Returns:
            Speeds within ``limits``.

        Raises:
            ParameterError: a time that does not ascend.
            SceneError: not a scene.
            ConfigurationError: the executor runs elsewhere.
        """
        if self._here is None:
            raise ConfigurationError("step: the executor of this controller runs elsewhere; call plan()")
        check_type("scene", scene, Scene, SceneError, none=True)
        self._here.measure(t, measurement)
        self.time, self.pace.period = t, self._here.period.seconds
        self._see(t, scene, trouble)
        if self.plans_next:
            self._publish(t)  # what is planned now continues what is ready by now
            seconds, period = self._planning_tick(t), self._here.period.seconds
            every = self.params.plan_every * self.params.control_dt / period
            self._next_tick = self._steps + max(1, round(every), int(np.ceil(seconds / period - 1e-9)))
        self._publish(t)
        command = self._here.command(t)
        self._steps += 1
        return command

    def plan(self, t: float, scene: Scene | None, *, trouble: str = "") -> None:
        """One planning tick; for a robot whose executor runs elsewhere.

        Args:
            t: time [s] on the executor's clock.
            scene, trouble: as in :meth:`step`.
        """
        check_type("scene", scene, Scene, SceneError, none=True)
        self.time = t
        self._see(t, scene, trouble)
        if not self._stopping:
            self._planning_tick(t)
        self._publish(np.inf)
        self.executor.planned()

    def _see(self, t: float, scene: Scene | None, trouble: str) -> None:
        """Take in a scene, and set out for the next goal where this one is reached."""
        if scene is not None:
            doubt = self._doubts.doubt(t, scene, at_rest=self.executor.at_rest(t))
            if doubt:
                self.log("fault", doubt)
            else:
                self._newest, self._trouble = scene, ""
        if trouble:
            self._trouble = trouble
        if self.executor.recoveries > self._recoveries:  # the robot is somewhere beside its strip
            self._recoveries = self.executor.recoveries
            self._ready.clear()
            self.replanner.demand(t + self.params.replan_time)
        if self.state is RunState.REACHED and self.goals and self.executor.settled:
            self._passed += 1
            self.retarget(self.goals.pop(0))

    # the planning loop

    def _planning_tick(self, t: float) -> float:
        """Plan; on any failure the active trajectory is driven to its end, and the reason is logged.

        Returns:
            What it took [s], by the meter.
        """
        began, submitting = perf_counter(), self._plans.submitting
        executor = self.executor
        self.result = None
        before = len(self._ready)
        allowed = self.pace.latency
        self.pace.begin(self.sensing_took)
        try:
            with undisturbed():
                self._plan(t)
        except ElasticStripsError as error:
            executor.reject(f"{type(error).__name__}: {error}")
            executor.log("fault", str(error))
        except Exception as error:
            _log.exception("planning tick failed")
            self.planner.reset()
            executor.reject(f"planning failed: {type(error).__name__}: {error}")
            executor.log("fault", f"planning exception: {type(error).__name__}: {error}")
        result = self.result
        charged = self.pace.finish(full=bool(result and result.timings))
        self._ready[before:] = [(due + charged, ready, proven) for due, ready, proven in self._ready[before:]]
        seconds = perf_counter() - began - (self._plans.submitting - submitting)  # plans are no part of the tick
        reason = (result.reason if result else "") or self.reason
        status = result.report.status.value if result else ""
        self.tick = Tick(t, seconds, result, self.strip.coordinates, executor.active.end_time, status, reason)
        self.statistics.add(seconds, late=(charged or seconds) > allowed)
        return charged

    def _plan(self, t: float) -> None:
        params, executor = self.params, self.executor
        if executor.waits:
            return
        if self._trouble or self._newest is None:
            executor.reject(self._trouble)
            executor.log("fault", self._trouble)
            return
        scene = self._newest
        old = stale(t, scene, params.max_scene_age)
        if old:
            executor.reject(old)
            executor.log("fault", "stale scene")
            return
        if self._here is not None and self._here.period.seconds > params.monitor.longest_period:
            slow = f"the control loop runs at {1.0 / self._here.period.seconds:.1f} Hz"
            executor.reject(f"{slow}; motions are followed from {1.0 / params.monitor.longest_period:.0f} Hz on")
            executor.log("fault", slow)
            return
        self.scene = scene
        if executor.lost_for > 0.1:
            executor.reject("odometry lost")
            return
        if self._no_path:  # the strip leads to the previous goal
            executor.reject(self._no_path)
            return
        waiting, at_rest = self._replan(t), executor.at_rest(t)
        evades = self.planner.evasion is not None and any(o.motion is not None for o in scene)
        if (waiting and at_rest and not evades) or self._rest_of_goal(t, scene):
            return
        self._allow()
        begin = self._begin(t)
        if at_rest and t >= executor.active.end_time + params.settle_time:
            executor.anchor(stationary(self.robot, self.limits, np.array(executor.estimate), begin, params.control_dt))
        result = self.result = self.plan_tick(t, scene, executor.active, begin)
        if result.late:
            executor.log("fault", f"late tick: it is ready only after {result.late:.2f} s")
        if not waiting:
            self.replanner.work_beside(scene, result.report.strip, self._plans.submit)
            due = self.replanner.watch(t, result, scene, at_rest=at_rest)
            if due:
                executor.log("replanning", due)
        if not waiting or result.outcome in (PlanOutcome.EVADE, PlanOutcome.BRAKE):
            self._decide(t, result)

    def _allow(self) -> None:
        """Plan with as large a tracking error as the estimate asks for."""
        params, executor = self.params, self.executor
        allowed = min(executor.needed_error, max(params.monitor.largest, params.tracking_error))
        before = self.planner.margins.tracking_error
        if allowed == before:
            return
        if min(before, allowed) == params.tracking_error:
            coarse = f"coarse: known to {1e3 * executor.coarse:.0f} mm"
            self.log("localization", coarse if allowed > before else "as good as assumed again")
        self.planner.allow(allowed)
        self.replanner.deform = self.planner.deformer.params

    def _decide(self, t: float, result: PlanResult) -> None:
        """Replace, brake or hold the active trajectory, or let it go on to its end."""
        outcome, proven = result.outcome, self.planner.margins.tracking_error
        if self.replanner.halted and outcome not in (PlanOutcome.BRAKE, PlanOutcome.EVADE):
            self.executor.reject(self.replanner.no_way or f"the strip is broken: {result.report.certificate.broken}")
        elif outcome is PlanOutcome.BRAKE or result.accepted:
            self._ready.append((t + result.late, result, proven))
        elif outcome is PlanOutcome.UNCHANGED:
            self.executor.hold(result.reason, proven)
        else:
            self.executor.reject(result.reason)

    def _begin(self, t: float) -> float:
        """Start time [s] of a motion that is planned now; where the executor runs elsewhere, one of its periods."""
        begin, dt = t + self.pace.latency, self.params.control_dt
        return begin if self._here is not None else dt * float(np.ceil(begin / dt - 1e-6))

    def _publish(self, t: float) -> None:
        """Hand planned motions that are ready by time ``t`` [s] to the executor."""
        ready = [entry for entry in self._ready if entry[0] <= t + 1e-9]
        self._ready = [entry for entry in self._ready if entry[0] > t + 1e-9]
        for _, result, proven in ready:
            if result.outcome is PlanOutcome.BRAKE:
                self.executor.brake(result.reason)
            elif result.motion is not None and result.certificate is not None:
                at_goal = result.outcome is PlanOutcome.ARRIVE
                self.executor.submit(result.motion, result.certificate, at_goal=at_goal, proven=proven)

    def _rest_of_goal(self, t: float, scene: Scene) -> bool:
        """Whether the active trajectory ends at the goal and is still certified: then there is nothing to plan."""
        executor = self.executor
        if not executor.at_goal or executor.at_rest(t):
            return executor.at_goal
        certificate = self.planner.certify(executor.active.tail(self._begin(t)), scene)
        if certificate.certified:
            executor.hold("the motion ends at the goal", self.planner.margins.tracking_error)
        return certificate.certified

    def _replan(self, t: float) -> bool:
        """Start planning a strip where that is due, and take it when it is ready; True while the robot waits for it.

        It begins where the robot will come to rest, and is taken when it stands there. A robot that evades takes it at
        once: it will stand elsewhere, and joins the strip from wherever that is, as any that it has left. Where it
        brakes, and will stand elsewhere for that, a strip from there is planned instead.
        """
        if self._next_plan is not None:
            if not self._next_plan.done():
                return True
            self._set_out(self._next_plan)
        replanner, executor = self.replanner, self.executor
        if not replanner.pending and self._replan_task is None:
            return False
        end = executor.active.coordinates[-1]
        stands = not (self.reference.v.any() or self._apart(self.reference.coordinates, end))
        beside = self._joins_from_beside(end, stands)
        if self._replan_task is None and t >= replanner.due:
            start = self.robot.space.from_coordinates(end)
            self._replan_from = end
            self._replan_task = self._plans.submit(replanner.another(self.scene, start, self.goal_q))
        if self._replan_task is not None and self._replan_task.done() and (stands or beside):
            self._take(self._replan_task, beside)
        return True

    def _set_out(self, plan: Future[PlanReport]) -> None:
        """Follow the first strip to another goal."""
        self._next_plan = None
        try:
            report = plan.result()
        except Exception as error:  # on any error: the present strip leads to another goal
            self._no_path = f"no way to the goal: {error}"
            raise
        self.executor.log("goal", report.reason)
        self.replanner.begin(report)
        self.planner.take(report.strip)

    def _joins_from_beside(self, end: Array, stands: bool) -> bool:
        """Whether the robot joins the strip that is ready from beside it, because it evades.

        A strip is discarded that begins where a robot that brakes will not stand.
        """
        task = self._replan_task
        if task is None or not task.done():
            return False
        apart = self._apart(self._replan_from, end)
        beside = self.planner.off_strip and (apart or not stands)
        if apart and not beside:  # it braked
            self._finish(task, self.replanner.discard)
        return beside

    def _take(self, plan: Future[Replanned], beside: bool) -> None:
        """Follow a strip that was planned anew, if there is one."""
        found = self._finish(plan, self.replanner.take)
        if found.strip is not None:
            self.planner.take(found.strip, beside=beside)
        self.executor.log("replanned", found.reason)

    def _finish(self, plan: Future[Replanned], told: Callable[[Replanned], None]) -> Replanned:
        """The outcome of a plan, told to the replanner in any case; what has failed is raised after that."""
        self._replan_task = None
        error = plan.exception()
        found = plan.result() if error is None else Replanned(None, "")
        told(found)
        if error is not None:
            raise error
        return found

    def _apart(self, one: Array, other: Array) -> bool:
        """Whether a strip that begins at one configuration does not begin at another."""
        return float(np.abs(self.robot.space.difference(one, other)).max(initial=0.0)) > _STRIP_START_OFFSET
