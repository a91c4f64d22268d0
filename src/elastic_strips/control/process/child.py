"""Child process: starts a process that Ctrl-C does not reach, not even while it starts, and ends one for sure."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from multiprocessing.process import BaseProcess

LONGEST_PROCESS_START = 120.0  # [s] until a process says that it runs: it imports everything anew
NOTHING_HEARD = "it ended at once (a program that starts processes needs `if __name__ == '__main__':`)"


def start_process(
    target: Callable[..., object], small: tuple[object, ...], task: tuple[object, ...], *, name: str
) -> SpawnProcess:
    """Start a process that ignores Ctrl-C, which is for its parent, and ends with it.

    The task is sent when the process runs. The standard library would send it before, and wait for ever where a
    process ends without reading all of it.

    Args:
        target: function of a module; it is called with ``small`` and ``task``.
        small: an argument of less than 60 kB; it may hold sockets, of which this process keeps its own.
        task: what else it is given.
        name: name of the process.

    Raises:
        Exception: something cannot be pickled, or the system has no more processes.
    """
    data = pickle.dumps(task, pickle.HIGHEST_PROTOCOL)
    receiver, sender = Pipe(duplex=False)
    process = get_context("spawn").Process(target=_enter, args=(target, small, receiver), name=name, daemon=True)
    with receiver, sender:
        try:
            if hasattr(signal, "pthread_sigmask"):
                resource_tracker.ensure_running()  # it would unblock the signal
                before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited by the child
                try:
                    process.start()
                finally:
                    signal.pthread_sigmask(signal.SIG_SETMASK, before)
            else:
                process.start()
            receiver.close()
            with suppress(BrokenPipeError):  # it has ended; who waits for its first word finds out
                sender.send_bytes(data)
        except BaseException:
            end_process(process, 0.0)
            raise
    return process


def _enter(target: Callable[..., object], small: tuple[object, ...], receiver: Connection) -> None:
    with receiver:
        data = receiver.recv_bytes()
    target(*small, *pickle.loads(data))


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
