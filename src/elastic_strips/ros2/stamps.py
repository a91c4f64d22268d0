"""Stamps: what was when: ROS' time stamps on the executor's clock, and rows of numbers between their samples."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.validation import check_number

from .messages import MessageError

_AT_ONCE = 2e-4  # [s] within which two clocks are read; else they are read again,
_TRIES = 5  # so often at most
_KEPT = 2.0  # [s] that samples are kept
_INTERVALS = 31  # from one sample to the next, whose median is the period


def read_together(ros: Callable[[], int], monotonic: Callable[[], float] = time.monotonic) -> tuple[int, float]:
    """ROS' clock [ns] and the monotonic one [s], read at the same time.

    Another thread may come between one reading and the next, and what was measured would be as much younger.
    """
    best, found = math.inf, (0, 0.0)
    for _ in range(_TRIES):
        before, now, after = monotonic(), ros(), monotonic()
        if after - before < best:
            best, found = after - before, (now, 0.5 * (before + after))
        if best <= _AT_ONCE:
            break
    return found


class StampClock:
    """Workspace: brings time stamps to the executor's clock, by their age: ROS' clock may jump, an age is short.

    Args:
        oldest: largest age [s] of what is still used.
        ahead: largest time [s] by which a stamp may be later than now: clocks of two machines differ a little.

    Attributes:
        epoch: reading of the monotonic clock [s] at which the executor's time is 0.
    """

    def __init__(self, oldest: float, ahead: float = 0.01) -> None:
        self.oldest: float = check_number("oldest", oldest, above=0.0, unit="s")
        self.ahead: float = check_number("ahead", ahead, low=0.0, unit="s")
        self.epoch: float = math.inf

    def tick(self, t: float, monotonic: float) -> None:
        """Learn the epoch where nobody says it: what is to be done at ``t`` [s] is done then, or late."""
        self.epoch = min(self.epoch, monotonic - t)

    def now(self, monotonic: float) -> float:
        """The time of what has no stamp [s]: that of the monotonic clock."""
        return monotonic - self.epoch

    def time(self, stamp: int, now: int, monotonic: float, ahead: float | None = None) -> float:
        """The time of a stamp on the executor's clock [s]; never later than now.

        Args:
            stamp: the stamp [ns].
            now: ROS' clock [ns], read
            monotonic: at this reading of the monotonic clock [s].
            ahead: as in the constructor, for stamps that say until when something holds.

        Raises:
            MessageError: the stamp is too far from now: the clocks of two machines differ, say.
        """
        age, most = 1e-9 * (now - stamp), self.ahead if ahead is None else ahead
        if age < -most:
            raise MessageError(f"a time stamp is {-age:.3g} s ahead of the clock; at most {most:g} s is believed")
        if age > self.oldest:
            raise MessageError(f"a time stamp is {age:.3g} s old; at most {self.oldest:g} s is used")
        return monotonic - self.epoch - max(age, 0.0)


class StampedRows:
    """Workspace: rows of numbers at ascending times, such as poses, interpolated between the last ones.

    Args:
        turns: which of the numbers are angles that may wrap [rad]; the shorter turn is taken.
        gap: largest time [s] between two samples that is interpolated over.
    """

    def __init__(self, turns: Sequence[int] = (), gap: float = 0.5) -> None:
        self._turns, self._gap = list(turns), gap
        self._entries: deque[tuple[float, Array]] = deque()

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def newest(self) -> float:
        """Time of the newest row [s]; −inf without one."""
        return self._entries[-1][0] if self._entries else -math.inf

    @property
    def oldest(self) -> float:
        """Time of the oldest row that is kept [s]; inf without one."""
        return self._entries[0][0] if self._entries else math.inf

    @property
    def period(self) -> float:
        """Median time from one row to the next [s]; inf where there are fewer than ten."""
        times = [t for t, _ in list(self._entries)[-_INTERVALS:]]
        return float(np.median(np.diff(times))) if len(times) >= 10 else math.inf

    def add(self, t: float, row: Array) -> None:
        """Add a row at a time [s].

        Raises:
            MessageError: it is not later than the last one.
        """
        if not t > self.newest:
            raise MessageError(f"a message of {t:.3f} s comes after, or twice, the one of {self.newest:.3f} s")
        self._entries.append((t, np.array(row, dtype=float)))
        while self._entries[0][0] < t - _KEPT:
            self._entries.popleft()

    def last(self) -> Array:
        """The newest row."""
        return self._entries[-1][1]

    def at(self, t: float) -> Array:
        """The row at a time [s].

        Raises:
            MessageError: it is older than what is kept, newer than what has come, or in a gap.
        """
        entries = self._entries
        if not self.oldest - 1e-9 <= t <= self.newest + 1e-9:
            raise MessageError(f"nothing is known of {t:.3f} s: it is from {self.oldest:.3f} to {self.newest:.3f} s")
        after = next((k for k in range(len(entries) - 1, -1, -1) if entries[k][0] <= t), 0) + 1
        if after >= len(entries):
            return entries[-1][1].copy()
        (t0, a), (t1, b) = entries[after - 1], entries[after]
        if t1 - t0 > self._gap:
            raise MessageError(f"nothing is known of {t:.3f} s: nothing came from {t0:.3f} to {t1:.3f} s")
        step = b - a
        for k in self._turns:
            step[k] = math.remainder(step[k], 2.0 * math.pi)
        return a + max(0.0, (t - t0) / (t1 - t0)) * step
