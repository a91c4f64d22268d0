"""Machine process: a simulated machine that runs against the wall clock in a process of its own, and its driver.

Two channels lead to it, with one pickled message per datagram: to the driver, in whatever process that is, and to the
simulated world. No process waits for another: what does not fit into a channel is dropped. So that nothing is lost by
that, every reading carries the wheel travel summed up since the start, and the newest localization fix; true states are
kept until they fit.
"""

from __future__ import annotations

import logging
import math
import pickle
import select
import signal
import socket
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.context import SpawnProcess
from typing import Any, NamedTuple, cast

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.driver import COMMAND_TIMEOUT
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.process.channel import ChannelClosedError, channel, put, take
from elastic_strips.control.process.child import (
    LONGEST_PROCESS_START,
    NOTHING_HEARD,
    end_process,
    orphaned,
    start_process,
)
from elastic_strips.control.process.priority import raise_priority
from elastic_strips.errors import ParameterError
from elastic_strips.validation import check_number

from .faults import FaultPlan, FaultyPlant
from .plant import STANDING_SPEED, Plant

_log = logging.getLogger(__name__)
_LARGEST_FIRST_MESSAGE = 1 << 16  # [bytes] of the first message
_DRIVER_BUFFER = 1 << 14  # [bytes] of the driver's channel: a reader that was stopped finds little that is old
_WORLD_BUFFER = 1 << 22  # [bytes] of the world's: a planner that takes seconds misses nothing
_LONGEST_STOP = 5.0  # [s] and it ends after this time if it has not
_AT_ONCE = 50  # true states in one message
_MOST_WAITING_STATES = 20_000  # true states that wait for a reader, at most


@dataclass(frozen=True, slots=True, eq=False)
class TrueState:
    """True state of the simulated machine.

    Attributes:
        time: time since the epoch [s].
        coordinates: (nv,) configuration as a coordinate row.
        v: (nv,) velocity: body twist, joint rates.
        motors: (k,) speeds of the drive's motors [m/s, rad/s].
        commanded: False where no command is in force, since the last one is too old.
    """

    time: float
    coordinates: Array
    v: Array
    motors: Array
    commanded: bool


class _Reading(NamedTuple):
    """The machine's message to its driver after a step."""

    time: float
    travel: list[float]  # (k,) since the start
    lost: int  # how often travel was not measured so far,
    misread: int  # and how often it was no number
    joints: list[float]
    fixes: int  # so many fixes have come so far
    fix: tuple[list[float], float | None, list[list[float]] | None] | None  # the newest: pose, time, covariance
    contact: str
    emergency: str
    error: str  # what the sensors' driver threw in place of a measurement


class MachineProcess:
    """Workspace: a plant in a process of its own, from ``__enter__`` to ``__exit__``.

    Args:
        make_plant: makes the plant in the process; has to be picklable, such as ``partial(KinematicPlant, robot,
            limits)``.
        coordinates: (nv,) coordinate row at which it begins, at rest.
        period: step of the plant [s].
        timeout: longest time [s] that a command holds.
        paused: whether it waits for :meth:`begin`.

    Attributes:
        epoch: ``time.monotonic()`` at which the machine's time is 0, the same in all processes.
        priority: how it gets the processor in time, as far as that was permitted.
    """

    def __init__(
        self,
        make_plant: Callable[[], Plant],
        coordinates: Array,
        *,
        period: float = 0.005,
        timeout: float = COMMAND_TIMEOUT,
        paused: bool = False,
    ) -> None:
        self._paused = paused
        self.period: float = check_number("period", period, above=0.0, high=0.1, unit="s")
        self.timeout: float = check_number("timeout", timeout, above=0.0, unit="s")
        self.epoch: float = math.nan
        self.priority: str = ""
        self._make_plant, self._coordinates = make_plant, np.array(coordinates, dtype=float)
        self._count = (0, 0)
        self._process: SpawnProcess | None = None
        self._states: list[TrueState] = []

    def __enter__(self) -> MachineProcess:
        """Start it, and wait until it runs.

        Raises:
            ParameterError: it does not start; the message says why.
        """
        self._driver, executor = channel(_DRIVER_BUFFER)
        self._world, world = channel(_WORLD_BUFFER)
        try:
            task = (self._make_plant, self._coordinates, self.period, self.timeout)
            self._process = start_process(_run, (executor, world), task, name="machine")
            executor.close()
            world.close()
            self._world.settimeout(LONGEST_PROCESS_START)
            data = self._world.recv(_LARGEST_FIRST_MESSAGE)
            self._world.setblocking(False)
            ready = pickle.loads(data) if data else NOTHING_HEARD
        except BaseException as error:
            executor.close()
            world.close()
            self._end(0.0)
            if isinstance(error, Exception):
                raise ParameterError(f"the simulated machine does not start: {error}") from error
            raise
        if isinstance(ready, str):
            self._end(LONGEST_PROCESS_START)
            raise ParameterError(f"the simulated machine does not start: {ready}")
        self._count, self.priority = ready
        _log.info("the simulated machine runs (%s)", self.priority)
        if not self._paused:
            self.begin(time.monotonic())
        return self

    def begin(self, epoch: float) -> None:
        """Let its time be 0 at this ``time.monotonic()``."""
        self.epoch = epoch
        put(self._world, ("begin", epoch))

    def __exit__(self, *_: object) -> None:
        """Let it come to rest and end; its last true states are kept for :meth:`truth`."""
        put(self._world, ("close", ""))
        self._end(_LONGEST_STOP + 5.0)

    def _end(self, patience: float) -> None:
        if self._process is not None and not end_process(self._process, patience):
            _log.warning("the simulated machine did not end; it is killed")
        self._states = self.truth()
        self._driver.close()
        self._world.close()

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """Number of the process."""
        return None if self._process is None else self._process.pid

    @property
    def now(self) -> float:
        """The machine's time [s]."""
        return time.monotonic() - self.epoch

    def driver(self) -> MachineDriver:
        """The driver of this machine, to be given to the process that controls; one at a time reads measurements."""
        return MachineDriver(self._driver.dup(), self._count)

    def truth(self) -> list[TrueState]:
        """The true states since the last call, one for each step; also of the time before it was killed."""
        states, self._states = self._states, []
        for message in _take(self._world):
            for time_, coordinates, v, motors, commanded in message:
                states.append(TrueState(time_, np.array(coordinates), np.array(v), np.array(motors), commanded))
        return states

    def touch(self, description: str) -> None:
        """Let measurements report a felt contact from now on; an empty description ends that."""
        put(self._world, ("contact", description))

    def press(self, description: str) -> None:
        """Press the emergency stop, which stops the motors and is measured; an empty description releases it."""
        put(self._world, ("emergency", description))


class MachineDriver:
    """Workspace: the :class:`~elastic_strips.control.driver.Driver` of a machine process.

    It can be sent to another process as an argument of that.

    Args:
        channel: channel to the machine.
        count: (k, n) numbers of drive coordinates and joints.
    """

    def __init__(self, channel: socket.socket, count: tuple[int, int]) -> None:
        self._channel, self._count = channel, count
        self._before: _Reading | None = None  # the last one that was returned
        self._fixes = 0
        self._felt = ""

    def measure(self, t: float) -> Measurement | None:
        """The measurement since the last call.

        Raises:
            RuntimeError: the sensors' driver threw something.
        """
        readings = [_Reading(*message) for message in _take(self._channel)]
        if not readings:
            return None
        self._felt = next((r.contact for r in reversed(readings) if r.contact), self._felt)
        before = self._before = self._before or readings[0]
        new = readings[-1]
        if new.error:
            raise RuntimeError(new.error)
        drive: Array | None = np.subtract(new.travel, before.travel)
        if new.lost > before.lost:
            drive = None
        elif new.misread > before.misread:
            drive = np.full(len(new.travel), np.nan)
        pose, pose_time, covariance = new.fix if new.fix is not None and new.fixes > self._fixes else (None, None, None)
        contact, self._felt = self._felt, ""
        self._before, self._fixes = new, new.fixes
        return Measurement(
            new.time,
            drive,
            np.array(new.joints),
            None if pose is None else np.array(pose),
            pose_time,
            None if covariance is None else np.array(covariance),
            contact,
            new.emergency,
        )

    def send(self, t: float, command: Command) -> None:
        """Pass on a command of time ``t`` [s].

        Raises:
            ParameterError: it has the wrong size or is not finite.
        """
        drive, joints = np.asarray(command.drive, dtype=float), np.asarray(command.joints, dtype=float)
        sound = (drive.shape, joints.shape) == ((self._count[0],), (self._count[1],))
        if not (sound and np.isfinite(drive).all() and np.isfinite(joints).all() and math.isfinite(t)):
            raise ParameterError(
                f"command {drive} and {joints} of time {t}: {self._count[0]} finite speeds of the drive and "
                f"{self._count[1]} of joints are needed"
            )
        put(self._channel, (float(t), drive.tolist(), joints.tolist(), bool(command.stop)))

    def close(self) -> None:
        """Stop the machine safely and release the channel."""
        k, n = self._count
        put(self._channel, (math.inf, [0.0] * k, [0.0] * n, True))
        self._channel.close()


def faulty_plant(make_plant: Callable[[], Plant], faults: FaultPlan, seed: int = 0) -> Plant:
    """A plant with faults, for a machine process: ``partial(faulty_plant, make_plant, faults)``."""
    return cast("Plant", FaultyPlant(make_plant(), faults, seed))


class _Machine:
    """Workspace: the plant in its process: steps it, and talks."""

    def __init__(
        self, plant: Plant, period: float, timeout: float, executor: socket.socket, world: socket.socket
    ) -> None:
        self.plant, self.period, self.timeout = plant, period, timeout
        self.executor, self.world = executor, world
        self.first = plant.robot.space.base_nv
        self.count = (len(plant.motors), len(plant.robot.joint_names))
        self.stop = Command(np.zeros(self.count[0]), np.zeros(self.count[1]), stop=True)
        self.command, self.sent = self.stop, -math.inf
        self.steps = 0
        self.said = {"contact": "", "emergency": ""}
        self.closing = False
        self.travel = np.zeros(self.count[0])
        self.lost = self.misread = self.fixes = 0
        self.fix: tuple[list[float], float | None, list[list[float]] | None] | None = None
        self.error = ""
        self.last = Measurement(0.0, None, plant.coordinates[self.first :])
        self.epoch = 0.0
        self.states: deque[tuple[object, ...]] = deque(maxlen=_MOST_WAITING_STATES)

    def try_out(self) -> None:
        """One step that does not count: what is loaded at the first use is loaded now.

        Raises:
            ParameterError: the plant cannot take such steps.
        """
        try:
            self.plant.step(self.stop, self.period)
        except RuntimeError as error:  # an injected fault
            _log.info("the simulated machine: %s", error)

    def wait(self) -> None:
        """Wait for the parent to say when time is 0."""
        while True:
            select.select([self.world], [], [], 1.0)
            for what, value in _take(self.world):
                if what == "begin":
                    self.epoch = value
                    time.sleep(max(0.0, value - time.monotonic()))
                    return
                self.closing = self.closing or what == "close"
            if self.closing or orphaned():
                self.closing = True
                return

    def run(self) -> None:
        """Follow the wall clock until the parent closes the machine, or is gone, and it has come to rest."""
        end = math.inf
        while True:
            now = time.monotonic() - self.epoch
            due = int(now / self.period + 1e-6)
            if due <= self.steps:
                time.sleep(max(0.0, (self.steps + 1) * self.period - now))
                continue
            while self.steps < due:  # several where the machine was late
                self.step()
            self.tell()
            self.listen()
            if end == math.inf and (self.closing or orphaned()):
                self.closing, end = True, now + _LONGEST_STOP
            if end < math.inf and (self.at_rest() or now > end):
                return

    def step(self) -> None:
        """One step under the command that is in force at its beginning."""
        commanded = self.steps * self.period - self.sent <= self.timeout
        obeyed = commanded and not self.closing and not self.said["emergency"]
        self.steps += 1
        try:
            self.note(self.plant.step(self.command if obeyed else self.stop, self.period))
            self.error = ""
        except Exception as error:  # as if the sensors' driver had thrown it; the machine goes on
            if not self.error:
                _log.warning("the simulated machine: %s", error)
            self.error = f"{type(error).__name__}: {error}"
            self.lost += 1
        plant = self.plant
        state = (plant.coordinates.tolist(), plant.v.tolist(), plant.motors.tolist())
        self.states.append((plant.time, *state, commanded))

    def note(self, measurement: Measurement) -> None:
        self.last = measurement
        drive = measurement.drive
        if drive is None:
            self.lost += 1
        elif np.isfinite(drive).all():
            self.travel += drive
        else:
            self.misread += 1
        if measurement.pose is not None:
            self.fixes += 1
            covariance = measurement.pose_covariance
            self.fix = (
                measurement.pose.tolist(),
                measurement.pose_time,
                None if covariance is None else covariance.tolist(),
            )

    def tell(self) -> None:
        """Send what was measured last."""
        last = self.last
        reading = _Reading(
            last.time,
            self.travel.tolist(),
            self.lost,
            self.misread,
            last.joints.tolist(),
            self.fixes,
            self.fix,
            last.contact or self.said["contact"],
            last.emergency or self.said["emergency"],
            self.error,
        )
        put(self.executor, tuple(reading))
        self.report()

    def report(self) -> bool:
        """Send some true states; False where none are left, or nobody takes them."""
        some = tuple(islice(self.states, _AT_ONCE))
        if not some or not put(self.world, some):
            return False
        for _ in some:
            self.states.popleft()
        return True

    def listen(self) -> None:
        """Take the newest command, and what the world says."""
        for sent, drive, joints, stop in _take(self.executor):
            self.command = Command(np.array(drive), np.array(joints), stop)
            self.sent = min(sent, time.monotonic() - self.epoch)
        for what, text in _take(self.world):
            if what == "close":
                self.closing = True
            else:
                self.said[what] = text

    def at_rest(self) -> bool:
        speeds = (self.plant.motors, self.plant.v[self.first :])
        return all(float(np.abs(v).max(initial=0.0)) < STANDING_SPEED for v in speeds)


def _run(
    executor: socket.socket,
    world: socket.socket,
    make_plant: Callable[[], Plant],
    coordinates: Array,
    period: float,
    timeout: float,
) -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, who closes the machine
    try:
        plant = make_plant()
        plant.reset(coordinates)
        machine = _Machine(plant, period, timeout, executor, world)
        machine.try_out()
        plant.reset(coordinates)
    except Exception as error:
        put(world, f"{type(error).__name__}: {error}")
        return
    priority = raise_priority()
    put(world, (machine.count, priority))
    try:
        machine.wait()
        machine.run()
        while machine.report():
            pass
    finally:
        plant.close()


def _take(end: socket.socket) -> list[tuple[Any, ...]]:
    """All messages that have come; none where the other end is gone."""
    messages: list[tuple[Any, ...]] = []
    with suppress(ChannelClosedError):
        messages.extend(message for message in take(end) if isinstance(message, tuple))
    return messages
