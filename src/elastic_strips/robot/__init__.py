"""Robots: URDF files and Pinocchio models become frozen :class:`RobotModel` values."""

import numpy  # noqa: F401  Coal loads it, too, and crashes where Ctrl-C comes meanwhile

from elastic_strips.catalogue import robot_names

from .footprint import PlanarFootprint, footprint_polygon
from .kinematics import ControlPoints, Kinematics
from .loading import LoadOptions, load_robot
from .model import RobotModel
from .space import BaseKind, ConfigurationSpace

__all__ = [
    "BaseKind",
    "ConfigurationSpace",
    "ControlPoints",
    "Kinematics",
    "LoadOptions",
    "PlanarFootprint",
    "RobotModel",
    "footprint_polygon",
    "load_robot",
    "robot_names",
]
