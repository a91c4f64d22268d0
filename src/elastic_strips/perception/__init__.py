"""Perception: what a robot makes of its range readings: tracks, a map, a scene to plan with."""

from __future__ import annotations

from .estimator import EstimatorReport, SceneEstimator, scan_scene
from .occupancy_grid import OccupancyGrid
from .params import SceneEstimatorParams
from .readings import NO_ANSWER, NOTHING, LaserScan, RangeRing, Reading, ScanRays, rays_of
from .tracking import TrackedObstacle, Tracker

__all__ = [
    "EstimatorReport",
    "LaserScan",
    "NOTHING",
    "NO_ANSWER",
    "OccupancyGrid",
    "RangeRing",
    "Reading",
    "ScanRays",
    "SceneEstimator",
    "SceneEstimatorParams",
    "TrackedObstacle",
    "Tracker",
    "rays_of",
    "scan_scene",
]
