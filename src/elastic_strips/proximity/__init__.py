"""Proximity: how near the robot's bodies are to obstacles and to each other, along a whole strip."""

from .bodies import BodySet
from .bounds import MotionBounds
from .narrowphase import GJK_EXCESS, Narrowphase
from .obstacles import Contacts, ObstacleProximity
from .self_distance import SelfContacts, SelfProximity
from .window import Window

__all__ = [
    "GJK_EXCESS",
    "BodySet",
    "Contacts",
    "MotionBounds",
    "Narrowphase",
    "ObstacleProximity",
    "SelfContacts",
    "SelfProximity",
    "Window",
]
