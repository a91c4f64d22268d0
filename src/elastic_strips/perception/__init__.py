"""Perception: range readings become tracks, a map and a scene to plan with."""

from __future__ import annotations

from .body_mask import BodyMask
from .estimator import SceneEstimator, scan_scene
from .params import SceneEstimatorParams
from .readings import NO_ANSWER, NOTHING, DepthImage, LaserScan, RangeImage, RangeRing, Reading
from .tracking import TrackedObstacle
from .volume_map import VolumeMap, VolumeMapParams

__all__ = [
    "BodyMask",
    "DepthImage",
    "LaserScan",
    "NOTHING",
    "NO_ANSWER",
    "RangeImage",
    "RangeRing",
    "Reading",
    "SceneEstimator",
    "SceneEstimatorParams",
    "TrackedObstacle",
    "VolumeMap",
    "VolumeMapParams",
    "scan_scene",
]
