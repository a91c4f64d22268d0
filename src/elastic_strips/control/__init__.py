"""Control: what runs on a robot: strips become motions in time, certified, supervised, tracked and recorded."""

from __future__ import annotations

from .calibration import Calibration, calibrate
from .controller import Controller
from .driver import Driver
from .estimation import EstimatorParams, StateEstimator
from .guard import Desired, Guard, GuardedCommand, GuardOutcome, GuardParams
from .interfaces import Command, Event, Measurement, RunState
from .local_planner import LocalPlanner
from .params import DriveParams, EvasionParams, MonitorParams, ObstacleAssumptions, Tolerance
from .record import DriveResult, Record, Recorder, RecordError
from .supervisor import Supervisor
from .tracking import TrackingController, TrackingGains

__all__ = [
    "Calibration",
    "Command",
    "Controller",
    "Driver",
    "Desired",
    "DriveParams",
    "DriveResult",
    "EstimatorParams",
    "EvasionParams",
    "Event",
    "Guard",
    "GuardOutcome",
    "GuardParams",
    "GuardedCommand",
    "LocalPlanner",
    "Measurement",
    "MonitorParams",
    "ObstacleAssumptions",
    "Record",
    "RecordError",
    "Recorder",
    "RunState",
    "StateEstimator",
    "Supervisor",
    "Tolerance",
    "TrackingController",
    "TrackingGains",
    "calibrate",
]
