"""Monitor: checks at the control rate what the certificate of a motion assumes, and says what no longer holds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision.bounds import Displacement
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.trajectory import MotionLimits

from .driver import COMMAND_TIMEOUT
from .estimation import StateEstimator
from .interfaces import Command, Measurement
from .motion_watch import MotionWatch
from .params import MonitorParams, ObstacleAssumptions

_TOO_FAST = 2.0
"""A motor that seems this many times as fast as its limit was misread."""
_OLDEST_FIX = 10.0  # [s] before the measurement that it comes with
_READING_SLACK = 0.05  # [m, rad] and what a reading may be off besides
_SAME_PERIOD = 1e-6  # part of a step by which a period may be longer
_MOST_STEPS = 1000  # of the motors' model at once: after that they stand
_STANDS = 0.01  # [m/s, rad/s] below this the motors' model stands
_MOST_VANISHED = 1
"""This many obstacles may vanish at once."""


class Monitor:
    """Workspace: compares what sensors and motors have done so far with what they can do.

    Args:
        robot: the robot.
        limits: limits of its motors.
        params: when an assumption counts as broken.
        dt: nominal control period [s]; the motors' model takes no longer steps, however long a period lasts.

    Attributes:
        deviation: bound [m] of the distance of any point of the robot from its place by the reference, estimated.
        uncertainty: error [m] of any point of the estimated robot, by the estimator's standard deviations.
        silent: since when [s] no usable measurement of wheels or joints has come; None where the last one was.
        motor_fault: how a motor disobeys; empty where all obey.
    """

    def __init__(self, robot: RobotModel, limits: MotionLimits, params: MonitorParams, dt: float) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: MonitorParams = params
        self.deviation: float = 0.0
        self.uncertainty: float = 0.0
        self.silent: float | None = None
        self.motor_fault: str = ""
        self._dt = dt
        self._displacement = Displacement(robot)
        self._last: Measurement | None = None
        self._joints_read: float | None = None  # time of the last joints that were believed
        self._model = np.zeros(len(limits.drive_speed))  # speeds that the motors ought to have
        self._wanted = self._model  # that they were told last
        self._holds_until = -math.inf  # [s]; then the motors stop by themselves
        self._modelled: float | None = None  # [s] time of the model
        self._travel, self._span = np.zeros_like(self._model), 0.0  # by the model since the last measurement
        self._wrong_since: float | None = None
        self._crept, self._stands_since = np.zeros_like(self._model), -math.inf  # by measurements, while it is to stand

    def measurement(self, t: float, raw: Measurement, estimate: Array) -> tuple[Measurement | None, tuple[str, ...]]:
        """A measurement without the parts that cannot be true.

        Args:
            t: time [s].
            raw: the measurement that came.
            estimate: (nv,) the last one; its joints stand for those that were misread.

        Returns:
            The rest of the measurement, None where nothing can be used; and what is wrong with it.
        """
        last, faults = self._last, []
        if not math.isfinite(raw.time) or raw.time > t + self.params.clock_skew:
            faults.append(f"a measurement has the time {raw.time:g} s, which is still to come")
            raw = replace(raw, time=t)
        before = raw.time - self._dt if last is None else last.time  # the first may come late, as all after it
        if raw.time <= before:
            self._silence(t)
            return None, (*faults, f"a measurement of time {raw.time:g} s is no newer than the last")
        span = raw.time - before
        self._advance(t)
        drive, odometry_fault = self._odometry(raw, span)
        joints, joints_fault = self._joints(raw, before, estimate[self.robot.space.base_nv :])
        pose, covariance, fix_fault = self._fix(raw)
        if drive is None or joints_fault:
            self._silence(t)
        else:
            self.silent = None
        self._last = replace(raw, drive=drive, joints=joints, pose=pose, pose_covariance=covariance)
        expected = self._travel / self._span if self._span > 0.0 else self._model
        self._travel, self._span = np.zeros_like(self._model), 0.0
        if drive is not None:
            self._check_motors(t, drive / span, expected)
            self._check_standing(t, drive - expected * span, span)
        return self._last, tuple(filter(None, (*faults, odometry_fault, joints_fault, fix_fault)))

    def _odometry(self, raw: Measurement, span: float) -> tuple[Array | None, str]:
        """How far the wheels went in ``span`` [s], None where that cannot be used; and what is wrong with it."""
        if raw.drive is None:
            return None, ""
        if not _near(raw.drive, np.zeros_like(self._model), self.limits.drive_speed, span):
            if np.shape(raw.drive) == self._travel.shape and self._apart(raw.drive).max() < self.params.same_place:
                return raw.drive, ""  # the stamp of this message, or of the one before, was late
            return None, "odometry is misread"
        if span > self.params.longest_arc:
            return self._after_a_gap(raw.drive, span)
        return raw.drive, ""

    def _after_a_gap(self, travel: Array, span: float) -> tuple[Array | None, str]:
        """How far the wheels went in ``span`` [s] of silence, None where odometry may have begun anew meanwhile."""
        apart = self._apart(travel)
        i = int(apart.argmax())
        if apart[i] < self.params.same_place:
            return travel, ""
        off = f"{apart[i]:.2f} {'rad' if i == 2 else 'm'}"  # of wheels, or of the base along, aside and around
        return None, f"odometry was silent for {span:.2f} s, and is {off} from where the base ought to be"

    def _apart(self, travel: Array) -> Array:
        """How far (k,) a travel since the last measurement [m, rad] is from what the motors were told meanwhile."""
        return np.abs(np.asarray(travel) - self._travel)

    def _joints(self, raw: Measurement, before: float, estimate: Array) -> tuple[Array, str]:
        """The joints, or their estimate where they cannot have come there since they were believed; what is wrong."""
        self._joints_read = before if self._joints_read is None else self._joints_read
        if not _near(raw.joints, estimate, self.limits.joint_speed, raw.time - self._joints_read):
            return estimate.copy(), "joints are misread"
        self._joints_read = raw.time
        return raw.joints, ""

    def _fix(self, raw: Measurement) -> tuple[Array | None, Array | None, str]:
        """A fix and its covariance, None where they cannot be used; and what is wrong with them."""
        pose, covariance = raw.pose, raw.pose_covariance
        if pose is None:
            return None, covariance, ""
        sound = np.shape(pose) == (3,) and np.isfinite(pose).all() and raw.pose_time is not None
        if not sound or not raw.time - _OLDEST_FIX < (raw.pose_time or 0.0) <= raw.time + self.params.clock_skew:
            return None, covariance, "a fix is misread"
        if covariance is not None and not _is_covariance(covariance):
            return pose, None, "the covariance of a fix is not valid"
        return pose, covariance, ""

    def nothing(self, t: float) -> None:
        """Take note that no measurement has come at time ``t`` [s]."""
        self._silence(t)

    def _silence(self, t: float) -> None:
        self.silent = t if self.silent is None else self.silent

    def commanded(self, t: float, command: Command) -> None:
        """Take note of the command for the period that begins at time ``t`` [s]."""
        self._advance(t)
        self._wanted = np.zeros_like(self._model) if command.stop else command.drive
        self._holds_until = t + COMMAND_TIMEOUT

    def _advance(self, t: float) -> None:
        """Bring the motors' model to time ``t`` [s], by what they were told last."""
        span = 0.0 if self._modelled is None else t - self._modelled
        self._modelled = t
        steps = math.ceil(span / self._dt - _SAME_PERIOD)
        for k in range(min(steps, _MOST_STEPS)):
            step = span / steps
            push = self.limits.drive_acceleration * step
            wanted = self._wanted if t - span + k * step < self._holds_until else 0.0
            change = (wanted - self._model) * (1.0 - math.exp(-step / max(self.params.wheel_lag, 1e-9)))
            self._model = self._model + np.clip(change, -push, push)
            self._travel, self._span = self._travel + step * self._model, self._span + step

    def _check_motors(self, t: float, speed: Array, expected: Array) -> None:
        """Compare measured speeds (k,) [m/s, rad/s] with those that the motors' model expects."""
        error = np.abs(speed - expected)
        if float(error.max(initial=0.0)) <= self.params.motor_error:
            self._wrong_since, self.motor_fault = None, ""
            return
        self._wrong_since = t if self._wrong_since is None else self._wrong_since
        if t - self._wrong_since >= self.params.motor_time:
            i = int(error.argmax())
            self.motor_fault = (
                f"motor {i} of the drive does not obey: {speed[i]:.2f} m/s where {expected[i]:.2f} are expected"
            )

    def _check_standing(self, t: float, further: Array, span: float) -> None:
        """Add up how much further (k,) [m, rad] than their model motors went in ``span`` [s] that ought to stand."""
        told = self._wanted.any() or float(np.abs(self._model).max(initial=0.0)) > _STANDS
        told = told or span > self.params.standing_time  # it may have been told otherwise when it went
        if told or t - self._stands_since > self.params.standing_time:
            self._crept, self._stands_since = np.zeros_like(self._model), t
        if told:
            return
        self._crept = self._crept + further
        far = np.abs(self._crept)
        if float(far.max(initial=0.0)) > self.params.standing_travel:
            i = int(far.argmax())
            went = f"it went on by {far[i]:.3f} m in {t - self._stands_since:.2f} s"
            self.motor_fault = f"motor {i} of the drive does not obey: {went} where it is to stand"

    def follow(self, reference: Array, estimate: Array, estimator: StateEstimator) -> None:
        """Bring :attr:`deviation` and :attr:`uncertainty` up to date.

        Args:
            reference, estimate: (nv,) where the robot has to be, and where it is estimated to be.
            estimator: knows how exact that is.
        """
        self.deviation = float(self._displacement(reference[None], estimate[None])[0])
        error = estimator.deviation(self._displacement.reach()) if estimator.localized else 0.0
        self.uncertainty = self.params.sigmas * error


class SceneMonitor:
    """Workspace: the scenes so far, compared with the newest one.

    Args:
        params: when an assumption counts as broken.
        assumptions: what is assumed about obstacles; the defaults where None.
    """

    def __init__(self, params: MonitorParams, assumptions: ObstacleAssumptions | None = None) -> None:
        self.params: MonitorParams = params
        self.motions: MotionWatch = MotionWatch(params, assumptions or ObstacleAssumptions())
        self._seen: frozenset[str] = frozenset()  # names of the obstacles of the last scene that was believed
        self._doubted_since: float | None = None

    def doubt(self, t: float, scene: Scene, *, at_rest: bool) -> str:
        """Why a scene is not to be believed; empty where it is.

        Args:
            t: time [s].
            scene: the newest one.
            at_rest: whether the robot stands: only then is a scene that lacks obstacles believed in the end.
        """
        if not scene.time <= t + self.params.clock_skew:
            return f"the scene's time is {scene.time - t:.2f} s ahead"
        gone = len(self._seen.difference(scene.names))
        if gone > _MOST_VANISHED and gone > self.params.vanished * len(self._seen):
            self._doubted_since = t if self._doubted_since is None else self._doubted_since
            if t - self._doubted_since < self.params.scene_doubt or not at_rest:
                return f"{gone} of {len(self._seen)} obstacles have vanished at once"
        self._seen, self._doubted_since = frozenset(scene.names), None
        return ""


def _near(values: Array, others: Array, speed: Array, span: float) -> bool:
    """Whether values can have become these in ``span`` [s], at speeds of at most about ``speed``."""
    return np.shape(values) == others.shape and bool(
        (
            np.abs(np.asarray(values) - others) <= _TOO_FAST * speed * span + _READING_SLACK
        ).all()  # False of what is no number
    )


def _is_covariance(value: Array) -> bool:
    """Whether a value is a (3, 3) matrix that is symmetric, finite and positive definite."""
    matrix = np.asarray(value)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T):
        return False
    return bool(np.linalg.eigvalsh(matrix)[0] > 0.0)
