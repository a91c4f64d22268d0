"""Telling: what the node publishes besides commands: the way ahead, the robot's state, diagnostics, warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.interfaces import Event, RunState
from elastic_strips.control.process import ExecutorProcess
from elastic_strips.errors import without_numbers
from elastic_strips.robot import RobotModel, footprint_polygon
from elastic_strips.scene import Scene
from elastic_strips.strip.constraint import AxisConstraint, ConstraintForce

from .driver import load, quality
from .markers import Lines, boxes_near, fill_markers
from .messages import RosObject, fill_path, fill_polygon, fill_stamp, fill_status
from .params import Ros2Params
from .requests import GoalState, Requests
from .sensing import Sensing

_NEWEST_EVENTS = 50  # that are looked at, at most
_SILENT = 0.2  # [s] from which on it is said which topic of the robot's motion is silent
_WAIT = 2.0  # [s] for which a robot stands before its goal until it is said why
_FOOTPRINT_PERIOD = 0.2  # [s] from one footprint to the next
_MOTION_STEP = 0.1  # [s] from one posture on a motion to the next
_MARKERS_PERIOD = 0.2  # [s] from one set of markers to the next
_MARKERS_AHEAD = 3.0  # [s] of the motion that is shown
_SAME_WARNING = 5.0  # [s] from a warning until the same is said again


class Run(Protocol):
    """The robot's state, why, and the events so far: of a controller, or of an executor."""

    @property
    def state(self) -> RunState: ...
    @property
    def reason(self) -> str: ...
    @property
    def events(self) -> Sequence[Event]: ...


class Telling:
    """Workspace: the topics that tell of the robot.

    Args:
        node: the node of ROS.
        robot: the robot.
        params: its parameters.
        requests: of goals.
        sensing: what makes scenes.
        ages: how old the newest message of each topic is at a time, of those that say how the robot moves [s].
    """

    def __init__(
        self,
        node: RosObject,
        robot: RobotModel,
        params: Ros2Params,
        requests: Requests,
        sensing: Sensing,
        ages: Callable[[float], dict[str, float]],
    ) -> None:
        self._ages = ages
        self._node, self._robot, self._params, self._requests, self._sensing = node, robot, params, requests, sensing
        nav, std, diagnostic, geometry = (load(f"{name}_msgs.msg") for name in ("nav", "std", "diagnostic", "geometry"))
        kept = quality(1, reliable=True, kept=True)
        self._plan = node.create_publisher(nav.Path, "plan", kept)
        self._state = node.create_publisher(std.String, "~/state", kept)
        self._diagnostics = node.create_publisher(diagnostic.DiagnosticArray, "/diagnostics", quality(1, reliable=True))
        self._footprint = node.create_publisher(geometry.PolygonStamped, "footprint", quality(1, reliable=True))
        markers = load("visualization_msgs.msg")
        self._markers = node.create_publisher(markers.MarkerArray, "~/markers", quality(1, reliable=True))
        self._lines = Lines(robot, params.hand)
        self._footprint_due = self._markers_due = -math.inf
        self._level: ConstraintForce | None = None
        self._told_state = ""
        self._stands_since = math.inf  # [s]
        self._warned: dict[str, float] = {}  # what was said, without numbers, and when it happened [s]
        self._warned_until = -math.inf

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def watch(self, level: AxisConstraint) -> None:
        """Tell from now on how level what is to stay level is."""
        self._level = ConstraintForce(self._robot, level)

    def log(self, text: str) -> None:
        """Say something in ROS' log."""
        self._node.get_logger().info(text)

    def warn(self, events: Sequence[Event]) -> None:
        """Say what went wrong since the last call; of what goes wrong all the time, once in a while."""
        news = [
            event for event in events[-_NEWEST_EVENTS:] if event.time > self._warned_until and event.kind == "fault"
        ]
        for event in news:
            self._warn_again(event.reason, event.time)
        if news:
            self._warned_until = news[-1].time
        for what in [what for what in list(self._sensing.counts) if what not in self._warned]:
            self._warned[what] = math.inf  # it is counted from now on
            self._node.get_logger().warning(f"left out: {what}")

    def _warn_again(self, text: str, t: float) -> None:
        """Say what is wrong, unless the same, but for its numbers, was said a while ago."""
        same = without_numbers(text)
        if t > self._warned.get(same, -math.inf) + _SAME_WARNING:
            self._warned[same] = t
            self._node.get_logger().warning(text)

    def show(self, rows: Array) -> None:
        """Publish the way ahead: coordinate rows (K, nv) of a robot whose base moves."""
        message, pose = load("nav_msgs.msg").Path(), load("geometry_msgs.msg").PoseStamped
        fill_path(message, pose, rows[:, :3], self._params.frame, self._now())
        self._plan.publish(message)

    def show_footprint(self, executor: ExecutorProcess) -> None:
        """Publish what the robot takes up, seen from above, now and for a while on its motion; where somebody hears."""
        if executor.now < self._footprint_due or not self._footprint.get_subscription_count():
            return
        self._footprint_due = executor.now + _FOOTPRINT_PERIOD
        rows = np.array([executor.estimate, *_motion(executor, self._params.footprint_ahead)])
        message, point = self._footprint.msg_type(), load("geometry_msgs.msg").Point32
        fill_stamp(message.header.stamp, self._now())
        message.header.frame_id = self._params.base_frame or "base_link"
        fill_polygon(message.polygon, point, footprint_polygon(self._robot, rows))
        self._footprint.publish(message)

    def show_markers(
        self, executor: ExecutorProcess, scene: Scene | None, controller: Controller | None = None
    ) -> None:
        """Publish the strip, the motion that the robot is on, and what is near it; where somebody hears."""
        if executor.now < self._markers_due or not self._markers.get_subscription_count():
            return
        self._markers_due = executor.now + _MARKERS_PERIOD
        lines, in_the_way = self._lines.motion(np.array(_motion(executor, _MARKERS_AHEAD))), ""
        if controller is not None:
            result = controller.tick.result if controller.tick is not None else None
            certificate = None if result is None else result.report.certificate
            certified = certificate is not None and certificate.certified
            lines = [*self._lines.strip(controller.strip.coordinates, certified=certified), *lines]
            in_the_way = certificate.broken.obstacle if certificate is not None and certificate.broken else ""
        place = executor.estimate[:2] if self._robot.space.planar else np.zeros(2)
        boxes = boxes_near(scene, place) if scene is not None else []
        message = self._markers.msg_type()
        make = load("visualization_msgs.msg").Marker, load("geometry_msgs.msg").Point
        fill_markers(message, make, lines, boxes, in_the_way, self._params.frame, self._now())
        self._markers.publish(message)

    def tell_wait(self, run: Run, t: float) -> None:
        """Say why a robot that has a goal stands, once it has for a while."""
        waits = self._requests.state is GoalState.DRIVING and run.state is RunState.STOPPED
        self._stands_since = min(self._stands_since, t) if waits else math.inf
        if t > self._stands_since + _WAIT:
            self._warn_again(f"it stands: {run.reason}{self._silent(t)}", t)

    def _silent(self, t: float) -> str:
        """Which topics of the robot's motion are silent, to be added to a sentence."""
        late = [f"{topic!r} for {age:.2g} s" for topic, age in self._ages(t).items() if age > _SILENT]
        return f": nothing usable has arrived from {' and '.join(late)}" if late else ""

    def tell_state(self, run: Run, pilot: str = "") -> None:
        """Publish the robot's state where it has changed, and what became of a pilot's command."""
        goal = self._requests
        what = pilot or f"goal {goal.number}: {goal.state.value}"
        text = f"{run.state.label}: {run.reason}; {what}"
        if text != self._told_state:
            self._told_state = text
            message = load("std_msgs.msg").String()
            message.data = text
            self._state.publish(message)

    def diagnose(self, run: Run, executor: ExecutorProcess, rate: float) -> None:
        """Publish how it goes; ``rate`` [Hz] is odometry's."""
        diagnostic = load("diagnostic_msgs.msg")
        array, status = diagnostic.DiagnosticArray(), diagnostic.DiagnosticStatus()
        now = executor.now
        guards = self._params.mode == "guard"
        fine = run.state in (RunState.MOVING, RunState.REACHED) or (guards and not executor.waits)
        faults = [event.reason for event in list(run.events)[-20:] if event.kind == "fault"]
        goal = self._requests
        tilt, tilted = (0.0, "") if self._level is None else tilt_of(self._level, executor.estimate)
        values: dict[str, object] = {
            "state": run.state.label,
            **({"pilot": executor.pilot} if guards else {"goal": f"{goal.number}: {goal.state.value}: {goal.reason}"}),
            "odometry_hz": f"{rate:.1f}",
            "executor": executor.priority,
            **({} if self._level is None else {"tilt_rad": f"{tilt:.3f}"}),
            "last_fault": faults[-1] if faults else "",
            **{f"age_of_{topic}_s": f"{age:.2f}" for topic, age in self._ages(now).items()},
            **{f"age_of_{topic}_s": f"{self._sensing.age(topic, now):.2f}" for topic in self._params.seen},
            **{f"dropped: {what}": count for what, count in self._sensing.counts.most_common(8)},
        }
        trouble = executor.lost or ("" if fine else f"{run.reason}{self._silent(now)}") or tilted
        if tilted:
            self._warn_again(tilted, now)
        said = executor.pilot if guards else run.reason
        fill_status(status, diagnostic.KeyValue, str(self._node.get_name()), trouble, said, values)
        array.header.stamp = self._node.get_clock().now().to_msg()
        array.status.append(status)
        self._diagnostics.publish(array)


def tilt_of(level: ConstraintForce, row: Array) -> tuple[float, str]:
    """By how much a frame that is to stay level is tilted [rad] at a coordinate row (nv,), and what to say of it; empty
    within its tolerance."""
    tilt, most = float(level.errors_at(row[None])[0]), level.constraint.tolerance
    said = f"{level.constraint.frame!r} is tilted by {tilt:.2f} rad; at most {most:g} are wanted"
    return tilt, said if tilt > most else ""


def _motion(executor: ExecutorProcess, seconds: float) -> list[Array]:
    """Coordinate rows (nv,) of the motion that the robot is on, from now on; none where there are to be 0 seconds."""
    t, active = executor.now, executor.active
    times = np.arange(t, min(t + seconds, active.end_time) + _MOTION_STEP, _MOTION_STEP) if seconds else []
    return [active.at(min(time, t + seconds)).coordinates for time in times]
