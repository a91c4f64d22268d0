"""Progress of long work, as lines of the log: the library never prints."""

from __future__ import annotations

import logging
from time import perf_counter

LOGGER = "elastic_strips.progress"
"""Name of the logger; the command line shows its lines (level INFO) where standard error is a terminal."""

_log = logging.getLogger(LOGGER)
PROGRESS_PERIOD = 2.0
"""How long nothing is said, at first and after each line [s]."""


class LoggedProgress:
    """Says how far something is, once it has taken two seconds, and every two seconds from then on.

    Args:
        what: what is being done, such as "decomposing a mesh of 500000 triangles".
        unit: what is counted, such as "bodies".
        total: how many of them there are.
    """

    def __init__(self, what: str, unit: str, total: int) -> None:
        self._what, self._unit, self._total = what, unit, total
        self._begun = self._said = perf_counter()
        self._done = 0

    def step(self) -> None:
        """One more is done."""
        self._done += 1
        now = perf_counter()
        if now - self._said > PROGRESS_PERIOD and self._done < self._total:
            self._said = now
            _log.info(
                "%s: %d of %d %s after %.0f s", self._what, self._done, self._total, self._unit, now - self._begun
            )
