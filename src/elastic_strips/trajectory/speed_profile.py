"""Speed profiles: the fastest motion along a path that keeps every limit (TOPP-RA).

Its linear programs have two variables, and rest is always allowed: Newton's steps along their rows solve them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, by_rows
from elastic_strips.native import kernel
from elastic_strips.work import count_work

LIMIT_EXCESS = 1e-3
"""Part of a limit by which a sample may exceed this limit."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Squared path speed x over a grid, linear in between: constant path acceleration from point to point.

    Attributes:
        grid: (G,) lengths.
        x: (G,) squared path speed.
        time: (G,) [s] since the start.
    """

    grid: Array
    x: Array
    time: Array

    @staticmethod
    def of(grid: Array, x: Array) -> Profile:
        """The profile of squared speeds ``x``, of which no two neighbours are 0."""
        speed = np.sqrt(x)
        time = np.zeros(len(grid))
        np.cumsum(2.0 * (grid[1:] - grid[:-1]) / (speed[1:] + speed[:-1]), out=time[1:])
        return Profile(grid, x, time)

    @property
    def duration(self) -> float:
        """Time [s] from the start to rest."""
        return float(self.time[-1])

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Length, path speed and path acceleration (M,) at times ``t`` (M,) since the start."""
        i = np.searchsorted(self.time[1:-1], t, side="right")
        gap = self.grid[i + 1] - self.grid[i]
        u = 0.5 * (self.x[i + 1] - self.x[i]) / gap
        since = t - self.time[i]
        speed = np.sqrt(self.x[i])
        s = self.grid[i] + since * (speed + 0.5 * since * u)
        return np.minimum(s, self.grid[i + 1]), np.maximum(speed + since * u, 0.0), u


def fastest(grid: Array, y1: Array, y2: Array, bound: Array, acceleration: Array, start: float) -> Profile | None:
    """The fastest profile from the squared path speed ``start`` to rest at the end of the grid.

    Both passes of TOPP-RA. As rest is always allowed (x = 0, u = 0 keeps any acceleration limit), the controllable
    speeds at a point reach from 0 up to one number: one linear program per point instead of two.

    Args:
        grid: (G,) lengths.
        y1, y2: (G, m) derivatives of the path.
        bound: (G,) largest squared path speed.
        acceleration: (m,) limits of |y′u + y″x|.
        start: squared path speed at the start.

    Returns:
        The profile, or None where there is none: it cannot stop in time, or its start is too fast for the bends.
    """
    count_work(batches=1)
    if (native := kernel()) is not None:
        x = np.empty(len(grid))
        found = native.fastest(*by_rows(grid, y1, y2, bound, acceleration), start, x)
        return Profile.of(grid, x) if found else None
    # a path of unit length, in a unit of time in which y′ stays as it is: tolerances mean the same for every path
    scale = float(grid[-1])
    step = (grid[1:] - grid[:-1]) / scale
    a, b = _rows(step, y1 / acceleration, y2 * (scale / acceleration))
    size = np.abs(a).max(axis=0)
    if not 0.0 < size.max() < np.inf:  # nor is it a number where the path is none
        return None
    moving = size > 1e-9 * size.max()
    a, b = a[:, moving], b[:, moving]
    room, slope = rate_bounds(a, b)
    with np.errstate(divide="ignore"):  # a row without u bounds x alone, or nothing
        most = np.where(np.isinf(room), 1.0 / np.abs(b), np.inf).min(axis=1, initial=np.inf)
    most = np.minimum(most, bound / scale)
    last = len(grid) - 1
    reach = np.zeros(last + 1)
    for i in range(last - 1, -1, -1):
        reach[i] = _controllable(room[i], slope[i], float(most[i]), 0.5 / float(step[i]), float(reach[i + 1]))
        if not reach[i] > 0.0:
            return None
    x = np.zeros(last + 1)
    x[0] = start / scale
    if x[0] > reach[0] * (1.0 + 1e-9):
        return None
    x[0] = min(x[0], reach[0])
    for i in range(last):
        u = float((room[i] - slope[i] * x[i]).min())
        x[i + 1] = max(min(x[i] + 2.0 * step[i] * u, reach[i + 1]), 0.0)
    if not (x[1:-1] > 0.0).all():
        return None
    return Profile.of(grid, x * scale)


def _controllable(room: Array, slope: Array, x: float, rate: float, reach: float) -> float:
    """The largest squared speed up to ``x`` from which some u keeps all rows, and leads to one within [0, reach].

    The room for u is concave in x, so Newton's steps from above end at it. NaN is answered by NaN.
    """
    # u ≤ high − falls x and u ≥ low − falls x: of the rows, and of the next point's range
    high, low, falls = np.append(room, reach * rate), np.append(-room, 0.0), np.append(slope, rate)
    for _ in range(64):
        most, least = high - falls * x, low - falls * x
        upper, lower = most.argmin(), least.argmax()
        over = float(least[lower] - most[upper])
        if not over > 1e-12 * float(abs(low[lower]) + abs(falls[lower]) * x):
            return x if over == over else over
        x -= over / float(falls[upper] - falls[lower])
        if not x > 0.0:
            return 0.0
    return x


def braked(grid: Array, y1: Array, y2: Array, acceleration: Array, start: float, part: float) -> Array:
    """(G,) squared path speeds that fall from ``start`` with a part of the hardest braking there is; from 0 on, 0."""
    if (native := kernel()) is not None:
        x = np.empty(len(grid))
        native.braked(*by_rows(grid, y1, y2, acceleration), start, part, x)
        return x
    h = grid[1:] - grid[:-1]
    room, slope = rate_bounds(*_rows(h, y1 / acceleration, y2 / acceleration))
    x = np.zeros(len(grid))
    x[0] = start
    for i in range(len(h)):
        if x[i] <= 0.0:
            break
        lower, upper = float((-room[i] - slope[i] * x[i]).max()), float((room[i] - slope[i] * x[i]).min())
        if lower < 0.0:
            u = min(part * lower, 0.5 * (lower + upper))
        else:  # in a bend that takes so much that the robot has to speed up
            u = lower + (1.0 - part) * (upper - lower)
        x[i + 1] = max(x[i] + 2.0 * h[i] * u, 0.0)
    return x


def _rows(step: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Rows (G, 2m) of |a u + b x| ≤ 1 for both ends of every step (G−1,), with the step's one acceleration u."""
    a_next, b_next = np.empty_like(a), np.empty_like(b)
    a_next[:-1], b_next[:-1] = a[1:] + 2.0 * step[:, None] * b[1:], b[1:]
    a_next[-1], b_next[-1] = a[-1], b[-1]
    return np.hstack([a, a_next]), np.hstack([b, b_next])


def rate_bounds(a: Array, b: Array) -> tuple[Array, Array]:
    """(room, slope) of the same shape: |a u + b x| ≤ 1 is −room − slope·x ≤ u ≤ room − slope·x."""
    flat = np.abs(a) < 1e-9
    size = np.where(flat, 1.0, np.abs(a))
    return np.where(flat, np.inf, 1.0 / size), np.where(flat, 0.0, np.sign(a) * b / size)


def broken_limit(time: Array, y: Array, v: Array, a: Array, speed: Array, acceleration: Array) -> str:
    """Which limit samples (M, m) break, by their own rates or by their differences; empty where they break none."""
    h = np.diff(time)[:, None]
    mean, change = np.diff(y, axis=0) / h, np.diff(v, axis=0) / h
    bend = 2.0 * np.diff(mean, axis=0) / (h[1:] + h[:-1])
    used = {
        "speed": np.abs(v) / speed,
        "speed between samples": np.abs(mean) / speed,
        "acceleration": np.abs(a) / acceleration,
        "change of velocity": np.abs(change) / acceleration,
        "acceleration between samples": np.abs(bend) / acceleration,
    }
    for what, parts in used.items():
        value = float(parts.max(initial=0.0))
        if not value <= 1.0 + LIMIT_EXCESS:  # so that a value that is not a number is caught too
            return f"the {what} would be {value:.4f} of its limit"
    return ""
