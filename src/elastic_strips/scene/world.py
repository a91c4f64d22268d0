"""Scene room, world: a scene with a timetable: what exists when, and where it is then, one snapshot after another."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from elastic_strips.errors import SceneError, nearest_name
from elastic_strips.scene import checks
from elastic_strips.scene.scene import Scene
from elastic_strips.summary import Summary

_LATEST = 1e12


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class World(Summary):
    """Obstacles that move, appear and vanish: an obstacle exists from ``appears`` on, until ``vanishes``.

    Args:
        scene: All obstacles, whenever they exist.
        appears: Name → time [s]; an obstacle that is not named has always been there.
        vanishes: Name → time [s] at which it is gone; an obstacle that is not named stays for ever.

    Raises:
        SceneError: A name that the scene has not, a time that is no finite number, an obstacle that vanishes before
            or when it appears.
    """

    scene: Scene
    appears: Mapping[str, float] = field(default_factory=dict)
    vanishes: Mapping[str, float] = field(default_factory=dict)
    _events: tuple[float, ...] = field(init=False, repr=False)  # times at which something appears or vanishes
    _latest: dict[int, Scene] = field(init=False, repr=False)  # number of events passed → newest snapshot made

    def __post_init__(self) -> None:
        if not isinstance(self.scene, Scene):
            raise SceneError(f"World needs a Scene, not {checks.shown(self.scene)}")
        for what in ("appears", "vanishes"):
            times = _times(self.scene, what, getattr(self, what))
            object.__setattr__(self, what, MappingProxyType(times))
        for name, end in self.vanishes.items():
            begin = self.appears.get(name, -math.inf)
            if not end > begin:
                raise SceneError(
                    f"obstacle {name!r} vanishes at {end:g} s; it must be later than it appears, {begin:g} s"
                )
        events = sorted({*self.appears.values(), *self.vanishes.values()})
        object.__setattr__(self, "_events", tuple(events))
        object.__setattr__(self, "_latest", {})

    def at(self, t: float) -> Scene:
        """Snapshot at time ``t`` [s]: the obstacles that exist then, at their poses.

        Between two times at which something appears or vanishes, a snapshot is derived from the one made before it, so
        that it shares what did not move and `Scene.rows_changed_since` costs next to nothing.
        """
        t = checks.number("time", t, low=-_LATEST, high=_LATEST, unit="s")
        phase = bisect_right(self._events, t)
        latest = self._latest.get(phase)
        if latest is None:
            there = [o for o in self.scene if self.exists(o.name or "", t)]
            latest = self.scene if len(there) == len(self.scene) else Scene(there, time=self.scene.time)
        if latest.time != t:
            latest = latest.at(t)
        self._latest[phase] = latest
        return latest

    def exists(self, name: str, t: float) -> bool:
        """Whether the obstacle of that name exists at ``t`` [s]."""
        if name not in self.scene:
            raise SceneError(f"no obstacle {checks.shown(name)} in the world{nearest_name(name, self.scene.names)}")
        return self.appears.get(name, -math.inf) <= t < self.vanishes.get(name, math.inf)

    def forget(self) -> None:
        """Make snapshots anew: the history of a `Yielding` motion has been forgotten."""
        self._latest.clear()

    @property
    def names_moving(self) -> tuple[str, ...]:
        """Names of the obstacles that have a motion, known or not."""
        return tuple(o.name or "" for o in self.scene if o.motion is not None)

    @property
    def event_times(self) -> tuple[float, ...]:
        """Times [s], ascending, at which something appears or vanishes."""
        return self._events

    def speed_bound(self, name: str | None = None, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of any point of an obstacle while it exists between ``start`` and ``end`` [s].

        Args:
            name: Of the obstacle; None asks about all of them.
            start: Begin of the interval; None is minus infinity.
            end: Its end; None is plus infinity.

        Returns:
            The bound; 0 where nothing moves, infinity where a loop of keyframes jumps.
        """
        low = -math.inf if start is None else checks.number("start", start, low=-_LATEST, high=_LATEST, unit="s")
        high = math.inf if end is None else checks.number("end", end, low=-_LATEST, high=_LATEST, unit="s")
        if not low <= high:
            raise SceneError(f"speed_bound needs start <= end, not {low:g} and {high:g} s")
        if name is not None:
            self.exists(name, 0.0)  # refuses an unknown name
        fastest = 0.0
        for obstacle in self.scene if name is None else (self.scene.obstacle(name),):
            begin = max(low, self.appears.get(obstacle.name or "", -math.inf))
            stop = min(high, self.vanishes.get(obstacle.name or "", math.inf))
            if obstacle.motion is not None and begin <= stop:
                fastest = max(
                    fastest,
                    obstacle.speed_bound(
                        start=None if begin == -math.inf else begin, end=None if stop == math.inf else stop
                    ),
                )
        return fastest

    def __reduce__(self) -> tuple[Any, ...]:
        return World, (self.scene, dict(self.appears), dict(self.vanishes))


def _times(scene: Scene, what: str, given: Any) -> dict[str, float]:
    if not isinstance(given, Mapping):
        raise SceneError(f"World {what} must be a mapping from names to times [s], not {checks.shown(given)}")
    times = {}
    for name, value in given.items():
        if name not in scene or not isinstance(name, str):
            raise SceneError(
                f"World {what}: no obstacle {checks.shown(name)} in the scene{nearest_name(name, scene.names)}"
            )
        times[name] = checks.number(f"{what} of {name!r}", value, low=-_LATEST, high=_LATEST, unit="s")
    return times
