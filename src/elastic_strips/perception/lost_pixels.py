"""Lost pixels: how far one sees through them at least, by what is beside them, and by what they answered a moment ago.

What is hidden in a hole of lost pixels is no wider than the widest disc that fits into it: single ones hide next to
nothing, a strip of them as much as a board that is seen edge-on. Where half of all pixels are lost at any time, as on a
floor that is seen from far away, a sensor that stands still sees through all of them one after the other; what never
answers stays lost.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from elastic_strips.arrays import Array, Image, Indices, Mask
from elastic_strips.native import kernel

from .readings import DepthImage, RangeImage

_WIDEST_HOLE = 24  # [pixels] of the holes that are looked into
_SHIFT = 0.003  # [m] by which a sensor may have moved …
_TURN = 0.003  # … and its axes [1]: a fifth to two fifths of a pixel


def filled(ranges: Image, unit: float) -> Image:
    """Ranges (H, W) with narrow holes of lost ones filled in.

    What is hidden at a pixel is no wider than the widest disc between pixels that answer, of which that pixel is in the
    square about it: in a rectangle this is so at its corners, too.

    Args:
        ranges: with ``NO_ANSWER`` where they are lost [m].
        unit: distance [m] at which one pixel is as wide as what may be overlooked; that of n is an n-th of it. A lost
            pixel is as far away as that, or as the nearer end of the shortest run of lost pixels through it, along its
            row, column and diagonals; where there is none with two ends, it stays lost.
    """
    if unit == 0.0:
        return ranges
    native = kernel()
    if native is None:
        return _filled(ranges, unit)
    out = np.empty(ranges.shape, dtype=np.float32)
    native.fill_holes(np.ascontiguousarray(ranges, dtype=np.float32), unit, _WIDEST_HOLE, out)
    return out


def _filled(ranges: Image, unit: float) -> Image:
    """The kernel's readable twin."""
    lost = np.argwhere(np.isnan(ranges))
    if not len(lost):
        return ranges
    around = np.pad(ranges, _WIDEST_HOLE, constant_values=np.nan)
    run, value = np.full(len(lost), np.inf), np.full(len(lost), np.nan)
    for line in ((0, 1), (1, 0), (1, 1), (1, -1)):
        (one, near), (two, far) = (_border(around, lost + _WIDEST_HOLE, np.array(line) * sign) for sign in (1, -1))
        long = (one + two) * float(np.hypot(*line))
        better = (one + two <= _WIDEST_HOLE) & (long < run)
        run[better], value[better] = long[better], np.minimum(near, far)[better]
    out = ranges.copy()
    out[tuple(lost.T)] = np.minimum(value, unit / _widths(np.isnan(ranges))[tuple(lost.T)])
    return out


def _widths(lost: Mask) -> Array:
    """Widths (H, W) [pixels] of the widest disc about each pixel; NaN where that is wider than any hole."""
    from scipy.ndimage import distance_transform_edt  # late: slow to import

    rows, columns = np.array(lost.shape) + 2
    open_ = np.ones((2 * rows - 1, 2 * columns - 1), dtype=bool)  # in half pixels
    open_[::2, ::2] = np.pad(lost, 1)

    def squares(open_: Mask) -> Indices:
        """Squared distances to what is not open."""
        return np.rint(np.asarray(distance_transform_edt(open_)) ** 2).astype(np.intp)

    discs = np.minimum(squares(open_), _WIDEST_HOLE**2 + 1)
    found = np.zeros_like(discs)
    for width in np.unique(discs)[1:]:  # squares as well, ascending
        found[squares(discs < width) <= 2 * width] = width
    found = found[2:-2:2, 2:-2:2]
    return np.where(found > _WIDEST_HOLE**2, np.nan, np.sqrt(found))


def _border(ranges: Image, at: Indices, step: Indices) -> tuple[Array, Array]:
    """How many steps (n,) it is from pixels (n, 2) to the first that is not lost, and its range (n,); infinity and
    ``NO_ANSWER`` where that is none of the next ones."""
    steps, value = np.full(len(at), np.inf), np.full(len(at), np.nan)
    for k in range(1, _WIDEST_HOLE + 1):
        open_ = np.flatnonzero(np.isinf(steps))
        if not len(open_):
            break
        i, j = (at[open_] + k * step).T
        found = ranges[i, j]
        there = ~np.isnan(found)
        steps[open_[there]], value[open_[there]] = k, found[there]
    return steps, value


class StillImages:
    """Workspace: images of one sensor since it last moved.

    Args:
        seconds: how long an answer counts [s].
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._kept: deque[tuple[float, Array, Image]] = deque()  # time, pose, ranges

    def filled(self, reading: DepthImage | RangeImage, T_world_sensor: Array) -> Image:
        """The ranges (H, W) of an image; where they are lost, the least that the same pixel has answered lately.

        Args:
            reading: the newest image.
            T_world_sensor: (4, 4) pose of the sensor then.
        """
        now, kept = reading.ranges, self._kept
        while kept and not (
            abs(reading.time - kept[0][0]) <= self._seconds
            and kept[0][2].shape == now.shape
            and _same(kept[0][1], T_world_sensor)
        ):
            kept.popleft()
        out = now
        if kept:
            lost = np.isnan(now)
            out = now.copy()
            out[lost] = np.fmin.reduce([before[lost] for _, _, before in kept])
        kept.append((reading.time, T_world_sensor, now))
        return out


def _same(one: Array, other: Array) -> bool:
    off = np.abs(one - other)
    return bool(off[:3, 3].max() <= _SHIFT and off[:3, :3].max() <= _TURN)
