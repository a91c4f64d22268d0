"""Process priority: makes the calling process fit for a loop at a fixed rate."""

from __future__ import annotations

import atexit
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_REALTIME_PRIORITY = 10  # above the kernel's default of 1, below its own threads
_PRIORITY_NICENESS = -15  # where there is no real-time priority; 0 is usual, -20 the most
_SWITCH_INTERVAL = 2e-4  # [s] after which a thread that holds the interpreter is asked for it, during a tick


class _Ticks:
    """Workspace: how many ticks run in this process, in threads of their own, and the switch interval [s] before."""

    def __init__(self) -> None:
        self.lock: threading.Lock = threading.Lock()
        self.running: int = 0
        self.interval: float = 0.0


_TICKS = _Ticks()


def keep_memory() -> None:
    """Make garbage collection look only through objects that are made from now on, until this is called again.

    A collection of everything looks through all modules, too: that takes 50 ms and more, in the middle of a tick.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()
    atexit.unregister(gc.unfreeze)
    atexit.register(gc.unfreeze)  # else extensions report at the end of the process what was never freed


@contextmanager
def undisturbed() -> Iterator[None]:
    """Let garbage collection wait meanwhile: the next one comes afterwards, not in the middle of a tick.

    And let threads of this process take the interpreter from each other sooner: a tick lends it to others whenever it
    computes in the native kernel, many times, and each of them may keep it for as long as that.
    """
    enabled = gc.isenabled()
    gc.disable()
    with _TICKS.lock:
        if not _TICKS.running:
            _TICKS.interval = sys.getswitchinterval()
            sys.setswitchinterval(min(_TICKS.interval, _SWITCH_INTERVAL))
        _TICKS.running += 1
    try:
        yield
    finally:
        with _TICKS.lock:
            _TICKS.running -= 1
            if not _TICKS.running:
                sys.setswitchinterval(_TICKS.interval)
        if enabled:
            gc.enable()


def raise_priority() -> str:
    """Turn garbage collection off and get the processor first, as far as that is permitted.

    Threads and processes that the calling thread starts from then on are served like it. Start helping threads after
    it: one that waits for the processor while it holds the interpreter's lock keeps the loop waiting, too. What was
    made so far is never looked through again, and cycles of references that are made later are never freed: a loop must
    not make any.

    Returns:
        What was permitted: ``"SCHED_FIFO 10"``, ``"nice -15"`` or ``"ordinary priority"``.
    """
    keep_memory()
    gc.disable()
    tries: tuple[tuple[str, Callable[[], object]], ...] = (
        (f"SCHED_FIFO {_REALTIME_PRIORITY}", _real_time),
        (f"nice {_PRIORITY_NICENESS}", lambda: os.setpriority(os.PRIO_PROCESS, 0, _PRIORITY_NICENESS)),
    )
    for said, attempt in tries:
        try:
            attempt()
            return said
        except (OSError, AttributeError):  # not permitted, or a system without it
            continue
    return "ordinary priority"


def _real_time() -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_REALTIME_PRIORITY))
