"""Scene room, keyframes: a motion through poses at given times."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_strips.errors import SceneError
from elastic_strips.scene import checks
from elastic_strips.scene.checks import Array
from elastic_strips.scene.motion import MAX_SPEED, Motion, check_radius
from elastic_strips.summary import Summary


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

    times: Array
    positions: Array
    quats: Array | None
    loop: bool
    jumps: bool
    _linear: Array  # (K - 1,) speed of the origin in each piece [m/s]
    _angular: Array  # (K - 1,) [rad/s]

    def __init__(self, times: Any, positions: Any, *, quats: Any = None, loop: bool = False) -> None:
        put = object.__setattr__
        t = checks.array("Keyframes times", times, (None,))
        p = checks.array("Keyframes positions", positions, (None, 3))
        if len(p) != len(t):
            raise SceneError(f"Keyframes need one position per time: {len(p)} positions, {len(t)} times")
        late = np.flatnonzero(np.diff(t) <= 0.0)
        if late.size:
            k = int(late[0])
            raise SceneError(f"Keyframes times must increase strictly: times[{k + 1}] = {t[k + 1]:g} after {t[k]:g}")
        if not isinstance(loop, (bool, np.bool_)):
            raise SceneError(f"Keyframes loop must be true or false, not {checks.shown(loop)}")
        if loop and len(t) < 2:
            raise SceneError("a Keyframes loop needs at least two keyframes, not 1")
        rotations = np.zeros(len(t) - 1)
        q = None
        if quats is not None:
            raw = checks.array("Keyframes quats", quats, (None, 4), limit=1e3)
            if len(raw) != len(t):
                raise SceneError(f"Keyframes need one quaternion per time: {len(raw)} quaternions, {len(t)} times")
            norm = np.linalg.norm(raw, axis=1)
            bad = np.flatnonzero(np.abs(norm - 1.0) > checks.QUAT_TOLERANCE)
            if bad.size:
                checks.quaternion(f"Keyframes quats[{int(bad[0])}]", raw[bad[0]])  # raises, and says what is needed
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
        put(self, "times", t)
        put(self, "positions", p)
        put(self, "quats", q)
        put(self, "loop", bool(loop))
        put(self, "jumps", bool(loop and opened))
        put(self, "_linear", linear)
        put(self, "_angular", angular)

    @property
    def relative(self) -> bool:
        """False: keyframes are absolute."""
        return False

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
            result[:3, :3] = checks.rotation_of(_slerp(self.quats[k], self.quats[after], share))
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
        radius = check_radius(radius)
        begin = -math.inf if start is None else float(start)
        stop = math.inf if end is None else float(end)
        if not begin <= stop:
            raise SceneError(f"speed_bound needs start <= end, not {begin:g} and {stop:g} s")
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

    def __reduce__(self) -> tuple[Any, ...]:
        return _keyframes, (self.times, self.positions, self.quats, self.loop)

    def _phase(self, t: float) -> float:
        first, last = float(self.times[0]), float(self.times[-1])
        if first <= t < last:  # exact: a keyframe's own time belongs to the piece that begins there
            return t
        return first + (t - first) % (last - first)


def _keyframes(times: Array, positions: Array, quats: Array | None, loop: bool) -> Keyframes:
    return Keyframes(times, positions, quats=quats, loop=loop)


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
    """Rotation vector (3,) [rad], world frame, that turns ``a`` into ``b`` the short way (a @ b >= 0)."""
    axis = a[3] * b[:3] - b[3] * a[:3] - np.cross(b[:3], a[:3])  # vector part of b times the conjugate of a
    length = float(np.linalg.norm(axis))
    return axis * (_angle(a, b) / length) if length > 0.0 else np.zeros(3)
