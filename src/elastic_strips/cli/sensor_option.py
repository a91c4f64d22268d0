"""The option ``--sensors`` of commands that drive: what the robot sees the scene by."""

from __future__ import annotations

import click

from ..sim.sensors import SensorConfig, read_sensors

sensors_option = click.option(
    "--sensors", metavar="NAMES|FILE.yaml",
    help="Drive by what the robot's simulated sensors see, not by the scene: all, or some by name (laser,sonar), of "
    "the Silvermate's; or those of a file (docs/sensors.md).",
)  # fmt: skip


def sensors_of(text: str | None) -> SensorConfig | None:
    """What the option's value stands for; None where it was not given.

    Raises:
        ParameterError: no such sensor, or a file that is none of sensors.
    """
    if text is None:
        return None
    if text.endswith((".yaml", ".yml")):
        return read_sensors(text)
    config = SensorConfig()
    return config if text == "all" else config.only(*(name.strip() for name in text.split(",")))
