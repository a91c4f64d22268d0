"""Sensors: simulated range sensors of a robot in a world, and what a laser can see of it."""

from __future__ import annotations

from .mounting import sensor_frames
from .params import InfraredParams, LaserParams, RangeParams, RingParams, SensorConfig, SonarParams
from .sensor_file import read_sensors, silvermate_sensors
from .suite import SensorSuite
from .visibility import Visibility, seen_obstacles, visible_to

__all__ = [
    "InfraredParams",
    "LaserParams",
    "RangeParams",
    "RingParams",
    "SensorConfig",
    "SensorSuite",
    "SonarParams",
    "Visibility",
    "read_sensors",
    "seen_obstacles",
    "sensor_frames",
    "silvermate_sensors",
    "visible_to",
]
