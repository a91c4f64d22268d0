"""Which pairs of a robot's links are not looked at, and why.

Every pair of links is looked at but those that one joint of the URDF joins without folding them together, those that
the SRDF leaves out, and those that touch in every sampled posture. All three are decided by links and shapes as the
file has them, before joints are held still and hulls joined: what holding a joint makes neighbours, or what is fixed to
a neighbour, is looked at.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Mask
from elastic_strips.errors import listed

from .geometry import LinkGeometry
from .sampled_postures import (
    GRAZING_DEPTH,
    NEVER_POSTURES,
    POSTURES,
    LinkPair,
    SampledPostures,
    folded,
    mesh_shares,
    touching_at_first,
    touching_in_some,
)

_log = logging.getLogger(__name__)
_NEARLY_ALL_POSTURES = 50  # postures one after the other in which a pair touches that nearly always does
_HIDDEN_SHARE = 0.9  # of postures in which the meshes of such a pair touch, at most, where its hulls hide them
_PAIRS_NAMED = 8  # in a warning
_NEVER_TOUCHING = "Never"  # what MoveIt's assistant writes of them


class WhyUnchecked(str, Enum):
    """Why collisions of two links are not checked."""

    JOINED = "one joint joins them"
    SRDF = "the SRDF leaves them out"
    ALWAYS = "they touch in every sampled posture"
    HELD = "they touch as their joints are held still"
    ALLOWED = "what is held may touch them"


@dataclass(frozen=True, slots=True)
class UncheckedPair:
    """Two links of a robot whose collisions with each other are not checked.

    Attributes:
        links: names of the links, sorted.
        why: the reason.
        note: further detail: the joint, the SRDF's reason, or in how many postures the meshes touch.
    """

    links: tuple[str, str]
    why: WhyUnchecked
    note: str = ""

    def __str__(self) -> str:
        return f"{self.links[0]} and {self.links[1]}: {self.why.value}" + (f" ({self.note})" if self.note else "")


def counted(pairs: Sequence[UncheckedPair]) -> str:
    """How many pairs are not checked for each reason, the most common first."""
    return "; ".join(f"{n} as {why}" for why, n in Counter(pair.why.value for pair in pairs).most_common())


@dataclass(frozen=True, slots=True)
class PairRules:
    """What is known about pairs of links besides their shapes.

    Attributes:
        disabled: pair of links → why it is left out, in the SRDF's words.
        enabled: pairs that are checked, though a joint joins them.
        told: whether somebody said which pairs to leave out, so that a pair that always touches is a surprise.
        followers: joint → (the joint that it mimics, multiplier, offset [rad or m]).
    """

    disabled: Mapping[LinkPair, str] = field(default_factory=dict)
    enabled: Collection[LinkPair] = frozenset()
    told: bool = False
    followers: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Pairs of a robot's shapes that are not checked.

    Attributes:
        mask: (n, n) whether a pair is left out; symmetric, and True on the diagonal and for shapes of one link.
        pairs: the links of these pairs, and why they are left out.
        shares: share of postures in which the meshes of a pair touch whose hulls do in every posture, or nearly so.
        hidden: pairs whose hulls touch in every sampled posture or nearly so, and whose meshes do not.
        crowded: pairs that are checked and touch in nearly every posture.
        met: pairs that never touch according to the SRDF, and in how many of the sampled postures they do.
    """

    mask: Mask
    pairs: dict[LinkPair, UncheckedPair]
    shares: Mapping[LinkPair, float]
    hidden: frozenset[LinkPair]
    crowded: frozenset[LinkPair]
    met: Mapping[LinkPair, int]


def joints_of_links(model: pin.Model) -> dict[LinkPair, str]:
    """Pairs of links that one joint joins, be it fixed or not, and its name: the tree as the URDF has it."""
    frames = list(model.frames)
    joined: dict[LinkPair, str] = {}
    for frame in frames:
        if frame.type != pin.FrameType.BODY:
            continue
        between = [frame]
        while 0 < between[-1].parentFrame < len(frames):
            above = frames[between[-1].parentFrame]
            if above.name == between[-1].name and above.type == between[-1].type:
                break  # Pinocchio gives a joint that was held still itself as its parent
            if above.type == pin.FrameType.BODY:
                if len(between) == 2:
                    joined[frozenset((frame.name, above.name))] = between[-1].name
                break
            between.append(above)
    return joined


def left_out(
    model: pin.Model,
    shapes: Sequence[LinkGeometry],
    meshes: Sequence[coal.CollisionGeometry],
    rules: PairRules,
    shares: Mapping[LinkPair, float] | None = None,
) -> LeftOut:
    """Decide which pairs of the file's shapes are checked.

    Args:
        model: the model with all its joints, before any is held still.
        shapes: convex shapes of its links.
        meshes: what they were made of, in the same order.
        rules: what else is known about the pairs.
        shares: the part of :attr:`LeftOut.shares` that is known already.
    """
    by_links = _pairs_by_links(shapes)
    between = {pair: members for pair, members in by_links.items() if len(pair) > 1}
    postures = SampledPostures(model, shapes, meshes, rules.followers)
    pairs = _told_unchecked(between, joints_of_links(model), rules)
    joined = {p: (out.note, between[p]) for p, out in pairs.items() if out.why is WhyUnchecked.JOINED}
    for pair in folded(postures, {pair: joint for pair, joint in joined.items() if pair not in rules.disabled}):
        del pairs[pair]
    asked = {pair: members for pair, members in between.items() if pair not in pairs}
    never = {p: between[p] for p, out in pairs.items() if out.why is WhyUnchecked.SRDF and out.note == _NEVER_TOUCHING}
    always, crowded, shares = _nearly_always_touching(postures, asked, shapes, meshes, shares or {})
    pairs |= always
    hidden = frozenset(pair for pair, share in shares.items() if share < (1.0 if pair in pairs else _HIDDEN_SHARE))
    mask = np.eye(len(shapes), dtype=bool)
    for pair, members in by_links.items():
        if pair in pairs or pair not in between:
            for i, k in members:
                mask[i, k] = mask[k, i] = True
    return LeftOut(mask, pairs, shares, hidden, crowded, touching_in_some(postures, never))


def _told_unchecked(
    pairs: Collection[LinkPair], joined: Mapping[LinkPair, str], rules: PairRules
) -> dict[LinkPair, UncheckedPair]:
    """The pairs that a joint or the SRDF leaves out."""
    found: dict[LinkPair, UncheckedPair] = {}
    for pair in pairs:
        if pair in joined and pair not in rules.enabled:
            found[pair] = _unchecked(pair, WhyUnchecked.JOINED, joined[pair])
        elif pair in rules.disabled:
            found[pair] = _unchecked(pair, WhyUnchecked.SRDF, rules.disabled[pair])
    return found


def _nearly_always_touching(
    postures: SampledPostures,
    asked: Mapping[LinkPair, list[tuple[int, int]]],
    shapes: Sequence[LinkGeometry],
    meshes: Sequence[coal.CollisionGeometry],
    given: Mapping[LinkPair, float],
) -> tuple[dict[LinkPair, UncheckedPair], frozenset[LinkPair], dict[LinkPair, float]]:
    """The pairs that touch in every posture, and are left out; those that nearly do; and shares of their meshes."""
    first_apart = touching_at_first(postures, asked)
    often = [pair for pair, count in first_apart.items() if count >= _NEARLY_ALL_POSTURES]
    rigid = {pair for pair in often if len({shapes[i].joint for i in asked[pair][0]}) == 1}
    shares = _shares(postures, {pair: asked[pair] for pair in often if pair not in rigid}, meshes, given)
    always: dict[LinkPair, UncheckedPair] = {}
    for pair in often:
        if first_apart[pair] == POSTURES:
            share = shares.get(pair, 1.0)
            note = f"their hulls; their meshes in {100.0 * share:.3g} % of them" if share < 1.0 else ""
            if pair in rigid:
                note = "nothing moves them to each other"
            always[pair] = _unchecked(pair, WhyUnchecked.ALWAYS, note)
    return always, frozenset(often).difference(always), shares


def _shares(
    postures: SampledPostures,
    pairs: Mapping[LinkPair, list[tuple[int, int]]],
    meshes: Sequence[coal.CollisionGeometry],
    given: Mapping[LinkPair, float],
) -> dict[LinkPair, float]:
    """Share of postures in which the meshes of pairs touch that have any; those that are ``given`` are not counted."""
    meshed = {
        pair: members
        for pair, members in pairs.items()
        if any(isinstance(meshes[k], coal.BVHModelBase) for member in members for k in member)
    }
    known = {pair: share for pair, share in given.items() if pair in meshed}
    return known | mesh_shares(postures, {pair: each for pair, each in meshed.items() if pair not in known})


def _unchecked(pair: LinkPair, why: WhyUnchecked, note: str = "") -> UncheckedPair:
    one, two = sorted(pair)
    return UncheckedPair((one, two), why, note)


def warn_of(out: LeftOut, rules: PairRules) -> None:
    """Report what a user would not expect: pairs that somebody asked for, hulls that hide what meshes do, an SRDF's
    pairs that never touch and did so in some of the sampled postures."""
    always = {links: pair for links, pair in out.pairs.items() if pair.why is WhyUnchecked.ALWAYS}
    hidden = [pair for links, pair in always.items() if links in out.hidden]
    asked = [pair for links, pair in always.items() if rules.told and links not in out.hidden]
    crowded = [_unchecked(pair, WhyUnchecked.ALWAYS) for pair in sorted(out.crowded, key=sorted)]
    met = out.met
    for found, text in (
        (
            asked,
            "self-collision of %d pairs is not checked, though the SRDF asks for it: they touch in every sampled "
            "posture (%s)",
        ),
        (
            crowded,
            "%d pairs of links touch in nearly every posture, so that little is free of collisions; where they "
            "may, an SRDF leaves them out (%s)",
        ),
        (
            hidden,
            "self-collision of %d pairs is not checked: their convex hulls touch in every sampled posture, their "
            "meshes do not (%s)",
        ),
    ):
        if found:
            names = [" and ".join(pair.links) + (f", {pair.note}" if pair.note else "") for pair in found]
            _log.warning(text, len(names), listed(names, _PAIRS_NAMED, between="; "))
    if met:
        said = [f"{' and '.join(sorted(pair))}, in {count} of {NEVER_POSTURES}" for pair, count in met.items()]
        _log.warning(
            "self-collision of %d pairs is not checked: the SRDF says that they never touch, but they do (%s)",
            len(said),
            listed(said, _PAIRS_NAMED, between="; "),
        )


def _pairs_by_links(shapes: Sequence[LinkGeometry]) -> dict[LinkPair, list[tuple[int, int]]]:
    """All pairs of shapes, by the links that they belong to; a link alone stands for its own shapes."""
    of: dict[LinkPair, list[tuple[int, int]]] = {}
    for i in range(len(shapes)):
        for k in range(i + 1, len(shapes)):
            of.setdefault(frozenset((*shapes[i].links, *shapes[k].links)), []).append((i, k))
    return of


def held_together(
    model: pin.Model,
    shapes: Sequence[LinkGeometry],
    meshes: Sequence[coal.CollisionGeometry],
    out: LeftOut,
) -> list[tuple[int, int]]:
    """Pairs of shapes that held joints bring together, deeper than closed fingers are: they collide.

    Args:
        model: the model in which some joints are held still.
        shapes: shapes of its links, in its joints' frames.
        meshes: what they were made of.
        out: the pairs that are not checked; those that only graze, or of which only the hulls touch, are added.
    """
    postures = SampledPostures(model, shapes, meshes)
    deep: list[tuple[int, int]] = []
    grazing: dict[LinkPair, UncheckedPair] = {}
    collide: set[LinkPair] = set()  # links of several shapes may do both
    for i in range(len(shapes)):
        for k in range(i + 1, len(shapes)):
            if shapes[i].joint != shapes[k].joint or out.mask[i, k]:
                continue
            depth = postures.depth(i, k)
            if depth < 0.0:
                continue  # for ever: nothing moves them
            pair = frozenset((*shapes[i].links, *shapes[k].links))
            if depth > GRAZING_DEPTH and postures.meshes_touch(i, k, 0.0, None):
                deep.append((i, k))
                collide.add(pair)
                continue
            what = "by less than 1 mm" if depth <= GRAZING_DEPTH else "only their hulls"
            grazing.setdefault(pair, _unchecked(pair, WhyUnchecked.HELD, what))
    for pair in grazing.keys() - collide:
        out.pairs.setdefault(pair, grazing[pair])
    if deep:
        names = [f"{shapes[i].links[0]} and {shapes[k].links[0]}" for i, k in deep]
        _log.warning(
            "joints are held still where links collide, so nothing is free of collisions: %s",
            listed(names, _PAIRS_NAMED, between="; "),
        )
    return deep
