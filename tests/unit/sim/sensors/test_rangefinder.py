"""Laser range finder: angles, exact scans of a room, the arm before the laser, noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from free_way import along, outside_robot

from elastic_strips.perception.own_body import Posture
from elastic_strips.scene import Box, Cylinder, Scene, World
from elastic_strips.sim.sensors import LaserParams
from elastic_strips.sim.sensors.devices import LaserRangefinder
from elastic_strips.sim.sensors.obstacle_rays import ObstacleRays

EXACT = LaserParams(noise=0.0, noise_ratio=0.0, dropout=0.0)
HANGING = [0.4, 0.2, 0.6, 0.0, -2.2, 0.0, -0.2]
"""Joints with which the forearm hangs before the laser."""


def laser(robot, obstacles=(), params=EXACT, coordinates=None, padding=0.01):
    posture = Posture(robot)
    posture.place(robot.space.to_coordinates(robot.home_q) if coordinates is None else coordinates)
    rng = np.random.default_rng(0)
    return LaserRangefinder(params, posture, ObstacleRays(World(Scene(obstacles))), rng, padding)


def at(robot, x=0.0, y=0.0, yaw=0.0, joints=None):
    coordinates = robot.space.to_coordinates(robot.home_q)
    coordinates[:3] = x, y, yaw
    if joints is not None:
        coordinates[3:] = joints
    return coordinates


def test_a_wall_and_the_poses(silvermate):
    """The laser sits 0.271 m before the base's middle; the wall's face is 3 m from the origin."""
    wall = Box([0.2, 50, 2], at=[3.1, 0, 0])
    coordinates = at(silvermate, 0.5, -0.2, 0.3)
    scan = laser(silvermate, [wall], coordinates=coordinates).measure(1.5)
    assert scan.time == 1.5
    assert len(scan.ranges) == 361
    assert (scan.angles[0], scan.angles[180], scan.angles[-1]) == pytest.approx(
        (-math.pi / 2, 0, math.pi / 2), abs=1e-12
    )
    np.testing.assert_allclose(scan.T_base_sensor[:3, 3], [0.271, 0, 0.25], atol=1e-12)
    ahead = 3.0 - 0.5 - 0.271 * math.cos(0.3)
    with np.errstate(divide="ignore"):
        exact = ahead / np.maximum(np.cos(scan.angles + 0.3), 0.0)
    exact[exact > 10.0] = np.inf
    np.testing.assert_allclose(scan.ranges, exact, rtol=1e-9)
    points = scan.points()
    world = points @ np.array([[math.cos(0.3), -math.sin(0.3), 0], [math.sin(0.3), math.cos(0.3), 0], [0, 0, 1]]).T
    np.testing.assert_allclose(world[:, 0] + 0.5, 3.0, atol=1e-9)
    np.testing.assert_allclose(world[:, 2], 0.25, atol=1e-12)


def test_what_is_above_or_below_the_plane_is_not_seen(silvermate):
    low, high = Box([1, 1, 0.2], at=[2, 0, 0.1]), Box([1, 1, 1], at=[2, 0, 0.8])
    assert np.isinf(laser(silvermate, [low, high]).measure(0.0).ranges).all()


def test_a_full_circle_has_no_ray_twice(silvermate):
    device = laser(silvermate, params=replace(EXACT, field_of_view=2 * math.pi, rays=8))
    np.testing.assert_allclose(np.diff(device.angles), math.pi / 4)
    assert device.angles[-1] == pytest.approx(3 * math.pi / 4)
    back = device.measure(0.0).ranges
    assert np.isnan(back[0])  # looks straight into the robot's own base
    assert np.isinf(back[4])


def test_too_near_is_no_answer(silvermate):
    pole = Cylinder(0.05, 1, at=[0.271 + 0.05 + 0.03, 0, 0.25])
    assert np.isnan(laser(silvermate, [pole]).measure(0.0).ranges[180])
    near = laser(silvermate, [pole], replace(EXACT, near_reads_min=True)).measure(0.0)
    assert near.ranges[180] == EXACT.range_min


def test_the_arm_before_the_laser_is_no_obstacle(silvermate):
    """Beams that meet the arm say nothing, with a wall behind it and without; beside it they see the wall."""
    coordinates = at(silvermate, joints=HANGING)
    wall = Box([0.2, 50, 2], at=[2.0, 0, 0])
    for obstacles in ([], [wall]):
        scan = laser(silvermate, obstacles, coordinates=coordinates, padding=0.0).measure(0.0)
        hidden = np.isnan(scan.ranges)
        assert 5 < hidden.sum() < 60
        for k in range(0, 361, 4):
            direction = np.array([math.cos(scan.angles[k]), math.sin(scan.angles[k]), 0.0])
            way = outside_robot(along(np.array([0.271, 0, 0.25]), direction, 1.6, 800), silvermate, coordinates)
            assert (way.min() < 0.0) == hidden[k]
        assert np.isfinite(scan.ranges).any() == bool(obstacles)
        padded = np.isnan(laser(silvermate, obstacles, coordinates=coordinates, padding=0.03).measure(0.0).ranges)
        assert (padded | ~hidden).all()
        assert padded.sum() > hidden.sum()


def test_what_is_before_the_arm_is_an_obstacle(silvermate):
    coordinates = at(silvermate, joints=HANGING)
    hidden = np.flatnonzero(np.isnan(laser(silvermate, coordinates=coordinates).measure(0.0).ranges))
    angle = EXACT.field_of_view * (hidden[len(hidden) // 2] / 360 - 0.5)
    post = Cylinder(0.03, 1, at=[0.271 + 0.15 * math.cos(angle), 0.15 * math.sin(angle), 0.25])
    seen = laser(silvermate, [post], coordinates=coordinates).measure(0.0)
    assert seen.ranges[hidden[len(hidden) // 2]] == pytest.approx(0.12, abs=1e-3)


def test_noise_and_losses(silvermate):
    params = LaserParams(noise=0.02, noise_ratio=0.0, dropout=0.05)
    device = laser(silvermate, [Box([0.2, 50, 2], at=[3.1, 0, 0])], params)
    exact = laser(silvermate, [Box([0.2, 50, 2], at=[3.1, 0, 0])]).measure(0.0).ranges
    middle = slice(90, 271)
    error = np.array([device.measure(0.0).ranges[middle] - exact[middle] for _ in range(40)])
    assert np.isnan(error).mean() == pytest.approx(0.05, abs=0.01)
    assert np.nanstd(error) == pytest.approx(0.02, rel=0.05)
    assert np.nanmax(np.abs(error)) <= 0.06 + 1e-12
