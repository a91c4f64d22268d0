"""Certificates of motions: equal to the certificate of strips, which asks at every sample, and dense in time."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from brute_force import configuration, link_distances, make_obstacle, random_coordinates

from elastic_strips.collision import (
    BodySet,
    Forecast,
    MotionBounds,
    MotionCertifier,
    ObstacleProximity,
    SegmentState,
    SelfProximity,
)
from elastic_strips.collision.strip_certificate import Certifier
from elastic_strips.native import twin
from elastic_strips.robot import Kinematics, load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Voxels
from elastic_strips.work import counted

ROUND = """<robot name="round"><link name="base_link"><collision><origin xyz="0 0 0.2"/><geometry>
  <cylinder radius="0.3" length="0.2"/></geometry></collision></link></robot>"""
SHAPES = ("box", "sphere", "cylinder", "capsule", "convex", "mesh", "voxels")
CLEARANCE = 0.02


def motion(robot, rng: np.random.Generator, count: int = 30, swing: float = 0.6) -> np.ndarray:
    """Samples on the arc from one posture to another one near by."""
    space = robot.space
    start = random_coordinates(robot, rng, 1)[0]
    v = rng.uniform(-swing, swing, space.nv)
    v[0], v[1] = rng.uniform(0.3, 1.2), 0.0
    end = np.clip(space.integrate(start[None], v[None])[0], space.lower, space.upper)
    v = space.difference(start[None], end[None])[0]
    return space.integrate(np.repeat(start[None], count, axis=0), np.linspace(0.0, 1.0, count)[:, None] * v)


def forecast(rng: np.random.Generator, moving: list[int]) -> Forecast:
    m = len(moving)
    velocity = np.column_stack((rng.uniform(-0.8, 0.8, (m, 2)), np.zeros(m)))
    return Forecast(np.array(moving), velocity, rng.uniform(0, 0.02, m), rng.uniform(0, 0.1, m), rng.uniform(0, 0.3, m))


def at_every_sample(robot, coordinates, v, scene, ahead, clearance: float):
    """The certificate of strips."""
    bodies = BodySet.links(robot)
    bounds = MotionBounds(bodies)
    kin = Kinematics(robot.tree, len(coordinates))
    kin.update(coordinates)
    obstacles = ObstacleProximity(bodies, influence=clearance + 0.1)
    obstacles.update(kin, scene, ahead)
    pairs = SelfProximity(bodies, robot.self_pairs, bounds, influence=0.02)
    pairs.update(kin)
    certifier = Certifier(bodies, bounds, obstacles, pairs)
    return certifier.certify(kin, v, clearance=clearance, self_clearance=1e-3, scene=scene), obstacles, pairs


@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_the_verdict_is_that_of_all_samples_and_asks_less(name, request, rng):
    robot = request.getfixturevalue(name)
    bodies = BodySet.links(robot)
    certifier = MotionCertifier(bodies, MotionBounds(bodies), robot.self_pairs)
    verdicts, asked = {True: 0, False: 0}, [0, 0]
    for k in range(60):
        coordinates = motion(robot, rng, swing=0.3 if k % 2 else 0.0)
        low, high = coordinates[:, :2].min(axis=0) - 1.2, coordinates[:, :2].max(axis=0) + 1.2
        scene = Scene([make_obstacle(s, rng, (*low, 0.0), (*high, 1.5)) for s in rng.choice(SHAPES, 3)])
        times = np.linspace(0.0, 1.0, len(coordinates))
        ahead = forecast(rng, sorted(rng.choice(3, int(rng.integers(0, 3)), replace=False).tolist())).predict(times)
        v = robot.space.difference(coordinates[:-1], coordinates[1:])
        before = counted()
        mine = certifier.certify(coordinates, v, scene, ahead, clearance=CLEARANCE, self_clearance=1e-3)
        between = counted()
        theirs, _, _ = at_every_sample(robot, coordinates, v, scene, ahead, CLEARANCE)
        after = counted()
        assert mine.certified == theirs.certified
        assert mine.segments.all() == (mine.broken is None)
        if mine.broken is not None:
            assert not mine.segments.any()  # nothing is said of the others
            assert mine.broken.certain
            assert mine.states[mine.broken.segment] == SegmentState.COLLIDING
        else:
            for k, work in enumerate((between - before, after - between)):
                asked[k] += work.pairs + work.queries
        verdicts[mine.certified] += 1
    assert min(verdicts.values()) >= 10
    assert asked[0] < 0.9 * asked[1]


def test_certified_is_free_at_all_times(silvermate, rng):
    """Dense in time, by brute force, the obstacle moved to where the forecast has it at the worst."""
    bodies = BodySet.links(silvermate)
    certifier = MotionCertifier(bodies, MotionBounds(bodies), silvermate.self_pairs)
    certified, nearest = 0, np.inf
    for _ in range(40):
        coordinates = motion(silvermate, rng, 12, swing=0.2)
        where = coordinates[int(rng.integers(12)), :2] + rng.uniform(-0.8, 0.8, 2)
        scene = Scene([Sphere(0.15, at=(*where, rng.uniform(0.1, 1.2)))])
        velocity = np.array([[*rng.uniform(-0.6, 0.6, 2), 0.0]])
        expected = Forecast(np.array([0]), velocity, np.zeros(1), np.array([0.05]), np.zeros(1))
        v = silvermate.space.difference(coordinates[:-1], coordinates[1:])
        times = np.linspace(0.0, 1.0, 12)
        certificate = certifier.certify(
            coordinates, v, scene, expected.predict(times), clearance=CLEARANCE, self_clearance=1e-3
        )
        if not certificate.certified:
            continue
        certified += 1
        for f in np.linspace(0.0, 11.0, 89):
            s = min(int(f), 10)
            row = silvermate.space.integrate(coordinates[s : s + 1], (f - s) * v[s : s + 1])[0]
            t = f / 11.0
            pose = scene.obstacles[0].pose.copy()
            pose[:3, 3] += velocity[0] * t
            d = link_distances(silvermate, scene.moved(scene.names[0], pose), configuration(silvermate, row)).min()
            nearest = min(nearest, d - 0.05 * t)
            assert d - 0.05 * t > CLEARANCE - 1e-5
    assert certified >= 8
    assert nearest < 0.3  # some of them were near


def test_what_lies_between_two_samples_is_found(silvermate):
    """A thin post that a single long step of a turning base sweeps over; both samples are far from it."""
    bodies = BodySet.links(silvermate)
    certifier = MotionCertifier(bodies, MotionBounds(bodies), silvermate.self_pairs)
    coordinates = np.stack([silvermate.space.to_coordinates(silvermate.home(x=x)) for x in (0.0, 2.0)])
    v = silvermate.space.difference(coordinates[:1], coordinates[1:])
    ahead = forecast(np.random.default_rng(0), []).predict(np.zeros(2))
    post = Box((0.02, 0.02, 1.0), at=(1.0, 0.0, 0.5), name="post")
    hit = certifier.certify(coordinates, v, Scene([post]), ahead, clearance=CLEARANCE, self_clearance=1e-3)
    assert not hit.certified
    assert hit.broken.obstacle == "post"
    aside = Box((0.02, 0.02, 1.0), at=(1.0, 0.9, 0.5), name="post")
    assert certifier.certify(coordinates, v, Scene([aside]), ahead, clearance=CLEARANCE, self_clearance=1e-3).certified


def test_what_stays_a_micron_outside_is_given_up(tmp_path):
    """A round base that turns beside a post: to the end, it would be looked at a hundred thousand times."""
    (tmp_path / "round.urdf").write_text(ROUND)
    robot = load_robot(tmp_path / "round.urdf", base="diff_drive")
    post = Cylinder(0.1, 1.0, at=(0.3 + 0.1 + CLEARANCE + 1.5e-5, 0.0, 0.5), name="post")
    bodies = BodySet.links(robot)
    coordinates = np.column_stack((np.zeros((9, 2)), np.linspace(0.0, 2.0, 9)))
    v = robot.space.difference(coordinates[:-1], coordinates[1:])
    ahead, found = forecast(np.random.default_rng(0), []).predict(np.zeros(9)), []
    for other in (False, True):
        with twin() if other else nullcontext():
            certifier = MotionCertifier(bodies, MotionBounds(bodies), robot.self_pairs)
            found.append(
                certifier.certify(coordinates, v, Scene([post]), ahead, clearance=CLEARANCE, self_clearance=1e-3)
            )
            assert certifier.checks < 5000
    assert found[0].certified == found[1].certified
    assert all(not each.certified and each.broken is not None and not each.broken.certain for each in found)


def test_many_pairs_are_searched_to_the_end(silvermate):
    """A robot that turns among walls of voxels has a thousand pairs to look at, and each of them several times."""
    wall = np.array([(x, y, z) for x in range(-30, 30, 2) for y in (-10, 10) for z in range(2, 40, 2)])
    walls = np.unique(np.vstack((wall, wall[:, [1, 0, 2]])), axis=0)
    scene = Scene([Voxels(0.05 * (walls + 0.5), 0.05, name="walls")])
    bodies = BodySet.links(silvermate)
    coordinates = np.repeat(silvermate.space.to_coordinates(silvermate.home())[None], 41, axis=0)
    coordinates[:, 2] = np.linspace(0.0, 6.0, 41)
    v = silvermate.space.difference(coordinates[:-1], coordinates[1:])
    ahead = forecast(np.random.default_rng(0), []).predict(np.zeros(41))
    for other in (False, True):
        with twin() if other else nullcontext():
            certifier = MotionCertifier(bodies, MotionBounds(bodies), silvermate.self_pairs)
            found = certifier.certify(coordinates, v, scene, ahead, clearance=CLEARANCE, self_clearance=1e-3)
            assert found.certified, found.broken


def test_links_that_meet_between_samples_are_found(silvermate, rng):
    bodies = BodySet.links(silvermate)
    certifier = MotionCertifier(bodies, MotionBounds(bodies), silvermate.self_pairs)
    verdicts = {True: 0, False: 0}
    nothing = Scene([])
    ahead = forecast(rng, []).predict(np.zeros(4))
    for _ in range(60):
        ends = random_coordinates(silvermate, rng, 2)
        v = silvermate.space.difference(ends[:1], ends[1:])
        coordinates = silvermate.space.integrate(np.repeat(ends[:1], 4, axis=0), np.linspace(0, 1, 4)[:, None] * v)
        steps = silvermate.space.difference(coordinates[:-1], coordinates[1:])
        mine = certifier.certify(coordinates, steps, nothing, ahead, clearance=CLEARANCE, self_clearance=1e-3)
        assert mine.certified == at_every_sample(silvermate, coordinates, steps, nothing, ahead, CLEARANCE)[0].certified
        verdicts[mine.certified] += 1
        assert mine.broken is None or mine.broken.kind == "self"
    assert min(verdicts.values()) >= 5
