"""Trajectory: limits of motors, paths in drive coordinates, and their timing, braking and certificate."""

from __future__ import annotations

from .limits import MotionLimits
from .path import DrivePath, RetimingError
from .retiming import Retimer, brake, retime
from .trajectory import ReferenceState, Trajectory, TrajectoryCertifier, stationary

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
    "stationary",
]
