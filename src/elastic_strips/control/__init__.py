"""Control: what runs on a robot: strips become motions in time, certified, supervised, tracked and recorded."""

from __future__ import annotations

from .controller import Controller, Tick
from .estimation import EstimatorParams, StateEstimator
from .interfaces import Command, Event, Measurement, RunState
from .local_planner import LocalPlanner
from .params import DRIVE_STRIP, DriveParams, EvasionParams, ObstacleAssumptions, Tolerance
from .prediction import predict
from .record import DriveResult, Record, Recorder, RecordError, TickStatistics
from .strip_timer import PlanOutcome, PlanResult
from .supervisor import Supervisor
from .tracking import TrackingController, TrackingGains

__all__ = [
    "Command",
    "Controller",
    "DRIVE_STRIP",
    "DriveParams",
    "DriveResult",
    "EstimatorParams",
    "EvasionParams",
    "Event",
    "LocalPlanner",
    "Measurement",
    "ObstacleAssumptions",
    "PlanOutcome",
    "PlanResult",
    "Record",
    "RecordError",
    "Recorder",
    "RunState",
    "StateEstimator",
    "Supervisor",
    "Tick",
    "TickStatistics",
    "Tolerance",
    "TrackingController",
    "TrackingGains",
    "predict",
]
