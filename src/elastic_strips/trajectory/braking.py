"""Braking: the earliest stop on the way that a trajectory takes anyway."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from .limits import MotionLimits
from .path import integrate_travel
from .speed_profile import Profile, broken_limit
from .trajectory import Trajectory

_MARGINS = (0.98, 0.995, 0.93, 0.85)
_STOPPED = 1e-9  # squared part of the trajectory's own speed that counts as none


def brake(trajectory: Trajectory, t: float, *, limits: MotionLimits | None = None, dt: float = 0.01) -> Trajectory:
    """The trajectory from time ``t`` [s] on, slowed down as fast as the limits allow until it stands.

    The way stays the same, to within what its samples resolve (micrometres): only the time along it is stretched.
    Where that gains nothing (it brakes already, or stands) this is what is left of the trajectory; either way it ends
    at rest if the trajectory does.

    Args:
        trajectory: what the robot drives.
        t: when to begin [s].
        limits: to brake with; the trajectory's own where None. It must keep them itself.
        dt: distance of the samples [s].
    """
    rest = trajectory.tail(t)
    limits = trajectory.limits if limits is None else limits
    first = max(int(np.searchsorted(trajectory.time, t, side="right")) - 1, 0)
    if t > trajectory.end_time - dt or not trajectory.v[first:].any():
        return rest
    time = trajectory.time[first:]
    y = np.zeros((len(time), limits.drive_dim + len(limits.joint_speed)))
    np.cumsum(limits.to_coordinates(trajectory.steps[first:]), axis=0, out=y[1:])
    v = limits.to_coordinates(trajectory.v[first:])
    own = _Timed(time, y, v, max(t, trajectory.start_time))
    for margin in _MARGINS:
        profile = own.slowest(margin * limits.acceleration)
        stop = None if profile is None else _sampled(own, profile, trajectory, rest.chart[0], limits, dt)
        if stop is not None and stop.end_time <= rest.end_time:
            return stop
    return rest


class _Timed:
    """Travel (N, m) over the trajectory's own time τ, with velocities that are linear in between."""

    def __init__(self, time: Array, y: Array, v: Array, begin: float) -> None:
        self.time, self.y, self.v, self.begin = time, y, v, begin
        self.a = (v[1:] - v[:-1]) / (time[1:] - time[:-1])[:, None]

    def __call__(self, tau: Array) -> tuple[Array, Array, Array]:
        """Travel (cubic in between), velocity and acceleration (M, m) at τ (M,)."""
        i = np.searchsorted(self.time[1:-1], tau, side="right")
        h = (self.time[i + 1] - self.time[i])[:, None]
        s = (tau - self.time[i])[:, None] / h
        before, after, mean = self.v[i], self.v[i + 1], (self.y[i + 1] - self.y[i]) / h
        square, cube = 3.0 * mean - 2.0 * before - after, before + after - 2.0 * mean
        return self.y[i] + h * s * (before + s * (square + s * cube)), before + s * h * self.a[i], self.a[i]

    def slowest(self, acceleration: Array) -> Profile | None:
        """The profile over τ that falls from rate 1 as fast as |ÿτ̇² + ẏτ̈| ≤ a allows; None where it does not reach 0.

        At a rate below 1 the trajectory's acceleration is within its limit, so a constant rate is always allowed; and
        of two ways down the lower one stays below the other, so each step may take the hardest braking there is.
        """
        time, v = self.time.copy(), self.v.copy()
        v[0] = v[0] + (self.begin - time[0]) * self.a[0]
        time[0] = self.begin
        h = time[1:] - time[:-1]
        a = np.hstack([v[:-1], v[1:] + 2.0 * h[:, None] * self.a]) / np.tile(acceleration, 2)
        b = np.tile(self.a / acceleration, 2)
        flat = np.abs(a) < 1e-9
        room = np.where(flat, np.inf, 1.0 / np.where(flat, 1.0, np.abs(a)))
        slope = np.where(flat, 0.0, np.sign(a) * b / np.where(flat, 1.0, np.abs(a)))
        x = np.ones(len(time))
        for i in range(len(h)):
            u = min(float((-room[i] - slope[i] * x[i]).max()), 0.0)
            x[i + 1] = x[i] + 2.0 * h[i] * u
            if x[i + 1] <= _STOPPED:
                grid = np.append(time[: i + 1], time[i] - x[i] / (2.0 * u))
                return Profile.of(grid, np.append(x[: i + 1], 0.0))
        return None


def _sampled(
    own: _Timed, profile: Profile, trajectory: Trajectory, start: Array, limits: MotionLimits, dt: float
) -> Trajectory | None:
    time = np.arange(np.ceil(profile.duration / dt - 1e-9) + 1.0) * dt
    tau, rate, change = profile(np.minimum(time, profile.duration))
    y, slope, bend = own(tau)
    v, a = slope * rate[:, None], bend * (rate * rate)[:, None] + slope * change[:, None]
    v[-1] = a[-1] = 0.0
    if broken_limit(time, y, v, a, limits.speed, limits.acceleration):
        return None
    return Trajectory(
        robot=trajectory.robot,
        limits=limits,
        time=time + own.begin,
        chart=integrate_travel(trajectory.robot, limits, start, y),
        v=limits.to_tangent(v),
        a=limits.to_tangent(a),
    )
