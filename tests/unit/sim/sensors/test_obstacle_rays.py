"""Beams and obstacles: exact distances and normals, every shape, motion, appearance; nothing shared with the oracle."""

from __future__ import annotations

import math
from contextlib import nullcontext

import numpy as np
import pytest
from brute_force import SHAPES, make_obstacle, make_scene
from cases import each
from free_way import along, outside_scene

from elastic_strips.native import twin
from elastic_strips.perception.rays import Nearest, RayBodies, Rays
from elastic_strips.scene import (
    Box,
    Capsule,
    Cone,
    ConvexHull,
    Cylinder,
    Mesh,
    Points,
    Scene,
    Sphere,
    Twist,
    Voxels,
    World,
)
from elastic_strips.sim.sensors.obstacle_rays import ObstacleRays

REACH = 12.0
EIGHTH = math.sin(math.pi / 8), math.cos(math.pi / 8)
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def beams(origin, directions) -> Rays:
    d = np.atleast_2d(np.asarray(directions, dtype=float))
    return Rays(np.atleast_2d(np.asarray(origin, dtype=float)), d / np.linalg.norm(d, axis=1, keepdims=True))


def world(*obstacles, **times) -> World:
    return World(Scene(obstacles), **times)


def random_transform(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, 0] *= np.sign(np.linalg.det(T[:3, :3]))
    T[:3, 3] = rng.uniform(-2, 2, 3)
    return T


def fan(count: int = 61, half: float = math.pi) -> np.ndarray:
    a = np.linspace(-half, half, count)
    return np.stack((np.cos(a), np.sin(a), 0.0 * a), axis=1)


@each(
    "obstacle, distance",
    [
        (Box([1, 2, 1], at=[3, 0, 0]), 2.5),
        (Box([1, 1, 1], at=[3, 0.1, 0], quat=[0, 0, *EIGHTH]), 3.1 - math.sqrt(0.5)),
        (Sphere(0.5, at=[3, 0.3, 0]), 3 - 0.4),
        (Cylinder(0.3, 1, at=[3, 0.18, 0.2]), 3 - 0.24),
        (Cylinder(0.3, 1, at=[3, 0, 0], quat=[0, math.sqrt(0.5), 0, math.sqrt(0.5)]), 2.5),
        (Capsule(0.3, 1, at=[3, 0.18, 0.2]), 3 - 0.24),
        (Capsule(0.3, 1, at=[3, 0, -0.68]), 3 - 0.24),
        (Cone(0.4, 0.8, at=[3, 0, 0]), 3 - 0.2),
        (Cone(0.4, 0.8, at=[3, 0, 0], quat=[0, math.sqrt(0.5), 0, math.sqrt(0.5)]), 2.6),
        (Cone(0.4, 0.8, at=[3, 0, 0], quat=[0, -math.sqrt(0.5), 0, math.sqrt(0.5)]), 2.6),
        (ConvexHull(CUBE, at=[3, 0.1, 0.2]), 2.5),
        (Mesh(CUBE, [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
                     [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], at=[3, 0.1, 0.2]), 2.5),
        (Voxels([[0, 0, 0], [0.2, 0, 0]], 0.2, at=[3, 0.01, 0.02]), 2.9),
        (Points([[0, 0.01, 0], [0.5, 0, 0]], 0.05, at=[3, 0, 0.02]), 2.95),
    ],
    ids=lambda v: getattr(v, "shape", None),
)  # fmt: skip
def test_distances_are_exact(obstacle, distance):
    """A beam along x; and the same from somewhere else, in another direction, with the whole world turned."""
    found = ObstacleRays(world(obstacle)).cast(0.0, beams([0, 0, 0], [1, 0, 0]), REACH, normals=True)
    assert found.distance[0] == pytest.approx(distance, abs=2e-6)
    assert np.linalg.norm(found.normal[0]) == pytest.approx(1.0, abs=1e-6)
    assert found.normal[0, 0] < 0.0  # outward
    behind = ObstacleRays(world(obstacle)).cast(0.0, beams([0, 0, 0], [-1, 0, 0]), REACH)
    assert behind.distance[0] == np.inf
    T = random_transform(np.random.default_rng(1))
    moved = world(obstacle.moved(T @ obstacle.pose))
    again = ObstacleRays(moved).cast(0.0, beams([0, 0, 0], [1, 0, 0]).moved(T), REACH, normals=True)
    assert again.distance[0] == pytest.approx(distance, abs=2e-6)
    if obstacle.shape != "cone":  # a beam into the apex has no normal of its own
        np.testing.assert_allclose(T[:3, :3].T @ again.normal[0], found.normal[0], atol=1e-6)


def test_a_round_pillar_is_round():
    """Every beam of a fan at a cylinder of 0.3 m: within a nanometre, where a millimetre would do."""
    rays = beams([0, 0, 0], fan(801, 0.5))
    found = ObstacleRays(world(Cylinder(0.3, 1, at=[1.5, 0, 0]))).cast(0.0, rays, REACH).distance
    angle = np.linspace(-0.5, 0.5, 801)
    room = 0.3**2 - (1.5 * np.sin(angle)) ** 2
    exact = np.where(room >= 0, 1.5 * np.cos(angle) - np.sqrt(np.maximum(room, 0)), np.inf)
    assert np.isfinite(exact).sum() > 200
    np.testing.assert_allclose(found, exact, atol=1e-9)


@each("shape", SHAPES)
def test_every_shape_against_its_own_inequalities(shape):
    """Free before the distance found, on the surface there; where nothing is found, free all the way."""
    rng = np.random.default_rng(SHAPES.index(shape))
    hits = 0
    for _ in range(6):
        scene = Scene([make_obstacle(shape, rng, (-1.0, -1.0, -0.5), (1.0, 1.0, 0.5))])
        origin = rng.uniform(-3, 3, 3)
        if outside_scene(origin[None], scene)[0] < 0.05:
            continue
        target = scene.obstacles[0].pose[:3, 3] + rng.uniform(-0.15, 0.15, (25, 3))
        rays = beams(origin, target - origin)
        found = ObstacleRays(World(scene)).cast(0.0, rays, REACH, normals=True)
        for d, direction, normal in zip(found.distance, rays.direction, found.normal, strict=True):
            way = outside_scene(along(origin, direction, min(d, REACH)), scene)
            assert way.min() > -1e-5
            if np.isfinite(d):
                hits += 1
                assert abs(way[-1]) < 1e-5
                assert normal @ direction < 1e-6
                out = outside_scene((origin + d * direction + 1e-3 * normal)[None], scene)[0]
                assert out > (
                    9e-4 if shape not in ("mesh", "voxels", "points") else 1e-5
                )  # straight out, from any corner
    assert hits > 20


def test_many_obstacles_many_origins():
    """Culling: a crowd is the nearest of its members, seen alone."""
    rng = np.random.default_rng(5)
    scene = make_scene(rng, 24, low=(-3.0, -3.0, 0.0), high=(3.0, 3.0, 1.0))
    origin = rng.uniform(-3, 3, (60, 3))
    targets = scene.table.center[rng.integers(0, len(scene.table), 60)]
    rays = beams(origin, targets + rng.uniform(-0.1, 0.1, (60, 3)) - origin)
    together = ObstacleRays(World(scene)).cast(0.0, rays, 4.0).distance
    alone = np.min([ObstacleRays(world(o)).cast(0.0, rays, 4.0).distance for o in scene], axis=0)
    both = (alone > 0.0) & (together > 0.0)  # inside of two bodies at once only one of them says so
    assert np.isfinite(alone[both]).sum() > 10
    assert np.isinf(alone).sum() > 5
    np.testing.assert_allclose(together[both], alone[both], atol=1e-5)


def test_nothing_beyond_the_reach():
    rays = beams([0, 0, 0], [1, 0, 0])
    for wall in (Box([1, 1, 1], at=[3, 0, 0]), ConvexHull(CUBE, at=[3, 0, 0])):
        assert ObstacleRays(world(wall)).cast(0.0, rays, 2.49).distance[0] == np.inf
        assert ObstacleRays(world(wall)).cast(0.0, rays, 2.51).distance[0] == pytest.approx(2.5, abs=1e-6)


@each("wall", [Box([1, 1, 1]), Sphere(0.5), Cone(0.5, 1), ConvexHull(CUBE), Voxels([[0, 0, 0]], 1)])
def test_inside_an_obstacle_the_distance_is_zero(wall):
    assert ObstacleRays(world(wall)).cast(0.0, beams([0, 0, 0.01], fan()), REACH).distance.max() == 0.0


@pytest.mark.parametrize("make", [lambda m: Box([1, 1, 1], motion=m), lambda m: ConvexHull(CUBE, motion=m)])
def test_what_moves_is_seen_where_it_is(make):
    """At any time, in any order; a turning one as it is turned."""
    moving = ObstacleRays(world(make(Twist([0.5, 0, 0], [0, 0, math.pi / 4])), Sphere(0.1, at=[0, 5, 0])))
    rays = beams([-4, 0, 0], [1, 0, 0])
    for t, turned in ((0.0, 0.5), (1.0, math.sqrt(0.5)), (2.0, 0.5), (0.0, 0.5)):
        assert moving.cast(t, rays, REACH).distance[0] == pytest.approx(4.0 + 0.5 * t - turned, abs=2e-6)


@each("make", [lambda x: Box([1, 1, 1], at=x, name="a"), lambda x: ConvexHull(CUBE, at=x, name="a")])
@each(
    "times, seen",
    [
        ({"appears": {"a": 1.0}, "vanishes": {"a": 2.0}}, [5.5, 2.5, 2.5, 5.5, 2.5]),
        ({"appears": {"a": 1.0}}, [5.5, 2.5, 2.5, 2.5, 2.5]),
        ({"vanishes": {"a": 2.0}}, [2.5, 2.5, 2.5, 5.5, 2.5]),
    ],
)
def test_what_appears_and_vanishes(make, times, seen):
    caster = ObstacleRays(world(make([3, 0, 0]), Box([2, 1, 1], at=[6.5, 0, 0]), **times))
    rays = beams([0, 0, 0], [1, 0, 0])
    got = [caster.cast(t, rays, REACH).distance[0] for t in (0.5, 1.0, 1.99, 2.0, 1.5)]
    assert got == pytest.approx(seen, abs=1e-6)


def test_an_empty_world_shows_nothing():
    assert np.isinf(ObstacleRays(world()).cast(0.0, beams([0, 0, 0], fan()), REACH).distance).all()


@each("padding", [0.0, 0.03])
def test_the_kernel_meets_what_its_twin_meets(padding):
    """Distances, normals and what is passed over, of every shape, from inside and outside."""
    rng = np.random.default_rng(8)
    geometries = [part for shape in SHAPES for part in _geometries(shape, rng)]
    count = len(geometries)
    T = np.array([random_transform(rng) for _ in range(count)])
    origin = rng.uniform(-2.5, 2.5, (3000, 3))
    origin[:count] = T[:, :3, 3]
    target = T[rng.integers(count, size=3000), :3, 3] + rng.normal(scale=0.08, size=(3000, 3))
    several = beams(origin, target - origin)
    for rays, inside in ((several, 0.0), (several, np.inf), (beams([2.5, 0.3, 0.2], target - [2.5, 0.3, 0.2]), 0.0)):
        found = []
        for other in (False, True):
            with twin() if other else nullcontext():
                bodies, nearest = RayBodies(geometries, padding), Nearest(len(rays), normals=True)
                bodies.place(np.ascontiguousarray(T[:, :3, :3]), T[:, :3, 3])
                bodies.cast(rays, nearest, reach=4.0, inside=inside)
                found.append(nearest)
        one, two = found
        assert 500 < np.isfinite(one.distance).sum() < 3000
        np.testing.assert_allclose(one.distance, two.distance, atol=1e-9)
        outside = np.isfinite(one.distance) & (one.distance > 0.0)
        same = np.linalg.norm(one.normal - two.normal, axis=1)[outside] < 1e-6
        assert same.mean() > 0.999  # on an edge either side is right


def _geometries(shape, rng):
    solid = make_obstacle(shape, rng, (-1.0, -1.0, -0.5), (1.0, 1.0, 0.5)).solid
    return [member for part in solid.parts for member in part.members]
