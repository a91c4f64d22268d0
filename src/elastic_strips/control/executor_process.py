"""Executor process: the control loop alone, in a process of its own, and what planning sees of it.

The process needs nothing of planning but the next certified motion. Planning may be late, hang or die: then the robot
comes to rest on the motion that it has.

What is promised of the messages: they come in order, and none twice, but any may be missing (see
:mod:`~elastic_strips.control.channel`). So a motion is checked where it is executed, by itself and against the one that
it continues, whatever planning believed; a status is whole, and the next one makes up for one that is missing: events
and stops are told until they are taken, the samples of the active trajectory again and again. Until these come,
planning may continue a trajectory that is active no longer; what it makes of it is refused. Who planned and died does
not come back: the process ends as soon as the robot stands, and another one starts from there.
"""

from __future__ import annotations

import gc
import logging
import math
import multiprocessing
import os
import pickle
import select
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import count, islice, takewhile
from multiprocessing.context import SpawnProcess
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.trajectory import stationary
from elastic_strips.validation import check_array, check_number, check_type

from .channel import ChannelClosedError, channel, put, take
from .child_process import end_process, orphaned, start_quietly
from .driver import Driver
from .executor import Executor
from .interfaces import Command, Event, Measurement, RunState
from .log_stream import LogStream
from .params import DriveParams, Tolerance
from .process_priority import raise_priority
from .supervisor import RunLog

_log = logging.getLogger(__name__)
_BUFFER = 1 << 20  # [bytes] of a channel
_START = 120.0  # [s] longest start of the process
_END = 15.0  # [s] longest time in which the robot comes to rest at the end
_BEAT = 0.02  # [s] from one heartbeat of planning to the next
_SETTLING = 0.03  # [s] a motion that was sent so short a time ago is taken for accepted
_TOLD = 20  # periods in which a motion of the executor's own is told
_SENT = 10  # motions that were sent last, which the active one may be
_QUIET = 0.0015  # [s] before a period begins nothing else is begun
_AT_ONCE = 50  # messages that are taken in one period: no flood of them holds up the command
_CREEPS = 2.0  # [s] after the end of its motion a robot that does not stand is left to its driver
_Thing = TypeVar("_Thing")
_Samples = tuple[Array, Array, Array, Array]  # time, coordinates, v, a


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """What the executor tells after a control period; see :class:`~elastic_strips.control.executor.ExecutorLink`.

    Attributes:
        time: [s] on the executor's clock.
        serial: number of the active trajectory: as it was submitted with, or negative where it is the executor's own.
        samples: its samples, where planning may not know them, and now and then.
        coordinates, v: (nv,) of the reference.
        events, stops: new ones since the last status that could be sent.
    """

    time: float
    state: RunState
    reason: str
    serial: int
    samples: _Samples | None
    at_goal: bool
    estimate: Array
    settled: bool
    lost_for: float
    waits: str
    coarse: float
    needed_error: float
    recoveries: int
    coordinates: Array
    v: Array
    events: tuple[Event, ...]
    stops: tuple[tuple[float, str], ...]


class ExecutorProcess:
    """Workspace: an executor in a process of its own; the :class:`~elastic_strips.control.executor.ExecutorLink` to it.

    Used once, in a ``with`` statement; at its end the robot comes to rest, and the process ends. It ends, too, where
    the process that started it is gone, or tells it to by SIGTERM, as soon as the robot stands.

    Args:
        robot: the robot.
        start: configuration (nq,) of the robot at rest.
        goal: configuration (nq,).
        params: of the drive.
        limits: of the motors; read off the robot where None.
        log: file of the log, which is written while the robot drives; none where None.

    Attributes:
        run: state, reason, events and stops of the robot.
        priority: what the process could do to get the processor in time.

    Raises:
        ConfigurationError: start or goal is not valid.
    """

    def __init__(
        self,
        robot: RobotModel,
        start: npt.ArrayLike,
        goal: npt.ArrayLike,
        *,
        params: DriveParams | None = None,
        limits: MotionLimits | None = None,
        log: str | os.PathLike[str] | None = None,
    ) -> None:
        space = robot.space
        self.robot: RobotModel = robot
        self.params: DriveParams = params or DriveParams()
        self.limits: MotionLimits = limits or MotionLimits.for_robot(robot)
        self.epoch: float = time.monotonic()
        self.run: RunLog = RunLog()
        self.priority: str = ""
        row = space.to_coordinates(robot.check_q(start, what="start"))
        self._goal = space.to_coordinates(robot.check_q(goal, what="goal"))
        self._task = (robot, self.limits, self.params, row, self._goal, self.params.tolerance)
        self._log = None if log is None else os.fspath(log)
        self._serial = count(1)
        resting = stationary(robot, self.limits, row, 0.0, self.params.control_dt)
        self._sent: tuple[float, int, Trajectory, bool] = (-np.inf, 0, resting, False)  # when, number, what, at goal
        self._status = Status(
            0.0, RunState.STOPPED, "not started", 0, None, False, row, True, 0.0, "", 0.0, self.params.tracking_error,
            0, row, np.zeros(robot.nv), (), (),
        )  # fmt: skip
        self._motions: deque[tuple[int, Trajectory]] = deque(maxlen=_SENT)  # that were sent last, by number
        self._active: tuple[int, Trajectory] = (0, resting)
        self._lock = threading.Lock()
        self._closing = False
        self._early: list[tuple[object, ...]] | None = []  # what is said before the process begins
        self._restarted = -math.inf  # [s]
        self._ending = threading.Event()
        self._gone = ""
        self._process: SpawnProcess | None = None
        self._thread: threading.Thread | None = None

    def start(self, driver: Driver) -> None:
        """Start the process, and wait until it is ready for :meth:`begin`.

        Args:
            driver: of the robot's motors; it is sent to the process.

        Raises:
            ConfigurationError: it does not start, or was started before; the message says why.
        """
        if self._process is not None:
            raise ConfigurationError("an executor's process is started once; make another one")
        self._link, child = channel(_BUFFER)
        process = multiprocessing.get_context("spawn").Process(
            target=_serve, args=(child, self._task, driver, self._log), name="executor", daemon=True
        )
        first: object = "it ended at once"
        try:
            start_quietly(process)
            child.close()
            self._link.settimeout(_START)
            data = self._link.recv(_BUFFER)
            self._link.setblocking(False)
            first = pickle.loads(data) if data else first
        except Exception as error:  # the driver cannot be sent to a process, or takes too long there
            first = f"{type(error).__name__}: {error}"
        finally:
            child.close()
            if not isinstance(first, tuple):
                self._link.close()
                end_process(process, 0.0 if process.is_alive() else _END)
        if not isinstance(first, tuple):
            raise ConfigurationError(f"the executor's process does not start: {first}")
        self._process = process
        _, self.priority = first

    def begin(self, epoch: float) -> None:
        """Let the control loop run; its time is 0 at this ``time.monotonic()``."""
        self.epoch = epoch
        early, self._early = self._early or [], None
        for message in (("begin", epoch), *early):
            self._put(*message)
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
        self._thread.start()

    def __enter__(self) -> ExecutorProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """Bring the robot to rest, and end the process."""
        if self._process is None:
            return
        self._closing = True
        put(self._link, ("close",))
        if not end_process(self._process, _END):
            _log.warning("the executor's process did not end; it is killed")
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
            self._listen()  # to what happened at the end
        self._link.close()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return 0 if self._process is None else self._process.pid or 0

    @property
    def now(self) -> float:
        """Time [s] on the executor's clock."""
        return time.monotonic() - self.epoch

    @property
    def lost(self) -> str:
        """Why nothing is heard of the executor; empty where all is well."""
        silent = self.now - self._status.time
        if self._gone or silent <= self.params.monitor.heartbeat:
            return self._gone
        return f"nothing is heard of the executor for {silent:.2f} s"

    # what planning sees

    @property
    def active(self) -> Trajectory:
        with self._lock:
            sent, serial, motion, _ = self._sent
            mine = serial == self._status.serial or self._status.time < sent + _SETTLING
            return motion if mine else self._active[1]

    @property
    def at_goal(self) -> bool:
        with self._lock:
            sent, _, _, at_goal = self._sent
            return at_goal if self._status.time < sent + _SETTLING else self._status.at_goal

    @property
    def estimate(self) -> Array:
        return self._status.estimate

    @property
    def settled(self) -> bool:
        return self._status.settled

    @property
    def lost_for(self) -> float:
        return self._status.lost_for

    @property
    def waits(self) -> str:
        return self.lost or self._status.waits

    @property
    def coarse(self) -> float:
        return self._status.coarse

    @property
    def needed_error(self) -> float:
        return self._status.needed_error

    @property
    def recoveries(self) -> int:
        return self._status.recoveries

    def reference(self, t: float) -> ReferenceState:
        """State of the reference that was told last."""
        status = self._status
        return ReferenceState(status.time, status.coordinates, status.v, np.zeros_like(status.v))

    def at_rest(self, t: float) -> bool:
        return t >= self.active.end_time

    def submit(self, motion: Trajectory, certificate: Certificate, *, at_goal: bool, proven: float) -> None:
        serial = next(self._serial)
        samples = (motion.time, motion.coordinates, motion.v, motion.a)
        if self._put("submit", serial, samples, certificate, at_goal, proven):
            self._note(serial, motion, at_goal)

    def anchor(self, resting: Trajectory) -> None:
        serial = next(self._serial)
        if self._put("anchor", serial, (resting.time, resting.coordinates, resting.v, resting.a)):
            self._note(serial, resting, at_goal=False)

    def brake(self, reason: str) -> None:
        self._put("brake", reason)

    def hold(self, reason: str, proven: float) -> None:
        self._put("hold", reason, proven)

    def reject(self, reason: str) -> None:
        self._put("reject", reason)

    def log(self, kind: str, reason: str) -> None:
        self._put("log", kind, reason)

    def retarget(self, goal: Array, tolerance: Tolerance) -> None:
        with self._lock:
            self._sent = (self.now, *self._sent[1:3], False)
            self._restarted = self.now
            self.run.state, self.run.reason = RunState.STOPPED, "new goal"
        self._put("retarget", goal, tolerance)

    def stop(self, reason: str) -> None:
        self._put("stop", reason)

    def resume(self) -> None:
        self._put("resume")

    def _note(self, serial: int, motion: Trajectory, at_goal: bool) -> None:
        """Take a motion that was sent for accepted, until there is word of it."""
        with self._lock:
            self._sent = (self.now, serial, motion, at_goal)
            self._motions.append((serial, motion))

    def _put(self, *message: object) -> bool:
        if self._early is not None:  # Ctrl-C, say
            self._early.append(message)
            return True
        sent = put(self._link, message)
        if not sent:
            _log.warning("the executor did not get: %s", message[0])
        return sent

    def _beat(self) -> None:
        """The thread: heartbeats there, what is told back; so that both go on while planning computes."""
        while not self._ending.wait(_BEAT):
            put(self._link, ("beat",))
            self._listen()

    def _listen(self) -> None:
        try:
            for message in take(self._link):
                if isinstance(message, Status):
                    self._take(message)
        except ChannelClosedError:
            if not self._gone and not self._closing:
                self._gone = "the executor's process is gone"
                self.run.state, self.run.reason = RunState.FAILED, self._gone
                self.run.events.append(Event(self.now, "fault", self._gone))
                _log.error(self._gone)

    def _take(self, status: Status) -> None:
        with self._lock:
            known = next((motion for serial, motion in self._motions if serial == status.serial), None)
            if status.serial == self._active[0]:
                pass
            elif known is not None:
                self._active = status.serial, known
            elif status.samples is not None:
                self._active = status.serial, Trajectory(self.robot, self.limits, *status.samples)
            self._status = status
            self.run.events.extend(status.events)
            self.run.stops.extend(status.stops)
            self.run.state, self.run.reason = status.state, status.reason  # last: who waits for it finds its reason


_Task = tuple[RobotModel, MotionLimits, DriveParams, Array, Array, Tolerance]


def _serve(link: socket.socket, task: _Task, driver: Driver, log: str | None) -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for planning, which lets the robot come to rest
    priority = raise_priority()  # before the log's thread begins, which has to have the same
    stream: LogStream | None = None
    try:
        stream = None if log is None else LogStream(log)
        loop = _Loop(link, Executor(*task, keep=500), driver, stream)
    except Exception as error:
        put(link, f"{type(error).__name__}: {error}")
        driver.close()
        return
    signal.signal(signal.SIGTERM, loop.end)
    _log.info("the executor runs (%s)", priority)
    put(link, ("ready", priority))
    try:
        if loop.wait():
            loop.run()
    finally:  # also where the loop itself is broken
        try:
            driver.close()
        finally:
            if stream is not None:
                stream.close()


class _Loop:
    """Workspace: the control loop in its process, on the wall clock."""

    def __init__(self, link: socket.socket, executor: Executor, driver: Driver, log: LogStream | None) -> None:
        self.link, self.executor, self.driver, self.log = link, executor, driver, log
        self.epoch, self.dt = 0.0, executor.params.control_dt
        self.heard: float | None = None  # [s] when the last word of planning came
        self.silent = self.gone = self.closing = False
        self.serial = 0
        self.own = 0  # trajectories of the executor's own so far
        self.known: Trajectory = executor.active  # the active one, as it was told
        self.told = 0  # periods since it changed by itself
        self.event: Event | None = None  # the last one that was told,
        self.stopped = -math.inf  # and when the last stop was [s]
        self.logged: Event | None = None
        self.log_error = ""

    def end(self, *_: object) -> None:
        """Come to rest, and end: SIGTERM, which also a program sends that ends without closing."""
        self.closing = True
        self.executor.stop("asked to stop")

    def wait(self) -> bool:
        """Wait until planning says when time is 0; False where it is gone."""
        while not (self.closing or orphaned()):
            select.select([self.link], [], [], 0.5)
            try:
                for message in take(self.link):
                    if isinstance(message, tuple) and message[0] == "begin":
                        self.epoch = message[1]
                        return True
                    if isinstance(message, tuple) and message[0] == "close":
                        return False
            except ChannelClosedError:
                return False
        return False

    def run(self) -> None:
        """Step after step, until the robot has come to rest at the end, or planning is gone and it stands."""
        k = max(int((time.monotonic() - self.epoch) / self.dt), 0)
        while not self.over():
            self.idle(self.epoch + k * self.dt)
            late = int((time.monotonic() - self.epoch) / self.dt) - k
            k += max(late, 0)  # periods that were missed are left out
            self.step(k * self.dt)
            k += 1

    def idle(self, until: float) -> None:
        """Let time pass to ``time.monotonic()`` ``until``; what planning says meanwhile is done meanwhile, and takes
        effect in the next period."""
        if not self.gone:
            self.listen()
        while (ahead := until - time.monotonic()) > 0.0:
            if self.gone or ahead < _QUIET:
                time.sleep(ahead)
            elif select.select([self.link], [], [], ahead - _QUIET)[0]:
                self.listen()

    def over(self) -> bool:
        executor = self.executor
        if not ((self.closing or self.gone) and executor.at_rest(executor.time)):
            return False
        return executor.settled or executor.time > executor.active.end_time + _CREEPS

    def step(self, t: float) -> None:
        """One control period: whatever fails in it, a command goes out."""
        executor, began = self.executor, time.monotonic()
        measurement: Measurement | None = None
        try:
            measurement = self.driver.measure(t)
        except Exception as error:
            executor.log("fault", f"driver exception: {type(error).__name__}: {error}")
        try:
            executor.measure(t, measurement)
        except Exception as error:
            _log.exception("a measurement could not be taken in")
            executor.fail(f"measuring failed: {type(error).__name__}: {error}")
        self.check_planner(t)
        try:
            command = executor.command(t)
        except Exception as error:
            _log.exception("no command could be made")
            executor.log("fault", f"no command: {type(error).__name__}: {error}")
            command = replace(executor.tracker.rest, stop=True)
        try:
            self.driver.send(t, command)
        except Exception as error:
            executor.log("fault", f"driver exception: {type(error).__name__}: {error}")
        try:
            self.tell(t, command, began, time.monotonic() - self.epoch)
        except Exception:
            _log.exception("telling failed")
        if executor.at_rest(t) and int(t / self.dt) % 100 == 0:
            gc.collect(0)

    def listen(self) -> None:
        """Do what planning says."""
        executor = self.executor
        try:
            for message in islice(take(self.link), _AT_ONCE):
                self.heard = executor.time
                try:
                    self.obey(message)
                except Exception as error:
                    executor.log("fault", f"a message of the planner: {type(error).__name__}: {error}")
        except ChannelClosedError:
            self.lose()
        except Exception as error:  # what cannot be unpickled
            executor.log("fault", f"a message of the planner: {type(error).__name__}: {error}")

    def check_planner(self, t: float) -> None:
        """Come to rest where planning is gone, or says nothing for too long."""
        executor, heard = self.executor, self.heard
        if int(t / self.dt) % 10 == 0 and orphaned():  # somebody else holds the channel open
            self.lose()
        elif heard is not None and t - heard > executor.params.monitor.heartbeat:
            if not (self.silent or self.gone):
                self.silent = True
                executor.fail(f"nothing is heard of the planner for {t - heard:.2f} s")
        elif self.silent:
            self.silent = False
            executor.log("planner", "it is heard again")

    def lose(self) -> None:
        """Planning is gone for good."""
        if not self.gone:
            self.gone = True
            self.executor.fail("the planner's process is gone")
            self.executor.stop("the planner's process is gone")

    def obey(self, message: object) -> None:
        """Do what a message says, where it can be done.

        Raises:
            Exception: it is no message, or carries what is none of its kind; nothing was changed.
        """
        if not isinstance(message, tuple) or not message:
            raise ConfigurationError(f"{message!r} is no message")
        what, *values = message
        executor = self.executor
        if what in ("submit", "anchor"):
            serial, samples, *rest = values
            motion = Trajectory(executor.robot, executor.limits, *samples)
            if what == "anchor":
                executor.anchor(motion)
            else:
                certificate, at_goal, proven = rest
                check_type("certificate", certificate, Certificate)
                proven = check_number("proven", proven, low=0.0, unit="m")
                executor.submit(motion, certificate, at_goal=bool(at_goal), proven=proven)
            if executor.active is motion:
                self.known, self.serial, self.told = motion, int(serial), _TOLD
        elif what == "hold":
            reason, proven = values
            executor.hold(str(reason), check_number("proven", proven, low=0.0, unit="m"))
        elif what == "retarget":
            goal, tolerance = values
            check_type("tolerance", tolerance, Tolerance)
            executor.retarget(check_array("goal", goal, (executor.robot.nv,)), tolerance)
        elif what == "close":
            self.end()
        elif what in ("brake", "reject", "log", "stop", "resume"):
            getattr(executor, what)(*map(str, values))
        elif what != "beat":
            raise ConfigurationError(f"{what!r} is no message")

    def tell(self, t: float, command: Command, began: float, sent: float) -> None:
        """Tell planning and the log what has happened in this period."""
        executor, run = self.executor, self.executor.run
        if executor.active is not self.known:  # the executor's own: braked, or set to where the robot is
            self.own -= 1
            self.known, self.serial, self.told = executor.active, self.own, 0
        self.told += 1
        samples = None
        if self.told <= _TOLD or self.told % _TOLD == 0:
            active = executor.active
            samples = (active.time, active.coordinates, active.v, active.a)
        reference = executor.reference(t)
        events = _after(lambda event: event is self.event, run.events)
        stops = _after(lambda stop: stop[0] <= self.stopped, run.stops)
        status = Status(
            t, run.state, run.reason, self.serial, samples, executor.at_goal, executor.estimate, executor.settled,
            executor.lost_for, executor.waits, executor.coarse, executor.needed_error, executor.recoveries,
            reference.coordinates, reference.v, events, stops,
        )  # fmt: skip
        if put(self.link, status):
            self.event = events[-1] if events else self.event
            self.stopped = stops[-1][0] if stops else self.stopped
        if self.log is None:
            return
        for event in _after(lambda event: event is self.logged, run.events):
            self.log.row({"t": event.time, "event": event.kind, "reason": event.reason})
            self.logged = event
        if self.log.error != self.log_error:
            self.log_error = self.log.error
            executor.log("fault" if self.log_error else "log", self.log_error or self.log.trouble or "written again")
        row = _row(t, sent, int(run.state), reference, executor.estimate, command)
        self.log.row({**row, "took": time.monotonic() - began})


def _after(known: Callable[[_Thing], bool], things: list[_Thing]) -> tuple[_Thing, ...]:
    """What comes after the last known thing."""
    return tuple(takewhile(lambda thing: not known(thing), reversed(things)))[::-1]


def _row(
    t: float, sent: float, state: int, reference: ReferenceState, estimate: Array, command: Command
) -> Mapping[str, object]:
    """A row of the log."""
    return {
        "t": t, "sent": sent, "state": state, "reference": reference.coordinates, "reference_v": reference.v,
        "estimate": estimate, "drive": command.drive, "joints": command.joints, "stop": command.stop,
    }  # fmt: skip
