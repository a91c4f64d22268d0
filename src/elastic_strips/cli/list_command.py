"""``elastic-strips list``: scenarios, robots and presets."""

from __future__ import annotations

import click

from ..named import PRESETS, SCENARIOS
from ..robot import robot_names, robot_summary


@click.command(name="list")
def list_command() -> None:
    """Show the scenarios, robots and presets that have names."""
    click.echo("Scenarios (elastic-strips run NAME):")
    for name, summary in SCENARIOS.items():
        click.echo(f"  {name:<18} {summary}")
    click.echo("\nRobots (--robot NAME, or the path of a URDF):")
    for name in robot_names():
        click.echo(f"  {name:<18} {robot_summary(name)}")
    click.echo("\nPresets (--preset NAME):")
    for name, summary in PRESETS.items():
        click.echo(f"  {name:<18} {summary}")
