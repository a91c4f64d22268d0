"""Own body: beams meet the robot where its bodies are, by their inequalities; padding; the housing hides nothing."""

from __future__ import annotations

import numpy as np
from brute_force import random_coordinates
from cases import each
from free_way import along, outside_robot

from elastic_strips.perception.own_body import Posture, SelfFilter, SensorMount
from elastic_strips.perception.rays import Rays

REACH = 4.0


def beams_of(robot, link: str, count: int, padding: float, rng):
    """Posture, mount, beams in all directions from 5 cm before a link's origin, and the body before them."""
    posture = Posture(robot)
    mount = SensorMount(posture, [link])
    direction = rng.normal(size=(count, 3))
    local = Rays(np.zeros((1, 3)), direction / np.linalg.norm(direction, axis=1, keepdims=True))
    T = mount.T_joint_sensor[0]
    own = SelfFilter(posture, np.full(count, mount.joint[0]), local.moved(T), padding)
    return posture, mount, local, own


@each("name, link", [("silvermate", "ir_2_frame"), ("silvermate", "laser_frame"), ("gantry", "tip")])
def test_free_before_the_robot_is_met_and_on_it_there(name, link, request):
    robot = request.getfixturevalue(name)
    rng = np.random.default_rng(3)
    posture, mount, local, own = beams_of(robot, link, 40, 0.0, rng)
    hits = 0
    for coordinates in random_coordinates(robot, rng, 6):
        posture.place(coordinates)
        T = mount.poses()[0][0]
        if outside_robot(T[None, :3, 3], robot, coordinates)[0] < 1e-4:
            continue  # a body holds the sensor: its housing
        rays = local.moved(T)
        for d, direction in zip(own.distances(rays, REACH), rays.direction, strict=True):
            way = outside_robot(along(rays.origin[0], direction, min(d, REACH)), robot, coordinates)
            assert way.min() > -1e-5
            if np.isfinite(d):
                hits += 1
                assert abs(way[-1]) < 1e-5
    assert hits > 20


def test_padding_is_seen_before_the_body_and_beside_it(silvermate):
    rng = np.random.default_rng(4)
    posture, mount, local, bare = beams_of(silvermate, "laser_frame", 400, 0.0, np.random.default_rng(1))
    thick = beams_of(silvermate, "laser_frame", 400, 0.02, np.random.default_rng(1))
    earlier = wider = 0
    for coordinates in random_coordinates(silvermate, rng, 12):
        posture.place(coordinates)
        thick[0].place(coordinates)
        rays = local.moved(mount.poses()[0][0])
        one, other = bare.distances(rays, REACH), thick[3].distances(rays, REACH)
        assert (other <= one).all()
        earlier += int((other < one - 0.015).sum())
        wider += int((np.isfinite(other) & np.isinf(one)).sum())
        for k in np.flatnonzero(np.isfinite(other)):
            at = rays.origin[0] + other[k] * rays.direction[k]
            assert outside_robot(at[None], silvermate, coordinates)[0] < 0.02 + 1e-6
    assert earlier > 5
    assert wider > 5


def test_hulls_are_met_too(tiago):
    """A robot of meshes: its links are hulls, padded ones contain the bare ones."""
    rng = np.random.default_rng(0)
    posture, mount, local, own = beams_of(tiago, "arm_7_link", 60, 0.01, rng)
    hits = 0
    for coordinates in random_coordinates(tiago, rng, 3):
        posture.place(coordinates)
        rays = local.moved(mount.poses()[0][0])
        found = own.distances(rays, REACH)
        hit = np.flatnonzero(np.isfinite(found))
        hits += len(hit)
        at = rays.origin[0] + found[hit, None] * rays.direction[hit]
        assert (outside_robot(at, tiago, coordinates) < 0.01 * np.sqrt(3) + 1e-5).all()
    assert hits > 5


def test_a_link_closer_than_the_padding_still_hides(silvermate):
    """Where a beam begins within the padding of a link, the link itself counts."""
    rng = np.random.default_rng(5)
    posture, mount, local, bare = beams_of(silvermate, "ir_2_frame", 100, 0.0, np.random.default_rng(1))
    thick = beams_of(silvermate, "ir_2_frame", 100, 0.5, np.random.default_rng(1))
    hits = 0
    for coordinates in random_coordinates(silvermate, rng, 6):
        posture.place(coordinates)
        thick[0].place(coordinates)
        rays = local.moved(mount.poses()[0][0])
        one, other = bare.distances(rays, REACH), thick[3].distances(rays, REACH)
        assert (other <= one).all()
        hits += int(((one == other) & np.isfinite(one)).sum())
    assert hits > 10
