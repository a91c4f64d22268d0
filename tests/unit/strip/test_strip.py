"""Strip: a frozen, checked chain of configurations."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, random_configurations
from cases import each_robot, refused

from elastic_strips.errors import ConfigurationError
from elastic_strips.strip import Strip


@each_robot
def test_nodes_are_copied_and_read_only(robot, rng):
    q = random_configurations(robot, rng, 4)
    strip = Strip(robot, q)
    q[0] = 0.0
    assert len(strip) == 4
    assert strip.q[0].any()
    with refused(ValueError, "read-only"):
        strip.q[0, 0] = 1.0
    with refused(ValueError, "read-only"):
        strip.coordinates[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        strip.q = q


@pytest.mark.parametrize("count", [0, 1])
def test_a_strip_has_two_nodes_at_least(silvermate, count):
    with refused(ConfigurationError, "(N, 11)"):
        Strip(silvermate, np.tile(silvermate.home_q, (count, 1)))
    with pytest.raises(ConfigurationError):
        Strip(silvermate, silvermate.home_q)


def test_faulty_nodes_are_named(silvermate):
    q = np.tile(silvermate.home_q, (5, 1))
    q[3, 6] = np.nan
    with refused(ConfigurationError, "strip", "[3, 6]"):
        Strip(silvermate, q)
    q = np.tile(silvermate.home_q, (5, 1))
    q[2, 4] = 8.0
    with refused(ConfigurationError, "'arm_1_joint'"):
        Strip(silvermate, q)
    q = np.tile(silvermate.home_q, (5, 1))
    q[1, 2:4] = 0.5, 0.5
    with refused(ConfigurationError, "(cos, sin)"):
        Strip(silvermate, q)


@each_robot
def test_coordinate_and_configurations_agree(robot, rng):
    q = random_configurations(robot, rng, 6)
    strip = Strip(robot, q)
    np.testing.assert_allclose(robot.space.from_coordinates(strip.coordinates), q, atol=1e-12)
    same = Strip.from_coordinates(robot, strip.coordinates)
    np.testing.assert_array_equal(same.coordinates, strip.coordinates)
    np.testing.assert_allclose(same.q, q, atol=1e-12)
    assert not same.q.flags.writeable
    assert not same.coordinates.flags.writeable


@each_robot
def test_velocities_are_pinocchios_differences(robot, rng):
    q = random_configurations(robot, rng, 6)
    expected = [pin.difference(robot.model, q[j], q[j + 1]) for j in range(5)]
    np.testing.assert_allclose(Strip(robot, q).velocities, expected, atol=1e-8)


def test_length_and_slip(silvermate, rover, gantry):
    q = [silvermate.home(), silvermate.home(x=1.0), silvermate.home(x=1.0, y=0.5)]
    strip = Strip(silvermate, q)
    assert strip.length == pytest.approx(1.5)
    np.testing.assert_allclose(strip.lateral_slip, [0.0, 0.5], atol=1e-12)
    q = [rover.home(), rover.home(y=1.0)]
    np.testing.assert_array_equal(Strip(rover, q).lateral_slip, [0.0])  # an omnidirectional base may slide
    assert Strip(rover, q).length == pytest.approx(1.0)
    joints = Strip(gantry, [gantry.home(bend=0.0), gantry.home(bend=0.3, slide=0.4 - 0.05)])
    assert joints.length == pytest.approx(np.hypot(0.3, 0.35))
    assert joints.lateral_slip.tolist() == [0.0]


def test_an_arc_has_no_slip_and_its_own_length(silvermate):
    angles = np.linspace(0.0, np.pi / 2, 7)
    q = [silvermate.home(x=np.sin(a), y=1.0 - np.cos(a), yaw=a) for a in angles]
    strip = Strip(silvermate, q)
    assert strip.length == pytest.approx(np.pi / 2, abs=1e-9)
    assert strip.lateral_slip.max() < 1e-12


@each_robot
def test_samples_lie_on_pin_interpolate(robot, rng):
    q = random_configurations(robot, rng, 3)
    strip = Strip(robot, q)
    samples = strip.sample(0.05)
    np.testing.assert_allclose(samples[0], q[0], atol=1e-12)
    np.testing.assert_allclose(samples[-1], q[-1], atol=1e-12)
    steps = [np.abs(pin.difference(robot.model, a, b)).max() for a, b in pairwise(samples)]
    assert max(steps) <= 0.05 + 1e-9
    counts = np.maximum(np.ceil(np.abs(strip.velocities).max(axis=1) / 0.05 - 1e-12).astype(int), 1)
    assert len(samples) == counts.sum() + 1
    middle = samples[int(counts[0]) // 2]
    s = (int(counts[0]) // 2) / counts[0]
    np.testing.assert_allclose(middle, pin.interpolate(robot.model, q[0], q[1], s), atol=1e-7)


def test_configurations_are_pinocchios(rover, rng):
    strip = Strip(rover, random_configurations(rover, rng, 3))
    for row, q in zip(strip.coordinates, strip.q, strict=True):
        np.testing.assert_allclose(configuration(rover, row), q, atol=1e-12)
