"""Movers that nothing has seen for long: where they may be is in doubt for a while, until it is looked at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.scene import UNSEEN_LAYER, Obstacle, Voxels

from .params import SceneEstimatorParams
from .tracking import Track, View

_CELL = 0.1  # [m]


@dataclass(slots=True, eq=False)
class _Way:
    """Where one of them may be: middles (n, 2) [m] of columns, until when [s], and which sensors have seen it."""

    name: str
    columns: Array
    until: float
    sensors: frozenset[str]
    obstacle: Obstacle | None = None


class LostMovers:
    """Workspace: the ways of movers whose tracks have ended because nothing had seen them for ``coast_time``.

    Such a thing was not seen to go away, and its motion is too old to be gone on with. Its way on, as wide as it may
    stray, is an obstacle at rest of what was not seen, ``unseen-track-3``, for ``doubt_time``; what a sensor that had
    seen it sees through meanwhile is none.

    Args:
        params: for how long, and how wide.
    """

    def __init__(self, params: SceneEstimatorParams) -> None:
        self._params = params
        self._ways: list[_Way] = []

    def add(self, tracks: list[Track], own: Callable[[Array], Mask]) -> None:
        """Movers that have just been lost; ``own`` tells which columns (n, 2) [m] the robot itself is in."""
        p = self._params
        for track in tracks:
            wide = track.radius + p.padding + p.stray_width
            way = p.doubt_time * track.v
            low = np.floor((np.minimum(track.p, track.p + way) - wide) / _CELL)
            high = np.ceil((np.maximum(track.p, track.p + way) + wide) / _CELL)
            grid = np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij")
            columns = (np.stack(grid, axis=-1).reshape(-1, 2) + 0.5) * _CELL
            d = columns - track.p
            part = np.clip(d @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
            away = d - part[:, None] * way
            columns = columns[np.hypot(away[:, 0], away[:, 1]) <= wide]
            columns = columns[~own(columns)]
            self._ways.append(_Way(track.name, columns, track.time + p.doubt_time, frozenset(track.seen_by)))

    def look(self, view: View, sensor: str) -> None:
        """Take out what a ``sensor``'s reading sees through, and what is over."""
        for way in self._ways:
            if sensor in way.sensors and len(way.columns):
                through, _ = view.beyond(way.columns, self._params.carve_margin)
                if through.any():
                    way.columns, way.obstacle = way.columns[~through], None
        self._ways = [way for way in self._ways if view.time < way.until and len(way.columns)]

    def obstacles(self) -> list[Obstacle]:
        """One for each that there is; those of which nothing was seen since are the same objects as before."""
        p = self._params
        for way in self._ways:
            if way.obstacle is None:
                centers = np.column_stack((way.columns, np.zeros(len(way.columns))))
                size, at = (_CELL, _CELL, p.tallest), (0.0, 0.0, 0.5 * p.tallest)
                way.obstacle = Voxels(centers, size, at=at, name=f"{UNSEEN_LAYER}-{way.name}")
        return [way.obstacle for way in self._ways if way.obstacle is not None]
