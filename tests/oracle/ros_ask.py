"""Asks the node of elastic_strips for a goal: x, y [m], yaw [rad], once it is ready for one."""

from __future__ import annotations

import sys
import time

from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String

from elastic_strips.ros2.driver import close_node, open_node, quality
from elastic_strips.ros2.messages import fill_pose

context, node = open_node("asker")
state = node.create_subscription(String, "elastic_strips/state", lambda _: None, quality(1, reliable=True, kept=True))
goal = node.create_publisher(PoseStamped, "goal_pose", quality(1, reliable=True))
end = time.monotonic() + 60.0
while time.monotonic() < end:
    with state.handle:
        heard = state.handle.take_message(String, False)
    if heard and goal.get_subscription_count():
        message = PoseStamped()
        fill_pose(message.pose, [float(word) for word in sys.argv[1:4]])
        goal.publish(message)
        goal.wait_for_all_acked()
        break
    time.sleep(0.02)
else:
    raise SystemExit("nobody is ready for a goal")
close_node(context, node)
