"""Sensing room, tracker: which cluster belongs to which track, what moves, and what is lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..robot.space import Array, Mask
from .cluster_shapes import Footprint, footprint
from .clusters import Cluster
from .estimator_params import SceneEstimatorParams
from .scan_rays import ScanRays
from .tracks import Track, TrackedObstacle, TrackState

_FORBIDDEN = 1e6
_VIEW_STEP = 0.04
_MAX_VIEWS = 64
_WAY = 0.3
"""A thing is looked for where it was this far [m] ago, or as long ago as ``look_back``."""
_EVIDENCE = 0.2
_VOTES = 2


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What one scan did to the tracks.

    Attributes:
        moved: (n, 2) points in the world that turned out to belong to a mover: they are not of the static world.
        tracks: how many there are, movers or not.
        started, lost: how many began and ended.
    """

    moved: Array
    tracks: int
    started: int
    lost: int


class Tracker:
    """Workspace: follows clusters that are small enough to be movers; nothing in it is random.

    A track is a *mover* once it is confirmed, its speed is significant, and the scans agree: it is now where an earlier
    scan saw through, or this scan sees through where it was. The visible end of a wall that wanders along it with the
    viewpoint does neither.
    """

    def __init__(self, params: SceneEstimatorParams) -> None:
        self.params = params
        self._tracks: list[Track] = []
        self._views: dict[str, deque[ScanRays]] = {}
        self._born = 0

    @property
    def movers(self) -> tuple[TrackedObstacle, ...]:
        """What moves, by age."""
        return tuple(t.tracked(self.params) for t in self._tracks if t.moving)

    @property
    def suspects(self) -> tuple[TrackedObstacle, ...]:
        """What has moved and may set off again, or begins to: with bounds of their speeds, by age."""
        return tuple(t.tracked(self.params) for t in self._tracks if t.wary(self.params) or t.stirring(self.params))

    def predict(self, time: float) -> None:
        """Take all tracks to ``time`` [s]."""
        for track in self._tracks:
            track.predict(time, self.params)

    def update(self, rays: ScanRays, clusters: Sequence[Cluster], sensor: str = "laser") -> Sighting:
        """Take a scan in: assign its clusters, judge what was not seen, begin new tracks."""
        params = self.params
        self.predict(rays.time)
        small = [c for c in clusters if len(c.points) >= params.min_points and c.extent <= params.max_mover_size]
        shapes = [footprint(c, params) for c in small]
        pairs = self._assign(small, shapes)
        moved: list[Array] = []
        seen, used = set(), set()
        for k, j in pairs:
            track = self._tracks[k]
            track.correct(small[j], shapes[j], params)
            seen.add(k)
            used.add(j)
            self._judge(track, small[j], rays, sensor, moved)
        for k, track in enumerate(self._tracks):
            if k not in seen:
                self._missed(track, rays)
        before = len(self._tracks)
        self._tracks = [t for t in self._tracks if t.state is not TrackState.LOST]
        lost = before - len(self._tracks)
        started = self._begin([(small[j], shapes[j]) for j in range(len(small)) if j not in used], rays.time)
        views = self._views.setdefault(sensor, deque(maxlen=_MAX_VIEWS))
        if not views or rays.time - views[-1].time >= _VIEW_STEP:
            views.append(rays)
        return Sighting(np.concatenate([np.zeros((0, 2)), *moved]), len(self._tracks), started, lost)

    def of_movers(self, points: Array) -> Mask:
        """Which of the points (n, 2) lie within movers, with their padding."""
        inside = np.zeros(len(points), dtype=bool)
        for track in self._tracks:
            if track.moving:
                d = points - track.p
                inside |= np.hypot(d[:, 0], d[:, 1]) <= track.radius + self.params.padding
        return inside

    def _assign(self, clusters: list[Cluster], shapes: list[Footprint]) -> list[tuple[int, int]]:
        if not clusters or not self._tracks:
            return []
        from scipy.optimize import linear_sum_assignment  # late: slow to import

        params = self.params
        cost = np.full((len(self._tracks), len(clusters)), _FORBIDDEN)
        centers = np.array([s.center for s in shapes])
        places = np.array([t.p for t in self._tracks])
        apart = np.hypot(*(places[:, None] - centers[None]).transpose(2, 0, 1))
        for k, j in np.argwhere(apart < params.max_mover_size + 0.5).tolist():
            square = self._tracks[k].distance2(clusters[j], shapes[j], params)
            if square < params.gate:
                cost[k, j] = square
        rows, columns = linear_sum_assignment(cost)
        return [(int(k), int(j)) for k, j in zip(rows, columns, strict=True) if cost[k, j] < _FORBIDDEN]

    def _judge(self, track: Track, cluster: Cluster, rays: ScanRays, sensor: str, moved: list[Array]) -> None:
        """Whether a track that was just seen is a mover from now on, or none any more."""
        params = self.params
        significant = track.state is TrackState.CONFIRMED and track.significant(params)
        if track.moving:
            if significant:
                track.moved = track.time
            elif track.time - track.moved > params.rest_time:
                track.moving, track.votes, track.rested = False, 0, track.time
            return
        displaced = self._displaced(track, cluster, rays, sensor)
        if displaced:
            track.stirred = track.time
        # what has moved before needs no proof that it can
        track.votes = track.votes + 1 if significant and (displaced or track.wary(params)) else 0
        if track.votes >= _VOTES:
            track.moving, track.moved = True, track.time
            moved.extend(points for _, points in track.points)

    def _displaced(self, track: Track, cluster: Cluster, rays: ScanRays, sensor: str) -> bool:
        """Whether scans some time apart contradict that a track stands."""
        then = rays.time - min(self.params.look_back, _WAY / max(track.speed, 1e-9))
        view = next((v for v in reversed(self._views.get(sensor, ())) if v.time <= then + 1e-6), None)
        if view is None:
            return False
        margin = self.params.carve_margin
        was = track.past_points(view.time + 1e-6)
        for scan, points in ((view, cluster.points), (rays, was)):
            if len(points):
                through, _ = scan.beyond(points, margin)
                if through.sum() >= max(2.0, _EVIDENCE * len(points)):
                    return True
        return False

    def _missed(self, track: Track, rays: ScanRays) -> None:
        """A track without a cluster: seen through, it is not there; hidden or next to something else, it may be."""
        params = self.params
        track.votes = 0
        places = track.p + track.radius * _STAR
        through, _ = rays.beyond(places, 0.5 * params.carve_margin)
        if through.sum() > 0.5 * len(places):
            track.misses += 1
        if track.misses >= params.lost_misses or (through.any() and track.state is TrackState.TENTATIVE):
            track.state = TrackState.LOST
        if rays.time - track.seen > params.coast_time:
            track.state = TrackState.LOST

    def _begin(self, fresh: list[tuple[Cluster, Footprint]], time: float) -> int:
        """New tracks, but for parts of movers."""
        if not fresh:
            return 0
        inside = self.of_movers(np.array([shape.center for _, shape in fresh]))
        count = 0
        for (cluster, shape), part in zip(fresh, inside.tolist(), strict=True):
            if not part:
                self._tracks.append(Track(self._born, time, cluster, shape, self.params))
                self._born += 1
                count += 1
        return count


_STAR = np.array([[0.0, 0.0], [0.7, 0.0], [-0.7, 0.0], [0.0, 0.7], [0.0, -0.7]])
