"""Independent jobs on many processes of this machine or of a Dask cluster; each result as soon as it is ready."""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar, cast

from elastic_strips._version import __version__
from elastic_strips.errors import ElasticStripsError, ParameterError, missing_extra
from elastic_strips.files import command_files, inputs_read, note_input
from elastic_strips.validation import check_count, check_type, shown

_LOG = logging.getLogger(__name__)
_Task = TypeVar("_Task")
_Made = TypeVar("_Made")
_JOBS_AHEAD = 500
"""Number of jobs that a cluster's scheduler is given in advance."""
_CONNECT_TIMEOUT = 10.0  # [s] for a cluster's scheduler to answer
_MOST_LOSSES = 3
"""Times that a result may be lost with its worker before its job is given up."""
_KEPT: dict[str, Any] = {}


class WorkerDied(ElasticStripsError):
    """The process that ran a job ended before the job did: it crashed, was killed, or had no memory left."""


class SchedulerLost(ElasticStripsError):
    """The scheduler of the cluster ended, or cannot be reached any more."""


def cached(key: str, make: Callable[[], _Made]) -> _Made:
    """A value that a worker keeps from job to job, made once per key."""
    if key not in _KEPT:
        _KEPT[key] = make()
    return _KEPT[key]


@dataclass(frozen=True, slots=True)
class Finished(Generic[_Made]):
    """A job that has ended.

    Attributes:
        index: index of its task.
        made: its return value; None where it raised.
        error: the exception that it raised; a `WorkerDied` where its process ended.
    """

    index: int
    made: _Made | None = None
    error: BaseException | None = None

    def result(self) -> _Made:
        """The job's return value; raises the job's exception."""
        if self.error is not None:
            raise self.error
        return cast("_Made", self.made)


def parallel_map(
    work: Callable[[_Task], _Made], tasks: Sequence[_Task], processes: int | None = None
) -> Iterator[_Made]:
    """Results of ``work`` on each task, in the order in which they are ready; a job's exception is raised here.

    Args:
        work: a function of a module (it is sent by name), of one picklable task.
        tasks: the tasks.
        processes: number of processes; one for each core where None; only this one where 1.
    """
    count = min(processes or os.cpu_count() or 1, len(tasks))
    if count <= 1:
        yield from map(work, tasks)
        return
    with closing(run_jobs(work, tasks, processes=count)) as jobs:
        for finished in jobs:
            yield finished.result()


def run_jobs(
    work: Callable[[_Task], _Made],
    tasks: Sequence[_Task],
    *,
    processes: int | None = None,
    scheduler: str | None = None,
) -> Generator[Finished[_Made], None, None]:
    """Run every task once, in other processes; the jobs in the order in which they end.

    A job whose process ends is run once more, alone: where that one ends too, the job is `Finished` with a `WorkerDied`
    (a cluster's scheduler decides by itself how often it tries). Closing the iterator, or an exception such as
    ``KeyboardInterrupt``, ends the local processes at once, and so does the end of this process, whatever ended it.

    Args:
        work: a function of a module (it is sent by name), of one picklable task.
        tasks: the tasks.
        processes: number of processes; one for each core where None. Not with a scheduler.
        scheduler: address of a Dask scheduler, such as ``tcp://127.0.0.1:8786``; processes of this machine where None.

    Raises:
        ParameterError: nothing answers at the scheduler's address, or its workers cannot import this library.
        SchedulerLost: the scheduler ended.
        MissingExtraError: a scheduler is given, and ``distributed`` is not installed.
    """
    if processes is not None:
        check_count("processes", processes, low=1)
    if scheduler is not None:
        yield from _on_cluster(work, tasks, scheduler)
        return
    count = min(processes or os.cpu_count() or 1, max(1, len(tasks)))
    pool = _LocalPool(count)
    jobs = _LocalJobs(work, tasks, pool, 2 * count)
    try:
        while jobs.submit():
            yield from jobs.ended()
        pool.wait()
    finally:
        pool.end()


class _LocalJobs(Generic[_Task, _Made]):
    """Which jobs wait, run, and have to run once more, alone.

    Args:
        work, tasks: as of :func:`run_jobs`.
        pool: the processes.
        most: jobs that are on their way at once.
    """

    def __init__(self, work: Callable[[_Task], _Made], tasks: Sequence[_Task], pool: _LocalPool, most: int) -> None:
        self._work, self._tasks, self._pool, self._most = work, tasks, pool, most
        self._waiting: deque[int] = deque(range(len(tasks)))
        self._suspects: deque[int] = deque()  # were on their way when a process ended: one may have been the reason
        self._alone: set[int] = set()  # suspects that run again, without others beside them
        self._running: dict[Future[tuple[_Made, list[str]]], int] = {}

    def submit(self) -> bool:
        """Begin as many jobs as may run; whether there are any left."""
        waiting, suspects, running = self._waiting, self._suspects, self._running
        alone = bool(suspects) or any(k in self._alone for k in running.values())
        most = 1 if alone else self._most
        while (suspects or waiting) and len(running) < most:
            k = suspects.popleft() if suspects else waiting.popleft()
            if most == 1:
                self._alone.add(k)
            try:
                running[self._pool.submit(self._work, self._tasks[k])] = k
            except BrokenProcessPool:  # a process ended while none of these was running, or is just being noticed
                (suspects if most == 1 else waiting).appendleft(k)
                self._alone.discard(k)
                if running:
                    break
                self._pool.restart()
        return bool(running)

    def ended(self) -> Iterator[Finished[_Made]]:
        """Wait for a job; those that have ended for good."""
        done, _ = wait(self._running, return_when=FIRST_COMPLETED)
        if any(isinstance(future.exception(), BrokenProcessPool) for future in done):
            done, _ = wait(self._running)  # the others have ended, too
            self._pool.restart()
        for future in done:
            k = self._running.pop(future)
            error = future.exception()
            if error is None:
                made, read = future.result()
                for name in read:
                    note_input(name)
                yield Finished(k, made)
            elif not isinstance(error, BrokenProcessPool):
                yield Finished(k, error=error)
            elif k in self._alone:
                yield Finished(k, error=WorkerDied("the process of the job ended: crashed, killed or out of memory"))
            else:
                self._suspects.append(k)
            self._alone.discard(k)


class _LocalPool:
    """Processes of this machine, which end with this one."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._context = multiprocessing.get_context("spawn")
        self._reader, self._writer = self._context.Pipe(duplex=False)
        self._executor = self._made()

    def _made(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._count, mp_context=self._context, initializer=_enter, initargs=(self._reader,))

    def submit(self, work: Callable[[_Task], _Made], task: _Task) -> Future[tuple[_Made, list[str]]]:
        """Begin a job. Processes that are started for it leave Ctrl-C to this one, from their first moment on."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # children inherit it
        try:
            return self._executor.submit(_noted, work, task)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def wait(self) -> None:
        """End the processes when they have nothing more to do."""
        self._executor.shutdown()

    def restart(self) -> None:
        """New processes in place of a pool that is broken."""
        _LOG.info("a worker process ended; starting new ones")
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._executor = self._made()

    def end(self) -> None:
        """End all processes now, whatever they do."""
        self._writer.close()
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._reader.close()


def _noted(work: Callable[[_Task], _Made], task: _Task) -> tuple[_Made, list[str]]:
    """A job's result, and the files that it read, which the command must not overwrite."""
    with command_files():
        return work(task), inputs_read()


def _enter(alive: Connection) -> None:
    """A worker uses one thread, and ends when nobody holds the other end of the pipe any more."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")

    def watch() -> None:
        try:
            alive.recv_bytes()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent-watch").start()


def _on_cluster(work: Callable[[_Task], _Made], tasks: Sequence[_Task], address: str) -> Iterator[Finished[_Made]]:
    """The jobs on the workers of a Dask cluster."""
    check_type("scheduler", address, str)
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise missing_extra("a Dask cluster", "distributed", "sweep") from None
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ParameterError(
            f"scheduler={shown(address)}: no Dask scheduler answers there, or it is not an address such as "
            f"tcp://127.0.0.1:8786 ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
        ) from None
    with client:
        try:
            versions = cast("dict[str, str]", client.run(_version))
        except Exception as error:  # whatever the import raised there
            raise ParameterError(
                f"scheduler={shown(address)}: a worker cannot import this library's jobs: install elastic_strips "
                f"{__version__} there ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
            ) from None
        _check_workers(versions)
        executor: Executor = client.get_executor(pure=False)
        waiting = deque(range(len(tasks)))
        running: dict[Future[_Made], int] = {}
        losses: Counter[int] = Counter()
        while waiting or running:
            while waiting and len(running) < _JOBS_AHEAD:
                k = waiting.popleft()
                running[executor.submit(work, tasks[k])] = k
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                k = running.pop(future)
                try:
                    error = future.exception()
                except CancelledError:
                    raise SchedulerLost(f"the scheduler at {address} ended, or cannot be reached any more") from None
                if _is_lost(error):
                    losses[k] += 1
                    if losses[k] < _MOST_LOSSES:
                        waiting.append(k)
                        continue
                    error = WorkerDied(f"{_MOST_LOSSES} workers ended before they handed over the result")
                if isinstance(error, KilledWorker):
                    error = WorkerDied(" ".join(str(error).split()).split(". ")[0])
                yield Finished(k, None if error else future.result(), error)


def _is_lost(error: BaseException | None) -> bool:
    """Whether an error is the executor's own: what is there when a worker ends between the end of its job and the
    fetching of the result, it takes for an error's three parts, and fails to take apart."""
    own = isinstance(error, (AttributeError, TypeError, ValueError)) and re.search("unpack|with_traceback", str(error))
    trace = error.__traceback__ if error is not None and own else None
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and trace.tb_frame.f_globals.get("__name__") == "distributed.cfexecutor"


def _version() -> str:
    return __version__


def _check_workers(versions: dict[str, str]) -> None:
    if not versions:
        _LOG.warning("the scheduler has no workers yet; waiting for some")
    for worker, version in versions.items():
        if version != __version__:
            _LOG.warning("worker %s has elastic_strips %s; this is %s", worker, version, __version__)
