"""Volume map: space about the robot in voxels, from images of depths and ranges; obstacles block by block.

A voxel is free only where *every* pixel over the ball about it ends behind it, by three standard deviations, and where
pixels are no further apart than the thinnest thing that there may be. It is an obstacle where rays have ended: one hit
where ranges are exact to less than a voxel, several where they are not, until it is looked at from where they are and
rays end beside it again and again. What is neither was not seen.

Near the sensors, voxels half as wide are freed by the same rule; they are taken out of obstacles and of what is in
doubt.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.errors import ParameterError
from elastic_strips.native import kernel
from elastic_strips.scene import UNSEEN_LAYER, Obstacle, Voxels
from elastic_strips.validation import Bound, NonNegative, Positive, check_fields
from elastic_strips.work import count_work

from .lost_pixels import StillImages, filled
from .readings import DepthImage, RangeImage
from .volume_twin import BLOCK, PASSED, VolumeTwin

_SIGMAS = 3.0  # standard deviations that count as the largest error
_UNIT = 0.05  # of log-odds, in which the map counts
_MOST_BLOCKS = 1 << 20
_OBSTACLES_A_BLOCK = 60  # of work that is counted, for one that is made anew: 0.3 ms
_FINE_ROOM = 0.6  # [m] from the base to sensors, about which finer voxels are
_EIGHTHS = np.stack(np.meshgrid(*[(-0.25, 0.25)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Middles of the eight finer voxels of a voxel from its own, by its edge."""
_ABOUT = np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 2, (-2.0, -1.0, 0.0, 1.0), indexing="ij"), axis=-1).reshape(-1, 3)
"""Middles of a voxel and of those next to it, and two below it, from its own, by its edge."""
_NUMBER_SHIFTS, _NUMBER_HALF = np.array([42, 21, 0]), 1 << 20  # three indices of a voxel in one number
_STANDING_HITS = 3.0  # exact ones, after which something counts as standing

Known = npt.NDArray[np.int8]
_Block = tuple[int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class VolumeMapParams:
    """How images become voxels; lengths in [m].

    Attributes:
        cell: edge of the voxels.
        length, height: of the window about the robot, along x and y and along z, rounded up to blocks of eight voxels.
        bottom: height at which it begins.
        noise: standard deviation of a depth or range …
        noise_growth: … and what it grows by with the square of it [1/m].
        bias: largest error that all ranges of an image have in common: of the sensor, its place on the robot, the
            robot's posture, and where the robot stands.
        range_max: nothing further away is noted, nor what is further away than `hit_range` and than whatever may be
            called free.
        hit_range: nothing further away becomes an obstacle: there it is not known to a voxel where it is.
        exact_range: up to here one hit is an obstacle, from here on two are; and what is looked at from here, and not
            hit, is less and less of one.
        fine_range: up to here voxels half as wide are freed as well; 0: none are.
        thinnest: nothing is thinner than this, or it may be overlooked: what is so far away that pixels lie further
            apart is not called free.
        ground: what is no higher than this, and three standard deviations, is the floor and no obstacle.
        hole: nothing that gives no answer is wider than this, or it may be overlooked: holes of lost pixels in an image
            count as seen through to where something wider would fit into them, or to the nearer of their two borders.
        answers_count: for how long [s] a lost pixel counts as ending where it ended before, at the nearest, while the
            sensor stands still.
        hit, miss: log-odds that a hit adds, and that a look through takes away.
        floor, top: bounds of the log-odds; the floor is −floor.
        occupied: voxels above it become obstacles, until they are below −floor / 2.
        unseen: whether voxels in doubt are ``"free"`` or ``"blocked"``: those that were never seen, and those that were
            hit and are no obstacle yet.
        stood_time: with ``"blocked"``, what has come where it was free, and was not seen for this long, may have gone:
            its voxels are in doubt [s].
        unseen_radius: with ``"blocked"``, those in blocks this close to the robot's base are obstacles, too.
        low: what is lower is not in doubt: a camera sees the floor too late.
        start_radius, start_margin: where the robot stands at first nothing is in doubt: in an upright cylinder about
            its base, and this near to its bodies.
    """

    cell: Positive = 0.05
    length: Positive = 20.0
    height: Positive = 2.8
    bottom: Annotated[float, Bound(low=-100.0, high=100.0, unit="m")] = 0.0
    noise: NonNegative = 0.002
    noise_growth: NonNegative = 0.0035
    bias: NonNegative = 0.01
    range_max: Positive = 5.0
    hit_range: Positive = 4.0
    exact_range: Positive = 1.5
    fine_range: NonNegative = 1.5
    thinnest: Positive = 0.03
    ground: NonNegative = 0.04
    hole: NonNegative = 0.05
    answers_count: NonNegative = 0.5
    hit: Positive = 0.85
    miss: Positive = 0.4
    floor: Positive = 0.8
    top: Positive = 3.4
    occupied: Positive = 0.5
    unseen: Literal["free", "blocked"] = "free"
    stood_time: NonNegative = 3.0
    unseen_radius: Positive = 1.6
    low: NonNegative = 0.1
    start_radius: NonNegative = 0.8
    start_margin: NonNegative = 0.15

    def __post_init__(self) -> None:
        check_fields(self)
        blocks = self.blocks
        if int(np.prod(blocks)) > _MOST_BLOCKS:
            raise ParameterError(
                f"VolumeMapParams.length={self.length!r} and height={self.height!r} are more than {_MOST_BLOCKS} "
                f"blocks of 8³ voxels of cell={self.cell!r} m"
            )
        if self.unseen == "blocked" and self.unseen_radius > 0.5 * self.length - 2.0 * self.block:
            raise ParameterError(
                f"VolumeMapParams.unseen_radius={self.unseen_radius!r} must be well within half of "
                f"length={self.length!r}"
            )
        if not self.occupied < min(self.hit, self.top):
            raise ParameterError(
                f"VolumeMapParams.occupied={self.occupied!r} must be below hit={self.hit!r} and top={self.top!r}"
            )

    @property
    def block(self) -> float:
        """Edge of the blocks [m]."""
        return BLOCK * self.cell

    @property
    def blocks(self) -> tuple[int, int, int]:
        """How many blocks the window has along each axis."""
        across, up = (math.ceil(length / self.block - 1e-9) for length in (self.length, self.height))
        return across, across, up

    def sigma(self, ranges: Array) -> Array:
        """Standard deviation [m] of ranges [m], of any shape."""
        return self.noise + self.noise_growth * ranges * ranges

    def error(self, ranges: Array) -> Array:
        """The largest error [m] of ranges [m]."""
        return _SIGMAS * self.sigma(ranges) + self.bias


@dataclass(frozen=True, slots=True, eq=False)
class SeenPoints:
    """Where the pixels of an image end over the floor.

    Attributes:
        pixels: (H, W) which pixels do, n of them.
        points: (n, 3) where, in the world [m].
        fresh: (n,) which of them end where it was free before, of all that is not thin at least: something has come.
        standing: (n,) which of them end where something has been seen several times.
    """

    pixels: Mask
    points: Array
    fresh: Mask
    standing: Mask


class VolumeMap:
    """Workspace: voxels about a robot. One per thread.

    Args:
        params: parameters of the map.
        name: name of the layer, with which its obstacles' names begin.
    """

    def __init__(self, params: VolumeMapParams | None = None, name: str = "volume") -> None:
        self.params: VolumeMapParams = params or VolumeMapParams()
        self.name: str = name
        p = self.params
        units = [round(x / _UNIT) for x in (p.miss, -p.floor, p.top, p.occupied, -0.5 * p.floor)]
        native = kernel()
        make = VolumeTwin if native is None else native.VolumeMap
        self._corner = np.array(
            [*(-(n // 2) for n in p.blocks[:2]), math.floor(p.bottom / p.block + 1e-9)], dtype=np.intp
        )
        self._map = make(np.array(p.blocks, dtype=np.intp), self._corner, p.cell, *units)
        self._fine: _FineVoxels | None = None
        if p.fine_range:
            self._fine = _FineVoxels(p, int(self._corner[2]), lambda *given: make(*given, *units))
        self._still: dict[str, StillImages] = {}  # by the sensor's name
        self._made: dict[_Block, _Made] = {}
        self._doubtful: dict[_Block, _Made] = {}  # within the radius
        self._doubts: set[_Block] = set()  # of these those in which something has changed
        self._finer: dict[_Block, None] = {}  # blocks in which finer voxels have changed
        self._came = np.zeros(0, dtype=np.int64)  # voxels in which something ended where it was free, in order
        self._came_at = np.zeros(0)  # when something ended in each of them last [s]

    def center(self, x: float, y: float) -> None:
        """Have the window about a point of the floor [m]; what leaves it is forgotten."""
        p = self.params
        middle = [math.floor(at / p.block) - n // 2 for at, n in zip((x, y), p.blocks, strict=False)]
        if max(abs(middle[0] - self._corner[0]), abs(middle[1] - self._corner[1])) > 1:  # not to and fro at a border
            self._corner = np.array([*middle, self._corner[2]], dtype=np.intp)
            self._map.roll(self._corner)
        if self._fine is not None:
            self._fine.center(x, y)

    def seen_by(self, reading: DepthImage | RangeImage, T_world_base: Array) -> SeenPoints:
        """Where an image's pixels end over the floor, and what is known of it so far.

        Args:
            reading: the image.
            T_world_base: (4, 4) pose of the base when it was measured.
        """
        p, ranges = self.params, reading.ranges
        pixels = reading.hits & (ranges <= min(p.hit_range, _longest(reading)))
        T = T_world_base @ reading.T_base_sensor
        there = ranges[pixels].astype(float)
        points = (reading.directions()[pixels] * there[:, None]) @ T[:3, :3].T + T[:3, 3]
        over = points[:, 2] > p.ground + p.error(there)
        pixels[pixels] = over
        points = np.ascontiguousarray(points[over])
        before = np.empty(len(points), dtype=np.int8)
        self._map.look(points, before)
        free = (before == PASSED) | ((before > PASSED) & (before <= -round(p.floor / _UNIT)))
        return SeenPoints(pixels, points, free, before >= round(_STANDING_HITS * p.hit / _UNIT))

    def add(
        self,
        reading: DepthImage | RangeImage,
        T_world_base: Array,
        seen: SeenPoints | None = None,
        ignored: Mask | None = None,
    ) -> None:
        """Take an image in.

        Args:
            reading: the image; pixels without an answer change nothing.
            T_world_base: (4, 4) pose of the base when it was measured.
            seen: what :meth:`seen_by` said of it, where that was asked.
            ignored: (n,) which of its points are not of the world at rest; their pixels free what they pass.
        """
        p = self.params
        seen = seen or self.seen_by(reading, T_world_base)
        T = T_world_base @ reading.T_base_sensor
        at = reading.ranges[seen.pixels]
        weight = np.where(at <= p.exact_range, p.hit, 0.5 * (p.occupied + 0.5 * p.hit)) / _UNIT
        if ignored is not None:
            weight[ignored] = 0.0
        hits, before = np.rint(weight).astype(np.int8), np.empty(len(at), dtype=np.int8)
        self._map.hit(seen.points, hits, before)
        view = _optics(reading)
        sure = p.thinnest * float(np.abs(view[2]).min())
        # what is filled in only frees: where a lost pixel ends, nothing was seen
        still = self._still.setdefault(reading.sensor, StillImages(p.answers_count))
        ranges = filled(still.filled(reading, T), p.hole * float(np.abs(view[2]).min()))
        # Behind what may be called free, and what may become an obstacle, nothing is of use yet.
        far = max(sure, p.hit_range)
        most = min(_longest(reading), p.range_max, far + float(p.error(np.array(far))))
        known = np.where(np.isnan(ranges), 0.0, np.minimum(ranges, most)).astype(float)
        clear = np.maximum(known - p.error(known), 0.0)
        pose = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
        near = reading.depth_min if isinstance(reading, DepthImage) else reading.range_min
        self._map.carve(np.ascontiguousarray(clear, dtype=np.float32), *view, *pose, near, sure, p.exact_range)
        if self._fine is not None:
            self._fine.hit(seen.points, hits)
            fine = np.ascontiguousarray(np.minimum(clear, p.fine_range), dtype=np.float32)
            self._fine.map.carve(fine, *view, *pose, near, sure, p.exact_range)
        if p.unseen == "blocked":
            self._doubt_what_came(reading.time, seen, weight > 0.0)

    def _doubt_what_came(self, time: float, seen: SeenPoints, stood: Mask) -> None:
        """Of what has come where it was free, and where no image has seen anything for a while, nothing is known: it
        came, and so it may have gone."""
        fresh = seen.fresh[stood]
        if not len(self._came) and not fresh.any():
            return
        voxels = _numbers(seen.points[stood], self.params.cell)
        came = np.union1d(self._came, voxels[fresh])
        since = np.full(len(came), time)
        since[np.searchsorted(came, self._came)] = self._came_at
        at = np.searchsorted(came[:-1], voxels)  # of the few that came: they are looked up among them, not sorted
        since[at[came[at] == voxels]] = time
        gone = time - since > self.params.stood_time
        if gone.any():
            # With what is about it: of who came the feet, say, which are where the floor has kept all from being free.
            middles = (_middles(came[gone], self.params.cell)[:, None] + self.params.cell * _ABOUT).reshape(-1, 3)
            known = np.empty(len(middles), dtype=np.int8)
            self._map.look(middles, known)
            self._map.forget(middles[known > round(self.params.occupied / _UNIT)])  # the others are free again
        self._came, self._came_at = came[~gone], since[~gone]

    def known(self, points: Array) -> Known:
        """(n,) what is known of the voxels that points (n, 3) [m] lie in: 1 an obstacle, 0 free, −1 neither."""
        found = np.empty(len(points), dtype=np.int8)
        self._map.look(np.ascontiguousarray(points, dtype=float), found)
        p = self.params
        free, full = found <= -round(0.5 * p.floor / _UNIT), found > round(p.occupied / _UNIT)
        if self._fine is not None:
            freed = self._fine.free(points)
            found[freed], free = 0, free | freed
        return np.where(found <= PASSED, -1, np.where(free, 0, np.where(full, 1, -1))).astype(np.int8)

    def doubtful(self, points: Array) -> Mask:
        """(n,) whether voxels that points (n, 3) [m] lie in are in doubt: never seen, or hit and no obstacle yet."""
        found = np.empty(len(points), dtype=np.int8)
        self._map.look(np.ascontiguousarray(points, dtype=float), found)
        doubt = (found <= PASSED) | ((found > 0) & (found <= round(self.params.occupied / _UNIT)))
        return doubt if self._fine is None else doubt & ~self._fine.free(points)

    def grant(self, points: Array) -> None:
        """Take it that the voxels of points (n, 3) [m] were seen, and are neither obstacles nor surely free, where they
        were not."""
        self._map.grant(np.ascontiguousarray(points, dtype=float))

    def forget(self, points: Array) -> None:
        """Forget what is known of the voxels of points (n, 3) [m]: a thing that was there has moved on. They were not
        seen then; they are not called free."""
        self._map.forget(np.ascontiguousarray(points, dtype=float))
        if self._fine is not None:
            self._fine.forget(points)

    def in_doubt(self, x: float, y: float) -> list[Obstacle]:
        """What is in doubt near a place (x, y) [m] of the base, one obstacle a block; blocks in which nothing changed
        are the same objects as before."""
        p = self.params
        self._forget_doubts()
        reach, (first, top) = p.unseen_radius, (self._corner[2], self._corner[2] + p.blocks[2])
        low = np.floor((np.array([x, y]) - reach) / p.block).astype(int)
        high = np.floor((np.array([x, y]) + reach) / p.block).astype(int)
        before, self._doubtful = self._doubtful, {}
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                off = max(i * p.block - x, x - (i + 1) * p.block, 0.0), max(j * p.block - y, y - (j + 1) * p.block, 0.0)
                if math.hypot(*off) > reach:
                    continue
                for k in range(first, top):
                    key, made = (i, j, k), before.get((i, j, k))
                    if made is None or key in self._doubts:
                        made = self._obstacle(np.array(key, dtype=np.intp), made, doubtful=True)
                    self._doubtful[key] = made
        self._doubts.clear()  # those that are not within the radius are made when they are
        return [made.obstacle for made in self._doubtful.values() if made.obstacle is not None]

    def obstacles(self) -> list[Obstacle]:
        """What stands, one obstacle a block; blocks in which nothing changed are the same objects as before."""
        self._forget_doubts()  # also where nobody asks for them: else their list would grow
        changed = _keys(self._map.changed(False)) | {key: None for key in self._finer if key in self._made}
        self._finer.clear()
        for key in changed:
            block = np.array(key, dtype=np.intp)
            made = self._obstacle(block, self._made.get(key))
            if made.obstacle is None and not len(self._map.boxes(block, False)):
                self._made.pop(key, None)
            else:
                self._made[key] = made
        return [made.obstacle for made in self._made.values() if made.obstacle is not None]

    def _forget_doubts(self) -> None:
        finer = {} if self._fine is None else self._fine.changed()
        self._finer |= finer
        self._doubts.update(_keys(self._map.changed(True)), finer)

    def _obstacle(self, block: Indices, before: _Made | None, *, doubtful: bool = False) -> _Made:
        """What a block consists of now; the same object as before where that is the same."""
        cell = self.params.cell
        if self._fine is None:
            boxes = self._map.boxes(block, doubtful).reshape(-1, 6)
        else:
            cell *= 0.5
            boxes = self._map.finer_boxes(block, doubtful, self._fine.map).reshape(-1, 6)
        given = boxes.tobytes()
        if before is not None and before.boxes == given:
            return before
        count_work(obstacles=_OBSTACLES_A_BLOCK)
        if doubtful:
            lowest = math.ceil(self.params.low / cell - 1e-9)
            boxes = boxes[boxes[:, 5] > lowest]
            boxes[:, 2] = np.maximum(boxes[:, 2], lowest)
        if not len(boxes):
            return _Made(given, None)
        i, j, k = block.tolist()
        name = f"{UNSEEN_LAYER if doubtful else self.name}-{i}-{j}-{k}"
        return _Made(given, Voxels.of_boxes(boxes[:, :3], boxes[:, 3:], cell, name))

    @property
    def counts(self) -> tuple[int, int]:
        """How many voxels are obstacles, and how many were never seen."""
        return self._map.count(False), self._map.count(True)


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """The obstacle of a block, None where it has none, and the boxes that it was made of, as bytes."""

    boxes: bytes
    obstacle: Obstacle | None


def _numbers(points: Array, cell: float) -> npt.NDArray[np.int64]:
    """A number (n,) for the voxel that each of points (n, 3) [m] lies in."""
    at = np.floor(points / cell).astype(np.int64)
    return np.asarray((at + _NUMBER_HALF) @ (1 << _NUMBER_SHIFTS), dtype=np.int64)


def _middles(numbers: npt.NDArray[np.int64], cell: float) -> Array:
    """The middles (n, 3) [m] of voxels, by their numbers (n,)."""
    at = ((numbers[:, None] >> _NUMBER_SHIFTS) & (2 * _NUMBER_HALF - 1)) - _NUMBER_HALF
    return np.asarray((at + 0.5) * cell, dtype=np.float64)


def _keys(blocks: Indices) -> dict[_Block, None]:
    """Blocks, three numbers each, in order."""
    return {(i, j, k): None for i, j, k in blocks.reshape(-1, 3).tolist()}


class _FineVoxels:
    """Workspace: voxels half as wide as those of a map, about the robot; of these it only counts which are free.

    Args:
        params: of the map.
        bottom: the block of it with which it begins in height.
        make: makes the voxels from blocks (3,), corner (3,) and cell.
    """

    def __init__(
        self, params: VolumeMapParams, bottom: int, make: Callable[[Indices, Indices, float], VolumeTwin]
    ) -> None:
        self._params = params
        across = math.ceil(2.0 * (params.fine_range + _FINE_ROOM) / params.block) + 1
        self._across = min(across, params.blocks[0])  # blocks of the map
        self._corner = np.array([-(self._across // 2), -(self._across // 2), bottom], dtype=np.intp)
        blocks = np.array([2 * self._across, 2 * self._across, 2 * params.blocks[2]], dtype=np.intp)
        self.map: VolumeTwin = make(blocks, 2 * self._corner, 0.5 * params.cell)
        self._free, self._top = -round(0.5 * params.floor / _UNIT), round(params.top / _UNIT)
        self._refined: dict[_Block, None] = {}  # blocks in the window in which something was freed
        self._changed: dict[_Block, None] = {}

    def center(self, x: float, y: float) -> None:
        """Have the window about a point of the floor [m]."""
        middle = [math.floor(at / self._params.block) - self._across // 2 for at in (x, y)]
        if max(abs(middle[0] - self._corner[0]), abs(middle[1] - self._corner[1])) <= 1:
            return
        self._note()
        self._corner = np.array([*middle, self._corner[2]], dtype=np.intp)
        self.map.roll(2 * self._corner)
        low, high = self._corner, self._corner + self._across
        for key in list(self._refined):
            if not (low[0] <= key[0] < high[0] and low[1] <= key[1] < high[1]):
                self._changed[key] = self._refined.pop(key)

    def hit(self, points: Array, weight: npt.NDArray[np.int8]) -> None:
        """Rays ended at points (n, 3), each with a weight (n). Unless rays have always ended there, something has come:
        nothing of the map's voxel stays free, but for what this image frees."""
        before = np.empty(len(points), dtype=np.int8)
        self.map.hit(points, weight, before)
        low = self._corner[:2] * self._params.block
        within = ((points[:, :2] >= low) & (points[:, :2] < low + self._across * self._params.block)).all(axis=1)
        self.forget(points[within & (weight > 0) & (before < self._top)])

    def forget(self, points: Array) -> None:
        """What lies in the map's voxels of points (n, 3) [m] is not free any more."""
        cell = self._params.cell
        if len(points):
            middles = (_middles(np.unique(_numbers(points, cell)), cell)[:, None] + _EIGHTHS * cell).reshape(-1, 3)
            self.map.forget(middles[self.free(middles)])

    def free(self, points: Array) -> Mask:
        """(n,) whether points (n, 3) [m] lie in voxels that are free."""
        found = np.empty(len(points), dtype=np.int8)
        self.map.look(np.ascontiguousarray(points, dtype=float), found)
        return (found > PASSED) & (found <= self._free)

    def changed(self) -> dict[_Block, None]:
        """Blocks of the map in which something was freed, or is free no more, since this was last asked."""
        self._note()
        changed, self._changed = self._changed, {}
        return changed

    def _note(self) -> None:
        for doubtful in (False, True):
            keys = _keys(self.map.changed(doubtful).reshape(-1, 3) // 2)
            self._changed |= keys
            self._refined |= keys


def _longest(reading: DepthImage | RangeImage) -> float:
    return reading.depth_max if isinstance(reading, DepthImage) else reading.range_max


def _optics(reading: DepthImage | RangeImage) -> tuple[bool, bool, Array, Array]:
    """Whether it is a camera's, whether it is closed, pixels a unit along columns and rows, and where that is 0."""
    if isinstance(reading, DepthImage):
        return True, False, np.array(reading.focal, dtype=float), np.array(reading.center, dtype=float)
    scale = 1.0 / np.array(reading.steps)
    return False, reading.closed, scale, -np.array([reading.azimuth[0], reading.elevation[0]]) * scale
