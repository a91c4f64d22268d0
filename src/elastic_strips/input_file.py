"""Input files: every file that is read is opened here, so that none can hang the process or fill its memory.

A regular file only (or a link to one), up to a size that its reader states, and one kind of message about it.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from elastic_strips.errors import InputError

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
# without O_NONBLOCK a FIFO that takes the file's place between the two looks at it would hang the call
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)


@contextmanager
def open_input(
    path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]
) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular file for reading.

    Args:
        path: the file, or a link to it.
        what: what to call it in messages, such as ``"laser log"``.
        limit: most bytes that it may have.
        error: type of the error that is raised about it.

    Yields:
        The stream, and the file's size in bytes.

    Raises:
        InputError: (of the type ``error``) missing, not allowed, a folder, FIFO, socket or device, or too large.
    """
    try:
        os.fspath(path)  # a number would be taken for a file that is open already
        _check(os.stat(path), path, what, limit, error)
        stream = os.fdopen(os.open(path, _FLAGS), "rb")
    except InputError:
        raise
    except (OSError, ValueError, TypeError) as problem:  # ValueError: a zero byte in the name
        raise error(f"{_name(path)}: cannot read the {what}: {_said(problem)}") from None
    with stream:
        size = _check(os.fstat(stream.fileno()), path, what, limit, error)
        try:
            yield stream, size
        except OSError as problem:  # while it is read
            raise error(f"{_name(path)}: cannot read the {what}: {_said(problem)}") from None


def check_input(path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> int:
    """The size [bytes] of a file that something else is going to open by its name.

    Raises:
        InputError: as of `open_input`.
    """
    with open_input(path, what, limit, error) as (_, size):
        return size


def read_input(path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> bytes:
    """What a file holds.

    Raises:
        InputError: as of `open_input`.
    """
    with open_input(path, what, limit, error) as (stream, _):
        data = stream.read(limit + 1)  # it may grow while it is read, and what /proc holds says that it is empty
    if len(data) > limit:
        raise error(f"{_name(path)}: the {what} has more than {limit} bytes, which is the most that is read")
    return data


def read_input_text(path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> str:
    """What a UTF-8 text file holds, without a byte order mark.

    Raises:
        InputError: as of `open_input`, or what it holds is not UTF-8; the message names line and byte.
    """
    data = read_input(path, what, limit, error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        line = data.count(b"\n", 0, problem.start) + 1
        byte = f"byte 0x{data[problem.start]:02x} at offset {problem.start}"
        raise error(f"{_name(path)}:{line}: the {what} is not UTF-8: {byte}") from None


def _check(status: os.stat_result, path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> int:
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for test, name in _KINDS if test(status.st_mode)), "no regular file")
        raise error(f"{_name(path)}: is {kind}, not a {what}")
    if status.st_size > limit:
        raise error(f"{_name(path)}: the {what} has {status.st_size} bytes; it may have at most {limit}")
    return status.st_size


def _said(problem: Exception) -> str:
    return getattr(problem, "strerror", None) or str(problem)


def _name(path: object) -> str:
    """The path for messages; control characters are escaped, so that a message stays one line."""
    name = str(Path(os.fsdecode(path))) if isinstance(path, (str, bytes, os.PathLike)) else repr(path)
    return name if name.isprintable() else ascii(name)[1:-1]
