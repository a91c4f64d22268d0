"""``elastic-strips list``: scenarios, robots and presets."""

from __future__ import annotations

import click

from ..catalogue import PRESETS, SCENARIOS, own_robots, robot_names, robot_summary


@click.command(name="list", help="Show the scenarios, robots and presets that have names.")
@click.option("--robots", is_flag=True, help="Only the robots, and all of them: those of example-robot-data too.")
def list_command(robots: bool) -> None:
    if robots:
        for name in robot_names():
            click.echo(f"{name:<28} {robot_summary(name)}")
        return
    click.echo("Scenarios (elastic-strips run NAME):")
    for name, summary in SCENARIOS.items():
        click.echo(f"  {name:<18} {summary}")
    click.echo("\nRobots (--robot NAME, or the path of a URDF):")
    for name in own_robots():
        click.echo(f"  {name:<18} {robot_summary(name)}")
    click.echo(f"  and {len(robot_names()) - len(own_robots())} more: elastic-strips list --robots")
    click.echo("\nPresets (--preset NAME):")
    for name, summary in PRESETS.items():
        click.echo(f"  {name:<18} {summary}")
