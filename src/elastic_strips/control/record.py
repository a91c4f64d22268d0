"""Record: frozen data of a run, and the recorder that collects it."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.summary import Summary

from .interfaces import Event, GoalReached, RunState
from .seen_rows import SeenLog, SeenRows

_Array = TypeVar("_Array", bound=np.ndarray)

DRIVE_NAMES: dict[BaseKind, tuple[str, ...]] = {
    BaseKind.DIFF_DRIVE: ("left", "right"),
    BaseKind.OMNI: ("x", "y", "yaw"),
    BaseKind.FIXED: (),
}
"""Names of the drive coordinates of each kind of base."""


class RecordError(InputError):
    """A record cannot be made, written or read; the message says what is wrong with it."""


STATES = tuple(state.label for state in RunState)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ControlRows(Summary):
    """One row for each control step (T of them), arrays read-only; NaN where a value is unknown.

    Attributes:
        time: (T,) strictly ascending [s].
        coordinates, v: (T, nv) true coordinate rows and velocities (body twist, joint rates).
        reference, reference_v: (T, nv) coordinate rows and velocities of the reference.
        estimate: (T, nv) estimated coordinate rows.
        drive: (T, k) commanded drive speeds [m/s; rad/s for an omnidirectional base's yaw].
        joints: (T, n) commanded joint rates [rad/s or m/s].
        motors: (T, k) true speeds of the drive's motors, at the rim and without slip [m/s; rad/s for a yaw].
        state: (T,) uint8 codes, see ``Record.states``.
    """

    time: Array
    coordinates: Array
    v: Array
    reference: Array
    reference_v: Array
    estimate: Array
    drive: Array
    joints: Array
    motors: Array
    state: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PlanningRows(Summary):
    """One row for each planning tick (P of them), arrays read-only; NaN where a value is unknown.

    Attributes:
        time: (P,) ascending [s].
        tick_ms: (P,) duration of the tick by the wall clock [ms].
        phase_ms: (P, F) its parts by phase [ms].
        phases: (F,) names of the phases.
        status: (P,) uint8 index into ``statuses``: the state of the strip.
        certified: (P,) whether the strip (or its horizon) was certified.
        clearance: (P,) clearance of the strip's nodes [m].
        horizon_end: (P,) time up to which motion is certified, and at which the robot can stand [s].
        node_offset: (P + 1,) rows of ``nodes`` from ``node_offset[i]`` to ``node_offset[i + 1]`` are tick i's strip.
        nodes: (M, nv) coordinate rows of all strips that were kept.
        reason: (P,) index into ``reasons``.
    """

    time: Array
    tick_ms: Array
    phase_ms: Array
    phases: tuple[str, ...]
    status: npt.NDArray[np.uint8]
    statuses: tuple[str, ...]
    certified: npt.NDArray[np.bool_]
    clearance: Array
    horizon_end: Array
    node_offset: npt.NDArray[np.int64]
    nodes: Array
    reason: npt.NDArray[np.int32]
    reasons: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.time)

    def strip(self, row: int) -> Array:
        """Coordinate rows (N, nv) of the strip of a tick; (0, nv) where it was not kept."""
        return self.nodes[self.node_offset[row] : self.node_offset[row + 1]]

    def row_at(self, time: float) -> int:
        """The last tick at or before ``time`` [s]; −1 before the first."""
        return int(np.searchsorted(self.time, time, side="right")) - 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Record(Summary):
    """All recorded data of a run.

    Attributes:
        robot: name of the robot.
        base: how its base moves.
        joint_names: its planned joints.
        locked: values of the joints that were held still [rad or m].
        urdf: absolute path of the robot's URDF, or None.
        control, planning: rows at the control rate and at the planning rate.
        events: in order of time.
        world: the true obstacles over time; in a record from a file they follow the recorded poses.
        goal: (nv,) coordinate row of the goal, or None.
        seen: what sensors made of the world, where the robot drove by them.
        states: names of the codes in ``control.state``.
        metadata: further plain JSON values: scenario, seed, ….
    """

    robot: str
    base: BaseKind
    joint_names: tuple[str, ...]
    locked: Mapping[str, float]
    urdf: str | None
    control: ControlRows
    planning: PlanningRows
    events: tuple[Event, ...]
    world: World
    goal: Array | None
    seen: SeenRows = field(default_factory=lambda: SeenLog().rows(0.0))
    states: tuple[str, ...] = STATES
    metadata: Mapping[str, object] = field(default_factory=dict)

    def _summary(self) -> dict[str, object]:
        return {
            "robot": self.robot,
            "base": self.base.value,
            "rows": len(self.control.time),
            "time": f"{self.duration:.2f} s",
            "obstacles": len(self.world.scene),
            "events": len(self.events),
        }

    @property
    def drive_names(self) -> tuple[str, ...]:
        """Names of the drive coordinates."""
        return DRIVE_NAMES[self.base]

    @property
    def duration(self) -> float:
        """Time between the first and the last control row [s]."""
        return float(self.control.time[-1] - self.control.time[0])

    def check_robot(self, robot: RobotModel) -> None:
        """Check that a robot is the recorded one.

        Raises:
            RecordError: its base, its planned joints or those that it holds still differ.
        """
        if robot.base_kind is not self.base or robot.joint_names != self.joint_names:
            raise RecordError(
                f"the record is of {self.robot!r} ({self.base.value}: {', '.join(self.joint_names)}); "
                f"{robot.name!r} is {robot.base_kind.value}: {', '.join(robot.joint_names)}"
            )
        if odd := sorted(name for name, _ in set(robot.locked.items()) ^ set(self.locked.items())):
            raise RecordError(f"the record is of {self.robot!r}; {robot.name!r} holds {odd[0]!r} at another value")


def frozen(array: _Array) -> _Array:
    """The array, read-only."""
    array.setflags(write=False)
    return array


class Recorder:
    """Workspace: collects rows during a run; :meth:`finish` makes the record.

    Args:
        robot: the robot that drives.
        world: the true obstacles.
        goal: (nv,) coordinate row of the goal.
        metadata: plain JSON values to keep with the record.

    Raises:
        RecordError: a goal of the wrong size.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World | Scene,
        *,
        goal: npt.ArrayLike | None = None,
        metadata: Mapping[str, object] | None = None,
    ) -> None:
        nv, k, n = robot.nv, len(DRIVE_NAMES[robot.base_kind]), len(robot.joint_names)
        self._robot = robot
        self._world = world if isinstance(world, World) else World(world)
        self._goal: Array | None = None
        if goal is not None:
            self.lead_to(goal)
        self._metadata = dict(metadata or {})
        cuts = np.cumsum([0, 1, nv, nv, nv, nv, nv, k, n, k]).tolist()
        self._slices = [slice(a, b) for a, b in pairwise(cuts)]
        self._names = [f.name for f in fields(ControlRows)][:-1]
        self._rows: list[Array] = []
        self._codes: list[int] = []
        self._ticks: list[tuple[float, float, Mapping[str, float], str, bool, float, float, str]] = []
        self._strips: list[Array] = []
        self._events: list[Event] = []
        self._seen = SeenLog()
        self._last = -np.inf

    def __len__(self) -> int:
        return len(self._rows)

    def lead_to(self, goal: npt.ArrayLike) -> None:
        """The run leads to another goal, a coordinate row (nv,).

        Raises:
            RecordError: a goal of the wrong size.
        """
        row, nv = np.array(goal, dtype=float), self._robot.nv
        if row.shape != (nv,):
            raise RecordError(f"the goal has shape {row.shape}; a coordinate row of {self._robot.name!r} has ({nv},)")
        self._goal = frozen(row)

    def control(
        self,
        time: float,
        *,
        coordinates: Array,
        v: Array,
        reference: Array | None = None,
        reference_v: Array | None = None,
        estimate: Array | None = None,
        drive: Array | None = None,
        joints: Array | None = None,
        motors: Array | None = None,
        state: int = RunState.MOVING,
    ) -> None:
        """Add a control row; the arguments are as in :class:`ControlRows`, None where a value is unknown.

        Raises:
            RecordError: a time that is not later than the last one, an array of another size, an unknown state.
        """
        if not time > self._last:
            raise RecordError(f"control rows must ascend in time: {time!r} s after {self._last!r} s")
        if not 0 <= state < len(STATES):
            raise RecordError(f"state {state} has no name; there are {len(STATES)}: {', '.join(STATES)}")
        given = (time, coordinates, v, reference, reference_v, estimate, drive, joints, motors)
        for values, name, where in zip(given[1:], self._names[1:], self._slices[1:], strict=True):
            if values is not None and np.shape(values) != (where.stop - where.start,):
                raise RecordError(f"{name} has shape {np.shape(values)}; it must be ({where.stop - where.start},)")
        self._last = float(time)
        self._codes.append(int(state))
        row = np.full(self._slices[-1].stop, np.nan)
        for values, where in zip(given, self._slices, strict=True):
            if values is not None:
                row[where] = values
        self._rows.append(row)

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
        """Add a planning tick; ``strip`` are coordinate rows (N, nv), the rest is as in :class:`PlanningRows`."""
        self._strips.append(np.zeros((0, self._robot.nv)) if strip is None else np.array(strip, dtype=float))
        self._ticks.append(
            (time, tick_ms, dict(phase_ms or {}), str(status), bool(certified), clearance, horizon_end, str(reason))
        )

    def event(self, time: float, kind: str, reason: str = "") -> None:
        """Add an event at a time [s]: its kind in one word, and a reason."""
        self._events.append(Event(float(time), str(kind), str(reason)))

    def seen(self, time: float, scene: Scene) -> None:
        """Add what sensors make of the world at a time [s]; what comes within 0.25 s of the last is not kept."""
        self._seen.look(time, scene)

    def finish(self) -> Record:
        """Return the record so far; recording may go on.

        Raises:
            RecordError: there is no control row, or a strip is not (N, nv).
        """
        if not self._rows:
            raise RecordError("there is no control row; a record needs at least one")
        robot = self._robot
        rows = np.array(self._rows)
        columns = {n: frozen(rows[:, s].copy()) for n, s in zip(self._names, self._slices, strict=True)}
        columns["time"] = frozen(rows[:, 0].copy())
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
            world=self._world.copied(),  # later runs do not change it
            goal=self._goal,
            seen=self._seen.rows(float(control.time[-1])),
            metadata=dict(self._metadata),
        )

    def _planning(self) -> PlanningRows:
        nv = self._robot.nv
        for strip in self._strips:
            if strip.ndim != 2 or strip.shape[1] != nv:
                raise RecordError(
                    f"a strip has shape {strip.shape}; coordinate rows of {self._robot.name!r} are (N, {nv})"
                )
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


@dataclass(slots=True, repr=False)
class TickStatistics(Summary):
    """Durations of planning ticks by the wall clock.

    Attributes:
        seconds: duration of every tick [s].
        misses: ticks that took longer than they had.
    """

    seconds: array[float] = field(default_factory=lambda: array("d"))
    misses: int = 0

    def add(self, seconds: float, *, late: bool) -> None:
        """Add a tick of a duration [s]; ``late``: it took longer than it had."""
        self.seconds.append(seconds)
        self.misses += late

    def percentiles(self) -> dict[str, float]:
        """p50, p95 and p99 [ms]; NaN without ticks."""
        values = 1e3 * np.array(self.seconds if len(self.seconds) else [np.nan])
        return {f"p{p}": float(np.percentile(values, p)) for p in (50, 95, 99)}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriveResult(Summary):
    """Result of a run.

    Attributes:
        record: record of the run.
        state, reason: state of the robot at the end, and why.
        stops: (time [s], reason) of every stop short of the goal.
        events: in order of time.
        replans: number of plans after the first.
        statistics: durations of the planning ticks.
        seconds: duration of the run by the wall clock [s].
        compute: what computing cost. ``"free"``: nothing; ``"work"``: the time that is modelled for it; a number: this
            many times the measured processor time; ``"realtime"``: it ran against the wall clock.
        goals: those that were reached, in order of time.
    """

    record: Record
    state: RunState
    reason: str
    stops: tuple[tuple[float, str], ...]
    events: tuple[Event, ...]
    replans: int
    statistics: TickStatistics
    seconds: float
    compute: str | float = "free"
    goals: tuple[GoalReached, ...] = ()

    def _summary(self) -> dict[str, object]:
        return {
            "state": self.state.label,
            "reason": self.reason,
            "time": f"{self.record.duration:.2f} s",
            "stops": len(self.stops),
            "events": len(self.events),
            "replans": self.replans,
            "compute": self.compute,
            "seconds": self.seconds,
        }

    @property
    def reached(self) -> bool:
        """Whether the robot stands at the goal, by its own estimate."""
        return self.state is RunState.REACHED

    @property
    def last(self) -> Array:
        """(nv,) coordinates of the last reference."""
        return self.record.control.reference[-1].copy()
