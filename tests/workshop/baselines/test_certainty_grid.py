"""Certainty grids: counts and probabilities after known readings; the window stays aligned with the world."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each
from flat_world import World, placed, scan
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.errors import ParameterError
from elastic_strips.perception import NO_ANSWER, NOTHING, LaserScan, RangeRing
from workshop.baselines import GridParams
from workshop.baselines.certainty_grid import CV_MAX, BayesGrid, HistogramGrid, make_grid

HERE = np.array([0.05, 0.05, 0.0])  # the middle of cell (0, 0)


def value_at(grid, point) -> float:
    """The stored value of the cell that holds a point (2,)."""
    i, j = grid.cells_of(point) - grid.first
    return float(grid.values[i, j])


def sonar(*ranges, half_angle=0.2, reach=2.0):
    """A ring whose sensors sit at the base's origin and look along x, y, −x, −y in turn."""
    T = np.stack([placed(0.0, 0.0, 0.5 * math.pi * k) for k in range(len(ranges))])
    return RangeRing("sonars", "sonar", 0.0, T, ranges, half_angle, 0.0, reach)


def laser(angles, ranges, reach=2.0):
    return LaserScan("laser", 0.0, np.eye(4), angles, ranges, 0.0, reach)


def row(grid, cells, y=0.05):
    return [value_at(grid, np.array([0.1 * k + 0.05, y])) for k in cells]


def test_a_range_adds_three_at_its_end_and_takes_one_off_before_it():
    grid = HistogramGrid()
    grid.update(sonar(1.0), HERE)
    assert row(grid, range(9, 13)) == [0.0, 3.0, 0.0, 0.0]
    grid.update(sonar(1.0), HERE)
    assert row(grid, [10]) == [6.0]
    grid.update(sonar(1.5), HERE)  # through the cell, to one behind it
    assert row(grid, [9, 10, 14, 15, 16]) == [0.0, 5.0, 0.0, 3.0, 0.0]
    assert grid.values.sum() == 8.0


def test_counts_stay_between_0_and_15():
    grid = HistogramGrid()
    for k in range(1, 8):
        grid.update(sonar(1.0), HERE)
        assert row(grid, [10]) == [min(3.0 * k, CV_MAX)]
    for k in range(1, 20):
        grid.update(sonar(NOTHING), HERE)  # nothing within 2 m empties the axis
        assert row(grid, [10]) == [max(15.0 - k, 0.0)]


def test_no_answer_changes_nothing():
    grid = HistogramGrid()
    grid.update(sonar(1.0), HERE)
    before = grid.values.copy()
    grid.update(sonar(NO_ANSWER), HERE)
    np.testing.assert_array_equal(grid.values, before)


def test_sensors_of_a_ring_count_each_by_itself():
    grid = HistogramGrid()
    T = np.stack([np.eye(4), np.eye(4)])
    grid.update(RangeRing("sonars", "sonar", 0.0, T, [1.0, 1.0], 0.2, 0.0, 2.0), HERE)
    assert row(grid, [10]) == [6.0]
    grid.update(RangeRing("sonars", "sonar", 0.0, T, [1.5, 1.5], 0.2, 0.0, 2.0), HERE)
    assert row(grid, [10, 15]) == [4.0, 6.0]


def test_pose_and_mounting_place_a_reading():
    grid = HistogramGrid()
    T = placed(0.2, 0.0, 0.5 * math.pi)[None]  # 0.2 m ahead, looks to the left
    grid.update(RangeRing("sonars", "sonar", 0.0, T, [0.7], 0.2, 0.0, 2.0), np.array([1.05, 1.05, 0.5 * math.pi]))
    assert value_at(grid, np.array([0.35, 1.25])) == 3.0  # to the left of a base that looks along y is −x
    assert grid.values.sum() == 3.0


def test_a_scan_changes_a_cell_once():
    grid = HistogramGrid()
    angles = np.linspace(-0.02, 0.02, 9)
    grid.update(laser(angles, np.full(9, 1.0)), HERE)
    assert row(grid, [10]) == [3.0]
    grid.update(laser(angles, np.full(9, 1.5)), HERE)
    assert row(grid, [10]) == [2.0]
    grid.update(laser(angles, np.full(9, NO_ANSWER)), HERE)
    assert row(grid, [10]) == [2.0]
    grid.update(laser(angles, np.full(9, NOTHING)), HERE)
    assert row(grid, [10]) == [1.0]
    assert row(grid, [-10], y=0.05) == [0.0]


def test_a_cell_where_one_ray_ends_and_another_goes_on_is_hit():
    grid = HistogramGrid()
    grid.update(laser([-0.03, 0.0, 0.03], [1.5, 1.5, 1.0]), HERE)
    assert row(grid, [10, 15]) == [3.0, 3.0]


def test_a_scan_leaves_alone_what_it_does_not_look_at():
    grid = HistogramGrid()
    grid.update(sonar(1.0, 1.0, 1.0, 1.0), HERE)
    before = grid.values.copy()
    grid.update(laser(np.radians([-1.0, 0.0, 1.0]), np.full(3, NOTHING)), HERE)
    changed = np.argwhere(grid.values != before) + grid.first
    assert changed.tolist() == [[10, 0]]


@settings(max_examples=40, deadline=None)
@given(
    x=st.floats(-3.0, 3.0),
    y=st.floats(-3.0, 3.0),
    dx=st.floats(-2.0, 2.0),
    dy=st.floats(-2.0, 2.0),
    seed=st.integers(0, 99),
)
def test_the_window_moves_by_whole_cells_and_keeps_the_world(x, y, dx, dy, seed):
    grid = HistogramGrid(GridParams(size=31))
    grid.follow(np.array([x, y]))
    grid.values[:] = np.random.default_rng(seed).integers(0, 16, grid.values.shape)
    cells = np.argwhere(np.ones_like(grid.values, dtype=bool)) + grid.first
    known = {tuple(c): v for c, v in zip(cells.tolist(), grid.values.ravel(), strict=True)}
    grid.follow(np.array([x + dx, y + dy]))
    assert (grid.cells_of(np.array([x + dx, y + dy])) - grid.first == 15).all()
    for c, v in zip(
        (np.argwhere(np.ones((31, 31), dtype=bool)) + grid.first).tolist(), grid.values.ravel(), strict=True
    ):
        assert v == known.get(tuple(c), 0.0)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 999),
    kind=st.sampled_from(["histogram", "bayes"]),
    yaw=st.floats(-3.0, 3.0),
    n=st.integers(1, 4),
)
def test_certainty_is_always_in_range(seed, kind, yaw, n):
    rng = np.random.default_rng(seed)
    grid = make_grid(GridParams(kind=kind, size=31))
    for _ in range(n):
        ranges = rng.choice([NOTHING, NO_ANSWER, *rng.uniform(0.0, 2.0, 6)], 4)
        grid.update(sonar(*ranges), np.array([*rng.uniform(-1, 1, 2), yaw]))
        grid.update(
            laser(np.linspace(-2.0, 2.0, 40), rng.uniform(0.1, 2.0, 40)), np.array([*rng.uniform(-1, 1, 2), yaw])
        )
    certainty = grid.certainty()
    assert np.isfinite(certainty).all()
    assert certainty.min() >= 0.0
    assert certainty.max() <= CV_MAX


def test_active_region():
    grid = HistogramGrid()
    grid.update(sonar(0.5, 1.0, 1.7), HERE)  # ahead, to the left, behind
    offsets, certainty = grid.active(HERE, 21)  # ten cells to each side
    np.testing.assert_allclose(sorted(offsets.tolist()), [[0.0, 1.0], [0.5, 0.0]], atol=1e-12)
    assert certainty.tolist() == [3.0, 3.0]
    assert len(grid.active(HERE, 19)[1]) == 1
    assert len(grid.active(np.array([50.0, 0.0]), 21)[1]) == 0


def test_bayes_on_the_axis_by_hand():
    p = GridParams(kind="bayes", hit=0.6, free=0.4, depth=0.1)
    grid = BayesGrid(p)
    grid.update(sonar(1.0, half_angle=0.3), HERE)
    # at its range: p = ½ (1 + 0.6)
    assert value_at(grid, np.array([1.05, 0.05])) == pytest.approx(math.log(0.8 / 0.2))
    # half-way: E = 1 − (0.5/0.9)², p = ½ (1 − 0.4 E)
    empty = 0.5 * (1.0 - 0.4 * (1.0 - (0.5 / 0.9) ** 2))
    assert value_at(grid, np.array([0.55, 0.05])) == pytest.approx(math.log(empty / (1.0 - empty)))
    # off the axis by 0.1 / 1.0, the same shell, weaker
    d, angle = math.hypot(1.0, 0.1), math.atan(0.1)
    signed = 0.6 * (1.0 - ((d - 1.0) / 0.1) ** 2) * (1.0 - (angle / 0.3) ** 2)
    assert value_at(grid, np.array([1.05, 0.15])) == pytest.approx(2.0 * math.atanh(signed))
    assert value_at(grid, np.array([1.05, 0.05 + 0.4])) == 0.0  # out of the cone
    assert value_at(grid, np.array([1.45, 0.05])) == 0.0  # behind
    grid.update(sonar(1.0, half_angle=0.3), HERE)  # log-odds add up
    assert value_at(grid, np.array([1.05, 0.05])) == pytest.approx(2.0 * math.log(4.0))
    assert grid.certainty().max() == pytest.approx(15.0 * (2.0 * 16.0 / 17.0 - 1.0))


def test_bayes_changes_its_mind_and_reads_scans():
    grid = BayesGrid(GridParams(kind="bayes"))
    for _ in range(50):
        grid.update(laser(np.linspace(-0.02, 0.02, 9), np.full(9, 1.0)), HERE)
    i, j = grid.cells_of(np.array([1.05, 0.05])) - grid.first
    assert grid.certainty()[i, j] == pytest.approx(15.0, abs=0.2)
    for _ in range(20):
        grid.update(laser(np.linspace(-0.02, 0.02, 9), np.full(9, 1.9)), HERE)
    assert grid.certainty()[i, j] == 0.0


@pytest.mark.parametrize("kind", ["histogram", "bayes"])
def test_a_wall_is_found_where_it_is(kind):
    world = World(walls=[(1.02, -3.0, 1.02, 3.0)])
    grid = make_grid(GridParams(kind=kind))
    for _ in range(4):
        grid.update(scan(world, HERE), HERE)
    offsets, certainty = grid.active(HERE, 33)
    sure = offsets[certainty > 8.0] + HERE[:2]
    assert len(sure) >= 25
    assert np.abs(sure[:, 0] - 1.05).max() < 0.06  # all in the column of cells that holds the wall


@each(
    "given_, message",
    [
        ({"kind": "baies"}, r"kind='baies' is unknown; did you mean 'bayes'"),
        ({"cell": 0.0}, r"cell=0.0 must be a finite number > 0"),
        ({"size": 2}, r"size=2 must be a whole number ≥ 3"),
        ({"hit": 1.0}, r"hit=1.0 must be a finite number > 0 and < 1"),
    ],
)
def test_parameters_are_checked(given_, message):
    with pytest.raises(ParameterError, match=message):
        GridParams(**given_)
