"""Process priority: makes the calling process fit for a loop at a fixed rate."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable

_PRIORITY = 10  # above the kernel's default of 1, below its own threads
_NICE = -15


def raise_priority() -> str:
    """Turn garbage collection off and get the processor first, as far as that is permitted.

    The calling thread alone is served first: threads and processes that it starts are ordinary ones. What was made so
    far is never looked through again, and cycles of references that are made later are never freed: a loop has to do
    without.

    Returns:
        What could be done: ``"SCHED_FIFO 10"``, ``"nice -15"`` or ``"ordinary priority"``.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    tries: tuple[tuple[str, Callable[[], object]], ...] = (
        (f"SCHED_FIFO {_PRIORITY}", _real_time),
        (f"nice {_NICE}", lambda: os.setpriority(os.PRIO_PROCESS, 0, _NICE)),
    )
    for said, attempt in tries:
        try:
            attempt()
            return said
        except (OSError, AttributeError):  # not permitted, or a system without it
            continue
    return "ordinary priority"


def _real_time() -> None:
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # children begin as ordinary threads
    os.sched_setscheduler(0, policy, os.sched_param(_PRIORITY))
