"""``python -m workshop tick | plan | … | study``: the group of commands."""

from __future__ import annotations

import click

from elastic_strips.cli import group

from . import bench_driving as driving
from . import bench_planning as planning
from .base_command import base
from .carve_command import carve
from .ros_robot_command import ros_pilot, ros_robot, ros_trials
from .study_command import study


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option("-v", "--verbose", is_flag=True, help="Log what the library does to standard error.")
@click.pass_context
def workshop(context: click.Context, verbose: bool) -> None:
    """Measure on this machine, and compare. The figures are percentiles; on a shared machine trust the ratios."""
    group.begin(context, verbose)


for _command in (
    planning.plan,
    planning.replan,
    planning.tick,
    planning.settle,
    planning.ik,
    planning.robots,
    planning.mbm,
    planning.looks,
    planning.peers,
    planning.others,
    driving.drive,
    driving.disturb,
    driving.faults,
    driving.goals,
    driving.reaction,
    driving.soak,
    driving.realtime,
    driving.trials,
    driving.guard,
    driving.barn,
    driving.dynabarn,
    driving.bridge,
    driving.house,
    planning.page,
    carve,
    ros_robot,
    ros_pilot,
    ros_trials,
    base,
    study,
):
    workshop.add_command(_command)


def run_cli(arguments: list[str] | None) -> None:
    """Run the command line; ends the process with the exit codes of ``elastic-strips``."""
    group.run_cli(arguments, workshop, "python -m workshop")
