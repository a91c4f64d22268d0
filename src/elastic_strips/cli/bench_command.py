"""``elastic-strips bench``: measure on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..io import check_writable, write_json
from ..io.files import write_whole
from ..robot import load_robot
from ..sim.bench import bench_plan, bench_replan, bench_robots, bench_tick, robot_cases, robots_table, with_table
from .bench_drive_command import COMMANDS
from .group import Finite
from .progress import LateProgress

_robot = click.option("--robot", default="silvermate", show_default=True, metavar="NAME|FILE.urdf", help="The robot.")
_seeds = click.option(
    "--seeds", type=click.IntRange(1, 100_000), default=100, show_default=True, help="Number of corridors."
)
_json = click.option("--json", "json_file", type=click.Path(), metavar="FILE", help="Write all figures.")


@click.group()
def bench() -> None:
    """Measure on this machine. The figures are percentiles; on a shared machine trust the ratios."""


@bench.command(short_help="From nothing to a certified strip.")
@_robot
@_seeds
@click.option("--scenario", default="corridor", show_default=True, metavar="NAME", help="A seeded scenario.")
@click.option("--grid/--no-grid", default=True, show_default=True, help="Try a way over a grid before OMPL.")
@_json
def plan(robot: str, seeds: int, scenario: str, grid: bool, json_file: str | None) -> None:
    """Plan the corridor (or another scenario) of many seeds: how often, how fast, how clear."""
    if json_file is not None:
        check_writable(json_file)
    model = load_robot(robot)
    with LateProgress("planning", seeds) as bar:
        figures = bench_plan(model, seeds, bar.step, scenario=scenario, grid=grid)
    what = "corridors" if scenario == "corridor" else f"seeds of {scenario}"
    click.echo(f"{figures['robot']} ({figures['base']}), {seeds} {what}")
    _row("certified", f"{100 * figures['certified']:.1f} %")
    _row("within 2 s", f"{100 * figures['certified_within_2_s']:.1f} %")
    _row("by the line alone", f"{100 * figures['line_alone']:.1f} %")
    _row("time to certified", _times(figures["time_to_certified_ms"]))
    clear = figures["clearance_m"]
    _row("clearance", f"min {clear['min']:.3f} m, {100 * clear['at_least_2cm']:.1f} % at least 2 cm")
    _row("largest lateral slip", f"{figures['max_lateral_slip_m']:.1e} m")
    for failure in figures["failures"]:
        _row(f"seed {failure['seed']} failed", failure["reason"])
    _write(json_file, figures)


@bench.command(short_help="Certified again after an obstacle moved.")
@_robot
@_seeds
@_json
def replan(robot: str, seeds: int, json_file: str | None) -> None:
    """Push the nearest obstacle 5 cm towards each planned strip, 4 times."""
    if json_file is not None:
        check_writable(json_file)
    model = load_robot(robot)
    with LateProgress("replanning", seeds) as bar:
        figures = bench_replan(model, seeds, bar.step)
    click.echo(f"{figures['robot']}, {figures['pushes']} pushes on {seeds} corridors")
    _row("certified again", f"{100 * figures['certified']:.1f} %")
    _row("time", _times(figures["time_to_certified_ms"]))
    _row(
        "ticks",
        f"p50 {figures['ticks']['p50']:.0f}, p99 {figures['ticks']['p99']:.0f}, max {figures['ticks']['max']:.0f}",
    )
    jump = figures["jump_m"]
    _row("jump of the strip", f"p50 {jump['p50']:.3f} m, p99 {jump['p99']:.3f} m")
    for failure in figures["failures"]:
        _row(f"seed {failure['seed']} push {failure['push']}", failure["reason"])
    _write(json_file, figures)


@bench.command(short_help="One control tick, and how it scales.")
@_robot
@click.option("--ticks", type=click.IntRange(20, 100_000), default=200, show_default=True, help="Measured ticks.")
@click.option("--scaling/--no-scaling", default=True, help="Also against the numbers of nodes and obstacles.")
@_json
def tick(robot: str, ticks: int, scaling: bool, json_file: str | None) -> None:
    """One tick on 64 nodes and 32 obstacles while one of them moves 2 cm per tick.

    In the same run, for the ratio: pin.computeDistances over every pair on the same strip.
    """
    if json_file is not None:
        check_writable(json_file)
    model = load_robot(robot)
    with LateProgress("ticking", 10 if scaling else 1) as bar:
        figures = bench_tick(model, ticks, bar.step, scaling=scaling)
    click.echo(
        f"{figures['robot']}, {figures['nodes']} nodes, {figures['obstacles']} obstacles, {figures['links']} links"
    )
    _row("tick", _times(figures["tick_ms"]))
    every = figures["every_pair"]
    _row("every pair", f"{_times(every['ms'])} ({every['pairs_per_node']} pairs a node)")
    _row("ratio of medians", f"{figures['ratio_p50']:.2f}")
    _row("certified", f"{100 * figures['certified']:.1f} %, {figures['queries_per_tick']:.0f} exact queries a tick")
    for phase, ms in figures["phases_ms"].items():
        _row(f"  {phase}", f"{ms:.3f} ms")
    _row("  sum / tick mean", f"{figures['phases_sum_ms']:.3f} / {figures['tick_mean_ms']:.3f} ms")
    for what in ("nodes", "obstacles"):
        for count, figure in figures.get(f"{what}_scaling", {}).items():
            _row(f"{count} {what}", _times(figure))
    _write(json_file, figures)


@bench.command(short_help="Load every robot, plan and settle a small problem.")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--data", metavar="DIR", type=click.Path(exists=True, file_okay=False), help="Every URDF of a folder, too."
)
@click.option("--timeout", type=Finite(0.01, 3600), default=10.0, show_default=True, help="Longest planning [s].")
@click.option(
    "--table",
    "table_file",
    type=click.Path(),
    metavar="FILE.md",
    help="Write the table there, between its marks if the file has them.",
)
@_json
def robots(
    names: tuple[str, ...], data: str | None, timeout: float, table_file: str | None, json_file: str | None
) -> None:
    """Load the named robots (all of "elastic-strips list --robots" by default), and those of a folder.

    Each goes from home to another posture, past a sphere in its way.
    """
    for file in (table_file, json_file):
        if file is not None:
            check_writable(file)
    cases = robot_cases(names, data)
    with LateProgress("trying robots", len(cases)) as bar:
        figures = bench_robots(cases, bar.step, timeout=timeout)
    text = robots_table(figures)
    click.echo(text, nl=False)
    if table_file is not None:
        page = Path(table_file)
        text = with_table(page.read_text(encoding="utf-8") if page.is_file() else "", text)
        click.echo(f"table   {write_whole(page, text.encode())}")
    _write(json_file, figures)


def _times(figure: dict[str, Any]) -> str:
    if figure["p50"] is None:
        return "-"
    return ", ".join(f"{p} {figure[p]:.2f}" for p in ("p50", "p95", "p99")) + " ms"


def _row(label: str, text: str) -> None:
    click.echo(f"  {label:<22} {text}")


def _write(json_file: str | None, figures: dict[str, Any]) -> None:
    if json_file is not None:
        click.echo(f"figures {write_json(json_file, figures)}")


for command in COMMANDS:
    bench.add_command(command)
