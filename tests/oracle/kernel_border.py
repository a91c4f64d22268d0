"""Calls of everything that the native kernel binds, each with one argument spoilt: it has to be refused.

A program of its own, as a kernel that reads past an array's end takes the process with it. It prints what was accepted
that should not have been, one line each, and then how many calls were made.

    python tests/oracle/kernel_border.py --fuzz 100000
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_strips.errors import NumericalError
from elastic_strips.native import kernel

REFUSED = (TypeError, ValueError)
N, C, G, P, M, K = 5, 7, 3, 4, 2, 6  # nodes, capacity, bodies, parts, movers, triples


@dataclass
class Call:
    """A call that is right as it is.

    Attributes:
        name: to print.
        function: what is called.
        args: its arguments.
        free: (argument, axis) of arrays that may be longer, or shorter; numbers: arguments whose entries count others.
        any: arguments that may hold what is no number; optional: those that may be None.
        depth: the argument that says how often intervals may be halved: at random, not too often.
    """

    name: str
    function: Callable[..., object]
    args: tuple[object, ...]
    free: tuple[tuple[int, int], ...] = ()
    numbers: tuple[int, ...] = ()
    any: tuple[int, ...] = ()
    optional: tuple[int, ...] = ()
    depth: int | None = None


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape)


def ints(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)


def calls(native) -> Iterator[Call]:
    planar, joints, nv, m = True, 5, 5, 6  # the last joint follows the one before
    support = np.zeros((joints, m), dtype=bool)
    support[1:, :3] = support[2:, 3] = support[3:, 4] = support[4, 5] = True
    offset = np.tile(np.eye(4), (joints, 1, 1))
    flags = np.zeros(joints, dtype=bool)
    motions = (ints(0, 1, 2, 3, 4, 4), np.array([1.0, 1.0, 1.0, 1.0, 1.0, -0.5]), zeros(m))
    tree_args = (
        planar, ints(0, 0, 1, 2, 3), ints(-1, -1, 3, 4, 5), flags, np.zeros(2, dtype=bool), support, offset, *motions,
    )  # fmt: skip
    yield Call("Tree", native.Tree, tree_args, free=((4, 0),), numbers=(1, 2, 7))
    tree = native.Tree(*tree_args)
    T = np.zeros((joints, C, 3, 4))
    T[..., 0, 0] = T[..., 1, 1] = T[..., 2, 2] = 1.0
    T[..., 0, 3] = np.arange(joints)[:, None]
    J = zeros(C, m, 6)
    yield Call("place", tree.place, (zeros(N, nv), T.copy(), J.copy(), True), free=((0, 0), (1, 1), (2, 0)))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    triangles = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint32)
    yield Call("convex", native.convex, (corners, triangles, 0.0), free=((0, 0), (1, 0)), numbers=(1,))
    yield Call("block", native.block, (np.ones((2, 3)), zeros(2, 3)))
    sphere, box = native.primitive("sphere", [0.1], 0.0), native.primitive("box", [0.1, 0.1, 0.1], 0.0)
    yield Call("primitive", native.primitive, ("box", [0.1, 0.1, 0.1], 0.0))
    for given in (("box", [0.1]), ("cube", [0.1, 0.1, 0.1]), ("", []), (3, [0.1]), ("sphere", 0.1), ("sphere", [None])):
        yield Call("primitive of no kind", native.primitive, (*given, 0.0), free=((-1, -1),))
    block, hull = native.block(np.ones((2, 3)), zeros(2, 3)), native.convex(corners, triangles, 0.0)
    turned = np.tile(np.eye(3), (G, 1, 1))
    bodies_args = (tree, [sphere, box, hull], ints(1, 2, 3), turned, zeros(G, 3), zeros(G, 2, 3), np.ones(G), 0.0)
    yield Call("Bodies", native.Bodies, bodies_args, numbers=(2,))
    for solids in ([sphere, box], [sphere, box, block], [sphere, None, box], [sphere, box, hull, hull]):
        yield Call("Bodies of other solids", native.Bodies, (tree, solids, *bodies_args[2:]), free=((-1, -1),))
    bodies = native.Bodies(*bodies_args)
    solids = [sphere, box, hull, block]
    placed = (np.tile(np.eye(3), (P, 1, 1)), np.full((P, 3), 3.0), zeros(P, 3), np.full((P, 3), 0.1))
    yield Call("Parts", native.Parts, (solids, *placed))
    yield Call("Parts that are boxes", native.Parts, ([sphere, None, hull, None], *placed))
    for given in (solids[1:], [sphere, 3.0, box, box]):
        yield Call("Parts of other solids", native.Parts, (given, *placed), free=((-1, -1),))
    parts, others = native.Parts([sphere, None, hull, block], *placed), native.Parts(solids, *placed)
    few = native.Parts(solids[1:], *(a[1:] for a in placed))
    yield Call("keep", parts.keep, (few, ints(-1, 0, 2, 1)), numbers=(1,))
    yield Call("keep of more", parts.keep, (few, ints(-1, 0, 3, 1)), free=((-1, -1),))
    moving_args = (zeros(N, M, 3), zeros(N, M), ints(0, -1, 1, 0))
    yield Call("Moving", native.Moving, (parts, *moving_args), numbers=(3,))
    moving = native.Moving(parts, *moving_args)
    unknown = np.full(N * G * P, -1e9)

    def rows(n: int = N, g: int = G, p: int = P) -> tuple[np.ndarray, np.ndarray]:
        return np.arange(n * g + 1) * p, np.tile(np.arange(p), n * g)

    def known(n: int = N, g: int = G, p: int = P, of=parts):
        k = n * g * p
        arrays = (np.full(k, -1e9), np.full(k, 1e9), np.full(k, np.inf))
        return native.Distances(
            of, *arrays, zeros(k, 3), zeros(k, 3), np.full(p, 1e-3), *rows(n, g, p), np.full((n, g), np.inf)
        )

    pairs_kept = N * G * P
    distance_args = (
        parts, unknown, -unknown, unknown.copy(), zeros(pairs_kept, 3), zeros(pairs_kept, 3), zeros(P), *rows(),
        zeros(N, G),
    )  # fmt: skip
    yield Call("Distances", native.Distances, distance_args, numbers=(7, 8))
    balls = (zeros(N, G, 3), np.ones((N, G)), zeros(P, 3), np.ones((P, 3)))
    near = (*balls, np.zeros(P, dtype=bool), np.arange(N) < 3, *rows(p=P - 1), ints(0, -1, 1, 2), P - 1)
    yield Call("near_parts", native.near_parts, near, numbers=(6, 7, 8), any=(0, 1))
    start, _ = rows(p=P - 1)
    for name, args in (
        ("rows that go back", (*near[:6], start[::-1].copy(), *near[7:])),
        ("rows that begin later", (*near[:6], np.maximum(start, 1), *near[7:])),
        ("rows of more", (*near[:6], start + np.arange(len(start)), *near[7:])),
        ("fewer former parts", (*near[:9], P - 2)),
    ):
        yield Call(f"near_parts of {name}", native.near_parts, args, free=((-1, -1),))
    narrow = native.Narrowphase(bodies)
    few_moving = native.Moving(parts, moving_args[0][1:], moving_args[1][1:], moving_args[2])
    index = (ints(0, 1, 2, 3, 4, 6), ints(0, 1, 2, 0, 1, 2), ints(0, 1, 2, 3, 0, 1))
    query = (T, *index, parts, zeros(K, 3), zeros(K), zeros(K, 3), zeros(K, 3))
    yield Call("query", narrow.query, query, free=((0, 1),), numbers=(1, 2, 3), any=(0,))
    yield Call("query of fewer parts", narrow.query, (*query[:4], few, *query[5:]), free=((-1, -1),))
    refine = (T, parts, moving, 1.0, known())
    yield Call("refine", narrow.refine, refine, free=((0, 1),), any=(0,), optional=(2,))
    for name, function, args in (
        ("fewer parts", narrow.refine, (T, few, *refine[2:])),
        ("others", narrow.refine, (T, others, None, *refine[3:])),
        ("others' forecast", narrow.refine, (T, parts, native.Moving(others, *moving_args), *refine[3:])),
        ("others' distances", narrow.refine, (*refine[:4], known(of=others))),
        ("a shorter forecast", narrow.refine, (T, parts, few_moving, *refine[3:])),
        ("more nodes", narrow.refine, (*refine[:4], known(n=C + 1))),
        ("more bodies", narrow.refine, (*refine[:4], known(g=G + 1))),
    ):
        yield Call(f"refine with {name}", function, args, free=((-1, -1),))
    follow = (
        T, zeros(N, nv), 0.3, np.full((N, nv), np.nan), zeros(N, G, 2, 3), zeros(N, G, 3, 3), np.full((N, 3), -9.0),
        np.full((N, 3), 9.0), ints(0, 1, 2, -1, 4), zeros(N), known(),
    )  # fmt: skip
    yield Call("follow", narrow.follow, follow, free=((0, 1),), numbers=(8,), any=(0,))
    yield Call("follow of more nodes", narrow.follow, (*follow[:10], known(n=C + 1)), free=((-1, -1),))
    radius, states = np.ones((m, G)), np.zeros(N - 1, dtype=np.int8)
    certify = (
        T, J, zeros(N, nv), zeros(N - 1, nv), parts, moving, radius, zeros(N - 1, P), known(), 0.05, 3, states,
    )  # fmt: skip
    yield Call("certify", narrow.certify, certify, free=((0, 1), (1, 0)), any=(0, 1), optional=(5,), depth=10)
    one = (T, J, zeros(1, nv), zeros(0, nv), parts, None, radius, None, known(n=1), 0.05, 3, states[:0])
    yield Call("certify of one node", narrow.certify, one, free=((-1, -1),))
    prove = (T, zeros(N, nv), zeros(N - 1, nv), parts, moving, zeros(N - 1, G), zeros(N - 1, P), 0.05, 3)
    yield Call("prove", narrow.prove, prove, free=((0, 1),), any=(0,), optional=(4,), depth=8)
    none = (T, zeros(0, nv), zeros(0, nv), parts, None, zeros(0, G), None, 0.05, 3)
    yield Call("prove of no node", narrow.prove, none, free=((-1, -1),))
    S = 2
    pairs_args = (bodies, np.array([[0, 1], [1, 2]]))
    yield Call("SelfPairs", native.SelfPairs, pairs_args, free=((1, 0),), numbers=(1,))
    pairs = native.SelfPairs(*pairs_args)

    def own(n: int = N, s: int = S):
        arrays = (np.full((n, s), -1e9), np.full((n, s), 1e9), np.full((n, s), np.inf))
        return native.SelfDistances(*arrays, zeros(n, s, 3), zeros(n, s, 3), zeros(n, s, 3), 1e-3)

    self_args = (zeros(N, S), zeros(N, S), zeros(N, S), zeros(N, S, 3), zeros(N, S, 3), zeros(N, S, 3), 1e-3)
    yield Call("SelfDistances", native.SelfDistances, self_args)
    update = (T, zeros(N, nv), zeros(N, nv), zeros(nv, S), np.ones(S), own())
    yield Call("update", pairs.update, update, free=((0, 1),), any=(0, 2))
    yield Call("update of more nodes", pairs.update, (*update[:5], own(n=C + 1)), free=((-1, -1),))
    yield Call("update of more pairs", pairs.update, (*update[:5], own(s=S + 1)), free=((-1, -1),))
    self_certify = (T, zeros(N, nv), zeros(N - 1, nv), zeros(nv, S), own(), 0.01, 3, states.copy())
    yield Call("self certify", pairs.certify, self_certify, free=((0, 1),), any=(0,), depth=6)
    self_prove = (T, zeros(N, nv), zeros(N - 1, nv), zeros(N - 1, S), 0.01, 3)
    yield Call("self prove", pairs.prove, self_prove, free=((0, 1),), any=(0,), depth=5)
    system_args = (zeros(N, nv), zeros(N, nv, nv), zeros(N - 1, nv, nv))
    yield Call("System", native.System, system_args)
    system = native.System(*system_args)
    yield Call("add_elastic", system.add_elastic, (True, zeros(N - 1, nv), np.ones(nv)))
    yield Call(
        "add_repulsion", system.add_repulsion, (narrow, J, known(), 0.3, 1.0, 0.1, 1.0), free=((1, 0),), any=(1,)
    )
    for other in (known(n=N + 1), known(g=G + 1)):
        yield Call("add_repulsion of others", system.add_repulsion, (narrow, J, other, 0.3, 1.0, 0.1, 1.0),
                   free=((-1, -1),))  # fmt: skip
    repulsion = (pairs, T, J, own(), np.full(S, 0.1), 1.0)
    yield Call("add_self_repulsion", system.add_self_repulsion, repulsion, free=((1, 1), (2, 0)), any=(1, 2))
    posture = (zeros(N, nv), zeros(N, nv), np.ones(nv), np.zeros(nv - 3, dtype=bool))
    yield Call("add_posture", system.add_posture, posture, free=((3, 0),))
    yield Call("add_posture of more joints", system.add_posture, (*posture[:3], np.zeros(nv + 1, dtype=bool)),
               free=((-1, -1),))  # fmt: skip
    yield Call("solve", system.solve, (np.ones(nv), zeros(N, nv)))
    turning = np.zeros(nv - 3, dtype=bool)
    for name in ("difference", "integrate"):
        yield Call(name, getattr(native, name), (True, turning, zeros(N, nv), zeros(N, nv), zeros(N, nv)), any=(2, 3))
    yield Call("project_rolling", native.project_rolling, (zeros(N, nv), 3), free=((0, 0), (0, 1)))
    for shape in ((0, nv), (N, 2)):
        yield Call("project_rolling", native.project_rolling, (zeros(*shape), 3), free=((-1, -1),))
    validity_args = (bodies, parts, np.array([[0, 1]]), radius, 0.05, 0.01)
    yield Call("Validity", native.Validity, validity_args, free=((2, 0),), numbers=(2,))
    checker = native.Validity(*validity_args)
    charted = native.Validity(*validity_args).chart(zeros(nv), np.ones(2))
    yield Call("valid", checker.valid, (zeros(nv),))
    yield Call("each", checker.each, (zeros(N, nv), False, np.zeros(N, dtype=np.int8)))
    yield Call("motion", checker.motion, (zeros(nv), np.full(nv, 0.1), 0.05))
    yield Call("chart", checker.chart, (zeros(nv), np.ones(2)), free=((1, 0),))
    yield Call("motion of a chart", charted.motion, ([0.0, 0.0], [0.1, 0.1], 0.05))
    nan = np.full(nv, np.nan)
    for name, function, args in (
        ("a chart of more", checker.chart, (zeros(nv), np.ones(nv + 1))),
        ("other states", charted.motion, ([0.0], [0.1, 0.1], 0.05)),
        ("no number", checker.valid, (nan,)),
        ("no number to start at", checker.motion, (nan, zeros(nv), 0.05)),
        ("no number to end at", checker.motion, (zeros(nv), nan, 0.05)),
        ("no step", checker.motion, (zeros(nv), np.ones(nv), 0.0)),
        ("a step that is no number", checker.motion, (zeros(nv), np.ones(nv), np.nan)),
        ("a long way", checker.motion, (zeros(nv), np.full(nv, 1e300), 0.05)),
    ):
        yield Call(f"validity of {name}", function, args, free=((-1, -1),))
    among = (np.stack((zeros(nv), np.full(nv, 0.1))), np.ones(2), np.full(2, -3.0), np.full(2, 3.0), zeros(2))
    search = (*among, 5, 0.05, 0.6, 500, 1.0, 20)
    yield Call("search", checker.search, search)
    for name, args in (
        ("no scale", (among[0], zeros(2), *search[2:])),
        ("more coordinates", (among[0], *(np.ones(nv + 1) for _ in range(4)), *search[5:])),
        ("no coordinate", (among[0], *(zeros(0) for _ in range(4)), *search[5:])),
        ("no step", (*search[:6], 0.0, *search[7:])),
        ("no range", (*search[:7], 0.0, *search[8:])),
        ("no end", (*search[:9], np.nan, 20)),
        ("far away", (1e9 * among[0], *search[1:])),
    ):
        yield Call(f"search with {name}", checker.search, args, free=((-1, -1),))
    yield Call("SphereFilter", native.SphereFilter, (*validity_args[:3], 0.05, 0.01), free=((2, 0),), numbers=(2,))
    spheres = native.SphereFilter(*validity_args[:3], 0.05, 0.01)
    yield Call("look", spheres.look, (zeros(11, nv), np.zeros(11, dtype=np.int8)))
    prover_args = (bodies, parts, np.array([[0, 1]]), radius, zeros(nv, 1))
    yield Call("PathProof", native.PathProof, prover_args, numbers=(2,))
    prover = native.PathProof(*prover_args)
    rows = (zeros(N, nv), zeros(N - 1, nv), 0.01, 0.01, 8, False, np.zeros(N - 1, dtype=np.int8))
    yield Call("prove by spheres", prover.prove, rows, depth=4)
    single = (rows[0][:1], rows[1][:0], *rows[2:6], rows[6][:0])
    yield Call("prove by spheres of one row", prover.prove, single, free=((-1, -1),))
    yield Call("least by spheres", prover.least, (rows[0], rows[1], 1e-3, 1.0))
    yield Call("least by spheres of one row", prover.least, (*single[:2], 1e-3, 1.0), free=((-1, -1),))
    yield Call("least by spheres of no end", prover.least, (rows[0], rows[1], 1e-3, np.inf), free=((-1, -1),))
    yield Call("spheres", native.spheres, (box, 64, 1e-3))
    for given in ((block, 64, 1e-3), (box, 0, 1e-3), (box, 2**40, 1e-3), (box, 64, np.nan)):
        yield Call("spheres of others", native.spheres, given, free=((-1, -1),))
    B, D, H, Q = 2, 3, 4, 5
    roll = (zeros(3), zeros(2), zeros(N, 2), zeros(N, 2), zeros(2), zeros(N, 2), zeros(2, 3), ints(*range(N)),
            zeros(N, H, 3))  # fmt: skip
    yield Call("roll_out", native.roll_out, roll, free=((8, 1),))
    wide = (zeros(3), zeros(4), zeros(N, 4), zeros(N, 4), zeros(4), zeros(N, 4), zeros(4, 3), *roll[7:])
    yield Call("roll_out of four speeds", native.roll_out, wide, free=((-1, -1),))
    seen = (zeros(N, H, 3), zeros(H))
    boxes = (zeros(B, 2), np.ones((B, 2)), zeros(B), np.ones(B))
    yield Call("near_discs", native.near_discs, (*seen, zeros(D, 8), zeros(D), 1.0, 9.0, zeros(N, H)))
    yield Call("possible_discs", native.possible_discs, (*seen, zeros(D, 8), zeros(3, D), *boxes, 9.0, zeros(N, H)))
    standing = (seen[0], zeros(D, 7), *boxes, 0.1, 9.0, zeros(N, H))
    yield Call("standing_boxes", native.standing_boxes, standing, free=((1, 0),))
    for half, least in ((np.zeros((B, 2)), 0.0), (np.full((B, 2), np.nan), 0.1), (np.full((B, 2), 1e9), 1e-9)):
        spoilt = (seen[0], zeros(D, 7), boxes[0], half, *boxes[2:], least, 9.0, zeros(N, H))
        yield Call("standing_boxes of no size", native.standing_boxes, spoilt, free=((-1, -1),))
    m, W = 3, 2
    travel = (np.linspace(0, 1, K), zeros(4, K - 1, m), np.linspace(0, 1, W + 1), zeros(W, 3, m), zeros(N),
              zeros(3, N, m))  # fmt: skip
    yield Call("travel_at", native.travel_at, travel)
    for k, short in ((0, zeros(1)), (2, zeros(1))):
        yield Call("travel_at of nothing", native.travel_at, (*travel[:k], short, *travel[k + 1 :]), free=((-1, -1),))
    lead = (zeros(W, Q), zeros(W, Q, 3), zeros(Q, 3), zeros(Q, 3), zeros(W, 2), 1.0, 1.0, True, 0.1, 1e-6, 0.9, 3,
            zeros(W, 3, 3))  # fmt: skip
    yield Call("lead_base", native.lead_base, lead)
    grid = (np.linspace(0, 1, N), np.ones((N, m)), zeros(N, m))
    yield Call("fastest", native.fastest, (*grid, np.ones(N), np.ones(m), 0.0, zeros(N)), any=(1, 2, 3))
    yield Call("braked", native.braked, (*grid, np.ones(m), 0.5, 0.9, zeros(N)), any=(1, 2))
    nothing = (zeros(0), zeros(0, m), zeros(0, m))
    yield Call("fastest of nothing", native.fastest, (*nothing, zeros(0), np.ones(m), 0.0, zeros(0)), free=((-1, -1),))
    yield Call("braked of nothing", native.braked, (zeros(N), zeros(N, 0), zeros(N, 0), zeros(0), 0.5, 0.9, zeros(N)),
               free=((-1, -1),))  # fmt: skip
    rows, columns, directions = 4, 6, 8
    angle = 2.0 * np.pi * np.arange(directions) / directions
    outlines = (ints(*range(K)), np.ones((K, directions)), zeros(K, 2), np.column_stack((np.cos(angle), np.sin(angle))))
    fill = (np.full((rows, columns), -1), zeros(2), 0.5, *outlines)
    yield Call("fill_outlines", native.fill_outlines, fill, free=((0, 0), (0, 1)))
    for name, args in (
        ("no size", (*fill[:2], 0.0, *fill[3:])),
        ("a size that is no number", (*fill[:2], np.nan, *fill[3:])),
        ("six directions", (*fill[:4], outlines[1][:, :6].copy(), outlines[2], outlines[3][:6])),
        ("no direction", (*fill[:4], outlines[1][:, :0].copy(), outlines[2], outlines[3][:0])),
    ):
        yield Call(f"fill_outlines of {name}", native.fill_outlines, args, free=((-1, -1),))
    taken, cells = np.eye(rows, columns) > 0.0, zeros(rows, columns)
    yield Call("clearance_map", native.clearance_map, (taken, 0.5, cells))
    yield Call("clearance_map of no size", native.clearance_map, (taken, 0.0, cells), free=((-1, -1),))
    yield Call("cell_cost", native.cell_cost, (cells, 0.1, 0.3, 12.0, cells.copy()), any=(0,))
    for inner, comfort, narrow in ((np.nan, 0.3, 12.0), (0.1, 0.0, 12.0), (0.1, np.nan, 12.0), (0.1, 0.3, 0.0)):
        yield Call("cell_cost of none", native.cell_cost, (cells, inner, comfort, narrow, cells.copy()),
                   free=((-1, -1),))  # fmt: skip
    costs = np.ones((rows, columns))
    yield Call("cheapest_route", native.cheapest_route, (costs, 0, rows * columns - 1), free=((0, 0), (0, 1)), any=(0,))
    for given in (
        (costs, 0, costs.size), (costs, costs.size, 0), (costs, -1, 3), (costs[:0], 0, 0), (0.0 * costs, 0, 3),
        (-costs, 0, 3), (costs * np.linspace(1.0, 1e9, columns), 0, 3), (1e300 * costs, 0, 3), (1e-300 * costs, 0, 3),
    ):  # fmt: skip
        yield Call("cheapest_route over no cells or such costs", native.cheapest_route, given, free=((-1, -1),))


def spoilt(call: Call) -> Iterator[tuple[str, tuple[object, ...]]]:
    """The call with one array of another size, type, layout or number of axes, or with numbers of what is not there."""

    def put(k: int, value: object) -> tuple[object, ...]:
        return (*call.args[:k], value, *call.args[k + 1 :])

    for k, array in enumerate(call.args):
        if not isinstance(array, np.ndarray):
            continue
        for axis in range(array.ndim):
            if (k, axis) in call.free:
                continue
            yield f"argument {k} longer along {axis}", put(k, np.concatenate([array, array.take([0], axis)], axis))
            if array.shape[axis] > 0:
                yield f"argument {k} shorter along {axis}", put(k, np.delete(array, 0, axis))
                yield f"argument {k} empty along {axis}", put(k, array.take([], axis))
        yield f"argument {k} with an axis more", put(k, array[None].copy())
        yield f"argument {k} with an axis less", put(k, array[0].copy())
        if array.ndim > 1:
            yield f"argument {k} flat", put(k, array.ravel())
        yield f"argument {k} as a number", put(k, np.array(1, dtype=array.dtype))
        for kind in (np.float32, np.int32, np.complex128, np.int64, np.float64, bool, object, np.dtype(">f8")):
            if array.dtype != kind:
                yield f"argument {k} as {np.dtype(kind)}", put(k, array.real.astype(kind))
        if array.size > 1:
            yield f"argument {k} with gaps", put(k, np.repeat(array, 2, axis=-1)[..., ::2])
        yield f"argument {k} as a list", put(k, array.tolist())
        yield f"argument {k} as nothing at all", put(k, "array")
        if k in call.numbers:
            for value in (-2, -(2**62), 2**31 - 1, 1_000) if array.dtype.kind == "i" else (2**32 - 1, 1_000):
                bad = array.copy()
                bad.flat[-1] = value
                yield f"argument {k} with {value}", put(k, bad)


def takes(call: Call, k: int, value: object) -> bool:
    """Whether the call is accepted with another argument ``k``."""
    args = [arg.copy() if isinstance(arg, np.ndarray) else arg for arg in call.args]
    args[k] = value
    try:
        call.function(*args)
    except REFUSED:
        return False
    return True


def not_numbers(call: Call) -> Iterator[tuple[str, tuple[object, ...]]]:
    """The call with what is no number in one of the arrays that are only read."""
    for k, array in enumerate(call.args):
        if not isinstance(array, np.ndarray) or array.dtype != float or array.size == 0 or k in call.any:
            continue
        locked = array.copy()
        locked.flags.writeable = False
        if not takes(call, k, locked):
            continue
        for value in (np.nan, np.inf, -np.inf):
            bad = array.copy()
            bad.flat[-1] = value
            yield f"argument {k} with {value}", (*call.args[:k], bad, *call.args[k + 1 :])


def never_made(kind: type) -> object:
    """An object of a class of the kernel without its C++ half."""
    return kind.__new__(kind)  # pyright: ignore[reportCallIssue]


def wrong_objects(call: Call, objects: Sequence[object]) -> Iterator[tuple[str, tuple[object, ...]]]:
    """The call with an object of another class, with none, and with one that was never made."""
    for k, arg in enumerate(call.args):
        kind = type(arg)
        if kind.__module__ != "elastic_strips._native":
            continue
        for other in (None, 3.0, np.zeros(3), *objects):
            if type(other) is not kind and not (other is None and k in call.optional):
                yield f"argument {k} as {other}", (*call.args[:k], other, *call.args[k + 1 :])
        yield f"argument {k} never made", (*call.args[:k], never_made(kind), *call.args[k + 1 :])


NUMBERS = (0, 1, -1, 7, 2**31 - 1, -(2**31), 2**62, -(2**62), 2**70, 0.0, -0.0, 1e-300, 1e300, np.nan, np.inf, -np.inf)
SHAPES = ((), (0,), (1,), (3,), (0, 3), (3, 0), (1, 1), (5, 5), (2, 3, 4), (0, 0, 0), (1, 1, 1, 1), (2, 2, 2, 2, 2))
KINDS = ("f8", "f8", "f4", "i8", "i8", "i1", "i4", "u4", "?", "c16", "O", "S3")


def mutated(rng: np.random.Generator, value: object, objects: Sequence[object]) -> object:
    """Another value instead of an argument: seldom one that fits."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        kind = int(rng.integers(9))
        if kind == 0:
            return np.full(SHAPES[rng.integers(len(SHAPES))], 1).astype(KINDS[rng.integers(len(KINDS))])
        if kind == 1:
            return value.real.astype(KINDS[rng.integers(len(KINDS))])
        if kind == 2 and value.ndim:
            return np.repeat(value, 2, axis=-1)[..., ::2]
        if kind == 3 and value.ndim:
            return value[::-1]
        if kind == 4 and value.ndim:
            axis = int(rng.integers(value.ndim))
            return value.take(rng.integers(0, max(1, value.shape[axis]), rng.integers(4)), axis, mode="clip") if (
                value.shape[axis]
            ) else value  # fmt: skip
        if kind == 5:
            return value.reshape(-1)
        if kind == 6 and value.ndim > 1:
            return value.T
        other = value.copy()
        if kind == 7:
            other.flags.writeable = False
        elif other.size and other.dtype != bool:
            some = rng.random(other.shape) < rng.choice([0.05, 1.0])
            chosen = [x for x in NUMBERS if other.dtype.kind == "f" or (x == x and abs(x) < 2**63)]
            with np.errstate(all="ignore"):
                other[some] = np.array(chosen[rng.integers(len(chosen))]).astype(other.dtype)
        return other
    if type(value).__module__ == "elastic_strips._native" and rng.random() < 0.5:
        return never_made(type(value))
    several = (None, "text", [], [np.nan], [1e300, -1.0], [None], {}, b"bytes", 1j, *NUMBERS, *objects)
    return several[rng.integers(len(several))]


def fuzz(native, count: int, seed: int, verbose: bool) -> None:
    """So many calls with one to three arguments that are another; whatever is said of them, the process lives."""
    rng = np.random.default_rng(seed)
    known = list(calls(native))
    objects = [arg for call in known for arg in call.args if type(arg).__module__ == "elastic_strips._native"]
    for number in range(count):
        call = known[rng.integers(len(known))]
        args = [arg.copy() if isinstance(arg, np.ndarray) else arg for arg in call.args]
        for k in rng.integers(0, len(args), rng.integers(1, 4)).tolist():
            args[k] = mutated(rng, args[k], objects)
        halvings = args[call.depth] if call.depth is not None else None
        if call.depth is not None and isinstance(halvings, int):
            args[call.depth] = min(halvings, 10)
        if verbose:
            print(number, call.name, args, file=sys.stderr, flush=True)
        try:
            call.function(*args)
        except (*REFUSED, NumericalError, MemoryError):
            continue
        except Exception as error:
            print(f"{call.name}, call {number} of seed {seed}: {error!r}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--fuzz", type=int, default=0, help="and so many calls with arguments at random")
    parser.add_argument("--seed", type=int, default=0, help="of those")
    parser.add_argument("--verbose", action="store_true", help="say each call before it is made")
    given = parser.parse_args()
    native = kernel()
    if native is None:
        print("no kernel", file=sys.stderr)
        raise SystemExit(3)
    np.set_printoptions(threshold=20)
    warnings.simplefilter("ignore")  # nanobind's, of objects that were never made
    made, known = 0, list(calls(native))
    objects = list({type(arg): arg for call in known for arg in call.args}.values())
    objects = [value for value in objects if type(value).__module__ == "elastic_strips._native"]
    for call in known:
        if call.free == ((-1, -1),):  # wrong as it is
            cases = [("", call.args)]
        else:
            call.function(*call.args)
            cases = [*spoilt(call), *not_numbers(call), *wrong_objects(call, objects)]
        for what, args in cases:
            made += 1
            if given.verbose:
                print(call.name, what, file=sys.stderr, flush=True)
            try:
                call.function(*args)
            except REFUSED:
                continue
            except Exception as error:
                print(f"{call.name}: {what}: {error!r}")
            else:
                print(f"{call.name}: {what}: accepted")
    fuzz(native, given.fuzz, given.seed, given.verbose)
    print(made + given.fuzz)


if __name__ == "__main__":
    main()
