"""Running: the node from its start to its end, driving to goals or guarding what somebody else commands.

Three threads work here: one hears and answers ROS, one makes scenes of what the sensors say, and this one plans. What
they hand to each other is immutable, or under one lock. The executor, or the guard, has a process of its own.
"""

from __future__ import annotations

import logging
import math
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from types import FrameType

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.guard import GuardParams
from elastic_strips.control.interfaces import RunState
from elastic_strips.control.params import DriveParams
from elastic_strips.control.process import ExecutorProcess
from elastic_strips.control.process.guard_process import GuardProcess
from elastic_strips.errors import ConfigurationError
from elastic_strips.scene import Scene
from elastic_strips.strip import OrientationConstraint

from .driver import Ros2Driver
from .motion import check_rate
from .node import Ros2Node
from .params import Ros2Params, drive_params
from .requests import GoalState
from .shared_memory import clear_left

_log = logging.getLogger(__name__)
_HAND_PERIOD = 0.01  # [s] from one look for a newer scene to the next, where a guard waits for it
_SEE_PERIOD = 0.005  # [s] from one look at what has come to the next
_LEAD_TIME = 0.1  # [s] from now to time 0
_LONGEST_CATCHING_UP = 2.0  # [s] of perception, before goals are taken
_TELL_AFTER = 2.0  # [s] of waiting until it is said what is missing
_TELL_PERIOD = 0.05  # [s]
_DIAGNOSTICS_PERIOD = 1.0  # [s]
_RATE_SPAN = 1.0  # [s] in which the rate of odometry is measured
_PLAN_AHEAD = 30.0  # [s] of the way that is shown, and
_PLAN_STEP = 0.2  # [s] from pose to pose
_PROGRESS_EVERY = 2  # planning ticks from one look at how far it still is to the next
_SHOWN_EVERY = 4  # planning ticks from one shown plan to the next


def run_node(arguments: Sequence[str] = (), params: Ros2Params | None = None, *, goals: int | None = None) -> RunState:
    """Drive a robot over ROS 2, until Ctrl-C, SIGTERM or the end of the last goal; the robot is at rest at the end.

    Args:
        arguments: arguments of ROS: ``["--ros-args", "-p", "robot:=tiago", …]``.
        params: the parameters; those of ROS where None.
        goals: end after so many goals were reached or refused; None: never.

    Returns:
        The robot's state at the end.

    Raises:
        MissingExtraError: rclpy is not installed.
        ConfigurationError: the robot's topics do not come, or too seldom.
        ParameterError: a parameter is wrong.
    """
    with ExitStack() as stack, interrupted() as asked:
        clear_left()
        stack.callback(clear_left)  # of the executor, where that was killed
        node = Ros2Node(params, ["--ros-args", *arguments] if arguments and arguments[0] != "--ros-args" else arguments)
        node.spin(stack)
        start, rate = _wait(node)
        drive = drive_params(node.params, node.limits, 1.0 / rate)
        node.telling.log(
            f"odometry at {rate:.0f} Hz: silence {drive.monitor.silence:.2g} s, "
            f"tracking error {drive.tracking_error:g} m"
        )
        run = _guard if node.params.mode == "guard" else _drive
        return run(node, stack, start, rate, drive, goals, asked)


def _drive(
    node: Ros2Node,
    stack: ExitStack,
    start: Array,
    rate: float,
    drive: DriveParams,
    goals: int | None,
    asked: threading.Event,
) -> RunState:
    """Drive to goals, until somebody has asked for the end."""
    q = node.robot.space.from_coordinates(start)
    if node.params.level is not None:
        kept = OrientationConstraint.from_configuration(node.robot, q, node.params.level)
        drive = replace(drive, constraint=kept)
        node.telling.watch(kept)
    executor = ExecutorProcess(node.robot, q, q, params=drive, limits=node.slower, log=node.params.log)
    stack.enter_context(executor)
    controller = Controller(
        node.robot, q, q, None, params=drive, limits=node.slower, executor=executor, meter=time.monotonic
    )
    stack.callback(controller.close)
    controller.scene = _begin(node, stack, executor)
    controller.warm_up()  # by what there is to plan among
    _catch_up(node, executor)
    node.telling.log("ready for goals")
    _plan(node, controller, executor, rate, goals, asked)
    return controller.state


def _guard(
    node: Ros2Node,
    stack: ExitStack,
    start: Array,
    rate: float,
    drive: DriveParams,
    _: int | None,
    asked: threading.Event,
) -> RunState:
    """Guard what somebody else commands, until the process is lost or somebody has asked for the end."""
    params = node.params
    own = GuardParams(drive=drive, oldest=params.oldest_command)
    guard = GuardProcess(node.robot, node.robot.space.from_coordinates(start), own, limits=node.slower, log=params.log)
    stack.enter_context(guard)
    seen: Scene | None = None
    told = diagnosed = -math.inf
    _begin(node, stack, guard)
    node.telling.log(f"ready for commands on {params.cmd_vel_in} and {params.joint_velocities_in}")
    while not guard.lost or guard.run.state is not RunState.FAILED:
        _check(asked)
        t, scene = guard.now, node.sensing.scene
        if scene is not None and scene is not seen:
            seen = scene
            if not guard.see(scene):
                guard.log("fault", "a scene could not be handed to the guard: it is too large, or the guard is behind")
        node.correct(*guard.estimated)
        node.requests.command(guard, node.telling.log)
        if t > told + _TELL_PERIOD:
            told = t
            node.telling.tell_state(guard.run, guard.pilot)
            node.telling.show_footprint(guard)
            node.telling.show_markers(guard, seen)
            node.telling.warn(list(guard.run.events))
        if t > diagnosed + _DIAGNOSTICS_PERIOD:
            diagnosed = t
            node.telling.diagnose(guard.run, guard, rate)
        time.sleep(_HAND_PERIOD)
    node.telling.log(f"the guard is lost: {guard.lost}")
    return guard.run.state


def _begin(node: Ros2Node, stack: ExitStack, executor: ExecutorProcess) -> Scene:
    """Start the process that drives, and perception; the first scene."""
    executor.start(Ros2Driver(node.robot, node.limits, node.params, node.arguments))
    epoch = time.monotonic() + _LEAD_TIME
    node.begin(epoch)
    executor.begin(epoch)
    _see(node, stack)
    time.sleep(_LEAD_TIME)
    return _first_scene(node, executor)


def _wait(node: Ros2Node) -> tuple[Array, float]:
    """Wait for the robot's topics; where it stands (nv,), and at which rate they come [Hz]."""
    began = told = time.monotonic()
    since: float | None = None
    while True:
        row, now = node.standing_row(), time.monotonic()
        if row is not None:
            since = now if since is None else since
            if now > since + _RATE_SPAN:
                return row, check_rate(node.period)
        elif now > began + node.params.patience:
            raise ConfigurationError(f"after {node.params.patience:g} s this is missing: {node.missing}{node.wrong}")
        elif now > told + _TELL_AFTER:
            told = now
            node.telling.log(f"waiting for {node.missing}")
        time.sleep(0.02)


def _first_scene(node: Ros2Node, executor: ExecutorProcess) -> Scene:
    """The first scene, once there is one; the robot stands.

    Raises:
        ConfigurationError: none comes.
    """
    while (scene := node.sensing.scene) is None:
        if executor.now > node.params.patience:
            raise ConfigurationError(
                f"nothing is seen on {', '.join(node.params.seen)} after {node.params.patience:g} s{node.wrong}"
            )
        time.sleep(0.02)
    return scene


def _catch_up(node: Ros2Node, executor: ExecutorProcess) -> None:
    """Wait until perception, which warming up has held up, has a scene of now: an old one is a fault."""
    end = executor.now + _LONGEST_CATCHING_UP
    while executor.now < end and (scene := node.sensing.scene) is not None:
        if executor.now - scene.time <= 0.5 * node.params.oldest_scene:
            break
        time.sleep(0.01)
    node.sensing.excuse()


def _see(node: Ros2Node, stack: ExitStack) -> None:
    """Make scenes of what comes, in a thread, until the stack is left."""
    ending = threading.Event()

    def run() -> None:
        while not ending.wait(_SEE_PERIOD):
            try:
                node.sensing.work(node.row_at, node.known())
            except Exception:
                _log.exception("what was seen could not be taken in")

    thread = threading.Thread(target=run, name="perception", daemon=True)
    thread.start()
    stack.callback(lambda: (ending.set(), thread.join(2.0)))


def _plan(
    node: Ros2Node,
    controller: Controller,
    executor: ExecutorProcess,
    rate: float,
    goals: int | None,
    asked: threading.Event,
) -> None:
    """Plan, until the executor is lost, the last goal is over or somebody has asked for the end."""
    told, seen, ticks = -math.inf, None, 0
    while not executor.lost or controller.state is not RunState.FAILED:
        _check(asked)
        t = executor.now
        node.correct(*executor.estimated)
        node.requests.do(controller, node.telling.log)
        scene = node.sensing.scene
        newer = _newer(scene, seen, t)  # one that came since t is for the next tick
        seen = seen if newer is None else newer  # which may be empty
        controller.plan(t, newer)
        node.telling.tell_state(controller)
        node.telling.tell_wait(controller, t)
        node.telling.warn(list(controller.events))
        if ticks % _PROGRESS_EVERY == 0:
            node.requests.note_progress(controller)
        if ticks % _SHOWN_EVERY == 0 and node.requests.state is GoalState.DRIVING and node.robot.space.planar:
            node.telling.show(controller.ahead(_PLAN_AHEAD, _PLAN_STEP))
        node.telling.show_footprint(executor)
        node.telling.show_markers(executor, controller.scene, controller)
        if t > told + _DIAGNOSTICS_PERIOD:
            told = t
            node.telling.diagnose(controller, executor, rate)
        over = node.requests.state in (GoalState.REACHED, GoalState.REFUSED, GoalState.CANCELLED)
        if goals is not None and node.requests.number >= goals and over and controller.executor.at_rest(t):
            return
        ticks += 1
        time.sleep(max(0.0, t + controller.pause - executor.now))
    node.telling.log(f"the executor is lost: {executor.lost}")


def _newer(scene: Scene | None, seen: Scene | None, t: float) -> Scene | None:
    return scene if scene is not None and scene is not seen and scene.time <= t else None


def _check(asked: threading.Event) -> None:
    if asked.is_set():
        raise KeyboardInterrupt


@contextmanager
def interrupted() -> Iterator[threading.Event]:
    """SIGTERM and a closed terminal end as Ctrl-C does: with a stop.

    Yields:
        What is set from then on: Python drops an exception that comes while an object is finalized, Ctrl-C's as well.
    """
    asked = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        asked.set()
        if callable(theirs):  # as that of the command line, which waits for the end of an import
            theirs(number, frame)
        else:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    numbers, theirs = [signal.SIGTERM, signal.SIGHUP], signal.getsignal(signal.SIGINT)
    if callable(theirs):  # else it is ignored, as in the background
        numbers.append(signal.SIGINT)
    before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
