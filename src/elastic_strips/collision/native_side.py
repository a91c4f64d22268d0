"""The kernel's side of this room: all that it is handed is made here, of what NumPy has.

Coal's classes of Python and those of the kernel do not know each other, so each shape is made once more. Arrays are
views: the kernel sees where the nodes and the parts go, and writes what it measures. A view is made anew as soon as it
is of other objects than are there, so that nobody has to say when one was replaced.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, cast

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices, Mask, by_rows
from elastic_strips.coal_shapes import LONG_ROUND, ShapeKind, shape_of, vertices
from elastic_strips.constants import FAR
from elastic_strips.native import kernel
from elastic_strips.scene import Scene
from elastic_strips.scene.parts import Part
from elastic_strips.scene.scene import PartTable
from elastic_strips.work import count_work

from .candidates import CandidateParts

if TYPE_CHECKING:
    from elastic_strips.native import _native

    from .bounds import BodySet, MotionBounds
    from .candidates import MovingParts, NodePrediction

MOST_HALVINGS = 10
"""Of a segment that spheres are to prove."""


def native_bodies(bodies: BodySet, kept: list[_native.Bodies]) -> _native.Bodies | None:
    """The bodies, made where they are not kept yet, or None where there is no kernel."""
    module = kernel()
    if module is None:
        return None
    if not kept:
        solids = [native_solid(module, geometry) for geometry in bodies.geometries]
        joint = np.ascontiguousarray(bodies.joint, dtype=np.intp)
        rows = by_rows(bodies.rotation, bodies.translation, bodies.ends, bodies.radius)
        kept.append(module.Bodies(bodies.tree.native(), solids, joint, *rows, bodies.skin))
    return kept[0]


def native_parts(candidates: CandidateParts) -> _native.Parts | None:
    """Candidates, or None where there is no kernel."""
    module = kernel()
    if module is None:
        return None
    solids: list[_native.Solid | None] = [None] * len(candidates)
    for k in _no_boxes(candidates):
        solids[k] = _part(module, candidates.parts[k])
    return _parts(module, candidates, solids)


_LAST_PARTS: list[tuple[PartTable, ModuleType, _native.Parts]] = []


def scene_parts(scene: Scene) -> _native.Parts | None:
    """All parts of a scene as it stands, or None where there is no kernel; those of the last scene are kept."""
    module, table = kernel(), scene.table
    if module is None:
        return None
    for known, by, parts in _LAST_PARTS:
        if known is table and by is module:
            return parts
    everywhere = np.full((1, 3), np.inf)
    made = native_parts(CandidateParts.build(scene, -everywhere, everywhere, 0.0))
    assert made is not None
    _LAST_PARTS[:] = [(table, module, made)]
    return made


def proven_segments(
    bounds: MotionBounds,
    scene: Scene,
    self_pairs: Indices,
    rows: Array,
    v: Array,
    *,
    clearance: float,
    self_clearance: float,
    depth: int = MOST_HALVINGS,
    all: bool = False,
) -> Mask | None:
    """Segments (N-1,) between rows (N, nv) with tangents (N-1, nv) that spheres about the links prove; None without a
    kernel. What is proven is certified; of the others nothing is said.

    Args:
        bounds: motion radii of the links.
        scene: the obstacles, as they stand.
        self_pairs: (S, 2) pairs of links that have to stay apart.
        rows, v: the path.
        clearance, self_clearance: distances [m] to prove.
        depth: most halvings of a segment. A certificate with one more halves as finely, and proves all of this too.
        all: whether nothing is wanted but a proof of all of them.
    """
    rows, v = by_rows(rows, v)
    with _path_proof(bounds, scene, self_pairs) as proof:
        if proof is None:
            return None
        states = np.ones(len(v), dtype=np.int8)
        checks, queries = proof.prove(rows, v, clearance, self_clearance, depth, all, states)
    count_work(pairs=checks * len(bounds.bodies), queries=queries)
    return states == 0


def least_distance(
    bounds: MotionBounds, scene: Scene, rows: Array, v: Array, *, tolerance: float, most: float = FAR
) -> float | None:
    """The least distance [m] to obstacles along rows (N, nv) with tangents (N-1, nv), or ``most`` where that is less,
    and at most ``tolerance`` below it; None without a kernel.
    """
    rows, v = by_rows(rows, v)
    with _path_proof(bounds, scene, None) as proof:
        if proof is None:
            return None
        least, checks, queries = proof.least(rows, v, tolerance, most)
    count_work(pairs=checks * len(bounds.bodies), queries=queries)
    return least


@dataclass(frozen=True, slots=True)
class _PathProof:
    """The kernel's proof of paths, and of what it was made."""

    proof: _native.PathProof
    radius: Array
    parts: _native.Parts
    self_pairs: Indices


_LAST_PROOF: list[_PathProof] = []


@contextmanager
def _path_proof(bounds: MotionBounds, scene: Scene, self_pairs: Indices | None) -> Iterator[_native.PathProof | None]:
    """A proof of paths among a scene and some self pairs, or any pairs where there are None; None without a kernel.

    The last one is kept. Whoever uses it takes it away meanwhile, so that two threads never share it.
    """
    module, bodies, parts = kernel(), bounds.bodies.native(), scene_parts(scene)
    if module is None or bodies is None or parts is None:
        yield None
        return
    try:
        kept = _LAST_PROOF.pop()
    except IndexError:
        kept = None
    if (
        kept is None
        or kept.radius is not bounds.of_motion
        or kept.parts is not parts
        or not (self_pairs is None or np.array_equal(self_pairs, kept.self_pairs))
    ):
        none = np.empty((0, 2), dtype=np.intp)
        pairs = np.ascontiguousarray(none if self_pairs is None else self_pairs, dtype=np.intp)
        made = module.PathProof(bodies, parts, pairs, *by_rows(bounds.of_motion, bounds.pair_radius(pairs)))
        kept = _PathProof(made, bounds.of_motion, parts, pairs)
    yield kept.proof
    _LAST_PROOF[:] = [kept]


class NativeNarrowphase:
    """Workspace: the kernel's narrow phase, and what it is shown.

    Attributes:
        calls: the kernel's object.
    """

    def __init__(self, module: ModuleType, bodies: _native.Bodies) -> None:
        self.calls: _native.Narrowphase = module.Narrowphase(bodies)
        self._module = module
        self._parts: tuple[CandidateParts, _native.Parts] | None = None
        self._moving: tuple[_native.Parts, NodePrediction, Indices, _native.Moving] | None = None

    @staticmethod
    def of(bodies: BodySet) -> NativeNarrowphase | None:
        """That of the bodies, or None where there is no kernel."""
        module, native = kernel(), bodies.native()
        return None if module is None or native is None else NativeNarrowphase(module, native)

    def parts(self, candidates: CandidateParts) -> _native.Parts:
        """Candidates, which move in place; what it knows of parts that are still there is kept."""
        if self._parts is not None and self._parts[0] is candidates:
            return self._parts[1]
        former = self._parts
        solids: list[_native.Solid | None] = [None] * len(candidates)
        for k in _no_boxes(candidates):
            solids[k] = _part(self._module, candidates.parts[k])
        parts = _parts(self._module, candidates, solids)
        if former is not None:
            at = {id(p): k for k, p in enumerate(former[0].parts)}
            parts.keep(former[1], np.array([at.get(id(p), -1) for p in candidates.parts], dtype=np.intp))
        self._parts = candidates, parts
        return parts

    def scene(self, candidates: CandidateParts, moving: MovingParts) -> tuple[_native.Parts, _native.Moving | None]:
        """Candidates and how they move: None where nothing does."""
        parts, prediction, mover, kept = self.parts(candidates), moving.prediction, moving.mover, self._moving
        if prediction is None:
            return parts, None
        if kept is not None and kept[0] is parts and kept[1] is prediction and kept[2] is mover:
            return parts, kept[3]
        made = self._module.Moving(parts, *by_rows(prediction.shift, prediction.uncertainty), mover)
        self._moving = parts, prediction, mover, made
        return parts, made

    def distances(
        self, candidates: CandidateParts, known: tuple[Array, ...], rows: tuple[Indices, Indices], floor: Array
    ) -> _native.Distances:
        """What is known of candidates: bound, since, exact, direction, witness and limit of an `ObstacleProximity`."""
        return self._module.Distances(self.parts(candidates), *known, *rows, floor)


class NativeSelfPairs:
    """Workspace: the kernel's self pairs, and what it is shown.

    Attributes:
        calls: the kernel's object.
    """

    def __init__(self, module: ModuleType, bodies: _native.Bodies, pairs: Indices) -> None:
        self.calls: _native.SelfPairs = module.SelfPairs(bodies, np.ascontiguousarray(pairs, dtype=np.intp))
        self._module = module

    @staticmethod
    def of(bodies: BodySet, pairs: Indices) -> NativeSelfPairs | None:
        """Those of the bodies, or None where there is no kernel."""
        module, native = kernel(), bodies.native()
        return None if module is None or native is None else NativeSelfPairs(module, native, pairs)

    def distances(self, known: tuple[Array, ...], tolerance: float) -> _native.SelfDistances:
        """What is known of them: bound, since, exact, direction, first and second of a `SelfProximity`."""
        return self._module.SelfDistances(*known, tolerance)


def _parts(module: ModuleType, candidates: CandidateParts, solids: Sequence[_native.Solid | None]) -> _native.Parts:
    """Candidates with these solids; where there is none, the kernel makes the box once it needs it."""
    c = candidates
    return module.Parts(solids, c.rotation, c.translation, c.box_center, c.box_half)


def _no_boxes(candidates: CandidateParts) -> list[int]:
    """Numbers of the parts that are not just the box about them; such boxes the kernel makes itself."""
    box = coal.Box
    return [k for k, part in enumerate(candidates.parts) if type(part.geometry) is not box]


def _part(module: ModuleType, part: Part) -> _native.Solid:
    """A part for the kernel, made once: most of a sensed scene was there before."""
    for entry in part.kept:
        by, known = cast("tuple[ModuleType, _native.Solid]", entry)
        if by is module:
            return known
    if part.geometry is not None:
        solid = native_solid(module, part.geometry)
    else:
        solid = module.block(part.sizes, part.middles)
    part.kept.append((module, solid))
    return solid


def native_solid(module: ModuleType, geometry: coal.CollisionGeometry) -> _native.Solid:
    """A convex shape."""
    kind, half = shape_of(geometry)
    swept = float(geometry.getSweptSphereRadius())
    if kind is ShapeKind.CONVEX:
        triangles = [geometry.polygons(i) for i in range(geometry.num_polygons)]
        corners = np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.uint32)
        return module.convex(vertices(geometry), corners, swept)
    if kind is ShapeKind.BOX:
        return module.primitive(kind.value, [2.0 * h for h in half], swept)
    if kind in LONG_ROUND:
        return module.primitive(kind.value, [half[0], 2.0 * half[1]], swept)
    return module.primitive(kind.value, list(half), swept)
