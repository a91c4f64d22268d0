"""Certificates of motions: against brute force in time, with what obstacles can do until the robot stands."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import configuration, link_distances

from elastic_strips.control import ObstacleAssumptions
from elastic_strips.control.prediction import predict
from elastic_strips.planning import straight_line
from elastic_strips.scene import Cylinder, Scene, Sphere, Twist, UnknownMotion
from elastic_strips.trajectory import MotionLimits, Retimer
from elastic_strips.trajectory.trajectory import TrajectoryCertifier

EXACT = ObstacleAssumptions(position_error=0.0, velocity_error=0.0, acceleration=0.0)


@pytest.fixture(scope="module")
def motion(silvermate):
    coordinates = straight_line(silvermate, silvermate.home(), silvermate.home(x=1.5), spacing=0.1)
    return Retimer(silvermate, MotionLimits.for_robot(silvermate), dt=0.02).horizon(coordinates, start_time=0.0)


def nearest(robot, motion, scene: Scene) -> float:
    """Least distance over the motion to obstacles on their true tracks."""
    times = np.linspace(motion.start_time, motion.end_time, 160)
    d = np.inf
    for t in times:
        d = min(d, link_distances(robot, scene.at(t), configuration(robot, motion.at(t).coordinates)).min())
    return float(d)


def test_certified_where_the_obstacle_will_have_passed(silvermate, motion):
    certifier = TrajectoryCertifier(silvermate, clearance=0.02)
    verdicts = {True: 0, False: 0}
    rng = np.random.default_rng(0)
    for _ in range(30):
        x, speed = rng.uniform(0.3, 1.8), rng.uniform(0.4, 1.5)
        scene = Scene([Cylinder(0.15, 1.6, at=(x, -rng.uniform(0.5, 2.5), 0.8), motion=Twist((0.0, speed, 0.0)))])
        certificate = certifier.certify(motion, scene, predict(scene, EXACT))
        d = nearest(silvermate, motion, scene)
        if certificate.certified:
            assert d > 0.02 - 1e-4
        else:
            assert d < 0.02 + 0.05  # the settling time and the grid of samples
        verdicts[certificate.certified] += 1
    assert min(verdicts.values()) >= 5


def test_uncertainty_grows_until_the_end(silvermate, motion):
    """An obstacle of unknown motion counts where it may be when the robot passes or stands."""
    certifier = TrajectoryCertifier(silvermate, clearance=0.02)
    for gap, bound, good in ((0.5, 0.2, True), (0.5, 0.35, False), (1.0, 0.35, True)):
        x = 1.5 + 0.30 + 0.15 + gap
        scene = Scene([Cylinder(0.15, 0.3, at=(x, 0.0, 0.15), motion=UnknownMotion(bound))])
        reach = bound * motion.duration
        assert (gap - reach > 0.02) == good
        assert certifier.certify(motion, scene, predict(scene, EXACT)).certified == good


def test_the_settling_time_counts(silvermate, motion):
    """Something that arrives while the robot still creeps on."""
    late = motion.end_time + 0.2
    gap = 0.9 * late
    scene = Scene([Sphere(0.1, at=(1.5 + 0.27 + 0.1 + gap + 0.05, 0.0, 0.2), motion=Twist((-0.9, 0, 0)))])
    verdicts = [
        TrajectoryCertifier(silvermate, clearance=0.02, settle_time=s)
        .certify(motion, scene, predict(scene, EXACT))
        .certified
        for s in (0.0, 0.6)
    ]
    assert verdicts == [True, False]


def test_an_old_snapshot_is_carried_forward(silvermate, motion):
    """The scene may be older than the motion: what moved meanwhile is accounted for."""
    track = Twist((0.0, 1.0, 0.0))
    certifier = TrajectoryCertifier(silvermate, clearance=0.02)
    now = Scene([Cylinder(0.15, 1.6, at=(0.8, -1.9, 0.8), motion=track)])
    for age in (0.0, 0.5, 1.0):
        old = now.at(-age)
        a = certifier.certify(motion, old, predict(old, EXACT))
        b = certifier.certify(motion, now, predict(now, EXACT))
        np.testing.assert_array_equal(a.states, b.states)
