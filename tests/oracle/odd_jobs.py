"""Jobs that fail, and that end their process: in a file of their own, since new processes must be able to import them;
and a Dask cluster of processes on this machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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


@contextmanager
def cluster(
    folder: Path, workers: int = 2, *, forgives: int = 3
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a Dask scheduler with workers on the loopback device, and its process and theirs. A job may bring down
    so many workers before it is given up."""
    from distributed import Client

    file, library = folder / "scheduler.json", str(Path(__file__).parent)
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, (library, os.environ.get("PYTHONPATH")))),
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": str(forgives),
    }
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    programs = [["dask_scheduler", "--host", "127.0.0.1", "--port", "0", *common]]
    programs += [
        [
            "dask_worker",
            "--host",
            "127.0.0.1",
            "--no-nanny",
            "--nthreads",
            "1",
            "--local-directory",
            str(folder),
            *common,
        ]
    ] * workers
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{program}", *arguments], env=environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        for program, *arguments in programs
    ]  # fmt: skip
    try:
        while not file.exists():
            assert processes[0].poll() is None, "the scheduler ended"
            time.sleep(0.05)
        with Client(scheduler_file=str(file), timeout=60.0, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60.0)
            address = client.scheduler.address  # type: ignore[union-attr]
        yield address, processes
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


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
