"""Scene room, yielding: a known track that is followed by a clock of its own, which slows down and stops for somebody.

Who slows the clock is not said here; see `elastic_strips.sim.pedestrians`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Any

from elastic_strips.errors import SceneError
from elastic_strips.scene import checks
from elastic_strips.scene.checks import Array
from elastic_strips.scene.motion import Keyframes, Motion, check_radius
from elastic_strips.scene.world import World

_SLACK = 1e-9  # [s] by which a place on the track may be rounded


class Yielding(Motion):
    """Workspace, the one motion that is not frozen: a track, and the history of how fast it has been followed.

    At the time t the obstacle is where its track has it at the track's time s(t). Before time 0, s = t; from then on
    the loop that owns the motion says by `advance` at which rate ds/dt, -1 to 1, s goes on (below 0: it steps back); it
    goes on so until it is told otherwise. What has been is never changed by that. All copies of an obstacle share its
    motion.

    Args:
        track: Where the obstacle moves if nobody stands in its way; a loop must not jump.
        acceleration: Most that the obstacle accelerates in any direction, its track's own turns included [m/s²];
            whoever sets the rates keeps to it.

    Raises:
        SceneError: No track, one that jumps, or an acceleration that is not positive.
    """

    __slots__ = ("_places", "_rates", "_times", "acceleration", "track")

    track: Keyframes
    acceleration: float
    _times: list[float]  # begin of each piece of the history [s]; the first reaches back for ever
    _places: list[float]  # of the track [s], at these times
    _rates: list[float]

    def __init__(self, track: Keyframes, acceleration: float = math.inf) -> None:
        if not isinstance(track, Keyframes):
            raise SceneError(f"Yielding needs Keyframes as its track, not {checks.shown(track)}")
        if track.jumps:
            raise SceneError("a Yielding motion cannot follow a loop that jumps: its last pose must be its first one")
        if not acceleration > 0.0:
            raise SceneError(f"Yielding acceleration={acceleration!r} must be positive [m/s²]")
        self.track, self.acceleration = track, float(acceleration)
        self.reset()

    def reset(self) -> None:
        """Forget the history: the track's own pace, at all times."""
        self._times, self._places, self._rates = [0.0, 0.0], [0.0, 0.0], [1.0, 1.0]

    def advance(self, t: float, rate: float) -> None:
        """From the time ``t`` [s] on, at which the history has arrived, follow the track at ``rate``, -1 to 1.

        Raises:
            SceneError: A rate outside its range, or a time before the last one that was given.
        """
        if not -1.0 <= rate <= 1.0:
            raise SceneError(f"rate={rate!r} must lie in [-1, 1]")
        if not self._times[-1] <= t < math.inf:
            raise SceneError(f"time {t:g} s is before {self._times[-1]:g} s; what has been cannot be changed")
        if rate == self._rates[-1]:
            return
        if t > self._times[-1]:
            self._places.append(self.place(t))
            self._times.append(float(t))
            self._rates.append(float(rate))
        else:
            self._rates[-1] = float(rate)

    def place(self, t: float) -> float:
        """The track's time s [s] at the time ``t`` [s]."""
        k = self._piece(t)
        return self._places[k] + self._rates[k] * (t - self._times[k])

    def rate(self, t: float) -> float:
        """ds/dt from the time ``t`` [s] on."""
        return self._rates[self._piece(t)]

    @property
    def relative(self) -> bool:
        """False: the track is absolute."""
        return False

    def pose(self, initial_pose: Array, t: float) -> Array:
        """Pose (4, 4) at time ``t`` [s]; see `Keyframes.pose`."""
        return self.track.pose(initial_pose, self.place(t))

    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """The track's velocities (3,) [m/s] and (3,) [rad/s], times the rate; see `Motion.velocity`."""
        k = self._piece(t)
        linear, angular = self.track.velocity(initial_pose, self._places[k] + self._rates[k] * (t - self._times[k]))
        return self._rates[k] * linear, self._rates[k] * angular

    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of a point within ``radius`` [m] of the origin between ``start`` and ``end`` [s].

        True of what has been; of what is to come, whatever rates will be given.
        """
        radius = check_radius(radius)
        begin = -math.inf if start is None else float(start)
        stop = math.inf if end is None else float(end)
        if not begin <= stop:
            raise SceneError(f"speed_bound needs start <= end, not {begin:g} and {stop:g} s")
        last, first, final = self._times[-1], self._piece(begin), self._piece(stop)
        places = [self.place(min(begin, last)), *self._places[first + 1 : final + 1]]
        if stop > last:
            low, high, rate = min(places) - (stop - last), max(places) + (stop - last), 1.0
        else:
            places.append(self.place(stop))
            low, high, rate = min(places), max(places), max(map(abs, self._rates[first : final + 1]))
        return rate * self.track.speed_bound(radius, start=low - _SLACK, end=high + _SLACK)

    def copy(self, *, history: bool = True) -> Yielding:
        """Another motion along the same track, with the same history or with none."""
        new = Yielding(self.track, self.acceleration)
        if history:
            new._times, new._places, new._rates = list(self._times), list(self._places), list(self._rates)
        return new

    def _piece(self, t: float) -> int:
        return max(bisect_right(self._times, t) - 1, 0)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.track, self.acceleration, list(self._times), list(self._places), list(self._rates))


def copied(world: World, *, history: bool = True) -> World:
    """A world whose yielding obstacles have clocks of their own; the world itself where none yields.

    Args:
        world: What may go on in its own way.
        history: Whether the copy keeps how its obstacles have yielded so far, or begins anew.
    """
    new = []
    for obstacle in world.scene:
        if isinstance(obstacle.motion, Yielding):
            motion = obstacle.motion.copy(history=history)
            pose = motion.pose(obstacle.anchor, obstacle.time)
            pose.flags.writeable = False
            new.append(obstacle.sensed(pose, motion))
    return World(world.scene.seen(new), world.appears, world.vanishes) if new else world


def _restored(
    track: Keyframes, acceleration: float, times: list[float], places: list[float], rates: list[float]
) -> Yielding:
    new = Yielding(track, acceleration)
    new._times, new._places, new._rates = times, places, rates
    return new
