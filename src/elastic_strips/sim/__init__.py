"""Simulation: what stands for the world: machines, sensors, movers, faults, the loop around a controller, scenarios,
the evaluation of a run. Nothing here runs on a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from .baselines import RawReadings, base_simulation
    from .closed_loop import MACHINE, Simulation, simulation
    from .evaluation import Contact, Evaluation, evaluate, protective_separation
    from .faults import FAULTS, Fault
    from .perception import Perceiver, Perception, PerceptionError, PerceptionParams
    from .plant import KinematicPlant, OdometryParams, Plant, PlantParams
    from .sensed_perception import LASER_ASSUMPTIONS, LASER_EASE, ContactSensor, SensedPerception
    from .task import TaskResult, TaskSimulation
    from .tracking_bound import DEFAULT_TRACKING_ERROR, Displacement, TrackingErrors, measure_tracking

__all__ = [
    "ContactSensor",
    "Contact",
    "DEFAULT_TRACKING_ERROR",
    "Displacement",
    "FAULTS",
    "Fault",
    "KinematicPlant",
    "LASER_ASSUMPTIONS",
    "LASER_EASE",
    "MACHINE",
    "Perceiver",
    "Perception",
    "PerceptionError",
    "PerceptionParams",
    "Plant",
    "PlantParams",
    "RawReadings",
    "SensedPerception",
    "OdometryParams",
    "Simulation",
    "TaskResult",
    "TaskSimulation",
    "TrackingErrors",
    "Evaluation",
    "base_simulation",
    "evaluate",
    "measure_tracking",
    "protective_separation",
    "simulation",
]

__getattr__ = late_names(  # a scenario needs nothing of what driving it needs
    __name__,
    {
        "baselines": ("RawReadings", "base_simulation"),
        "evaluation": ("Contact", "Evaluation", "evaluate", "protective_separation"),
        "faults": ("FAULTS", "Fault"),
        "closed_loop": ("MACHINE", "Simulation", "simulation"),
        "perception": ("Perceiver", "Perception", "PerceptionError", "PerceptionParams"),
        "plant": ("KinematicPlant", "Plant", "PlantParams", "OdometryParams"),
        "sensed_perception": ("LASER_ASSUMPTIONS", "LASER_EASE", "ContactSensor", "SensedPerception"),
        "task": ("TaskResult", "TaskSimulation"),
        "tracking_bound": ("DEFAULT_TRACKING_ERROR", "Displacement", "TrackingErrors", "measure_tracking"),
        "bench": (),
        "datasets": (),
        "mujoco": (),
        "scenarios": (),
        "sensors": (),
    },
)
