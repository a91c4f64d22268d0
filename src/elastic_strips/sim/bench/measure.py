"""Measurement: percentiles, a description of the machine, and a pool of processes for the benchmarks."""

from __future__ import annotations

import multiprocessing
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from elastic_strips._version import __version__

Figures: TypeAlias = dict[str, Any]
"""Measured values by name: numbers, texts, lists and further figures, ready for JSON."""
Note: TypeAlias = Callable[[str], object]
"""Called after each piece of work with a few words, for a progress bar."""
_Task = TypeVar("_Task")
_Made = TypeVar("_Made")


def silent(note: str) -> None:
    """A :data:`Note` that goes nowhere."""


def percentiles(values: Sequence[float] | npt.NDArray[np.float64], *, scale: float = 1.0) -> Figures:
    """p50, p90, p95, p99 and max of values, times ``scale``."""
    array = np.asarray(values, dtype=float) * scale
    if len(array) == 0:
        return {"p50": None, "p90": None, "p95": None, "p99": None, "max": None}
    return {f"p{p}": float(np.percentile(array, p)) for p in (50, 90, 95, 99)} | {"max": float(array.max())}


def head(benchmark: str, **what: object) -> Figures:
    """First figures of a benchmark: its name, the machine, and the values of ``what``."""
    import coal
    import pinocchio as pin

    machine = {
        "elastic_strips": __version__,
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "pinocchio": pin.__version__,
        "coal": coal.__version__,
        "numpy": np.__version__,
    }
    return {"benchmark": benchmark, "machine": machine, **what}


_WORK: Figures = {}


def parallel_map(
    work: Callable[[_Task], _Made], tasks: Sequence[_Task], processes: int | None = None
) -> Iterator[_Made]:
    """Results of ``work`` on each task, in the order in which they are ready.

    Args:
        work: a function of a module (it is sent by name), of one picklable task.
        tasks: the tasks.
        processes: how many; one for each core where None, none but this one where 1.
    """
    count = min(processes or os.cpu_count() or 1, len(tasks))
    if count <= 1:
        yield from map(work, tasks)
        return
    context = multiprocessing.get_context("spawn")
    with context.Pool(count, initializer=_quiet) as pool:
        yield from pool.imap_unordered(work, tasks)


def _quiet() -> None:
    """A worker leaves Ctrl-C to the main process, and uses one thread."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def cached(key: str, make: Callable[[], _Made]) -> _Made:
    """A value that a worker keeps from task to task, made once per key."""
    if key not in _WORK:
        _WORK[key] = make()
    return _WORK[key]
