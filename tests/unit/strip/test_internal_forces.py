"""Internal forces: minus the gradient of their potential, and the Gauss–Newton matrix of their residuals."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from brute_force import configuration, random_coordinates
from cases import each_robot

from elastic_strips.robot import RobotModel
from elastic_strips.strip.forces import add_elastic, add_joint_limits, add_posture
from elastic_strips.strip.paper.equations import elastic_force, elastic_torque
from elastic_strips.strip.solver import System

Potential = Callable[[np.ndarray], float]


def gradient(robot: RobotModel, coordinates: np.ndarray, potential: Potential, h: float = 1e-5) -> np.ndarray:
    """∂V over the nodes' tangents (N, nv) by central differences."""
    out = np.zeros_like(coordinates)
    for n in range(len(coordinates)):
        for k in range(robot.nv):
            value = []
            for sign in (1.0, -1.0):
                v = np.zeros_like(coordinates)
                v[n, k] = sign * h
                value.append(potential(robot.space.integrate(coordinates, v)))
            out[n, k] = (value[0] - value[1]) / (2 * h)
    return out


def assert_is_minus_gradient(force: np.ndarray, slope: np.ndarray, tolerance: float = 1e-5) -> None:
    assert np.abs(slope).max() > 1e-3, "nothing to compare"
    np.testing.assert_allclose(force, -slope, atol=tolerance * np.abs(slope).max())


def residual_jacobian(
    robot: RobotModel, coordinates: np.ndarray, residual: Callable[[np.ndarray], np.ndarray], h: float = 1e-6
) -> np.ndarray:
    """Jacobian (R, N·nv) of residuals over the tangents, by central differences."""
    columns = []
    for n in range(len(coordinates)):
        for k in range(robot.nv):
            v = np.zeros_like(coordinates)
            v[n, k] = h
            up, down = residual(robot.space.integrate(coordinates, v)), residual(robot.space.integrate(coordinates, -v))
            columns.append((up - down) / (2 * h))
    return np.array(columns).T


def dense(system: System) -> np.ndarray:
    """The block tridiagonal matrix as a full one (N·nv, N·nv)."""
    n, nv = system.force.shape
    out = np.zeros((n * nv, n * nv))
    for j in range(n):
        out[j * nv : (j + 1) * nv, j * nv : (j + 1) * nv] = system.diagonal[j]
    for j in range(n - 1):
        block = system.upper[j]
        out[j * nv : (j + 1) * nv, (j + 1) * nv : (j + 2) * nv] = block
        out[(j + 1) * nv : (j + 2) * nv, j * nv : (j + 1) * nv] = block.T
    return out


def assert_positive(system: System) -> np.ndarray:
    matrix = dense(system)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert np.linalg.eigvalsh(matrix).min() > -1e-9 * max(1.0, np.abs(matrix).max())
    return matrix


@pytest.fixture
def coordinates(robot: RobotModel, rng: np.random.Generator) -> np.ndarray:
    """Five nodes whose neighbours lie within a turn of two radians."""
    rows = [random_coordinates(robot, rng, 1)[0]]
    for _ in range(4):
        step = rng.normal(size=robot.nv) * 0.3
        if robot.space.planar:
            step[2] = rng.uniform(-2.0, 2.0)
        rows.append(np.clip(robot.space.integrate(rows[-1], step), robot.space.lower, robot.space.upper))
    return np.array(rows)


def springs(robot: RobotModel, weight: np.ndarray) -> Potential:
    """½ Σ vᵀ W v with v from Pinocchio."""
    import pinocchio as pin

    def potential(coordinates: np.ndarray) -> float:
        q = [configuration(robot, row) for row in coordinates]
        v = [pin.difference(robot.model, a, b) for a, b in pairwise(q)]
        return 0.5 * float(sum((weight * x) @ x for x in v))

    return potential


def test_elastic_force_is_minus_its_gradient(robot, coordinates, rng):
    weight = rng.uniform(0.1, 2.0, robot.nv)
    system = System(len(coordinates), robot.nv)
    v = robot.space.difference(coordinates[:-1], coordinates[1:])
    add_elastic(system, robot.space, v, weight)
    energy = system.energies["elastic"]
    assert energy == pytest.approx(springs(robot, weight)(coordinates), rel=1e-9)
    assert system.energies == {"elastic": energy}
    assert_is_minus_gradient(system.force, gradient(robot, coordinates, springs(robot, weight)))


def test_elastic_matrix_is_gauss_newton(robot, coordinates, rng):
    weight = rng.uniform(0.1, 2.0, robot.nv)
    system = System(len(coordinates), robot.nv)
    add_elastic(system, robot.space, robot.space.difference(coordinates[:-1], coordinates[1:]), weight)

    def residual(c: np.ndarray) -> np.ndarray:
        return (np.sqrt(weight) * robot.space.difference(c[:-1], c[1:])).ravel()

    J = residual_jacobian(robot, coordinates, residual)
    np.testing.assert_allclose(assert_positive(system), J.T @ J, atol=1e-6)
    np.testing.assert_allclose(system.force.ravel(), -J.T @ residual(coordinates), atol=1e-6)


def test_rolling_penalises_sideways_travel_alone(silvermate, rng):
    coordinates = random_coordinates(silvermate, rng, 4)
    system = System(4, 10)
    v = silvermate.space.difference(coordinates[:-1], coordinates[1:])
    weight = np.zeros(10)
    weight[1] = 200.0
    add_elastic(system, silvermate.space, v, weight)
    assert system.energies["elastic"] == pytest.approx(100.0 * float((v[:, 1] ** 2).sum()))
    assert_is_minus_gradient(system.force, gradient(silvermate, coordinates, springs(silvermate, weight)))
    np.testing.assert_array_equal(system.force[:, 3:], 0.0)
    assert_positive(system)
    drivable = np.zeros((3, 10))
    drivable[:, 0] = 0.5, 1.0, -0.3
    drivable[:, 2] = 0.3, 0.0, -1.0
    still = System(4, 10)
    add_elastic(still, silvermate.space, drivable, weight)
    assert still.energies["elastic"] == 0.0


def test_springs_spread_nodes_evenly(silvermate):
    """Eq. 4 does not: the reason for springs."""
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (3, 1))
    coordinates[:, 0] = 0.0, 0.9, 1.0
    system = System(3, 10)
    add_elastic(system, silvermate.space, silvermate.space.difference(coordinates[:-1], coordinates[1:]), np.ones(10))
    assert system.force[1, 0] == pytest.approx(-0.8)
    points = np.zeros((3, 1, 3))
    points[:, 0, 0] = 0.0, 0.9, 1.0
    np.testing.assert_allclose(elastic_force(points, 1.0), 0.0, atol=1e-15)


def limits(robot: RobotModel, k_l: float, margin: float) -> Potential:
    def potential(coordinates: np.ndarray) -> float:
        total = 0.0
        for row in coordinates:
            for k in range(robot.nv):
                for gap in (row[k] - robot.space.lower[k], robot.space.upper[k] - row[k]):
                    if np.isfinite(gap) and gap < margin:
                        total += 0.5 * k_l * (margin - gap) ** 2
        return total

    return potential


@each_robot
def test_joint_limit_force_is_minus_its_gradient(robot, rng):
    coordinates = random_coordinates(robot, rng, 6)
    margin, k_l = 0.11, 3.0
    coordinates[0] = np.where(np.isfinite(robot.space.lower), robot.space.lower + 0.01, coordinates[0])
    coordinates[1] = np.where(np.isfinite(robot.space.upper), robot.space.upper - 0.02, coordinates[1])
    system = System(6, robot.nv)
    add_joint_limits(system, robot.space, coordinates, k_l=k_l, margin=margin)
    assert system.energies["joint_limits"] == pytest.approx(limits(robot, k_l, margin)(coordinates), rel=1e-12)
    assert_is_minus_gradient(system.force, gradient(robot, coordinates, limits(robot, k_l, margin)))
    assert (system.force[0] >= 0).all()
    assert (system.force[1] <= 0).all()
    assert_positive(system)
    b = robot.space.base_nv
    np.testing.assert_array_equal(system.force[:, :b], 0.0)


def test_joint_limits_far_away_do_nothing(silvermate):
    system = System(2, 10)
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home(arm_1_joint=1.0, arm_4_joint=1.0)), (2, 1))
    add_joint_limits(system, silvermate.space, coordinates, k_l=1.0, margin=0.01)
    assert system.energies["joint_limits"] == 0.0
    np.testing.assert_array_equal(system.force, 0.0)
    np.testing.assert_array_equal(system.diagonal, 0.0)


def test_joint_limit_matrix_is_the_hessian(silvermate):
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (1, 1))
    coordinates[0, 3] = silvermate.space.lower[3] + 0.01
    system = System(1, 10)
    add_joint_limits(system, silvermate.space, coordinates, k_l=2.5, margin=0.05)
    expected = np.zeros((10, 10))
    expected[3, 3] = 2.5
    np.testing.assert_array_equal(system.diagonal[0], expected)


def test_joint_limit_matrix_between_two_near_limits(gantry):
    """A range narrower than twice the margin: both springs act, so the stiffness is twice the gain."""
    coordinates = gantry.space.to_coordinates(gantry.home_q)[None].copy()
    coordinates[0, 0] = 0.075
    system = System(1, 4)
    add_joint_limits(system, gantry.space, coordinates, k_l=1.0, margin=0.3)
    assert system.diagonal[0, 0, 0] == 2.0


@each_robot
def test_posture_force_is_minus_its_gradient(robot, rng):
    b = robot.space.base_nv
    coordinates, target = random_coordinates(robot, rng, 5), random_coordinates(robot, rng, 5)
    k_p = np.where(np.arange(robot.nv) < b, 0.0, rng.uniform(0.1, 1.0, robot.nv))

    def potential(c: np.ndarray) -> float:
        off = c - target
        circular = np.r_[np.zeros(b, dtype=bool), robot.space.circular]
        off[:, circular] = np.angle(np.exp(1j * off[:, circular]))
        return 0.5 * float((k_p * off**2).sum())

    system = System(5, robot.nv)
    add_posture(system, robot.space, coordinates, target, k_p=k_p)
    assert system.energies["posture"] == pytest.approx(potential(coordinates))
    assert_is_minus_gradient(system.force, gradient(robot, coordinates, potential))
    np.testing.assert_allclose(assert_positive(system), np.diag(np.tile(k_p, 5)), atol=1e-15)


def test_posture_takes_the_short_way_of_a_continuous_joint(gantry):
    coordinates = gantry.space.to_coordinates(gantry.home(spin=3.0))[None]
    target = gantry.space.to_coordinates(gantry.home(spin=-3.0))
    system = System(1, 4)
    add_posture(system, gantry.space, coordinates, target, k_p=np.ones(4))
    spin = gantry.joint_names.index("spin")
    assert system.force[0, spin] == pytest.approx(2 * np.pi - 6.0)


def test_forces_add_up(silvermate, rng):
    coordinates = random_coordinates(silvermate, rng, 4)
    v = silvermate.space.difference(coordinates[:-1], coordinates[1:])
    one, two, both = System(4, 10), System(4, 10), System(4, 10)
    sideways = 7.0 * np.eye(10)[1]
    add_elastic(one, silvermate.space, v, np.ones(10))
    add_elastic(two, silvermate.space, v, sideways)
    add_elastic(both, silvermate.space, v, np.ones(10))
    add_elastic(both, silvermate.space, v, sideways)
    np.testing.assert_allclose(both.force, one.force + two.force)
    np.testing.assert_allclose(dense(both), dense(one) + dense(two))
    both.clear()
    assert not both.force.any()
    assert not both.diagonal.any()
    assert not both.upper.any()
    assert both.energies == {}


def test_rows_of_the_same_node_add_up(rng):
    system, nv = System(5, 6), 6
    node = np.array([0, 0, 2, 3, 3, 3])
    rows, force, stiffness = rng.normal(size=(6, nv)), rng.normal(size=6), rng.uniform(0.1, 1, 6)
    system.add_rows(node, rows, force, stiffness)
    for n in range(5):
        mine = node == n
        np.testing.assert_allclose(system.force[n], force[mine] @ rows[mine], atol=1e-12)
        np.testing.assert_allclose(system.diagonal[n], rows[mine].T @ np.diag(stiffness[mine]) @ rows[mine], atol=1e-12)
    system.add_rows(node[:0], rows[:0], force[:0], stiffness[:0])


def eq4(points: np.ndarray, k_c: float) -> np.ndarray:
    """Eq. 4, node by node, as printed: k_c [ d⁻/(d⁻+d⁺) (p⁺ − p⁻) − (p − p⁻) ]."""
    out = np.zeros_like(points)
    for j in range(1, len(points) - 1):
        for i in range(points.shape[1]):
            before, here, after = points[j - 1, i], points[j, i], points[j + 1, i]
            d_before, d_after = np.linalg.norm(here - before), np.linalg.norm(after - here)
            share = d_before / (d_before + d_after)
            out[j, i] = k_c * (share * (after - before) - (here - before))
    return out


def test_elastic_force_is_eq_4(rng):
    points = rng.normal(size=(7, 4, 3))
    np.testing.assert_allclose(elastic_force(points, 0.5), eq4(points, 0.5), atol=1e-14)
    np.testing.assert_array_equal(elastic_force(points, 0.5)[[0, -1]], 0.0)


def test_elastic_force_of_coinciding_points_is_zero():
    points = np.zeros((4, 2, 3))
    np.testing.assert_array_equal(elastic_force(points, 0.5), 0.0)
    np.testing.assert_array_equal(elastic_torque(np.zeros(4), points[:, 0], 0.5), 0.0)


def test_contraction_torque_is_eq_4_of_the_heading(rng):
    points = np.cumsum(rng.uniform(0.1, 1.0, (6, 3)), axis=0)
    yaw = np.array([3.0, 3.1, -3.1, -2.9, -3.0, 3.0])
    torque = elastic_torque(yaw, points, 0.5)
    unwrapped = np.unwrap(yaw)
    for j in range(1, 5):
        d0, d1 = np.linalg.norm(points[j] - points[j - 1]), np.linalg.norm(points[j + 1] - points[j])
        share = d0 / (d0 + d1)
        expected = 0.5 * (share * (unwrapped[j + 1] - unwrapped[j - 1]) - (unwrapped[j] - unwrapped[j - 1]))
        assert torque[j] == pytest.approx(expected, abs=1e-12)
    assert torque[0] == torque[-1] == 0.0
