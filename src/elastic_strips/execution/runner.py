"""Execution room, runner: the closed loop of planning, tracking and driving, in simulated time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from time import perf_counter, sleep

import numpy as np
import numpy.typing as npt

from ..errors import RobotError
from ..planning import PlanReport
from ..robot import RobotModel
from ..scene import Scene, World
from ..strip import Strip
from ..validation import check_able, check_count, check_number, check_type
from .bystanders import Bystanders
from .estimation import Estimator
from .faults import Fault, FaultPlan
from .limits import MotionLimits
from .params import DriveParams
from .perception import Perceiver, Perception, PerceptionParams
from .pilot import Pilot
from .planning_loop import PlanningLoop
from .plant import KinematicPlant, Plant, PlantParams
from .proposal import Proposal
from .record import Record, RunState
from .recorder import Recorder
from .replanning import Replanner
from .result import DriveResult, TickStatistics
from .supervisor import Supervisor, standstill
from .tracking import TrackingController, TrackingGains
from .verdict import Tolerance

_log = logging.getLogger(__name__)
MACHINE = PlantParams(speed_margin=1.0, acceleration_margin=1.0)
"""A machine that can do exactly what its limits say; motions are planned with less (``DriveParams.ease_*``)."""

_KEPT = 500  # events that are kept where nothing is recorded: such a run may last for days
Watch = Callable[["Runner"], object]


class Runner:
    """Workspace: drives a robot through a world, from start to goal.

    Args:
        robot: the robot.
        world: the true obstacles over time; a :class:`Scene` stands still or moves as its obstacles say.
        start: configuration (nq,).
        goal: configuration (nq,), or several of them (G, nq), one after the other.
        params: of the drive.
        limits: of the motors; read off the robot where None.
        strip: the strip to begin with; planned where None.
        path: waypoints (K, 2) [m] that the first plan tries before all else.
        grid: whether plans may use a way over a grid.
        plant: the machine; a :class:`KinematicPlant` where None.
        perception: noise and delay of the sensed scene; or what senses it.
        replanner: decides when a strip is planned anew, and does it; one of its own where None.
        faults: what goes wrong on purpose.
        seed: of the first plan, of the plant and of what is sensed.
        watch: called after every planning tick, with this runner; what it raises is logged and goes no further.
        realtime: whether to wait for the wall clock.
        record: whether to write down every step; without it a result has a record of the last step only, and the newest
            few hundred events.
        metadata: plain JSON values to keep with the record.

    Raises:
        ConfigurationError: start or goal is not sound, or in collision.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World | Scene,
        start: npt.ArrayLike,
        goal: npt.ArrayLike,
        *,
        params: DriveParams | None = None,
        limits: MotionLimits | None = None,
        strip: Strip | None = None,
        path: npt.ArrayLike | None = None,
        grid: bool = True,
        plant: Plant | None = None,
        perception: PerceptionParams | Perceiver | None = None,
        replanner: Replanner | None = None,
        faults: Iterable[Fault] = (),
        seed: int = 0,
        watch: Watch | None = None,
        realtime: bool = False,
        record: bool = True,
        metadata: dict[str, object] | None = None,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("params", params, DriveParams, none=True)
        check_type("limits", limits, MotionLimits, none=True)
        check_type("strip", strip, Strip, none=True)
        check_able("plant", plant, "reset", "step")
        check_able("replanner", replanner, "plan")
        check_able("watch", watch)
        if not isinstance(perception, PerceptionParams):
            check_able("perception", perception, "known", "sense")
        check_count("seed", seed)
        self.robot, self.params = robot, params or DriveParams()
        self.world = world if isinstance(world, World) else World(world)
        self.bystanders = Bystanders(robot, self.world)
        self.limits = limits or MotionLimits.for_robot(robot)
        self.faults = FaultPlan(faults)
        self.watch, self.realtime = watch, realtime
        plant_seed, sense_seed = np.random.SeedSequence(seed).spawn(2)
        self.plant: Plant = plant or KinematicPlant(robot, self.limits, MACHINE, seed=np.random.default_rng(plant_seed))
        self.perception: Perceiver
        if perception is None or isinstance(perception, PerceptionParams):
            rng, noise = np.random.default_rng(sense_seed), perception or PerceptionParams()
            self.perception = Perception(self.world, self.params.assumptions, noise, rng, self.faults)
        else:
            self.perception = perception
        goals = np.atleast_2d(robot.check_q(goal, what="goal"))
        self.goals = [goals[0], *goals[1:]]
        self.goal_q = self.goals.pop(0)
        self.goal = robot.space.to_chart(self.goal_q)
        first = robot.space.to_chart(robot.check_q(start, what="start"))
        self.time = 0.0
        self.first_plan: PlanReport | None = None
        self.replanner = replanner or Replanner(robot, self.params, seed=seed, grid=grid)
        if strip is None:
            self.first_plan = self.replanner.plan(self.perception.known(), start, self.goal_q, path=path)
            strip = self.first_plan.strip
        self.pilot = Pilot(robot, self.limits, self.params, strip)
        self.plant.reset(first)
        self.estimator = Estimator(robot, self.limits)
        self.estimator.reset(first, 0.0)
        self.estimate = first
        self.tracker = TrackingController(robot, self.limits, TrackingGains(headroom=1.0))
        resting = standstill(robot, self.limits, first, 0.0, self.params.control_dt)
        self.supervisor = Supervisor(resting, keep=None if record else _KEPT)
        last = robot.space.to_chart(goals[-1])
        self._new_recorder = lambda: Recorder(robot, self.world, goal=last, metadata=metadata or {})
        self.recorder, self._recording, self._step = self._new_recorder(), record, 0
        self.planning = PlanningLoop(
            self.pilot, self.supervisor, self.perception, self.replanner, self.faults, self.goal_q
        )
        self.statistics = TickStatistics()
        self._stop = False

    @property
    def tolerance(self) -> Tolerance:
        """How near counts as reached."""
        params = self.params
        return Tolerance(position=params.goal_position, yaw=params.goal_angle, joints=params.goal_angle)

    @property
    def scene(self) -> Scene:
        """The newest one that was sensed."""
        return self.planning.scene

    @property
    def proposal(self) -> Proposal | None:
        """What the last planning tick came to; None where it came to nothing."""
        return self.planning.proposal

    def stop(self) -> None:
        """Ask the loop to end: the held motion is driven to its rest first."""
        self._stop = True

    def run(self, *, time_limit: float | None = None) -> DriveResult:
        """Drive until the goal is reached, the time is over, or :meth:`stop` was called."""
        params, supervisor = self.params, self.supervisor
        limit = params.time_limit if time_limit is None else check_number("time_limit", time_limit, low=0.0, unit="s")
        began, first = perf_counter(), self._step
        while True:
            step = self._step
            t = self.time = step * params.control_dt
            over = t >= limit
            if step % params.plan_every == 0:
                if not self._stop and not over:
                    self._planning_tick(t)
                elif supervisor.state in (RunState.MOVING, RunState.SLOWING):  # who stands, stands for another reason
                    supervisor.keep("asked to stop" if self._stop else f"time limit of {limit:g} s", t)
            self.planning.hand_over(t)
            state = supervisor.update(t)
            self._control(t, state)
            self._step += 1
            if state is RunState.REACHED and self._settled():
                if not self.goals:
                    break
                self.retarget(self.goals.pop(0))
            if (self._stop or over) and supervisor.at_rest(t) and self._settled():
                break
            if self.realtime:
                ahead = began + (self._step - first) * params.control_dt - perf_counter()
                if ahead > 0.0:
                    sleep(ahead)
        return self._result(perf_counter() - began)

    def retarget(self, goal: npt.ArrayLike) -> None:
        """At rest, take another goal (nq,) and plan a strip to it."""
        self.goal_q = self.planning.goal = self.robot.check_q(goal, what="goal")
        self.goal = self.robot.space.to_chart(self.goal_q)
        self.supervisor.restart("new goal", self.time)
        q = self.robot.space.from_chart(self.supervisor.reference(self.time).chart)
        report = self.replanner.plan(self.scene, q, self.goal_q)
        self.supervisor.log(self.time, "goal", report.reason)
        self.pilot.take(report.strip)

    # the control loop

    def _control(self, t: float, state: RunState) -> None:
        params = self.params
        if self.faults.active("lost_odometry", t):
            self.plant.lost_odometry(t + params.control_dt)
            self.supervisor.log(t, "fault", "odometry lost")
        reference = self.supervisor.reference(t)
        estimate, base = self.estimate, self.robot.space.base_nv
        if self.estimator.lost_for > 0.0:  # to follow an estimate that stands still would be to run away
            estimate = np.concatenate((reference.chart[:base], estimate[base:]))
        command = self.tracker.command(reference, estimate)
        if not self._recording and len(self.recorder) > 100:
            self.recorder = self._new_recorder()
        self.recorder.control(
            t, chart=self.plant.chart, v=self.plant.v, reference=reference.chart, reference_v=reference.v,
            estimate=self.estimate, drive=command.drive, joints=command.joints, motors=self.plant.motors,
            state=int(state),
        )  # fmt: skip
        self.perception.observe(t, self.plant.chart, self.estimate)
        self.bystanders.step(t, self.plant.chart, self.plant.v)
        measurement = self.plant.step(command, params.control_dt)
        self.estimate = self.estimator.update(measurement)

    def _settled(self) -> bool:
        """Whether the robot truly stands; the plant's own truth, only to know when to stop recording."""
        return bool(np.abs(self.plant.v).max(initial=0.0) < 1e-3)

    # the planning loop

    def _planning_tick(self, t: float) -> None:
        params, supervisor = self.params, self.supervisor
        began = perf_counter()
        self.planning.tick(t, self.estimate, self.estimator.lost_for)
        seconds = perf_counter() - began
        proposal = self.proposal
        self.statistics.add(seconds, params.latency * params.control_dt)
        self.recorder.planning(
            t,
            tick_ms=1e3 * seconds,
            phase_ms={k: 1e3 * s for k, s in proposal.timings.items()} if proposal else {},
            status=proposal.report.status.value if proposal else "",
            certified=bool(proposal and proposal.report.certified),
            clearance=proposal.report.node_clearance if proposal else np.nan,
            horizon_end=supervisor.held.end_time,
            strip=self.pilot.strip.chart,
            reason=(proposal.reason if proposal else "") or supervisor.reason,
        )
        if self.watch is not None:
            try:
                self.watch(self)
            except Exception:  # a viewer that dies does not stop the robot
                _log.exception("the watcher failed")
                self.watch = None
                supervisor.log(t, "fault", "viewer lost")

    def _result(self, seconds: float) -> DriveResult:
        supervisor = self.supervisor
        for event in supervisor.events:
            self.recorder.event(event.time, event.kind, event.reason)
        record: Record = self.recorder.finish()
        return DriveResult(
            record=record,
            state=supervisor.state,
            reason=supervisor.reason,
            stops=tuple(supervisor.stops),
            events=tuple(supervisor.events),
            replans=self.replanner.count,
            statistics=self.statistics,
            seconds=seconds,
        )
