"""Actions: `navigate_to_pose` and `follow_path` of Nav2's, served where nav2_msgs can be imported.

What has become of a goal is known by its requests; here its client is told. All of it is done in the thread that hears
ROS, and nothing waits: a goal is "accepted" until it ends, and is executed then, with what has become of it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

from .driver import load
from .messages import MessageError, RosObject, check_frame, fill_pose, fill_stamp, path_of, planar_pose
from .params import Ros2Params
from .requests import GoalState, Progress, Request, Requests

_TELL_PERIOD = 0.1  # [s] from one look at what has become of goals to the next


class _Action(NamedTuple):
    """An action: its name in `nav2_msgs.action`, and what a goal of it asks for, in a frame."""

    kind: str
    request: Callable[[Any, str], Request]


def _pose_request(goal: RosObject, frame: str) -> Request:
    check_frame(goal.pose, frame)
    return Request("goal", planar_pose(goal.pose.pose))


_ACTIONS = {
    "navigate_to_pose": _Action("NavigateToPose", _pose_request),
    "follow_path": _Action("FollowPath", lambda goal, frame: Request("path", path_of(goal.path, frame))),
}
"""They are named as `params.ACTIONS`."""


class _Goal(NamedTuple):
    """A goal that somebody waits for.

    Attributes:
        handle: a ``ServerGoalHandle``, or what has the same methods.
        kind: the type of the action.
        number: of the goal among the requests.
        since: when it was accepted [ns].
    """

    handle: RosObject
    kind: RosObject
    number: int
    since: int


class ActionGoals:
    """Workspace: the goals of actions' clients, who are told how far it still is, and how it ended.

    A goal that another one has taken the place of, or that the ``cancel`` of the node's services has ended, is aborted:
    its client has not asked for that. One that its client cancels is canceled once the robot stands, or drives on to
    another goal.

    Args:
        requests: to which goals are handed.
        frame: frame of goals; empty: any.
        log: says what is refused.
    """

    def __init__(self, requests: Requests, frame: str, log: Callable[[str], object]) -> None:
        self._requests, self._frame, self._log = requests, frame, log
        self._goals: list[_Goal] = []

    def readable(self, name: str, goal: RosObject) -> bool:
        """Whether a goal of an action can be read."""
        try:
            _ACTIONS[name].request(goal, self._frame)
        except MessageError as error:
            self._log(f"{name} refused: {error}")
            return False
        return True

    def accept(self, name: str, kind: RosObject, handle: RosObject, now: int) -> None:
        """Ask for what a goal of an action says, which came at a time [ns]."""
        number = self._requests.ask(_ACTIONS[name].request(handle.request, self._frame))
        self._goals.append(_Goal(handle, kind, number, now))

    def cancel(self, handle: RosObject) -> None:
        """Ask that the goal of a handle is given up; the goal after it is not."""
        for goal in self._goals:
            if goal.handle.goal_id == handle.goal_id:
                self._requests.ask(Request("cancel", reason="its client cancelled the goal", number=goal.number))

    def tell(self, now: int) -> None:
        """Tell the clients how far it still is at a time [ns], or how it ended."""
        for goal in list(self._goals):
            over, progress = self._requests.outcome(goal.number), self._requests.progress
            if over is not None:
                self._goals.remove(goal)
                goal.handle.execute(lambda handle, kind=goal.kind, over=over: _ended(handle, kind, over))
            elif progress is not None and progress.number == goal.number:
                goal.handle.publish_feedback(_feedback(goal.kind, progress, self._frame, now, goal.since))


def _ended(handle: RosObject, kind: RosObject, over: tuple[GoalState, str]) -> RosObject:
    """Say how a goal ended; its result. Those of ROS 2 Humble have no fields."""
    state, reason = over
    result = kind.Result()
    if state is GoalState.REACHED:
        handle.succeed()
    elif state is GoalState.CANCELLED and handle.is_cancel_requested:
        handle.canceled()
    else:
        handle.abort()
        if hasattr(result, "error_code"):
            result.error_code = kind.Result.UNKNOWN
    if hasattr(result, "error_msg"):
        result.error_msg = reason
    return result


def _feedback(kind: RosObject, progress: Progress, frame: str, now: int, since: int) -> RosObject:
    """The feedback of either action: those of its fields that there are."""
    told = kind.Feedback()
    if hasattr(told, "current_pose"):
        told.current_pose.header.frame_id = frame
        fill_stamp(told.current_pose.header.stamp, now)
        fill_pose(told.current_pose.pose, progress.place)
        fill_stamp(told.navigation_time, now - since)
        fill_stamp(told.estimated_time_remaining, round(1e9 * progress.seconds))
        told.distance_remaining = progress.distance
    else:
        told.distance_to_goal, told.speed = progress.distance, progress.speed
    return told


def serve(
    node: RosObject, params: Ros2Params, requests: Requests, log: Callable[[str], object]
) -> Callable[[], object]:
    """Serve the actions of the parameters, where nav2_msgs can be imported; else say once that there are none.

    Returns:
        What ends that; it is to be called before the node is destroyed.
    """
    names = params.actions or ()
    if params.mode != "drive" or not names:
        return lambda: None
    try:
        kinds = importlib.import_module("nav2_msgs.action")
    except ImportError as error:
        log(f"there are no actions ({', '.join(names)}): nav2_msgs is not there ({error})")
        return lambda: None
    action, frame = load("rclpy.action"), params.world_frame or params.odom_frame or ""
    goals = ActionGoals(requests, frame, log)

    def now() -> int:
        return int(node.get_clock().now().nanoseconds)

    def server(name: str) -> RosObject:
        kind = getattr(kinds, _ACTIONS[name].kind)

        def asked(goal: Any) -> Any:
            return action.GoalResponse.ACCEPT if goals.readable(name, goal) else action.GoalResponse.REJECT

        def cancelled(handle: Any) -> Any:
            goals.cancel(handle)
            return action.CancelResponse.ACCEPT

        return action.ActionServer(
            node,
            kind,
            name,
            execute_callback=lambda handle: kind.Result(),  # each goal brings its own
            goal_callback=asked,
            handle_accepted_callback=lambda handle: goals.accept(name, kind, handle, now()),
            cancel_callback=cancelled,
        )

    servers = [server(name) for name in names]
    timer = node.create_timer(_TELL_PERIOD, lambda: goals.tell(now()))

    def end() -> None:
        timer.cancel()
        for each in servers:
            each.destroy()

    return end
