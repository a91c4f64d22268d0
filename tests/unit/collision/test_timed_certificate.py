"""Certificates of strips among moving obstacles: nothing that is certified comes near what it meets on its way."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import configuration, link_distances, make_obstacle

from elastic_strips.collision import Forecast
from elastic_strips.scene import Cylinder, Scene
from elastic_strips.strip import Deformer, DeformParams, Strip

SHAPES = ("box", "sphere", "cylinder", "capsule", "cone", "convex")


def closest(strip: Strip, segment: int, scene: Scene, forecast: Forecast, times: np.ndarray, samples: int) -> float:
    """Nearest that the robot comes to the grown obstacles on a segment, by dense sampling in time."""
    robot, nearest = strip.robot, np.inf
    for f in np.linspace(0.0, 1.0, samples):
        t = (1.0 - f) * times[segment] + f * times[segment + 1]
        row = robot.space.interpolate(strip.coordinates[segment], strip.coordinates[segment + 1], f)
        there = scene
        for m, k in enumerate(forecast.obstacles):
            pose = scene.obstacles[k].pose.copy()
            pose[:3, 3] += forecast.velocity[m] * t
            there = there.moved(scene.names[k], pose)
        d = link_distances(robot, there, configuration(robot, row))
        growth = np.zeros(len(scene))
        growth[forecast.obstacles] = forecast.offset + forecast.speed * t + 0.5 * forecast.acceleration * t * t
        nearest = min(nearest, float((d - growth[scene.table.obstacle_index]).min()))
    return nearest


@pytest.mark.parametrize("name", ["silvermate", "rover"])
def test_certified_among_moving_obstacles(name, request, rng):
    robot = request.getfixturevalue(name)
    deformer = Deformer(robot, DeformParams(clearance=0.01))
    certified, refused, near = 0, 0, 0
    for _ in range(7):
        scene = Scene([make_obstacle(s, rng, (-0.5, -1.5, 0.0), (2.5, 1.5, 1.2)) for s in SHAPES])
        moving = sorted(rng.choice(len(SHAPES), 3, replace=False).tolist())
        forecast = Forecast(
            np.array(moving), rng.uniform(-1.0, 1.0, (3, 3)), np.full(3, 0.01), rng.uniform(0, 0.1, 3),
            rng.uniform(0, 0.4, 3),
        )  # fmt: skip
        strip = Strip(
            robot, [robot.home(x=x, y=0.3 * y) for x, y in zip(np.linspace(0, 2, 5), rng.normal(size=5), strict=True)]
        )
        times = np.cumsum(np.append(0.0, rng.uniform(0.1, 0.6, 4)))
        ahead = forecast.predict(times)
        report = deformer.assess(strip, scene, prediction=lambda coordinates, ahead=ahead: ahead)
        for j, good in enumerate(report.certificate.segments):
            d = closest(strip, j, scene, forecast, times, 41)
            if good:
                assert d > 0.01 - 1e-5
                certified += 1
                near += d < 0.08
            else:
                assert d < 0.2
                refused += 1
        still = deformer.certify(strip, scene)
        fresh = Deformer(robot, DeformParams(clearance=0.01)).certify(strip, scene)
        np.testing.assert_array_equal(still.states, fresh.states)
    assert certified >= 4
    assert refused >= 4


def test_what_begins_before_the_snapshot_meets_obstacles_where_they_were(silvermate):
    """A motion that has begun when the scene is sensed: the obstacle came from somewhere, and moved all the while."""
    strip = Strip(silvermate, [silvermate.home(x=x) for x in np.linspace(0.0, 2.0, 9)])
    times = np.linspace(-1.5, 0.5, 9)
    sensed = np.array([0.5 * (times[3] + times[4]), 0.0])  # where and when it crossed the robot's path
    velocity = np.array([[0.0, 0.9, 0.0]])
    at = (strip.coordinates[3, 0], -velocity[0, 1] * sensed[0], 0.4)
    scene = Scene([Cylinder(0.1, 0.8, at=at, name="walker")])
    known = Forecast(np.array([0]), velocity, np.zeros(1), np.zeros(1), np.zeros(1))
    deformer = Deformer(silvermate, DeformParams(clearance=0.01))
    report = deformer.assess(strip, scene, prediction=lambda coordinates: known.predict(times))
    distances = [closest(strip, j, scene, known, times, 41) for j in range(len(strip) - 1)]
    assert min(distances) < 0.0 < max(distances)
    for good, d in zip(report.certificate.segments, distances, strict=True):
        assert not good or d > 0.01 - 1e-5


def test_bounds_grow_into_the_past_as_into_the_future():
    walker = Forecast(np.array([0]), np.array([[0.3, -0.2, 0.0]]), np.full(1, 0.01), np.full(1, 0.1), np.full(1, 0.5))
    ahead = walker.predict(np.array([-2.0, 0.0, 2.0]))
    np.testing.assert_allclose(ahead.shift[0], -ahead.shift[2])
    np.testing.assert_allclose(ahead.uncertainty[:, 0], [1.21, 0.01, 1.21])


def test_a_crossing_obstacle_is_passed_behind(silvermate):
    """The strip goes where the obstacle will have left, and not where it stands now."""
    from elastic_strips.planning import straight_line

    scene = Scene([Cylinder(0.3, 1.6, at=(2.0, 0.2, 0.8), name="walker")])
    leaving = Forecast(np.array([0]), np.array([[0.0, 0.8, 0.0]]), np.zeros(1), np.zeros(1), np.zeros(1))
    strip = Strip.from_coordinates(
        silvermate, straight_line(silvermate, silvermate.home(), silvermate.home(x=4.0), spacing=0.13)
    )

    def prediction(coordinates):
        v = silvermate.space.difference(coordinates[:-1], coordinates[1:])
        return leaving.predict(np.append(0.0, np.cumsum(np.hypot(v[:, 0], v[:, 1]))) / 1.0)

    deformer = Deformer(silvermate)
    aside, around = strip, strip
    for _ in range(15):
        moving = deformer.step(aside, scene, prediction=prediction)
        aside = moving.strip
    assert moving.certified
    standing = Deformer(silvermate).settle(around, scene, max_ticks=15)
    assert np.abs(aside.coordinates[:, 1]).max() < 0.05
    assert np.abs(standing.strip.coordinates[:, 1]).max() > 0.2


def test_a_strip_that_does_not_move_is_certified_against_the_newest_scene(silvermate):
    """Also where it is the strip of the last report, and what was foreseen has turned out otherwise."""
    deformer = Deformer(silvermate, DeformParams(clearance=0.01))
    strip = Strip(silvermate, [silvermate.home(x=x) for x in np.linspace(0.0, 2.0, 8)])
    far = Scene([Cylinder(0.2, 1.5, at=(1.0, -3.0, 0.75), name="walker")])
    waits = Forecast(np.array([0]), np.zeros((1, 3)), np.zeros(1), np.zeros(1), np.zeros(1))

    def prediction(coordinates):
        return waits.predict(np.linspace(0.0, 2.0, len(coordinates)))

    report = deformer.step(strip, far, prediction=prediction)
    assert report.certified
    pose = far.obstacle("walker").pose.copy()
    pose[1, 3] = 0.0
    near = far.moved("walker", pose)
    assert not deformer.assess(report.strip, near, prediction=prediction).certified
