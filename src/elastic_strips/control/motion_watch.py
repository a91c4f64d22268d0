"""Motion watch: whether obstacles move as scenes say; those that do not count as of unknown motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.scene import Obstacle, Scene, UnknownMotion
from elastic_strips.work import count_work

from .params import MonitorParams, ObstacleAssumptions

_LONGEST_COMPARISON = 0.5  # [s] from a scene to the one that it is compared with
_STRIKES = 3  # contradictions until an obstacle is suspected: fewer may be a corner, or another thing's name
_STRIKES_FORGOTTEN = 1.0  # [s] after the last one
_ONE_WAY = 0.8  # of all contradictions, added up, that lead the same way
_BEYOND = 2.0  # times what is assumed, that they come to together
_WRONG_FOR = 0.3  # [s] for which a velocity has to be wrong: trackers take time to learn one
_MEASURED_OVER = 0.25  # [s] the time over which the speed of an obstacle is measured
_REACTION_TIME = 1.0  # [s] for which a suspected obstacle may accelerate: about as long as it takes to stop
_ROUND = ("sphere", "cylinder", "capsule", "cone")
_PRIMITIVES = (*_ROUND, "box")


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """What is kept of the obstacles of the last scene, a row for each (M), of two points each.

    Attributes:
        place, half: (M, 2, 3) where the points were in the last scene, (M, 3) the half sizes.
        then, then_place: (M,), (M, 2, 3) time and places that the next scene is compared with.
        velocity, rate, acceleration: (M, 3), (M,), (M,) what was said of its motion then, and how wrong that may be.
        slack: (M,) [m] by which its place may be off because its size has changed since.
        strikes, struck: (M,) how often it was elsewhere than that allows, and when last [s].
        apart, total: (M, 2, 3), (M, 2) these contradictions added up, with and without their directions [m].
        since: (M,) from when on they were [s].
        begun, begun_place: (M,), (M, 2, 3) since when its speed is measured [s], and where it was then.
        seen: (M,) its largest speed while it was elsewhere [m/s].
        suspected: (M,) 1 where its motion counts as unknown.
    """

    place: Array
    half: Array
    then: Array
    then_place: Array
    velocity: Array
    rate: Array
    acceleration: Array
    slack: Array
    strikes: Array
    struck: Array
    apart: Array
    total: Array
    since: Array
    begun: Array
    begun_place: Array
    seen: Array
    suspected: Array

    def put(self, which: Mask, **values: Array | float) -> None:
        """Set the rows of some obstacles."""
        for name, value in values.items():
            getattr(self, name)[which] = value[which] if isinstance(value, np.ndarray) else value


class MotionWatch:
    """Workspace: the scenes so far, obstacle by obstacle.

    A place that its obstacle cannot have come to since an earlier scene, by its stated motion (or none) and the assumed
    errors, contradicts that motion. Three times in a row one way, and the obstacle counts as one of unknown motion: as
    fast as it was seen to be, and as much faster as it may get while a robot stops, until it has agreed for
    ``MonitorParams.motion_trust``. What is further away than anything moves, or where another obstacle was, has got
    another's name. How far a change of size can shift an obstacle is allowed for; what is no simple shape is not
    watched where it changes.

    Args:
        params: how long a suspicion lasts.
        assumptions: what is assumed about obstacles.
    """

    def __init__(self, params: MonitorParams, assumptions: ObstacleAssumptions) -> None:
        self._trust, self._assumptions = params.motion_trust, assumptions
        self._names: tuple[str, ...] = ()
        self._time = -np.inf
        self._rows: _Rows | None = None
        self._scene: Scene | None = None
        self._solids: Sequence[object] = ()
        self._checked: Scene = Scene([])
        self._suspects: dict[str, float] = {}  # name → speed bound [m/s]

    def checked(self, t: float, scene: Scene) -> tuple[Scene, tuple[str, ...]]:
        """A scene in which obstacles that contradict their motions have an unknown one.

        Args:
            t: time [s]; that of a scene without one.
            scene: the newest one.

        Returns:
            The scene, and what is wrong with obstacles that were not suspected yet.
        """
        if scene is self._scene:
            return self._checked, ()
        self._scene = scene
        time = t if scene.stamp is None else scene.time
        found = self._compare(time, scene) if time > self._time else ()
        if not self._suspects:
            self._checked = scene
        else:
            suspects = (scene.obstacle(name) for name in self._suspects if name in scene)
            wrong = [o.observed(o.pose, UnknownMotion(self._suspects[o.name or ""])) for o in suspects]
            self._checked = scene.with_observations(wrong)
        return self._checked, found

    def _compare(self, time: float, scene: Scene) -> tuple[str, ...]:
        """Bring the rows up to date, and say which obstacles are suspected from now on, and why."""
        count_work(obstacles=len(scene))
        now, before = self._measured(time, scene), self._known(scene.names)
        self._names, solids = scene.names, [o.solid for o in scene]
        step_time, self._time = time - self._time, time
        if before is None:
            self._rows, self._solids = now, solids
            return ()
        (rows, known), a = before, self._assumptions
        pairs = zip(solids, self._solids, scene, strict=True)
        known &= np.array([solid is old or o.shape in _PRIMITIVES for solid, old, o in pairs], dtype=bool)
        self._solids = solids
        resized = np.linalg.norm(now.half - rows.half, axis=1)
        rows.slack[:] += resized
        step = np.linalg.norm(now.place - rows.place, axis=2).max(axis=1)
        known &= step <= 2.0 * a.position_error + resized + a.max_speed * step_time
        span = time - rows.then
        off = now.place - rows.then_place - (span[:, None] * rows.velocity)[:, None]
        allowed = self._allowed(rows, span)
        struck = known & (np.linalg.norm(off, axis=2).max(axis=1) > allowed)
        for k in np.flatnonzero(struck):  # few: whether another obstacle was where this one is now
            other = np.linalg.norm(rows.place[:, 0] - now.place[k, 0], axis=1)
            other[k] = np.inf
            known[k] = struck[k] = other.min(initial=np.inf) >= step[k]
        self._strike(time, now, rows, off, struck)
        fresh = {name: getattr(now, name) for name in ("velocity", "rate", "acceleration", "then")}
        stale = struck | ~known | (span >= _LONGEST_COMPARISON)
        rows.put(stale, **fresh, then_place=now.place, slack=0.0)
        rows.put(~known, strikes=0.0, suspected=0.0, begun=now.begun, begun_place=now.place)
        rows.place[:], rows.half[:] = now.place, now.half
        self._rows = rows
        return self._judge(scene, rows, off, allowed, span)

    def _allowed(self, rows: _Rows, span: Array) -> Array:
        """(M,) how far [m] obstacles may be from where their stated motions take them in times ``span`` (M,) [s]."""
        a = self._assumptions
        wrong = np.minimum(rows.rate * span + 0.5 * rows.acceleration * span**2, 2.0 * a.max_speed * span)
        return 2.0 * a.position_error + rows.slack + wrong

    def _strike(self, time: float, now: _Rows, rows: _Rows, off: Array, struck: Mask) -> None:
        """Count contradictions, measure the speeds of the obstacles, and decide whom to suspect."""
        remembered = np.where(rows.suspected > 0.0, self._trust, _STRIKES_FORGOTTEN)
        rows.put(time - rows.struck > remembered, strikes=0.0, suspected=0.0)
        rows.put(rows.strikes == 0.0, apart=0.0, total=0.0, seen=0.0, since=rows.then)
        if struck.any():
            rows.put(struck, strikes=rows.strikes + 1.0, struck=time)
            rows.put(struck, apart=rows.apart + off, total=rows.total + np.linalg.norm(off, axis=2))
            far, noise = np.linalg.norm(rows.apart, axis=2), 2.0 * self._assumptions.position_error
            ways = [now.place - rows.then_place, now.place - rows.begun_place]
            just_now, longer = (np.linalg.norm(way, axis=2).max(axis=1) for way in ways)
            just_now = (just_now - noise) / np.maximum(time - rows.then, 1e-9)
            longer = (longer + noise) / np.maximum(time - rows.begun, 1e-9)
            rows.put(struck, seen=np.maximum(rows.seen, np.maximum(just_now, longer)))
            beyond = (far >= _ONE_WAY * rows.total) & (far > _BEYOND * self._allowed(rows, time - rows.since)[:, None])
            long_enough = ~rows.velocity.any(axis=1) | (time - rows.since >= _WRONG_FOR - 1e-6)
            rows.put(struck & beyond.any(axis=1) & (rows.strikes >= _STRIKES) & long_enough, suspected=1.0)
        rows.put(time - rows.begun >= _MEASURED_OVER, begun=now.begun, begun_place=now.place)

    def _judge(self, scene: Scene, rows: _Rows, off: Array, allowed: Array, span: Array) -> tuple[str, ...]:
        """Note whom to suspect, and say why of those who are new."""
        a, found, suspects = self._assumptions, [], {}
        for k in np.flatnonzero(rows.suspected):
            name = scene.names[k]
            bound = suspects[name] = min(float(rows.seen[k]) + a.acceleration * _REACTION_TIME, a.max_speed)
            if name not in self._suspects:
                far = float(np.linalg.norm(off[k], axis=1).max())
                found.append(
                    f"obstacle {name!r} is {1e3 * far:.0f} mm from where it {_said(scene.obstacles[k])}, after "
                    f"{span[k]:.2f} s, for which {1e3 * allowed[k]:.0f} mm are assumed; its motion now counts as "
                    f"unknown, with up to {bound:.1f} m/s{_perhaps(scene.obstacles[k], off[k, 0], float(span[k]))}"
                )
        self._suspects = suspects
        return tuple(found)

    def _measured(self, time: float, scene: Scene) -> _Rows:
        """Rows of a scene's obstacles, with nothing known of their past."""
        a, table, count = self._assumptions, scene.table, len(scene)
        first = table.offsets[:-1]
        velocity, rate, acceleration = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
        for k, obstacle in enumerate(scene.obstacles):
            if obstacle.motion is None:
                continue
            if isinstance(obstacle.motion, UnknownMotion):
                rate[k] = obstacle.motion.max_speed
                continue
            linear, angular = obstacle.velocity()
            velocity[k] = linear
            rate[k] = a.velocity_error + float(np.linalg.norm(angular)) * obstacle.reach
            acceleration[k] = a.acceleration
        half, turn, rows = table.local_half[first], table.rotation[first], np.arange(count)
        longest = np.array([2 if o.shape in _ROUND else -1 for o in scene], dtype=np.intp)
        longest = np.where(longest < 0, half.argmax(axis=1) if count else longest, longest)
        tip = turn[rows, :, longest] * half[rows, longest][:, None]
        place = table.center[first][:, None] + np.stack([np.zeros_like(tip), tip], axis=1)
        times, none = np.full(count, time), np.zeros(count)
        return _Rows(
            place=place,
            half=half,
            then=times,
            then_place=place.copy(),
            velocity=velocity,
            rate=rate,
            acceleration=acceleration,
            slack=none,
            strikes=none.copy(),
            struck=np.full(count, -np.inf),
            apart=np.zeros_like(place),
            total=np.zeros((count, 2)),
            since=times.copy(),
            begun=times.copy(),
            begun_place=place.copy(),
            seen=none.copy(),
            suspected=none.copy(),
        )

    def _known(self, names: tuple[str, ...]) -> tuple[_Rows, Mask] | None:
        """The rows of the obstacles of these names, and which of them there are."""
        rows = self._rows
        if rows is None or not self._names:
            return None
        if names == self._names:
            return rows, np.ones(len(names), dtype=bool)
        place = {name: k for k, name in enumerate(self._names)}
        index = np.array([place.get(name, -1) for name in names], dtype=np.intp)
        self._solids = [self._solids[k] if k >= 0 else None for k in index]
        picked = {f.name: getattr(rows, f.name)[index] for f in fields(_Rows)}
        return replace(rows, **picked), index >= 0


def _said(obstacle: Obstacle) -> str:
    """Where an obstacle ought to be by its stated motion, in words."""
    if obstacle.motion is None:
        return "would be if it stood still, as the scene says"
    if isinstance(obstacle.motion, UnknownMotion):
        return f"was, although it is said to have at most {obstacle.motion.max_speed:.1f} m/s"
    return f"would be at its stated {float(np.linalg.norm(obstacle.velocity()[0])):.2f} m/s"


def _perhaps(obstacle: Obstacle, off: Array, span: float) -> str:
    """What the caller may have got wrong, where an obstacle moves twice as fast as it is said to: off (3,) [m] within a
    time [s]; empty where it does not."""
    expected = span * obstacle.velocity()[0]
    far = float(np.linalg.norm(expected))
    if isinstance(obstacle.motion, UnknownMotion) or float(np.linalg.norm(off - expected)) > 0.25 * far or far == 0.0:
        return ""
    return ". It moves twice as fast as it is said to: at= is where it is at time=, which is 0 where it is not given"
