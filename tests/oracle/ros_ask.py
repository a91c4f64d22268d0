"""Asks the node of elastic_strips for goals "x,y,yaw" [m, rad], once it is ready for one; to stop, resume, cancel; and
for its footprint, whose corners it prints."""

from __future__ import annotations

import json
import sys
import time

from geometry_msgs.msg import PolygonStamped, PoseStamped
from std_msgs.msg import String
from std_srvs.srv import Trigger

from elastic_strips.ros2.driver import close_node, open_node, quality
from elastic_strips.ros2.messages import fill_pose

LONGEST = 60.0  # [s]


def ask_for_goal(node, place: list[float]) -> None:
    state = node.create_subscription(
        String, "elastic_strips/state", lambda _: None, quality(1, reliable=True, kept=True)
    )
    goal = node.create_publisher(PoseStamped, "goal_pose", quality(1, reliable=True))
    end, heard = time.monotonic() + LONGEST, None
    while heard is None or not goal.get_subscription_count():
        assert time.monotonic() < end, "nobody is ready for a goal"
        with state.handle:
            heard = heard or state.handle.take_message(String, False)
        time.sleep(0.02)
    message = PoseStamped()
    fill_pose(message.pose, place)
    goal.publish(message)
    goal.wait_for_all_acked()


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


def hear_footprint(node) -> None:
    heard = node.create_subscription(PolygonStamped, "footprint", lambda _: None, quality(1))
    end, taken = time.monotonic() + LONGEST, None
    while taken is None:
        assert time.monotonic() < end, "no footprint comes"
        with heard.handle:
            taken = heard.handle.take_message(PolygonStamped, False)
        time.sleep(0.02)
    print(json.dumps([taken[0].header.frame_id, [[point.x, point.y] for point in taken[0].polygon.points]]))


context, node = open_node("asker")
for word in sys.argv[1:]:
    if "," in word:
        ask_for_goal(node, [float(number) for number in word.split(",")])
    elif word == "footprint":
        hear_footprint(node)
    else:
        call(context, node, word)
close_node(context, node)
