"""Realtime: a drive against the wall clock; machine, executor, sensors and planning each in a process of its own.

This process plans. The executor needs only the next motion from it, and the machine only the next command from the
executor. Where the robot has sensors, they and what is made of their readings are in a process that needs only the
machine's states, and where the robot is thought to be.
"""

from __future__ import annotations

import logging
import os
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.interfaces import Event, RunState
from elastic_strips.control.process.executor_process import ExecutorProcess
from elastic_strips.control.process.log_stream import read_log
from elastic_strips.control.record import DriveResult, RecordError
from elastic_strips.scene import World
from elastic_strips.validation import check_number

from .closed_loop import LONGEST_OVERTIME, Simulation, sensed_by
from .machine_process import MachineProcess, TrueState
from .perception import Perception
from .plant import Plant
from .sensing_process import SensingProcess

_log = logging.getLogger(__name__)
_LEAD_TIME = 0.1  # [s] from now to time 0
_STOPPING_TIME = 1.0  # [s] in which a machine stops that gets no commands
_WORLD_PERIOD = 0.0099  # [s] from one step of pedestrians and sensors to the next


class MachineView:
    """Workspace: the last true state of the machine, which runs in a process of its own."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant  # as it was before it was sent there
        self.state: TrueState = TrueState(0.0, plant.coordinates, plant.v, plant.motors, commanded=False)

    def __getattr__(self, name: str) -> object:
        return getattr(self._plant, name)

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        return self.state.time

    @property
    def coordinates(self) -> Array:
        """(nv,) true configuration as a coordinate row."""
        return self.state.coordinates

    @property
    def v(self) -> Array:
        """(nv,) true velocity."""
        return self.state.v

    @property
    def motors(self) -> Array:
        """(k,) true speeds of the drive's motors."""
        return self.state.motors


class _Steps:
    """Workspace: which of the machine's states are steps of the world; of the same states always the same."""

    def __init__(self) -> None:
        self._last = -np.inf  # [s]

    def next(self, state: TrueState) -> bool:
        """Whether the next state is one."""
        if state.time < self._last + _WORLD_PERIOD:
            return False
        self._last = state.time
        return True


class RealtimeSimulation(Simulation[Controller]):
    """Workspace: a :class:`Simulation` whose machine and executor run in processes of their own, on the wall clock.

    Args:
        controller: the controller whose executor is ``executor``.
        executor: the executor, not started yet.
        make_plant: makes the machine in its process; can be pickled.
        plant: a plant like it, at the start.
        world, perception, goal, watch, metadata: as for the :class:`Simulation`.
        log: file that the executor writes while it drives.
        temporary: whether the log is removed after the run, or if there is no run.
        eager: whether planning goes on without a pause, rather than at the planning rate.

    Attributes:
        machine: the machine's process, while it runs; else None.
        executor: the controller's executor.
        log: file of the executor's log.
    """

    def __init__(
        self,
        controller: Controller,
        executor: ExecutorProcess,
        world: World,
        make_plant: Callable[[], Plant],
        plant: Plant,
        perception: Perception,
        *,
        goal: Array | None = None,
        watch: Callable[[RealtimeSimulation], object] | None = None,
        metadata: dict[str, object] | None = None,
        log: str | os.PathLike[str],
        temporary: bool = False,
        eager: bool = False,
    ) -> None:
        self.view: MachineView = MachineView(plant)
        super().__init__(
            controller,
            world,
            cast("Plant", self.view),
            perception,
            goal=goal,
            metadata=metadata,
            realtime=True,
            watch=cast("Callable[[Simulation[Controller]], object] | None", watch),
        )
        self.executor: ExecutorProcess = executor
        self.machine: MachineProcess | None = None
        self.eager: bool = eager
        self.log: Path = Path(log)
        self._cleaned = weakref.finalize(self, Path.unlink, self.log, missing_ok=True) if temporary else None
        self._make_plant = make_plant
        self._truth: list[TrueState] = []
        self._come: deque[TrueState] = deque()  # states that this process has not looked at yet
        self._fed = False  # whether a thread takes them from the machine
        self._steps = _Steps()

    def run(self, *, time_limit: float | None = None) -> DriveResult:
        """Drive until the last goal is reached, the time is up, or :meth:`stop` was called."""
        params, controller, executor = self.params, self.controller, self.executor
        limit = params.time_limit if time_limit is None else check_number("time_limit", time_limit, low=0.0, unit="s")
        began = time.perf_counter()
        try:
            with ExitStack() as stack:
                stack.callback(controller.close)
                self.machine = machine = stack.enter_context(
                    MachineProcess(self._make_plant, self.view.coordinates, paused=True)
                )
                stack.enter_context(executor)
                executor.start(machine.driver())
                controller.warm_up()
                epoch = time.monotonic() + _LEAD_TIME
                machine.begin(epoch)
                executor.begin(epoch)
                with self._feeding(machine):
                    time.sleep(_LEAD_TIME)
                    self._drive(machine, limit)
            self._observe(machine)
            return self._result(time.perf_counter() - began)
        finally:
            self.machine = None
            if isinstance(self.perception, SensingProcess):
                self.perception.close()
            if self._cleaned is not None:
                self._cleaned()

    @contextmanager
    def _feeding(self, machine: MachineProcess) -> Iterator[None]:
        """Hand the machine's states on to the sensors' process meanwhile, where there is one, in a thread."""
        sensing, over = self.perception, threading.Event()
        if not isinstance(sensing, SensingProcess):
            yield
            return

        def feed() -> None:
            steps = _Steps()
            while not over.wait(_WORLD_PERIOD):
                states = machine.truth()
                self._come.extend(states)
                sensing.feed([state for state in states if steps.next(state)], self.executor.estimated)
                machine.touch(sensing.contact)

        self._fed, thread = True, threading.Thread(target=feed, name="sensors", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self._fed = False

    def _drive(self, machine: MachineProcess, limit: float) -> None:
        """Plan until the drive is over, the time ``limit`` [s] at the latest, and the robot stands."""
        controller, executor = self.controller, self.executor
        over = False
        while True:
            t = self.time = executor.now
            self._observe(machine)
            if t >= limit and not over:
                over = True
                controller.stop(f"time limit of {limit:g} s")
            sensed, trouble = sensed_by(self.perception, t)
            controller.sensing_took = executor.now - t
            controller.plan(t, sensed, trouble=trouble)
            if controller.tick is not None and controller.tick.time == t:
                self._after_tick(controller.tick)
            if ((controller.ended or controller.halted) and self._settled()) or t > limit + LONGEST_OVERTIME:
                return
            if not machine.alive:
                controller.log("fault", "the machine's process is gone")
                return
            if controller.state is RunState.FAILED:  # the executor is gone: the machine stops by itself
                time.sleep(_STOPPING_TIME)
                return
            if not self.eager:  # the perception's time is part of the tick
                time.sleep(max(0.0, t + controller.pause - executor.now))

    def _observe(self, machine: MachineProcess) -> None:
        """Take in the machine's states, and let the world go on."""
        if not self._fed:
            self._come.extend(machine.truth())
        while self._come:
            state = self._come.popleft()
            self._truth.append(state)
            if not self._steps.next(state):
                continue
            self.view.state = state
            self.perception.observe(state.time, state.coordinates, self.controller.estimate)
            self.pedestrians.step(state.time, state.coordinates, state.v)
        if not self._fed:
            machine.touch(self.perception.contact)

    def _result(self, seconds: float) -> DriveResult:
        rows: list[dict[str, object]] = []
        try:
            rows = read_log(self.log)
        except RecordError as error:  # what the machine did is known, and is not to be lost
            _log.warning("%s; nothing of it is recorded", error)
            self.executor.run.events.append(Event(self.time, "fault", str(error)))
        _record(self, rows)
        return replace(super()._result(seconds), compute="realtime")


def _record(driven: RealtimeSimulation, rows: Sequence[dict[str, object]]) -> None:
    """Record the machine's states, period by period, with the executor's log of the same time."""
    dt, nan, state = driven.params.control_dt, [np.nan] * driven.robot.nv, int(RunState.STOPPED)
    written = {round(float(str(row["t"])) / dt): row for row in rows if "event" not in row}
    last = -1
    for truth in [*driven._truth] or [driven.view.state]:
        k = int(truth.time / dt + 1e-6)
        if k == last:
            continue
        last, row = k, written.get(k, {})
        state = int(str(row.get("state", state)))

        def values(name: str, row: dict[str, object] = row, empty: Sequence[float] = nan) -> Array:
            return np.array(row.get(name, empty), dtype=float)

        driven.recorder.control(
            truth.time,
            coordinates=truth.coordinates,
            v=truth.v,
            motors=truth.motors,
            reference=values("reference"),
            reference_v=values("reference_v"),
            estimate=values("estimate"),
            drive=values("drive") if row else None,
            joints=values("joints") if row else None,
            state=state,
        )
