"""A distance that two pieces of a robot are proven to keep in every posture within the limits."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Indices

from .geometry import LinkGeometry, joint_pose, pose_in_joint

_LEAST_PROVEN = 1e-4  # [m] distance below which a proof that two pieces never touch gives up
_DISTANCE_ENOUGH = 0.03  # [m] distance at which it need not go on
_MOST_CELLS = 2000  # parts of the range of two joints that it looks at, at most


def least_distances(model: pin.Model, pieces: Sequence[LinkGeometry], pairs: Indices) -> Array:
    """Distances [m] (S,) that pairs are proven to keep in every posture within the limits; 0 where none is proven."""
    return np.array([least_distance(model, pieces, int(i), int(k)) for i, k in pairs], dtype=float)


def least_distance(
    model: pin.Model, pieces: Sequence[LinkGeometry], i: int, k: int, *, cells: int = _MOST_CELLS
) -> float:
    """A distance [m] that two pieces are proven to keep in every posture; 0 where there is none, or no proof.

    Only tried where one or two joints lie between them. The box of these joints' limits is divided; in each cell the
    distance is at least that at its middle, less what the pieces can move towards each other inside it. The cell with
    the least bound is divided first, until the bound is 3 cm, or near what was measured.
    """
    between = _joints_between(model, pieces[i].joint, pieces[k].joint)
    if not 1 <= len(between) <= 2 or any(model.joints[j].nq != 1 for j in between):
        return 0.0
    index = [model.joints[j].idx_q for j in between]
    low, high = model.lowerPositionLimit[index], model.upperPositionLimit[index]
    if not np.isfinite([low, high]).all():
        return 0.0
    slides = [model.joints[j].shortname().startswith("JointModelP") for j in between]
    reach = np.array(
        [
            1.0 if slide else max(_chain_reach(model, pieces[n], j) for n in (i, k))
            for j, slide in zip(between, slides, strict=True)
        ]
    )
    data, q = model.createData(), pin.neutral(model)
    request, result = coal.DistanceRequest(True), coal.DistanceResult()
    request.gjk_tolerance = 1e-8
    one, two = pieces[i], pieces[k]
    in_one, in_two = pose_in_joint(one), pose_in_joint(two)
    measured = np.inf

    def bound(a: Array, b: Array) -> float:
        nonlocal measured
        q[index] = 0.5 * (a + b)
        pin.forwardKinematics(model, data, q)
        result.clear()
        at, there = joint_pose(data, one.joint) * in_one, joint_pose(data, two.joint) * in_two
        d = coal.distance(one.geometry, at, two.geometry, there, request, result)
        measured = min(measured, d)
        return d - _LEAST_PROVEN - float((0.5 * (b - a) * reach).sum())

    todo = [(bound(low, high), 0, low, high)]
    for count in range(cells):
        least, _, a, b = todo[0]
        if measured <= _LEAST_PROVEN:
            return 0.0
        if least >= min(_DISTANCE_ENOUGH, 0.7 * measured):
            return least
        heapq.heappop(todo)
        axis = int(np.argmax((b - a) * reach))
        middle = 0.5 * (a[axis] + b[axis])
        left, right = b.copy(), a.copy()
        left[axis] = right[axis] = middle
        for n, (lower, upper) in enumerate(((a, left), (right, b))):
            heapq.heappush(todo, (bound(lower, upper), 2 * count + n + 1, lower, upper))
    return max(todo[0][0], 0.0)


def _joints_between(model: pin.Model, a: int, b: int) -> list[int]:
    """Joints that move one of the bodies of joints ``a`` and ``b`` and not the other."""
    chains = []
    for joint in (a, b):
        chain = set()
        while joint > 0:
            chain.add(joint)
            joint = model.parents[joint]
        chains.append(chain)
    return sorted(chains[0] ^ chains[1])


def _axis(model: pin.Model, joint: int) -> Array:
    """(3,) axis of a joint that turns, in its own frame."""
    data = model.joints[joint].createData()
    model.joints[joint].calc(data, np.zeros(1))
    return np.asarray(data.S, dtype=float).reshape(6)[3:]


def _chain_reach(model: pin.Model, piece: LinkGeometry, joint: int) -> float:
    """Bound [m] of a piece's distance from a joint's axis in any posture; 0 where the joint does not carry it.

    Where other joints lie between them it is that from the joint's origin.
    """
    if piece.joint == joint:
        axis = _axis(model, joint)
        return piece.capsule.r + max(
            float(np.linalg.norm(np.cross(axis, end))) for end in (piece.capsule.a, piece.capsule.b)
        )
    far = max(float(np.linalg.norm(piece.capsule.a)), float(np.linalg.norm(piece.capsule.b))) + piece.capsule.r
    at = piece.joint
    while at > 0 and at != joint:
        far += float(np.linalg.norm(model.jointPlacements[at].translation))
        if model.joints[at].shortname().startswith("JointModelP"):
            index = model.joints[at].idx_q
            far += max(abs(float(model.lowerPositionLimit[index])), abs(float(model.upperPositionLimit[index])))
        at = model.parents[at]
    return far if at == joint else 0.0
