"""The bar that shows how far a command has come, and about how long the rest takes."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING

import click

from elastic_strips.progress import PROGRESS_PERIOD

if TYPE_CHECKING:
    from rich.progress import Progress

_REPORT_PERIOD = 10.0  # [s] between lines of progress where standard error is no terminal
_LEAST_DONE = 0.03  # of the way, before which it is not known how long the rest takes


class LateProgress:
    """Context manager: call :meth:`step` often; after two seconds a bar is drawn on standard error, if that is a
    terminal: how many steps are done, and about how long the rest takes.

    Args:
        label: what is being done.
        total: number of steps, or None where it is not known.
        lines: whether the same is said without a terminal, as a line every ten seconds.
    """

    def __init__(self, label: str, total: int | None = None, *, lines: bool = False) -> None:
        self._label, self._total, self._lines = label, total, lines
        self._progress: Progress | None = None
        self._looked = False
        self._count = 0
        self._way = 0.0

    def __enter__(self) -> LateProgress:
        self._begin = self._said = self._set_off = perf_counter()
        return self

    def step(self, note: str = "") -> None:
        """One step is done; ``note`` is shown beside the bar."""
        self._count += 1
        now = perf_counter()
        if self._total is not None:
            share = self._count / self._total
            note = _with_rest(note, (now - self._begin) * (1.0 / share - 1.0))
        self._show(now, self._count, self._total, f"{self._count}/{self._total or '?'}", note)
        if self._progress is None and self._lines and now - self._said > _REPORT_PERIOD and self._count != self._total:
            self._said = now
            click.echo(f"{self._label}: {self._count} of {self._total or '?'}, {note}", err=True)

    def come(self, left: float, way: float, unit: str, note: str = "") -> None:
        """Instead of a step: what is ``left`` of a way, which may be another way than before."""
        now = perf_counter()
        if way != self._way:
            self._way, self._set_off = way, now
        done = min(max(way - left, 0.0), way)
        if done > _LEAST_DONE * way and now > self._set_off:
            note = _with_rest(note, (now - self._set_off) * (way - done) / done)
        self._show(now, done, way, f"{done:.1f} of {way:.1f} {unit}", note)

    def _show(self, now: float, done: float, total: float | None, said: str, note: str) -> None:
        if not self._looked and now - self._begin > PROGRESS_PERIOD:
            self._looked = True
            self._draw()
        if self._progress is not None:
            self._progress.update(self._task, completed=done, total=total, said=said, note=note)

    def _draw(self) -> None:
        try:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
        except ImportError:  # the doctor has to say so
            return
        console = Console(stderr=True)
        if console.is_terminal and not console.is_dumb_terminal:
            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TextColumn("{task.fields[said]}", markup=False),
                TimeElapsedColumn(),
                TextColumn("{task.fields[note]}", markup=False),
            )
            self._progress = Progress(*columns, console=console, transient=True)
            self._task = self._progress.add_task(self._label, total=None, said="", note="")
            self._progress.start()

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()


def _with_rest(note: str, seconds: float) -> str:
    """A note after how long the rest takes."""
    return ", ".join(filter(None, (f"about {duration(max(0.0, seconds))} left", note)))


def duration(seconds: float) -> str:
    """A duration, such as 40 s, 3 min 20 s or 2 h 5 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
