"""Sensors room, sensor file: the range sensors of a robot from a YAML file; docs/sensors.md is its reference."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from elastic_strips.errors import ParameterError, nearest_name
from elastic_strips.io.nodes import Node, load_yaml
from elastic_strips.sim.sensors import params as sensing
from elastic_strips.sim.sensors.params import InfraredParams, LaserParams, SensorConfig, SensorParams, SonarParams

_KINDS: dict[str, type[LaserParams | SonarParams | InfraredParams]] = {
    "laser": LaserParams,
    "sonar": SonarParams,
    "infrared": InfraredParams,
}


def silvermate_sensors() -> Path:
    """The file of the Silvermate's range sensors, which comes with the library: one to copy and to change."""
    return Path(sensing.__file__).with_name("silvermate_sensors.yaml")


def read_sensors(path: str | os.PathLike[str] | None = None) -> SensorConfig:
    """The range sensors that a YAML file describes.

    Args:
        path: of the file; None for the Silvermate's.

    Returns:
        The sensors in the order of the file; what it leaves out is as `LaserParams`, `SonarParams` and
        `InfraredParams` have it.

    Raises:
        ParameterError: the file cannot be read, a key is unknown, a value is of another kind or out of bounds; the
            message names file, line, key, value and bound.
    """
    root = load_yaml(silvermate_sensors() if path is None else path, error=ParameterError)
    entries = root.mapping(("sensors", "self_padding"), needed=("sensors",), what="a sensor file")
    named = entries["sensors"].mapping(what="names to sensors")
    values: dict[str, Any] = {"sensors": tuple(_sensor(name, node) for name, node in named.items())}
    if "self_padding" in entries:
        values["self_padding"] = entries["self_padding"].number()
    return root.checked(SensorConfig, **values)


def _sensor(name: str, node: Node) -> SensorParams:
    kind = node.mapping().get("kind")
    if kind is None:
        node.fail(f"the key 'kind' is missing{nearest_name('kind', _KINDS)}")
    make = _KINDS[kind.text(valid=_KINDS)]
    known = {f.name: f.type for f in fields(make) if f.name != "name"}
    entries = node.mapping(("kind", *known), what=f"a {kind.value}")
    values: dict[str, Any] = {"name": name}
    for key, entry in entries.items():
        if key != "kind":
            values[key] = _value(str(known[key]), entry)
    return node.checked(make, **values)


def _value(kind: str, node: Node) -> Any:
    """What a node holds, as the field of that type needs it."""
    if kind == "str":
        return node.text()
    if kind == "bool":
        return node.boolean()
    if kind == "int":
        return node.integer(low=0, high=1_000_000)
    if kind.startswith("tuple"):
        return tuple(entry.text() for entry in node)
    return node.number(unit="")
