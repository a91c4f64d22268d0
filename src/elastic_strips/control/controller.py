"""Controller: the planning loop of a robot, around an executor; measurements and scenes in, commands out, step by step.

It has no access to a simulator's true state: the robot's state is estimated from measurements, obstacles come from
sensed scenes.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Executor as Workers
from dataclasses import dataclass
from time import perf_counter
from typing import TypedDict

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.collision.path_rows import path_rows
from elastic_strips.errors import ConfigurationError, ElasticStripsError, GoalError, RobotError, SceneError
from elastic_strips.planning import Goal, PlanReport
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.trajectory import stationary
from elastic_strips.validation import check_able, check_count, check_number, check_type, named_arguments

from .executor import ExecutorLink, MotionExecutor
from .goal_keeper import GoalKeeper, may_leave, may_look
from .interfaces import Command, Event, GoalReached, Measurement, RunState
from .itinerary import Goals, configuration_of, goals_in_order
from .local_planner import LocalPlanner
from .monitor import SceneMonitor
from .pace import Pace
from .params import DriveParams, Tolerance
from .process.priority import keep_memory, undisturbed
from .record import TickStatistics
from .replanning import Replanner
from .retreat import Retreat
from .strip_timer import PlanOutcome, PlanResult
from .vantage import Vantage

_log = logging.getLogger(__name__)
KEPT_EVENTS = 500
"""Events that are kept by default: a robot may run for days."""
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
    why = f": {scene.held_up}" if scene.held_up else ""
    return f"stale scene: {age:.2f} s old, at most {most:g} s{why}"


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
        goal: configuration (nq,), a :class:`~elastic_strips.HandPose`, a :class:`~elastic_strips.BasePose`, coordinates
            by name; or several of these, one after the other, each of which may be a list of which any will do.
        scene: obstacles known before the first step; none where None.
        params: parameters of the drive.
        limits: limits of the motors; read off the robot where None.
        strip: first strip, such as `repair` makes of another planner's path; planned where None.
        path: waypoints (K, 2) [m] that the first plan tries first.
        grid: whether plans may use a path over a grid.
        replanner: decides when a strip is replanned, and how; a :class:`Replanner` where None.
        workers: run plans while the control loop goes on, one after the other; an own thread where None.
        seed: of the planner.
        events: the newest events and stops that are kept at least; all where None.
        executor: one that runs elsewhere, with the same robot, limits, start and goal; one of its own where None.
        meter: reading [s] of the clock that computing is measured with; motions begin later where planning takes
            longer. None where it takes no time.

    Attributes:
        first_plan: report of the first strip's plan; None where the strip was given, or there is none yet.
        scene: the newest scene that was planned with.
        result: result of the last planning tick; None where it gave none.
        plan_tick: function that plans in a tick; it may be replaced by a wrapper.
        time: of the last step [s].
        tick: the last planning tick, or None.
        statistics: durations of the planning ticks.
        sensing_took: time [s] that the perception took for what comes next, by the clock that computing is measured
            with.
        executor, planner, replanner, keeper, pace: the parts.

    Raises:
        ConfigurationError: start or goal is not valid, or in collision; or the strip is another robot's. Where sensors
            that see what is free show something too near the start, and not in the robot, it begins, and gets away from
            that first.
        GoalError: no configuration that is free reaches the first goal. Where the scene is of sensors that see what is
            free, and a hand is to be there, the robot looks at it from nearer first.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> scene = es.Scene([es.Box((0.4, 0.4, 1.0), at=(1.6, 0.35, 0.5), name="shelf")])
        >>> with es.Controller(robot, start=robot.home(), goal=robot.home(x=3.0), scene=scene) as controller:
        ...     command = controller.step(0.0, None, scene)  # time, measurement, scene; from then on every 10 ms
        >>> command.drive.shape, command.joints.shape  # for the motors
        ((2,), (7,))
    """

    @named_arguments
    def __init__(
        self,
        robot: RobotModel,
        start: npt.ArrayLike,
        goal: Goals,
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
        if strip is not None:
            path_rows(robot, strip)  # which refuses another robot's
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
        first, *following = goals_in_order(robot, goal)
        self.scene: Scene = Scene([]) if scene is None else scene
        self.first_plan: PlanReport | None = None
        self.replanner: Replanner = replanner or Replanner(robot, self.params, seed=seed, grid=grid)
        looks = False  # whether it has to look at the goal from nearer, before there is a strip to it
        if strip is None:
            plan = self.replanner.first(self.scene, start, first, path=path)
            try:
                self.first_plan = plan()
                self.replanner.begin(self.first_plan)
                strip = self.first_plan.strip
            except (ConfigurationError, GoalError) as error:
                at_goal = isinstance(error, GoalError) or configuration_of(robot, first) is not None  # not at the start
                looks = at_goal and may_look(robot, self.scene, first, self.replanner.deform)
                looks = looks or may_leave(robot, self.scene, start, self.replanner.deform)
                if not looks:
                    raise
                strip = Strip.from_coordinates(robot, np.array([self.start, self.start]))
        goal_q = None if looks else configuration_of(robot, first)
        goal_q = strip.q[-1] if goal_q is None else goal_q
        self.pace: Pace = Pace(self.params, meter, transfer=0 if executor is None else 1)
        self.planner: LocalPlanner = LocalPlanner(robot, self.limits, self.params, strip, self.pace)
        self.plan_tick: PlanTick = self.planner.tick
        self._here: MotionExecutor | None = None
        if executor is None:
            executor = self._here = MotionExecutor(
                robot,
                self.limits,
                self.params,
                self.start,
                robot.space.to_coordinates(goal_q),
                self.params.tolerance,
                keep=events,
            )
        self.executor: ExecutorLink = executor
        self._retreat = Retreat(executor, self.planner)
        self._vantage: Vantage | None = None
        if robot.space.planar:
            self._vantage = Vantage(executor, self.planner, self._retreat.way, self._plan_from_here)
        self.keeper: GoalKeeper = GoalKeeper(
            self.start,
            goal_q,
            goal_q if looks else first,  # for now it is to stay where it is
            following,
            executor,
            self.planner,
            self.replanner,
            self.params,
            workers,
            self._forget_motions,
        )
        self.result: PlanResult | None = None
        self._doubts = SceneMonitor(self.params.monitor, self.params.assumptions)
        self._recoveries = 0
        self._speed = 1.0  # part of the full speed
        self._active: Trajectory = self.executor.active  # of the planning tick
        self._proven = self._due = self.params.tracking_error  # [m] what it is certified with, and ought to be
        self._ready: list[tuple[float, PlanResult, float]] = []  # due when [s], what, proven with [m]
        self._newest, self._trouble = scene, "" if scene is not None else "no scene has arrived yet"
        self._stopping = ""
        self._next_tick = 0  # number of the step with the next planning tick
        if looks:
            self.keeper.retarget(0.0, goal, self.scene, 0.0)

    def __enter__(self) -> Controller:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the planning thread; a running plan is waited for."""
        self.keeper.plans.close()

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
    def goals(self) -> list[Goal | Sequence[Goal]]:
        """Goals after the present one."""
        return self.keeper.goals

    @property
    def goal_q(self) -> Array:
        """Configuration (nq,) of the present goal; while the way to it is planned, of the one before."""
        return self.keeper.goal_q

    @property
    def goal(self) -> Array:
        """Its coordinate row (nv,)."""
        return self.keeper.goal

    @property
    def goals_reached(self) -> list[GoalReached]:
        """The goals that were reached so far, in order of time."""
        return self.keeper.reached

    @property
    def tolerance(self) -> Tolerance:
        """How near counts as reached."""
        return self.keeper.tolerance

    @property
    def replans(self) -> int:
        """How often a strip was replanned."""
        return self.replanner.count

    @property
    def reference(self) -> ReferenceState:
        """State that the robot follows at the time of the last step."""
        return self.executor.reference(self.time)

    @property
    def strip(self) -> Strip:
        """The strip that is followed."""
        return self.planner.strip

    def ahead(self, seconds: float, step: float = 0.2) -> Array:
        """Where the strip leads: coordinate rows (K, nv), as fast as the limits allow; for sensors that look ahead.

        Args:
            seconds: how far ahead [s].
            step: from row to row [s].
        """
        rows = self.strip.coordinates
        times = self.planner.arrival(rows)
        at = np.arange(0.0, min(seconds, float(times[-1])) + step, step)
        after = np.clip(np.searchsorted(times, at, side="right"), 1, len(rows) - 1)
        part = np.clip((at - times[after - 1]) / np.maximum(times[after] - times[after - 1], 1e-9), 0.0, 1.0)
        space = self.robot.space
        return np.array(
            [
                space.integrate(rows[i - 1], s * space.difference(rows[i - 1], rows[i]))
                for i, s in zip(after.tolist(), part.tolist(), strict=True)
            ]
        )

    @property
    def reached(self) -> int:
        """How many of the goals have been reached."""
        return len(self.goals_reached)

    @property
    def plans_next(self) -> bool:
        """Whether the next step has a planning tick, which needs a scene."""
        stands = bool(self._stopping) and self.executor.at_rest(self.time)
        return not stands and self._steps >= self._next_tick

    @property
    def pause(self) -> float:
        """Time [s] from the beginning of the last planning tick to the next one: half of the period of the planning
        where that one had the strip's step alone, as the two together take too long."""
        period = self.params.plan_every * self.params.control_dt
        return 0.5 * period if self.planner.prepared else period

    @property
    def ended(self) -> bool:
        """Whether the last goal is reached."""
        keeper = self.keeper
        return self.state is RunState.REACHED and not (self.goals or keeper.planning or keeper.next_path)

    @property
    def halted(self) -> bool:
        """Whether the robot was to :meth:`stop`, or its goal was cancelled, and it stands."""
        return bool(self._stopping or self.keeper.cancelled) and self.executor.at_rest(self.time)

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

    def retarget(self, goal: Goals) -> None:
        """Take another goal, or several one after the other, in place of all that there were.

        The way to it is planned while the robot drives on; the next motion goes on from the active one, without a stop
        where the way to the new goal leads on. Where no way is found, the robot comes to rest, and
        :attr:`reason` says why.

        Args:
            goal: as for the :class:`Controller`.

        Raises:
            ConfigurationError: a configuration that is not valid.
        """
        self.keeper.retarget(self.time, goal, self.scene, self.pace.latency)

    @named_arguments
    def follow(
        self, path: npt.ArrayLike, *, within: float, wait: bool = True, joints: npt.ArrayLike | None = None
    ) -> None:
        """Follow a path of the base, such as another planner's, in place of all goals.

        The strip is drawn to the path, and every motion that is driven is proven to keep to it within the distance, the
        tracking error included. Where something is in the way, the robot gives way as far as that, or waits; it plans
        no other way. :attr:`reason` says what it waits for.

        Args:
            path: waypoints (K, 2) x, y [m] or (K, 3) with the heading [rad] at the end; the robot begins next to where
                it is.
            within: largest distance [m] of the base's origin from the path; more than the tracking error.
            wait: whether the robot waits where it cannot go on; else the path is given up, as by :meth:`cancel`, with
                the reason.
            joints: (n,) positions [rad or m] as the joints are to be on the way. Where they are elsewhere, the robot
                first comes to rest, and moves them before it sets out; its base may give way meanwhile. None: as they
                are now, or were to be on a path that is followed now. Either way they give way to what is near, and
                return.

        Raises:
            ParameterError: a path of another shape, or a distance that is too small.
            ConfigurationError: the robot's base is fixed, or further from the path than that; a joint beyond its range.
        """
        self.keeper.follow(self.time, path, within, wait, joints, self.pace.latency)

    def cancel(self, reason: str = "the goal was cancelled") -> None:
        """Give up the goal and all after it: the robot comes to rest, and stands until :meth:`retarget`.

        Args:
            reason: becomes the reason of the state.
        """
        self.keeper.cancel(reason)

    def set_speed(self, part: float) -> None:
        """Drive more slowly, or as fast as before: the motions that are planned from now on.

        Args:
            part: of the speeds that ``params`` allow, in [0, 1]; 0: the robot comes to rest, and waits.

        Raises:
            ParameterError: a part outside its range.
        """
        self._speed = check_number("part", part, low=0.0, high=1.0)
        if self._speed > 0.0:
            self.planner.timer.slow_down(self._speed)

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
        self.keeper.forget_replan()
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
            every = self.pause / period
            self._next_tick = self._steps + max(1, round(every), int(np.ceil(seconds / period - 1e-9)))
        self._publish(t)
        command = self._here.command(t)
        self.keeper.count(t)
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
        self.keeper.count(t)
        self._see(t, scene, trouble)
        if not self._stopping or not self.executor.at_rest(t):
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
                (self._newest, wrong), self._trouble = self._doubts.motions.checked(t, scene), ""
                for reason in wrong:
                    self.log("fault", reason)
        if trouble:
            self._trouble = trouble
        if self.executor.recoveries > self._recoveries:  # the robot is somewhere beside its strip
            self._recoveries = self.executor.recoveries
            self._plan_from_here(t)
        self.keeper.set_out(t, self.scene, self.pace.latency)

    def _plan_from_here(self, t: float) -> None:
        """The robot stands somewhere else than its strip begins: another one is planned."""
        self._ready.clear()
        self.replanner.demand(t + self.params.replan_time)

    def _forget_motions(self) -> None:
        """Forget motions that are planned, but have not begun; brakes that are due stay."""
        self._ready = [entry for entry in self._ready if entry[1].outcome is PlanOutcome.BRAKE]

    # the planning loop

    def _planning_tick(self, t: float) -> float:
        """Plan; on any failure the active trajectory is driven to its end, and the reason is logged.

        Returns:
            What it took [s], by the meter.
        """
        began, submitting = perf_counter(), self.keeper.plans.submitting
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
        seconds = perf_counter() - began - (self.keeper.plans.submitting - submitting)  # plans are no part of the tick
        reason = (result.reason if result else "") or self.reason
        status = result.report.status.value if result else ""
        self.tick = Tick(t, seconds, result, self.strip.coordinates, executor.active.end_time, status, reason)
        self.statistics.add(seconds, late=(charged or seconds) > allowed)
        return charged

    def _plan(self, t: float) -> None:
        params, executor = self.params, self.executor
        self._retreat.note(self.reference.coordinates)
        if executor.waits and executor.waits != executor.contact:
            self._watch_stop(t)
            return
        if self._trouble or self._newest is None:
            executor.reject(self._trouble)
            executor.log("fault", self._trouble)
            return
        scene = self._newest
        if self._vantage is not None:
            scene = self._vantage.scene(t, scene, no_way=bool(self.keeper.no_way or self.replanner.no_way))
        old = stale(t, scene, params.max_scene_age)
        if old:
            executor.reject(old)
            executor.log("fault", f"stale scene: {scene.held_up}" if scene.held_up else "stale scene")
            return
        if self._here is not None and self._here.period.seconds > params.monitor.longest_period:
            slow = f"the control loop runs at {1.0 / self._here.period.seconds:.1f} Hz"
            executor.reject(f"{slow}; motions are followed from {1.0 / params.monitor.longest_period:.0f} Hz on")
            executor.log("fault", slow)
            return
        if scene.remark:
            executor.log("fault", scene.remark)
        self.scene = scene
        if executor.lost_for > 0.1:
            executor.reject("odometry lost")
            return
        if self._retreat.backs_off(t, self._begin(t), scene, stuck=self._stuck):
            return
        goes = self.keeper.path is None and not (self.keeper.cancelled or executor.at_goal)
        if self._vantage is not None and goes and self._speed:
            speed = self._speed * params.speed_scale
            if self._vantage.looks(t, self._begin(t), scene, speed):
                self._watch_stop(t)
                return
        stops = self.keeper.no_way or ("the speed is set to 0" if self._speed == 0.0 else "")
        if stops:  # the strip leads to the previous goal, or nowhere for now
            executor.reject(stops)
            self._watch_stop(t)
            return
        if self.keeper.looks_here(t) and not self.keeper.planning:
            executor.reject("it looks at its goal from here")
            return
        self._prove_again(t, scene)
        waiting, at_rest = self.keeper.path is None and self.keeper.replan(t, scene), executor.at_rest(t)
        evades = self.planner.evasion is not None and any(o.motion is not None for o in scene)
        if (waiting and at_rest and not evades) or self._rest_of_goal(t, scene):
            return
        self._allow()
        begin = self._begin(t)
        if at_rest and t >= executor.active.end_time + params.settle_time:
            # From now on: from a time to come on the robot would count as moving until then.
            executor.anchor(stationary(self.robot, self.limits, np.array(executor.estimate), t, params.control_dt))
            self._active = executor.active
        self.keeper.look_onward(scene)
        result = self.result = self.plan_tick(t, scene, self._active, begin)
        if self.planner.passed is not None:
            self.keeper.pass_goal(*self.planner.passed)
        if self._vantage is not None:
            self._vantage.note(t, result, scene, stands=at_rest)
        if result.late:
            executor.log("fault", f"late tick: its result comes only after {result.late:.2f} s")
        if self.keeper.path is not None:
            if self.keeper.blocked(t, self.keeper.path, result, at_rest):
                return
        elif not waiting:
            self.replanner.work_beside(scene, result.report.strip, self.keeper.plans.submit)
            due = self.replanner.watch(t, result, scene, at_rest=at_rest)
            if due:
                executor.log("replanning", due)
        drives_on = self.keeper.drives_on(t)
        if not waiting or drives_on or result.outcome in (PlanOutcome.EVADE, PlanOutcome.BRAKE):
            self._decide(t, result)

    def _watch_stop(self, t: float) -> None:
        """While the robot comes to rest and nothing else is planned, brake harder where a scene is not what the motion
        was certified for, and it is certified no longer."""
        scene, executor = self._newest, self.executor
        if scene is None or executor.at_rest(t) or stale(t, scene, self.params.max_scene_age):
            return
        broken = self.planner.refuted(executor.active, scene, self._begin(t))
        if broken:
            executor.brake(broken)

    @property
    def _stuck(self) -> bool:
        """Whether the robot is to go on to a goal, and the last planning tick found no motion."""
        if self.executor.at_goal or self.keeper.cancelled or self._speed == 0.0:
            return False  # it is to stand where it is
        result = self.tick.result if self.tick is not None else None
        return bool(self.keeper.no_way) or result is None or not result.accepted

    def _prove_again(self, t: float, scene: Scene) -> None:
        """Certify the active motion with a larger error, where the robot comes near to what it was proven with."""
        executor = self.executor
        self._active, self._proven = executor.active, self.planner.margins.tracking_error
        self._due = due = max(executor.due_error, self._allowed)
        if due <= self._proven or executor.at_rest(t):
            return
        if self.planner.certify(self._active.tail(t), scene, due).certified:
            self._proven = due
            executor.hold(self.reason, self._active, due)

    @property
    def _allowed(self) -> float:
        """Tracking error [m] that the estimate asks for, as far as motions are planned for that."""
        return min(self.executor.needed_error, max(self.params.monitor.largest, self.params.tracking_error))

    def _allow(self) -> None:
        """Plan with as large a tracking error as the estimate asks for."""
        params, executor, allowed = self.params, self.executor, self._allowed
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
        outcome, proven, due = result.outcome, self.planner.margins.tracking_error, self._due
        if outcome is PlanOutcome.UNCHANGED:
            self.executor.hold(result.reason, self._active, self._proven)
        elif result.accepted and due > proven and result.motion is not None:
            proven = due if self.planner.certify(result.motion, self.scene, due).certified else proven
        if self.replanner.halted and outcome not in (PlanOutcome.BRAKE, PlanOutcome.EVADE):
            self.executor.reject(self.replanner.no_way or f"the strip is broken: {result.report.certificate.broken}")
        elif outcome is PlanOutcome.BRAKE or result.accepted:
            self._ready.append((t + result.late, result, proven))
        elif outcome is not PlanOutcome.UNCHANGED:
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
                at_goal = result.outcome is PlanOutcome.ARRIVE and not (self.keeper.planning or self.keeper.looks)
                self.executor.submit(result.motion, result.certificate, at_goal=at_goal, proven=proven)

    def _rest_of_goal(self, t: float, scene: Scene) -> bool:
        """Whether the active trajectory ends at the goal and is still certified: then there is nothing to plan, unless
        the robot may go on from there."""
        executor = self.executor
        if self.keeper.goes_on and not executor.at_rest(t):
            return False
        if not executor.at_goal or executor.at_rest(t):
            return executor.at_goal
        proven = self._proven
        done = proven > self.planner.margins.tracking_error  # just now
        certified = done or self.planner.certify(self._active.tail(t), scene, proven).certified
        if certified:
            executor.hold("the motion ends at the goal", self._active, proven)
        return certified
