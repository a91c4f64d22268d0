"""Joint search: paths of the joints alone by OMPL, for arms among shelves and cages; the base stays where it is."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import Kinematics

from .ompl_planner import OMPL_LOCK, ended, real_bounds, seed_ompl, solved, waiting
from .problem import Deadline
from .tree_search import TreeSpace, search_by_trees
from .validity import Checker, ValidityChecker

PLANNERS = ("LBKPIECE1", "LBKPIECE1", "LBKPIECE1", "RRTConnect")
"""The planners that search, in turns: the first is better in tight places, the last where there is room."""
_LONGEST_TREE_MOTION = 0.6  # of a tree, in scaled units: the square root of a motion radius [m] times an angle
_LEAST_SCALED_RADIUS = 0.01  # [m] how far a joint counts as moving a point of the robot, at least
_TREE_CELLS = 10.0  # of the trees' grid, from one end of the hand's reach to the other
_TREE_SHORTCUTS, _OMPL_SHORTCUTS = 60, 150  # most tries to shorten a path


def search_joints(
    valid: Checker,
    endpoints: Array,
    *,
    seed: int,
    planner: str,
    step: float,
    timeout: float,
    deadline: Deadline,
) -> Array | None:
    """Corners (K, nv) of a path between two configurations (2, nv) with the same base, or None.

    Each joint counts by the square root of how far it can move a point of the robot: a shoulder's turn is longer than
    a wrist's. Trees grow by where the hand is, with its Jacobian at the goal.

    Args:
        valid: the checker of validity.
        endpoints: valid configurations (2, nv).
        seed: seed of OMPL's random numbers.
        planner: one of ``PLANNERS``.
        step: motions are checked wherever a point may have moved by this [m].
        timeout: longest search [s]; in seconds of work if the deadline bounds work.
        deadline: when everything must end.
    """
    if isinstance(valid, ValidityChecker):
        space = _tree_space(valid, endpoints, step)
        search = deadline.within(timeout)
        return search_by_trees(valid, endpoints, space, seed=seed, deadline=search, tries=_TREE_SHORTCUTS)
    if not OMPL_LOCK.acquire(timeout=waiting(deadline.within(timeout))):
        return None
    try:
        return _search(valid, endpoints, seed, planner, step, deadline.within(timeout), deadline)
    finally:
        OMPL_LOCK.release()
        valid.count()


def _tree_space(valid: ValidityChecker, endpoints: Array, step: float) -> TreeSpace:
    scale, (low, high), space = _scale(valid), _limits(valid, endpoints), valid.robot.space
    period = np.where(space.circular, 2.0 * np.pi, 0.0)
    return TreeSpace(scale, low * scale, high * scale, period * scale, _LONGEST_TREE_MOTION, step)


def _scale(valid: Checker) -> Array:
    """(J,) what a radian or metre of each joint counts."""
    b = valid.robot.space.base_nv
    return np.sqrt(np.maximum(valid.bounds.radius[b:].max(axis=1, initial=0.0), _LEAST_SCALED_RADIUS))


def _limits(valid: Checker, endpoints: Array) -> tuple[Array, Array]:
    """(J,) limits of the joints within a turn, and both ends within them."""
    robot, b = valid.robot, valid.robot.space.base_nv
    low, high = (np.clip(limit[b:], -np.pi, np.pi) for limit in (robot.space.lower, robot.space.upper))
    return np.minimum(low, endpoints[:, b:].min(axis=0)), np.maximum(high, endpoints[:, b:].max(axis=0))


def _search(
    valid: Checker,
    endpoints: Array,
    seed: int,
    planner: str,
    step: float,
    search: Deadline,
    deadline: Deadline,
) -> Array | None:
    from ompl import base as ob
    from ompl import geometric as og

    if search.over():
        return None
    seed_ompl(seed)
    b = valid.robot.space.base_nv
    count = valid.robot.space.nv - b
    scale = _scale(valid)
    space = _scaled_space(valid, endpoints, scale)
    motion = valid.in_chart(endpoints[0], 1.0 / scale)

    numbers = itemgetter(*range(count)) if count > 1 else lambda state: (state[0],)  # in half of a slice's time

    def row(state: Any) -> Array:
        return np.concatenate((endpoints[0, :b], np.divide(numbers(state), scale)))

    class Motions(ob.MotionValidator):
        def checkMotion(self, one: Any, two: Any) -> bool:
            return motion(numbers(one), numbers(two), step)

    setup = og.SimpleSetup(space)
    info = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: valid.at(row(state)))
    motions = Motions(info)
    info.setMotionValidator(motions)
    first, last = space.allocState(), space.allocState()
    for state, end in ((first, endpoints[0]), (last, endpoints[1])):
        for k in range(count):
            state[k] = float(end[b + k] * scale[k])  # type: ignore[index]
    setup.setStartAndGoalStates(first, last, 1e-9)
    chosen = getattr(og, planner)(info)
    chosen.setRange(_LONGEST_TREE_MOTION)
    setup.setPlanner(chosen)
    if not solved(setup, valid, search):
        return None
    corners = np.array([row(state) for state in setup.getSolutionPath().getStates()])
    corners[0], corners[-1] = endpoints
    return shortened(valid, corners, scale, step, seed, lambda: ended(valid, deadline))


def _scaled_space(valid: Checker, endpoints: Array, scale: Array) -> Any:
    """OMPL's space of the joints, scaled, within a turn and their limits; its trees' cells are by where the hand is."""
    from ompl import base as ob

    b = valid.robot.space.base_nv
    low, high = _limits(valid, endpoints)
    space = ob.RealVectorStateSpace(len(scale))
    space.setBounds(real_bounds(low * scale, high * scale))
    projection = _hand_motion(valid, endpoints[1])[:, b:] / scale
    cells = np.abs(projection) @ ((high - low) * scale) / _TREE_CELLS
    if (cells > 0.0).all():
        space.registerDefaultProjection(
            ob.RealVectorLinearProjectionEvaluator(space, cells.tolist(), np.asfortranarray(projection))
        )
    return space


def _hand_motion(valid: Checker, coordinates: Array) -> Array:
    """(3, nv) how the body that the joints can move farthest moves with each coordinate [m] about a configuration."""
    bounds = valid.bounds
    kin = Kinematics(bounds.bodies.tree, 1)
    kin.update(coordinates[None])
    hand = np.array([int(np.argmax(bounds.radius.sum(axis=0)))])
    at = bounds.bodies.ends_at(kin, np.zeros(1, dtype=np.intp), hand)[0].mean(axis=0)
    return bounds.bodies.tree.summed((kin.J[0, :, :3] + np.cross(kin.J[0, :, 3:], at)).T)


def shortened(
    valid: Checker,
    corners: Array,
    scale: Array,
    step: float,
    seed: int,
    over: Callable[[], bool],
) -> Array:
    """A path (K, nv) without detours: straight between two of its places wherever that is valid and shorter."""
    b = corners.shape[1] - len(scale)
    corners = corners[np.r_[True, (np.diff(corners, axis=0) != 0.0).any(axis=1)]]
    along = _along(corners[:, b:] * scale)
    tries = [(0.0, 1.0), *np.sort(np.random.default_rng(seed).random((_OMPL_SHORTCUTS - 1, 2)), axis=1).tolist()]
    for first, last in tries:
        if len(corners) < 3 or over():
            break
        places = first * along[-1], last * along[-1]
        i, j = (min(bisect_right(along, p) - 1, len(along) - 2) for p in places)
        if i == j:
            continue
        one, two = (
            corners[k] + (p - along[k]) / max(along[k + 1] - along[k], 1e-12) * (corners[k + 1] - corners[k])
            for k, p in ((i, places[0]), (j, places[1]))
        )
        if math.dist(two[b:] * scale, one[b:] * scale) > 0.98 * (places[1] - places[0]):
            continue
        if valid.motion(one, two, step):
            corners = np.vstack((corners[: i + 1], one, two, corners[j + 1 :]))
            corners = corners[np.r_[True, np.abs(np.diff(corners, axis=0)).max(axis=1) > 1e-12]]
            along = _along(corners[:, b:] * scale)
    return corners


def _along(points: Array) -> list[float]:
    """Lengths along a path (K, n), from its start to each of its corners."""
    return [0.0, *np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)).tolist()]


def divided(corners: Array, spacing: float) -> Array:
    """Rows (N, nv) along a path's corners (K, nv), no further apart than ``spacing`` [m or rad]."""
    rows = [corners[:1]]
    for one, two in pairwise(corners):
        count = max(1, int(np.ceil(np.linalg.norm(two - one) / spacing)))
        rows.append(one + np.arange(1, count + 1)[:, None] / count * (two - one))
    return np.concatenate(rows)
