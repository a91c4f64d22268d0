"""Parts: the convex Coal geometries that obstacles consist of, with bounds for culling; equal boxes become fewer.

Everything here is in the obstacle's own frame, so that all copies of an obstacle that is moved share one `Solid`.

The union of the boxes does not change: only boxes of one grid that fill a larger box are merged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from itertools import pairwise, permutations

import coal
import numpy as np
from numpy.typing import NDArray

from elastic_strips.arrays import Array, ArrayLike, Indices
from elastic_strips.errors import SceneError
from elastic_strips.hulls import MIN_THICKNESS, convex_shape, flatness
from elastic_strips.native import kernel

_IDENTITY = np.eye(4)
_IDENTITY.flags.writeable = False
_NO_BOXES = np.zeros((0, 3))


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One convex piece of an obstacle, or one block of boxes; all in the obstacle's frame.

    Attributes:
        geometry: Coal geometry, its local AABB computed; None for a block of boxes.
        T_obstacle_part: Pose (4, 4) of the geometry in the obstacle's frame; the rotation always is the identity.
        center: Centre (3,) of the part's axis-aligned bounding box [m].
        half_extents: Half sizes (3,) of that box [m].
        radius: Radius of a sphere about ``center`` that holds the part [m].
        sizes, middles: For a block: edges and middles (n, 3) of its boxes [m]; of none otherwise.
        kept: What who computes with it has made of it and keeps, as long as there is the part.
    """

    geometry: coal.CollisionGeometry | None
    T_obstacle_part: Array
    center: Array
    half_extents: Array
    radius: float
    sizes: Array = field(default_factory=lambda: _NO_BOXES)
    middles: Array = field(default_factory=lambda: _NO_BOXES)
    kept: list[object] = field(default_factory=list, init=False, repr=False)
    _boxes: list[tuple[coal.Box, Array]] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        for array in (self.T_obstacle_part, self.center, self.half_extents, self.sizes, self.middles):
            array.flags.writeable = False

    @property
    def boxes(self) -> Sequence[tuple[coal.Box, Array]]:
        """For a block: the (coal.Box, middle (3,)) of its boxes, made when they are first asked for; else none."""
        if len(self._boxes) < len(self.sizes):
            self._boxes[:] = zip(_boxes(self.sizes), self.middles, strict=True)
        return self._boxes

    @property
    def members(self) -> tuple[coal.CollisionGeometry, ...]:
        """The Coal objects of the part: one geometry, or those of a block's boxes."""
        return tuple(g for g, _ in self.boxes) if self.geometry is None else (self.geometry,)

    def __reduce__(self) -> tuple[object, ...]:
        return _restored, tuple(getattr(self, f.name) for f in fields(self) if f.init)


def _restored(*state: object) -> Part:
    """Rebuild a pickled part: Coal pickles a primitive without its local AABB."""
    part = Part(*state)  # type: ignore[arg-type]
    if part.geometry is not None:
        part.geometry.computeLocalAABB()
    return part


class Solid:
    """The parts of one shape and their bounds as arrays; shared by all obstacles of that shape.

    Attributes:
        parts: The parts (p).
        translation: Part origins in the obstacle's frame (p, 3) [m].
        center: Bounding box centres (p, 3) [m].
        half_extents: Bounding box half sizes (p, 3) [m].
        radius: Bounding sphere radii (p,) [m].
        rows: All of these (p, 10), in this order: a scene joins the rows of its solids at once.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts: tuple[Part, ...] = tuple(parts)
        self.rows: Array = np.array(
            [[*p.T_obstacle_part[:3, 3], *p.center, *p.half_extents, p.radius] for p in self.parts]
        ).reshape(-1, 10)
        self.translation: Array = self.rows[:, :3]
        self.center: Array = self.rows[:, 3:6]
        self.half_extents: Array = self.rows[:, 6:9]
        self.radius: Array = self.rows[:, 9]

    @cached_property
    def reach(self) -> float:
        """Radius [m] of a sphere about the obstacle's origin that holds all parts."""
        return float((np.linalg.norm(self.center, axis=1) + self.radius).max())

    def __reduce__(self) -> tuple[object, ...]:
        return Solid, (self.parts,)


def primitive(geometry: coal.CollisionGeometry, half_extents: ArrayLike, radius: float) -> Solid:
    """Solid of one Coal primitive that is centred at the obstacle's origin."""
    geometry.computeLocalAABB()
    return Solid([Part(geometry, np.eye(4), np.zeros(3), np.array(half_extents, dtype=np.float64), float(radius))])


def hull_part(vertices: Array, what: str = "vertices") -> Part:
    """The convex hull of ``vertices`` (V, 3) [m] as a part, called ``what`` in messages.

    Raises:
        SceneError: the points are flat or fewer than four.
    """
    if len(vertices) < 4:
        raise SceneError(f"{what}: {len(vertices)} points given; a convex hull needs at least 4")
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    center = 0.5 * (low + high)
    local = vertices - center
    thickness = flatness(local)
    if thickness < MIN_THICKNESS:
        raise SceneError(
            f"{what}: the {len(vertices)} points are flat ({thickness:.3g} m thick); a convex hull needs at least 4 "
            f"points that do not lie in one plane (thickness at least {MIN_THICKNESS:g} m)"
        )
    from scipy.spatial import QhullError  # late: slow to import

    try:
        geometry, corners = convex_shape(local, what, SceneError)
    except QhullError as error:
        raise SceneError(f"{what}: no convex hull of {len(vertices)} points: {str(error).splitlines()[0]}") from None
    half, reach = 0.5 * (high - low), np.abs(corners).max(axis=0)
    half = np.where(reach > half + 1e-9, reach, half)  # a hull may be larger than its points, and rounding is no growth
    placement = np.eye(4)
    placement[:3, 3] = center
    return Part(geometry, placement, center, half, float(np.linalg.norm(corners, axis=1).max()))


BLOCK_EDGE = 0.45
"""Edge [m] of the cells of space that a cluster is cut into; each occupied cell is one `Part`."""

_SNAP_SHARE = 1e-3
"""Centres within this share of a voxel's edge of a regular grid are snapped to it (boxes grow by what was snapped)."""

MAX_CENTERS = 2_000_000
_MAX_BOXES = 400_000  # a kilobyte each
"""Most boxes of one obstacle, as they are given and after merging."""

_Index = NDArray[np.int64]


def cluster_solid(centers: Array, size: Array) -> Solid:
    """Solid of axis-aligned boxes of one ``size`` (3,) about ``centers`` (V, 3) [m].

    Duplicates are dropped. If the centres lie on a grid of that size, full larger boxes replace groups of them;
    otherwise every box stays. The boxes are grouped by cells of about `BLOCK_EDGE` metres.

    Raises:
        SceneError: more than `MAX_CENTERS` boxes, or more than `_MAX_BOXES` after merging.
    """
    if len(centers) > MAX_CENTERS:
        raise SceneError(f"{len(centers)} boxes are given; at most {MAX_CENTERS} are accepted: thin them out first")
    lows, highs, block = merged_boxes(centers, size)
    if len(lows) > _MAX_BOXES:
        raise SceneError(
            f"{len(lows)} boxes are left after merging; at most {_MAX_BOXES} are accepted: take a coarser grid"
        )
    return Solid(_blocks(lows, highs, block))


def grid_solid(low: Indices, high: Indices, cell: float) -> tuple[Solid, Array]:
    """Solid of boxes of a grid that are one part, and the middles of their cells (n, 3) [m], box by box.

    Args:
        low, high: first cells (B, 3), and those after the last along each axis.
        cell: edge of a cell [m].
    """
    native = kernel()
    if native is None:
        (part,) = _blocks(cell * low.astype(float), cell * high.astype(float), np.zeros(low.shape, dtype=np.int64))
        cells = _cells(low, high, cell)
    else:
        cells, whole = np.empty((native.count_cells(low, high), 3)), np.empty(7)
        middles, edges = np.empty(low.shape), np.empty(low.shape)
        native.grid_boxes(low, high, cell, cells, middles, edges, whole)
        part = Part(None, _IDENTITY, whole[:3], whole[3:6], float(whole[6]), edges, middles)
    cells.flags.writeable = False
    return Solid([part]), cells


def _cells(low: Indices, high: Indices, cell: float) -> Array:
    size = high - low
    count = size.prod(axis=1)
    box = np.repeat(np.arange(len(low)), count)
    number, (_, wide, tall) = np.arange(len(box)) - np.repeat(np.cumsum(count) - count, count), size[box].T
    places = np.stack((number // (wide * tall), number // tall % wide, number % tall), axis=1)
    return np.asarray((low[box] + places + 0.5) * cell, dtype=np.float64)


def merged_boxes(centers: Array, size: Array) -> tuple[Array, Array, _Index]:
    """Corners ``lows``, ``highs`` (m, 3) [m] of boxes with the same union, and the cell (m, 3) each one lies in."""
    turns = np.exp(2j * np.pi * centers / size).mean(axis=0)
    origin = np.angle(turns) / (2.0 * np.pi) * size
    cells = np.rint((centers - origin) / size).astype(np.int64)
    first = cells.min(axis=0)  # blocks start at the lowest voxel
    cells, origin = cells - first, origin + first * size
    slip = np.abs(centers - (cells * size + origin)).max(axis=0)
    if (slip > _SNAP_SHARE * size).any():  # no grid
        keep = _unique(np.rint(centers * 1e9).astype(np.int64))
        middles = centers[keep]
        return (
            middles - 0.5 * size,
            middles + 0.5 * size,
            np.floor((middles - middles.min(axis=0)) / BLOCK_EDGE).astype(np.int64),
        )
    span = np.maximum(1, np.rint(BLOCK_EDGE / size)).astype(np.int64)
    low, high = merge_cells(cells[_unique(cells)], span)
    grow = np.where(slip > 1e-9, slip, 0.0)
    return (low - 0.5) * size + origin - grow, (high - 0.5) * size + origin + grow, low // span


def merge_cells(cells: _Index, span: _Index) -> tuple[_Index, _Index]:
    """Merge unit ``cells`` (V, 3), without duplicates, into boxes [low, high) (m, 3) that fill the same cells.

    Runs along one axis are joined, then equal runs along the next, then the last; of the six orders the best one
    counts. No box crosses a multiple of ``span`` (3,).
    """
    found: list[tuple[_Index, _Index]] = []
    flat = (cells == cells[:1]).all(axis=0)
    tried: set[tuple[int, ...]] = set()
    for order in permutations(range(3)):
        wide = tuple(axis for axis in order if not flat[axis])
        if wide in tried:  # nothing to join along an axis of one cell: when that is tried makes no difference
            continue
        tried.add(wide)
        low, high = cells, cells + 1
        for done, axis in enumerate(order):
            low, high = _join(low, high, axis, order[:done], span)
        found.append((low, high))
    return min(found, key=lambda boxes: len(boxes[0]))


def _join(low: _Index, high: _Index, axis: int, merged: tuple[int, ...], span: _Index) -> tuple[_Index, _Index]:
    """Join boxes that touch along ``axis`` and agree in the others (``merged`` axes have other lengths than 1)."""
    others = [a for a in range(3) if a != axis]
    keys = [low[:, a] for a in others] + [high[:, a] for a in others if a in merged]
    order = np.lexsort([low[:, axis], *keys])
    low, high = low[order], high[order]
    same = (low[1:, axis] == high[:-1, axis]) & (low[1:, axis] // span[axis] == low[:-1, axis] // span[axis])
    for a in others:
        same &= (low[1:, a] == low[:-1, a]) & (high[1:, a] == high[:-1, a])
    starts = np.flatnonzero(np.concatenate([[True], ~same]))
    ends = np.append(starts[1:], len(low)) - 1
    joined = high[starts].copy()
    joined[:, axis] = high[ends, axis]
    return low[starts], joined


def _unique(keys: _Index) -> _Index:
    """Indices, ascending, of the first of each group of equal rows of ``keys`` (V, 3)."""
    order = np.lexsort([keys[:, 2], keys[:, 1], keys[:, 0]])  # stable: the first of equal rows stays first
    ranked = keys[order]
    fresh = np.concatenate([[True], (ranked[1:] != ranked[:-1]).any(axis=1)])
    return np.sort(order[fresh])


def _blocks(lows: Array, highs: Array, block: _Index) -> list[Part]:
    """One part per block."""
    order = np.lexsort([block[:, 2], block[:, 1], block[:, 0]])
    lows, highs, block = lows[order], highs[order], block[order]
    starts = np.flatnonzero(np.concatenate([[True], (block[1:] != block[:-1]).any(axis=1)]))
    counts = np.diff(np.append(starts, len(lows)))
    low, high = np.minimum.reduceat(lows, starts), np.maximum.reduceat(highs, starts)
    center, half = 0.5 * (low + high), 0.5 * (high - low)
    middles, sizes = 0.5 * (lows + highs), np.round(highs - lows, 12)
    far = np.linalg.norm(np.abs(middles - np.repeat(center, counts, axis=0)) + 0.5 * sizes, axis=1)
    radius = np.maximum.reduceat(far, starts).tolist()
    return [
        Part(None, _IDENTITY, center[k], half[k], radius[k], sizes[i:j], middles[i:j])
        for k, (i, j) in enumerate(pairwise([*starts.tolist(), len(lows)]))
    ]


def _boxes(sizes: Array) -> list[coal.Box]:
    """Coal boxes of ``sizes`` (m, 3) [m]; equal ones are one object."""
    return [_box(*size) for size in sizes.tolist()]


@lru_cache(maxsize=4096)
def _box(x: float, y: float, z: float) -> coal.Box:
    """The Coal box of edges [m]; nobody changes it. Those of grids are of few sizes."""
    box = coal.Box(x, y, z)
    box.computeLocalAABB()
    return box
