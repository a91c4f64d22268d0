"""Scene room: what stands and moves around the robot, as immutable snapshots made of convex Coal parts."""

from elastic_strips.scene.motion import Keyframes, Motion, Twist, Unknown
from elastic_strips.scene.obstacle import Obstacle
from elastic_strips.scene.parts import Part
from elastic_strips.scene.scene import PartTable, Scene
from elastic_strips.scene.shapes import Box, Capsule, Cone, ConvexHull, Cylinder, Mesh, Points, Sphere, Voxels
from elastic_strips.scene.world import World
from elastic_strips.scene.yielding import Yielding

__all__ = [
    "Box",
    "Capsule",
    "Cone",
    "ConvexHull",
    "Cylinder",
    "Keyframes",
    "Mesh",
    "Motion",
    "Obstacle",
    "Part",
    "PartTable",
    "Points",
    "Scene",
    "Sphere",
    "Twist",
    "Unknown",
    "Voxels",
    "World",
    "Yielding",
]
