"""Maintenance: long and uncertified segments are divided, crowded nodes go, nothing else changes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from brute_force import random_coordinates
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.strip.resampling import kept_segments, node_spacing, resample

BASE = 10


def straight(silvermate, *x: float) -> np.ndarray:
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (len(x), 1))
    coordinates[:, 0] = x
    return coordinates


def edit(silvermate, coordinates: np.ndarray, **options: object):
    settings = {"max_spacing": 0.2, "min_spacing": 0.06} | options
    return resample(
        silvermate.space, coordinates, node_spacing(silvermate.space, coordinates, np.ones(BASE)), **settings
    )


def test_a_good_strip_is_left_alone(silvermate):
    assert edit(silvermate, straight(silvermate, 0.0, 0.1, 0.2, 0.3)) is None
    assert edit(silvermate, straight(silvermate, 0.0, 0.0)) is None


def test_long_segments_are_divided_evenly(silvermate):
    coordinates, source = edit(silvermate, straight(silvermate, 0.0, 0.1, 0.6))
    np.testing.assert_allclose(coordinates[:, 0], [0.0, 0.1, 0.1 + 0.5 / 3, 0.1 + 1.0 / 3, 0.6])
    assert source.tolist() == [0, 1, -1, -1, 2]


def test_one_segment_gets_at_most_seven_nodes_at_once(silvermate):
    _, source = edit(silvermate, straight(silvermate, 0.0, 50.0))
    assert source.tolist() == [0, *[-1] * 7, 1]


def test_segments_without_certificate_are_halved(silvermate):
    coordinates, source = edit(silvermate, straight(silvermate, 0.0, 0.1, 0.2), split=np.array([False, True]))
    assert source.tolist() == [0, 1, -1, 2]
    assert coordinates[2, 0] == pytest.approx(0.15)


def test_a_segment_of_no_length_is_not_halved_for_ever(silvermate):
    assert edit(silvermate, straight(silvermate, 0.0, 0.1, 0.101), split=np.array([False, True])) is None


def test_crowded_nodes_go_one_in_two(silvermate):
    x = np.linspace(0.0, 0.1, 11)
    _, source = edit(silvermate, straight(silvermate, *x))
    assert (source >= 0).all()
    gone = sorted(set(range(11)) - set(source.tolist()))
    assert gone
    assert 0 not in gone
    assert 10 not in gone
    assert all(b - a > 1 for a, b in pairwise(gone))


def test_no_node_goes_beside_one_that_comes(silvermate):
    _, source = edit(silvermate, straight(silvermate, 0.0, 0.02, 0.04, 0.06), split=np.array([False, True, False]))
    assert source.tolist() == [0, 1, -1, 2, 3]


def test_there_are_never_more_than_max_nodes(silvermate):
    coordinates = straight(silvermate, 0.0, 1.0, 2.0)
    made = edit(silvermate, coordinates, max_nodes=8)
    assert made is None or len(made[0]) <= 8
    assert len(edit(silvermate, coordinates, max_nodes=11)[0]) == 11


def test_some_nodes_come_in_where_not_all_fit(silvermate):
    """A broken segment must not stay broken because others are long as well."""
    coordinates = straight(silvermate, 0.0, 1.0, 2.0)
    _, source = edit(silvermate, coordinates, max_nodes=8)
    assert (source < 0).any()


@settings(max_examples=120, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    nodes=st.integers(2, 40),
    scale=st.sampled_from([0.005, 0.05, 0.3]),
    broken=st.floats(0.0, 0.4),
    room=st.integers(0, 60),
)
def test_order_ends_and_interpolation_are_kept(silvermate, rover, seed, nodes, scale, broken, room):
    rng = np.random.default_rng(seed)
    robot = silvermate if seed % 2 else rover
    steps = rng.normal(size=(nodes, robot.nv)) * scale
    coordinates = random_coordinates(robot, rng, 1)
    for v in steps[1:]:
        coordinates = np.vstack((coordinates, robot.space.integrate(coordinates[-1], v)))
    weight, split = rng.uniform(0.05, 1.0, robot.nv), rng.random(nodes - 1) < broken
    spacing = node_spacing(robot.space, coordinates, weight)
    made = resample(
        robot.space, coordinates, spacing, max_spacing=0.2, min_spacing=0.06, split=split, max_nodes=nodes + room
    )
    if made is None:
        assert spacing.max() <= 0.2 or room < np.ceil(spacing / 0.2).sum()
        return
    new, source = made
    assert source[0] == 0
    assert source[-1] == nodes - 1
    old = source[source >= 0]
    assert (np.diff(old) > 0).all()
    np.testing.assert_array_equal(new[source >= 0], coordinates[old])
    assert len(new) <= nodes + room
    # new nodes lie on the way between the old ones
    j = 0
    for row, of in zip(new, source, strict=True):
        if of >= 0:
            j = of
            continue
        v, whole = (
            robot.space.difference(coordinates[j], row),
            robot.space.difference(coordinates[j], coordinates[j + 1]),
        )
        share = float(v @ whole) / float(whole @ whole)
        assert 0.0 < share < 1.0
        np.testing.assert_allclose(v, share * whole, atol=1e-9)
    after = node_spacing(robot.space, new, weight)
    if len(new) + nodes - len(old) < nodes + room:  # all that was wanted fitted
        assert after.max() <= max(0.2, spacing.max() / 8, spacing.max() * ((source >= 0).all())) + 1e-9
    if len(old) < nodes:
        gone = np.setdiff1d(np.arange(nodes), old)
        assert (spacing[gone - 1] + spacing[gone] < 0.06).all()
        assert not split[gone - 1].any() or scale < 0.05


def test_segments_are_kept_only_as_they_were():
    """Neither what was put in, nor what joins two, nor what moved by a bit, nor what was not asked for."""
    before = np.arange(7.0)[:, None]
    source = np.array([0, 1, -1, 2, 4, 5, 6])  # one put in after 1, and 3 taken out
    rows = np.where(source[:, None] < 0, 1.5, before[source])
    which = np.array([True, True, True, True, True, False])
    assert kept_segments(before, rows, source, which).tolist() == [True, False, False, False, True, False]
    rows[1] += 1e-15
    assert rows[1] != before[1]
    assert kept_segments(before, rows, source, which).tolist() == [False, False, False, False, True, False]
