"""``python -m workshop base``: one drive by a method for a base alone, which the paper names."""

from __future__ import annotations

from functools import partial

import click

from elastic_strips.cli import options
from elastic_strips.cli.drive_command import Outputs, drive_and_report

from .bench_options import BASE_METHOD


@click.command(short_help="One drive by a method for a base alone.")
@click.argument("scenario", metavar="NAME|FILE.yaml", type=options.SCENARIO)
@click.option("--method", type=BASE_METHOD, default="vfh", show_default=True, help="What steers.")
@options.robot_option(help="A robot other than the scenario's.")
@click.option("--seed", type=options.SEED, help="Seed of plant, noise and generated scenes.")
@click.option("--plant", type=options.PLANT, default="kinematic", show_default=True, help="The machine.")
@options.sensors_option
@click.option("--time-limit", type=options.Finite(0.1, 36000), help="Longest run [s of simulated time].")
@options.json_option("Write the result.")
@click.option("--record", "record_file", metavar="FILE.npz|FILE.csv", type=click.Path(), help="Write what happened.")
@options.html_option("Write a standalone 3D page of the drive.")
@click.option("--view", is_flag=True, help="Show it while it drives, in the browser on this machine only.")
@options.browser_option
def base(
    scenario: str,
    method: str,
    robot: str | None,
    seed: int | None,
    plant: str,
    sensors: str | None,
    time_limit: float | None,
    json_file: str | None,
    record_file: str | None,
    html_file: str | None,
    view: bool,
    no_browser: bool,
) -> int:
    """Artificial potential field, virtual force field, vector field histogram or elastic band: the method sees what its
    sensors see, promises nothing, and stops at a contact. The arm does not move.

    Exit codes are those of ``elastic-strips drive``.
    """
    from elastic_strips.io.record_file import check_record_file
    from elastic_strips.robot import load_robot
    from elastic_strips.sim.scenarios import get_scenario
    from elastic_strips.sim.scenarios.drive import DriveSetup
    from workshop.baselines import make_base_simulation

    options.check_outputs(scenario, json_file, record_file, html_file)
    if record_file is not None:
        check_record_file(record_file)
    problem = get_scenario(scenario, seed=seed or 0)
    model = problem.load_robot(preset="default") if robot is None else load_robot(robot)
    number = problem.seed if seed is None else seed
    setup = DriveSetup(robot=model, seed=number, plant=plant, sensors=options.sensors_of(sensors, model.name))
    return drive_and_report(
        problem,
        partial(make_base_simulation, problem, method, setup, realtime=view),
        Outputs(json_file, record_file, html_file),
        time_limit=time_limit,
        view=view,
        no_browser=no_browser,
    )
