"""``elastic-strips bench drive | faults | barn | dynabarn | bridge``: the closed loop, many times."""

from __future__ import annotations

from typing import Any

import click

from ..io import check_writable, write_json
from ..robot import load_robot
from ..sim.bench import bench_bridge, bench_drive, bench_faults, bench_problems, bench_reaction, bench_soak
from ..sim.scenarios import DRIVE_METHODS, PLANTS, STRIP
from .group import Finite
from .progress import LateProgress
from .sensor_option import sensors_of, sensors_option

_json = click.option("--json", "json_file", type=click.Path(), metavar="FILE", help="Write all figures and runs.")
_processes = click.option(
    "--processes", type=click.IntRange(1, 256), help="How many runs at once; one for each core by default."
)
_root = click.option(
    "--root", required=True, metavar="DIR", type=click.Path(exists=True, file_okay=False),
    help="Folder with the data: DIR/barn, DIR/dynabarn, DIR/bridge.",
)  # fmt: skip


@click.command(short_help="Drive among moving obstacles, many seeds.")
@click.option("--robot", default="silvermate", show_default=True, metavar="NAME|FILE.urdf", help="The robot.")
@click.option("--scenario", default="moving-corridor", show_default=True, metavar="NAME", help="A seeded scenario.")
@click.option("--seeds", type=click.IntRange(1, 1_000_000), default=50, show_default=True, help="Number of runs.")
@click.option("--first", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="First seed.")
@click.option("--plant", type=click.Choice(PLANTS), default="kinematic", show_default=True, help="The machine.")
@click.option("--evade", is_flag=True, help="Leave the strip where something comes, rather than only brake and wait.")
@click.option("--method", type=click.Choice(DRIVE_METHODS), default=STRIP, show_default=True, help="What steers.")
@sensors_option
@_processes
@_json
def drive(
    robot: str,
    scenario: str,
    seeds: int,
    first: int,
    plant: str,
    evade: bool,
    method: str,
    sensors: str | None,
    processes: int | None,
    json_file: str | None,
) -> None:
    """Drive a scenario of many seeds in the closed loop; each run is evaluated from its true states."""
    _writable(json_file)
    config = sensors_of(sensors)
    with LateProgress("driving", seeds) as bar:
        figures = bench_drive(
            robot,
            range(first, first + seeds),
            bar.step,
            scenario=scenario,
            plant=plant,
            evade=evade,
            method=method,
            sensors=config,
            processes=processes,
        )
    click.echo(f"{robot}, {scenario}, {method}, {plant} plant, {seeds} runs")
    _drive_rows(figures)
    for group in figures["classes"]:
        click.echo(f"movers up to {group['from']:g} … {group['to']:g} m/s, {group['count']} runs")
        _drive_rows(group)
    for run in figures["runs"]:
        if not run["reached"] or run["collisions"]:
            last = run.get("error") or (run["stops"][-1][1] if run["stops"] else run["state"])
            _row(f"seed {run['seed']}", f"{run['collisions']} collisions; {last}")
    _write(json_file, figures)


@click.command(short_help="Put faults into many runs.")
@click.option("--robot", default="silvermate", show_default=True, metavar="NAME|FILE.urdf", help="The robot.")
@click.option("--seeds", type=click.IntRange(1, 100_000), default=50, show_default=True, help="Runs of each fault.")
@_processes
@_json
def faults(robot: str, seeds: int, processes: int | None, json_file: str | None) -> None:
    """Every kind of fault at a random time: the robot has to end at rest or at the goal, without a contact at speed."""
    _writable(json_file)
    from ..sim import FAULTS

    with LateProgress("putting in faults", seeds * len(FAULTS)) as bar:
        figures = bench_faults(robot, range(seeds), bar.step, processes=processes)
    for kind, row in figures["kinds"].items():
        _row(
            kind,
            f"{row['count']} runs: {100 * row['at_rest_or_goal']:.0f} % end at rest or at the goal, "
            f"{100 * row['reached']:.0f} % reached, {row['collisions']} contacts at speed, "
            f"{100 * row['named']:.0f} % named in the log",
        )
    _write(json_file, figures)


def _problem(kind: str, text: str) -> click.Command:
    @click.command(kind, short_help=text)
    @_root
    @click.option("--robot", default="jackal-box", show_default=True, metavar="NAME|FILE.urdf", help="The robot.")
    @click.option("--seeds", type=click.IntRange(1, 1000), default=1, show_default=True, help="Runs of each world.")
    @click.option("--id", "ids", multiple=True, type=int, metavar="ID", help="Only this world; may be given again.")
    @_processes
    @_json
    def command(
        root: str, robot: str, seeds: int, ids: tuple[int, ...], processes: int | None, json_file: str | None
    ) -> None:
        _writable(json_file)
        with LateProgress(kind) as bar:
            figures = bench_problems(
                kind, root, bar.step, robot=robot, seeds=seeds, ids=ids or None, processes=processes
            )
        click.echo(f"{robot}, {figures['worlds']} worlds, {figures['count']} runs")
        _problem_rows(figures)
        for name, group in figures["by_difficulty"].items():
            click.echo(f"{name}, {group['count']} runs")
            _problem_rows(group)
        for run in figures["runs"]:
            if not run["success"]:
                _row(f"world {run['id']} seed {run['seed']}", run["reason"] or "an obstacle ran into the robot at rest")
        _write(json_file, figures)

    command.help = text
    return command


@click.command(short_help="The bridge: the arm has to duck.")
@_root
@click.option("--robot", default="bridge-arm", show_default=True, metavar="NAME|FILE.urdf", help="The robot.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Of the planner.")
@_json
def bridge(root: str, robot: str, seed: int, json_file: str | None) -> None:
    """Plan both legs under the bridge, and drive them."""
    _writable(json_file)
    with LateProgress("bridge") as bar:
        bar.step()
        figures = bench_bridge(root, robot=robot, seed=seed)
    for leg in figures["legs"]:
        verdict = "certified" if leg["certified"] else "not certified"
        _row(
            f"leg {leg['leg'] + 1}",
            f"{verdict} by {leg['method']} in {leg['seconds']:.2f} s, clearance {leg['clearance_m']:.3f} m",
        )
    driven = "reached" if figures["reached"] else "not reached"
    _row("driven", f"{driven} in {figures['time_s']:.1f} s, {figures['collisions']} collisions, "
         f"least clearance {figures['min_clearance_m']:.3f} m")  # fmt: skip
    _write(json_file, figures)


@click.command(short_help="How soon a new obstacle is answered.")
@click.option("--robot", default="silvermate", show_default=True, metavar="NAME|FILE.urdf", help="The robot.")
@click.option("--seeds", type=click.IntRange(1, 100_000), default=50, show_default=True, help="Number of corridors.")
@click.option("--depth", type=Finite(0.0, 0.4), default=0.1, show_default=True, help="How far into the way [m].")
@_json
def reaction(robot: str, seeds: int, depth: float, json_file: str | None) -> None:
    """A post appears on the strip while the robot drives, planned at 100 Hz: ticks until a new certified strip is
    followed."""
    _writable(json_file)
    with LateProgress("reacting", seeds) as bar:
        figures = bench_reaction(load_robot(robot), range(seeds), bar.step, depth=depth)
    ticks, ms = figures["ticks"], figures["ms"]
    _row("reacted", f"{figures['reacted']} of {figures['count']}")
    _row("ticks of 10 ms", f"p50 {ticks['p50']:.0f}, p95 {ticks['p95']:.0f}, max {ticks['max']:.0f}")
    _row("time", f"p50 {ms['p50']:.1f}, p95 {ms['p95']:.1f} ms")
    _row("the tick itself", f"p50 {figures['tick_ms']['p50']:.1f}, p95 {figures['tick_ms']['p95']:.1f} ms")
    _write(json_file, figures)


@click.command(short_help="Drive for a long time; watch memory and ticks.")
@click.option("--robot", default="silvermate", show_default=True, metavar="NAME|FILE.urdf", help="The robot.")
@click.option("--hours", type=Finite(0.01, 1000), default=1.0, show_default=True, help="Of simulated time.")
@_json
def soak(robot: str, hours: float, json_file: str | None) -> None:
    """Drive to and fro among moving obstacles in one process."""
    _writable(json_file)
    with LateProgress("soaking") as bar:
        figures = bench_soak(load_robot(robot), hours, bar.step)
    memory = figures["memory_mb"]
    _row("driven", f"{figures['hours']:.2f} h, {figures['legs']} legs, {figures['stops']} stops")
    if figures["growth"] is not None:
        _row("memory", f"{memory['warm']:.1f} to {memory['end']:.1f} MB, {100 * figures['growth']:+.2f} %")
        first, second = figures["tick_ms_first_half"], figures["tick_ms_second_half"]
        if first["p50"] is not None:
            _row("p99 of ticks", f"{first['p50']:.1f} ms in the first half, {second['p50']:.1f} ms in the second")
    _write(json_file, figures)


COMMANDS = (
    drive,
    faults,
    reaction,
    soak,
    _problem("barn", "BARN's static worlds, for a base as large as a Jackal."),
    _problem("dynabarn", "DynaBARN's moving discs, for a base as large as a Jackal."),
    bridge,
)


def _drive_rows(figures: dict[str, Any]) -> None:
    _row("reached", f"{100 * figures['reached']:.1f} %")
    unseen = figures["collisions"] - figures["collisions_seen"]
    _row("contacts at speed", f"{figures['collisions']}" + (f", {unseen} with what no laser saw" if unseen else ""))
    _row("run into at rest", f"{figures['runs_with_contacts_at_rest']} runs")
    _row("stops", f"{figures['stops']}, {figures['stops_without_reason']} without a reason")
    if figures["time_s"]["p50"] is not None:
        _row("time", f"p50 {figures['time_s']['p50']:.1f}, p95 {figures['time_s']['p95']:.1f} s")
        if figures["tracking_m"]["p50"] is not None:
            _row("tracking error", f"p50 {figures['tracking_m']['p50']:.4f}, max {figures['tracking_m']['max']:.4f} m")
        _row("planning tick", f"median of p50 {figures['tick_ms_p50']['p50']:.1f}, "
             f"of p99 {figures['tick_ms_p99']['p50']:.1f} ms")  # fmt: skip


def _problem_rows(figures: dict[str, Any]) -> None:
    _row("success", f"{100 * figures['success']:.1f} % without any contact")
    _row("passively safe", f"{100 * figures['success_passive']:.1f} % reached without a contact at speed")
    _row("collisions", f"{100 * figures['collisions']:.1f} % of the runs at speed, "
         f"{100 * figures['run_into_at_rest']:.1f} % run into at rest")  # fmt: skip
    if figures["time_s"]["p50"] is not None:
        _row("time", f"p50 {figures['time_s']['p50']:.1f}, p95 {figures['time_s']['p95']:.1f} s")
    if "score" in figures:
        _row("score", f"{figures['score']:.4f} (time counts from 4 T* on), {figures['score_2_8']:.4f} (from 2 T* on)")


def _row(name: str, text: str) -> None:
    click.echo(f"  {name:<20} {text}")


def _writable(json_file: str | None) -> None:
    if json_file is not None:
        check_writable(json_file)


def _write(json_file: str | None, figures: dict[str, Any]) -> None:
    if json_file is not None:
        click.echo(f"figures {write_json(json_file, figures)}")
