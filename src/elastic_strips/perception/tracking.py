"""Tracking: things followed from scan to scan with Kalman filters, and whether they move, rest or are lost."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.scene import Cylinder, Motion, Obstacle, Twist, UnknownMotion

from .clusters import OTHER, ROUND, Cluster, ClusterShape, fit_shape
from .params import SceneEstimatorParams

_KEPT_POINTS = 64  # of a thing
_WIDTH_ERROR = 0.25  # standard deviation of the width of a thing, as a part of it: it turns, say
_WIDTH_FOR = 1.5  # [s] for which a thing is as wide as it was seen to be: later it has turned
_SOLID_SLACK = 0.01
"""A mover's solid is made this much larger [m] than it has to be, so that it need not be made anew at once."""

_HEIGHTS = (0.35, 1.05)  # [m] between which images look for what only a plane has seen
_LEAST_PART, _MOST_PART = 20.0, 80.0  # of its points, in percent, between whose heights images look for what they saw

_REMEMBERED_SHARE = 0.8  # of how far a thing was from where it was expected, from one time it is seen to the next
_MOST_ASIDE = 0.2
"""A mover that is so far [m] aside from where it is expected, time after time, does not move as it seems to: of what
comes out from behind something, the middle of what is seen moves by itself."""
_STRAY_STEP = 0.05
"""A mover's solid grows in such steps [m] while it is not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedObstacle:
    """A moving obstacle as the sensors see it: an upright cylinder with a velocity, and how certain both are.

    Attributes:
        name: name of the track and of the obstacle, ``"track-3"``; it stays with the thing.
        obstacle: obstacle with its pose and `Twist` at `time`, or with `UnknownMotion` where that is all that is known;
            its solid is the same object as long as its size is.
        time: time of the estimate [s].
        position: (2,) position of the cylinder's axis [m].
        velocity: (2,) velocity of the axis [m/s].
        position_sigma: standard deviation of the position along any direction [m].
        velocity_sigma: the same for the velocity [m/s].
        radius: radius of the cylinder, with padding [m].
        seen: time at which it was last seen [s].
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


class Track:
    """Workspace: the state of one thing.

    Noise is the same in all directions, so x and y share one covariance [[pp, pv], [pv, vv]] and no matrices are
    needed.
    """

    fitted: float
    radius: float
    confirmed: bool
    moved: float
    displaced_at: float
    rested: float

    def __init__(
        self,
        number: int,
        time: float,
        cluster: Cluster,
        shape: ClusterShape,
        params: SceneEstimatorParams,
        sensor: str = "laser",
    ) -> None:
        self.number: int = number
        self.seen_by: dict[str, float] = {sensor: time}  # when each sensor that has seen it last did [s]
        self.time: float = time
        self.seen: float = time
        self.p: Array = np.array(shape.center)
        self.v: Array = np.zeros(2)
        self.pp: float = _noise(cluster, shape, params, shape.radius)
        self.pv: float = 0.0
        self.vv: float = (0.5 * params.max_speed) ** 2
        self.fitted = self.radius = shape.radius
        self.half_width: float = 0.0  # across the view, on average of when it was seen whole of late [m]
        self.whole: int = 0  # how often it was seen so …
        self.whole_at: float = -math.inf  # … and when last [s]
        self.hits: int = 1
        self.misses: int = 0
        self.votes: int = 0
        self.contradicted: int = 0  # how often scans did, of late
        self.aside: Array = np.zeros(2)  # how far it was from where it was expected, on average of late [m]
        self.confirmed = self.lost = self.moving = False
        # when it last moved, when it came to rest, and when scans last contradicted that it stands
        self.moved = self.rested = -math.inf
        self.displaced_at = time if cluster.displaced else -math.inf
        self.points: deque[tuple[float, Array]] = deque([(time, cluster.points)], maxlen=_KEPT_POINTS)
        self.solids: deque[Array] = deque([cluster.solid], maxlen=_KEPT_POINTS)
        self.heights: Array = _heights(cluster, np.array(_HEIGHTS))  # between which images look for it [m]
        self.solid: Cylinder | None = None
        self.solid_radius: float = 0.0

    @property
    def name(self) -> str:
        """Of the track and of its obstacle."""
        return f"track-{self.number}"

    @property
    def speed(self) -> float:
        """[m/s]."""
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

    def measured(self, cluster: Cluster, shape: ClusterShape) -> Array:
        """(2,) where the cluster has the thing's centre, given the radius that earlier scans had [m].

        Of a circle the side next to the sensor is known well and its far side is not: the centre is put behind the
        near side by the radius of all scans, not of this one. Of what leaves the view, or goes behind something, one
        end is still seen: its middle is as far from that as it was when it was seen whole.
        """
        center = np.array(shape.center)
        if shape.kind == ROUND:
            if self.hits < 2:
                return center
            view = center - cluster.origin
            return center + view / max(float(np.hypot(view[0], view[1])), 1e-9) * (self.fitted - shape.radius)
        if self._half_seen(cluster):
            first = cluster.covered[0]
            end = cluster.points[-1 if first else 0]
            across = _across(end - cluster.origin) * (-1.0 if first else 1.0)
            center = center + max(self.half_width - float((center - end) @ across), 0.0) * across
            # how far away its middle is, a part of it hardly tells: where it is expected, as far as that fits to it
            ahead = np.array([across[1], -across[0]]) * (-1.0 if first else 1.0)
            far = cluster.points @ ahead
            fits = min(max(float(self.p @ ahead), float(far.min())), float(far.max()) + self.fitted)
            return center + (fits - float(center @ ahead)) * ahead
        return center

    def _half_seen(self, cluster: Cluster) -> bool:
        """Whether a cluster is a part of it with one of its ends, and how wide it is was seen a moment ago."""
        return self.time - self.whole_at <= _WIDTH_FOR and cluster.covered[0] != cluster.covered[1]

    def _noise(self, cluster: Cluster, shape: ClusterShape, params: SceneEstimatorParams) -> float:
        """Variance of a cluster's centre along any direction [m²]."""
        if shape.kind != ROUND and self._half_seen(cluster):
            return _noise(None, shape, params, self.fitted) + (_WIDTH_ERROR * self.half_width) ** 2
        return _noise(cluster, shape, params, self.fitted)

    def distance2(self, cluster: Cluster, shape: ClusterShape, params: SceneEstimatorParams) -> float:
        """Squared Mahalanobis distance of a cluster; infinite where it is too far for anything that moves."""
        d = self.measured(cluster, shape) - self.p
        square = float(d @ d)
        size = abs(shape.radius - self.fitted) / (0.1 + 0.3 * self.fitted)
        return square / (self.pp + self._noise(cluster, shape, params)) + size * size

    def correct(self, cluster: Cluster, shape: ClusterShape, params: SceneEstimatorParams) -> None:
        """Take a cluster in."""
        noise = self._noise(cluster, shape, params)
        total = self.pp + noise
        gain_p, gain_v = self.pp / total, self.pv / total
        d = self.measured(cluster, shape) - self.p
        self.aside = _REMEMBERED_SHARE * self.aside + (1.0 - _REMEMBERED_SHARE) * d
        self.p, self.v = self.p + gain_p * d, self.v + gain_v * d
        self.vv -= gain_v * self.pv
        self.pp, self.pv = (1.0 - gain_p) * self.pp, (1.0 - gain_p) * self.pv
        if self.speed > params.max_speed:
            self.v *= params.max_speed / self.speed
        self.hits += 1
        self.misses = 0
        self.seen = self.time
        self.points.append((self.time, cluster.points))
        if len(cluster.solid):
            self.solids.append(cluster.solid)
        self.heights = _heights(cluster, self.heights)
        if not cluster.hidden:
            self.whole, self.whole_at = self.whole + 1, self.time
            away = cluster.points - cluster.origin
            wide = 0.5 * float(np.ptp(away @ _across(away.mean(axis=0))))
            self.half_width += (wide - self.half_width) / min(self.whole, 5)
        if not cluster.hidden or (shape.kind != OTHER and not self._half_seen(cluster)):
            self.fitted += (shape.radius - self.fitted) / min(self.hits, 20)
        far = float(np.hypot(*(cluster.points - self.p).T).max())
        needed = min(max(self.fitted, far), 0.75 * params.max_mover_size)
        self.radius = needed if needed > self.radius else self.radius + 0.1 * (needed - self.radius)
        self.confirmed = self.confirmed or self.hits >= params.confirm_hits

    def significant(self, params: SceneEstimatorParams) -> bool:
        """Whether it is faster than things at rest, and than its uncertainty."""
        return self.speed >= max(params.min_speed, params.significance * math.sqrt(self.vv))

    def stands(self, params: SceneEstimatorParams) -> bool:
        """Whether it is known to be there, and nothing has shown of late that it moves."""
        calm = self.time - self.displaced_at > params.rest_time and not self.recently_moved(params)
        return self.confirmed and not self.moving and calm

    def lately_seen_by_another(self, sensor: str) -> bool:
        """Whether a sensor that is not this one sees it."""
        return any(self.time - seen <= _SEES_FOR for other, seen in self.seen_by.items() if other != sensor)

    def recently_moved(self, params: SceneEstimatorParams) -> bool:
        """Whether it has moved, stands, and may set off again."""
        return not self.moving and self.time - self.rested <= params.recent_motion_time

    def begins_to_move(self, params: SceneEstimatorParams) -> bool:
        """Whether scans show that it does not stand, while its velocity is not known yet."""
        return not self.moving and self.time - self.displaced_at <= params.motion_onset_time

    def may_creep(self, params: SceneEstimatorParams) -> bool:
        """Whether scans have shown several times of late that it does not stand, and its velocity is not known.

        What creeps up to a voxel's width in a few scans shows that in some of them only.
        """
        return (
            not self.moving and self.contradicted >= _LEAST_VOTES and self.time - self.displaced_at <= params.rest_time
        )

    def past_points(self, time: float) -> Array:
        """The newest points that are not younger than ``time`` [s]; empty where there are none."""
        for t, points in reversed(self.points):
            if t <= time:
                return points
        return np.zeros((0, 2))

    def _strayed(self, params: SceneEstimatorParams) -> float:
        """How far it may be [m] from where it would be at the same velocity, since it was last seen, in steps."""
        far = 0.5 * params.mover_acceleration * (self.time - self.seen) ** 2
        return min(math.floor(far / _STRAY_STEP) * _STRAY_STEP, params.stray_width)

    def tracked(self, params: SceneEstimatorParams) -> TrackedObstacle:
        """The mover as a value; its solid is made anew only where its radius has changed."""
        wanted = self.radius + params.padding + self._strayed(params)
        if (
            self.solid is None
            or not self.solid_radius - params.shape_change - _SOLID_SLACK <= wanted <= self.solid_radius
        ):
            self.solid_radius = wanted + _SOLID_SLACK
            self.solid = Cylinder(self.solid_radius, params.tallest, name=self.name, motion=Twist())
        pose = np.eye(4)
        pose[:2, 3], pose[2, 3] = self.p, 0.5 * params.tallest
        pose.flags.writeable = False
        position, velocity = self.p.copy(), self.v.copy()
        position.flags.writeable = velocity.flags.writeable = False
        motion: Motion = Twist(np.array([velocity[0], velocity[1], 0.0]))
        astray = self.moving and math.hypot(self.aside[0], self.aside[1]) > _MOST_ASIDE
        if astray or self.begins_to_move(params):
            motion = UnknownMotion(min(params.motion_onset_speed, self.speed + 2.0 * math.sqrt(self.vv)))
        elif not self.moving:
            speed = self.speed if self.may_creep(params) else 0.0
            motion = UnknownMotion(min(params.motion_onset_speed, max(params.recent_motion_speed, speed)))
        return TrackedObstacle(
            name=self.name,
            obstacle=self.solid.at(self.time).observed(pose, motion),
            time=self.time,
            position=position,
            velocity=velocity,
            position_sigma=math.sqrt(self.pp),
            velocity_sigma=math.sqrt(self.vv),
            radius=self.solid_radius,
            seen=self.seen,
        )


def _heights(cluster: Cluster, known: Array) -> Array:
    """(2,) between which heights [m] most of a thing was seen last; ``known`` where only a plane sees it."""
    if not len(cluster.solid):
        return known
    return np.percentile(cluster.solid[:, 2], (_LEAST_PART, _MOST_PART))


def _across(view: Array) -> Array:
    """Unit vector (2,) across a view, counter-clockwise."""
    return np.array([-view[1], view[0]]) / max(float(np.hypot(view[0], view[1])), 1e-9)


def _noise(cluster: Cluster | None, shape: ClusterShape, params: SceneEstimatorParams, radius: float) -> float:
    """Variance of a cluster's centre along any direction, given the radius of earlier scans [m²]; where None, of one
    that is seen whole."""
    fit = 2.0 if shape.kind == ROUND else 4.0
    variance = (fit * params.range_noise) ** 2 + params.pose_noise**2
    if cluster is not None and cluster.hidden:
        # how much is missing beyond the hidden end, and where a straight thing is along itself
        chord = cluster.points[-1] - cluster.points[0]
        variance += max(radius - 0.5 * math.hypot(chord[0], chord[1]), 0.0) ** 2
        if shape.kind != ROUND:
            variance += (0.5 * max(shape.size)) ** 2
    return variance


class View(Protocol):
    """A reading in the world, as tracks are judged by it."""

    @property
    def time(self) -> float:
        """When it was measured [s]."""
        ...

    def beyond(self, points: Array, margin: float, heights: Array) -> tuple[Mask, Mask]:
        """Which places (n, 2) it sees through by more than ``margin`` [m], and which it could not see.

        Args:
            points: the places [m].
            margin: how much further it must see [m].
            heights: (n, 2) between which something would be there [m].
        """
        ...


_VIEW_STEP = 0.04
_MAX_VIEWS = 64
_LOOK_BACK_DISTANCE = 0.3
"""A thing is looked for where it was this far [m] ago, or as long ago as ``history``."""
_LEAST_EVIDENCE = 0.2
_LEAST_VOTES = 2
_SEES_FOR = 0.3
"""A sensor sees a thing if it has last seen it no more than this long [s] before any sensor has."""


class Tracker:
    """Workspace: follows clusters that are small enough to be movers; nothing in it is random.

    A track is a *mover* once it is confirmed, its speed is significant, and the scans agree: it is now where an earlier
    scan saw through, or this scan sees through where it was. The visible end of a wall that wanders along it with the
    viewpoint does neither.

    Attributes:
        lost: movers whose tracks ended in the last update, because nothing had seen them for ``coast_time``, or because
            something is seen through where they should be by now.
    """

    def __init__(self, params: SceneEstimatorParams) -> None:
        self.params = params
        self._tracks: list[Track] = []
        self._views: dict[str, deque[View]] = {}
        self._born = 0
        self._traces: list[Array] = []
        self.lost: list[Track] = []

    def __len__(self) -> int:
        """How many things are followed, movers or not."""
        return len(self._tracks)

    @property
    def movers(self) -> tuple[TrackedObstacle, ...]:
        """The things that move, by age."""
        return tuple(t.tracked(self.params) for t in self._tracks if t.moving)

    @property
    def moving(self) -> tuple[Track, ...]:
        """The tracks of :attr:`movers`."""
        return tuple(t for t in self._tracks if t.moving)

    @property
    def possibly_moving(self) -> tuple[TrackedObstacle, ...]:
        """Things that have moved and may set off again, or begin to: with bounds of their speeds, by age."""
        p = self.params
        return tuple(t.tracked(p) for t in self._tracks if t.recently_moved(p) or t.begins_to_move(p) or t.may_creep(p))

    def traces(self) -> Array:
        """(n, 3) where images have seen things that turned out to move by the last update [m]."""
        return np.concatenate([np.zeros((0, 3)), *self._traces])

    def update(self, now: View, clusters: Sequence[Cluster], sensor: str = "laser") -> Array:
        """Take a ``sensor``'s reading in: assign its clusters, judge tracks that were not seen, begin new tracks.

        Returns:
            (n, 2) points in the world that turned out to belong to a mover and not to the static world.
        """
        params = self.params
        self._traces.clear()
        self.lost = []
        for track in self._tracks:
            track.predict(now.time, params)
        small = [c for c in clusters if c.extent <= params.max_mover_size]
        small += self._set_apart([c for c in clusters if c.extent > params.max_mover_size], now, sensor)
        small = [c for c in small if len(c.points) >= params.min_points]
        shapes = [fit_shape(c, params) for c in small]
        pairs = self._assign(small, shapes, sensor)
        moved: list[Array] = []
        seen, used = set(), set()
        for k, j in pairs:
            track = self._tracks[k]
            track.correct(small[j], shapes[j], params)
            track.seen_by[sensor] = track.time
            seen.add(k)
            used.add(j)
        met = [(self._tracks[k], small[j]) for k, j in pairs]
        for (track, cluster), displaced in zip(met, self._displaced(met, now, sensor), strict=True):
            self._judge(track, cluster, displaced, moved)
        whole = [track for track, _ in met if track.moving]
        self._missed([track for k, track in enumerate(self._tracks) if k not in seen], now, sensor)
        self._tracks = [t for t in self._tracks if not t.lost]
        self._begin([(small[j], shapes[j]) for j in range(len(small)) if j not in used], whole, now.time, sensor)
        views = self._views.setdefault(sensor, deque(maxlen=_MAX_VIEWS))
        if not views or now.time - views[-1].time >= _VIEW_STEP:
            views.append(now)
        return np.concatenate([np.zeros((0, 2)), *moved])

    def of_movers(self, points: Array) -> Mask:
        """Which of the points (n, 2) lie within movers, with their padding."""
        return _within(self.moving, points, self.params.padding)

    def may_have_moved(self, points: Array, within: float) -> Mask:
        """Which of the points (n, 2) may be of things that have moved within some time [s], movers or not yet."""
        params = self.params
        inside = np.zeros(len(points), dtype=bool)
        for track in self._tracks:
            if track.moving or track.speed > params.min_speed or track.recently_moved(params):
                d = points - track.p
                far = track.radius + params.padding + track.speed * within
                inside |= np.hypot(d[:, 0], d[:, 1]) <= far
        return inside

    def _set_apart(self, large: list[Cluster], now: View, sensor: str) -> list[Cluster]:
        """The parts of clusters that are too large to move that are where an earlier scan saw through: who steps out
        from behind a wall, or along it, is seen as a part of it at first."""
        params = self.params
        large = [cluster for cluster in large if cluster.displaced is None]
        view = next((v for v in reversed(self._views.get(sensor, ())) if v.time <= now.time - params.history), None)
        if view is None or not large:
            return []
        points = np.concatenate([cluster.points for cluster in large])
        through, _ = view.beyond(points, params.carve_margin, np.broadcast_to(_HEIGHTS, (len(points), 2)))
        apart: list[Cluster] = []
        for cluster, own in zip(large, np.split(through, np.cumsum([len(c.points) for c in large])[:-1]), strict=True):
            if own.any():
                parts = np.split(cluster.points, np.flatnonzero(np.diff(own)) + 1)[0 if own[0] else 1 :: 2]
                found = [Cluster(part, cluster.origin, (True, True)) for part in parts]
                apart += [part for part in found if part.extent <= params.max_mover_size]
        return apart

    def _assign(self, clusters: list[Cluster], shapes: list[ClusterShape], sensor: str) -> list[tuple[int, int]]:
        """Which cluster is which track's.

        A track that is not met costs as much as a cluster at its gate's end: else two things that come up to one
        another are exchanged, rather than that one of them is not seen. What moves in an image is not what another
        sensor sees standing there, above or below it.
        """
        if not clusters or not self._tracks:
            return []
        from scipy.optimize import linear_sum_assignment  # late: slow to import

        params = self.params
        cost = np.full((len(self._tracks), len(clusters)), params.gate)
        centers = np.array([s.center for s in shapes])
        places = np.array([t.p for t in self._tracks])
        apart = np.hypot(*(places[:, None] - centers[None]).transpose(2, 0, 1))
        elsewhere = [t.stands(params) and t.lately_seen_by_another(sensor) for t in self._tracks]
        for k, j in np.argwhere(apart < params.max_mover_size + 0.5).tolist():
            if elsewhere[k] and clusters[j].displaced:
                continue
            cost[k, j] = min(self._tracks[k].distance2(clusters[j], shapes[j], params), params.gate)
        rows, columns = linear_sum_assignment(cost)
        return [(int(k), int(j)) for k, j in zip(rows, columns, strict=True) if cost[k, j] < params.gate]

    def _judge(self, track: Track, cluster: Cluster, displaced: bool, moved: list[Array]) -> None:
        """Whether a track that was just seen is a mover from now on, or no longer one."""
        params = self.params
        significant = track.confirmed and track.significant(params)
        if track.moving:
            if significant:
                track.moved = track.time
            elif track.time - track.moved > params.rest_time:
                track.moving, track.votes, track.rested = False, 0, track.time
            if track.moving and len(cluster.solid):  # what sticks out of its cylinder enters the map otherwise
                self._traces.append(cluster.solid[~self.of_movers(cluster.solid[:, :2])])
            return
        if displaced:
            lately = track.time - track.displaced_at <= params.rest_time
            track.contradicted = track.contradicted + 1 if lately else 1
            track.displaced_at = track.time
        # what has moved before needs no proof that it can
        track.votes = track.votes + 1 if significant and (displaced or track.recently_moved(params)) else 0
        if track.votes >= _LEAST_VOTES:
            track.moving, track.moved = True, track.time
            moved.extend(points for _, points in track.points)
            self._traces.extend(track.solids)
            track.solids.clear()

    def _displaced(self, met: Sequence[tuple[Track, Cluster]], now: View, sensor: str) -> list[bool]:
        """Whether each cluster, or scans some time apart, show that a track does not stand; not asked of movers."""
        result = [bool(cluster.displaced) for _, cluster in met]
        looks: dict[View, list[tuple[int, Array]]] = {}  # at all places of a scan at once
        for k, (track, cluster) in enumerate(met):
            if track.moving or cluster.displaced is not None:
                continue
            then = now.time - min(self.params.history, _LOOK_BACK_DISTANCE / max(track.speed, 1e-9))
            view = next((v for v in reversed(self._views.get(sensor, ())) if v.time <= then + 1e-6), None)
            if view is not None:
                looks.setdefault(view, []).append((k, cluster.points))
                looks.setdefault(now, []).append((k, track.past_points(view.time + 1e-6)))
        for scan, places in looks.items():
            asked = np.concatenate([points for _, points in places])
            through, _ = scan.beyond(asked, self.params.carve_margin, np.broadcast_to(_HEIGHTS, (len(asked), 2)))
            ends = np.cumsum([len(points) for _, points in places])
            for (k, points), own in zip(places, np.split(through, ends[:-1]), strict=True):
                result[k] |= own.sum() >= max(2.0, _LEAST_EVIDENCE * len(points))
        return result

    def _missed(self, tracks: list[Track], now: View, sensor: str) -> None:
        """Tracks without a cluster: seen through, it is not there; hidden or next to something else, it may be.

        Only a sensor that sees a thing can miss it: what hangs above a laser's plane is not in its scans, even if
        something in one of them was once taken for it.
        """
        if not tracks:
            return
        params = self.params
        places = np.concatenate([track.p + track.radius * _STAR for track in tracks])
        heights = np.repeat([track.heights for track in tracks], len(_STAR), axis=0)
        through = now.beyond(places, 0.5 * params.carve_margin, heights)[0].reshape(-1, len(_STAR)).sum(axis=1)
        for track, count in zip(tracks, through.tolist(), strict=True):
            if now.time - track.seen > params.coast_time:
                track.lost = True
                continue
            if track.seen_by.get(sensor, -math.inf) < track.seen - _SEES_FOR:
                continue
            track.votes = 0
            if count > 0.5 * len(_STAR):
                track.misses += 1
            track.lost = track.misses >= params.lost_misses or (count > 0 and not track.confirmed)
        self.lost.extend(track for track in tracks if track.lost and track.moving)

    def _begin(self, fresh: list[tuple[Cluster, ClusterShape]], met: list[Track], time: float, sensor: str) -> None:
        """New tracks, except for parts of movers that were met: what is where a mover should be, and is not where it
        is taken to be within its errors, may be that mover, whose motion was wrong."""
        if not fresh:
            return
        inside = _within(met, np.array([shape.center for _, shape in fresh]), self.params.padding)
        for (cluster, shape), part in zip(fresh, inside.tolist(), strict=True):
            if not part:
                self._tracks.append(Track(self._born, time, cluster, shape, self.params, sensor))
                self._born += 1


def _within(tracks: Iterable[Track], points: Array, padding: float) -> Mask:
    """Which of the points (n, 2) lie within tracks, made larger [m]."""
    inside = np.zeros(len(points), dtype=bool)
    for track in tracks:
        d = points - track.p
        inside |= np.hypot(d[:, 0], d[:, 1]) <= track.radius + padding
    return inside


_STAR = np.array([[0.0, 0.0], [0.7, 0.0], [-0.7, 0.0], [0.0, 0.7], [0.0, -0.7]])
