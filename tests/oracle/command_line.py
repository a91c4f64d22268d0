"""The command line as a process of its own, and Ctrl-C in the middle of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

CALL = [sys.executable, "-c", "from elastic_strips.cli import main; main()"]


def _heed_interrupts() -> None:
    """A background job's children are born deaf to Ctrl-C; a terminal's are not."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def interrupted(
    arguments: list[str],
    folder: Path,
    *,
    after: float = 0.0,
    printed: str = "",
    until: Callable[[], bool] | None = None,
    module: str = "elastic_strips.cli.group",
) -> subprocess.CompletedProcess[str]:
    """A process that gets Ctrl-C some seconds after its modules are loaded, or once it printed something, or once
    something holds."""
    root = str(Path(__file__).parents[2])
    program = (
        f"import sys; sys.path.append({root!r}); from elastic_strips.cli import run_program; "
        f"print('loaded', flush=True); run_program({module!r}, None)"
    )
    process = subprocess.Popen(
        [sys.executable, "-u", "-c", program, *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder, env=os.environ,
        preexec_fn=_heed_interrupts,
    )  # fmt: skip
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "loaded\n"
        if printed:
            assert printed in process.stdout.readline()
        time.sleep(after)
        end = time.monotonic() + 120.0
        while until is not None and not until() and time.monotonic() < end:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    return subprocess.CompletedProcess(arguments, process.returncode, out, errors)
