"""A ROS 2 node around a Controller: scans, clouds, odometry and joint states in, velocities of base and arm out.

It needs rclpy (a sourced ROS 2). Topics, and where the laser and the camera are mounted, are below; remap or change
them. What a cloud shows is thought to stand where it was seen last, and to be no part of the robot.
Run it: python scripts/examples/18_ros_node.py --ros-args -p x:=3.0 -p y:=0.0 -p yaw:=0.0
"""

from __future__ import annotations

import math

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState, LaserScan, PointCloud2
from std_msgs.msg import Float64MultiArray

import elastic_strips as es
from elastic_strips.control import Command, Controller, Measurement
from elastic_strips.io import cloud_scene
from elastic_strips.io.bag_reader import cloud_of
from elastic_strips.io.laser_log import scan_of
from elastic_strips.perception import SceneEstimator

PERIOD = 0.01  # [s] of the control loop, DriveParams.control_dt
T_BASE_LASER = np.eye(4)  # where the laser is mounted; on a robot, tf2 knows
T_BASE_LASER[:3, 3] = 0.271, 0.0, 0.25
T_BASE_CAMERA = np.eye(4)  # of the frame that the clouds are in
LOW, HIGH, VOXEL = 0.1, 1.6, 0.05  # heights between which a cloud's points count, and edge of its cells [m]


def seconds(stamp) -> float:
    return stamp.sec + 1e-9 * stamp.nanosec


class StripNode(Node):
    """Steps a controller at its rate, with what came last."""

    def __init__(self) -> None:
        super().__init__("elastic_strips")
        self.robot = es.load_robot("silvermate")
        self.goal = [self.declare_parameter(*goal).value for goal in (("x", 3.0), ("y", 0.0), ("yaw", 0.0))]
        self.estimator, self.scan_time = SceneEstimator(), -math.inf
        self.seen: es.Scene | None = None  # of the newest cloud
        self.controller: Controller | None = None
        self.pose = self.joints = None  # x, y [m], yaw [rad]; [rad]
        self.told = None  # the pose up to which the controller has been told what was travelled
        self.start = self.get_clock().now().nanoseconds  # the controller's clock begins here
        self.base = self.create_publisher(Twist, "cmd_vel", 1)
        self.arm = self.create_publisher(Float64MultiArray, "arm_velocity_controller/commands", 1)
        self.create_subscription(Odometry, "odom", self.on_odometry, 10)
        self.create_subscription(JointState, "joint_states", self.on_joints, 10)
        self.create_subscription(LaserScan, "scan", self.on_scan, 5)
        self.create_subscription(PointCloud2, "points", self.on_cloud, 5)
        self.create_timer(PERIOD, self.on_timer)

    def now(self) -> float:
        return 1e-9 * (self.get_clock().now().nanoseconds - self.start)

    def on_odometry(self, message: Odometry) -> None:
        at, turn = message.pose.pose.position, message.pose.pose.orientation
        self.pose = np.array([at.x, at.y, 2.0 * math.atan2(turn.z, turn.w)])

    def on_joints(self, message: JointState) -> None:
        position = dict(zip(message.name, message.position, strict=True))
        if all(name in position for name in self.robot.joint_names):
            self.joints = np.array([position[name] for name in self.robot.joint_names])

    def on_scan(self, message: LaserScan) -> None:
        if self.pose is None:
            return
        keys = ("angle_min", "angle_increment", "range_min", "range_max")
        head = {"stamp": seconds(message.header.stamp) - 1e-9 * self.start, **{k: getattr(message, k) for k in keys}}
        self.estimator.update(scan_of(message.header.frame_id, head, message.ranges, T_BASE_LASER), self.pose)

    def on_cloud(self, message: PointCloud2) -> None:
        if self.pose is None:
            return
        x, y, yaw = self.pose
        local = cloud_of(message).points @ T_BASE_CAMERA[:3, :3].T + T_BASE_CAMERA[:3, 3]
        c, s = math.cos(yaw), math.sin(yaw)
        points = local @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + (x, y, 0.0)
        points = points[(points[:, 2] >= LOW) & (points[:, 2] <= HIGH)]
        self.seen = cloud_scene(points, VOXEL) if len(points) else None

    def on_timer(self) -> None:
        if self.pose is None or self.joints is None or not self.estimator.times:
            return  # not everything is there yet
        scene = self.estimator.scene()
        for obstacle in self.seen or ():
            scene = scene.with_obstacle(obstacle)
        if self.controller is None:  # the robot stands; the first plan is made here
            start = self.robot.space.from_coordinates(np.concatenate([self.pose, self.joints]))
            self.controller = Controller(self.robot, start, self.robot.home(*self.goal), scene)
            self.told, measurement = self.pose, None
        else:
            measurement = Measurement(self.now(), self.travelled(), self.joints)
        newer = scene if scene.time > self.scan_time else None
        self.scan_time = scene.time
        self.send(self.controller.step(self.now(), measurement, newer))
        if self.controller.ended:
            self.get_logger().info(f"{self.controller.state.label}: {self.controller.reason}")
            self.controller.close()
            raise SystemExit

    def travelled(self) -> np.ndarray:
        """Of the rims left and right [m] since it was asked last: odometry as a differential drive's encoders."""
        dx, dy, turn = self.pose - self.told
        turn = math.remainder(turn, 2.0 * math.pi)
        along = self.told[2] + 0.5 * turn
        forward, self.told = dx * math.cos(along) + dy * math.sin(along), self.pose
        return forward + 0.5 * self.controller.limits.track * turn * np.array([-1.0, 1.0])

    def send(self, command: Command) -> None:
        left, right = (0.0, 0.0) if command.stop else command.drive
        twist = Twist()
        twist.linear.x = float(0.5 * (left + right))
        twist.angular.z = float((right - left) / self.controller.limits.track)
        self.base.publish(twist)
        rates = 0.0 * command.joints if command.stop else command.joints
        self.arm.publish(Float64MultiArray(data=[float(rate) for rate in rates]))


rclpy.init()
node = StripNode()
try:
    rclpy.spin(node)
except SystemExit:
    pass
finally:
    node.destroy_node()
    rclpy.shutdown()
