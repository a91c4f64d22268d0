"""Sensors room, sensor file: the range sensors of a robot from a YAML file; docs/sensors.md is its reference."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from elastic_strips.errors import ParameterError, nearest_name
from elastic_strips.io import schema
from elastic_strips.io.yaml_source import Node, load_yaml

from . import params as sensing
from .params import InfraredParams, LaserParams, SensorConfig, SensorParams, SonarParams

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
    entries = schema.mapping(root, ("sensors", "self_padding"), needed=("sensors",), what="a sensor file")
    named = entries["sensors"]
    if not isinstance(named.value, dict):
        named.fail(f"must be a mapping from names to sensors, not {schema.kind(named)}")
    values: dict[str, Any] = {"sensors": tuple(_sensor(name, node) for name, node in named.value.items())}
    if "self_padding" in entries:
        values["self_padding"] = schema.number(entries["self_padding"])
    return schema.checked(root, SensorConfig, **values)


def _sensor(name: str, node: Node) -> SensorParams:
    if not isinstance(node.value, dict):
        node.fail(f"must be a mapping, not {schema.kind(node)}")
    kind = node.value.get("kind")
    if kind is None:
        node.fail(f"the key 'kind' is missing{nearest_name('kind', _KINDS)}")
    make = _KINDS[schema.string(kind, valid=_KINDS)]
    known = {f.name: f.type for f in fields(make) if f.name != "name"}
    entries = schema.mapping(node, ("kind", *known), what=f"a {kind.value}")
    values: dict[str, Any] = {"name": name}
    for key, entry in entries.items():
        if key != "kind":
            values[key] = _value(str(known[key]), entry)
    return schema.checked(node, make, **values)


def _value(kind: str, node: Node) -> Any:
    """What a node holds, as the field of that type needs it."""
    if kind == "str":
        return schema.string(node)
    if kind == "bool":
        return schema.boolean(node)
    if kind == "int":
        return schema.integer(node, low=0, high=1_000_000)
    if kind.startswith("tuple"):
        return tuple(schema.string(entry) for entry in schema.items(node))
    return schema.number(node, unit="")
