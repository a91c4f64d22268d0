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


def self_pairs(
    model: pin.Model,
    pieces: Sequence[LinkGeometry],
    home: Array,
    disabled: Iterable[Iterable[str]] | None,
) -> npt.NDArray[np.intp]:
    """Pairs (S, 2) of pieces to keep apart.

    Pieces of one joint never move relative to each other and those of neighbouring joints touch by design: both are left
    out. A pair of links is left out where ``disabled`` names it. Without ``disabled``, pairs that touch at home or
    in nearly every sampled posture are left out, and said so in the log.
    """
    ignored = None if disabled is None else {frozenset(p) for p in disabled}
    pairs = []
    for i in range(len(pieces)):
        for k in range(i + 1, len(pieces)):
            a, b = pieces[i].joint, pieces[k].joint
            if a == b or model.parents[a] == b and a > 0 or model.parents[b] == a and b > 0:
                continue
            if ignored is not None and all(
                frozenset((la, lb)) in ignored for la in pieces[i].links for lb in pieces[k].links
            ):
                continue
            pairs.append((i, k))
    if ignored is None:
        pairs = _without_permanent(model, pieces, home, pairs)
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
