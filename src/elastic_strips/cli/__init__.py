"""Command line: ``elastic-strips run | drag | drive | view | certify | robot | sweep | list | doctor``."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

EXIT_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; ends the process with the exit codes of its help text.

    What it needs is imported here: Ctrl-C ends it quietly from the first moment on.

    Args:
        arguments: without the program's name; None takes those of the process.
    """
    run_program("elastic_strips.cli.group", arguments)


def run_program(module: str, arguments: list[str] | None) -> None:
    """Import a module and call its ``run_cli``, which ends the process; Ctrl-C is an exit code all the while."""
    try:
        with interruptible_imports():
            run_cli = import_module(module).run_cli
        with unlost_interrupts():
            run_cli(arguments)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(EXIT_INTERRUPTED)


@contextmanager
def interruptible_imports() -> Iterator[None]:
    """Ctrl-C ends the process at once: nothing has started yet, and a ``KeyboardInterrupt`` during an import may be
    lost in a callback of the interpreter, or printed by one."""
    with _interrupts_by(_leave):
        yield


@contextmanager
def unlost_interrupts() -> Iterator[None]:
    """Ctrl-C during an import is a ``KeyboardInterrupt`` right after it; some modules are imported late."""
    with _interrupts_by(_raise_later):
        yield


@contextmanager
def _interrupts_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Another handler of SIGINT, where it has Python's own or one of these."""
    before = signal.getsignal(signal.SIGINT)
    try:
        mine = before in (signal.default_int_handler, _leave, _raise_later)
        if mine:
            signal.signal(signal.SIGINT, handler)
    except ValueError:  # not the main thread, which alone gets signals
        mine = False
    try:
        yield
    finally:
        if mine:
            signal.signal(signal.SIGINT, before)


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


def _raise_later(number: int, frame: FrameType | None) -> None:
    # Who imports a module that calls main may go on.
    while frame is not None and frame.f_code is not run_program.__code__:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            signal.signal(signal.SIGALRM, _raise_later)  # ask again soon
            signal.setitimer(signal.ITIMER_REAL, 0.02)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


__all__ = ["main", "run_program"]
