"""Masks: what a robot covers in its own images is told, and what stands before it is not hidden."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import coal
import numpy as np
from brute_force import random_coordinates
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.native import twin
from elastic_strips.perception import BodyMask, DepthImage
from elastic_strips.perception.own_body import OwnBodies, Posture, SensorMount
from elastic_strips.perception.rays import Nearest, Rays
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


def met_by_each_ray(robot, coordinates, image, margin):
    """Where each pixel's ray meets a body, every ray asked about every body: with origins of their own."""
    posture, directions = Posture(robot), image.directions()
    posture.place(coordinates)
    stretch = np.linalg.norm(directions, axis=-1).reshape(-1, 1)
    rays = Rays(np.zeros((1, 3)), directions.reshape(-1, 3) / stretch).moved(image.T_base_sensor)
    rays = Rays(np.tile(rays.origin, (len(rays), 1)), rays.direction)
    nearest = Nearest(len(rays))
    for padding in (0.0, margin):
        T = posture.T_base_world @ posture.T_world_joint
        OwnBodies(robot.geometries, padding).cast(T, rays, nearest, image.depth_max * float(stretch.max()))
    return nearest.distance.reshape(image.depth.shape)


@each("name, frame, tilt", [("silvermate", "head_frame", 0.9), ("tiago", "xtion_depth_frame", 0.5)])
@each("other", [False, True])
def test_bodies_that_are_passed_over_cover_nothing(name, frame, tilt, other, request, brief):
    """In any posture, the camera in its housing, before it, and anywhere near the robot."""
    robot = request.getfixturevalue(name)
    rng, posture = np.random.default_rng(4), Posture(robot)
    params = DepthParams(frame=frame, axis="x", tilt=tilt, columns=40, rows=30)
    mount = SensorMount(posture, [frame], params.T_frame_camera)
    covered = passed = 0
    with twin() if other else nullcontext():
        mask = BodyMask(robot)
        for k, coordinates in enumerate(random_coordinates(robot, rng, 4 if other else 14 if brief else 40)):
            posture.place(coordinates)
            T = mount.poses()[1][0]
            if k % 2:
                turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
                T[:3, :3] = T[:3, :3] @ turn * np.linalg.det(turn)
                T[:3, 3] += rng.uniform(-0.25, 0.25, 3) * rng.integers(2)
            depth = rng.choice([0.3, 1.0, 3.0, np.inf, np.nan], (30, 40)).astype(np.float32)
            focal = 20.0 / np.tan(rng.uniform(0.2, 1.1))
            q = robot.space.from_coordinates(coordinates)
            image = DepthImage("head", 0.0, T, depth, (focal, focal), (19.5, 14.5), 0.1, 6.0, q=q)
            own = met_by_each_ray(robot, coordinates, image, mask.margin)
            ranges = depth * np.linalg.norm(image.directions(), axis=-1)
            np.testing.assert_array_equal(mask.covered(image), np.isfinite(own) & ~(ranges < own))
            covered += int(mask.covered(image).sum())
            passed += int((~mask.covered(image)).sum())
    assert min(covered, passed) > 250


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


def test_places_above_and_below_the_robot_are_those_near_its_bodies_seen_from_above(silvermate):
    """Of random ones, by what Coal says of thin columns; capsules about bodies stand off from them a little."""
    rng, mask, margin = np.random.default_rng(5), BodyMask(silvermate), 0.1
    column, found = coal.Cylinder(1e-6, 10.0), 0
    for coordinates in random_coordinates(silvermate, rng, 4):
        coordinates[:3] = 0.0
        q = silvermate.space.from_coordinates(coordinates)
        posture = Posture(silvermate)
        posture.place(coordinates)
        places = rng.uniform(-1.0, 1.0, (300, 2))
        near = mask.above_or_below(places, q, margin)
        for place, told in zip(places, near.tolist(), strict=True):
            distance = min(
                coal.distance(
                    p.geometry, coal.Transform3s(*rotation_and_place(posture.T_world_joint[p.joint] @ p.placement)),
                    column, coal.Transform3s(np.eye(3), np.array([*place, 0.0])),
                    coal.DistanceRequest(), coal.DistanceResult(),
                )
                for p in silvermate.geometries
            )  # fmt: skip
            assert told or distance > margin - 1e-3
            assert not told or distance < margin + 0.3
            found += told
    assert 50 < found < 900


def rotation_and_place(T):
    return np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy()


def test_an_image_has_to_say_how_the_robot_stood(silvermate, tiago):
    image = image_of(silvermate, Scene([Box((1, 1, 1), at=(2, 0, 0.5))]), np.zeros(silvermate.nv))
    with refused(ConfigurationError):
        BodyMask(tiago).covered(image)
    with refused(ParameterError, "head"):
        BodyMask(silvermate).covered(replace(image, q=None))
    with refused(ParameterError, "margin"):
        BodyMask(silvermate, margin=-0.01)
