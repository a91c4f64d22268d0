"""``elastic-strips list``: the scenarios, robots and presets that have names."""

from __future__ import annotations

from collections.abc import Mapping

import click

from elastic_strips.catalogue import PRESETS, SCENARIOS, find_robot, own_robots, robot_names

from . import options, output


@click.command(name="list", help="List the scenarios, robots and presets that have names.")
@click.option(
    "--robots", is_flag=True, help="List only robots, but all of them, including those of example-robot-data."
)
@options.json_option("Write the names, with all robots,")
def list_command(robots: bool, json_file: str | None) -> None:
    everybody = {name: find_robot(name) for name in robot_names()}
    if robots:
        summaries = {name: robot.summary for name, robot in everybody.items()}
        _section("", summaries, "{:<28} {}")
    else:
        own = {name: everybody[name].summary for name in own_robots()}
        _section("Scenarios (elastic-strips run NAME):", SCENARIOS)
        more = f"  and {len(everybody) - len(own)} more: elastic-strips list --robots"
        _section("\nRobots (--robot NAME, or the path of a URDF):", own, after=more)
        _section("\nPresets (--preset NAME):", PRESETS)
    document: dict[str, object] = {"format": "elastic-strips-list", "version": 1}
    if not robots:
        document["scenarios"] = _named(SCENARIOS)
        document["presets"] = _named(PRESETS)
    document["robots"] = [
        {"name": robot.name, "summary": robot.summary, "base": robot.base, "urdf": str(robot.urdf)}
        for robot in everybody.values()
    ]
    output.write_document("names", json_file, document)


def _section(title: str, summaries: Mapping[str, str], line: str = "  {:<18} {}", after: str = "") -> None:
    plain = [*([title] if title else []), *(line.format(*item) for item in summaries.items())]
    output.show(
        lambda: output.table(("", ""), list(summaries.items()), title=title.strip()),
        "\n".join([*plain, *([after] if after else [])]),
        after,
    )


def _named(summaries: Mapping[str, str]) -> list[dict[str, str]]:
    return [{"name": name, "summary": summary} for name, summary in summaries.items()]
