"""Kinematics: placements, Jacobians and point rows of a whole batch equal Pinocchio's, one by one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from brute_force import configuration, random_coordinates
from cases import each_robot

from elastic_strips.robot import Kinematics, RobotModel


def placed(robot: RobotModel, rng: np.random.Generator) -> tuple[np.ndarray, Kinematics]:
    """Coordinate rows (7, nv), and the kinematics at them."""
    coordinates = random_coordinates(robot, rng, 7)
    kin = Kinematics(robot.tree, 3)  # grows
    kin.update(coordinates)
    return coordinates, kin


def reference(robot: RobotModel, row: np.ndarray) -> pin.Data:
    data = robot.model.createData()
    q = configuration(robot, row)
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    return data


def random_points(robot: RobotModel, rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """Nodes, joints and positions in Pinocchio's joint frames."""
    node = rng.integers(0, 7, count)
    joint = rng.integers(0, robot.model.njoints, count)
    return node, joint, rng.uniform(-0.5, 0.5, (count, 3))


@each_robot
def test_placements_equal_forward_kinematics(robot, rng):
    coordinates, kin = placed(robot, rng)
    for n, row in enumerate(coordinates):
        data = reference(robot, row)
        for i in range(robot.model.njoints):
            np.testing.assert_allclose(kin.T[i, n, :, :3], data.oMi[i].rotation @ robot.tree.align[i], atol=1e-12)
            np.testing.assert_allclose(kin.T[i, n, :, 3], data.oMi[i].translation, atol=1e-12)


@each_robot
def test_jacobian_columns_equal_pinocchio(robot, rng):
    coordinates, kin = placed(robot, rng)
    for n, row in enumerate(coordinates):
        np.testing.assert_allclose(kin.J[n].T, reference(robot, row).J, atol=1e-12)


@each_robot
def test_a_smaller_update_after_a_larger_one(robot, rng):
    _, kin = placed(robot, rng)
    coordinates = random_coordinates(robot, rng, 2)
    kin.update(coordinates)
    assert kin.n == 2
    for n, row in enumerate(coordinates):
        np.testing.assert_allclose(kin.J[n].T, reference(robot, row).J, atol=1e-12)


@each_robot
def test_updating_without_jacobians_still_places(robot, rng):
    coordinates, _ = placed(robot, rng)
    kin = Kinematics(robot.tree, 7)
    kin.update(coordinates, jacobians=False)
    last = robot.model.njoints - 1
    np.testing.assert_allclose(kin.T[last, 3, :, 3], reference(robot, coordinates[3]).oMi[last].translation, atol=1e-12)


@each_robot
def test_points_and_to_aligned(robot, rng):
    coordinates, kin = placed(robot, rng)
    _, joint, local = random_points(robot, rng, 12)
    aligned = np.array([robot.tree.align[j].T @ p for j, p in zip(joint, local, strict=True)])
    world = kin.points(joint, aligned)
    assert world.shape == (7, 12, 3)
    T = np.array(pin.SE3.Random().homogeneous)
    for n, row in enumerate(coordinates):
        data = reference(robot, row)
        for k, j in enumerate(joint):
            np.testing.assert_allclose(world[n, k], data.oMi[int(j)].act(local[k]), atol=1e-12)
            frame = kin.T[j, n] @ robot.tree.to_aligned(int(j), T)
            np.testing.assert_allclose(frame, (data.oMi[int(j)].homogeneous @ T)[:3], atol=1e-12)


def point_jacobians(kin, node, joint, point):
    """Point Jacobians (K, 3, nv): how fast points move along each axis of the world."""
    return np.stack([kin.directional(node, joint, point, np.tile(axis, (len(node), 1))) for axis in np.eye(3)], axis=1)


@each_robot
def test_point_jacobians_equal_finite_differences(robot, rng):
    coordinates, kin = placed(robot, rng)
    node, joint, local = random_points(robot, rng, 25)
    points = np.array(
        [reference(robot, coordinates[n]).oMi[int(j)].act(p) for n, j, p in zip(node, joint, local, strict=True)]
    )
    J = point_jacobians(kin, node, joint, points)
    assert J.shape == (25, 3, robot.nv)
    h = 1e-6
    for k in range(25):
        q = configuration(robot, coordinates[node[k]])
        for i in range(robot.nv):
            ends = []
            for sign in (1, -1):
                v = np.zeros(robot.nv)
                v[i] = sign * h
                data = robot.model.createData()
                pin.forwardKinematics(robot.model, data, pin.integrate(robot.model, q, v))
                ends.append(data.oMi[int(joint[k])].act(local[k]))
            np.testing.assert_allclose(J[k, :, i], (ends[0] - ends[1]) / (2 * h), atol=1e-8)


@each_robot
def test_point_jacobians_equal_frame_jacobians(robot, rng):
    coordinates, kin = placed(robot, rng)
    for n in (0, 6):
        data = reference(robot, coordinates[n])
        for frame_id in rng.integers(0, robot.model.nframes, 8):
            frame = robot.model.frames[int(frame_id)]
            full = pin.getFrameJacobian(robot.model, data, int(frame_id), pin.LOCAL_WORLD_ALIGNED)
            point = data.oMf[int(frame_id)].translation[None]
            joint = np.array([frame.parentJoint])
            np.testing.assert_allclose(point_jacobians(kin, np.array([n]), joint, point)[0], full[:3], atol=1e-12)


@each_robot
def test_directional_is_the_projected_jacobian(robot, rng):
    _, kin = placed(robot, rng)
    node, joint, point = random_points(robot, rng, 30)
    direction = rng.normal(size=(30, 3))
    rows = kin.directional(node, joint, point, direction)
    expected = np.einsum("ki,kiv->kv", direction, point_jacobians(kin, node, joint, point))
    np.testing.assert_allclose(rows, expected, atol=1e-12)
