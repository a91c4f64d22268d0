"""Asks the node of elastic_strips for goals "x,y,yaw" [m, rad], or "hand:x,y,z" of its hand, once it is ready for one;
to follow "path:x,y,yaw;x,y,yaw"; to stop, resume, cancel; for "speed:0.3"; for its footprint, whose corners it prints;
and for its markers, whose namespaces and numbers it prints."""

from __future__ import annotations

import json
import sys
import time

from geometry_msgs.msg import PolygonStamped, PoseStamped
from nav_msgs.msg import Path
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from elastic_strips.ros2.driver import close_node, open_node, quality
from elastic_strips.ros2.messages import fill_path, fill_pose

LONGEST = 60.0  # [s]


def ask_for_goal(node, place: list[float], *, hand: bool = False) -> None:
    state = node.create_subscription(
        String, "elastic_strips/state", lambda _: None, quality(1, reliable=True, kept=True)
    )
    goal = node.create_publisher(PoseStamped, "hand_pose" if hand else "goal_pose", quality(1, reliable=True))
    end, heard = time.monotonic() + LONGEST, None
    while heard is None or not goal.get_subscription_count():
        assert time.monotonic() < end, "nobody is ready for a goal"
        with state.handle:
            heard = heard or state.handle.take_message(String, False)
        time.sleep(0.02)
    message = PoseStamped()
    fill_pose(message.pose, (*place[:2], 0.0) if hand else place)
    message.pose.position.z = place[2] if hand else 0.0
    goal.publish(message)
    goal.wait_for_all_acked()


def ask_for_path(node, places: list[list[float]]) -> None:
    paths = node.create_publisher(Path, "plan_in", quality(1, reliable=True))
    end, message = time.monotonic() + LONGEST, Path()
    while not paths.get_subscription_count():
        assert time.monotonic() < end, "nobody follows paths"
        time.sleep(0.02)
    fill_path(message, PoseStamped, places, "odom", node.get_clock().now().nanoseconds)
    paths.publish(message)
    paths.wait_for_all_acked()


def call(context, node, what: str) -> None:
    import rclpy.executors

    client = node.create_client(Trigger, f"elastic_strips/{what}")
    assert client.wait_for_service(LONGEST), what
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    answer = client.call_async(Trigger.Request())
    executor.spin_until_future_complete(answer, LONGEST)
    assert answer.result().success, what
    executor.shutdown()


def set_speed(context, node, value: float) -> None:
    import rclpy.executors
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    client = node.create_client(SetParameters, "elastic_strips/set_parameters")
    assert client.wait_for_service(LONGEST)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    wanted = Parameter("speed", value=value).to_parameter_msg()
    answer = client.call_async(SetParameters.Request(parameters=[wanted]))
    executor.spin_until_future_complete(answer, LONGEST)
    print(answer.result().results[0].successful)
    executor.shutdown()


def hear(node, kind, topic: str):
    heard = node.create_subscription(kind, topic, lambda _: None, quality(1))
    end, taken = time.monotonic() + LONGEST, None
    while taken is None:
        assert time.monotonic() < end, f"nothing comes on {topic}"
        with heard.handle:
            taken = heard.handle.take_message(kind, False)
        time.sleep(0.02)
    return taken[0]


context, node = open_node("asker")
for word in sys.argv[1:]:
    if word.startswith("path:"):
        ask_for_path(node, [[float(x) for x in place.split(",")] for place in word.removeprefix("path:").split(";")])
    elif "," in word:
        numbers = word.removeprefix("hand:").split(",")
        ask_for_goal(node, [float(number) for number in numbers], hand=word.startswith("hand:"))
    elif word.startswith("speed:"):
        set_speed(context, node, float(word.removeprefix("speed:")))
    elif word == "footprint":
        found = hear(node, PolygonStamped, "footprint")
        print(json.dumps([found.header.frame_id, [[point.x, point.y] for point in found.polygon.points]]))
    elif word == "markers":
        found = hear(node, MarkerArray, "elastic_strips/markers").markers
        print(json.dumps([[one.header.frame_id, one.ns, one.id] for one in found]))
    else:
        call(context, node, word)
close_node(context, node)
