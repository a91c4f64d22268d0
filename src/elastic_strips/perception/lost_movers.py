"""Movers that nothing sees: where they may be since then is in doubt for a while, until it is looked at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.scene import UNSEEN_LAYER, Obstacle, Voxels

from .params import SceneEstimatorParams
from .tracking import Track, View

_CELL = 0.1  # [m]
_HIDDEN_AFTER = 0.15  # [s] without being seen, from which on a mover counts as hidden
_ARRIVAL_STEP = 0.2  # [s] by which the times are rounded from which on it may be somewhere: each makes an obstacle anew
_REACHED_WITHIN = 1.5  # [s] where one may come so soon that is followed no longer, a motion does not lead


@dataclass(slots=True, eq=False)
class _Way:
    """Where one of them may be.

    Attributes:
        name: of the track.
        columns, since: middles (n, 2) [m] of columns that it may take up, and from when on (n,) [s].
        along: (n,) how far ahead they are of where it was seen last, less what it is wide [m].
        line, passed: places (m, 2) [m] along its way where it itself may be, and from when on (m,) [s].
        seen, speed: when it was seen last [s], and how fast it went [m/s].
        heights: (2,) lowest and highest place [m] at which it was seen last.
        until: when this is over [s].
        sensors: that have seen it.
        through: (n,) which of the columns one of these saw through last.
        there: (n,) which of them are in doubt.
        obstacle: made of these.
    """

    name: str
    columns: Array
    since: Array
    along: Array
    line: Array
    passed: Array
    seen: float
    speed: float
    heights: Array
    until: float
    sensors: frozenset[str]
    through: Mask
    there: Mask
    obstacle: Obstacle | None = None

    def look(self, view: View, margin: float) -> None:
        """What a sensor that has seen it sees through."""
        places = np.concatenate((self.columns, self.line))
        through, _ = view.beyond(places, margin, np.broadcast_to(self.heights, (len(places), 2)))
        self.through = through[: len(self.columns)]
        gone = (self.passed <= view.time) & through[len(self.columns) :]
        self.line, self.passed = self.line[~gone], self.passed[~gone]

    def leave_out(self, now: float, own: Mask, within: float, acceleration: float) -> None:
        """Where it is not: where it may have come by now, and is seen through, or the robot is. What is in doubt is
        where it may come ``within`` some time [s] without being seen, through the robot too."""
        kept = ~((self.since <= now) & self.through)
        there = ~self.through & (self.since <= now + within)
        if own.any():  # it has not come there yet, however fast it is; but from where it may be by now it still may
            left = self.along[own, None] - (self.passed[self.passed <= now] - self.seen) * self.speed
            soon = (left >= 0.0) & (left <= self.speed * within + 0.5 * acceleration * within**2)
            there[own] &= within > 0.0 and soon.any(axis=1)
        if not kept.all():
            self.columns, self.since, self.along = self.columns[kept], self.since[kept], self.along[kept]
            self.through, there, self.obstacle = self.through[kept], there[kept], None
        if self.obstacle is None or not np.array_equal(there, self.there):
            self.there, self.obstacle = there, None


class LostMovers:
    """Workspace: the ways of movers that nothing sees.

    Such a thing was not seen to go away. It may have stopped where it was seen last, or gone on at its last velocity,
    or at any speed between: so its way from there on, as far as it may have come and as wide as it may stray, is an
    obstacle at rest of what was not seen, ``unseen-track-3``; once its track is lost, with the way that it may come
    next. Where the robot is, or a sensor that had seen the thing sees through, it is not; where it is nowhere any more,
    or ``doubt_time`` after its track is lost for good, that is over. A track that is dropped, because something is seen
    through where it should be by now, leaves its way, too.

    Args:
        params: for how long, and how wide.
    """

    def __init__(self, params: SceneEstimatorParams) -> None:
        self._params = params
        self._ways: list[_Way] = []

    def update(
        self,
        followed: Sequence[Track],
        ended: Sequence[Track],
        view: View,
        sensor: str,
        own: Callable[[Array], Mask],
    ) -> None:
        """Take in the reading of a ``sensor`` with which tracks were just updated.

        Args:
            followed: the movers that are followed, seen or not.
            ended: movers whose tracks have just ended.
            view: the reading.
            sensor: its sensor.
            own: tells which columns (n, 2) [m] the robot itself is in.
        """
        now = view.time
        hidden = [track for track in followed if now - track.seen > _HIDDEN_AFTER]
        names = {track.name for track in followed}
        seen = names - {track.name for track in hidden}
        self._ways = [way for way in self._ways if way.name not in seen and now < way.until]
        known = {way.name for way in self._ways}
        self._ways.extend(self._way(track) for track in (*hidden, *ended) if track.name not in known)
        if not self._ways:
            return
        places = np.concatenate([way.columns for way in self._ways])
        ends = np.cumsum([len(way.columns) for way in self._ways])
        for way, at_robot in zip(self._ways, np.split(own(places), ends[:-1]), strict=True):
            if sensor in way.sensors:
                way.look(view, self._params.carve_margin)
            within = 0.0 if way.name in names else _REACHED_WITHIN
            way.leave_out(now, at_robot, within, self._params.mover_acceleration)
        # who is nowhere by now does not come any further
        self._ways = [way for way in self._ways if (way.passed <= now).any() and len(way.columns)]

    def _way(self, track: Track) -> _Way:
        p = self._params
        last, wide = track.p - (track.time - track.seen) * track.v, track.radius + p.padding
        lasts, widest, speed = p.coast_time + p.doubt_time, wide + p.stray_width, max(track.speed, 1e-6)
        ahead = track.v / speed
        low = np.floor((np.minimum(last, last + lasts * track.v) - widest) / _CELL)
        high = np.ceil((np.maximum(last, last + lasts * track.v) + widest) / _CELL)
        grid = np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij")
        columns = (np.stack(grid, axis=-1).reshape(-1, 2) + 0.5) * _CELL
        along = (columns - last) @ ahead
        away = columns - last - np.clip(along, 0.0, lasts * speed)[:, None] * ahead
        beside = np.hypot(*away.T)
        columns, along, beside = (x[beside <= widest] for x in (columns, along, beside))
        # when it has strayed so far to the side, and when it has come so far ahead and strayed in that direction
        strays = np.sqrt(2.0 * np.maximum(beside - wide, 0.0) / p.mover_acceleration)
        left, a = np.maximum(along - wide, 0.0), p.mover_acceleration
        comes = (np.sqrt(speed * speed + 2.0 * a * left) - speed) / a
        late = 0.5 * a * comes * comes > p.stray_width
        comes = np.where(late, (left - p.stray_width) / speed, comes)
        since = track.seen + np.floor(np.maximum(strays, comes) / _ARRIVAL_STEP) * _ARRIVAL_STEP
        passed = np.arange(0.0, lasts, min(_CELL / speed, lasts))
        nowhere = np.zeros(len(columns), dtype=bool)
        return _Way(
            name=track.name,
            columns=columns,
            since=since,
            along=left,
            line=last + passed[:, None] * track.v,
            passed=track.seen + passed,
            seen=track.seen,
            speed=speed,
            heights=track.heights,
            until=track.seen + lasts,
            sensors=frozenset(track.seen_by),
            through=nowhere,
            there=nowhere,
        )

    def obstacles(self) -> list[Obstacle]:
        """One for each that there is; those of which nothing was seen since are the same objects as before."""
        p = self._params
        for way in self._ways:
            if way.obstacle is None and way.there.any():
                columns = way.columns[way.there]
                centers = np.column_stack((columns, np.zeros(len(columns))))
                size, at = (_CELL, _CELL, p.tallest), (0.0, 0.0, 0.5 * p.tallest)
                way.obstacle = Voxels(centers, size, at=at, name=f"{UNSEEN_LAYER}-{way.name}")
        return [way.obstacle for way in self._ways if way.obstacle is not None]
