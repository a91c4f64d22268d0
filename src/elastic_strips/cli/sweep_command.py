"""``elastic-strips sweep``: scenarios × parameters × seeds into a table that can be resumed."""

from __future__ import annotations

import logging
import shlex
from contextlib import closing, suppress

import click

from elastic_strips.errors import InputError, plural
from elastic_strips.sim.jobs import SchedulerLost
from elastic_strips.sim.mujoco.model import import_mujoco
from elastic_strips.sim.sweep import Plot, Sweep, SweepStore, plot_sweep, read_sweep, run_sweep
from elastic_strips.sim.sweep.plot import check_plot, plot_columns

from . import EXIT_INTERRUPTED, options, output

_FAILURES_TOLD = 5  # runs


@click.command()
@click.argument("file", metavar="FILE.yaml", type=options.FILE)
@click.option(
    "--out",
    metavar="FILE.csv|.parquet|.jsonl",
    type=click.Path(),
    help="The table to write; the sweep is resumed from FILE.journal beside it.  [default: the sweep's name, .csv]",
)
@click.option(
    "--processes", "--jobs", type=options.Whole(1, 256), help="How many runs to do at once; by default one per core."
)
@click.option(
    "--scheduler",
    metavar="tcp://HOST:PORT",
    help="Run on the workers of this Dask cluster instead (the extra sweep).",
)
@click.option("--retry-failed", is_flag=True, help="Repeat the runs that ended in an error.")
@click.option("--dry-run", is_flag=True, help="List the runs without running them.")
@click.option(
    "--plot",
    "plot_file",
    metavar="FILE.png",
    type=options.OutputFile(),
    help="Draw a plot of the table (the extra study).",
)
@click.option("--x", metavar="COLUMN", help="Column on the plot's x axis; by default the first that varies.")
@click.option(
    "--y", metavar="COLUMN", help="Column on the plot's y axis; by default clearance_m of plans, time_s of drives."
)
@click.option(
    "--hue",
    metavar="COLUMN",
    help="Column whose values get a colour each in the plot; by default the next that varies.",
)
@options.json_option("Write what was swept and which runs ended in an error.")
def sweep(
    file: str,
    out: str | None,
    processes: int | None,
    scheduler: str | None,
    retry_failed: bool,
    dry_run: bool,
    plot_file: str | None,
    x: str | None,
    y: str | None,
    hue: str | None,
    json_file: str | None,
) -> int:
    """Run everything that FILE.yaml asks for: scenarios x robots x presets x parameters x seeds. It may be

    \b
      kind: plan                        # as elastic-strips run; or drive
      scenarios: [corridor, case-7]     # names, or scenario files
      seeds: {first: 0, count: 20}      # or a list
      grid:                             # every combination of these values
        influence: [0.2, 0.3, 0.4]
      fixed: {k_c: 1.0}                 # in every run

    and may have robots and presets (lists). Parameters are those of DeformParams, and for drives of DriveParams by
    their dotted names (evasion.horizon); of plans also timeout and base; of drives plant, method, sensors, evade,
    alternatives, level, compute, time_limit, base. A wrong name is answered with the right ones.

    Each run is a row of the table, even if it fails. The same command again goes on where it was interrupted, by
    Ctrl-C, kill -9 or the end of the machine, and runs nothing twice.

    Exit code 0: every run has a result. 2: wrong input. 3: some ended in an error. 130: interrupted.
    """
    if scheduler and processes:
        raise click.UsageError("--processes is for this machine; the cluster of --scheduler has its own workers")
    if not plot_file and (x or y or hue):
        raise click.UsageError("--x, --y and --hue are for the picture: give --plot FILE.png")
    found = read_sweep(file)
    plot = Plot(x, y, hue)
    if plot_file:
        plot_columns(found, plot)
        check_plot(plot_file)
    table = f"{found.path.stem}.csv" if out is None else out
    options.check_outputs(file, table, f"{table}.journal", plot_file, json_file)
    if dry_run:
        _say_runs(found)
        output.write_document("answer", json_file, _document(found, None))
        return options.EXIT_DONE
    if scheduler:
        _quieten_dask()
    elif "mujoco" in (found.fixed.get("plant"), *found.grid.get("plant", ())):
        import_mujoco()  # else every run would say that it is not there
    with SweepStore(found, table) as store:
        try:
            _run_rest(store, processes=processes, scheduler=scheduler, retry_failed=retry_failed)
        except (KeyboardInterrupt, SchedulerLost) as reason:
            given = {
                "--out": out,
                "--processes": processes,
                "--scheduler": scheduler,
                "--plot": plot_file,
                "--x": x,
                "--y": y,
                "--hue": hue,
                "--json": json_file,
            }
            words = [str(word) for option, value in given.items() if value is not None for word in (option, value)]
            again = shlex.join(["elastic-strips", "sweep", file, *words, *(["--retry-failed"] * retry_failed)])
            return _left_off(reason, store, again)
        except InputError as error:
            error.args = (f"{error} ({_kept(store)})",) if store.rows else error.args
            raise
    _say_table(store)
    if plot_file:
        drawn = plot_sweep(found, list(store.rows.values()), plot_file, plot=plot)
        output.say(
            f"plot    {plot_file}  ({drawn.y} over {drawn.x}" + (f", {drawn.hue} in colours)" if drawn.hue else ")")
        )
    output.write_document("answer", json_file, _document(found, store))
    return options.EXIT_NOT_DONE if store.failed else options.EXIT_DONE


def _say_runs(found: Sweep) -> None:
    """List the runs of a sweep."""
    output.say(f"{found.path.stem}: {_runs(len(found))}")
    for run in found.runs():
        output.say(f"  {run.index:>6}  {run}")


def _run_rest(store: SweepStore, *, processes: int | None, scheduler: str | None, retry_failed: bool) -> None:
    """Run what the table does not have yet, with a bar that shows it."""
    title, count = store.sweep.path.stem, len(store.sweep)
    todo = len(store.todo(retry_failed=retry_failed))
    done = count - todo
    output.say(f"{title}: {_runs(count)}" + (f", {done} done before, {todo} to go" * (done > 0)))
    wrong = 0
    rows = run_sweep(store, processes=processes, scheduler=scheduler, retry_failed=retry_failed)
    with closing(rows), options.LateProgress(title, todo, lines=True) as bar:
        for row in rows:
            wrong += row["error_type"] is not None
            bar.step(f"{wrong} with an error" if wrong else "")


def _left_off(reason: BaseException, store: SweepStore, again: str) -> int:
    """Say that a sweep was interrupted, or lost its cluster, and with which command it goes on; the exit code."""
    lost = isinstance(reason, SchedulerLost)
    output.say(
        ("error:", output.BAD) if lost else "interrupted",
        f" {reason}" if lost else "",
        f"; {_kept(store)}. Go on with:\n  {again}",
        err=True,
    )
    return options.EXIT_NOT_DONE if lost else EXIT_INTERRUPTED


def _say_table(store: SweepStore) -> None:
    """Say what the table has, and the first of the runs that ended in an error."""
    failed = store.failed
    count = output.verdict(f"{len(failed)} with an error", not failed)
    output.say(f"table   {store.path}  ({plural(len(store.rows), 'row')}, ", count, ")")
    for row in failed[:_FAILURES_TOLD]:
        output.say(f"  run {row['run']}, {row['scenario']}, seed {row['seed']}: {row['error_type']}: {row['error']}")
    if len(failed) > _FAILURES_TOLD:
        output.say(f"  … and {len(failed) - _FAILURES_TOLD} more")


def _kept(store: SweepStore) -> str:
    return f"{len(store.rows)} of {_runs(len(store.sweep))} are kept"


def _quieten_dask() -> None:
    """Where a worker or the scheduler ends, Dask logs tracebacks of its own; here one line says what happened."""
    with suppress(ImportError):
        import distributed  # noqa: F401 -- which sets the levels of its loggers

        if not logging.getLogger().isEnabledFor(logging.INFO):  # as --verbose has it
            for name in ("distributed", "distributed.client"):
                logging.getLogger(name).setLevel(logging.CRITICAL)


def _document(found: Sweep, store: SweepStore | None) -> dict[str, object]:
    """The document of ``--json``; without a store it is that of a sweep that is not run."""
    document: dict[str, object] = {
        "format": "elastic-strips-sweep-answer",
        "version": 1,
        "sweep": found.document(),
        "runs": len(found),
    }
    if store is None:
        return document | {"listed": [run.identity for run in found.runs()]}
    names = ("run", "scenario", "robot", "seed", *found.grid, "error_type", "error")
    failed = [{name: row[name] for name in names} for row in store.failed]
    return document | {"table": str(store.path), "rows": len(store.rows), "failed": failed}


def _runs(count: int) -> str:
    return plural(count, "run")
