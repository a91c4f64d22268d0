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
_STRIKES = 2  # contradictions until an obstacle is suspected: a single one may be a corner, or another thing's name
_STRIKES_FORGOTTEN = 1.0  # [s] after the last one
_MEASURED_OVER = 0.25  # [s] the time over which the speed of an obstacle is measured
_REACTION_TIME = 1.0  # [s] for which a suspected obstacle may accelerate: about as long as it takes to stop
_ROUND = ("sphere", "cylinder", "capsule", "cone")
_PRIMITIVES = (*_ROUND, "box")


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """What is kept of the obstacles of the last scene, a row for each.

    Attributes:
        place, turn, half: (M, 3), (M, 3, 3), (M, 3) where the first part of each was in the last scene, and its size.
        then, then_place, then_turn: (M,), … time and pose that the next scene is compared with.
        velocity, rate, acceleration: (M, 3), (M,), (M,) what was said of its motion then, and how wrong that may be.
        slack: (M,) [m] by which its place may be off because its size has changed since.
        strikes, struck: (M,) how often it was elsewhere than that allows, and when last [s].
        begun, begun_place: (M,), (M, 3) since when its speed is measured [s], and where it was then.
        seen: (M,) its largest speed while it was elsewhere [m/s].
    """

    place: Array
    turn: Array
    half: Array
    then: Array
    then_place: Array
    then_turn: Array
    velocity: Array
    rate: Array
    acceleration: Array
    slack: Array
    strikes: Array
    struck: Array
    begun: Array
    begun_place: Array
    seen: Array

    def put(self, which: Mask, **values: Array | float) -> None:
        """Set the rows of some obstacles."""
        for name, value in values.items():
            getattr(self, name)[which] = value[which] if isinstance(value, np.ndarray) else value


class MotionWatch:
    """Workspace: the scenes so far, obstacle by obstacle.

    A pose that its obstacle cannot have come to since an earlier scene, by its stated motion (or none) and the
    assumed errors, contradicts that motion. Twice within a second, and the obstacle counts as one of unknown motion,
    as fast as it was seen to be and as much faster as it may get while a robot stops, until it has agreed for
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
        rows, known = before
        a = self._assumptions
        same, self._solids = self._same(scene, solids, known), solids
        resized = np.linalg.norm(now.half - rows.half, axis=1)
        rows.put(np.ones(len(known), dtype=bool), slack=rows.slack + resized)
        step = np.linalg.norm(now.place - rows.place, axis=1)
        noise = 2.0 * a.position_error + resized
        known = known & same & (step <= noise + a.max_speed * step_time)
        span = time - rows.then
        apart = np.linalg.norm(now.place - rows.then_place - span[:, None] * rows.velocity, axis=1)
        apart += self._swing(scene, now.turn, rows.then_turn)
        allowed = 2.0 * a.position_error + rows.slack + rows.rate * span + 0.5 * rows.acceleration * span**2
        allowed = np.minimum(allowed, 2.0 * (a.position_error + a.max_speed * span) + rows.slack)
        struck = known & (apart > allowed)
        for k in np.flatnonzero(struck):  # few: whether another obstacle was where this one is now
            other = np.linalg.norm(rows.place - now.place[k], axis=1)
            other[k] = np.inf
            known[k] = struck[k] = other.min(initial=np.inf) >= step[k]
        self._strike(time, now, rows, struck)
        stale = struck | ~known | (span >= _LONGEST_COMPARISON)
        rows.put(
            stale,
            then=now.then,
            then_place=now.place,
            then_turn=now.turn,
            velocity=now.velocity,
            rate=now.rate,
            acceleration=now.acceleration,
            slack=0.0,
        )
        rows.put(~known, strikes=0.0, struck=-np.inf, begun=now.begun, begun_place=now.place, seen=0.0)
        rows.put(np.ones(len(known), dtype=bool), place=now.place, turn=now.turn, half=now.half)
        self._rows = rows
        return self._judge(time, scene, rows, apart, allowed, span)

    def _strike(self, time: float, now: _Rows, rows: _Rows, struck: Mask) -> None:
        """Count contradictions, and measure the speeds of the obstacles."""
        remembered = np.where(rows.strikes >= _STRIKES, self._trust, _STRIKES_FORGOTTEN)
        rows.put(time - rows.struck > remembered, strikes=0.0, seen=0.0)
        rows.put(struck, strikes=rows.strikes + 1.0, struck=time)
        noise, lately = 2.0 * self._assumptions.position_error, np.maximum(time - rows.then, 1e-9)
        just_now = (np.linalg.norm(now.place - rows.then_place, axis=1) - noise) / lately
        longer = (np.linalg.norm(now.place - rows.begun_place, axis=1) + noise) / np.maximum(time - rows.begun, 1e-9)
        rows.put(struck, seen=np.maximum(rows.seen, np.maximum(just_now, longer)))
        rows.put(time - rows.begun >= _MEASURED_OVER, begun=now.begun, begun_place=now.place)

    def _judge(
        self, time: float, scene: Scene, rows: _Rows, apart: Array, allowed: Array, span: Array
    ) -> tuple[str, ...]:
        """Whom to suspect, and why."""
        a, found, suspects = self._assumptions, [], {}
        for k in np.flatnonzero((rows.strikes >= _STRIKES) & (time - rows.struck <= self._trust)):
            name, obstacle = scene.names[k], scene.obstacles[k]
            bound = min(float(rows.seen[k]) + a.acceleration * _REACTION_TIME, a.max_speed)
            suspects[name] = bound
            if name not in self._suspects:
                found.append(
                    f"obstacle {name!r} is {1e3 * apart[k]:.0f} mm from where it {_said(obstacle)}, after "
                    f"{span[k]:.2f} s, for which {1e3 * allowed[k]:.0f} mm are assumed; its motion counts as unknown, "
                    f"up to {bound:.1f} m/s"
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
        place, turn, times = table.center[first], table.rotation[first], np.full(count, time)
        return _Rows(
            place=place,
            turn=turn,
            half=table.local_half[first],
            then=times,
            then_place=place.copy(),
            then_turn=turn.copy(),
            velocity=velocity,
            rate=rate,
            acceleration=acceleration,
            slack=np.zeros(count),
            strikes=np.zeros(count),
            struck=np.full(count, -np.inf),
            begun=times.copy(),
            begun_place=place.copy(),
            seen=np.zeros(count),
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

    def _same(self, scene: Scene, solids: Sequence[object], known: Mask) -> Mask:
        """Which obstacles can be compared: those that have the same parts as before, or are of one simple part."""
        pairs = zip(solids, self._solids, scene.obstacles, strict=True)
        return known & np.array([s is old or o.shape in _PRIMITIVES for s, old, o in pairs], dtype=bool)

    def _swing(self, scene: Scene, turn: Array, before: Array) -> Array:
        """How far [m] an obstacle's points have moved because it has turned."""
        swung = np.zeros(len(turn))
        changed = np.flatnonzero((turn != before).any(axis=(1, 2)))
        for k in changed:
            obstacle: Obstacle = scene.obstacles[k]
            if obstacle.shape not in _ROUND:
                swung[k] = obstacle.reach * float(np.linalg.norm(turn[k] - before[k])) / np.sqrt(2.0)
        return swung


def _said(obstacle: Obstacle) -> str:
    """Where an obstacle ought to be by its stated motion, in words."""
    if obstacle.motion is None:
        return "has stood by what is said of it"
    if isinstance(obstacle.motion, UnknownMotion):
        return f"was, with at most {obstacle.motion.max_speed:.1f} m/s"
    return f"is by its stated {float(np.linalg.norm(obstacle.velocity()[0])):.2f} m/s"
