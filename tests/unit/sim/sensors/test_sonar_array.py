"""Rings: cones, groups, nearest echo, oblique surfaces, near things, crosstalk, the robot's own arm."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import each

from elastic_strips.perception.own_body import Posture
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, World
from elastic_strips.sim.sensors import InfraredParams, SonarParams
from elastic_strips.sim.sensors.devices import SonarArray, cone_rays
from elastic_strips.sim.sensors.obstacle_rays import ObstacleRays

SONAR = SonarParams(noise=0.0, noise_ratio=0.0, dropout=0.0, crosstalk=0.0, groups=1)
INFRARED = InfraredParams(noise=0.0, noise_ratio=0.0, dropout=0.0)
RADIUS, HEIGHT = 0.271, 0.2105  # of the sonars' ring [m]


def ring(robot, obstacles, params=SONAR, joints=None, seed=0):
    posture = Posture(robot)
    coordinates = robot.space.to_coordinates(robot.home_q)
    if joints is not None:
        coordinates[3:] = joints
    posture.place(coordinates)
    world = ObstacleRays(World(Scene(obstacles)))
    return SonarArray(params, posture, world, np.random.default_rng(seed), 0.01)


def ball(sensor: int, distance: float, radius: float = 0.1, away: float = 0.0) -> Sphere:
    """A ball ``distance`` before a sonar, ``away`` [rad] from its axis."""
    angle = sensor * math.pi / 6
    at = RADIUS * np.array([math.cos(angle), math.sin(angle), 0])
    at += (distance + radius) * np.array([math.cos(angle + away), math.sin(angle + away), 0])
    return Sphere(radius, at=[at[0], at[1], HEIGHT])


@each("count", [1, 2, 7, 31])
def test_a_cone_is_filled(count):
    d = cone_rays(0.3, count)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    np.testing.assert_allclose(d[0], [1, 0, 0])
    assert d[:, 0].min() == pytest.approx(math.cos(0.3) if count > 1 else 1.0)
    if count > 10:  # no empty quarter
        assert {(y > 0, z > 0) for y, z in d[1:, 1:]} == {(a, b) for a in (True, False) for b in (True, False)}


def test_each_sonar_looks_where_it_should(silvermate):
    for k in range(12):
        reading = ring(silvermate, [ball(k, 1.0)]).measure(0.5)
        assert reading.ranges[k] == pytest.approx(1.0, abs=1e-6)
        assert np.isinf(np.delete(reading.ranges, k)).all()
        np.testing.assert_allclose(
            reading.points()[0, :2], 1.271 * np.array([math.cos(k * math.pi / 6), math.sin(k * math.pi / 6)]), atol=1e-5
        )
    assert (reading.time, reading.kind, reading.sensor, reading.half_angle) == (0.5, "sonar", "sonar", SONAR.half_angle)


def test_the_cone_has_the_width_it_should(silvermate):
    wide = replace(SONAR, rays=400)
    inside, outside = SONAR.half_angle - 0.02, SONAR.half_angle + math.asin(0.1 * math.sin(SONAR.max_incidence) / 1.1)
    assert ring(silvermate, [ball(0, 1.0, 0.1, inside)], wide).measure(0.0).ranges[0] == pytest.approx(1.0, abs=0.005)
    assert ring(silvermate, [ball(0, 1.0, 0.1, outside)], wide).measure(0.0).ranges[0] == np.inf


def test_the_nearest_echo_counts(silvermate):
    reading = ring(silvermate, [ball(3, 2.0), ball(3, 0.7, 0.1, 0.1)]).measure(0.0)
    assert reading.ranges[3] == pytest.approx(0.7, abs=0.02)


def test_too_near_reads_as_the_shortest_range(silvermate):
    near = Box([0.1, 0.5, 0.5], at=[RADIUS + 0.05 + 0.06, 0, HEIGHT])
    assert ring(silvermate, [near]).measure(0.0).ranges[0] == SONAR.range_min
    silent = ring(silvermate, [near], replace(SONAR, near_reads_min=False)).measure(0.0)
    assert np.isnan(silent.ranges[0])


def test_oblique_surfaces_reflect_away_and_still_hide(silvermate):
    """A plate turned by 60° gives no echo, and what is behind it none either; without the rule it does."""
    turn = math.radians(60)
    plate = Box([0.02, 6, 2], at=[1.5, 0, 0.3], quat=[0, 0, math.sin(turn / 2), math.cos(turn / 2)])
    behind = Box([0.2, 0.5, 1], at=[2.5, 0, 0.3])
    assert ring(silvermate, [plate, behind]).measure(0.0).ranges[0] == np.inf
    assert ring(silvermate, [behind]).measure(0.0).ranges[0] == pytest.approx(2.4 - RADIUS, abs=1e-6)
    rough = ring(silvermate, [plate, behind], replace(SONAR, max_incidence=math.pi / 2)).measure(0.0)
    assert 0.5 < rough.ranges[0] < 1.5 - RADIUS
    square = Box([0.02, 6, 2], at=[1.5, 0, 0.3], quat=[0, 0, math.sin(0.25), math.cos(0.25)])  # 0.5 rad
    assert np.isfinite(ring(silvermate, [square]).measure(0.0).ranges[0])


def test_groups_take_turns(silvermate):
    walls = [ball(k, 0.8) for k in range(12)]
    device = ring(silvermate, walls, replace(SONAR, groups=3))
    for turn in (0, 1, 2, 0):
        reading = device.measure(0.0)
        assert np.flatnonzero(reading.hits).tolist() == list(range(turn, 12, 3))
        assert np.isnan(reading.ranges[~reading.hits]).all()
    device.restart()
    assert device.measure(0.0).hits[0]


def test_crosstalk_puts_a_neighbours_echo_where_nothing_is(silvermate):
    """One neighbour of two, at the probability given; never a longer range than one's own."""
    params = replace(SONAR, crosstalk=0.2, frames=SONAR.frames)
    device = ring(silvermate, [ball(0, 0.5), ball(6, 2.0)], params)
    got = np.array([device.measure(0.0).ranges for _ in range(300)])
    assert np.allclose(got[:, 0], 0.5, atol=1e-6)
    for k in (1, 11):
        heard = np.isfinite(got[:, k])
        np.testing.assert_allclose(got[heard, k], 0.5, atol=1e-6)
        assert heard.mean() == pytest.approx(0.1, abs=0.05)
    assert np.isinf(got[:, 3]).all()
    apart = ring(silvermate, [ball(0, 0.5)], replace(params, groups=3, crosstalk=1.0))
    assert np.isnan(apart.measure(0.0).ranges[1])  # does not fire now
    assert np.isinf(apart.measure(0.0).ranges).sum() == 4  # neighbours in the second group have heard nothing


def test_infrared_sensors_are_narrow_and_short(silvermate):
    """Sensor 2 is on the body, 0.505 m high, and looks ahead."""
    reading = ring(silvermate, [Cylinder(0.05, 0.2, at=[0.6, 0, 0.505])], INFRARED).measure(0.0)
    assert reading.kind == "infrared"
    assert reading.ranges[2] == pytest.approx(0.55 - 0.101, abs=1e-6)
    assert np.isinf(np.delete(reading.ranges, 2)).all()
    assert ring(silvermate, [Cylinder(0.05, 0.2, at=[1.0, 0, 0.505])], INFRARED).measure(0.0).ranges[2] == np.inf


def test_the_arm_before_a_sonar_is_no_obstacle(silvermate):
    """With the arm before some sonars these say nothing, whatever is behind; a thing before the arm is seen."""
    hanging = [0.4, 0.2, 0.6, 0.0, -2.2, 0.0, -0.2]
    alone = ring(silvermate, [], SONAR, hanging).measure(0.0)
    hidden = np.flatnonzero(np.isnan(alone.ranges))
    assert 1 <= len(hidden) <= 4
    assert np.isinf(np.delete(alone.ranges, hidden)).all()
    far = ring(silvermate, [ball(k, 2.5, 0.3) for k in hidden], SONAR, hanging).measure(0.0)
    assert np.isnan(far.ranges[hidden]).all()
    near = ring(silvermate, [ball(hidden[0], 0.16, 0.02)], SONAR, hanging).measure(0.0)
    assert near.ranges[hidden[0]] == pytest.approx(0.16, abs=1e-3)
