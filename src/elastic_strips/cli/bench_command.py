"""``elastic-strips bench``, many runs and their figures; and ``elastic-strips study``, which ends in a report."""

from __future__ import annotations

from collections.abc import Callable
from math import degrees
from pathlib import Path
from typing import TypeVar

import click

from elastic_strips.files import atomic_write, write_json
from elastic_strips.robot import BaseKind, load_robot
from elastic_strips.sim import FAULTS, Fault
from elastic_strips.sim.bench import bench_plan, bench_replan, bench_tick
from elastic_strips.sim.bench.drive import bench_disturb, bench_drive, bench_reaction, bench_soak
from elastic_strips.sim.bench.inverse_kinematics import bench_inverse_kinematics
from elastic_strips.sim.bench.measure import Figures
from elastic_strips.sim.bench.peers import REQUIREMENTS, bench_peers
from elastic_strips.sim.bench.problems import bench_bridge, bench_problems
from elastic_strips.sim.bench.reach import bench_mbm
from elastic_strips.sim.bench.realtime import bench_realtime
from elastic_strips.sim.bench.robots import bench_robots, robot_cases, robots_table, with_table
from elastic_strips.sim.bench.settle import bench_settle
from elastic_strips.sim.bench.trials import KINDS, bench_trials
from elastic_strips.sim.computing import Computing
from elastic_strips.sim.reach_problems import MBM_ROBOTS
from elastic_strips.sim.scenarios.drive import DRIVE_METHODS, PLANTS, STRIP

from . import options

_F = TypeVar("_F", bound=Callable[..., object])
_json = options.json_option("Write all figures.")
_json_runs = options.json_option("Write all figures and runs.")
_root = click.option(
    "--root", required=True, metavar="DIR", type=click.Path(exists=True, file_okay=False),
    help="Folder with the data: DIR/barn, DIR/dynabarn, DIR/bridge, DIR/house, DIR/mbm.",
)  # fmt: skip


def _seeds(default: int, help: str, most: int = 100_000) -> Callable[[_F], _F]:
    return click.option("--seeds", type=click.IntRange(1, most), default=default, show_default=True, help=help)


@click.group()
def bench() -> None:
    """Measure on this machine. The figures are percentiles; on a shared machine trust the ratios."""


@bench.command(short_help="From nothing to a certified strip.")
@options.robot_option("silvermate")
@_seeds(100, "Number of corridors.")
@click.option("--scenario", default="corridor", show_default=True, metavar="NAME", help="A seeded scenario.")
@click.option("--grid/--no-grid", default=True, show_default=True, help="Try a way over a grid before OMPL.")
@_json
def plan(robot: str, seeds: int, scenario: str, grid: bool, json_file: str | None) -> None:
    """Plan the corridor (or another scenario) of many seeds: how often, how fast, how clear."""
    model = load_robot(robot)
    with options.LateProgress("planning", seeds) as bar:
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
@options.robot_option("silvermate")
@_seeds(100, "Number of corridors.")
@click.option("--into", type=options.Finite(0.001, 0.5), metavar="M", help="Push so deep into the strip instead [m].")
@_json
def replan(robot: str, seeds: int, into: float | None, json_file: str | None) -> None:
    """Push the nearest obstacle 5 cm towards each planned strip, 4 times.

    With --into a strip that stays broken is planned anew."""
    model = load_robot(robot)
    with options.LateProgress("replanning", seeds) as bar:
        figures = bench_replan(model, seeds, bar.step, into=into)
    click.echo(f"{figures['robot']}, {figures['pushes']} pushes on {seeds} corridors")
    anew = "" if into is None else f", {figures['anew']} planned anew"
    _row("certified again", f"{100 * figures['certified']:.1f} %{anew}")
    _row("time", _times(figures["time_to_certified_ms"]))
    ticks = figures["ticks"]
    _row("ticks", f"p50 {ticks['p50']:.0f}, p99 {ticks['p99']:.0f}, max {ticks['max']:.0f}")
    jump = figures["jump_m"]
    _row("jump of the strip", f"p50 {jump['p50']:.3f} m, p99 {jump['p99']:.3f} m")
    for failure in figures["failures"]:
        _row(f"seed {failure['seed']} push {failure['push']}", failure["reason"])
    _write(json_file, figures)


@bench.command(short_help="One control tick, and how it scales.")
@options.robot_option("silvermate")
@click.option("--ticks", type=click.IntRange(20, 100_000), default=200, show_default=True, help="Measured ticks.")
@click.option("--scaling/--no-scaling", default=True, help="Also against the numbers of nodes and obstacles.")
@_json
def tick(robot: str, ticks: int, scaling: bool, json_file: str | None) -> None:
    """One tick on 64 nodes and 32 obstacles while one of them moves 2 cm per tick.

    In the same run, for the ratio: pin.computeDistances over every pair on the same strip.
    """
    model = load_robot(robot)
    with options.LateProgress("ticking", 10 if scaling else 1) as bar:
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
@click.option(
    "--timeout", type=options.Finite(0.01, 3600), default=10.0, show_default=True, help="Longest planning [s]."
)
@click.option(
    "--table", "table_file", type=options.OutputFile(), metavar="FILE.md",
    help="Write the table there, between its marks if the file has them.",
)  # fmt: skip
@_json
def robots(
    names: tuple[str, ...], data: str | None, timeout: float, table_file: str | None, json_file: str | None
) -> None:
    """Load the named robots (all of "elastic-strips list --robots" by default), and those of a folder.

    Each goes from home to another posture, past a sphere in its way.
    """
    cases = robot_cases(names, data)
    with options.LateProgress("trying robots", len(cases)) as bar:
        figures = bench_robots(cases, bar.step, timeout=timeout)
    text = robots_table(figures)
    click.echo(text, nl=False)
    if table_file is not None:
        page = Path(table_file)
        text = with_table(page.read_text(encoding="utf-8") if page.is_file() else "", text)
        click.echo(f"table   {atomic_write(page, text.encode())}")
    _write(json_file, figures)


@bench.command(short_help="Drive among moving obstacles, many seeds.")
@options.robot_option("silvermate")
@click.option("--scenario", default="moving-corridor", show_default=True, metavar="NAME", help="A seeded scenario.")
@_seeds(50, "Number of runs.", 1_000_000)
@click.option("--first", type=options.SEED, default=0, show_default=True, help="First seed.")
@click.option("--plant", type=click.Choice(PLANTS), default="kinematic", show_default=True, help="The machine.")
@options.evade_option
@click.option(
    "--alternatives", type=click.IntRange(1, 10), default=1, show_default=True, help="Strips that are kept at hand."
)
@options.level_option
@click.option("--method", type=click.Choice(DRIVE_METHODS), default=STRIP, show_default=True, help="What steers.")
@options.sensors_option
@options.compute_option
@options.processes_option
@_json_runs
def drive(
    robot: str,
    scenario: str,
    seeds: int,
    first: int,
    plant: str,
    evade: bool | None,
    alternatives: int,
    level: str,
    method: str,
    sensors: str | None,
    compute: str | None,
    processes: int | None,
    json_file: str | None,
) -> None:
    """Drive a scenario of many seeds in the closed loop; each run is evaluated from its true states."""
    config = options.sensors_of(sensors, robot)
    with options.LateProgress("driving", seeds) as bar:
        figures = bench_drive(
            robot,
            range(first, first + seeds),
            bar.step,
            scenario=scenario,
            plant=plant,
            evade=evade is not False,
            alternatives=alternatives,
            level=level,
            method=method,
            sensors=config,
            compute=_compute(compute),
            processes=processes,
        )
    click.echo(f"{robot}, {scenario}, {method}, {plant} plant, {seeds} runs, computing: {figures['compute']}")
    _drive_rows(figures)
    for group in figures["classes"]:
        click.echo(f"movers up to {group['from']:g} … {group['to']:g} m/s, {group['count']} runs")
        _drive_rows(group)
    _failed_rows(figures)
    _write(json_file, figures)


def _disturb(name: str, scenario: str) -> None:
    @bench.command(name, short_help="Put faults into many runs.")
    @options.robot_option("silvermate")
    @_seeds(50, "Runs of each fault.")
    @click.option("--scenario", default=scenario, show_default=True, help="What is driven.")
    @click.option("--kind", "kinds", multiple=True, metavar="KIND", help="Only this fault; may be given again.")
    @options.compute_option
    @options.processes_option
    @_json_runs
    def command(
        robot: str,
        seeds: int,
        scenario: str,
        kinds: tuple[str, ...],
        compute: str | None,
        processes: int | None,
        json_file: str | None,
    ) -> None:
        """Every kind of fault at a random time: the robot has to come to rest without a contact at speed, to name what
        is wrong, and to go on to the goal when it is over."""
        chosen = tuple(Fault.parse(f"{kind}@0").kind for kind in kinds) or tuple(FAULTS)
        with options.LateProgress("putting in faults", seeds * len(chosen)) as bar:
            figures = bench_disturb(
                robot, range(seeds), bar.step, kinds=chosen, scenario=scenario, compute=_compute(compute),
                processes=processes,
            )  # fmt: skip
        for kind, row in figures["kinds"].items():
            _row(
                kind,
                f"{row['count']} runs: {100 * row['reached']:.0f} % reached, {row['collisions']} contacts at speed "
                f"({row['collisions_standing']} with what stands), {100 * row['at_rest_or_goal']:.0f} % end at rest or "
                f"at the goal, at most {row['tracking_m'].get('max', 0.0):.3f} m off, "
                f"{100 * row['named']:.0f} % named in the log",
            )
        _write(json_file, figures)


_disturb("disturb", "corridor")
_disturb("faults", "moving-corridor")


def _problem(kind: str, text: str) -> None:
    @bench.command(kind, short_help=text, help=text)
    @_root
    @options.robot_option("jackal-box")
    @_seeds(1, "Runs of each world.", 1000)
    @click.option("--id", "ids", multiple=True, type=int, metavar="ID", help="Only this world; may be given again.")
    @options.compute_option
    @options.processes_option
    @_json_runs
    def command(
        root: str,
        robot: str,
        seeds: int,
        ids: tuple[int, ...],
        compute: str | None,
        processes: int | None,
        json_file: str | None,
    ) -> None:
        with options.LateProgress(kind) as bar:
            figures = bench_problems(
                kind, root, bar.step, robot=robot, seeds=seeds, ids=ids or None, compute=_compute(compute),
                processes=processes,
            )  # fmt: skip
        click.echo(f"{robot}, {figures['worlds']} worlds, {figures['count']} runs, computing: {figures['compute']}")
        _problem_rows(figures)
        for name, group in figures["by_difficulty"].items():
            click.echo(f"{name}, {group['count']} runs")
            _problem_rows(group)
        for run in figures["runs"]:
            if not run["success"]:
                _row(f"world {run['id']} seed {run['seed']}", run["reason"] or "an obstacle ran into the robot at rest")
        _write(json_file, figures)


_problem("barn", "BARN's static worlds, for a base as large as a Jackal.")
_problem("dynabarn", "DynaBARN's moving discs, for a base as large as a Jackal.")


@bench.command(short_help="The bridge: the arm has to duck.")
@_root
@options.robot_option("bridge-arm")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the planner.")
@options.compute_option
@_json_runs
def bridge(root: str, robot: str, seed: int, compute: str | None, json_file: str | None) -> None:
    """Plan both legs under the bridge, and drive them."""
    with options.LateProgress("bridge") as bar:
        bar.step()
        figures = bench_bridge(root, robot=robot, seed=seed, compute=_compute(compute))
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


@bench.command(short_help="Across a furnished house.")
@_root
@options.robot_option("silvermate")
@_seeds(30, "Pairs of start and goal.")
@click.option("--first", type=options.SEED, default=0, show_default=True, help="First seed.")
@options.evade_option
@options.sensors_option
@options.compute_option
@options.processes_option
@_json_runs
def house(
    root: str,
    robot: str,
    seeds: int,
    first: int,
    evade: bool | None,
    sensors: str | None,
    compute: str | None,
    processes: int | None,
    json_file: str | None,
) -> None:
    """Drive from one free place of the house to another, with walls, furniture and their legs as 571 convex pieces."""
    config = options.sensors_of(sensors, robot)
    with options.LateProgress("driving", seeds) as bar:
        figures = bench_drive(
            robot, range(first, first + seeds), bar.step, scenario="house", evade=evade is not False, sensors=config,
            compute=_compute(compute), time_limit=180.0, root=root, processes=processes,
        )  # fmt: skip
    click.echo(f"{robot}, house, {seeds} pairs, computing: {figures['compute']}")
    _drive_rows(figures)
    _failed_rows(figures)
    _write(json_file, figures)


@bench.command(short_help="Reach into shelves, boxes and cages.")
@_root
@click.option("--robot", type=click.Choice(MBM_ROBOTS), default="fetch", show_default=True, help="The arm.")
@click.option("--stride", type=click.IntRange(1, 1000), default=1, show_default=True, help="Every so many problems.")
@click.option("--timeout", type=options.Finite(0.01, 600), default=2.0, show_default=True, help="For each [s].")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the planner.")
@click.option(
    "--base", type=click.Choice([kind.value for kind in BaseKind]), default="fixed", show_default=True,
    help="One that can move starts two metres off.",
)  # fmt: skip
@_json_runs
def mbm(
    root: str, robot: str, stride: int, timeout: float, seed: int, base: str, json_file: str | None
) -> None:  # fmt: skip
    """Plan MotionBenchMaker's problems of the Fetch or the Panda: how many are certified, how fast, how clear."""
    with options.LateProgress("planning", 350 // stride) as bar:
        figures = bench_mbm(root, robot, bar.step, stride=stride, timeout=timeout, seed=seed, base=base)
    valid, total = figures["valid"], figures["total"]
    click.echo(f"{robot} ({base}), {total} problems, {total - valid} with a start or goal in collision")
    share = 100.0 * figures["certified"] / max(valid, 1)
    _row("certified", f"{figures['certified']} of {valid} ({share:.1f} %) within {timeout:g} s")
    ms = figures["ms"]
    if figures["certified"]:
        low, middle, high = ms["quartiles"]
        _row("time", f"p25 {low:.1f}, p50 {middle:.1f}, p75 {high:.1f}, p95 {ms['p95']:.1f}, mean {ms['mean']:.1f} ms")
        _row("by the line", f"{figures['by_the_line']}")
        _row("length", f"p50 {figures['length_rad']['p50']:.2f} rad")
        _row("clearance", f"p50 {1e3 * figures['clearance_m']['p50']:.1f} mm")
    for kind, some in figures["kinds"].items():
        _row(kind, f"{some['certified']} of {some['valid']}")
    for failure in figures["failures"]:
        _row(f"{failure['name']} failed", failure["reason"])
    _write(json_file, figures)


@bench.command(short_help="Inverse kinematics of the whole body.")
@options.robot_option("panda")
@click.option("--frame", default="panda_hand_tcp", show_default=True, metavar="NAME", help="A frame of the robot.")
@click.option("--base", type=click.Choice([kind.value for kind in BaseKind]), help="The robot's own where not given.")
@click.option("--poses", type=click.IntRange(1, 1_000_000), default=1000, show_default=True, help="Number of poses.")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the poses.")
@_json
def ik(robot: str, frame: str, base: str | None, poses: int, seed: int, json_file: str | None) -> None:
    """Reach poses of random configurations from home; beside a single start of the usual loop."""
    with options.LateProgress("reaching", poses) as bar:
        figures = bench_inverse_kinematics(load_robot(robot, base=base), frame, bar.step, poses=poses, seed=seed)
    click.echo(f"{figures['robot']} ({figures['base']}), {poses} poses of {frame}")
    for what, some in (("reached", figures), ("one start", figures["one_start"])):
        _row(what, f"{100 * some['reached']:.2f} %, {_times(some['ms'])}")
    if figures["position_m"] is not None:
        _row("at most off by", f"{1e3 * figures['position_m']:.3f} mm, {1e3 * figures['angle_rad']:.3f} mrad")
    _write(json_file, figures)


@bench.command(short_help="Other planners on the same problems.")
@options.robot_option("tiago")
@_seeds(20, "Number of problems.")
@click.option("--scenario", default="corridor", show_default=True, metavar="NAME", help="A seeded scenario.")
@click.option(
    "--peer", "peers", multiple=True, type=click.Choice(tuple(REQUIREMENTS)), help="Only this one; may be given again."
)
@click.option(
    "--environments", default="peers", show_default=True, metavar="DIR", type=click.Path(file_okay=False),
    help="Where each peer gets a virtual environment of its own, by pip.",
)  # fmt: skip
@click.option("--timeout", type=options.Finite(0.01, 600), default=10.0, show_default=True, help="For each path [s].")
@_json_runs
def peers(
    robot: str, seeds: int, scenario: str, peers: tuple[str, ...], environments: str, timeout: float,
    json_file: str | None,
) -> None:  # fmt: skip
    """First paths, and paths again after an obstacle was pushed 35 mm into them: here, and by other planners.

    The robot's base may go sideways, since the others know no wheels. Their paths are certified here."""
    model = load_robot(robot, base="omni")
    with options.LateProgress("planning") as bar:
        figures = bench_peers(
            model, seeds, bar.step, scenario=scenario, peers=peers or tuple(REQUIREMENTS), environments=environments,
            timeout=timeout,
        )  # fmt: skip
    click.echo(f"{figures['robot']} ({figures['base']}), {seeds} problems of {scenario}")
    for name, row in figures["planners"].items():
        if "skipped" in row:
            click.echo(f"{name}: skipped: {row['skipped']}")
            continue
        click.echo(f"{name} {row.get('version', '')} {row.get('planner', '')}".rstrip())
        for what, part in (("first", row["first"]), ("again", row["again"])):
            jump = part["jump_m"]["p50"]
            _row(
                what,
                f"{part['solved']} of {part['count']}: {_times(part['ms'])}; {part['certified']} certified, "
                f"{part['touching']} touch{'' if jump is None else f'; jump p50 {jump:.2f} m'}",
            )
    _write(json_file, figures)


@bench.command(short_help="What a planned strip loses and gains on its way to rest.")
@options.robot_option("silvermate")
@_seeds(100, "Number of problems.")
@click.option("--scenario", default="corridor", show_default=True, metavar="NAME", help="A seeded scenario.")
@_json_runs
def settle(robot: str, seeds: int, scenario: str, json_file: str | None) -> None:
    """Settle the planned strip of many seeds: clearance before and after, ticks, and the energy's rises."""
    model = load_robot(robot)
    with options.LateProgress("settling", seeds) as bar:
        figures = bench_settle(model, scenario, seeds, bar.step)
    click.echo(f"{figures['robot']} ({figures['base']}), {scenario}, {figures['strips']} strips")
    _row("certified", f"{100 * figures['certified']:.1f} %")
    _row("at rest", f"{100 * figures['at_rest']:.1f} %, {100 * figures['at_rest_soon']:.1f} % within 60 ticks")
    if figures["strips"]:
        ticks, lost = figures["ticks"], figures["lost_m"]
        _row("ticks", f"p50 {ticks['p50']:.0f}, p95 {ticks['p95']:.0f}, max {ticks['max']:.0f}")
        _row("time", _times(figures["ms"]))
        worse = f"more than 1 mm for {100 * figures['worse']:.1f} %"
        _row("clearance lost", f"p95 {1e3 * lost['p95']:.2f}, max {1e3 * lost['max']:.2f} mm; {worse}")
        _row("energy rose", f"by {figures['energy_rise']:.1e} of it in a tick at most")
    _write(json_file, figures)


@bench.command(short_help="How soon a new obstacle is answered.")
@options.robot_option("silvermate")
@_seeds(50, "Number of corridors.")
@click.option(
    "--depth", type=options.Finite(0.0, 0.4), default=0.1, show_default=True, help="How far into the way [m]."
)
@_json_runs
def reaction(robot: str, seeds: int, depth: float, json_file: str | None) -> None:
    """A post appears on the strip while the robot drives, planned at 100 Hz: ticks until a new certified strip is
    followed."""
    with options.LateProgress("reacting", seeds) as bar:
        figures = bench_reaction(load_robot(robot), range(seeds), bar.step, depth=depth)
    ticks, ms = figures["ticks"], figures["ms"]
    _row("reacted", f"{figures['reacted']} of {figures['count']}")
    _row("ticks of 10 ms", f"p50 {ticks['p50']:.0f}, p95 {ticks['p95']:.0f}, max {ticks['max']:.0f}")
    _row("time", f"p50 {ms['p50']:.1f}, p95 {ms['p95']:.1f} ms")
    _row("the tick itself", f"p50 {figures['tick_ms']['p50']:.1f}, p95 {figures['tick_ms']['p95']:.1f} ms")
    _write(json_file, figures)


@bench.command(short_help="Drive for a long time; watch memory and ticks.")
@options.robot_option("silvermate")
@click.option("--hours", type=options.Finite(0.01, 1000), default=1.0, show_default=True, help="Of simulated time.")
@_json_runs
def soak(robot: str, hours: float, json_file: str | None) -> None:
    """Drive to and fro among moving obstacles in one process."""
    with options.LateProgress("soaking") as bar:
        figures = bench_soak(load_robot(robot), hours, bar.step)
    memory = figures["memory_mb"]
    _row("driven", f"{figures['hours']:.2f} h, {figures['legs']} legs, {figures['stops']} stops")
    if figures["growth"] is not None:
        _row("memory", f"{memory['warm']:.1f} to {memory['end']:.1f} MB, {100 * figures['growth']:+.2f} %")
        first, second = figures["tick_ms_first_half"], figures["tick_ms_second_half"]
        if first["p50"] is not None:
            _row("p99 of ticks", f"{first['p50']:.1f} ms in the first half, {second['p50']:.1f} ms in the second")
    _write(json_file, figures)


@bench.command(short_help="How evenly commands come against the wall clock.")
@options.robot_option("silvermate")
@click.option("--minutes", type=options.Finite(0.1, 1440), default=10.0, show_default=True, help="How long.")
@click.option("--inline", is_flag=True, help="Control and planning in one thread, for comparison.")
@_json_runs
def realtime(robot: str, minutes: float, inline: bool, json_file: str | None) -> None:
    """Drive to and fro among moving obstacles against the wall clock, with machine, control loop and planning in
    processes of their own; planning never waits."""
    with options.LateProgress("driving") as bar:
        figures = bench_realtime(load_robot(robot), minutes, bar.step, inline=inline)
    _row("driven", f"{figures['seconds']:.0f} s in {figures['mode']} ({figures['priority']}), {figures['legs']} legs, "
         f"{len(figures['stops'])} stops, {figures['contacts_at_speed']} contacts at speed")  # fmt: skip
    for name, key in (
        ("gaps of commands", "gap_ms"), ("without pauses", "gap_unpaused_ms"), ("control steps", "step_ms")
    ):  # fmt: skip
        gap = figures[key]
        if gap["p50"] is not None:
            _row(name, f"p50 {gap['p50']:.2f}, p99 {gap['p99']:.2f}, p99.9 {gap['p99_9']:.2f}, max {gap['max']:.2f} ms")
    _row("in bursts", f"{100 * figures['bursts']:.2f} %")
    _row("two periods late", f"{figures['late']}, {figures['late_paused']} of them in pauses of the computer "
         f"({figures['paused_s']:.1f} s in all, the longest {figures['longest_pause_ms']:.0f} ms)")  # fmt: skip
    _write(json_file, figures)


@bench.command(short_help="Kill and stop processes of drives against the wall clock.")
@options.robot_option("silvermate")
@_seeds(5, "Trials of each kind.")
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), help="Only this one; may be given again.")
@_json_runs
def trials(robot: str, seeds: int, kinds: tuple[str, ...], json_file: str | None) -> None:
    """The planner or the executor is killed, stopped or hung at a random time, or the disk is full: the robot has to
    come to rest without a contact, and to go on where it can."""
    with options.LateProgress("killing", seeds * len(kinds or KINDS)) as bar:
        figures = bench_trials(robot, range(seeds), bar.step, kinds=kinds or None)
    for kind, row in figures["kinds"].items():
        longest = row["longest_to_rest_s"]
        _row(kind, f"{row['count']} trials: {100 * row['at_rest']:.0f} % at rest in the end, "
             + ("" if longest is None else f"after {longest:.2f} s at most, ")
             + f"{row['contacts_at_speed']} contacts at speed, {100 * row['reached']:.0f} % reached, "
             f"{100 * row['named']:.0f} % named")  # fmt: skip
    _write(json_file, figures)


def _compute(given: str | None) -> str:
    """What computing costs: as it was measured, unless something else was asked for."""
    return str(Computing.parse(given or "1").label)


def _drive_rows(figures: Figures) -> None:
    _row("reached", f"{100 * figures['reached']:.1f} %")
    unseen = figures["collisions"] - figures["collisions_seen"]
    _row("contacts at speed", f"{figures['collisions']}" + (f", {unseen} with what no laser saw" if unseen else ""))
    _row("run into at rest", f"{figures['runs_with_contacts_at_rest']} runs")
    _row("stops", f"{figures['stops']}, {figures['stops_without_reason']} without a reason")
    if figures["time_s"]["p50"] is not None:
        _row("time", f"p50 {figures['time_s']['p50']:.1f}, p95 {figures['time_s']['p95']:.1f} s")
        if figures["tracking_m"]["p50"] is not None:
            _row("tracking error", f"p50 {figures['tracking_m']['p50']:.4f}, max {figures['tracking_m']['max']:.4f} m")
        off = figures["constraint_rad"]
        if off["p50"] is not None:
            _row(
                "off level",
                f"p50 {degrees(off['p50']):.1f}, max {degrees(off['max']):.1f}°, at the worst of each run",
            )
        _row("planning tick", f"median of p50 {figures['tick_ms_p50']['p50']:.1f}, "
             f"of p99 {figures['tick_ms_p99']['p50']:.1f} ms")  # fmt: skip
        ticks = figures["ticks"]
        if ticks["count"]:
            moving = ticks["moving_max_ms"]
            _row("all ticks", _times(ticks["ms"]) + f", max {ticks['ms']['max']:.1f} ms"
                 + ("" if moving is None else f" ({moving:.1f} while moving)")
                 + f", {100 * ticks['over_20_ms']:.2f} % over 20 ms")  # fmt: skip
        anew = figures["planned_anew_s"]
        if anew["p50"] is not None:
            _row("waits for plans", f"p50 {anew['p50']:.2f}, p99 {anew['p99']:.2f}, max {anew['max']:.2f} s")


def _failed_rows(figures: Figures) -> None:
    """A line for each run with something wrong."""
    for run in figures["runs"]:
        if not run["reached"] or run["collisions"]:
            last = run.get("error") or (run["stops"][-1][1] if run["stops"] else run["state"])
            touched = sorted({contact["obstacle"] for contact in run.get("contacts", ())})
            _row(
                f"seed {run['seed']}",
                f"{run['collisions']} collisions{': ' if touched else ''}{', '.join(touched)}; {last}",
            )


def _problem_rows(figures: Figures) -> None:
    _row("success", f"{100 * figures['success']:.1f} % without any contact")
    _row("passively safe", f"{100 * figures['success_passive']:.1f} % reached without a contact at speed")
    _row("collisions", f"{100 * figures['collisions']:.1f} % of the runs at speed, "
         f"{100 * figures['run_into_at_rest']:.1f} % run into at rest")  # fmt: skip
    if figures["time_s"]["p50"] is not None:
        _row("time", f"p50 {figures['time_s']['p50']:.1f}, p95 {figures['time_s']['p95']:.1f} s")
    if "score" in figures:
        _row("score", f"{figures['score']:.4f} (time counts from 4 T* on), {figures['score_2_8']:.4f} (from 2 T* on)")


def _times(figure: dict[str, float | None]) -> str:
    if figure["p50"] is None:
        return "-"
    return ", ".join(f"{p} {figure[p]:.2f}" for p in ("p50", "p95", "p99")) + " ms"


def _row(label: str, text: str) -> None:
    click.echo(f"  {label:<22} {text}")


def _write(json_file: str | None, figures: Figures) -> None:
    if json_file is not None:
        click.echo(f"figures {write_json(json_file, figures)}")


@click.group()
def study() -> None:
    """Studies that end in a report."""


@study.command(name="paper")
@click.option("--out", default="study", show_default=True, metavar="FOLDER", type=click.Path(), help="Where to.")
@options.processes_option
@click.option("--quick", is_flag=True, help="Tables and figures alone: no comparison, no parameter map.")
def paper(out: str, processes: int | None, quick: bool) -> int:
    """Tables 1 and 2, Figs. 5 to 11, methods compared, and a map of the parameters: Markdown, HTML and pictures."""
    from elastic_strips.sim.study import paper_study  # it imports much that no other command needs

    less = {"compared": (), "mapped": ""} if quick else {}
    with options.LateProgress("study") as bar:
        found = paper_study(out, processes=processes, step=bar.step, **less)
    for case, run in found.runs.items():
        click.echo(f"{case:8} {run.outcome.value:10} {run.reason}")
    click.echo(f"report   {found.report}")
    return options.EXIT_DONE if found.as_the_paper_says else options.EXIT_NOT_DONE
