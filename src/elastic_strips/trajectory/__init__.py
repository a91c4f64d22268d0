"""Trajectory: limits of motors, paths in drive coordinates, and their timing, braking and certificate."""

from .limits import MotionLimits
from .path import RetimingError
from .retiming import Retimer, retime
from .trajectory import ReferenceState, Trajectory, TrajectoryCertifier

__all__ = [
    "MotionLimits",
    "ReferenceState",
    "Retimer",
    "RetimingError",
    "Trajectory",
    "TrajectoryCertifier",
    "retime",
]
