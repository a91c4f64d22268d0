"""The map: what is freed, what is hit, what stays unknown, the policy for it, and which obstacles stay the same."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each
from hypothesis import given, settings
from hypothesis import strategies as st
from ray_caster import box_segments, scan

from elastic_strips.errors import ParameterError
from elastic_strips.perception import LaserScan, RangeRing, SceneEstimatorParams
from elastic_strips.perception.occupancy_grid import OccupancyGrid
from elastic_strips.perception.readings import rays_of
from elastic_strips.scene import Voxels

WALL = [(2.0, -3.0, 2.0, 3.0)]


def filled_map(scans, params=None):
    grid = OccupancyGrid(params or SceneEstimatorParams())
    for reading in scans:
        grid.add_scan(rays_of(reading, (0, 0, 0)))
    return grid


def covered(obstacles, points):
    """(n,) whether world points (n, 3) lie in one of the boxes."""
    inside = np.zeros(len(points), dtype=bool)
    for o in obstacles:
        for part in o.parts:
            for box, at in part.boxes:
                inside |= (np.abs(points - o.pose[:3, 3] - at) <= np.asarray(box.halfSide) + 1e-9).all(axis=1)
    return inside


def at_height(points, z=0.5):
    return np.column_stack((points, np.full(len(points), z)))


def test_free_space_is_carved_and_the_wall_is_hit():
    grid = filled_map([scan((0, 0, 0), segments=WALL)])
    inner = np.array([[x, y] for x in np.arange(0.2, 1.8, 0.1) for y in (-0.1, 0.0, 0.1)])
    assert grid.known(inner).all()
    assert not grid.occupied(inner).any()
    wall = np.array([[2.0 + 1e-9, y] for y in np.linspace(-1.5, 1.5, 200)])
    assert grid.occupied(wall).all()
    behind = np.array([[2.3, y] for y in np.linspace(-1.0, 1.0, 20)])
    assert not grid.known(behind).any()
    obstacles = grid.obstacles()
    assert all(isinstance(o, Voxels) and o.motion is None for o in obstacles)
    assert covered(obstacles, at_height(wall, 0.01)).all()
    assert covered(obstacles, at_height(wall, grid.params.height - 0.01)).all()
    assert not covered(obstacles, at_height(wall, grid.params.height + 0.01)).any()
    assert not covered(obstacles, at_height(inner)).any()


def test_what_is_gone_is_carved_away_and_what_comes_is_there_at_once():
    grid = filled_map([scan((0, 0, 0), 0.1 * k, circles=[(1.0, 0.0, 0.1)], segments=WALL) for k in range(5)])
    spot = np.array([[0.91, 0.0]])
    assert grid.occupied(spot).all()
    scans = 0
    while grid.occupied(spot).all():
        scans += 1
        grid.add_scan(rays_of(scan((0, 0, 0), 1.0 + 0.1 * scans, segments=WALL), (0, 0, 0)))
        assert scans < 12
    assert scans >= 3  # one stray ray does not remove a thing
    grid.add_scan(rays_of(scan((0, 0, 0), 4.0, circles=[(1.0, 0.0, 0.1)]), (0, 0, 0)))
    assert grid.occupied(spot).all()


def test_dropouts_say_nothing_and_nothing_frees_up_to_the_range():
    reading = scan((0, 0, 0), reach=5.0)
    silent = LaserScan("laser", 0.0, reading.T_base_sensor, reading.angles, np.full(361, np.nan), 0.05, 5.0)
    spots = np.array([[x, 0.0] for x in np.arange(0.5, 4.9, 0.2)])
    assert not filled_map([silent]).known(spots).any()
    grid = filled_map([reading])
    assert grid.known(spots).all()
    assert not grid.occupied(spots).any()
    assert not grid.known(np.array([[5.2, 0.0]])).any()
    half = np.array(reading.ranges)
    half[reading.angles > 0.0] = np.nan
    grid = filled_map([LaserScan("laser", 0.0, reading.T_base_sensor, reading.angles, half, 0.05, 5.0)])
    assert grid.known(np.array([[2.0, -1.0]])).all()
    assert not grid.known(np.array([[2.0, 1.0]])).any()


@pytest.mark.parametrize("policy", ["free", "blocked"])
def test_unseen_space_has_a_policy(policy):
    params = SceneEstimatorParams(unseen=policy, unseen_radius=2.5, robot_radius=0.4)
    grid = filled_map([scan((0, 0, 0), segments=[(1.0, -0.5, 1.0, 0.5)])], params)
    grid.clear_footprint(0.0, 0.0)
    obstacles = grid.obstacles()
    hidden = np.array([[x, y] for x in (1.3, 1.8, 2.4) for y in (-0.3, 0.0, 0.3)])
    hidden = hidden[np.hypot(*hidden.T) < 2.45]
    assert covered(obstacles, at_height(hidden)).all() == (policy == "blocked")
    rear = np.array([[-1.0, 0.0], [-2.0, 0.3]])
    assert covered(obstacles, at_height(rear)).all() == (policy == "blocked")
    free = np.array([[0.5, 0.0], [0.0, 1.5], [0.2, -2.0], [-0.3, 0.0], [0.0, 0.0]])  # seen, or the robot's own place
    assert not covered(obstacles, at_height(free)).any()
    outside = 2.58 * np.column_stack((np.cos(np.arange(0, 6, 0.1)), np.sin(np.arange(0, 6, 0.1))))
    assert not covered(obstacles, at_height(outside)).any()
    assert any((o.name or "").startswith("unseen-") for o in obstacles) == (policy == "blocked")


def test_blocked_cells_are_freed_once_they_are_seen_and_follow_the_base():
    params = SceneEstimatorParams(unseen="blocked", unseen_radius=1.5, settle_delay=0.0)
    grid = filled_map([scan((0, 0, 0), fov=1.0)], params)
    grid.clear_footprint(0.0, 0.0)
    rear = at_height(np.array([[-1.0, 0.0]]))
    assert covered(grid.obstacles(), rear).all()
    grid.add_scan(rays_of(scan((0, 0, math.pi), 0.1, fov=1.0), (0, 0, math.pi)))
    grid.clear_footprint(0.0, 0.0)
    assert not covered(grid.obstacles(), rear).any()
    side = at_height(np.array([[0.0, -1.2]]))
    assert covered(grid.obstacles(), side).all()
    grid.clear_footprint(2.0, 0.0)
    assert not covered(grid.obstacles(), side).any()


@pytest.mark.parametrize("begin", [0.0, 1.8e9])
def test_what_stands_where_something_moved_is_in_doubt_after_a_while(begin):
    """Only what came after that, and was not hit since; one that is hit again is in the map at once. The grid grows
    meanwhile."""
    post = box_segments(1.0, 0.5, 0.1, 0.1)
    grid = filled_map([scan((0, 0, 0), begin, segments=WALL)], SceneEstimatorParams(stood_time=3.0))
    places = np.array([[1.0, 0.5], [2.0, 0.0], [1.0, -0.513]])
    grid.walk(places, np.array([0.3, 0.3, 0.001]))
    grid.add_scan(rays_of(scan((0, 0, 0), begin + 1.0, segments=WALL + post), (0, 0, 0)))
    here, wall = at_height(np.array([[0.96, 0.5]])), at_height(np.array([[2.01, -0.1]]))

    def layers(points):
        return {o.name.rstrip("-0123456789") for o in grid.obstacles() if covered([o], points).all()}

    assert layers(here) == {"map"}
    aside = scan((0, 0, math.pi), begin + 3.5, segments=[(-9.0, -3.0, -9.0, 3.0)], fov=0.5 * math.pi)
    grid.add_scan(rays_of(aside, (0, 0, math.pi)))
    assert layers(here) == {"map"}
    away = scan((0, 0, math.pi), begin + 4.5, segments=[(-9.0, -3.0, -9.0, 3.0)], fov=0.5 * math.pi)
    grid.add_scan(rays_of(away, (0, 0, math.pi)))
    assert layers(here) == {"unseen-stood"}
    assert layers(wall) == {"map"}
    grid.add_scan(rays_of(scan((0, 0, 0), begin + 5.0, segments=WALL + post), (0, 0, 0)))
    assert layers(here) == {"map"}


def test_unchanged_tiles_keep_their_obstacles():
    room = box_segments(0, 0, 8, 6)
    grid = filled_map([scan((0, 0, 0), 0.1 * k, segments=room) for k in range(3)])
    first = {o.name: o for o in grid.obstacles()}
    assert "map-1--3" in first
    assert len(first) > 10
    grid.add_scan(rays_of(scan((0, 0, 0), 0.4, segments=room, circles=[(1.5, 0.5, 0.1)]), (0, 0, 0)))
    second = {o.name: o for o in grid.obstacles()}
    assert {n for n in second if second[n] is not first.get(n)} == {"map-1-0"}
    assert all(one is other for one, other in zip(grid.obstacles(), second.values(), strict=True))


def test_noise_makes_few_new_obstacles():
    """A scan in ten seconds of scans at 10 Hz makes few of a room's tiles anew."""
    rng, room = np.random.default_rng(0), box_segments(0, 0, 8, 6)
    grid, before, made = OccupancyGrid(SceneEstimatorParams()), {}, []
    for k in range(60):
        pose = rng.normal(0, (0.01, 0.01, 0.004))
        grid.add_scan(rays_of(scan((0, 0, 0), 0.1 * k, segments=room, noise=0.01, rng=rng), pose))
        now = {o.name: o for o in grid.obstacles()}
        made.append(sum(now[name] is not before.get(name) for name in now))
        before = now
    assert np.mean(made[20:]) < 4.0


@settings(max_examples=25, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 1000))
def test_the_padded_ends_of_all_rays_are_in_the_obstacles(x, y, yaw, seed):
    rng = np.random.default_rng(seed)
    world = {"segments": box_segments(0, 0, 9, 9), "circles": [(*rng.uniform(-3, 3, 2), 0.2)]}
    rays = rays_of(scan((x, y, yaw), rays=121, noise=0.01, rng=rng, **world), (x, y, yaw))
    grid = OccupancyGrid(SceneEstimatorParams())
    grid.add_scan(rays)
    hits = rays.hits
    ends = rays.origin + rays.ranges[hits, None] * rays.direction[hits]
    obstacles = grid.obstacles()
    for corner in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
        assert covered(obstacles, at_height(ends + 0.99 * grid.params.padding * np.array(corner))).all()


def test_rings_mark_near_arcs_and_free_only_what_they_say():
    T = np.array([np.eye(4)] * 3)
    T[:, :3, 3] = 0.2, 0.0, 0.1
    for k, yaw in enumerate((0.0, 1.5, -1.5)):
        T[k, :2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    ring = RangeRing("sonars", "sonar", 0.0, T, np.array([0.6, np.inf, 2.5]), 0.26, 0.1, 4.0)
    grid = OccupancyGrid(SceneEstimatorParams(), "near")
    grid.add_ring(ring, (0, 0, 0))
    arc = 0.2 + 0.6 * np.cos(np.linspace(-0.26, 0.26, 9)), 0.6 * np.sin(np.linspace(-0.26, 0.26, 9))
    assert grid.occupied(np.column_stack(arc)).all()
    assert grid.known(np.array([[0.5, 0.0]])).all()
    beside = np.array([[0.2 + 0.5 * math.cos(1.5), 0.5 * math.sin(1.5)]])
    assert not grid.known(beside).any()  # a sonar that hears nothing says nothing
    assert grid.known(beside * [1.0, -1.0]).all()
    assert not grid.known(np.array([[0.2 + 1.2 * math.cos(1.5), -1.2 * math.sin(1.5)]])).any()
    assert all((o.name or "").startswith("near-") for o in grid.obstacles())
    infrared = RangeRing("ir", "infrared", 0.0, T, np.array([np.inf] * 3), 0.03, 0.1, 0.8)
    grid.add_ring(infrared, (0, 0, 0))
    assert grid.known(beside).all()


@each(
    "values, message",
    [
        ({"unseen": "open"}, "unseen='open'.*Valid: blocked, free"),
        ({"cell": 0.0}, r"cell=0\.0 must be a finite number > 0"),
        ({"cell": 0.03}, r"tile=1\.0 must be 1 to 1000 times cell=0\.03"),
        ({"padding": 0.06}, r"padding=0\.06 must be at most cell"),
        ({"height": math.nan}, "height=nan must be a finite number"),
        ({"lost_misses": 2.5}, r"lost_misses=2\.5 must be a whole number"),
        ({"confirm_hits": True}, "confirm_hits=True must be a whole number"),
        ({"occupied": 1.0}, r"occupied=1\.0 must be below hit=0\.85"),
        ({"break_angle": 2.0}, r"break_angle=2\.0 must be a finite number of rad > 0 and < 1\.57"),
        ({"gate": "wide"}, "gate='wide' must be a finite number"),
    ],
)
def test_wrong_parameters_are_refused(values, message):
    with pytest.raises(ParameterError, match=message):
        SceneEstimatorParams(**values)
