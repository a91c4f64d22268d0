"""Seen rows: what a robot took for its world while it drove by sensors, a few times a second, as plain arrays."""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Mask
from elastic_strips.coal_shapes import ShapeKind, shape_of
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.scene.parts import Part
from elastic_strips.scene.quantities import quaternion_of
from elastic_strips.summary import Summary

_log = logging.getLogger(__name__)
SEEN_PERIOD = 0.25
"""Least time [s] from one look at what is seen to the next."""
SEEN_SHAPES = ("box", "cylinder", "sphere")
"""Shapes of what was seen, by their codes in ``SeenRows.shape``."""
MOST_SEEN = 1_000_000
"""Largest number of shapes of a record."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SeenRows(Summary):
    """The shapes (K of them) that the robot's sensors made of the world, arrays read-only; none where it was known.

    What moves is one shape at each look, where it was then. Space that was not seen yet is not among them.

    Attributes:
        begin, end: (K,) from when until when each was there [s].
        shape: (K,) uint8 index into ``SEEN_SHAPES``; other shapes are the boxes about them.
        size: (K, 3) its extent along its own axes [m].
        position, quaternion: (K, 3), (K, 4) where its centre is [m, world], and how it is turned (x, y, z, w).
        moves: (K,) whether it was taken to move.
    """

    begin: Array
    end: Array
    shape: npt.NDArray[np.uint8]
    size: Array
    position: Array
    quaternion: Array
    moves: Mask

    def __post_init__(self) -> None:
        for each in fields(self):
            getattr(self, each.name).setflags(write=False)

    def __len__(self) -> int:
        return len(self.begin)

    def there(self, time: float) -> Mask:
        """(K,) which of them were there at a time [s]."""
        return (self.begin <= time) & (time < self.end)


class _Shapes(NamedTuple):
    """Of the shapes (k of them) of an obstacle: codes (k,), sizes (k, 3), positions (k, 3), quaternions (k, 4)."""

    code: Array
    size: Array
    position: Array
    quaternion: Array


class _There(NamedTuple):
    """An obstacle that is there, its shapes, and since when [s]."""

    obstacle: Obstacle
    shapes: _Shapes
    since: float


class SeenLog:
    """Workspace: collects what is seen; only what changed since the last look takes room."""

    def __init__(self) -> None:
        self._there: dict[str, _There] = {}
        self._gone: list[tuple[_There, float]] = []  # what was there, and until when [s]
        self._looked = -np.inf
        self._count = 0

    def look(self, time: float, scene: Scene) -> None:
        """Take in the scene that was seen at a time [s], unless the last look was just before."""
        if time < self._looked + SEEN_PERIOD or self._count > MOST_SEEN:
            return
        self._looked = time
        seen: dict[str, _There] = {}
        for obstacle in scene.seen:
            name = str(obstacle.name)
            was = self._there.get(name)
            if was is None or not _unchanged(was.obstacle, obstacle):
                now = _There(obstacle, _shapes(obstacle), time)
                was = now if was is None or not all(map(np.array_equal, was.shapes, now.shapes)) else was
            seen[name] = was
        over = [there for name, there in self._there.items() if seen.get(name) is not there]
        self._gone += [(there, time) for there in over]
        self._count += sum(len(there.shapes.code) for there in over)
        self._there = seen
        if self._count > MOST_SEEN:
            _log.warning("what is seen after %.1f s is not recorded: it has more than %d shapes", time, MOST_SEEN)

    def rows(self, end: float) -> SeenRows:
        """What was seen so far; what is there now was there until ``end`` [s]. Collecting may go on."""
        spans = [*self._gone, *((there, max(end, there.since)) for there in self._there.values())]
        times = np.array([(there.since, until, there.obstacle.motion is not None) for there, until in spans])
        times = np.repeat(times.reshape(-1, 3), [len(there.shapes.code) for there, _ in spans], axis=0)
        nothing = _Shapes(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4)))
        code, size, position, quaternion = map(np.concatenate, zip(nothing, *(s.shapes for s, _ in spans), strict=True))
        return SeenRows(
            begin=times[:, 0].copy(),
            end=times[:, 1].copy(),
            shape=code.astype(np.uint8),
            size=size,
            position=position,
            quaternion=quaternion,
            moves=times[:, 2].astype(bool),
        )


def _unchanged(one: Obstacle, other: Obstacle) -> bool:
    return one.parts is other.parts and np.array_equal(one.pose, other.pose)


def _shapes(obstacle: Obstacle) -> _Shapes:
    pose = np.asarray(obstacle.pose)
    found = [_members(part) for part in obstacle.parts]
    code, size, middle = (np.concatenate([each[k] for each in found]) for k in range(3))
    position = middle @ pose[:3, :3].T + pose[:3, 3]
    return _Shapes(code, size, position, np.tile(quaternion_of(pose[:3, :3]), (len(code), 1)))


def _members(part: Part) -> tuple[Array, Array, Array]:
    """Codes (k,), sizes (k, 3) and middles (k, 3) [m] of a part's shapes, in the obstacle's frame."""
    origin = np.asarray(part.T_obstacle_part)[:3, 3]
    if part.geometry is None:
        return np.zeros(len(part.sizes)), np.asarray(part.sizes), origin + np.asarray(part.middles)
    kind, _ = shape_of(part.geometry)
    box = 2.0 * np.asarray(part.half_extents)
    code = SEEN_SHAPES.index(kind.value) if kind in (ShapeKind.CYLINDER, ShapeKind.SPHERE) else 0
    return np.full(1, float(code)), box[None], np.asarray(part.center)[None]
