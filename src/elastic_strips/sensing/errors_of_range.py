"""Sensing room, errors of range: what a device makes of a true distance: noise, losses, limits."""

from __future__ import annotations

import numpy as np

from ..robot.space import Array
from .params import RangeParams
from .readings import NO_ANSWER, NOTHING

CUT = 3.0
"""Noise is cut off at this many standard deviations."""


def measured(distance: Array, params: RangeParams, rng: np.random.Generator) -> Array:
    """Ranges (R,) [m] that a device reports.

    As many random numbers are drawn whatever the distances are, so that one range does not change the noise of another.

    Args:
        distance: (R,) true ones [m]; infinite where nothing is, NaN where nothing is known.
        params: of the device.
        rng: source of noise and dropouts.

    Returns:
        ``NOTHING`` beyond the longest range, ``NO_ANSWER`` where the range was lost or is not known; else within
        ``range_min`` and ``range_max``.
    """
    white = np.clip(rng.standard_normal(distance.shape), -CUT, CUT)
    lost = rng.random(distance.shape) < params.dropout
    there = np.where(np.isfinite(distance), distance, 0.0)
    ranges = np.clip(there + (params.noise + params.noise_ratio * there) * white, params.range_min, params.range_max)
    near = distance < params.range_min
    ranges[near] = params.range_min if params.near_reads_min else NO_ANSWER
    ranges[distance > params.range_max] = NOTHING
    ranges[lost | np.isnan(distance)] = NO_ANSWER
    return ranges
