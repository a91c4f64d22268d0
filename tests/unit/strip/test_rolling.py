"""Rolling projection: afterwards the wheels can follow, and little else has changed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from brute_force import configuration
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.robot import RobotModel
from elastic_strips.strip.solver import ROLLING_TOLERANCE, project_rolling


def wavy(robot: RobotModel, seed: int, nodes: int, noise: float) -> np.ndarray:
    """A smooth forward path that bends up to 0.2 rad a segment, its nodes pushed off by ``noise`` [m and rad]."""
    rng = np.random.default_rng(seed)
    coordinates = np.tile(robot.space.to_coordinates(robot.home_q), (nodes, 1))
    bend = np.cumsum(rng.normal(size=nodes) * 0.05).clip(-0.2, 0.2)
    coordinates[0, 2] = rng.uniform(-np.pi, np.pi)
    for j in range(1, nodes):
        v = np.zeros(robot.nv)
        v[0], v[2] = rng.uniform(0.08, 0.2), bend[j]
        coordinates[j] = robot.space.integrate(coordinates[j - 1], v)
    coordinates[1:-1, :3] += rng.normal(size=(nodes - 2, 3)) * noise
    coordinates[:, 3:] += 0.01 * rng.normal(size=(nodes, robot.nv - 3))
    return coordinates


def slip(robot: RobotModel, coordinates: np.ndarray) -> float:
    """Largest |v_y| of ``pin.difference`` between neighbours."""
    q = [configuration(robot, row) for row in coordinates]
    return max(abs(float(pin.difference(robot.model, q[j], q[j + 1])[1])) for j in range(len(q) - 1))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), nodes=st.integers(3, 70), noise=st.sampled_from([0.0, 1e-4, 0.005, 0.02]))
def test_any_wavy_strip_becomes_drivable(silvermate, seed, nodes, noise):
    coordinates = wavy(silvermate, seed, nodes, noise)
    before = coordinates.copy()
    projected, residual = project_rolling(silvermate.space, coordinates)
    np.testing.assert_array_equal(coordinates, before)
    assert residual <= ROLLING_TOLERANCE
    assert slip(silvermate, projected) <= ROLLING_TOLERANCE + 1e-12
    np.testing.assert_array_equal(projected[[0, -1]], before[[0, -1]])
    np.testing.assert_array_equal(projected[:, 3:], before[:, 3:])
    assert np.abs(projected[:, :3] - before[:, :3]).max() <= 1e-6 + 12.0 * noise + 12.0 * slip(silvermate, before)
    again, _ = project_rolling(silvermate.space, projected)
    np.testing.assert_array_equal(again, projected)


def test_it_moves_about_as_little_as_possible(silvermate):
    """One Newton step of the metric diag(1, 1, 0.1): against a constrained least-squares solution."""
    from scipy.optimize import minimize

    coordinates = wavy(silvermate, 3, 6, 2e-3)
    projected, _ = project_rolling(silvermate.space, coordinates)
    weight = np.tile([1.0, 1.0, 0.1], 4)

    def moved(x: np.ndarray) -> np.ndarray:
        out = coordinates.copy()
        out[1:-1, :3] += x.reshape(4, 3)
        return out

    best = minimize(
        lambda x: 1e6 * float(weight @ x**2),
        np.zeros(12),
        constraints={
            "type": "eq",
            "fun": lambda x: 1e3 * silvermate.space.difference(moved(x)[:-1], moved(x)[1:])[:, 1],
        },
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 300},
    )
    assert best.success
    found = (projected - coordinates)[1:-1, :3].ravel()
    assert float(weight @ found**2) <= 1.05 * float(weight @ best.x**2) + 1e-12


def test_a_sideways_shift_becomes_an_s_curve(silvermate):
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (30, 1))
    coordinates[:, 0] = np.linspace(0.0, 3.0, 30)
    coordinates[:, 1] = 0.4 * np.linspace(0.0, 1.0, 30)
    assert slip(silvermate, coordinates) > 0.01
    projected, residual = project_rolling(silvermate.space, coordinates)
    assert residual <= ROLLING_TOLERANCE
    assert slip(silvermate, projected) <= 1.1e-9
    assert np.abs(projected[:, 2]).max() < 0.8


def test_turning_in_place_and_driving_backwards_are_drivable(silvermate):
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (7, 1))
    coordinates[:, 2] = 0.0, 0.5, 1.0, 1.5, 1.5, 1.5, 1.5
    coordinates[4:, 1] = -0.2, -0.4, -0.6
    projected, residual = project_rolling(silvermate.space, coordinates)
    assert residual <= ROLLING_TOLERANCE or np.abs(projected - coordinates).max() < 0.1
    drive = coordinates[3:].copy()
    drive[:, 2] = np.pi / 2
    projected, residual = project_rolling(silvermate.space, drive)
    np.testing.assert_array_equal(projected, drive)
    assert residual < 1e-15


def test_what_cannot_be_projected_says_so(silvermate):
    """Two fixed poses side by side: no node in between can make both segments drivable exactly by a small step."""
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (3, 1))
    coordinates[:, 1] = 0.0, 0.3, 0.6
    _, residual = project_rolling(silvermate.space, coordinates, iterations=1)
    assert residual > ROLLING_TOLERANCE


def test_two_nodes_cannot_be_projected(silvermate):
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (2, 1))
    coordinates[1, :2] = 0.5, 0.1
    projected, residual = project_rolling(silvermate.space, coordinates)
    np.testing.assert_array_equal(projected, coordinates)
    assert residual > 0.05


def test_one_node_is_drivable(silvermate):
    coordinates = silvermate.space.to_coordinates(silvermate.home_q)[None]
    projected, residual = project_rolling(silvermate.space, coordinates)
    np.testing.assert_array_equal(projected, coordinates)
    assert residual == 0.0
