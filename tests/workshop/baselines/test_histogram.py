"""Vector field histogram: magnitudes, enlargement, thresholds, mask, valleys and cost by hand; doors are passed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each
from flat_world import World, door, drive, placed
from hypothesis import given
from hypothesis import strategies as st

from elastic_strips.errors import ParameterError
from elastic_strips.perception import RangeRing
from workshop.baselines import BaseLimits, HistogramParams, VectorFieldHistogram
from workshop.baselines.histogram import (
    Valley,
    binary_histogram,
    candidates,
    cheapest,
    masked_histogram,
    original_histogram,
    primary_histogram,
    sector_distance,
    valleys,
)

HERE = np.array([0.05, 0.05, 0.0])
GOAL = np.array([5.05, 0.05, 0.0])


def primary(offsets, certainty, enlarged=0.3):
    return primary_histogram(
        np.array(offsets), np.array(certainty), sectors=72, cell=0.1, reach=16.0, a=257.0, enlarged=enlarged
    )


def flags(*blocked, count=72):
    out = np.zeros(count, dtype=bool)
    out[list(blocked)] = True
    return out


def test_magnitude_by_hand_and_one_at_the_rim():
    assert primary([[1.0, 0.0]], [5.0])[0] == pytest.approx(25.0 * (257.0 - 100.0))  # b = 1
    assert primary([[1.6, 0.0]], [7.0])[0] == pytest.approx(49.0)  # a − b d_max² = 1
    assert not primary([[1.61, 0.0]], [15.0]).any()  # outside the circle
    assert primary([[1.0, 0.0], [1.0, 0.0]], [5.0, 2.0])[0] == pytest.approx(29.0 * 157.0)  # they add up


def test_cells_are_enlarged_by_the_base():
    # asin(0.3 / 0.6) = 30 degrees: six sectors of 5 degrees to both sides
    assert np.flatnonzero(primary([[0.6, 0.0]], [5.0])).tolist() == [*range(7), *range(66, 72)]
    assert np.flatnonzero(primary([[0.0, 0.6]], [5.0])).tolist() == list(range(12, 25))
    assert np.count_nonzero(primary([[0.2, 0.0]], [5.0])) == 37  # within the enlarged base: the half plane
    assert np.count_nonzero(primary([[1.6, 0.0]], [5.0], enlarged=0.0)) == 1  # at least its own sector


@given(st.floats(0.35, 1.5), st.integers(0, 71), st.floats(0.05, 0.34))
def test_turning_the_scene_turns_the_histogram(distance, turn, enlarged):
    def at(k):
        angle = 2.0 * math.pi * k / 72 + 0.013
        return primary([[distance * math.cos(angle), distance * math.sin(angle)]], [9.0], enlarged)

    np.testing.assert_allclose(at(turn), np.roll(at(0), turn))


def test_original_histogram_by_hand():
    h = original_histogram(np.array([[1.0, 0.0]]), np.array([4.0]), sectors=72, cell=0.1, reach=16.0, smoothing=5)
    m = 16.0 * (math.sqrt(2.0) * 16.0 - 10.0)
    np.testing.assert_allclose(h[[0, 1, 2, 3, 4, 5, 6, 67, 71]], m / 11.0 * np.array([5, 5, 4, 3, 2, 1, 0, 1, 5]))
    corner = original_histogram(np.array([[1.6, 1.6]]), np.array([4.0]), sectors=72, cell=0.1, reach=16.0, smoothing=5)
    np.testing.assert_allclose(corner, 0.0, atol=1e-9)


def test_thresholds_have_hysteresis():
    density = np.array([1.0, 3.0, 3.0, 5.0])
    before = np.array([True, True, False, False])
    assert binary_histogram(density, before, 2.0, 4.0).tolist() == [False, True, False, True]


def test_mask_by_hand():
    free = flags()
    cell = np.array([[0.3, 0.6]])  # at 63.4 degrees to the left
    masked = masked_histogram(free, cell, 0.0, turning_radius=0.5, enlarged=0.35)
    # the left centre is (0, 0.5): 0.316 from the cell, less than 0.85; all beyond 63.4 degrees to the left is shut
    assert np.flatnonzero(masked).tolist() == list(range(13, 36))
    assert not masked_histogram(free, cell, 0.0, turning_radius=0.0, enlarged=0.35).any()  # it turns in place
    far = np.array([[1.5, 1.0]])  # 1.58 from the left centre
    assert not masked_histogram(free, far, 0.0, turning_radius=0.5, enlarged=0.35).any()
    mirrored = masked_histogram(free, cell * [1.0, -1.0], 0.0, turning_radius=0.5, enlarged=0.35)
    assert np.flatnonzero(mirrored[1:36]).size == 0
    assert mirrored[[59, 50, 37]].all()
    turned = masked_histogram(
        free, cell @ np.array([[0.0, 1.0], [-1.0, 0.0]]), 0.5 * math.pi, turning_radius=0.5, enlarged=0.35
    )
    assert np.flatnonzero(turned).tolist() == list(range(31, 54))


def test_valleys_wrap_around():
    assert valleys(flags(10, 11, 20)) == [Valley(12, 19), Valley(21, 81)]
    assert valleys(flags()) == [Valley(0, 71)]
    assert valleys(~flags()) == []


@given(st.lists(st.integers(0, 71), max_size=40))
def test_valleys_are_all_open_sectors_once(shut):
    blocked = flags(*shut)
    open_ = sorted(k % 72 for v in valleys(blocked) for k in range(v.right, v.left + 1))
    assert open_ == np.flatnonzero(~blocked).tolist()


def test_candidates():
    narrow = ~flags(*range(5, 10))
    assert candidates(narrow, 40.0, 16) == [7.0]  # the middle
    wide = ~flags(*range(10, 41))
    assert candidates(wide, 60.0, 16) == [18.0, 32.0]
    assert candidates(wide, 25.0, 16) == [18.0, 32.0, 25.0]  # the target, between them
    assert candidates(wide, 12.0, 16) == [18.0, 32.0]
    assert candidates(~flags(*range(60, 72), *range(0, 20)), -1.0, 16) == [68.0, 11.0, 71.0]  # over the wrap
    assert candidates(flags(), -1.0, 16) == [71.0]
    assert candidates(~flags(), 3.0, 16) == []


def test_cost_by_hand():
    assert sector_distance(1.0, 71.0, 72) == 2.0
    # g(10) = 5·10 + 2·10 + 2·30 = 130; g(70) = 5·2 + 2·2 + 2·30 = 74; g(38) = 5·34 + 2·34 + 2·2 = 242
    weighed = [(5.0, 0.0), (2.0, 0.0), (2.0, 40.0)]
    assert cheapest([10.0, 70.0, 38.0], weighed, 72) == 70.0
    # the last choice decides between two that are as far from the target
    assert cheapest([10.0, 62.0], [(5.0, 0.0), (2.0, 0.0), (2.0, 12.0)], 72) == 10.0
    assert cheapest([10.0, 62.0], [(5.0, 0.0), (2.0, 0.0), (2.0, 60.0)], 72) == 62.0


def test_one_sonar_echo_blocks_nothing_several_do():
    method = VectorFieldHistogram(BaseLimits())
    for k, blocks in enumerate((False, True, True)):
        method.update(RangeRing("s", "sonar", 0.0, placed(0.2, 0.0, 0.0)[None], [0.6], 0.2, 0.0, 2.0), HERE)
        method.command(0.1 * k, HERE, np.zeros(2), GOAL)
        assert method.blocked.any() == blocks


def test_boxed_in_it_stands_and_says_so():
    world = World(circles=[(0.05 + 0.5 * math.cos(a), 0.05 + 0.5 * math.sin(a), 0.1) for a in np.arange(0, 6.2, 0.3)])
    run = drive(VectorFieldHistogram(BaseLimits()), world, HERE, GOAL, seconds=2.0)
    assert run.commands[-1].status == "blocked"
    assert "no direction is open" in run.commands[-1].reason
    assert abs(run.commands[-1].v) < 1e-12
    assert run.clearance > 0.0


def test_speed_law():
    limits, p = BaseLimits(max_speed=0.6, max_turn=1.5), HistogramParams(stop_density=100.0, min_speed=0.04)
    method = VectorFieldHistogram(limits, p)
    assert method._speed(0.0, 0.0, False) == pytest.approx(0.64)  # then bounded by the largest speed
    assert method._speed(50.0, 0.75, False) == pytest.approx(0.6 * 0.5 * 0.5 + 0.04)
    assert method._speed(500.0, 0.0, True) == 0.0


@each("params", [HistogramParams(), HistogramParams.original()], ids=["vfh+", "vfh"])
@each("start", [(0.6, 0.0, 0.0), (0.6, 0.4, -0.3)])
def test_it_passes_a_narrow_door(params, start):
    gap = 0.8 if params.variant == "vfh+" else 1.2
    method = VectorFieldHistogram(BaseLimits(), params)
    run = drive(method, door(gap), start, np.array([5.0, 0.0, 0.0]), seconds=18.0, rate=12.0)
    assert run.arrived
    assert run.clearance > 0.0


def test_a_goal_in_front_of_a_wall_is_reached():
    goal = np.array([2.0, 0.0, 0.0])
    run = drive(VectorFieldHistogram(BaseLimits()), World(walls=[(2.45, -3, 2.45, 3)]), (0, 0, 0), goal, seconds=12.0)
    assert run.arrived
    assert run.clearance > 0.0


@each(
    "given_, message",
    [
        ({"variant": "vhf"}, r"variant='vhf' is unknown; did you mean 'vfh'"),
        ({"active": 10}, r"active=10 must be odd"),
        ({"low": 9000.0}, r"low=9000.0 must not exceed high=5000.0"),
        ({"sectors": 4}, r"sectors=4 must be a whole number ≥ 8"),
        ({"magnitude": 0.5}, r"magnitude=0.5 must be a finite number ≥ 1"),
        ({"target_weight": 0.0}, r"target_weight=0.0 must be a finite number > 0"),
    ],
)
def test_parameters_are_checked(given_, message):
    with pytest.raises(ParameterError, match=message):
        HistogramParams(**given_)
