"""EvasivePlanner: short motions of the base that avoid moving obstacles.

A few hundred manoeuvres are rolled out some seconds ahead and compared by risk and by progress towards the goal. Only
a certified motion is driven: one that follows the best manoeuvre for a while, and ends at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import Certificate
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.robot.space import wrap_angle
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.trajectory import MotionLimits
from elastic_strips.trajectory.braking import brought_to_rest
from elastic_strips.trajectory.trajectory import ReferenceState, Trajectory

from .keeping import ConstraintKeeper
from .lookahead import ObstacleLookahead
from .pace import Pace
from .params import EvasionParams
from .prediction import ArrivalTimes, Outlook
from .progress import DETOUR_COST
from .rollout import RollOuts, lattice
from .strip_timer import PlanOutcome, PlanResult, fastest_drive


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

    Args:
        robot: the robot.
        limits: limits of its motors.
        start: first state, at ``start.time``.
        target: (k,) speeds of the drive coordinates.
        part: share of the acceleration limits.
        duration: until it begins to brake [s].
        dt: time between samples [s].

    Returns:
        The motion; None where a joint would leave its range.
    """
    change = np.concatenate([part * limits.drive_acceleration, limits.joint_acceleration])
    speed, goal = limits.to_coordinates(start.v), np.zeros(len(change))
    goal[: limits.drive_dim] = target
    rising = goal > speed
    nearer = np.empty((max(round(duration / dt), 1) + 1, len(change)))
    nearer[0], nearer[1:] = speed, np.where(rising, change, -change) * dt
    np.cumsum(nearer, axis=0, out=nearer)
    nearer = np.where(rising, np.minimum(nearer, goal), np.maximum(nearer, goal))
    return brought_to_rest(robot, limits, start, nearer, change * dt, dt)


_CONTACT_COST = 40.0
"""Cost of a contact, per second."""
_STOP_COST = 10.0
"""Cost of a place and speed from which a stop could not be certified, per second."""
_MISSED_COST = 2.0
"""Cost of an angle by which the strip's constraint is missed with the joints as they are [1/rad]."""
_HEADING_COST = 0.3
"""Cost of a heading error [s/rad]."""
_BEHIND_COST = 3.0
"""Cost of something that is about to come up from behind a robot that sees only ahead, per second."""
_BEHIND_WITHIN = 4.0
"""Distance [m] from which on it counts."""
_LONGER_BY = np.array([0.0, 0.2, 0.5, 0.9])
"""Times [s] for which a manoeuvre may be followed beyond the least time, to end at a free place."""
_ROOM_STEP = 0.1
"""Step [s] at which the way to that place is looked at."""
_FREE_PLACE_TIME = 0.25
"""Time [s] for which that place is to stay free."""
_COMPARED_AT_ONCE = 8
"""This many of the shortlist are compared with static obstacles at a time."""
_LEAST_GAIN = 0.1
"""Gain of cost [s] for which a robot in motion, or at risk, leaves the strip."""
_STRIP_PACE = 0.75
"""Part of the largest speed and acceleration that the strip is assumed to be followed with."""
_STEADINESS_BONUS = 0.15
"""Bonus [s] of the manoeuvre that was chosen last: it goes on unless another one is better."""


class EvasivePlanner(OneThread):
    """Workspace: compares manoeuvres of the base among the moving obstacles of a sensed scene.

    Args:
        robot: the robot; a fixed base has no manoeuvres.
        limits: limits of its motors.
        params: parameters of the comparison.
        dt: time between the samples of motions [s].
        hold: least time [s] for which a motion follows its manoeuvre before it brakes.
        backward: whether manoeuvres lead backwards, too; not for robots that see only ahead of them.
        turn_speed: how fast the base turns in them at most [rad/s].

    Attributes:
        hold: the argument ``hold``.
        time: (T,) times [s] after the start at which costs are taken.
    """

    def __init__(
        self,
        robot: RobotModel,
        limits: MotionLimits,
        params: EvasionParams,
        *,
        dt: float,
        hold: float,
        backward: bool = True,
        turn_speed: float = np.inf,
    ) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: EvasionParams = params
        self.dt: float = dt
        self._clearance = 0.0  # distance [m] that certificates require
        self._footprint = PlanarFootprint(robot)
        self.hold: float = hold
        self._backward = backward
        self.time: Array = params.step * np.arange(1, round(params.horizon / params.step) + 1, dtype=float)
        self._weight = params.step * np.exp(-self.time / params.discount_time)
        self._braking = params.acceleration * float(limits.drive_acceleration[:2].min(initial=np.inf))
        self._radius = params.radius + params.radius_growth * self.time
        if limits.drive_dim:
            self._lattice = lattice(limits, backward=backward, turn_speed=turn_speed)
            self._kinds = self._lattice.different
            self._rolling = RollOuts(limits, part=params.acceleration, dt=params.step)
            self._stopping = RollOuts(limits, part=params.acceleration, dt=_ROOM_STEP)
        self._last: Array | None = None
        self._constraint: ConstraintForce | None = None

    @exclusive
    def improved(
        self,
        result: PlanResult,
        start: ReferenceState,
        active: Trajectory,
        outlook: Outlook,
        certify: Callable[[Trajectory, Outlook], Certificate],
        arrival: ArrivalTimes,
        pace: Pace | None = None,
        trend: Array | None = None,
        keeper: ConstraintKeeper | None = None,
    ) -> PlanResult:
        """The given result, or one with a certified motion off the strip where that has a lower cost.

        Args:
            result: result of planning along the strip.
            start: first state of the next motion.
            active: the trajectory that is executed.
            outlook: of the tick.
            certify: certifies motions.
            arrival: times at the strip's nodes.
            pace: how much time there is for further motions where the best is not certified; enough where None.
            trend: (M, 3) accelerations [m/s²] with which the moving obstacles are expected to go on for a little while.
            keeper: of the strip's constraint; None where it has none.
        """
        scene = outlook.scene
        self._constraint = None if keeper is None else keeper.constraint
        if not self.look(outlook, start, result.way, trend):
            return result
        if result.accepted:
            rows = self._followed(result, start, arrival)
        else:
            motion = result.motion if result.outcome is PlanOutcome.BRAKE and result.motion is not None else active
            rows = motion.coordinates_at(start.time + self.time)
        risk, cost = self.cost(rows)
        threatened = risk > self.params.risk_threshold
        broken = result.report.certificate.broken
        by_standing = broken is not None and broken.obstacle in scene and scene.obstacle(broken.obstacle).motion is None
        if not threatened and (result.accepted or by_standing):
            self._last = None
            return result
        gain = _LEAST_GAIN if threatened or start.v.any() else self.params.min_gain
        began = 0.0 if pace is None else pace.reading()
        for motion in self.options(start, cost - gain):
            several = (motion,) if keeper is None else keeper.motions(motion, scene, self.hold, result.way)
            for each in several:
                certificate = certify(each, outlook)
                if certificate.certified:
                    return replace(result, outcome=PlanOutcome.EVADE, motion=each, certificate=certificate, reason="")
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
        strip, speed, times = result.way, result.speed, self.time
        top = _STRIP_PACE * float(self.limits.drive_speed.max(initial=1.0))
        change = _STRIP_PACE * float(self.limits.drive_acceleration.min(initial=np.inf)) / top
        now = min(fastest_drive(self.limits, start.v) / top, speed)
        ramp = np.minimum(times, (speed - now) / change)
        passed = now * times + change * ramp * (times - 0.5 * ramp)
        reached = arrival(strip)
        broken = np.flatnonzero(~result.report.certificate.segments)
        if len(broken):
            before = 0 if result.lead is None else len(result.lead) - 1
            passed = np.minimum(passed, reached[min(before + int(broken[0]), len(reached) - 1)])
        i = np.clip(np.searchsorted(reached, passed, side="right") - 1, 0, len(strip) - 2)
        s = np.clip((passed - reached[i]) / np.maximum(reached[i + 1] - reached[i], 1e-9), 0.0, 1.0)
        return self.robot.space.interpolate(strip[i], strip[i + 1], s)

    @exclusive
    def look(self, outlook: Outlook, start: ReferenceState, strip: Array, trend: Array | None = None) -> bool:
        """Take in a scene, for :meth:`cost` and :meth:`options`.

        Args:
            outlook: of the tick.
            start: first state of the next motion.
            strip: (K, nv) coordinate rows of the path to the goal from there.
            trend: (M, 3) accelerations [m/s²] that are expected of the moving obstacles for a little while.

        Returns:
            Whether any moving obstacle may come near within the horizon; only then costs are defined.
        """
        scene, possible = outlook.scene, outlook.possible
        if not self.limits.drive_dim or not len(possible):
            return False
        self._clearance = outlook.margins.clearance
        self._footprint.update(start.coordinates)
        horizon = self.params.horizon
        reach = self._footprint.reach() + self.params.radius + float(self.limits.drive_speed[:2].max()) * horizon
        lookahead = ObstacleLookahead(
            self._footprint, scene, possible, start.coordinates[:2], reach=reach, horizon=horizon, trend=trend
        )
        if not lookahead.movers:
            self._last = None
            return False
        self._lookahead, self._delay = lookahead, start.time - scene.time
        self._path = path = strip[:, :2]
        self._square = (path * path).sum(axis=1)
        self._rest = rest = np.zeros(len(path))
        step = path[1:] - path[:-1]
        rest[:-1] = np.cumsum(np.hypot(step[:, 0], step[:, 1])[::-1])[::-1]
        ahead = np.searchsorted(-rest, -np.maximum(rest - 1.0, 0.0))
        self._ahead = path[np.minimum(ahead, len(path) - 1)]  # of each node, about a metre on
        return True

    @exclusive
    def cost(self, rows: Array) -> tuple[float, float]:
        """Risk and cost [s] of coordinate rows (T, nv) at :attr:`time` after the start.

        The risk is the cost of contact and nearness, 0 where nothing is near; the cost adds the time left to the goal,
        and what comes up from behind.
        """
        pose = rows[None, :, :3]
        risk = self._risk(pose)
        return float(risk[0]), float(risk[0] + self._to_go(pose[:, -1])[0] + self._lost_sight(pose)[0])

    def options(self, start: ReferenceState, better: float) -> Iterator[Trajectory]:
        """Motions that begin manoeuvres of a cost [s] below ``better``, the best first.

        Each follows its manoeuvre for a while, and then brakes to rest at a place that the forecast leaves free.
        """
        params, kinds, last = self.params, self._kinds, self._last
        hold = self._held(start)
        targets = self._lattice.take(np.take(hold >= 0, self._lattice.kind))
        if not len(targets):
            return
        pose = self._rolling.poses(start, targets, horizon=params.horizon)
        cost = self._to_go(pose[:, -1])
        if self._constraint is not None:
            missed = self._constraint.errors_held(start.coordinates, pose)
            cost += _MISSED_COST * self.params.step * missed.sum(axis=1)
        if last is not None:  # a bonus for the present manoeuvre
            cost[(np.abs(targets.first - last) < 1e-9).all(axis=1)] -= _STEADINESS_BONUS
        able = cost < better  # risk only adds to it
        targets, pose, cost = targets.take(able), pose[able], cost[able]
        cost += self._risk(pose) + self._lost_sight(pose)
        best = np.argsort(cost, kind="stable")[: params.shortlist]
        tried: set[int] = set()
        for i in self._in_order(pose, cost, best[cost[best] < better], better):
            kind = int(targets.kind[i])
            if kind in tried:
                continue
            if len(tried) >= params.tries:
                break
            tried.add(kind)
            duration = self.hold + float(_LONGER_BY[hold[kind]])
            motion = motion_to(
                self.robot, self.limits, start, kinds[kind], part=params.acceleration, duration=duration, dt=self.dt
            )
            if motion is not None:
                self._last = kinds[kind]
                yield motion
        self._last = None

    def _in_order(self, pose: Array, cost: Array, best: Indices, better: float) -> Iterator[int]:
        """Those of ``best``, in ascending order of cost, that stay below ``better`` with the risk of touching what
        stands, by cost with that risk. It only adds to a cost: few are asked for it before the first is sure."""
        known: list[tuple[float, int]] = []  # cost, and place among the best
        for begin in range(0, len(best), _COMPARED_AT_ONCE):
            few = best[begin : begin + _COMPARED_AT_ONCE]
            risen = cost[few] + self._standing_risk(pose[few])
            known += [(c, begin + k) for k, c in enumerate(risen.tolist()) if c < better]
            known.sort()
            end = begin + len(few)
            least = float(cost[best[end]]) if end < len(best) else np.inf  # of all others
            while known and known[0][0] <= least:
                yield int(best[known.pop(0)[1]])

    def _held(self, start: ReferenceState) -> Indices:
        """(D,) index of the shortest time for which each different target can be held and what follows keep clear of
        the forecast until the base has come to rest, at a free place; −1 where there is none.

        The next tick replans, and most places are free: the longer times are tried where the shortest does not do.
        """
        kinds, longer = self._kinds, len(_LONGER_BY) - 1
        after = _FREE_PLACE_TIME + _ROOM_STEP
        held = self._free(start, kinds, np.full(len(kinds), self.hold + _LONGER_BY[0]), after=after).astype(np.intp) - 1
        left = np.flatnonzero(held < 0)
        if len(left):
            hold = np.tile(self.hold + _LONGER_BY[1:], len(left))
            free = self._free(start, np.repeat(kinds[left], longer, axis=0), hold).reshape(-1, longer)
            held[left] = np.where(free.any(axis=1), 1 + free.argmax(axis=1), -1)
        return held

    def _free(self, start: ReferenceState, target: Array, hold: Array, *, after: float | None = None) -> Mask:
        """(N,) whether motions to targets (N, k), held for times (N,) [s], keep clear of the forecast."""
        time, pose, rest = self._stopping.to_rest(start, target, hold, after=after)
        apart = self._lookahead.possible(pose, self._delay + time, 2.0 * self._clearance)
        return np.all((apart > self._clearance) | (time > rest[:, None] + _FREE_PLACE_TIME), axis=1)

    def _risk(self, pose: Array) -> Array:
        """(N,) cost [s] of coming near moving obstacles, discounted with time, as predictions become less certain."""
        params = self.params
        apart = self._lookahead.near(pose, self._delay + self.time, params.lookahead) - self._clearance
        near = np.minimum(np.maximum(1.0 - apart / self._radius, 0.0), 1.5)
        cost = params.proximity_weight * near * near + _CONTACT_COST * (apart < 0.0)
        cost[:, 1:] += _STOP_COST * self._blocked(pose)
        return cost @ self._weight

    def _lost_sight(self, pose: Array) -> Array:
        """(N,) cost [s] of turning the back on what comes up to a robot that sees only ahead: once it is out of sight,
        nothing is known of where it goes."""
        if self._backward:
            return np.zeros(len(pose))
        behind = self._lookahead.from_behind(pose[:, 1::4], self._delay + self.time[1::4], _BEHIND_WITHIN)
        return _BEHIND_COST * (behind @ (4.0 * self._weight[1::4]))

    def _blocked(self, pose: Array) -> Mask:
        """(N, T−1) where a robot that follows poses (N, T, 3) could not be certified to stop, from the second pose on:
        something may come there while it brakes.

        From each pose on it brakes straight ahead. Obstacles have come as expected, and may then leave their courses.
        """
        step = pose[:, 1:] - pose[:, :-1]
        braking = np.hypot(step[..., 0], step[..., 1]) / (self.params.step * self._braking)  # [s]
        stop, wait = pose[:, 1:] + (0.5 / self.params.step) * braking[..., None] * step, braking + self.hold
        time = (self._delay + self.time[1:] + wait).reshape(-1)
        apart = self._lookahead.near(stop.reshape(1, -1, 3), time, _FREE_PLACE_TIME).reshape(wait.shape)
        return apart < self._clearance + self._lookahead.growth * wait * wait

    def _standing_risk(self, pose: Array) -> Array:
        """(N,) cost [s] of touching static obstacles."""
        apart = self._lookahead.from_standing(pose[:, 1::2], 2.0 * self._clearance)
        return (_CONTACT_COST * (apart < self._clearance)) @ (2.0 * self._weight[1::2])

    def _to_go(self, pose: Array) -> Array:
        """(N,) time [s] to the goal from poses (N, 3): back to the strip, along it, and turning."""
        top = 0.8 * float(self.limits.drive_speed[:2].min())
        at, path = pose[:, :2], self._path
        length = (at * at).sum(axis=1)[:, None] + self._square
        length -= 2.0 * (at @ path.T)
        np.sqrt(np.maximum(length, 0.0, out=length), out=length)
        length *= DETOUR_COST
        length += self._rest
        node = length.argmin(axis=1)
        least = length[np.arange(len(pose)), node] / top
        if self.limits.drive_dim != 2:
            return least
        to = self._ahead[node] - at
        turn = np.abs(wrap_angle(np.arctan2(to[:, 1], to[:, 0]) - pose[:, 2]))
        turn = np.minimum(turn, np.pi - turn + 0.5)  # backing up is possible too
        counts = np.minimum(np.hypot(to[:, 0], to[:, 1]), 1.0)  # at the goal there is nothing left to head for
        return least + _HEADING_COST * turn * counts
