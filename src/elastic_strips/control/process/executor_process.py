"""Executor process: the control loop alone, in a process of its own, and the planner's view of it.

The process needs only the next certified motion from planning. Planning may be late, hang or die: then the robot
comes to rest on the motion that it has.

What is promised of the messages: they come in order, and none twice, but any may be missing (see
:mod:`~elastic_strips.control.process.channel`). So a motion is checked where it is executed, by itself and against the
one that it continues, whatever planning believed; a status is whole, and the next one makes up for one that is
missing: events and stops are told until they are taken, the samples of the active trajectory again and again. Until
these come, planning may continue a trajectory that is active no longer; what it makes of it is refused. Who planned and
died does not come back: the process ends as soon as the robot stands, and another one starts from there.
"""

from __future__ import annotations

import logging
import os
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable
from itertools import count
from multiprocessing.context import SpawnProcess
from pathlib import Path

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.control.driver import Driver
from elastic_strips.control.interfaces import Event, RunState
from elastic_strips.control.params import DriveParams, Tolerance
from elastic_strips.control.supervisor import RunLog
from elastic_strips.errors import ConfigurationError
from elastic_strips.files import refuse_input
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.trajectory import stationary

from .channel import ChannelClosedError, channel, put, take
from .child import LONGEST_PROCESS_START, NOTHING_HEARD, end_process, start_process
from .executor_loop import Status, serve

_log = logging.getLogger(__name__)
_CHANNEL_BUFFER = 1 << 20  # [bytes] of a channel
_LONGEST_END = 15.0  # [s] longest time in which the robot comes to rest at the end
_HEARTBEAT_PERIOD = 0.02  # [s] from one heartbeat of planning to the next
_TAKEN_FOR_ACCEPTED = 0.03  # [s] a motion that was sent so short a time ago is taken for accepted
_REMEMBERED_MOTIONS = 10  # motions that were sent last, which the active one may be


class ExecutorProcess:
    """Workspace: an executor in a process of its own; the :class:`~elastic_strips.control.executor.ExecutorLink` to it.

    Used once, in a ``with`` statement; at its end the robot comes to rest, and the process ends. It ends, too, where
    the process that started it is gone, or tells it to by SIGTERM, as soon as the robot stands.

    Args:
        robot: the robot.
        start: configuration (nq,) of the robot at rest.
        goal: configuration (nq,).
        params: parameters of the drive.
        limits: limits of the motors; read off the robot where None.
        log: file of the log, which is written while the robot drives; None writes no log.

    Attributes:
        run: state, reason, events and stops of the robot.
        priority: how the process gets the processor in time, as far as that was permitted.

    Raises:
        ConfigurationError: start or goal is not valid.
    """

    _serve: Callable[..., None] = staticmethod(serve)  # main function of the process

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
        self._task: tuple[object, ...] = (robot, self.limits, self.params, row, self._goal, self.params.tolerance)
        if log is not None:
            refuse_input(Path(log))
        self._log = None if log is None else os.fspath(log)
        self._serial = count(1)
        resting = stationary(robot, self.limits, row, 0.0, self.params.control_dt)
        self._sent: tuple[float, int, Trajectory, bool] = (-np.inf, 0, resting, False)  # when, number, what, at goal
        self._status = Status(
            time=0.0,
            state=RunState.STOPPED,
            reason="not started",
            serial=0,
            samples=None,
            at_goal=False,
            estimate=row,
            measured=0.0,
            settled=True,
            lost_for=0.0,
            waits="",
            contact="",
            coarse=0.0,
            needed_error=self.params.tracking_error,
            due_error=self.params.tracking_error,
            recoveries=0,
            coordinates=row,
            v=np.zeros(robot.nv),
            events=(),
            stops=(),
        )
        self._motions: deque[tuple[int, Trajectory]] = deque(maxlen=_REMEMBERED_MOTIONS)  # sent last, by number
        self._active: tuple[int, Trajectory] = (0, resting)
        self._lock = threading.Lock()
        self._closing = False
        self._early: list[tuple[object, ...]] | None = []  # what is said before the process begins
        self._ending = threading.Event()
        self._gone = ""
        self._process: SpawnProcess | None = None
        self._thread: threading.Thread | None = None

    def start(self, driver: Driver) -> None:
        """Start the process, and wait until it is ready for :meth:`begin`.

        Args:
            driver: drives the robot's motors; it is sent to the process.

        Raises:
            ConfigurationError: the process does not start, or was started before; the message says why.
        """
        if self._process is not None:
            raise ConfigurationError("an executor's process is started once; make another one")
        self._link, child = channel(_CHANNEL_BUFFER)
        process: SpawnProcess | None = None
        first: object = NOTHING_HEARD
        try:
            process = start_process(self._serve, (child, driver), (self._task, self._log), name="executor")
            child.close()
            self._link.settimeout(LONGEST_PROCESS_START)
            data = self._link.recv(_CHANNEL_BUFFER)
            self._link.setblocking(False)
            first = pickle.loads(data) if data else first
        except Exception as error:  # the driver cannot be sent to a process, or takes too long there
            first = f"{type(error).__name__}: {error}"
        finally:
            child.close()
            if not isinstance(first, tuple):
                self._link.close()
                if process is not None:
                    end_process(process, 0.0 if process.is_alive() else _LONGEST_END)
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
        if not end_process(self._process, _LONGEST_END):
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
        """Why nothing has been heard from the executor; empty where all is well."""
        silent = self.now - self._status.time
        if self._gone or silent <= self.params.monitor.heartbeat:
            return self._gone
        return f"nothing has been heard from the executor for {silent:.2f} s"

    # what planning sees

    @property
    def active(self) -> Trajectory:
        with self._lock:
            sent, serial, motion, _ = self._sent
            mine = serial == self._status.serial or self._status.time < sent + _TAKEN_FOR_ACCEPTED
            return motion if mine else self._active[1]

    @property
    def at_goal(self) -> bool:
        with self._lock:
            sent, _, _, at_goal = self._sent
            return at_goal if self._status.time < sent + _TAKEN_FOR_ACCEPTED else self._status.at_goal

    @property
    def estimate(self) -> Array:
        return self._status.estimate

    @property
    def estimated(self) -> tuple[float, Array]:
        """The estimate (nv,), and the time [s] of the measurement that it is by."""
        status = self._status
        return status.measured, status.estimate

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
    def contact(self) -> str:
        return self._status.contact

    @property
    def coarse(self) -> float:
        return self._status.coarse

    @property
    def needed_error(self) -> float:
        return self._status.needed_error

    @property
    def due_error(self) -> float:
        return self._status.due_error

    @property
    def recoveries(self) -> int:
        return self._status.recoveries

    @property
    def pilot(self) -> str:
        """What became of the last command of a pilot, where one is guarded."""
        return self._status.pilot

    def reference(self, t: float) -> ReferenceState:
        """State of the reference that was told last."""
        status = self._status
        return ReferenceState(status.time, status.coordinates, status.v, np.zeros_like(status.v))

    def at_rest(self, t: float) -> bool:
        return t >= self.active.end_time

    def submit(
        self, motion: Trajectory, certificate: Certificate, *, at_goal: bool, proven: float, leaving: bool = False
    ) -> None:
        serial = next(self._serial)
        samples = (motion.time, motion.coordinates, motion.v, motion.a)
        if self._put("submit", serial, samples, certificate, at_goal, proven, leaving):
            self._note(serial, motion, at_goal)

    def anchor(self, resting: Trajectory) -> None:
        serial = next(self._serial)
        if self._put("anchor", serial, (resting.time, resting.coordinates, resting.v, resting.a)):
            self._note(serial, resting, at_goal=False)

    def planned(self) -> None:
        self._put("planned")

    def brake(self, reason: str) -> None:
        self._put("brake", reason)

    def hold(self, reason: str, motion: Trajectory, proven: float) -> None:
        with self._lock:
            sent = ((serial, each) for serial, each in (self._active, *self._motions, self._sent[1:3]))
            serial = next((serial for serial, each in sent if each is motion), None)
        if serial is not None:
            self._put("hold", serial, reason, proven)

    def reject(self, reason: str) -> None:
        self._put("reject", reason)

    def log(self, kind: str, reason: str) -> None:
        self._put("log", kind, reason)

    def retarget(self, goal: Array, tolerance: Tolerance) -> None:
        rests = self.at_rest(self.now)
        with self._lock:
            self._sent = (self.now, *self._sent[1:3], False)
            if rests:
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
        while not self._ending.wait(_HEARTBEAT_PERIOD):
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
