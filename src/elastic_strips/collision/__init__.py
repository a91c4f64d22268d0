"""Collision room: distances kept from tick to tick, bounds of motions, where moving obstacles can be, and the
certificate: proof that segments and motions keep their clearance."""

from .bounds import BodySet, MotionBounds
from .candidates import Forecast, NodePrediction
from .certificate import BrokenSegment, Certificate, SegmentState
from .motion_certificate import MotionCertifier
from .narrowphase import GJK_EXCESS, Contacts
from .obstacles import ObstacleProximity
from .self_distance import SelfContacts, SelfProximity
from .strip_certificate import Certifier, ProtectiveHulls, chart_clearance, protective_hulls

__all__ = [
    "BodySet",
    "BrokenSegment",
    "Certificate",
    "Certifier",
    "Contacts",
    "Forecast",
    "GJK_EXCESS",
    "MotionBounds",
    "MotionCertifier",
    "NodePrediction",
    "ObstacleProximity",
    "ProtectiveHulls",
    "SegmentState",
    "SelfContacts",
    "SelfProximity",
    "chart_clearance",
    "protective_hulls",
]
