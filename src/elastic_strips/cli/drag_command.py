"""``elastic-strips drag``: push obstacles and the goal with the mouse, and watch the strip give way."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import click

from elastic_strips.errors import plural

from . import options, output
from .robot_options import load_robot, robot_options

if TYPE_CHECKING:
    from elastic_strips.planning import Goal
    from elastic_strips.robot import LoadOptions, RobotModel
    from elastic_strips.sim.scenarios import Scenario

_LONGEST_DRIVE = 86400.0  # [s]


@click.command()
@click.argument("scenario", metavar="[NAME|FILE.yaml]", default="case-7", type=options.SCENARIO)
@options.robot_option(help="A robot other than the scenario's: a name, or your own URDF file.")
@robot_options
@options.base_option()
@click.option("--seed", type=options.SEED, help="Seed of the planner and of generated scenes.  [default: 0]")
@click.option("--rate", type=options.Finite(1, 1000), default=50.0, show_default=True, help="Ticks a second [1/s].")
@click.option(
    "--speed", type=options.Finite(0.01, 100), default=2.0, show_default=True, help="Largest speed of dragging [m/s]."
)
@options.goals_option
@click.option("--drive", "drives", is_flag=True, help="Let the robot drive to wherever the goal is dragged.")
@click.option("--for", "seconds", type=options.Finite(0.1, 1e6), help="End after this time [s].")
@options.browser_option
@click.pass_context
def drag(
    context: click.Context,
    scenario: str,
    robot: str | None,
    described: LoadOptions,
    base: str | None,
    seed: int | None,
    rate: float,
    speed: float,
    goals: tuple[Goal, ...],
    drives: bool,
    seconds: float | None,
    no_browser: bool,
) -> int:
    """Plan a strip and show it in the browser, where it gives way while you drag an obstacle, or the ring at the goal,
    with the mouse. Without a name, the scenario is case-7.

    Shift, or the arrow, moves an obstacle up and down; Alt, or the ring around it, turns it. The card shows how long a
    tick takes, the clearance of the strip, and whether it is certified. With --drive the robot drives to wherever the
    goal's ring or hand is dragged, and obstacles move only by themselves. The server listens on this machine only;
    Ctrl-C ends it.

    Exit code 0: the strip was certified at the end; with --drive, nothing was touched at speed. 2: wrong input. 3: the
    strip was broken; with --drive, something was touched.
    """
    from elastic_strips.sim.scenarios import get_scenario

    options.check_outputs(scenario)
    if len(goals) > 1 and not drives:
        raise click.UsageError("several goals need --drive; a strip leads to one goal")
    for name in ("rate", "speed") if drives else ():
        if context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
            raise click.UsageError(f"--{name} is for a strip alone; with --drive the robot's own limits hold")
    problem = get_scenario(scenario, seed=seed or 0)
    model = load_robot(problem, robot, described, base=base)
    if drives:
        return _drive(problem, model, goals, seed, seconds, no_browser)
    return _keep(problem, model, goals, seed or 0, rate, speed, seconds, no_browser)


def _keep(
    problem: Scenario,
    model: RobotModel,
    goals: tuple[Goal, ...],
    seed: int,
    rate: float,
    speed: float,
    seconds: float | None,
    no_browser: bool,
) -> int:
    """Keep a strip alive while things are dragged."""
    from elastic_strips.planning import plan_report

    start, end = problem.ends(model)
    plan = plan_report(model, problem.scene, start, goals[0] if goals else end, seed=seed)
    if not plan.certified:
        output.say(("warning:", output.NOTE), f" {plan.reason}", err=True)
    with options.open_viewer(no_browser=no_browser, title=problem.name) as viewer:
        from elastic_strips.viewer import LiveStrip

        with LiveStrip(model, problem.scene, plan.strip, viewer=viewer, rate=rate, speed=speed) as live:
            output.say(f"viewer  {viewer.url}  (drag obstacles and the goal's ring; Ctrl-C ends)")
            until = time.monotonic() + (seconds or float("inf"))
            try:
                while viewer.alive and live.alive and time.monotonic() < until:
                    time.sleep(0.1)
            except KeyboardInterrupt:
                pass
        report = live.report
        output.say(
            f"{report.status.value}: clearance at the nodes {report.node_clearance:.3f} m, ",
            output.verdict("certified" if report.certified else "not certified", report.certified),
            f", {plural(live.ticks, 'tick')}, replanned {plural(live.replans, 'time')}",
        )
    return options.EXIT_DONE if report.certified else options.EXIT_NOT_DONE


def _drive(
    problem: Scenario,
    model: RobotModel,
    goals: tuple[Goal, ...],
    seed: int | None,
    seconds: float | None,
    no_browser: bool,
) -> int:
    """Drive to wherever the goal is dragged, against the wall clock."""
    from elastic_strips.sim.scenarios import make_simulation
    from elastic_strips.sim.scenarios.drive import DriveSetup, conclude

    from .drive_command import watched_drive

    setup = DriveSetup(robot=model, seed=problem.seed if seed is None else seed, goals=goals, compute="1")
    with options.open_viewer(no_browser=no_browser, title=problem.name) as viewer:
        driven, result, _ = watched_drive(
            problem,
            partial(make_simulation, problem, setup, realtime=True),
            time_limit=seconds or _LONGEST_DRIVE,
            viewer=viewer,
            stays=True,
        )
    found = conclude(problem, driven, result).evaluation
    touched = len(found.collisions)
    output.say(
        f"{driven.time:.1f} s, {found.path_m:.2f} m, {plural(len(result.goals), 'goal')} reached, "
        f"{plural(len(result.stops), 'stop')}, ",
        output.verdict(f"{plural(touched, 'contact')} at speed", not touched),
        f", run into {plural(len(found.rest_contacts), 'time')} at rest",
    )
    return options.EXIT_NOT_DONE if touched else options.EXIT_DONE
