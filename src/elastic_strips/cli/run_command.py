"""``elastic-strips run``: plan, deform, certify; write the result and show it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from elastic_strips.errors import listed, plural

from . import options, output
from .robot_options import load_robot, robot_options

if TYPE_CHECKING:
    from elastic_strips.robot import LoadOptions
    from elastic_strips.sim.scenarios import RunResult
    from elastic_strips.strip import DeformReport
    from elastic_strips.trajectory import MotionLimits
    from elastic_strips.viewer import Viewer


@click.command()
@click.argument("scenario", metavar="NAME|FILE.yaml", type=options.SCENARIO)
@click.option("--preset", type=options.PRESET, help="Parameters and solver; the scenario's by default.")
@options.robot_option(help="A robot other than the scenario's.")
@robot_options
@options.base_option()
@click.option("--seed", type=options.SEED, help="Seed of the planner and of generated scenes.  [default: 0]")
@click.option(
    "--timeout", type=options.Finite(0.01, 3600), default=20.0, show_default=True, help="Time limit of planning [s]."
)
@click.option(
    "--start-depth",
    type=options.Finite(0.0, 0.05),
    default=0.0,
    metavar="M",
    help="If the start touches something by at most this depth [m], lead out of it along growing distance, and certify "
    "the strip from where it is free: the result has both parts, and is not certified as a whole.",
)
@options.json_option("Write the result.")
@click.option(
    "--trajectory",
    "trajectory_file",
    metavar="FILE",
    type=options.OutputFile(),
    help="Write the certified strip, timed within the robot's limits: .csv, .npz, .json or .mcap.",
)
@options.limit_options
@options.html_option("Write a standalone 3D page of the result.")
@options.picture_options
@click.option("--view", is_flag=True, help="Show the result in the browser, on this machine only, until Ctrl-C.")
@options.browser_option
def run(
    scenario: str,
    preset: str | None,
    robot: str | None,
    described: LoadOptions,
    base: str | None,
    seed: int | None,
    timeout: float,
    start_depth: float,
    json_file: str | None,
    trajectory_file: str | None,
    limits: options.GivenLimits,
    html_file: str | None,
    png_file: str | None,
    film_file: str | None,
    view: bool,
    no_browser: bool,
) -> int:
    """Plan an initial strip, deform it away from the obstacles until it has converged, and certify it.

    NAME is one of "elastic-strips list"; FILE.yaml is a scenario file, such as

    \b
      robot: silvermate
      start: {x: -1}
      goal: {x: 4}
      scene:
        obstacles:
          - {shape: box, size: [0.6, 0.6, 1.4], at: [1.5, 0.1, 0.7]}

    where robot and scene may be paths: of a URDF or xacro file, and of a scene file, MoveIt's .scene, OctoMap's .bt or
    .ot, or a Nav2 map's .yaml.

    Obstacles that move, appear or vanish are taken as they are at the scene's time. A trajectory is certified against
    them by its times.

    Exit code 0: certified. 2: wrong input. 3: blocked or broken, certified only from where a start that touches is
    free, or no trajectory was found; the reason is printed.
    """
    from elastic_strips.collision.path_certificate import changes
    from elastic_strips.io.trajectory_file import check_trajectory_file
    from elastic_strips.sim.scenarios import get_scenario, result_document, run_scenario

    options.check_outputs(scenario, json_file, trajectory_file, html_file, png_file, film_file)
    if trajectory_file is not None:
        check_trajectory_file(trajectory_file)
    elif limits:
        raise click.UsageError(
            "--joint-speed, --wheel-speed, --base-speed, --track and --wheel-radius are for --trajectory"
        )
    problem = get_scenario(scenario, seed=seed or 0)
    model = load_robot(problem, robot, described, preset, base)
    allowed = None if trajectory_file is None else limits.of(model)
    with options.LateProgress(f"{problem.name}: deforming") as bar:

        def watch(report: DeformReport) -> None:
            bar.step(f"{report.status.value}, clearance at the nodes {report.node_clearance:.3f} m")

        result = run_scenario(
            problem, robot=model, preset=preset, seed=seed, timeout=timeout, watch=watch, start_depth=start_depth
        )
    _summary(result)
    if json_file is not None:
        output.write_document("result", json_file, result_document(result))
    timed = trajectory_file is None or _write_timed(result, trajectory_file, allowed)

    moving = {obstacle.name for obstacle in problem.scene if obstacle.motion is not None}
    others = [name for name in changes(problem.world) if name not in moving]
    notes = [("appears or vanishes", listed(others, 1))] if others else []

    def draw(viewer: Viewer) -> None:
        viewer.animate(model, problem.scene, result.report, duration=10.0, notes=notes)

    options.write_pictures(draw, html_file, png_file, film_file, title=problem.name)
    if view:
        options.serve(draw, no_browser=no_browser, title=problem.name)
    return options.EXIT_DONE if result.certified and timed else options.EXIT_NOT_DONE


def _write_timed(result: RunResult, file: str, limits: MotionLimits | None) -> bool:
    """Write the trajectory, or say why there is none."""
    from elastic_strips.collision import certify
    from elastic_strips.collision.path_certificate import changes
    from elastic_strips.io.trajectory_file import write_trajectory
    from elastic_strips.trajectory import RetimingError, retime

    if not result.certified:
        output.say(
            ("no trajectory", output.BAD),
            ": the strip is not certified" + ("" if result.departure is None else " as a whole"),
        )
        return False
    try:
        trajectory = retime(result.report.strip, limits=limits)
    except RetimingError as error:
        output.say(("no trajectory", output.BAD), f": {error}")
        return False
    by_times = ""
    if changes(world := result.scenario.world):
        by_times = ", certified by its times"
        met = certify(
            result.robot, world, trajectory.coordinates, clearance=result.params.clearance, times=trajectory.time
        )
        if not met.certified:
            reason = f"as it would be timed, {met.reason}; 'elastic-strips drive' gives way in time"
            output.say(("no trajectory", output.BAD), f": {reason}")
            return False
    written = write_trajectory(file, trajectory, scene=result.report.scene)
    output.say(f"trajectory  {written}, {trajectory.duration:.2f} s, {len(trajectory)} samples{by_times}")
    return True


def _summary(result: RunResult) -> None:
    from elastic_strips.collision.path_certificate import changes

    report = result.report
    verdict = "certified" if result.certified else report.status.value
    if result.departure is not None:
        verdict = "not certified" if result.departure.rest is None else "left contact, certified from where it is free"
    changing = changes(result.scenario.world)
    if changing and result.certified:
        verdict += f" as at {result.scenario.scene.time:g} s"
    output.say(
        f"{result.scenario.name} · {result.robot.name} · preset {result.params.preset}: ",
        output.verdict(verdict, result.certified),
    )
    output.say(f"  {result.reason}")
    first = "-" if result.time_to_certified is None else f"{1e3 * result.time_to_certified:.0f} ms"
    output.say(
        f"  clearance {result.clearance:.3f} m, length {report.strip.length:.2f} m, {len(report.strip)} nodes, "
        f"{plural(result.ticks, 'tick')}, first certified after {first}"
        + (f", passes {result.passing_side}" if result.passing_side else "")
    )
    if changing:
        output.say(
            ("  note:", output.NOTE),
            f" the scene changes with time ({listed(changing)}), and is taken as it is then; 'elastic-strips drive' "
            "reckons with what changes",
        )
    if not result.certified and report.certificate.broken is not None:
        output.say((f"  {report.certificate.broken}", output.BAD))
