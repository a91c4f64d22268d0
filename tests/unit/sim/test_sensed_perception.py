"""Sensed perception: a scene of what the sensors see, nothing of what touches the robot, and no ghosts in its body."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import refused

from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder, Keyframes, Scene, World
from elastic_strips.sim.perception import PerceptionError
from elastic_strips.sim.sensed_perception import SensorPerception, body_radius, sees_behind
from elastic_strips.sim.sensors import LaserParams, SensorConfig, named_sensors
from elastic_strips.sim.sensors.params import LidarParams

LASER = SensorConfig().only("laser")
PILLAR = Box((0.4, 0.4, 1.5), at=(1.5, 0.3, 0.75), name="pillar")


def stand(perception: SensorPerception, coordinates: np.ndarray, begin: float, end: float) -> None:
    for t in np.arange(begin, end, 0.01).tolist():
        perception.observe(t, coordinates, coordinates)


def test_what_stands_is_known_from_the_start(silvermate):
    perception = SensorPerception(silvermate, World(Scene([PILLAR])), silvermate.home(), sensors=LASER)
    known = perception.known()
    assert len(known)
    assert "pillar" not in known, "a sensor knows no names"
    near = min(np.hypot(*(o.pose[:2, 3] + p.center[:2] - (1.5, 0.3))) for o in known for p in o.parts)
    assert near < 0.3
    assert perception.params.delay == pytest.approx(0.03 + 1 / 20)


def test_a_blind_robot_says_so(silvermate):
    perception = SensorPerception(silvermate, World(Scene([PILLAR])), silvermate.home(), sensors=LASER, look=0.0)
    with refused(PerceptionError, "laser"):
        perception.sense(0.0)


def test_it_goes_on_reading_while_it_feels_something(silvermate):
    """A post comes into the robot from the side, and goes: nothing of it stays in the scene. Meanwhile scenes are no
    older than else, or a robot would wait for its sensors as long as something touches it."""
    way = Keyframes([0, 1, 2, 3, 9], [[0, -2, 0.7], [0, -0.3, 0.7], [0, -0.3, 0.7], [0, -6, 0.7], [0, -6, 0.7]])
    post = Cylinder(0.15, 1.4, at=(0.0, -2.0, 0.7), name="post", motion=way)
    perception = SensorPerception(silvermate, World(Scene([post])), silvermate.home(), sensors=LASER)
    coordinates = silvermate.space.to_coordinates(silvermate.home())
    stand(perception, coordinates, 0.0, 1.5)
    assert perception.contact == "the bumper is pressed"
    assert perception.sense(1.5).time > 1.5 - perception.params.delay - 0.03
    stand(perception, coordinates, 1.5, 4.0)
    assert not perception.contact
    scene = perception.sense(4.0)
    close = [o.name for o in scene for p in o.parts if np.hypot(*(o.pose[:2, 3] + p.center[:2])) < 0.5]
    assert close == []


def test_the_body_is_free_of_what_was_seen_there(silvermate):
    perception = SensorPerception(silvermate, World(Scene([PILLAR])), silvermate.home(), sensors=LASER, bumper=False)
    coordinates = silvermate.space.to_coordinates(silvermate.home())
    assert perception.estimator.map.occupied(np.array([[1.3, 0.3]])).all()
    coordinates[:2] = 1.3, 0.3  # the robot is now where the pillar's face was seen
    stand(perception, coordinates, 0.0, 0.2)
    angle = np.linspace(0.0, 2.0 * np.pi, 24)
    body = coordinates[:2] + 0.26 * np.column_stack((np.cos(angle), np.sin(angle)))
    assert not perception.estimator.map.occupied(body).any()


@pytest.mark.parametrize("name, least, most", [("silvermate", 0.269, 0.271), ("jackal-box", 0.214, 0.216)])
def test_the_body_radius_is_the_largest_disc_within(name, least, most):
    assert least < body_radius(load_robot(name)) < most


def test_who_is_late_looks_at_the_newest_readings_alone(silvermate):
    coordinates = silvermate.space.to_coordinates(silvermate.home())

    def after(newest):
        perception = SensorPerception(silvermate, World(Scene([PILLAR])), silvermate.home(), sensors=LASER)
        perception.looked_at.clear()
        for k in range(100):
            perception.measure(0.01 * k, coordinates, coordinates)
        assert perception.looked_at["laser"] == 0
        assert perception.work(0.99, coordinates, newest=newest)
        assert not perception.work(0.99, coordinates, newest=newest), "nothing has come since"
        return perception

    late, all_ = after(True), after(False)
    assert late.looked_at["laser"] == 1
    assert all_.looked_at["laser"] > 10
    assert late.newest["laser"][0].time == all_.newest["laser"][0].time


def test_who_sees_behind(silvermate):
    """A lidar turns all the way round, but on the front of the head it looks into that, and a laser at the front of the
    base into the base."""

    def behind(*sensors):
        return sees_behind(silvermate, SensorConfig(sensors=sensors))

    assert sees_behind(silvermate, SensorConfig())
    assert sees_behind(silvermate, SensorConfig().only("sonar"))
    assert not sees_behind(silvermate, SensorConfig().only("laser"))
    assert not behind(LaserParams(field_of_view=2.0 * math.pi))
    assert behind(LaserParams(field_of_view=2.0 * math.pi), LaserParams(name="rear", frame="sonar_6_frame"))
    assert not behind(LaserParams(frame="sonar_6_frame", field_of_view=0.7)), "it sees a part of what is behind"
    assert sees_behind(silvermate, named_sensors("laser,rear-laser", "silvermate"))
    assert sees_behind(silvermate, named_sensors("mast-lidar", "silvermate"))
    level = {"elevation_min": -0.908, "elevation_max": 0.122, "columns": 64, "rows": 16}
    assert not behind(LidarParams(frame="head_frame", **level))
    assert behind(LidarParams(frame="hand_frame", **level)), "held out in front, it sees most"
