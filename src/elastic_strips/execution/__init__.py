"""Execution: strips become motions in time; motions are certified, tracked, supervised, recorded and judged."""

from .braking import brake
from .controller import Controller, Tick
from .estimation import Estimator, EstimatorParams
from .faults import FAULTS, Fault
from .judge import judge
from .limits import MotionLimits
from .params import DRIVE_STRIP, DriveParams, EvasionParams, ObstacleAssumptions, Tolerance
from .path import DrivePath, RetimingError
from .perception import Perceiver, Perception, PerceptionError, PerceptionParams
from .pilot import Pilot
from .plant import KinematicPlant, Plant, PlantParams
from .prediction import predict
from .proposal import Proposal
from .record import Event, Record, RecordError, RunState
from .recorder import Recorder
from .result import DriveResult, TickStatistics
from .retiming import Retimer, retime
from .sensing import Measurement, SensorParams
from .separation import protective_separation
from .simulation import MACHINE, Simulation, simulation
from .supervisor import Supervisor
from .timed_certificate import TrajectoryCertifier
from .tracking import Command, TrackingController, TrackingGains
from .tracking_bound import DEFAULT_TRACKING_ERROR, Displacement, TrackingErrors, measure_tracking
from .trajectory import ReferenceState, Trajectory
from .verdict import Contact, Verdict

__all__ = [
    "FAULTS",
    "MACHINE",
    "Command",
    "DEFAULT_TRACKING_ERROR",
    "Contact",
    "Controller",
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
    "Perceiver",
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
    "SensorParams",
    "Simulation",
    "Supervisor",
    "Tick",
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
    "simulation",
]
