"""Configuration space: the batched twins equal Pinocchio, also near zero and near half a turn."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, random_coordinates
from cases import each_robot, refused

from elastic_strips.errors import RobotError
from elastic_strips.robot import ConfigurationSpace, RobotModel
from elastic_strips.robot.space import wrap_angle

ANGLES = (0.0, 1e-9, 1e-6, 9.9e-5, 1.01e-4, 1e-3, 0.1, 1.5, 3.0, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-8)


def turned(robot: RobotModel, start: np.ndarray, angle: float) -> np.ndarray:
    """``start`` (nv,) with yaw and continuous joints turned by ``angle`` and everything else moved a little."""
    space = robot.space
    end = start + 0.1
    if space.planar:
        end[2] = start[2] + angle
    circular = np.flatnonzero(space.circular) + space.base_nv
    end[circular] = start[circular] - angle
    return np.clip(end, space.lower, space.upper)


def pairs(robot: RobotModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Coordinate rows (K, nv) to compare between: random ones, and ones whose angles differ by special values."""
    a = random_coordinates(robot, rng, 60)
    b = random_coordinates(robot, rng, 60)
    special = [turned(robot, row, sign * angle) for row in a[:3] for angle in ANGLES for sign in (1, -1)]
    first = np.repeat(a[:3], 2 * len(ANGLES), axis=0)
    return np.vstack((a, first)), np.vstack((b, special))


def configurations(robot: RobotModel, *coordinate_arrays: np.ndarray) -> list[np.ndarray]:
    return [np.array([configuration(robot, row) for row in coordinates]) for coordinates in coordinate_arrays]


@each_robot
def test_from_coordinate_gives_pinocchios_configuration(robot, rng):
    coordinates = random_coordinates(robot, rng, 20)
    q = robot.space.from_coordinates(coordinates)
    np.testing.assert_allclose(q, [configuration(robot, row) for row in coordinates], atol=1e-15)
    for row in q:
        np.testing.assert_allclose(pin.normalize(robot.model, row), row, atol=1e-12)


@each_robot
def test_coordinate_round_trip_keeps_shape(robot, rng):
    coordinates = random_coordinates(robot, rng, 12).reshape(3, 4, -1)
    q = robot.space.from_coordinates(coordinates)
    assert q.shape == (3, 4, robot.nq)
    np.testing.assert_allclose(robot.space.to_coordinates(q), coordinates, atol=1e-12)
    np.testing.assert_allclose(robot.space.to_coordinates(q[0, 0]), coordinates[0, 0], atol=1e-12)


@each_robot
def test_difference_equals_pinocchio(robot, rng):
    a, b = pairs(robot, rng)
    got = robot.space.difference(a, b)
    expected = np.array([pin.difference(robot.model, x, y) for x, y in zip(*configurations(robot, a, b), strict=True)])
    np.testing.assert_allclose(got, expected, atol=1e-7)  # Pinocchio's own digits near 0 and near π
    turn = np.abs(wrap_angle(b - a))
    plain = (((turn > 1e-2) | (turn == 0.0)) & (turn < np.pi - 1e-2)).all(axis=1)
    assert plain.sum() > 20
    np.testing.assert_allclose(got[plain], expected[plain], atol=1e-11)


@each_robot
def test_integrate_equals_pinocchio(robot, rng):
    a, b = pairs(robot, rng)
    v = robot.space.difference(a, b)
    for scale in (1.0, -0.3, 2.7):
        got = robot.space.from_coordinates(robot.space.integrate(a, scale * v))
        expected = [pin.integrate(robot.model, configuration(robot, x), scale * w) for x, w in zip(a, v, strict=True)]
        np.testing.assert_allclose(got, expected, atol=1e-10)


@each_robot
def test_interpolate_equals_pinocchio(robot, rng):
    a, b = pairs(robot, rng)
    ends = configurations(robot, a, b)
    circular = np.flatnonzero(robot.space.circular) + robot.space.base_nv
    half_turn = (np.abs(wrap_angle(b - a)[:, circular]) > np.pi - 2e-6).any(axis=1)
    for s in (0.0, 0.25, 0.5, 1.0):
        got = robot.space.from_coordinates(robot.space.interpolate(a, b, s))
        by_twist = [
            pin.integrate(robot.model, x, s * pin.difference(robot.model, x, y)) for x, y in zip(*ends, strict=True)
        ]
        np.testing.assert_allclose(got, by_twist, atol=1e-7)
        # pin.interpolate leaves a continuous joint where it is when its turn is within 1e-6 of π
        expected = np.array([pin.interpolate(robot.model, x, y, s) for x, y in zip(*ends, strict=True)])
        np.testing.assert_allclose(got[~half_turn], expected[~half_turn], atol=1e-7)


@each_robot
def test_interpolate_takes_one_fraction_per_row(robot, rng):
    a, b = pairs(robot, rng)
    s = np.linspace(0.0, 1.0, len(a))
    rows = [robot.space.interpolate(a[k], b[k], s[k]) for k in range(len(a))]
    np.testing.assert_allclose(robot.space.interpolate(a, b, s), rows, atol=1e-14)


@each_robot
def test_integrating_a_difference_arrives(robot, rng):
    a, b = pairs(robot, rng)
    got = robot.space.from_coordinates(robot.space.integrate(a, robot.space.difference(a, b)))
    np.testing.assert_allclose(got, robot.space.from_coordinates(b), atol=1e-11)


@each_robot
def test_difference_jacobians_equal_pinocchio(robot, rng):
    space = robot.space
    if not space.planar:
        pytest.skip("a fixed base has none")
    a, b = pairs(robot, rng)
    near_half_turn = np.abs(np.abs(wrap_angle(b[:, 2] - a[:, 2])) - np.pi) < 1e-4  # Pinocchio's own digits end there
    a, b = a[~near_half_turn], b[~near_half_turn]
    v = space.difference(a, b)
    first, second = space.base_difference_jacobians(v)
    for k in range(len(a)):
        qa, qb = configuration(robot, a[k]), configuration(robot, b[k])
        J0, J1 = pin.dDifference(robot.model, qa, qb)
        np.testing.assert_allclose(first[k], J0[:3, :3], atol=1e-6)
        np.testing.assert_allclose(second[k], J1[:3, :3], atol=1e-6)
        np.testing.assert_allclose(J0[3:, 3:], -np.eye(space.nv - 3), atol=1e-9)
        np.testing.assert_allclose(J1[3:, 3:], np.eye(space.nv - 3), atol=1e-9)


def test_difference_jacobians_equal_finite_differences(silvermate, rng):
    """Independent of Pinocchio's conditioning: also at tiny and at nearly half turns."""
    space, h = silvermate.space, 1e-6
    for angle in (0.0, 1e-5, 9.9e-5, 1.01e-4, 0.3, -2.0, 3.0):
        a = random_coordinates(silvermate, rng, 1)[0]
        b = turned(silvermate, a, angle)
        first, second = space.base_difference_jacobians(space.difference(a, b))
        for k in range(3):
            e = np.zeros(space.nv)
            e[k] = h
            one = (space.difference(space.integrate(a, e), b) - space.difference(space.integrate(a, -e), b)) / (2 * h)
            two = (space.difference(a, space.integrate(b, e)) - space.difference(a, space.integrate(b, -e))) / (2 * h)
            np.testing.assert_allclose(first[:, k], one[:3], atol=1e-8)
            np.testing.assert_allclose(second[:, k], two[:3], atol=1e-8)


def test_wrap_angle():
    angles = np.array([0.0, np.pi, -np.pi, 3 * np.pi, 2 * np.pi, -1e-12, 7.0])
    np.testing.assert_allclose(wrap_angle(angles), [0.0, np.pi, np.pi, np.pi, 0.0, -1e-12, 7.0 - 2 * np.pi], atol=1e-14)


def test_limits_follow_the_model(gantry, rover):
    np.testing.assert_array_equal(gantry.space.lower, [-0.2, 0.1, -np.inf, -1.5])
    np.testing.assert_array_equal(gantry.space.upper, [0.35, 0.9, np.inf, 2.5])
    np.testing.assert_array_equal(rover.space.lower[:3], [-np.inf] * 3)
    assert not rover.space.lower.flags.writeable


def test_joints_of_more_than_one_freedom_are_refused():
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    with refused(RobotError, "'ball'"):
        ConfigurationSpace.from_model(model)
