"""Execution room, recorder: takes down what a run does while it goes on; a row costs microseconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Scene, World
from ..scene.yielding import copied
from .record import DRIVE_NAMES, STATES, ControlRows, Event, PlanningRows, Record, RecordError, RunState, frozen


class _Rows:
    """Workspace: rows of numbers that grow by doubling."""

    def __init__(self, width: int, capacity: int) -> None:
        self.data = np.full((max(capacity, 1), width), np.nan)
        self.n = 0

    def next(self) -> Array:
        """The next row, NaN all over, to be written into."""
        if self.n == len(self.data):
            self.data = np.concatenate((self.data, np.full_like(self.data, np.nan)))
        self.n += 1
        return self.data[self.n - 1]

    def columns(self, begin: int, end: int) -> Array:
        """A frozen copy of some columns."""
        return frozen(self.data[: self.n, begin:end].copy())


class Recorder:
    """Workspace: takes rows while a run goes on; ``finish`` makes the record of them."""

    def __init__(
        self,
        robot: RobotModel,
        world: World | Scene,
        *,
        goal: npt.ArrayLike | None = None,
        states: Sequence[str] = STATES,
        strip_every: int = 1,
        capacity: int = 4096,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        """Start with no rows.

        Args:
            robot: who drives.
            world: the true obstacles.
            goal: (nv,) chart row to be reached.
            states: names of the state codes.
            strip_every: keep the strip of every so many ticks; 0 keeps none.
            capacity: control rows that are allocated at once.
            metadata: plain JSON values to keep with the record.

        Raises:
            RecordError: a goal of the wrong size, ``strip_every`` or the number of states out of range.
        """
        if strip_every < 0:
            raise RecordError(f"strip_every = {strip_every} must be at least 0 (0: keep no strips)")
        if not 0 < len(states) <= 256:
            raise RecordError(f"{len(states)} states given; 1 to 256 fit into a byte")
        nv, k, n = robot.nv, len(DRIVE_NAMES[robot.base_kind]), len(robot.joint_names)
        self._robot = robot
        self._world = world if isinstance(world, World) else World(world)
        self._goal = None if goal is None else frozen(np.array(goal, dtype=float))
        if self._goal is not None and self._goal.shape != (nv,):
            raise RecordError(f"the goal has shape {self._goal.shape}; a chart row of {robot.name!r} has ({nv},)")
        self._states, self._every, self._metadata = tuple(states), strip_every, dict(metadata or {})
        cuts = np.cumsum([0, 1, nv, nv, nv, nv, nv, k, n, k]).tolist()
        self._slices = [slice(a, b) for a, b in pairwise(cuts)]
        self._names = [f.name for f in fields(ControlRows)][:-1]
        self._rows = _Rows(cuts[-1], capacity)
        self._codes: list[int] = []
        self._ticks: list[tuple[float, float, Mapping[str, float], str, bool, float, float, str]] = []
        self._strips: list[Array] = []
        self._events: list[Event] = []
        self._last = -np.inf

    def __len__(self) -> int:
        return self._rows.n

    @property
    def drive_dim(self) -> int:
        """Number k of drive coordinates."""
        return len(DRIVE_NAMES[self._robot.base_kind])

    def control(
        self,
        time: float,
        *,
        chart: Array,
        v: Array,
        reference: Array | None = None,
        reference_v: Array | None = None,
        estimate: Array | None = None,
        drive: Array | None = None,
        joints: Array | None = None,
        motors: Array | None = None,
        state: int = RunState.MOVING,
    ) -> None:
        """Add a control row; the arguments are those of `ControlRows`, None where there is nothing to write.

        Raises:
            RecordError: a time that is not later than the last one, an array of another size, an unknown state.
        """
        if not time > self._last:
            raise RecordError(f"control rows ascend in time: {time!r} s after {self._last!r} s")
        if not 0 <= state < len(self._states):
            raise RecordError(f"state {state} has no name; there are {len(self._states)}: {', '.join(self._states)}")
        given = (time, chart, v, reference, reference_v, estimate, drive, joints, motors)
        for values, name, where in zip(given[1:], self._names[1:], self._slices[1:], strict=True):
            if values is not None and np.shape(values) != (where.stop - where.start,):
                raise RecordError(f"{name} has shape {np.shape(values)}; it must be ({where.stop - where.start},)")
        self._last = float(time)
        self._codes.append(int(state))
        row = self._rows.next()
        for values, where in zip(given, self._slices, strict=True):
            if values is not None:
                row[where] = values

    def planning(
        self,
        time: float,
        *,
        tick_ms: float = np.nan,
        phase_ms: Mapping[str, float] | None = None,
        status: str = "",
        certified: bool = False,
        clearance: float = np.nan,
        horizon_end: float = np.nan,
        strip: Array | None = None,
        reason: str = "",
    ) -> None:
        """Add a tick of the planner; ``strip`` are chart rows (N, nv), the rest is as in `PlanningRows`."""
        keep = strip is not None and self._every > 0 and len(self._ticks) % self._every == 0
        none = np.zeros((0, self._robot.nv))
        self._strips.append(np.array(strip, dtype=float) if keep else none)
        self._ticks.append(
            (time, tick_ms, dict(phase_ms or {}), str(status), bool(certified), clearance, horizon_end, str(reason))
        )

    def event(self, time: float, kind: str, reason: str = "") -> None:
        """Note something that happened once."""
        self._events.append(Event(float(time), str(kind), str(reason)))

    def finish(self, **metadata: Any) -> Record:
        """Freeze what was recorded, with more ``metadata``; recording may go on.

        Raises:
            RecordError: there is no control row, or a strip is not (N, nv).
        """
        if not self._rows.n:
            raise RecordError("there is no control row; a record needs at least one")
        robot = self._robot
        columns = {n: self._rows.columns(s.start, s.stop) for n, s in zip(self._names, self._slices, strict=True)}
        columns["time"] = frozen(columns["time"][:, 0].copy())
        control = ControlRows(**columns, state=frozen(np.array(self._codes, dtype=np.uint8)))
        return Record(
            robot=robot.name,
            base=robot.base_kind,
            joint_names=tuple(robot.joint_names),
            locked=dict(robot.locked),
            urdf=robot.urdf_path,
            control=control,
            planning=self._planning(),
            events=tuple(sorted(self._events, key=lambda e: e.time)),
            world=copied(self._world),  # what a later run makes of it is not part of this one
            goal=self._goal,
            states=self._states,
            metadata={**self._metadata, **metadata},
        )

    def _planning(self) -> PlanningRows:
        nv = self._robot.nv
        for strip in self._strips:
            if strip.ndim != 2 or strip.shape[1] != nv:
                raise RecordError(f"a strip has shape {strip.shape}; chart rows of {self._robot.name!r} are (N, {nv})")
        columns = list(zip(*self._ticks, strict=True)) or [()] * 8
        phases = tuple(dict.fromkeys(name for tick in columns[2] for name in tick))
        statuses, reasons = tuple(dict.fromkeys(columns[3])), tuple(dict.fromkeys(columns[7]))
        if len(statuses) > 256:
            raise RecordError(f"{len(statuses)} different statuses; at most 256 fit into a byte")
        phase_ms = [[tick.get(name, np.nan) for name in phases] for tick in columns[2]]
        return PlanningRows(
            time=_column(columns[0]),
            tick_ms=_column(columns[1]),
            phase_ms=frozen(np.array(phase_ms, dtype=float).reshape(len(self._ticks), len(phases))),
            phases=phases,
            status=frozen(np.array([statuses.index(s) for s in columns[3]], dtype=np.uint8)),
            statuses=statuses,
            certified=frozen(np.array(columns[4], dtype=bool)),
            clearance=_column(columns[5]),
            horizon_end=_column(columns[6]),
            node_offset=frozen(np.cumsum([0, *map(len, self._strips)], dtype=np.int64)),
            nodes=frozen(np.concatenate([np.zeros((0, nv)), *self._strips])),
            reason=frozen(np.array([reasons.index(r) for r in columns[7]], dtype=np.int32)),
            reasons=reasons,
        )


def _column(values: Sequence[float]) -> Array:
    return frozen(np.array(values, dtype=float))
