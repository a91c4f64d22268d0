"""Tunnel: protective hulls, their connectivity, and the motion-bound certificate of every segment."""

from .certificate import BrokenSegment, Certificate, Certifier, SegmentState
from .clearance import chart_clearance
from .hulls import Tunnel, protective_hulls
from .motion_certificate import MotionCertifier

__all__ = [
    "BrokenSegment",
    "Certificate",
    "Certifier",
    "MotionCertifier",
    "SegmentState",
    "Tunnel",
    "chart_clearance",
    "protective_hulls",
]
