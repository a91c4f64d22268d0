"""Collision room: distances kept from tick to tick, bounds of motions, where moving obstacles can be, and the
certificate: proof that segments and motions keep their clearance."""

import numpy  # noqa: F401  Coal loads it, too, and crashes where Ctrl-C comes meanwhile

from .bounds import BodySet, MotionBounds
from .candidates import Forecast
from .certificate import BrokenSegment, Certificate, SegmentState
from .motion_certificate import MotionCertifier
from .obstacles import ObstacleProximity
from .path_certificate import PathCertificate, Verdict, certify
from .proof import PathProof, prove
from .self_distance import SelfProximity
from .strip_certificate import ProtectiveHulls

__all__ = [
    "BodySet",
    "BrokenSegment",
    "Certificate",
    "Forecast",
    "MotionBounds",
    "MotionCertifier",
    "ObstacleProximity",
    "PathCertificate",
    "PathProof",
    "ProtectiveHulls",
    "SegmentState",
    "SelfProximity",
    "Verdict",
    "certify",
    "prove",
]
