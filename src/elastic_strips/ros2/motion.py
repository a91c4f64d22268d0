"""Motion: odometry and joint states as measurements: only where something new came, and of the time when it was."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.estimation import Pose, compose, inverse, log
from elastic_strips.control.interfaces import Measurement
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.trajectory import MotionLimits

from .messages import BasePlace, MessageError
from .stamps import StampedRows

SLOWEST_ODOMETRY = 20.0
"""Least rate [Hz] of odometry, and of joint states, with which a robot is driven."""
_CHANGED_AGAIN, _SAME_AGAIN = 0.1, 1.0
"""Times [s] after which a transform counts again, where it has changed and where it has not: it is repeated more often
than it is measured, and a fix that counts ten times is believed as ten."""
_RATE_SLACK = 0.95  # of that: what is measured of 20 Hz may be a little less


def _of(row: Array) -> Pose:
    x, y, yaw = row.tolist()
    return x, y, yaw


def carried(correction: Array, pose: Array) -> Array:
    """The pose (3,) of odometry in the world, where that is off by a correction (3,)."""
    return np.array(compose(_of(correction), _of(pose)))


def correction_of(estimate: Array, odometry: Array) -> Array:
    """(3,) where the frame of odometry is in the world: the robot is at ``estimate`` (3,), by odometry elsewhere."""
    return np.array(compose(_of(estimate), inverse(_of(odometry))))


class MotionReader:
    """Workspace: what odometry and joint states say of a robot's motion.

    Both come at times of their own; a measurement is of the newest time of which both are known.

    Args:
        robot: the robot.
        limits: limits of its motors, whose track says what odometry means for two wheels.

    Attributes:
        odometry: the base's poses by odometry (3,).
        joints: of each set of joints that come in one message, rows of their positions [rad or m].
    """

    def __init__(self, robot: RobotModel, limits: MotionLimits) -> None:
        self._limits = limits
        self._names = robot.joint_names
        self._planar = robot.base_kind is not BaseKind.FIXED
        self.odometry: StampedRows = StampedRows(turns=(2,))
        self.joints: dict[tuple[str, ...], StampedRows] = {}
        self._group: dict[str, tuple[str, ...]] = {}  # joint → the joints that came with it last
        self._told: tuple[float, Array | None] = (-math.inf, None)
        self._fix: tuple[float, BasePlace] | None = None
        self._transform: tuple[float, Array] = (-math.inf, np.full(3, math.nan))  # that counted last
        self._transform_noise: Array | None = None  # covariance of the one that is not told yet

    def note_odometry(self, t: float, place: BasePlace) -> None:
        """Take in where odometry has the base at a time [s].

        Raises:
            MessageError: it is out of order.
        """
        self.odometry.add(t, place.pose)

    def note_joints(self, t: float, positions: Mapping[str, float]) -> None:
        """Take in positions of joints by name at a time [s]; joints that are not planned are left out.

        Raises:
            MessageError: it is out of order.
        """
        names = tuple(name for name in self._names if name in positions)
        if not names:
            return
        rows = self.joints.setdefault(names, StampedRows())
        rows.add(t, np.array([positions[name] for name in names]))
        self._group.update(dict.fromkeys(names, names))

    def note_fix(self, t: float, place: BasePlace) -> None:
        """Take in where the base was at a time [s] by localization; it is handed on with the next measurement."""
        self._fix = t, place

    def note_transform(self, t: float, transform: Array, noise: tuple[float, float]) -> None:
        """Take in where the frame of odometry is in the world (3,) at a time [s], with standard deviations [m], [rad].

        With odometry's pose of then, it is a fix of the base, which is handed on with the next measurement.
        """
        before, last = self._transform
        same = bool(np.array_equal(transform, last))
        if t >= before + (_SAME_AGAIN if same else _CHANGED_AGAIN) - 1e-6:
            self._transform = t, np.array(transform, dtype=float)
            self._transform_noise = np.diag(np.square([noise[0], noise[0], noise[1]]))

    @property
    def missing(self) -> str:
        """What has not come yet; empty where everything has."""
        lacking = [name for name in self._names if name not in self._group]
        parts = [] if len(self.odometry) or not self._planar else ["odometry"]
        if lacking:
            parts.append(f"positions of {', '.join(lacking[:8])}{', …' if len(lacking) > 8 else ''}")
        return " and ".join(parts)

    @property
    def newest(self) -> float:
        """The newest time [s] of which everything is known; −inf where something is missing."""
        if self.missing:
            return -math.inf
        times = [self.joints[group].newest for group in set(self._group.values())]
        return min([*times, self.odometry.newest] if self._planar else times)

    @property
    def oldest(self) -> float:
        """The oldest time [s] of which everything is still known; inf where something is missing."""
        if self.missing:
            return math.inf
        times = [self.joints[group].oldest for group in set(self._group.values())]
        return max([*times, self.odometry.oldest] if self._planar else times)

    def ages(self, now: float) -> tuple[float, float]:
        """How old the newest usable odometry is, and the newest positions of all joints [s]; 0 for what is not read."""
        joints = [self.joints[self._group[name]].newest if name in self._group else -math.inf for name in self._names]
        return now - self.odometry.newest if self._planar else 0.0, now - min(joints, default=now)

    @property
    def period(self) -> float:
        """Median time [s] from one message to the next, of what comes most seldom; inf before ten have come."""
        if self.missing:
            return math.inf
        times = [self.joints[group].period for group in set(self._group.values())]
        return max([*times, self.odometry.period] if self._planar else times)

    def row(self, t: float) -> Array:
        """(nv,) coordinate row at a time [s], the base by odometry.

        Raises:
            MessageError: not everything is known of then.
        """
        joints = self.joints_at(t)
        return np.concatenate((self.odometry.at(t), joints)) if self._planar else joints

    def measure(self) -> Measurement | None:
        """What is new since the last measurement that was made; None where nothing is."""
        t = self.newest
        before, pose_before = self._told
        if not t > before:
            return None
        try:
            joints, pose = self.joints_at(t), self.odometry.at(t) if self._planar else None
        except MessageError:  # the first messages do not overlap yet
            return None
        drive = np.zeros(len(self._limits.drive_speed))
        if pose is not None and pose_before is not None:
            drive = self._limits.to_drive(np.array(log(compose(inverse(_of(pose_before)), _of(pose)))))
        self._told = t, pose
        if self._transform_noise is not None and self._planar:
            (at, transform), noise, self._transform_noise = self._transform, self._transform_noise, None
            at = min(at, t)  # it holds on for what is measured next
            try:
                place = carried(transform, self.odometry.at(at))
            except MessageError:  # it is from before odometry, or from a gap of it
                return Measurement(t, drive, joints)
            return Measurement(t, drive, joints, place, at, noise)
        if self._fix is None or self._fix[0] > t:  # one of a time that is not known yet waits
            return Measurement(t, drive, joints)
        (at, place), self._fix = self._fix, None
        return Measurement(t, drive, joints, place.pose, at, place.covariance)

    def joints_at(self, t: float) -> Array:
        """Positions of the planned joints at a time [s].

        Raises:
            MessageError: they are not known of then.
        """
        rows = {group: self.joints[group].at(t) for group in set(self._group.values())}
        return np.array([rows[self._group[n]][self._group[n].index(n)] for n in self._names])


def check_rate(period: float, what: str = "odometry and joint states") -> float:
    """The rate [Hz] of what comes every ``period`` [s].

    Raises:
        ConfigurationError: it is too low to drive by.
    """
    rate = 1.0 / period if period > 0.0 else math.inf
    if rate < _RATE_SLACK * SLOWEST_ODOMETRY:
        raise ConfigurationError(
            f"{what} come at {rate:.1f} Hz; at least {SLOWEST_ODOMETRY:g} Hz is needed: the robot would drive blind "
            "between two of them"
        )
    return rate
