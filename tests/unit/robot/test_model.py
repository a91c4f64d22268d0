"""RobotModel: home, configuration checks, locked joints, control points, and models that exist already."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys

import coal
import numpy as np
import pinocchio as pin
import pytest
from brute_force import random_configurations
from cases import each, each_robot, refused

from elastic_strips.catalogue import find_robot
from elastic_strips.errors import ConfigurationError, InputError, RobotError
from elastic_strips.robot import BaseKind, RobotModel, load_robot, robot_names

ARM = tuple(f"arm_{i}_joint" for i in range(1, 8))


def test_named_robots(silvermate, tiago):
    assert {"silvermate", "tiago", "jackal-box", "bridge-arm"} < set(robot_names())
    for robot in (silvermate, tiago):
        assert robot.base_kind is BaseKind.DIFF_DRIVE
        assert robot.model.joints[1].shortname() == "JointModelPlanar"
        assert find_robot(robot.name).summary
    assert silvermate.joint_names == ARM
    assert tiago.joint_names == ("torso_lift_joint", *ARM)
    assert (silvermate.nq, silvermate.nv) == (11, 10)
    assert (tiago.nq, tiago.nv) == (12, 11)


@each_robot
def test_every_link_of_the_robots_moves_as_convex_shape(robot):
    assert len(robot.geometries) == robot.collision_model.ngeoms
    for piece, obj in zip(robot.geometries, robot.collision_model.geometryObjects, strict=True):
        assert isinstance(piece.geometry, (coal.ShapeBase,))
        assert (obj.name, obj.parentJoint) == (piece.name, piece.joint)
        np.testing.assert_allclose(obj.placement.homogeneous, piece.placement, atol=1e-15)
    assert len(robot.self_pairs) == len(robot.collision_model.collisionPairs)


def test_unknown_name_says_which_are_known():
    with refused(RobotError, "'silvermat'", "'silvermate'", "tiago"):
        load_robot("silvermat")


def test_unknown_base_says_which_are_known():
    with refused(RobotError, "'diffdrive'", "'diff_drive'", "fixed", "omni"):
        load_robot("silvermate", base="diffdrive")


def test_base_kinds_of_a_named_robot(silvermate):
    omni, fixed = load_robot("silvermate", base="omni"), load_robot("silvermate", base=BaseKind.FIXED)
    assert (omni.base_kind, omni.nq) == (BaseKind.OMNI, 11)
    assert (fixed.base_kind, fixed.nq, fixed.nv) == (BaseKind.FIXED, 7, 7)
    np.testing.assert_allclose(fixed.home(), silvermate.home()[4:])


def test_home_places_the_base_and_overrides_joints(silvermate):
    q = silvermate.home(x=1.0, y=-2.0, yaw=0.5, arm_4_joint=1.25)
    np.testing.assert_allclose(q[:4], [1.0, -2.0, np.cos(0.5), np.sin(0.5)])
    assert q[4 + 3] == 1.25
    others = [i for i in range(4, 11) if i != 7]
    np.testing.assert_array_equal(q[others], silvermate.home_q[others])
    assert not silvermate.home_q.flags.writeable
    q[0] = 7.0  # a copy: the next home is unharmed
    assert silvermate.home()[0] == 0.0


def test_joints_with_the_names_of_the_base_pose():
    model = pin.Model()
    for name, axis in (("x", pin.JointModelPX()), ("yaw", pin.JointModelRZ())):
        model.addJoint(model.njoints - 1, axis, pin.SE3.Identity(), name)
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -1.0, 1.0
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("tip", 2, pin.SE3.Identity(), coal.Sphere(0.1)))
    robot = RobotModel.from_pinocchio(model, geometry, base="fixed")
    np.testing.assert_array_equal(robot.home(joints={"x": 0.25, "yaw": -0.5}), [0.25, -0.5])
    with refused(ConfigurationError, "joints=3"):
        robot.home(joints=3)


def test_home_is_the_srdfs_posture(silvermate):
    np.testing.assert_allclose(silvermate.home()[4:], [0.05, 0.15, -0.6, 2.0, 0.5, 0.15, -0.6])


@each(
    "override, message",
    [
        (
            {"arm_8_joint": 0.0},
            r"'silvermate' plans no joint 'arm_8_joint'; did you mean 'arm_\d_joint'\? Valid: arm_1",
        ),
        ({"wheel_left_joint": 0.0}, r"plans no joint 'wheel_left_joint'"),
        ({"arm_1_joint": 3.5}, r"joint 'arm_1_joint' = 3.5 is outside its limits \[-1, 3\]"),
        ({"arm_1_joint": 90.0}, r"\[-1, 3\] rad; 90 \w+ are 1.5708 rad"),
        ({"arm_1_joint": np.nan}, r"\[4\] = nan is not finite"),
        ({"x": np.inf}, r"\[0\] = inf is not finite"),
        ({"yaw": np.nan}, r"not finite"),
    ],
)
def test_home_refuses(silvermate, override, message):
    with pytest.raises(ConfigurationError, match=message):
        silvermate.home(**override)


@pytest.mark.parametrize("override", [{"x": "one"}, {"arm_1_joint": "far"}])
def test_home_refuses_what_is_no_number(silvermate, override):
    try:
        silvermate.home(**override)
    except InputError:
        return
    pytest.fail("accepted")


def test_home_of_a_fixed_base_stays(gantry):
    with refused(ConfigurationError, "base", "'gantry'", "x=1.0"):
        gantry.home(x=1.0)
    q = gantry.home(spin=4.0, slide=0.1)
    np.testing.assert_allclose(q, [0.1, 0.1, np.cos(4.0), np.sin(4.0), 0.0])


@each(
    "change, message",
    [
        (lambda q: q[:-1], r"shape \(10,\); 'silvermate' wants \(…, 11\): x, y, cos yaw, sin yaw, joints"),
        (lambda q: q[None, None], r"shape \(1, 1, 11\)"),
        (lambda q: "home", r"not an array of numbers"),
        (lambda q: None, r"shape \(\)"),
        (lambda q: [list(q), [1.0]], r"not an array of numbers"),
        (lambda q: np.where(np.arange(11) == 6, np.nan, q), r"q\[6\] = nan is not finite"),
        (lambda q: np.where(np.arange(11) == 0, -np.inf, q), r"q\[0\] = -inf is not finite"),
        (lambda q: np.where(np.arange(11) == 2, 1.00001, q), r"pair \(cos, sin\) at 2, 3"),
        (lambda q: np.where(np.arange(11) == 2, 0.0, q), r"pair \(cos, sin\) at 2, 3"),
        (lambda q: np.where(np.arange(11) == 4, 3.001, q), r"'arm_1_joint' = 3.001 is outside its limits \[-1, 3\]"),
        (lambda q: np.where(np.arange(11) == 10, -1.1, q), r"'arm_7_joint' = -1.1 is outside"),
    ],
)
def test_check_q_refuses(silvermate, change, message):
    with pytest.raises(ConfigurationError, match=message):
        silvermate.check_q(change(silvermate.home()))


def test_check_q_of_a_continuous_joint(gantry):
    q = gantry.home()
    q[2:4] = 0.6, 0.7
    with refused(ConfigurationError, "(cos, sin)"):
        gantry.check_q(q)


def test_check_q_copies_and_can_ignore_limits(silvermate):
    q = silvermate.home()
    q[4] = 9.0
    out = silvermate.check_q(q, limits=False)
    np.testing.assert_array_equal(out, q)
    assert out is not q
    stack = np.stack((silvermate.home(), q))
    with refused(ConfigurationError, "strip", "'arm_1_joint'"):
        silvermate.check_q(stack, what="strip")


def test_locked_joints_are_gone_and_hold_their_value(gantry_urdf, gantry):
    locked = load_robot(gantry_urdf, base="fixed", locked={"spin": 1.2, "nod": 0.5})
    assert locked.joint_names == ("slide", "bend")
    assert locked.locked == {"spin": 1.2, "nod": 0.5}
    data, full = locked.model.createData(), gantry.model.createData()
    q = gantry.home(spin=1.2, nod=0.5, slide=0.2, bend=-1.0)
    pin.framesForwardKinematics(gantry.model, full, q)
    pin.framesForwardKinematics(locked.model, data, locked.home(slide=0.2, bend=-1.0))
    for name in ("tip", "camera"):
        one = data.oMf[locked.model.getFrameId(name)].homogeneous
        np.testing.assert_allclose(one, full.oMf[gantry.model.getFrameId(name)].homogeneous, atol=1e-12)


@each(
    "locked, message",
    [
        ({"spinn": 0.0}, r"locked: unknown joint 'spinn'; did you mean 'spin'"),
        ({"spin": np.nan}, r"joint 'spin' has value nan"),
        ({"spin": "fast"}, r"joint 'spin' has value 'fast'"),
        ({"nod": 2.0}, r"joint 'nod' = 2 is outside its limits \[0.1, 0.9\]"),
        ({"root_joint": 0.0}, r"unknown joint 'root_joint'"),
    ],
)
def test_locked_refuses(gantry_urdf, locked, message):
    with pytest.raises(RobotError, match=message):
        load_robot(gantry_urdf, locked=locked)


def test_default_control_points_are_base_joints_and_hand(silvermate, rng):
    assert silvermate.control_point_set.names == ("P_m", *(f"P_{i}" for i in range(1, 8)), "P_hand")
    q = random_configurations(silvermate, rng, 1)[0]
    data = silvermate.model.createData()
    pin.framesForwardKinematics(silvermate.model, data, q)
    points = silvermate.control_points(q)
    np.testing.assert_allclose(points[0], [q[0], q[1], 0.0], atol=1e-12)
    for i in range(1, 8):
        np.testing.assert_allclose(points[i], data.oMi[1 + i].translation, atol=1e-12)
    hand = data.oMf[silvermate.model.getFrameId("hand_frame")]
    np.testing.assert_allclose(points[8], hand.translation, atol=1e-12)


def test_control_points_of_ones_own(gantry_urdf, rng):
    given = {"lens": "camera", "pen": ("tip", (0.0, 0.02, -0.3))}
    robot = load_robot(gantry_urdf, base="omni", control_points=given)
    assert robot.control_point_set.names == ("lens", "pen")
    q = random_configurations(robot, rng, 1)[0]
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    lens, pen = robot.control_points(q)
    np.testing.assert_allclose(lens, data.oMf[robot.model.getFrameId("camera")].translation, atol=1e-12)
    np.testing.assert_allclose(pen, data.oMf[robot.model.getFrameId("tip")].act(np.array(given["pen"][1])), atol=1e-12)


@each(
    "points, message",
    [
        ({"a": "tipp"}, r"control point 'a': unknown frame 'tipp'; did you mean 'tip'"),
        ({"a": "TIP"}, r"control point 'a': unknown frame 'TIP'; did you mean 'tip'"),
        ({"a": ("tip", (0.0, 1.0))}, r"control point 'a': offset \(0.0, 1.0\) is not three"),
        ({"a": ("tip", (0.0, np.nan, 1.0))}, r"not three finite numbers"),
        ({}, r"control_points is empty"),
    ],
)
def test_control_points_refuse(gantry_urdf, points, message):
    with pytest.raises(RobotError, match=message):
        load_robot(gantry_urdf, control_points=points)


def chain(planar: bool) -> tuple[pin.Model, pin.GeometryModel]:
    """A hand-made Pinocchio model: an optional planar root and one continuous joint that carries a capsule."""
    model = pin.Model()
    model.name = "made"
    parent = 0
    if planar:
        parent = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root_joint")
    joint = model.addJoint(parent, pin.JointModelRUBZ(), pin.SE3(np.eye(3), np.array([0.1, 0, 0.2])), "turn")
    geometry = pin.GeometryModel()
    at = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
    arm, post = coal.Capsule(0.05, 0.2), coal.Box(0.1, 0.1, 0.3)
    frame = [model.addJointFrame(i) for i in range(1, model.njoints)][-1]
    geometry.addGeometryObject(pin.GeometryObject("arm", joint, frame, at, arm))
    geometry.addGeometryObject(pin.GeometryObject("post", parent, parent, pin.SE3.Identity(), post))
    return model, geometry


def test_from_pinocchio_takes_models_that_exist():
    model, geometry = chain(planar=True)
    robot = RobotModel.from_pinocchio(model, geometry)
    assert (robot.name, robot.base_kind) == ("made", BaseKind.OMNI)
    assert robot.joint_names == ("turn",)
    np.testing.assert_allclose(robot.home(x=1.0, turn=0.3), [1, 0, 1, 0, np.cos(0.3), np.sin(0.3)])
    assert (model.nq, geometry.ngeoms) == (6, 2)  # unchanged
    assert robot.visual_model.ngeoms == 2
    diff = RobotModel.from_pinocchio(model, geometry, base="diff_drive", name="mine", locked={"turn": 0.5})
    assert (diff.name, diff.base_kind, diff.nv) == ("mine", BaseKind.DIFF_DRIVE, 3)


def test_a_fixed_robot_of_one_joint(rng):
    robot = RobotModel.from_pinocchio(*chain(planar=False))
    assert (robot.base_kind, robot.nv) == (BaseKind.FIXED, 1)


def test_from_pinocchio_takes_geometry_without_frames():
    code = (
        "import coal, pinocchio as pin\n"
        "from elastic_strips.robot import RobotModel\n"
        "model, geometry = pin.Model(), pin.GeometryModel()\n"
        "joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), 'root_joint')\n"
        "geometry.addGeometryObject(pin.GeometryObject('arm', joint, pin.SE3.Identity(), coal.Sphere(0.1)))\n"
        "assert RobotModel.from_pinocchio(model, geometry).geometries[0].joint == 1\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60, capture_output=True)


def test_from_pinocchio_refuses():
    model, geometry = chain(planar=False)
    with refused(RobotError, "base='omni'", "model"):
        RobotModel.from_pinocchio(model, geometry, base="omni")
    model, geometry = chain(planar=True)
    with refused(RobotError, "base='fixed'", "model"):
        RobotModel.from_pinocchio(model, geometry, base="fixed")
    with refused(RobotError, "home", "'tum'"):
        RobotModel.from_pinocchio(model, geometry, home={"tum": 0.0})
    with refused(RobotError, "'made'"):
        RobotModel.from_pinocchio(model, pin.GeometryModel())
    model.jointPlacements[1] = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    with refused(RobotError, "origin"):
        RobotModel.from_pinocchio(model, geometry)


def test_shapes_without_convex_description_are_refused():
    model, geometry = chain(planar=True)
    geometry.addGeometryObject(
        pin.GeometryObject("wall", 1, 1, pin.SE3.Identity(), coal.Halfspace(np.array([0, 0, 1.0]), 0))
    )
    with refused(RobotError, "Halfspace", "Box, Sphere"):
        RobotModel.from_pinocchio(model, geometry)


def test_the_model_is_frozen(silvermate):
    with pytest.raises(dataclasses.FrozenInstanceError):
        silvermate.name = "other"


def test_messages_fit_on_a_screen(silvermate):
    with pytest.raises(ConfigurationError) as caught:
        silvermate.home(no_such_joint=0.0)
    assert len(str(caught.value)) < 300
    assert not re.search(r"0x[0-9a-f]{6}", str(caught.value))


def test_a_frames_pose(silvermate, rng):
    data = silvermate.model.createData()
    for _ in range(5):
        q = silvermate.home(x=float(rng.uniform(-2, 2)), y=1.0, yaw=float(rng.uniform(-3, 3)))
        pin.framesForwardKinematics(silvermate.model, data, q)
        expected = data.oMf[silvermate.model.getFrameId("hand_frame")].homogeneous
        np.testing.assert_allclose(silvermate.frame_pose(q, "hand_frame"), expected, atol=1e-12)
    with refused(RobotError, "'hand_fram'", "hand_frame"):
        silvermate.frame_pose(silvermate.home(), "hand_fram")
    with pytest.raises(ConfigurationError):
        silvermate.frame_pose(silvermate.home()[:3], "hand_frame")
