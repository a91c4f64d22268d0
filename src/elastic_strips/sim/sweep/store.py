"""The table of a sweep: a journal that survives the end of its process at any moment, folded into CSV, Parquet or
JSON lines."""

from __future__ import annotations

import csv
import errno
import fcntl
import io
import json
import logging
import os
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any

from elastic_strips._version import __version__
from elastic_strips.arrays import Document
from elastic_strips.errors import InputError, missing_extra, nearest_name
from elastic_strips.files import atomic_write, check_writable, read_input, refuse_input
from elastic_strips.sim.jobs import run_jobs
from elastic_strips.validation import check_type, shown

from .document import Sweep, SweepError
from .runs import Row, Run, empty, execute, failed

_LOG = logging.getLogger(__name__)
FORMAT, FORMAT_VERSION = "elastic-strips-sweep", 1
SUFFIXES = (".csv", ".parquet", ".jsonl")
_MOST_BYTES = 4_000_000_000
_FOLD_EVERY = 10.0  # [s]
_FOLD_SHARE = 0.05
"""Part of the time that rewriting the whole table may take up."""


class SweepStore:
    """Context manager: the rows of a sweep, kept in ``FILE.journal`` as they come, and in ``FILE`` from time to time.

    The journal is the sweep's memory: a line with the sweep's document, then one line for each row, each written by one
    call. A last line without an end was being written when the process ended; it is cut off, and its run is run again.
    The table is written whole or not at all: every ten seconds or later, and when the store is closed.

    Args:
        sweep: the sweep.
        path: the table's file: ``.csv``, ``.parquet`` (extra ``sweep``) or ``.jsonl``.

    Attributes:
        rows: run → its last row.

    Raises:
        SweepError: another ending, a table or journal of another sweep, or one that another process is writing.
        InputError: the file cannot be written.
        MissingExtraError: pyarrow is not installed.
    """

    def __init__(self, sweep: Sweep, path: str | os.PathLike[str]) -> None:
        check_type("sweep", sweep, Sweep)
        self.sweep: Sweep = sweep
        self.path: Path = check_writable(path)
        self.suffix: str = self.path.suffix.lower()
        if self.suffix not in SUFFIXES:
            raise SweepError(
                f"{self.path}: unknown ending {shown(self.path.suffix)}{nearest_name(self.suffix, SUFFIXES)}"
            )
        if self.suffix == ".parquet":
            _pyarrow()
        self.journal: Path = check_writable(self.path.with_name(self.path.name + ".journal"))
        self.rows: dict[int, Row] = {}
        self._columns = sweep.columns()
        self._folded_at, self._took, self._changed = monotonic(), 0.0, False
        self._stream = self._opened()
        try:
            self._changed = bool(self._read())
        except BaseException:
            os.close(self._stream)
            raise

    def __enter__(self) -> SweepStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self.rows:
                self.fold()
            else:  # nothing has been run: nothing is left behind
                self.journal.unlink(missing_ok=True)
        except InputError as problem:
            if error is None:
                raise
            _LOG.warning("%s", problem)  # what ended the sweep is said, not what came of it
        finally:
            os.close(self._stream)

    def todo(self, *, retry_failed: bool = False) -> list[Run]:
        """The runs that have no row yet; with ``retry_failed`` also those that ended in an error."""
        return [run for run in self.sweep.runs() if self._open(run.index, retry_failed)]

    def _open(self, index: int, retry_failed: bool) -> bool:
        row = self.rows.get(index)
        return row is None or (retry_failed and row["error_type"] is not None)

    @property
    def failed(self) -> list[Row]:
        """The rows with an error, in the order of the runs."""
        return [row for _, row in sorted(self.rows.items()) if row["error_type"] is not None]

    def add(self, row: Row) -> None:
        """Keep a row; one of the same run is replaced.

        Raises:
            SweepError: it cannot be written, or has other columns.
        """
        if row.keys() != self._columns.keys():
            other = ", ".join(sorted(row.keys() ^ self._columns.keys()))
            raise SweepError(f"a row has other columns ({other}): a worker runs another version than {__version__}?")
        self._write(row)
        self.rows[int(row["run"] or 0)] = row
        self._changed = True
        if monotonic() - self._folded_at > max(_FOLD_EVERY, self._took / _FOLD_SHARE):
            self.fold()

    def fold(self) -> None:
        """Write the table, if rows have come since.

        Raises:
            InputError: it cannot be written.
        """
        if not self._changed:
            return
        began = monotonic()
        os.fsync(self._stream)
        rows = [self.rows[k] for k in sorted(self.rows)]
        if self.suffix == ".parquet":
            data = self._parquet(rows)
        elif self.suffix == ".csv":
            data = self._csv(rows)
        else:
            data = "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows).encode()
        atomic_write(self.path, data)
        self._folded_at, self._changed = monotonic(), False
        self._took = self._folded_at - began

    def _opened(self) -> int:
        """The journal, for this process alone."""
        if self.path.exists() and not self.journal.exists():
            raise SweepError(
                f"{self.path}: is there, but the journal of its sweep ({self.journal.name}) is not; it would be "
                "overwritten: give another name, or remove it"
            )
        refuse_input(self.journal)
        while True:
            try:
                stream = os.open(self.journal, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            except OSError as error:
                raise SweepError(f"{self.journal}: cannot write: {error.strerror}") from None
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)  # ends with the process, whatever ends it
                if os.path.samestat(os.fstat(stream), os.stat(self.journal)):
                    return stream
            except FileNotFoundError:  # one that had run nothing has removed it meanwhile
                pass
            except BlockingIOError:
                os.close(stream)
                raise SweepError(f"{self.journal}: another process is writing this sweep") from None
            except OSError as error:
                os.close(stream)
                raise SweepError(f"{self.journal}: cannot be locked there: {error.strerror}") from None
            os.close(stream)

    def _read(self) -> int:
        """Read the journal, and cut off an unfinished last line; returns how many rows there were."""
        data = read_input(self.journal, "journal of a sweep", _MOST_BYTES, SweepError)
        whole = data[: data.rfind(b"\n") + 1]
        try:
            if len(whole) < len(data):
                os.ftruncate(self._stream, len(whole))
        except OSError as error:
            raise SweepError(f"{self.journal}: cannot write: {error.strerror}") from None
        if not whole:
            head = {
                "format": FORMAT,
                "version": FORMAT_VERSION,
                "elastic_strips": __version__,
                "digest": self.sweep.digest,
                "columns": list(self._columns),
                "sweep": self.sweep.document(),
            }
            self._write(head)
            return 0
        first, *lines = whole.splitlines()
        self._check_head(self._parsed(first, 1))
        for number, line in enumerate(lines, 2):
            row = self._parsed(line, number)
            if set(row) != set(self._columns) or not isinstance(k := row["run"], int) or not 0 <= k < len(self.sweep):
                raise SweepError(f"{self.journal}:{number}: is damaged: no row of this sweep")
            self.rows[k] = {name: row[name] for name in self._columns}
        return len(lines)

    def _parsed(self, line: bytes, number: int) -> dict[str, Any]:
        try:
            value = json.loads(line)
        except (ValueError, RecursionError):
            value = None
        if not isinstance(value, dict):
            raise SweepError(f"{self.journal}:{number}: is damaged: no line of a journal")
        return value

    def _check_head(self, head: dict[str, Any]) -> None:
        if head.get("format") != FORMAT or not isinstance(head.get("sweep"), dict):
            raise SweepError(f"{self.journal}:1: is not a journal of a sweep")
        if head.get("version") != FORMAT_VERSION:
            raise SweepError(f"{self.journal}:1: has version {shown(head.get('version'))}, not {FORMAT_VERSION}")
        if differences := _differences(head["sweep"], self.sweep.document()):
            raise SweepError(
                f"{self.path}: belongs to another sweep than {self.sweep.path}, give another name, or remove it and "
                f"{self.journal.name}: {differences}"
            )
        made = head.get("elastic_strips")
        if head.get("columns") != list(self._columns):
            raise SweepError(
                f"{self.path}: elastic_strips {shown(made)} made it, with other columns; give another name"
            )
        if made != __version__:
            _LOG.warning("%s: elastic_strips %s made its first rows; this is %s", self.path, made, __version__)

    def _write(self, document: Document | Row) -> None:
        line = json.dumps(document, allow_nan=False).encode() + b"\n"
        before = os.fstat(self._stream).st_size
        try:
            if os.write(self._stream, line) < len(line):
                os.ftruncate(self._stream, before)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise SweepError(f"{self.journal}: cannot write: {error.strerror}") from None

    def _csv(self, rows: list[Row]) -> bytes:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, list(self._columns), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue().encode()

    def _parquet(self, rows: list[Row]) -> bytes:
        arrow, parquet = _pyarrow()
        kinds = {bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
        schema = arrow.schema(
            [(name, kinds[kind]) for name, kind in self._columns.items()],
            metadata={
                "elastic_strips": __version__,
                "sweep": json.dumps(self.sweep.document()),
                "digest": self.sweep.digest,
            },
        )
        made = {
            name: [str(v) if kind is str and v is not None else v for v in (row[name] for row in rows)]
            for name, kind in self._columns.items()
        }
        stream = io.BytesIO()
        parquet.write_table(arrow.table(made, schema=schema), stream)
        return stream.getvalue()


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise missing_extra("a Parquet file", "pyarrow", "sweep") from None
    return pyarrow, pyarrow.parquet


def _differences(old: Document, new: Document) -> str:
    """The differences of two documents of sweeps, for a message; empty where there are none."""
    found = []
    for key in dict.fromkeys((*old, *new)):
        a, b = old.get(key), new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            found += [
                f"{key}.{name} was {_told(a, name)}, is {_told(b, name)}"
                for name in dict.fromkeys((*a, *b))
                if a.get(name) != b.get(name)
            ]
            if a == b and list(a) != list(b):
                found.append(f"the order of {key} was {', '.join(a)}, is {', '.join(b)}")
        elif a != b:
            found.append(f"{key} was {_brief(a)}, is {_brief(b)}")
    return "; ".join(found)[:600]


def _told(values: dict[str, Any], name: str) -> str:
    return _brief(values[name]) if name in values else "not given"


def _brief(value: object) -> str:
    if isinstance(value, list) and len(value) > 6:
        return f"[{', '.join(map(str, value[:3]))}, … {len(value)} entries]"
    return shown(value)


def run_sweep(
    store: SweepStore,
    *,
    processes: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
) -> Generator[Row, None, None]:
    """Run all runs that have no row in a store; yields each row once kept. A run that fails is a row with its error.

    Args:
        store: store of the sweep.
        processes: number of processes; one for each core where None.
        scheduler: address of a Dask scheduler; processes of this machine where None.
        retry_failed: whether to run again runs that ended in an error.

    Raises:
        ParameterError, SchedulerLost, MissingExtraError: as for :func:`~elastic_strips.sim.jobs.run_jobs`.
        InputError: a row cannot be written.
    """
    runs = store.todo(retry_failed=retry_failed)
    if not runs:
        return
    with closing(run_jobs(execute, runs, processes=processes, scheduler=scheduler)) as jobs:
        for finished in jobs:
            run = runs[finished.index]
            if finished.made is None:  # its process ended
                row = empty(run) | failed(finished.error or RuntimeError("no row"))
            else:
                row = finished.made
            store.add(row)
            yield row
