"""Scene estimator: readings in, scenes out: a map of things at rest, and tracks of things that move."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import ArrayLike
from elastic_strips.errors import ParameterError
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.validation import check_type
from elastic_strips.work import count_work

from .clusters import cluster_obstacles, clusters_of
from .occupancy_grid import OccupancyGrid
from .params import SceneEstimatorParams
from .readings import LaserScan, RangeRing, Reading, pose_matrix, rays_of
from .tracking import TrackedObstacle, Tracker


@dataclass(frozen=True, slots=True)
class EstimatorReport:
    """The effect of the last reading.

    Attributes:
        sensor: sensor of the reading; empty before the first.
        time: time of the reading [s].
        hits, nothing, no_answer: numbers of its ranges that met something, met nothing, and say nothing.
        tracks, movers: how many things are followed, and how many of them move.
    """

    sensor: str = ""
    time: float = -math.inf
    hits: int = 0
    nothing: int = 0
    no_answer: int = 0
    tracks: int = 0
    movers: int = 0


class SceneEstimator:
    """Workspace: turns the readings of one robot's sensors into scenes. One per thread.

    Everything that is seen is an obstacle of the map first. Small things that turn out to move leave it and become
    cylinders with a velocity; they go back into it when they stop.

    Rings of sonars and infrared sensors look at other heights than the laser, and see things that it does not (glass):
    they have a layer of their own, ``near-3-5``, which the laser does not clear. Nothing is tracked by them.

    Args:
        params: parameters of the scenes.

    Attributes:
        map, near: the layers of lasers and of rings.
        tracker: tracks things that may move.
        movers: moving things, at the time of the newest scan.
        possibly_moving: things that have moved and may set off again, or begin to move; in the map too, and in scenes
            with `UnknownMotion`.
        report: effect of the last reading.
    """

    def __init__(self, params: SceneEstimatorParams | None = None) -> None:
        check_type("params", params, SceneEstimatorParams, none=True)
        self.params: SceneEstimatorParams = params or SceneEstimatorParams()
        self.map: OccupancyGrid = OccupancyGrid(self.params)
        self.near: OccupancyGrid = OccupancyGrid(replace(self.params, unseen="free"), "near")
        self.tracker: Tracker = Tracker(self.params)
        self.report: EstimatorReport = EstimatorReport()
        self._newest: dict[str, float] = {}
        self._scan_time = self._time = -math.inf
        self.movers: tuple[TrackedObstacle, ...] = ()
        self.possibly_moving: tuple[TrackedObstacle, ...] = ()
        self._scene: Scene | None = None

    @property
    def times(self) -> dict[str, float]:
        """Sensor → time of its newest reading [s]; the time of a sensor that has died stands still."""
        return dict(self._newest)

    def update(self, reading: Reading, base_pose: ArrayLike) -> EstimatorReport:
        """Take a reading in.

        Args:
            reading: a laser scan or a round of a ring of sensors.
            base_pose: estimated (x [m], y [m], yaw [rad]) of the base when it was measured.

        Raises:
            ParameterError: a reading that is older than the last one of its sensor, a tilted laser, a pose that is not
                finite.
        """
        if not math.isfinite(reading.time):
            raise ParameterError(f"the reading of {reading.sensor!r} has the time {reading.time!r}; it must be finite")
        if reading.time < self._newest.get(reading.sensor, -math.inf):
            raise ParameterError(
                f"the reading of {reading.sensor!r} at {reading.time:g} s comes after the one at "
                f"{self._newest[reading.sensor]:g} s; the readings of a sensor must be given in their order"
            )
        if isinstance(reading, LaserScan):
            self._scan(reading, base_pose)
            self._scan_time = max(self._scan_time, reading.time)
        else:
            self._ring(reading, base_pose)
        count_work(rays=len(reading.ranges), obstacles=len(self.tracker))
        T = pose_matrix(base_pose)
        self.map.clear_footprint(float(T[0, 3]), float(T[1, 3]))
        self._newest[reading.sensor] = reading.time
        self._time = self._scan_time if self._scan_time > -math.inf else max(self._time, reading.time)
        self.movers, self.possibly_moving = self.tracker.movers, self.tracker.possibly_moving
        self._scene = None
        r = reading.ranges
        self.report = EstimatorReport(
            sensor=reading.sensor,
            time=reading.time,
            hits=int(np.isfinite(r).sum()),
            nothing=int(np.isposinf(r).sum()),
            no_answer=int(np.isnan(r).sum()),
            tracks=len(self.tracker),
            movers=len(self.movers),
        )
        return self.report

    def scene(self, t: float | None = None) -> Scene:
        """The newest scene: things at rest, movers with their velocities, and things that possibly move.

        Its ``time`` is that of the newest scan.

        Readings of rings do not make a scene newer, since they say nothing about movers, unless there is no laser at
        all; `times` says whether all lasers are alive.

        Static obstacles that have not changed are the same objects as before; a mover keeps its name and its solid.

        Args:
            t: present time [s]; the time of the scene where None.

        Raises:
            ParameterError: there was no reading yet, or ``t`` is before the scene's time.
        """
        if self._time == -math.inf:
            raise ParameterError("there is no scene before the first reading: call update first")
        if t is not None and not t >= self._time - 1e-9:
            raise ParameterError(f"a scene at t={t!r} s is asked for, but scans up to {self._time:g} s are in it")
        if self._scene is None:
            tracked = (t.obstacle for t in (*self.movers, *self.possibly_moving))
            self._scene = Scene([*self.map.obstacles(), *self.near.obstacles(), *tracked], time=self._time)
            count_work(obstacles=len(self._scene))
        return self._scene

    def _scan(self, scan: LaserScan, base_pose: ArrayLike) -> None:
        rays = rays_of(scan, base_pose)
        self.map.forget(self.tracker.update(rays, clusters_of(rays, self.params), scan.sensor))
        at = np.flatnonzero(rays.hits)
        ignored = np.zeros(len(rays.ranges), dtype=bool)
        ignored[at] = self.tracker.of_movers(rays.origin + rays.ranges[at, None] * rays.direction[at])
        self.map.add_scan(rays, ignored)

    def _ring(self, ring: RangeRing, base_pose: ArrayLike) -> None:
        T = pose_matrix(base_pose) @ ring.T_base_sensor
        ends = T[:, :2, 3] + np.where(ring.hits, ring.ranges, 0.0)[:, None] * T[:, :2, 0]
        self.near.add_ring(ring, base_pose, self.tracker.of_movers(ends))


def scan_scene(scan: LaserScan, base_pose: ArrayLike, params: SceneEstimatorParams | None = None) -> Scene:
    """The scene that a single scan shows, without a history: nothing moves.

    Every cluster becomes padded upright solids that hold its points: a cylinder where it is round, a thin box where
    it is straight, otherwise one or several boxes; ``"seen-0"``, ``"seen-1"``, … counter-clockwise.

    Args:
        scan: scan of a level sensor.
        base_pose: (x [m], y [m], yaw [rad]) of the base when it was measured.
        params: how clusters become solids.

    Raises:
        ParameterError: a tilted sensor, fewer than two rays, angles that do not ascend, or a pose that is not finite.
    """
    params = params or SceneEstimatorParams()
    solids: list[Obstacle] = []
    for k, cluster in enumerate(clusters_of(rays_of(scan, base_pose), params)):
        solids += cluster_obstacles(cluster, params, f"seen-{k}")
    return Scene(solids, time=scan.time)
