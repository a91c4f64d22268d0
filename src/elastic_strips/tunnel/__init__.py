"""Certificates: proof that segments and motions keep their clearance, the clearance itself, and protective hulls."""

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
