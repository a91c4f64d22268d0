"""Simulation: plants, sensors, moving obstacles, faults, the closed loop, scenarios and the evaluation of runs.
Nothing here runs on a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from .closed_loop import Simulation, simulation
    from .evaluation import Evaluation, evaluate
    from .faults import FAULTS, Fault
    from .perception import Perception, PerceptionError, PerceptionParams
    from .plan_drive import drive_plan
    from .plant import KinematicPlant, Plant, PlantParams
    from .sensed_perception import SensorPerception
    from .task import TaskResult, TaskSimulation

__all__ = [
    "FAULTS",
    "Fault",
    "KinematicPlant",
    "Perception",
    "PerceptionError",
    "PerceptionParams",
    "Plant",
    "PlantParams",
    "SensorPerception",
    "Simulation",
    "TaskResult",
    "TaskSimulation",
    "Evaluation",
    "drive_plan",
    "evaluate",
    "simulation",
]

__getattr__ = late_names(  # a scenario needs nothing of what driving it needs
    __name__,
    {
        "evaluation": ("Evaluation", "evaluate"),
        "faults": ("FAULTS", "Fault"),
        "closed_loop": ("Simulation", "simulation"),
        "perception": ("Perception", "PerceptionError", "PerceptionParams"),
        "plan_drive": ("drive_plan",),
        "plant": ("KinematicPlant", "Plant", "PlantParams"),
        "sensed_perception": ("SensorPerception",),
        "task": ("TaskResult", "TaskSimulation"),
        "mujoco": (),
        "scenarios": (),
        "sensors": (),
    },
)
