"""Sensing room, tracks: one thing followed from scan to scan with a constant-velocity Kalman filter in the plane."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..robot.space import Array
from ..scene import Cylinder, Motion, Obstacle, Twist, Unknown
from .cluster_shapes import OTHER, ROUND, Footprint
from .clusters import Cluster
from .estimator_params import SceneEstimatorParams

_KEPT_POINTS = 64
_SLACK = 0.01
"""A mover's solid is made that much larger [m] than it has to be, so that it need not be made anew at once."""


class TrackState(Enum):
    """How sure a track is."""

    TENTATIVE = "tentative"
    CONFIRMED = "confirmed"
    LOST = "lost"


@dataclass(frozen=True, slots=True, eq=False)
class TrackedObstacle:
    """A mover as the sensors have it: an upright cylinder with a velocity, and how sure both are.

    Attributes:
        name: of the track and of the obstacle, ``"track-3"``; it stays with the thing.
        obstacle: with its pose and `Twist` at `time`, or `Unknown` where that is all that is known; its solid is
            the same object as long as its size is.
        time: of the estimate [s].
        position: (2,) of the cylinder's axis [m].
        velocity: (2,) [m/s].
        position_sigma: standard deviation of the position along any direction [m].
        velocity_sigma: the same of the velocity [m/s].
        radius: of the cylinder, with padding [m].
        seen: when it was last seen [s].
        age: since it was first seen [s].
    """

    name: str
    obstacle: Obstacle
    time: float
    position: Array
    velocity: Array
    position_sigma: float
    velocity_sigma: float
    radius: float
    seen: float
    age: float

    def within(self, position_error: float, velocity_error: float, *, sigmas: float = 3.0) -> bool:
        """Whether ``sigmas`` standard deviations are no more than what a planner assumes [m, m/s]."""
        return sigmas * self.position_sigma <= position_error and sigmas * self.velocity_sigma <= velocity_error


class Track:
    """Workspace: the state of one thing.

    Noise is the same in all directions, so x and y share one covariance [[pp, pv], [pv, vv]] and no matrices are
    needed.
    """

    __slots__ = (
        "born",
        "fitted",
        "hits",
        "misses",
        "moved",
        "moving",
        "number",
        "p",
        "points",
        "pp",
        "pv",
        "radius",
        "rested",
        "seen",
        "solid",
        "solid_radius",
        "state",
        "stirred",
        "time",
        "v",
        "votes",
        "vv",
    )

    def __init__(self, number: int, time: float, cluster: Cluster, shape: Footprint, params: SceneEstimatorParams):
        self.number, self.time, self.born, self.seen = number, time, time, time
        self.p, self.v = np.array(shape.center), np.zeros(2)
        self.pp, self.pv, self.vv = _noise(cluster, shape, params, shape.radius), 0.0, (0.5 * params.max_speed) ** 2
        self.fitted = self.radius = shape.radius
        self.hits, self.misses, self.votes = 1, 0, 0
        self.state, self.moving = TrackState.TENTATIVE, False
        # when it last moved, when it came to rest, and when scans last contradicted that it stands
        self.moved = self.rested = self.stirred = -math.inf
        self.points: deque[tuple[float, Array]] = deque([(time, cluster.points)], maxlen=_KEPT_POINTS)
        self.solid: Cylinder | None = None
        self.solid_radius = 0.0

    @property
    def name(self) -> str:
        return f"track-{self.number}"

    @property
    def speed(self) -> float:
        return math.hypot(self.v[0], self.v[1])

    def predict(self, time: float, params: SceneEstimatorParams) -> None:
        """Go on at the same velocity; the acceleration is noise, constant within a step."""
        dt = max(time - self.time, 0.0)
        q = params.mover_acceleration**2
        self.p = self.p + dt * self.v
        self.pp += dt * (2.0 * self.pv + dt * self.vv) + 0.25 * q * dt**4
        self.pv += dt * self.vv + 0.5 * q * dt**3
        self.vv += q * dt * dt
        self.time = max(time, self.time)

    def measured(self, cluster: Cluster, shape: Footprint) -> Array:
        """(2,) where the cluster has the thing's centre, given the radius that earlier scans had [m].

        Of a circle the side next to the sensor is known well and its far side is not: the centre is put behind the
        near side by the radius of all scans, not of this one.
        """
        center = np.array(shape.center)
        if shape.kind != ROUND or self.hits < 2:
            return center
        view = center - cluster.origin
        return center + view / max(float(np.hypot(view[0], view[1])), 1e-9) * (self.fitted - shape.radius)

    def distance2(self, cluster: Cluster, shape: Footprint, params: SceneEstimatorParams) -> float:
        """Squared Mahalanobis distance of a cluster; infinite where it is too far for anything that moves."""
        d = self.measured(cluster, shape) - self.p
        square = float(d @ d)
        size = abs(shape.radius - self.fitted) / (0.1 + 0.3 * self.fitted)
        return square / (self.pp + _noise(cluster, shape, params, self.fitted)) + size * size

    def correct(self, cluster: Cluster, shape: Footprint, params: SceneEstimatorParams) -> None:
        """Take a cluster in."""
        noise = _noise(cluster, shape, params, self.fitted)
        total = self.pp + noise
        gain_p, gain_v = self.pp / total, self.pv / total
        d = self.measured(cluster, shape) - self.p
        self.p, self.v = self.p + gain_p * d, self.v + gain_v * d
        self.vv -= gain_v * self.pv
        self.pp, self.pv = (1.0 - gain_p) * self.pp, (1.0 - gain_p) * self.pv
        if self.speed > params.max_speed:
            self.v *= params.max_speed / self.speed
        self.hits += 1
        self.misses = 0
        self.seen = self.time
        self.points.append((self.time, cluster.points))
        if shape.kind != OTHER or not cluster.hidden:
            self.fitted += (shape.radius - self.fitted) / min(self.hits, 20)
        far = float(np.hypot(*(cluster.points - self.p).T).max())
        needed = min(max(self.fitted, far), 0.75 * params.max_mover_size)
        self.radius = needed if needed > self.radius else self.radius + 0.1 * (needed - self.radius)
        if self.state is TrackState.TENTATIVE and self.hits >= params.confirm_hits:
            self.state = TrackState.CONFIRMED

    def significant(self, params: SceneEstimatorParams) -> bool:
        """Whether it is faster than what stands, and than its uncertainty."""
        return self.speed >= max(params.min_speed, params.significance * math.sqrt(self.vv))

    def wary(self, params: SceneEstimatorParams) -> bool:
        """Whether it has moved, stands, and may set off again."""
        return not self.moving and self.time - self.rested <= params.wary_time

    def stirring(self, params: SceneEstimatorParams) -> bool:
        """Whether scans contradict that it stands, while its velocity is not known yet."""
        return not self.moving and self.time - self.stirred <= params.stir_time

    def past_points(self, time: float) -> Array:
        """The newest points that are not younger than ``time`` [s]; empty where there are none."""
        for t, points in reversed(self.points):
            if t <= time:
                return points
        return np.zeros((0, 2))

    def tracked(self, params: SceneEstimatorParams) -> TrackedObstacle:
        """The mover as a value; its solid is made anew only where its radius has changed."""
        wanted = self.radius + params.padding
        if self.solid is None or not self.solid_radius - params.shape_change - _SLACK <= wanted <= self.solid_radius:
            self.solid_radius = wanted + _SLACK
            self.solid = Cylinder(self.solid_radius, params.height, name=self.name, motion=Twist())
        pose = np.eye(4)
        pose[:2, 3], pose[2, 3] = self.p, 0.5 * params.height
        pose.flags.writeable = False
        position, velocity = self.p.copy(), self.v.copy()
        position.flags.writeable = velocity.flags.writeable = False
        motion: Motion = Twist(np.array([velocity[0], velocity[1], 0.0]))
        if self.stirring(params):
            motion = Unknown(min(params.stir_speed, self.speed + 2.0 * math.sqrt(self.vv)))
        elif not self.moving:
            motion = Unknown(params.wary_speed)
        return TrackedObstacle(
            name=self.name,
            obstacle=self.solid.at(self.time).sensed(pose, motion),
            time=self.time,
            position=position,
            velocity=velocity,
            position_sigma=math.sqrt(self.pp),
            velocity_sigma=math.sqrt(self.vv),
            radius=self.solid_radius,
            seen=self.seen,
            age=self.time - self.born,
        )


def _noise(cluster: Cluster, shape: Footprint, params: SceneEstimatorParams, radius: float) -> float:
    """Variance of a cluster's centre along any direction, given the radius of earlier scans [m²]."""
    fit = 2.0 if shape.kind == ROUND else 4.0
    variance = (fit * params.range_noise) ** 2 + params.pose_noise**2
    if cluster.hidden:  # how much is missing beyond the hidden end, and where a straight thing is along itself
        chord = cluster.points[-1] - cluster.points[0]
        variance += max(radius - 0.5 * math.hypot(chord[0], chord[1]), 0.0) ** 2
        if shape.kind != ROUND:
            variance += (0.5 * max(shape.size)) ** 2
    return variance
