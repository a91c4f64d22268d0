"""Stands for rclpy where there is no ROS: one node, its topics, and a robot in a room that does what it is told.

`spin` plays the world: it integrates what was published, and gives odometry, joint states and scans, in simulated time.
The modules of messages that a node imports are made here, too.
"""

from __future__ import annotations

import math
import sys
from types import ModuleType, SimpleNamespace

import numpy as np

import elastic_strips as es
from elastic_strips.sim.sensors import SensorConfig, SensorSuite

STEP = 0.01
LONGEST = 60.0
CRATE = es.Box((0.4, 0.4, 1.0), at=(1.6, 0.35, 0.5), name="crate")
_time = [1_700_000_000_000_000_000]  # ns: as far from 0 as on a robot
_messages: dict[str, dict[str, object]] = {
    "geometry_msgs": {"Twist": ("linear", "angular")},
    "nav_msgs": {"Odometry": ()},
    "sensor_msgs": {"JointState": (), "LaserScan": ()},
    "std_msgs": {"Float64MultiArray": ()},
}


def _kind(name: str, parts: tuple[str, ...]) -> type:
    def fill(self, **values: object) -> None:
        self.__dict__.update({part: SimpleNamespace(x=0.0, y=0.0, z=0.0) for part in parts}, **values)

    return type(name, (), {"__init__": fill})


for _package, _kinds in _messages.items():
    sys.modules[_package] = ModuleType(_package)
    sys.modules[f"{_package}.msg"] = module = ModuleType(f"{_package}.msg")
    module.__dict__.update({name: _kind(name, parts) for name, parts in _kinds.items()})


class Node:
    """What a node uses of ROS' own."""

    def __init__(self, name: str) -> None:
        self.heard, self.said, self.timers = {}, {}, []

    def declare_parameter(self, name: str, value: object) -> SimpleNamespace:
        return SimpleNamespace(value=value)

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=_time[0]))

    def create_publisher(self, kind: type, topic: str, depth: int) -> SimpleNamespace:
        def publish(message: object) -> None:
            assert isinstance(message, kind)
            self.said[topic] = message

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind: type, topic: str, callback: object, depth: int) -> None:
        self.heard[topic] = (kind, callback)

    def create_timer(self, period: float, callback: object) -> None:
        assert period == STEP
        self.timers.append(callback)

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(info=print)

    def destroy_node(self) -> None:
        pass


def init() -> None:
    """Nothing is to be done."""


def shutdown() -> None:
    """Nothing is to be done."""


def spin(node: Node) -> None:
    """Play the world until the node ends; it must not take longer than a minute of it, and not touch the crate."""
    robot, scene = es.load_robot("silvermate"), es.Scene([CRATE])
    laser = SensorSuite(robot, es.World(scene), SensorConfig().only("laser"), seed=1)
    row = robot.space.to_coordinates(robot.home()).copy()
    start = _time[0]

    def tell(topic: str, t: float, **values: object) -> None:
        kind, callback = node.heard[topic]
        at = start + round(t * 1e9)
        stamp = SimpleNamespace(sec=at // 10**9, nanosec=at % 10**9)
        callback(kind(header=SimpleNamespace(stamp=stamp, frame_id="laser"), **values))

    for k in range(round(LONGEST / STEP)):
        _time[0] = start + round(k * STEP * 1e9)
        if "cmd_vel" in node.said:
            v, w = node.said["cmd_vel"].linear.x, node.said["cmd_vel"].angular.z
            middle = row[2] + 0.5 * w * STEP
            row[:3] += STEP * np.array([v * math.cos(middle), v * math.sin(middle), w])
            row[3:] += STEP * np.array(node.said["arm_velocity_controller/commands"].data)
        turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(0.5 * row[2]), w=math.cos(0.5 * row[2]))
        pose = SimpleNamespace(position=SimpleNamespace(x=row[0], y=row[1], z=0.0), orientation=turn)
        tell("odom", k * STEP, pose=SimpleNamespace(pose=pose))
        tell("joint_states", k * STEP, name=list(robot.joint_names), position=row[3:].tolist())
        for scan in laser.observe(k * STEP, row):
            step = float(scan.angles[1] - scan.angles[0])
            head = {"angle_min": float(scan.angles[0]), "angle_increment": step, "range_min": scan.range_min}
            tell("scan", scan.time, **head, range_max=scan.range_max, ranges=scan.ranges.tolist())
        if k % 20 == 0:
            assert es.strip_clearance(es.Strip.from_coordinates(robot, np.stack([row, row])), scene) > 0.0
        try:
            for timer in node.timers:
                timer()
        except SystemExit:
            print(f"the robot stands at x = {row[0]:.2f} m after {k * STEP:.1f} s")
            raise
    raise TimeoutError(f"the node has not ended after {LONGEST:g} s; the robot is at {row[:3]}")
