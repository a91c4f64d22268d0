"""Sensors: simulated range sensors of a robot in a world, and what a laser can see of it."""

from __future__ import annotations

from .mounting import sensor_frames
from .params import InfraredParams, LaserParams, RangeParams, RingParams, SensorConfig, SonarParams
from .sensor_file import read_sensors, silvermate_sensors
from .suite import SensorSuite

__all__ = [
    "InfraredParams",
    "LaserParams",
    "RangeParams",
    "RingParams",
    "SensorConfig",
    "SensorSuite",
    "SonarParams",
    "read_sensors",
    "sensor_frames",
    "silvermate_sensors",
]
