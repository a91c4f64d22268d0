"""Scene room, scenes and worlds: snapshots of all obstacles at one time, with all their parts as arrays; timetables.

A `Scene` is one snapshot. A `World` is a scene with a timetable: what exists when, and where it is then.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain, pairwise
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from elastic_strips.arrays import Array, Indices
from elastic_strips.errors import SceneError, nearest_name, plural
from elastic_strips.summary import Summary, shortened, table
from elastic_strips.validation import check_type, named_arguments, shown

from .motion import PedestrianMotion
from .obstacle import UNSEEN_LAYER, Obstacle
from .parts import Part
from .quantities import check_time


@dataclass(frozen=True, slots=True, eq=False)
class PartTable:
    """Parts of all obstacles of a scene (P of them, obstacle by obstacle), world frame, read-only.

    Attributes:
        parts: The parts (P).
        obstacle_index: Index (P,) of each part's obstacle in the scene.
        offsets: Obstacle k owns the rows ``offsets[k]`` to ``offsets[k + 1]``; (K + 1,).
        rotation: Rotations of T_world_part (P, 3, 3).
        translation: Translations of T_world_part (P, 3) [m].
        center: Centres of the parts' world bounding boxes (P, 3) [m]; of their bounding spheres too.
        half_extents: Half sizes of the world bounding boxes (P, 3) [m].
        radius: Radii of the bounding spheres (P,) [m].
        local_half: Half sizes of the bounding boxes (P, 3) [m] in the obstacles' frames.
        local_center: Their centres (P, 3) [m] in the obstacles' frames.
        local_translation: Origins of the parts (P, 3) [m] in the obstacles' frames.
    """

    parts: tuple[Part, ...]
    obstacle_index: NDArray[np.int64]
    offsets: NDArray[np.int64]
    rotation: Array
    translation: Array
    center: Array
    half_extents: Array
    radius: Array
    local_half: Array
    local_center: Array
    local_translation: Array

    def __len__(self) -> int:
        return len(self.parts)


def _build_table(obstacles: Sequence[Obstacle]) -> PartTable:
    """Table of ``obstacles`` from scratch."""
    solids = [o.solid for o in obstacles]
    counts = np.fromiter((len(s.parts) for s in solids), dtype=np.int64, count=len(solids))
    offsets = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(counts)])
    index = np.repeat(np.arange(len(solids)), counts)
    rows = np.concatenate([np.zeros((0, 10)), *(s.rows for s in solids)])
    local_translation, local_center, local_half, radius = (
        np.ascontiguousarray(rows[:, columns]) for columns in (slice(3), slice(3, 6), slice(6, 9), 9)
    )
    poses = np.concatenate([np.zeros((0, 4)), *(o.pose for o in obstacles)]).reshape(-1, 4, 4)[index]
    rotation, origin = np.ascontiguousarray(poses[:, :3, :3]), poses[:, :3, 3]
    translation = np.einsum("pij,pj->pi", rotation, local_translation) + origin
    center = np.einsum("pij,pj->pi", rotation, local_center) + origin
    half = np.minimum(np.einsum("pij,pj->pi", np.abs(rotation), local_half), radius[:, None])
    arrays = (index, offsets, rotation, translation, center, half, radius, local_half, local_center, local_translation)
    for array in arrays:
        array.flags.writeable = False
    return PartTable(tuple(chain.from_iterable(s.parts for s in solids)), *arrays)


def _joined_table(pieces: Sequence[tuple[PartTable, int, int]]) -> PartTable:
    """Table of obstacles ``first`` to ``last`` of each table, one after the other."""
    rows = [(t, slice(int(t.offsets[first]), int(t.offsets[last]))) for t, first, last in pieces]
    counts = np.concatenate([np.diff(t.offsets[first : last + 1]) for t, first, last in pieces])
    joined = {
        f.name: np.concatenate([getattr(t, f.name)[s] for t, s in rows])
        for f in fields(PartTable)
        if f.name not in ("parts", "obstacle_index", "offsets")
    }
    joined["obstacle_index"] = np.repeat(np.arange(len(counts)), counts)
    joined["offsets"] = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(counts)])
    for array in joined.values():
        array.flags.writeable = False
    return PartTable(tuple(chain.from_iterable(t.parts[s] for t, s in rows)), **joined)


def _update_table(table: PartTable, obstacles: Sequence[Obstacle], changed: Sequence[int]) -> PartTable:
    """Table of ``obstacles``, which differ from those of ``table`` only in the poses of the ``changed`` ones."""
    rotation, translation = table.rotation.copy(), table.translation.copy()
    center, half = table.center.copy(), table.half_extents.copy()
    if len(changed) == 1:
        k = changed[0]
        pose = obstacles[k].pose
        turn, origin = pose[:3, :3], pose[:3, 3]
        rows = slice(int(table.offsets[k]), int(table.offsets[k + 1]))
        rotation[rows] = turn
        translation[rows] = table.local_translation[rows] @ turn.T + origin
        center[rows] = table.local_center[rows] @ turn.T + origin
        half[rows] = np.minimum(table.local_half[rows] @ np.abs(turn).T, table.radius[rows, None])
    else:
        poses = np.array([obstacles[k].pose for k in changed])
        number = np.full(len(table.offsets) - 1, -1)
        number[list(changed)] = np.arange(len(changed))
        which = number[table.obstacle_index]
        rows = np.flatnonzero(which >= 0)
        pose = poses[which[rows]]
        turn, origin = pose[:, :3, :3], pose[:, :3, 3]
        rotation[rows] = turn
        translation[rows] = np.einsum("pij,pj->pi", turn, table.local_translation[rows]) + origin
        center[rows] = np.einsum("pij,pj->pi", turn, table.local_center[rows]) + origin
        spread = np.einsum("pij,pj->pi", np.abs(turn), table.local_half[rows])
        half[rows] = np.minimum(spread, table.radius[rows, None])
    for array in (rotation, translation, center, half):
        array.flags.writeable = False
    return replace(table, rotation=rotation, translation=translation, center=center, half_extents=half)


class Scene:
    """An immutable set of named obstacles at a time.

    Args:
        obstacles: The obstacles; those without a name get one ("box-0", "sphere-1": shape and place in the scene).
        time: Time of the snapshot [s]; moving obstacles are taken to their poses at that time. None is time 0 of what
            was made for no time in particular, such as a map.

    Attributes:
        obstacles: The obstacles (tuple), each with a name.
        names: Their names (tuple).
        time: Time of the snapshot [s].
        stamp: The time that it was made for [s], or None where that is none in particular.
        held_up: What keeps it from being newer; empty where that is not known.
        remark: What is odd about it, such as sensors that contradict each other; empty where nothing is.
        table: Arrays of all parts in the world, see `PartTable`; made on demand, cheap for a derived snapshot.

    Examples:
        >>> scene = es.Scene([es.Box((1.2, 0.8, 0.05), at=(2.0, 0.3, 0.7), name="table")])
        >>> fuller = scene.with_obstacle(es.Sphere(0.1, at=(2.0, 0.3, 0.9), name="ball"))
        >>> scene.names, fuller.names
        (('table',), ('table', 'ball'))
    """

    __slots__ = (
        "_changed",
        "_index",
        "_seen",
        "_source",
        "_table",
        "held_up",
        "names",
        "obstacles",
        "remark",
        "stamp",
        "time",
    )

    obstacles: tuple[Obstacle, ...]
    names: tuple[str, ...]
    time: float
    stamp: float | None
    held_up: str
    remark: str
    _index: dict[str, int] | None  # name -> place, made when it is first asked for
    _table: PartTable | None
    _source: PartTable | None  # table of an earlier snapshot ...
    _changed: tuple[int, ...]  # ... that differs in the poses of these obstacles
    _seen: Scene | Literal["all"] | None  # see `seen`; None until it is asked for

    @named_arguments
    def __init__(
        self,
        obstacles: Iterable[Obstacle] = (),
        *,
        time: float | None = None,
        held_up: str = "",
        remark: str = "",
    ) -> None:
        check_type("held_up", held_up, str, SceneError)
        check_type("remark", remark, str, SceneError)
        stamp = None if time is None else check_time("Scene time", time)
        time = 0.0 if stamp is None else stamp
        if isinstance(obstacles, Obstacle):
            raise SceneError("Scene needs a list of obstacles: write Scene([obstacle])")
        try:
            given = list(obstacles)
        except TypeError:
            raise SceneError(f"Scene needs a list of obstacles, not {shown(obstacles)}") from None
        if not all(issubclass(kind, Obstacle) for kind in set(map(type, given))):
            k = next(k for k, obstacle in enumerate(given) if not isinstance(obstacle, Obstacle))
            raise SceneError(f"obstacle {k} is not an obstacle (Box, Sphere, …): {shown(given[k])}")
        names = [o.name for o in given]
        nameless = [k for k, name in enumerate(names) if name is None]
        taken = set(names) - {None}
        if len(taken) + len(nameless) < len(names):
            raise _named_twice(names)
        for k in nameless:
            name = _free_name(given[k].shape, k, taken)
            given[k], names[k] = given[k].named(name), name
            taken.add(name)
        obstacles = tuple(o if o.motion is None else o.at(time) for o in given)
        _filled(self, obstacles, stamp, tuple(name or "" for name in names), (held_up, remark))

    @property
    def table(self) -> PartTable:
        """Arrays of all parts in the world frame."""
        table = self._table
        if table is None:
            source = self._source
            table = (
                _build_table(self.obstacles) if source is None else _update_table(source, self.obstacles, self._changed)
            )
            object.__setattr__(self, "_table", table)
        return table

    def obstacle(self, name: str) -> Obstacle:
        """The obstacle of that name; `SceneError` if there is none."""
        return self.obstacles[self._place(name)]

    def moves(self, name: str) -> bool:
        """Whether there is an obstacle of that name, and it moves."""
        return name in self and self.obstacle(name).motion is not None

    def at(self, t: float) -> Scene:
        """Snapshot at time ``t`` [s]: moving obstacles at their poses then; the others are the same objects."""
        t = check_time("time", t)
        obstacles = tuple(o if o.motion is None else o.at(t) for o in self.obstacles)
        pairs = enumerate(zip(obstacles, self.obstacles, strict=True))
        return self._derived(obstacles, t, tuple(k for k, (new, old) in pairs if new is not old))

    def moved(self, name: str, pose: object) -> Scene:
        """Snapshot with one obstacle at another ``pose`` T_world_obstacle (4, 4) [m] (or a ``pin.SE3``).

        A twist goes on from there; an obstacle with `Keyframes` is back on its track at the next `at`.
        """
        k = self._place(name)
        old = self.obstacles
        new = old[k].moved(pose, time=self.time)  # a static obstacle keeps the time it was made for
        return self._derived((*old[:k], new, *old[k + 1 :]), self.stamp, (k,))

    def with_observations(self, obstacles: Iterable[Obstacle]) -> Scene:
        """Snapshot in which these take the place of obstacles of the same names: copies of them, elsewhere or moving.

        Raises:
            SceneError: an obstacle that is not a copy of the one of its name.
        """
        new, places = list(self.obstacles), []
        for obstacle in obstacles:
            k = self._place(obstacle.name or "")
            if obstacle.solid is not new[k].solid:
                raise SceneError(f"obstacle {obstacle.name!r} is not a copy of the scene's: it has other parts")
            new[k] = obstacle
            places.append(k)
        return self._derived(tuple(new), self.stamp, tuple(sorted(places)))

    def with_obstacle(self, obstacle: Obstacle) -> Scene:
        """Snapshot with one more obstacle, named if it has no name; a moving one is taken to the scene's time.

        Raises:
            SceneError: it is not an obstacle, or its name is taken.
        """
        if not isinstance(obstacle, Obstacle):
            raise SceneError(f"this is not an obstacle (Box, Sphere, …): {shown(obstacle)}")
        if obstacle.name is None:
            obstacle = obstacle.named(_free_name(obstacle.shape, len(self.obstacles), self._places))
        elif obstacle.name in self._places:
            raise SceneError(f"there already is an obstacle {obstacle.name!r} in the scene; names must be unique")
        count, table, obstacle = len(self.obstacles), self._known_table(), obstacle.at(self.time)
        new = _filled(
            object.__new__(Scene),
            (*self.obstacles, obstacle),
            self.stamp,
            (*self.names, obstacle.name or ""),
            self._said,
        )
        object.__setattr__(new, "_index", {**self._places, new.names[-1]: count})
        if table is not None:
            joined = _joined_table(((table, 0, count), (_build_table((obstacle,)), 0, 1)))
            object.__setattr__(new, "_table", joined)
        return new

    def without(self, name: str) -> Scene:
        """Snapshot without the obstacle of that name; `SceneError` if there is none."""
        k, table = self._place(name), self._known_table()
        obstacles, names = self.obstacles, self.names
        left = (*obstacles[:k], *obstacles[k + 1 :])
        new = _filled(object.__new__(Scene), left, self.stamp, (*names[:k], *names[k + 1 :]), self._said)
        if table is not None:
            joined = _joined_table(((table, 0, k), (table, k + 1, len(obstacles))))
            object.__setattr__(new, "_table", joined)
        return new

    @property
    def seen(self) -> Scene:
        """The scene without what stands for what no sensor has seen (`UNSEEN_LAYER`); this one where there is none."""
        seen = self._seen
        if seen is None:
            kept = [k for k, name in enumerate(self.names) if not name.startswith(f"{UNSEEN_LAYER}-")]
            seen = "all"  # and not the scene itself, which would keep itself alive
            if len(kept) < len(self.names):
                obstacles, names = tuple(self.obstacles[k] for k in kept), tuple(self.names[k] for k in kept)
                seen = _filled(object.__new__(Scene), obstacles, self.stamp, names, self._said)
                object.__setattr__(seen, "_seen", "all")
                ends = [k for k in range(1, len(kept)) if kept[k] != kept[k - 1] + 1]
                runs = [(self.table, kept[a], kept[b - 1] + 1) for a, b in pairwise([0, *ends, len(kept)]) if a < b]
                if runs:  # who asks for what was seen asks for all as well: of both tables one is made
                    object.__setattr__(seen, "_table", _joined_table(runs))
            object.__setattr__(self, "_seen", seen)
        return self if isinstance(seen, str) else seen

    def rows_changed_since(self, earlier: Scene) -> Indices | None:
        """Rows of `table` whose pose differs from an ``earlier`` snapshot's; None if the scenes have other obstacles.

        Costs next to nothing for a snapshot derived directly from ``earlier``.
        """
        if earlier is self:
            return np.zeros(0, dtype=np.intp)
        if self._source is not None and self._source is earlier._table:
            offsets = self._source.offsets
            rows = [np.arange(offsets[k], offsets[k + 1], dtype=np.intp) for k in self._changed]
            return np.concatenate(rows) if rows else np.zeros(0, dtype=np.intp)
        old, new = earlier.table, self.table
        if new.parts is not old.parts and new.parts != old.parts:
            return None
        changed = np.zeros(len(new), dtype=bool)
        changed[np.flatnonzero((new.translation != old.translation).ravel()) // 3] = True
        changed[np.flatnonzero((new.rotation != old.rotation).ravel()) // 9] = True
        return np.flatnonzero(changed)

    def _place(self, name: str) -> int:
        try:
            return self._places[name]
        except (KeyError, TypeError):
            raise SceneError(f"no obstacle {name!r} in the scene{nearest_name(name, self.names)}") from None

    @property
    def _places(self) -> dict[str, int]:
        """Name → place."""
        index = self._index
        if index is None:
            index = dict(zip(self.names, range(len(self.names)), strict=True))
            object.__setattr__(self, "_index", index)
        return index

    @property
    def _said(self) -> tuple[str, str]:
        """What is said about the scene: `held_up` and `remark`."""
        return self.held_up, self.remark

    def _known_table(self) -> PartTable | None:
        """The table, unless it had to be made from scratch."""
        return None if self._table is None and self._source is None else self.table

    def _derived(self, obstacles: tuple[Obstacle, ...], stamp: float | None, changed: tuple[int, ...]) -> Scene:
        """Snapshot that differs in the poses of the ``changed`` obstacles."""
        if self._table is not None or self._source is None:  # all that is derived from this one derives its table
            source = self.table
        else:
            source, changed = self._source, tuple(sorted({*changed, *self._changed}))
        said = self._said if stamp == self.stamp else ("", "")
        new = _filled(object.__new__(Scene), obstacles, stamp, self.names, said, source, changed)
        object.__setattr__(new, "_index", self._index)
        if source is not None and not changed:
            object.__setattr__(new, "_table", source)
        return new

    def __len__(self) -> int:
        return len(self.obstacles)

    def __iter__(self) -> Iterator[Obstacle]:
        return iter(self.obstacles)

    def __contains__(self, name: object) -> bool:
        return name in self._places if isinstance(name, str) else any(o is name for o in self.obstacles)

    def __repr__(self) -> str:
        names = shortened(", ".join(self.names[:8]) + (", …" if len(self.names) > 8 else ""))
        return f"Scene({plural(len(self.obstacles), 'obstacle')} at t = {self.time:g} s: {names})"

    def _repr_html_(self) -> str:
        rows = {o.name or "": f"{o.shape} at {np.round(o.pose[:3, 3], 3).tolist()} m" for o in self.obstacles[:20]}
        rest = len(self.obstacles) - len(rows)
        return table(f"Scene at t = {self.time:g} s", {**rows, **({"…": f"{rest} more"} if rest else {})})

    def __setattr__(self, key: str, value: object) -> None:
        raise AttributeError(f"Scene is immutable; {key!r} cannot be set. Use moved, at, with_obstacle or without")

    def __delattr__(self, key: str) -> None:
        raise AttributeError(f"Scene is immutable; {key!r} cannot be deleted")

    def __reduce__(self) -> tuple[object, ...]:
        return _made, (self.obstacles, self.stamp, self._said)


@named_arguments
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class World(Summary):
    """Obstacles that move, appear and vanish: an obstacle exists from ``appears`` on, until ``vanishes``.

    Args:
        scene: All obstacles, whenever they exist.
        appears: Name → time [s]; an obstacle that is not named has always been there.
        vanishes: Name → time [s] from which on it is gone; an obstacle that is not named stays for ever.

    Attributes:
        event_times: Times [s], ascending, at which something appears or vanishes.

    Raises:
        SceneError: A name that the scene does not have, a time that is not finite, or an obstacle that vanishes before
            or when it appears.

    Examples:
        >>> cart = es.Box((0.6, 0.4, 0.9), at=(0.0, 1.0, 0.45), name="cart", motion=es.Twist(linear=(0.5, 0.0, 0.0)))
        >>> world = es.World(es.Scene([cart]), appears={"cart": 2.0})
        >>> world.at(0.0).names, world.at(3.0).names
        ((), ('cart',))
        >>> float(world.at(3.0).obstacle("cart").pose[0, 3])  # it has come this far [m]
        1.5
    """

    scene: Scene
    appears: Mapping[str, float] = field(default_factory=dict)
    vanishes: Mapping[str, float] = field(default_factory=dict)
    event_times: tuple[float, ...] = field(init=False, repr=False)
    _latest: dict[int, Scene] = field(init=False, repr=False)  # number of events passed → newest snapshot made

    def __post_init__(self) -> None:
        if not isinstance(self.scene, Scene):
            raise SceneError(f"World needs a Scene, not {shown(self.scene)}")
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
        object.__setattr__(self, "event_times", tuple(events))
        object.__setattr__(self, "_latest", {})

    def at(self, t: float) -> Scene:
        """Snapshot at time ``t`` [s]: the obstacles that exist then, at their poses.

        Between two times at which something appears or vanishes, a snapshot is derived from the one made before it, so
        that it shares what did not move and `Scene.rows_changed_since` costs next to nothing.
        """
        t = check_time("time", t)
        phase = bisect_right(self.event_times, t)
        latest = self._latest.get(phase)
        if latest is None:
            there = [o for o in self.scene if self.exists(o.name or "", t)]
            latest = self.scene if len(there) == len(self.scene) else Scene(there, time=self.scene.stamp)
        if latest.stamp != t:
            latest = latest.at(t)
        self._latest[phase] = latest
        return latest

    def exists(self, name: str, t: float) -> bool:
        """Whether the obstacle of that name exists at ``t`` [s]; `SceneError` if there is none of that name."""
        if name not in self.scene:
            raise SceneError(f"no obstacle {shown(name)} in the world{nearest_name(name, self.scene.names)}")
        return self.appears.get(name, -math.inf) <= t < self.vanishes.get(name, math.inf)

    def copied(self, *, history: bool = True) -> World:
        """A world with own copies of every `PedestrianMotion`; the world itself where there are none.

        Args:
            history: Whether the copies keep their history.
        """
        new = []
        for obstacle in self.scene:
            if isinstance(obstacle.motion, PedestrianMotion):
                motion = obstacle.motion.copy(history=history)
                pose = motion.pose(obstacle.anchor, obstacle.time)
                pose.flags.writeable = False
                new.append(obstacle.observed(pose, motion))
        return World(self.scene.with_observations(new), self.appears, self.vanishes) if new else self

    def forget(self) -> None:
        """Drop cached snapshots, after the history of a `PedestrianMotion` was deleted."""
        self._latest.clear()

    @property
    def names_moving(self) -> tuple[str, ...]:
        """Names of the obstacles that have a motion, known or not."""
        return tuple(o.name or "" for o in self.scene if o.motion is not None)

    @property
    def names_resting(self) -> tuple[str, ...]:
        """Names of the obstacles that have no motion, and are there all the time."""
        come_or_go = {*self.appears, *self.vanishes}
        return tuple(o.name or "" for o in self.scene if o.motion is None and o.name not in come_or_go)

    def speed_bound(self, name: str | None = None, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of any point of an obstacle while it exists between ``start`` and ``end`` [s].

        Args:
            name: Name of the obstacle; the largest speed of all of them where None.
            start: Begin of the interval; None is minus infinity.
            end: Its end; None is plus infinity.

        Returns:
            The bound; 0 where nothing moves, infinity where a loop of keyframes jumps.

        Raises:
            SceneError: An unknown name, or an interval that ends before it begins.
        """
        low = -math.inf if start is None else check_time("start", start)
        high = math.inf if end is None else check_time("end", end)
        if not low <= high:
            raise SceneError(f"speed_bound needs start <= end, not {low:g} and {high:g} s")
        if name is not None:
            self.exists(name, 0.0)  # refuses an unknown name
        fastest = 0.0
        for obstacle in self.scene if name is None else (self.scene.obstacle(name),):
            begin = max(low, self.appears.get(obstacle.name or "", -math.inf))
            stop = min(high, self.vanishes.get(obstacle.name or "", math.inf))
            if obstacle.motion is not None and begin <= stop:
                fastest = max(fastest, obstacle.speed_bound(start=begin, end=stop))
        return fastest

    def __reduce__(self) -> tuple[object, ...]:
        return World, (self.scene, dict(self.appears), dict(self.vanishes))


def _made(obstacles: tuple[Obstacle, ...], stamp: float | None, said: tuple[str, str]) -> Scene:
    """A scene of named obstacles at their poses."""
    return _filled(object.__new__(Scene), obstacles, stamp, tuple(o.name or "" for o in obstacles), said)


def _filled(
    scene: Scene,
    obstacles: tuple[Obstacle, ...],
    stamp: float | None,
    names: tuple[str, ...],
    said: tuple[str, str],
    source: PartTable | None = None,
    changed: tuple[int, ...] = (),
) -> Scene:
    """Fill the new scene with its values."""
    put = object.__setattr__
    put(scene, "obstacles", obstacles)
    put(scene, "names", names)
    put(scene, "stamp", stamp)
    put(scene, "time", 0.0 if stamp is None else stamp)
    put(scene, "held_up", said[0])
    put(scene, "remark", said[1])
    put(scene, "_index", None)
    put(scene, "_table", None)
    put(scene, "_source", source)
    put(scene, "_changed", changed)
    put(scene, "_seen", None)
    return scene


def _named_twice(names: Sequence[str | None]) -> SceneError:
    """The error about the first name in ``names`` that has been there before."""
    first: dict[str, int] = {}
    k, name = next((k, n) for k, n in enumerate(names) if n is not None and first.setdefault(n, k) != k)
    return SceneError(f"obstacles {first[name]} and {k} are both named {name!r}; names must be unique")


def _free_name(shape: str, place: int, taken: Container[str]) -> str:
    while f"{shape}-{place}" in taken:
        place += 1
    return f"{shape}-{place}"


def _times(scene: Scene, what: str, given: object) -> dict[str, float]:
    if not isinstance(given, Mapping):
        raise SceneError(f"World {what} must be a mapping from names to times [s], not {shown(given)}")
    times = {}
    for name, value in given.items():
        if name not in scene or not isinstance(name, str):
            raise SceneError(f"World {what}: no obstacle {shown(name)} in the scene{nearest_name(name, scene.names)}")
        times[name] = check_time(f"{what} of {name!r}", value)
    return times
