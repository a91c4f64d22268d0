"""Control: the paper's hybrid control in three layers."""

from __future__ import annotations

from .hybrid import Director, HybridControl, deliberate
from .sequencing import Facts, Order, SequencingLayer
from .task_watch import TaskEvent, TaskState, TaskWatch
from .tasks import Deliberation, DeliberativeLayer, DriveAndReach, DriveTo, Part, Reach, Reached, ReachHand, Step, Task

__all__ = [
    "Deliberation",
    "DeliberativeLayer",
    "Director",
    "DriveAndReach",
    "DriveTo",
    "Facts",
    "HybridControl",
    "Order",
    "Part",
    "Reach",
    "ReachHand",
    "Reached",
    "SequencingLayer",
    "Step",
    "Task",
    "TaskEvent",
    "TaskState",
    "TaskWatch",
    "deliberate",
]
