"""Files: every file that is read or written is opened here.

Only regular files (or links to them) are read, up to a size that the reader states, so that none can hang the
process or fill its memory. A file is written whole or not at all. Within a command (`command_files`) no file is written
that it has read, whatever name leads to it.
"""

from __future__ import annotations

import difflib
import gzip
import io
import json
import os
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import islice
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
_MOST_COMPARED = 2000  # names of a folder, with that of a file that is not there


@dataclass
class _Command:
    """Files, by device and inode: of those that were read, the name that was used, and those that it has written."""

    read: dict[tuple[int, int], str] = field(default_factory=dict)
    written: set[tuple[int, int]] = field(default_factory=set)


_command: _Command | None = None  # of the process: its threads read and write for the same command


@contextmanager
def command_files() -> Iterator[None]:
    """Within this context a file that was read is not overwritten, unless it was written within it: symbolic and hard
    links, other spellings and files that are named inside files are the same file."""
    global _command
    before = _command
    _command = before or _Command()
    try:
        yield
    finally:
        _command = before


def inputs_read() -> list[str]:
    """The files that the command has read so far, by absolute names, for the process that this one works for."""
    return [] if _command is None else [os.path.abspath(name) for name in _command.read.values()]


def note_input(path: str | os.PathLike[str]) -> None:
    """Remember a file that something else reads by its name, or would read."""
    with suppress(OSError, ValueError):
        _note(os.stat(path), path)


def _note(status: os.stat_result, path: str | os.PathLike[str]) -> None:
    key = (status.st_dev, status.st_ino)
    if _command is not None and key not in _command.written and stat.S_ISREG(status.st_mode):
        _command.read.setdefault(key, _name(path))


def refuse_input(target: Path) -> None:
    """Refuse to write a file that the command has read.

    Raises:
        InputError: the command has read it.
    """
    if _command is None:
        return
    with suppress(OSError):
        status = target.stat()
        name = _command.read.get((status.st_dev, status.st_ino))
        if name is not None:
            also = "" if name == _name(target) else f", as {name}"
            raise InputError(
                f"{_name(target)}: is read by this same command{also}, and would be overwritten; give another name"
            )


@contextmanager
def open_input(
    path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]
) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular file for reading.

    Args:
        path: the file, or a link to it.
        what: its name in messages, such as ``"laser log"``.
        limit: largest size [bytes] that it may have.
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
        beside = _meant(path) if isinstance(problem, FileNotFoundError) else ""
        raise error(f"{_name(path)}: cannot read the {what}: {_said(problem)}{beside}") from None
    with stream:
        status = os.fstat(stream.fileno())
        size = _check(status, path, what, limit, error)
        _note(status, path)
        try:
            yield stream, size
        except OSError as problem:  # while it is read
            raise error(f"{_name(path)}: cannot read the {what}: {_said(problem)}") from None


def _meant(path: str | os.PathLike[str]) -> str:
    """The file of the same folder that may be meant by the name of one that is not there."""
    given = Path(path)
    try:
        with os.scandir(given.parent) as entries:
            names = [entry.name for entry in islice(entries, _MOST_COMPARED)]
    except OSError:
        return ""
    close = difflib.get_close_matches(given.name, names, n=1, cutoff=0.8)
    return f"; did you mean {close[0]!r}?" if close else ""


def check_input(path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> int:
    """The size [bytes] of a file that something else is going to open by its name.

    Raises:
        InputError: as of `open_input`.
    """
    with open_input(path, what, limit, error) as (_, size):
        return size


def read_input(path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> bytes:
    """The bytes of a file.

    Raises:
        InputError: as of `open_input`.
    """
    with open_input(path, what, limit, error) as (stream, _):
        data = stream.read(limit + 1)  # it may grow while it is read, and what /proc holds says that it is empty
    if len(data) > limit:
        raise error(f"{_name(path)}: the {what} has more than {limit} bytes, which is the most that is read")
    return data


def _unpacked(data: bytes, path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> bytes:
    """The unpacked bytes of a gzip file, up to the limit."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
            out = stream.read(limit + 1)
    except (OSError, EOFError, zlib.error) as problem:
        raise error(f"{_name(path)}: the {what} is not a gzip file: {_said(problem)}") from None
    if len(out) > limit:
        raise error(f"{_name(path)}: the {what} has more than {limit} bytes unpacked, which is the most that is read")
    return out


def read_input_text(path: str | os.PathLike[str], what: str, limit: int, error: type[InputError]) -> str:
    """The text of a UTF-8 file, or of one packed by gzip (``*.gz``), without a byte order mark.

    Raises:
        InputError: as for `open_input`, or its content is not UTF-8; the message names line and byte.
    """
    data = read_input(path, what, limit, error)
    if os.fspath(path).endswith(".gz"):
        data = _unpacked(data, path, what, limit, error)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        line = data.count(b"\n", 0, problem.start) + 1
        byte = f"byte 0x{data[problem.start]:02x} at offset {problem.start}"
        raise error(f"{_name(path)}:{line}: the {what} is not UTF-8: {byte}") from None


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The path, if a file can be made there.

    Raises:
        InputError: it is a folder, its folder is missing or not writable, or the command has read it.
    """
    try:
        target = Path(path)
        target.exists()  # a name that the system refuses fails here
    except (OSError, TypeError, ValueError) as error:
        raise InputError(f"{path!s:.80}: is not a file name: {getattr(error, 'strerror', None) or error}") from None
    if not target.name:
        raise InputError(f"{str(path)!r}: is not a file name")
    if target.is_dir():
        raise InputError(f"{target}: is a folder; give the name of a file")
    if target.exists() and not target.is_file():  # it would be replaced by a file
        raise InputError(f"{target}: is a device or a pipe; give the name of a file")
    folder = target.parent
    if not folder.is_dir():
        raise InputError(f"{target}: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{target}: the folder {folder} is not writable")
    refuse_input(target)
    return target


def write_json(path: str | os.PathLike[str], document: object) -> Path:
    """Write a document as JSON: the whole file or nothing (NaN and infinity are refused).

    Raises:
        InputError: the file cannot be written, or the document is not JSON.
    """
    target = check_writable(path)
    return atomic_write(target, json_text(document, str(target)).encode())


def json_text(document: object, where: str) -> str:
    """A document as JSON (NaN and infinity are refused), for a place that messages call ``where``.

    Raises:
        InputError: the document is not JSON.
    """
    try:
        return json.dumps(document, indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{where}: the document is not JSON: {error}") from None


def atomic_write(target: Path, data: bytes) -> Path:
    """Write a file that `check_writable` has passed: all of it or nothing. An existing file keeps its mode.

    Raises:
        InputError: the file cannot be written, or the command has read it.
    """
    refuse_input(target)
    name = None
    try:
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o644
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name[:100]}.", suffix=".part")
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())  # else a crash could leave the new name with nothing behind it
        os.chmod(name, mode)
        status = os.stat(name)
        os.replace(name, target)
        name = None
        if _command is not None:
            _command.written.add((status.st_dev, status.st_ino))
    except OSError as error:
        raise InputError(f"{target}: cannot write: {error.strerror or error}") from None
    finally:
        if name is not None:
            with suppress(OSError):
                os.unlink(name)
    return target


@contextmanager
def scratch_folder(target: Path) -> Iterator[Path]:
    """A folder in which others write on the way to a file; it is removed with its contents.

    Raises:
        InputError: there is no room for the file, or it cannot be written.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="elastic-strips-", ignore_cleanup_errors=True) as folder:
            yield Path(folder)
    except OSError as error:
        said = " ".join((error.strerror or str(error)).split())
        raise InputError(f"{target}: cannot write: {said[:300]}") from None


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
