"""Shapes: what they are in Coal, their bounds, and which input is refused."""

import math
import pickle

import coal
import numpy as np
import pytest
from cases import each, refused
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import spatial

from elastic_strips.errors import SceneError
from elastic_strips.scene import (
    Box,
    Capsule,
    Cone,
    ConvexHull,
    Cylinder,
    Keyframes,
    Mesh,
    Obstacle,
    Points,
    Scene,
    Sphere,
    Twist,
    Voxels,
)

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
TETRA = ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
SHAPES = {
    "box": lambda **k: Box((0.4, 0.6, 0.8), **k),
    "sphere": lambda **k: Sphere(0.3, **k),
    "cylinder": lambda **k: Cylinder(0.2, 0.9, **k),
    "capsule": lambda **k: Capsule(0.2, 0.9, **k),
    "cone": lambda **k: Cone(0.2, 0.9, **k),
    "convex": lambda **k: ConvexHull(CUBE + np.array([0.3, 0.0, 0.1]), **k),
    "mesh": lambda **k: Mesh(*TETRA, **k),
    "voxels": lambda **k: Voxels([[0, 0, 0], [0.1, 0, 0], [2, 0, 0]], 0.1, **k),
    "points": lambda **k: Points([[0, 0, 0], [0.13, 0, 0], [2, 0, 0.4]], 0.02, **k),
}


def probe_distance(obstacle, point, radius=0.05):
    """Signed distance [m] of a small ball about a world point to the obstacle."""
    ball = coal.Sphere(radius)
    best = np.inf
    for part in obstacle.parts:
        members = part.boxes or ((part.geometry, np.zeros(3)),)
        for geometry, shift in members:
            T = obstacle.pose @ part.T_obstacle_part
            here = coal.Transform3s(np.ascontiguousarray(T[:3, :3]), T[:3, 3] + T[:3, :3] @ shift)
            there = coal.Transform3s(np.eye(3), np.asarray(point, dtype=float))
            result = coal.DistanceResult()
            best = min(best, coal.distance(geometry, here, ball, there, coal.DistanceRequest(), result))
    return best


@each(
    "obstacle, point, expected",
    [
        (Box((1, 2, 3)), (1.5, 0, 0), 1.0),
        (Box((1, 2, 3)), (0, 0, 2.5), 1.0),
        (Box((1, 1, 1)), (1.5, 1.5, 1.5), math.sqrt(3)),
        (Sphere(0.5), (0, 2.5, 0), 2.0),
        (Cylinder(0.5, 2.0), (0, 0, 2.0), 1.0),
        (Cylinder(0.5, 2.0), (2.5, 0, 0.9), 2.0),
        (Capsule(0.5, 2.0), (0, 0, 2.5), 1.0),
        (Capsule(0.5, 2.0), (2.5, 0, 1.0), 2.0),
        (Cone(0.5, 2.0), (0, 0, 2.0), 1.0),  # apex up
        (Cone(0.5, 2.0), (0.4, 0, -2.0), 1.0),  # base down
        (ConvexHull(CUBE), (1.5, 0.1, 0.2), 1.0),
        (ConvexHull(CUBE + np.array([5, 0, 0])), (6.5, 0.1, 0.2), 1.0),
        (ConvexHull(CUBE), (0.3, 0.1, 0.2), -0.2),
        (Mesh(*TETRA), (2, 2, 2), 5 / math.sqrt(3)),
        (Mesh(*TETRA), (0.3, 0.2, -1), 1.0),
        (Voxels([[0, 0, 0], [1, 0, 0]], 1.0), (0.5, 0, 1.5), 1.0),
        (Voxels([[0, 0, 0]], (1.0, 2.0, 3.0)), (0, 3.0, 0), 2.0),
        (Points([[0, 0, 0], [5, 0, 0]], 0.1), (5, 1.1, 0), 1.0),
    ],
)
def test_coal_distance_has_the_known_value(obstacle, point, expected):
    assert probe_distance(obstacle, point) == pytest.approx(expected - 0.05, abs=5e-6)


def test_pose_places_the_obstacle():
    turned = Box((2, 0.2, 0.2), at=(1, 0, 0), quat=(0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    assert probe_distance(turned, (1, 2, 0)) == pytest.approx(1 - 0.05, abs=5e-6)
    assert probe_distance(turned, (3, 0, 0)) == pytest.approx(1.9 - 0.05, abs=5e-6)


@each("make", SHAPES.values(), ids=SHAPES)
def test_bounds_hold_the_geometry_and_are_tight(make):
    obstacle = make()
    assert obstacle.parts
    for part in obstacle.parts:
        assert np.array_equal(part.T_obstacle_part[:3, :3], np.eye(3))
        low, high = [], []
        for geometry, shift in part.boxes or ((part.geometry, np.zeros(3)),):
            origin = part.T_obstacle_part[:3, 3] + shift
            low.append(geometry.aabb_local.min_ + origin)  # needs computeLocalAABB: huge numbers without it
            high.append(geometry.aabb_local.max_ + origin)
        low, high = np.min(low, axis=0), np.max(high, axis=0)
        np.testing.assert_allclose(part.center - part.half_extents, low, atol=1e-9)
        np.testing.assert_allclose(part.center + part.half_extents, high, atol=1e-9)
        assert part.half_extents.max() - 1e-12 <= part.radius <= np.linalg.norm(part.half_extents) + 1e-9
        assert np.linalg.norm(part.center) + part.radius <= obstacle.reach + 1e-12


@each("make", SHAPES.values(), ids=SHAPES)
def test_every_shape_is_an_immutable_obstacle_and_shares_its_parts(make):
    obstacle = make(name="one", at=(1, 2, 3))
    assert isinstance(obstacle, Obstacle)
    with pytest.raises(AttributeError):
        obstacle.name = "two"
    with refused(ValueError, "read-only"):
        obstacle.pose[0, 3] = 5.0
    pose = np.eye(4)
    pose[:3, 3] = 4, 5, 6
    moved = obstacle.moved(pose)
    assert type(moved) is type(obstacle)
    assert moved.name == "one"
    assert moved.parts is obstacle.parts
    assert moved.pose[:3, 3].tolist() == [4, 5, 6]
    assert obstacle.pose[:3, 3].tolist() == [1, 2, 3]
    pose[0, 3] = 99.0  # the copy does not see the caller's array
    assert moved.pose[0, 3] == 4.0
    assert obstacle.named("two").name == "two"
    assert repr(obstacle).startswith(type(obstacle).__name__)


@each("make", SHAPES.values(), ids=SHAPES)
def test_pickling_keeps_distances_bounds_and_immutability(make):
    obstacle = make(at=(0.1, 0.2, 0.3), motion=Twist((1, 0, 0)))
    copy = pickle.loads(pickle.dumps(obstacle))
    assert type(copy) is type(obstacle)
    assert probe_distance(copy, (3, 1, 1)) == probe_distance(obstacle, (3, 1, 1))
    for part in copy.parts:
        assert all(member.aabb_radius > 0 for member in part.members)
        assert not part.center.flags.writeable
    assert not copy.pose.flags.writeable
    assert copy.at(1.0).pose[0, 3] == pytest.approx(1.1)


BAD = [
    (lambda: Box((1, 1)), "shape"),
    (lambda: Box((1, 1, 0)), "at least"),
    (lambda: Box((1, 1, -1)), "at least"),
    (lambda: Box((1, 1, math.nan)), "finite"),
    (lambda: Box((1, 1, 1e7)), "within"),
    (lambda: Box("abc"), "numbers"),
    (lambda: Box((True, 1, 1)), "numbers"),
    (lambda: Box(None), "numbers"),
    (lambda: Box([[1], [1, 2]]), "array"),
    (lambda: Box((1, 1, 1), at=(0, 0, math.inf)), r"at\[2\] is inf"),
    (lambda: Box((1, 1, 1), quat=(0, 0, 0, 1.1)), r"norm 1\.1"),
    (lambda: Box((1, 1, 1), quat=(0, 0, 0, 0)), "norm 0"),
    (lambda: Box((1, 1, 1), quat=(0, 0, 1)), "shape"),
    (lambda: Box((1, 1, 1), name=""), "name"),
    (lambda: Box((1, 1, 1), name=5), "name"),
    (lambda: Box((1, 1, 1), name="a\nb"), "name"),
    (lambda: Box((1, 1, 1), motion="fast"), "motion"),
    (lambda: Box((1, 1, 1), at=(9, 0, 0), motion=Keyframes([0, 1], [[0, 0, 0], [1, 0, 0]])), "keyframes say"),
    (lambda: Sphere(0), r"Sphere radius=0 must be .* of m ≥ 1e-06 and ≤ 1e\+06"),
    (lambda: Sphere(True), "must be a finite number"),
    (lambda: Sphere("0.3"), "must be a finite number"),
    (lambda: Sphere(1 + 2j), "must be a finite number"),
    (lambda: Sphere(10**400), "finite"),
    (lambda: Cylinder(0.1, 0.0), "Cylinder length"),
    (lambda: Capsule(-0.1, 1.0), "Capsule radius"),
    (lambda: Cone(0.1, math.nan), "Cone length"),
    (lambda: ConvexHull(CUBE[:3]), "at least 4"),
    (lambda: ConvexHull(CUBE[:4]), "flat"),
    (lambda: ConvexHull(np.zeros((6, 3))), "flat"),
    (lambda: ConvexHull(CUBE * (1, 1, 1e-7)), "flat"),
    (lambda: ConvexHull(np.zeros((0, 3))), "empty"),
    (lambda: Mesh(TETRA[0], [[0, 1, 4]]), r"\[0, 3\]"),
    (lambda: Mesh(TETRA[0], [[0, 1, -1]]), r"\[0, 3\]"),
    (lambda: Mesh(TETRA[0], [[0, 1, 1.5]]), "integers"),
    (lambda: Mesh(TETRA[0], [[0, 1, 1]]), "no triangle with an area"),
    (lambda: Voxels([], 0.1), "numbers|shape|empty"),
    (lambda: Voxels([[0, 0, 0]], 0.0), "Voxels size"),
    (lambda: Voxels([[0, 0, math.nan]], 0.1), "finite"),
    (lambda: Points([[0, 0]], 0.1), "shape"),
    (lambda: Points([[0, 0, 0]], -1), "Points radius"),
    (lambda: Sphere(1).moved(np.zeros((4, 4))), "rigid"),
    (lambda: Sphere(1).moved(np.eye(3)), "shape"),
    (lambda: Sphere(1).moved(np.diag([1.0, 1.0, -1.0, 1.0])), "rigid"),
    (lambda: Sphere(1).moved(np.full((4, 4), np.nan)), "finite"),
    (lambda: Sphere(1).at(math.nan), "finite"),
    (lambda: Sphere(1).named(None), "name"),
]


@each("make, message", BAD)
def test_bad_input_raises_a_scene_error_that_names_it(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_nearly_unit_quaternion_is_normalised():
    pose = Box((1, 1, 1), quat=np.array([0.1, 0.2, 0.3, 0.9273618495495703]) * (1 + 5e-7)).pose
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-14)


def test_moved_cleans_a_rotation_from_single_precision():
    pose = Box((1, 1, 1), quat=np.array([0.1, 0.2, 0.3, 0.9273618495495703])).pose
    moved = Sphere(1).moved(pose.astype(np.float32))
    np.testing.assert_allclose(moved.pose[:3, :3] @ moved.pose[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(moved.pose, pose, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(5, 120))
def test_hull_distance_agrees_with_the_support_function(seed, count):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * rng.uniform(0.2, 1.0, 3) + rng.normal(size=3) * 3
    hull = ConvexHull(points)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    far = points.mean(axis=0) + 8 * direction
    distance = probe_distance(hull, far) + 0.05
    part = hull.parts[0]
    # Distance lies between the best separating plane and the distance to any vertex.
    assert distance <= np.linalg.norm(points - far, axis=1).min() + 1e-5
    assert distance >= (far @ direction - (points @ direction).max()) - 1e-5
    assert np.all(np.abs(points - part.center) <= part.half_extents + 1e-12)
    assert np.all(np.linalg.norm(points - part.center, axis=1) <= part.radius + 1e-12)


@pytest.mark.parametrize("apexes", [[[0.0, 0.0, 0.4]], [[0.0, 0.0, 0.4], [0.0, 0.0, -0.3]]])
def test_a_hull_with_a_corner_of_many_neighbours_becomes_an_obstacle(apexes):
    """Cones over 600 corners: all is inside, the bounds hold the shape, and it is hardly larger."""
    turn = np.linspace(0.0, 2.0 * np.pi, 600, endpoint=False)
    points = np.vstack((np.column_stack((0.3 * np.cos(turn), 0.3 * np.sin(turn), np.zeros(600))), apexes))
    part = ConvexHull(points).parts[0]
    corners = np.asarray(part.geometry.points()).reshape(-1, 3)
    assert outside(points - part.center, corners).max() < 1e-9
    assert outside(corners + part.center, points).max() < 2e-5
    assert np.all(np.abs(corners) <= part.half_extents + 1e-12)
    assert np.all(np.linalg.norm(corners, axis=1) <= part.radius + 1e-12)


def outside(points, corners):
    """How far (V,) [m] points stick out of the convex hull of others."""
    hull = spatial.ConvexHull(corners)
    return (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)


def test_obstacles_compare_by_identity():
    box = Box((1, 1, 1))
    assert box in {box}
    assert box != Box((1, 1, 1))
    assert Scene([box]).obstacles[0].parts is box.parts
