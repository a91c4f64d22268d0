"""``python -m workshop``: drives in the closed loop, many of them, with faults, for long, and against the clock."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

import click

from elastic_strips.catalogue import FAULTS
from elastic_strips.cli import options, output
from elastic_strips.cli.output import row

from .bench_options import METHOD, house_option, root_option, runs_option, scenario_option, seeds_option, times

if TYPE_CHECKING:
    from workshop.bench.measure import Figures


@click.command(short_help="Drive among moving obstacles, many seeds.")
@options.robot_option("silvermate")
@click.option(
    "--scenario",
    type=options.SEEDED,
    default="moving-corridor",
    show_default=True,
    metavar="NAME",
    help="A seeded scenario.",
)
@seeds_option(50, "Number of runs.", 1_000_000)
@click.option("--first", type=options.SEED, default=0, show_default=True, help="First seed.")
@click.option("--plant", type=options.PLANT, default="kinematic", show_default=True, help="The machine.")
@options.evade_option
@click.option(
    "--alternatives", type=click.IntRange(1, 10), default=1, show_default=True, help="Strips that are kept at hand."
)
@options.level_option
@click.option("--method", type=METHOD, default="strip", show_default=True, help="What steers.")
@options.sensors_option
@options.compute_option
@options.processes_option
@runs_option
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
    from workshop.bench.drive import bench_drive

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
    output.say(f"{robot}, {scenario}, {method}, {plant} plant, {seeds} runs, computing: {figures['compute']}")
    _drive_rows(figures)
    for group in figures["classes"]:
        output.say(f"movers up to {group['from']:g} … {group['to']:g} m/s, {group['count']} runs")
        _drive_rows(group)
    _failed_rows(figures)
    output.write_document("figures", json_file, figures)


def _disturb(name: str, scenario: str) -> click.Command:
    @click.command(name, short_help="Put faults into many runs.")
    @options.robot_option("silvermate")
    @seeds_option(50, "Runs of each fault.")
    @scenario_option(scenario, "What is driven.")
    @click.option(
        "--kind",
        "kinds",
        multiple=True,
        metavar="KIND",
        type=options.FAULT_KIND,
        help="Only this fault; may be given again.",
    )
    @options.sensors_option
    @options.compute_option
    @options.processes_option
    @runs_option
    def command(
        robot: str,
        seeds: int,
        scenario: str,
        kinds: tuple[str, ...],
        sensors: str | None,
        compute: str | None,
        processes: int | None,
        json_file: str | None,
    ) -> None:
        """Every kind of fault at a random time: the robot has to come to rest without a contact at speed, to name what
        is wrong, and to go on to the goal when it is over."""
        from elastic_strips.sim import Fault
        from workshop.bench.drive import bench_disturb

        chosen = tuple(Fault.parse(f"{kind}@0").kind for kind in kinds) or None
        config = options.sensors_of(sensors, robot)
        with options.LateProgress("putting in faults", seeds * len(chosen or FAULTS)) as bar:
            figures = bench_disturb(
                robot,
                range(seeds),
                bar.step,
                kinds=chosen,
                scenario=scenario,
                sensors=config,
                compute=_compute(compute),
                processes=processes,
            )
        _disturbed_rows(figures)
        output.write_document("figures", json_file, figures)

    return command


def _disturbed_rows(figures: Figures) -> None:
    for kind, some in figures["kinds"].items():
        row(
            kind,
            f"{some['count']} runs: {100 * some['reached']:.0f} % reached, {some['collisions']} contacts at speed "
            f"({some['collisions_standing']} with what stands), {100 * some['at_rest_or_goal']:.0f} % end at rest "
            f"or at the goal, at most {some['tracking_m'].get('max', 0.0):.3f} m off, "
            f"{100 * some['named']:.0f} % named in the log",
        )


disturb: click.Command = _disturb("disturb", "corridor")
faults: click.Command = _disturb("faults", "moving-corridor")


def _problem(kind: str, text: str, about: str) -> click.Command:
    @click.command(kind, short_help=text, help=text)
    @root_option(f"{kind}/{kind}_worlds.json", about)
    @options.robot_option("jackal-box")
    @seeds_option(1, "Runs of each world.", 1000)
    @click.option("--id", "ids", multiple=True, type=int, metavar="ID", help="Only this world; may be given again.")
    @click.option(
        "--difficulty",
        type=click.Choice(["easy", "medium", "hard"]),
        default=None,
        help="Only worlds of this class, where they have one.",
    )
    @click.option(
        "--phases",
        type=click.IntRange(1, 100),
        default=1,
        show_default=True,
        help="Runs of each seed that begin at other times of the obstacles' loops.",
    )
    @click.option("--method", type=METHOD, default="strip", show_default=True, help="What steers.")
    @options.sensors_option
    @options.compute_option
    @options.processes_option
    @runs_option
    def command(
        root: str,
        robot: str,
        seeds: int,
        ids: tuple[int, ...],
        difficulty: str | None,
        phases: int,
        method: str,
        sensors: str | None,
        compute: str | None,
        processes: int | None,
        json_file: str | None,
    ) -> None:
        from workshop.bench.problems import bench_problems

        config = options.sensors_of(sensors, robot)
        with options.LateProgress(kind) as bar:
            figures = bench_problems(
                kind,
                root,
                bar.step,
                robot=robot,
                seeds=seeds,
                ids=ids or None,
                difficulty=difficulty or "",
                phases=phases,
                method=method,
                sensors=config,
                compute=_compute(compute),
                processes=processes,
            )
        output.say(
            f"{robot}, {figures['method']}, {figures['worlds']} worlds, {figures['count']} runs, "
            f"computing: {figures['compute']}"
        )
        _problem_rows(figures)
        for name, group in figures["by_difficulty"].items():
            output.say(f"{name}, {group['count']} runs")
            _problem_rows(group)
        for run in figures["runs"]:
            if not run["success"]:
                which = f"world {run['id']} seed {run['seed']} phase {run['phase']}"
                row(which, run["reason"] or "an obstacle ran into the robot at rest")
        output.write_document("figures", json_file, figures)

    return command


_CHALLENGE = "from the BARN challenge (github.com/Daffan/the-barn-challenge)"
barn: click.Command = _problem(
    "barn",
    "BARN's static worlds, for a base as large as a Jackal.",
    f"made of the worlds {_CHALLENGE}; workshop.datasets reads it.",
)
dynabarn: click.Command = _problem(
    "dynabarn",
    "DynaBARN's moving discs, for a base as large as a Jackal.",
    f"made of the arenas {_CHALLENGE}; workshop.datasets reads it.",
)


@click.command(short_help="The bridge: the arm has to duck.")
@root_option(
    "bridge/bridge.json",
    "the numbers of the first experiment of REMANI-Planner (github.com/SYSU-STAR/REMANI-Planner); "
    "workshop.datasets reads it.",
)
@options.robot_option("bridge-arm")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the planner.")
@options.compute_option
@runs_option
def bridge(root: str, robot: str, seed: int, compute: str | None, json_file: str | None) -> None:
    """Plan both legs under the bridge, and drive them."""
    from workshop.bench.problems import bench_bridge

    with options.LateProgress("bridge") as bar:
        bar.step()
        figures = bench_bridge(root, robot=robot, seed=seed, compute=_compute(compute))
    for leg in figures["legs"]:
        verdict = "certified" if leg["certified"] else "not certified"
        row(
            f"leg {leg['leg'] + 1}",
            f"{verdict} by {leg['method']} in {leg['seconds']:.2f} s, clearance {leg['clearance_m']:.3f} m",
        )
    driven = "reached" if figures["reached"] else "not reached"
    row(
        "driven",
        f"{driven} in {figures['time_s']:.1f} s, {figures['collisions']} collisions, "
        f"least clearance {figures['min_clearance_m']:.3f} m",
    )
    output.write_document("figures", json_file, figures)


@click.command(short_help="Across a furnished house.")
@house_option()
@options.robot_option("silvermate")
@seeds_option(30, "Pairs of start and goal.")
@click.option("--first", type=options.SEED, default=0, show_default=True, help="First seed.")
@options.evade_option
@options.sensors_option
@click.option("--reach", is_flag=True, help="Reach with the hand for places above furniture. Joints of heads look.")
@click.option(
    "--walkers", type=click.IntRange(0, 20), default=0, show_default=True, help="With --reach: people who walk about."
)
@options.compute_option
@options.processes_option
@runs_option
def house(
    root: str,
    robot: str,
    seeds: int,
    first: int,
    evade: bool | None,
    sensors: str | None,
    reach: bool,
    walkers: int,
    compute: str | None,
    processes: int | None,
    json_file: str | None,
) -> None:
    """Drive from one free place of the house to another, with walls, furniture and their legs as 571 convex pieces."""
    from workshop.bench.drive import bench_drive
    from workshop.bench.reaches import bench_reaches

    if walkers and not reach:
        raise click.UsageError("--walkers is for --reach")
    config = options.sensors_of(sensors, robot)
    if reach:
        with options.LateProgress("reaching", seeds) as bar:
            figures = bench_reaches(
                robot,
                range(first, first + seeds),
                bar.step,
                root=root,
                walkers=walkers,
                sensors=config,
                compute=_compute(compute or "work"),
                processes=processes,
            )
        output.say(f"{robot}, reaches in the house, {seeds} drives, {walkers} people, computing: {figures['compute']}")
        row("reached", f"{figures['reached']} of {seeds}", figures["reached"] == seeds)
        row("contacts at speed", f"{figures['contacts_seen']} with what was seen", not figures["contacts_seen"])
        row("", f"{figures['contacts_unseen']} with what no sensor had in view; {figures['contacts_at_rest']} at rest")
        if figures["reached"]:
            row("time", f"p50 {figures['time_s']['p50']:.1f} s, p95 {figures['time_s']['p95']:.1f} s")
        row("stops", f"{figures['stops']}")
        for why, count in figures["failures"].items():
            row("failed", f"{count}: {why}", False)
        output.write_document("figures", json_file, figures)
        return
    with options.LateProgress("driving", seeds) as bar:
        figures = bench_drive(
            robot,
            range(first, first + seeds),
            bar.step,
            scenario="house",
            evade=evade is not False,
            sensors=config,
            compute=_compute(compute),
            time_limit=180.0,
            root=root,
            processes=processes,
        )
    output.say(f"{robot}, house, {seeds} pairs, computing: {figures['compute']}")
    _drive_rows(figures)
    _failed_rows(figures)
    output.write_document("figures", json_file, figures)


@click.command(short_help="Goals that change, are passed, or are paths and poses of both hands.")
@options.robot_option("silvermate")
@options.base_option()
@click.option(
    "--case",
    type=options.LateChoice("workshop.bench.goals", "CASES"),
    default="every",
    show_default=True,
    help="What is measured.",
)
@seeds_option(3, "Number of drives.")
@click.option(
    "--rate", type=options.Finite(1.0, 1000.0), default=100.0, show_default=True, help="Of the control loop [1/s]."
)
@click.option(
    "--seconds", type=options.Finite(1.0, 36000), default=120.0, show_default=True, help="Of a drive, at most [s]."
)
@click.option("--moving/--static", default=False, show_default=True, help="Whether something moves beside what stands.")
@click.option(
    "--root",
    metavar="DIR",
    type=click.Path(exists=True, file_okay=False),
    help="Folder with house.json, in which picks are; without it they are on tables in an open room.",
)
@options.compute_option
@options.processes_option
@runs_option
def goals(
    robot: str,
    base: str | None,
    case: str,
    seeds: int,
    rate: float,
    seconds: float,
    moving: bool,
    root: str | None,
    compute: str | None,
    processes: int | None,
    json_file: str | None,
) -> None:
    """Drives with goals on the move, where computing takes modelled time unless another cost is given.

    every: a new goal every two seconds, taken at speed and, for comparison, after a stop. patrol: ten goals, passed
    and, for comparison, with a stop at each. path: a path of the base, kept to within 0.3 m. look: a hand that points
    at a place. hands: poses of all hands at once; of one hand and the base where there is one only. picks: a can on
    furniture is driven to, reached and lifted.
    """
    from workshop.bench.goals import bench_goals

    with options.LateProgress("driving", seeds) as bar:
        figures = bench_goals(
            robot,
            case,
            range(seeds),
            bar.step,
            base=base,
            rate=rate,
            seconds=seconds,
            moving=moving,
            compute=_compute(compute or "work"),
            processes=processes,
            root=root,
        )
    if case == "picks":
        _pick_rows(figures, root)
        output.write_document("figures", json_file, figures)
        return
    output.say(f"{robot}, {case}, {'moving' if moving else 'static'}, {rate:g} Hz, computing: {figures['compute']}")
    for way, some in figures["ways"].items():
        output.say(f"{way}, {some['count']} drives")
        _goal_rows(case, some)
    for run in figures["runs"]:
        if "error" in run or run["contacts"] or run["goals_missed"] or (case != "every" and not run["reached"]):
            row(f"{run['way']}, seed {run['seed']}", run.get("error") or f"{run['state']}: {run['reason']}", False)
    output.write_document("figures", json_file, figures)


def _pick_rows(figures: Figures, root: str | None) -> None:
    output.say(f"{figures['robot']}, picks {'on tables' if root is None else 'in the house'}")
    for way, some in figures["ways"].items():
        output.say(f"{way}, {some['count']} picks")
        row("certified", f"{some['certified']} of {some['count']}", some["certified"] == some["count"])
        for what, count in some["failures"].items():
            row("configurations", f"{count} failed at {what}")
        work = some["work_s"]
        if work["p50"] is not None:
            row("work", f"p50 {work['p50']:.1f} s, p95 {work['p95']:.1f} s as modelled")
        if "reached" in some:
            row("driven", f"{some['reached']} reached, {some['contacts']} contacts", some["contacts"] == 0)
    for run in figures["runs"]:
        if "error" in run or not run["certified"]:
            row(f"{run['way']}, seed {run['seed']}", run.get("error") or f"{run['on']}: {run['reason']}", False)


def _goal_rows(case: str, figures: Figures) -> None:
    minutes = max(figures["time_s"], 1e-9) / 60.0
    if case == "every":
        row("nearer to the goals", f"{figures['progress_m']:.1f} m, {figures['progress_m'] / minutes:.1f} m a minute")
    else:
        row("reached", f"{figures['reached']} of {figures['count']}", figures["reached"] == figures["count"])
    row("driven", f"{figures['path_m']:.1f} m in {figures['time_s']:.1f} s, {figures['rest_s']:.1f} s of it at rest")
    row("came to rest", f"{figures['rests']} times, stood {figures['longest_stand_s']:.1f} s short of a goal at most")
    row(
        "contacts at speed",
        f"{figures['contacts']} ({figures['contacts_standing']} with what stands)",
        figures["contacts"] == 0,
    )
    row(
        "goals",
        f"{figures['goals']} reached, {figures['passed']} of them passed, at most {figures['goals_off_m']:.3f} m off, "
        f"{figures['goals_missed']} beyond tolerance and tracking error",
        figures["goals_missed"] == 0,
    )
    for name, text in _OF_A_CASE.items():
        if name in figures:
            row(name.replace("_", " "), text.format(figures[name]))
    for what in ("stop_reasons", "waits"):
        for reason, count in figures[what].items():
            row("stopped" if what == "stop_reasons" else "waited", f"{count} times: {reason}")


_OF_A_CASE = {
    "astray_m": "at most {:.3f} m off what was asked, where a goal was called reached",
    "off_path_m": "at most {:.3f} m off the path",
    "from_end_m": "at most {:.3f} m from the end of the path in the end",
    "off_rad": "at most {:.3f} rad off the gaze",
    "within": "{:.1%} of the samples within the gaze's tolerance",
    "hands_off_m": "at most {:.3f} m off the pose, of those that reached it",
}
"""Figures of some cases alone, and how they are told."""


@click.command(short_help="How soon a new obstacle is answered.")
@options.robot_option("silvermate")
@seeds_option(50, "Number of corridors.")
@click.option(
    "--depth", type=options.Finite(0.0, 0.4), default=0.1, show_default=True, help="How far into the way [m]."
)
@runs_option
def reaction(robot: str, seeds: int, depth: float, json_file: str | None) -> None:
    """A post appears on the strip while the robot drives, planned at 100 Hz: ticks until a new certified strip is
    followed."""
    from elastic_strips.robot import load_robot
    from workshop.bench.drive import bench_reaction

    with options.LateProgress("reacting", seeds) as bar:
        figures = bench_reaction(load_robot(robot), range(seeds), bar.step, depth=depth)
    ticks, ms = figures["ticks"], figures["ms"]
    row("reacted", f"{figures['reacted']} of {figures['count']}", figures["reacted"] == figures["count"])
    row("ticks of 10 ms", f"p50 {ticks['p50']:.0f}, p95 {ticks['p95']:.0f}, max {ticks['max']:.0f}")
    row("time", f"p50 {ms['p50']:.1f}, p95 {ms['p95']:.1f} ms")
    row("the tick itself", f"p50 {figures['tick_ms']['p50']:.1f}, p95 {figures['tick_ms']['p95']:.1f} ms")
    output.write_document("figures", json_file, figures)


@click.command(short_help="Drive for a long time; watch memory and ticks.")
@options.robot_option("silvermate")
@click.option("--hours", type=options.Finite(0.01, 1000), default=1.0, show_default=True, help="Of simulated time.")
@runs_option
def soak(robot: str, hours: float, json_file: str | None) -> None:
    """Drive to and fro among moving obstacles in one process."""
    from elastic_strips.robot import load_robot
    from workshop.bench.drive import bench_soak

    with options.LateProgress("soaking") as bar:
        figures = bench_soak(load_robot(robot), hours, bar.step)
    memory = figures["memory_mb"]
    row("driven", f"{figures['hours']:.2f} h, {figures['legs']} legs, {figures['stops']} stops")
    if figures["growth"] is not None:
        row("memory", f"{memory['warm']:.1f} to {memory['end']:.1f} MB, {100 * figures['growth']:+.2f} %")
        first, second = figures["tick_ms_first_half"], figures["tick_ms_second_half"]
        if first["p50"] is not None:
            row("p99 of ticks", f"{first['p50']:.1f} ms in the first half, {second['p50']:.1f} ms in the second")
    output.write_document("figures", json_file, figures)


@click.command(short_help="How evenly commands come against the wall clock.")
@options.robot_option("silvermate")
@click.option("--minutes", type=options.Finite(0.1, 1440), default=10.0, show_default=True, help="How long.")
@click.option("--inline", is_flag=True, help="Control and planning in one thread, for comparison.")
@runs_option
def realtime(robot: str, minutes: float, inline: bool, json_file: str | None) -> None:
    """Drive to and fro among moving obstacles against the wall clock, with machine, control loop and planning in
    processes of their own; planning never waits."""
    from elastic_strips.robot import load_robot
    from workshop.bench.realtime import bench_realtime

    with options.LateProgress("driving") as bar:
        figures = bench_realtime(load_robot(robot), minutes, bar.step, inline=inline)
    row(
        "driven",
        f"{figures['seconds']:.0f} s in {figures['mode']} ({figures['priority']}), {figures['legs']} legs, "
        f"{len(figures['stops'])} stops, {figures['contacts_at_speed']} contacts at speed",
    )
    for name, key in (
        ("gaps of commands", "gap_ms"),
        ("without pauses", "gap_unpaused_ms"),
        ("control steps", "step_ms"),
    ):
        gap = figures[key]
        if gap["p50"] is not None:
            row(name, f"p50 {gap['p50']:.2f}, p99 {gap['p99']:.2f}, p99.9 {gap['p99_9']:.2f}, max {gap['max']:.2f} ms")
    row("in bursts", f"{100 * figures['bursts']:.2f} %")
    row(
        "two periods late",
        f"{figures['late']}, {figures['late_paused']} of them in pauses of the computer "
        f"({figures['paused_s']:.1f} s in all, the longest {figures['longest_pause_ms']:.0f} ms)",
    )
    output.write_document("figures", json_file, figures)


@click.command(short_help="Kill and stop processes of drives against the wall clock.")
@options.robot_option("silvermate")
@seeds_option(5, "Trials of each kind.")
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    type=options.LateChoice("workshop.bench.trials", "KINDS"),
    help="Only this one; may be given again.",
)
@runs_option
def trials(robot: str, seeds: int, kinds: tuple[str, ...], json_file: str | None) -> None:
    """The planner or the executor is killed, stopped or hung at a random time, or the disk is full: the robot has to
    come to rest without a contact, and to go on where it can."""
    from workshop.bench.trials import KINDS, bench_trials

    with options.LateProgress("killing", seeds * len(kinds or KINDS)) as bar:
        figures = bench_trials(robot, range(seeds), bar.step, kinds=kinds or None)
    for kind, some in figures["kinds"].items():
        longest = some["longest_to_rest_s"]
        row(
            kind,
            f"{some['count']} trials: {100 * some['at_rest']:.0f} % at rest in the end, "
            + ("" if longest is None else f"after {longest:.2f} s at most, ")
            + f"{some['contacts_at_speed']} contacts at speed, {100 * some['reached']:.0f} % reached, "
            f"{100 * some['named']:.0f} % named",
        )
    output.write_document("figures", json_file, figures)


@click.command(short_help="Hostile pilots, and what a guard makes of them.")
@click.option(
    "--robot",
    "robots",
    multiple=True,
    default=("silvermate", "tiago"),
    show_default=True,
    metavar="NAME|URDF",
    help="A robot; may be given again.",
)
@seeds_option(2, "Runs of each pilot; every second one among moving obstacles.")
@click.option("--first", type=options.SEED, default=0, show_default=True, help="First seed.")
@click.option(
    "--base",
    "bases",
    multiple=True,
    type=click.Choice(["own", "omni"]),
    default=("own", "omni"),
    show_default=True,
    help="The robot's own base, or one that slides; may be given again.",
)
@click.option(
    "--pilot",
    "pilots",
    multiple=True,
    type=options.LateChoice("workshop.bench.guard", "PILOTS"),
    help="Only this pilot; may be given again.",
)
@click.option(
    "--method",
    "methods",
    multiple=True,
    type=options.LateChoice("workshop.bench.guard", "METHODS"),
    default=("guard",),
    show_default=True,
    help="The guard or a peer; may be given again.",
)
@click.option(
    "--obstacles",
    multiple=True,
    type=click.IntRange(0, 1000),
    default=(20,),
    show_default=True,
    help="Obstacles in the hall; may be given again.",
)
@click.option("--kind", type=options.FAULT_KIND, default="", metavar="KIND", help="A fault that is put into each run.")
@click.option("--plant", type=options.PLANT, default="kinematic", show_default=True, help="The machine.")
@click.option("--time", type=click.FloatRange(1.0, 3600.0), default=15.0, show_default=True, help="Of a run [s].")
@click.option("--passing", is_flag=True, help="Measure what passes: far from everything, along walls, in doors.")
@options.sensors_option
@options.compute_option
@options.processes_option
@runs_option
def guard(
    robots: tuple[str, ...],
    seeds: int,
    first: int,
    bases: tuple[str, ...],
    pilots: tuple[str, ...],
    methods: tuple[str, ...],
    obstacles: tuple[int, ...],
    kind: str,
    plant: str,
    time: float,
    passing: bool,
    sensors: str | None,
    compute: str | None,
    processes: int | None,
    json_file: str | None,
) -> None:
    """Pilots who mean harm drive a robot in a hall: the guard must let nobody touch anything at speed, and pass on what
    it can."""
    from elastic_strips.sim import Fault
    from workshop.bench.guard import PILOTS, bench_guard
    from workshop.bench.guard_passing import bench_passing

    chosen = ["" if base == "own" else base for base in bases]
    if passing:
        with options.LateProgress("passing") as bar:
            figures = bench_passing(robots, range(first, first + seeds), bar.step, bases=chosen)
        _passing_rows(figures)
    else:
        runs = len(robots) * len(chosen) * len(pilots or PILOTS) * len(methods) * len(obstacles) * seeds
        with options.LateProgress("guarding", runs) as bar:
            figures = bench_guard(
                robots,
                range(first, first + seeds),
                bar.step,
                bases=chosen,
                pilots=pilots or None,
                methods=methods,
                obstacles=obstacles,
                fault=Fault.parse(f"{kind}@0").kind if kind else "",
                plant=plant,
                time=time,
                compute=compute or "free",
                sensors=options.sensors_of(sensors, robots[0]),
                processes=processes,
            )
        _guarded_rows(figures)
    output.write_document("figures", json_file, figures)


def _guarded_rows(figures: Figures) -> None:
    for some in figures["groups"]:
        near = some["least_clearance_m"]
        row(
            f"{some['robot']} {some['base']} {some['method']}".replace("  ", " "),
            f"{some['obstacles']} obstacles, {some['count']} runs: {some['contacts_at_speed']} contacts at speed in "
            f"{some['runs_with_contacts']}, {some['contacts_with_seen']} with what was in view, "
            f"{some['contacts_at_rest']} at rest, "
            + ("" if near is None else f"least distance {1e3 * near:.0f} mm, ")
            + ("" if some["share"] is None else f"share {some['share']:.2f}, ")
            + f"path {some['path_m']:.1f} m, {some['unproven']} unproven, step {times(some['step_ms'])}",
            some["contacts_with_seen"] == 0,
        )


def _passing_rows(figures: Figures) -> None:
    for some in figures["rows"]:
        output.say(f"{some['robot']}, {some['base']}")
        for what, told in (
            ("base", "base command"),
            ("whole", "whole command"),
            ("whole_at_home", "about the home posture"),
        ):
            free = some.get(f"free_{what}")
            if free is not None:
                causes = ", ".join(f"{name} ({count})" for name, count in free["causes"])
                row(
                    told,
                    f"{100 * free['share']:.1f} % ({100 * free['least_share']:.1f} % at least) where nothing is near, "
                    f"as it is in {100 * free['passed']:.1f} % of "
                    f"the periods; bent by {causes or 'nothing'}",
                )
        for name, wall in some.items():
            if name.startswith("wall"):
                row(
                    f"wall at {name[5:]}°",
                    f"{100 * wall['whole']:.0f} % of the speed, {100 * wall['settled']:.0f} % in its second half"
                    + ("" if wall["of_free"] is None else f", {100 * wall['of_free']:.1f} % of that without the wall")
                    + f"; {wall['braking']} periods of braking",
                )
            elif name.startswith("door"):
                row(
                    f"door of {name[5:]} m",
                    ", ".join(
                        f"{method} " + ("not through" if door["time_s"] is None else f"{door['time_s']:.2f} s")
                        for method, door in wall.items()
                    ),
                )


def _compute(given: str | None) -> str:
    """What computing costs: as it was measured, unless something else was asked for."""
    from elastic_strips.sim.computing import Computing

    return str(Computing.parse(given or "1").label)


def _drive_rows(figures: Figures) -> None:
    row("reached", f"{100 * figures['reached']:.1f} %", figures["reached"] == 1.0)
    unseen = figures["collisions"] - figures["collisions_seen"]
    row("contacts at speed", f"{figures['collisions']}" + (f", {unseen} with what no laser saw" if unseen else ""))
    row("run into at rest", f"{figures['runs_with_contacts_at_rest']} runs")
    row("stops", f"{figures['stops']}, {figures['stops_without_reason']} without a reason")
    if figures["time_s"]["p50"] is not None:
        row("time", f"p50 {figures['time_s']['p50']:.1f}, p95 {figures['time_s']['p95']:.1f} s")
        if figures["tracking_m"]["p50"] is not None:
            row("tracking error", f"p50 {figures['tracking_m']['p50']:.4f}, max {figures['tracking_m']['max']:.4f} m")
        off = figures["constraint_rad"]
        if off["p50"] is not None:
            row(
                "off level",
                f"p50 {degrees(off['p50']):.1f}, max {degrees(off['max']):.1f}°, at the worst of each run",
            )
        row(
            "planning tick",
            f"median of p50 {figures['tick_ms_p50']['p50']:.1f}, of p99 {figures['tick_ms_p99']['p50']:.1f} ms",
        )
        ticks = figures["ticks"]
        if ticks["count"]:
            moving = ticks["moving_max_ms"]
            row(
                "all ticks",
                times(ticks["ms"])
                + f", max {ticks['ms']['max']:.1f} ms"
                + ("" if moving is None else f" ({moving:.1f} while moving)")
                + f", {100 * ticks['over_20_ms']:.2f} % over 20 ms",
            )
        anew = figures["planned_anew_s"]
        if anew["p50"] is not None:
            row("waits for plans", f"p50 {anew['p50']:.2f}, p99 {anew['p99']:.2f}, max {anew['max']:.2f} s")


def _failed_rows(figures: Figures) -> None:
    """A line for each run with something wrong."""
    for run in figures["runs"]:
        if not run["reached"] or run["collisions"]:
            last = run.get("error") or (run["stops"][-1][1] if run["stops"] else run["state"])
            touched = sorted({contact["obstacle"] for contact in run.get("contacts", ())})
            row(
                f"seed {run['seed']}",
                f"{run['collisions']} collisions{': ' if touched else ''}{', '.join(touched)}; {last}",
            )


def _problem_rows(figures: Figures) -> None:
    row("success", f"{100 * figures['success']:.1f} % without any contact", figures["success"] == 1.0)
    row("passively safe", f"{100 * figures['success_passive']:.1f} % reached without a contact at speed")
    row(
        "collisions",
        f"{100 * figures['collisions']:.1f} % of the runs at speed, "
        f"{100 * figures['run_into_at_rest']:.1f} % run into at rest",
    )
    row("contacts", f"{figures['contacts_at_speed']} at speed; {figures['contacts_per_s']:.3f} a second of either kind")
    row("reached", f"{100 * figures['reached']:.1f} %")
    if figures["time_s"]["p50"] is not None:
        row("time", f"p50 {figures['time_s']['p50']:.1f}, p95 {figures['time_s']['p95']:.1f} s")
    if "score" in figures:
        row("score", f"{figures['score']:.4f} (time counts from 4 T* on), {figures['score_2_8']:.4f} (from 2 T* on)")
