"""A posture near home in which the robot does not collide with itself, where home does."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import listed

from .value import RobotValue

_LINK_DISTANCE = 2e-3  # [m] that the robot's own links keep in it: more than strips ask of them
_SCALES = np.repeat(np.linspace(0.05, 1.0, 40), 4)  # parts of the joints' ranges that are tried, the nearest first
_ROUNDS_FROM_START = 8  # of these from each start
_MOST_DISTANCES = 2_000_000  # distances that are measured from each start, or a little more
_ENDLESS_RANGE = np.pi  # [rad or m] the range of a joint without limits, to either side


def free_posture(robot: RobotValue) -> tuple[Array, str]:
    """A configuration (nq,) near home whose links keep apart, with few joints changed; and which do not, for people.

    The joints between two links that are in each other are moved at random, ever further and at last anywhere within
    their limits, until they overlap less; one pair after another. Where that gets stuck it begins anew from the middle
    of the limits, and from a random posture. The result is brought back to home joint by joint, as far as it stays
    free. It is the same at every call.

    Returns:
        The configuration in which the links overlap least, and which links do: empty where it is free.
    """
    space, rng, b = robot.space, np.random.default_rng(0), robot.space.base_nv
    data, geometry = robot.model.createData(), robot.collision_model.createData()
    home = space.to_coordinates(robot.home_q)
    low = np.where(np.isfinite(space.lower), space.lower, home - _ENDLESS_RANGE)
    high = np.where(np.isfinite(space.upper), space.upper, home + _ENDLESS_RANGE)
    support = robot.tree.support[[piece.joint for piece in robot.geometries]]
    between = support[robot.self_pairs[:, 0]] ^ support[robot.self_pairs[:, 1]]  # (S, M)

    def lacking(row: Array) -> Array:
        """By how much each pair is nearer than it should be [m] (S,)."""
        pin.computeDistances(robot.model, data, robot.collision_model, geometry, space.from_coordinates(row))
        return np.maximum(_LINK_DISTANCE - np.array([result.min_distance for result in geometry.distanceResults]), 0.0)

    def apart_from(row: Array) -> tuple[Array, Array]:
        """Coordinates (nv,) that are reached from others, and how much each pair still lacks there (S,)."""
        now = lacking(row)
        for scale in np.tile(
            _SCALES, int(np.clip(_MOST_DISTANCES // (len(_SCALES) * max(len(now), 1)), 1, _ROUNDS_FROM_START))
        ):
            if not now.any():
                break
            moved = np.unique(robot.tree.coordinate[between[rng.choice(np.flatnonzero(now))]])
            trial = row.copy()
            trial[moved] = rng.uniform(row + scale * (low - row), row + scale * (high - row))[moved]
            then = lacking(trial)
            if then.sum() < now.sum():
                row, now = trial, then
        return row, now

    row, now = apart_from(home)
    for start in (0.5 * (low + high), rng.uniform(low, high)):
        if not now.any():
            break
        start[:b] = home[:b]
        row, now = min((row, now), apart_from(start), key=lambda found: float(found[1].sum()))
    if not now.any():
        for k in np.argsort(np.abs(row - home)):
            trial = row.copy()
            trial[k] = home[k]
            if not lacking(trial).any():
                row = trial
    q = space.from_coordinates(row)
    q.setflags(write=False)
    said = _overlaps(robot, now)
    if not said and (hit := robot.self_collision(q)) is not None:  # asked anew: distances began from the last answers
        return q, f"{hit[0]!r} and {hit[1]!r}"
    return q, listed(said, 4)


def _overlaps(robot: RobotValue, lacking: Array) -> list[str]:
    """The pieces that are in each other, the deepest first, by what the distance of each pair lacks [m] (S,)."""
    said: list[str] = []
    for k in np.argsort(-lacking):
        if lacking[k] > _LINK_DISTANCE:
            a, b = (robot.geometries[i].name for i in robot.self_pairs[k])
            said.append(f"{a!r} and {b!r} ({1e3 * (lacking[k] - _LINK_DISTANCE):.0f} mm)")
    return said
