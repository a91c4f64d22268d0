"""EvasivePlanner: short motions of the base that avoid moving obstacles.

A few hundred manoeuvres are rolled out some seconds ahead and compared by risk and by progress towards the goal. Only
a certified motion is driven: one that follows the best manoeuvre for a while, and ends at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import Forecast
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.robot.space import wrap_angle
from elastic_strips.scene import Scene
from elastic_strips.trajectory import MotionLimits
from elastic_strips.trajectory.path import integrate_travel
from elastic_strips.trajectory.trajectory import ReferenceState, Trajectory, TrajectoryCertifier

from .lookahead import ObstacleLookahead
from .pace import Pace
from .params import EvasionParams
from .prediction import ArrivalTimes
from .strip_timer import PlanOutcome, PlanResult, fastest_drive

_REACH = 0.95
"""Largest speeds of manoeuvres, as a part of the limits."""
_DRIVES = (-1.0, -0.6, -0.25, 0.0, 0.25, 0.6, 1.0)  # parts of the largest speed
_TURNS = (-3.0, -1.5, -0.6, 0.0, 0.6, 1.5, 3.0)  # [rad/s]
_ONWARD = ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (1.0, 1.2), (1.0, -1.2))
_CHANGES = (0.4, 1.0)  # times [s] at which the second target replaces the first


@dataclass(frozen=True, slots=True, eq=False)
class _Targets:
    """Two-stage manoeuvres: target speeds that are approached as fast as the motors allow, one after the other.

    Attributes:
        first, second: (N, k) speeds of the drive coordinates [m/s or rad/s].
        change: (N,) time from the beginning [s] at which the second replaces the first.
        kind: (N,) index of each one's first target among the different ones.
    """

    first: Array
    second: Array
    change: Array
    kind: Indices

    def __len__(self) -> int:
        return len(self.change)

    def take(self, which: Mask) -> _Targets:
        """Those of a mask (N,)."""
        return _Targets(self.first[which], self.second[which], self.change[which], self.kind[which])

    @property
    def different(self) -> Array:
        """(D, k) the different first targets, in the order of their kinds."""
        return self.first[np.unique(self.kind, return_index=True)[1]]


def lattice(limits: MotionLimits) -> _Targets:
    """Grid of targets over all speeds of the base, rest included, each followed by several second targets.

    Args:
        limits: of the motors.
    """
    top = _REACH * limits.drive_speed
    if limits.drive_dim == 2:
        v, w = np.meshgrid(np.array(_DRIVES) * top.min(), np.array(_TURNS), indexing="ij")
        first = _within(limits.to_drive(np.stack([v.ravel(), 0.0 * v.ravel(), w.ravel()], axis=1)), top)
        onward = np.array([[v * top.min(), 0.0, w] for v, w in _ONWARD])
        second = _within(limits.to_drive(onward), top)
    else:
        angle = 2.0 * np.pi * np.arange(16) / 16
        around = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]) * top
        first = np.vstack([around, 0.4 * around, np.zeros((1, 3))])
        second = np.vstack([around[::4], np.zeros((1, 3))])
    first = np.unique(first.round(9), axis=0)
    kinds = np.arange(len(first))
    n, m = len(first), len(second)
    changes = np.concatenate([np.full(n, np.inf), np.repeat(_CHANGES, n * m)])
    several = [np.repeat(first, m, axis=0), np.tile(second, (n, 1)), np.repeat(kinds, m)]
    times = len(_CHANGES)
    return _Targets(
        np.vstack([first, *[several[0]] * times]),
        np.vstack([first, *[several[1]] * times]),
        changes,
        np.concatenate([kinds, *[several[2]] * times]).astype(np.intp),
    )


def _roll_out(
    limits: MotionLimits, start: ReferenceState, targets: _Targets, *, part: float, horizon: float, dt: float
) -> Array:
    """Poses (N, T, 3) of the base [m, rad] in N manoeuvres over a horizon [s], in steps of ``dt`` [s].

    ``part`` is that of the acceleration limits.
    """
    change = part * limits.drive_acceleration * dt
    steps = np.arange(round(horizon / dt) + 1)
    speed = _approach(limits.to_drive(start.v[:3])[:, None], targets.first.T, change, steps)
    for when in np.unique(targets.change[np.isfinite(targets.change)]).tolist():
        at = np.flatnonzero(targets.change == when)
        done = min(int(np.ceil(when / dt - 0.5)), len(steps) - 1)  # steps towards the first target
        speed[:, done:, at] = _approach(speed[:, done, at], targets.second[at].T, change, steps[: len(steps) - done])
    return _poses(limits, start, speed, dt)


def _approach(speed: Array, goal: Array, change: Array, steps: Indices) -> Array:
    """Speeds (k, S, N) after numbers of steps (S,), from speeds (k, 1) or (k, N) towards goals (k, N).

    Each step changes them by ``change`` (k,) at most. The long axis is the last: NumPy's loops run along it.
    """
    most = (change[:, None] * steps)[..., None]
    off = (goal - speed)[:, None]
    return np.asarray(speed[:, None] + np.minimum(np.maximum(off, -most), most), dtype=float)


def roll_to_rest(
    limits: MotionLimits, start: ReferenceState, target: Array, hold: Array, *, part: float, dt: float
) -> tuple[Array, Array, Array]:
    """Roll out motions of :func:`motion_to`.

    Args:
        limits: of the motors.
        start: first state.
        target: (N, k) speeds of the drive coordinates.
        hold: (N,) times [s] for which they are held before the base brakes.
        part: of the acceleration limits.
        dt: step [s].

    Returns:
        (T,) times [s] after the start, (N, T, 3) poses then, and (N,) times [s] at which the motions are at rest.
    """
    change = part * limits.drive_acceleration
    longest = float(hold.max()) + float((limits.drive_speed / change).max()) + dt
    time = dt * np.arange(1.0, round(longest / dt) + 1.0)
    steps = np.arange(len(time) + 1)
    speed = _approach(limits.to_drive(start.v[:3])[:, None], target.T, change * dt, steps)
    rest = np.zeros(len(target))
    for when in np.unique(hold).tolist():
        at = np.flatnonzero(hold == when)
        done = int(np.floor(when / dt + 0.5))  # steps before it brakes
        now = speed[:, done, at]
        duration = np.maximum((np.abs(now) / change[:, None]).max(axis=0), 1e-9)
        left = np.maximum(1.0 - steps[: len(steps) - done, None] * (dt / duration), 0.0)
        speed[:, done:, at] = left * now[:, None]
        rest[at] = done * dt + duration
    return time, _poses(limits, start, speed, dt), rest


def _poses(limits: MotionLimits, start: ReferenceState, speed: Array, dt: float) -> Array:
    """Poses (N, T, 3) for speeds (k, T + 1, N) of the drive coordinates."""
    to_twist = limits.to_twist(np.eye(len(speed)))  # (k, 3)
    x, y, turn = np.tensordot(to_twist.T * dt, 0.5 * (speed[:, 1:] + speed[:, :-1]), axes=1)
    yaw = start.coordinates[2] + np.cumsum(turn, axis=0)
    middle = yaw - 0.5 * turn
    cos, sin = np.cos(middle), np.sin(middle)
    pose = np.empty((speed.shape[2], speed.shape[1] - 1, 3))
    pose[..., 0] = (start.coordinates[0] + np.cumsum(cos * x - sin * y, axis=0)).T
    pose[..., 1] = (start.coordinates[1] + np.cumsum(sin * x + cos * y, axis=0)).T
    pose[..., 2] = yaw.T
    return pose


def motion_to(
    robot: RobotModel,
    limits: MotionLimits,
    start: ReferenceState,
    target: Array,
    *,
    part: float,
    duration: float,
    dt: float,
) -> Trajectory | None:
    """A motion that approaches a target speed for a short while and then brakes to rest; the joints only brake.

    Velocities are linear and travels quadratic between samples, so that no limit is exceeded anywhere. Braking keeps
    the proportion of the speeds: the base stays on its arc.

    Args:
        robot: the robot.
        limits: of its motors.
        start: first state, at ``start.time``.
        target: (k,) speeds of the drive coordinates.
        part: of the acceleration limits.
        duration: until it begins to brake [s].
        dt: time between samples [s].

    Returns:
        The motion; None where a joint would leave its range.
    """
    k = limits.drive_dim
    change = limits.acceleration.copy()
    change[:k] *= part
    goal = np.concatenate([target, np.zeros(len(change) - k)])
    rows = [limits.to_coordinates(start.v)]
    for _ in range(max(round(duration / dt), 1)):
        rows.append(rows[-1] + np.clip(goal - rows[-1], -change * dt, change * dt))
    steps = max(int(np.ceil(float((np.abs(rows[-1]) / change).max()) / dt - 1e-9)), 1)
    rows += [rows[-1] * (1.0 - j / steps) for j in range(1, steps + 1)]
    v = np.array(rows)
    y = np.vstack([np.zeros(v.shape[1]), np.cumsum(0.5 * dt * (v[1:] + v[:-1]), axis=0)])
    a = np.vstack([np.diff(v, axis=0) / dt, np.zeros(v.shape[1])])
    coordinates = integrate_travel(robot, limits, start.coordinates, y)
    space, base = robot.space, robot.space.base_nv
    low, high = np.minimum(space.lower, start.coordinates) - 1e-6, np.maximum(space.upper, start.coordinates) + 1e-6
    if ((coordinates < low) | (coordinates > high))[:, base:].any():
        return None
    time = start.time + dt * np.arange(len(v), dtype=float)
    return Trajectory(robot, limits, time, coordinates, limits.to_tangent(v), limits.to_tangent(a))


def _within(drive: Array, top: Array) -> Array:
    """Speeds (N, k) scaled back to their limits (k,), in proportion: the curvature stays."""
    return np.asarray(drive / np.maximum((np.abs(drive) / top).max(axis=1), 1.0)[:, None], dtype=float)


_TOUCHING = 40.0
"""Cost of a contact, per second."""
_DETOUR = 1.5
"""Cost of a metre beside the strip, in metres along it."""
_TURN = 0.3
"""Cost of a heading error [s/rad]."""
_LONGER = (0.0, 0.2, 0.5, 0.9)
"""Times [s] for which a manoeuvre may be followed beyond the least one, to end at a free place."""
_GAIN = 0.1
"""Gain of cost [s] for which a robot in motion, or at risk, leaves the strip."""
_PACE = 0.75
"""Part of the largest speed and acceleration that the strip is assumed to be followed with."""
_STEADY = 0.15
"""Bonus [s] of the manoeuvre that was chosen last: it goes on unless another is better."""


class EvasivePlanner:
    """Workspace: compares manoeuvres of the base among the moving obstacles of a sensed scene.

    Args:
        robot: the robot; a fixed base has no manoeuvres.
        limits: of its motors.
        params: of the comparison.
        dt: time between the samples of motions [s].
        hold: least time [s] for which a motion follows its manoeuvre before it brakes.
        clearance: distance [m] that certificates require.

    Attributes:
        hold: see above.
        time: (T,) times [s] after the start at which costs are taken.
    """

    def __init__(
        self, robot: RobotModel, limits: MotionLimits, params: EvasionParams, *, dt: float, hold: float,
        clearance: float,
    ) -> None:  # fmt: skip
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: EvasionParams = params
        self.dt: float = dt
        self.clearance: float = clearance
        self._footprint = PlanarFootprint(robot)
        self.hold: float = hold
        if limits.drive_dim:
            self._lattice = lattice(limits)
        self.time: Array = params.step * np.arange(1, round(params.horizon / params.step) + 1, dtype=float)
        self._last: Array | None = None

    def improved(
        self,
        result: PlanResult,
        start: ReferenceState,
        active: Trajectory,
        scene: Scene,
        possible: Forecast,
        certifier: TrajectoryCertifier,
        arrival: ArrivalTimes,
        pace: Pace | None = None,
    ) -> PlanResult:
        """The given result, or one with a certified motion off the strip where that has a lower cost.

        Args:
            result: of planning along the strip.
            start: first state of the next motion.
            active: the trajectory that is executed.
            scene: sensed.
            possible: forecast of its moving obstacles.
            certifier: of motions.
            arrival: times at the strip's nodes.
            pace: how much time there is for further motions where the best is not certified; enough where None.
        """
        if not self.look(scene, possible, start, result.report.strip.coordinates):
            return result
        if result.accepted:
            rows = self._followed(result, start, arrival)
        else:
            motion = result.motion if result.outcome is PlanOutcome.BRAKE and result.motion is not None else active
            rows = np.array([motion.at(start.time + t).coordinates for t in self.time])
        risk, cost = self.cost(rows)
        threatened = risk > self.params.risk_threshold
        broken = result.report.certificate.broken
        by_standing = broken is not None and broken.obstacle in scene and scene.obstacle(broken.obstacle).motion is None
        if not threatened and (result.accepted or by_standing):
            self._last = None
            return result
        gain = _GAIN if threatened or start.v.any() else self.params.min_gain
        began = 0.0 if pace is None else pace.reading()
        for motion in self.options(start, cost - gain):
            certificate = certifier.certify(motion, scene, possible)
            if certificate.certified:
                return replace(result, outcome=PlanOutcome.EVADE, motion=motion, certificate=certificate, reason="")
            if pace is not None:
                took, began = pace.reading() - began, pace.reading()
                if not pace.has(took):
                    self._last = None
                    break
        return result

    def _followed(self, result: PlanResult, start: ReferenceState, arrival: ArrivalTimes) -> Array:
        """(T, nv) predicted coordinate rows at :attr:`time` after the start if the robot follows the strip.

        Where the strip is broken the robot is assumed to stop and wait.
        """
        strip, speed, times = result.report.strip.coordinates, result.speed, self.time
        top = _PACE * float(self.limits.drive_speed.max(initial=1.0))
        change = _PACE * float(self.limits.drive_acceleration.min(initial=np.inf)) / top
        now = min(fastest_drive(self.limits, start.v) / top, speed)
        ramp = np.minimum(times, (speed - now) / change)
        passed = now * times + change * ramp * (times - 0.5 * ramp)
        reached = arrival(strip)
        broken = np.flatnonzero(~result.report.certificate.segments)
        if len(broken):
            passed = np.minimum(passed, reached[min(int(broken[0]), len(reached) - 1)])
        i = np.clip(np.searchsorted(reached, passed, side="right") - 1, 0, len(strip) - 2)
        s = np.clip((passed - reached[i]) / np.maximum(reached[i + 1] - reached[i], 1e-9), 0.0, 1.0)
        return self.robot.space.interpolate(strip[i], strip[i + 1], s)

    def look(self, scene: Scene, possible: Forecast, start: ReferenceState, strip: Array) -> bool:
        """Take in a scene, for :meth:`cost` and :meth:`options`.

        Args:
            scene: sensed.
            possible: forecast of its moving obstacles.
            start: first state of the next motion.
            strip: (M, nv) coordinate rows of the path to the goal from there.

        Returns:
            Whether any moving obstacle may come near within the horizon; only then costs are defined.
        """
        if not self.limits.drive_dim or not len(possible):
            return False
        self._footprint.update(start.coordinates)
        horizon = self.params.horizon
        reach = self._footprint.reach() + self.params.radius + float(self.limits.drive_speed[:2].max()) * horizon
        lookahead = ObstacleLookahead(
            self._footprint, scene, possible, start.coordinates[:2], reach=reach, horizon=horizon
        )
        if not lookahead.movers:
            self._last = None
            return False
        self._lookahead, self._delay = lookahead, start.time - scene.time
        self._path = strip[:, :2]
        step = np.hypot(*np.diff(self._path, axis=0).T)
        self._rest = np.append(np.cumsum(step[::-1])[::-1], 0.0)
        return True

    def cost(self, rows: Array) -> tuple[float, float]:
        """Risk and cost [s] of coordinate rows (T, nv) at :attr:`time` after the start.

        The risk is the cost of contact and nearness, 0 where nothing is near; the cost adds the time left to the goal.
        """
        pose = rows[None, :, :3]
        risk = self._risk(pose)
        return float(risk[0]), float(risk[0] + self._to_go(pose[:, -1])[0])

    def options(self, start: ReferenceState, better: float) -> Iterator[Trajectory]:
        """Motions that begin manoeuvres of a cost [s] below ``better``, the best first.

        Each follows its manoeuvre for a while, and then brakes to rest at a place that the forecast leaves free.
        """
        params, targets, last = self.params, self._lattice, self._last
        part, step = params.acceleration, params.step
        kinds = targets.different
        room = self._room(start, kinds)
        hold = room.argmax(axis=1)  # the shortest that ends at a free place; the next tick plans anew
        targets = targets.take(np.take(room.any(axis=1), targets.kind))
        if not len(targets):
            return
        pose = _roll_out(self.limits, start, targets, part=part, horizon=params.horizon, dt=step)
        risk = self._risk(pose)
        cost = risk + self._to_go(pose[:, -1])
        if last is not None:  # a bonus for the present manoeuvre
            same = (np.abs(targets.first - last) < 1e-9).all(axis=1)
            cost[same] -= _STEADY
        best = np.argsort(cost, kind="stable")[: params.shortlist]
        best = best[cost[best] < better]
        cost[best] += self._standing_risk(pose[best])
        best = best[np.argsort(cost[best], kind="stable")]
        tried: set[int] = set()
        for i in best[cost[best] < better].tolist():
            kind = int(targets.kind[i])
            if kind in tried:
                continue
            if len(tried) >= params.tries:
                break
            tried.add(kind)
            duration = self.hold + _LONGER[hold[kind]]
            motion = motion_to(self.robot, self.limits, start, kinds[kind], part=part, duration=duration, dt=self.dt)
            if motion is not None:
                self._last = kinds[kind]
                yield motion
        self._last = None

    def _room(self, start: ReferenceState, kinds: Array) -> Mask:
        """(D, H) whether motions to targets (D, k), held for H different times, keep clear of the forecast."""
        count = len(_LONGER)
        hold = np.tile(self.hold + np.array(_LONGER), len(kinds))
        time, pose, rest = roll_to_rest(
            self.limits, start, np.repeat(kinds, count, axis=0), hold, part=self.params.acceleration, dt=0.1
        )
        apart = self._lookahead.possible(pose, self._delay + time, 2.0 * self.clearance) - self.clearance
        over = time > rest[:, None] + 0.25
        return ((apart > 0.0) | over).all(axis=1).reshape(-1, count)

    def _risk(self, pose: Array) -> Array:
        """(N,) cost [s] of coming near moving obstacles, discounted with time, as predictions become less certain."""
        params, t = self.params, self.time
        apart = self._lookahead.near(pose, self._delay + t, params.lookahead) - self.clearance
        near = np.clip(1.0 - apart / (params.radius + params.radius_growth * t), 0.0, 1.5)
        weight = params.step * np.exp(-t / params.discount_time)
        return (params.proximity_weight * near * near + _TOUCHING * (apart < 0.0)) @ weight

    def _standing_risk(self, pose: Array) -> Array:
        """(N,) cost [s] of touching static obstacles."""
        apart = self._lookahead.from_standing(pose[:, 1::2], 2.0 * self.clearance)
        weight = 2.0 * self.params.step * np.exp(-self.time[1::2] / self.params.discount_time)
        return (_TOUCHING * (apart < self.clearance)) @ weight

    def _to_go(self, pose: Array) -> Array:
        """(N,) time [s] to the goal from poses (N, 3): back to the strip, along it, and turning."""
        top = 0.8 * float(self.limits.drive_speed[:2].min())
        at, path = pose[:, :2], self._path
        square = np.square(at).sum(axis=1)[:, None] + np.square(path).sum(axis=1) - 2.0 * (at @ path.T)
        length = _DETOUR * np.sqrt(np.maximum(square, 0.0)) + self._rest
        node = length.argmin(axis=1)
        ahead = np.searchsorted(-self._rest, -np.maximum(self._rest[node] - 1.0, 0.0))
        ahead = np.minimum(ahead, len(self._rest) - 1)
        to = path[ahead] - at
        turn = np.abs(wrap_angle(np.arctan2(to[:, 1], to[:, 0]) - pose[:, 2]))
        turn = np.minimum(turn, np.pi - turn + 0.5)  # backing up is possible too
        turn = turn * np.minimum(np.hypot(to[:, 0], to[:, 1]), 1.0)  # at the goal there is none left
        return length[np.arange(len(pose)), node] / top + (_TURN * turn if self.limits.drive_dim == 2 else 0.0)
