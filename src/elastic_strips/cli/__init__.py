"""Command line: ``elastic-strips run | drive | view | bench | study | list``."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

EXIT_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; ends the process with the exit codes of its help text.

    What it needs is imported here: Ctrl-C ends it quietly from the first moment on.

    Args:
        arguments: without the program's name; None takes those of the process.
    """
    try:
        with interruptible_imports():
            from .group import run_cli

        run_cli(arguments)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        sys.exit(EXIT_INTERRUPTED)


@contextmanager
def interruptible_imports() -> Iterator[None]:
    """Ctrl-C ends the process at once: nothing has started yet, and a ``KeyboardInterrupt`` during an import may be
    lost in a callback of the interpreter, or printed by one."""
    try:
        mine = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if mine:
            signal.signal(signal.SIGINT, _leave)
    except ValueError:  # not the main thread, which alone gets signals
        mine = False
    try:
        yield
    finally:
        if mine:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _leave(number: int, frame: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


__all__ = ["main"]
