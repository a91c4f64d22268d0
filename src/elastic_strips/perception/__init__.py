"""Perception: what a robot makes of its range readings: tracks, a map, a scene to plan with."""

from __future__ import annotations

from .clusters import Cluster, Footprint, cluster_obstacles, clusters_of, fit_circle, footprint
from .estimator import EstimatorReport, SceneEstimator, scan_scene
from .params import SceneEstimatorParams
from .readings import NO_ANSWER, NOTHING, LaserScan, RangeRing, Reading, ScanRays, rays_of
from .tracking import Sighting, TrackedObstacle, Tracker, TrackState
from .voxel_map import VoxelMap

__all__ = [
    "Cluster",
    "EstimatorReport",
    "Footprint",
    "LaserScan",
    "NOTHING",
    "NO_ANSWER",
    "RangeRing",
    "Reading",
    "ScanRays",
    "SceneEstimator",
    "SceneEstimatorParams",
    "Sighting",
    "TrackState",
    "TrackedObstacle",
    "Tracker",
    "VoxelMap",
    "cluster_obstacles",
    "clusters_of",
    "fit_circle",
    "footprint",
    "rays_of",
    "scan_scene",
]
