"""Scene room, clusters: thousands of equal boxes (voxels, points) become few larger ones, grouped in blocks.

The union of the boxes does not change: only boxes of one grid that fill a larger box are merged.
"""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.errors import SceneError
from elastic_strips.scene.checks import Array
from elastic_strips.scene.parts import Part, Solid, coal

BLOCK = 0.45
"""Edge [m] of the cells of space that a cluster is cut into; each occupied cell is one `Part`."""

SNAP = 1e-3
"""Centres within this share of a voxel's edge of a regular grid are snapped to it (boxes grow by what was snapped)."""

MAX_CENTERS = 2_000_000
MAX_BOXES = 400_000  # a kilobyte each
"""Most boxes of one obstacle: as they are given, and after merging."""

_IDENTITY = np.eye(4)
_IDENTITY.flags.writeable = False

Index = NDArray[np.int64]


def cluster_solid(centers: Array, size: Array) -> Solid:
    """Solid of axis-aligned boxes of one ``size`` (3,) about ``centers`` (V, 3) [m].

    Duplicates are dropped. If the centres lie on a grid of that size, full larger boxes replace groups of them;
    otherwise every box stays. The boxes are grouped by cells of about `BLOCK` metres.

    Raises:
        SceneError: more than `MAX_CENTERS` boxes, or more than `MAX_BOXES` after merging.
    """
    if len(centers) > MAX_CENTERS:
        raise SceneError(f"{len(centers)} boxes are given; at most {MAX_CENTERS} are accepted: thin them out first")
    lows, highs, block = merged_boxes(centers, size)
    if len(lows) > MAX_BOXES:
        raise SceneError(
            f"{len(lows)} boxes are left after merging; at most {MAX_BOXES} are accepted: take a coarser grid"
        )
    return Solid(_blocks(lows, highs, block))


def merged_boxes(centers: Array, size: Array) -> tuple[Array, Array, Index]:
    """Corners ``lows``, ``highs`` (m, 3) [m] of boxes with the same union, and the cell (m, 3) each one lies in."""
    turns = np.exp(2j * np.pi * centers / size).mean(axis=0)
    origin = np.angle(turns) / (2.0 * np.pi) * size
    cells = np.rint((centers - origin) / size).astype(np.int64)
    first = cells.min(axis=0)  # blocks start at the lowest voxel
    cells, origin = cells - first, origin + first * size
    slip = np.abs(centers - (cells * size + origin)).max(axis=0)
    if (slip > SNAP * size).any():  # no grid
        keep = _unique(np.rint(centers * 1e9).astype(np.int64))
        middles = centers[keep]
        return (
            middles - 0.5 * size,
            middles + 0.5 * size,
            np.floor((middles - middles.min(axis=0)) / BLOCK).astype(np.int64),
        )
    span = np.maximum(1, np.rint(BLOCK / size)).astype(np.int64)
    low, high = merge_cells(cells[_unique(cells)], span)
    grow = np.where(slip > 1e-9, slip, 0.0)
    return (low - 0.5) * size + origin - grow, (high - 0.5) * size + origin + grow, low // span


def merge_cells(cells: Index, span: Index) -> tuple[Index, Index]:
    """Merge unit ``cells`` (V, 3), without duplicates, into boxes [low, high) (m, 3) that fill the same cells.

    Runs along one axis are joined, then equal runs along the next, then the last; of the six orders the best one
    counts. No box crosses a multiple of ``span`` (3,).
    """
    best: tuple[Index, Index] | None = None
    flat = (cells == cells[:1]).all(axis=0)
    tried: set[tuple[int, ...]] = set()
    for order in permutations(range(3)):
        wide = tuple(axis for axis in order if not flat[axis])
        if wide in tried:  # nothing to join along an axis of one cell: when that is tried makes no difference
            continue
        tried.add(wide)
        low, high = cells, cells + 1
        for done, axis in enumerate(order):
            low, high = _join(low, high, axis, order[:done], span)
        if best is None or len(low) < len(best[0]):
            best = low, high
    assert best is not None
    return best


def _join(low: Index, high: Index, axis: int, merged: tuple[int, ...], span: Index) -> tuple[Index, Index]:
    """Join boxes that touch along ``axis`` and agree in the others (``merged`` axes have other lengths than 1)."""
    others = [a for a in range(3) if a != axis]
    keys = [low[:, a] for a in others] + [high[:, a] for a in others if a in merged]
    order = np.lexsort([low[:, axis], *keys])
    low, high = low[order], high[order]
    same = (low[1:, axis] == high[:-1, axis]) & (low[1:, axis] // span[axis] == low[:-1, axis] // span[axis])
    for a in others:
        same &= (low[1:, a] == low[:-1, a]) & (high[1:, a] == high[:-1, a])
    starts = np.flatnonzero(np.concatenate([[True], ~same]))
    ends = np.append(starts[1:], len(low)) - 1
    joined = high[starts].copy()
    joined[:, axis] = high[ends, axis]
    return low[starts], joined


def _unique(keys: Index) -> Index:
    """Indices, ascending, of the first of each group of equal rows of ``keys`` (V, 3)."""
    order = np.lexsort([keys[:, 2], keys[:, 1], keys[:, 0]])  # stable: the first of equal rows stays first
    ranked = keys[order]
    fresh = np.concatenate([[True], (ranked[1:] != ranked[:-1]).any(axis=1)])
    return np.sort(order[fresh])


def _blocks(lows: Array, highs: Array, block: Index) -> list[Part]:
    """One part per block; equal boxes share one Coal geometry."""
    order = np.lexsort([block[:, 2], block[:, 1], block[:, 0]])
    lows, highs, block = lows[order], highs[order], block[order]
    starts = np.flatnonzero(np.concatenate([[True], (block[1:] != block[:-1]).any(axis=1)]))
    counts = np.diff(np.append(starts, len(lows)))
    low, high = np.minimum.reduceat(lows, starts), np.maximum.reduceat(highs, starts)
    center, half = 0.5 * (low + high), 0.5 * (high - low)
    middles, sizes = 0.5 * (lows + highs), highs - lows
    far = np.linalg.norm(np.abs(middles - np.repeat(center, counts, axis=0)) + 0.5 * sizes, axis=1)
    radius = np.maximum.reduceat(far, starts).tolist()
    middles.flags.writeable = False
    cache: dict[tuple[float, ...], Any] = {}
    members = list(zip(_boxes(sizes, cache), middles, strict=True))
    bounds = [*starts.tolist(), len(lows)]
    return [
        Part(None, _IDENTITY, center[i], half[i], radius[i], tuple(members[bounds[i] : bounds[i + 1]]))
        for i in range(len(starts))
    ]


def _boxes(sizes: Array, cache: dict[tuple[float, ...], Any]) -> list[Any]:
    """Coal boxes of ``sizes`` (m, 3) [m]; equal ones (to 1e-12 m) are one object."""
    result = []
    for key in map(tuple, np.round(sizes, 12).tolist()):
        box = cache.get(key)
        if box is None:
            box = cache[key] = coal.Box(*key)
            box.computeLocalAABB()
        result.append(box)
    return result
