"""A progress bar that appears only in a terminal, and only when something takes longer than two seconds."""

from __future__ import annotations

from time import perf_counter
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

_PATIENCE = 2.0


class LateProgress:
    """Context manager: call :meth:`step` often; after two seconds a bar is drawn on standard error, if that is a
    terminal.

    Args:
        label: what is being done.
        total: number of steps, or None where it is not known.
    """

    def __init__(self, label: str, total: int | None = None) -> None:
        self._label, self._total = label, total
        self._console = Console(stderr=True)
        self._progress: Progress | None = None
        self._count = 0

    def __enter__(self) -> LateProgress:
        self._begin = perf_counter()
        return self

    def step(self, note: str = "") -> None:
        """One step is done; ``note`` is shown beside the bar."""
        self._count += 1
        if self._progress is None and self._console.is_terminal and perf_counter() - self._begin > _PATIENCE:
            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
                       TextColumn("{task.fields[note]}"))  # fmt: skip
            self._progress = Progress(*columns, console=self._console, transient=True)
            self._task = self._progress.add_task(self._label, total=self._total, note=note)
            self._progress.start()
        if self._progress is not None:
            self._progress.update(self._task, completed=self._count, note=note)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._progress is not None:
            self._progress.stop()
