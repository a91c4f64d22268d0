"""The engine of benchmarks and sweeps: every job ends once, whatever happens to the processes that run them."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from types import ModuleType

import odd_jobs
import pytest
from cases import each, refused

from elastic_strips.errors import ParameterError
from elastic_strips.sim import jobs
from elastic_strips.sim.jobs import SchedulerLost, WorkerDied, parallel_map, run_jobs

SQUARES = [n * n for n in range(12)]


def in_order(found: list) -> list[int]:
    assert sorted(f.index for f in found) == list(range(len(SQUARES)))
    return [f.result() for f in sorted(found, key=lambda f: f.index)]


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.process
@pytest.mark.parametrize("processes", [1, 2])
def test_results_come_as_they_are_ready(processes: int) -> None:
    assert sorted(parallel_map(odd_jobs.square, range(12), processes)) == SQUARES


def test_a_job_that_raises_is_handed_over_and_raises_where_it_is_asked_for() -> None:
    found = list(run_jobs(odd_jobs.stumbles, range(5), processes=2))
    wrong = [f for f in found if f.error is not None]
    assert [(f.index, str(f.error)) for f in wrong] == [(3, "three")]
    assert sorted(f.result() for f in found if f.error is None) == [0, 1, 4, 16]
    with refused(ValueError, "three"):
        list(parallel_map(odd_jobs.stumbles, range(5), 2))


def test_jobs_of_a_process_that_is_killed_run_again(tmp_path: Path) -> None:
    found = list(run_jobs(odd_jobs.killed_once, [(str(tmp_path), n) for n in range(12)], processes=2))
    assert in_order(found) == SQUARES
    assert (tmp_path / "killed").exists()


def test_a_job_that_kills_every_process_is_named_and_no_other() -> None:
    found = list(run_jobs(odd_jobs.deadly, range(12), processes=2))
    assert sorted(f.index for f in found) == list(range(12))
    assert [(f.index, type(f.error)) for f in found if f.error is not None] == [(3, WorkerDied)]


def _workers(folder: Path) -> list[int]:
    return [int(text) for file in folder.iterdir() if (text := file.read_text())]


def test_an_exception_ends_the_processes_at_once(tmp_path: Path) -> None:
    tasks = [(str(tmp_path), n) for n in range(2)]

    def interrupt(number: int, frame: object) -> None:
        if len(_workers(tmp_path)) == 2:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
    try:
        with pytest.raises(KeyboardInterrupt):
            list(run_jobs(odd_jobs.note, tasks, processes=2))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert all(odd_jobs.gone(worker) for worker in _workers(tmp_path))


def test_the_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    program = (
        f"import sys; sys.path.insert(0, {str(Path(odd_jobs.__file__).parent)!r})\n"
        "import odd_jobs\nfrom elastic_strips.sim.jobs import run_jobs\n"
        f"list(run_jobs(odd_jobs.note, [({str(tmp_path)!r}, n) for n in range(2)], processes=2))"
    )
    main = subprocess.Popen([sys.executable, "-c", program])
    until(lambda: len(_workers(tmp_path)) == 2)
    main.kill()
    main.wait()
    until(lambda: all(odd_jobs.gone(worker) for worker in _workers(tmp_path)))


# --- a Dask cluster ----------------------------------------------------------------------------------------------


def test_jobs_of_a_worker_of_a_cluster_that_is_killed_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with odd_jobs.cluster(tmp_path) as (address, _):
        tasks = [(str(tmp_path), n) for n in range(12)]
        assert in_order(list(run_jobs(odd_jobs.killed_once, tasks, scheduler=address))) == SQUARES
        assert (tmp_path / "killed").exists()
        found = list(run_jobs(odd_jobs.stumbles, range(5), scheduler=address))  # by the worker that is left
        assert [(f.index, str(f.error)) for f in found if f.error is not None] == [(3, "three")]
        absent = ModuleType("absent")
        exec("def version(): return '0'", absent.__dict__)
        monkeypatch.setitem(sys.modules, "absent", absent)
        monkeypatch.setattr(jobs, "_version", absent.version)
        with refused(ParameterError, "import"):
            list(run_jobs(odd_jobs.square, [1], scheduler=address))


def test_a_job_that_brings_down_a_worker_of_a_cluster_is_named(tmp_path: Path) -> None:
    with odd_jobs.cluster(tmp_path, forgives=0) as (address, _):
        found = list(run_jobs(odd_jobs.deadly, range(12), scheduler=address))
    assert sorted(f.index for f in found) == list(range(12))
    assert {type(f.error) for f in found if f.error is not None} == {WorkerDied}
    assert found[[f.index for f in found].index(3)].error is not None


class _Lossy:
    """A future of Dask's whose result is there, but was lost with its worker since."""

    def __init__(self, result: object, status: str) -> None:
        self.status, self._made = status, result

    async def _result(self, raiseit: bool) -> object:
        return self._made


def _handed_over(result: object, status: str) -> BaseException | None:
    """What Dask's own executor makes of it."""
    from distributed.cfexecutor import _cascade_future

    future: Future[object] = Future()

    async def hand_over() -> None:
        await _cascade_future(_Lossy(result, status), future)

    asyncio.run(hand_over())
    return future.exception(timeout=10.0)


def _failure(text: str) -> tuple[object, ...]:
    try:
        raise ValueError(text)
    except ValueError as error:
        return type(error), error, error.__traceback__


@each("result", [9, {"run": 0}, dict.fromkeys("abcdef"), "abc", ()])
@each("status", ["lost", "pending"])
def test_a_result_that_was_lost_with_its_worker_is_no_error_of_the_job(result: object, status: str) -> None:
    assert jobs._is_lost(_handed_over(result, status))


def test_an_error_of_a_job_is_no_lost_result() -> None:
    assert not jobs._is_lost(_handed_over(9, "finished"))
    kind, error, trace = _failure("too many values to unpack (expected 3)")
    assert not jobs._is_lost(_handed_over((kind, error, trace), "error"))
    kind, error, _ = _failure("three")
    assert not jobs._is_lost(_handed_over((kind, error, None), "error"))  # of a traceback that was too long to be sent


def test_a_scheduler_that_ends_is_said(tmp_path: Path) -> None:
    with odd_jobs.cluster(tmp_path, 1) as (address, (scheduler, _)), pytest.raises(SchedulerLost, match=address):
        list(run_jobs(odd_jobs.deadly_scheduler, [(n, scheduler.pid) for n in range(6)], scheduler=address))


@each("address", ["tcp://127.0.0.1:9", "nonsense://x", "tcp://:-1"])
def test_an_address_without_a_scheduler_is_wrong_input(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "_CONNECT_TIMEOUT", 0.5)
    with refused(ParameterError, "scheduler"):
        list(run_jobs(odd_jobs.square, [1], scheduler=address))
