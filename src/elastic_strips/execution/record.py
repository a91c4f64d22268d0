"""Execution room, record: what a closed-loop run has written down, as frozen values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import InputError
from ..robot import BaseKind, RobotModel
from ..robot.space import Array
from ..scene import World
from ..summary import Summary

DRIVE_NAMES = {
    BaseKind.DIFF_DRIVE: ("left", "right"),
    BaseKind.OMNI: ("x", "y", "yaw"),
    BaseKind.FIXED: (),
}
"""Names of the drive coordinates of each kind of base."""


class RecordError(InputError):
    """A record cannot be made, written or read; the message says what is wrong with it."""


class RunState(IntEnum):
    """What the robot is doing; a record keeps the names beside the codes.

    ``MOVING``: it follows its reference. ``SLOWING``: it brakes. ``STOPPED``: it stands and waits. ``REACHED``: it is
    at the goal. ``FAILED``: the run ended elsewhere.
    """

    MOVING = 0
    SLOWING = 1
    STOPPED = 2
    REACHED = 3
    FAILED = 4


STATES = tuple(state.name.lower() for state in RunState)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ControlRows(Summary):
    """One row a control step (T of them), arrays read-only; NaN where something was not known.

    Attributes:
        time: (T,) strictly ascending [s].
        chart, v: (T, nv) true chart rows and velocities (body twist, joint rates).
        reference, reference_v: (T, nv) chart rows and velocities that the controller followed.
        estimate: (T, nv) chart rows that the controller believed.
        drive: (T, k) commanded drive speeds [m/s; rad/s for an omnidirectional base's yaw].
        joints: (T, n) commanded joint rates [rad/s or m/s].
        motors: (T, k) true speeds of the drive's motors, at the rim and without slip [m/s; rad/s for a yaw].
        state: (T,) uint8 codes, see ``Record.states``.
    """

    time: Array
    chart: Array
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
    """One row a tick of the planner (P of them), arrays read-only; NaN where something was not known.

    Attributes:
        time: (P,) ascending [s].
        tick_ms: (P,) duration of the tick by the wall clock [ms].
        phase_ms: (P, F) of it by phase [ms]; phases: their names (F).
        status: (P,) uint8 index into ``statuses``: the state of the strip.
        certified: (P,) whether the strip (or its horizon) was certified.
        clearance: (P,) [m].
        horizon_end: (P,) time up to which motion was certified and at whose end the robot can stand [s].
        node_offset: (P + 1,) rows of ``nodes`` from ``node_offset[i]`` to ``node_offset[i + 1]`` are tick i's strip.
        nodes: (M, nv) chart rows of all strips that were kept.
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
        """Chart rows (N, nv) of the strip of a tick; (0, nv) where it was not kept."""
        return self.nodes[self.node_offset[row] : self.node_offset[row + 1]]

    def row_at(self, time: float) -> int:
        """The last tick at or before ``time`` [s]; −1 before the first."""
        return int(np.searchsorted(self.time, time, side="right")) - 1


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened once: time [s], kind (one word) and what there is to say about it."""

    time: float
    kind: str
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Record(Summary):
    """Everything that a run wrote down.

    Attributes:
        robot: name of the robot; base: how its base moves; joint_names: its planned joints.
        locked: values of the joints that were held still [rad or m].
        urdf: absolute path of the robot's URDF, or None.
        control, planning: rows at the control rate and at the planning rate.
        events: in the order of time.
        world: the true obstacles over time; one that was read from a file follows the recorded poses.
        goal: (nv,) chart row that the robot was to reach, or None.
        states: names of the codes in ``control.state``.
        metadata: whatever the run wants to keep besides: scenario, seed, …; plain JSON values.
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
    states: tuple[str, ...] = STATES
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def _summary(self) -> dict[str, object]:
        return {
            "robot": self.robot, "base": self.base.value, "rows": len(self.control.time),
            "time": f"{self.duration:.2f} s", "obstacles": len(self.world.scene), "events": len(self.events),
        }  # fmt: skip

    @property
    def drive_names(self) -> tuple[str, ...]:
        """Names of the drive coordinates."""
        return DRIVE_NAMES[self.base]

    @property
    def duration(self) -> float:
        """Time between the first and the last control row [s]."""
        return float(self.control.time[-1] - self.control.time[0])

    def check_robot(self, robot: RobotModel) -> None:
        """Refuse a robot that is not the recorded one.

        Raises:
            RecordError: its base or its planned joints are others.
        """
        if robot.base_kind is not self.base or robot.joint_names != self.joint_names:
            raise RecordError(
                f"the record is of {self.robot!r} ({self.base.value}: {', '.join(self.joint_names)}); "
                f"{robot.name!r} is {robot.base_kind.value}: {', '.join(robot.joint_names)}"
            )


def frozen(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The array, read-only."""
    array.setflags(write=False)
    return array
