"""``elastic-strips drag``: push obstacles and the goal with the mouse, and watch the strip give way."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from . import options, output
from .robot_options import load_robot, robot_options

if TYPE_CHECKING:
    from elastic_strips.robot import LoadOptions


@click.command()
@click.argument("scenario", metavar="[NAME|FILE.yaml]", default="case-7", type=options.SCENARIO)
@options.robot_option(help="A robot other than the scenario's: a name, or your own URDF file.")
@robot_options
@options.base_option()
@click.option("--seed", type=options.SEED, help="Seed of the planner and of generated scenes.  [default: 0]")
@click.option("--rate", type=options.Finite(1, 1000), default=50.0, show_default=True, help="Ticks a second.")
@click.option(
    "--speed", type=options.Finite(0.01, 100), default=2.0, show_default=True, help="Largest speed of dragging [m/s]."
)
@click.option("--for", "seconds", type=options.Finite(0.1, 1e6), help="End after this many seconds.")
@options.browser_option
def drag(
    scenario: str,
    robot: str | None,
    described: LoadOptions,
    base: str | None,
    seed: int | None,
    rate: float,
    speed: float,
    seconds: float | None,
    no_browser: bool,
) -> int:
    """Plan a strip and keep it alive in the browser: drag an obstacle with the mouse, or the ring at the goal. Without
    a name it is case-7.

    With Shift, or the arrow, an obstacle goes up and down; with Alt, or the ring about it, it turns. The card says how
    long a tick takes, how clear the strip is, and whether it is certified. The server listens on this machine only;
    Ctrl-C ends it.

    Exit code 0: the strip was certified at the end. 2: wrong input. 3: it was broken.
    """
    from elastic_strips.planning import plan_report
    from elastic_strips.sim.scenarios import get_scenario

    options.check_outputs(scenario)
    problem = get_scenario(scenario, seed=seed or 0)
    model = load_robot(problem, robot, described, base=base)
    plan = plan_report(model, problem.scene, *problem.ends(model), seed=seed or 0)
    if not plan.certified:
        output.say(f"warning: {plan.reason}", err=True)
    with options.open_viewer(no_browser=no_browser, title=problem.name) as viewer:
        from elastic_strips.viewer import LiveStrip

        with LiveStrip(model, problem.scene, plan.strip, viewer=viewer, rate=rate, speed=speed) as live:
            output.say(f"viewer  {viewer.url}  (drag obstacles and the goal's ring; Ctrl-C ends)")
            end = time.monotonic() + (seconds or float("inf"))
            try:
                while viewer.alive and live.alive and time.monotonic() < end:
                    time.sleep(0.1)
            except KeyboardInterrupt:
                pass
        report = live.report
        output.say(
            f"{report.status.value}: clearance of the nodes {report.node_clearance:.3f} m, ",
            output.verdict("certified" if report.certified else "not certified", report.certified),
            f", {live.ticks} ticks, {live.replans} planned anew",
        )
    return options.EXIT_DONE if report.certified else options.EXIT_NOT_DONE
