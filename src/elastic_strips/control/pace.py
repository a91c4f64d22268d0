"""Pace: how long control periods last and planning takes, when a motion that is planned now can begin, and what a tick
still has time for."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from .params import DriveParams

_REMEMBERED_PERIODS, _FEWEST_PERIODS = 15, 2
"""Control periods whose median counts, the lower one of two, and the fewest of them."""
_SAME_PERIOD = 0.05
"""Part of the nominal period by which the measured one may differ and is the same."""
_SAME_STEP = 1e-6  # of a period, which a tick may take longer
_REMEMBERED_TICKS = 20
"""Durations of ticks that are remembered."""
_TICK_QUANTILE, _TICK_RESERVE = 0.9, 1.1
"""Most ticks have to be in time; one that is not costs one motion, and the held one goes on meanwhile."""
_WAITING_SHARE = 0.4
"""Part of the time until a motion begins that work which can wait for the next tick may take: certificate and timing of
its result need the rest."""


class ControlPeriod:
    """Workspace: how long a control period lasts, by the times of the last steps.

    Args:
        nominal: the period [s] that counts until it is known, and where the measured one is about the same.

    Attributes:
        seconds: the period [s].
    """

    def __init__(self, nominal: float) -> None:
        self.seconds: float = nominal
        self._nominal = nominal
        self._spans: deque[float] = deque(maxlen=_REMEMBERED_PERIODS)

    def note(self, span: float) -> None:
        """Take note of the time [s] between two steps."""
        self._spans.append(span)
        if len(self._spans) >= _FEWEST_PERIODS:
            measured = sorted(self._spans)[(len(self._spans) - 1) // 2]
            same = abs(measured - self._nominal) <= _SAME_PERIOD * self._nominal
            self.seconds = self._nominal if same else measured


class Pace:
    """Workspace: durations of the last planning ticks, and the budget of the present one.

    Args:
        params: parameters of the drive, with the least latency.
        meter: reading [s] of the clock that computing is measured with; None where it takes no time.
        transfer: control periods that a motion takes to the executor.

    Attributes:
        period: how long a control period lasts [s], where that is measured.
    """

    def __init__(self, params: DriveParams, meter: Callable[[], float] | None, transfer: int = 0) -> None:
        self.transfer: int = transfer
        self.params: DriveParams = params
        self.meter: Callable[[], float] | None = meter
        self.period: float = params.control_dt
        self._expected: float = 0.0  # [s] that most ticks take
        self._seconds: deque[float] = deque(maxlen=_REMEMBERED_TICKS)
        self._periods: int = 0  # that most ticks take
        self._began = self._end = 0.0

    @property
    def periods(self) -> int:
        """Control periods from a tick to the beginning of its motion."""
        return max(self.params.latency, self._periods) + self.transfer

    @property
    def latency(self) -> float:
        """Time [s] from a tick to the beginning of its motion: until the first step that can hand it over."""
        nominal = self.periods * self.params.control_dt
        if self.meter is None or self.period <= self.params.control_dt:
            return nominal
        steps = max(1, math.ceil(self._expected / self.period - _SAME_STEP))
        return max(nominal, steps * self.period)

    @property
    def every(self) -> int:
        """Control periods from one tick to the next, as long as they take now."""
        return max(self.params.plan_every, self.periods if self.slow else 0)

    @property
    def slow(self) -> bool:
        """Whether planning takes longer than ``DriveParams.latency``."""
        return self.periods > self.params.latency + self.transfer

    def begin(self, spent: float = 0.0) -> None:
        """A tick begins, and has time until its motion begins; ``spent`` [s] were spent on its scene already."""
        if self.meter is not None:
            self._began = self.meter() - spent
            self._end = self._began + self.latency

    def finish(self, *, full: bool) -> float:
        """A tick has ended; ``full`` where it planned a motion. Returns what it took [s]."""
        if self.meter is None:
            return 0.0
        seconds = self.meter() - self._began
        if full:
            self._seconds.append(seconds)
            self._expected = _TICK_RESERVE * float(np.quantile(self._seconds, _TICK_QUANTILE))
            self._periods = math.ceil(self._expected / self.params.control_dt)
        return seconds

    def has(self, seconds: float, *, waits: bool = False) -> bool:
        """Whether the tick has so much time left [s], or the part of it for what can wait for the next one."""
        end = self._began + _WAITING_SHARE * (self._end - self._began) if waits else self._end
        return self.meter is None or self.meter() + seconds <= end

    def reading(self) -> float:
        """Reading [s] of the meter; 0 without one."""
        return 0.0 if self.meter is None else self.meter()
