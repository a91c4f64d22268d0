"""Tunnel: protective hulls, their connectivity, and the motion-bound certificate of every segment."""

from .certificate import BrokenSegment, Certificate, SegmentState
from .motion_certificate import MotionCertifier
from .strip_certificate import Certifier, ProtectiveHulls, protective_hulls, strip_clearance

__all__ = [
    "BrokenSegment",
    "Certificate",
    "Certifier",
    "MotionCertifier",
    "ProtectiveHulls",
    "SegmentState",
    "protective_hulls",
    "strip_clearance",
]
