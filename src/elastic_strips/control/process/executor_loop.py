"""Executor loop: the control loop on the wall clock, in the executor's process, and its messages with planning."""

from __future__ import annotations

import gc
import logging
import math
import select
import signal
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import islice, takewhile
from typing import TypeVar

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.control.driver import Driver
from elastic_strips.control.executor import MotionExecutor
from elastic_strips.control.interfaces import Command, Event, Measurement, RunState
from elastic_strips.control.params import DriveParams, Tolerance
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.validation import check_array, check_number, check_type

from .channel import ChannelClosedError, put, take
from .child import orphaned
from .log_stream import LogStream
from .priority import raise_priority

_log = logging.getLogger(__name__)
_TELLING_PERIODS = 20  # periods in which a motion of the executor's own is told
_QUIET_BEFORE_PERIOD = 0.0015  # [s] before a period begins nothing else is begun
_MESSAGES_PER_PERIOD = 50  # messages that are taken in one period: no flood of them holds up the command
_LONGEST_CREEP = 2.0  # [s] after the end of its motion a robot that does not stand is left to its driver
_Thing = TypeVar("_Thing")
_Samples = tuple[Array, Array, Array, Array]  # time, coordinates, v, a

ExecutorTask = tuple[RobotModel, MotionLimits, DriveParams, Array, Array, Tolerance]
"""The parts that an executor is made of: robot, limits, parameters, place of the robot, goal, tolerance."""


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """The executor's report after a control period; see :class:`~elastic_strips.control.executor.ExecutorLink`.

    Attributes:
        time: [s] on the executor's clock.
        serial: number of the active trajectory: as it was submitted with, or negative where it is the executor's own.
        samples: its samples, sent now and then and whenever planning may not know them.
        measured: [s] of the measurement that the estimate is by.
        coordinates, v: (nv,) of the reference.
        events, stops: new ones since the last status that could be sent.
        pilot: what became of the last command of a pilot, where one is guarded.
        scene: number of the last scene that was taken, where one is guarded.
    """

    time: float
    state: RunState
    reason: str
    serial: int
    samples: _Samples | None
    at_goal: bool
    estimate: Array
    measured: float
    settled: bool
    lost_for: float
    waits: str
    contact: str
    coarse: float
    needed_error: float
    due_error: float
    recoveries: int
    coordinates: Array
    v: Array
    events: tuple[Event, ...]
    stops: tuple[tuple[float, str], ...]
    pilot: str = ""
    scene: int = 0


def serve(link: socket.socket, driver: Driver, task: ExecutorTask, log: str | None) -> None:
    """Main function of the process: it reports ready, waits for time 0, and runs the loop to its end.

    Args:
        link: channel to planning.
        driver: drives the robot's motors.
        task: the parts that the executor is made of.
        log: file of the log; None writes no log.
    """
    run_loop(link, driver, lambda stream: Loop(link, MotionExecutor(*task, keep=500), driver, stream), log)


def run_loop(link: socket.socket, driver: Driver, make: Callable[[LogStream | None], Loop], log: str | None) -> None:
    """What `serve` does, with the loop that ``make`` makes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for planning, which lets the robot come to rest
    priority = raise_priority()  # before the log's thread begins, which has to have the same
    stream: LogStream | None = None
    try:
        stream = None if log is None else LogStream(log)
        loop = make(stream)
        opening = getattr(driver, "open", None)
        if callable(opening):
            opening()
        loop.notes = getattr(driver, "notes", loop.notes)
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


class Loop:
    """Workspace: the control loop in its process, on the wall clock."""

    def __init__(self, link: socket.socket, executor: MotionExecutor, driver: Driver, log: LogStream | None) -> None:
        self.link, self.executor, self.driver, self.log = link, executor, driver, log
        self.epoch, self.dt = 0.0, executor.params.control_dt
        self.heard: float | None = None  # [s] when the last word of planning came
        self.planned: float | None = None  # [s] when its last tick ended
        self.silent = self.hangs = self.gone = self.closing = False
        self.serial = 0
        self.own = 0  # trajectories of the executor's own so far
        self.known: Trajectory = executor.active  # the active one, as it was told
        self.told = 0  # periods since it changed by itself
        self.event: Event | None = None  # the last one that was told,
        self.stopped = -math.inf  # and when the last stop was [s]
        self.logged: Event | None = None
        self.log_error = ""
        self.pilot = ""
        self.taken = 0
        self.notes: Callable[[], Iterable[str]] = tuple  # of the driver

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
            if self.gone or ahead < _QUIET_BEFORE_PERIOD:
                time.sleep(ahead)
            elif select.select([self.link], [], [], ahead - _QUIET_BEFORE_PERIOD)[0]:
                self.listen()

    def over(self) -> bool:
        executor = self.executor
        if not ((self.closing or self.gone) and executor.at_rest(executor.time)):
            return False
        return executor.settled or executor.time > executor.active.end_time + _LONGEST_CREEP

    def step(self, t: float) -> None:
        """One control period: whatever fails in it, a command goes out."""
        executor, began = self.executor, time.monotonic()
        measurement: Measurement | None = None
        try:
            measurement = self.driver.measure(t)
        except Exception as error:
            executor.log("fault", f"driver exception: {type(error).__name__}: {error}")
        for note in self.notes():
            executor.log("fault", note)
        try:
            command = self.command(t, measurement)
        except Exception as error:
            _log.exception("no command could be computed")
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

    def command(self, t: float, measurement: Measurement | None) -> Command:
        """The command for the period that begins at ``t`` [s]."""
        try:
            self.executor.measure(t, measurement)
        except Exception as error:
            _log.exception("a measurement could not be taken in")
            self.executor.fail(f"measuring failed: {type(error).__name__}: {error}")
        self.check_planner(t)
        return self.executor.command(t)

    def listen(self) -> None:
        """Do what planning says."""
        executor = self.executor
        try:
            for message in islice(take(self.link), _MESSAGES_PER_PERIOD):
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
        """Come to rest where planning is gone, or says nothing for too long; where it hangs, on the motion it made."""
        executor, heard = self.executor, self.heard
        if int(t / self.dt) % 10 == 0 and orphaned():  # somebody else holds the channel open
            self.lose()
        elif heard is not None and t - heard > executor.params.monitor.heartbeat:
            if not (self.silent or self.gone):
                self.silent = True
                executor.fail(f"nothing has been heard from the planner for {t - heard:.2f} s")
        elif self.silent:
            self.silent = False
            executor.log("planner", "the planner is heard again")
        self.check_ticks(t)

    def check_ticks(self, t: float) -> None:
        """Write down where planning lives, but hangs."""
        executor, params = self.executor, self.executor.params.monitor
        ago = 0.0 if self.planned is None or self.silent or self.gone else t - self.planned
        if not self.hangs and ago > params.planner_hangs and not executor.at_rest(t):
            self.hangs = True
            executor.log("fault", f"the planner hangs: its last tick ended {ago:.2f} s ago")
        elif self.hangs and ago <= params.planner_hangs:
            self.hangs = False
            executor.log("planner", "the planner plans again")

    def lose(self) -> None:
        """Planning is gone for good."""
        if not self.gone:
            self.gone = True
            self.executor.fail("the planner's process is gone")
            self.executor.stop("the planner's process is gone")

    def obey(self, message: object) -> None:
        """Do what a message says, where it can be done.

        Raises:
            Exception: it is not a message, or its content is of another kind; nothing was changed.
        """
        if not isinstance(message, tuple) or not message:
            raise ConfigurationError(f"{message!r} is not a message")
        what, *values = message
        executor = self.executor
        if what in ("submit", "anchor"):
            serial, samples, *rest = values
            motion = Trajectory(executor.robot, executor.limits, *samples)
            if what == "anchor":
                executor.anchor(motion)
            else:
                certificate, at_goal, proven, leaving = rest
                check_type("certificate", certificate, Certificate)
                proven = check_number("proven", proven, low=0.0, unit="m")
                executor.submit(motion, certificate, at_goal=bool(at_goal), proven=proven, leaving=bool(leaving))
            if executor.active is motion:
                self.known, self.serial, self.told = motion, int(serial), _TELLING_PERIODS
        elif what == "hold":
            serial, reason, proven = values
            proven = check_number("proven", proven, low=0.0, unit="m")
            if serial == self.serial and self.known is executor.active:
                executor.hold(str(reason), executor.active, proven)
        elif what == "retarget":
            goal, tolerance = values
            check_type("tolerance", tolerance, Tolerance)
            executor.retarget(check_array("goal", goal, (executor.robot.nv,)), tolerance)
        elif what == "close":
            self.end()
        elif what == "planned":
            self.planned = executor.time
        elif what in ("brake", "reject", "log", "stop", "resume"):
            getattr(executor, what)(*map(str, values))
        elif what != "beat":
            raise ConfigurationError(f"{what!r} is not a message")

    def tell(self, t: float, command: Command, began: float, sent: float) -> None:
        """Tell planning and the log what has happened in this period."""
        executor, run = self.executor, self.executor.run
        if executor.active is not self.known:  # the executor's own: braked, or set to where the robot is
            self.own -= 1
            self.known, self.serial, self.told = executor.active, self.own, 0
        self.told += 1
        samples = None
        if self.told <= _TELLING_PERIODS or self.told % _TELLING_PERIODS == 0:
            active = executor.active
            samples = (active.time, active.coordinates, active.v, active.a)
        reference = executor.reference(t)
        events = _after(lambda event: event is self.event, run.events)
        stops = _after(lambda stop: stop[0] <= self.stopped, run.stops)
        status = Status(
            time=t,
            state=run.state,
            reason=run.reason,
            serial=self.serial,
            samples=samples,
            at_goal=executor.at_goal,
            estimate=executor.estimate,
            measured=executor.measured,
            settled=executor.settled,
            lost_for=executor.lost_for,
            waits=executor.waits,
            contact=executor.contact,
            coarse=executor.coarse,
            needed_error=executor.needed_error,
            due_error=executor.due_error,
            recoveries=executor.recoveries,
            coordinates=reference.coordinates,
            v=reference.v,
            events=events,
            stops=stops,
            pilot=self.pilot,
            scene=self.taken,
        )
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
        "t": t,
        "sent": sent,
        "state": state,
        "reference": reference.coordinates,
        "reference_v": reference.v,
        "estimate": estimate,
        "drive": command.drive,
        "joints": command.joints,
        "stop": command.stop,
    }
