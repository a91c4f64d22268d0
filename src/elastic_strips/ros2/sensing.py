"""Sensing: scans, clouds and maps as they come, and the scene that they show; whatever is wrong with one is counted."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ElasticStripsError, RobotError
from elastic_strips.io.bag_reader import cloud_of
from elastic_strips.io.point_cloud import cloud_scene, without_robot
from elastic_strips.perception import SceneEstimator, SceneEstimatorParams
from elastic_strips.perception.own_body import Posture, SelfFilter, SensorMount
from elastic_strips.perception.rays import Rays
from elastic_strips.perception.readings import NO_ANSWER, LaserScan
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.scene import Obstacle, Scene

from .messages import MessageError, RosObject, depth_image, kind_of, laser_scan, map_obstacles
from .params import Ros2Params, mount_of

_LASER_PLANE = 0.3  # [m] pieces that reach below this height are in the plane of a base's laser
_OWN_PADDING = 0.02  # [m] by which the robot is thicker for its own lasers
_WAITING = 20  # messages that wait to be looked at, at most; the oldest are dropped
_TOO_LATE = "not looked at in time"
_NEWER = "a newer one had arrived"
_VOXEL = 0.05  # [m] edge of the cells of a cloud
_SHORT_NAME = 40  # of what is counted


class _Waiting(NamedTuple):
    """A message that waits until it is known where the robot was then."""

    kind: str
    topic: str
    message: Any
    time: float


class Mounts:
    """Workspace: where sensors are on the robot: at the link with their frame's name, or where they are said to be.

    Args:
        robot: the robot.
        params: with the ``mounts`` that no link has the name of.
    """

    def __init__(self, robot: RobotModel, params: Ros2Params) -> None:
        self.posture: Posture = Posture(robot)
        self._told: dict[str, Array] = {}
        for text in params.mounts or ():
            frame, (x, y, z, *turn) = mount_of(text)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = pin.rpy.rpyToMatrix(*turn), (x, y, z)
            self._told[frame] = T
        self._base = 1 if robot.space.planar else 0  # the joint that carries the base
        self._known: dict[str, tuple[int, Array]] = {}

    def of(self, frame: str) -> tuple[int, Array]:
        """The joint that carries a sensor, and its pose (4, 4) in the joint's frame.

        Raises:
            MessageError: the robot has no such link, and no mount says where it is.
        """
        name = frame.strip("/")
        if name not in self._known:
            if name in self._told:
                self._known[name] = self._base, self._told[name]
            else:
                try:
                    mount = SensorMount(self.posture, (name,))
                except RobotError as error:
                    raise MessageError(f"unknown frame {name!r}: {str(error).split(' It has:')[0]}") from None
                self._known[name] = int(mount.joint[0]), mount.T_joint_sensor[0]
        return self._known[name]

    def on_base(self, frame: str) -> Array:
        """(4, 4) pose of a sensor in the base's frame, in the posture."""
        joint, local = self.of(frame)
        return self.posture.T_base_world @ self.posture.T_world_joint[joint] @ local


class Sensing:
    """Workspace: makes scenes of messages; one thread takes them in, and another one may look at ``scene``.

    Args:
        robot: the robot.
        params: the node's parameters.

    Attributes:
        scene: what is seen, as it was published last; None before anything was.
        counts: what was wrong with messages, and how often.
        last: when something of each topic was taken in last [s].
    """

    def __init__(self, robot: RobotModel, params: Ros2Params) -> None:
        self._robot, self._params = robot, params
        radius = PlanarFootprint.of(robot, robot.home()).inner_below(_LASER_PLANE)
        self._estimator = SceneEstimator(
            SceneEstimatorParams(body_radius=radius),
            robot=robot.seeing,
            required=(*(params.scans or ()), *(params.depths or ())),
        )
        self.mounts: Mounts = Mounts(robot, params)
        self._filters: dict[str, tuple[Array, SelfFilter, Rays]] = {}
        self._waiting: deque[_Waiting] = deque(maxlen=_WAITING)
        self._clouds: dict[str, tuple[float, Obstacle | None]] = {}  # topic → time [s] and what was there
        self._map: list[Obstacle] = []
        self._began = math.inf  # when the first of all was taken in [s]
        self.scene: Scene | None = None
        self.counts: Counter[str] = Counter()
        self.last: dict[str, float] = {}

    def count(self, topic: str, error: Exception) -> None:
        """Count what is wrong with a message."""
        self.counts[f"{topic}: {kind_of(error)[:_SHORT_NAME]}"] += 1

    def offer(self, kind: str, topic: str, message: RosObject | tuple[RosObject, RosObject], t: float) -> None:
        """Hand over a ``"scan"`` or ``"cloud"`` of a time [s], a ``"depth"`` with its camera, or a ``"map"``; in any
        thread."""
        if len(self._waiting) == _WAITING:
            self.counts[f"{topic}: {_TOO_LATE}"] += 1
        self._waiting.append(_Waiting(kind, topic, message, t))

    def forget(self) -> None:
        """Leave out what waits with a time, which is of another clock."""
        kept = [waiting for waiting in self._waiting if waiting.kind == "map"]
        self._waiting.clear()
        self._waiting.extend(kept)
        self.excuse()  # nobody looked yet

    def excuse(self) -> None:
        """Count no longer what was not looked at in time so far."""
        for what in [what for what in self.counts if what.endswith((_TOO_LATE, _NEWER))]:
            del self.counts[what]

    def work(self, row_at: Callable[[float], Array], known: tuple[float, float]) -> bool:
        """Take in what can be by now; whether ``scene`` is a new one.

        Args:
            row_at: the robot's coordinate row (nv,) in the world at a time [s].
            known: from when to when it is known [s].
        """
        later: list[_Waiting] = []
        changed = False
        for _ in range(len(self._waiting)):
            waiting = self._waiting.popleft()
            if waiting.kind != "map" and waiting.time > known[1]:
                later.append(waiting)
                continue
            if waiting.kind != "map" and self.scene is None and waiting.time < known[0]:
                continue  # from before it was known where the robot is
            if waiting.kind == "depth" and any(self._passes(later, waiting, known[1]) for later in self._waiting):
                self.counts[f"{waiting.topic}: {_NEWER}"] += 1
                continue
            try:
                self._take(waiting, row_at)
                changed = True
                self.last[waiting.topic] = waiting.time
                if waiting.kind != "map":
                    self._began = min(self._began, waiting.time)
            except (ElasticStripsError, ValueError) as error:
                self.count(waiting.topic, error)
        self._waiting.extendleft(reversed(later))
        if changed and (self._estimator.times or self._clouds):
            self._publish()
        return changed

    @staticmethod
    def _passes(later: _Waiting, one: _Waiting, known: float) -> bool:
        """Whether a later image makes another one needless: one takes longer to look at than to come, maybe."""
        return later.topic == one.topic and one.time < later.time <= known

    def _take(self, waiting: _Waiting, row_at: Callable[[float], Array]) -> None:
        if waiting.kind == "map":
            self._map = map_obstacles(waiting.message)
            return
        row = row_at(waiting.time)
        posture = self.mounts.posture
        posture.place(row)
        message, info = waiting.message if waiting.kind == "depth" else (waiting.message, waiting.message)
        frame = str(message.header.frame_id)
        T_base_sensor = self.mounts.on_base(frame)
        place = row[:3] if self._robot.space.planar else np.zeros(3)
        if waiting.kind == "depth":
            reach = self._params.depth_near, self._params.depth_far
            q = self._robot.space.from_coordinates(row)
            most = self._params.depth_pixels
            image = depth_image(message, info, waiting.topic, waiting.time, T_base_sensor, reach, q, most)
            self._estimator.update(image, place)
            return
        if waiting.kind == "scan":
            scan = laser_scan(waiting.message, waiting.topic, waiting.time, T_base_sensor)
            self._estimator.update(self._without_robot(scan, frame), place)
            return
        cloud = cloud_of(waiting.message)
        T = np.linalg.inv(posture.T_base_world) @ T_base_sensor
        points = cloud.points @ T[:3, :3].T + T[:3, 3]
        points = points[(points[:, 2] >= self._params.low) & (points[:, 2] <= self._params.high)]
        name = f"cloud-{waiting.topic.strip('/')}"
        if len(points):
            points = without_robot(points, self._robot, self._robot.space.from_coordinates(row)).points
        seen = cloud_scene(points, _VOXEL, name=name) if len(points) else None
        self._clouds[waiting.topic] = waiting.time, None if seen is None else seen.obstacles[0]

    def _without_robot(self, scan: LaserScan, frame: str) -> LaserScan:
        """The scan without what the laser may see of the robot itself."""
        joint, T_joint_sensor = self.mounts.of(frame)
        known = self._filters.get(scan.sensor)
        if known is None or not np.array_equal(known[0], scan.angles):
            fan = np.column_stack((np.cos(scan.angles), np.sin(scan.angles), np.zeros(len(scan.angles))))
            local = Rays(np.zeros((1, 3)), fan)
            joints = np.full(len(fan), joint, dtype=np.intp)
            own = SelfFilter(self.mounts.posture, joints, local.moved(T_joint_sensor), _OWN_PADDING)
            known = self._filters[scan.sensor] = scan.angles, own, local
        _, own, local = known
        T = self.mounts.posture.T_world_joint[joint] @ T_joint_sensor
        distance = own.distances(local.moved(T), scan.range_max)
        covered = np.isfinite(distance) & ~(scan.ranges < distance - _OWN_PADDING)
        if not covered.any():
            return scan
        ranges = np.where(covered, NO_ANSWER, scan.ranges)
        return LaserScan(
            scan.sensor, scan.time, scan.T_base_sensor, scan.angles, ranges, scan.range_min, scan.range_max
        )

    def _publish(self) -> None:
        """Make the scene, as old as what is behind all others; a cloud that has not come yet is as old as the first
        one of anything."""
        found = self._estimator.scene() if self._estimator.times else None
        ages = [(self._clouds.get(topic, (self._began, None))[0], topic) for topic in self._params.clouds or ()]
        time, topic = min(ages, default=(math.inf, ""))
        behind = found is None or time < found.time
        things = [*(found or ()), *self._map, *(cloud for _, cloud in self._clouds.values() if cloud is not None)]
        if behind:
            since = f"since {time:.2f} s" if topic in self._clouds else "yet"
            remark = "" if found is None else found.remark
            self.scene = Scene(things, time=time, held_up=f"nothing has arrived from {topic!r} {since}", remark=remark)
        else:
            assert found is not None
            self.scene = Scene(things, time=found.stamp, held_up=found.held_up, remark=found.remark)

    def age(self, topic: str, now: float) -> float:
        """How old the newest message of a topic is that was taken in [s]."""
        return now - self.last.get(topic, -math.inf)
