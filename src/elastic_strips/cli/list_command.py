"""``elastic-strips list``: scenarios, robots and presets."""

from __future__ import annotations

import click

from ..deform import PRESETS
from ..robot import robot_names, robot_summary
from ..scenarios import get_scenario, scenario_names

_PRESET_TEXT = {
    "default": "forces at witness points, implicit update, exact rolling constraint",
    "paper": "Eqs. 2-9 of the paper at its control points; the base moves as if omnidirectional",
}


@click.command(name="list", help="Show the scenarios, robots and presets that have names.")
def list_command() -> None:
    click.echo("Scenarios (elastic-strips run NAME):")
    for name in scenario_names():
        click.echo(f"  {name:<18} {get_scenario(name).summary}")
    click.echo("\nRobots (--robot NAME, or the path of a URDF):")
    for name in robot_names():
        click.echo(f"  {name:<18} {robot_summary(name)}")
    click.echo("\nPresets (--preset NAME):")
    for name in PRESETS:
        click.echo(f"  {name:<18} {_PRESET_TEXT[name]}")
