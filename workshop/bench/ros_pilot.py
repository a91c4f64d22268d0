"""ROS pilot: somebody hostile at the topics that the node guards, as a ROS 2 node in a process of its own."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import Desired
from elastic_strips.robot import load_robot
from elastic_strips.ros2.driver import close_node, load, open_node, quality
from elastic_strips.ros2.messages import fill_stamp, fill_twist, place_of
from elastic_strips.trajectory import MotionLimits

from .pilots import PILOTS, Seen
from .ros_robot import pillar_corridor

_PERIOD = 0.02  # [s] from one command to the next
_LONGEST_WAIT = 60.0  # [s] until somebody hears it
_SPOILT = 0.3  # part of the commands of a kind that is no command


def fly(kind: str, seed: int, seconds: float, *, spoilt: bool, stamped: bool, arguments: list[str]) -> int:
    """Command for so many seconds, once somebody listens; how many commands went out.

    Args:
        kind: one of `PILOTS`.
        seed: of the corridor and of the pilot.
        seconds: how long [s].
        spoilt: whether some come in unknown frames, with NaN, of long ago, of too many joints, or not at all.
        stamped: whether velocities are TwistStamped rather than Twist.
        arguments: arguments of ROS.
    """
    robot = load_robot("silvermate")
    limits = MotionLimits.for_robot(robot)
    rng = np.random.default_rng(seed + 100)
    pilot, scene = PILOTS[kind](robot, limits, rng), pillar_corridor(seed)[0].at(0.0)
    context, node = open_node("pilot", arguments)
    row: Array = robot.space.to_coordinates(robot.home())
    odometry = node.create_subscription(load("nav_msgs.msg").Odometry, "odom", lambda _: None, quality(5))
    once = quality(1, reliable=True)
    geometry = load("geometry_msgs.msg")
    twists = node.create_publisher(geometry.TwistStamped if stamped else geometry.Twist, "cmd_vel_in", once)
    rates = node.create_publisher(load("std_msgs.msg").Float64MultiArray, "joint_velocities_in", once)
    sent, trick, until = 0, 0, -math.inf
    try:
        end = time.monotonic() + _LONGEST_WAIT
        while not (twists.get_subscription_count() and rates.get_subscription_count()) and time.monotonic() < end:
            time.sleep(0.02)
        began = time.monotonic()
        while (t := time.monotonic() - began) < seconds:
            for _ in range(20):
                with odometry.handle:
                    taken = odometry.handle.take_message(odometry.msg_type, odometry.raw)
                if taken is None:
                    break
                row[:3] = place_of(taken[0]).pose
            desired = pilot(Seen(t, row, scene))
            if t >= until:
                until, trick = t + float(rng.uniform(0.1, 0.6)), int(rng.integers(1, 6))
                trick = trick if spoilt and rng.random() < _SPOILT else 0
            if desired is not None and trick != 1:
                _send(node, twists, rates, desired, trick)
                sent += 1
            time.sleep(_PERIOD)
    finally:
        close_node(context, node)
    return sent


def _send(node: Any, twists: Any, rates: Any, desired: Desired, trick: int) -> None:
    message, joints = twists.msg_type(), rates.msg_type()
    twist = getattr(message, "twist", message)
    if twist is not message:
        stamp = node.get_clock().now().nanoseconds - (3_000_000_000 if trick == 2 else 0)
        fill_stamp(message.header.stamp, stamp)
        message.header.frame_id = "nowhere" if trick == 3 else "base_link"
    fill_twist(twist, np.zeros(3) if desired.twist is None else desired.twist)
    if trick == 4:
        twist.linear.x = math.nan
    joints.data = [] if desired.joints is None else desired.joints.tolist()
    if trick == 5:
        joints.data.append(1.0)
    twists.publish(message)
    rates.publish(joints)
