"""Motions: how an obstacle moves with time, and how fast any of its points can get.

Motions that are known: `Twist`, `Keyframes`; one that is not: `UnknownMotion`. One whose rate a simulation sets:
`PedestrianMotion`; see `elastic_strips.sim.pedestrians`.
"""

from __future__ import annotations

import abc
import math
from bisect import bisect_right
from dataclasses import dataclass, fields
from functools import partial
from typing import ClassVar

import numpy as np

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import SceneError
from elastic_strips.summary import Summary
from elastic_strips.validation import check_number, named_arguments, shown

from .quantities import QUAT_TOLERANCE, check_points, check_quaternion, rotation_of

MAX_SPEED = 1e4
"""Largest linear [m/s] or angular [rad/s] speed that is accepted."""

_TRACK_SLACK = 1e-9  # [s] by which a place on a track may be rounded


class Motion(abc.ABC):
    """A rigid motion in the world frame; immutable, but for `PedestrianMotion`.

    Attributes:
        relative: Whether it starts from the obstacle's pose; else it gives absolute poses.
        still: Whether `pose` gives back the pose that it is given: an obstacle stays as it is in all snapshots.
    """

    __slots__ = ()
    relative: ClassVar[bool] = True
    still: ClassVar[bool] = False

    @abc.abstractmethod
    def pose(self, initial_pose: Array, t: float) -> Array:
        """Pose (4, 4) at time ``t`` [s] of an obstacle that has ``initial_pose`` (4, 4) at time 0."""

    @abc.abstractmethod
    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """Velocity of the obstacle's origin (3,) [m/s] and angular velocity (3,) [rad/s] at ``t`` [s], world frame.

        Where the velocity jumps, it is that from ``t`` on (the right-sided derivative of `pose`).
        """

    @abc.abstractmethod
    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of any point that is at most ``radius`` [m] away from the obstacle's origin.

        Args:
            radius: Distance from the obstacle's origin [m].
            start: Begin of the interval of time [s]; ``None`` is minus infinity.
            end: End of the interval [s]; ``None`` is plus infinity.
        """


@named_arguments
@dataclass(frozen=True, slots=True, eq=False)
class Twist(Motion):
    """A constant velocity: the origin moves at ``linear``, the orientation turns about it at ``angular``.

    Args:
        linear: Velocity of the obstacle's origin [m/s], world frame.
        angular: Angular velocity [rad/s], world frame; the orientation at t is exp(angular t) times the one at 0.

    Examples:
        >>> walk = es.Twist(linear=(0.0, 0.8, 0.0))
        >>> person = es.Capsule(0.25, 1.2, at=(2.0, -2.0, 0.85), name="person", motion=walk)
        >>> round(float(es.Scene([person]).at(1.0).obstacle("person").pose[1, 3]), 3)  # y, a second later [m]
        -1.2
    """

    linear: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    angular: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for key in ("linear", "angular"):
            object.__setattr__(self, key, check_points(f"Twist {key}", getattr(self, key), (3,), limit=MAX_SPEED))

    def pose(self, initial_pose: Array, t: float) -> Array:
        """Pose (4, 4) at time ``t`` [s]; see `Motion.pose`."""
        result = np.array(initial_pose, dtype=np.float64)
        result[:3, 3] += self.linear * t
        rate = math.sqrt(float(self.angular @ self.angular))
        if rate > 0.0 and t != 0.0:
            result[:3, :3] = _axis_rotation(self.angular / rate, rate * t) @ result[:3, :3]
        return result

    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """``linear`` and ``angular``, at all times; see `Motion.velocity`."""
        return self.linear, self.angular

    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of a point within ``radius`` [m] of the origin; the same at all times."""
        return float(np.linalg.norm(self.linear) + np.linalg.norm(self.angular) * _check_radius(radius))

    def __reduce__(self) -> tuple[object, ...]:
        return Twist, (self.linear, self.angular)


@dataclass(frozen=True, slots=True, eq=False)
class UnknownMotion(Motion):
    """A motion of which only a bound of the speed is known, as of an obstacle that was seen once.

    As far as is known the obstacle stays where it is: `pose` is its last pose and `velocity` is 0. But any of its
    points may be up to ``max_speed`` times the elapsed time away from there.

    Args:
        max_speed: Largest speed of any point of the obstacle [m/s].
    """

    still: ClassVar[bool] = True  # as far as is known
    max_speed: float

    def __post_init__(self) -> None:
        speed = check_number(
            "UnknownMotion max_speed", self.max_speed, low=0.0, high=MAX_SPEED, unit="m/s", error=SceneError
        )
        object.__setattr__(self, "max_speed", speed)

    def pose(self, initial_pose: Array, t: float) -> Array:
        """A copy of ``initial_pose`` (4, 4), at all times."""
        return np.array(initial_pose, dtype=np.float64)

    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """Zeros (3,) and (3,): no direction is known."""
        return np.zeros(3), np.zeros(3)

    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """``max_speed`` [m/s], whatever the ``radius``."""
        _check_radius(radius)
        return self.max_speed


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class Keyframes(Motion, Summary):
    """Absolute poses at given times; between them the position is linear and the orientation slerps.

    Before the first and after the last keyframe the obstacle rests there, unless ``loop`` repeats the motion for ever.
    A loop whose last pose is not its first one *jumps* (``jumps`` is true): `speed_bound` is infinite for an interval
    of time with a jump in it.

    Args:
        times: Strictly increasing times (K,) [s].
        positions: Positions of the obstacle's origin (K, 3) [m], world frame.
        quats: Unit quaternions (K, 4) (x, y, z, w), world frame; ``None`` keeps the obstacle's own orientation.
        loop: Repeat with the period ``times[-1] - times[0]``.
    """

    relative: ClassVar[bool] = False
    times: Array
    positions: Array
    quats: Array | None
    loop: bool
    jumps: bool
    _linear: Array  # (K - 1,) speed of the origin in each piece [m/s]
    _angular: Array  # (K - 1,) [rad/s]

    @named_arguments
    def __init__(
        self, times: ArrayLike, positions: ArrayLike, *, quats: ArrayLike | None = None, loop: bool = False
    ) -> None:
        t = check_points("Keyframes times", times, (None,))
        p = check_points("Keyframes positions", positions, (None, 3))
        if len(p) != len(t):
            raise SceneError(f"Keyframes need one position per time: {len(p)} positions, {len(t)} times")
        late = np.flatnonzero(np.diff(t) <= 0.0)
        if late.size:
            k = int(late[0])
            raise SceneError(f"Keyframes times must increase strictly: times[{k + 1}] = {t[k + 1]:g} after {t[k]:g}")
        if not isinstance(loop, (bool, np.bool_)):
            raise SceneError(f"Keyframes loop must be true or false, not {shown(loop)}")
        if loop and len(t) < 2:
            raise SceneError("a Keyframes loop needs at least two keyframes, not 1")
        rotations = np.zeros(len(t) - 1)
        q = None
        if quats is not None:
            raw = check_points("Keyframes quats", quats, (None, 4), limit=1e3)
            if len(raw) != len(t):
                raise SceneError(f"Keyframes need one quaternion per time: {len(raw)} quaternions, {len(t)} times")
            norm = np.linalg.norm(raw, axis=1)
            bad = np.flatnonzero(np.abs(norm - 1.0) > QUAT_TOLERANCE)
            if bad.size:
                check_quaternion(f"Keyframes quats[{int(bad[0])}]", raw[bad[0]])  # raises, and says what is needed
            q = raw / norm[:, None]
            q[1:] *= np.cumprod(np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))[:, None]  # slerp the short way
            a, b = q[:-1], q[1:]
            rotations = 4.0 * np.arctan2(np.linalg.norm(b - a, axis=1), np.linalg.norm(b + a, axis=1))
            q.flags.writeable = False
        spans = np.diff(t)
        linear, angular = np.linalg.norm(np.diff(p, axis=0), axis=1) / spans, rotations / spans
        if linear.size and max(linear.max(), angular.max()) > MAX_SPEED:
            k = int(np.argmax(np.maximum(linear, angular)))
            raise SceneError(
                f"Keyframes {k} to {k + 1} need {linear[k]:g} m/s and {angular[k]:g} rad/s; "
                f"at most {MAX_SPEED:g} is allowed"
            )
        opened = np.linalg.norm(p[-1] - p[0]) > 1e-9 or (q is not None and _angle(q[0], q[-1]) > 1e-9)
        jumps = bool(loop and opened)
        for f, value in zip(fields(self), (t, p, q, bool(loop), jumps, linear, angular), strict=True):
            object.__setattr__(self, f.name, value)

    def pose(self, initial_pose: Array, t: float) -> Array:
        """Pose (4, 4) at time ``t`` [s]; of ``initial_pose`` only the orientation counts, where ``quats`` is None."""
        times, positions = self.times, self.positions
        result = np.array(initial_pose, dtype=np.float64)
        phase = self._phase(t) if self.loop else min(max(t, float(times[0])), float(times[-1]))
        k = min(max(int(np.searchsorted(times, phase, side="right")) - 1, 0), max(len(times) - 2, 0))
        if len(times) == 1:
            share, after = 0.0, 0
        else:
            share, after = (phase - float(times[k])) / float(times[k + 1] - times[k]), k + 1
        result[:3, 3] = positions[k] + share * (positions[after] - positions[k])
        if self.quats is not None:
            result[:3, :3] = rotation_of(_slerp(self.quats[k], self.quats[after], share))
        return result

    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """Velocities (3,) [m/s] and (3,) [rad/s] of the piece that begins or lies at ``t``; see `Motion.velocity`.

        Zero before the first keyframe, and from the last one on unless the motion loops.
        """
        times = self.times
        if not self._linear.size or not (self.loop or float(times[0]) <= t < float(times[-1])):
            return np.zeros(3), np.zeros(3)
        phase = self._phase(t) if self.loop else t
        k = min(max(int(np.searchsorted(times, phase, side="right")) - 1, 0), len(times) - 2)
        span = float(times[k + 1] - times[k])
        linear = (self.positions[k + 1] - self.positions[k]) / span
        return linear, np.zeros(3) if self.quats is None else _turn(self.quats[k], self.quats[k + 1]) / span

    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of a point within ``radius`` [m] of the origin between ``start`` and ``end`` [s].

        Infinite if the loop jumps in that interval.
        """
        radius = _check_radius(radius)
        begin, stop = _interval(start, end)
        if not self._linear.size:
            return 0.0
        speeds = self._linear + radius * self._angular
        if not self.loop:
            moving = (self.times[:-1] <= stop) & (self.times[1:] >= begin)
            return float(speeds[moving].max(initial=0.0))
        first, last = float(self.times[0]), float(self.times[-1])
        period = last - first
        if not stop - begin < period:
            return math.inf if self.jumps else float(speeds.max())
        slack = 1e-9 * max(1.0, abs(begin), abs(stop))  # the phase is rounded, except in the first turn
        a = begin if first <= begin < last else self._phase(begin) - slack
        b = a + (stop - begin) + 2.0 * slack
        if self.jumps and (b >= last or a < first):
            return math.inf
        moving = (self.times[:-1] <= b) & (self.times[1:] >= a)
        for shift in (-period, period):
            moving |= (self.times[:-1] <= b + shift) & (self.times[1:] >= a + shift)
        return float(speeds[moving].max(initial=0.0))

    def __reduce__(self) -> tuple[object, ...]:
        return partial(Keyframes, quats=self.quats, loop=self.loop), (self.times, self.positions)

    def _phase(self, t: float) -> float:
        first, last = float(self.times[0]), float(self.times[-1])
        if first <= t < last:  # exact: a keyframe's own time belongs to the piece that begins there
            return t
        return first + (t - first) % (last - first)


class PedestrianMotion(Motion):
    """Workspace, the one motion that is not frozen: a track, and the history of the rate at which it was followed.

    At time t the obstacle is where the track is at its own time s(t). Before time 0, s = t; from then on the
    simulation sets the rate ds/dt in [-1, 1] by `advance` (below 0: backwards), which holds until it is set again.
    The past never changes. All copies of an obstacle share its motion.

    Args:
        track: Motion of the obstacle while nothing blocks it; a loop must not jump.
        acceleration: Largest acceleration of the obstacle in any direction, turns of the track included [m/s²]. The
            rates that are set must keep to it.

    Raises:
        SceneError: No track, one that jumps, or an acceleration that is not positive.
    """

    __slots__ = ("_places", "_rates", "_times", "acceleration", "track")

    relative: ClassVar[bool] = False
    track: Keyframes
    acceleration: float
    _times: list[float]  # begin of each piece of the history [s]; the first reaches back for ever
    _places: list[float]  # of the track [s], at these times
    _rates: list[float]

    def __init__(self, track: Keyframes, acceleration: float = math.inf) -> None:
        if not isinstance(track, Keyframes):
            raise SceneError(f"PedestrianMotion needs Keyframes as its track, not {shown(track)}")
        if track.jumps:
            raise SceneError("a PedestrianMotion cannot follow a loop that jumps: its last pose must be its first one")
        if not acceleration > 0.0:
            raise SceneError(f"PedestrianMotion acceleration={acceleration!r} must be positive [m/s²]")
        self.track, self.acceleration = track, float(acceleration)
        self.reset()

    def reset(self) -> None:
        """Delete the history: rate 1 at all times."""
        self._times, self._places, self._rates = [0.0, 0.0], [0.0, 0.0], [1.0, 1.0]

    def advance(self, t: float, rate: float) -> None:
        """Follow the track at ``rate`` in [-1, 1] from the time ``t`` [s] on, the latest so far or later.

        Raises:
            SceneError: A rate outside its range, or a time before the last one that was given.
        """
        if not -1.0 <= rate <= 1.0:
            raise SceneError(f"rate={rate!r} must lie in [-1, 1]")
        if not self._times[-1] <= t < math.inf:
            raise SceneError(f"time {t:g} s is before {self._times[-1]:g} s; the past cannot be changed")
        if rate == self._rates[-1]:
            return
        if t > self._times[-1]:
            self._places.append(self.place(t))
            self._times.append(float(t))
            self._rates.append(float(rate))
        else:
            self._rates[-1] = float(rate)

    def place(self, t: float) -> float:
        """The track's time s [s] at the time ``t`` [s]."""
        k = self._piece(t)
        return self._places[k] + self._rates[k] * (t - self._times[k])

    def rate(self, t: float) -> float:
        """ds/dt from the time ``t`` [s] on."""
        return self._rates[self._piece(t)]

    def pose(self, initial_pose: Array, t: float) -> Array:
        """Pose (4, 4) at time ``t`` [s]; see `Keyframes.pose`."""
        return self.track.pose(initial_pose, self.place(t))

    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """The track's velocities (3,) [m/s] and (3,) [rad/s], times the rate; see `Motion.velocity`."""
        k = self._piece(t)
        linear, angular = self.track.velocity(initial_pose, self._places[k] + self._rates[k] * (t - self._times[k]))
        return self._rates[k] * linear, self._rates[k] * angular

    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of a point within ``radius`` [m] of the origin between ``start`` and ``end`` [s].

        Exact for the past; for the future it holds for any rates.
        """
        radius = _check_radius(radius)
        begin, stop = _interval(start, end)
        last, first, final = self._times[-1], self._piece(begin), self._piece(stop)
        places = [self.place(min(begin, last)), *self._places[first + 1 : final + 1]]
        if stop > last:
            low, high, rate = min(places) - (stop - last), max(places) + (stop - last), 1.0
        else:
            places.append(self.place(stop))
            low, high, rate = min(places), max(places), max(map(abs, self._rates[first : final + 1]))
        return rate * self.track.speed_bound(radius, start=low - _TRACK_SLACK, end=high + _TRACK_SLACK)

    def copy(self, *, history: bool = True) -> PedestrianMotion:
        """Another motion along the same track, with the same history or with none."""
        new = PedestrianMotion(self.track, self.acceleration)
        if history:
            new._times, new._places, new._rates = list(self._times), list(self._places), list(self._rates)
        return new

    def _piece(self, t: float) -> int:
        return max(bisect_right(self._times, t) - 1, 0)


def check_motion(value: object) -> Motion | None:
    """Check that ``value`` is a `Motion` or None."""
    if value is not None and not isinstance(value, Motion):
        raise SceneError(
            f"motion must be a Twist, Keyframes, UnknownMotion, PedestrianMotion or None, not {shown(value)}"
        )
    return value


def _check_radius(value: float) -> float:
    """Check a distance from an obstacle's origin [m]."""
    radius = float(value)
    if not radius >= 0.0:
        raise SceneError(f"radius is {radius:g} m; it must be at least 0")
    return radius


def _interval(start: float | None, end: float | None) -> tuple[float, float]:
    """Begin and end [s] of an interval of time; None is infinity."""
    begin = -math.inf if start is None else float(start)
    stop = math.inf if end is None else float(end)
    if not begin <= stop:
        raise SceneError(f"speed_bound needs start <= end, not {begin:g} and {stop:g} s")
    return begin, stop


def _angle(a: Array, b: Array) -> float:
    """Angle [rad] in [0, pi] between two unit quaternions, accurate for small ones too."""
    if float(a @ b) < 0.0:
        b = -b
    return 4.0 * math.atan2(float(np.linalg.norm(b - a)), float(np.linalg.norm(b + a)))


def _slerp(a: Array, b: Array, share: float) -> Array:
    """Quaternion at ``share`` in [0, 1] of the way from ``a`` to ``b`` (a @ b >= 0)."""
    half = 0.5 * _angle(a, b)
    if half < 1e-9:
        return a
    q = (math.sin((1.0 - share) * half) * a + math.sin(share * half) * b) / math.sin(half)
    return q / np.linalg.norm(q)


def _turn(a: Array, b: Array) -> Array:
    """Rotation vector (3,) [rad], world frame, that turns ``a`` into ``b`` the shorter way (a @ b >= 0)."""
    axis = a[3] * b[:3] - b[3] * a[:3] - np.cross(b[:3], a[:3])  # vector part of b times the conjugate of a
    length = float(np.linalg.norm(axis))
    return axis * (_angle(a, b) / length) if length > 0.0 else np.zeros(3)


def _axis_rotation(axis: Array, angle: float) -> Array:
    """Rotation matrix (3, 3) about the unit ``axis`` by ``angle`` [rad]."""
    half = 0.5 * math.remainder(angle, 2.0 * math.pi)
    return rotation_of(np.append(axis * math.sin(half), math.cos(half)))
