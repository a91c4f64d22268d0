"""The readable twin of the kernel's volume map: the same voxels, freed and hit by the same rules, in NumPy."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Image, Indices, Mask

BLOCK = 8
"""Voxels along the edge of a block."""
UNSEEN = -128
"""What is known of a voxel of which nothing is known."""
PASSED = -127
"""… and of one that was seen through by pixels that are too far apart to see what is thin: as little, but that nothing
larger was there."""

_FARTHEST = 1e4  # [m] that an image may see
_HALF_DIAGONAL = 0.5 * math.sqrt(3.0)
_PER_CHUNK = 200_000  # voxels that are looked at together


class VolumeTwin:
    """Workspace: the window of voxels; see `elastic_strips.native` for the kernel's.

    Args:
        blocks: how many blocks of `BLOCK` voxels it has along each axis.
        corner: the block of space that it begins with.
        cell: edge of a voxel [m].
        miss, floor, top: what a look through takes away, and the bounds of what is known.
        filled, emptied: a voxel above it becomes an obstacle, and one below it is none any more.
    """

    def __init__(
        self, blocks: Indices, corner: Indices, cell: float, miss: int, floor: int, top: int, filled: int, emptied: int
    ) -> None:
        self._shape, self._corner, self._cell = blocks * BLOCK, corner * BLOCK, cell
        self._miss, self._floor, self._top, self._filled, self._emptied = miss, floor, top, filled, emptied
        self._known = np.full(self._shape, UNSEEN, dtype=np.int8)
        self._full = np.zeros(self._shape, dtype=bool)
        self._sure = np.zeros(self._shape, dtype=bool)  # not in doubt
        self._hit = np.zeros(self._shape, dtype=bool)
        self._changed: tuple[set[tuple[int, ...]], set[tuple[int, ...]]] = (set(), set())  # blocks: full, in doubt

    def roll(self, corner: Indices) -> None:
        """Begin at another block of space: what leaves the window is forgotten."""
        by = corner * BLOCK - self._corner
        if not by.any():
            return
        moved = list(zip(by.tolist(), self._shape.tolist(), strict=True))
        kept = tuple(slice(max(b, 0), max(n + min(b, 0), 0)) for b, n in moved)
        goes = tuple(slice(max(-b, 0), max(n - max(b, 0), 0)) for b, n in moved)
        leaves = np.ones(self._shape, dtype=bool)
        leaves[kept] = False
        self._note(False, np.argwhere(leaves & self._full) + self._corner)
        for name, empty in (("_known", UNSEEN), ("_full", False), ("_sure", False), ("_hit", False)):
            before = getattr(self, name)
            after = np.full(self._shape, empty, dtype=before.dtype)
            after[goes] = before[kept]
            setattr(self, name, after)
        self._corner = corner * BLOCK

    def hit(self, points: Array, weight: npt.NDArray[np.int8], before: npt.NDArray[np.int8]) -> None:
        """Rays ended at points (n, 3), each with a weight (n); ``before`` (n) becomes what was known there."""
        self._hit[:] = False
        self.look(points, before)
        at, inside = self._cells(points)
        mine = inside & (weight > 0)
        at = at[mine]
        was = np.where(before[mine] <= PASSED, 0, np.maximum(before[mine], 0)).astype(int)
        new = np.full(self._shape, UNSEEN, dtype=int)
        np.maximum.at(new, tuple(at.T), np.minimum(was + weight[mine], self._top))
        cells = np.unique(at, axis=0)
        self._hit[tuple(cells.T)] = True
        self._put(cells, new[tuple(cells.T)])

    def carve(
        self,
        clear: Image,
        camera: bool,
        closed: bool,
        scale: Array,
        middle: Array,
        rotation: Array,
        origin: Array,
        nearest: float,
        sure: float,
        exact: float,
    ) -> None:
        """Free the voxels of which every pixel over the ball about them sees further; but not what was hit last.

        From ``sure`` [m] on pixels are too far apart to see all: obstacles there only become what was never seen, and
        what was never seen has been passed. Of
        what was never seen, what is seen beyond the middle of is neither. What was hit and is looked at from up to
        ``exact`` [m] with nothing before it, and is not hit, is less and less of an obstacle, and then neither.
        """
        sight = _Sight(clear, camera, closed, scale, middle)
        if not sight.farthest > nearest:
            return
        reach = sight.reach()
        low = np.maximum(np.floor((origin - reach) / (BLOCK * self._cell)).astype(int), self._corner // BLOCK)
        high = np.floor((origin + reach) / (BLOCK * self._cell)).astype(int)
        high = np.minimum(high, (self._corner + self._shape) // BLOCK - 1)
        if (low > high).any():
            return
        blocks = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)
        seen = _HALF_DIAGONAL * BLOCK * self._cell
        cover = sight.cover((((blocks + 0.5) * (BLOCK * self._cell)) - origin) @ rotation, seen)
        least, most = sight.seen(cover)
        near, far, known = cover[2], cover[3], cover[4]
        out = (near > sight.farthest) | (far < nearest) | (known & (most < near))
        every = ~out & known & (near >= nearest) & (least > far) & (far <= sure)
        within = np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        self._pass((blocks[every][:, None] * BLOCK + within).reshape(-1, 3), True)
        some = blocks[~out & ~every]
        for first in range(0, len(some), _PER_CHUNK // BLOCK**3):
            voxels = (some[first : first + _PER_CHUNK // BLOCK**3, None] * BLOCK + within).reshape(-1, 3)
            cover = sight.cover((voxels + 0.5) * self._cell @ rotation - origin @ rotation, _HALF_DIAGONAL * self._cell)
            least, _ = sight.seen(cover)
            passed = cover[4] & (cover[2] >= nearest) & (cover[3] < sight.farthest) & (least > cover[3])
            self._pass(voxels[passed], cover[3][passed] <= sure)
            halfway = cover[4] & (cover[2] >= nearest) & (cover[3] < sight.farthest) & (cover[3] <= sure)
            halfway &= ~passed & (least > 0.5 * (cover[2] + cover[3]))
            self._grant(voxels[halfway] - self._corner)
            open_ = cover[4] & (cover[2] >= nearest) & (cover[3] < sight.farthest) & (cover[3] <= exact)
            self._fade(voxels[open_ & ~passed & (least > cover[2])] - self._corner)

    def look(self, points: Array, known: npt.NDArray[np.int8]) -> None:
        """What is known of the voxels of points (n, 3)."""
        at, inside = self._cells(points)
        known[:] = UNSEEN
        known[inside] = self._known[tuple(at[inside].T)]

    def grant(self, points: Array) -> None:
        """Of the voxels of points (n, 3) those that were never seen are neither from now on."""
        at, inside = self._cells(points)
        self._grant(np.unique(at[inside], axis=0))

    def forget(self, points: Array) -> None:
        """Nothing is known any more of the voxels of points (n, 3)."""
        at, inside = self._cells(points)
        at = np.unique(at[inside], axis=0)
        self._put(at, np.full(len(at), UNSEEN))

    def changed(self, doubtful: bool) -> Indices:
        """Blocks (n, 3), one after the other, whose obstacles have changed since last asked, or whose voxels in doubt:
        those that were never seen, and those that have been hit and are no obstacle yet."""
        noted = self._changed[doubtful]
        found = sorted(noted)
        noted.clear()
        return np.array(found, dtype=np.intp).reshape(-1)

    def boxes(self, block: Indices, doubtful: bool) -> Indices:
        """Boxes (n, 6), low and high in voxels of space, that a block's obstacles, or its voxels in doubt, consist
        of."""
        return _merged(self._listed(block, doubtful), block * BLOCK)

    def finer_boxes(self, block: Indices, doubtful: bool, fine: VolumeTwin) -> Indices:
        """The same without what a map of voxels half as wide knows to be free; low and high in voxels of that."""
        left = self._listed(block, doubtful).repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)
        at = np.stack(np.meshgrid(*[np.arange(2 * BLOCK)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        known = np.empty(len(at), dtype=np.int8)
        middles = np.asarray((2 * BLOCK * block + at + 0.5) * fine._cell, dtype=np.float64)
        fine.look(middles, known)
        return _merged(left & ~((known > PASSED) & (known <= fine._emptied)).reshape(left.shape), 2 * BLOCK * block)

    def _listed(self, block: Indices, doubtful: bool) -> Mask:
        """Which voxels of a block are obstacles, or in doubt."""
        first = block * BLOCK - self._corner
        if not ((first >= 0) & (first < self._shape)).all():
            return np.zeros((BLOCK,) * 3, dtype=bool)
        here = tuple(slice(a, a + BLOCK) for a in first.tolist())
        return ~self._sure[here] if doubtful else self._full[here].copy()

    def count(self, unseen: bool) -> int:
        """How many voxels are obstacles, or were never seen."""
        return int((self._known <= PASSED).sum() if unseen else self._full.sum())

    def _cells(self, points: Array) -> tuple[Indices, Mask]:
        at = np.floor(points / self._cell).astype(np.intp) - self._corner
        inside: Mask = np.all((at >= 0) & (at < self._shape), axis=1)
        return at, inside

    def _pass(self, voxels: Indices, sure: Mask | bool) -> None:
        at, surely = voxels - self._corner, np.broadcast_to(sure, len(voxels))
        now = self._known[tuple(at.T)].astype(int)
        changes = ~self._hit[tuple(at.T)]
        at, now, surely = at[changes], now[changes], surely[changes]
        then = np.maximum(np.where(now <= PASSED, 0, now) - self._miss, self._floor)
        then = np.where(~surely & (now <= PASSED), PASSED, then)
        self._put(at, np.where(~surely & (now >= self._emptied) & (then < self._emptied), UNSEEN, then))

    def _fade(self, at: Indices) -> None:
        """Have voxels (n, 3) of the window that were hit be less of an obstacle where they are not hit now."""
        now = self._known[tuple(at.T)].astype(int)
        hit = (now > 0) & ~self._hit[tuple(at.T)]
        at, now = at[hit], now[hit]
        self._put(at, np.maximum(now - self._miss, 0), neither=now <= self._miss)

    def _grant(self, at: Indices) -> None:
        """Have voxels (n, 3) of the window that were never seen be neither."""
        new = at[self._known[tuple(at.T)] <= PASSED]
        self._put(new, np.zeros(len(new), dtype=int))

    def _put(self, at: Indices, known: npt.NDArray[np.int_], neither: Mask | bool = False) -> None:
        """Have it known of voxels (n, 3) of the window, none of them twice; no obstacles where ``neither``."""
        index = tuple(at.T)
        full = self._full[index]
        now = (known > PASSED) & np.where(full, known >= self._emptied, known > self._filled) & ~np.asarray(neither)
        sure = now | ((known > PASSED) & (known <= 0))
        self._note(False, at[full != now] + self._corner)
        self._note(True, at[sure != self._sure[index]] + self._corner)
        self._known[index], self._full[index], self._sure[index] = known, now, sure

    def _note(self, doubtful: bool, voxels: Indices) -> None:
        self._changed[doubtful].update(map(tuple, np.unique(voxels // BLOCK, axis=0).tolist()))


def _merged(left: Mask, first: Indices) -> Indices:
    """Boxes (n, 6), one after the other, of the voxels ``left`` (n, n, n) of a cube, which begins at the voxel
    ``first`` (3,)."""
    edge, found = len(left), []
    while left.any():
        x, y, z = np.argwhere(left)[0].tolist()
        top, wide, deep = z + 1, y + 1, x + 1
        while top < edge and left[x, y, top]:
            top += 1
        while wide < edge and left[x, wide, z:top].all():
            wide += 1
        while deep < edge and left[deep, y:wide, z:top].all():
            deep += 1
        left[x:deep, y:wide, z:top] = False
        found.append(np.concatenate((first + np.array((x, y, z)), first + np.array((deep, wide, top)))))
    return np.array(found, dtype=np.intp).reshape(-1)


class _Sight:
    """What the pixels of an image surely see, and the least and most of rectangles of them: of halves of halves."""

    def __init__(self, clear: Image, camera: bool, closed: bool, scale: Array, middle: Array) -> None:
        self._camera, self._closed, self._scale, self._middle = camera, closed, scale, middle
        known = np.where((clear > 0.0) & (clear < _FARTHEST), clear, np.float32(0.0))
        self._shape = known.shape
        self._levels = [(known, known)]
        while max(known.shape) > 1:
            least, most = self._levels[-1]
            self._levels.append((_halved(least, np.minimum), _halved(most, np.maximum)))
            known = self._levels[-1][0]
        self.farthest = float(self._levels[-1][1][0, 0])

    def reach(self) -> float:
        """How far the furthest pixel can see [m]."""
        if not self._camera:
            return self.farthest
        size = np.array(self._shape[::-1], dtype=float)
        wide = np.maximum(self._middle + 0.5, size - 0.5 - self._middle) / self._scale
        return self.farthest * math.sqrt(1.0 + float(wide @ wide))

    def cover(self, c: Array, radius: float) -> tuple[Array, Array, Array, Array, Mask]:
        """Columns (n, 2) and rows (n, 2) from first to last that balls about c (n, 3) cover, their nearest and furthest
        [m], and whether they are far enough to say."""
        with np.errstate(invalid="ignore", divide="ignore"):
            if self._camera:
                near, far, known = c[:, 2] - radius, c[:, 2] + radius, c[:, 2] > radius
                below = c[:, 2] ** 2 - radius * radius
                spans = []
                for k in range(2):
                    root = radius * np.sqrt(c[:, k] ** 2 + below)
                    ends = (c[:, k] * c[:, 2] - root) / below, (c[:, k] * c[:, 2] + root) / below
                    spans.append(self._middle[k] + self._scale[k] * np.stack(ends, axis=1))
                return spans[0], spans[1], near, far, known
            flat = np.hypot(c[:, 0], c[:, 1])
            distance = np.hypot(flat, c[:, 2])
            halves = np.arcsin(radius / flat), np.arcsin(radius / distance)
            turns = np.arctan2(c[:, 1], c[:, 0]), np.arctan2(c[:, 2], flat)
            spans = []
            for k in range(2):
                at, half = self._middle[k] + self._scale[k] * turns[k], abs(self._scale[k]) * halves[k]
                spans.append(np.stack((at - half, at + half), axis=1))
            return spans[0], spans[1], distance - radius, distance + radius, flat > radius

    def seen(self, cover: tuple[Array, Array, Array, Array, Mask]) -> tuple[Array, Array]:
        """Least and most (n) that the pixels over balls see; pixels beside the image see nothing."""
        rows, columns = self._shape
        known = cover[4]
        least, most = np.zeros(len(known)), np.zeros(len(known))
        at = np.flatnonzero(known)
        c, r = (np.floor(span[at] + 0.5) for span in cover[:2])
        whole = (r[:, 0] >= 0) & (r[:, 1] <= rows - 1)
        r[:, 0], r[:, 1] = np.maximum(r[:, 0], 0), np.minimum(r[:, 1], rows - 1)
        some = r[:, 0] <= r[:, 1]
        if self._closed:
            around = c[:, 1] - c[:, 0] >= columns - 1
            c[around] = (0, columns - 1)
            c -= columns * np.floor(c[:, :1] / columns)
            first, second = c.copy(), np.zeros_like(c)
            first[:, 1] = np.minimum(c[:, 1], columns - 1)
            second[:, 1] = c[:, 1] - columns
            further = c[:, 1] > columns - 1
        else:
            whole &= (c[:, 0] >= 0) & (c[:, 1] <= columns - 1)
            c[:, 0], c[:, 1] = np.maximum(c[:, 0], 0), np.minimum(c[:, 1], columns - 1)
            some &= c[:, 0] <= c[:, 1]
            first, second, further = c, c, np.zeros(len(c), dtype=bool)
        low, high = self._rectangle(r[some], first[some])
        more = further & some
        low2, high2 = self._rectangle(r[more], second[more])
        both = np.flatnonzero(further[some])
        low[both], high[both] = np.minimum(low[both], low2), np.maximum(high[both], high2)
        most[at[some]] = high
        least[at[some]] = np.where(whole[some], low, 0.0)
        return least, most

    def _rectangle(self, rows: Array, columns: Array) -> tuple[Array, Array]:
        r, c = rows.astype(int), columns.astype(int)
        least, most = np.empty(len(r)), np.empty(len(r))
        left = np.ones(len(r), dtype=bool)
        for k, (low, high) in enumerate(self._levels):
            a, b, d, e = r[:, 0] >> k, r[:, 1] >> k, c[:, 0] >> k, c[:, 1] >> k
            now = left & (b - a <= 1) & (e - d <= 1)
            corners = [(a[now], d[now]), (a[now], e[now]), (b[now], d[now]), (b[now], e[now])]
            least[now] = np.min([low[at] for at in corners], axis=0)
            most[now] = np.max([high[at] for at in corners], axis=0)
            left &= ~now
        return least, most


def _halved(image: Image, of: np.ufunc) -> Image:
    rows, columns = image.shape
    even = np.pad(image, ((0, rows % 2), (0, columns % 2)), mode="edge")
    return of(of(even[::2, ::2], even[::2, 1::2]), of(even[1::2, ::2], even[1::2, 1::2]))
