"""Driver: wheels and arm of a robot that speaks ROS 2; it has a context of its own, in the executor's process.

It looks for messages when it is asked to measure, and has no thread of its own: `measure` and `send` wait for nothing.
"""

from __future__ import annotations

import importlib
import time
from collections import Counter
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.guard import Desired
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.errors import ConfigurationError, ParameterError, missing_extra, plural
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits

from .messages import (
    MessageError,
    RosObject,
    check_frame,
    ending_at_rest,
    fill_stamp,
    fill_trajectory,
    fill_twist,
    joints_of,
    kind_of,
    nanoseconds,
    place_of,
    transform_of,
)
from .motion import MotionReader
from .params import TF, Ros2Params
from .pilot import PilotReader
from .shared_memory import clear_left
from .stamps import StampClock, read_together

TF_DEPTH = 50
"""Messages of ``/tf`` that wait at most: everybody publishes there."""
TF_AHEAD = 2.0
"""Time [s] by which a transform's stamp may be ahead: localization stamps until when it holds."""
_LONGEST_DISCOVERY = 15.0  # [s] until something of the robot has come: now and then discovery takes 3 s
_LONGEST_UNHEARD = 5.0  # [s] for which it is waited for the emergency stop when all else is there
_AT_ONCE = 20  # messages of a topic that are taken in one period
_LONGEST_BLIND = 0.1  # [s] besides, for which joint states may be missing
_ARM_PERIOD = 0.02  # [s] from one trajectory of the arm to the next
_ARM_HOLD = 0.1  # [s] for which it goes on without a new one before it slows down
_MOST_NOTES = 10  # kinds of what was left out that are told at once
_LAST_WORDS = 5  # commands of rest at the end, and
_LAST_PERIOD = 0.02  # [s] from one to the next


def load(module: str) -> ModuleType:
    """A module of ROS 2's.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        wanted = missing_extra("driving a robot over ROS 2", module.split(".")[0], "ros2")
        raise type(wanted)(f"{wanted}; or source a ROS 2 installation for this Python ({error})") from None


def open_node(name: str, arguments: list[str] | None = None) -> tuple[RosObject, RosObject]:
    """A context that leaves signals alone, and a node in it.

    Raises:
        MissingExtraError: rclpy is not installed.
    """
    rclpy = load("rclpy")
    context = load("rclpy.context").Context()
    rclpy.init(args=arguments, context=context, signal_handler_options=load("rclpy.signals").SignalHandlerOptions.NO)
    return context, load("rclpy.node").Node(name, context=context)


def close_node(context: RosObject, node: RosObject) -> None:
    """Destroy a node, and shut its context down."""
    node.destroy_node()
    context.try_shutdown()


def quality(depth: int, *, reliable: bool = False, kept: bool = False) -> RosObject:
    """Quality of service: of best effort, which hears everybody, or reliable; ``kept`` for who comes later."""
    qos = load("rclpy.qos")
    return qos.QoSProfile(
        depth=depth,
        reliability=qos.ReliabilityPolicy.RELIABLE if reliable else qos.ReliabilityPolicy.BEST_EFFORT,
        durability=qos.DurabilityPolicy.TRANSIENT_LOCAL if kept else qos.DurabilityPolicy.VOLATILE,
    )


class Ros2Driver:
    """Workspace: the :class:`~elastic_strips.control.driver.Driver` of a robot that speaks ROS 2.

    It can be sent to another process until it is opened. What it cannot promise is the command timeout: the robot's own
    controllers have to stop where no velocity comes any more.

    Args:
        robot: the robot.
        limits: limits of its motors.
        params: the node's parameters.
        arguments: arguments of ROS, such as remappings.
    """

    def __init__(self, robot: RobotModel, limits: MotionLimits, params: Ros2Params, arguments: list[str]) -> None:
        self._robot, self._limits, self._params, self._arguments = robot, limits, params, arguments
        self._node: Any = None

    def open(self) -> None:
        """Begin to listen, and wait until odometry and joint states have come.

        Raises:
            ConfigurationError: they do not come.
        """
        params = self._params
        self._context, node = open_node("elastic_strips_driver", self._arguments)
        self._node = node
        self._clock = StampClock(params.oldest)
        self._reader = MotionReader(self._robot, self._limits)
        self.counts: Counter[str] = Counter()
        self._emergency: bool | None = None
        self._notes: dict[str, None] = {}  # what was left out since it was asked for
        nav, sensor, geometry = (load(f"{name}_msgs.msg") for name in ("nav", "sensor", "geometry"))
        self._subscriptions: list[tuple[str, Any, Callable[[Any], None]]] = []
        if self._robot.space.planar:
            self._hear(nav.Odometry, params.odom, quality(20), self._on_odometry)
        if self._robot.joint_names:
            self._hear(sensor.JointState, params.joint_states, quality(20), self._on_joints)
        if params.fix is not None:
            self._hear(geometry.PoseWithCovarianceStamped, params.fix, quality(1, reliable=True), self._on_fix)
        if params.fix_from_tf:
            self._hear(load("tf2_msgs.msg").TFMessage, TF, quality(TF_DEPTH), self._on_tf)
        if params.emergency is not None:
            kind = load("std_msgs.msg").Bool
            self._hear(kind, params.emergency, quality(1, reliable=True, kept=True), self._on_emergency)
        self._pilot = self._no_pilot()
        if params.mode == "guard":
            self._hear_pilot()
        self._twist = geometry.TwistStamped if params.stamped else geometry.Twist
        self._base = None
        if self._robot.space.planar:
            self._base = node.create_publisher(self._twist, params.cmd_vel, quality(1, reliable=True))
        self._arm, self._arm_sent = None, -np.inf
        if self._robot.joint_names and params.arm != "none":
            kind = (
                load("trajectory_msgs.msg").JointTrajectory
                if params.arm == "trajectory"
                else load("std_msgs.msg").Float64MultiArray
            )
            self._arm = node.create_publisher(kind, params.arm_topic, quality(1, reliable=True))
        self._wait()
        self._clock = StampClock(params.oldest)
        self._reader = MotionReader(self._robot, self._limits)
        self._pilot = self._no_pilot()
        self._notes.clear()

    def _no_pilot(self) -> PilotReader:
        params = self._params
        return PilotReader(self._robot, params.base_frame, params.oldest_command, backward=params.backward)

    def _hear_pilot(self) -> None:
        params, geometry = self._params, load("geometry_msgs.msg")
        if self._robot.space.planar:
            kind = geometry.TwistStamped if params.stamped_in else geometry.Twist
            self._hear(kind, params.cmd_vel_in, quality(1), self._on_velocity)
        if self._robot.joint_names and params.arm != "none":
            kind = load("std_msgs.msg").Float64MultiArray
            self._hear(kind, params.joint_velocities_in, quality(1), self._on_rates)

    def _wait(self) -> None:
        began = time.monotonic()
        self._clock.epoch = began
        listeners = [publisher for publisher in (self._base, self._arm) if publisher is not None]
        there: float | None = None  # when all was there but perhaps the emergency stop [s]
        while True:
            self._listen()
            missing, now = self._reader.missing, time.monotonic()
            if not missing and all(p.get_subscription_count() for p in listeners):
                there = now if there is None else there
                # until it is heard of it counts as pressed, and what was pressed waits for somebody to resume
                heard = self._params.emergency is None or self._emergency is not None
                if heard or now > there + _LONGEST_UNHEARD:
                    return
            elif now - began > _LONGEST_DISCOVERY:
                deaf = [p.topic_name for p in listeners if not p.get_subscription_count()]
                why = (
                    f"no message has arrived of {self._reader.missing}"
                    if self._reader.missing
                    else (f"nobody listens to {', '.join(deaf)}")
                )
                close_node(self._context, self._node)
                self._node = None
                raise ConfigurationError(f"{why} for {_LONGEST_DISCOVERY:g} s; {self._said()}")
            time.sleep(0.005)

    def _said(self) -> str:
        """What was wrong with messages so far."""
        wrong = ", ".join(f"{what} ({plural(count, 'time')})" for what, count in self.counts.most_common(3))
        return f"of what arrived, this was wrong: {wrong}" if wrong else "is the robot on, and are the topics right?"

    def _hear(self, kind: Any, topic: str, qos: Any, take: Callable[[Any], None]) -> None:
        self._subscriptions.append((topic, self._node.create_subscription(kind, topic, lambda _: None, qos), take))

    def _listen(self) -> None:
        """Take what has come; what is wrong is counted."""
        for topic, subscription, take in self._subscriptions:
            for _ in range(_AT_ONCE):
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is None:
                    break
                try:
                    take(taken[0])
                except MessageError as error:
                    what = f"{topic}: {kind_of(error)}"
                    self.counts[what] += 1
                    if len(self._notes) < _MOST_NOTES:
                        self._notes[what] = None

    def _time(self, message: Any) -> float:
        return self._time_of(nanoseconds(message.header.stamp))

    def _time_of(self, stamp: int, ahead: float | None = None) -> float:
        now, monotonic = read_together(lambda: int(self._node.get_clock().now().nanoseconds))
        return self._clock.time(stamp, now, monotonic, ahead)

    def _on_odometry(self, message: Any) -> None:
        check_frame(message, self._params.odom_frame or "")
        self._reader.note_odometry(self._time(message), place_of(message))

    def _on_joints(self, message: Any) -> None:
        self._reader.note_joints(self._time(message), joints_of(message))

    def _on_fix(self, message: Any) -> None:
        check_frame(message, self._params.world_frame or "")
        self._reader.note_fix(self._time(message), place_of(message))

    def _on_tf(self, message: Any) -> None:
        params = self._params
        found = transform_of(message, params.world_frame or "", params.odom_frame or "")
        if found is not None:
            noise = params.tf_noise, params.tf_angle_noise
            self._reader.note_transform(self._time_of(found.stamp, TF_AHEAD), found.pose, noise)

    def _on_emergency(self, message: Any) -> None:
        self._emergency = bool(message.data)

    def notes(self) -> list[str]:
        """What was left out of what came since the last call."""
        found = [f"left out: {what}" for what in self._notes]
        self._notes.clear()
        return found

    def _on_velocity(self, message: Any) -> None:
        if self._params.stamped_in:
            self._pilot.check_frame(message)
            self._pilot.note_twist(self._time(message), message.twist)
        else:
            self._pilot.note_twist(self._clock.now(time.monotonic()), message)

    def _on_rates(self, message: Any) -> None:
        self._pilot.note_rates(self._clock.now(time.monotonic()), message.data)

    def desired(self, t: float) -> Desired | None:
        """What somebody wants, of what came up to the last measurement."""
        return self._pilot.desired(t)

    def measure(self, t: float) -> Measurement | None:
        """The newest measurement; None where nothing new came."""
        self._clock.tick(t, time.monotonic())
        self._listen()
        found, stop = self._reader.measure(), self._emergency_stop
        if found is None or not stop:
            return found
        return Measurement(
            found.time, found.drive, found.joints, found.pose, found.pose_time, found.pose_covariance, "", stop
        )

    @property
    def _emergency_stop(self) -> str:
        if self._params.emergency is None or self._emergency is False:
            return ""
        return (
            "emergency stop pressed" if self._emergency else f"nothing has arrived from {self._params.emergency!r} yet"
        )

    def send(self, t: float, command: Command) -> None:
        """Pass a command on; a safe stop is a velocity of zero, for a topic cuts no power.

        Raises:
            ParameterError: it has the wrong size or is not finite.
        """
        drive, joints = np.asarray(command.drive, dtype=float), np.asarray(command.joints, dtype=float)
        wanted = (len(self._limits.drive_speed),), (len(self._limits.joint_speed),)
        if (drive.shape, joints.shape) != wanted or not (np.isfinite(drive).all() and np.isfinite(joints).all()):
            raise ParameterError(f"command {drive} and {joints}: finite speeds of the sizes {wanted} are needed")
        if command.stop:
            drive, joints = 0.0 * drive, 0.0 * joints
        now = self._node.get_clock().now().nanoseconds
        if self._base is not None:
            message = self._twist()
            if self._params.stamped:
                message.header.frame_id = self._params.base_frame or "base_link"
                fill_stamp(message.header.stamp, now)
            fill_twist(message.twist if self._params.stamped else message, self._limits.to_twist(drive))
            self._base.publish(message)
        if self._arm is not None:
            self._send_arm(t, joints)

    def _send_arm(self, t: float, rates: Array) -> None:
        assert self._arm is not None
        message = self._arm.msg_type()
        if self._params.arm == "velocity":
            message.data = rates.tolist()
        else:
            if t < self._arm_sent + _ARM_PERIOD - 1e-6:
                return
            self._arm_sent = t
            newest = self._reader.newest
            if t > newest + _ARM_HOLD + _LONGEST_BLIND:  # where it is now is not known; the last one ends at rest
                return
            try:
                here = self._reader.joints_at(newest)
            except MessageError:  # after a gap they are known from now on
                return
            ahead = here + rates * min(max(t - newest, 0.0), _ARM_HOLD)
            points = ending_at_rest(ahead, rates, self._limits.joint_acceleration, _ARM_HOLD)
            make = load("trajectory_msgs.msg").JointTrajectoryPoint
            fill_trajectory(message, make, self._robot.joint_names, points)
        self._arm.publish(message)

    def close(self) -> None:
        """Command rest, several times: who listens may have missed one; and leave ROS."""
        if self._node is None:
            return
        rest = Command.rest(self._limits)
        try:
            for _ in range(_LAST_WORDS):
                self.send(time.monotonic() - self._clock.epoch, rest)
                time.sleep(_LAST_PERIOD)
        finally:
            close_node(self._context, self._node)
            self._node = None
            clear_left()  # of who started this process, where that was killed
