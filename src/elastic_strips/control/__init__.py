"""Control room: the paper's hybrid control: deliberative, sequencing and reactive layer."""

from __future__ import annotations

from .base_controller import BaseController, RawReadings, base_simulation
from .bumper import Bumper
from .deliberative import Deliberation, DeliberativeLayer, Part, Step
from .director import Director
from .hybrid import HybridControl, HybridResult
from .reach import Reach, Reached
from .sensed_perception import LASER_ASSUMPTIONS, LASER_EASE, SensedPerception
from .sequencing import Facts, Order, SequencingLayer
from .task_watch import TaskEvent, TaskState, TaskWatch
from .tasks import DriveAndReach, DriveTo, ReachHand, Task

__all__ = [
    "DriveTo",
    "ReachHand",
    "DriveAndReach",
    "Task",
    "HybridControl",
    "HybridResult",
    "DeliberativeLayer",
    "Deliberation",
    "Part",
    "Step",
    "Reach",
    "Reached",
    "SequencingLayer",
    "Facts",
    "Order",
    "Director",
    "SensedPerception",
    "LASER_ASSUMPTIONS",
    "LASER_EASE",
    "BaseController",
    "RawReadings",
    "base_simulation",
    "Bumper",
    "TaskWatch",
    "TaskState",
    "TaskEvent",
]
