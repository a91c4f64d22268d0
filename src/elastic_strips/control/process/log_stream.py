"""Log stream: rows that are written to disk while a run goes on, so that a killed process leaves its log behind."""

from __future__ import annotations

import json
import logging
import math
import os
import threading
import time
from collections import deque
from collections.abc import Mapping

import numpy as np

from elastic_strips.control.record import RecordError
from elastic_strips.files import read_input

_log = logging.getLogger(__name__)
_WRITE_PERIOD = 0.05  # [s] from one write to the next
_RETRY_AFTER = 1.0  # [s] after a write that failed
_LOG_DECIMALS = 6
_CHUNK_SIZE = 1 << 20  # [bytes] about so much is formatted before it is written
_LARGEST_LOG = 1 << 32  # [bytes]


class LogStream:
    """Workspace: a log of JSON lines; a thread of its own formats and writes them.

    What was written survives the process, however it ends: at most about 0.1 s of rows is lost. It does not survive the
    machine, whose disk may be written later. In a process with raised priority it is to be made after that was raised
    (:func:`~elastic_strips.control.process.priority.raise_priority`).

    Args:
        path: the file; one that exists is replaced.
        capacity: largest number of rows that wait where the disk is full or slow; beyond it the oldest are dropped.

    Raises:
        RecordError: the file cannot be opened.
    """

    def __init__(self, path: str | os.PathLike[str], *, capacity: int = 20_000) -> None:
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_CLOEXEC", 0)
            self._file = os.open(path, flags, 0o644)
        except OSError as error:
            raise RecordError(f"{os.fspath(path)}: cannot write the log: {error.strerror}") from None
        self._path = os.fspath(path)
        self._rows: deque[tuple[int, dict[str, object]]] = deque(maxlen=capacity)
        self._given = 0  # rows so far
        self._next = 0  # number of the row that comes next if none was dropped
        self._bytes = b""  # formatted, not written
        self._waiting = 0  # rows in them
        self.error: str = ""
        """Present trouble with the file; empty where all is well."""
        self.lost: int = 0
        """Rows that will never be written."""
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Trouble with the file, and how many rows are lost so far; empty where there was none."""
        lost = f"{self.lost} rows are lost" if self.lost else ""
        return "; ".join(filter(None, (self.error, lost)))

    def row(self, values: Mapping[str, object]) -> None:
        """Write a row; returns at once.

        Args:
            values: by name: text, numbers, arrays, lists and mappings of them. Arrays are copied here, unless they are
                inside something else; they are written with 6 decimals. Where a number is not finite, null is
                written.
        """
        row = {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in values.items()}
        self._rows.append((self._given, row))  # a full deque drops its oldest
        self._given += 1

    def close(self) -> None:
        """Write the waiting rows, once, and close the file."""
        if self._end.is_set():
            return
        self._end.set()
        self._thread.join()
        os.close(self._file)

    def __enter__(self) -> LogStream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while not self._end.wait(_RETRY_AFTER if self.error else _WRITE_PERIOD):
            self._write()
        self._write()
        if self.error:  # the disk is still full
            self.lost += self._waiting + len(self._rows)

    def _write(self) -> None:
        """Write all rows that wait; rows that the disk does not take are kept."""
        try:
            while self._rows or self._bytes:
                if not self._bytes:
                    self._format()
                done = os.write(self._file, self._bytes)
                self._bytes = self._bytes[done:]  # the rest of a torn line is what is written next
                self.error = ""
        except OSError as error:
            self.error = f"{self._path}: the log cannot be written: {error.strerror}"

    def _format(self) -> None:
        lines: list[bytes] = []
        size = 0
        while self._rows and size < _CHUNK_SIZE:
            number, row = self._rows.popleft()
            self.lost += number - self._next
            self._next = number + 1
            try:
                line = _line(row)
            except Exception as error:  # a value that cannot be shown costs its row, not the log
                _log.warning("%s: row %d is left out: %s", self._path, number, error)
                self.lost += 1
                continue
            lines.append(line)
            size += len(line)
            time.sleep(0.0)  # lets the loop have the interpreter's lock
        self._bytes, self._waiting = b"".join(lines), len(lines)


def _line(row: dict[str, object]) -> bytes:
    return json.dumps(_plain(row), default=str, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _plain(value: object) -> object:
    """A value as JSON can hold it."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "f":
            value = np.round(value, _LOG_DECIMALS)
            if np.isfinite(value).all():
                return value.tolist()
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_plain(v) for v in value]
    return value


def read_log(path: str | os.PathLike[str]) -> list[dict[str, object]]:
    """The rows of a log, also of one whose process was killed: a torn last line is left out.

    Raises:
        RecordError: the file cannot be read, or a line before the last one is not a row.
    """
    lines = read_input(path, "log", _LARGEST_LOG, RecordError).split(b"\n")
    rows: list[dict[str, object]] = []
    for number, line in enumerate(lines, start=1):
        if not line:
            continue
        try:
            row = json.loads(line)
        except ValueError:
            row = None
        if isinstance(row, dict):
            rows.append(row)
        elif number < len(lines):
            raise RecordError(f"{os.fspath(path)}: line {number} of the log is not a row: {line[:60]!r}")
    return rows
