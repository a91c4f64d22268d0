"""``python -m workshop``: planning, deforming and reaching, and other planners on the same problems."""

from __future__ import annotations

import os
from pathlib import Path

import click

from elastic_strips.catalogue import find_robot
from elastic_strips.cli import options, output
from elastic_strips.cli.output import row
from elastic_strips.files import atomic_write

from .bench_options import figures_option, root_option, runs_option, scenario_option, seeds_option, times


@click.command(short_help="From nothing to a certified strip.")
@options.robot_option("silvermate")
@seeds_option(100, "Number of corridors.")
@scenario_option("corridor")
@click.option("--grid/--no-grid", default=True, show_default=True, help="Try a way over a grid before OMPL.")
@figures_option
def plan(robot: str, seeds: int, scenario: str, grid: bool, json_file: str | None) -> None:
    """Plan the corridor (or another scenario) of many seeds: how often, how fast, how clear."""
    from elastic_strips.robot import load_robot
    from workshop.bench import bench_plan

    model = load_robot(robot)
    with options.LateProgress("planning", seeds) as bar:
        figures = bench_plan(model, seeds, bar.step, scenario=scenario, grid=grid)
    what = "corridors" if scenario == "corridor" else f"seeds of {scenario}"
    output.say(f"{figures['robot']} ({figures['base']}), {seeds} {what}")
    row("certified", f"{100 * figures['certified']:.1f} %", figures["certified"] == 1.0)
    row("within 2 s", f"{100 * figures['certified_within_2_s']:.1f} %")
    row("by the line alone", f"{100 * figures['line_alone']:.1f} %")
    row("time to certified", times(figures["time_to_certified_ms"]))
    clear = figures["clearance_m"]
    row("clearance", f"min {clear['min']:.3f} m, {100 * clear['at_least_2cm']:.1f} % at least 2 cm")
    row("largest lateral slip", f"{figures['max_lateral_slip_m']:.1e} m")
    for failure in figures["failures"]:
        row(f"seed {failure['seed']} failed", failure["reason"], False)
    output.write_document("figures", json_file, figures)


@click.command(short_help="Certified again after an obstacle moved.")
@options.robot_option("silvermate")
@seeds_option(100, "Number of corridors.")
@click.option("--into", type=options.Finite(0.001, 0.5), metavar="M", help="Push so deep into the strip instead [m].")
@figures_option
def replan(robot: str, seeds: int, into: float | None, json_file: str | None) -> None:
    """Push the nearest obstacle 5 cm towards each planned strip, 4 times.

    With --into a strip that stays broken is replanned."""
    from elastic_strips.robot import load_robot
    from workshop.bench import bench_replan

    model = load_robot(robot)
    with options.LateProgress("replanning", seeds) as bar:
        figures = bench_replan(model, seeds, bar.step, into=into)
    output.say(f"{figures['robot']}, {figures['pushes']} pushes on {seeds} corridors")
    anew = "" if into is None else f", {figures['anew']} replanned"
    row("certified again", f"{100 * figures['certified']:.1f} %{anew}")
    row("time", times(figures["time_to_certified_ms"]))
    ticks = figures["ticks"]
    row("ticks", f"p50 {ticks['p50']:.0f}, p99 {ticks['p99']:.0f}, max {ticks['max']:.0f}")
    jump = figures["jump_m"]
    row("jump of the strip", f"p50 {jump['p50']:.3f} m, p99 {jump['p99']:.3f} m")
    for failure in figures["failures"]:
        row(f"seed {failure['seed']} push {failure['push']}", failure["reason"], False)
    output.write_document("figures", json_file, figures)


@click.command(short_help="One control tick, and how it scales.")
@options.robot_option("silvermate")
@click.option("--ticks", type=click.IntRange(20, 100_000), default=200, show_default=True, help="Measured ticks.")
@click.option("--scaling/--no-scaling", default=True, help="Also against the numbers of nodes and obstacles.")
@figures_option
def tick(robot: str, ticks: int, scaling: bool, json_file: str | None) -> None:
    """One tick on 64 nodes and 32 obstacles while one of them moves 2 cm per tick.

    In the same run, for the ratio: pin.computeDistances over every pair on the same strip.
    """
    from elastic_strips.robot import load_robot
    from workshop.bench import bench_tick

    model = load_robot(robot)
    with options.LateProgress("ticking", 10 if scaling else 1) as bar:
        figures = bench_tick(model, ticks, bar.step, scaling=scaling)
    output.say(
        f"{figures['robot']}, {figures['nodes']} nodes, {figures['obstacles']} obstacles, {figures['links']} links"
    )
    row("tick", times(figures["tick_ms"]))
    every = figures["every_pair"]
    row("every pair", f"{times(every['ms'])} ({every['pairs_per_node']} pairs a node)")
    row("ratio of medians", f"{figures['ratio_p50']:.2f}")
    row("certified", f"{100 * figures['certified']:.1f} %, {figures['queries_per_tick']:.0f} exact queries a tick")
    for phase, ms in figures["phases_ms"].items():
        row(f"  {phase}", f"{ms:.3f} ms")
    row("  sum / tick mean", f"{figures['phases_sum_ms']:.3f} / {figures['tick_mean_ms']:.3f} ms")
    for what in ("nodes", "obstacles"):
        for count, figure in figures.get(f"{what}_scaling", {}).items():
            row(f"{count} {what}", times(figure))
    output.write_document("figures", json_file, figures)


@click.command(short_help="Pictures a second of the live page.")
@options.robot_option("tiago")
@click.option("--obstacles", type=click.IntRange(0, 10_000), default=60, show_default=True, help="That stand.")
@click.option("--movers", type=click.IntRange(0, 1000), default=5, show_default=True, help="Balls that move.")
@click.option(
    "--for", "seconds", type=options.Finite(1, 3600), default=10.0, show_default=True, help="Time of measuring [s]."
)
@figures_option
def page(robot: str, obstacles: int, movers: int, seconds: float, json_file: str | None) -> None:
    """A live strip at 50 ticks a second among obstacles, shown in Chromium without a window, 1280 by 720 pixels.

    The page is sent at most 30 pictures a second, and drawn plainer where that takes long.
    """
    from elastic_strips.robot import load_robot
    from workshop.bench import bench_page

    model = load_robot(robot)
    with options.LateProgress("drawing", 2) as bar:
        figures = bench_page(model, seconds, bar.step, obstacles=obstacles, movers=movers)
    output.say(f"{figures['robot']}, {obstacles} obstacles, {movers} movers, {figures['renderer']}")
    row("pictures a second", f"{figures['pictures_per_s']:.1f}")
    row("between pictures", times(figures["between_pictures_ms"]))
    row("ticks a second", f"{figures['ticks_per_s']:.0f}")
    row("plainness", f"{figures['plainness']} of 4")
    output.write_document("figures", json_file, figures)


@click.command(short_help="Load every robot, plan and settle a small problem.")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--data", metavar="DIR", type=click.Path(exists=True, file_okay=False), help="Every URDF of a folder, too."
)
@click.option(
    "--timeout", type=options.Finite(0.01, 3600), default=10.0, show_default=True, help="Longest planning [s]."
)
@click.option(
    "--table",
    "table_file",
    type=options.OutputFile(),
    metavar="FILE.md",
    help="Write the table there, between its marks if the file has them.",
)
@figures_option
def robots(
    names: tuple[str, ...], data: str | None, timeout: float, table_file: str | None, json_file: str | None
) -> None:
    """Load the named robots (all of "elastic-strips list --robots" by default), and those of a folder.

    Each goes from home to another posture, past a sphere in its way.
    """
    from workshop.bench.robots import bench_robots, robot_cases, robots_table, with_table

    options.check_outputs("", table_file, json_file)
    for name in names:
        if not os.path.exists(name):  # a file that cannot be read is a row of the table; a name that nobody has is none
            find_robot(name)
    cases = robot_cases(names, data)
    with options.LateProgress("trying robots", len(cases)) as bar:
        figures = bench_robots(cases, bar.step, timeout=timeout)
    text = robots_table(figures)
    output.show(lambda: output.markdown(text), text.rstrip("\n"))
    if table_file is not None:
        page = Path(table_file)
        text = with_table(page.read_text(encoding="utf-8") if page.is_file() else "", text)
        output.say(f"table   {atomic_write(page, text.encode())}")
    output.write_document("figures", json_file, figures)


_mbm_root = root_option(
    "mbm",
    "in mbm/fetch and mbm/panda, MotionBenchMaker's problems as VAMP ships them (github.com/KavrakiLab/vamp), each "
    "with URDF, SRDF, meshes and problems.json.gz; workshop.reach_problems reads them.",
)
_mbm_arm = click.option(
    "--robot",
    type=options.LateChoice("workshop.reach_problems", "MBM_ROBOTS"),
    default="fetch",
    show_default=True,
    help="The arm.",
)


@click.command(short_help="Reach into shelves, boxes and cages.")
@_mbm_root
@_mbm_arm
@click.option("--stride", type=click.IntRange(1, 1000), default=1, show_default=True, help="Every so many problems.")
@click.option("--timeout", type=options.Finite(0.01, 600), default=2.0, show_default=True, help="Limit for each [s].")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the planner.")
@click.option(
    "--base", type=options.BASE, default="fixed", show_default=True, help="A base that can move starts two metres away."
)
@runs_option
def mbm(root: str, robot: str, stride: int, timeout: float, seed: int, base: str, json_file: str | None) -> None:
    """Plan MotionBenchMaker's problems of the Fetch or the Panda: how many are certified, how fast, how clear."""
    from workshop.bench.reach import bench_mbm

    with options.LateProgress("planning", 350 // stride) as bar:
        figures = bench_mbm(root, robot, bar.step, stride=stride, timeout=timeout, seed=seed, base=base)
    valid, total = figures["valid"], figures["total"]
    output.say(f"{robot} ({base}), {total} problems, {total - valid} with a start or goal in collision")
    share = 100.0 * figures["certified"] / max(valid, 1)
    row("certified", f"{figures['certified']} of {valid} ({share:.1f} %) within {timeout:g} s")
    ms = figures["ms"]
    if figures["certified"]:
        low, middle, high = ms["quartiles"]
        row("time", f"p25 {low:.1f}, p50 {middle:.1f}, p75 {high:.1f}, p95 {ms['p95']:.1f}, mean {ms['mean']:.1f} ms")
        row("by the line", f"{figures['by_the_line']}")
        length = figures["length_rad"]
        row("length", f"p50 {length['p50']:.2f}, p95 {length['p95']:.2f}, max {length['max']:.2f} rad")
        row("clearance", f"p50 {1e3 * figures['clearance_m']['p50']:.1f} mm")
    for kind, some in figures["kinds"].items():
        row(kind, f"{some['certified']} of {some['valid']}")
    for failure in figures["failures"]:
        row(f"{failure['name']} failed", failure["reason"], False)
    output.write_document("figures", json_file, figures)


@click.command(short_help="What spheres about the links decide.")
@_mbm_root
@_mbm_arm
@click.option("--stride", type=click.IntRange(1, 1000), default=4, show_default=True, help="Every so many problems.")
@click.option("--each", type=click.IntRange(1, 10_000), default=60, show_default=True, help="Configurations of a sort.")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the configurations.")
@runs_option
def looks(root: str, robot: str, stride: int, each: int, seed: int, json_file: str | None) -> None:
    """Look at configurations near MotionBenchMaker's problems: what spheres decide, and what is left to exact shapes.

    ELASTIC_STRIPS_INSTRUCTIONS=baseline|avx2|avx512 chooses what the spheres are looked at with."""
    from workshop.bench.looks import bench_looks

    with options.LateProgress("looking", 350 // stride) as bar:
        figures = bench_looks(root, robot, bar.step, stride=stride, each=each, seed=seed)
    some, leaves, us = figures["configurations"], figures["leaves"], figures["us_each"]
    output.say(
        f"{robot}, {some['valid']} valid and {some['invalid']} invalid configurations, {figures['instructions']}"
    )
    row("otherwise than by shapes", str(figures["wrong"]), figures["wrong"] == 0)
    row("spheres", f"{leaves['of a link']:.0f} of a link, {leaves['of all']} of {leaves['links']}")
    row("time of each", ", ".join(f"{name} {value:.2f} µs" for name, value in us.items()))
    for kind, share in figures["shares"].items():
        row(kind, ", ".join(f"{name} {100 * value:.1f} %" for name, value in share.items()))
    output.write_document("figures", json_file, figures)


@click.command(short_help="Inverse kinematics of the whole body.")
@options.robot_option("panda")
@click.option("--frame", default="panda_hand_tcp", show_default=True, metavar="NAME", help="A frame of the robot.")
@click.option("--base", type=options.BASE, help="The robot's own where not given.")
@click.option("--poses", type=click.IntRange(1, 1_000_000), default=1000, show_default=True, help="Number of poses.")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the poses.")
@figures_option
def ik(robot: str, frame: str, base: str | None, poses: int, seed: int, json_file: str | None) -> None:
    """Reach poses of random configurations from home; beside a single start of the usual loop."""
    from elastic_strips.robot import load_robot
    from workshop.bench.inverse_kinematics import bench_inverse_kinematics

    with options.LateProgress("reaching", poses) as bar:
        figures = bench_inverse_kinematics(load_robot(robot, base=base), frame, bar.step, poses=poses, seed=seed)
    output.say(f"{figures['robot']} ({figures['base']}), {poses} poses of {frame}")
    for what, some in (("reached", figures), ("one start", figures["one_start"])):
        row(what, f"{100 * some['reached']:.2f} %, {times(some['ms'])}")
    if figures["position_m"] is not None:
        row("at most off by", f"{1e3 * figures['position_m']:.3f} mm, {1e3 * figures['angle_rad']:.3f} mrad")
    output.write_document("figures", json_file, figures)


environments_option = click.option(
    "--environments",
    default="peers",
    show_default=True,
    metavar="DIR",
    type=click.Path(file_okay=False),
    help="Where each planner gets a virtual environment of its own, by pip.",
)
path_timeout_option = click.option(
    "--timeout", type=options.Finite(0.01, 600), default=10.0, show_default=True, help="For each path [s]."
)


@click.command(short_help="Other planners on the same problems.")
@options.robot_option("tiago")
@seeds_option(20, "Number of problems.")
@scenario_option("corridor")
@click.option(
    "--peer",
    "peers",
    multiple=True,
    type=options.LateChoice("workshop.bench.peers", "REQUIREMENTS"),
    help="Only this one; may be given again.",
)
@environments_option
@path_timeout_option
@runs_option
def peers(
    robot: str,
    seeds: int,
    scenario: str,
    peers: tuple[str, ...],
    environments: str,
    timeout: float,
    json_file: str | None,
) -> None:
    """First paths, and paths again after an obstacle was pushed 35 mm into them: here, and by other planners.

    The robot's base may go sideways, since the others know no wheels. Their paths are certified here."""
    from elastic_strips.robot import load_robot
    from workshop.bench.peers import REQUIREMENTS, bench_peers

    model = load_robot(robot, base="omni")
    with options.LateProgress("planning") as bar:
        figures = bench_peers(
            model,
            seeds,
            bar.step,
            scenario=scenario,
            peers=peers or tuple(REQUIREMENTS),
            environments=environments,
            timeout=timeout,
        )
    output.say(f"{figures['robot']} ({figures['base']}), {seeds} problems of {scenario}")
    for name, peer in figures["planners"].items():
        if "skipped" in peer:
            output.say(f"{name}: skipped: {peer['skipped']}")
            continue
        output.say(f"{name} {peer.get('version', '')} {peer.get('planner', '')}".rstrip())
        for what, part in (("first", peer["first"]), ("again", peer["again"])):
            jump = part["jump_m"]["p50"]
            row(
                what,
                f"{part['solved']} of {part['count']}: {times(part['ms'])}; {part['certified']} certified, "
                f"{part['touching']} touch{'' if jump is None else f'; jump p50 {jump:.2f} m'}",
            )
    output.write_document("figures", json_file, figures)


@click.command(short_help="Other planners' paths, certified, repaired and driven.")
@options.robot_option("tiago")
@seeds_option(20, "Number of scenes.")
@click.option(
    "--planner",
    "planners",
    multiple=True,
    type=options.LateChoice("workshop.bench.others", "OTHERS"),
    help="Only this one; may be given again.",
)
@environments_option
@path_timeout_option
@runs_option
def others(
    robot: str, seeds: int, planners: tuple[str, ...], environments: str, timeout: float, json_file: str | None
) -> None:
    """Paths of OMPL and RoboPlan: certified as they come, repaired, and followed while something comes into them.

    A base drives through corridors, and may go sideways; an arm that stands is among boxes."""
    from elastic_strips.robot import BaseKind, load_robot
    from workshop.bench.others import OTHERS, bench_others

    model = load_robot(robot)
    if model.base_kind is BaseKind.DIFF_DRIVE:
        model = load_robot(robot, base="omni")
    with options.LateProgress("looking") as bar:
        figures = bench_others(
            model, range(seeds), bar.step, planners=planners or OTHERS, environments=environments, timeout=timeout
        )
    output.say(f"{figures['robot']} ({figures['base']}), {seeds} scenes")
    for name, some in figures["planners"].items():
        if "skipped" in some:
            output.say(f"{name}: skipped: {some['skipped']}")
            continue
        output.say(f"{name} {some.get('version', '')} {some.get('planner', '')}".rstrip())
        row("solved", f"{some['solved']} of {some['count']}")
        depth, moved = some["depth_m"], some["moved_m"]
        row(
            "as they are",
            f"{some['certified']} certified, {some['refuted']} refuted, {some['unknown']} unknown"
            + ("" if depth["p50"] is None else f"; p50 {1e3 * depth['p50']:.1f}, max {1e3 * depth['max']:.1f} mm deep"),
        )
        row(
            "repaired",
            f"{some['repaired']} certified"
            + ("" if moved["p50"] is None else f"; moved by p50 {moved['p50']:.2f}, max {moved['max']:.2f} m"),
        )
        row("as timed, with what comes", f"{some['blind_refuted']} of {some['drives']} run into something")
        row(
            "followed online",
            f"{some['reached']} of {some['drives']} reached; contacts at speed {some['contacts_at_speed']}, "
            f"at rest {some['contacts_at_rest']}; {some['replans']} replans",
            some["contacts_at_speed"] == 0,
        )
    output.write_document("figures", json_file, figures)


@click.command(short_help="What a planned strip loses and gains on its way to rest.")
@options.robot_option("silvermate")
@seeds_option(100, "Number of problems.")
@scenario_option("corridor")
@runs_option
def settle(robot: str, seeds: int, scenario: str, json_file: str | None) -> None:
    """Settle the planned strip of many seeds: clearance before and after, ticks, and the energy's rises."""
    from elastic_strips.robot import load_robot
    from workshop.bench.settle import bench_settle

    model = load_robot(robot)
    with options.LateProgress("settling", seeds) as bar:
        figures = bench_settle(model, scenario, seeds, bar.step)
    output.say(f"{figures['robot']} ({figures['base']}), {scenario}, {figures['strips']} strips")
    row("certified", f"{100 * figures['certified']:.1f} %", figures["certified"] == 1.0)
    row("at rest", f"{100 * figures['at_rest']:.1f} %, {100 * figures['at_rest_soon']:.1f} % within 60 ticks")
    if figures["strips"]:
        ticks, lost = figures["ticks"], figures["lost_m"]
        row("ticks", f"p50 {ticks['p50']:.0f}, p95 {ticks['p95']:.0f}, max {ticks['max']:.0f}")
        row("time", times(figures["ms"]))
        worse = f"more than 1 mm for {100 * figures['worse']:.1f} %"
        row("clearance lost", f"p95 {1e3 * lost['p95']:.2f}, max {1e3 * lost['max']:.2f} mm; {worse}")
        row("energy rose", f"by {figures['energy_rise']:.1e} of it in a tick at most")
    output.write_document("figures", json_file, figures)
