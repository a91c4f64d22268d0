"""Actions: what their clients are told. Stand-ins take the place of rclpy's and nav2_msgs' classes here."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from asked import Drive
from cases import each

from elastic_strips.robot import RobotModel
from elastic_strips.ros2 import Ros2Params
from elastic_strips.ros2.actions import ActionGoals, serve
from elastic_strips.ros2.requests import Request, Requests


def fields(**values: object) -> type:
    """A class whose objects have these fields."""

    def make(self: object) -> None:
        for name, value in values.items():
            setattr(self, name, value() if callable(value) else value)

    return type("Message", (), {"__init__": make, "UNKNOWN": 9000})


def stamp() -> SimpleNamespace:
    return SimpleNamespace(sec=0, nanosec=0)


def pose_at(x: float, y: float = 0.0, frame: str = "map") -> SimpleNamespace:
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame, stamp=stamp()),
        pose=SimpleNamespace(
            position=SimpleNamespace(x=x, y=y, z=0.0), orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        ),
    )


class NavigateToPose:
    Result = fields(error_code=0, error_msg="")
    Feedback = fields(
        current_pose=lambda: pose_at(0.0, frame=""),
        navigation_time=stamp,
        estimated_time_remaining=stamp,
        number_of_recoveries=0,
        distance_remaining=0.0,
    )


class FollowPath:
    Result = fields()  # as in Humble
    Feedback = fields(distance_to_goal=0.0, speed=0.0)


class Handle:
    """A goal of an action, as a server has it: what it was told, in order."""

    def __init__(self, request: SimpleNamespace) -> None:
        self.request, self.goal_id = request, object()
        self.is_cancel_requested = False
        self.feedback, self.told, self.result = [], [], None

    def publish_feedback(self, feedback: object) -> None:
        self.feedback.append(feedback)

    def execute(self, callback) -> None:
        self.result = callback(self)

    def succeed(self) -> None:
        self.told.append("succeeded")

    def abort(self) -> None:
        self.told.append("aborted")

    def canceled(self) -> None:
        assert self.is_cancel_requested, "rclpy does not allow that"
        self.told.append("canceled")


class Served:
    """A robot that drives to the goals of actions."""

    def __init__(self, robot: RobotModel) -> None:
        self.drive, self.said = Drive(robot), []
        self.drive.run(0.5)
        self.goals = ActionGoals(self.drive.requests, "map", self.said.append)

    def to(self, x: float) -> Handle:
        handle = Handle(SimpleNamespace(pose=pose_at(x)))
        self.goals.accept("navigate_to_pose", NavigateToPose, handle, self.now)
        return handle

    def cancel(self, handle: Handle) -> None:
        self.goals.cancel(handle)
        handle.is_cancel_requested = True

    @property
    def now(self) -> int:
        return round(1e9 * self.drive.t)

    def run(self, seconds: float, until: Handle | None = None) -> None:
        end = self.drive.t + seconds
        while self.drive.t < end and not (until and until.told):
            self.drive.run(0.1)
            self.goals.tell(self.now)


@pytest.fixture
def served(jackal_box: RobotModel) -> Served:
    return Served(jackal_box)


def test_a_pose_is_reached_and_its_client_hears_how_far_it_is(served: Served):
    handle = served.to(1.5)
    served.run(20.0, handle)
    assert handle.told == ["succeeded"]
    assert (handle.result.error_code, bool(handle.result.error_msg)) == (0, True)
    assert served.drive.machine.coordinates[0] == pytest.approx(1.5, abs=0.1)
    assert served.drive.speeds[-1] < 0.02
    far = [feedback.distance_remaining for feedback in handle.feedback]
    assert far[0] == pytest.approx(1.5, abs=0.2)
    assert far[-1] < 0.3
    assert all(np.diff(far) < 0.05)
    last = handle.feedback[-1]
    assert last.navigation_time.sec + 1e-9 * last.navigation_time.nanosec == pytest.approx(
        served.drive.t - 0.5, abs=1.5
    )
    assert last.current_pose.header.frame_id == "map"
    assert last.current_pose.pose.position.x > 1.0
    remaining = [each.estimated_time_remaining for each in handle.feedback]
    assert 0.5 < remaining[0].sec + 1e-9 * remaining[0].nanosec < 5.0


def test_a_path_is_followed(served: Served):
    path = SimpleNamespace(header=SimpleNamespace(frame_id="map"), poses=[pose_at(x) for x in (0.0, 0.5, 1.2)])
    handle = Handle(SimpleNamespace(path=path))
    assert served.goals.readable("follow_path", handle.request)
    served.goals.accept("follow_path", FollowPath, handle, served.now)
    served.run(20.0, handle)
    assert handle.told == ["succeeded"]
    assert handle.feedback[0].distance_to_goal == pytest.approx(1.2, abs=0.2)
    assert max(feedback.speed for feedback in handle.feedback) > 0.2


def test_one_that_is_cancelled_ends_when_the_robot_stands(served: Served):
    handle = served.to(3.0)
    served.run(1.5)
    assert served.drive.speeds[-1] > 0.2
    served.cancel(handle)
    served.run(0.1)
    assert not handle.told
    served.run(10.0, handle)
    assert handle.told == ["canceled"]
    assert served.drive.speeds[-1] < 0.02
    assert served.drive.machine.coordinates[0] < 2.8


def test_a_newer_goal_aborts_the_older_one_and_nothing_stops(served: Served):
    first = served.to(3.0)
    served.run(2.0)
    begun = len(served.drive.speeds)
    second = served.to(4.0)
    served.run(1.0)
    assert first.told == ["aborted"]
    assert first.result.error_code == 9000
    assert "another goal" in first.result.error_msg
    assert not second.told
    assert min(served.drive.speeds[begun:]) > 0.2
    served.cancel(first)  # too late, and none of the second one's business
    served.run(20.0, second)
    assert (first.told, second.told) == (["aborted"], ["succeeded"])
    assert served.drive.machine.coordinates[0] == pytest.approx(4.0, abs=0.1)


def test_one_whose_client_did_not_ask_for_an_end_is_aborted(served: Served):
    handle = served.to(3.0)
    served.run(1.0)
    served.drive.requests.ask(Request("cancel", reason="by the service"))
    served.run(10.0, handle)
    assert handle.told == ["aborted"]
    assert handle.result.error_msg == "by the service"


def test_what_cannot_be_followed_is_aborted_and_what_cannot_be_read_is_rejected(served: Served):
    far = SimpleNamespace(header=SimpleNamespace(frame_id="map"), poses=[pose_at(x, 5.0) for x in (5.0, 6.0)])
    handle = Handle(SimpleNamespace(path=far))
    served.goals.accept("follow_path", FollowPath, handle, served.now)
    served.run(1.0, handle)
    assert handle.told == ["aborted"]
    assert not served.goals.readable("navigate_to_pose", SimpleNamespace(pose=pose_at(1.0, frame="base_link")))
    assert not served.goals.readable("navigate_to_pose", SimpleNamespace(pose=pose_at(float("nan"))))
    far.poses = far.poses[:1]
    assert not served.goals.readable("follow_path", SimpleNamespace(path=far))
    assert len(served.said) == 3


# the glue


class Server:
    """An action server of rclpy's, as far as it is called here."""

    made: ClassVar[list[Server]] = []

    def __init__(self, node, kind, name, *, execute_callback, goal_callback, handle_accepted_callback, cancel_callback):
        self.kind, self.name, self.ended = kind, name, False
        self.goal_callback, self.accepted, self.cancel_callback = (
            goal_callback,
            handle_accepted_callback,
            cancel_callback,
        )
        self.made.append(self)

    def destroy(self) -> None:
        self.ended = True


class Node:
    def __init__(self) -> None:
        self.tell, self.ended = None, False

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))

    def create_timer(self, period: float, call) -> SimpleNamespace:
        self.tell = call
        return SimpleNamespace(cancel=lambda: setattr(self, "ended", True))


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> list[Server]:
    rclpy, nav2 = ModuleType("rclpy.action"), ModuleType("nav2_msgs.action")
    answers = SimpleNamespace(ACCEPT="accept", REJECT="reject")
    vars(rclpy).update(ActionServer=Server, GoalResponse=answers, CancelResponse=answers)
    vars(nav2).update(NavigateToPose=NavigateToPose, FollowPath=FollowPath)
    monkeypatch.setitem(sys.modules, "rclpy.action", rclpy)
    monkeypatch.setitem(sys.modules, "nav2_msgs.action", nav2)
    monkeypatch.setattr(Server, "made", [])
    return Server.made


def test_both_actions_are_served_and_hand_their_goals_on(ros: list[Server]):
    node, requests = Node(), Requests(0.3)
    end = serve(node, Ros2Params(world_frame="map"), requests, print)
    by_name = {server.name: server for server in Server.made}
    assert {name: server.kind for name, server in by_name.items()} == {
        "navigate_to_pose": NavigateToPose,
        "follow_path": FollowPath,
    }
    poses, goal = by_name["navigate_to_pose"], SimpleNamespace(pose=pose_at(1.0))
    assert poses.goal_callback(goal) == "accept"
    assert poses.goal_callback(SimpleNamespace(pose=pose_at(1.0, frame="odom"))) == "reject"
    handle = Handle(goal)
    poses.accepted(handle)
    assert poses.cancel_callback(handle) == "accept"
    requests.close("the node ends")
    node.tell()
    assert handle.told == ["aborted"]
    assert handle.result.error_msg == "the node ends"
    end()
    assert node.ended
    assert all(server.ended for server in by_name.values())


@each("told", [{"actions": ("follow_path",)}, {"actions": None}, {"mode": "guard"}])
def test_only_those_that_are_asked_for(told: dict[str, object], ros: list[Server]):
    Server.made.clear()
    serve(Node(), Ros2Params(**told), Requests(0.3), print)  # pyright: ignore[reportArgumentType]
    assert [server.name for server in Server.made] == (["follow_path"] if told.get("actions") else [])


def test_without_nav2_there_are_none_which_is_said_once(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "nav2_msgs.action", None)
    said: list[str] = []
    serve(Node(), Ros2Params(), Requests(0.3), said.append)()
    assert len(said) == 1
    assert "nav2_msgs" in said[0]
