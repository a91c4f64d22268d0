"""Executor process: the control loop alone, in a process of its own, and what planning sees of it.

The process needs nothing of planning but the next certified motion. Planning may be late, hang or die: then the robot
comes to rest on the motion that it has.
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import pickle
import select
import signal
import socket
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing.context import SpawnProcess

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.trajectory import stationary

from .channel import ChannelClosedError, channel, put, take
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
_Samples = tuple[Array, Array, Array, Array]  # time, coordinates, v, a


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """What the executor tells after a control period; see :class:`~elastic_strips.control.executor.ExecutorLink`.

    Attributes:
        time: [s] on the executor's clock.
        serial: number of the active trajectory; samples: its samples, where planning may not know them.
        coordinates, v: (nv,) of the reference.
        events, stops: new ones since the last status.
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

    Used in a ``with`` statement; at its end the robot comes to rest, and the process ends.

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
        self._active: tuple[int, Trajectory] = (0, resting)
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._gone = ""
        self._process: SpawnProcess | None = None
        self._thread: threading.Thread | None = None

    def start(self, driver: Driver) -> None:
        """Start the process, and wait until it is ready for :meth:`begin`.

        Args:
            driver: of the robot's motors; it is sent to the process.

        Raises:
            ConfigurationError: it does not start.
        """
        self._link, child = channel(_BUFFER)
        self._process = process = multiprocessing.get_context("spawn").Process(
            target=_serve, args=(child, self._task, driver, self._log), name="executor", daemon=True
        )
        process.start()
        child.close()
        self._link.settimeout(_START)
        try:
            first = self._link.recv(_BUFFER)
        except OSError as error:
            process.kill()
            raise ConfigurationError(f"the executor's process does not start: {error}") from error
        finally:
            self._link.setblocking(False)
        if not first:
            raise ConfigurationError("the executor's process ended at once; its log says why")
        _, self.priority = pickle.loads(first)

    def begin(self, epoch: float) -> None:
        """Let the control loop run; its time is 0 at this ``time.monotonic()``."""
        self.epoch = epoch
        self._put("begin", epoch)
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
        self._thread.start()

    def __enter__(self) -> ExecutorProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """Bring the robot to rest, and end the process."""
        if self._process is None:
            return
        put(self._link, ("close",))
        self._process.join(_END)
        if self._process.is_alive():
            _log.warning("the executor's process did not end; it is killed")
            self._process.kill()
            self._process.join()
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
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
        with self._lock:
            self._sent = (self.now, serial, motion, at_goal)
        if not self._put("submit", serial, samples, certificate, at_goal, proven):
            self._sent = (-np.inf, *self._sent[1:])

    def anchor(self, resting: Trajectory) -> None:
        serial = next(self._serial)
        with self._lock:
            self._sent = (self.now, serial, resting, False)
        self._put("anchor", serial, (resting.time, resting.coordinates, resting.v, resting.a))

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
        self._put("retarget", goal, tolerance)

    def stop(self, reason: str) -> None:
        self._put("stop", reason)

    def resume(self) -> None:
        self._put("resume")

    def _put(self, *message: object) -> bool:
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
            if not self._gone and not self._ending.is_set():
                self._gone = "the executor's process is gone"
                self.run.state, self.run.reason = RunState.FAILED, self._gone
                self.run.events.append(Event(self.now, "fault", self._gone))
                _log.error(self._gone)

    def _take(self, status: Status) -> None:
        with self._lock:
            if status.samples is not None and status.serial != self._active[0]:
                self._active = status.serial, Trajectory(self.robot, self.limits, *status.samples)
            elif status.serial == self._sent[1]:
                self._active = status.serial, self._sent[2]
            self._status = status
            self.run.state, self.run.reason = status.state, status.reason
            self.run.events.extend(status.events)
            self.run.stops.extend(status.stops)


_Task = tuple[RobotModel, MotionLimits, DriveParams, Array, Array, Tolerance]


def _serve(link: socket.socket, task: _Task, driver: Driver, log: str | None) -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for planning, which lets the robot come to rest
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    priority = raise_priority()  # before the log's thread begins, which has to have the same
    _log.info("the executor runs (%s)", priority)
    loop = _Loop(link, Executor(*task, keep=500), driver, None if log is None else LogStream(log))
    put(link, ("ready", priority))
    if loop.wait():
        loop.run()
    driver.close()
    if loop.log is not None:
        loop.log.close()


class _Loop:
    """Workspace: the control loop in its process, on the wall clock."""

    def __init__(self, link: socket.socket, executor: Executor, driver: Driver, log: LogStream | None) -> None:
        self.link, self.executor, self.driver, self.log = link, executor, driver, log
        self.epoch, self.dt = 0.0, executor.params.control_dt
        self.heard: float | None = None  # [s] when the last word of planning came
        self.silent = self.gone = self.closing = False
        self.serial = 0
        self.known: Trajectory = executor.active  # the active one, as it was told
        self.told = 0  # periods since it changed by itself
        self.events = self.stops = 0  # told so far
        self.seen_events: list[Event] = []
        self.log_trouble = ""

    def wait(self) -> bool:
        """Wait until planning says when time is 0; False where it is gone."""
        while True:
            select.select([self.link], [], [])
            try:
                for message in take(self.link):
                    if isinstance(message, tuple) and message[0] == "begin":
                        self.epoch = message[1]
                        return True
                    if isinstance(message, tuple) and message[0] == "close":
                        return False
            except ChannelClosedError:
                return False

    def run(self) -> None:
        """Step after step, until the robot has come to rest at the end, or planning is gone and it stands."""
        k = max(int((time.monotonic() - self.epoch) / self.dt), 0)
        while not self.over():
            ahead = self.epoch + k * self.dt - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            late = int((time.monotonic() - self.epoch) / self.dt) - k
            k += max(late, 0)  # periods that were missed are left out
            self.step(k * self.dt)
            k += 1

    def over(self) -> bool:
        return (self.closing or self.gone) and self.executor.at_rest(self.executor.time) and self.executor.settled

    def step(self, t: float) -> None:
        """One control period: whatever fails in it, a command goes out."""
        executor = self.executor
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
        self.listen(t)
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
        self.tell(t, command, time.monotonic() - self.epoch)
        if executor.at_rest(t) and int(t / self.dt) % 100 == 0:
            gc.collect(0)

    def listen(self, t: float) -> None:
        """Do what planning says; come to rest where it says nothing for too long."""
        executor, patience = self.executor, self.executor.params.monitor.heartbeat
        try:
            for message in take(self.link):
                self.heard = t
                self.obey(message)
        except ChannelClosedError:
            if not self.gone:
                self.gone = True
                executor.fail("the planner's process is gone")
                executor.stop("the planner's process is gone")
            return
        except Exception as error:
            executor.log("fault", f"a message of the planner: {type(error).__name__}: {error}")
        if self.heard is not None and t - self.heard > patience:
            if not self.silent:
                self.silent = True
                executor.fail(f"nothing is heard of the planner for {t - self.heard:.2f} s")
        elif self.silent:
            self.silent = False
            executor.log("planner", "it is heard again")

    def obey(self, message: object) -> None:
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
                executor.submit(motion, certificate, at_goal=at_goal, proven=proven)
            if executor.active is motion:
                self.known, self.serial, self.told = motion, serial, _TOLD
        elif what == "close":
            self.closing = True
            executor.stop("asked to stop")
        elif what in ("brake", "hold", "reject", "log", "retarget", "stop", "resume"):
            getattr(executor, what)(*values)
        elif what != "beat":
            raise ConfigurationError(f"{what!r} is no message")

    def tell(self, t: float, command: Command, sent: float) -> None:
        """Tell planning and the log what has happened in this period."""
        executor, run = self.executor, self.executor.run
        if executor.active is not self.known:  # the executor's own: braked, or set to where the robot is
            self.known, self.serial, self.told = executor.active, -abs(self.serial) - 1, 0
        self.told += 1
        samples = None
        if self.told <= _TOLD or self.told % _TOLD == 0:
            active = executor.active
            samples = (active.time, active.coordinates, active.v, active.a)
        reference = executor.reference(t)
        events, stops = self.news(run)
        put(self.link, Status(
            t, run.state, run.reason, self.serial, samples, executor.at_goal, executor.estimate, executor.settled,
            executor.lost_for, executor.waits, executor.coarse, executor.needed_error, executor.recoveries,
            reference.coordinates, reference.v, events, stops,
        ))  # fmt: skip
        if self.log is None:
            return
        for event in events:
            self.log.row({"t": event.time, "event": event.kind, "reason": event.reason})
        if self.log.trouble != self.log_trouble:
            self.log_trouble = self.log.trouble
            if self.log_trouble:
                executor.log("fault", self.log_trouble)
        self.log.row(_row(t, sent, int(run.state), reference, executor.estimate, command))

    def news(self, run: RunLog) -> tuple[tuple[Event, ...], tuple[tuple[float, str], ...]]:
        """Events and stops that were not told yet; a log keeps the newest only."""
        events = []
        for event in reversed(run.events):
            if self.seen_events and event is self.seen_events[-1]:
                break
            events.append(event)
        if events:
            self.seen_events = [events[0]]
        stops = [stop for stop in run.stops if stop[0] > self.stops]
        if stops:
            self.stops = stops[-1][0]
        return tuple(reversed(events)), tuple(stops)


def _row(
    t: float, sent: float, state: int, reference: ReferenceState, estimate: Array, command: Command
) -> Mapping[str, object]:
    """A row of the log."""
    return {
        "t": t, "sent": sent, "state": state, "reference": reference.coordinates, "reference_v": reference.v,
        "estimate": estimate, "drive": command.drive, "joints": command.joints, "stop": command.stop,
    }  # fmt: skip
