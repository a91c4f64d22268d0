"""Execution room, result: what a run came to, beside its record."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

from ..summary import Summary
from .record import Event, Record, RunState


@dataclass(slots=True, repr=False)
class TickStatistics(Summary):
    """Durations of planning ticks by the wall clock.

    Attributes:
        seconds: of every tick [s].
        misses: ticks that took longer than they had.
    """

    seconds: array[float] = field(default_factory=lambda: array("d"))
    misses: int = 0

    def add(self, seconds: float, budget: float) -> None:
        """Count a tick."""
        self.seconds.append(seconds)
        self.misses += seconds > budget

    def percentiles(self) -> dict[str, float]:
        """p50, p95 and p99 [ms]; NaN without ticks."""
        values = 1e3 * np.array(self.seconds if len(self.seconds) else [np.nan])
        return {f"p{p}": float(np.percentile(values, p)) for p in (50, 95, 99)}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriveResult(Summary):
    """What a run came to.

    Attributes:
        record: everything that was written down.
        state, reason: what the robot was doing at the end, and why.
        stops: (time [s], reason) of every stop short of the goal.
        events: in order of time.
        replans: how often the way was planned anew.
        statistics: durations of the planning ticks.
        seconds: duration of the run by the wall clock [s].
    """

    record: Record
    state: RunState
    reason: str
    stops: tuple[tuple[float, str], ...]
    events: tuple[Event, ...]
    replans: int
    statistics: TickStatistics
    seconds: float

    def _summary(self) -> dict[str, object]:
        return {
            "state": self.state.name.lower(), "reason": self.reason, "time": f"{self.record.duration:.2f} s",
            "stops": len(self.stops), "events": len(self.events), "replans": self.replans, "seconds": self.seconds,
        }  # fmt: skip

    @property
    def reached(self) -> bool:
        """Whether the robot stands at the goal by its own account."""
        return self.state is RunState.REACHED
