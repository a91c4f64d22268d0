"""Node: a robot that speaks ROS 2, driven by a Controller; the executor, and its driver, have a process of their own.

Three threads work here: one hears and answers ROS, one makes scenes of what the sensors say, and this one plans. What
they hand to each other is immutable, or under one lock.
"""

from __future__ import annotations

import logging
import math
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.interfaces import Event, RunState
from elastic_strips.control.process import ExecutorProcess
from elastic_strips.errors import ConfigurationError, ElasticStripsError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Scene
from elastic_strips.trajectory import MotionLimits

from .driver import Ros2Driver, close_node, load, open_node, quality
from .messages import (
    MessageError,
    check_frame,
    fill_path,
    fill_status,
    joints_of,
    nanoseconds,
    path_of,
    place_of,
    planar_pose,
)
from .motion import MotionReader, carried, check_rate, correction_of
from .params import Ros2Params, drive_params
from .requests import GoalState, Request, Requests
from .sensing import Sensing
from .stamps import StampClock

_log = logging.getLogger(__name__)
NODE_NAME = "elastic_strips"
_PLAN_PERIOD = 0.05  # [s]
_SEE_PERIOD = 0.005  # [s] from one look at what has come to the next
_LEAD_TIME = 0.1  # [s] from now to time 0
_TELL_AFTER = 2.0  # [s] of waiting until it is said what is missing
_DIAGNOSTICS_PERIOD = 1.0  # [s]
_RATE_SPAN = 1.0  # [s] in which the rate of odometry is measured
_PLAN_AHEAD = 30.0  # [s] of the way that is shown, and
_PLAN_STEP = 0.2  # [s] from pose to pose
_NEWEST_EVENTS = 50  # that are looked at, at most
_SAME_WARNING = 5.0  # [s] from a warning until the same is said again
_NUMBER = re.compile(r"-?[0-9.]+")  # by which alone what is said again and again differs
_SHOWN_EVERY = 4  # planning ticks from one shown plan to the next


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
            self.sensing: Sensing = Sensing(self.robot, self.params)
            self.requests: Requests = Requests(self.params.within)
            self._lock = threading.Lock()
            self._reader = MotionReader(self.robot, self.limits)
            self._clock = StampClock(self.params.oldest)
            self._clock.epoch = time.monotonic()
            self._fix: tuple[float, Array] | None = None
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
        lists = ("scans", "clouds", "depths", "mounts")
        for name, default in Ros2Params.names().items():
            if name in lists:
                value = (
                    self.node.declare_parameter(name, kinds.STRING_ARRAY).value
                    if default is None
                    else (
                        self.node.declare_parameter(name, list(default)).value  # type: ignore[call-overload]
                    )
                )
                value = tuple(value) if value else default
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
        for topic in params.scans:
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
        self._hear(geometry.PoseStamped, params.goal_pose, once, self._on_goal)
        self._hear(nav.Path, params.plan_in, once, self._on_path)

    def _hear(self, kind: Any, topic: str, qos: Any, take: Callable[[Any], None]) -> None:
        def heard(message: Any) -> None:
            try:
                take(message)
            except ElasticStripsError as error:  # of one message: it is counted, and the next one may be right
                self.sensing.count(topic, error)

        self.node.create_subscription(kind, topic, heard, qos)

    def _advertise(self) -> None:
        nav, std, diagnostic = (load(f"{name}_msgs.msg") for name in ("nav", "std", "diagnostic"))
        trigger, kept = load("std_srvs.srv").Trigger, quality(1, reliable=True, kept=True)
        self._plan = self.node.create_publisher(nav.Path, "plan", kept)
        self._state = self.node.create_publisher(std.String, "~/state", kept)
        self._diagnostics = self.node.create_publisher(
            diagnostic.DiagnosticArray, "/diagnostics", quality(1, reliable=True)
        )
        for kind in ("stop", "resume", "cancel"):

            def answer(_: Any, response: Any, kind: str = kind) -> Any:
                self.requests.ask(Request(kind, reason=f"asked to {kind}"))
                response.success, response.message = True, ""
                return response

            self.node.create_service(trigger, f"~/{kind}", answer)
        self._told_state = ""
        self._warned: dict[str, float] = {}  # what was said, without numbers, and when it happened [s]
        self._warned_until = -math.inf

    # what comes, in the thread of ROS

    def _time(self, message: Any) -> float:
        now = self.node.get_clock().now().nanoseconds
        return self._clock.time(nanoseconds(message.header.stamp), now, time.monotonic())

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
        self._fix = self._time(message), place_of(message).pose

    def _on_seen(self, kind: str, topic: str, message: Any) -> None:
        with self._lock:
            self.sensing.offer(kind, topic, message, self._time(message))

    def _on_depth(self, topic: str, message: Any) -> None:
        if topic not in self._cameras:
            raise MessageError("no camera_info has come yet")
        with self._lock:
            self.sensing.offer("depth", topic, (message, self._cameras[topic]), self._time(message))

    def _on_goal(self, message: Any) -> None:
        check_frame(message, self.params.world_frame or "")
        self.requests.ask(Request("goal", planar_pose(message.pose)))

    def _on_path(self, message: Any) -> None:
        self.requests.ask(Request("path", path_of(message, self.params.world_frame or "")))

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
        if self.params.fix is not None and self.robot.space.planar:
            if self._fix is None:
                return None
            self.correction = correction_of(self._fix[1], row[:3])
            row[:3] = self._fix[1]
        return row

    @property
    def missing(self) -> str:
        """What has not come yet."""
        with self._lock:
            parts = [self._reader.missing]
        if self.params.fix is not None and self._fix is None:
            parts.append(f"a pose from {self.params.fix!r}")
        return ", ".join(part for part in parts if part) or "more messages of odometry and joint states"

    @property
    def wrong(self) -> str:
        """What was wrong with messages most often, to be added to a sentence."""
        found = ", ".join(f"{what} ({count} times)" for what, count in self.sensing.counts.most_common(3))
        return f"; wrong was: {found}" if found else ""

    @property
    def period(self) -> float:
        """Median time from one message of odometry, or of joint states, to the next [s]."""
        with self._lock:
            return self._reader.period

    # what is told, in the thread that plans

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
                    _log.exception("a message, or a request, could not be taken")

        def end() -> None:
            ending.set()
            thread.join(2.0)
            executor.shutdown()
            close_node(self.context, self.node)

        thread = threading.Thread(target=run, name="ros", daemon=True)
        thread.start()
        stack.callback(end)

    def log(self, text: str) -> None:
        """Say something in ROS' log."""
        self.node.get_logger().info(text)

    def warn(self, events: list[Event]) -> None:
        """Say what went wrong since the last call; of what goes wrong all the time, once in a while."""
        news = [
            event for event in events[-_NEWEST_EVENTS:] if event.time > self._warned_until and event.kind == "fault"
        ]
        for event in news:
            same = _NUMBER.sub("", event.reason)
            if event.time > self._warned.get(same, -math.inf) + _SAME_WARNING:
                self._warned[same] = event.time
                self.node.get_logger().warning(event.reason)
        if news:
            self._warned_until = news[-1].time
        for what in [what for what in list(self.sensing.counts) if what not in self._warned]:
            self._warned[what] = math.inf  # it is counted from now on
            self.node.get_logger().warning(f"left out: {what}")

    def show(self, controller: Controller) -> None:
        """Publish the way ahead."""
        if not self.robot.space.planar:
            return
        rows = controller.ahead(_PLAN_AHEAD, _PLAN_STEP)
        nav, geometry = load("nav_msgs.msg"), load("geometry_msgs.msg")
        message = nav.Path()
        now = self.node.get_clock().now().nanoseconds
        fill_path(
            message, geometry.PoseStamped, rows[:, :3], self.params.world_frame or self.params.odom_frame or "odom", now
        )
        self._plan.publish(message)

    def tell_state(self, controller: Controller) -> None:
        """Publish the robot's state where it has changed."""
        goal = self.requests
        text = f"{controller.state.label}: {controller.reason}; goal {goal.number}: {goal.state.value}"
        if text != self._told_state:
            self._told_state = text
            message = load("std_msgs.msg").String()
            message.data = text
            self._state.publish(message)

    def diagnose(self, controller: Controller, executor: ExecutorProcess, rate: float) -> None:
        """Publish how it goes."""
        diagnostic = load("diagnostic_msgs.msg")
        array, status = diagnostic.DiagnosticArray(), diagnostic.DiagnosticStatus()
        now = executor.now
        trouble = executor.lost or ("" if controller.state is RunState.MOVING else controller.reason)
        trouble = "" if controller.state is RunState.REACHED else trouble
        faults = [event.reason for event in list(controller.events)[-20:] if event.kind == "fault"]
        values: dict[str, object] = {
            "state": controller.state.label,
            "goal": f"{self.requests.number}: {self.requests.state.value}: {self.requests.reason}",
            "odometry_hz": f"{rate:.1f}",
            "executor": executor.priority,
            "last_fault": faults[-1] if faults else "",
            **{f"age_of_{topic}_s": f"{self.sensing.age(topic, now):.2f}" for topic in self.params.scans},
            **{f"dropped: {what}": count for what, count in self.sensing.counts.most_common(8)},
        }
        fill_status(status, diagnostic.KeyValue, NODE_NAME, trouble, controller.reason, values)
        array.header.stamp = self.node.get_clock().now().to_msg()
        array.status.append(status)
        self._diagnostics.publish(array)


def run_node(arguments: Sequence[str] = (), params: Ros2Params | None = None, *, goals: int | None = None) -> RunState:
    """Drive a robot over ROS 2, until Ctrl-C, SIGTERM or the end of the last goal; the robot is at rest at the end.

    Args:
        arguments: arguments of ROS: ``["--ros-args", "-p", "robot:=tiago", …]``.
        params: the parameters; those of ROS where None.
        goals: end after so many goals were reached or refused; None: never.

    Returns:
        The robot's state at the end.

    Raises:
        MissingExtraError: rclpy is not installed.
        ConfigurationError: the robot's topics do not come, or too seldom.
        ParameterError: a parameter is wrong.
    """
    with ExitStack() as stack, _terminated():
        node = Ros2Node(params, ["--ros-args", *arguments] if arguments and arguments[0] != "--ros-args" else arguments)
        node.spin(stack)
        start, rate = _wait(node)
        drive = drive_params(node.params, node.limits, 1.0 / rate)
        q = node.robot.space.from_coordinates(start)
        node.log(
            f"odometry at {rate:.0f} Hz: silence {drive.monitor.silence:.2g} s, "
            f"tracking error {drive.tracking_error:g} m"
        )
        executor = ExecutorProcess(node.robot, q, q, params=drive, limits=node.limits, log=node.params.log)
        stack.enter_context(executor)
        controller = Controller(
            node.robot, q, q, None, params=drive, limits=node.limits, executor=executor, meter=time.monotonic
        )
        stack.callback(controller.close)
        executor.start(Ros2Driver(node.robot, node.limits, node.params, node.arguments))
        epoch = time.monotonic() + _LEAD_TIME
        node.begin(epoch)
        executor.begin(epoch)
        _see(node, stack)
        time.sleep(_LEAD_TIME)
        controller.scene = _first_scene(node, executor)
        controller.warm_up()  # by what there is to plan among
        node.log("ready for goals")
        _plan(node, controller, executor, rate, goals)
    return controller.state


def _wait(node: Ros2Node) -> tuple[Array, float]:
    """Wait for the robot's topics; where it stands (nv,), and at which rate they come [Hz]."""
    began = told = time.monotonic()
    since: float | None = None
    while True:
        row, now = node.standing_row(), time.monotonic()
        if row is not None:
            since = now if since is None else since
            if now > since + _RATE_SPAN:
                return row, check_rate(node.period)
        elif now > began + node.params.patience:
            raise ConfigurationError(f"after {node.params.patience:g} s this is missing: {node.missing}{node.wrong}")
        elif now > told + _TELL_AFTER:
            told = now
            node.log(f"waiting for {node.missing}")
        time.sleep(0.02)


def _first_scene(node: Ros2Node, executor: ExecutorProcess) -> Scene:
    """The first scene, once there is one; the robot stands.

    Raises:
        ConfigurationError: none comes.
    """
    while (scene := node.sensing.scene) is None:
        if executor.now > node.params.patience:
            raise ConfigurationError(
                f"nothing is seen on {', '.join(node.params.scans)} after {node.params.patience:g} s{node.wrong}"
            )
        time.sleep(0.02)
    return scene


def _see(node: Ros2Node, stack: ExitStack) -> None:
    """Make scenes of what comes, in a thread, until the stack is left."""
    ending = threading.Event()

    def run() -> None:
        while not ending.wait(_SEE_PERIOD):
            try:
                node.sensing.work(node.row_at, node.known())
            except Exception:
                _log.exception("what was seen could not be taken in")

    thread = threading.Thread(target=run, name="perception", daemon=True)
    thread.start()
    stack.callback(lambda: (ending.set(), thread.join(2.0)))


def _plan(node: Ros2Node, controller: Controller, executor: ExecutorProcess, rate: float, goals: int | None) -> None:
    """Plan, until the executor is lost or the last goal is over."""
    told, seen, ticks = -math.inf, None, 0
    while not executor.lost or controller.state is not RunState.FAILED:
        t = executor.now
        node.correct(*executor.estimated)
        node.requests.do(controller, node.log)
        scene = node.sensing.scene
        newer = _newer(scene, seen, t)
        seen = scene
        controller.plan(t, newer)
        node.tell_state(controller)
        node.warn(list(controller.events))
        if ticks % _SHOWN_EVERY == 0 and node.requests.state is GoalState.DRIVING:
            node.show(controller)
        if t > told + _DIAGNOSTICS_PERIOD:
            told = t
            node.diagnose(controller, executor, rate)
        over = node.requests.state in (GoalState.REACHED, GoalState.REFUSED, GoalState.CANCELLED)
        if goals is not None and node.requests.number >= goals and over and controller.executor.at_rest(t):
            return
        ticks += 1
        time.sleep(max(0.0, t + _PLAN_PERIOD - executor.now))
    node.log(f"the executor is lost: {executor.lost}")


def _newer(scene: Scene | None, seen: Scene | None, t: float) -> Scene | None:
    return scene if scene is not None and scene is not seen and scene.time <= t else None


@contextmanager
def _terminated() -> Iterator[None]:
    """SIGTERM and a closed terminal end as Ctrl-C does: with a stop."""

    def end(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
