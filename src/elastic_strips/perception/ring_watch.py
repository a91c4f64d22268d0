"""Ring watch: what sonars hear where images and lasers see through, as through glass."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from elastic_strips.arrays import Array

from .image_movers import ImageView, measured
from .readings import RangeRing, ScanRays

_IN_A_ROW = 3  # echoes of a sonar, for a single one may be another sonar's
_FRESH = 0.3  # [s] between an echo and what is compared with it, at most
_KEPT_FOR = 2.0  # [s] a contradiction is told after it was found last
_BEYOND = 0.15  # [m] by which what is seen through ends behind where an echo comes from
_LOWEST = 0.08  # [m] over the floor: nothing lower is compared
_FLOOR = 0.05  # [m] what is no higher is taken to be the floor
_MOST_UNKNOWN = 0.25  # of the places that an echo may come from: nothing is seen there
_BESIDE_PLANE = 0.1  # [m] by which they may be higher or lower than a laser's plane
_TILTS, _AROUND = (0.0, 0.35, 0.7, 1.0), 8  # parts of a cone's half angle; directions to each


class RingWatch:
    """Workspace: the echoes of one ring so far.

    An echo says that something is as far as it, anywhere in the sonar's cone. Where an image sees through all of these
    places, and a laser through those in its plane, the thing is of glass, or else so thin that they overlook it.
    """

    def __init__(self) -> None:
        self._odd: dict[int, int] = {}  # sonar → echoes in a row that contradict
        self._said, self._until = "", -math.inf

    def look(
        self, ring: RangeRing, T_world_base: Array, images: Iterable[ImageView], scans: Iterable[ScanRays]
    ) -> None:
        """Compare a ring's echoes with what else was seen; without a fresh image nothing tells.

        Args:
            ring: a round of its sensors.
            T_world_base: (4, 4) pose of the base when it was measured.
            images: the newest image of each sensor that was believed.
            scans: the newest scan of each laser.
        """
        if ring.kind != "sonar":  # infrared light passes through glass as well
            return
        images = [view for view in images if abs(ring.time - view.time) <= _FRESH]
        scans = [scan for scan in scans if abs(ring.time - scan.time) <= _FRESH]
        T = T_world_base @ ring.T_base_sensor
        fan = _fan(ring.half_angle)
        for k in np.flatnonzero(~np.isnan(ring.ranges)).tolist() if images else ():
            range_, by = float(ring.ranges[k]), ""
            if ring.range_min < range_ < math.inf:
                places = T[k, :3, 3] + range_ * fan @ T[k, :3, :3].T
                by = _seen_through(places[places[:, 2] > _LOWEST], images, scans)
            self._odd[k] = self._odd.get(k, 0) + 1 if by else 0
            if self._odd[k] < _IN_A_ROW:
                continue
            if not self.said(ring.time):
                self._said = (
                    f"{ring.sensor!r} hears something {range_:.1f} m from it, and {by} sees through it: "
                    "glass, a mirror, or something thin"
                )
            self._until = ring.time + _KEPT_FOR

    def said(self, now: float) -> str:
        """What contradicts the echoes up to a time [s], in words; empty where nothing does."""
        return self._said if now <= self._until else ""


def _fan(half_angle: float) -> Array:
    """(n, 3) unit vectors that fill a cone about x."""
    turn = np.arange(_AROUND) * (2.0 * math.pi / _AROUND)
    rim = np.column_stack((np.zeros(_AROUND), np.cos(turn), np.sin(turn)))
    tilts = half_angle * np.array(_TILTS)
    return np.concatenate([math.cos(tilt) * np.array([1.0, 0.0, 0.0]) + math.sin(tilt) * rim for tilt in tilts])


def _seen_through(places: Array, images: list[ImageView], scans: list[ScanRays]) -> str:
    """The sensor whose image sees through all of some places (n, 3); empty where none does, or where anything else
    ends there or before."""
    by = ""
    for view in images:
        T = view.T_world_sensor
        distance, range_ = measured(view.image, (places - T[:3, 3]) @ T[:3, :3])
        with np.errstate(divide="ignore", invalid="ignore"):
            height = T[2, 3] + range_ / distance * (places[:, 2] - T[2, 3])  # where it ends
        if (range_ <= distance + np.where(height < _FLOOR, 0.0, _BEYOND)).any():
            return ""
        if np.isnan(range_).mean() <= _MOST_UNKNOWN:
            by = by or repr(view.image.sensor)
    for scan in scans:
        level = places[np.abs(places[:, 2] - scan.height) < _BESIDE_PLANE, :2]
        through, hidden = scan.beyond(level, _BEYOND)
        if not (through | hidden).all():
            return ""
    return by if len(places) else ""
