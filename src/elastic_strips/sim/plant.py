"""Plants: the interface of simulated machines, their odometry and localization, and a fast kinematic plant with lag,
slip and jitter."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Protocol

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.estimation import TIME_SLACK, Pose, compose, exp
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import Bound, Checked, NonNegative, check_fields, named_arguments

STANDING_SPEED = 1e-3
"""Speed [m/s, rad/s] of bases and joints below which a machine stands."""
_Margin = Annotated[float, Bound(low=1.0, infinite=True)]
_Slip = Annotated[float, Bound(low=0.0, high=0.2)]


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryParams(Checked):
    """Errors of encoders and localization. All noise is Gaussian, cut off at three standard deviations.

    Attributes:
        encoder_noise: noise of a wheel's reading [m at the rim]; readings err, not increments, so it does not add up.
        joint_noise: noise of a joint encoder [rad or m].
        fix_period: time between localization fixes [s]; infinite for none.
        fix_noise: noise of a fix's x and of its y [m].
        fix_angle_noise: noise of its yaw [rad].
        fix_latency: time from the measurement of a fix to its arrival [s].
    """

    encoder_noise: NonNegative = 5e-5
    joint_noise: NonNegative = 2e-4
    fix_period: Annotated[float, Bound(above=0.0, infinite=True)] = 0.05
    fix_noise: NonNegative = 0.003
    fix_angle_noise: NonNegative = 0.003
    fix_latency: NonNegative = 0.02

    @staticmethod
    def ideal() -> OdometryParams:
        """Exact readings; fixes come at once."""
        return OdometryParams(encoder_noise=0.0, joint_noise=0.0, fix_noise=0.0, fix_angle_noise=0.0, fix_latency=0.0)


def _standard_normals(rng: np.random.Generator, block: int = 1024) -> Iterator[float]:
    """Endless standard normal numbers cut off at ±3, drawn in blocks: a number costs as much as a list's next."""
    while True:
        yield from np.clip(rng.standard_normal(block), -3.0, 3.0).tolist()


class Odometry:
    """Workspace: measurements of true states; shared by all plants.

    Args:
        params: sizes of the errors.
        rng: source of the noise.
        count: (k, n) numbers of drive coordinates and joints.
    """

    def __init__(self, params: OdometryParams, rng: np.random.Generator, count: tuple[int, int]) -> None:
        self.params = params
        self._rng = rng
        self._normal = _standard_normals(rng)
        self._drives, self._joints = count
        self._lost_until = -math.inf
        self.reset(0.0, (0.0,) * self._drives)

    def reset(self, time: float, travel: Sequence[float]) -> None:
        """Restart at a time [s] with the drive's travel (k,) so far; a loss of odometry ends."""
        self._reading = list(travel)
        self._next_fix = time + self.params.fix_period
        self._pending: deque[tuple[float, float, float, float]] = deque()
        self._lost_until = -math.inf

    def lose_odometry(self, until: float) -> None:
        """Measure no encoder travel and no fix up to the time ``until`` [s]; delayed fixes are lost, too."""
        self._lost_until = until
        self._pending.clear()

    def measure(
        self, time: float, travel: Sequence[float], joints: Array, pose: tuple[float, float, float] | None
    ) -> Measurement:
        """The measurement of a true state.

        Args:
            time: time [s].
            travel: (k,) true travel of the drive coordinates since the reset, as the encoders turn [m or rad].
            joints: (n,) true joint positions.
            pose: true base pose x, y, yaw; None for a fixed base.
        """
        p, normal = self.params, self._normal
        noise = p.encoder_noise
        before, self._reading = self._reading, [s + noise * next(normal) for s in travel]
        if p.joint_noise > 0.0:
            white = self._rng.standard_normal(self._joints)
            joints = joints + p.joint_noise * np.minimum(np.maximum(white, -3.0), 3.0)
        else:
            joints = joints.copy()
        if pose is None:
            return Measurement(time, np.zeros(0), joints)
        if time <= self._lost_until + TIME_SLACK:
            while self._next_fix <= time + TIME_SLACK:
                self._next_fix += p.fix_period
            return Measurement(time, None, joints)
        drive = np.array([b - a for a, b in zip(before, self._reading, strict=True)])
        if time >= self._next_fix - TIME_SLACK:
            while self._next_fix <= time + TIME_SLACK:
                self._next_fix += p.fix_period
            x, y, yaw = pose
            self._pending.append(
                (
                    time,
                    x + p.fix_noise * next(normal),
                    y + p.fix_noise * next(normal),
                    yaw + p.fix_angle_noise * next(normal),
                )
            )
        if self._pending and self._pending[0][0] + p.fix_latency <= time + TIME_SLACK:
            at, *fix = self._pending.popleft()
            return Measurement(time, drive, joints, np.array(fix), at)
        return Measurement(time, drive, joints)


_STICTION_SPEED = 5e-4  # [m/s, rad/s] a motor with zero command stands below this speed


def speed_loop(v: float, u: float, lag: float, push: float, h: float) -> tuple[float, float]:
    """Speed and travel after ``h`` [s] of ``dv/dt = clip((u − v)/lag, ±push)``, exactly."""
    way, gap = 0.0, u - v
    if gap == 0.0:
        return v, v * h
    knee = push * lag if lag > 0.0 else 0.0
    if abs(gap) > knee and push < math.inf:
        change = math.copysign(push, gap)
        ramp = (abs(gap) - knee) / push
        if ramp >= h:
            return v + change * h, (v + 0.5 * change * h) * h
        way = (v + 0.5 * change * ramp) * ramp
        v += change * ramp
        h -= ramp
        gap = u - v
    if lag <= 0.0:
        return u, way + u * h
    left = math.exp(-h / lag)
    way += u * h - gap * lag * (1.0 - left)
    v = u - gap * left
    if u == 0.0 and abs(v) < _STICTION_SPEED:
        v = 0.0
    return v, way


_LONGEST_ARC = 0.005  # [s] longest time that is integrated as one arc


@named_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class PlantParams:
    """How a machine differs from its plan.

    Attributes:
        wheel_lag: time constant of the wheels' speed loops [s].
        joint_lag: time constant of the joints' speed loops [s].
        speed_margin: the motors can turn this many times as fast as the limits that are planned with.
        acceleration_margin: they can speed up or brake this many times as hard. The defaults are assumptions; a machine
            without such margins is planned with ``limits.scaled(…)``.
        slip: largest part of a rim's travel that is lost (or gained) on the floor, for each wheel; for an
            omnidirectional base per body axis. It wanders between ±slip with a standard deviation of half of it.
        slip_time: correlation time of that [s].
        slip_noise: standard deviation of further slip, drawn anew in every step.
        jitter: a command arrives late by up to this [s], evenly distributed; the one before holds meanwhile.
        odometry: errors of the measurements.
    """

    wheel_lag: NonNegative = 0.04
    joint_lag: NonNegative = 0.03
    speed_margin: _Margin = 1.1
    acceleration_margin: _Margin = 1.5
    slip: _Slip = 0.02
    slip_time: NonNegative = 1.0
    slip_noise: _Slip = 0.002
    jitter: NonNegative = 0.002
    odometry: OdometryParams = field(default_factory=OdometryParams)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.slip > 0.0 and self.slip_time == 0.0:
            raise ParameterError("slip_time=0 must be positive; slip_noise is what changes from step to step")

    @staticmethod
    def seen_closely() -> PlantParams:
        """With fixes to half a millimetre and half a milliradian, as from a camera at the hand for the things it looks
        at; for :meth:`DriveParams.standing`."""
        return PlantParams(odometry=OdometryParams(fix_noise=5e-4, fix_angle_noise=5e-4))

    @staticmethod
    def ideal() -> PlantParams:
        """No lag, limits of speed or acceleration, slip, jitter, noise or latency: commands are driven exactly."""
        return PlantParams(
            wheel_lag=0.0,
            joint_lag=0.0,
            speed_margin=math.inf,
            acceleration_margin=math.inf,
            slip=0.0,
            slip_noise=0.0,
            jitter=0.0,
            odometry=OdometryParams.ideal(),
        )


class Plant(Protocol):
    """A simulated machine: commands in, measurements out; its true state is for the evaluation."""

    @property
    def robot(self) -> RobotModel:
        """The robot that it simulates."""
        ...

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        ...

    @property
    def coordinates(self) -> Array:
        """(nv,) true configuration as a coordinate row."""
        ...

    @property
    def v(self) -> Array:
        """(nv,) true velocity: body twist, joint rates."""
        ...

    @property
    def motors(self) -> Array:
        """(k,) true speeds of the drive's motors, at the rim and without slip [m/s; rad/s for a yaw]."""
        ...

    def reset(self, coordinates: Array, time: float = 0.0) -> None:
        """Put the robot at a coordinate row (nv,), at rest, at a time [s]."""
        ...

    def step(self, command: Command, dt: float) -> Measurement:
        """Apply a command for ``dt`` [s] and measure at the end."""
        ...

    def lost_odometry(self, until: float) -> None:
        """Measure no encoder travel and no fix up to the time ``until`` [s]."""
        ...

    def close(self) -> None:
        """Release resources."""
        ...


class KinematicPlant:
    """Speed loops with lag and limited acceleration, wheels that slip, exact arcs; about 40 µs per step.

    A zero command brakes a speed v to below w = 0.01 m/s within ``v/a − τ + τ ln(aτ/w)`` where v > aτ, else within
    ``τ ln(v/w)``, plus the jitter; τ is the lag, a the limit of the acceleration times its margin.
    Below 0.0005 m/s it stands still: friction.

    Args:
        robot: the robot; any kind of base.
        limits: limits with which its motions are planned.
        params: how the machine differs from its plan.
        seed: seed of all noise, or a generator.

    Attributes:
        lost: (k,) further part of each drive coordinate's travel that is lost on the floor, as a fault.

    Raises:
        ParameterError: limits that do not fit the robot.
    """

    lost: list[float]

    @named_arguments
    def __init__(
        self,
        robot: RobotModel,
        limits: MotionLimits,
        params: PlantParams | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        params = PlantParams() if params is None else params
        check_limits(robot, limits)
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: PlantParams = params
        self._rng = np.random.default_rng(seed)
        self._normal = _standard_normals(self._rng)
        self._k, self._n = len(limits.drive_speed), len(limits.joint_speed)
        self._top = (limits.drive_speed * params.speed_margin).tolist()
        self._push = (limits.drive_acceleration * params.acceleration_margin).tolist()
        self._joint_top = (limits.joint_speed * params.speed_margin).tolist()
        self._joint_push = (limits.joint_acceleration * params.acceleration_margin).tolist()
        first = robot.space.base_nv
        self._lower, self._upper = robot.space.lower[first:].tolist(), robot.space.upper[first:].tolist()
        self._odometry = Odometry(params.odometry, self._rng, (self._k, self._n))
        self.reset(robot.space.to_coordinates(robot.home_q))

    @property
    def time(self) -> float:
        return self._time

    @property
    def coordinates(self) -> Array:
        return np.array([*self._pose, *self._joints] if self._k else self._joints)

    @property
    def v(self) -> Array:
        if not self._k:
            return np.array(self._joint_speed)
        ground = [w * (1.0 - s - x) for w, s, x in zip(self._wheel, self._slip, self.lost, strict=True)]
        return np.array([*self._twist(ground), *self._joint_speed])

    @property
    def motors(self) -> Array:
        return np.array(self._wheel)

    @property
    def slip(self) -> Array:
        """(k,) part of each drive coordinate's travel that is lost now."""
        return np.array(self._slip)

    def reset(self, coordinates: Array, time: float = 0.0) -> None:
        """Put the robot at a coordinate row (nv,) at rest; the wheels' slip is drawn anew."""
        values = [float(x) for x in coordinates]
        first = self.robot.space.base_nv
        self._time = float(time)
        self._pose: Pose = (values[0], values[1], values[2]) if self._k else (0.0, 0.0, 0.0)
        self._joints = values[first:]
        self._wheel, self._travel = [0.0] * self._k, [0.0] * self._k
        self._joint_speed = [0.0] * self._n
        self._command: tuple[list[float], list[float]] = ([0.0] * self._k, [0.0] * self._n)
        half = 0.5 * self.params.slip
        self._wander = [half * next(self._normal) for _ in range(self._k)]
        self._slip = [max(-2.0 * half, min(2.0 * half, s)) for s in self._wander]
        self.lost: list[float] = [0.0] * self._k
        self._odometry.reset(self._time, self._travel)

    def step(self, command: Command, dt: float) -> Measurement:
        """Apply a command for ``dt`` [s]; it arrives late by the jitter.

        Raises:
            ParameterError: a command of the wrong size or not finite.
        """
        drive, joints = command.drive.tolist(), command.joints.tolist()
        if len(drive) != self._k or len(joints) != self._n or not math.isfinite(sum(drive) + sum(joints)):
            raise ParameterError(
                f"command {drive} and {joints}: {self._k} finite speeds of the drive and {self._n} of joints are needed"
            )
        if command.stop:
            drive, joints = [0.0] * self._k, [0.0] * self._n
        drive = [max(-top, min(top, u)) for u, top in zip(drive, self._top, strict=True)]
        joints = [max(-top, min(top, u)) for u, top in zip(joints, self._joint_top, strict=True)]
        p = self.params
        if self._k and (p.slip > 0.0 or p.slip_noise > 0.0):
            self._change_slip(dt)
        if p.jitter > 0.0:
            late = min(p.jitter * float(self._rng.random()), dt)
            self._advance(late)
            self._command = (drive, joints)
            self._advance(dt - late)
        else:
            self._command = (drive, joints)
            self._advance(dt)
        self._time += dt
        pose = self._pose if self._k else None
        return self._odometry.measure(self._time, self._travel, np.array(self._joints), pose)

    def lost_odometry(self, until: float) -> None:
        """Measure no encoder travel and no fix up to the time ``until`` [s]."""
        self._odometry.lose_odometry(until)

    def close(self) -> None:
        """Nothing to release."""

    def _change_slip(self, dt: float) -> None:
        p = self.params
        keep = math.exp(-dt / p.slip_time) if p.slip > 0.0 else 0.0
        kick = 0.5 * p.slip * math.sqrt(1.0 - keep * keep)
        normal, most = self._normal, p.slip
        self._wander = [max(-most, min(most, keep * s + kick * next(normal))) for s in self._wander]
        self._slip = [s + p.slip_noise * next(normal) for s in self._wander]

    def _advance(self, h: float) -> None:
        """Integrate for ``h`` [s] under the present command."""
        if h <= 0.0:
            return
        p = self.params
        drive, joints = self._command
        if self._k:
            pieces = max(1, math.ceil(h / _LONGEST_ARC - 1e-9))
            piece = h / pieces
            for _ in range(pieces):
                ground = []
                for i in range(self._k):
                    self._wheel[i], way = speed_loop(self._wheel[i], drive[i], p.wheel_lag, self._push[i], piece)
                    self._travel[i] += way
                    ground.append(way * (1.0 - self._slip[i] - self.lost[i]))
                self._pose = compose(self._pose, exp(self._twist(ground)))
        for i in range(self._n):
            speed, way = speed_loop(self._joint_speed[i], joints[i], p.joint_lag, self._joint_push[i], h)
            at = self._joints[i] + way
            if not self._lower[i] <= at <= self._upper[i]:
                at, speed = min(max(at, self._lower[i]), self._upper[i]), 0.0
            self._joints[i], self._joint_speed[i] = at, speed

    def _twist(self, drive: list[float]) -> Pose:
        """``MotionLimits.to_twist`` of one vector, on floats."""
        if self._k == 2:
            left, right = drive
            return 0.5 * (left + right), 0.0, (right - left) / self.limits.track
        return drive[0], drive[1], drive[2]


def check_limits(robot: RobotModel, limits: MotionLimits) -> None:
    """Check that limits have the robot's numbers of drive coordinates and joints.

    Raises:
        ParameterError: they do not.
    """
    wanted = {"diff_drive": 2, "omni": 3, "fixed": 0}[robot.base_kind.value]
    joints = len(robot.joint_names)
    if len(limits.drive_speed) != wanted or len(limits.joint_speed) != joints:
        raise ParameterError(
            f"limits have {len(limits.drive_speed)} drive coordinates and {len(limits.joint_speed)} joints; "
            f"{robot.name!r} ({robot.base_kind.value}) has {wanted} and {joints}"
        )
