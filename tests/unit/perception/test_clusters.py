"""Clusters of a scan: where it is split, what shapes become of it, and that they hold what was seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each, refused
from hypothesis import given, settings
from hypothesis import strategies as st
from ray_caster import box_segments, cast, scan

from elastic_strips.errors import ParameterError
from elastic_strips.perception import LaserScan, SceneEstimatorParams, scan_scene
from elastic_strips.perception.clusters import cluster_obstacles, clusters_of, fit_circle
from elastic_strips.perception.readings import rays_of
from elastic_strips.scene import Box, Cylinder

PARAMS = SceneEstimatorParams()


def holds(obstacles, points, slack=1e-9):
    """(n,) whether world points (n, 2) lie in the footprint of one of the boxes and cylinders."""
    inside = np.zeros(len(points), dtype=bool)
    for o in obstacles:
        local = (points - o.pose[:2, 3]) @ o.pose[:2, :2]
        if isinstance(o, Cylinder):
            inside |= np.hypot(*local.T) <= o.spec["radius"] + slack
        else:
            inside |= (np.abs(local) <= 0.5 * o.spec["size"][:2] + slack).all(axis=1)
    return inside


def true_points(pose, **world):
    """Densely sampled points of the true surfaces that are visible from a pose."""
    bearing = pose[2] + np.linspace(-0.75 * math.pi, 0.75 * math.pi, 3000)
    r = cast(pose[:2], bearing, **world)
    at = np.isfinite(r)
    way = np.column_stack((np.cos(bearing), np.sin(bearing)))
    return np.array(pose[:2]) + r[at, None] * way[at], bearing[at]


def test_a_cylinder_and_a_box_are_two_clusters_of_their_kinds():
    world = {"circles": [(2.0, 0.6, 0.2)], "segments": box_segments(2.0, -0.8, 0.5, 0.5)}
    scene = scan_scene(scan((0, 0, 0), **world), (0, 0, 0))
    assert [type(o) for o in scene] == [Box, Cylinder]
    box, cylinder = scene
    np.testing.assert_allclose(cylinder.pose[:3, 3], (2.0, 0.6, 0.75), atol=0.02)
    assert cylinder.spec["radius"] == pytest.approx(0.2 + PARAMS.padding, abs=0.01)
    assert cylinder.spec["length"] == PARAMS.height
    assert box.pose[0, 3] - 0.5 * box.spec["size"][2] < 2.0


@each("seed", range(5))
def test_shapes_hold_the_visible_sides_of_the_true_ones(seed):
    """With noise; surfaces between the outermost rays that hit a thing are held to the last point."""
    rng = np.random.default_rng(seed)
    pose = (0.3, -0.2, 0.5)
    world = {
        "circles": [(2.2, 1.6, 0.15), (2.8, 0.3, 0.3)],
        "segments": [*box_segments(1.0, 2.5, 0.7, 0.4, rng.uniform(0, 1.5)), (4.0, -3.0, 5.0, 4.0)],
    }
    reading = scan(pose, noise=0.008, rng=rng, **world)
    rays = rays_of(reading, pose)
    points, bearing = true_points(pose, **world)
    for cluster in clusters_of(rays, PARAMS):
        if len(cluster.points) < 5:
            continue
        solids = cluster_obstacles(cluster, PARAMS, "x")
        assert holds(solids, cluster.points).all()
        angle = np.unwrap(np.arctan2(*(cluster.points - rays.origin).T[::-1]))
        mine = (bearing > angle[0]) & (bearing < angle[-1])
        near = np.min(np.hypot(*(points[mine][:, None] - cluster.points[None]).transpose(2, 0, 1)), axis=1) < 0.1
        assert mine.any()
        assert holds(solids, points[mine][near], 0.012).all()


@settings(max_examples=60, deadline=None)
@given(st.floats(0.05, 0.45), st.floats(1.0, 4.0), st.floats(-1.0, 1.0), st.integers(0, 1000))
def test_every_point_of_a_cluster_lies_in_its_solids_by_the_padding(radius, distance, angle, seed):
    rng = np.random.default_rng(seed)
    at = ((distance + radius) * math.cos(angle), (distance + radius) * math.sin(angle))
    world = {"circles": [(*at, radius)], "segments": [*box_segments(-1.5, 1.0, 0.8, 0.3, angle), (-4, -3, 5, -3)]}
    reading = scan((0, 0, 0), noise=0.01, rng=rng, **world)
    for cluster in clusters_of(rays_of(reading, (0, 0, 0)), PARAMS):
        for way in ((1, 0), (-1, 0), (0, 1), (0, -1)):  # padded to all sides
            moved = cluster.points + 0.7 * PARAMS.padding * np.array(way)
            assert holds(cluster_obstacles(cluster, PARAMS, "x"), moved).all()


@each("arc", [0.8, 1.5, 3.0])
def test_circle_fit(arc):
    """Exact on exact points; with noise as good as the arc allows."""
    t = np.linspace(-arc, arc, 40)
    exact = np.column_stack((3.0 + 0.3 * np.cos(t), -2.0 + 0.3 * np.sin(t)))
    np.testing.assert_allclose(fit_circle(exact), (3.0, -2.0, 0.3), atol=1e-9)
    rng = np.random.default_rng(1)
    errors = [np.abs(np.subtract(fit_circle(exact + rng.normal(0, 0.005, (40, 2))), (3, -2, 0.3))) for _ in range(50)]
    assert np.mean(errors) < {0.8: 0.012, 1.5: 0.004, 3.0: 0.002}[arc]
    assert fit_circle(np.column_stack((np.linspace(0, 1, 9), np.linspace(1, 3, 9))))[2] == math.inf


def test_a_rooms_corner_is_two_thin_boxes_and_leaves_the_room_free():
    room = box_segments(0.0, 0.0, 6.0, 4.0)
    scene = scan_scene(scan((0, 0, 0), segments=room), (0, 0, 0))
    assert all(isinstance(o, Box) for o in scene)
    grid = np.stack(np.meshgrid(np.linspace(-2.8, 2.8, 30), np.linspace(-1.8, 1.8, 30)), -1).reshape(-1, 2)
    assert not holds(scene, grid).any()
    points, _ = true_points((0, 0, 0), segments=room)
    assert holds(scene, points).mean() > 0.99


def test_the_break_distance_grows_with_range_and_step():
    """A wall is one thing near and far, seen finely or coarsely; a gap of 0.3 m splits it at any of them."""
    for distance, rays in ((1.0, 361), (6.0, 361), (3.0, 91)):
        wall = [(distance, -1.0, distance, 1.0)]
        assert len(clusters_of(rays_of(scan((0, 0, 0), segments=wall, rays=rays), (0, 0, 0)), PARAMS)) == 1
        split = [(distance, -1.0, distance, -0.15), (distance, 0.15, distance, 1.0)]
        assert len(clusters_of(rays_of(scan((0, 0, 0), segments=split, rays=rays), (0, 0, 0)), PARAMS)) == 2


@each("depth", [0.25, 0.4, 2.0])
def test_a_step_in_depth_splits_though_no_ray_is_free(depth):
    plates = [(2.0, -1.0, 2.0, 0.0), (2.0 + depth, -0.5, 2.0 + depth, 1.5)]
    near, far = clusters_of(rays_of(scan((0, 0, 0), segments=plates), (0, 0, 0)), PARAMS)
    assert not near.hidden
    assert far.hidden
    assert near.points[:, 0].max() < 2.01 < far.points[:, 0].min()


def test_a_thing_behind_the_sensor_is_not_torn_apart_by_a_full_turn():
    reading = scan((0, 0, 0), circles=[(-2.0, 0.0, 0.3)], fov=2 * math.pi * 719 / 720, rays=720)
    (cluster,) = clusters_of(rays_of(reading, (0, 0, 0)), PARAMS)
    assert not cluster.hidden
    (solid,) = cluster_obstacles(cluster, PARAMS, "x")
    np.testing.assert_allclose(solid.pose[:2, 3], (-2.0, 0.0), atol=0.01)


def test_dropouts_do_not_split_and_make_ends_uncertain():
    reading = scan((0, 0, 0), segments=[(2.0, -1.0, 2.0, 1.0)])
    ranges = np.array(reading.ranges)
    ranges[180] = np.nan
    (cluster,) = clusters_of(rays_of(_with(reading, ranges), (0, 0, 0)), PARAMS)
    assert not cluster.hidden
    ends = np.flatnonzero(np.isfinite(ranges))
    ranges[ends[0] - 1] = np.nan
    (cluster,) = clusters_of(rays_of(_with(reading, ranges), (0, 0, 0)), PARAMS)
    assert cluster.hidden


def test_a_laser_that_hangs_upside_down_sees_the_same_world():
    world = {"circles": [(2.0, 0.7, 0.2)]}
    upright = scan((0, 0, 0), **world)
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    hanging = LaserScan("laser", 0.0, T, upright.angles, upright.ranges[::-1], 0.05, 10.0)
    np.testing.assert_allclose(
        scan_scene(hanging, (1, 2, 3)).obstacles[0].pose, scan_scene(upright, (1, 2, 3)).obstacles[0].pose, atol=1e-9
    )


def test_what_cannot_be_laid_out_is_refused():
    good = scan((0, 0, 0))
    tilt = np.eye(4)
    tilt[:3, :3] = [[math.cos(0.2), 0, math.sin(0.2)], [0, 1, 0], [-math.sin(0.2), 0, math.cos(0.2)]]
    with refused(ParameterError, "tilted"):
        rays_of(LaserScan("l", 0.0, tilt, good.angles, good.ranges, 0.05, 10.0), (0, 0, 0))
    with refused(ParameterError, "ascending"):
        rays_of(LaserScan("l", 0.0, np.eye(4), good.angles[::-1], good.ranges, 0.05, 10.0), (0, 0, 0))
    with refused(ParameterError, "three"):
        rays_of(good, (0, 0))
    with refused(ParameterError, "finite"):
        rays_of(good, (0, math.nan, 0))
    assert len(scan_scene(good, (0, 0, 0))) == 0


def _with(reading, ranges):
    return LaserScan(
        reading.sensor,
        reading.time,
        reading.T_base_sensor,
        reading.angles,
        ranges,
        reading.range_min,
        reading.range_max,
    )
