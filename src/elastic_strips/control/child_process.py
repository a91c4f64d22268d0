"""Child process: starts a process that Ctrl-C does not reach, not even while it starts, and ends one for sure."""

from __future__ import annotations

import os
import signal
from multiprocessing import parent_process, resource_tracker
from multiprocessing.process import BaseProcess


def start_quietly(process: BaseProcess) -> None:
    """Start a process that ignores Ctrl-C, which is for its parent.

    Raises:
        Exception: what it is given cannot be pickled, or the system has no more processes.
    """
    if not hasattr(signal, "pthread_sigmask"):
        process.start()
        return
    resource_tracker.ensure_running()  # it would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited by the child
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_process(process: BaseProcess, patience: float) -> bool:
    """Wait for the end of a process, and kill it where that takes longer than ``patience`` [s].

    Returns:
        Whether it ended by itself; also where it was never started.
    """
    if process.pid is None:
        return True
    process.join(patience)
    if not process.is_alive():
        return True
    process.kill()
    process.join()
    return False


def orphaned() -> bool:
    """Whether the process that started this one is gone."""
    parent = parent_process()
    return parent is not None and os.getppid() != parent.pid
