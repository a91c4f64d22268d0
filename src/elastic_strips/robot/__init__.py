"""Robots: URDF files and Pinocchio models become frozen :class:`RobotModel` values."""

from elastic_strips.catalogue import recorded_robot, robot_names, robot_summary

from .footprint import PlanarFootprint
from .geometry import Capsule, LinkGeometry
from .kinematics import ControlPoints, Kinematics, KinematicTree
from .loading import load_robot
from .model import RobotModel
from .space import BaseKind, ConfigurationSpace

__all__ = [
    "BaseKind",
    "Capsule",
    "ConfigurationSpace",
    "ControlPoints",
    "KinematicTree",
    "Kinematics",
    "LinkGeometry",
    "PlanarFootprint",
    "RobotModel",
    "load_robot",
    "recorded_robot",
    "robot_names",
    "robot_summary",
]
