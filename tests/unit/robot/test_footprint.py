"""Planar footprints: discs and boxes of robots seen from above."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import brute_force
import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each
from scipy.spatial import ConvexHull

from elastic_strips.coal_shapes import support_points
from elastic_strips.errors import RobotError
from elastic_strips.robot import PlanarFootprint, RobotModel, footprint_polygon
from elastic_strips.robot.footprint import box_distance, support
from elastic_strips.scene import Cylinder


@each(
    "geometry",
    [coal.Box(0.3, 0.5, 0.8), coal.Sphere(0.4), coal.Capsule(0.2, 0.7), coal.Cylinder(0.3, 0.9), coal.Cone(0.3, 0.9)],
    ids=lambda g: type(g).__name__,
)
def test_the_support_is_the_distance_from_a_far_plane(geometry, rng):
    """A slab that faces a direction comes as near as the support says."""
    for direction in rng.normal(size=(20, 3)):
        direction /= np.linalg.norm(direction)
        turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0, 0]), direction).toRotationMatrix()
        slab, at = coal.Box(1.0, 50.0, 50.0), coal.Transform3s(turn, 5.0 * direction)
        gap = coal.distance(geometry, coal.Transform3s(), slab, at, coal.DistanceRequest(), coal.DistanceResult())
        assert support(geometry, direction[None])[0] == pytest.approx(4.5 - gap, abs=2e-5)


def test_the_footprint_of_the_robots(jackal_box, silvermate, bridge_arm):
    """Largest disc within, smallest disc about: a box's are half its width and half its diagonal."""
    footprint = PlanarFootprint.of(jackal_box, jackal_box.home(3.0, 1.0, 0.7))
    assert footprint.inner == pytest.approx(0.215)
    assert np.hypot(0.254, 0.215) <= footprint.outer <= 1.005 * np.hypot(0.254, 0.215)
    assert PlanarFootprint.of(silvermate, silvermate.home_q).inner == pytest.approx(0.27)
    assert PlanarFootprint.of(silvermate, silvermate.home_q).height == pytest.approx(1.45)
    assert PlanarFootprint.of(bridge_arm, bridge_arm.home_q).height == pytest.approx(0.8217, abs=1e-4)


@each("name", ["silvermate", "bridge_arm", "jackal_box"])
def test_the_boxes_hold_the_bodies(name, request, rng):
    """In random postures, wherever the base is; and what a disc holds, a box about the base does."""
    robot = request.getfixturevalue(name)
    footprint, space = PlanarFootprint(robot), robot.space
    for _ in range(5):
        q = robot.home(2.0, -1.0, 0.4).copy()
        row = space.to_coordinates(q)
        row[space.base_nv :] = rng.uniform(np.maximum(space.lower, -3.0), np.minimum(space.upper, 3.0))[space.base_nv :]
        footprint.update(row)
        row[: space.base_nv] = 0.0
        data, placed = robot.model.createData(), robot.collision_model.createData()
        pin.updateGeometryPlacements(robot.model, data, robot.collision_model, placed, space.from_coordinates(row))
        for piece, pose in zip(robot.geometries, placed.oMg, strict=True):
            points, radius = support_points(piece.geometry)
            points = points @ pose.rotation.T + pose.translation
            low, high = points.min(axis=0) - radius, points.max(axis=0) + radius
            held = np.abs(0.5 * (low + high)[:2] - footprint.middle) + 0.5 * (high - low)[:2] < footprint.half + 1e-9
            assert (held.all(axis=1) & (footprint.low < low[2] + 1e-9) & (footprint.high > high[2] - 1e-9)).any()
        assert footprint.reach() >= footprint.inner
        assert footprint.reach(low=1e3) == 0.0
        heights = np.array([[-np.inf, np.inf], [0.0, 0.2], [0.5, 0.6], [1e3, 1e4]])
        np.testing.assert_array_equal(footprint.reaches(*heights.T), [footprint.reach(*z) for z in heights.tolist()])
        assert footprint.height <= footprint.high.max() + 1e-9


def test_a_low_disc_leaves_out_what_is_above(silvermate):
    footprint = PlanarFootprint.of(silvermate, silvermate.home_q)
    assert 0.0 < footprint.inner_below(0.3) <= footprint.inner
    assert footprint.inner_below(-1.0) == 0.0


def test_the_distance_from_a_box():
    x, y = np.array([0.0, 3.0, 3.0, 0.5]), np.array([0.0, 0.0, 4.0, 0.2])
    np.testing.assert_allclose(box_distance(x, y, 1.0, 1.0), [-1.0, 2.0, np.hypot(2.0, 3.0), -0.5])


# the polygon


def sampled(shape: Any, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random points (count, 3) [m] of a Coal shape, most of them on its surface."""
    turn = rng.normal(size=(count, 3))
    turn /= np.linalg.norm(turn, axis=1)[:, None]
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    rim = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(count)))
    along = np.array([0.0, 0.0, 1.0]) * np.clip(rng.uniform(-2.0, 2.0, count), -1.0, 1.0)[:, None]
    if isinstance(shape, coal.Box):
        return np.asarray(shape.halfSide) * np.clip(rng.uniform(-2.0, 2.0, (count, 3)), -1.0, 1.0)
    if isinstance(shape, coal.Sphere):
        return shape.radius * turn
    if isinstance(shape, coal.Cylinder):
        return shape.radius * rim + shape.halfLength * along
    if isinstance(shape, coal.Capsule):
        return shape.radius * turn + shape.halfLength * along
    corners = np.array(shape.points())
    few = corners[rng.integers(len(corners), size=(count, 3))]
    share = rng.dirichlet(np.full(3, 0.3), count)
    return np.vstack((corners, np.einsum("ki,kij->kj", share, few)))


def points_at(robot: RobotModel, row: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Some points (K, 2) [m] of a robot, seen from above in the world; about so many."""
    each_one = count // len(robot.collision_model.geometryObjects) + 1
    poses = brute_force.link_poses(robot, robot.space.from_coordinates(row))
    return np.vstack(
        [
            (sampled(thing.geometry, each_one, rng) @ T[:3, :3].T + T[:3, 3])[:, :2]
            for thing, T in zip(robot.collision_model.geometryObjects, poses, strict=True)
        ]
    )


def outside(polygon: np.ndarray, points: np.ndarray) -> float:
    """How far [m] the farthest point is outside a convex polygon; below 0 where all are inside."""
    side = np.roll(polygon, -1, axis=0) - polygon
    length = np.linalg.norm(side, axis=1)
    side, start = side[length > 1e-12] / length[length > 1e-12, None], polygon[length > 1e-12]
    normal = np.column_stack((side[:, 1], -side[:, 0]))
    return float((points @ normal.T - np.sum(normal * start, axis=1)).max())


def area(polygon: np.ndarray) -> float:
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def test_the_polygon_holds_every_point_and_hardly_more(robot: RobotModel, rng: np.random.Generator):
    for row in brute_force.random_coordinates(robot, rng, 3):
        points = points_at(robot, row, 20_000, rng)
        polygon = footprint_polygon(robot, row, place=(0.0, 0.0, 0.0))
        assert outside(polygon, points) < 0.0
        hull = ConvexHull(points).volume  # an area, of points in the plane
        assert hull <= area(polygon) < 1.01 * hull


def test_it_is_in_the_frame_of_the_base(silvermate: RobotModel):
    """The same wherever the robot stands; and its corners as they are in the world, moved there."""
    row = silvermate.space.to_coordinates(silvermate.home(1.0, -2.0, 0.7))
    here = silvermate.space.to_coordinates(silvermate.home())
    polygon, other = footprint_polygon(silvermate, row), footprint_polygon(silvermate, here)
    assert max(outside(polygon, other), outside(other, polygon)) < 3e-3, "which sides are left out may differ"
    np.testing.assert_array_equal(footprint_polygon(silvermate, row, place=(1.0, -2.0, 0.7)), polygon)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    there = footprint_polygon(silvermate, row, place=(0.0, 0.0, 0.0))
    moved = polygon @ turn.T + (1.0, -2.0)
    assert max(outside(moved, there), outside(there, moved)) < 3e-3


def test_the_polygon_of_a_way_holds_the_robot_all_along_it(robot: RobotModel, rng: np.random.Generator):
    """Three postures far from each other: base and joints turn by up to a radian from one to the next."""
    rows = [brute_force.random_coordinates(robot, rng, 1)[0]]
    for _ in range(2):
        step = rng.uniform(-1.0, 1.0, robot.nv)
        rows.append(robot.space.integrate(rows[-1], step))
    polygon = footprint_polygon(robot, np.array(rows), place=(0.0, 0.0, 0.0))
    found = []
    for a, b in pairwise(rows):
        for s in np.linspace(0.0, 1.0, 50):
            found.append(points_at(robot, robot.space.interpolate(a, b, s), 2000, rng))
    points = np.vstack(found)
    assert outside(polygon, points) < 0.0
    hull = ConvexHull(points)
    around = hull.area  # the length of its border
    assert area(polygon) < 1.01 * hull.volume + 1.5e-3 * around


def test_what_the_robot_carries_counts(silvermate: RobotModel, rng: np.random.Generator):
    frame = silvermate.model.frames[silvermate.model.nframes - 1].name
    held = silvermate.attached(Cylinder(0.02, 0.9), frame, name="rod")
    row = silvermate.space.to_coordinates(silvermate.home())
    points = points_at(held, row, 5000, rng)
    assert outside(footprint_polygon(held, row, place=(0.0, 0.0, 0.0)), points) < 0.0
    assert area(footprint_polygon(held, row)) >= area(footprint_polygon(silvermate, row)) - 1e-9


@each("rows", ([], [0.0, 0.0], [[float("nan")] * 3]))
def test_rows_of_another_robot_are_refused(rows: list[float], jackal_box: RobotModel):
    with pytest.raises(RobotError):
        footprint_polygon(jackal_box, rows)
