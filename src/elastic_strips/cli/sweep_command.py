"""``elastic-strips sweep``: scenarios × parameters × seeds into a table that can be resumed."""

from __future__ import annotations

import shlex
from contextlib import closing
from time import perf_counter

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from elastic_strips.errors import InputError
from elastic_strips.sim.jobs import SchedulerLost
from elastic_strips.sim.sweep import Plot, Sweep, SweepStore, plot_sweep, read_sweep, run_sweep
from elastic_strips.sim.sweep.plot import plot_columns

from . import EXIT_INTERRUPTED, options

_SAY_EVERY = 10.0  # [s]
_TOLD = 5


@click.command()
@click.argument("file", metavar="FILE.yaml")
@click.option(
    "--out", metavar="FILE.csv|.parquet|.jsonl", type=click.Path(),
    help="The table; beside it FILE.journal, from which the sweep is resumed.  [default: the sweep's name, .csv]",
)  # fmt: skip
@click.option("--jobs", type=click.IntRange(1, 256), help="How many runs at once; one for each core by default.")
@click.option(
    "--scheduler", metavar="tcp://HOST:PORT",
    help="Run on the workers of this Dask cluster instead (pip install 'elastic-strips[sweep]').",
)  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Run again what ended in an error.")
@click.option("--dry-run", is_flag=True, help="List the runs, and run none.")
@click.option(
    "--plot", "plot_file", metavar="FILE.png", type=options.OutputFile(),
    help="Draw the table (pip install 'elastic-strips[study]').",
)  # fmt: skip
@click.option("--x", metavar="COLUMN", help="Of the plot; what varies first by default.")
@click.option("--y", metavar="COLUMN", help="Of the plot; clearance_m of plans, time_s of drives by default.")
@click.option("--hue", metavar="COLUMN", help="Of the plot: a colour for each value; what varies next by default.")
def sweep(
    file: str,
    out: str | None,
    jobs: int | None,
    scheduler: str | None,
    retry_failed: bool,
    dry_run: bool,
    plot_file: str | None,
    x: str | None,
    y: str | None,
    hue: str | None,
) -> int:
    """Run everything that FILE.yaml asks for: scenarios x robots x presets x parameters x seeds.

    Each run is a row of the table, one that fails too. The same command again goes on where it was interrupted, by
    Ctrl-C, kill -9 or the end of the machine, and runs nothing twice.

    Exit code 0: every run has a result. 2: wrong input. 3: some ended in an error. 130: interrupted.
    """
    if scheduler and jobs:
        raise click.UsageError("--jobs is of this machine; the cluster of --scheduler has its own workers")
    if not plot_file and (x or y or hue):
        raise click.UsageError("--x, --y and --hue are of the picture: --plot FILE.png")
    found = read_sweep(file)
    plot = Plot(x, y, hue)
    if plot_file:
        plot_columns(found, plot)
    if dry_run:
        return _list(found)
    table = out or f"{found.path.stem}.csv"
    options.check_outputs(file, table, plot_file)
    again = shlex.join(
        ["elastic-strips", "sweep", file, *(["--out", out] if out else []), *(["--jobs", str(jobs)] if jobs else []),
         *(["--scheduler", scheduler] if scheduler else []), *(["--plot", plot_file] if plot_file else [])]
    )  # fmt: skip
    with SweepStore(found, table) as store:
        todo = store.todo(retry_failed=retry_failed)
        done = len(found) - len(todo)
        click.echo(
            f"{found.path.stem}: {_runs(len(found))}" + (f", {done} done before, {len(todo)} to go" * (done > 0))
        )
        try:
            rows = run_sweep(store, processes=jobs, scheduler=scheduler, retry_failed=retry_failed)
            with closing(rows), _Progress(found.path.stem, len(todo)) as bar:
                for row in rows:
                    bar.step(row["error_type"] is not None)
        except (KeyboardInterrupt, SchedulerLost) as reason:
            lost = isinstance(reason, SchedulerLost)
            text = f"error: {reason}" if lost else "interrupted"
            click.echo(f"{text}; {len(store.rows)} of {_runs(len(found))} are kept. Go on with:\n  {again}", err=True)
            return options.EXIT_NOT_DONE if lost else EXIT_INTERRUPTED
        except InputError as error:
            error.args = (f"{error} ({len(store.rows)} of {_runs(len(found))} are kept)",) if store.rows else error.args
            raise
    failed = store.failed
    click.echo(f"table   {store.path}  ({len(store.rows)} rows, {len(failed)} with an error)")
    for row in failed[:_TOLD]:
        click.echo(f"  run {row['run']}, {row['scenario']}, seed {row['seed']}: {row['error_type']}: {row['error']}")
    if len(failed) > _TOLD:
        click.echo(f"  … and {len(failed) - _TOLD} more")
    if plot_file:
        drawn = plot_sweep(found, list(store.rows.values()), plot_file, plot=plot)
        click.echo(
            f"plot    {plot_file}  ({drawn.y} over {drawn.x}" + (f", {drawn.hue} in colours)" if drawn.hue else ")")
        )
    return options.EXIT_NOT_DONE if failed else options.EXIT_DONE


def _list(found: Sweep) -> int:
    click.echo(f"{found.path.stem}: {_runs(len(found))}")
    for run in found.runs():
        click.echo(f"  {run.index:>6}  {run}")
    return options.EXIT_DONE


def _runs(count: int) -> str:
    return f"{count} run{'s' if count != 1 else ''}"


class _Progress:
    """Context manager: how many are done, and about how long the rest takes; on standard error, as a bar where that is
    a terminal, else as a line every ten seconds."""

    def __init__(self, label: str, total: int) -> None:
        self._label, self._total, self._done, self._failed = label, total, 0, 0
        console = Console(stderr=True)
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
        )
        self._bar = Progress(*columns, console=console, transient=True) if console.is_terminal and total else None

    def __enter__(self) -> _Progress:
        self._began = self._told = perf_counter()
        if self._bar is not None:
            self._task = self._bar.add_task(self._label, total=self._total, note="")
            self._bar.start()
        return self

    def step(self, failed: bool) -> None:
        """One run is done."""
        self._done += 1
        self._failed += failed
        now = perf_counter()
        left = (now - self._began) / self._done * (self._total - self._done)
        note = f"about {_duration(left)} left" + (f", {self._failed} with an error" if self._failed else "")
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, note=note)
        elif now - self._told > _SAY_EVERY and self._done < self._total:
            self._told = now
            click.echo(f"{self._label}: {self._done} of {self._total}, {note}", err=True)

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()


def _duration(seconds: float) -> str:
    """Such as 40 s, 3 min 20 s or 2 h 5 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
