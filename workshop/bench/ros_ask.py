"""ROS ask: asks the node of elastic_strips for goals "x,y,yaw" [m, rad], or "hand:x,y,z" of its hand, once it is ready
for one; to follow "path:x,y,yaw;x,y,yaw"; to stop, resume, cancel; for "speed:0.3"; for its footprint, whose corners it
prints; and for its markers, whose namespaces and numbers it prints."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from typing import Any

import click

from elastic_strips.ros2.driver import close_node, load, open_node, quality
from elastic_strips.ros2.messages import fill_path, fill_pose

LONGEST = 60.0  # [s]


def ask_for_goal(node: Any, place: Sequence[float], *, hand: bool = False, frame: str = "") -> None:
    """Publish a goal of the base, or a place of the hand, once somebody is ready for it."""
    String, PoseStamped = load("std_msgs.msg").String, load("geometry_msgs.msg").PoseStamped
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
    message.header.frame_id = frame
    fill_pose(message.pose, (*place[:2], 0.0) if hand else place)
    message.pose.position.z = place[2] if hand else 0.0
    goal.publish(message)
    goal.wait_for_all_acked()


def ask_for_path(node: Any, places: Sequence[Sequence[float]], frame: str = "odom") -> None:
    """Publish a path once somebody follows paths."""
    Path, PoseStamped = load("nav_msgs.msg").Path, load("geometry_msgs.msg").PoseStamped
    paths = node.create_publisher(Path, "plan_in", quality(1, reliable=True))
    end, message = time.monotonic() + LONGEST, Path()
    while not paths.get_subscription_count():
        assert time.monotonic() < end, "nobody follows paths"
        time.sleep(0.02)
    fill_path(message, PoseStamped, places, frame, node.get_clock().now().nanoseconds)
    paths.publish(message)
    paths.wait_for_all_acked()


def call(context: Any, node: Any, what: str) -> None:
    """Call one of the node's services, and wait for its answer."""
    Trigger = load("std_srvs.srv").Trigger
    client = node.create_client(Trigger, f"elastic_strips/{what}")
    assert client.wait_for_service(LONGEST), what
    executor = load("rclpy.executors").SingleThreadedExecutor(context=context)
    executor.add_node(node)
    answer = client.call_async(Trigger.Request())
    executor.spin_until_future_complete(answer, LONGEST)
    assert answer.result().success, what
    executor.shutdown()


def set_speed(context: Any, node: Any, value: float) -> None:
    SetParameters, Parameter = load("rcl_interfaces.srv").SetParameters, load("rclpy.parameter").Parameter
    client = node.create_client(SetParameters, "elastic_strips/set_parameters")
    assert client.wait_for_service(LONGEST)
    executor = load("rclpy.executors").SingleThreadedExecutor(context=context)
    executor.add_node(node)
    wanted = Parameter("speed", value=value).to_parameter_msg()
    answer = client.call_async(SetParameters.Request(parameters=[wanted]))
    executor.spin_until_future_complete(answer, LONGEST)
    click.echo(answer.result().results[0].successful)
    executor.shutdown()


def hear(node: Any, kind: Any, topic: str) -> Any:
    heard = node.create_subscription(kind, topic, lambda _: None, quality(1))
    end, taken = time.monotonic() + LONGEST, None
    while taken is None:
        assert time.monotonic() < end, f"nothing comes on {topic}"
        with heard.handle:
            taken = heard.handle.take_message(kind, False)
        time.sleep(0.02)
    return taken[0]


def answer(words: list[str]) -> None:
    """Ask for one thing after another."""
    context, node = open_node("asker")
    for word in words:
        if word.startswith("path:"):
            ask_for_path(
                node, [[float(x) for x in place.split(",")] for place in word.removeprefix("path:").split(";")]
            )
        elif "," in word:
            numbers = word.removeprefix("hand:").split(",")
            ask_for_goal(node, [float(number) for number in numbers], hand=word.startswith("hand:"))
        elif word.startswith("speed:"):
            set_speed(context, node, float(word.removeprefix("speed:")))
        elif word == "footprint":
            found = hear(node, load("geometry_msgs.msg").PolygonStamped, "footprint")
            click.echo(json.dumps([found.header.frame_id, [[point.x, point.y] for point in found.polygon.points]]))
        elif word == "markers":
            found = hear(node, load("visualization_msgs.msg").MarkerArray, "elastic_strips/markers").markers
            click.echo(json.dumps([[one.header.frame_id, one.ns, one.id] for one in found]))
        else:
            call(context, node, word)
    close_node(context, node)


if __name__ == "__main__":
    answer(sys.argv[1:])
