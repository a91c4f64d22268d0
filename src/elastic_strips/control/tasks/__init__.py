"""Tasks: the paper's hybrid control in three layers: deliberative, sequencing and reactive."""

from __future__ import annotations

from .hybrid import HybridControl, PathService, deliberate
from .sequencing import Blackboard, Order, SequencingLayer
from .tasks import (
    DeliberativeLayer,
    DriveAndReach,
    DriveTo,
    ReachHand,
    StepKind,
    Task,
    TaskPlan,
    TaskStep,
)

__all__ = [
    "TaskPlan",
    "DeliberativeLayer",
    "PathService",
    "DriveAndReach",
    "DriveTo",
    "Blackboard",
    "HybridControl",
    "Order",
    "StepKind",
    "ReachHand",
    "SequencingLayer",
    "TaskStep",
    "Task",
    "deliberate",
]
