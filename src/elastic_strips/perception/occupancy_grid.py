"""Occupancy grid: things at rest, as log-odds of cells of the floor, and as obstacles tile by tile."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.errors import SceneError
from elastic_strips.scene import UNSEEN_LAYER, Obstacle, Voxels
from elastic_strips.scene.obstacle import STOOD_LAYER

from .params import SceneEstimatorParams
from .readings import RangeRing, ScanRays, pose_matrix

_Tile = tuple[int, int]
_Index = NDArray[np.int64]
_AROUND = np.array([[-1, -1, -1, 0, 0, 1, 1, 1], [-1, 0, 1, -1, 1, -1, 0, 1]])
_MAX_CELLS = 60_000_000


class OccupancyGrid:
    """Workspace: the evidence of scans about cells of the floor, and obstacles made of it.

    The grid grows with the seen area. Rays free the cells that they pass, up to `SceneEstimatorParams.carve_margin`
    before their ends; where they end, every cell that the padded point touches is hit. A scan counts once per cell,
    and where it both hits and frees a cell, it hits it. A cell that is hit is an obstacle at once, however often it was
    free before; it takes some scans to be free again. What stands where something has moved may go again: where that
    was not seen for a while, it is among what was not seen.

    The grids of the base methods (`workshop.baselines.certainty_grid`) stay apart: they are windows that move with the
    base and forget what leaves them, and follow the rules of their papers, by which every reading counts.

    Args:
        params: parameters of the map.
        name: name of the layer, with which its obstacles' names begin.

    Attributes:
        log_odds: (X, Y) log-odds of being occupied.
        filled: (X, Y) whether a cell is an obstacle: on above ``occupied``, off below −``floor`` / 2.
        seen: (X, Y) whether anything is known.
        walked: (X, Y) whether something has moved there, over what was known to be free.
        corner: indices of the first cell, multiples of the tile; cell (i, j) begins at (corner + (i, j)) · cell [m].
    """

    def __init__(self, params: SceneEstimatorParams, name: str = "map") -> None:
        self.params: SceneEstimatorParams = params
        self.name: str = name
        self.log_odds: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)
        self.seen: Mask = np.zeros((0, 0), dtype=bool)
        self.corner: NDArray[np.int64] = np.zeros(2, dtype=np.int64)
        self.filled: Mask = np.zeros((0, 0), dtype=bool)
        self.walked: Mask = np.zeros((0, 0), dtype=bool)
        self._walked_within: tuple[_Index, _Index] | None = None  # first cell of these and the one after the last
        self._hit_at: NDArray[np.float64] = np.zeros((0, 0))  # time of the last hit [s]
        self._doubted = np.zeros((0, 0), dtype=bool)  # filled cells of which it is in doubt whether they still are
        self._shown = np.zeros((0, 0), dtype=bool)  # cells that the obstacles are made of
        self._blocked = np.zeros((0, 0), dtype=bool)  # unseen cells that are obstacles
        self._center: Array | None = None  # of the disc that they lie in
        layers = name, UNSEEN_LAYER, STOOD_LAYER
        self._stale: dict[str, dict[_Tile, float]] = {layer: {} for layer in layers}  # tile → when it is due
        self._made: dict[str, dict[_Tile, Obstacle]] = {layer: {} for layer in layers}
        self._time = -math.inf

    def add_scan(self, rays: ScanRays, ignored: Mask | None = None) -> None:
        """Take a scan in.

        Args:
            rays: rays of the scan; rays about which nothing is known change nothing.
            ignored: (R,) rays whose ends are not of the static world; they free what they pass.
        """
        p = self.params
        r, self._time = rays.ranges, max(self._time, rays.time)
        reach = np.where(np.isfinite(r), r - p.carve_margin, np.where(np.isposinf(r), rays.range_max, 0.0))
        hit = np.isfinite(r) if ignored is None else np.isfinite(r) & ~ignored
        ends = rays.origin + r[hit, None] * rays.direction[hit]
        self._integrate(rays.origin, rays.direction, np.minimum(reach, p.carve_range), rays.range_min, ends)

    def add_ring(self, ring: RangeRing, base_pose: ArrayLike, ignored: Mask | None = None) -> None:
        """Take a round of cone sensors in: something is somewhere on an arc, and nothing nearer is in the cone.

        Ranges beyond ``sonar_range`` free their cones up to there and hit nothing. A sonar that hears nothing frees
        nothing, because smooth walls send its sound elsewhere.

        Args:
            ring: the round.
            base_pose: (x [m], y [m], yaw [rad]) of the base.
            ignored: (S,) sensors that see something that is not of the static world.
        """
        p = self.params
        self._time = max(self._time, ring.time)
        T = pose_matrix(base_pose) @ ring.T_base_sensor
        count = 2 * math.ceil(ring.half_angle * p.sonar_range / p.cell) + 1
        spread = np.linspace(-ring.half_angle, ring.half_angle, count)
        for s, r in enumerate(ring.ranges.tolist()):
            if math.isnan(r) or (math.isinf(r) and ring.kind == "sonar"):
                continue
            angle = math.atan2(T[s, 1, 0], T[s, 0, 0]) + spread
            direction, origin = np.column_stack((np.cos(angle), np.sin(angle))), T[s, :2, 3]
            hit = r <= p.sonar_range and (ignored is None or not ignored[s])
            ends = origin + r * direction if hit else np.zeros((0, 2))
            free = min(r - p.carve_margin if math.isfinite(r) else ring.range_max, p.sonar_range, p.carve_range)
            reach, aside = np.full(count, free), p.padding * np.array([-T[s, 1, 0], T[s, 0, 0]])
            for shift in (-aside, aside):  # as wide as what a hit marks, else its edges would stay for ever
                self._integrate(origin + shift, direction, reach, ring.range_min, np.zeros((0, 2)))
            self._integrate(origin, direction, reach, ring.range_min, ends)

    def forget(self, points: Array) -> None:
        """Free the cells about points (n, 2) [m]: the thing that was there has moved on."""
        if len(points):
            i, j = self._touched(points)
            self._change(i, j, np.full(len(i), -self.params.floor), at_once=True)

    def walk(self, places: Array, radii: Array) -> None:
        """Something moves at places (n, 2) [m], as far about them as ``radii`` (n,) [m]: what stands there later may go
        again. What stands there already does not move."""
        for place, radius in zip(places, radii.tolist(), strict=True):
            i, j = self._disc(place, radius)
            if not len(i):  # it is smaller than a cell
                continue
            self.walked[i, j] |= self.seen[i, j] & ~self.filled[i, j]
            first, last = (np.array([cut(i), cut(j)]) + self.corner for cut in (np.min, np.max))
            low, high = self._walked_within or (first, last + 1)
            self._walked_within = np.minimum(low, first), np.maximum(high, last + 1)

    def clear_footprint(self, x: float, y: float) -> None:
        """Free the cells under the base at (x, y) [m]; unseen cells about it count from now on."""
        p = self.params
        if p.robot_radius > 0.0:
            i, j = self._disc(np.array([x, y]), p.robot_radius)
            fresh = ~self.seen[i, j]
            self._see(i[fresh], j[fresh])
        if p.body_radius > 0.0:
            i, j = self._disc(np.array([x, y]), p.body_radius + math.sqrt(0.5) * p.cell)
            full = self.filled[i, j]
            if full.any():
                self._change(i[full], j[full], np.full(int(full.sum()), -p.floor), at_once=True)
        if p.unseen == "blocked" and (
            self._center is None or math.hypot(x - self._center[0], y - self._center[1]) > 0.25 * p.tile
        ):
            self._center = np.array([x, y])
            i, j = self._disc(self._center, p.unseen_radius)
            blocked = np.zeros(self.seen.shape, dtype=bool)
            blocked[i, j] = ~self.seen[i, j]
            i, j = np.nonzero(blocked != self._blocked)
            self._mark(UNSEEN_LAYER, i, j, -math.inf)
            self._blocked = blocked

    def occupied(self, points: Array) -> Mask:
        """Whether the points (n, 2) [m] lie in filled cells."""
        return self._look(points, self.filled)

    def known(self, points: Array) -> Mask:
        """Whether the points (n, 2) [m] lie in cells that have been seen."""
        return self._look(points, self.seen)

    def free_near(self, x: float, y: float, radius: float) -> Array:
        """Middles (n, 2) [m] of the cells within a distance of a point that have been seen and are no obstacles."""
        i, j = self._disc(np.array([x, y]), radius)
        free = self.seen[i, j] & ~self.filled[i, j]
        return np.asarray(
            (np.column_stack((i[free], j[free])) + self.corner + 0.5) * self.params.cell, dtype=np.float64
        )

    def obstacles(self) -> tuple[Obstacle, ...]:
        """One `Voxels` for each tile with occupied cells, ``map-3-5``, for each with blocked ones, ``unseen-3-5``, and
        for each with cells of which it is in doubt whether they are still occupied, ``unseen-stood-3-5``.

        An obstacle stays the same object as long as no cell of its tile changes; a cell that becomes free, or
        occupied next to it, changes it with a delay (``settle_delay``), so that not
        every scan makes new obstacles.
        """
        self._doubt_walked()
        for kind, stale in self._stale.items():
            due = sorted(tile for tile, time in stale.items() if time <= self._time)
            self._rebuild(kind, due)
            for tile in due:
                del stale[tile]
        return tuple(o for made in self._made.values() for _, o in sorted(made.items()))

    def _doubt_walked(self) -> None:
        """Find out which cells are in doubt: filled ones where something has moved, that were not hit for a while."""
        if self._walked_within is None:
            return
        first, end = (cell - self.corner for cell in self._walked_within)
        window = slice(first[0], end[0]), slice(first[1], end[1])
        i, j = np.nonzero(self.walked[window] & (self.filled[window] | self._doubted[window]))
        i, j = i + first[0], j + first[1]
        doubted = self.filled[i, j] & (self._time - self._hit_at[i, j] > self.params.stood_time)
        other = doubted != self._doubted[i, j]
        self._doubted[i[other], j[other]] = doubted[other]
        for kind in (self.name, STOOD_LAYER):
            self._mark(kind, i[other], j[other], -math.inf)

    def _rebuild(self, kind: str, tiles: Iterable[_Tile]) -> None:
        p, n, made = self.params, self.params.tile_cells, self._made[kind]
        size = (p.cell, p.cell, p.height)
        for tile in tiles:
            first = np.array(tile) * n - self.corner
            cells = slice(first[0], first[0] + n), slice(first[1], first[1] + n)
            if kind == self.name:
                self._shown[cells] = self.filled[cells]
            if kind == UNSEEN_LAYER:
                at = np.argwhere(self._blocked[cells])
            else:
                at = np.argwhere(self.filled[cells] & (self._doubted[cells] == (kind == STOOD_LAYER)))
            if not len(at):
                made.pop(tile, None)
                continue
            centers = np.column_stack(((at + 0.5) * p.cell, np.zeros(len(at))))
            origin = (tile[0] * p.tile, tile[1] * p.tile, 0.5 * p.height)
            made[tile] = Voxels(centers, size, at=origin, name=f"{kind}-{tile[0]}-{tile[1]}")

    def _integrate(self, origin: Array, direction: Array, reach: Array, start: float, ends: Array) -> None:
        p = self.params
        far = origin + np.maximum(reach, 0.0)[:, None] * direction
        self._cover(np.concatenate((far, ends - p.cell, ends + p.cell, origin[None])))
        hit_i, hit_j = self._touched(ends)
        if len(hit_i):
            hits = np.unique(hit_i * self.seen.shape[1] + hit_j)
            hit_i, hit_j = np.divmod(hits, self.seen.shape[1])
            self._change(hit_i, hit_j, np.minimum(np.maximum(self.log_odds[hit_i, hit_j], 0.0) + p.hit, p.top))
            self._hit_at[hit_i, hit_j] = self._time
        if not len(direction) or not reach.max() > 0.0:
            return
        limit = np.array(self.seen.shape) + self.corner
        low = np.maximum(np.floor(np.minimum(far.min(axis=0), origin) / p.cell).astype(np.int64) - 1, self.corner)
        high = np.minimum(np.floor(np.maximum(far.max(axis=0), origin) / p.cell).astype(np.int64) + 2, limit)
        rows, width = (high - low).tolist()
        passed = np.zeros((rows, width), dtype=bool)  # a window of the grid
        # one sample a cell along every ray, in cells: all rays one after the other
        begin = math.ceil(start / p.cell - 0.5)
        count = np.maximum(np.floor(reach / p.cell + 0.5).astype(np.int64) - begin, 0)
        along = np.arange(int(count.sum()), dtype=np.float32)
        along -= np.repeat((np.cumsum(count) - count).astype(np.float32) - np.float32(begin + 0.5), count)
        local, slope = (origin / p.cell - low).astype(np.float32), direction.astype(np.float32)
        i = (local[0] + np.repeat(slope[:, 0], count) * along).astype(np.int32)
        j = (local[1] + np.repeat(slope[:, 1], count) * along).astype(np.int32)
        passed.ravel()[i * width + j] = True
        shift = self.corner - low
        inside = (hit_i + shift[0] >= 0) & (hit_j + shift[1] >= 0)
        inside &= (hit_i + shift[0] < rows) & (hit_j + shift[1] < width)
        passed[hit_i[inside] + shift[0], hit_j[inside] + shift[1]] = False
        self._free(passed, low - self.corner)

    def _free(self, passed: Mask, first: _Index) -> None:
        """Rays have passed these cells of the window that begins at cell ``first``."""
        p = self.params
        window = tuple(slice(a, a + n) for a, n in zip(first.tolist(), passed.shape, strict=True))
        values, filled = self.log_odds[window], self.filled[window]
        values[passed] = np.maximum(values[passed] - p.miss, -p.floor)
        if p.unseen == "blocked":
            i, j = np.nonzero(passed & ~self.seen[window])
            self._see(i + first[0], j + first[1])
        else:
            self.seen[window] |= passed
        i, j = np.nonzero(passed & filled & (values < -0.5 * p.floor))
        filled[i, j] = False
        self._mark(self.name, i + first[0], j + first[1], self._time + p.settle_delay)

    def _change(self, i: _Index, j: _Index, new: Array, *, at_once: bool = False) -> None:
        """These cells have new log-odds."""
        p = self.params
        self.log_odds[i, j] = new
        fresh = ~self.seen[i, j]
        self._see(i[fresh], j[fresh])
        was = self.filled[i, j]
        now = np.where(was, new >= -0.5 * p.floor, new > p.occupied)
        self.filled[i, j] = now
        on, off = now & ~was, was & ~now
        later = -math.inf if at_once else self._time + p.settle_delay
        self._mark(self.name, i[off], j[off], later)
        i, j = i[on], j[on]
        if not len(i):
            return
        rows, columns = self._shown.shape
        near_i = np.minimum(np.maximum(i[:, None] + _AROUND[0], 0), rows - 1)
        near_j = np.minimum(np.maximum(j[:, None] + _AROUND[1], 0), columns - 1)
        beside = self._shown[near_i, near_j].any(axis=1)
        self._mark(self.name, i[beside], j[beside], later)
        self._mark(self.name, i[~beside], j[~beside], -math.inf)

    def _see(self, i: _Index, j: _Index) -> None:
        """These cells have been seen for the first time."""
        self.seen[i, j] = True
        was = self._blocked[i, j]
        self._blocked[i[was], j[was]] = False
        self._mark(UNSEEN_LAYER, i[was], j[was], self._time + self.params.settle_delay)

    def _mark(self, kind: str, i: _Index, j: _Index, due: float) -> None:
        """The tiles of these cells have to be made anew, at the time ``due`` [s] or, if that is earlier, as it was."""
        if len(i):
            n = self.params.tile_cells
            tiles = set(zip(((i + self.corner[0]) // n).tolist(), ((j + self.corner[1]) // n).tolist(), strict=True))
            stale = self._stale[kind]
            for x, y in tiles:
                stale[x, y] = min(due, stale.get((x, y), math.inf))

    def _touched(self, points: Array) -> tuple[_Index, _Index]:
        """Cells that the squares of half edge ``padding`` about points (n, 2) touch; the grid holds them."""
        p = self.params
        if not len(points):
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        pads = p.padding * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 0.0]])
        spots = (points[:, None] + pads).reshape(-1, 2)
        self._cover(spots)
        cells = np.floor(spots / p.cell).astype(np.int64) - self.corner
        return cells[:, 0], cells[:, 1]

    def _disc(self, center: Array, radius: float) -> tuple[_Index, _Index]:
        """Cells whose middles lie within ``radius`` [m] of a point; the grid holds them."""
        self._cover(np.stack((center - radius, center + radius)))
        cell = self.params.cell
        low = np.floor((center - radius) / cell).astype(np.int64)
        high = np.ceil((center + radius) / cell).astype(np.int64)
        x = (np.arange(low[0], high[0]) + 0.5) * cell - center[0]
        y = (np.arange(low[1], high[1]) + 0.5) * cell - center[1]
        i, j = np.nonzero(x[:, None] ** 2 + y[None] ** 2 <= radius * radius)
        return i + low[0] - self.corner[0], j + low[1] - self.corner[1]

    def _look(self, points: Array, layer: Mask) -> Mask:
        cells = np.floor(points / self.params.cell).astype(np.int64) - self.corner
        inside = ((cells >= 0) & (cells < self.seen.shape)).all(axis=1)
        result = np.zeros(len(points), dtype=bool)
        result[inside] = layer[cells[inside, 0], cells[inside, 1]]
        return result

    def _cover(self, points: Array) -> None:
        """Grow the grid, by whole tiles, until it holds the points (n, 2) [m]."""
        p, n = self.params, self.params.tile_cells
        low = np.floor(points.min(axis=0) / p.tile - 1e-6).astype(np.int64) * n
        high = (np.floor(points.max(axis=0) / p.tile + 1e-6).astype(np.int64) + 1) * n
        size = np.array(self.seen.shape)
        if size.all():
            if (low >= self.corner).all() and (high <= self.corner + size).all():
                return
            low, high = np.minimum(low, self.corner), np.maximum(high, self.corner + size)
        shape = high - low
        if shape.prod() > _MAX_CELLS:
            raise SceneError(f"the map would have {shape[0]} × {shape[1]} cells; at most {_MAX_CELLS} are kept")
        at = tuple(slice(a, a + s) for a, s in zip((self.corner - low).tolist(), size.tolist(), strict=True))
        for name in ("log_odds", "filled", "seen", "walked", "_hit_at", "_doubted", "_shown", "_blocked"):
            old = getattr(self, name)
            new = np.zeros(shape, dtype=old.dtype)
            if size.all():
                new[at] = old
            setattr(self, name, new)
        self.corner = low
