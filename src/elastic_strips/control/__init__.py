"""Control: what runs on a robot: strips become motions in time, certified, supervised, tracked and recorded."""

from __future__ import annotations

from .controller import Controller, Tick
from .estimation import Estimator, EstimatorParams
from .measurement import Measurement
from .onward import Proposal
from .params import DRIVE_STRIP, DriveParams, EvasionParams, ObstacleAssumptions, Tolerance
from .pilot import Pilot
from .prediction import predict
from .record import DriveResult, Event, Record, Recorder, RecordError, RunState, TickStatistics
from .supervisor import Supervisor
from .tracking import Command, TrackingController, TrackingGains

__all__ = [
    "Command",
    "Controller",
    "DRIVE_STRIP",
    "DriveParams",
    "DriveResult",
    "Estimator",
    "EstimatorParams",
    "EvasionParams",
    "Event",
    "Measurement",
    "ObstacleAssumptions",
    "Pilot",
    "Proposal",
    "Record",
    "RecordError",
    "Recorder",
    "RunState",
    "Supervisor",
    "Tick",
    "TickStatistics",
    "Tolerance",
    "TrackingController",
    "TrackingGains",
    "predict",
]
