"""Masks: what a robot covers in its own images is told, and what stands before it is not hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from brute_force import random_coordinates
from cases import refused

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.perception import BodyMask
from elastic_strips.scene import Box, Scene, Sphere, World
from elastic_strips.sim.sensors import DepthParams, SensorConfig, SensorSuite

CAMERA = DepthParams(name="head", frame="head_frame", axis="x", tilt=0.9, field_of_view=1.6, columns=48, rows=36)
EXACT = DepthParams(
    name="head", frame="head_frame", axis="x", tilt=0.9, field_of_view=1.6, columns=48, rows=36,
    noise=0.0, noise_growth=0.0, dropout=0.0, edge_dropout=0.0, bias=0.0, bias_ratio=0.0, max_incidence=1.57,
    range_min=0.01,
)  # fmt: skip


def image_of(robot, scene, coordinates, params=EXACT, seed=1):
    suite = SensorSuite(robot, World(scene), SensorConfig(sensors=(params,)), seed=seed)
    found = ()
    for k in range(40):
        found = suite.observe(0.01 * k, coordinates)
        if found:
            return found[0]
    raise AssertionError("no image")


def test_the_robot_is_covered_in_any_posture_and_little_else(silvermate):
    """In an empty world all that an exact camera sees is the floor or the robot."""
    rng, mask = np.random.default_rng(2), BodyMask(silvermate)
    own_pixels = beside = pixels = 0
    for coordinates in random_coordinates(silvermate, rng, 25):
        coordinates[:3] = 0.0
        image = image_of(silvermate, Scene([]), coordinates)
        d = image.directions() @ image.T_base_sensor[:3, :3].T
        with np.errstate(divide="ignore"):
            floor = np.where(d[..., 2] < 0.0, -image.T_base_sensor[2, 3] / d[..., 2], np.inf)
        own = np.isfinite(image.depth) & (image.depth < floor - 1e-3)
        covered = mask.covered(image)
        assert not (own & ~covered).any()
        own_pixels += int(own.sum())
        beside += int((covered & ~own).sum())
        pixels += own.size
        assert np.isnan(mask.without(image).depth[covered]).all()
    assert own_pixels > 500
    assert beside < 0.2 * pixels


def test_joints_may_be_a_little_off(silvermate):
    """By 0.5°, and with noise: three centimetres cover it."""
    rng, mask = np.random.default_rng(3), BodyMask(silvermate)
    leaked = own_pixels = 0
    for coordinates in random_coordinates(silvermate, rng, 15):
        coordinates[:3] = 0.0
        image = image_of(silvermate, Scene([]), coordinates, CAMERA)
        d = image.directions() @ image.T_base_sensor[:3, :3].T
        with np.errstate(divide="ignore"):
            floor = np.where(d[..., 2] < 0.0, -image.T_base_sensor[2, 3] / d[..., 2], np.inf)
        own = np.isfinite(image.depth) & (image.depth < floor - 0.3)
        thought = coordinates.copy()
        thought[3:] += rng.uniform(-1.0, 1.0, len(thought) - 3) * np.radians(0.5)
        q = silvermate.space.from_coordinates(np.clip(thought, silvermate.space.lower, silvermate.space.upper))
        leaked += int((own & ~mask.covered(image, q)).sum())
        own_pixels += int(own.sum())
    assert own_pixels > 300
    assert leaked < 0.005 * own_pixels


def test_what_stands_before_the_arm_is_not_hidden(silvermate):
    coordinates = silvermate.space.to_coordinates(silvermate.home())
    empty = image_of(silvermate, Scene([]), coordinates)
    mask = BodyMask(silvermate)
    row, column = np.argwhere(mask.covered(empty) & (empty.depth < 1.2))[0]
    d = empty.directions()[row, column] @ empty.T_base_sensor[:3, :3].T
    at = empty.T_base_sensor[:3, 3] + 0.6 * empty.depth[row, column] * d
    ball = image_of(silvermate, Scene([Sphere(0.04, at=at)]), coordinates)
    assert ball.depth[row, column] < empty.depth[row, column] - 0.1
    assert not mask.covered(ball)[row, column]


def test_an_image_has_to_say_how_the_robot_stood(silvermate, tiago):
    image = image_of(silvermate, Scene([Box((1, 1, 1), at=(2, 0, 0.5))]), np.zeros(silvermate.nv))
    with refused(ConfigurationError):
        BodyMask(tiago).covered(image)
    with refused(ParameterError, "head"):
        BodyMask(silvermate).covered(replace(image, q=None))
    with refused(ParameterError, "margin"):
        BodyMask(silvermate, margin=-0.01)
