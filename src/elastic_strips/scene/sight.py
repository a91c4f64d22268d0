"""Sight: what of some points is seen from elsewhere among the obstacles of a scene, by the boxes about their parts."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask

from .scene import Scene

_PARALLEL = 1e-12  # components of a line [m] below this count as this: it never enters a slab that it begins beside


def sight_shares(scene: Scene, eyes: Array, points: Array, short: float) -> Array:
    """Parts (M,) of the points that are seen from each of several eyes, in [0, 1].

    Args:
        scene: what may be in between; parts count as the boxes about them, blocks of boxes as their boxes.
        eyes: (M, 3) [m].
        points: (K, 3) [m].
        short: a point is seen where its line of sight is free up to this [m] before it.
    """
    to = points[None] - eyes[:, None]
    far = np.linalg.norm(to, axis=2, keepdims=True)
    to = (to * np.maximum(1.0 - short / np.maximum(far, short), 0.0)).reshape(-1, 3)
    first = np.repeat(eyes, len(points), axis=0)
    blocked, table = np.zeros(len(first), dtype=bool), scene.table
    low = np.minimum(first, first + to).min(axis=0, initial=np.inf)
    high = np.maximum(first, first + to).max(axis=0, initial=-np.inf)
    near = (table.center - table.half_extents <= high) & (table.center + table.half_extents >= low)
    for row in np.flatnonzero(near.all(axis=1)).tolist():
        part, turn = table.parts[row], table.rotation[row]
        left = np.flatnonzero(~blocked)
        o, d = (first[left] - table.translation[row]) @ turn, to[left] @ turn
        middle, half = table.local_center[row] - table.local_translation[row], table.local_half[row]
        met = _met(o, d, middle[None], half[None])
        if part.geometry is None and len(met):
            met = met[_met(o[met], d[met], part.middles, 0.5 * part.sizes)]
        blocked[left[met]] = True
    seen: Mask = ~blocked.reshape(len(eyes), len(points))
    return seen.mean(axis=1)


def _met(o: Array, d: Array, middle: Array, half: Array) -> Indices:
    """Which lines from o (R, 3) to o + d meet one of the boxes with middles and half sizes (n, 3)."""
    across = 1.0 / np.where(np.abs(d) < _PARALLEL, _PARALLEL, d)[:, None]
    one, two = (middle - half - o[:, None]) * across, (middle + half - o[:, None]) * across
    enters, leaves = np.minimum(one, two).max(axis=2), np.maximum(one, two).min(axis=2)
    return np.flatnonzero(((enters <= leaves) & (leaves >= 0.0) & (enters <= 1.0)).any(axis=1))
