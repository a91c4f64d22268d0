"""Sensors: simulated range sensors of a robot in a world."""

from __future__ import annotations

from elastic_strips.perception.own_body import sensor_frames

from .devices import SensorSuite
from .params import (
    DepthParams,
    InfraredParams,
    LaserParams,
    LidarParams,
    SensorConfig,
    SonarParams,
    named_sensors,
    read_sensors,
    sensor_file,
)

__all__ = [
    "DepthParams",
    "InfraredParams",
    "LaserParams",
    "LidarParams",
    "SensorConfig",
    "SensorSuite",
    "SonarParams",
    "named_sensors",
    "read_sensors",
    "sensor_frames",
    "sensor_file",
]
