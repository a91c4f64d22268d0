"""What the bisection measures, against brute force: lower bounds never above the truth, distances equal to it."""

from __future__ import annotations

import numpy as np
from brute_force import SHAPES, configuration, link_distances, make_obstacle, random_coordinates, self_distances
from cases import each, each_robot

from elastic_strips.collision import BodySet, Forecast, MotionBounds, ObstacleProximity, SelfProximity
from elastic_strips.collision.certificate import ObstaclePairs, SelfPairs
from elastic_strips.robot import Kinematics
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Strip
from elastic_strips.strip.strip import strip_clearance

NOISE = 2e-5


def test_obstacle_pairs_among_moving_parts(silvermate, rng):
    coordinates = random_coordinates(silvermate, rng, 4)
    kin, between = Kinematics(silvermate.tree, 4), Kinematics(silvermate.tree, 4)
    kin.update(coordinates)
    scene = Scene([make_obstacle(s, rng, (-1.0, -1.0, 0.0), (1.0, 1.0, 1.5)) for s in SHAPES])
    forecast = Forecast(np.array([0, 2]), rng.normal(size=(2, 3)), np.full(2, 0.01), np.full(2, 0.1), np.full(2, 0.2))
    times = np.array([0.0, 0.3, 0.5, 0.6])
    proximity = ObstacleProximity(BodySet.links(silvermate), influence=3.0)
    proximity.update(kin, scene, forecast.predict(times))
    window = proximity.candidates
    pairs = ObstaclePairs(proximity.bodies, proximity.narrow, window, proximity.moving)
    count = len(proximity.bodies) * len(window)
    for place in (0.25, 1.5, 2.75):
        s = int(place)
        row = silvermate.space.interpolate(coordinates[s : s + 1], coordinates[s + 1 : s + 2], place - s)
        between.update(row, jacobians=False)
        ahead = forecast.predict(times)
        shift = (1 - place + s) * ahead.shift[s] + (place - s) * ahead.shift[s + 1]
        growth = (1 - place + s) * ahead.uncertainty[s] + (place - s) * ahead.uncertainty[s + 1]
        moved = scene
        less = np.zeros(len(scene))
        for m, k in enumerate(forecast.obstacles):
            pose = scene.obstacles[k].pose.copy()
            pose[:3, 3] += shift[m]
            moved, less[k] = moved.moved(scene.names[k], pose), growth[m]
        truth = link_distances(silvermate, moved, configuration(silvermate, row[0]))[:, window.rows]
        truth = (truth - less[window.obstacle]).ravel()
        given = (between, np.zeros(count, dtype=int), np.full(count, place), np.arange(count))
        low, d = pairs.lower_bounds(*given), pairs.distances(*given)
        apart = truth + np.tile(less[window.obstacle], len(proximity.bodies)) > 0.0
        assert (low <= truth + NOISE)[apart].all()
        assert (low >= truth - 1.0)[apart].any()
        np.testing.assert_allclose(d[apart], truth[apart], atol=NOISE)
        assert apart.sum() > 50


@each_robot
def test_self_pairs(robot, rng):
    bodies = BodySet.links(robot)
    pairs = SelfPairs(SelfProximity(bodies, robot.self_pairs, MotionBounds(bodies), influence=0.1))
    kin, coordinates = Kinematics(robot.tree, 8), random_coordinates(robot, rng, 12)
    kin.update(coordinates)
    truth = np.array([self_distances(robot, configuration(robot, row)) for row in coordinates])
    node, pair = (i.ravel() for i in np.indices(truth.shape))
    given = (kin, node, node.astype(float), pair)
    assert (pairs.lower_bounds(*given) <= truth.ravel() + 1e-9).all()
    np.testing.assert_allclose(pairs.distances(*given), truth.ravel(), atol=NOISE)


@each("seed", [13, 21, 25])
def test_the_clearance_of_a_strip_that_goes_deep_into_an_obstacle(silvermate, seed):
    """Lower bounds from boxes say nothing inside them; they once hid millimetres of a penetration."""
    rng, space = np.random.default_rng(seed), silvermate.space
    coordinates = random_coordinates(silvermate, rng, 1)
    coordinates = np.vstack((coordinates, space.integrate(coordinates, 0.3 * rng.normal(size=(1, silvermate.nv)))))
    coordinates = np.clip(coordinates, space.lower, space.upper)
    at = coordinates[:, :2].mean(axis=0) + rng.uniform(-0.3, 0.3, 2)
    scene = Scene([Box((0.5, 0.5, 0.6), at=(*at, rng.uniform(0.1, 0.9)))])
    rows = space.interpolate(coordinates[:1], coordinates[1:], np.linspace(0.0, 1.0, 60))
    truth = min(link_distances(silvermate, scene, configuration(silvermate, row)).min() for row in rows)
    value = strip_clearance(Strip.from_coordinates(silvermate, coordinates), scene)
    assert truth - 2e-3 <= value <= truth + 1e-6
