"""Elastic strips: certified collision-free whole-body paths of mobile manipulators that give way to obstacles.

::

    import elastic_strips as es

    robot = es.load_robot("silvermate")
    scene = es.Scene([es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7)), es.Sphere(0.25, at=(2.4, 0.8, 1.0))])
    strip = es.plan(robot, scene, start=robot.home(x=-1.0), goal=robot.home(x=6.0))
    report = es.Deformer(robot).settle(strip, scene)
    print(report.status, report.clearance, report.certificate.certified)
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from elastic_strips._late import late_names
from elastic_strips._version import __version__
from elastic_strips.errors import (
    ConfigurationError,
    ElasticStripsError,
    InputError,
    MissingExtraError,
    ParameterError,
    RobotError,
    ScenarioError,
    SceneError,
)

if TYPE_CHECKING:
    from elastic_strips.collision import Certificate
    from elastic_strips.control import Command, Controller, Measurement
    from elastic_strips.io import read_scene, read_world, write_scene, write_world
    from elastic_strips.planning import PlanReport, plan, plan_report
    from elastic_strips.robot import RobotModel, load_robot, robot_names
    from elastic_strips.scene import (
        Box,
        Capsule,
        Cone,
        ConvexHull,
        Cylinder,
        Keyframes,
        Mesh,
        Points,
        Scene,
        Sphere,
        Twist,
        UnknownMotion,
        Voxels,
        World,
    )
    from elastic_strips.sim.scenarios import get_scenario, run_scenario, scenario_names
    from elastic_strips.strip import Deformer, DeformParams, DeformReport, DeformStatus, Strip, strip_clearance
    from elastic_strips.viewer import Viewer

logging.getLogger(__name__).addHandler(logging.NullHandler())  # who uses the library decides what is shown

__all__ = [
    "__version__",
    "load_robot",
    "robot_names",
    "RobotModel",
    "Scene",
    "Box",
    "Sphere",
    "Cylinder",
    "Capsule",
    "Cone",
    "ConvexHull",
    "Mesh",
    "Voxels",
    "Points",
    "Twist",
    "Keyframes",
    "UnknownMotion",
    "World",
    "read_scene",
    "write_scene",
    "read_world",
    "write_world",
    "Strip",
    "plan",
    "plan_report",
    "PlanReport",
    "Deformer",
    "DeformParams",
    "DeformReport",
    "DeformStatus",
    "Certificate",
    "strip_clearance",
    "Controller",
    "Measurement",
    "Command",
    "get_scenario",
    "scenario_names",
    "run_scenario",
    "Viewer",
    "ElasticStripsError",
    "InputError",
    "MissingExtraError",
    "RobotError",
    "SceneError",
    "ScenarioError",
    "ConfigurationError",
    "ParameterError",
]


_ROOMS = {
    "control": ("Command", "Controller", "Measurement"),
    "io": ("read_scene", "read_world", "write_scene", "write_world"),
    "planning": ("PlanReport", "plan", "plan_report"),
    "robot": ("RobotModel", "load_robot", "robot_names"),
    "sim.scenarios": ("get_scenario", "run_scenario", "scenario_names"),
    "scene": (
        "Box", "Capsule", "Cone", "ConvexHull", "Cylinder", "Keyframes", "Mesh", "Points", "Scene", "Sphere", "Twist",
        "UnknownMotion", "Voxels", "World",
    ),
    "strip": ("Deformer", "DeformParams", "DeformReport", "DeformStatus", "Strip", "strip_clearance"),
    "collision": ("Certificate",),
    "viewer": ("Viewer",),
    **{room: () for room in ("perception", "sim", "trajectory")},
}  # fmt: skip
__getattr__ = late_names(__name__, _ROOMS)  # who wants the version need not wait for Pinocchio


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
