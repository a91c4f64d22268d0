"""Deadline: how much is left of the time that a plan may take."""

from __future__ import annotations

from time import perf_counter


class Deadline:
    """A point in time, ``seconds`` from now.

    Args:
        seconds: how far ahead it is [s].
    """

    def __init__(self, seconds: float) -> None:
        self._began = perf_counter()
        self._end = self._began + seconds

    @property
    def spent(self) -> float:
        """Time [s] since it was set."""
        return perf_counter() - self._began

    @property
    def left(self) -> float:
        """Time [s] that is left; negative where it is over."""
        return self._end - perf_counter()

    def over(self) -> bool:
        """Whether the time is over."""
        return perf_counter() >= self._end
