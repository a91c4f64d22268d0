"""Models that already exist in Pinocchio: what they may hold, and what is refused."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import refused

from elastic_strips.errors import ConfigurationError, RobotError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.kinematics import KinematicTree
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, DeformParams, Strip


def planar_model() -> pin.Model:
    model = pin.Model()
    model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root_joint")
    model.appendBodyToJoint(1, pin.Inertia.Random(), pin.SE3.Identity())
    return model


def geometry(*shapes: tuple[str, int, coal.CollisionGeometry, tuple[float, float, float]]) -> pin.GeometryModel:
    collision = pin.GeometryModel()
    for name, joint, shape, at in shapes:
        pose = pin.SE3(np.eye(3), np.array(at))
        collision.addGeometryObject(pin.GeometryObject(name, joint, 0, pose, shape))
    return collision


def test_geometry_fixed_to_the_world_is_no_link_of_a_robot_that_moves():
    """A wall in the collision model was carried along as if it could not be hit by the base."""
    collision = geometry(("body", 1, coal.Sphere(0.2), (0, 0, 0)), ("wall", 0, coal.Box(0.1, 2, 1), (1.5, 0, 0)))
    with refused(RobotError, "joint", "'wall'", "Scene"):
        RobotModel.from_pinocchio(planar_model(), collision)


def test_a_fixed_base_may_stand_on_geometry_of_the_world():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn", np.ones(1), np.ones(1), -np.ones(1), np.ones(1))
    collision = geometry(("stand", 0, coal.Box(0.1, 0.1, 0.1), (0, 0, 0)), ("arm", 1, coal.Sphere(0.1), (0.5, 0, 0)))
    robot = RobotModel.from_pinocchio(model, collision)
    assert [piece.name for piece in robot.geometries] == ["stand", "arm"]


def test_a_slider_without_limits_is_bounded():
    """A turning joint before it moves its links the further the further they slid: nothing bounds that else."""
    model = pin.Model()
    turn = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "turn")
    slide = model.addJoint(turn, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    robot = RobotModel.from_pinocchio(model, geometry(("ball", slide, coal.Sphere(0.1), (0, 0, 0))))
    assert robot.home(slide=900.0)[-1] == 900.0
    with refused(ConfigurationError, "limits"):
        robot.home(slide=1100.0)
    far = Strip(robot, [robot.home(turn=0.0, slide=900.0), robot.home(turn=0.3, slide=900.0)])
    at = 900.0 * np.array([np.cos(0.15), np.sin(0.15)])
    assert not Deformer(robot).certify(far, Scene([Box((0.1, 0.1, 0.1), at=(*at, 0.0))])).certified


@pytest.mark.parametrize("shape", [coal.Sphere(0.05), coal.Box(0.1, 0.1, 0.1)])
def test_a_swept_sphere_radius_counts(shape):
    """Coal adds it to every distance; so the capsules and boxes that things are culled by must hold it as well."""
    shape.setSweptSphereRadius(1.5)
    robot = RobotModel.from_pinocchio(planar_model(), geometry(("body", 1, shape, (0, 0, 0))))
    strip = Strip(robot, [robot.home(x=-1.0), robot.home(x=1.0)])
    deformer = Deformer(robot, DeformParams(influence=0.05))
    assert not deformer.certify(strip, Scene([Box((6.0, 0.1, 1.0), at=(0.0, 1.5, 0.0))])).certified
    assert deformer.certify(strip, Scene([Box((6.0, 0.1, 1.0), at=(0.0, 1.7, 0.0))])).certified


def test_kinematics_that_differ_from_pinocchios_are_refused(silvermate, monkeypatch):
    """As they would where NumPy returns wrong values for arrays of some size."""
    monkeypatch.setattr(np, "cos", lambda x: np.sqrt(np.maximum(0.0, 1.0 - np.sin(x) ** 2)))
    with refused(RobotError, "Pinocchio"):
        KinematicTree.from_model(silvermate.model, silvermate.space)
