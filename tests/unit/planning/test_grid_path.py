"""Paths over a grid: clearances against exact distances, wide gaps before short ways, strips that are certified."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import astuple

import coal
import numpy as np
import pytest
from brute_force import SHAPES, make_obstacle
from cases import each
from shared_data import shared_data

from elastic_strips.errors import ParameterError
from elastic_strips.native import kernel, twin
from elastic_strips.planning import grid_path, plan_report
from elastic_strips.planning.grid_path import (
    COMFORTABLE_CLEARANCE,
    cell_cost,
    cheapest_route,
    clearance_map,
    ground_about,
    owner_map,
    resample,
)
from elastic_strips.planning.initial_strip import waypoint_rows
from elastic_strips.robot import PlanarFootprint, load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Voxels
from elastic_strips.strip import Deformer
from elastic_strips.work import Work, counted
from workshop.datasets import barn_ids, load_barn

FAR_LOW = np.array([-12.0, -12.0])
WALL = Scene([Box((0.2, 3.0, 1.5), at=(2.0, 0.6, 0.75)), Box((0.2, 3.0, 1.5), at=(2.0, -3.9, 0.75))])
"""A wall with one door, off the straight line."""

both_kernels = pytest.mark.parametrize("native", [nullcontext, twin], ids=["kernel", "twin"])


def slalom(seed):
    """Posts in disorder between (0, 0) and (6, 0)."""
    rng = np.random.default_rng(seed)
    places = np.column_stack((rng.uniform(0.8, 5.2, 30), rng.uniform(-2.5, 2.5, 30)))
    return Scene([Cylinder(0.1, 1.0, at=(x, y, 0.5)) for x, y in places])


@each("seed", range(4))
def test_the_map_holds_every_obstacle_and_little_more(seed):
    """Against exact distances of a thin post at the cells' middles, for shapes in any pose."""
    rng = np.random.default_rng(seed)
    items = [make_obstacle(shape, rng, (-3, -3, 0.3), (3, 3, 1.0)) for shape in SHAPES]
    scene, low, shape, edge = Scene(items), np.array([-4.0, -4.0]), np.array([161, 161]), 0.05
    clear = clearance_map(owner_map(scene, low, shape, edge, 5.0) >= 0, edge)
    post = coal.Cylinder(1e-4, 20.0)
    cells = rng.integers(0, 161, (300, 2))
    for i, j in cells:
        at = coal.Transform3s(np.eye(3), np.array([*(low + edge * np.array([i, j])), 0.0]))
        exact = np.inf
        for part, turn, place in zip(scene.table.parts, scene.table.rotation, scene.table.translation, strict=True):
            pieces = part.boxes if part.geometry is None else ((part.geometry, np.zeros(3)),)
            for geometry, shift in pieces:
                where = coal.Transform3s(turn, place + turn @ shift)
                gap = coal.distance(geometry, where, post, at, coal.DistanceRequest(), coal.DistanceResult())
                exact = min(exact, gap)
        assert clear[i, j] <= max(exact, 0.0) + 0.75 * edge
        assert clear[i, j] >= exact - 1.5 * edge


def test_obstacles_above_the_robot_and_on_the_floor_do_not_count(jackal_box):
    low, shape = np.array([-1.0, -1.0]), np.array([41, 41])
    height = PlanarFootprint.of(jackal_box, jackal_box.home_q).height
    assert height == pytest.approx(0.25)
    for z, counts in [(0.3, False), (0.2, True), (-0.1, False), (-0.04, True)]:
        scene = Scene([Box((0.2, 0.2, 0.1), at=(0, 0, z + 0.05))])
        assert (owner_map(scene, low, shape, 0.05, height) >= 0).any() == counts, z


def test_it_goes_through_the_door_and_keeps_off_its_sides(jackal_box):
    found = grid_path(jackal_box, WALL, jackal_box.home(), jackal_box.home(4.0))
    assert found.points is not None, found.reason
    np.testing.assert_array_equal(found.points[[0, -1]], [[0, 0], [4, 0]])
    at_wall = found.points[np.abs(found.points[:, 0] - 2.0).argmin()]
    assert at_wall[1] == pytest.approx(-1.65, abs=0.25)  # the door is from -2.4 to -0.9
    steps = np.linalg.norm(np.diff(found.points, axis=0), axis=1)
    assert steps.max() < 1.01 * 0.05


def _room(x: float, side: float = 2.4) -> list[Box]:
    """Four walls about a place."""
    walls = [Box((0.1, side, 1.0), at=(x + d, 0.0, 0.5), name=f"wall at {x + d:g}") for d in (-0.5 * side, 0.5 * side)]
    return [*walls, *(Box((side, 0.1, 1.0), at=(x, d, 0.5), name=f"wall {d:g}") for d in (-0.5 * side, 0.5 * side))]


def test_who_is_walled_in_is_said_and_by_what(jackal_box):
    start, goal = jackal_box.home(), jackal_box.home(4.0)
    crate = Box((0.3, 0.3, 1.0), at=(1.8, 1.0, 0.5), name="crate")  # aside of it all
    for at, what in ((4.0, "goal"), (0.0, "start")):
        walls = _room(at)
        found = grid_path(jackal_box, Scene([*walls, crate]), start, goal)
        assert found.points is None
        assert found.walled_in.startswith(f"the {what} ")
        assert all(wall.name in found.walled_in for wall in walls)
        assert "crate" not in found.walled_in
        assert found.walled_in in found.reason
        report = plan_report(jackal_box, Scene([*walls, crate]), start, goal, timeout=2.0)
        assert not report.certified
        assert report.walled_in.startswith(f"the {what} ")
    across = Box((0.2, 60.0, 1.0), at=(2.0, 0.0, 0.5), name="across")  # there may be a way about it, further off
    found = grid_path(jackal_box, Scene([across]), start, goal)
    assert found.points is None
    assert found.walled_in == ""


@both_kernels
def test_ground_is_reached_where_a_way_leads(native, jackal_box):
    """Not in a closed yard, also where the start is in it; and about the box there is a way around."""
    walls = [((4.0, 0.1), (5.0, 2.0)), ((4.0, 0.1), (5.0, -2.0)), ((0.1, 4.0), (3.0, 0.0)), ((0.1, 4.0), (7.0, 0.0))]
    scene = Scene([Box((*size, 1.0), at=(*at, 0.5)) for size, at in walls])
    places = np.array([(2.0, 0.0), (5.0, 0.5), (3.0, 0.0), (9.0, 1.0)])
    with native():
        outside = ground_about(jackal_box, scene, jackal_box.home(), places)
        inside = ground_about(jackal_box, scene, jackal_box.home(x=5.0), places)
        large = ground_about(jackal_box, scene, jackal_box.home(), 100.0 * places)
    assert outside is not None
    assert inside is not None
    assert outside.reached(places).tolist() == [True, False, False, True]
    assert inside.reached(places).tolist() == [False, True, False, False]
    assert large is None
    split = Scene([Box((0.2, 60.0, 1.0), at=(3.0, 0.0, 0.5))])  # it ends beyond the grid
    around = ground_about(jackal_box, split, jackal_box.home(), np.array([(5.0, 0.0)]))
    assert around is not None
    assert around.reached(np.array([(5.0, 0.0)])).all()


def test_it_prefers_a_wide_gap_to_a_short_way(jackal_box):
    """Two doors: a straight one of 0.5 m, which the robot would just pass, and a wide one 1.2 m aside."""
    wall = [Box((0.2, 0.9, 1.0), at=(2.0, 0.7, 0.5)), Box((0.2, 4.0, 1.0), at=(2.0, -2.25, 0.5))]
    far = Box((0.2, 4.0, 1.0), at=(2.0, 4.5, 0.5))
    found = grid_path(jackal_box, Scene([*wall, far]), jackal_box.home(), jackal_box.home(4.0))
    assert found.points is not None
    assert 1.3 < np.interp(2.0, found.points[:, 0], found.points[:, 1]) < 2.4
    shut = Scene([*wall, Box((0.2, 6.0, 1.0), at=(2.0, 3.8, 0.5))])
    narrow = grid_path(jackal_box, shut, jackal_box.home(), jackal_box.home(4.0))
    assert narrow.points is not None
    assert abs(np.interp(2.0, narrow.points[:, 0], narrow.points[:, 1])) < 0.1


def least_costs(cost, first):
    """Costs of the cheapest paths from a cell to all others, by relaxing all moves at once until nothing changes."""
    rows, columns = cost.shape
    moves = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if 0 < i * i + j * j < 6 and i * i + j * j != 4]
    assert len(moves) == 16
    come, own = np.full((rows + 4, columns + 4), np.inf), np.full((rows + 4, columns + 4), np.inf)
    own[2:-2, 2:-2] = cost
    come[first[0] + 2, first[1] + 2] = 0.0
    while True:
        before = come.copy()
        for i, j in moves:
            step = 0.5 * np.hypot(i, j) * (own + np.roll(own, (i, j), (0, 1)))
            np.minimum(come, np.roll(come, (i, j), (0, 1)) + step, out=come)
        if np.array_equal(come, before):
            return come[2:-2, 2:-2]


def cost_of(cost, route):
    """What a path (K, 2) costs; its moves are those of the grid."""
    step = np.square(np.diff(route, axis=0)).sum(axis=1)
    assert np.isin(step, (1, 2, 5)).all()
    at = cost[tuple(route.T)]
    return float((0.5 * (at[1:] + at[:-1]) * np.sqrt(step)).sum())


def random_costs(rng):
    """Costs of a small grid: flat, rough or very different ones, and closed cells."""
    shape = rng.integers(1, 30, 2)
    cost = rng.choice([1.0, 1.0 + rng.uniform(), 12.0, 9000.0]) ** rng.uniform(size=shape)
    cost[rng.uniform(size=shape) < rng.choice([0.0, 0.2, 0.5])] = np.inf
    return cost, np.column_stack([rng.integers(0, n, 2) for n in shape])


@both_kernels
def test_a_route_is_the_cheapest_there_is(native):
    rng, found = np.random.default_rng(6), 0
    with native():
        for _ in range(150):
            cost, ends = random_costs(rng)
            least = least_costs(cost, ends[0])[tuple(ends[1])]
            route = cheapest_route(cost, ends)
            if not np.isfinite(least):
                assert route is None
                continue
            assert route is not None
            np.testing.assert_array_equal(route[[0, -1]], ends)
            assert cost_of(cost, route) == pytest.approx(least, rel=1e-12)
            found += len(route) > 5
    assert 30 < found < 140


@both_kernels
def test_open_cells_are_counted(native):
    cost = np.ones((9, 11))
    cost[3, :5] = np.inf
    with native():
        before = counted()
        cheapest_route(cost, np.array([[0, 0], [8, 10]]))
    assert counted() - before == Work(batches=1, cells=94)


@both_kernels
def test_clearances_are_the_distances_to_the_nearest_taken_cell(native):
    rng = np.random.default_rng(4)
    with native():
        for _ in range(60):
            taken = rng.uniform(size=rng.integers(1, 40, 2)) < rng.choice([0.002, 0.02, 0.3, 1.0])
            clear = clearance_map(taken, 0.05)
            cells, nearest = np.indices(taken.shape).reshape(2, -1).T, np.argwhere(taken)
            if not len(nearest):
                assert np.isinf(clear).all()
                continue
            gap = np.square(cells[:, None] - nearest).sum(axis=2).min(axis=1)
            np.testing.assert_allclose(clear.ravel(), 0.05 * np.sqrt(gap), rtol=1e-12, atol=0.0)


@both_kernels
def test_cells_within_half_a_cell_belong_to_the_last_obstacle_there(native):
    """Outlines that pass just beyond the middles of cells, or just before them; corners are rounded."""
    for slack in (1e-6, -1e-6):
        boxes = Scene(
            [
                Box((0.75 + slack, 1.25 + slack, 1.0), at=(1.0, 1.0, 0.5)),
                Box((0.25 + slack, 9.0, 1.0), at=(1.5, 1.0, 0.5)),
            ]
        )
        expected = np.full((9, 8), -1)
        if slack > 0.0:  # x from 0.625 - 0.125 to 1.375 + 0.125, y from 0.375 - 0.125 to 1.625 + 0.125
            expected[3:6, 1:8] = 0
            expected[2:7, 2:7] = 0
            expected[5:8] = 1
        else:
            expected[3:6, 2:7] = 0
            expected[6] = 1
        with native():
            owner = owner_map(boxes, np.zeros(2), np.array(expected.shape), 0.25, 2.0)
        np.testing.assert_array_equal(owner, expected)


@both_kernels
def test_costs_fall_from_the_narrowest_clearance_to_the_open(native):
    clear = np.array([[0.0, 0.29, 0.3, 0.4, 0.5, 9.0, np.inf]])
    with native():
        cost = cell_cost(clear, 0.3, 0.2, np.zeros((0, 2), dtype=int), 0.05)
    np.testing.assert_allclose(cost, [[np.inf, np.inf, 12.0, 1.0 + 11.0 / 4.0, 1.0, 1.0, 1.0]])


@both_kernels
def test_a_start_among_obstacles_has_no_way_unless_it_is_the_goal(native):
    cost = np.ones((5, 5))
    cost[2, 2] = np.inf
    with native():
        assert cheapest_route(cost, np.array([[2, 2], [0, 0]])) is None
        assert cheapest_route(cost, np.array([[0, 0], [2, 2]])) is None
        route = cheapest_route(cost, np.array([[2, 2], [2, 2]]))
        assert route is not None
        assert route.tolist() == [[2, 2]]


@pytest.mark.skipif(kernel() is None, reason="there is no kernel")
@each("seed", range(6))
def test_both_kernels_find_the_same_path(jackal_box, seed):
    """Maps, costs and paths among shapes in any pose, some beyond the grid, to the last bit."""
    rng = np.random.default_rng(seed)
    items = [make_obstacle(shape, rng, (-4, -4, 0.0), (8, 4, 0.6)) for shape in (*SHAPES, *SHAPES)]
    points = rng.uniform((1.0, -2.0, 0.1), (5.0, 2.0, 0.4), (40, 3))
    scene, low, shape = Scene([*items, Voxels(points, 0.1)]), np.array([-2.5, -3.0]), np.array([190, 120])
    cells, found = np.array([[50, 60], [170, 60]]), []
    for native in (nullcontext, twin):
        with native():
            before = counted()
            owner = owner_map(scene, low, shape, 0.05, 1.0)
            clear = clearance_map(owner >= 0, 0.05)
            cost = cell_cost(clear, 0.2, COMFORTABLE_CLEARANCE, cells, 0.05)
            path = grid_path(jackal_box, slalom(seed), jackal_box.home(), jackal_box.home(6.0)).points
            found.append((owner, clear, cost, cheapest_route(cost, cells), path))
            assert path is not None
            found[-1] = (*found[-1], np.array(astuple(counted() - before)))
    assert 0.02 < (found[0][0] >= 0).mean() < 0.5
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@each("seed", range(4))
def test_among_ways_that_cost_the_same_both_kernels_choose_the_same(seed):
    """On an open grid there are very many."""
    rng = np.random.default_rng(seed)
    cost = np.ones((40, 50))
    cost[rng.uniform(size=cost.shape) < 0.1] = np.inf
    ends = np.array([[0, 0], [39, 49]])
    cost[tuple(ends.T)] = 1.0
    route = cheapest_route(cost, ends)
    with twin():
        other = cheapest_route(cost, ends)
    assert route is not None
    assert other is not None
    np.testing.assert_array_equal(route, other)


def test_a_gap_that_is_a_little_too_narrow_is_driven_around(jackal_box):
    """Between two posts the robot nearly fits; a long way round there is one."""
    gap = 0.5 * (2.0 * PlanarFootprint.of(jackal_box, jackal_box.home_q).inner - 0.01)
    posts = [Box((0.02, 8.0, 1.0), at=(2.0, s * (4.0 + gap), 0.5)) for s in (-1, 1)]
    found = grid_path(jackal_box, Scene(posts), jackal_box.home(), jackal_box.home(4.0), box=(FAR_LOW, -FAR_LOW))
    assert found.points is not None
    assert np.abs(found.points[:, 1]).max() > 8.0


def test_no_way_is_said(jackal_box, bridge_arm):
    """A wall without a door; and a deck that is lower than the arm in its start posture."""
    wall = Scene([Box((0.2, 30.0, 1.5), at=(2.0, 0.0, 0.75))])
    found = grid_path(jackal_box, wall, jackal_box.home(), jackal_box.home(4.0))
    assert found.points is None
    assert "no way for the base on a grid of 0.05 m" in found.reason
    deck = Scene([Box((0.6, 30.0, 0.1), at=(2.0, 0.0, 0.75))])
    assert grid_path(bridge_arm, deck, bridge_arm.home(), bridge_arm.home(4.0)).points is None
    assert grid_path(jackal_box, deck, jackal_box.home(), jackal_box.home(4.0)).points is not None


@each("seed", range(6))
def test_a_grid_path_relaxes_to_a_certified_strip_without_cusps(jackal_box, seed):
    """Forwards but for some centimetres while turning at an end; every segment drivable."""
    scene, start, goal = slalom(seed), jackal_box.home(), jackal_box.home(6.0)
    report = plan_report(jackal_box, scene, start, goal, line=False, grid=True)
    assert (report.certified, report.method, report.attempts) == (True, "grid", 1), report.reason
    assert Deformer(jackal_box).certify(report.strip, scene).certified
    assert report.strip.lateral_slip.max() <= 1e-6
    coordinates = report.strip.coordinates
    ahead = jackal_box.space.difference(coordinates[:-1], coordinates[1:])[:, 0]
    assert -ahead[ahead < 0.0].sum() < 0.05
    assert ahead[2:-2].min() > -1e-3  # what turning at an end takes back
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-12)


def test_the_planner_goes_on_where_the_grid_fails(bridge_arm):
    """The grid's robot cannot duck; OMPL's can."""
    deck = Scene([Box((0.6, 30.0, 0.1), at=(0.0, 0.0, 0.75), name="deck")])
    report = plan_report(bridge_arm, deck, bridge_arm.home(-1.5), bridge_arm.home(1.5), grid=True, timeout=60.0)
    assert report.certified, report.reason
    assert report.method in ("line", "ompl")


@pytest.mark.parametrize("base", ["diff_drive", "omni"])
def test_a_given_path_is_tried_first(base):
    """Waypoints, or coordinate rows, replace line and planner."""
    robot = load_robot("jackal-box", base=base)
    start, goal = robot.home(), robot.home(4.0, 0.0, 1.0)
    way = [(0, 0), (1.0, -1.65), (3.0, -1.65), (4, 0)]
    report = plan_report(robot, WALL, start, goal, path=way)
    assert (report.certified, report.method, report.attempts) == (True, "path", 0), report.reason
    again = plan_report(robot, WALL, start, goal, path=report.strip.coordinates)
    assert (again.certified, again.method) == (True, "path")
    through = plan_report(
        robot, WALL, start, goal, path=[(0, 0), (4, 0)], seed=1, grid=False
    )  # a bad path does no harm
    assert through.certified
    assert through.method == "ompl"


def test_waypoint_rows_turn_in_place_where_headings_differ_much(jackal_box):
    start, goal = jackal_box.home(yaw=2.0), jackal_box.home(2.0, 0.0, 0.3)
    rows = waypoint_rows(jackal_box, start, goal, [(0, 0), (2, 0)], spacing=0.1)
    np.testing.assert_allclose(jackal_box.space.from_coordinates(rows[[0, -1]]), [start, goal], atol=1e-12)
    turning = np.flatnonzero(np.hypot(*rows[:, :2].T) == 0.0)
    assert len(turning) >= 6
    assert np.abs(np.diff(rows[:, 2])).max() <= 0.36
    np.testing.assert_allclose(rows[turning[-1] : -9, 2], 0.0, atol=0.01)
    assert len(np.unique(rows[-9:, 0])) == 9  # 0.3 rad at the goal is bent, not turned in place
    steps = jackal_box.space.difference(rows[:-1], rows[1:])
    assert np.abs(steps[turning[:-1], :2]).max() == 0.0


def test_joints_move_evenly_along_waypoints(silvermate):
    start, goal = silvermate.home(), silvermate.home(2.0, 1.0, 0.4, arm_1_joint=1.0)
    rows = waypoint_rows(silvermate, start, goal, [(0, 0), (1, 0), (2, 1)], spacing=0.1)
    along = np.diff(rows[:, 3])
    assert along.min() > 0.0
    np.testing.assert_allclose(along, along.mean(), rtol=1e-6)


def test_resampling_keeps_the_ends_and_the_length():
    way = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    even = resample(way, 0.1)
    np.testing.assert_allclose(even[[0, -1]], way[[0, -1]])
    assert np.linalg.norm(np.diff(even, axis=0), axis=1).max() <= 0.1 + 1e-12
    assert len(resample(np.zeros((2, 2)), 0.1)) == 2


BAD = [
    (lambda r, f: grid_path(f, WALL, f.home(), f.home()), "the base of 'jackal-box' is fixed"),
    (lambda r, f: plan_report(r, WALL, r.home(), r.home(4.0), path=[(0, 0)]), r"path has shape \(1, 2\)"),
    (lambda r, f: plan_report(r, WALL, r.home(), r.home(4.0), path=np.zeros((3, 4))), r"\(K, 2\) or \(K, 3\)"),
    (lambda r, f: plan_report(r, WALL, r.home(), r.home(4.0), path=[(0, 0), (np.nan, 0)]), "not finite"),
    (lambda r, f: plan_report(f, Scene([]), f.home(), f.home(), path=[(0, 0), (1, 0)]), "is fixed"),
]


@each("make, message", BAD)
def test_wrong_arguments_are_refused(make, message, jackal_box):
    with pytest.raises(ParameterError, match=message):
        make(jackal_box, load_robot("jackal-box", base="fixed"))


def test_it_finds_a_way_through_the_barn_worlds(jackal_box):
    """A tenth of the official worlds; every strip is certified, keeps 5 cm and never backs up."""
    folder = shared_data("barn")
    for number in [i for i in barn_ids(folder) if i % 6 == 0][::10]:
        problem = load_barn(folder, number)
        ends = problem.configurations(jackal_box)
        report = plan_report(jackal_box, problem.world.at(0.0), *ends, line=False, grid=True)
        assert report.certified, (number, report.reason)
        assert report.method in ("line", "grid")
        assert report.report.clearance > 0.05
