"""Calls of everything that the native kernel binds, each with one argument spoilt: it has to be refused.

A program of its own, as a kernel that reads past an array's end takes the process with it. It prints what was accepted
that should not have been, one line each, and then how many calls were made.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

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
    """

    name: str
    function: Callable[..., object]
    args: tuple[object, ...]
    free: tuple[tuple[int, int], ...] = ()
    numbers: tuple[int, ...] = ()


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
    block, hull = native.block(np.ones((2, 3)), zeros(2, 3)), native.convex(corners, triangles, 0.0)
    turned = np.tile(np.eye(3), (G, 1, 1))
    bodies_args = (tree, [sphere, box, hull], ints(1, 2, 3), turned, zeros(G, 3), zeros(G, 2, 3), np.ones(G), 0.0)
    yield Call("Bodies", native.Bodies, bodies_args, numbers=(2,))
    for solids in ([sphere, box], [sphere, box, block], [sphere, None, box], [sphere, box, hull, hull]):
        yield Call("Bodies of other solids", native.Bodies, (tree, solids, *bodies_args[2:]), free=((-1, -1),))
    bodies = native.Bodies(*bodies_args)
    poses_args = (np.tile(np.eye(3), (P, 1, 1)), np.full((P, 3), 3.0), zeros(P, 3), np.full((P, 3), 0.1))
    yield Call("Poses", native.Poses, poses_args)
    poses = native.Poses(*poses_args)
    moving_args = (zeros(N, M, 3), zeros(N, M), ints(0, -1, 1, 0))
    yield Call("Moving", native.Moving, moving_args, free=((2, 0),), numbers=(2,))
    moving = native.Moving(*moving_args)
    unknown = np.full((N, G, P), -1e9)

    def known(n: int = N, g: int = G, p: int = P):
        arrays = (np.full((n, g, p), -1e9), np.full((n, g, p), 1e9), np.full((n, g, p), np.inf))
        return native.Distances(*arrays, zeros(n, g, p, 3), zeros(n, g, p, 3), np.full(p, 1e-3))

    distance_args = (unknown, -unknown, unknown.copy(), zeros(N, G, P, 3), zeros(N, G, P, 3), zeros(P))
    yield Call("Distances", native.Distances, distance_args)
    narrow = native.Narrowphase(bodies)
    parts = [sphere, box, hull, block]
    for given in ([sphere, None, box, box], [sphere, 3.0]):
        yield Call("set_parts of none", narrow.set_parts, (given,), free=((-1, -1),))
    narrow.set_parts(parts)
    few, few_poses, few_moving = native.Narrowphase(bodies), native.Poses(*(a[1:] for a in poses_args)), native.Moving(
        moving_args[0][1:], moving_args[1][1:], moving_args[2]
    )  # fmt: skip
    few.set_parts(parts[1:])
    index = (ints(0, 1, 2, 3, 4, 6), ints(0, 1, 2, 0, 1, 2), ints(0, 1, 2, 3, 0, 1))
    query = (T, *index, poses, zeros(K, 3), zeros(K), zeros(K, 3), zeros(K, 3))
    yield Call("query", narrow.query, query, free=((0, 1),), numbers=(1, 2, 3))
    yield Call("query of fewer parts", few.query, query, free=((-1, -1),))
    refine = (T, poses, moving, 1.0, known())
    yield Call("refine", narrow.refine, refine, free=((0, 1),))
    for name, function, args in (
        ("fewer parts", few.refine, refine),
        ("fewer poses", narrow.refine, (T, few_poses, *refine[2:])),
        ("a shorter forecast", narrow.refine, (T, poses, few_moving, *refine[3:])),
        ("more nodes", narrow.refine, (*refine[:4], known(n=C + 1))),
        ("more bodies", narrow.refine, (*refine[:4], known(g=G + 1))),
        ("more columns", narrow.refine, (*refine[:4], known(p=P + 1))),
    ):
        yield Call(f"refine with {name}", function, args, free=((-1, -1),))
    follow = (
        T, zeros(N, nv), 0.3, np.full((N, nv), np.nan), zeros(N, G, 2, 3), zeros(N, G, 3, 3), np.full((N, 3), -9.0),
        np.full((N, 3), 9.0), ints(0, 1, 2, -1, 4), zeros(N), known(),
    )  # fmt: skip
    yield Call("follow", narrow.follow, follow, free=((0, 1),), numbers=(8,))
    yield Call("follow of more nodes", narrow.follow, (*follow[:10], known(n=C + 1)), free=((-1, -1),))
    radius, states = np.ones((m, G)), np.zeros(N - 1, dtype=np.int8)
    certify = (
        T, J, zeros(N, nv), zeros(N - 1, nv), poses, moving, radius, zeros(N - 1, P), known(), 0.05, 3, states,
    )  # fmt: skip
    yield Call("certify", narrow.certify, certify, free=((0, 1), (1, 0)))
    one = (T, J, zeros(1, nv), zeros(0, nv), poses, None, radius, None, known(n=1), 0.05, 3, states[:0])
    yield Call("certify of one node", narrow.certify, one, free=((-1, -1),))
    prove = (T, zeros(N, nv), zeros(N - 1, nv), poses, moving, zeros(N - 1, G), zeros(N - 1, P), 0.05, 3)
    yield Call("prove", narrow.prove, prove, free=((0, 1),))
    none = (T, zeros(0, nv), zeros(0, nv), poses, None, zeros(0, G), None, 0.05, 3)
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
    update = (T, zeros(N, nv), zeros(N, nv), zeros(nv, S), 1.0, own())
    yield Call("update", pairs.update, update, free=((0, 1),))
    yield Call("update of more nodes", pairs.update, (*update[:5], own(n=C + 1)), free=((-1, -1),))
    yield Call("update of more pairs", pairs.update, (*update[:5], own(s=S + 1)), free=((-1, -1),))
    self_certify = (T, zeros(N, nv), zeros(N - 1, nv), zeros(nv, S), own(), 0.01, 3, states.copy())
    yield Call("self certify", pairs.certify, self_certify, free=((0, 1),))
    yield Call("self prove", pairs.prove, (T, zeros(N, nv), zeros(N - 1, nv), zeros(N - 1, S), 0.01, 3), free=((0, 1),))
    system_args = (zeros(N, nv), zeros(N, nv, nv), zeros(N - 1, nv, nv))
    yield Call("System", native.System, system_args)
    system = native.System(*system_args)
    yield Call("add_elastic", system.add_elastic, (True, zeros(N - 1, nv), np.ones(nv)))
    yield Call("add_repulsion", system.add_repulsion, (narrow, J, known(), 0.3, 1.0, 0.1, 1.0), free=((1, 0),))
    for other in (known(n=N + 1), known(g=G + 1), known(p=P + 1)):
        yield Call("add_repulsion of others", system.add_repulsion, (narrow, J, other, 0.3, 1.0, 0.1, 1.0),
                   free=((-1, -1),))  # fmt: skip
    repulsion = (pairs, T, J, own(), np.full(S, 0.1), 1.0)
    yield Call("add_self_repulsion", system.add_self_repulsion, repulsion, free=((1, 1), (2, 0)))
    posture = (zeros(N, nv), zeros(N, nv), np.ones(nv), np.zeros(nv - 3, dtype=bool))
    yield Call("add_posture", system.add_posture, posture, free=((3, 0),))
    yield Call("add_posture of more joints", system.add_posture, (*posture[:3], np.zeros(nv + 1, dtype=bool)),
               free=((-1, -1),))  # fmt: skip
    yield Call("solve", system.solve, (np.ones(nv), zeros(N, nv)))
    turning = np.zeros(nv - 3, dtype=bool)
    for name in ("difference", "integrate"):
        yield Call(name, getattr(native, name), (True, turning, zeros(N, nv), zeros(N, nv), zeros(N, nv)))
    yield Call("project_rolling", native.project_rolling, (zeros(N, nv), 3), free=((0, 0), (0, 1)))
    for shape in ((0, nv), (N, 2)):
        yield Call("project_rolling", native.project_rolling, (zeros(*shape), 3), free=((-1, -1),))
    validity_args = (bodies, parts, np.array([[0, 1]]), poses, radius, 0.05)
    yield Call("Validity", native.Validity, validity_args, free=((2, 0),), numbers=(2,))
    for given in (parts[1:], [sphere, box, hull, None]):
        yield Call("Validity of other parts", native.Validity, (bodies, given, *validity_args[2:]), free=((-1, -1),))
    checker = native.Validity(*validity_args)
    charted = native.Validity(*validity_args).chart(zeros(nv), np.ones(2))
    yield Call("valid", checker.valid, (zeros(nv),))
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
    yield Call("fastest", native.fastest, (*grid, np.ones(N), np.ones(m), 0.0, zeros(N)))
    yield Call("braked", native.braked, (*grid, np.ones(m), 0.5, 0.9, zeros(N)))
    nothing = (zeros(0), zeros(0, m), zeros(0, m))
    yield Call("fastest of nothing", native.fastest, (*nothing, zeros(0), np.ones(m), 0.0, zeros(0)), free=((-1, -1),))
    yield Call("braked of nothing", native.braked, (zeros(N), zeros(N, 0), zeros(N, 0), zeros(0), 0.5, 0.9, zeros(N)),
               free=((-1, -1),))  # fmt: skip


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


def main() -> None:
    native = kernel()
    if native is None:
        print("no kernel", file=sys.stderr)
        raise SystemExit(3)
    made = 0
    for call in calls(native):
        if call.free == ((-1, -1),):  # wrong as it is
            cases = [("", call.args)]
        else:
            call.function(*call.args)
            cases = list(spoilt(call))
        for what, args in cases:
            made += 1
            if "-v" in sys.argv:
                print(call.name, what, file=sys.stderr, flush=True)
            try:
                call.function(*args)
            except REFUSED:
                continue
            except Exception as error:
                print(f"{call.name}: {what}: {error!r}")
            else:
                print(f"{call.name}: {what}: accepted")
    print(made)


if __name__ == "__main__":
    main()
