"""Scene room: obstacles around the robot, at rest or moving, as immutable snapshots made of convex Coal parts."""

from .motion import Keyframes, Motion, PedestrianMotion, Twist, UnknownMotion
from .obstacle import UNSEEN_LAYER, Box, Capsule, Cone, ConvexHull, Cylinder, Mesh, Obstacle, Points, Sphere, Voxels
from .scene import Scene, World

__all__ = [
    "UNSEEN_LAYER",
    "Box",
    "Capsule",
    "Cone",
    "ConvexHull",
    "Cylinder",
    "Keyframes",
    "Mesh",
    "Motion",
    "Obstacle",
    "PedestrianMotion",
    "Points",
    "Scene",
    "Sphere",
    "Twist",
    "UnknownMotion",
    "Voxels",
    "World",
]
