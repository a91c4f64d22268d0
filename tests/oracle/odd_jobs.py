"""Jobs that fail, and that end their process: in a file of their own, since new processes must be able to import them;
and a Dask cluster of processes on this machine."""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

CLOCKED = ("time_to_certified_ms", "tick_p50_ms", "tick_p95_ms", "deadline_misses", "wall_s")
"""Columns of a sweep's table that depend on the clock: they differ between two runs alike."""


def square(number: int) -> int:
    return number * number


def stumbles(number: int) -> int:
    """Fails at three."""
    if number == 3:
        raise ValueError("three")
    return number * number


def note(task: tuple[str, int]) -> int:
    """Leaves the process' number in a file of the folder, and stays."""
    folder, number = task
    Path(folder, str(number)).write_text(str(os.getpid()))
    time.sleep(600.0)
    return number


def killed_once(task: tuple[str, int]) -> int:
    """Kills its own process the first time that it meets seven."""
    folder, number = task
    marker = Path(folder, "killed")
    if number == 7 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def deadly(number: int) -> int:
    """Three kills its process whenever it is met."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def deadly_scheduler(task: tuple[int, int]) -> int:
    """Three kills the process of a number, and waits."""
    number, process = task
    if number == 3:
        os.kill(process, signal.SIGKILL)
        time.sleep(600.0)
    return number * number


def _scheduler(said: Connection, forgives: int) -> None:
    from dask import config
    from distributed import Scheduler

    logging.getLogger("distributed").setLevel(logging.CRITICAL)

    async def serve() -> None:
        async with Scheduler(host="127.0.0.1", port=0, dashboard_address=":0") as made:
            said.send(made.address)
            await made.finished()

    # a worker that has gone is asked for its results as long as the other bound says: 30 s by default
    bounds = {"distributed.scheduler.allowed-failures": forgives, "distributed.comm.timeouts.connect": "2s"}
    with config.set(bounds):
        asyncio.run(serve())


def _worker(scheduler: str, folder: str) -> None:
    from distributed import Worker

    logging.getLogger("distributed").setLevel(logging.CRITICAL)

    async def serve() -> None:
        async with Worker(scheduler, host="127.0.0.1", nthreads=1, local_directory=folder) as made:
            await made.finished()

    asyncio.run(serve())


@contextmanager
def cluster(folder: Path, workers: int = 2, *, forgives: int = 3) -> Iterator[tuple[str, list[BaseProcess]]]:
    """Address of a Dask scheduler with workers on the loopback device, and its process and theirs. A job may bring down
    so many workers before it is given up. Processes are forked from one that has imported everything, once."""
    from distributed import Client

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["distributed", "elastic_strips.sim.sweep"])
    ours, theirs = context.Pipe(duplex=False)
    processes: list[BaseProcess] = []
    try:
        processes.append(context.Process(target=_scheduler, args=(theirs, forgives)))
        processes[0].start()
        theirs.close()
        address = ours.recv()  # an EOFError: it ended
        for _ in range(workers):
            processes.append(context.Process(target=_worker, args=(address, str(folder))))
            processes[-1].start()
        with Client(address, timeout=60.0, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60.0)
        yield address, processes
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def gone(process: int) -> bool:
    """Whether a process has ended; what nobody has asked for its end counts."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        if sys.platform == "linux":
            return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False
