"""Sensing room: range sensors of a robot, simulated or real, and what they say about obstacles."""

from __future__ import annotations

from .cluster_shapes import Footprint, cluster_obstacles, fit_circle, footprint
from .clusters import Cluster, clusters_of
from .estimator import EstimatorReport, SceneEstimator, scan_scene
from .estimator_params import SceneEstimatorParams
from .mounting import sensor_frames
from .params import InfraredParams, LaserParams, RangeParams, RingParams, SensorConfig, SonarParams
from .readings import NO_ANSWER, NOTHING, LaserScan, RangeRing, Reading
from .scan_rays import ScanRays, rays_of
from .suite import SensorSuite
from .tracker import Sighting, Tracker
from .tracks import TrackedObstacle, TrackState
from .visibility import Visibility, seen_obstacles, visible_to
from .voxel_map import VoxelMap

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
    "SceneEstimator",
    "SceneEstimatorParams",
    "EstimatorReport",
    "scan_scene",
    "TrackedObstacle",
    "TrackState",
    "Tracker",
    "Sighting",
    "VoxelMap",
    "ScanRays",
    "rays_of",
    "Cluster",
    "clusters_of",
    "Footprint",
    "footprint",
    "fit_circle",
    "cluster_obstacles",
    "Visibility",
    "visible_to",
    "seen_obstacles",
]
