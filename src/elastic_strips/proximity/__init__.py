"""Proximity: how near the robot's bodies are to obstacles and to each other, along a whole strip."""

from .bounds import BodySet, MotionBounds
from .forecast import Ahead, Forecast, Movers
from .narrowphase import GJK_EXCESS, Contacts, Narrowphase
from .obstacles import ObstacleProximity
from .self_distance import SelfContacts, SelfProximity
from .window import Window

__all__ = [
    "Ahead",
    "BodySet",
    "Contacts",
    "Forecast",
    "GJK_EXCESS",
    "MotionBounds",
    "Movers",
    "Narrowphase",
    "ObstacleProximity",
    "SelfContacts",
    "SelfProximity",
    "Window",
]
