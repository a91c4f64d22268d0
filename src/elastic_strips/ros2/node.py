"""Node: the topics and services of the node, and what has come of them, in the thread that hears ROS."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ElasticStripsError, ParameterError, nearest_name, plural
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.trajectory import MotionLimits

from .actions import serve
from .driver import TF_AHEAD, TF_DEPTH, close_node, load, open_node, quality
from .messages import (
    MessageError,
    check_frame,
    joints_of,
    nanoseconds,
    path_of,
    place_of,
    planar_pose,
    spatial_pose,
    transform_of,
)
from .motion import MotionReader, carried, correction_of
from .params import TF, Ros2Params, posture_of
from .requests import Request, Requests
from .sensing import Sensing
from .stamps import StampClock, read_together
from .telling import Telling

_log = logging.getLogger(__name__)
NODE_NAME = "elastic_strips"
_LAST_WORDS = 0.3  # [s] in which clients are told that their goals are over


class Ros2Node:
    """Workspace: the topics and services of the node, and what has come of them.

    Args:
        params: its parameters; those of ROS where None.
        arguments: arguments of ROS, such as remappings and files of parameters.

    Raises:
        MissingExtraError: rclpy is not installed.
        ParameterError: a parameter is wrong.
    """

    def __init__(self, params: Ros2Params | None, arguments: Sequence[str]) -> None:
        self.arguments: list[str] = list(arguments)
        self.context, self.node = open_node(NODE_NAME, self.arguments)
        self._spinning: threading.Thread | None = None
        try:
            self.params: Ros2Params = self._declared() if params is None else params
            self.robot: RobotModel = load_robot(self.params.robot)
            self.limits: MotionLimits = MotionLimits.for_robot(self.robot)
            self.slower: MotionLimits = self.limits.scaled(self.params.speed, 1.0)  # that it is driven with
            self.sensing: Sensing = Sensing(self.robot, self.params)
            self.requests: Requests = Requests(self.params.within, posture_of(self.robot, self.params.path_posture))
            self._lock = threading.Lock()
            self._reader = MotionReader(self.robot, self.limits)
            self._clock = StampClock(self.params.oldest)
            self._clock.epoch = time.monotonic()
            self._fix: Array | None = None  # the base's newest pose in the world, by localization
            self._transform: Array | None = None  # where the frame of odometry is in the world, by tf
            self._cameras: dict[str, Any] = {}  # the newest camera_info of each topic of depths
            self.correction: Array = np.zeros(3)
            self._subscribe()
            self._advertise()
        except BaseException:
            close_node(self.context, self.node)
            raise

    def _declared(self) -> Ros2Params:
        """The parameters that ROS has; an empty text, or an empty list, is none."""
        kinds = load("rclpy.parameter").Parameter.Type
        values: dict[str, Any] = {}
        lists = ("scans", "clouds", "depths", "mounts", "path_posture", "actions")
        for name, default in Ros2Params.names().items():
            if name in lists:
                value = (
                    self.node.declare_parameter(name, kinds.STRING_ARRAY).value
                    if default is None
                    else (
                        self.node.declare_parameter(name, list(default)).value  # type: ignore[call-overload]
                    )
                )
                value = tuple(each for each in value if each) or None if value else default
            else:
                value = self.node.declare_parameter(name, "" if default is None else default).value
                value = default if value == "" else value
            values[name] = value
        return Ros2Params(**values)

    def _subscribe(self) -> None:
        params = self.params
        nav, sensor, geometry = (load(f"{name}_msgs.msg") for name in ("nav", "sensor", "geometry"))
        if self.robot.space.planar:
            self._hear(nav.Odometry, params.odom, quality(20), self._on_odometry)
        if self.robot.joint_names:
            self._hear(sensor.JointState, params.joint_states, quality(20), self._on_joints)
        for topic in params.scans or ():
            self._hear(sensor.LaserScan, topic, quality(5), lambda m, topic=topic: self._on_seen("scan", topic, m))
        for topic in params.clouds or ():
            self._hear(sensor.PointCloud2, topic, quality(5), lambda m, topic=topic: self._on_seen("cloud", topic, m))
        for topic in params.depths or ():
            beside = f"{topic.rpartition('/')[0]}/camera_info" if "/" in topic else "camera_info"
            self._hear(sensor.CameraInfo, beside, quality(1), lambda m, topic=topic: self._cameras.update({topic: m}))
            self._hear(sensor.Image, topic, quality(2), lambda m, topic=topic: self._on_depth(topic, m))
        once = quality(1, reliable=True)
        if params.map is not None:
            topic = params.map
            kept = quality(1, reliable=True, kept=True)
            self._hear(nav.OccupancyGrid, topic, kept, lambda m: self.sensing.offer("map", topic, m, 0.0))
        if params.fix is not None:
            self._hear(geometry.PoseWithCovarianceStamped, params.fix, once, self._on_fix)
        if params.fix_from_tf:
            self._hear(load("tf2_msgs.msg").TFMessage, TF, quality(TF_DEPTH), self._on_tf)
        self._hear(geometry.PoseStamped, params.goal_pose, once, self._on_goal)
        for what, frame in (("hand", params.hand), ("level", params.level)):
            if frame is not None and find_frame(self.robot.model, frame) is None:
                names = [str(frame.name) for frame in self.robot.model.frames]
                raise ParameterError(f"{what}: there is no frame {frame!r}{nearest_name(frame, names)}")
        if params.hand is not None:
            self._hear(geometry.PoseStamped, params.hand_pose, once, self._on_hand)
        self._hear(nav.Path, params.plan_in, once, self._on_path)
        if not self.node.has_parameter("speed"):
            self.node.declare_parameter("speed", params.speed)
        self.node.add_on_set_parameters_callback(self._on_parameters)

    def _hear(self, kind: Any, topic: str, qos: Any, take: Callable[[Any], None]) -> None:
        def heard(message: Any) -> None:
            try:
                take(message)
            except ElasticStripsError as error:  # of one message: it is counted, and the next one may be right
                self.sensing.count(topic, error)

        self.node.create_subscription(kind, topic, heard, qos)

    def _advertise(self) -> None:
        trigger = load("std_srvs.srv").Trigger
        self.telling: Telling = Telling(self.node, self.robot, self.params, self.requests, self.sensing, self.ages)
        for kind in ("stop", "resume", "cancel"):

            def answer(_: Any, response: Any, kind: str = kind) -> Any:
                self.requests.ask(Request(kind, reason=f"asked to {kind}"))
                response.success, response.message = True, ""
                return response

            self.node.create_service(trigger, f"~/{kind}", answer)
        self._end_actions = serve(self.node, self.params, self.requests, self.telling.log)

    # what comes, in the thread of ROS

    def _time(self, message: Any) -> float:
        return self._time_of(nanoseconds(message.header.stamp))

    def _time_of(self, stamp: int, ahead: float | None = None) -> float:
        now, monotonic = read_together(lambda: int(self.node.get_clock().now().nanoseconds))
        return self._clock.time(stamp, now, monotonic, ahead)

    def _on_odometry(self, message: Any) -> None:
        check_frame(message, self.params.odom_frame or "")
        t, place = self._time(message), place_of(message)
        with self._lock:
            self._reader.note_odometry(t, place)

    def _on_joints(self, message: Any) -> None:
        t, positions = self._time(message), joints_of(message)
        with self._lock:
            self._reader.note_joints(t, positions)

    def _on_fix(self, message: Any) -> None:
        check_frame(message, self.params.world_frame or "")
        self._time(message)  # which refuses what is old
        self._fix = place_of(message).pose

    def _on_tf(self, message: Any) -> None:
        found = transform_of(message, self.params.world_frame or "", self.params.odom_frame or "")
        if found is not None:
            self._time_of(found.stamp, TF_AHEAD)  # which refuses what is old
            self._transform = found.pose

    def _on_seen(self, kind: str, topic: str, message: Any) -> None:
        with self._lock:
            self.sensing.offer(kind, topic, message, self._time(message))

    def _on_depth(self, topic: str, message: Any) -> None:
        if topic not in self._cameras:
            raise MessageError("no camera_info has arrived yet")
        with self._lock:
            self.sensing.offer("depth", topic, (message, self._cameras[topic]), self._time(message))

    def _on_goal(self, message: Any) -> None:
        check_frame(message, self.params.world_frame or "")
        self.requests.ask(Request("goal", planar_pose(message.pose)))

    def _on_hand(self, message: Any) -> None:
        check_frame(message, self.params.world_frame or "")
        self.requests.ask(Request("hand", spatial_pose(message.pose), self.params.hand or ""))

    def _on_path(self, message: Any) -> None:
        self.requests.ask(Request("path", path_of(message, self.params.world_frame or "")))

    def _on_parameters(self, changed: list[Any]) -> Any:
        """Take another speed, and refuse the rest."""
        most, why = self.params.speed, ""
        for parameter in changed:
            value = parameter.value
            if parameter.name in Ros2Params.names() and (parameter.name != "speed" or self.params.mode != "drive"):
                why = f"{parameter.name!r} cannot be changed while the node runs"
            elif parameter.name == "speed" and not (isinstance(value, float | int) and 0.0 <= value <= most):
                why = f"speed={value!r} must be within [0, {most:g}], as the node was started with"
            elif parameter.name == "speed":
                self.requests.ask(Request("speed", np.array([float(value) / most])))
        return load("rcl_interfaces.msg").SetParametersResult(successful=not why, reason=why)

    # where the robot is

    def begin(self, epoch: float) -> None:
        """Time is 0 at this reading of the monotonic clock from now on: what is known keeps its own."""
        with self._lock:
            self._reader = MotionReader(self.robot, self.limits)
            self._clock.epoch = epoch
            self.sensing.forget()

    def row_at(self, t: float) -> Array:
        """(nv,) coordinate row of the robot in the world at a time [s].

        Raises:
            MessageError: it is not known.
        """
        with self._lock:
            row = self._reader.row(t)
        if self.robot.space.planar:
            row[:3] = carried(self.correction, row[:3])
        return row

    def known(self) -> tuple[float, float]:
        """From when to when it is known where the robot is [s]."""
        with self._lock:
            return self._reader.oldest, self._reader.newest

    def ages(self, now: float) -> dict[str, float]:
        """How old the newest usable message of each topic is that says how the robot moves [s]."""
        with self._lock:
            odometry, joints = self._reader.ages(now)
        topics = {self.params.odom: odometry} if self.robot.space.planar else {}
        return {**topics, **({self.params.joint_states: joints} if self.robot.joint_names else {})}

    def correct(self, measured: float, estimate: Array) -> None:
        """Learn where the frame of odometry is, from an estimate of a time [s]."""
        if not self.robot.space.planar:
            return
        try:
            with self._lock:
                odometry = self._reader.odometry.at(measured)
        except ElasticStripsError:  # it is older than what is kept, or newer than what has come here
            return
        self.correction = correction_of(estimate[:3], odometry)

    def standing_row(self) -> Array | None:
        """(nv,) where the robot stands, in the world; None where that is not known yet."""
        with self._lock:
            t = self._reader.newest
            if t == -math.inf or self._reader.period == math.inf:
                return None
            row = self._reader.row(t)
        if self.params.fixes and self.robot.space.planar:
            if self._transform is not None:
                self.correction = self._transform
            elif self._fix is not None:
                self.correction = correction_of(self._fix, row[:3])
            else:
                return None
            row[:3] = carried(self.correction, row[:3])
        return row

    @property
    def missing(self) -> str:
        """What has not come yet."""
        with self._lock:
            parts = [self._reader.missing]
        if self.params.fixes and self._fix is None and self._transform is None:
            parts.append(f"a pose from {self.params.fixes!r}")
        return ", ".join(part for part in parts if part) or "more messages of odometry and joint states"

    @property
    def wrong(self) -> str:
        """What was wrong with messages most often, to be added to a sentence."""
        found = ", ".join(f"{what} ({plural(count, 'time')})" for what, count in self.sensing.counts.most_common(3))
        return f"; wrong was: {found}" if found else ""

    @property
    def period(self) -> float:
        """Median time from one message of odometry, or of joint states, to the next [s]."""
        with self._lock:
            return self._reader.period

    def spin(self, stack: ExitStack) -> None:
        """Hear and answer ROS, in a thread, until the stack is left."""
        executor = load("rclpy.executors").SingleThreadedExecutor(context=self.context)
        executor.add_node(self.node)
        ending = threading.Event()

        def run() -> None:
            while not ending.is_set():
                try:
                    executor.spin_once(timeout_sec=0.1)
                except Exception:  # of one callback: the others go on
                    if ending.is_set() or not self.context.ok():
                        return
                    _log.exception("a message or a request could not be handled")

        def end() -> None:
            if self.requests.close("the node ends"):
                time.sleep(_LAST_WORDS)
            ending.set()
            thread.join(2.0)
            self._end_actions()
            executor.shutdown()
            close_node(self.context, self.node)

        thread = threading.Thread(target=run, name="ros", daemon=True)
        thread.start()
        stack.callback(end)
