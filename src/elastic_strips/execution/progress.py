"""Execution room, progress: what of a strip still lies ahead of where the robot is."""

from __future__ import annotations

import numpy as np

from ..robot import ConfigurationSpace
from ..robot.space import Array, Indices

_SEARCHED = 24
_CROWDED = 0.05
_CORNER = np.cos(np.deg2rad(50.0))


def remaining(
    space: ConfigurationSpace, chart: Array, here: Array, weight: Array, *, moving: bool = True
) -> tuple[Array, Indices]:
    """The nodes of a strip that are still ahead, behind the present configuration as first node.

    Args:
        space: configuration space.
        chart: (N, nv) nodes; the robot was at the first of them a little while ago.
        here: (nv,) where it is now.
        weight: (nv,) metric that makes angles comparable with metres.
        moving: whether it moves: then it cannot leave out a corner at which it has to stop.

    Returns:
        (M, nv) nodes, ``here`` first, M ≥ 2, and (M,) which node of ``chart`` each was (−1 for ``here``). A node that
        would crowd the first one is left out; the goal never is.
    """
    first = chart[: min(_SEARCHED, len(chart))]
    scale = np.sqrt(weight)
    onward = space.difference(first[:-1], first[1:]) * scale
    corner = _first_corner(onward)
    v = space.difference(np.broadcast_to(here, first.shape), first) * scale
    distance = np.sqrt((v * v).sum(axis=1))
    nearest = 0  # the first local minimum: a strip may come back to where it was
    while nearest < corner and distance[nearest + 1] <= distance[nearest]:
        nearest += 1
    ahead = nearest
    if nearest < corner and float(onward[nearest] @ -v[nearest]) >= 0.0:  # the nearest node is already behind
        ahead = nearest + 1
    last = min(corner, len(chart) - 1) if moving else len(chart) - 1
    while ahead < last and ahead < len(first) and distance[ahead] < _CROWDED:
        ahead += 1
    ahead = max(ahead, 1)
    source = np.concatenate(([-1], np.arange(ahead, len(chart)))).astype(np.intp)
    return np.vstack([here[None], chart[ahead:]]), source


def _first_corner(onward: Array) -> int:
    """Index of the first node at which the direction turns sharply; the last of these nodes where none does."""
    length = np.sqrt((onward * onward).sum(axis=1))
    product = (onward[:-1] * onward[1:]).sum(axis=1)
    sharp = (product < _CORNER * length[:-1] * length[1:]) & (length[:-1] > 1e-3) & (length[1:] > 1e-3)
    found = np.flatnonzero(sharp)
    return int(found[0]) + 1 if len(found) else len(onward)
