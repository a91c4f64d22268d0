"""Explicit update: the paper's Eqs. 8–9 written out, and the bound on the turn."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each

from elastic_strips.strip.paper.equations import explicit_step

ALPHA = np.r_[0.0, 0.0, 0.0, np.full(4, 0.25)]


def step(torque: np.ndarray, force: np.ndarray, yaw: np.ndarray, tilt: float = 1.0, **options: object) -> np.ndarray:
    settings = {"planar": True, "alpha": ALPHA, "transfer_tilt": tilt, "yaw": yaw} | options
    return explicit_step(torque, force, **settings)


def test_displacements_are_proportional(rng):
    """δθ = α τ; δx = f_x and δy = f_y in the world; δφ = α_m τ_m with α_m a quarter of the transfer tilt."""
    torque, force = 0.1 * rng.normal(size=(5, 7)), rng.normal(size=(5, 3))
    yaw = np.array([0.0, 0.1, 0.3, 0.2, 0.1])
    delta = step(torque, force, yaw)
    for n in range(1, 4):
        np.testing.assert_allclose(delta[n, 3:], 0.25 * torque[n, 3:])
        c, s = np.cos(yaw[n]), np.sin(yaw[n])
        np.testing.assert_allclose(np.array([[c, -s], [s, c]]) @ delta[n, :2], force[n, :2], atol=1e-12)
        assert delta[n, 2] == pytest.approx(0.25 * torque[n, 2])
    np.testing.assert_array_equal(delta[[0, -1]], 0.0)


@each("tilt", [0.2, np.pi / 6, np.pi / 3])
def test_no_turn_exceeds_the_transfer_tilt(tilt, rng):
    yaw = rng.uniform(-np.pi, np.pi, 40)
    delta = step(rng.normal(size=(40, 7)) * 50.0, np.zeros((40, 3)), yaw, tilt)
    assert np.abs(delta[:, 2]).max() <= tilt + 1e-12
    calm = np.full(40, 0.3)
    delta = step(np.full((40, 7), 100.0), np.zeros((40, 3)), calm, tilt)
    np.testing.assert_allclose(delta[1:-1, 2], tilt)


def test_headings_stay_within_the_tilt_of_their_neighbours(rng):
    """An update does not carry a heading further from its neighbours' than the transfer tilt."""
    tilt = 0.4
    yaw = np.cumsum(rng.uniform(-0.1, 0.1, 30))
    for _ in range(20):
        delta = step(rng.normal(size=(30, 7)) * 10.0, np.zeros((30, 3)), yaw, tilt)
        new = yaw + delta[:, 2]
        for n in range(1, 29):
            for other in (yaw[n - 1], yaw[n + 1]):
                was, now = abs(yaw[n] - other), abs(new[n] - other)
                assert now <= max(tilt, was) + 1e-9


def test_a_fixed_base_has_joints_only(rng):
    torque = rng.normal(size=(4, 3))
    delta = explicit_step(
        torque, np.zeros((4, 3)), planar=False, alpha=np.full(3, 0.5), transfer_tilt=1.0, yaw=np.zeros(4)
    )
    np.testing.assert_allclose(delta[1:-1], 0.5 * torque[1:-1])
    np.testing.assert_array_equal(delta[[0, -1]], 0.0)


def test_inputs_are_not_changed(rng):
    torque, force, yaw = rng.normal(size=(4, 7)), rng.normal(size=(4, 3)), rng.normal(size=4)
    kept = [a.copy() for a in (torque, force, yaw)]
    step(torque, force, yaw)
    for before, after in zip(kept, (torque, force, yaw), strict=True):
        np.testing.assert_array_equal(before, after)
