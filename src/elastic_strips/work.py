"""Work: how much a thread has computed, counted where the time goes, and a model of the time that it takes.

Equal inputs make equal counts on every processor, as far as a limit of real time (a planner's) does not end the
computing before. Everything is counted once a batch: that costs nothing next to the batch.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from operator import mul

SECONDS_PER: dict[str, float] = {
    "batches": 0.6e-3,
    "pairs": 0.1e-6,
    "queries": 4.5e-6,
    "obstacles": 3e-6,
    "outlooks": 0.003e-6,
    "cells": 0.04e-6,
    "moves": 0.24e-6,
    "checks": 40e-6,
    "looks": 0.25e-6,
    "rays": 13e-6,
    "pixels": 1e-6,
}
"""Time of each [s] with the native kernel, including all work around it: fitted to 7,000 planning ticks, 9,400 readings
and 5,000 scenes of drives in corridors (with and without sensors; Silvermate, TIAGo) and in a furnished house. There,
and in five other drives, 94 % of the ticks, readings and scenes of more than 3 ms took between a half and twice what
these say, and all together 0.93 times that; plans of less than 0.2 s took up to ten times what these say, and all plans
together 1.26 times. Measured by themselves: cells, 0.01 µs each on large grids and 0.04 µs on those of first plans; and
looks in shelves and cages, 0.15 to 0.3 µs each of the Panda and 0.12 to 0.25 µs of the Fetch."""


@dataclass(frozen=True, slots=True)
class Work:
    """Amounts of computing.

    Attributes:
        batches: calls that work on all nodes or samples at once: kinematics, speed profiles, rolling projections,
            footprints; they stand for the cost of such a call whatever its size, and of the work around it.
            A single configuration makes none.
        pairs: distances of bodies and parts that were bounded.
        queries: distances that were measured exactly.
        obstacles: obstacles that were processed one by one.
        outlooks: distances of manoeuvres' poses to obstacles seen from above.
        cells: open cells of grids that were searched for one path.
        moves: moves between open cells of grids that were searched for paths of several classes.
        checks: configurations that were checked for a sampling planner.
        looks: configurations that a tree search looked at.
        rays: rays of sensors' readings that were taken in.
        pixels: pixels of depth images that were taken in; one of a range image, which looks all about, counts as two.
    """

    batches: int = 0
    pairs: int = 0
    queries: int = 0
    obstacles: int = 0
    outlooks: int = 0
    cells: int = 0
    moves: int = 0
    checks: int = 0
    looks: int = 0
    rays: int = 0
    pixels: int = 0

    def __sub__(self, before: Work) -> Work:
        return Work(*(now - then for now, then in zip(astuple(self), astuple(before), strict=True)))

    @property
    def seconds(self) -> float:
        """Modelled time [s] on the processor that the model was fitted on."""
        return sum(getattr(self, name) * each for name, each in SECONDS_PER.items())


class _Counts(threading.local):
    """Workspace: amounts of the calling thread, in the order of :class:`Work`."""

    def __init__(self) -> None:
        self.amounts = [0] * len(SECONDS_PER)
        self.bounds = False  # whether limits of time are limits of work


_COUNTS = _Counts()


def count_work(
    *,
    batches: int = 0,
    pairs: int = 0,
    queries: int = 0,
    obstacles: int = 0,
    outlooks: int = 0,
    cells: int = 0,
    moves: int = 0,
    checks: int = 0,
    looks: int = 0,
    rays: int = 0,
    pixels: int = 0,
) -> None:
    """Add to the work of the calling thread; see :class:`Work`."""
    amounts = _COUNTS.amounts
    amounts[0] += batches
    amounts[1] += pairs
    amounts[2] += queries
    amounts[3] += obstacles
    amounts[4] += outlooks
    amounts[5] += cells
    amounts[6] += moves
    amounts[7] += checks
    amounts[8] += looks
    amounts[9] += rays
    amounts[10] += pixels


def seconds_counted() -> float:
    """Modelled time [s] of the computing of the calling thread since it began."""
    return sum(map(mul, _COUNTS.amounts, SECONDS_PER.values()))


def counted() -> Work:
    """The work of the calling thread since it began."""
    return Work(*_COUNTS.amounts)


@contextmanager
def bounded_by_work() -> Iterator[None]:
    """Let the calling thread's limits of time be limits of modelled time meanwhile, so that equal inputs end alike on
    every machine, whatever else runs there."""
    before, _COUNTS.bounds = _COUNTS.bounds, True
    try:
        yield
    finally:
        _COUNTS.bounds = before


def work_bounds() -> bool:
    """Whether limits of time are limits of modelled time for the calling thread; see :func:`bounded_by_work`."""
    return _COUNTS.bounds
