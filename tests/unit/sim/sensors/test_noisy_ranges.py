"""Errors of range: statistics of noise and losses, what is near, far, or not known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_strips.sim.sensors import LaserParams
from elastic_strips.sim.sensors.devices import noisy_ranges

EXACT = LaserParams(noise=0.0, noise_ratio=0.0, dropout=0.0, range_min=0.2, range_max=5.0)


def test_an_exact_device():
    got = noisy_ranges(np.array([0.1, 0.2, 3.0, 5.0, 5.01, np.inf, np.nan]), EXACT, np.random.default_rng(0))
    np.testing.assert_array_equal(got, [np.nan, 0.2, 3.0, 5.0, np.inf, np.inf, np.nan])


def test_what_is_near_reads_as_the_shortest_range_where_the_device_does_so():
    got = noisy_ranges(np.array([0.0, 0.19, 0.3]), replace(EXACT, near_reads_min=True), np.random.default_rng(0))
    np.testing.assert_array_equal(got, [0.2, 0.2, 0.3])


@pytest.mark.parametrize("distance", [1.0, 4.0])
def test_noise_has_the_size_that_was_asked_for(distance):
    params = replace(EXACT, noise=0.01, noise_ratio=0.005)
    error = noisy_ranges(np.full(20_000, distance), params, np.random.default_rng(1)) - distance
    sigma = 0.01 + 0.005 * distance
    assert abs(error.mean()) < 4 * sigma / np.sqrt(20_000)
    assert error.std() == pytest.approx(sigma, rel=0.02)  # the cut at three takes 0.7 % off
    assert np.abs(error).max() <= 3.0 * sigma + 1e-12
    assert np.abs(error).max() > 2.9 * sigma


def test_ranges_stay_within_what_the_device_can_tell():
    params = replace(EXACT, noise=0.1)
    for distance in (0.2, 5.0):
        got = noisy_ranges(np.full(1000, distance), params, np.random.default_rng(1))
        assert got.min() >= 0.2
        assert got.max() <= 5.0


def test_losses_are_as_frequent_as_was_asked_for():
    got = noisy_ranges(np.tile([1.0, np.inf], 20_000), replace(EXACT, dropout=0.1), np.random.default_rng(2))
    for kind in (got[::2], got[1::2]):  # a beam that meets nothing can be lost too
        assert np.isnan(kind).mean() == pytest.approx(0.1, abs=0.01)


def test_one_range_does_not_change_the_noise_of_another():
    params = replace(EXACT, noise=0.01, dropout=0.2)
    one = noisy_ranges(np.array([1.0, 2.0, 3.0]), params, np.random.default_rng(3))
    other = noisy_ranges(np.array([np.inf, 2.0, np.nan]), params, np.random.default_rng(3))
    assert one[1] == other[1] or (np.isnan(one[1]) and np.isnan(other[1]))
