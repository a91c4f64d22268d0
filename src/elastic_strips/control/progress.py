"""Progress: the part of a strip that is still ahead of the robot."""

from __future__ import annotations

from itertools import takewhile

import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.robot import ConfigurationSpace
from elastic_strips.robot.space import wrap_angle

_NODES_SEARCHED = 24
_CROWDED_SPACING = 0.05
_AT_NODE_DISTANCE = 1e-3  # [m] from a node, within which a base is at it
DETOUR_COST = 1.5
"""Cost of a metre beside the strip, in metres along it."""
_LEAST_JOIN, _MOST_JOIN = 0.8, 3.0  # distance along the strip from the nearest node to where it is joined [m]
_JOIN_STEP = 0.15
_CURVE_ANGLE = 1.1  # [rad] smaller differences of heading are joined in a curve, without turning in place
_CORNER_COSINE = np.cos(np.deg2rad(50.0))


def trim_passed(
    space: ConfigurationSpace, coordinates: Array, here: Array, weight: Array, *, moving: bool = True
) -> tuple[Array, Indices]:
    """The nodes of a strip that are still ahead, after the present configuration as first node.

    Args:
        space: configuration space.
        coordinates: (N, nv) nodes; the robot was at the first of them one tick ago.
        here: (nv,) its present coordinate row.
        weight: (nv,) metric that makes angles comparable with metres.
        moving: whether it moves: then it cannot skip a corner at which it has to stop.

    Returns:
        (M, nv) nodes, ``here`` first, M ≥ 2, and (M,) index of each among the given nodes (−1 for ``here``). A node
        too near to the first one is left out; the goal never is.
    """
    first = coordinates[: min(_NODES_SEARCHED, len(coordinates))]
    scale = np.sqrt(weight)
    onward = space.difference(first[:-1], first[1:]) * scale
    corner = _first_corner(onward)
    v = space.difference(np.broadcast_to(here, first.shape), first) * scale
    distance = np.sqrt((v * v).sum(axis=1))
    nearest = 0  # the first local minimum: a strip may come back to where it was
    if moving:
        near = takewhile(lambda k: distance[k] <= distance[0] + _CROWDED_SPACING, range(corner, len(onward)))
        passed = [k for k in near if _is_beyond(space.planar, -v[0], -v[k], onward[k])]
        if passed:
            nearest = passed[-1]
            corner = nearest + _first_corner(onward[nearest:])
    while nearest < corner and distance[nearest + 1] <= distance[nearest]:
        nearest += 1
    ahead = nearest
    if nearest < corner and float(onward[nearest] @ -v[nearest]) >= 0.0:  # the nearest node is already behind
        ahead = nearest + 1
    last = min(corner, len(coordinates) - 1) if moving else len(coordinates) - 1
    while ahead < last and ahead < len(first) and distance[ahead] < _CROWDED_SPACING:
        ahead += 1
    ahead = max(ahead, 1)
    source = np.concatenate(([-1], np.arange(ahead, len(coordinates)))).astype(np.intp)
    return np.vstack([here[None], coordinates[ahead:]]), source


def reconnect(
    space: ConfigurationSpace, coordinates: Array, here: Array, weight: Array, *, moving: bool = True
) -> tuple[Array, Indices]:
    """The rest of a strip that the robot has left, joined to its present configuration.

    The base returns in a curve to a node further on; where its heading differs too much, it turns in place at both
    ends. A fixed base is treated as by :func:`trim_passed`, which has the same arguments and results.
    """
    if not space.planar:
        return trim_passed(space, coordinates, here, weight, moving=moving)
    apart = np.hypot(*(coordinates[:, :2] - here[:2]).T)
    passed = np.append(0.0, np.cumsum(np.hypot(*np.diff(coordinates[:, :2], axis=0).T)))
    left = passed[-1] - passed
    nearest = int((DETOUR_COST * apart + left).argmin())
    ahead = min(max(2.0 * float(apart[nearest]), _LEAST_JOIN), _MOST_JOIN)
    last = len(coordinates) - 1
    node = min(max(int(np.searchsorted(passed, passed[nearest] + ahead)), 1), last)
    target = coordinates[node]
    path = target[:2] - here[:2]
    length = float(np.hypot(*path))
    rows = here[None] if length < _AT_NODE_DISTANCE else _bend(here, target, path, length)
    source = np.concatenate((np.full(len(rows), -1), np.arange(node, len(coordinates)))).astype(np.intp)
    return np.vstack([rows, coordinates[node:]]), source


def _bend(here: Array, target: Array, path: Array, length: float) -> Array:
    """Rows (R, nv) from ``here`` to before ``target``."""
    heading = float(np.arctan2(path[1], path[0]))
    off = [float(wrap_angle(np.array(yaw - heading))) for yaw in (here[2], target[2])]
    count = max(int(np.ceil(length / _JOIN_STEP)), 2)
    s = np.arange(count)[:, None] / count
    rows = here + s * (target - here)
    if max(abs(off[0]), abs(off[1])) < _CURVE_ANGLE:
        reach = 0.35 * length
        a = here[:2] + reach * np.array([np.cos(here[2]), np.sin(here[2])])
        b = target[:2] - reach * np.array([np.cos(target[2]), np.sin(target[2])])
        u = 1.0 - s
        rows[:, :2] = u**3 * here[:2] + 3 * u * u * s * a + 3 * u * s * s * b + s**3 * target[:2]
        slope = u * u * (a - here[:2]) + 2 * u * s * (b - a) + s * s * (target[:2] - b)
        rows[:, 2] = np.unwrap(np.append(here[2], np.arctan2(slope[1:, 1], slope[1:, 0])))
        return rows
    turn = [int(np.ceil(abs(angle) / 0.35)) for angle in off]
    rows[:, 2] = here[2] - off[0]
    first = np.repeat(here[None], turn[0], axis=0)
    first[:, 2] -= off[0] * np.arange(turn[0]) / max(turn[0], 1)
    end = np.repeat(target[None], turn[1], axis=0)
    end[:, 2] = rows[-1, 2] + off[1] * np.arange(turn[1]) / max(turn[1], 1)
    return np.vstack([first, rows, end])


def _is_beyond(planar: bool, moved: Array, off: Array, onward: Array) -> bool:
    """Whether a robot that has moved so far (nv,) is beside what follows on a corner (nv,), so far (nv,) off from the
    corner, and goes that way, all in the metric [m]: nodes that are near each other and unsteady make corners that are
    none."""
    n = 2 if planar else len(onward)
    size = float(np.linalg.norm(onward[:n]))
    part = float(off[:n] @ onward[:n]) / size**2 if size > 0.0 else -1.0
    same = float(moved[:n] @ onward[:n]) > _CORNER_COSINE * float(np.linalg.norm(moved[:n])) * size
    return same and 0.0 <= part <= 1.0 and float(np.linalg.norm(off - part * onward)) < _CROWDED_SPACING


def _first_corner(onward: Array) -> int:
    """Index of the first node at which the direction turns sharply; the last of these nodes where none does."""
    length = np.sqrt((onward * onward).sum(axis=1))
    product = (onward[:-1] * onward[1:]).sum(axis=1)
    sharp = (product < _CORNER_COSINE * length[:-1] * length[1:]) & (length[:-1] > 1e-3) & (length[1:] > 1e-3)
    found = np.flatnonzero(sharp)
    return int(found[0]) + 1 if len(found) else len(onward)
