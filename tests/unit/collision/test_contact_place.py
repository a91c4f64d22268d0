"""Where a pin stands: at both that touch, and not in the middle of a link."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from cases import each

import elastic_strips as es
from elastic_strips.collision.contact_place import contact_place
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Voxels

BOX = es.Box((0.3, 0.3, 1.0), at=(2.0, 0.3, 0.5), name="it")
VOXELS = Voxels([(2.0, 0.3, 0.1 * k) for k in range(8)], 0.1, name="it")


def off(robot: RobotModel, q: np.ndarray, link: str, place: np.ndarray) -> float:
    """How far a place is from one of the robot's pieces [m]; below 0 inside."""
    data, placed = robot.model.createData(), robot.collision_model.createData()
    pin.updateGeometryPlacements(robot.model, data, robot.collision_model, placed, q)
    k = [piece.name for piece in robot.geometries].index(link)
    at, dot = placed.oMg[k], coal.Transform3s(np.eye(3), place)
    pose = coal.Transform3s(at.rotation, at.translation)
    shape = robot.geometries[k].geometry
    return float(coal.distance(shape, pose, coal.Sphere(1e-6), dot, coal.DistanceRequest(True), coal.DistanceResult()))


@each("obstacle", [BOX, VOXELS, es.Sphere(0.2, at=(2.0, 0.3, 0.3), name="it")])
def test_it_is_at_both_that_touch(obstacle: es.Obstacle, silvermate: RobotModel):
    scene = es.Scene([obstacle])
    found = es.certify(silvermate, scene, np.stack([silvermate.home(), silvermate.home(x=3.5)]))
    assert found.broken is not None
    assert found.q is not None
    place = contact_place(silvermate, found.q, found.broken, scene)
    assert place is not None
    depth = max(0.0, -found.broken.clearance) + 1e-3
    assert abs(off(silvermate, found.q, found.broken.link, place)) < depth
    assert abs(place[0] - 2.0) < 0.25
    assert abs(place[1] - 0.3) < 0.25
    assert np.hypot(*(place[:2] - found.q[:2])) > 0.15, "not in the middle of the base"


def test_two_links_and_what_is_not_known(silvermate: RobotModel, bridge_arm: RobotModel):
    q = bridge_arm.home(joints={"shoulder_lift_joint": 1.2, "elbow_joint": 1.5})
    found = es.certify(bridge_arm, es.Scene(), np.stack([bridge_arm.home(), q]))
    assert found.broken is not None
    assert found.q is not None
    place = contact_place(bridge_arm, found.q, found.broken, es.Scene())
    assert place is not None
    for name in (found.broken.link, found.broken.obstacle):
        assert off(bridge_arm, found.q, name, place) < abs(found.broken.clearance) + 1e-3
    wall = es.certify(silvermate, es.Scene([BOX]), np.stack([silvermate.home(), silvermate.home(x=3.5)]))
    assert wall.broken is not None
    assert contact_place(silvermate, silvermate.home(), wall.broken, es.Scene()) is None
    nobody = es.collision.BrokenSegment(0, "nobody", "it", -0.1, "obstacle", certain=True)
    assert contact_place(silvermate, silvermate.home(), nobody, es.Scene([BOX])) is None
