"""Phase clock: mutually exclusive phases of a tick that sum to it."""

from __future__ import annotations

from time import perf_counter


class PhaseClock:
    """Accounts time to phases; what passes between two marks belongs to the phase of the later mark."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        self.phases: dict[str, float] = {}
        self._begin = self._last = perf_counter()

    def mark(self, phase: str) -> None:
        """Account the time since the last mark to ``phase``."""
        now = perf_counter()
        self.phases[phase] = self.phases.get(phase, 0.0) + now - self._last
        self._last = now

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return perf_counter() - self._begin

    def total(self) -> float:
        """Sum of all phases [s]."""
        return sum(self.phases.values())
