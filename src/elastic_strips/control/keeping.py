"""Keeping: joints that go on satisfying the strip's constraint where the base drives beside the strip.

A motion beside the strip is made for its base. Its joints are moved to where they satisfy the constraint at some of its
poses, by the least motion, and follow these as fast as their limits allow.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.braking import brought_to_rest

_KEPT_AT = (0.0, 0.1, 0.2, 0.4, 0.8)
"""Times [s] after the beginning of a motion at which its joints are to satisfy the constraint; at its end besides. The
next tick replans, and so the first ones count most."""
_STEPS = 6
"""Newton's steps to there: what is turned further than these can follow is not reached by the joints either."""
_SEARCH_EVERY, _SEARCHED = 5, 16
"""Where no other posture is known, so many random ones are tried, each time that so many ticks found none."""
_LOOKS = 5  # at the way from one posture to another
_SOON = 3
"""Of these times so many have to be satisfied; else the joints turn to another posture."""
_SLOWED = 2.0
"""Beside a strip the base goes so many times more slowly than it can, at most, while joints turn to where they are to
be."""
_FOLLOWING_GAIN = 8.0  # [1/s] with which joints catch up
_BRAKED_SHARE = 0.8  # of their acceleration, with which they come to where they are to be, and to the ends of ranges
_SPEED_SHARE = 0.95  # of their speed


class ConstraintKeeper:
    """Workspace: moves the joints of what leads beside the strip to where they satisfy its constraint.

    Args:
        robot, limits: the robot, and the limits of its motors.
        constraint: the strip's.
        self_clearance: distance [m] to keep between the robot's own links.
        dt: time between the samples of motions [s].
    """

    def __init__(
        self, robot: RobotModel, limits: MotionLimits, constraint: ConstraintForce, *, self_clearance: float, dt: float
    ) -> None:
        self.constraint: ConstraintForce = constraint
        self._tolerance = constraint.constraint.tolerance
        self._robot, self._limits, self._dt = robot, limits, dt
        self._posture: Array | None = None
        self._lost = 0
        self._rng = np.random.default_rng(0)
        self._own = ValidityChecker(robot, Scene([]), margin=0.0, self_margin=self_clearance)

    def motions(self, motion: Trajectory, scene: Scene, hold: float, way: Array) -> Iterator[Trajectory]:
        """Motions of the same base of which the joints satisfy the constraint: to the end, or for a time ``hold`` [s],
        after which they brake; and the motion itself, whose joints only brake.

        Args:
            motion: begins beside the strip.
            scene: of the tick.
            hold: see above.
            way: (K, nv) rows from there along the strip, where the joints turn to where they cannot stay.
        """
        start = motion.start_time
        times = start + np.array([t for t in _KEPT_AT if t < motion.duration - self._dt] + [motion.duration])
        rows, free = self._wanted(motion, times, scene, way)
        longest = 1 + [*free, False].index(False)
        for count in dict.fromkeys((longest, min(longest, 1 + int(np.searchsorted(times, start + hold))))):
            kept = self._following(motion, times[:count], rows[:count]) if count > 1 else None
            if kept is not None:
                yield kept
        yield motion

    def _wanted(self, motion: Trajectory, times: Array, scene: Scene, way: Array) -> tuple[Array, list[bool]]:
        """Rows (K, nv) at times (K,) [s] of a motion, to which joints turn, and of all but the first whether the
        robot's own links are apart."""
        b, coordinates = self._robot.space.base_nv, motion.coordinates_at(times)
        places = self.constraint.places_at(scene, times)
        rows, off = self.constraint.project(coordinates, places=places, steps=_STEPS)
        free = [self._own.at(row) for row in rows[1:]]
        self._own.count()
        if off[:_SOON].max() <= self._tolerance and all(free[: _SOON - 1]):
            self._posture = None
            return rows, free
        k = min(_SOON, len(times) - 1)
        posture = self._other(coordinates[k], None if places is None else places[k], way)
        if posture is None:
            return rows, free
        coordinates[1:, b:] = posture
        return coordinates, [True] * (len(times) - 1)

    def _other(self, row: Array, place: Array | None, way: Array) -> Array | None:
        """(n,) joints that satisfy the constraint at the base of a row (nv,) in another posture, to which the robot's
        own links let them turn; None where none are known."""
        b, space = self._robot.space.base_nv, self._robot.space
        seeds = [self._turned_to(way)] if self._posture is None else [self._posture, self._turned_to(way)]
        found = self._best(row, place, np.array(seeds))
        self._lost += 1
        if found is None and self._lost % _SEARCH_EVERY == 1:
            low, high = np.maximum(space.lower[b:], -np.pi), np.minimum(space.upper[b:], np.pi)
            found = self._best(row, place, self._rng.uniform(low, high, (_SEARCHED, len(low))))
        self._posture = found
        return found

    def _best(self, row: Array, place: Array | None, seeds: Array) -> Array | None:
        b = self._robot.space.base_nv
        rows = np.tile(row, (len(seeds), 1))
        rows[:, b:] = seeds
        places = None if place is None else np.tile(place, (len(seeds), 1))
        rows, off = self.constraint.project(rows, places=places, steps=_STEPS)
        took = (np.abs(rows - row)[:, b:] / self._limits.joint_speed).max(axis=1)
        for k in np.argsort(np.where(off <= self._tolerance, took, np.inf)).tolist():
            if off[k] > self._tolerance:
                break
            between = row + np.linspace(0.0, 1.0, _LOOKS + 1)[1:, None] * (rows[k] - row)
            free = all(self._own.at(each) for each in between[::-1])
            self._own.count()
            if free:
                return rows[k, b:]
        return None

    def _turned_to(self, way: Array) -> Array:
        """(n,) joints of the first row of a way (K, nv) that satisfies the constraint; of the last where none does."""
        satisfied = self.constraint.errors_at(way) <= self._tolerance
        return way[int(satisfied.argmax()) if satisfied.any() else -1, self._robot.space.base_nv :]

    def path(self, coordinates: Array) -> Array:
        """Rows (N, nv) whose inner ones have their joints where they satisfy the constraint, by the least motion.

        Where that does not lead to it, they are moved to it from before or from after such rows: then the joints turn
        from one posture to the other between two rows. What remains is put between its neighbours.
        """
        n, b = len(coordinates), self._robot.space.base_nv
        out, good = coordinates.copy(), np.ones(n, dtype=bool)
        if n < 3:
            return out
        out[1:-1], good[1:-1] = self._moved(coordinates[1:-1])
        edges = np.flatnonzero(np.diff(good.astype(int)))
        for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):  # good ones beside a run
            run = slice(first + 1, last + 1)
            sides = []
            for beside in (first, last + 1):
                row = coordinates[run].copy()
                row[:, b:] = out[beside, b:]
                sides.append(self._moved(row))
            (before, well), (after, fine) = sides
            counts = np.append(0, np.cumsum(well)) + np.append(np.cumsum(fine[::-1])[::-1], 0)
            ends = np.vstack([out[first], before])[:, b:], np.vstack([after, out[last + 1]])[:, b:]
            turn = np.abs(ends[0] - ends[1]).max(axis=1)
            k = int(np.lexsort((turn, -counts))[0])
            out[run] = np.vstack([before[:k], after[k:]])
            good[run] = np.append(well[:k], fine[k:])
        if not good.all():
            (known,), (left,) = np.nonzero(good), np.nonzero(~good)
            for j in range(b, out.shape[1]):
                out[left, j] = np.interp(left, known, out[known, j])
        return self._eased(out)

    def _eased(self, rows: Array) -> Array:
        """Rows (N, nv) to whose joints those of the first one go over on the first part of the way, so that the robot
        need not stop there."""
        limits, b = self._limits, self._robot.space.base_nv
        steps = limits.to_coordinates(self._robot.space.difference(rows[:-1], rows[1:]))[:, : limits.drive_dim]
        seconds = np.append(0.0, np.cumsum((np.abs(steps) / limits.drive_speed).max(axis=1, initial=0.0)))
        turn = rows[:, b:] - rows[0, b:]
        needed = (np.abs(turn) / limits.joint_speed).max(axis=1, initial=0.0)
        part = np.minimum(_SLOWED * seconds / np.maximum(needed, 1e-9), 1.0)[1:-1]
        rows[1:-1, b:] = rows[0, b:] + part[:, None] * turn[1:-1]
        return rows

    def _moved(self, coordinates: Array) -> tuple[Array, Mask]:
        """Rows (N, nv) moved to where they satisfy the constraint, and which do, with their own links apart."""
        rows, off = self.constraint.project(coordinates, steps=_STEPS)
        good = off <= self._tolerance
        for k in np.flatnonzero(good).tolist():
            good[k] = self._own.at(rows[k])
        self._own.count()
        return rows, good

    def _following(self, motion: Trajectory, times: Array, rows: Array) -> Trajectory | None:
        """A motion of the same base whose joints follow rows (K, nv) at times (K,) [s], and then brake; None where they
        would leave their ranges."""
        limits = self._limits
        rates = limits.to_coordinates(motion.v)
        rates[:, limits.drive_dim :] = self._rates(motion, times, rows[:, self._robot.space.base_nv :])
        start = ReferenceState(motion.start_time, motion.coordinates[0], motion.v[0], motion.a[0])
        return brought_to_rest(self._robot, limits, start, rates, limits.acceleration * self._dt, self._dt)

    def _rates(self, motion: Trajectory, times: Array, wanted: Array) -> Array:
        """(N, n) rates of joints at a motion's samples that follow rows (K, n) at times (K,) [s], and then brake."""
        limits, dt, b = self._limits, self._dt, self._robot.space.base_nv
        top, change = _SPEED_SHARE * limits.joint_speed, _BRAKED_SHARE * limits.joint_acceleration * dt
        easy = 0.8 * _BRAKED_SHARE * limits.joint_acceleration
        low, high = self._robot.space.lower[b:], self._robot.space.upper[b:]
        slopes = np.diff(wanted, axis=0) / np.diff(times)[:, None]
        at, v = motion.coordinates[0, b:].copy(), motion.v[0, b:].copy()
        rates = np.empty((len(motion), len(at)))
        rates[0] = v
        for i, t in enumerate(motion.time[:-1].tolist()):
            to = np.zeros_like(v)
            if t < times[-1] - 1e-9:
                j = int(np.searchsorted(times, t + 1e-9, side="right")) - 1
                left = wanted[j] + (t - times[j]) * slopes[j] - at
                catching_up = np.minimum(_FOLLOWING_GAIN * np.abs(left), np.sqrt(2.0 * easy * np.abs(left)))
                to = np.clip(slopes[j] + np.copysign(catching_up, left), -top, top)
                to = np.clip(to, -_stopping(at - low, -v, easy, dt), _stopping(high - at, v, easy, dt))
            after = v + np.clip(to - v, -change, change)
            at, v = at + 0.5 * dt * (v + after), after
            rates[i + 1] = v
        return rates


def _stopping(gap: Array, v: Array, easy: Array, dt: float) -> Array:
    """(n,) next speeds with which joints that go ``v`` (n,) still stop within a gap (n,)."""
    return easy * (np.sqrt(dt * dt + 2.0 * np.maximum(gap - 0.5 * dt * v, 0.0) / easy) - dt)
