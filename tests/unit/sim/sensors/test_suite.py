"""Sensor suite: rates and latencies to the step, seeds, order, what moves; wrong calls are refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError, RobotError
from elastic_strips.perception import RangeRing
from elastic_strips.scene import Box, ConvexHull, Cylinder, Scene, Twist, World
from elastic_strips.sim.sensors import InfraredParams, LaserParams, SensorConfig, SensorSuite, SonarParams

WORLD = World(Scene([Box([0.2, 8, 2], at=[2, 0, 0.5]), Cylinder(0.3, 1, at=[0, 1.5, 0.5])]))
LASER = LaserParams(rays=31)
DT = 0.01


def run(suite, coordinates, steps, first=0):
    return [(k * DT, r) for k in range(first, first + steps) for r in suite.observe(k * DT, coordinates)]


@pytest.fixture(scope="module")
def home(silvermate):
    return silvermate.space.to_coordinates(silvermate.home_q)


@each("rate, latency", [(20.0, 0.03), (15.0, 0.0), (100.0, 0.25), (7.3, 0.055)])
def test_rate_and_latency(silvermate, home, rate, latency):
    """Measured at the first step at or after each period, read at the first step after the latency."""
    suite = SensorSuite(silvermate, WORLD, SensorConfig(sensors=(replace(LASER, rate=rate, latency=latency),)))
    got = run(suite, home, 200)
    times = [math.ceil(round(k / rate / DT, 6)) * DT for k in range(1 + int(1.99 * rate))]
    reads = [math.ceil(round((t + latency) / DT, 6)) * DT for t in times]
    expected = [(a, b) for a, b in zip(reads, times, strict=True) if a <= 1.99 + 1e-9]
    np.testing.assert_allclose([(t, r.time) for t, r in got], expected, atol=1e-9)


def test_all_sensors_of_the_silvermate(silvermate, home):
    suite = SensorSuite(silvermate, WORLD)
    assert suite.config.names == ("laser", "sonar", "infrared")
    got = run(suite, home, 111)
    count = {name: sum(r.sensor == name for _, r in got) for name in suite.config.names}
    assert count == {"laser": 22, "sonar": 17, "infrared": 27}
    for name in suite.config.names:
        times = [r.time for _, r in got if r.sensor == name]
        assert times == sorted(times)


@pytest.mark.parametrize("first", ["slow", "fast"])
def test_order_of_time(silvermate, home, first):
    """What was measured earlier comes first, though it may be read later, and whichever sensor is named first."""
    sensors = (replace(LASER, name="fast", latency=0.0), replace(LASER, name="slow", latency=0.05))
    config = SensorConfig(sensors=sensors if first == "fast" else sensors[::-1])
    suite = SensorSuite(silvermate, WORLD, config)
    assert [r.sensor for r in suite.observe(0.0, home)] == ["fast"]
    both = suite.observe(0.05, home)
    assert [(r.sensor, r.time) for r in both] == [("slow", 0.0), ("fast", 0.05)]


def test_seeds(silvermate, home):
    config = SensorConfig(sensors=(LASER, SonarParams()))

    def ranges(seed, config=config, sensor="laser"):
        suite = SensorSuite(silvermate, WORLD, config, seed=seed)
        return np.concatenate([r.ranges for _, r in run(suite, home, 40) if r.sensor == sensor])

    np.testing.assert_array_equal(ranges(3), ranges(3))
    np.testing.assert_array_equal(ranges(3), ranges(np.random.default_rng(3)))
    assert not np.array_equal(ranges(3), ranges(4), equal_nan=True)
    one = replace(config, sensors=(LASER,))
    np.testing.assert_array_equal(ranges(3), ranges(3, one))  # another sensor does not change this one's noise


@pytest.mark.parametrize("shape", ["cylinder", "hull"])
def test_what_moves_is_seen_where_it_was_at_that_time(silvermate, home, shape):
    going = Twist([0.5, 0, 0])
    corners = [[x, y, z] for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.5, 0.5)]
    thing = (
        Cylinder(0.3, 1, at=[1.5, 0, 0.5], motion=going)
        if shape == "cylinder"
        else ConvexHull(corners, at=[1.5, 0, 0.5], motion=going)
    )
    exact = replace(LASER, noise=0.0, noise_ratio=0.0, dropout=0.0)
    suite = SensorSuite(silvermate, World(Scene([thing])), SensorConfig(sensors=(exact,)))
    got = run(suite, home, 100)
    assert len(got) > 15
    for _, scan in got:
        assert scan.ranges[15] == pytest.approx(1.2 - 0.271 + 0.5 * scan.time, abs=1e-6)


def test_the_robot_moves(silvermate, home):
    exact = replace(LASER, noise=0.0, noise_ratio=0.0, dropout=0.0, latency=0.0)
    suite = SensorSuite(silvermate, WORLD, SensorConfig(sensors=(exact,)))
    for k in range(3):
        coordinates = home.copy()
        coordinates[0] = 0.1 * k
        (scan,) = suite.observe(k * 0.05, coordinates)
        assert scan.ranges[15] == pytest.approx(1.9 - 0.271 - 0.1 * k, abs=1e-9)


def test_reset_begins_anew(silvermate, home):
    suite = SensorSuite(silvermate, WORLD, SensorConfig(sensors=(LASER, replace(SonarParams(), dropout=0.0))))
    run(suite, home, 7)
    suite.reset(0.013)
    got = [r for k in range(4) for r in suite.observe(0.013 + k * DT, home)]
    assert [r.time for r in got] == [0.013, 0.013]
    sonar = next(r for r in got if isinstance(r, RangeRing))
    assert np.flatnonzero(~np.isnan(sonar.ranges)).tolist() == [0, 3, 6, 9]


def test_after_a_gap_a_sensor_fires_once(silvermate, home):
    suite = SensorSuite(silvermate, WORLD, SensorConfig(sensors=(replace(LASER, latency=0.0),)))
    assert [len(suite.observe(t, home)) for t in (0.0, 0.51, 0.54, 0.55, 0.56)] == [1, 1, 0, 1, 0]


def test_wrong_calls(silvermate, gantry, home):
    suite = SensorSuite(silvermate, WORLD, SensorConfig(sensors=(LASER,)))
    suite.observe(0.1, home)
    with refused(ParameterError, "back"):
        suite.observe(0.05, home)
    with refused(ParameterError, "finite"):
        suite.observe(math.nan, home)
    with refused(ConfigurationError, "finite"):
        suite.observe(1.0, home * math.nan)
    with refused(RobotError, "'laser_frame'"):
        SensorSuite(gantry, WORLD)


def test_another_robot_with_frames_of_its_own(gantry):
    """A fixed base; an infrared sensor at the tip of the arm."""
    params = InfraredParams(frames=("tip",), noise=0.0, noise_ratio=0.0, dropout=0.0, latency=0.0)
    suite = SensorSuite(gantry, WORLD, SensorConfig(sensors=(params,)))
    (reading,) = suite.observe(0.0, np.array([0.0, 0.3, 0.2, 0.5]))
    assert reading.ranges.shape == (1,)
