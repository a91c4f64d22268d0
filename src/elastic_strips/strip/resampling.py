"""Resampling: where to insert a node, and which to remove, so that a strip stays dense enough and no denser."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.robot import ConfigurationSpace


def node_spacing(space: ConfigurationSpace, coordinates: Array, weight: Array) -> Array:
    """(N−1,) weighted length √(vᵀ diag(w) v) [m] of each segment between nodes (N, nv), w = ``weight`` (nv,)."""
    v = space.difference(coordinates[:-1], coordinates[1:])
    return np.sqrt((v * v) @ weight)


def resample(
    space: ConfigurationSpace,
    coordinates: Array,
    spacing: Array,
    *,
    max_spacing: float,
    min_spacing: float,
    split: Mask | None = None,
    spare: Mask | None = None,
    max_nodes: int = 512,
) -> tuple[Array, Indices] | None:
    """Divide segments that are too long, or marked; drop inner nodes that are too close to their neighbours.

    Args:
        space: configuration space.
        coordinates: (N, nv) nodes.
        spacing: (N−1,) lengths of the segments, of :func:`node_spacing`.
        max_spacing: a longer segment is divided.
        min_spacing: a node is dropped where both its segments together are shorter.
        split: (N−1,) segments to halve in any case, because they have no certificate.
        spare: (N,) nodes that are dropped however long their segments are, unless a neighbour was dropped.
        max_nodes: no node is inserted above this number.

    Returns:
        The new nodes (M, nv), and the index (M,) of the old node that each was, −1 for a new one; None where nothing
        changes.
    """
    surplus = spacing[:-1] + spacing[1:] < min_spacing
    if spare is not None:
        surplus |= spare[1:-1]
    if not surplus.any() and spacing.max(initial=0.0) <= max_spacing and (split is None or not split.any()):
        return None
    pieces = np.clip(np.ceil(spacing / max_spacing).astype(int), 1, 8)
    if split is not None:
        halved = split & (spacing > 0.05 * min_spacing)
        pieces[halved] = np.maximum(pieces[halved], 2)
    room = max_nodes - len(coordinates)
    if int((pieces - 1).sum()) > room:  # marked segments first, then where the pieces are longest
        wanted, priority = pieces, np.zeros(len(spacing)) if split is None else split * 1e6
        pieces = np.ones_like(wanted)
        for _ in range(room):
            need = np.where(pieces < wanted, spacing / pieces + np.where(pieces == 1, priority, 0.0), -np.inf)
            pieces[int(np.argmax(need))] += 1
    keep = np.ones(len(coordinates), dtype=bool)
    surplus &= (pieces[:-1] == 1) & (pieces[1:] == 1)
    for j in np.flatnonzero(surplus) + 1:
        keep[j] = not keep[j - 1]
    if keep.all() and (pieces == 1).all():
        return None
    inserted = np.append(pieces - 1, 0)
    first = np.cumsum(keep + inserted) - inserted  # where what a node is followed by begins
    source = np.full(int(first[-1]), -1, dtype=np.intp)
    source[first[keep] - 1] = np.flatnonzero(keep)
    segment = np.repeat(np.arange(len(coordinates)), inserted)
    part = (np.arange(len(segment)) - np.repeat(np.cumsum(inserted) - inserted, inserted) + 1) / pieces[segment]
    rows = coordinates[source]
    rows[source < 0] = space.interpolate(coordinates[segment], coordinates[segment + 1], part)
    return rows, source


def kept_segments(before: Array, coordinates: Array, source: Indices, which: Mask) -> Mask:
    """(M−1,) segments of edited nodes that are segments of the nodes before, to the last bit, and among ``which``.

    Args:
        before: (N, nv) nodes before.
        coordinates: (M, nv) nodes now.
        source: (M,) which node each was before, −1 for a new one.
        which: (N−1,) segments before.
    """
    stays = (source >= 0) & (coordinates == before[source]).all(axis=1)
    return stays[:-1] & stays[1:] & (np.diff(source) == 1) & which[source[:-1]]
