"""Scene estimator: readings in, scenes out: a map of things at rest, and tracks of things that move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.validation import check_type
from elastic_strips.work import count_work

from .body_mask import BodyMask
from .clusters import Cluster, cluster_obstacles, clusters_of
from .image_movers import ImageView, moving_clusters
from .image_watch import ImageReport, ImageWatch
from .lost_movers import LostMovers
from .occupancy_grid import OccupancyGrid
from .params import SceneEstimatorParams
from .readings import DepthImage, LaserScan, RangeImage, RangeRing, Reading, ScanRays, pose_matrix, rays_of
from .ring_watch import RingWatch
from .tracking import TrackedObstacle, Tracker, View
from .volume_map import VolumeMap, VolumeMapParams

_OWN_MARGIN = 0.15  # [m] about the robot's bodies, where nothing else can be
_TOUCHED_MARGIN = 0.12
"""So near to the robot's bodies [m] no motion can begin where something is in doubt: what motions keep from it, and
from a point to the far end of its voxel."""
_POSTURE_FOR = 0.3  # [s] for which the posture of an image tells where the arm is


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
    they have a layer of their own, ``near-3-5``, which the laser does not clear. Nothing is tracked by them. Where a
    sonar hears something that an image sees through, the scene's ``remark`` says so.

    Depth cameras and 3-D lidars see all heights: what they see is a third layer of voxels, ``volume-3-5-1``, which they
    alone clear. The robot itself is taken out of their images. Images that cannot be as they say are not taken in
    (`watched` tells why): to the scene they are as if they had not come.

    Args:
        params: parameters of the scenes.
        robot: the robot that carries the sensors; needed for images of depths and ranges alone.
        volume: parameters of their layer.
        required: names of the sensors that scenes rest on: a scene is no newer than what was last believed of each of
            them. All lasers, cameras and 3-D lidars that have given a reading where None.

    Attributes:
        map, near: the layers of lasers and of rings.
        volume: the layer of images; None before the first, unless what was not seen is blocked.
        tracker: tracks things that may move.
        watched: sensor of images → how its newest image fits to what is known.
        movers: moving things, at the time of the newest scan.
        possibly_moving: things that have moved and may set off again, or begin to move; in the map too, and in scenes
            with `UnknownMotion`.
        report: effect of the last reading.
    """

    def __init__(
        self,
        params: SceneEstimatorParams | None = None,
        *,
        robot: RobotModel | None = None,
        volume: VolumeMapParams | None = None,
        required: Sequence[str] | None = None,
    ) -> None:
        # late: slow to import, and no reading is to wait for it
        import scipy.ndimage
        import scipy.optimize  # noqa: F401

        check_type("params", params, SceneEstimatorParams, none=True)
        check_type("robot", robot, RobotModel, none=True)
        check_type("volume", volume, VolumeMapParams, none=True)
        if required is not None and (isinstance(required, str) or not all(isinstance(n, str) for n in required)):
            raise ParameterError(f"required={required!r} must be a list of sensors' names, such as ('laser', 'camera')")
        self._required = None if required is None else tuple(required)
        self._mask = None if robot is None else BodyMask(robot)
        self._base = (0.0, 0.0)  # where it is [m]
        self._q: Array | None = None  # how the robot stood in the newest image
        self._posed = -math.inf  # [s] when that was
        self._volume_params = volume or VolumeMapParams()
        blocked = self._volume_params.unseen == "blocked"
        self.volume: VolumeMap | None = VolumeMap(self._volume_params) if blocked else None
        self._stood = False  # whether the place where the robot stood at first is in it
        self.params: SceneEstimatorParams = params or SceneEstimatorParams()
        self.map: OccupancyGrid = OccupancyGrid(self.params)
        self.near: OccupancyGrid = OccupancyGrid(replace(self.params, unseen="free"), "near")
        self.tracker: Tracker = Tracker(self.params)
        self._lost = LostMovers(self.params)
        self.report: EstimatorReport = EstimatorReport()
        self._newest: dict[str, float] = {}
        self._believed: dict[str, float] = {}  # of lasers and images: sensor → time of the newest that was taken in
        self._began = self._time = -math.inf
        self._watches: dict[str, ImageWatch] = {}
        self._scans: dict[str, ScanRays] = {}  # laser → what it saw last
        self.watched: dict[str, ImageReport] = {}
        self._views: dict[str, ImageView] = {}  # sensor of images → its newest one that was believed
        self._rings: dict[str, RingWatch] = {}
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
            reading: a laser scan, a round of a ring of sensors, or an image of depths or ranges.
            base_pose: estimated (x [m], y [m], yaw [rad]) of the base when it was measured.

        Raises:
            ParameterError: a reading that is older than the last one of its sensor, a tilted laser, a pose that is not
                finite, an image without the robot or its configuration.
        """
        if not math.isfinite(reading.time):
            raise ParameterError(f"the reading of {reading.sensor!r} has the time {reading.time!r}; it must be finite")
        if reading.time < self._newest.get(reading.sensor, -math.inf):
            raise ParameterError(
                f"the reading of {reading.sensor!r} at {reading.time:g} s came after the one at "
                f"{self._newest[reading.sensor]:g} s; the readings of a sensor must be given in their order"
            )
        if isinstance(reading, LaserScan):
            self._scan(reading, base_pose)
            self._believed[reading.sensor] = reading.time
        elif isinstance(reading, RangeRing):
            self._ring(reading, base_pose)
        elif self._image(reading, base_pose):
            self._believed[reading.sensor] = reading.time
        else:  # an image that is not believed does not make a scene newer
            self._believed.setdefault(reading.sensor, reading.time)
        if reading.ranges.ndim == 1:
            count_work(rays=len(reading.ranges), obstacles=len(self.tracker))
        T = pose_matrix(base_pose)
        self._base = float(T[0, 3]), float(T[1, 3])
        self.map.clear_footprint(*self._base)
        self._newest[reading.sensor] = reading.time
        self._began = reading.time if self._began == -math.inf else self._began
        self._time = self._oldest()[0]
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

        Its ``time`` is that of the newest reading of the sensor that has been silent, or not believed, for the longest,
        among those that are required; ``held_up`` names it.

        Readings of rings do not make a scene newer, since they say nothing about movers, unless there is nothing else.

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
            voxels = [] if self.volume is None else self.volume.obstacles()
            if self.volume is not None and self._volume_params.unseen == "blocked":
                voxels += self.volume.in_doubt(*self._base)
            layers = [*self.map.obstacles(), *self.near.obstacles(), *voxels, *self._lost.obstacles()]
            now = max(self._newest.values())
            remark = next(filter(None, (ring.said(now) for ring in self._rings.values())), "")
            self._scene = Scene([*layers, *tracked], time=self._time, held_up=self._held_up(), remark=remark)
            count_work(obstacles=len(self._scene))
        return self._scene

    def _oldest(self) -> tuple[float, str]:
        """Time [s] and name of the required sensor that is behind all others; one that has not come yet is of the time
        of the very first reading."""
        times = self._believed if self._required is None else {n: self._of(n) for n in self._required}
        if not times:  # there are rings alone
            newest = max(self._newest, key=self._newest.__getitem__)
            return self._newest[newest], newest
        last = min(times, key=times.__getitem__)
        return times[last], last

    def _of(self, sensor: str) -> float:
        """Time of the newest reading of a sensor that counts [s]."""
        return self._believed.get(sensor, self._newest.get(sensor, self._began))

    def _held_up(self) -> str:
        """What keeps the scene from being newer."""
        time, sensor = self._oldest()
        report = self.watched.get(sensor)
        if report is not None and report.reason:
            return report.reason
        if sensor not in self._newest:
            return f"nothing has arrived from {sensor!r} yet"
        return f"nothing has arrived from {sensor!r} since {time:.2f} s"

    def _scan(self, scan: LaserScan, base_pose: ArrayLike) -> None:
        rays = rays_of(scan, base_pose)
        self._track(rays, clusters_of(rays, self.params), scan.sensor, pose_matrix(base_pose))
        at = np.flatnonzero(rays.hits)
        ignored = np.zeros(len(rays.ranges), dtype=bool)
        ignored[at] = self.tracker.of_movers(rays.origin + rays.ranges[at, None] * rays.direction[at])
        self.map.add_scan(rays, ignored)
        self._scans[scan.sensor] = rays
        self._forget_traces(scan.time, pose_matrix(base_pose))
        if self.volume is not None and self._volume_params.unseen == "blocked":
            # What stands on the floor is taken to reach up to the laser's plane.
            p = self.volume.params
            free = self.map.free_near(float(rays.origin[0]), float(rays.origin[1]), p.unseen_radius)
            levels = np.arange(0.5 * p.cell, rays.height + p.cell, p.cell)
            self.volume.grant(np.column_stack((np.repeat(free, len(levels), axis=0), np.tile(levels, len(free)))))

    def _track(self, view: View, clusters: Sequence[Cluster], sensor: str, T_world_base: Array) -> None:
        self.map.forget(self.tracker.update(view, clusters, sensor))
        walking = [track for track in self.tracker.moving if track.seen == view.time]
        self.map.walk(np.array([track.p for track in walking]), np.array([track.radius for track in walking]))

        def own(columns: Array) -> Mask:
            """Which columns (n, 2) [m] the robot is in, or so near to that nothing else can be."""
            if self._mask is None or (q := self._posture(view.time)) is None:
                return np.hypot(*(columns - T_world_base[:2, 3]).T) <= self.params.robot_radius
            local = (columns - T_world_base[:2, 3]) @ T_world_base[:2, :2]
            return self._mask.above_or_below(local, q, _OWN_MARGIN)

        self._lost.update(self.tracker.moving, self.tracker.lost, view, sensor, own)

    def _ring(self, ring: RangeRing, base_pose: ArrayLike) -> None:
        T = pose_matrix(base_pose) @ ring.T_base_sensor
        ends = T[:, :2, 3] + np.where(ring.hits, ring.ranges, 0.0)[:, None] * T[:, :2, 0]
        self.near.add_ring(ring, base_pose, self.tracker.of_movers(ends))
        watch = self._rings.setdefault(ring.sensor, RingWatch())
        watch.look(ring, pose_matrix(base_pose), self._views.values(), self._scans.values())

    def _image(self, image: DepthImage | RangeImage, base_pose: ArrayLike) -> bool:
        """Take an image in where it is to be believed; whether it was."""
        if self._mask is None:
            raise ParameterError(
                f"the image of {image.sensor!r} may show the robot itself: SceneEstimator needs robot= to tell"
            )
        count_work(pixels=image.ranges.size * (1 if isinstance(image, DepthImage) else 2))
        T = pose_matrix(base_pose)
        self._q, self._posed = image.q, image.time
        kept, own = self._mask.apart(image)
        if self.volume is None:
            self.volume = VolumeMap(self._volume_params)
        self.volume.center(float(T[0, 3]), float(T[1, 3]))
        if not self._stood and image.q is not None:
            p, self._stood = self.volume.params, True
            place = self._mask.place_of(image.q, p.start_radius, p.bottom + p.height, p.start_margin, 0.5 * p.cell)
            self.volume.grant(place @ T[:3, :3].T + T[:3, 3])
        T_world_sensor = T @ kept.T_base_sensor
        seen = self.volume.seen_by(kept, T)
        moving = np.zeros(kept.ranges.shape, dtype=bool)
        moving[seen.pixels] = seen.fresh | self.tracker.of_movers(seen.points[:, :2])
        watch = self._watches.setdefault(image.sensor, ImageWatch(self.volume.params))
        self.watched[image.sensor] = report = watch.look(
            image, kept, T_world_sensor, own, moving, self.tracker.may_have_moved, self._scans
        )
        if report.reason:
            return False
        view = self._views[image.sensor] = ImageView(kept, T_world_sensor)
        clusters = moving_clusters(seen.points, seen.fresh, seen.standing, view, self.params)
        self._track(view, clusters, kept.sensor, T)
        self.volume.add(kept, T, seen, self.tracker.of_movers(seen.points[:, :2]))
        self._forget_traces(image.time, T)
        return True

    def _posture(self, time: float) -> Array | None:
        """Configuration (nq,) of the newest image; None where that is so old by ``time`` [s] that the arm may be
        elsewhere."""
        return self._q if time - self._posed <= _POSTURE_FOR else None

    def _forget_traces(self, time: float, T_world_base: Array) -> None:
        """Forget what is known of where things were that turned out to move.

        Who stood right at the robot, and has gone, leaves nothing in doubt there: the robot's motions were certified up
        to where it is. Its sensors seldom see those places, and it could not leave them.
        """
        traces = self.tracker.traces()
        if self.volume is None or not len(traces):
            return
        self.volume.forget(traces)
        if self._mask is not None and (q := self._posture(time)) is not None:
            local = (traces - T_world_base[:3, 3]) @ T_world_base[:3, :3]
            self.volume.grant(traces[self._mask.near(local, q, _TOUCHED_MARGIN)])


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
