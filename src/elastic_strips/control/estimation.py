"""Estimation: the robot's configuration from encoders and delayed localization fixes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import Checked, NonNegative, Positive

from .interfaces import Measurement
from .slip import Drift, SlipWatch, slip_bounds

Pose = tuple[float, float, float]
"""x, y [m], yaw [rad], or a twist v_x, v_y, ω in the body's frame that takes unit time."""


def exp(twist: Pose) -> Pose:
    """The pose reached along a twist in unit time."""
    vx, vy, turn = twist
    if abs(turn) < 1e-4:
        s, k = 1.0 - turn * turn / 6.0, 0.5 * turn
    else:
        s, k = math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn
    return s * vx - k * vy, k * vx + s * vy, turn


def log(pose: Pose) -> Pose:
    """The twist that leads to a pose in unit time, by the shorter turn."""
    x, y, turn = pose
    turn = math.atan2(math.sin(turn), math.cos(turn))
    half = 0.5 * turn
    alpha = 1.0 - turn * turn / 12.0 if abs(turn) < 1e-4 else half / math.tan(half)
    return alpha * x + half * y, alpha * y - half * x, turn


def compose(a: Pose, b: Pose) -> Pose:
    """The pose ``b`` in the frame of the pose ``a``."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return a[0] + cos * b[0] - sin * b[1], a[1] + sin * b[0] + cos * b[1], a[2] + b[2]


def inverse(a: Pose) -> Pose:
    """The pose of the world in the frame of ``a``."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return -cos * a[0] - sin * a[1], sin * a[0] - cos * a[1], -a[2]


_Odometry = tuple[float, Pose, tuple[float, ...]]  # time, pose, encoder travel
_KEPT_POSES = 64  # odometry poses kept for delayed fixes
TIME_SLACK = 1e-9  # [s] times that differ by less are the same


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorParams(Checked):
    """The estimator's assumptions about the sensors.

    Attributes:
        slip: standard deviation of a wheel's slip, as a part of its travel.
        slip_time: correlation time of the slip [s].
        fix_noise, fix_angle_noise: standard deviations of a fix [m, rad].
        drift: standard deviation of all other motion of the base after one second [m, rad].
        coast: after the loss of odometry the last velocity is kept this long [s]; then the estimate stands.
        gate: a fix that is more standard deviations from odometry is a sign of wheels that slip, if their
            travel can explain it; otherwise it is not believed.
        believe_after: time [s] after which a fix is believed after all, if the robot has stood so long and all
            fixes agreed meanwhile.
        believe_within: distance [m] within which such a fix must be: somebody may have pushed the robot. One further
            away needs :meth:`StateEstimator.trust`, or a reset.
        side_slip: sideways part of its travel by which a base may slip, or by which fixes may be turned against its
            wheels [rad]. Fixes that drift further sideways are believed no longer.
    """

    slip: NonNegative = 0.01
    slip_time: Positive = 1.0
    fix_noise: Positive = 0.003
    fix_angle_noise: Positive = 0.003
    drift: NonNegative = 0.001
    coast: NonNegative = 0.05
    gate: Positive = 5.0
    believe_after: NonNegative = 3.0
    believe_within: NonNegative = 0.3
    side_slip: NonNegative = 0.01


class StateEstimator:
    """Workspace: odometry from encoders, corrected by fixes; joint positions directly from their encoders.

    Encoder travel gives the exact arc since the last measurement. A fix measures a past pose: it is compared with the
    odometry of that time, and the correction is carried to the present along the odometry since. The gain is that of an
    extended Kalman filter with the pose and the slip of each drive coordinate as state, so that steady slip of a wheel
    is estimated.

    With the default plant's noise, at every sample of 880 runs of 10 to 20 s (Silvermate, TIAGo), the base's error was
    at most 7 mm and 13 mrad, the joints' that of their encoders.

    Args:
        robot: the robot; any kind of base.
        limits: track and kind of drive.
        params: assumed noise.

    Attributes:
        doubt: why the last fix was not believed; empty where it was.
        localized: whether a fix has ever come; otherwise the pose is that of odometry, in a frame of its own.
        slipped: by how much [m] odometry was off at the last fix, if only wheels that slip explain it; else 0.
        contradiction: how fixes and odometry contradict each other; empty where they do not. Fixes that drift as no
            slip explains are believed no longer, and what they have shifted is taken back. It is over when the robot
            stands and all fixes have agreed with odometry for ``believe_after``, or by :meth:`trust`.
    """

    doubt: str
    localized: bool
    slipped: float
    contradiction: str

    def __init__(self, robot: RobotModel, limits: MotionLimits, params: EstimatorParams | None = None) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: EstimatorParams = EstimatorParams() if params is None else params
        self._k, self._first = len(limits.drive_speed), robot.space.base_nv
        p = self.params
        self._watch = SlipWatch(limits, p.side_slip, p.drift, p.gate)
        self._to_twist = limits.to_twist(np.eye(self._k)).T if self._k else np.zeros((3, 0))  # (3, k)
        self.reset(robot.space.to_coordinates(robot.home_q))

    @property
    def lost_for(self) -> float:
        """Time [s] without odometry: from the first measurement without encoder travel to the first fix that was
        measured after its return; 0 in normal operation."""
        return 0.0 if self._lost_since is None else self._time - self._lost_since

    def deviation(self, reach: float) -> float:
        """Standard deviation [m], by the filter, of the present place of a point that moves with the base and is at
        most ``reach`` [m] from its origin, in the direction where it is largest; 0 for a fixed base."""
        if not self._k:
            return 0.0
        P = self._predicted(self._past[-1])
        half, apart = 0.5 * (P[0, 0] + P[1, 1]), 0.5 * (P[0, 0] - P[1, 1])
        largest = half + math.hypot(apart, P[0, 1])
        return math.sqrt(largest + 2.0 * reach * math.hypot(P[0, 2], P[1, 2]) + reach**2 * P[2, 2])

    def reset(self, coordinates: Array, time: float = 0.0) -> None:
        """Restart from a known coordinate row (nv,) at a time [s]."""
        self._time = float(time)
        values = [float(x) for x in coordinates]
        self._joints = np.array(values[self._first :])
        pose = (values[0], values[1], values[2]) if self._k else (0.0, 0.0, 0.0)
        self._pose: Pose = pose
        self._slip = [0.0] * self._k
        self._sum = [0.0] * self._k  # encoder travel since the reset
        self._twist: Pose = (0.0, 0.0, 0.0)
        self._lost_since: float | None = None
        self._back_at: float | None = None
        self._past: deque[_Odometry] = deque([(self._time, pose, (0.0,) * self._k)], _KEPT_POSES)
        self._at_fix = self._past[0]
        self._last_fix = (self._past[0], np.zeros(3))  # where odometry was at the last fix, and how far from it
        self._doubted: _Odometry | None = None  # since when, where, at which travel
        self.doubt, self.contradiction, self.slipped, self.localized = "", "", 0.0, False
        self._within = self.params.believe_within  # [m] of odometry, where fixes that agree are believed in the end
        self._trusting = False
        self._seen: tuple[_Odometry, Array] | None = None  # where odometry was at the last fix that was taken, and it
        self._watch.reset()
        self._P = np.zeros((3 + self._k, 3 + self._k))
        for i in range(self._k):
            self._P[3 + i, 3 + i] = self.params.slip**2

    def trust(self) -> None:
        """Take the next fix for true, whatever odometry says: somebody has looked where the robot is."""
        if self.contradiction or self._doubted is not None:
            self._trusting = True

    def update(self, measurement: Measurement) -> Array:
        """Take in a measurement; returns the estimated coordinate row (nv,) at its time."""
        dt = measurement.time - self._time
        self._time = measurement.time
        self._joints = measurement.joints
        if not self._k:
            return self._joints.copy()
        if measurement.drive is None:
            self._coast(dt)
        else:
            if self._lost_since is not None and self._back_at is None:
                self._back_at = measurement.time
            drive = measurement.drive.tolist()
            self._sum = [s + u for s, u in zip(self._sum, drive, strict=True)]
            travel = self._travelled([u * (1.0 - s) for u, s in zip(drive, self._slip, strict=True)])
            self._pose = compose(self._pose, exp(travel))
            if dt > 0.0:
                self._twist = (travel[0] / dt, travel[1] / dt, travel[2] / dt)
        self._past.append((self._time, self._pose, tuple(self._sum)))
        if measurement.pose is not None and measurement.pose_time is not None:
            self._blend(measurement.pose_time, measurement.pose.tolist(), measurement.pose_covariance)
        return np.concatenate((self._pose, self._joints))

    def _travelled(self, drive: list[float]) -> Pose:
        """Body travel of drive travel."""
        if self._k == 2:
            return 0.5 * (drive[0] + drive[1]), 0.0, (drive[1] - drive[0]) / self.limits.track
        return drive[0], drive[1], drive[2]

    def _coast(self, dt: float) -> None:
        """Odometry is lost: extrapolate for a moment, and mark the pose as lost."""
        if self._lost_since is None:
            self._lost_since = self._time - dt
        self._back_at = None
        if self._time - self._lost_since <= self.params.coast + TIME_SLACK:
            vx, vy, turn = self._twist
            self._pose = compose(self._pose, exp((vx * dt, vy * dt, turn * dt)))

    def _blend(self, at: float, fix: list[float], covariance: Array | None) -> None:
        """Correct all poses since the time ``at`` [s] by a fix that was measured then."""
        past = self._lookup(at)
        if past is None:
            return  # older than the kept poses, or than the last fix
        p, P = self.params, self._predicted(past)
        found = self._lost_since is not None and self._back_at is not None and at >= self._back_at - TIME_SLACK
        if found or self._trusting:  # the travel since the loss is unknown
            P[:3, :3] = np.eye(3)
            self._forget()
        _, pose, _ = past
        error = np.array(log(compose(inverse(pose), (fix[0], fix[1], fix[2]))))
        noise = np.diag([p.fix_noise**2, p.fix_noise**2, p.fix_angle_noise**2]) if covariance is None else covariance
        self.slipped, self.localized = 0.0, True
        beyond = bool(self.contradiction) or error @ np.linalg.solve(P[:3, :3] + noise, error) > p.gate**2
        if beyond and not self._believed(past, fix, error, noise):
            return
        if self.contradiction or (self._doubted is not None and beyond):
            self._forget()
        drift = self._drift(past, fix, noise)
        if drift is not None:
            self._distrust(past, fix, error, drift)
            return
        if self.slipped or self._doubted is not None:  # the filter does not know how far off odometry is
            P[:3, :3] += np.diag([*np.repeat(error[:2] @ error[:2], 2), error[2] ** 2])
        self.doubt, self._doubted = "", None
        self._last_fix = (past, np.zeros(3))
        gain = np.linalg.solve(P[:3, :3] + noise, P[:3]).T  # (3 + k, 3), P is symmetric
        self._P = P - gain @ P[:3]
        delta = (gain @ error).tolist()
        self._slip = [max(-0.1, min(0.1, s + d)) for s, d in zip(self._slip, delta[3:], strict=True)]
        # carry the correction along the odometry since: all later poses move rigidly with the one corrected
        moved = compose(pose, exp((delta[0], delta[1], delta[2])))
        shift = compose(moved, inverse(pose))
        self._pose = compose(shift, self._pose)
        self._past = deque(
            ((t, compose(shift, q), s) for t, q, s in self._past if t >= at - 2.0 * TIME_SLACK), _KEPT_POSES
        )
        self._at_fix = (at, moved, past[2])
        self._seen = self._at_fix, np.array(fix)
        if found:
            self._lost_since = self._back_at = None

    def _forget(self) -> None:
        """Compare later fixes with later odometry alone: what was before is explained."""
        self.contradiction, self._within, self._trusting = "", self.params.believe_within, False
        self._seen = None
        self._watch.reset()

    def _drift(self, past: _Odometry, fix: list[float], noise: Array) -> Drift | None:
        """How a fix and those before it drift from odometry, if no wheels that slip explain it."""
        sigma = np.sqrt(np.diag(noise))
        if self._seen is None:
            return self._watch.add(past[0], np.zeros(3), np.zeros(self._k), sigma)
        last, before = self._seen
        by_odometry = compose(inverse(last[1]), past[1])
        by_fixes = compose(inverse((before[0], before[1], before[2])), (fix[0], fix[1], fix[2]))
        turned = math.remainder(by_fixes[2] - by_odometry[2], 2.0 * math.pi)
        # the heading goes wrong evenly, and the base moves along its mean heading, however far
        seen = compose((0.0, 0.0, -0.5 * (turned + by_odometry[2])), by_fixes)
        told = compose((0.0, 0.0, -0.5 * by_odometry[2]), by_odometry)
        shift = np.array([seen[0] - told[0], seen[1] - told[1], turned])
        return self._watch.add(past[0], shift, np.abs(np.subtract(past[2], last[2])), sigma)

    def _distrust(self, past: _Odometry, fix: list[float], error: Array, drift: Drift) -> None:
        """Believe fixes no longer, and take back by how much they have shifted the estimate along the drift's axis."""
        self.doubt = self.contradiction = str(drift)
        self._doubted = (past[0], (fix[0], fix[1], fix[2]), past[2])
        shifted = drift.rate * drift.span
        back = np.zeros(3)
        back[drift.axis] = error[drift.axis] - shifted
        moved = compose(past[1], exp((float(back[0]), float(back[1]), float(back[2]))))
        shift = compose(moved, inverse(past[1]))
        self._pose = compose(shift, self._pose)
        self._past = deque(((t, compose(shift, q), s) for t, q, s in self._past), _KEPT_POSES)
        self._at_fix = (self._at_fix[0], compose(shift, self._at_fix[1]), self._at_fix[2])
        self._P[drift.axis, drift.axis] += back[drift.axis] ** 2
        self._within = 6.0 * self.params.fix_noise + (abs(shifted) if drift.axis < 2 else 0.0)

    def _believed(self, past: _Odometry, fix: list[float], error: Array, noise: Array) -> bool:
        """Whether a fix that contradicts odometry is to be believed: wheels slip, or the robot was pushed."""
        p, (last, before) = self.params, self._last_fix
        self._last_fix = (past, error)
        spread = 6.0 * np.sqrt(np.diag(noise))
        turned = max(abs(error[2]), abs(before[2])) + spread[2]
        bounds = slip_bounds(self.limits, np.abs(np.subtract(past[2], last[2])), p.side_slip, turned)
        off = math.hypot(*error[:2])
        if self._doubted is None and (np.abs(error - before) <= bounds + spread).all():
            self.slipped = off
            return True
        beside = f"{off:.1f} m and {math.degrees(abs(error[2])):.0f}°"
        self.doubt = self.contradiction or f"fixes are {beside} from what odometry says"
        there = self._doubted
        if there is not None:
            moved = float(np.abs(np.subtract(past[2], there[2])).max())
            apart = math.hypot(fix[0] - there[1][0], fix[1] - there[1][1])
        if there is None or moved > 1e-3 + 2.0 * p.drift or apart > 2.0 * spread[0]:
            self._doubted = (past[0], (fix[0], fix[1], fix[2]), past[2])
            return False
        return off <= self._within and past[0] - there[0] >= p.believe_after

    def _lookup(self, at: float) -> _Odometry | None:
        """Odometry at a past time, interpolated between the kept poses."""
        later = None
        for entry in reversed(self._past):
            if entry[0] <= at + TIME_SLACK:
                if later is None or at - entry[0] <= TIME_SLACK:
                    return entry
                s = (at - entry[0]) / (later[0] - entry[0])
                travel = log(compose(inverse(entry[1]), later[1]))
                pose = compose(entry[1], exp((s * travel[0], s * travel[1], s * travel[2])))
                return at, pose, tuple(a + s * (b - a) for a, b in zip(entry[2], later[2], strict=True))
            later = entry
        return None

    def _predicted(self, past: _Odometry) -> Array:
        """Covariance of pose and slip at a time after the last fix; errors live in the base's own frame."""
        p, k = self.params, self._k
        dt = max(past[0] - self._at_fix[0], 0.0)
        x, y, turn = compose(inverse(self._at_fix[1]), past[1])
        cos, sin = math.cos(turn), math.sin(turn)
        F = np.eye(3 + k)
        F[:2, :3] = [[cos, sin, sin * x - cos * y], [-sin, cos, cos * x + sin * y]]
        travel = np.array([b - a for a, b in zip(self._at_fix[2], past[2], strict=True)])
        F[:3, 3:] = -self._to_twist * travel
        F[1, 3:] += 0.5 * x * F[2, 3:]  # the heading's error grows evenly, and the base drives along it
        keep = math.exp(-dt / p.slip_time)
        for i in range(k):
            F[3 + i, 3 + i] = keep
        P = F @ self._P @ F.T
        P[range(3), range(3)] += p.drift**2 * dt
        P[range(3, 3 + k), range(3, 3 + k)] += p.slip**2 * (1.0 - keep * keep)
        return P


_KEPT_SAMPLES = 200


class PoseBuffer:
    """Workspace: the last estimates of a base's pose."""

    def __init__(self) -> None:
        self._entries: deque[tuple[float, Array]] = deque(maxlen=_KEPT_SAMPLES)

    def add(self, t: float, estimate: Array) -> None:
        """Add an estimated coordinate row (nv,), which begins with x, y [m], yaw [rad], at time ``t`` [s]."""
        self._entries.append((t, np.array(estimate[:3])))

    def at(self, t: float) -> Array:
        """(3,) pose of the estimate that is nearest to time ``t`` [s]."""
        return min(self._entries, key=lambda entry: abs(entry[0] - t))[1]

    def velocity(self, over: int) -> Array:
        """(2,) speed [m/s] and yaw rate [rad/s] over the last ``over`` estimates."""
        (t0, a), (t1, b) = self._entries[max(-over, -len(self._entries))], self._entries[-1]
        if t1 <= t0:
            return np.zeros(2)
        forward = np.array([np.cos(b[2]), np.sin(b[2])]) @ (b[:2] - a[:2])
        return np.array([forward, np.remainder(b[2] - a[2] + np.pi, 2.0 * np.pi) - np.pi]) / (t1 - t0)
