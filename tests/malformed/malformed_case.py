"""A malformed file, as data: what to write, and what the message about it has to say."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from elastic_strips.errors import InputError

Content = str | bytes | Callable[[Path], None]
"""Text, bytes, or a function that makes whatever shall stand at the path."""


@dataclass(frozen=True, slots=True)
class FileCase:
    """One malformed file.

    Attributes:
        name: what is wrong with it.
        file: its name.
        content: see :data:`Content`.
        error: type of the error that it has to raise.
        says: what the message has to contain.
        beside: further files of the same folder, by name.
        names_file: whether the message has to contain the file's name (without suffix).
    """

    name: str
    file: str
    content: Content
    error: type[InputError]
    says: tuple[str, ...]
    beside: Mapping[str, Content] = field(default_factory=dict)
    names_file: bool = True

    def write(self, folder: Path) -> Path:
        """Make the file and what stands beside it."""
        for name, content in self.beside.items():
            _write(folder / name, content)
        path = folder / self.file
        _write(path, self.content)
        return path


def _write(path: Path, content: Content) -> None:
    if isinstance(content, str):
        path.write_text(content, encoding="utf-8")
    elif isinstance(content, bytes):
        path.write_bytes(content)
    else:
        content(path)


def folder(path: Path) -> None:
    """A folder where a file should be."""
    path.mkdir()


def nothing(path: Path) -> None:
    """No file at all."""


def special(kind: str, path: Path) -> None:
    """What must never be read: a FIFO that nobody writes to, a device that never ends; or a folder, or nothing."""
    if kind == "a FIFO":
        os.mkfifo(path)
    elif kind == "endless":
        path.symlink_to("/dev/zero")
    elif kind == "a folder":
        path.mkdir()
    elif kind == "too large":
        sparse(300_000_000)(path)


@contextmanager
def no_hang(seconds: int = 60) -> Iterator[None]:
    """Fail instead of waiting for ever."""

    def expire(signum: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"no answer within {seconds} s")

    previous = signal.signal(signal.SIGALRM, expire)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


def sparse(size: int) -> Callable[[Path], None]:
    """A file of ``size`` zero bytes that takes no room on the disk."""

    def make(path: Path) -> None:
        with path.open("wb") as stream:
            stream.truncate(size)

    return make
