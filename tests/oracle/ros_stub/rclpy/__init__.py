"""Stands for rclpy where there is no ROS: one node, its topics, and a robot in a room that does what it is told.

`spin` plays the world: it integrates what was published, and gives odometry, joint states and scans, in simulated time.
The modules of messages that a node imports are made here, too.
"""

from __future__ import annotations

import math
import sys
from array import array
from types import ModuleType, SimpleNamespace

import numpy as np

import elastic_strips as es
from elastic_strips.sim.sensors import SensorConfig, SensorSuite

STEP = 0.01
LONGEST = 60.0
CRATE = es.Box((0.4, 0.4, 1.0), at=(1.6, 0.35, 0.5), name="crate")
SHELF = es.Box((0.3, 0.3, 0.3), at=(1.6, -0.75, 0.6), name="shelf")  # over the laser: only the camera sees it
_time = [1_700_000_000_000_000_000]  # ns: as far from 0 as on a robot
_messages: dict[str, dict[str, object]] = {
    "geometry_msgs": {"Twist": ("linear", "angular")},
    "nav_msgs": {"Odometry": ()},
    "sensor_msgs": {"JointState": (), "LaserScan": (), "PointCloud2": ()},
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


def _cloud(row: np.ndarray) -> dict[str, object]:
    """The shelf's surface in the base's frame: PointCloud2, four floats a point, rows that end with 8 bytes more."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.15, 0.15, 9)] * 3), axis=-1).reshape(-1, 3)
    c, s = math.cos(row[2]), math.sin(row[2])
    world = grid[np.abs(grid).max(axis=1) > 0.149] + SHELF.pose[:3, 3] - (row[0], row[1], 0.0)
    points = np.zeros((len(world), 4), "<f4")
    points[:, :3] = world @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    points[0] = np.nan
    width = len(points) // 2
    data = b"".join(half.tobytes() + bytes(8) for half in (points[:width], points[width : 2 * width]))
    fields = [SimpleNamespace(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate("xyz")]
    return {"height": 2, "width": width, "fields": fields, "is_bigendian": False, "point_step": 16,
            "row_step": 16 * width + 8, "data": array("B", data), "is_dense": False}  # fmt: skip


def spin(node: Node) -> None:
    """Play the world until the node ends; it must not take longer than a minute of it, and touch nothing."""
    robot, scene = es.load_robot("silvermate"), es.Scene([CRATE, SHELF])
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
            tell("points", k * STEP, **_cloud(row))
            assert es.strip_clearance(es.Strip.from_coordinates(robot, np.stack([row, row])), scene) > 0.0
        try:
            for timer in node.timers:
                timer()
        except SystemExit:
            print(f"the robot stands at x = {row[0]:.2f} m after {k * STEP:.1f} s")
            raise
    raise TimeoutError(f"the node has not ended after {LONGEST:g} s; the robot is at {row[:3]}")
