"""Pedestrians: moving obstacles that stop for a robot at rest in their path.

They belong to the simulated world: they react to the robot's true state, and no planner has access to their policy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import LONG_ROUND, ShapeKind, shape_of
from elastic_strips.errors import ParameterError
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.robot.footprint import box_distance
from elastic_strips.scene import Obstacle, PedestrianMotion, World
from elastic_strips.validation import Fraction, NonNegative, Positive, check_fields

_LEAST_OVERLAP = 0.05
"""Vertical gaps below this [m] count as overlap of heights."""
_ROUND_KINDS = (ShapeKind.SPHERE, *LONG_ROUND)


@dataclass(frozen=True, slots=True, eq=False)
class _Discs:
    """An obstacle as upright discs in its own frame.

    Attributes:
        centre: (D, 3) centres [m].
        radius: (D,) radii [m].
        half: (D, 3) half sizes of the discs' pieces [m].
    """

    centre: Array
    radius: Array
    half: Array

    @staticmethod
    def of(obstacle: Obstacle) -> _Discs:
        """The discs of an obstacle: one for each round part, several side by side along other parts."""
        rows: list[tuple[Array, float, Array]] = []
        upright = abs(float(obstacle.pose[2, 2])) > 0.999
        for part in obstacle.parts:
            half = part.half_extents
            along = int(half[1] > half[0])
            long, wide = float(half[along]), float(half[1 - along])
            if not upright:
                rows.append((part.center, part.radius, np.full(3, part.radius)))
            elif shape_of(part.geometry)[0] in _ROUND_KINDS:
                rows.append((part.center, long, half))
            else:
                count = min(math.ceil(long / max(wide, 1e-3)), 8)
                for k in range(count):
                    centre = part.center.copy()
                    centre[along] += long * ((2 * k + 1) / count - 1.0)
                    rows.append((centre, math.hypot(long / count, wide), half))
        centre, radius, half = zip(*rows, strict=True)
        return _Discs(np.array(centre), np.array(radius), np.array(half))


def _distances(footprint: PlanarFootprint, base: Array, discs: _Discs, poses: Array) -> Array:
    """Distances (P,) [m] seen from above of an obstacle at poses (P, 4, 4) from a robot with its base at (x, y, yaw).

    They are infinite where no heights overlap.
    """
    cos, sin = math.cos(base[2]), math.sin(base[2])
    rotation = poses[:, None, :3, :3]
    centre = np.matmul(rotation, discs.centre[:, :, None])[..., 0] + poses[:, None, :3, 3]  # (P, D, 3)
    tall = (np.abs(rotation[..., 2, :]) * discs.half).sum(axis=-1) + _LEAST_OVERLAP  # (P, D)
    local = (centre[..., :2] - base[:2]) @ np.array([[cos, -sin], [sin, cos]])
    offset = local[:, :, None] - footprint.middle  # (P, D, K, 2)
    outside = box_distance(offset[..., 0], offset[..., 1], *footprint.half.T)
    z = centre[..., 2, None]
    level = (z - tall[..., None] <= footprint.high) & (z + tall[..., None] >= footprint.low)
    apart = np.where(level, outside - discs.radius[:, None], np.inf)
    return apart.reshape(len(poses), -1).min(axis=1)


_TIME_ROUNDING = 1e-6  # [s] rounding of times
_BRAKING_STEP = 0.05  # [s] step of a predicted stop
_MOST_BRAKING_STEPS = 200  # steps of a predicted stop
_LEAST_BOUNDING_SPEED = 0.1  # [m/s] least speed that bounds the change of a clock's rate


@dataclass(frozen=True, slots=True, kw_only=True)
class YieldingPolicy:
    """How yielding obstacles treat a robot.

    Attributes:
        distance: distance at which they stop before a robot that stands, seen from above [m].
        standing: a robot stands if no velocity of it is larger than this [m/s, rad/s].
        patience: time for which it must have stood already [s].
        look: how often they look and decide [s].
        onward: an obstacle that has yielded goes on when this much more of its way than its next stop needs is free
            [m].
        aside: an obstacle that comes nearer by less than this [m] passes by.
        room: an obstacle that waits in front of a robot that goes on standing steps back until it is this far away [m];
            less than ``onward``, or it would come back at once. A robot that reckons with all that somebody next to it
            might do cannot go away otherwise.
        wait: how long it waits before that [s].
        pace: part of its own pace at which it steps back.
    """

    distance: NonNegative = 0.25
    standing: NonNegative = 0.02
    patience: NonNegative = 0.2
    look: Positive = 0.05
    onward: NonNegative = 1.0
    aside: NonNegative = 0.005
    room: NonNegative = 0.8
    wait: NonNegative = 1.0
    pace: Fraction = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.room < self.distance + self.onward:
            raise ParameterError(f"{self}: room must be less than distance + onward")


class Pedestrians:
    """Workspace: sets the clocks of a world's yielding obstacles, in every control step.

    They yield to a robot at rest: one that would come too near brakes, in time if it can, waits, and continues when its
    path is free. They yield neither to a moving robot nor to each other. The constructor resets their histories.

    Args:
        robot: the robot that they yield to.
        world: the obstacles over time; without yielding ones a step does nothing.
        policy: how they yield.
    """

    def __init__(self, robot: RobotModel, world: World, policy: YieldingPolicy | None = None) -> None:
        self._policy, self._world = policy or YieldingPolicy(), world
        self._movers = [_Mover(o, o.motion) for o in world.scene if isinstance(o.motion, PedestrianMotion)]
        self._footprint = PlanarFootprint(robot) if self._movers else None
        self._planar = robot.space.planar
        self._moved, self._looked, self._time = -math.inf, -math.inf, math.nan
        for mover in self._movers:
            mover.motion.reset()
        if self._movers:
            world.forget()

    def step(self, t: float, coordinates: Array, v: Array) -> None:
        """Set all clocks from the time ``t`` [s] on.

        Args:
            t: time [s], later than at the last step.
            coordinates: (nv,) true coordinate row of the robot.
            v: (nv,) its true velocity.
        """
        if self._footprint is None:
            return
        policy, dt = self._policy, t - self._time
        self._time = t
        if np.abs(v).max(initial=0.0) >= policy.standing or self._moved == -math.inf:
            self._moved = t
        stands = t - self._moved >= policy.patience - _TIME_ROUNDING
        if t - self._looked >= policy.look - _TIME_ROUNDING:
            self._looked = t
            self._footprint.update(coordinates)
            base = coordinates[:3] if self._planar else np.zeros(3)
            for mover in self._movers:
                if self._world.exists(mover.name, t):
                    mover.decide(t, stands, self._footprint, base, policy)
        for mover in self._movers:
            if dt > 0.0:
                mover.turn(t, dt)


class _Mover:
    """Workspace: a yielding obstacle, the time since when it yields [s], and the wanted rate of its clock."""

    def __init__(self, obstacle: Obstacle, motion: PedestrianMotion) -> None:
        self.name, self.motion, self.wish = obstacle.name or "", motion, 1.0
        self._since: float | None = None
        self._anchor, self._discs = obstacle.anchor, _Discs.of(obstacle)
        self._begin = -math.inf if motion.track.loop else float(motion.track.times[0])
        self._cell = max(float(np.diff(motion.track.times).min(initial=1.0)), 1e-3)

    def turn(self, t: float, dt: float) -> None:
        """Change the rate from ``t`` [s] on towards the wanted one, ``dt`` [s] after the last change."""
        rate = self.motion.rate(t)
        if rate != self.wish:
            self.motion.advance(t, self._towards(self.wish, self.motion.place(t), rate, dt))

    def decide(self, t: float, stands: bool, footprint: PlanarFootprint, base: Array, policy: YieldingPolicy) -> None:
        """Decide to go on, to stop, or to step back."""
        if self._since is None and not stands:
            return
        place, rate = self.motion.place(t), self.motion.rate(t)
        path = self._stop(place, rate, policy.look)
        if self._since is not None:
            pace = max(self._speed(path[-1]), _LEAST_BOUNDING_SPEED)
            path += (path[-1] + np.linspace(0.1, 1.0, 10) * (policy.onward / pace)).tolist()
        near = _distances(footprint, base, self._discs, self._poses(path))
        here = float(near[0])
        limit = min(policy.distance, here - policy.aside)  # too near already: at least not nearer
        if near.min() >= limit:
            self.wish, self._since = 1.0, None
            return
        if self._since is None:
            self._since = t
        self.wish = 0.0
        if stands and here < policy.room and t - self._since >= policy.wait and place > self._begin:
            back = self._poses([place, place - 0.25, place - 0.5])
            if _distances(footprint, base, self._discs, back).min() >= here - policy.aside:
                self.wish = -policy.pace

    def _stop(self, place: float, rate: float, late: float) -> list[float]:
        """Places on the track [s], from the present one to the end of a stop that begins in ``late`` [s]."""
        places = [place, place + rate * late]
        while rate != 0.0 and len(places) < _MOST_BRAKING_STEPS:
            places.append(places[-1] + rate * _BRAKING_STEP)
            rate = self._towards(0.0, places[-1], rate, _BRAKING_STEP)
        return places

    def _towards(self, wish: float, place: float, rate: float, dt: float) -> float:
        """The rate [s/s] that is reached after ``dt`` [s] towards a wanted one; no clock runs faster than others.

        Where its track brakes harder than it may, it would have to go on along it faster.
        """
        down, up = self._changes(place, rate)
        return min(max(wish, rate + dt * down, -1.0), rate + dt * up, 1.0)

    def _changes(self, place: float, rate: float) -> tuple[float, float]:
        """Least and largest change of the rate [1/s] that keep the obstacle within its acceleration.

        At the rate r along a track p the acceleration is r' p' + r² p''; p'' is taken on both sides of the place. Where
        the track alone exceeds the acceleration, the rate can only decrease.
        """
        limit, h = self.motion.acceleration, self._cell
        before, v, after = (self.motion.track.velocity(self._anchor, place + d)[0] for d in (-h, 0.0, h))
        speed = math.sqrt(max(float(v @ v), float(after @ after)))
        most = limit / max(speed, _LEAST_BOUNDING_SPEED)
        down, up = -most, most
        square = float(v @ v)
        if square < 1e-12:
            return down, up
        for turn in (v - before, after - v):
            a = rate * rate / h * turn
            along = float(a @ v) / square
            left = along * along - (float(a @ a) - limit * limit) / square
            if left <= 0.0:
                return -most, 0.0
            down, up = max(down, -along - math.sqrt(left)), min(up, -along + math.sqrt(left))
        return down, up

    def _speed(self, place: float) -> float:
        return float(np.linalg.norm(self.motion.track.velocity(self._anchor, place)[0]))

    def _poses(self, places: list[float]) -> Array:
        return np.array([self.motion.track.pose(self._anchor, s) for s in places])
