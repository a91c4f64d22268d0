"""Proximity: how near the robot's bodies are to obstacles and to each other, along a whole strip."""

from .bounds import BodySet, MotionBounds
from .candidates import Forecast, NodePrediction
from .narrowphase import GJK_EXCESS, Contacts
from .obstacles import ObstacleProximity
from .self_distance import SelfContacts, SelfProximity

__all__ = [
    "NodePrediction",
    "BodySet",
    "Contacts",
    "Forecast",
    "GJK_EXCESS",
    "MotionBounds",
    "ObstacleProximity",
    "SelfContacts",
    "SelfProximity",
]
