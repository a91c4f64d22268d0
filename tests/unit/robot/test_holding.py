"""What a robot holds is part of it: it moves with the hand, counts in distances and certificates, and is drawn."""

from __future__ import annotations

import pickle
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import refused

from elastic_strips.collision import BodySet, ObstacleProximity
from elastic_strips.errors import ConfigurationError, RobotError
from elastic_strips.planning import plan_report
from elastic_strips.robot import Kinematics, RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Voxels
from elastic_strips.strip import Deformer, Strip
from elastic_strips.viewer.geometry import robot_bodies

FINGERS = ("panda_leftfinger", "panda_rightfinger")
HAND = "panda_hand_tcp"


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda")


def frame_pose(robot: RobotModel, q: np.ndarray, frame: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(frame)].copy()


def test_it_moves_with_the_frame(panda, rng):
    """Against Coal alone: the distance of a rod in the hand from a ball, in random postures."""
    rod, ball = Cylinder(0.02, 0.4, at=(0.0, 0.0, 0.1), quat=(0.5, 0.5, 0.5, 0.5)), Sphere(0.1, at=(0.4, 0.1, 0.9))
    held = panda.attached(rod, HAND, touch=FINGERS, name="rod")
    bodies = BodySet.links(held)
    proximity, kin = ObstacleProximity(bodies, influence=9.0), Kinematics(held.tree)
    for _ in range(10):
        q = rng.uniform(panda.space.lower, panda.space.upper)
        kin.update(q[None])
        proximity.reset()
        proximity.update(kin, Scene([ball]))
        T = frame_pose(panda, q, HAND).homogeneous @ rod.pose
        poses = coal.Transform3s(T[:3, :3], T[:3, 3]), coal.Transform3s(np.eye(3), ball.pose[:3, 3])
        request, result = coal.DistanceRequest(True), coal.DistanceResult()
        apart = coal.distance(coal.Cylinder(0.02, 0.4), poses[0], coal.Sphere(0.1), poses[1], request, result)
        assert proximity.exact[0, bodies.names.index("rod"), 0] == pytest.approx(apart, abs=1e-4)


def test_what_is_taken_up_stays_where_it_is(panda):
    q = panda.home()
    can = Cylinder(0.03, 0.1, at=frame_pose(panda, q, HAND).translation, name="can")
    held = panda.attached(can, HAND, q=q, touch=(*FINGERS, "panda_hand"))
    piece = held.geometries[-1]
    assert piece.name == "can"
    data = held.model.createData()
    pin.forwardKinematics(held.model, data, q)
    np.testing.assert_allclose(data.oMi[piece.joint].homogeneous @ piece.placement, can.pose, atol=1e-12)


def test_it_counts_against_obstacles_and_the_robot_itself(panda):
    """A slab that the empty hand clears, and a rod that reaches back to the arm."""
    q = panda.home()
    tip = frame_pose(panda, q, HAND).translation
    scene = Scene([Box((0.2, 0.2, 0.02), at=tip - (0.0, 0.0, 0.2), name="slab")])
    rod = Cylinder(0.01, 0.5)
    held = panda.attached(rod, HAND, touch=(*FINGERS, "panda_hand"), name="rod")
    strip = Strip(panda, np.tile(q, (2, 1)))
    assert Deformer(panda).certify(strip, scene).certified
    certificate = Deformer(held).certify(Strip(held, np.tile(q, (2, 1))), scene)
    assert not certificate.certified
    assert (certificate.broken.link, certificate.broken.obstacle) == ("rod", "slab")
    assert len(held.self_pairs) > len(panda.self_pairs)
    assert not held.same_as(panda)
    long = panda.attached(Cylinder(0.01, 2.0), HAND, touch=(*FINGERS, "panda_hand"), name="rod")
    assert "rod" in (long.self_collision(q) or ())


def test_plans_are_made_with_it(panda):
    """Beside a post, whatever the hand holds passes, too: by the independent distance of each piece at every node."""
    scene = Scene([Box((0.1, 0.1, 0.9), at=(0.45, 0.0, 0.45), name="post")])
    held = panda.attached(Box((0.05, 0.3, 0.05), at=(0.0, 0.0, 0.05)), HAND, touch=(*FINGERS, "panda_hand"), name="bar")
    start, goal = (held.home(joints={"panda_joint1": a}) for a in (-1.0, 1.0))
    report = plan_report(held, scene, start, goal)
    assert report.certified, report.reason
    bodies = BodySet.links(held)
    proximity, kin = ObstacleProximity(bodies, influence=9.0), Kinematics(held.tree)
    kin.update(report.strip.coordinates)
    proximity.update(kin, scene)
    assert proximity.exact[:, bodies.names.index("bar")].min() > 0.0


def test_it_is_drawn_and_sent_to_other_processes(panda):
    held = panda.attached(Voxels([[0.0, 0.0, 0.1], [0.05, 0.0, 0.1]], 0.05), HAND, touch=(*FINGERS, "panda_hand"))
    names = [item.name for item in held.visual_model.geometryObjects]
    assert len(names) > panda.visual_model.ngeoms
    assert any(name.startswith("load") for name in names)
    copy = pickle.loads(pickle.dumps(held))
    assert [piece.name for piece in copy.geometries] == [piece.name for piece in held.geometries]
    assert copy.same_as(held)


def test_a_robot_without_looks_of_its_own_is_drawn_with_it(panda):
    """What collides is drawn then: robot and load, not the load alone."""
    plain = replace(panda, visual=pin.GeometryModel)
    held = plain.attached(Box((0.1, 0.1, 0.1), name="parcel"), HAND, touch=FINGERS)
    before, after = robot_bodies(plain), robot_bodies(held)
    assert [body.joint for body in after] == [body.joint for body in before]
    assert len(after) > 5
    assert sum(len(body.mesh.faces) for body in after) > sum(len(body.mesh.faces) for body in before)


def test_it_has_a_mass(panda):
    held = panda.attached(Sphere(0.02), HAND, mass=1.5, touch=(*FINGERS, "panda_hand"))
    total = sum(inertia.mass for inertia in held.model.inertias)
    assert total == pytest.approx(sum(inertia.mass for inertia in panda.model.inertias) + 1.5)


def test_what_cannot_be_held_is_refused(panda):
    ball, q = Sphere(0.05), panda.home()
    with refused(RobotError, "'panda_hand_tcp'"):
        panda.attached(ball, "panda_hand_tpc")
    with refused(RobotError, "move"):
        panda.attached(ball, "panda_link0")
    with refused(RobotError, "'thumb'"):
        panda.attached(ball, HAND, touch=["thumb"])
    with refused(RobotError, "already"):
        panda.attached(ball, HAND, name="panda_link0")
    with refused(RobotError, "mass"):
        panda.attached(ball, HAND, mass=-1.0)
    with refused(RobotError, "already"):
        panda.attached(ball, HAND, name="ball").attached(ball, HAND, name="ball")
    at = frame_pose(panda, q, "panda_link4").translation
    with pytest.raises(ConfigurationError, match="touches the robot where it is taken up"):
        panda.attached(Sphere(0.05, at=at, name="ball"), HAND, q=q)
