"""Elastic strips: certified collision-free whole-body paths of mobile manipulators that give way to obstacles.

::

    import elastic_strips as es

    robot = es.load_robot("silvermate")
    scene = es.Scene([es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7)), es.Sphere(0.25, at=(2.4, 0.8, 1.0))])
    strip = es.plan(robot, scene, start=robot.home(x=-1.0), goal=robot.home(x=6.0))
    report = es.Deformer(robot).settle(strip, scene)
    print(report.status, report.clearance, report.certificate.certified)

What most programs need has its name here. The rest is in the rooms: ``es.scene.ConvexHull``, ``es.errors.SceneError``,
``es.sim.Simulation``; docs/architecture.md says what is where.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from elastic_strips._late import late_names
from elastic_strips._version import __version__
from elastic_strips.errors import ElasticStripsError, InputError

if TYPE_CHECKING:
    from elastic_strips import (  # noqa: F401 (rooms are attributes: es.scene)
        collision,
        control,
        errors,
        io,
        perception,
        planning,
        robot,
        scene,
        sim,
        strip,
        trajectory,
        viewer,
    )
    from elastic_strips.collision import Certificate, certify
    from elastic_strips.control import Command, Controller, DriveParams, Measurement
    from elastic_strips.io import load_path, read_scene, write_scene
    from elastic_strips.planning import BasePose, HandPose, plan, plan_report
    from elastic_strips.robot import RobotModel, load_robot
    from elastic_strips.scene import Box, Capsule, Cylinder, Mesh, Scene, Sphere, Twist, World
    from elastic_strips.strip import Deformer, DeformParams, DeformReport, Strip
    from elastic_strips.trajectory import MotionLimits, retime
    from elastic_strips.viewer import Viewer

logging.getLogger(__name__).addHandler(logging.NullHandler())  # who uses the library decides what is shown

__all__ = [
    "__version__",
    "load_robot",
    "RobotModel",
    "Scene",
    "World",
    "Box",
    "Sphere",
    "Cylinder",
    "Capsule",
    "Mesh",
    "Twist",
    "read_scene",
    "write_scene",
    "plan",
    "plan_report",
    "HandPose",
    "BasePose",
    "Strip",
    "Deformer",
    "DeformParams",
    "DeformReport",
    "load_path",
    "certify",
    "Certificate",
    "retime",
    "MotionLimits",
    "Controller",
    "DriveParams",
    "Measurement",
    "Command",
    "Viewer",
    "ElasticStripsError",
    "InputError",
]

_ROOMS = {
    "collision": ("Certificate", "certify"),
    "control": ("Command", "Controller", "DriveParams", "Measurement"),
    "errors": (),
    "io": ("load_path", "read_scene", "write_scene"),
    "perception": (),
    "planning": ("BasePose", "HandPose", "plan", "plan_report"),
    "robot": ("RobotModel", "load_robot"),
    "scene": ("Box", "Capsule", "Cylinder", "Mesh", "Scene", "Sphere", "Twist", "World"),
    "sim": (),
    "strip": ("Deformer", "DeformParams", "DeformReport", "Strip"),
    "trajectory": ("MotionLimits", "retime"),
    "viewer": ("Viewer",),
}
__getattr__ = late_names(__name__, _ROOMS)  # who wants the version need not wait for Pinocchio


def __dir__() -> list[str]:
    return sorted(__all__)
