"""Bench room, pool: many seeded runs on all cores, results as they come."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

_WORK: dict[str, Any] = {}


def spread(
    work: Callable[[Any], dict[str, Any]], tasks: Sequence[Any], processes: int | None = None
) -> Iterator[dict[str, Any]]:
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


def cached(key: str, make: Callable[[], Any]) -> Any:
    """What a worker keeps from task to task: made once under a key."""
    if key not in _WORK:
        _WORK[key] = make()
    return _WORK[key]
