"""A posture near home in which the robot does not collide with itself, where home does."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array

from .model import RobotModel

_APART = 2e-3  # [m] that the robot's own links keep in it: more than strips ask of them
_ROUNDS = 8  # after each, fewer links are in each other
_SCALES = np.linspace(0.05, 1.0, 40)  # parts of the joints' ranges that are tried in a round, the nearest first
_TRIES = 4  # postures of each
_TURN = np.pi  # [rad or m] the range of a joint without limits, to either side


def free_posture(robot: RobotModel) -> Array | None:
    """A configuration (nq,) near home whose links keep apart, with few joints changed; None where none is found.

    The joints between links that are in each other are moved at random, ever further, until less is; what is found is
    brought back to home joint by joint, as far as it stays free. The same at every call.
    """
    space, rng = robot.space, np.random.default_rng(0)
    data, geometry = robot.model.createData(), robot.collision_model.createData()
    home = space.to_coordinates(robot.home_q)
    low = np.where(np.isfinite(space.lower), space.lower, home - _TURN)
    high = np.where(np.isfinite(space.upper), space.upper, home + _TURN)
    support = robot.tree.support[[piece.joint for piece in robot.geometries]]
    between = support[robot.self_pairs[:, 0]] ^ support[robot.self_pairs[:, 1]]  # (S, M)

    def lacking(row: Array) -> Array:
        """By how much each pair is nearer than it should be [m] (S,)."""
        pin.computeDistances(robot.model, data, robot.collision_model, geometry, space.from_coordinates(row))
        return np.maximum(_APART - np.array([result.min_distance for result in geometry.distanceResults]), 0.0)

    row, now = home, lacking(home)
    for _ in range(_ROUNDS):
        if not now.any():
            break
        moved = np.unique(robot.tree.coordinate[between[now > 0.0].any(axis=0)])
        before, least = row, float(now.sum())
        for scale in np.repeat(_SCALES, _TRIES):
            trial = before.copy()
            step = scale * rng.uniform(-0.5, 0.5, len(moved)) * (high - low)[moved]
            trial[moved] = np.clip(before[moved] + step, low[moved], high[moved])
            then = lacking(trial)
            if then.sum() < least:
                row, now, least = trial, then, float(then.sum())
                if not now.any():
                    break
    if now.any():
        return None
    for k in np.argsort(np.abs(row - home)):
        trial = row.copy()
        trial[k] = home[k]
        if not lacking(trial).any():
            row = trial
    q = space.from_coordinates(row)
    q.setflags(write=False)
    return q if robot.self_collision(q) is None else None  # asked anew: what was measured began from the last answers
