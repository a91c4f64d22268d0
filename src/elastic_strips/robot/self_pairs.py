"""Which pairs of a robot's own pieces are kept apart, which are not checked, and why.

Every pair of links is checked except those that one joint of the URDF joins, those that the SRDF leaves out, and those
that touch in every sampled posture. All three are decided by links and shapes as the file has them, before joints are
held still and hulls joined. So links that become neighbours by holding a joint, or are fixed to one, are checked.
Where hulls touch in every posture and the meshes do not, the meshes are taken as a few convex pieces each.
"""

from __future__ import annotations

import heapq
import logging
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.decompose import Surface, one_of_each_body

from .coal_shapes import faces, support_points, vertices
from .geometry import LinkGeometry, convex_shapes, joined_pieces, parts_of, piece_of

_log = logging.getLogger(__name__)
_SAMPLES = 400  # postures; a pair that touches in all of them is left out
_NEARLY_ALL = 50  # postures one after the other in which a pair touches that nearly always does
_HIDDEN_SHARE = 0.9  # of postures in which the meshes of such a pair touch, at most, where its hulls hide them
_MESH_SAMPLES = 40  # postures at least in which the meshes are asked, of pairs that are left out for their hulls
_MET_SAMPLES = 60  # postures in which pairs that never touch, as an SRDF says, are asked
_NEVER = "Never"  # what MoveIt's assistant writes of them
_TOUCH = 1.5e-3  # [m] shapes nearer than this count as touching, where it is asked whether they always do
_GRAZE = 1e-3  # [m] by which what is held still may overlap: closed fingers do
_LEAST = 1e-4  # [m] distance below which a proof that two pieces never touch gives up
_ENOUGH = 0.03  # [m] distance at which it need not go on
_MOST_PARTS = (4, 16)  # convex pieces of a mesh whose hull hides what it does: the second where the first do not help
_BODIES = 8  # of a mesh that are looked for inside of another one, in each of many postures
_CELLS = 600  # parts of the range of two joints that it looks at, at most

_DOT = coal.Sphere(1e-6)  # [m]

LinkPair = frozenset[str]


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
    n = len(shapes)
    joined = joints_of_links(model)
    mask = np.eye(n, dtype=bool)
    pairs: dict[LinkPair, UncheckedPair] = {}
    asked: dict[LinkPair, list[tuple[int, int]]] = {}
    never: dict[LinkPair, list[tuple[int, int]]] = {}

    def leave_out(members: list[tuple[int, int]]) -> None:
        for i, k in members:
            mask[i, k] = mask[k, i] = True

    for pair, members in _by_links(shapes).items():
        if len(pair) == 1:
            leave_out(members)
        elif pair in joined and pair not in rules.enabled:
            leave_out(members)
            pairs[pair] = _unchecked(pair, WhyUnchecked.JOINED, joined[pair])
        elif pair in rules.disabled:
            leave_out(members)
            pairs[pair] = _unchecked(pair, WhyUnchecked.SRDF, rules.disabled[pair])
            if rules.disabled[pair] == _NEVER:
                never[pair] = members
        else:
            asked[pair] = members
    postures = _Postures(model, shapes, meshes, rules.followers)
    first_apart = _first_apart(postures, asked)
    often = {
        pair: asked[pair]
        for pair, count in first_apart.items()
        if count >= _NEARLY_ALL
        and shapes[asked[pair][0][0]].joint != shapes[asked[pair][0][1]].joint
        and any(isinstance(meshes[m], coal.BVHModelBase) for member in asked[pair] for m in member)
    }
    known = {pair: share for pair, share in (shares or {}).items() if pair in often}
    shares = known | _mesh_shares(postures, {pair: each for pair, each in often.items() if pair not in known})
    for pair, count in first_apart.items():
        if count == _SAMPLES:
            share = shares.get(pair, 1.0)
            note = f"their hulls; their meshes in {100.0 * share:.3g} % of them" if share < 1.0 else ""
            if shapes[asked[pair][0][0]].joint == shapes[asked[pair][0][1]].joint:
                note = "nothing moves them to each other"
            leave_out(asked[pair])
            pairs[pair] = _unchecked(pair, WhyUnchecked.ALWAYS, note)
    hidden = frozenset(pair for pair, share in shares.items() if share < (1.0 if pair in pairs else _HIDDEN_SHARE))
    crowded = frozenset(pair for pair, count in first_apart.items() if _NEARLY_ALL <= count < _SAMPLES)
    return LeftOut(mask, pairs, shares, hidden, crowded, _ever_touching(postures, never))


def _unchecked(pair: LinkPair, why: WhyUnchecked, note: str = "") -> UncheckedPair:
    one, two = sorted(pair)
    return UncheckedPair((one, two), why, note)


def _warn(out: LeftOut, rules: PairRules) -> None:
    """Report what a user would not expect: pairs that somebody asked for, hulls that hide what meshes do, an SRDF's
    pairs that never touch and did so in some of the sampled postures."""
    always = {links: pair for links, pair in out.pairs.items() if pair.why is WhyUnchecked.ALWAYS}
    hidden = [pair for links, pair in always.items() if links in out.hidden]
    asked = [pair for links, pair in always.items() if rules.told and links not in out.hidden]
    crowded = [_unchecked(pair, WhyUnchecked.ALWAYS) for pair in sorted(out.crowded, key=sorted)]
    met = out.met
    for found, text in (
        (asked, "self-collision of %d pairs is not checked, though the SRDF asks for it: they touch in every sampled "
                "posture (%s)"),
        (crowded, "%d pairs of links touch in nearly every posture, so that little is free of collisions; those that "
                  "may touch can be left out by an SRDF (%s)"),
        (hidden, "self-collision of %d pairs is not checked: their convex hulls touch in every sampled posture, their "
                 "meshes do not (%s)"),
    ):  # fmt: skip
        if found:
            names = [" and ".join(pair.links) + (f", {pair.note}" if pair.note else "") for pair in found]
            more = f" and {len(names) - 8} more" if len(names) > 8 else ""
            _log.warning(text, len(names), "; ".join(names[:8]) + more)
    if met:
        said = [f"{' and '.join(sorted(pair))}, in {count} of {_MET_SAMPLES}" for pair, count in met.items()]
        more = f" and {len(said) - 8} more" if len(said) > 8 else ""
        _log.warning(
            "self-collision of %d pairs is not checked: the SRDF says that they never touch, but they do (%s)",
            len(said), "; ".join(said[:8]) + more,
        )  # fmt: skip


class _Postures:
    """Workspace: random postures of a model within its limits, in which joints that mimic another follow it.

    Args:
        model: the model.
        shapes: convex shapes of its links.
        meshes: what they were made of, in the same order.
        followers: joint → (the joint that it mimics, multiplier, offset [rad or m]).
    """

    def __init__(
        self,
        model: pin.Model,
        shapes: Sequence[LinkGeometry],
        meshes: Sequence[coal.CollisionGeometry] = (),
        followers: Mapping[str, tuple[str, float, float]] | None = None,
    ) -> None:
        self._model, self._data = model, model.createData()
        self._shapes, self._meshes = shapes, meshes
        self._rng = np.random.default_rng(0)
        self._low, self._high = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
        wide = ~((np.abs(self._low) < 1e6) & (np.abs(self._high) < 1e6))
        self._low[wide], self._high[wide] = -np.pi, np.pi
        self._followers = []
        for name, (leader, multiplier, offset) in (followers or {}).items():
            if model.existJointName(name) and model.existJointName(leader):
                one, two = model.joints[model.getJointId(name)], model.joints[model.getJointId(leader)]
                if one.nq == two.nq == 1:
                    self._followers.append((one.idx_q, two.idx_q, multiplier, offset))
        # a ball about each shape: most pairs are too far apart to be measured
        self._middles = [0.5 * (p.capsule.a + p.capsule.b) for p in shapes]
        self._radii = np.array([0.5 * np.linalg.norm(p.capsule.b - p.capsule.a) + p.capsule.r for p in shapes])
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._poses: dict[int, coal.Transform3s] = {}
        self._surfaces: dict[int, Surface] = {}  # of meshes, by their identity: parts of one share it
        self._corners: dict[int, Array] = {}
        self.place(pin.neutral(model))

    def place(self, q: Array) -> None:
        """Take a posture."""
        pin.forwardKinematics(self._model, self._data, q)
        self._poses.clear()

    def next(self) -> None:
        """Take the next random one."""
        q = pin.normalize(self._model, self._rng.uniform(self._low, self._high))
        for own, leader, multiplier, offset in self._followers:
            q[own] = multiplier * q[leader] + offset
        self.place(q)

    def near(self, pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """The pairs whose balls touch."""
        first, second = np.asarray(pairs, dtype=np.intp).reshape(-1, 2).T
        at = [self._data.oMi[p.joint].act(c) for p, c in zip(self._shapes, self._middles, strict=True)]
        middles = np.array(at).reshape(-1, 3)
        apart = np.linalg.norm(middles[first] - middles[second], axis=1) - self._radii[first] - self._radii[second]
        return [pairs[n] for n in np.flatnonzero(apart <= _TOUCH).tolist()]

    def touch(self, i: int, k: int) -> bool:
        """Whether two convex shapes touch."""
        return self._collide(self._shapes[i].geometry, self._pose(i), self._shapes[k].geometry, self._pose(k))

    def depth(self, i: int, k: int) -> float:
        """How deep [m] two convex shapes are in each other; below 0 where they are apart."""
        result = coal.DistanceResult()
        one, two = self._shapes[i].geometry, self._shapes[k].geometry
        return -coal.distance(one, self._pose(i), two, self._pose(k), coal.DistanceRequest(True), result)

    def meshes_touch(self, i: int, k: int, margin: float = _TOUCH, most: int | None = _BODIES) -> bool:
        """Whether two shapes come nearer than a margin [m] as the file has them, or a body of one is inside the other:
        Coal's meshes are hollow. Of meshes of more bodies only the first ``most`` are looked for there."""
        if self._collide(self._meshes[i], self._pose(i), self._meshes[k], self._pose(k), margin):
            return True
        for inner, outer in ((i, k), (k, i)):
            if isinstance(self._meshes[outer], coal.BVHModelBase):
                for corner in self._bodies(inner)[:most]:
                    at = self._pose(inner).transform(corner)
                    dot = coal.Transform3s(np.eye(3), at)
                    if not self._collide(_DOT, dot, self._shapes[outer].geometry, self._pose(outer), margin):
                        continue
                    if self._within(outer, self._pose(outer).inverse().transform(at)):
                        return True
        return False

    def _bodies(self, i: int) -> Array:
        """A point (B, 3) of each body of a shape as the file has it, in its frame."""
        mesh = self._meshes[i]
        if not isinstance(mesh, coal.BVHModelBase):
            return support_points(mesh)[0][:1]
        if id(mesh) not in self._corners:
            self._corners[id(mesh)] = one_of_each_body(vertices(mesh), faces(mesh))
        return self._corners[id(mesh)]

    def _within(self, i: int, point: Array) -> bool:
        """Whether a mesh encloses a point (3,) in its frame."""
        mesh = self._meshes[i]
        if id(mesh) not in self._surfaces:
            self._surfaces[id(mesh)] = Surface.of(vertices(mesh), faces(mesh))
        return self._surfaces[id(mesh)].encloses(point)

    def _collide(
        self,
        one: coal.CollisionGeometry,
        at: coal.Transform3s,
        two: coal.CollisionGeometry,
        there: coal.Transform3s,
        margin: float = _TOUCH,
    ) -> bool:
        self._request.security_margin = margin
        self._result.clear()
        return bool(coal.collide(one, at, two, there, self._request, self._result))

    def _pose(self, i: int) -> coal.Transform3s:
        if i not in self._poses:
            self._poses[i] = _pose(self._data, self._shapes[i])
        return self._poses[i]


def _first_apart(postures: _Postures, of: Mapping[LinkPair, list[tuple[int, int]]]) -> dict[LinkPair, int]:
    """In how many sampled postures each pair of links touches, by any of these shapes, before one where it does not."""
    counts, left = dict.fromkeys(of, 0), dict(of)
    for _ in range(_SAMPLES):
        if not left:
            break
        postures.next()
        close = set(postures.near([member for each in left.values() for member in each]))
        left = {pair: each for pair, each in left.items() if any(postures.touch(*m) for m in each if m in close)}
        for pair in left:
            counts[pair] += 1
    return counts


def _ever_touching(postures: _Postures, of: Mapping[LinkPair, list[tuple[int, int]]]) -> dict[LinkPair, int]:
    """In how many sampled postures two links touch, shapes as in the file, for pairs that do in some and not in all."""
    hits = Counter[LinkPair]()
    for _ in range(_MET_SAMPLES if of else 0):
        postures.next()
        close = set(postures.near([member for each in of.values() for member in each]))
        for pair, each in of.items():
            hits[pair] += any(
                postures.depth(*m) > _GRAZE and postures.meshes_touch(*m)
                for m in each
                if m in close and postures.touch(*m)
            )
    return {pair: count for pair, count in hits.items() if 0 < count < _MET_SAMPLES}


def _mesh_shares(postures: _Postures, of: Mapping[LinkPair, list[tuple[int, int]]]) -> dict[LinkPair, float]:
    """Share of postures in which links touch with their shapes as in the file, and not only with their hulls.

    Links that touch in all of the first postures are tested further, up to a posture in which they do not.
    """
    hits, asked, left = Counter[LinkPair](), Counter[LinkPair](), dict(of)
    for k in range(_SAMPLES):
        if k >= _MESH_SAMPLES:
            left = {pair: each for pair, each in left.items() if hits[pair] == asked[pair]}
        if not left:
            break
        postures.next()
        for pair, each in left.items():
            hits[pair] += any(postures.meshes_touch(*m) for m in each)
            asked[pair] += 1
    return {pair: hits[pair] / asked[pair] for pair in of}


def _pose(data: pin.Data, piece: LinkGeometry) -> coal.Transform3s:
    T = data.oMi[piece.joint] * pin.SE3(piece.placement[:3, :3], piece.placement[:3, 3])
    return coal.Transform3s(T.rotation, T.translation)


def _by_links(shapes: Sequence[LinkGeometry]) -> dict[LinkPair, list[tuple[int, int]]]:
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
    postures = _Postures(model, shapes, meshes)
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
            if depth > _GRAZE and postures.meshes_touch(i, k, 0.0, None):
                deep.append((i, k))
                collide.add(pair)
                continue
            what = "by less than 1 mm" if depth <= _GRAZE else "only their hulls"
            grazing.setdefault(pair, _unchecked(pair, WhyUnchecked.HELD, what))
    for pair in grazing.keys() - collide:
        out.pairs.setdefault(pair, grazing[pair])
    if deep:
        names = [f"{shapes[i].links[0]} and {shapes[k].links[0]}" for i, k in deep]
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        _log.warning(
            "joints are held still where links collide, so nothing is free of collisions: %s%s",
            "; ".join(names[:8]), more,
        )  # fmt: skip
    return deep


@dataclass(frozen=True, slots=True)
class Pieces:
    """A robot's convex pieces, and which pairs of them are kept apart.

    Attributes:
        pieces: in the frames of the planned model's joints.
        pairs: (S, 2) numbers of pieces that must not touch.
        apart: (S,) distances [m] that they are proven to keep in every posture; 0 where nothing is proven.
        unchecked: pairs of links that are not checked.
    """

    pieces: tuple[LinkGeometry, ...]
    pairs: Indices
    apart: Array
    unchecked: tuple[UncheckedPair, ...]


def pieces_and_pairs(
    model: pin.Model, collision: pin.GeometryModel, planned: pin.Model, carried: pin.GeometryModel, rules: PairRules
) -> Pieces:
    """The convex pieces of a robot and its self pairs.

    Robots of primitives only keep their shapes as they are; else shapes of one joint are joined if no pair is lost.

    Args:
        model: the model with all its joints.
        collision: its collision geometry.
        planned: the model in which some joints are held still.
        carried: the collision geometry of that one, in the same order.
        rules: what is known about pairs of links.

    Raises:
        RobotError: an unsupported shape, or a mesh without volume.
    """
    shapes, numbers, out = _parted(model, collision, rules)
    _warn(out, rules)
    meshes = [collision.geometryObjects[n].geometry for n in numbers]
    carriers = [carried.geometryObjects[n] for n in numbers]
    placed = [
        piece_of(shape.name, shape.links, obj.parentJoint, shape.geometry, np.array(obj.placement.homogeneous))
        for shape, obj in zip(shapes, carriers, strict=True)
    ]
    deep = held_together(planned, placed, meshes, out)
    alone = {i for pair in deep for i in pair}
    pieces, rows = placed, list(range(len(placed)))
    pairs = _checked(pieces, rows, out.mask, deep)
    if any(isinstance(mesh, coal.BVHModelBase) for mesh in meshes):
        while True:
            pieces, rows = joined_pieces(placed, out.mask, alone)
            pairs = _checked(pieces, rows, out.mask, deep)
            # a hull that was joined may touch always what its parts do not: these stay as they are
            single = {shape.name for shape in placed}
            swollen = [i for i in _touching_always(planned, pieces, pairs) if pieces[i].name not in single]
            if not swollen:
                break
            covered = {link for i in swollen for link in pieces[i].links}
            alone |= {n for n, shape in enumerate(placed) if shape.links[0] in covered}
    table = np.asarray(pairs, dtype=np.intp).reshape(-1, 2)
    unchecked = tuple(sorted(out.pairs.values(), key=lambda pair: pair.links))
    return Pieces(tuple(pieces), table, least_distances(planned, pieces, table), unchecked)


def _parted(
    model: pin.Model, collision: pin.GeometryModel, rules: PairRules
) -> tuple[list[LinkGeometry], list[int], LeftOut]:
    """Convex shapes of a robot, the number of the collision object of each, and the pairs that are not checked.

    Where two links' hulls touch in every posture and their meshes do not, each of their meshes is taken as a few
    convex pieces, so that the links can be kept apart, except where that does not help.
    """
    whole = convex_shapes(model, collision)
    meshes = [obj.geometry for obj in collision.geometryObjects]
    parts: dict[int, list[LinkGeometry]] = {}
    shares: dict[LinkPair, float] = {}

    def look() -> tuple[list[LinkGeometry], list[int], LeftOut]:
        taken = [(n, part) for n, shape in enumerate(whole) for part in parts.get(n, [shape])]
        numbers, shapes = [n for n, _ in taken], [part for _, part in taken]
        out = left_out(model, shapes, [meshes[n] for n in numbers], rules, shares)
        shares.update(out.shares)
        return shapes, numbers, out

    def of(pairs: Collection[LinkPair]) -> list[int]:
        links = {link for pair in pairs for link in pair}
        return [n for n, shape in enumerate(whole) if links & set(shape.links)]

    found = first = look()
    for most in _MOST_PARTS:
        if not found[2].hidden:
            return found
        parts |= {n: parts_of(whole[n], meshes[n], most) for n in of(found[2].hidden)}
        found = look()
    told_apart = of(first[2].hidden - found[2].hidden)
    if set(parts) <= set(told_apart):
        return found
    parts = {n: parts[n] for n in told_apart}
    return look()


def _checked(
    pieces: Sequence[LinkGeometry], rows: Sequence[int], mask: Mask, deep: Sequence[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Pairs of pieces that move relative to each other and are checked, and those of the shapes ``deep``."""
    number = {row: n for n, row in enumerate(rows)}
    held = {(number[i], number[k]) for i, k in deep}
    return [
        (i, k)
        for i in range(len(pieces))
        for k in range(i + 1, len(pieces))
        if (pieces[i].joint != pieces[k].joint and not mask[rows[i], rows[k]]) or (i, k) in held
    ]


def _touching_always(model: pin.Model, pieces: Sequence[LinkGeometry], pairs: list[tuple[int, int]]) -> set[int]:
    """Pieces of pairs that touch in every sampled posture."""
    each = {frozenset((str(i), str(k))): [(i, k)] for i, k in pairs}
    counts = _first_apart(_Postures(model, pieces), each)
    return {i for pair, count in counts.items() if count == _SAMPLES for i in each[pair][0]}


def least_distances(model: pin.Model, pieces: Sequence[LinkGeometry], pairs: Indices) -> Array:
    """Distances [m] (S,) that pairs are proven to keep in every posture within the limits; 0 where none is proven."""
    return np.array([least_distance(model, pieces, int(i), int(k)) for i, k in pairs], dtype=float)


def least_distance(model: pin.Model, pieces: Sequence[LinkGeometry], i: int, k: int, *, cells: int = _CELLS) -> float:
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
    reach = np.array([
        1.0 if slide else max(_chain_reach(model, pieces[n], j) for n in (i, k))
        for j, slide in zip(between, slides, strict=True)
    ])  # fmt: skip
    data, q = model.createData(), pin.neutral(model)
    request, result = coal.DistanceRequest(True), coal.DistanceResult()
    request.gjk_tolerance = 1e-8
    measured = np.inf

    def bound(a: Array, b: Array) -> float:
        nonlocal measured
        q[index] = 0.5 * (a + b)
        pin.forwardKinematics(model, data, q)
        result.clear()
        poses = [_pose(data, p) for p in (pieces[i], pieces[k])]
        d = coal.distance(pieces[i].geometry, poses[0], pieces[k].geometry, poses[1], request, result)
        measured = min(measured, d)
        return d - _LEAST - float((0.5 * (b - a) * reach).sum())

    todo = [(bound(low, high), 0, low, high)]
    for count in range(cells):
        least, _, a, b = todo[0]
        if measured <= _LEAST:
            return 0.0
        if least >= min(_ENOUGH, 0.7 * measured):
            return least
        heapq.heappop(todo)
        axis = int(np.argmax((b - a) * reach))
        middle = 0.5 * (a[axis] + b[axis])
        left, right = b.copy(), a.copy()
        left[axis] = right[axis] = middle
        for n, (one, two) in enumerate(((a, left), (right, b))):
            heapq.heappush(todo, (bound(one, two), 2 * count + n + 1, one, two))
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
