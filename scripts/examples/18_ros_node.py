"""A robot that speaks ROS 2 is driven to goals on /goal_pose: odometry, joint states and scans in, velocities out.

It needs rclpy: a sourced ROS 2, or pip install 'elastic-strips[ros2]'. `elastic-strips ros2` is the same.
Run it: python scripts/examples/18_ros_node.py --ros-args -p robot:=silvermate -p goal_pose:=/goal_pose
"""

import sys

from elastic_strips.ros2 import run_node

if __name__ == "__main__":  # the executor is a process of its own, and imports this file
    print(f"the robot is at rest: {run_node(sys.argv[1:], goals=1).label}")
