"""A robot that was sent to another process is the same robot."""

from __future__ import annotations

import pickle

import numpy as np
from cases import each_robot, refused

from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.sim.plant import KinematicPlant
from elastic_strips.trajectory import MotionLimits


@each_robot
def test_a_pickled_robot_is_the_same(robot: RobotModel):
    copy = pickle.loads(pickle.dumps(robot))
    assert copy.same_as(robot)
    assert robot.same_as(copy)
    assert copy.name == robot.name
    assert copy.joint_names == robot.joint_names
    assert dict(copy.locked) == dict(robot.locked)
    assert dict(copy.states) == dict(robot.states)
    for name in ("lower", "upper"):
        np.testing.assert_array_equal(getattr(copy.space, name), getattr(robot.space, name))
    for a, b in zip(copy.geometries, robot.geometries, strict=True):
        assert (a.name, a.links, a.capsule.r) == (b.name, b.links, b.capsule.r)
        np.testing.assert_array_equal([a.capsule.a, a.capsule.b], [b.capsule.a, b.capsule.b])
        assert a.geometry.aabb_radius == b.geometry.aabb_radius > 0.0
    rows = np.tile(robot.space.to_coordinates(robot.home_q), (3, 1)) + 0.1 * np.arange(3)[:, None]
    placed = [Kinematics(r.tree) for r in (copy, robot)]
    for kinematics in placed:
        kinematics.update(rows)
    np.testing.assert_array_equal(placed[0].T[:, :3], placed[1].T[:, :3])
    np.testing.assert_array_equal(placed[0].J[:3], placed[1].J[:3])
    for q in robot.space.from_coordinates(rows):
        assert copy.self_collision(q) == robot.self_collision(q)
        np.testing.assert_allclose(copy.control_points(q), robot.control_points(q), rtol=0.0, atol=1e-14)


def test_a_pickled_robot_is_read_only_and_can_be_drawn(silvermate: RobotModel):
    copy = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(silvermate))))
    with refused(ValueError, "read-only"):
        copy.home_q[0] = 1.0
    assert len(copy.visual_model.geometryObjects) == len(silvermate.geometries)
    KinematicPlant(copy, pickle.loads(pickle.dumps(MotionLimits.for_robot(silvermate))))
