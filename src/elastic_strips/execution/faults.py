"""Execution room, faults: what can go wrong around the loop, put in on purpose to see that the robot ends at rest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import ParameterError, nearest_name
from ..validation import check_type, shown

FAULTS = {
    "scene_frozen": "the scene is not renewed",
    "scene_late": "the scene comes 0.3 s late",
    "nan_obstacle": "an obstacle's pose is not a number",
    "planning_exception": "the planning tick raises an exception",
    "slow_tick": "the planning tick takes ten times its budget",
    "lost_odometry": "neither wheel travel nor position is measured",
    "viewer_killed": "the viewer's process dies",
}
SCENE_DELAY = 0.3
"""Lateness [s] of the fault ``scene_late``."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a run.

    Attributes:
        kind: one of ``FAULTS``.
        start: when it begins [s].
        duration: how long it lasts [s].
    """

    kind: str
    start: float
    duration: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise ParameterError(f"fault {self.kind!r} is unknown{nearest_name(self.kind, FAULTS)}")
        for name in ("start", "duration"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise ParameterError(f"fault {self.kind}: {name}={value!r} must be finite and ≥ 0 s")

    def active(self, t: float) -> bool:
        """Whether it is there at time ``t`` [s]."""
        return self.start <= t < self.start + self.duration

    @staticmethod
    def parse(text: str) -> Fault:
        """A fault from ``kind@start`` or ``kind@start:duration``.

        Raises:
            ParameterError: anything else.
        """
        check_type("a fault", text, str)
        kind, _, rest = text.partition("@")
        start, _, duration = rest.partition(":")
        try:
            return Fault(kind, float(start or 0.0), float(duration or 1.0))
        except ValueError as error:
            if isinstance(error, ParameterError):
                raise
            raise ParameterError(f"fault {text!r} must read kind@start or kind@start:duration, in seconds") from None


class FaultPlan:
    """The faults of a run, asked by name and time."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        if not isinstance(faults, Iterable) or isinstance(faults, (str, bytes)):
            raise ParameterError(f"faults={shown(faults)} must be a list of Faults")
        self.faults = tuple(faults)
        for fault in self.faults:
            check_type("a fault", fault, Fault)

    def active(self, kind: str, t: float) -> bool:
        """Whether a fault of that kind is there at time ``t`` [s]."""
        return any(f.kind == kind and f.active(t) for f in self.faults)
