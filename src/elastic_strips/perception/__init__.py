"""Perception: range readings become tracks, a map and a scene to plan with."""

from __future__ import annotations

from .estimator import SceneEstimator, scan_scene
from .params import SceneEstimatorParams
from .readings import NO_ANSWER, NOTHING, LaserScan, RangeRing, Reading
from .tracking import TrackedObstacle

__all__ = [
    "LaserScan",
    "NOTHING",
    "NO_ANSWER",
    "RangeRing",
    "Reading",
    "SceneEstimator",
    "SceneEstimatorParams",
    "TrackedObstacle",
    "scan_scene",
]
