"""Certainty grids: probability of occupancy of every cell, from readings.

Sources:
    H. P. Moravec, A. Elfes (1985), High resolution maps from wide angle sonar, IEEE ICRA: the sonar's cone.
    H. P. Moravec (1988), Sensor fusion in certainty grids for mobile robots, AI Magazine 9(2); A. Elfes (1989), Using
    occupancy grids for mobile robot perception and navigation, IEEE Computer 22(6): Bayes' rule, cell by cell.
    J. Borenstein, Y. Koren (1991), Histogramic in-motion mapping for mobile robot obstacle avoidance, IEEE Trans.
    Robotics and Automation 7(4): integer counts on the sonar's axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.perception import LaserScan, RangeRing
from elastic_strips.validation import Bound, Checked, Positive

Flags = npt.NDArray[np.bool_]
_Whole = npt.NDArray[np.int_]
_CONE, _DEPTH = 0.05, 0.15  # [rad, m] how far a scanned point may be off a sonar's cone and range to explain them


@dataclass(frozen=True, slots=True, eq=False)
class PlanarRays:
    """Rays of one reading, seen from above, in the world frame; without those that gave no answer.

    Attributes:
        start: (R, 2) where they begin [m].
        bearing: (R,) their directions [rad].
        length: (R,) how far they are free [m].
        hit: (R,) whether there is something at their end.
    """

    start: Array
    bearing: Array
    length: Array
    hit: Flags

    @property
    def ends(self) -> Array:
        """(R, 2) where they end [m]."""
        return self.start + self.length[:, None] * np.stack((np.cos(self.bearing), np.sin(self.bearing)), axis=1)


PlanarReading = LaserScan | RangeRing
"""What methods of the plane understand: no images."""


def planar_rays(reading: PlanarReading, pose: Array) -> PlanarRays:
    """The rays of a reading, taken at a pose (x, y, yaw) of the base; heights are left out."""
    if isinstance(reading, LaserScan):
        a, T = reading.angles, reading.T_base_sensor
        along = np.stack((np.cos(a), np.sin(a)), axis=1) @ T[:2, :2].T
        start = np.broadcast_to(T[:2, 3], along.shape)
    else:
        along, start = reading.T_base_sensor[:, :2, 0], reading.T_base_sensor[:, :2, 3]
    known = ~np.isnan(reading.ranges)
    along, start, ranges = along[known], start[known], reading.ranges[known]
    x, y, yaw = (float(p) for p in pose[:3])
    cos, sin = math.cos(yaw), math.sin(yaw)
    hit = np.isfinite(ranges)
    length = np.where(hit, ranges, reading.range_max) * np.hypot(along[:, 0], along[:, 1])
    return PlanarRays(
        np.stack((x + cos * start[:, 0] - sin * start[:, 1], y + sin * start[:, 0] + cos * start[:, 1]), axis=1),
        np.arctan2(along[:, 1], along[:, 0]) + yaw,
        length,
        hit,
    )


class SensedPoints:
    """Workspace: last points of each sensor, in the world frame. A reading without any answer changes nothing.

    A sonar does not measure the direction within its cone. A scan's point in the cone at about the sonar's range
    explains the echo; else the obstacle is assumed on the axis, as it may be below the scan's plane.
    """

    def __init__(self) -> None:
        self._scans: dict[str, Array] = {}
        self._rings: dict[str, tuple[PlanarRays, float]] = {}
        self._points: Array | None = np.zeros((0, 2))

    def update(self, reading: PlanarReading, pose: Array) -> None:
        """Replace the points of a reading's sensor; ``pose`` is the base's (x, y, yaw) at its time."""
        rays = planar_rays(reading, pose)
        if not len(rays.hit):
            return
        if isinstance(reading, LaserScan):
            self._scans[reading.sensor] = rays.ends[rays.hit]
        else:
            self._rings[reading.sensor] = rays, reading.half_angle
        self._points = None

    @property
    def points(self) -> Array:
        """(P, 2) all of them [m]."""
        if self._points is None:
            scanned = np.concatenate([np.zeros((0, 2)), *self._scans.values()])
            echoes = [rays.ends[rays.hit & ~_explained(rays, half, scanned)] for rays, half in self._rings.values()]
            self._points = np.concatenate([scanned, *echoes])
        return self._points


def _explained(rays: PlanarRays, half_angle: float, points: Array) -> Flags:
    """(R,) whether one of the points (P, 2) is in a ray's cone at about the ray's length."""
    out = np.zeros(len(rays.hit), dtype=bool)
    to = points - rays.start[:, None]
    ray, point = np.nonzero(np.abs(np.hypot(to[..., 0], to[..., 1]) - rays.length[:, None]) <= _DEPTH)
    bearing = np.arctan2(to[ray, point, 1], to[ray, point, 0])
    off = np.mod(bearing - rays.bearing[ray] + np.pi, 2.0 * np.pi) - np.pi
    out[ray[np.abs(off) <= half_angle + _CONE]] = True
    return out


CV_MAX = 15
"""Largest certainty value of a cell."""
_ON, _OFF = 3, 1  # what a reading adds at its end, and takes off before it
_LOG_ODDS_MOST = 6.0  # bound of a cell's log-odds, so that it can change
_LEAST_RANGE = 1e-6
_BelowOne = Annotated[float, Bound(above=0.0, below=1.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class GridParams(Checked):
    """Parameters of a grid.

    Attributes:
        kind: ``"histogram"`` (counts, Borenstein and Koren) or ``"bayes"`` (Moravec, Elfes).
        cell: edge of a cell [m]; 0.1 is Borenstein and Koren's.
        size: number of cells along an edge of the window; ours: it has to hold the active region.
        hit, free: how much a reading at its best says "occupied" or "empty" [−], of ``"bayes"``; ours.
        depth: half of the thickness ε of the shell in which a sonar says that something is [m]; ours.
    """

    kind: Literal["histogram", "bayes"] = "histogram"
    cell: Positive = 0.1
    size: Annotated[int, Bound(low=3)] = 61
    hit: _BelowOne = 0.6
    free: _BelowOne = 0.4
    depth: Positive = 0.1


class CertaintyGrid:
    """Workspace: a square window of cells about the base, aligned with the world: cell k spans [k·cell, (k + 1)·cell).

    Args:
        params: sizes.
    """

    first: npt.NDArray[np.int64]

    def __init__(self, params: GridParams | None = None) -> None:
        self.params: GridParams = GridParams() if params is None else params
        self.values: Array = np.zeros((int(self.params.size), int(self.params.size)))
        self.first = np.zeros(2, dtype=int)  # number of the window's first cell, along x and y
        self._placed = False

    def cells_of(self, points: Array) -> _Whole:
        """(…, 2) numbers, in the world, of the cells that hold points (…, 2) [m]."""
        return np.floor(np.asarray(points) / self.params.cell).astype(int)

    def follow(self, position: Array) -> None:
        """Move the window, by whole cells, so that its middle cell holds the position; other cells are dropped."""
        size = len(self.values)
        first = self.cells_of(position[:2]) - size // 2
        shift = first - self.first
        if self._placed and shift.any():
            moved = np.zeros_like(self.values)
            if (np.abs(shift) < size).all():
                to = tuple(slice(max(-s, 0), size - max(s, 0)) for s in shift)
                source = tuple(slice(max(s, 0), size - max(-s, 0)) for s in shift)
                moved[to] = self.values[source]
            self.values = moved
        self.first, self._placed = first, True

    def update(self, reading: PlanarReading, pose: Array) -> None:
        """Add a reading that was taken at a pose (x, y, yaw) of the base; the window follows the base."""
        self.follow(pose)
        rays = planar_rays(reading, pose)
        if not len(rays.hit):
            return
        if isinstance(reading, LaserScan):
            self._add_scan(rays)
        else:
            self._add_ring(reading, rays)

    def certainty(self) -> Array:
        """(N, N) certainty values from 0 to ``CV_MAX``."""
        raise NotImplementedError

    def active(self, position: Array, cells: int) -> tuple[Array, Array]:
        """Cells of the active region C* that are not empty.

        Args:
            position: (2,) of the base [m].
            cells: edge of the region, in cells; odd, so that the base is in the middle one.

        Returns:
            (K, 2) from the position to the cells' middles [m], (K,) certainty values in (0, ``CV_MAX``].
        """
        low = np.maximum(self.cells_of(position[:2]) - cells // 2 - self.first, 0)
        high = np.maximum(self.cells_of(position[:2]) + cells // 2 + 1 - self.first, 0)
        part = self.certainty()[low[0] : high[0], low[1] : high[1]]
        i, j = np.nonzero(part > 0.0)
        middles = (np.stack((i, j), axis=1) + low + self.first + 0.5) * self.params.cell
        return middles - np.asarray(position[:2]), part[i, j]

    def _add_scan(self, rays: PlanarRays) -> None:
        raise NotImplementedError

    def _add_ring(self, ring: RangeRing, rays: PlanarRays) -> None:
        raise NotImplementedError

    def _from(self, start: Array, block: tuple[slice, slice] = (slice(None), slice(None))) -> tuple[Array, Array]:
        """Distances [m] and bearings [rad] of the middles of a block of cells, all by default, from a point."""
        middles = (self.first[:, None] + np.arange(len(self.values)) + 0.5) * self.params.cell - start[:, None]
        dx, dy = middles[0][block[0], None], middles[1][None, block[1]]
        return np.hypot(dx, dy), np.arctan2(dy, dx)

    def _inside(self, cells: _Whole) -> Flags:
        return np.asarray(((cells >= 0) & (cells < len(self.values))).all(axis=-1))

    def _scanned(self, rays: PlanarRays) -> tuple[Flags, Flags]:
        """(N, N) which cells a scan's rays cross, and in which they end, each once however many rays do."""
        ended = np.zeros(self.values.shape, dtype=bool)
        cells = self.cells_of(rays.ends[rays.hit]) - self.first
        cells = cells[self._inside(cells)]
        ended[cells[:, 0], cells[:, 1]] = True
        distance, bearing = self._from(rays.start[0])
        order = np.argsort(np.mod(rays.bearing - rays.bearing[0], 2.0 * np.pi))
        angle = np.mod(rays.bearing[order] - rays.bearing[0], 2.0 * np.pi)
        at = np.mod(bearing - rays.bearing[0], 2.0 * np.pi)
        right = np.searchsorted(angle, at)
        a, b = (right - 1) % len(angle), right % len(angle)
        gap_a, gap_b = np.mod(at - angle[a], 2.0 * np.pi), np.mod(angle[b] - at, 2.0 * np.pi)
        nearest, gap = np.where(gap_a < gap_b, a, b), np.minimum(gap_a, gap_b)
        # the ray nearest to the cell's middle must meet the cell, and go on beyond it
        half = 0.5 * self.params.cell
        free = (gap * distance <= half) & (distance + math.sqrt(2.0) * half <= rays.length[order][nearest])
        return free & ~ended, ended


class HistogramGrid(CertaintyGrid):
    """Counts from 0 to 15: +3 where a range ends on the sensor's axis, −1 in the cells on the axis before it.

    A range without an echo empties the axis up to the sensor's reach. A laser scan, of which many rays meet the same
    cell, changes a cell once: +3 where any ray ends, else −1 where one goes through.
    """

    values: Array

    def certainty(self) -> Array:
        """(N, N) certainty values from 0 to ``CV_MAX``: the counts."""
        return self.values

    def _add_scan(self, rays: PlanarRays) -> None:
        crossed, ended = self._scanned(rays)
        self.values += _ON * ended.astype(float) - _OFF * crossed
        np.clip(self.values, 0.0, CV_MAX, out=self.values)

    def _add_ring(self, ring: RangeRing, rays: PlanarRays) -> None:
        size, step = len(self.values), 0.25 * self.params.cell
        ends = self.cells_of(rays.ends) - self.first
        reach = np.minimum(rays.length, 1.5 * size * self.params.cell)
        s = np.arange(0.0, float(reach.max()), step)
        along = np.stack((np.cos(rays.bearing), np.sin(rays.bearing)), axis=1)
        cells = self.cells_of(rays.start[:, None] + s[None, :, None] * along[:, None]) - self.first
        crossed = self._inside(cells) & (s < reach[:, None])
        crossed &= ~((cells == ends[:, None]).all(axis=-1) & rays.hit[:, None])
        sensor = np.broadcast_to(np.arange(len(cells))[:, None], crossed.shape)[crossed]
        key = np.unique((sensor * size + cells[crossed][:, 0]) * size + cells[crossed][:, 1]) % (size * size)
        count = np.bincount(key, minlength=size * size).reshape(size, size)
        self.values = np.maximum(self.values - _OFF * count, 0.0)
        ends = ends[rays.hit & self._inside(ends)]
        np.add.at(self.values, (ends[:, 0], ends[:, 1]), _ON)
        np.minimum(self.values, CV_MAX, out=self.values)


class BayesGrid(CertaintyGrid):
    """Log-odds of being occupied, summed over readings (Bayes' rule with independent readings and cells).

    Model of a sonar at range R for a cell at distance δ and angle θ off its axis, with half-angle ω/2:
    empty E = (1 − ((δ − R_min)/(R − ε − R_min))²)(1 − (2θ/ω)²) for δ in [R_min, R − ε];
    occupied O = (1 − ((δ − R)/ε)²)(1 − (2θ/ω)²) for δ in [R − ε, R + ε].
    Then p(occupied | reading) = ½ (1 + hit·O − free·E), and ln(p/(1 − p)) is added to the cell.
    """

    def certainty(self) -> Array:
        """(N, N) certainty values from 0 to ``CV_MAX``: 15 (2p − 1) where p > ½."""
        return CV_MAX * np.maximum(np.tanh(0.5 * self.values), 0.0)

    def _add(self, signed: Array, block: tuple[slice, slice] = (slice(None), slice(None))) -> None:
        """Add readings with 2p − 1 = ``signed``: ln(p/(1 − p)) = 2 artanh(2p − 1)."""
        total = self.values[block] + 2.0 * np.arctanh(signed)
        self.values[block] = np.clip(total, -_LOG_ODDS_MOST, _LOG_ODDS_MOST)

    def _add_scan(self, rays: PlanarRays) -> None:
        crossed, ended = self._scanned(rays)
        self._add(self.params.hit * ended - self.params.free * crossed)

    def _add_ring(self, ring: RangeRing, rays: PlanarRays) -> None:
        for start, bearing, length, hit in zip(rays.start, rays.bearing, rays.length, rays.hit, strict=True):
            block = self._around(ring, start, float(bearing), float(length))
            distance, at = self._from(start, block)
            self._add(self._cone(ring, distance, at - bearing, float(length), bool(hit)), block)

    def _around(self, ring: RangeRing, start: Array, bearing: float, length: float) -> tuple[slice, slice]:
        """The block of cells that holds a sensor's cone."""
        angles = bearing + ring.half_angle * np.linspace(-1.0, 1.0, 9)
        reach = (length + self.params.depth) / math.cos(min(ring.half_angle, 1.0) / 8.0)
        rim = start + reach * np.stack((np.cos(angles), np.sin(angles)), axis=1)
        low = self.cells_of(np.minimum(rim.min(axis=0), start)) - self.first - 1
        high = self.cells_of(np.maximum(rim.max(axis=0), start)) - self.first + 2
        low, high = np.clip(low, 0, None), np.clip(high, 0, None)
        return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))

    def _cone(self, ring: RangeRing, distance: Array, off: Array, length: float, hit: bool) -> Array:
        """(…, …) 2p − 1 of one sensor's cone; a cone narrower than a cell is as wide as the cell."""
        p = self.params
        half = np.maximum(ring.half_angle, 0.5 * p.cell / np.maximum(distance, _LEAST_RANGE))
        off = np.remainder(off + np.pi, 2.0 * np.pi) - np.pi
        across = np.maximum(1.0 - (off / half) ** 2, 0.0)
        near = length - p.depth if hit else length
        depth = max(near - ring.range_min, _LEAST_RANGE)
        inside = (distance >= ring.range_min) & (distance <= near)
        empty = np.where(inside, 1.0 - ((distance - ring.range_min) / depth) ** 2, 0.0)
        shell = np.maximum(1.0 - ((distance - length) / p.depth) ** 2, 0.0) if hit else 0.0
        return across * (p.hit * shell - p.free * np.maximum(empty, 0.0))


_KINDS = {"histogram": HistogramGrid, "bayes": BayesGrid}


def make_grid(params: GridParams | None = None) -> CertaintyGrid:
    """A grid of the kind that the parameters name."""
    params = GridParams() if params is None else params
    return _KINDS[params.kind](params)
