"""Simulation: what stands for the world: machines, sensors, movers, faults, the loop around a controller, scenarios,
the evaluation of a run. Nothing here runs on a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from .baselines import base_simulation
    from .closed_loop import Simulation, simulation
    from .evaluation import Contact, Evaluation, evaluate, protective_separation
    from .faults import FAULTS, Fault
    from .perception import NoisyGroundTruth, Perception, PerceptionError, PerceptionParams
    from .plant import KinematicPlant, OdometryParams, Plant, PlantParams
    from .sensed_perception import SensorPerception
    from .task import TaskResult, TaskSimulation

__all__ = [
    "Contact",
    "FAULTS",
    "Fault",
    "KinematicPlant",
    "NoisyGroundTruth",
    "Perception",
    "PerceptionError",
    "PerceptionParams",
    "Plant",
    "PlantParams",
    "OdometryParams",
    "SensorPerception",
    "Simulation",
    "TaskResult",
    "TaskSimulation",
    "Evaluation",
    "base_simulation",
    "evaluate",
    "protective_separation",
    "simulation",
]

__getattr__ = late_names(  # a scenario needs nothing of what driving it needs
    __name__,
    {
        "baselines": ("base_simulation",),
        "evaluation": ("Contact", "Evaluation", "evaluate", "protective_separation"),
        "faults": ("FAULTS", "Fault"),
        "closed_loop": ("Simulation", "simulation"),
        "perception": ("NoisyGroundTruth", "Perception", "PerceptionError", "PerceptionParams"),
        "plant": ("KinematicPlant", "Plant", "PlantParams", "OdometryParams"),
        "sensed_perception": ("SensorPerception",),
        "task": ("TaskResult", "TaskSimulation"),
        "tracking_bound": (),
        "bench": (),
        "datasets": (),
        "mujoco": (),
        "scenarios": (),
        "sensors": (),
    },
)
