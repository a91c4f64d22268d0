"""Joints that look: what is proven of the robot holds wherever its head is, and its sensors see where it really is."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from cases import refused

import elastic_strips as es
from elastic_strips.coal_shapes import outside, support_points
from elastic_strips.errors import RobotError

HEAD = ("head_1_joint", "head_2_joint")


@pytest.fixture(scope="module")
def tiago(looking_tiago):
    return looking_tiago


def posed(robot, row, links):
    """Corners in the world of pieces of some links."""
    import pinocchio as pin

    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.space.from_coordinates(row))
    found = []
    for piece in robot.geometries:
        if set(piece.links) & set(links):
            T = data.oMi[piece.joint].homogeneous @ piece.placement
            corners = support_points(piece.geometry)[0]
            found.append((piece, T, corners @ T[:3, :3].T + T[:3, 3]))
    return found


def test_the_head_stays_within_what_is_planned_with(tiago):
    seeing, rng = tiago.seeing, np.random.default_rng(3)
    row = tiago.space.to_coordinates(tiago.home(0.4, -0.2, 0.7))
    ((piece, T, _),) = posed(tiago, row, ["head_2_link"])
    k = [seeing.space.base_nv + seeing.joint_names.index(joint) for joint in HEAD]
    low, high = seeing.space.lower[k], seeing.space.upper[k]
    ends = np.array(np.meshgrid(*np.stack((low, high), axis=1))).reshape(2, -1).T
    out = []
    for values in np.vstack((ends, rng.uniform(low, high, (40, 2)))):
        for _, _, corners in posed(seeing, tiago.seeing_row(row, values), ["head_1_link", "head_2_link"]):
            out.append(outside(piece.geometry, (corners - T[:3, 3]) @ T[:3, :3]).max())
    assert max(out) < 1e-6
    assert max(out) > -0.05  # and it is no larger than that takes


def test_only_the_head_is_another_one(tiago, shared):
    plain = shared("tiago", "tiago")
    assert tiago.joint_names == plain.joint_names
    assert plain.seeing is plain
    assert not plain.looking
    assert set(tiago.seeing.joint_names) == {*plain.joint_names, *HEAD}
    assert not tiago.same_as(plain)
    others = [p.name for p in tiago.geometries if "head" not in p.name]
    assert others == [p.name for p in plain.geometries if "head" not in p.name]


def test_it_goes_to_another_process(tiago):
    copy = pickle.loads(pickle.dumps(tiago))
    assert copy.looking == HEAD
    assert copy.seeing.joint_names == tiago.seeing.joint_names


def test_what_cannot_look_is_refused():
    with refused(RobotError, "wheel_left_joint"):
        es.load_robot("tiago", looking=["wheel_left_joint"])
    with refused(RobotError, "arm_1_joint"):
        es.load_robot("tiago", looking=["arm_1_joint"])
    with refused(RobotError, "neck"):
        es.load_robot("tiago", looking=["neck"])


def test_what_looks_is_not_planned():
    with refused(RobotError, "head_1_joint"):
        es.load_robot("tiago", looking=HEAD, joints=["torso_lift_joint", "head_1_joint"])


def test_what_it_holds_is_held_before_its_eyes_too(tiago):
    can = es.Cylinder(0.03, 0.12, at=(0.2, 0.0, 0.0), name="can")
    held = tiago.attached(can, "arm_tool_link", touch=[f.name for f in tiago.model.frames if "hand" in f.name])
    row = tiago.space.to_coordinates(tiago.home())
    ((_, T, _),) = posed(held, row, ["can"])
    ((_, seen, _),) = posed(held.seeing, held.seeing_row(row, np.array([0.3, -0.2])), ["can"])
    np.testing.assert_allclose(seen, T, atol=1e-9)
