"""Artificial potential field: forces are minus the gradient of the potentials; it is trapped where theory says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flat_world import World, drive, scan, trap
from hypothesis import given
from hypothesis import strategies as st
from refusals import taken
from scipy.optimize import brentq

from workshop.baselines import BaseLimits, PotentialField, PotentialFieldParams
from workshop.baselines.force_fields import attractive_force, nearest_points, repulsive_force

P = PotentialFieldParams(attraction=2.0, conic=1.5, repulsion=0.05, influence=0.8)
FAR = np.array([5.0, 0.0, 0.0])


def test_attraction_by_hand():
    np.testing.assert_allclose(attractive_force(np.array([0.0, 0.0]), np.array([0.3, -0.4]), P), [0.6, -0.8])
    np.testing.assert_allclose(attractive_force(np.array([0.0, 0.0]), np.array([30.0, 40.0]), P), [1.8, 2.4])


@given(st.floats(0.02, 1.2), st.floats(-3.1, 3.1))
def test_repulsion_is_minus_the_gradient_of_its_potential(rho, angle):
    away = np.array([math.cos(angle), math.sin(angle)])

    def potential(r):
        return 0.5 * P.repulsion * max(1.0 / r - 1.0 / P.influence, 0.0) ** 2

    h = 1e-6 * rho
    slope = (potential(rho + h) - potential(rho - h)) / (2.0 * h)
    force = repulsive_force(away[None], np.array([rho]), P)[0]
    np.testing.assert_allclose(force, -slope * away, rtol=1e-4, atol=1e-5)


def test_repulsion_by_hand():
    force = repulsive_force(np.array([[-1.0, 0.0]]), np.array([0.4]), P)
    np.testing.assert_allclose(force, [[-0.05 * (2.5 - 1.25) / 0.16, 0.0]])
    assert not repulsive_force(np.array([[1.0, 0.0]]), np.array([0.81]), P).any()


def test_each_wall_of_a_corridor_has_its_nearest_point():
    s = np.linspace(-2.0, 2.0, 81)
    walls = np.concatenate((np.stack((s, np.full(81, 0.5)), 1), np.stack((s, np.full(81, -0.6)), 1)))
    found = nearest_points(walls)
    np.testing.assert_allclose(sorted(found.tolist()), [[0.0, -0.6], [0.0, 0.5]], atol=1e-12)
    assert nearest_points(np.zeros((0, 2))).shape == (0, 2)


def test_no_net_force_at_the_analytic_minimum():
    limits, p = BaseLimits(), PotentialFieldParams()
    rho = brentq(
        lambda r: p.repulsion * (1.0 / r - 1.0 / p.influence) / r**2 - p.attraction * p.conic, 0.05, p.influence
    )
    world, at = World(circles=[(2.0, 0.0, 0.3)]), np.array([2.0 - 0.3 - limits.radius - rho, 0.0, 0.0])
    method = PotentialField(limits)
    method.update(scan(world, at), at)
    np.testing.assert_allclose(method.force(at, FAR), 0.0, atol=1e-9)
    assert method.command(0.0, at, np.zeros(2), FAR).v == pytest.approx(0.0, abs=1e-9)
    method.update(scan(world, at - [0.1, 0.0, 0.0]), at - [0.1, 0.0, 0.0])
    assert method.force(at - [0.1, 0.0, 0.0], FAR)[0] > 0.1  # and it is stable along the way
    assert method.force(at + np.array([0.05, 0.0, 0.0]), FAR)[0] < -0.1


def test_trapped_in_a_u():
    run = drive(PotentialField(BaseLimits()), trap(), (0.0, 0.05, 0.0), FAR, seconds=16.0, rate=10.0)
    assert not run.arrived
    assert run.commands[-1].status == "blocked"
    assert "no progress" in run.commands[-1].reason
    assert run.poses[:, 0].max() < 2.3
    assert run.clearance > 0.0


def test_parameters_are_checked():
    names = ("attraction", "conic", "repulsion", "influence", "turn_gain")
    values = (0.0, -1.0, np.nan, np.inf, True, None)
    assert taken(PotentialFieldParams, [{name: value} for name in names for value in values]) == []
