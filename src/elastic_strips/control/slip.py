"""Slip: what wheels that slip can do to odometry, and whether they explain how fixes have moved against it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.trajectory import MotionLimits

SPANS = (1.0, 4.0)
"""Times [s] over which fixes are compared with odometry: what drifts fast shows in the first, what drifts slowly in the
second."""
_LEAST_PART = 0.5  # of such a time that has to be covered by fixes
_LEAST_FIXES = 4
_RANDOM_WALK_SLOPE = 1.2  # variance of the slope of a random walk: this times its variance at the end / duration²
_AXES = ("lengthwise", "sideways", "turning")


def slip_bounds(limits: MotionLimits, travel: Array, side_slip: float, turned: float) -> Array:
    """How far wheels that slip can shift the base against odometry.

    A wheel loses at most its travel, and only along itself: a differential drive is shifted lengthwise and turned, and
    sideways by a small part of its travel, or because its heading was wrong on the way. An omnidirectional base is
    shifted along each axis by at most its travel along it.

    Args:
        limits: kind of drive, and track.
        travel: (k,) travel of the drive coordinates [m or rad], without signs.
        side_slip: sideways part of the travel.
        turned: largest error of the heading on the way [rad].

    Returns:
        (3,) in the base's frame: x, y [m], yaw [rad].
    """
    if len(travel) == 2:
        far = float(travel.max())
        return np.array([far, far * (side_slip + turned), float(travel.sum()) / limits.track])
    far = float(np.hypot(travel[0], travel[1]))
    aside = far * (side_slip + turned)
    return np.array([travel[0] + aside, travel[1] + aside, travel[2] + 0.2 * float(travel.sum())])


@dataclass(frozen=True, slots=True)
class Drift:
    """Fixes that move steadily against odometry, as no wheels that slip explain.

    Attributes:
        axis: 0: lengthwise, 1: sideways, 2: turning.
        rate: how fast they do [m/s, rad/s], in the base's frame.
        span: for how long they were compared [s].
    """

    axis: int
    rate: float
    span: float

    def __str__(self) -> str:
        fast = f"{math.degrees(self.rate):.1f} °/s" if self.axis == 2 else f"{1e3 * self.rate:.0f} mm/s"
        return f"fixes drift from odometry, {_AXES[self.axis]} at {fast} over {self.span:.1f} s; no slip explains that"


class SlipWatch:
    """Workspace: how fixes have moved against odometry in the last seconds, axis by axis of the base.

    The slope of that over time is known much better than a single fix: with fixes of 3 mm at 20 Hz to 2.3 mm/s in one
    second. What it may come to is what the wheels travelled meanwhile, by :func:`slip_bounds`: the slope of a sum is
    a weighted sum of its increments, so bounds of these bound it.

    Args:
        limits: kind of drive, and track.
        side_slip: sideways part of the travel.
        wander: standard deviation of all other motion of the base after one second [m, rad].
        gate: standard deviations that a slope may be beyond what slip explains.
    """

    def __init__(self, limits: MotionLimits, side_slip: float, wander: float, gate: float) -> None:
        self._limits, self._side_slip, self._wander, self._gate = limits, side_slip, wander, gate
        self.reset()

    def reset(self) -> None:
        """Forget all fixes: the next one is compared with none."""
        self._rows: deque[Array] = deque()  # time; sums of shifts, of their bounds and of their variances; fixes' noise

    def add(self, t: float, shift: Array, travel: Array, noise: Array) -> Drift | None:
        """Take in a fix.

        Args:
            t: when it was measured [s].
            shift: (3,) by how much the base moved by fixes beyond what it moved by odometry since the last fix: x, y
                [m], yaw [rad] in its frame.
            travel: (k,) travel of the drive coordinates since then, without signs.
            noise: (3,) standard deviations of the fix.

        Returns:
            The drift that slip does not explain; None where it explains all.
        """
        row = np.zeros(13)
        if self._rows:
            last, bound = self._rows[-1], slip_bounds(self._limits, travel, self._side_slip, 0.0)
            wander = self._wander**2 * (t - last[0]) + (np.array([0.0, 1.0, 0.0]) * travel.max() * noise[2]) ** 2
            row[1:10] = last[1:10] + np.concatenate([shift, bound, wander])
        row[0], row[10:] = t, noise
        self._rows.append(row)
        while t - self._rows[0][0] > SPANS[-1]:
            self._rows.popleft()
        table = np.array(self._rows)
        drifts = [drift for span in SPANS if (drift := self._drift(table[table[:, 0] >= t - span], span)) is not None]
        return drifts[0] if drifts else None

    def _drift(self, table: Array, span: float) -> Drift | None:
        """The drift in some rows that slip does not explain."""
        time = table[:, 0] - table[:, 0].mean()
        covered = float(time[-1] - time[0])
        if len(table) < _LEAST_FIXES or covered < _LEAST_PART * span:
            return None
        square = float(time @ time)
        slope, bound = time @ table[:, 1:4] / square, time @ table[:, 4:7] / square
        walked = _RANDOM_WALK_SLOPE * (table[-1, 7:10] - table[0, 7:10]) / covered**2
        deviation = np.sqrt(table[:, 10:].max(axis=0) ** 2 / square + walked)
        beyond = (np.abs(slope) - bound) / deviation
        axis = int(beyond.argmax())
        return Drift(axis, float(slope[axis]), covered) if beyond[axis] > self._gate else None
