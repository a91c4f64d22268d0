"""Kinematics and both proximities equal Pinocchio and brute force at several nodes, for every size and kind of base.

Arrays of eight numbers a row have caught NumPy returning wrong values once; so every size is looked at.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, link_distances, make_scene, random_coordinates, self_distances
from random_robots import random_urdf

from elastic_strips.collision import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from elastic_strips.robot import Kinematics, RobotModel, load_robot

NODES = 5


@pytest.fixture(scope="module", params=["fixed", "omni", "diff_drive"])
def robots(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[RobotModel]:
    """One robot of every size nv = 3 … 16."""
    rng = np.random.default_rng(11)
    base, folder = request.param, tmp_path_factory.mktemp("robots")
    return [
        load_robot(random_urdf(rng, folder, nv - (0 if base == "fixed" else 3), name=f"nv{nv}"), base=base)
        for nv in range(3, 17)
    ]


def test_placements_and_jacobians_equal_pinocchio_at_every_node(robots, rng):
    for robot in robots:
        coordinates = random_coordinates(robot, rng, NODES)
        kin = Kinematics(robot.tree, NODES)
        kin.update(coordinates)
        data = robot.model.createData()
        for n, row in enumerate(coordinates):
            pin.computeJointJacobians(robot.model, data, configuration(robot, row))
            for i in range(1, robot.model.njoints):
                what = f"nv={robot.nv}, node {n}, joint {robot.model.names[i]}"
                R = data.oMi[i].rotation @ robot.tree.align[i]
                np.testing.assert_allclose(kin.T[i, n, :, :3], R, atol=1e-12, err_msg=what)
                np.testing.assert_allclose(kin.T[i, n, :, 3], data.oMi[i].translation, atol=1e-12, err_msg=what)
            J = np.asarray(data.J).reshape(6, robot.nv)
            np.testing.assert_allclose(kin.J[n].T, J, atol=1e-12, err_msg=f"nv={robot.nv}, node {n}: Jacobian")


def test_no_bound_is_above_the_distance_at_any_node(robots, rng):
    for robot in robots:
        scene = make_scene(rng, 5, shapes=("box", "sphere", "capsule", "convex", "cylinder"))
        coordinates = random_coordinates(robot, rng, NODES)
        kin = Kinematics(robot.tree, NODES)
        kin.update(coordinates)
        bodies = BodySet.links(robot)
        obstacles = ObstacleProximity(bodies, influence=0.5)
        obstacles.update(kin, scene)
        own = SelfProximity(bodies, robot.self_pairs, MotionBounds(bodies), influence=0.5)
        own.update(kin)
        assert obstacles.candidates is not None
        rows = obstacles.candidates.rows
        for n, row in enumerate(coordinates):
            q = configuration(robot, row)
            true = link_distances(robot, scene, q)[:, rows]
            what = f"nv={robot.nv}, node {n}"
            assert (obstacles.bound[n] <= true + 1e-6).all(), what
            near = true < 0.4
            np.testing.assert_allclose(obstacles.exact[n][near], true[near], atol=2e-5, err_msg=what)
            if len(robot.self_pairs):
                true = self_distances(robot, q)
                assert (own.bound[n] <= true + 1e-6).all(), what
                near = true < 0.4
                np.testing.assert_allclose(own.exact[n][near], true[near], atol=2e-5, err_msg=what)
