"""A robot's own pieces, and which pairs of them are kept apart.

Where hulls touch in every posture and the meshes do not, the meshes are taken as a few convex pieces each.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Indices, Mask

from .geometry import LinkGeometry, convex_shapes, joined_pieces, parts_of, piece_of
from .least_distance import least_distances
from .sampled_postures import POSTURES, LinkPair, SampledPostures, touching_at_first
from .unchecked_pairs import LeftOut, PairRules, UncheckedPair, held_together, left_out, warn_of

_PARTS_OF_MESH = (
    4,
    16,
)  # convex pieces of a mesh whose hull hides what it does: the second where the first do not help


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
    warn_of(out, rules)
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
    for most in _PARTS_OF_MESH:
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
    counts = touching_at_first(SampledPostures(model, pieces), each)
    return {i for pair, count in counts.items() if count == POSTURES for i in each[pair][0]}
