"""Executor: the work of every control period: measurements in, the active trajectory followed and watched,
commands out.

It needs only the next certified motion from the planner, and brings the robot to rest where none comes.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Protocol

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.errors import ParameterError, plural
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState, Retimer, Trajectory
from elastic_strips.trajectory.trajectory import stationary
from elastic_strips.validation import check_number

from .estimation import StateEstimator
from .interfaces import Command, Measurement, RunState
from .monitor import Monitor
from .pace import ControlPeriod
from .params import DriveParams, Tolerance
from .supervisor import RunLog, Supervisor
from .tracking import TrackingController

_TRACKING_ERROR_STEP = 0.005  # [m] in which the tracking error grows
_RELEASED = ": released, waiting for resume"
_STANDING_SPEED = 0.05  # [m/s, rad/s] a measured speed below this counts as standing


class ExecutorLink(Protocol):
    """The planner's view of an executor: its own one, or one in another process.

    Attributes:
        run: state, reason, events and stops of the robot.
        active: the trajectory that is executed; it ends at rest.
        at_goal: whether that trajectory ends at the goal.
        estimate: (nv,) estimated coordinate row.
        settled: whether the robot stands, by its measured speed.
        lost_for: time [s] without odometry.
        waits: why it takes no motions now; empty where it takes them.
        contact: what the robot touches by its last measurement; empty without a contact.
        coarse: error [m] of the estimated robot, by the estimator's standard deviations.
        needed_error: tracking error [m] that the present accuracy of the estimate requires.
        due_error: tracking error [m] that the active trajectory ought to be certified with by now, so that the robot
            need not brake.
        recoveries: how often the robot went on from a place off its reference.
    """

    @property
    def run(self) -> RunLog: ...
    @property
    def active(self) -> Trajectory: ...
    @property
    def at_goal(self) -> bool: ...
    @property
    def estimate(self) -> Array: ...
    @property
    def settled(self) -> bool: ...
    @property
    def lost_for(self) -> float: ...
    @property
    def waits(self) -> str: ...
    @property
    def contact(self) -> str: ...
    @property
    def coarse(self) -> float: ...
    @property
    def needed_error(self) -> float: ...
    @property
    def due_error(self) -> float: ...
    @property
    def recoveries(self) -> int: ...

    def reference(self, t: float) -> ReferenceState:
        """State to follow at time ``t`` [s]."""
        ...

    def at_rest(self, t: float) -> bool:
        """Whether the active trajectory has ended by time ``t`` [s]."""
        ...

    def submit(
        self, motion: Trajectory, certificate: Certificate, *, at_goal: bool, proven: float, leaving: bool = False
    ) -> None:
        """Offer a motion that continues the active trajectory.

        Args:
            motion: starts now or later.
            certificate: certificate of this motion.
            at_goal: whether its end is the goal.
            proven: tracking error [m] that it was certified with.
            leaving: whether it leads away from what the robot touches, and is taken though it touches that.
        """
        ...

    def brake(self, reason: str) -> None:
        """Come to rest on the path of the active trajectory, as fast as the motors can."""
        ...

    def hold(self, reason: str, motion: Trajectory, proven: float) -> None:
        """Note that a motion is still certified, if it is the active one.

        Args:
            reason: why the robot will stop at its end.
            motion: as :attr:`active` was.
            proven: tracking error [m] that it is certified with.
        """
        ...

    def reject(self, reason: str) -> None:
        """Note that there is no new motion, and why; the active trajectory goes on to its end."""
        ...

    def log(self, kind: str, reason: str) -> None:
        """Write down an event at the present time: its kind in one word, and a reason."""
        ...

    def planned(self) -> None:
        """Note that a planning tick is over, whatever its result."""
        ...

    def anchor(self, resting: Trajectory) -> None:
        """At rest, follow a trajectory that stays where the robot is estimated to be."""
        ...

    def retarget(self, goal: Array, tolerance: Tolerance) -> None:
        """Take another goal: its coordinate row (nv,), and how near counts as reached. The active trajectory goes on,
        and does not end there."""
        ...

    def stop(self, reason: str) -> None:
        """Take no more motions, and come to rest at the end of the active trajectory."""
        ...

    def resume(self) -> None:
        """Take motions again."""
        ...


class MotionExecutor:
    """Workspace: follows the active trajectory, watches what its certificate assumes, and brakes where that fails.

    In every control period: :meth:`measure`, then what the planner has (:meth:`submit`, …), then :meth:`command`.
    After a fault it goes on from where the robot is, as soon as that stands and is known.

    Args:
        robot: the robot.
        limits: limits of its motors.
        params: parameters of the drive.
        start: (nv,) coordinate row of the robot at rest.
        goal: (nv,) coordinate row of its goal.
        tolerance: how near counts as reached.
        keep: the newest events and stops that are kept at least; all where None.

    Attributes:
        time: time of the last step [s].
        estimator, monitor, supervisor, tracker: the parts.
        period: how long a control period lasts.
        contact: what the robot touches by its last measurement; empty without a contact.
        measured: [s] time of the measurement that the estimate is by.
        proven: tracking error [m] that the active trajectory was certified with.
        other attributes: see :class:`ExecutorLink`.
    """

    def __init__(
        self,
        robot: RobotModel,
        limits: MotionLimits,
        params: DriveParams,
        start: Array,
        goal: Array,
        tolerance: Tolerance,
        *,
        keep: int | None = None,
    ) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: DriveParams = params
        self.goal: Array = goal
        self.tolerance: Tolerance = tolerance
        self.time: float = 0.0
        self.period: ControlPeriod = ControlPeriod(params.control_dt)
        self.estimate: Array = np.array(start)
        self.estimator: StateEstimator = StateEstimator(robot, limits, params.sensing)
        self.estimator.reset(self.estimate, 0.0)
        self.monitor: Monitor = Monitor(robot, limits, params.monitor, params.control_dt)
        self.tracker: TrackingController = TrackingController(robot, limits, params.gains)
        resting = stationary(robot, limits, self.estimate, 0.0, params.control_dt)
        self.supervisor: Supervisor = Supervisor(resting, keep=keep)
        self._contact: str = ""
        self.proven: float = params.tracking_error
        self.recoveries: int = 0
        self._before = (-math.inf, self.proven)  # until when [s] the motion before is followed, and its error [m]
        self._retimer = Retimer(robot, limits, dt=params.sample_dt)
        self._halt = ""  # why the robot has to stand before it goes on from where it is
        self._beside = 0.0  # [m] how far it was off its reference since then
        self._recovered: deque[tuple[float, float]] = deque(maxlen=params.monitor.recoveries)  # when [s], from how far
        self._agreed_since: float | None = None  # since when it has stood, and nothing contradicts that
        self._stopping = self._emergency = ""  # why it takes no motions; the emergency stop that was pressed
        self._released = False  # whether that is not pressed any more
        self._power_cut: float | None = None  # since when [s]
        self._braked: Trajectory | None = None  # for the contact
        self._speed = 0.0
        self.measured: float = 0.0
        self._steps = 0

    @property
    def run(self) -> RunLog:
        return self.supervisor

    @property
    def active(self) -> Trajectory:
        return self.supervisor.active

    @property
    def at_goal(self) -> bool:
        return self.supervisor.at_goal

    @property
    def settled(self) -> bool:
        return self._speed < _STANDING_SPEED

    @property
    def lost_for(self) -> float:
        return self.estimator.lost_for

    @property
    def contact(self) -> str:
        return self._contact

    @property
    def waits(self) -> str:
        return self._halt or self._stopping or self.contact

    @property
    def coarse(self) -> float:
        return self.monitor.uncertainty

    @property
    def needed_error(self) -> float:
        """The error that is needed, in steps of 5 mm."""
        params = self.params
        needed = params.monitor.control_share * params.tracking_error + self.monitor.uncertainty
        return (
            params.tracking_error
            if needed <= params.tracking_error
            else math.ceil(needed / _TRACKING_ERROR_STEP) * _TRACKING_ERROR_STEP
        )

    @property
    def due_error(self) -> float:
        """The error that is due, in steps of 5 mm."""
        monitor, least = self.params.monitor, self.params.tracking_error
        due = (self._off + self.monitor.uncertainty) / max(monitor.prove_at * monitor.brake_at, 1e-9)
        due = math.ceil(due / _TRACKING_ERROR_STEP) * _TRACKING_ERROR_STEP
        return min(max(due, least), max(monitor.largest, least))

    @property
    def _off(self) -> float:
        """How far the robot is off its reference [m], as far as that is known."""
        return 0.0 if self.monitor.silent is not None else self.monitor.deviation

    def reference(self, t: float) -> ReferenceState:
        return self.supervisor.reference(t)

    def at_rest(self, t: float) -> bool:
        return self.supervisor.at_rest(t)

    # from the planner

    def submit(
        self, motion: Trajectory, certificate: Certificate, *, at_goal: bool, proven: float, leaving: bool = False
    ) -> None:
        waits = (self._halt or self._stopping) if leaving else self.waits
        if waits:
            self.reject(waits)
            return
        if motion.start_time < self.time - 1e-9:
            self.log("fault", "late tick")
        known, most = self.monitor.uncertainty, self.params.monitor.brake_at * proven
        if not self.at_rest(self.time) and self._off + known > most:
            may_be = 1e3 * (self._off + known)
            self.reject(
                f"the robot may be {may_be:.0f} mm off its reference, too much for the new motion's certificate"
            )
            return
        if self.supervisor.submit(motion, certificate, self.time, at_goal=at_goal):
            self._before, self.proven = (motion.start_time, self._proven(self.time)), proven
            if leaving:
                self._braked = motion  # what it touches is no reason to brake on it

    def _proven(self, t: float) -> float:
        """Tracking error [m] that the motion that is followed at time ``t`` [s] was certified with, and the next."""
        until, before = self._before
        return self.proven if t >= until else min(self.proven, before)

    def planned(self) -> None:
        """Nothing to do: who plans here cannot hang unnoticed."""

    def brake(self, reason: str) -> None:
        t, supervisor = self.time, self.supervisor
        begin = t + self.params.latency * self.params.control_dt
        supervisor.brake(self._retimer.brake(supervisor.active, begin), reason, t)

    def hold(self, reason: str, motion: Trajectory, proven: float) -> None:
        if motion is self.active:
            self.proven = proven
            self.supervisor.hold(reason)

    def reject(self, reason: str) -> None:
        self.supervisor.reject(reason, self.time)

    def log(self, kind: str, reason: str) -> None:
        self.supervisor.log(self.time, kind, reason)

    def anchor(self, resting: Trajectory) -> None:
        off = np.abs(self.robot.space.difference(self.estimate, resting.coordinates[0])).max(initial=0.0)
        if self.at_rest(self.time) and off <= self.proven and not (resting.steps.any() or resting.v.any()):
            self.supervisor.reset(resting)

    def retarget(self, goal: Array, tolerance: Tolerance) -> None:
        self.goal, self.tolerance = goal, tolerance
        self.supervisor.restart("new goal", self.time)

    def stop(self, reason: str) -> None:
        self._stopping = self._stopping or reason

    def resume(self) -> None:
        if self._emergency:
            self.supervisor.stand("resumed")
        self._stopping = self._emergency = ""
        self._released = False
        self._recovered.clear()
        self.estimator.trust()

    # in every control period

    def measure(self, t: float, raw: Measurement | None) -> None:
        """Take in those parts of a measurement that can be true.

        Args:
            t: time [s], later than at the last call by about ``params.control_dt``.
            raw: measured since then; None at the first call, when the robot stands, and where nothing came.

        Raises:
            ParameterError: a time that does not ascend.
        """
        if self._steps and not check_number("t", t, unit="s") > self.time:
            raise ParameterError(f"t={t!r} s must be later than the last step, at {self.time!r} s")
        began, self.time = self.time, t
        if self._steps:
            self.period.note(t - began)
        measurement = None
        if raw is not None:
            measurement, faults = self.monitor.measurement(t, raw, self.estimate)
            for fault in faults:
                self.log("fault", fault)
        elif self._steps:
            self.monitor.nothing(t)
        if measurement is not None:
            before, self.estimate = self.estimate, self.estimator.update(measurement)
            step = self.robot.space.difference(before, self.estimate)
            self._speed = float(np.abs(step).max(initial=0.0)) / max(t - began, 1e-9)
            self.measured = measurement.time
            if measurement.drive is None:
                self.log("fault", "odometry lost")
            if self.estimator.doubt:
                self.log("fault", self.estimator.doubt)
        if raw is not None:
            self._check_touch(raw)
        if self._halt:
            self._recover(t)

    def command(self, t: float) -> Command:
        """The command for the control period that begins at time ``t`` [s], that of the last measurement."""
        self._check_proof(t)
        self._check_arrival(t)
        if self._stopping and self.run.state in (RunState.MOVING, RunState.BRAKING):  # at rest it has another reason
            self.reject(self._stopping)
        self.supervisor.update(t)
        if self._emergency:
            self.supervisor.stand(self._emergency + _RELEASED * self._released)
        self._steps += 1
        command = self._command(t)
        self.monitor.commanded(t, command)
        return command

    def fail(self, reason: str) -> None:
        """Log a fault from outside this executor, and come to rest."""
        self.log("fault", reason)
        if not self.at_rest(self.time):
            self.brake(reason)

    def _check_touch(self, measurement: Measurement) -> None:
        """Brake at a contact, and where an emergency stop is pressed."""
        self._contact = measurement.contact
        if measurement.emergency and not self._emergency:
            self._emergency = self._stopping = measurement.emergency
            self.fail(measurement.emergency)
        if self._emergency and self._released is bool(measurement.emergency):
            self._released = not measurement.emergency
            self.log("emergency", self._emergency + _RELEASED * self._released)
        if not self.contact:
            self._braked = None
        elif self.active is not self._braked:
            self.log("fault", self.contact)
            self.brake(self.contact)
            self._braked = self.active
        else:
            self.reject(self.contact)

    def _check_proof(self, t: float) -> None:
        """Brake where what the active trajectory was proven with holds no longer."""
        monitor, supervisor, params = self.monitor, self.supervisor, self.params
        then = self.reference(min(self.measured, t)).coordinates
        monitor.follow(then, self.estimate, self.estimator)
        if monitor.motor_fault and self._power_cut is None:
            self.log("fault", monitor.motor_fault)
            self._power_cut = t
        off, known = self._off, monitor.uncertainty
        reason = monitor.motor_fault
        if not reason and monitor.silent is not None and t - monitor.silent >= params.monitor.silence:
            reason = f"no usable measurement for {t - monitor.silent:.2f} s"
        proven = self._proven(t)
        if not reason:
            reason = self.estimator.contradiction
        if not reason and off + known > params.monitor.brake_at * proven:
            reason = (
                f"the robot is {1e3 * off:.0f} mm off its reference, known to within {1e3 * known:.0f} mm, and the "
                f"proof allows for {1e3 * proven:.0f} mm"
            )
            if self.estimator.doubt:
                reason += f": {self.estimator.doubt}"
        beside = off > proven or bool(self.estimator.contradiction or monitor.motor_fault)
        if reason and not self._halt and (beside or not supervisor.at_rest(t)):
            self._halt = reason
            slipped = self.estimator.slipped
            self.log("fault", f"wheels slip: odometry is {1e3 * slipped:.0f} mm off; {reason}" if slipped else reason)
            if not supervisor.at_rest(t):
                self.brake(reason)
        if self._halt and off > proven:
            self._beside = max(self._beside, off)
            self.log("unproven", f"the robot is further off its reference than the proof assumes: {self._halt}")

    def _check_arrival(self, t: float) -> None:
        """At rest at the end of a motion to the goal, check whether the robot is there, too."""
        supervisor, off = self.supervisor, np.abs(self.robot.space.difference(self.goal, self.estimate))
        if self._halt or not supervisor.at_goal or not supervisor.at_rest(t) or self.run.state is RunState.REACHED:
            return
        base, wide = self.robot.space.base_nv, self.tolerance
        apart = float(np.hypot(*off[:2])) if base else 0.0
        turned = float(off[2]) if base else 0.0
        if apart <= wide.position and turned <= wide.yaw and float(off[base:].max(initial=0.0)) <= wide.joints:
            return
        self._halt = f"at rest {apart:.2f} m and {math.degrees(turned):.0f}° from the goal"
        self.log("fault", self._halt)
        supervisor.restart(self._halt, t)

    def _recover(self, t: float) -> None:
        """After a halt, go on from where the robot is, as soon as it stands and that is known."""
        supervisor, monitor, params = self.supervisor, self.monitor, self.params
        cut, why = self._power_cut, ""
        cooling = cut is not None and t < max(cut, self.active.end_time) + params.monitor.motor_wait
        if cooling or not (supervisor.at_rest(t) and self.settled):
            why = self._halt
        elif monitor.silent is not None:
            why = "no measurements arrive"
        elif self.estimator.lost_for > 0.0:
            why = "odometry was interrupted: only a fix of the base says where the robot is now"
        elif self.estimator.doubt:
            why = self.estimator.doubt
        elif self.needed_error > max(params.monitor.largest, params.tracking_error):
            why = f"the robot's position is known only to within {1e3 * self.coarse:.0f} mm"
        self._agreed_since = None if why else t if self._agreed_since is None else self._agreed_since
        why = why or self._again_and_again(t)
        if why:
            self.reject(why)
            return
        if self._beside:
            self._recovered.append((t, self._beside))
        self._power_cut, self._beside, self._agreed_since = None, 0.0, None
        self.log(
            "recovered",
            f"the robot goes on from {monitor.deviation:.2f} m beside its reference, after this: {self._halt}",
        )
        self._halt = ""
        supervisor.reset(stationary(self.robot, self.limits, np.array(self.estimate), t, params.control_dt))
        supervisor.restart("recovered", t)
        self.recoveries += 1

    def _again_and_again(self, t: float) -> str:
        """Why a robot that was found beside its reference again and again stands for a while; empty where it does not.

        Once it goes on, it stands so the next time that it is found there.
        """
        monitor, found = self.params.monitor, self._recovered
        if len(found) < monitor.recoveries or t - found[0][0] > monitor.recovery_span:
            return ""
        if self._agreed_since is not None and t - self._agreed_since >= monitor.recovery_pause:
            return ""
        most = 1e3 * max(far for _, far in found)
        why = (
            f"odometry and fixes contradict each other: within {found[-1][0] - found[0][0]:.0f} s the robot was found "
            f"{plural(len(found), 'time')} beside its reference, by at most {most:.0f} mm"
        )
        self.log("fault", why)
        return why

    def _command(self, t: float) -> Command:
        """Speeds that follow the reference; the base and joints that are not measured are not fed back."""
        space, reference, estimate = self.robot.space, self.reference(t), self.estimate
        base = space.base_nv
        if self._power_cut is not None or (self._emergency and self.run.state is RunState.STOPPED):
            return replace(self.tracker.rest, stop=True)
        if self.measured < t - 1e-6:  # since then it has moved about as the reference has
            then = self.reference(self.measured).coordinates
            estimate = space.integrate(estimate, space.difference(then, reference.coordinates))
        if self.estimator.lost_for > 0.0:  # feedback on a frozen estimate would drive the base away
            estimate = np.concatenate((reference.coordinates[:base], estimate[base:]))
        if self.monitor.silent is not None:
            estimate = reference.coordinates
        older = 0.5 * (self.period.seconds - self.params.control_dt)  # than the gains assume commands to be
        return self.tracker.command(reference, estimate, older)
