"""Scenarios room, to rest: tracks of movers that may be slowed down, and whose end nobody hides."""

from __future__ import annotations

import math

import numpy as np

FINE = 10
"""Pieces between two keyframes of such a track."""


def to_rest(places: np.ndarray, frame: float, acceleration: float) -> np.ndarray:
    """A track (K, 2) with a stop at its end, and smooth: each place is the mean over ``frame``, `FINE` of them a frame.

    So the velocity changes in steps that are small beside what braking adds to them; no place moves by half a
    millimetre.
    """
    velocity = (places[-1] - places[-2]) / frame
    speed = float(np.hypot(*velocity))
    slower = speed - acceleration * frame * np.arange(1, math.ceil(speed / (acceleration * frame)))
    stop = places[-1] + frame * np.cumsum(np.outer(slower, velocity / speed), axis=0)
    first, last = 2.0 * places[0] - places[1], stop[-1] if len(stop) else places[-1]
    p = np.vstack((first, places, stop, last, last))
    i = np.arange(FINE * (len(p) - 3) + 1)
    k = (i + FINE // 2) // FINE
    u = (i / FINE - k)[:, None]
    bend = p[k + 2] - 2.0 * p[k + 1] + p[k]
    return p[k + 1] + 0.5 * u * (p[k + 2] - p[k]) + (0.5 * u * u + 0.125) * bend
