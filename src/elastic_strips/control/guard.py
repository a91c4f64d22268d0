"""Guard: the commands of others, in every control period; what is driven of them is certified down to its stop.

A joystick, a servo or a learned policy says what it wants. What cannot be certified is bent as little as can be, and
the answer says how much was taken, and why.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from typing import Annotated

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet, Certificate
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError, SceneError, nearest_name
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.scene import Scene
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory, TrajectoryCertifier
from elastic_strips.trajectory.holding import fastest_towards, hold_and_brake
from elastic_strips.trajectory.trajectory import stationary
from elastic_strips.validation import Bound, Checked, Count, NonNegative, Positive, check_able, check_type

from .controller import KEPT_EVENTS, Controller, stale
from .executor import MotionExecutor
from .guard_proposal import NearPairs, Proposer
from .guard_steering import Steered, Steering
from .interfaces import Command, Measurement
from .monitor import SceneMonitor
from .params import DriveParams, Margins
from .prediction import Outlook
from .process.priority import undisturbed

_log = logging.getLogger(__name__)
_Part = Annotated[float, Bound(above=0.0, high=1.0)]
_ZERO = 1e-6  # [m/s, rad/s] a command below this is rest
_SAME = 1e-6  # of the motors' largest speeds: a command that differs by less is the same
_NOTHING = 2e-3  # of these: a proposal below this is none
_SAME_DIRECTION = 0.999  # cosine from which on a command is slowed and not bent
_ANCHOR_SHARE = 0.25  # of the tracking error off its reference, at rest, from which on the robot starts where it is
_INSIDE = 5e-5  # [m] below the present distance that is certified where the robot leaves the clearance
_LEAST_CLEARANCE = 5e-4  # [m] from which on a robot can leave by itself
_STOP_MARGIN = 5e-4  # [rad or m] before its stop a joint comes to rest, besides what rounding of periods costs
_DAMPING = 0.05  # of a hand's twist near singular postures
_SELF_REACH = 0.1  # [m] within which links count for each other
_FARTHEST = 1.0  # [m] and obstacles, at most
_SHARES = (1.0, 0.6, 0.25, 0.0)  # of the base's, or the arm's command that are tried one after the other
_STUCK = 1e-3  # [m] of room below which none of them is tried
_ROOM = 1e-3  # [m] from obstacles, besides what a tracking error takes, with which motions are certified
_CALM = 0.5  # [s] for which a tracking error is kept that is no longer needed: it comes and goes with every fix


class GuardOutcome(Enum):
    """What became of a command.

    ``PASSED``: it is driven as it is. ``BENT``: another one is driven, in another direction. ``SLOWED``: a part of it,
    in its direction. ``BRAKING``: none; the robot comes to rest on the motion that it has. ``STOPPED``: it stands.
    """

    PASSED = "passed"
    BENT = "bent"
    SLOWED = "slowed"
    BRAKING = "braking"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardParams(Checked):
    """How commands are guarded; times [s], lengths [m].

    Attributes:
        drive: what is assumed of obstacles, robot and measurements, and what motions keep from obstacles.
        self_clearance: distance that motions keep between the robot's own links, but for those that touch in no
            posture. The tracking error has a part in it.
        speed, acceleration: shares of the motors' largest speeds and accelerations that motions are certified with; the
            rest is for tracking. A faster command is one at this speed.
        hold: control periods for which a command is held before the certified motion brakes: with one, the robot would
            brake at each period that is missed.
        oldest: age of a command from which on it counts no more.
        tries: most motions that are certified in a period.
        budget: time of a period's computing after which none is tried anew, by the guard's meter.
        leaving_speed: largest speed [m/s, and twice that in rad/s] of a robot that is inside its clearance.
        steer: whether a differential drive that is about to run askew into something that stands is turned along it;
            else it stops there, since it cannot slide.
    """

    drive: DriveParams = field(default_factory=DriveParams)
    self_clearance: Positive = 0.005
    speed: _Part = 0.95
    acceleration: _Part = 0.8
    hold: Count = 2
    oldest: Positive = 0.15
    tries: Count = 6
    budget: Positive = 0.004
    leaving_speed: NonNegative = 0.1
    steer: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Desired:
    """What somebody wants a robot to do now. What is not given rests.

    Values that are not finite are no command, and bring the robot to rest.

    Attributes:
        twist: (3,) velocity x, y [m/s] and yaw [rad/s] of the base in its own frame; y counts for an omnidirectional
            base alone.
        joints: (n,) joint velocities [rad/s or m/s].
        hand: (6,) velocity [m/s] and angular velocity [rad/s] of a frame of the robot, along the base's axes and
            relative to the base; the joints follow it, beside ``joints``.
        frame: name of that frame.
        time: when it was said [s]; now where None.
    """

    twist: Array | None = None
    joints: Array | None = None
    hand: Array | None = None
    frame: str = ""
    time: float | None = None

    def __post_init__(self) -> None:
        """Take the values.

        Raises:
            ParameterError: a twist or a hand's velocity of another size, or one without a frame.
        """
        for name, size in (("twist", 3), ("joints", None), ("hand", 6)):
            value = getattr(self, name)
            if value is None:
                continue
            try:
                row = np.array(value, dtype=float)
            except (TypeError, ValueError):
                raise ParameterError(f"Desired.{name}={value!r} is no row of numbers") from None
            if row.ndim != 1 or (size is not None and len(row) != size):
                raise ParameterError(f"Desired.{name} has shape {row.shape}; it is a row ({size or 'n'},)")
            row.setflags(write=False)
            object.__setattr__(self, name, row)
        if self.hand is not None and not self.frame:
            raise ParameterError("Desired.hand is the velocity of a frame: frame='…' names it")

    @property
    def finite(self) -> bool:
        """Whether all its values are finite."""
        given = [value for value in (self.twist, self.joints, self.hand) if value is not None]
        return all(bool(np.isfinite(value).all()) for value in given)


@dataclass(frozen=True, slots=True, eq=False)
class GuardedCommand:
    """The answer of a guard for one control period.

    Attributes:
        command: speeds of the motors.
        passed: (nv,) velocity that was taken, body twist and joint rates; the motors approach it as fast as they may.
        outcome: what became of the desired command.
        share: part of it that was taken, 0 to 1, by the motors' largest speeds.
        reason: why it was not taken as it is; empty where it was.
        link, obstacle: what is in the way: a link, and an obstacle or another link; empty where nothing is.
        distance: their distance now [m]; NaN where nothing is, or where it is not known.
        clearance: distance [m] to obstacles that is certified for what is driven: less than was asked for where the
            robot leaves a place inside its clearance.
        tries: motions that were certified, or refused, in this period.
        stops_in: time [s] until the robot stands, if nothing else comes.
    """

    command: Command
    passed: Array
    outcome: GuardOutcome
    share: float
    reason: str
    link: str
    obstacle: str
    distance: float
    clearance: float
    tries: int
    stops_in: float


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    """What a period has decided: the velocity (nv,) and what is in its way."""

    v: Array
    outcome: GuardOutcome
    share: float
    reason: str = ""
    link: str = ""
    obstacle: str = ""
    distance: float = math.nan
    tries: int = 0


class Guard:
    """Workspace: passes on the commands of anybody, and certifies what is driven down to its stop.

    In every control period :meth:`step` takes measurement, scene and desired command, and returns the command of the
    motors. The motion that is driven holds a velocity for a moment and ends at rest; another one replaces it only if it
    is certified against all that the obstacles may do. So the robot stands at any contact, under the assumptions of
    :class:`~elastic_strips.control.Controller`, whoever steers.

    Args:
        robot: the robot.
        limits: limits of its motors; read off the robot where None.
        params: how commands are guarded.
        start: configuration (nq,) of the robot at rest; its home where None.
        events: the newest events and stops that are kept at least; all where None.
        meter: reading [s] of the clock that ``GuardParams.budget`` is measured with, as ``time.monotonic``; where None
            only ``GuardParams.tries`` counts.

    Attributes:
        executor: what follows motions, watches and brakes.
        last: the answer of the last step; None before the first.

    Raises:
        ConfigurationError: the start is not valid.
    """

    def __init__(
        self,
        robot: RobotModel,
        limits: MotionLimits | None = None,
        params: GuardParams | None = None,
        *,
        start: npt.ArrayLike | None = None,
        events: int | None = KEPT_EVENTS,
        meter: Callable[[], float] | None = None,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("limits", limits, MotionLimits, none=True)
        check_type("params", params, GuardParams, none=True)
        check_able("meter", meter)
        self.robot: RobotModel = robot
        self.params: GuardParams = params or GuardParams()
        self.limits: MotionLimits = limits or MotionLimits.for_robot(robot)
        self.last: GuardedCommand | None = None
        drive, limits, own, base = self.params.drive, self.limits, self.params, robot.space.base_nv
        row = robot.space.to_coordinates(robot.check_q(robot.home_q if start is None else start, what="start"))
        self.executor: MotionExecutor = MotionExecutor(robot, limits, drive, row, row, drive.tolerance, keep=events)
        self._meter: Callable[[], float] = meter or (lambda: 0.0)
        self._certifier = TrajectoryCertifier(
            robot,
            clearance=drive.clearance,
            self_clearance=own.self_clearance,
            settle_time=drive.settle_time,
            apart=0.0,
        )
        self._slower = limits.scaled(own.speed, 1.0)
        self._change = own.acceleration * limits.acceleration
        top, k = limits.drive_speed[:2], limits.drive_dim
        stop = float((0.5 * top * top / self._change[:k][:2]).max(initial=0.0) if k else 0.0)
        reach = min(max(stop + 3.0 * own.hold * drive.control_dt * float(top.max(initial=0.0)), 0.25), _FARTHEST)
        self._proposer = Proposer(
            robot,
            limits,
            self_clearance=own.self_clearance,
            part=own.acceleration,
            reach=reach + drive.clearance,
            self_reach=_SELF_REACH,
        )
        steers = own.steer and robot.base_kind is BaseKind.DIFF_DRIVE
        self._steering = Steering(robot, self._slower, part=own.acceleration) if steers else None
        self._columns, self._scale = self._proposer.columns, self._proposer.scale
        self._margins: Margins = drive.margins
        self._needed, self._due = _Peak(drive.tracking_error), _Peak(drive.tracking_error)
        self._doubts = SceneMonitor(drive.monitor, drive.assumptions)
        self._scene: Scene | None = None
        self._trouble = "no scene has arrived yet"
        self._outlook: Outlook | None = None
        self._proof: tuple[Trajectory, Outlook] | None = None  # a certified motion, and what against
        self._refused = ("", "")  # the pair that motions were refused for last
        self._levels = (0, 0)  # where in `_SHARES` the next period begins
        self._inside = False  # whether the robot leaves its clearance, or has to
        self._said: tuple[GuardOutcome, str, str] | None = None
        self._clearance = drive.clearance  # that the active motion is certified with
        self._leaves = False  # whether that is less than was asked for
        self._lender: Controller | None = None
        self._own = self.executor
        self._frames: dict[str, int] = {}
        self._data = robot.model.createData()  # for the hand
        bodies = BodySet.links(robot)
        self._arm = {name for name, joint in zip(bodies.names, bodies.joint, strict=True) if joint > (base > 0)}

    def step(
        self,
        t: float,
        measurement: Measurement | None,
        scene: Scene | None,
        desired: Desired | None,
        *,
        trouble: str = "",
    ) -> GuardedCommand:
        """One control period.

        Args:
            t: time [s], later than at the last step.
            measurement: since the last step; None at the first, when the robot stands.
            scene: the newest sensed scene, with the time at which it was sensed; None where no newer one came. One
                without a time, in which nothing moves, is a map: it counts until another scene comes.
            desired: what is wanted from now on; None: nothing, the robot comes to rest.
            trouble: why no scene came, where that is known; the robot comes to rest then.

        Raises:
            ParameterError: a time that does not ascend, or a command for another robot.
            SceneError: not a scene.
        """
        check_type("scene", scene, Scene, SceneError, none=True)
        check_type("desired", desired, Desired, none=True)
        self._check(desired)
        began = self._meter()
        executor = self.executor
        executor.measure(t, measurement)
        self._see(t, scene, trouble)
        try:
            with undisturbed():
                taken = self._decide(t, desired, began)
        except Exception as error:  # nothing new is driven, and nothing that was known counts any more
            _log.exception("the guard failed")
            taken = self._failed(t, f"guarding failed: {type(error).__name__}: {error}")
        command = executor.command(t)
        self._say(t, taken)
        standing = executor.active.end_time - t
        self.last = GuardedCommand(
            command,
            taken.v,
            taken.outcome,
            taken.share,
            taken.reason,
            taken.link,
            taken.obstacle,
            taken.distance,
            self._clearance,
            taken.tries,
            max(float(standing), 0.0),
        )
        return self.last

    def safe(self, action: npt.ArrayLike, t: float, measurement: Measurement | None, scene: Scene | None) -> Array:
        """An action of a policy, made safe; :attr:`last` says what became of it.

        Args:
            action: (nv,) velocity: the base's twist x, y, yaw in its own frame [m/s, rad/s], then the joints' [rad/s or
                m/s]; the joints alone (n,) for a robot whose base is fixed.
            t, measurement, scene: as for :meth:`step`.

        Returns:
            (nv,) velocity to be commanded, in the same form.

        Raises:
            ParameterError: an action of another size.
        """
        row, base = np.asarray(action, dtype=float), self.robot.space.base_nv
        if row.shape != (self.robot.nv,):
            raise ParameterError(f"the action has shape {row.shape}; {self.robot.name!r} takes ({self.robot.nv},)")
        desired = Desired(twist=row[:base] if base else None, joints=row[base:])
        command = self.step(t, measurement, scene, desired).command
        return self.limits.to_tangent(np.concatenate((command.drive, command.joints)))

    def take_over(self, controller: Controller) -> None:
        """Drive a controller's robot from now on, moving or not: call :meth:`step` instead of its own.

        Its motion goes on until something else is certified. It keeps its strip and goal for :meth:`hand_back`.

        Raises:
            ConfigurationError: it drives another robot, or its executor runs elsewhere; or one is taken over already.
        """
        if self._lender is not None:
            raise ConfigurationError("take_over: a controller's robot is driven already; hand it back first")
        if not self.robot.same_as(controller.robot):
            raise ConfigurationError(
                f"take_over: the guard is of {self.robot.name!r}, not of {controller.robot.name!r}"
            )
        self.executor, self._lender = controller.lend(), controller
        self._forget()

    def hand_back(self) -> None:
        """Let the controller that was taken over drive on, from wherever its robot is, moving or not.

        Raises:
            ConfigurationError: none was taken over.
        """
        if self._lender is None:
            raise ConfigurationError("hand_back: no controller's robot is driven")
        self._lender.take_back()
        self.executor, self._lender = self._own, None
        self._forget()

    def stop(self, reason: str = "asked to stop") -> None:
        """Bring the robot to rest; it stands until :meth:`resume`."""
        self.executor.stop(reason)

    def resume(self) -> None:
        """Take commands again after :meth:`stop`, or after an emergency stop that is no longer pressed."""
        self.executor.resume()

    def _forget(self) -> None:
        self._proof = self._said = None
        self._clearance, self._leaves = self._margins.clearance, False
        if self._steering is not None:
            self._steering.forget()

    # what comes in

    def _check(self, desired: Desired | None) -> None:
        if desired is None:
            return
        if desired.twist is not None and not self.robot.space.base_nv:
            raise ParameterError(f"Desired.twist: the base of {self.robot.name!r} is fixed")
        count = len(self.limits.joint_speed)
        if desired.joints is not None and len(desired.joints) != count:
            raise ParameterError(
                f"Desired.joints has {len(desired.joints)} velocities; {self.robot.name!r} has {count} joints"
            )
        if desired.hand is not None and desired.frame not in self._frames:
            model = self.robot.model
            found = find_frame(model, desired.frame)
            if found is None:
                names = [frame.name for frame in model.frames]
                raise ParameterError(f"there is no frame {desired.frame!r}{nearest_name(desired.frame, names)}")
            self._frames[desired.frame] = found

    def _see(self, t: float, scene: Scene | None, trouble: str) -> None:
        """Take in a scene, and how well the robot is known."""
        executor, drive = self.executor, self.params.drive
        if scene is not None:
            doubt = self._doubts.doubt(t, scene, at_rest=executor.at_rest(t))
            if doubt:
                executor.log("fault", doubt)
            else:
                if scene.remark:
                    executor.log("fault", scene.remark)
                (scene, wrong), self._trouble = self._doubts.motions.checked(t, scene), ""
                for reason in wrong:
                    executor.log("fault", reason)
                if scene is not self._scene:
                    self._scene, self._outlook = scene, None
        if trouble:
            self._trouble = trouble
        allowed = self._needed.at(t, min(executor.needed_error, max(drive.monitor.largest, drive.tracking_error)))
        self._due.at(t, max(executor.due_error, allowed))
        if allowed != self._margins.tracking_error:
            if allowed > self._margins.tracking_error:
                self._proof = None
            self._margins, self._outlook = replace(self._margins, tracking_error=allowed), None
        if self._outlook is None and self._scene is not None:
            self._outlook = Outlook.of(self._scene, drive.assumptions, self._margins)

    def _trouble_now(self, t: float) -> str:
        """Why nothing may be driven now; empty where it may."""
        executor, drive = self.executor, self.params.drive
        if executor.waits:
            return executor.waits
        if self._trouble or self._scene is None:
            return self._trouble
        if executor.period.seconds > drive.monitor.longest_period:
            return f"the control loop runs at {1.0 / executor.period.seconds:.1f} Hz"
        if executor.lost_for > 0.1:
            return "odometry lost"
        return stale(t, self._scene, drive.max_scene_age)

    def _wanted(self, desired: Desired) -> Array:
        """(nv,) the desired velocity, as fast as it may be: the base in proportion, each joint by itself."""
        base = self.robot.space.base_nv
        v = np.zeros(self.robot.nv)
        if base and desired.twist is not None:
            v[:base] = desired.twist
        if desired.joints is not None:
            v[base:] += desired.joints
        if desired.hand is not None:
            v[base:] += self._joints_of_hand(desired.hand, self._frames[desired.frame])
        return self._limited(v)

    def _limited(self, v: Array) -> Array:
        """A velocity (nv,) as fast as it may be: the base in proportion, each joint by itself."""
        limits, base, out = self._slower, self.robot.space.base_nv, v.copy()
        if base:
            drive = limits.to_drive(v[:base])
            out[:base] = limits.to_twist(drive / max(1.0, float((np.abs(drive) / limits.drive_speed).max())))
        out[base:] = np.clip(v[base:], -limits.joint_speed, limits.joint_speed)
        return out

    def _joints_of_hand(self, twist: Array, frame: int) -> Array:
        """(n,) joint rates that move a frame, by damped least squares; all scaled down where one would be too fast."""
        robot, base = self.robot, self.robot.space.base_nv
        q = robot.space.from_coordinates(self.executor.estimate)
        J = pin.computeFrameJacobian(robot.model, self._data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        J = np.asarray(J)[:, base:]
        if base:
            yaw = float(self.executor.estimate[2])
            turn = np.array(
                [[math.cos(yaw), math.sin(yaw), 0.0], [-math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
            )
            J = np.vstack((turn @ J[:3], turn @ J[3:]))
        rates = J.T @ np.linalg.solve(J @ J.T + _DAMPING**2 * np.eye(6), twist)
        return rates / max(1.0, float((np.abs(rates) / self._slower.joint_speed).max(initial=0.0)))

    # what is made of it

    def _decide(self, t: float, desired: Desired | None, began: float) -> _Taken:
        executor = self.executor
        trouble = self._trouble_now(t)
        if trouble:
            return self._none(t, trouble)
        assert self._outlook is not None
        if desired is None:
            return self._none(t, "no command", holds=True)
        if not desired.finite:
            return self._none(t, "the command is not finite")
        age = 0.0 if desired.time is None else t - desired.time
        if not -self.params.drive.monitor.clock_skew <= age <= self.params.oldest:  # a time that is no number, too
            return self._none(t, "the command's time is still to come" if age < 0.0 else "the command is old")
        wanted = self._wanted(desired)
        if np.abs(wanted).max(initial=0.0) <= _ZERO:
            rest = self._none(t, "the command is to stand still", holds=True)
            return replace(rest, outcome=GuardOutcome.PASSED, share=1.0, reason="")
        if executor.at_rest(t) and self._off():
            resting = stationary(self.robot, self.limits, np.array(executor.estimate), t, self.params.drive.control_dt)
            executor.anchor(resting)
        return self._drive(t, wanted, self._outlook, began)

    def _off(self) -> bool:
        """Whether a robot at rest stands noticeably beside its reference."""
        executor = self.executor
        return executor.settled and executor.monitor.deviation > _ANCHOR_SHARE * executor.proven

    def _drive(self, t: float, wanted: Array, outlook: Outlook, began: float) -> _Taken:
        """Find a command near the wanted one whose motion is certified, and drive it."""
        executor, drive = self.executor, self.params.drive
        start = executor.active.at(t)
        hold = self.params.hold * max(executor.period.seconds, drive.control_dt)
        wide = replace(outlook.margins, tracking_error=self._due.value).clearance
        pairs = self._proposer.look(start, outlook, settle=hold + drive.settle_time, clearance=wide)
        now = _Now(start, hold, outlook, pairs, *self._kept(pairs, start), self._room_for_error(pairs))
        v, cause = self._proposed(wanted, now)
        if float(np.abs(v[self._columns] / self._scale).max()) < _NOTHING:
            none = self._none(t, f"{cause[0]} is near {cause[1]}")
            return replace(none, link=cause[0], obstacle=cause[1], distance=pairs.of(*cause))
        options, tries = _Options(v, self.robot.space.base_nv, self._levels), 0
        option = options.now()
        tried, together = np.full(len(self._change), np.inf), True
        while option is not None and tries < self.params.tries:
            if tries and self._meter() - began > self.params.budget:
                break
            v, _ = self._within_stops(option, start, hold)
            speed = self._reachable(v, now)
            if together and float(np.abs(speed - tried).max()) < _NOTHING:  # what was refused already
                option = options.after(False, stuck=False)
                continue
            tried = speed
            motion = hold_and_brake(
                self.robot, self.limits, start, speed, part=self.params.acceleration, hold=hold, together=together
            )
            certificate, proven = self._proven(motion, now)
            tries += 1
            broken = certificate.broken
            if tries == 1:
                self._proposer.learn(refused=broken is not None)
            if broken is None:
                executor.submit(motion, certificate, at_goal=False, proven=proven)
                if executor.active is not motion:
                    return replace(self._none(t, executor.run.reason), tries=tries)
                if options.softened and not cause[0]:
                    cause = self._refused
                self._proof, self._levels = (motion, outlook), options.easier
                self._clearance, self._leaves = now.with_error(proven), now.leaving
                return self._taken(v, wanted, now, cause, tries)
            self._refused = pair = broken.labels or (broken.link, broken.obstacle)
            if tries == 1:
                cause = pair
                if self._steering is not None:
                    self._steering.forget()
            of_self = broken.kind == "self"
            room = pairs.of(*pair) - (now.self_clearance if of_self else now.clearance)
            self._inside = self._inside or room < _INSIDE
            if room < 0.0:
                break  # where the motion begins it is too near already
            together = not (tries == 1 and self.limits.drive_dim == 3 and not of_self)
            if not together:  # the same, with a stop that turns off along what is in the way
                continue
            option = options.after(of_self or broken.link in self._arm, stuck=room < _STUCK)
        none = self._none(t, f"{cause[0]} is too near to {cause[1]}")
        return replace(none, link=cause[0], obstacle=cause[1], distance=pairs.of(*cause), tries=tries)

    def _proposed(self, wanted: Array, now: _Now) -> tuple[Array, tuple[str, str]]:
        """A velocity (nv,) near the wanted one that is likely to be certified, and what keeps it from being that."""
        v, stopped = self._within_stops(wanted, now.start, now.hold)
        cause = stopped, stopped
        steered: Steered | None = None
        if self._steering is not None and not now.leaving:
            steered = self._steering.steer(
                v, now.start, now.outlook.scene, partial(self._certify, now=now, error=now.due)
            )
            v, cause = steered.v, self._steering.cause if steered.turned else cause
        free, turned = steered is not None and steered.free, steered is not None and steered.turned
        pairs = now.pairs.own if free else now.pairs  # the base was looked ahead with, and the joints were not
        proposal = self._proposer.propose(v, now.start, pairs, hold=now.hold, turns=not turned)
        if proposal.cause is not None:
            v, cause = self._limited(proposal.v), pairs.names[proposal.cause]
        return (self._slowed(v, now.slow_from) if now.leaving else v), cause

    def _proven(self, motion: Trajectory, now: _Now) -> tuple[Certificate, float]:
        """A motion's certificate, and the tracking error [m] that it is certified with.

        That is the one that is due, so that the robot need not brake where it is further off its reference; the least
        one only where there is no room for that, and the robot is known, and on its reference, well enough.
        """
        executor, least = self.executor, now.outlook.margins.tracking_error
        if now.due > least and not now.leaving:
            certificate = self._certify(motion, now, now.due)
            far = executor.monitor.deviation + executor.coarse > self.params.drive.monitor.brake_at * least
            if certificate.certified or far:
                return certificate, now.due
        return self._certify(motion, now, least), least

    def _certify(self, motion: Trajectory, now: _Now, error: float) -> Certificate:
        """Certify a motion with a tracking error [m]."""
        scene, possible, kept = now.outlook.scene, now.outlook.possible, now.with_error(error)
        return self._certifier.certify(motion, scene, possible, clearance=kept, self_clearance=now.self_clearance)

    def _reachable(self, v: Array, now: _Now) -> Array:
        """(k + n,) the speeds of drive and joints that a velocity (nv,) comes to while it is held."""
        before, change = self.limits.to_coordinates(now.start.v), self._change * now.hold
        return np.minimum(np.maximum(self.limits.to_coordinates(v), before - change), before + change)

    def _taken(self, v: Array, wanted: Array, now: _Now, cause: tuple[str, str], tries: int) -> _Taken:
        """What became of a command of which ``v`` (nv,) is driven."""
        want, have = wanted[self._columns] / self._scale, v[self._columns] / self._scale
        size, along = float(want @ want), float(want @ have)
        if float(np.abs(want - have).max()) <= _SAME:
            return _Taken(v, GuardOutcome.PASSED, 1.0, tries=tries)
        same = along >= _SAME_DIRECTION * math.sqrt(size) * float(np.linalg.norm(have))
        link, obstacle = cause
        if now.leaving:
            reason = f"{link} leaves the clearance of {obstacle}"
        else:
            reason = f"{link} is near its stop" if link == obstacle else f"{link} is near {obstacle}"
        outcome = GuardOutcome.SLOWED if same else GuardOutcome.BENT
        share = min(max(along / size, 0.0), 1.0)
        return _Taken(v, outcome, share, reason, link, obstacle, now.pairs.of(link, obstacle), tries)

    def _room_for_error(self, pairs: NearPairs) -> float:
        """The tracking error [m] that is due, as far as there is room for it where the robot is."""
        least, room = self._margins.tracking_error, float(pairs.distance[: pairs.outer].min(initial=math.inf))
        return max(least, min(self._due.value, room - self._margins.margin - _ROOM))

    def _within_stops(self, wanted: Array, start: ReferenceState, hold: float) -> tuple[Array, str]:
        """A velocity (nv,) with which no joint passes its stop, and the joint that this slows most."""
        space, base, k = self.robot.space, self.robot.space.base_nv, self.limits.drive_dim
        here, now, change = start.coordinates[base:], start.v[base:], self._change[k:]
        margin = _STOP_MARGIN + 0.5 * change * hold * hold
        low, high = space.lower[base:] + margin, space.upper[base:] - margin
        up = fastest_towards(high - here, now, change, hold)
        down = fastest_towards(here - low, -now, change, hold)
        rates = np.clip(wanted[base:], np.minimum(-down, 0.0), np.maximum(up, 0.0))
        less = np.abs(wanted[base:] - rates)
        if not less.any():
            return wanted, ""
        v = wanted.copy()
        v[base:] = rates
        worst = int(np.argmax(less))
        return v, self.robot.joint_names[worst] if less[worst] > _ZERO else ""

    def _kept(self, pairs: NearPairs, start: ReferenceState) -> tuple[float, float, int]:
        """What motions keep now from obstacles and between links [m], and the first coordinate that has to be slow.

        It is less than was asked for where a robot that stands, or is slow, is inside that: it has to get out again. At
        the very border it is only where a motion has been refused for that.
        """
        clearance, own, slow = self._margins.clearance, self.params.self_clearance, self.params.leaving_speed
        others = float(pairs.distance[: pairs.outer].min(initial=math.inf)) - clearance
        selves = float(pairs.distance[pairs.outer :].min(initial=math.inf)) - own
        border = _INSIDE if self._inside else 0.0
        if others >= border and selves >= border:
            self._inside = self._inside and min(others, selves) < _INSIDE
            return clearance, own, self.robot.nv
        first = 0 if others < border else self.robot.space.base_nv
        if slow == 0.0 or self._slowed(start.v, first) is not start.v:
            return clearance, own, self.robot.nv
        self._inside = True
        kept = min(clearance, max(clearance + others - _INSIDE, _LEAST_CLEARANCE))
        return kept, min(own, max(own + selves - _INSIDE, _LEAST_CLEARANCE)), first

    def _slowed(self, v: Array, first: int) -> Array:
        """A velocity (nv,) whose coordinates from the first on are as slow as inside the clearance; itself if it is."""
        slow, base = 1.02 * self.params.leaving_speed, self.robot.space.base_nv
        turning = float(np.abs(v[max(first, 2 if base else 0) :]).max(initial=0.0))
        over = max(float(np.hypot(*v[:2])) if base and not first else 0.0, 0.5 * turning) / slow if slow else np.inf
        if over <= 1.0:
            return v
        out = v.copy()
        out[first:] /= 1.02 * over
        return out

    # where nothing new is driven

    def _none(self, t: float, reason: str, *, holds: bool = False) -> _Taken:
        """Let the active motion go on to its end, or brake harder where the scene no longer allows for it."""
        executor, self._levels = self.executor, (0, 0)
        if self._steering is not None:
            self._steering.forget()
        stands, refuted = executor.at_rest(t), self._recheck(t)
        if holds and not executor.waits:
            executor.hold(reason, executor.active, executor.proven)
        else:
            executor.reject(reason)
        if refuted:
            executor.brake(refuted)
        outcome = GuardOutcome.STOPPED if stands else GuardOutcome.BRAKING
        return _Taken(np.zeros(self.robot.nv), outcome, 0.0, reason)

    def _failed(self, t: float, reason: str) -> _Taken:
        """Forget what is known after an exception; the active motion goes on to its end."""
        self._certifier.reset()
        self._proposer.reset()
        self._forget()
        if self._steering is not None:
            self._steering.reset()
        self.executor.log("fault", reason)
        self.executor.reject(reason)
        stands = self.executor.at_rest(t)
        outcome = GuardOutcome.STOPPED if stands else GuardOutcome.BRAKING
        return _Taken(np.zeros(self.robot.nv), outcome, 0.0, reason)

    def _recheck(self, t: float) -> str:
        """Certify the active motion anew where the scene is not what its certificate allowed for, or where the robot
        comes near to the tracking error that it was proven with; why it has to brake, empty where it need not."""
        outlook, executor, proof = self._outlook, self.executor, self._proof
        active, proven, due = executor.active, executor.proven, self._due.value
        if outlook is None or executor.at_rest(t):
            return ""
        holds = proof is not None and proof[0] is active and (proof[1] is outlook or proof[1].allows(outlook.scene))
        rest, broken, least = active.tail(t), None, outlook.margins.tracking_error
        errors = {min(least, proven)} if self._leaves else {max(due, proven, least), max(proven, least), least}
        for error in sorted(errors, reverse=True):
            if holds and error <= proven:
                return ""
            kept = replace(outlook.margins, tracking_error=error).clearance
            kept = min(kept, self._clearance) if self._leaves else kept
            broken = self._certifier.certify(rest, outlook.scene, outlook.possible, clearance=kept).broken
            if broken is None:
                self._proof, self._clearance = (active, outlook), kept
                executor.hold(executor.run.reason, active, error)
                return ""
        self._proof = None
        return f"the motion is no longer certified: {broken}"

    def _say(self, t: float, taken: _Taken) -> None:
        """Write down what is bent or refused, once for each link and obstacle."""
        said = taken.outcome, taken.link, taken.obstacle
        if said != self._said and taken.link:
            self.executor.log("guard", f"{taken.outcome.value}: {taken.reason}")
        self._said = said


class _Peak:
    """Workspace: the largest of the last values of a tracking error [m]."""

    def __init__(self, value: float) -> None:
        self.value = value
        self._until = -math.inf

    def at(self, t: float, value: float) -> float:
        """Take in the value at time ``t`` [s]; returns the largest one of late."""
        if value >= self.value or t >= self._until:
            self.value, self._until = value, t + _CALM
        return self.value


@dataclass(frozen=True, slots=True, eq=False)
class _Now:
    """What a period decides on: the state from which motions begin, how long they hold, and what they keep from.

    Attributes:
        clearance, self_clearance: that motions keep [m].
        slow_from: the first coordinate that has to be slow, as the robot is inside its clearance; their number else.
        due: tracking error [m] that motions are proposed and certified with where there is room for that.
    """

    start: ReferenceState
    hold: float
    outlook: Outlook
    pairs: NearPairs
    clearance: float
    self_clearance: float
    slow_from: int
    due: float

    def with_error(self, error: float) -> float:
        """The clearance [m] that motions keep that are certified with a tracking error [m]."""
        return self.clearance + error - self.outlook.margins.tracking_error

    @property
    def leaving(self) -> bool:
        """Whether the robot is inside the clearance that was asked for."""
        return self.slow_from < len(self.start.v)


class _Options:
    """Workspace: velocities to try, one after the other, by what the one before was refused for.

    Args:
        v: (nv,) the proposed one.
        base: number of the base's coordinates.
        levels: where in `_SHARES` to begin, for the base and for the arm.
    """

    def __init__(self, v: Array, base: int, levels: tuple[int, int]) -> None:
        self._v, self._base = v, base
        self._moves = [bool(part.any()) for part in (v[:base], v[base:])]
        self._levels = [level if moves else 0 for level, moves in zip(levels, self._moves, strict=True)]

    @property
    def easier(self) -> tuple[int, int]:
        """Where the next period had better begin: with a little more than this one came to."""
        return max(self._levels[0] - 1, 0), max(self._levels[1] - 1, 0)

    @property
    def softened(self) -> bool:
        """Whether the present one is only a part of what was proposed."""
        return any(self._levels)

    def now(self) -> Array | None:
        """The present one (nv,); None where nothing is left of it."""
        v = self._v.copy()
        v[: self._base] *= _SHARES[self._levels[0]]
        v[self._base :] *= _SHARES[self._levels[1]]
        return v if v.any() else None

    def after(self, arm: bool, *, stuck: bool) -> Array | None:
        """The next one (nv,) after a refusal for the arm, or for the base; None where there is none.

        Args:
            arm: whether a link of the arm was in it.
            stuck: whether they are so near that the base, or the arm, had better stay.
        """
        last = len(_SHARES) - 1
        left = [moves and level < last for moves, level in zip(self._moves, self._levels, strict=True)]
        of_arm = left[1] and (arm or not left[0])
        if not left[of_arm]:
            return None
        self._levels[of_arm] = last if stuck else self._levels[of_arm] + 1
        return self.now()
