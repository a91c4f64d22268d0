"""Ranges never promise room that is not there: no range is longer than the true free way, but for its noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from brute_force import make_scene, random_coordinates
from free_way import along, outside_robot, outside_scene
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.perception import LaserScan, RangeRing
from elastic_strips.perception.own_body import Posture, SensorMount
from elastic_strips.scene import World
from elastic_strips.sim.sensors import LaserParams, SensorConfig, SensorSuite, SonarParams

LASER = LaserParams(rays=41, range_max=4.0, latency=0.0, near_reads_min=True)
SONAR = SonarParams(groups=1, rays=9, latency=0.0, crosstalk=0.3, max_incidence=math.pi / 2)
CONFIG = SensorConfig(sensors=(LASER, SONAR))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_range_is_longer_than_the_free_way(silvermate, seed):
    """Up to a range, less its noise, a beam is free: of the laser each, of a sonar at least its axis."""
    rng = np.random.default_rng(seed)
    scene = make_scene(rng, 9, low=(-2.5, -2.5, 0.0), high=(2.5, 2.5, 0.6))
    coordinates = random_coordinates(silvermate, rng, 1)[0]
    suite = SensorSuite(silvermate, World(scene), CONFIG, seed=rng)
    scan, ring = suite.observe(0.0, coordinates)
    assert isinstance(scan, LaserScan)
    assert isinstance(ring, RangeRing)
    posture = Posture(silvermate)
    posture.place(coordinates)
    T = posture.T_world_joint[1] @ scan.T_base_sensor
    beams = [(T, a, r, LASER) for a, r in zip(scan.angles, scan.ranges, strict=True)]
    beams += [
        (posture.T_world_joint[1] @ S, 0.0, r, SONAR) for S, r in zip(ring.T_base_sensor, ring.ranges, strict=True)
    ]
    ways = []
    for T, angle, value, params in beams:
        if np.isnan(value) or value <= params.range_min:
            continue  # nothing is known, or nothing said of what is nearer
        clear = params.range_max
        if np.isfinite(value):  # what is at d reads as d + 3 (σ + k d) at most
            clear = (value - 3.0 * params.noise) / (1.0 + 3.0 * params.noise_ratio)
        ways.append(along(T[:3, 3], T[:3, :3] @ (math.cos(angle), math.sin(angle), 0.0), max(clear, 0.0), 60))
    if not ways:
        return  # the sensors are inside an obstacle
    points = np.array(ways)
    assert outside_scene(points.reshape(-1, 3), scene).min() > -1e-5
    assert outside_robot(points[:, 3:].reshape(-1, 3), silvermate, coordinates).min() > -1e-5


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_an_exact_laser_sees_is_there(silvermate, seed):
    """Each point of a scan without noise is on an obstacle, and none is on the robot."""
    rng = np.random.default_rng(seed)
    scene = make_scene(rng, 18, low=(-2.5, -2.5, 0.1), high=(2.5, 2.5, 0.5))
    coordinates = random_coordinates(silvermate, rng, 1)[0]
    exact = replace(LASER, noise=0.0, noise_ratio=0.0, dropout=0.0, range_min=0.0)
    posture = Posture(silvermate)
    posture.place(coordinates)
    origin = SensorMount(posture, ["laser_frame"]).poses()[0][0][:3, 3]
    if outside_scene(origin[None], scene)[0] < 1e-4:
        return
    (scan,) = SensorSuite(silvermate, World(scene), SensorConfig(sensors=(exact,))).observe(0.0, coordinates)
    assert isinstance(scan, LaserScan)
    points = scan.points() @ posture.T_world_joint[1, :3, :3].T + posture.T_world_joint[1, :3, 3]
    assert np.abs(outside_scene(points, scene)).max(initial=0.0) < 1e-5
    assert outside_robot(points, silvermate, coordinates).min(initial=np.inf) > 0.0
