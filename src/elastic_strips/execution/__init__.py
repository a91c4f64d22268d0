"""Execution: what runs on a robot: strips become motions in time, certified, supervised, tracked and recorded."""

from __future__ import annotations

from .braking import brake
from .controller import Controller, Tick
from .estimation import Estimator, EstimatorParams
from .limits import MotionLimits
from .measurement import Measurement
from .onward import Proposal
from .params import DRIVE_STRIP, DriveParams, EvasionParams, ObstacleAssumptions, Tolerance
from .path import DrivePath, RetimingError
from .pilot import Pilot
from .prediction import predict
from .record import DriveResult, Event, Record, Recorder, RecordError, RunState, TickStatistics
from .retiming import Retimer, retime
from .supervisor import Supervisor
from .timed_certificate import TrajectoryCertifier
from .tracking import Command, TrackingController, TrackingGains
from .trajectory import ReferenceState, Trajectory

__all__ = [
    "Command",
    "Controller",
    "DRIVE_STRIP",
    "DriveParams",
    "DrivePath",
    "DriveResult",
    "Estimator",
    "EstimatorParams",
    "EvasionParams",
    "Event",
    "Measurement",
    "MotionLimits",
    "ObstacleAssumptions",
    "Pilot",
    "Proposal",
    "Record",
    "RecordError",
    "Recorder",
    "ReferenceState",
    "Retimer",
    "RetimingError",
    "RunState",
    "Supervisor",
    "Tick",
    "TickStatistics",
    "Tolerance",
    "TrackingController",
    "TrackingGains",
    "Trajectory",
    "TrajectoryCertifier",
    "brake",
    "predict",
    "retime",
]
