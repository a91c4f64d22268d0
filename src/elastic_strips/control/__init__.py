"""Control: what runs on a robot: strips become motions in time, certified, supervised, tracked and recorded."""

from __future__ import annotations

from .controller import Controller
from .estimation import StateEstimator
from .interfaces import Command, Event, Measurement, RunState
from .local_planner import LocalPlanner
from .params import DriveParams, EvasionParams, ObstacleAssumptions, Tolerance
from .record import DriveResult, Record, Recorder, RecordError
from .supervisor import Supervisor
from .tracking import TrackingController

__all__ = [
    "Command",
    "Controller",
    "DriveParams",
    "DriveResult",
    "EvasionParams",
    "Event",
    "LocalPlanner",
    "Measurement",
    "ObstacleAssumptions",
    "Record",
    "RecordError",
    "Recorder",
    "RunState",
    "StateEstimator",
    "Supervisor",
    "Tolerance",
    "TrackingController",
]
