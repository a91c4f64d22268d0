"""Simulation: what stands for the world: machines, sensors, movers, faults, the loop around a controller, the judge."""

from __future__ import annotations

from .base import RawReadings, base_simulation
from .faults import FAULTS, Fault
from .judge import Contact, Verdict, judge
from .odometry import SensorParams
from .perception import NoisyGroundTruth, Perception, PerceptionError, PerceptionParams
from .plant import KinematicPlant, Plant, PlantParams
from .sensed_perception import LASER_ASSUMPTIONS, LASER_EASE, Bumper, SensorPerception
from .separation import protective_separation
from .simulation import MACHINE, Simulation, simulation
from .task import TaskResult, TaskSimulation
from .tracking_bound import DEFAULT_TRACKING_ERROR, Displacement, TrackingErrors, measure_tracking

__all__ = [
    "Bumper",
    "Contact",
    "DEFAULT_TRACKING_ERROR",
    "Displacement",
    "FAULTS",
    "Fault",
    "KinematicPlant",
    "LASER_ASSUMPTIONS",
    "LASER_EASE",
    "MACHINE",
    "NoisyGroundTruth",
    "Perception",
    "PerceptionError",
    "PerceptionParams",
    "Plant",
    "PlantParams",
    "RawReadings",
    "SensorPerception",
    "SensorParams",
    "Simulation",
    "TaskResult",
    "TaskSimulation",
    "TrackingErrors",
    "Verdict",
    "base_simulation",
    "judge",
    "measure_tracking",
    "protective_separation",
    "simulation",
]
