"""Retiming: from nodes to a trajectory that keeps every limit, over a horizon or the whole strip."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.strip import Strip
from elastic_strips.validation import check_array, check_number, check_type, named_arguments

from .limits import MotionLimits
from .path import DrivePath, Polyline, RetimingError, integrate_travel, metric, polyline, smooth_path
from .speed_profile import LIMIT_EXCESS, Profile, braked, broken_limit, fastest, rate_bounds
from .trajectory import Trajectory, joined, stationary

_LIMIT_MARGINS = ((0.99, 0.97, 1), (0.99, 0.995, 1), (0.98, 0.95, 2), (0.97, 0.9, 4))
"""Parts of the speed and acceleration limits to plan with, and how many times finer the grid is: between the points of
its grid a profile exceeds what it was planned with, by up to 0.5 % or, in the sharpest bends, more. The second is tried
where there is no room to brake, the others where a limit is broken."""

_LEAD_WINDOWS = ((0.04, 0.5), (0.08, 1.0))
"""Nearest knot to the start and length of the windows [m]; the second turns more gently into the polyline."""

_RESTING_SHARE = 5e-4  # part of the speed limits below which a start counts as rest
_BEND_LEAST_SPEED = (
    0.05  # speed [m/s in the metric] below which an acceleration says nothing about the bend of the path
)
_SHARPEST_BEND = 10.0  # bend at the start [1/m] up to which it is continued
_STEP_GROWTH = 1.3
_SHORTEST_PATH = 1e-6  # shorter paths are none [m]

_BRAKE_MARGINS = (0.98, 0.995, 0.93, 0.85)
_STOPPED_SHARE = 1e-9  # squared part of the trajectory's own speed that counts as none


@dataclass(frozen=True, slots=True)
class _Start:
    """Time [s], velocity (m,) of drive and joints, whether that is one, and the bend (m,) of the path, where known."""

    time: float
    velocity: Array
    moving: bool
    bend: Array | None = None


class Retimer:
    """Times nodes as fast as the limits allow (TOPP-RA). It has no mutable state: threads may share one."""

    def __init__(
        self, robot: RobotModel, limits: MotionLimits | None = None, *, dt: float = 0.01, turn_speed: float = np.inf
    ) -> None:
        """Prepare for a robot.

        Args:
            robot: the robot.
            limits: limits of its motors; :meth:`MotionLimits.for_robot` where None.
            dt: distance of the samples [s].
            turn_speed: how fast the base turns at most [rad/s], besides the motors' limits, to within some per cent in
                the sharpest bends; inf: as they allow. A start that turns faster is braked to it.

        Raises:
            ParameterError: limits of another robot, dt outside [1e-4, 0.1], or a turn_speed that is not positive.
        """
        check_type("robot", robot, RobotModel, RobotError)
        check_type("limits", limits, MotionLimits, none=True)
        self.robot = robot
        self.limits: MotionLimits = MotionLimits.for_robot(robot) if limits is None else limits
        k = {BaseKind.DIFF_DRIVE: 2, BaseKind.OMNI: 3, BaseKind.FIXED: 0}[robot.base_kind]
        if self.limits.drive_dim != k or len(self.limits.joint_speed) != robot.nv - robot.space.base_nv:
            raise ParameterError(
                f"the limits are for {self.limits.drive_dim} drive coordinates and {len(self.limits.joint_speed)} "
                f"joints; {robot.name!r} has {k} and {robot.nv - robot.space.base_nv}"
            )
        self.dt: float = check_number("dt", dt, low=1e-4, high=0.1, unit="s")
        self.turn_speed: float = check_number("turn_speed", turn_speed, above=0.0, infinite=True, unit="rad/s")
        self.weight: Array = metric(robot, self.limits)
        self._speed, self._acceleration = self.limits.speed, self.limits.acceleration

    def horizon(
        self,
        coordinates: npt.ArrayLike,
        v_start: npt.ArrayLike | None = None,
        *,
        a_start: npt.ArrayLike | None = None,
        distance: float = np.inf,
        start_time: float = 0.0,
        speed: float = 1.0,
        insist: bool = True,
    ) -> Trajectory:
        """The fastest motion along the nodes ahead that ends at rest.

        It ends at the first of these: the last node; a node where the robot has to stop anyway (a cusp, a
        sharp corner such as between turning in place and driving); ``distance`` ahead, or the least distance beyond
        it in which the robot can stop.

        Args:
            coordinates: (K, nv) nodes; it starts exactly at the first one.
            v_start: (nv,) velocity there: body twist, joint rates; from rest where it is None or about zero.
            a_start: (nv,) acceleration there, with which the path continues to bend as before: replanning from a
                state of a trajectory then seldom fails. None where unknown.
            distance: how far to go [m]: the base's travel, a joint's turn counted as 0.25 m/rad.
            start_time: time of the first sample [s].
            speed: part of the speed limits to use, in (0, 1]. A faster start is braked to it.
            insist: where there is no room to brake, try other curves into the nodes, too, and harder braking.

        Raises:
            ConfigurationError: nodes of the wrong shape or not finite.
            ParameterError: another argument outside its range.
            RetimingError: it cannot be driven like that. The robot's present motion still can.
        """
        nodes = self._nodes(coordinates)
        if not distance > 0.0:
            raise ParameterError(f"distance={distance!r} m must be positive")
        check_number("speed", speed, above=0.0, high=1.0)
        start = self._start(start_time, v_start, a_start)
        line = polyline(self.robot, self.limits, self.weight, nodes, start.velocity if start.moving else None)
        return self._drive(line, float(line.s[line.stops[0]]), start, distance, speed, insist=insist)

    def full(self, coordinates: npt.ArrayLike, *, start_time: float = 0.0, speed: float = 1.0) -> Trajectory:
        """All of the nodes from rest to rest, with a stop wherever one is needed.

        Args:
            coordinates, start_time, speed: as for :meth:`horizon`.

        Raises:
            ConfigurationError, ParameterError, RetimingError: as for :meth:`horizon`.
        """
        nodes = self._nodes(coordinates)
        check_number("speed", speed, above=0.0, high=1.0)
        start = self._start(start_time, None, None)
        stops = polyline(self.robot, self.limits, self.weight, nodes).stops
        pieces: list[Trajectory] = []
        first = 0
        for stop in stops:
            piece = nodes[first : stop + 1]
            if pieces:  # each piece starts where the one before has ended and makes up for what that missed
                start = replace(start, time=pieces[-1].end_time)
                piece = np.vstack([pieces[-1].coordinates[-1], piece[1:]])
            line = polyline(self.robot, self.limits, self.weight, piece)
            pieces.append(self._drive(line, float(line.s[-1]), start, np.inf, speed))
            first = stop
        return joined(pieces)

    def brake(self, trajectory: Trajectory, t: float) -> Trajectory:
        """The trajectory from time ``t`` [s] on, slowed down as fast as the limits allow until it stands.

        The path stays the same, to within what its samples resolve (micrometres): only the time along it is stretched.
        Where that gains nothing (it brakes already, or is at rest) this is the rest of the trajectory; either way
        it ends at rest if the trajectory does.

        Args:
            trajectory: what the robot drives; it must keep the limits itself.
            t: time at which to begin [s].
        """
        rest, limits = trajectory.tail(t), self.limits
        first = max(int(np.searchsorted(trajectory.time, t, side="right")) - 1, 0)
        if t > trajectory.end_time - self.dt or not trajectory.v[first:].any():
            return rest
        time = trajectory.time[first:]
        y = np.zeros((len(time), limits.drive_dim + len(limits.joint_speed)))
        np.cumsum(limits.to_coordinates(trajectory.steps[first:]), axis=0, out=y[1:])
        v = limits.to_coordinates(trajectory.v[first:])
        own = _Timed(time, y, v, max(t, trajectory.start_time))
        for margin in _BRAKE_MARGINS:
            profile = own.slowest(margin * limits.acceleration)
            stop = None if profile is None else self._sampled_stop(own, profile, rest.coordinates[0])
            if stop is not None and stop.end_time <= rest.end_time:
                return stop
        return rest

    def _nodes(self, coordinates: npt.ArrayLike) -> Array:
        nodes = check_array(
            f"nodes of {self.robot.name!r}", coordinates, (None, self.robot.nv), error=ConfigurationError
        )
        return nodes if len(nodes) > 1 else np.vstack([nodes, nodes])

    def _start(self, time: float, v: npt.ArrayLike | None, a: npt.ArrayLike | None) -> _Start:
        time, nv = check_number("start_time", time, unit="s"), self.robot.nv
        given = {"v_start": v, "a_start": a}
        rows = {name: np.zeros(nv) if row is None else np.asarray(row, dtype=float) for name, row in given.items()}
        for name, row in rows.items():
            if row.shape != (nv,) or not np.isfinite(row).all():
                raise ParameterError(f"{name} = {row.tolist()} must be {nv} finite numbers: body twist, joint rates")
        if self.limits.drive_dim == 2 and abs(rows["v_start"][1]) > LIMIT_EXCESS * self._speed[0]:
            raise ParameterError(f"v_start moves sideways at {rows['v_start'][1]:g} m/s; a differential drive cannot")
        velocity = self.limits.to_coordinates(rows["v_start"])
        over = np.abs(velocity) / self._speed
        if over.max(initial=0.0) > 1.0 + LIMIT_EXCESS:
            worst = int(over.argmax())
            raise RetimingError(
                f"the speed at the start in coordinate {worst} (drive, then joints) is {abs(velocity[worst]):.4g}; "
                f"the limit is {self._speed[worst]:.4g}"
            )
        if over.max(initial=0.0) <= _RESTING_SHARE:
            return _Start(time, np.zeros_like(velocity), False)
        x = float(((velocity * self.weight) ** 2).sum())
        if a is None or x < _BEND_LEAST_SPEED * _BEND_LEAST_SPEED:
            return _Start(time, velocity, True)
        change = self.limits.to_coordinates(rows["a_start"])
        bend = (change - velocity * float((change * velocity) @ self.weight**2) / x) / x
        sharpness = float(np.linalg.norm(bend * self.weight))
        return _Start(time, velocity, True, bend * min(1.0, _SHARPEST_BEND / max(sharpness, 1e-12)))

    def _drive(
        self, line: Polyline, available: float, start: _Start, distance: float, speed: float, *, insist: bool = True
    ) -> Trajectory:
        """A motion over ``distance`` or what is needed to stop, and no more than the length ``available``."""
        with np.errstate(divide="ignore"):
            rate = float(np.min(self._acceleration / np.abs(start.velocity), initial=np.inf))
        braking = 0.5 * float(np.linalg.norm(start.velocity * self.weight)) / rate  # [m in the metric], straight on
        if available < max(0.9 * braking, _SHORTEST_PATH):
            if not start.moving:
                return stationary(self.robot, self.limits, line.coordinates[0], start.time, self.dt)
            raise RetimingError(
                f"the robot has to stop within {available:.4g} m and needs {braking:.4g} m to brake; keep to the "
                "trajectory that it drives"
            )
        length, longest = min(max(distance, 1.05 * braking), available), min(max(distance, 2.0 * braking), available)
        attempt = margin = 0
        path = None
        while True:
            if path is None:
                lead, window = _LEAD_WINDOWS[attempt]
                heading = start.velocity if start.moving else None
                path = smooth_path(
                    self.robot,
                    self.limits,
                    line,
                    length,
                    weight=self.weight,
                    heading=heading,
                    bend=start.bend,
                    lead=lead,
                    window=window,
                )
            result = self._timed(path, start, speed, _LIMIT_MARGINS[margin])
            if isinstance(result, Trajectory):
                return result
            if result is None and length < longest:
                length, path = min(_STEP_GROWTH * length, longest), None
            elif result is None and insist and start.moving and margin == 0:
                margin = 1
            elif result is None and insist and start.moving and attempt + 1 < len(_LEAD_WINDOWS):
                attempt, margin, path = attempt + 1, 0, None
            elif result is not None and margin + 1 < len(_LIMIT_MARGINS):
                margin = max(margin + 1, 2)
            else:
                why = result or f"no profile of speeds brakes from {start.velocity.round(3).tolist()}"
                raise RetimingError(f"{why} on the {length:.4g} m ahead; keep to the trajectory that the robot drives")

    def _timed(
        self, path: DrivePath, start: _Start, speed: float, margin: tuple[float, float, int]
    ) -> Trajectory | str | None:
        """The path in time; why it would break a limit; or None where the robot cannot brake on it."""
        acceleration = margin[1] * self._acceleration
        if margin[2] > 1:
            path = path.finer(margin[2])
        rate = np.abs(path.y1)
        now = float((np.abs(start.velocity) / self._speed).max())  # part of the limits that the start uses
        with np.errstate(divide="ignore"):
            highest = (self._speed / rate).min(axis=1)  # path speed
        bound = (margin[0] * np.minimum(speed * highest, self._turning(path))) ** 2
        x = float(((start.velocity * self.weight) ** 2).sum())
        if x > bound[0]:  # too fast: brake to the bound, hard but not so hard that there is only one profile to
            falling = braked(path.grid, path.y1, path.y2, acceleration, x, 0.9)
            bound = np.maximum(bound, np.minimum(falling, (now * highest) ** 2))
        profile = fastest(path.grid, path.y1, path.y2, bound, acceleration, x)
        return None if profile is None else self._sampled(path, profile, start, max(speed, now))

    def _turning(self, path: DrivePath) -> Array | float:
        """(G,) path speed at which the base turns as fast as it may."""
        if not (self.limits.drive_dim and np.isfinite(self.turn_speed)):
            return np.inf
        with np.errstate(divide="ignore"):
            return self.turn_speed / np.abs(self.limits.to_twist(path.y1[:, : self.limits.drive_dim])[:, 2])

    def _sampled(self, path: DrivePath, profile: Profile, start: _Start, speed: float) -> Trajectory | str:
        # whole steps only: the robot arrives within the last one, and waits for what is left of it
        time = np.arange(np.ceil(profile.duration / self.dt - 1e-9) + 1.0) * self.dt
        s, rate, change = profile(np.minimum(time, profile.duration))
        s[-1], rate[-1] = path.curve.length, 0.0
        y, y1, y2 = path.curve(s)
        v, a = y1 * rate[:, None], y2 * (rate * rate)[:, None] + y1 * change[:, None]
        a[-1] = 0.0
        why = broken_limit(time, y, v, a, speed * self._speed, self._acceleration)
        if why:
            return why
        return self._trajectory(time + start.time, path.start, y, v, a)

    def _sampled_stop(self, own: _Timed, profile: Profile, start: Array) -> Trajectory | None:
        time = np.arange(np.ceil(profile.duration / self.dt - 1e-9) + 1.0) * self.dt
        tau, rate, change = profile(np.minimum(time, profile.duration))
        y, slope, bend = own(tau)
        v, a = slope * rate[:, None], bend * (rate * rate)[:, None] + slope * change[:, None]
        v[-1] = a[-1] = 0.0
        if broken_limit(time, y, v, a, self._speed, self._acceleration):
            return None
        return self._trajectory(time + own.begin, start, y, v, a)

    def _trajectory(self, time: Array, start: Array, y: Array, v: Array, a: Array) -> Trajectory:
        """Travel, velocities and accelerations (M, m) of drive and joints as a trajectory from ``start`` (nv,)."""
        limits = self.limits
        rows = integrate_travel(self.robot, limits, start, y)
        return Trajectory(self.robot, limits, time, rows, limits.to_tangent(v), limits.to_tangent(a))


@named_arguments
def retime(strip: Strip, limits: MotionLimits | None = None, *, dt: float = 0.01, speed: float = 1.0) -> Trajectory:
    """A whole strip from rest to rest, as fast as the limits allow; it stops at cusps and sharp corners.

    Args:
        strip: the strip.
        limits: :meth:`MotionLimits.for_robot` where None.
        dt: distance of the samples [s].
        speed: as in :meth:`Retimer.horizon`.

    Raises:
        ParameterError: an argument outside its range.
        RetimingError: a piece cannot be driven within the limits.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> trajectory = es.retime(es.plan(robot, es.Scene(), robot.home(), robot.home(x=2.0)))
        >>> halfway = trajectory.at(trajectory.start_time + 0.5 * trajectory.duration)
        >>> round(float(halfway.coordinates[0]), 2)  # x [m]
        1.0
    """
    return Retimer(strip.robot, limits, dt=dt).full(strip.coordinates, speed=speed)


class _Timed:
    """Travel (N, m) over the trajectory's own time τ, with velocities that are linear in between."""

    def __init__(self, time: Array, y: Array, v: Array, begin: float) -> None:
        self.time, self.y, self.v, self.begin = time, y, v, begin
        self.a = (v[1:] - v[:-1]) / (time[1:] - time[:-1])[:, None]

    def __call__(self, tau: Array) -> tuple[Array, Array, Array]:
        """Travel (cubic in between), velocity and acceleration (M, m) at τ (M,)."""
        i = np.searchsorted(self.time[1:-1], tau, side="right")
        h = (self.time[i + 1] - self.time[i])[:, None]
        s = (tau - self.time[i])[:, None] / h
        before, after, mean = self.v[i], self.v[i + 1], (self.y[i + 1] - self.y[i]) / h
        square, cube = 3.0 * mean - 2.0 * before - after, before + after - 2.0 * mean
        return self.y[i] + h * s * (before + s * (square + s * cube)), before + s * h * self.a[i], self.a[i]

    def slowest(self, acceleration: Array) -> Profile | None:
        """The profile over τ that falls from rate 1 as fast as |ÿτ̇² + ẏτ̈| ≤ a allows; None where it does not reach 0.

        At a rate below 1 the trajectory's acceleration is within its limit, so a constant rate is always allowed; and
        of two profiles the lower one stays below the other, so each step may take the hardest braking there is.
        """
        time, v = self.time.copy(), self.v.copy()
        v[0] = v[0] + (self.begin - time[0]) * self.a[0]
        time[0] = self.begin
        h = time[1:] - time[:-1]
        a = np.hstack([v[:-1], v[1:] + 2.0 * h[:, None] * self.a]) / np.tile(acceleration, 2)
        b = np.tile(self.a / acceleration, 2)
        room, slope = rate_bounds(a, b)
        x = np.ones(len(time))
        for i in range(len(h)):
            u = min(float((-room[i] - slope[i] * x[i]).max()), 0.0)
            x[i + 1] = x[i] + 2.0 * h[i] * u
            if x[i + 1] <= _STOPPED_SHARE:
                grid = np.append(time[: i + 1], time[i] - x[i] / (2.0 * u))
                return Profile.of(grid, np.append(x[: i + 1], 0.0))
        return None
