"""Self-collision pairs: which pieces of the robot must not touch each other."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from .geometry import LinkGeometry
from .space import Array

_log = logging.getLogger(__name__)
_SAMPLES = 300
_ALWAYS = 0.95
_TOUCH = 1.5e-3  # pieces nearer than this [m] count as touching


def self_pairs(
    model: pin.Model,
    pieces: Sequence[LinkGeometry],
    home: Array,
    disabled: Iterable[Iterable[str]] | None,
) -> npt.NDArray[np.intp]:
    """Pairs (S, 2) of pieces to keep apart.

    Pieces of one joint never move relative to each other and those of neighbouring joints touch by design: both are
    left out. A pair of links is left out where ``disabled`` names it. Without ``disabled``, pairs that touch at home or
    in nearly every sampled posture are left out, and said so in the log.
    """
    ignored = None if disabled is None else {frozenset(p) for p in disabled}
    pairs = []
    for i in range(len(pieces)):
        for k in range(i + 1, len(pieces)):
            a, b = pieces[i].joint, pieces[k].joint
            if a == b or (model.parents[a] == b and a > 0) or (model.parents[b] == a and b > 0):
                continue
            if ignored is not None and all(
                frozenset((la, lb)) in ignored for la in pieces[i].links for lb in pieces[k].links
            ):
                continue
            pairs.append((i, k))
    if ignored is None:
        pairs = _without_permanent(model, pieces, home, pairs)
        pairs = [p for p in pairs if not never_touch(model, pieces, *p)]
    return np.asarray(pairs, dtype=np.intp).reshape(-1, 2)


def _without_permanent(
    model: pin.Model, pieces: Sequence[LinkGeometry], home: Array, pairs: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    data = model.createData()
    rng = np.random.default_rng(0)
    hits = np.zeros(len(pairs), dtype=int)
    at_home = np.zeros(len(pairs), dtype=bool)
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    wide = ~((np.abs(lower) < 1e6) & (np.abs(upper) < 1e6))
    lower[wide], upper[wide] = -np.pi, np.pi
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.security_margin = _TOUCH
    for sample in range(_SAMPLES + 1):
        q = home if sample == 0 else pin.normalize(model, rng.uniform(lower, upper))
        pin.forwardKinematics(model, data, q)
        poses = []
        for p in pieces:
            T = data.oMi[p.joint] * pin.SE3(p.placement[:3, :3], p.placement[:3, 3])
            poses.append(coal.Transform3s(T.rotation, T.translation))
        for n, (i, k) in enumerate(pairs):
            result.clear()
            if coal.collide(pieces[i].geometry, poses[i], pieces[k].geometry, poses[k], request, result):
                hits[n] += 1
                at_home[n] |= sample == 0
    drop = at_home | (hits > _ALWAYS * _SAMPLES)
    for n in np.flatnonzero(drop):
        i, k = pairs[n]
        why = "touch at home" if at_home[n] else "touch nearly always"
        _log.info("self-collision of %s and %s is not checked: they %s", pieces[i].name, pieces[k].name, why)
    return [p for n, p in enumerate(pairs) if not drop[n]]


def never_touch(model: pin.Model, pieces: Sequence[LinkGeometry], i: int, k: int, *, cells: int = 4000) -> bool:
    """Whether two pieces are proven apart in every posture: only tried where at most two joints lie between them.

    The box of these joints' limits is divided until, in each cell, the distance at its middle exceeds what the
    pieces can move towards each other inside it. True is a proof; False means that they touch somewhere or that
    ``cells`` did not suffice.
    """
    between = _joints_between(model, pieces[i].joint, pieces[k].joint)
    if not 1 <= len(between) <= 2:
        return False
    low, high, radius = [], [], []
    for j in between:
        joint = model.joints[j]
        if joint.nq != 1:
            return False
        low.append(float(model.lowerPositionLimit[joint.idx_q]))
        high.append(float(model.upperPositionLimit[joint.idx_q]))
        revolute = not joint.shortname().startswith("JointModelP")
        lever = max(_chain_reach(model, pieces[n], j) for n in (i, k))
        radius.append(lever if revolute else 1.0)
    reach = np.asarray(radius)
    data, q = model.createData(), pin.neutral(model)
    request, result = coal.DistanceRequest(True), coal.DistanceResult()
    open_cells = [(np.asarray(low), np.asarray(high))]
    if not np.isfinite(np.asarray(low + high)).all():
        return False
    for _ in range(cells):
        if not open_cells:
            return True
        a, b = open_cells.pop()
        for value, j in zip(0.5 * (a + b), between, strict=True):
            q[model.joints[j].idx_q] = value
        pin.forwardKinematics(model, data, q)
        poses = []
        for p in (pieces[i], pieces[k]):
            T = data.oMi[p.joint] * pin.SE3(p.placement[:3, :3], p.placement[:3, 3])
            poses.append(coal.Transform3s(T.rotation, T.translation))
        result.clear()
        d = coal.distance(pieces[i].geometry, poses[0], pieces[k].geometry, poses[1], request, result)
        if d <= 1e-4:
            return False
        travel = 0.5 * (b - a) * reach
        if d - 1e-4 > travel.sum():
            continue
        axis = int(np.argmax(travel))
        middle = 0.5 * (a[axis] + b[axis])
        left, right = b.copy(), a.copy()
        left[axis] = right[axis] = middle
        open_cells += [(a, left), (right, b)]
    return not open_cells


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


def _chain_reach(model: pin.Model, piece: LinkGeometry, joint: int) -> float:
    """Bound [m] of a piece's distance from a joint's origin in any posture; 0 where the joint does not carry it."""
    far = max(float(np.linalg.norm(piece.capsule.a)), float(np.linalg.norm(piece.capsule.b))) + piece.capsule.r
    at = piece.joint
    while at > 0 and at != joint:
        far += float(np.linalg.norm(model.jointPlacements[at].translation))
        if model.joints[at].shortname().startswith("JointModelP"):
            index = model.joints[at].idx_q
            far += max(abs(float(model.lowerPositionLimit[index])), abs(float(model.upperPositionLimit[index])))
        at = model.parents[at]
    return far if at == joint else 0.0
