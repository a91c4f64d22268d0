"""Tasks: the paper's hybrid control in three layers: deliberative, sequencing and reactive."""

from __future__ import annotations

from .hybrid import ConstraintEvent, ConstraintMonitor, ConstraintState, HybridControl, PathService, deliberate
from .sequencing import Blackboard, Order, SequencingLayer
from .tasks import (
    DeliberativeLayer,
    DriveAndReach,
    DriveTo,
    InverseKinematics,
    Part,
    ReachHand,
    ReachResult,
    Step,
    Task,
    TaskPlan,
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
    "Part",
    "InverseKinematics",
    "ReachHand",
    "ReachResult",
    "SequencingLayer",
    "Step",
    "Task",
    "ConstraintEvent",
    "ConstraintState",
    "ConstraintMonitor",
    "deliberate",
]
