"""Proximity: how near the robot's bodies are to obstacles and to each other, along a whole strip."""

from .bodies import BodySet
from .bounds import MotionBounds
from .contacts import Contacts
from .forecast import Ahead, Forecast, Movers
from .narrowphase import GJK_EXCESS, Narrowphase
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
