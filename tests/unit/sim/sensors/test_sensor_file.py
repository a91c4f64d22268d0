"""Sensor files: the Silvermate's is what the defaults say; wrong files name file, line, key, value and bound."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ParameterError
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Scene, World
from elastic_strips.sim.sensors import (
    InfraredParams,
    LaserParams,
    SensorConfig,
    SensorSuite,
    SonarParams,
    named_sensors,
    read_sensors,
    sensor_file,
)

DOCS = Path(__file__).parents[4] / "docs" / "sensors.md"


def written(tmp_path, text):
    path = tmp_path / "sensors.yaml"
    path.write_text(text)
    return path


def test_the_silvermates_file_is_the_default():
    assert read_sensors() == SensorConfig()
    assert read_sensors(sensor_file()) == SensorConfig()


def test_the_silvermates_file_says_everything():
    text = sensor_file().read_text(encoding="utf-8")
    for make in (LaserParams, SonarParams, InfraredParams):
        for f in fields(make):
            assert f.name == "name" or re.search(rf"^    {f.name}:", text, re.MULTILINE), f.name


@each("name, ahead", [("tiago", 0.0), ("jackal-box", 0.12)])
def test_the_file_of_a_robot_fits_it(name, ahead):
    """Its laser sees a wall ahead, and no part of the robot; a robot without a file gets the Silvermate's."""
    robot = load_robot(name)
    world = World(Scene([Box([0.2, 4.0, 1.0], at=[2.1, 0.0, 0.5])]))
    suite = SensorSuite(robot, world, read_sensors(sensor_file(name)), seed=1)
    coordinates = robot.space.to_coordinates(robot.home())
    readings = [reading for step in range(20) for reading in suite.observe(0.01 * step, coordinates)]
    assert readings
    for reading in readings:
        middle = len(reading.ranges) // 2
        assert abs(np.median(reading.ranges[middle - 5 : middle + 6]) - 2.0 + ahead) < 0.1
    assert sensor_file("nobody") == sensor_file("silvermate") != sensor_file("tiago")


@each("name", ["silvermate", "tiago"])
def test_the_camera_on_a_head_sees_ahead(name):
    """What stands before the robot is in the middle of the image's width, and the floor below it."""
    robot = load_robot(name)
    world = World(Scene([Box([0.2, 0.8, 1.6], at=[2.1, 0.0, 0.8])]))
    suite = SensorSuite(robot, world, named_sensors("head-camera", name), seed=1)
    coordinates = robot.space.to_coordinates(robot.home())
    (image,) = [reading for step in range(10) for reading in suite.observe(0.01 * step, coordinates)]
    points = image.points()
    front = points[(abs(points[:, 0] - 2.0) < 0.05) & (points[:, 2] > 0.3) & (points[:, 2] < 1.55)]
    assert len(front) > 300
    assert abs(front[:, 1].min() + front[:, 1].max()) < 0.1
    assert (abs(points[:, 2]) < 0.03).sum() > 300


def test_the_lidar_on_a_mast_sees_all_around(silvermate):
    """Four walls, each a metre and a half off its origin, and the head below it hides none of them."""
    walls = [Box([0.2, 6.0, 3.0], at=[x, 0.0, 1.5]) for x in (-2.6, 2.6)]
    walls += [Box([6.0, 0.2, 3.0], at=[0.0, y, 1.5]) for y in (-2.6, 2.6)]
    suite = SensorSuite(silvermate, World(Scene(walls)), named_sensors("mast-lidar", "silvermate"), seed=1)
    coordinates = silvermate.space.to_coordinates(silvermate.home())
    image = next(reading for step in range(20) for reading in suite.observe(0.01 * step, coordinates))
    head = silvermate.frame_pose(silvermate.home(), "head_frame")
    assert image.T_base_sensor[2, 3] == pytest.approx(head[2, 3] + 0.35)
    points = image.points()
    for axis, side in ((0, -2.5), (0, 2.5), (1, -2.5), (1, 2.5)):
        assert (abs(points[:, axis] - side) < 0.06).sum() > 1000


def test_sensors_by_name():
    assert named_sensors("all", "silvermate") == SensorConfig()
    assert named_sensors("all,head-camera", "silvermate").names == ("laser", "sonar", "infrared", "head-camera")
    assert named_sensors("head-camera, laser", "tiago").names == ("laser", "head-camera")
    assert named_sensors("laser,rear-laser,mast-lidar", "silvermate").names == ("laser", "mast-lidar", "rear-laser")
    assert named_sensors("laser", "fetch").sensors[0].frame == "laser_link"
    assert named_sensors("head-camera", "somewhere/fetch.urdf").sensors[0].frame == "head_camera_depth_optical_frame"
    with refused(ParameterError, "'hed-camera'", "'head-camera'", "all, head-camera, laser"):
        named_sensors("laser,hed-camera", "tiago")
    with refused(ParameterError, "'jackal-box'", "'head-camera'", "all, laser"):
        named_sensors("head-camera", "jackal-box")


def test_what_a_file_leaves_out_is_the_default(tmp_path):
    config = read_sensors(written(tmp_path, "sensors:\n  front: {kind: laser, rays: 7}\n  ir: {kind: infrared}\n"))
    assert config == SensorConfig(sensors=(LaserParams(name="front", rays=7), InfraredParams(name="ir")))


@each(
    "text, message",
    [
        (
            "sensors:\n  a: {kind: laser}\n  b: {kind: laser, rangemax: 3}\n",
            r":3: .*rangemax.*did you mean 'range_max'",
        ),
        ("sensors:\n  a:\n    kind: laser\n    dropout: 2\n", r":2: sensors\.a: .*dropout=2\.0 must be .*≥ 0 and ≤ 1"),
        ("sensors:\n  a:\n    kind: laser\n    dropout: high\n", r":4: sensors\.a\.dropout: must be a number"),
        ("sensors:\n  a:\n    kind: laser\n    rays: 3.5\n", r":4: sensors\.a\.rays: must be an integer"),
        ("sensors:\n  a: {kind: lasr}\n", r":2: sensors\.a\.kind: .*did you mean 'laser'"),
        ("sensors:\n  a: {rate: 3}\n", r"the key 'kind' is missing.*depth, infrared, laser, lidar, sonar"),
        ("sensors: [laser]\n", "must be a mapping of names to sensors"),
        ("sensors:\n  a: 3\n", "must be a mapping"),
        ("sensor: {}\n", "did you mean 'sensors'"),
        ("self_padding: 0.1\n", "the key 'sensors' is missing"),
        ("sensors: {}\nself_padding: 2\n", r"self_padding=2\.0.*of m ≥ 0 and ≤ 1"),
        ("sensors:\n  a: {kind: sonar, frames: [a, a], groups: 1}\n", "names a link twice"),
    ],
)
def test_wrong_files(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ParameterError, match=message) as caught:
        read_sensors(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with refused(ParameterError, "none.yaml"):
        read_sensors(tmp_path / "none.yaml")


def test_the_document_names_every_key():
    text = DOCS.read_text(encoding="utf-8")
    for make in (LaserParams, SonarParams, InfraredParams):
        for f in fields(make):
            assert f.name == "name" or f"`{f.name}`" in text, f.name
