"""Execution: strips become motions in time; motions are certified, tracked, supervised, recorded and judged."""

from .braking import brake
from .estimation import Estimator, EstimatorParams
from .faults import FAULTS, Fault
from .judge import judge
from .limits import MotionLimits
from .params import DRIVE_STRIP, DriveParams, EvasionParams, ObstacleAssumptions
from .path import DrivePath, RetimingError
from .perception import ContactError, Perception, PerceptionError, PerceptionParams
from .pilot import Pilot
from .plant import KinematicPlant, Plant, PlantParams
from .prediction import predict
from .proposal import Proposal
from .record import Event, Record, RecordError, RunState
from .recorder import Recorder
from .result import DriveResult, TickStatistics
from .retiming import Retimer, retime
from .runner import MACHINE, Runner
from .sensing import Measurement, SensorParams
from .separation import protective_separation
from .supervisor import Supervisor
from .timed_certificate import TrajectoryCertifier
from .tracking import Command, TrackingController, TrackingGains
from .tracking_bound import DEFAULT_TRACKING_ERROR, Displacement, TrackingErrors, measure_tracking
from .trajectory import ReferenceState, Trajectory
from .verdict import Contact, Tolerance, Verdict

__all__ = [
    "FAULTS",
    "MACHINE",
    "Command",
    "DEFAULT_TRACKING_ERROR",
    "Contact",
    "ContactError",
    "Displacement",
    "TrackingErrors",
    "measure_tracking",
    "DrivePath",
    "DRIVE_STRIP",
    "DriveParams",
    "DriveResult",
    "Estimator",
    "EvasionParams",
    "EstimatorParams",
    "Event",
    "Fault",
    "KinematicPlant",
    "Measurement",
    "MotionLimits",
    "ObstacleAssumptions",
    "Perception",
    "PerceptionError",
    "PerceptionParams",
    "Pilot",
    "Plant",
    "PlantParams",
    "Proposal",
    "Record",
    "RecordError",
    "Recorder",
    "ReferenceState",
    "Retimer",
    "RetimingError",
    "RunState",
    "Runner",
    "SensorParams",
    "Supervisor",
    "TickStatistics",
    "Tolerance",
    "TrackingController",
    "TrackingGains",
    "Trajectory",
    "TrajectoryCertifier",
    "Verdict",
    "brake",
    "judge",
    "predict",
    "protective_separation",
    "retime",
]
