"""Trajectory: limits of motors, paths in drive coordinates, and their timing, braking and certificate."""

from __future__ import annotations

from .braking import brake
from .limits import MotionLimits
from .path import DrivePath, RetimingError
from .retiming import Retimer, retime
from .timed_certificate import TrajectoryCertifier
from .trajectory import ReferenceState, Trajectory

__all__ = [
    "DrivePath",
    "MotionLimits",
    "ReferenceState",
    "Retimer",
    "RetimingError",
    "Trajectory",
    "TrajectoryCertifier",
    "brake",
    "retime",
]
