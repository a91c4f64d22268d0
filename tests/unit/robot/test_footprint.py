"""Planar footprints: discs and boxes of robots seen from above."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each

from elastic_strips.coal_shapes import support_points
from elastic_strips.robot import PlanarFootprint
from elastic_strips.robot.footprint import box_distance, support


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
