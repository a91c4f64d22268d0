"""Forecasts: distances at the time when a node is reached, against scenes whose obstacles stand there."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import configuration, link_distances, make_obstacle, random_coordinates
from cases import each

from elastic_strips.collision import BodySet, Forecast, ObstacleProximity
from elastic_strips.errors import ParameterError
from elastic_strips.robot import Kinematics
from elastic_strips.scene import Scene, Sphere

SHAPES = ("box", "sphere", "cylinder", "capsule", "convex", "mesh", "voxels")
INFLUENCE = 0.5


def forecast(rng: np.random.Generator, obstacles: list[int], horizon: float = np.inf) -> Forecast:
    m = len(obstacles)
    return Forecast(
        np.array(obstacles), rng.uniform(-0.5, 0.5, (m, 3)), rng.uniform(0, 0.02, m), rng.uniform(0, 0.1, m),
        rng.uniform(0, 0.2, m), horizon,
    )  # fmt: skip


def truth(robot, scene: Scene, row, shift: np.ndarray, growth: np.ndarray, moving: list[int]) -> np.ndarray:
    """Distances (G, P) with the moving obstacles put where they will be."""
    there = scene
    for m, k in enumerate(moving):
        pose = scene.obstacles[k].pose.copy()
        pose[:3, 3] += shift[m]
        there = there.moved(scene.names[k], pose)
    d = link_distances(robot, there, configuration(robot, row))
    for m, k in enumerate(moving):
        d[:, scene.table.obstacle_index == k] -= growth[m]
    return d


@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_distances_are_those_at_the_time_of_the_node(name, request, rng):
    robot = request.getfixturevalue(name)
    compared = 0
    for _ in range(3):
        scene = Scene([make_obstacle(s, rng, (-1.5, -1.5, 0.0), (1.5, 1.5, 1.5)) for s in SHAPES])
        moving = sorted(rng.choice(len(SHAPES), 4, replace=False).tolist())
        coordinates = random_coordinates(robot, rng, 5)
        kin = Kinematics(robot.tree, 5)
        kin.update(coordinates)
        times = np.sort(rng.uniform(0.0, 2.0, 5))
        ahead = forecast(rng, moving).predict(times)
        proximity = ObstacleProximity(BodySet.links(robot), influence=INFLUENCE)
        proximity.update(kin, scene, ahead)
        window = proximity.candidates
        contacts = proximity.contacts()
        for n in range(5):
            d = truth(robot, scene, coordinates[n], ahead.shift[n], ahead.uncertainty[n], moving)[:, window.rows]
            # of a block that is penetrated the deepest box counts, where the tree stops at the first
            solid = np.array([p.geometry is not None for p in window.parts])
            assert (proximity.bound[n] <= d + 1e-9)[:, solid].all()
            mine = contacts.node == n
            near = np.zeros(d.shape, dtype=bool)
            near[contacts.body[mine], contacts.part[mine]] = True
            assert near[d < INFLUENCE - 1e-3].all()
            exact = proximity.exact[n]
            both = near & solid & (d > -0.01)
            np.testing.assert_allclose(exact[both], d[both], atol=1e-4)
            compared += int(both.sum())
        # the witness lies on the robot where it really is
        keep = contacts.distance > 0.0
        ends = BodySet.links(robot).capsule_ends(kin)[contacts.node, contacts.body][keep]
        witness = contacts.witness[keep]
        a, b = ends[:, 0], ends[:, 1]
        s = np.clip(np.einsum("ki,ki->k", witness - a, b - a) / np.maximum(np.sum((b - a) ** 2, 1), 1e-12), 0, 1)
        gap = np.linalg.norm(witness - a - s[:, None] * (b - a), axis=1)
        assert (gap <= BodySet.links(robot).radius[contacts.body[keep]] + 1e-4).all()
    assert compared > 60


def test_a_forecast_that_is_dropped_leaves_no_trace(silvermate, rng):
    scene = Scene([make_obstacle(s, rng, (-1, -1, 0.0), (1, 1, 1.5)) for s in SHAPES])
    coordinates = random_coordinates(silvermate, rng, 4)
    kin = Kinematics(silvermate.tree, 4)
    kin.update(coordinates)
    used, fresh = (ObstacleProximity(BodySet.links(silvermate), influence=INFLUENCE) for _ in range(2))
    for moving in ([0, 3], [1], [0, 1, 2, 5]):
        used.update(kin, scene, forecast(rng, moving).predict(np.linspace(0.0, 3.0, 4)))
    used.update(kin, scene)
    fresh.update(kin, scene)
    one, two = used.contacts(), fresh.contacts()
    order = [np.lexsort((used.candidates.rows[c.part], c.body, c.node)) for c in (one, two)]
    assert len(one) == len(two) > 10
    np.testing.assert_allclose(one.distance[order[0]], two.distance[order[1]], atol=1e-9)


@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_what_is_kept_from_tick_to_tick_never_exceeds_the_distance(name, request, rng):
    """Obstacles advance and turn, forecasts and nodes change a little: bounds are carried along, most are not asked."""
    robot = request.getfixturevalue(name)
    scene = Scene([make_obstacle(s, rng, (-1.2, -1.2, 0.0), (1.2, 1.2, 1.5)) for s in SHAPES[:6]])
    moving = [0, 2, 3, 5]
    expected = forecast(rng, moving, horizon=1.8)
    expected.velocity[1], expected.speed[1] = 0.0, 0.3  # it only grows
    coordinates = random_coordinates(robot, rng, 6)
    kin = Kinematics(robot.tree, 6)
    used = ObstacleProximity(BodySet.links(robot), influence=INFLUENCE)
    for tick in range(24):
        times = np.linspace(0.0, 1.7, 6) + rng.uniform(0.0, 0.02) + 0.4 * (tick % 3 == 2)
        if tick % 4 == 3:  # a node goes, another one comes
            source = np.array([0, 1, 3, 4, -1, 5])
            used.remap(source)
            coordinates = np.where((source < 0)[:, None], random_coordinates(robot, rng, 6), coordinates[source])
        elif tick % 2:
            coordinates = robot.space.integrate(coordinates, rng.uniform(-0.003, 0.003, coordinates.shape))
        for k in moving[:3]:
            pose = scene.obstacles[k].pose.copy()
            pose[:3, 3] += rng.uniform(-0.01, 0.01, 3) * (tick % 2)
            a = rng.uniform(-0.01, 0.01) if tick % 2 else rng.uniform(-0.4, 0.4)
            pose[:2, :3] = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) @ pose[:2, :3]
            scene = scene.moved(scene.names[k], pose)
        kin.update(coordinates)
        ahead = expected.predict(times)
        used.update(kin, scene, ahead)
        window, found = used.candidates, used.contacts()
        for n in range(6):
            d = truth(robot, scene, coordinates[n], ahead.shift[n], ahead.uncertainty[n], moving)[:, window.rows]
            mine = found.node == n
            near = np.zeros(d.shape, dtype=bool)
            near[found.body[mine], found.part[mine]] = True
            heard = ~ahead.ignored[n] | ~np.isin(window.obstacle, moving)
            assert (used.bound[n] <= d + 1e-9)[:, heard].all()
            apart = heard & (d > 0.0)
            contacts = near & apart
            np.testing.assert_allclose(used.exact[n][contacts], d[contacts], atol=2.1e-3)
            assert contacts[(d < INFLUENCE - 5e-3) & apart].all()


def test_what_moves_as_expected_is_not_asked_again(silvermate, rng):
    """A tick later it is nearer, and the nodes are reached sooner: where they meet, nothing has changed."""
    scene = Scene([make_obstacle(s, rng, (-1.2, -1.2, 0.0), (1.2, 1.2, 1.5)) for s in SHAPES[:6]])
    velocity = np.array([[0.4, -0.3, 0.0], [-0.2, 0.5, 0.0], [0.1, 0.1, 0.0]])
    expected = Forecast(np.array([0, 2, 4]), velocity, np.zeros(3), np.zeros(3), np.zeros(3))
    kin = Kinematics(silvermate.tree, 6)
    kin.update(random_coordinates(silvermate, rng, 6))
    times = np.linspace(0.2, 2.0, 6)
    proximity = ObstacleProximity(BodySet.links(silvermate), influence=INFLUENCE)
    proximity.update(kin, scene, expected.predict(times))
    first = proximity.narrow.queries
    assert first > 20
    for tick in range(1, 4):
        there = scene
        for m, k in enumerate((0, 2, 4)):
            pose = scene.obstacles[k].pose.copy()
            pose[:3, 3] += 0.05 * tick * velocity[m]
            there = there.moved(scene.names[k], pose)
        proximity.update(kin, there, expected.predict(times - 0.05 * tick))
    assert proximity.narrow.queries == first
    proximity.update(kin, scene, expected.predict(times + 0.1))
    assert proximity.narrow.queries > first


def test_what_comes_from_far_away_is_in_the_window(silvermate):
    """An obstacle 20 m off that will be here in time."""
    scene = Scene([Sphere(0.2, at=(20.0, 0.0, 0.3))])
    kin = Kinematics(silvermate.tree, 2)
    kin.update(np.repeat(silvermate.space.to_coordinates(silvermate.home())[None], 2, axis=0))
    coming = Forecast(np.array([0]), np.array([[-10.0, 0.0, 0.0]]), np.zeros(1), np.zeros(1), np.zeros(1))
    proximity = ObstacleProximity(BodySet.links(silvermate), influence=INFLUENCE)
    proximity.update(kin, scene)
    assert len(proximity.contacts()) == 0
    proximity.update(kin, scene, coming.predict(np.array([0.0, 1.95])))
    contacts = proximity.contacts()
    assert set(contacts.node) == {1}
    assert contacts.distance.min() == pytest.approx(0.5 - 0.2 - 0.27, abs=2e-3)
    proximity.update(kin, scene, coming.predict(np.array([0.0, 1.9])))
    assert proximity.clearance()[1].min() == INFLUENCE


def test_beyond_the_horizon_nothing_is_said(silvermate):
    scene = Scene([Sphere(0.2, at=(0.3, 0.0, 0.3)), Sphere(0.2, at=(-0.3, 0.0, 0.3))])
    kin = Kinematics(silvermate.tree, 3)
    kin.update(np.repeat(silvermate.space.to_coordinates(silvermate.home())[None], 3, axis=0))
    still = Forecast(np.array([0]), np.zeros((1, 3)), np.zeros(1), np.zeros(1), np.zeros(1), horizon=1.0)
    proximity = ObstacleProximity(BodySet.links(silvermate), influence=INFLUENCE)
    proximity.update(kin, scene, still.predict(np.array([0.0, 0.9, 1.1])))
    contacts = proximity.contacts()
    obstacle = proximity.candidates.obstacle[contacts.part]
    assert set(contacts.node[obstacle == 0]) == {0, 1}
    assert set(contacts.node[obstacle == 1]) == {0, 1, 2}


@each(
    "change, message",
    [
        ({"velocity": np.zeros((2, 3))}, r"velocity has shape \(2, 3\); 1 obstacles need \(1, 3\)"),
        ({"speed": np.array([-0.1])}, "speed holds -0.1; it must be ≥ 0"),
        ({"acceleration": np.array([np.nan])}, "acceleration holds a value that is not finite"),
    ],
)
def test_forecasts_are_checked(change, message):
    values = {"velocity": np.zeros((1, 3)), "offset": np.zeros(1), "speed": np.zeros(1), "acceleration": np.zeros(1)}
    with pytest.raises(ParameterError, match=message):
        Forecast(np.array([0]), **(values | change))
