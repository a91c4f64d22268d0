"""Sensing room: range sensors of a robot, simulated or real, and what they say about obstacles."""

from __future__ import annotations

from .mounting import sensor_frames
from .params import InfraredParams, LaserParams, RangeParams, RingParams, SensorConfig, SonarParams
from .readings import NO_ANSWER, NOTHING, LaserScan, RangeRing, Reading
from .suite import SensorSuite
from .triangles import NoRayTracer

__all__ = [
    "LaserScan",
    "RangeRing",
    "Reading",
    "NOTHING",
    "NO_ANSWER",
    "SensorSuite",
    "SensorConfig",
    "RangeParams",
    "LaserParams",
    "RingParams",
    "SonarParams",
    "InfraredParams",
    "sensor_frames",
    "NoRayTracer",
]
