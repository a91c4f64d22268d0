"""Motors: a speed loop with lag and limited acceleration, solved exactly."""

from __future__ import annotations

import math

_STICTION = 5e-4  # [m/s, rad/s] below it, a motor that is told to stand stands


def speed_loop(v: float, u: float, lag: float, push: float, h: float) -> tuple[float, float]:
    """Speed and way after ``h`` [s] of ``dv/dt = clip((u − v)/lag, ±push)``, exactly."""
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
    if u == 0.0 and abs(v) < _STICTION:
        v = 0.0
    return v, way


def stopping_time(speed: float, below: float, lag: float, push: float) -> float:
    """Time [s] in which a :func:`speed_loop` that is told to stand gets from a ``speed`` > 0 to under ``below``."""
    if speed <= below:
        return 0.0
    knee = push * lag  # from here on the lag brakes more gently than the limit
    if below >= knee:
        return (speed - below) / push
    return max(speed - knee, 0.0) / push + lag * math.log(min(speed, knee) / below)
