"""Elastic band: forces by hand and by differences; neighbours overlap; a broken band is said to be, and made anew."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each
from flat_world import World, door, drive, scan, trap
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.errors import ParameterError
from workshop.baselines import BaseLimits, ElasticBand, ElasticBandParams
from workshop.baselines.elastic_band import (
    FreeDistance,
    SensedPath,
    bubble_contraction,
    bubble_repulsion,
    connected,
    relaxed,
    thinned,
    without_tangent,
)

GOAL = np.array([5.0, 0.0, 0.0])


def test_free_distance():
    free = FreeDistance(np.array([[1.0, 0.0], [0.0, 3.0]]), 0.25, 1.0)
    np.testing.assert_allclose(free(np.array([[0.0, 0.0], [0.9, 0.0], [9.0, 9.0]])), [0.75, -0.15, 1.0])
    assert FreeDistance(np.zeros((0, 2)), 0.25, 1.0)(np.zeros((4, 3, 2))).tolist() == [[1.0] * 3] * 4


def test_contraction_by_hand():
    chain = np.array([[0.0, 0.0], [1.0, 1.0], [4.0, 1.0], [5.0, 1.0]])
    half = math.sqrt(0.5)
    np.testing.assert_allclose(
        bubble_contraction(chain, 2.0), [[2.0 * (1.0 - half), -2.0 * half], [0.0, 0.0]], atol=1e-12
    )


def test_contraction_is_minus_the_gradient_of_the_length():
    rng = np.random.default_rng(3)
    chain, h = rng.uniform(-1, 1, (4, 2)), 1e-6

    def length(c):
        return np.linalg.norm(np.diff(c, axis=0), axis=1).sum()

    for i in (1, 2):
        for k in range(2):
            step = np.zeros_like(chain)
            step[i, k] = h
            slope = (length(chain + step) - length(chain - step)) / (2.0 * h)
            assert bubble_contraction(chain, 1.0)[i - 1, k] == pytest.approx(-slope, abs=1e-6)


def test_repulsion_by_hand():
    free = FreeDistance(np.array([[0.0, 0.0]]), 0.25, 1.0)
    at = np.array([[0.65, 0.0], [0.0, -0.75], [1.2, 0.0]])  # free distances 0.4, 0.5, 0.95
    force = bubble_repulsion(free, at, free(at), 2.0, 0.7)
    np.testing.assert_allclose(force, [[2.0 * 0.3, 0.0], [0.0, -2.0 * 0.2], [0.0, 0.0]], atol=1e-9)


def test_repulsion_vanishes_in_the_middle_of_a_gap():
    free = FreeDistance(np.array([[0.0, 0.5], [0.0, -0.5]]), 0.25, 1.0)
    at = np.array([[0.0, 0.0], [0.0, 0.1]])
    force = bubble_repulsion(free, at, free(at), 1.0, 0.7)
    np.testing.assert_allclose(force[0], 0.0, atol=1e-12)
    assert force[1, 1] < -0.1


@given(st.integers(0, 999))
def test_no_force_along_the_band(seed):
    rng = np.random.default_rng(seed)
    chain, force = rng.uniform(-1, 1, (5, 2)), rng.uniform(-1, 1, (3, 2))
    out = without_tangent(force, chain)
    np.testing.assert_allclose((out * (chain[:-2] - chain[2:])).sum(axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(without_tangent(out, chain), out, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 9999))
def test_neighbours_overlap_or_the_band_is_broken(seed):
    rng = np.random.default_rng(seed)
    free = FreeDistance(rng.uniform((0.0, -2.0), (5.0, 2.0), (8, 2)), 0.2, 1.0)
    chain = connected(np.array([[-0.5, 0.0], [5.5, 0.0]]), free, least=0.02, overlap=0.9, most=150)
    for _ in range(6):
        if chain is None:
            return
        for kept in (chain, thinned(chain, free, least=0.02, overlap=0.7)):
            rho = free(kept)
            assert (rho >= 0.02).all()
            assert (np.linalg.norm(np.diff(kept, axis=0), axis=1) <= 0.9 * (rho[1:] + rho[:-1]) + 1e-9).all()
            along = np.linspace(kept[:-1], kept[1:], 21)  # so the base is free all along the band
            assert (free(along) > 0.0).all()
            assert kept[0].tolist() == [-0.5, 0.0]
            assert kept[-1].tolist() == [5.5, 0.0]
        chain = relaxed(kept, free, contraction=0.3, repulsion=0.8, influence=0.7)
        chain = connected(chain, free, least=0.02, overlap=0.9, most=150)


def test_a_detour_contracts_to_a_straight_line():
    free = FreeDistance(np.zeros((0, 2)), 0.2, 1.0)
    chain = np.array([[0.0, 0.0], [1.0, 0.8], [2.0, 1.2], [3.0, 0.8], [4.0, 0.0]])
    for _ in range(200):
        chain = relaxed(chain, free, contraction=0.3, repulsion=0.8, influence=0.7)
    assert np.abs(chain[:, 1]).max() < 0.01


def test_a_band_is_pushed_off_an_obstacle():
    free = FreeDistance(np.array([[2.0, -0.35]]), 0.2, 1.0)
    chain = connected(np.array([[0.0, 0.0], [4.0, 0.0]]), free, least=0.02, overlap=0.9, most=150)
    assert chain is not None
    before = free(chain).min()
    for _ in range(60):
        chain = connected(
            relaxed(chain, free, contraction=0.2, repulsion=1.0, influence=0.7), free, least=0.02, overlap=0.9, most=150
        )
    assert free(chain).min() > before + 0.1


def test_a_broken_band_without_a_planner_stands():
    method = ElasticBand(BaseLimits())
    wall = World(walls=[(1.5, -3.0, 1.5, 3.0)])
    run = drive(method, wall, (0, 0, 0), GOAL, seconds=2.0)
    assert run.commands[-1].status == "blocked"
    assert run.commands[-1].reason == "the band is broken"
    assert method.chain is None
    assert run.poses[-1, 0] < 0.01


def test_what_appears_on_the_band_breaks_it_and_the_planner_is_asked():
    asked = []

    def planner(points, start, goal):
        asked.append(len(points))
        return SensedPath(0.27)(points, start, goal)

    method = ElasticBand(BaseLimits(), planner=planner)
    method.command(0.0, np.zeros(3), np.zeros(2), GOAL)
    assert not asked
    world = World(circles=[(1.5, 0.05, 0.3)])
    method.update(scan(world, np.zeros(3)), np.zeros(3))
    command = method.command(0.1, np.zeros(3), np.zeros(2), GOAL)
    assert len(asked) == 1
    assert command.status == "moving"
    assert method.chain is not None
    assert min(world.clearance(p, 0.27) for p in method.chain) > 0.0


@pytest.mark.parametrize("start", [(0.6, 0.0, 0.0), (0.6, 0.4, -0.3)])
def test_it_passes_a_narrow_door(start):
    method = ElasticBand(BaseLimits(), planner=SensedPath(0.27))
    run = drive(method, door(0.8), start, GOAL, seconds=18.0, rate=10.0)
    assert run.arrived
    assert run.clearance > 0.0


def test_it_leaves_a_trap_by_its_planner():
    method = ElasticBand(BaseLimits(), planner=SensedPath(0.27))
    run = drive(method, trap(), (0.0, 0.0, 0.0), GOAL, seconds=20.0, rate=10.0)
    assert run.arrived
    assert run.clearance > 0.0


def test_the_planner_finds_no_way_where_there_is_none():
    ring = np.array([[math.cos(a), math.sin(a)] for a in np.arange(0.0, 6.3, 0.05)])
    assert SensedPath(0.27)(ring, np.zeros(2), GOAL[:2]) is None


@each(
    "given_, message",
    [
        ({"least": 2.0}, r"least=2.0 must not exceed largest=1.0"),
        ({"look_least": 0.6}, r"look_least=0.6 must not exceed look_ahead=0.5"),
        ({"overlap": 1.1}, r"overlap=1.1 must be a finite number > 0 and ≤ 1"),
        ({"iterations": 1.5}, r"iterations=1.5 must be a whole number"),
        ({"repulsion": -1.0}, r"repulsion=-1.0 must be a finite number > 0"),
    ],
)
def test_parameters_are_checked(given_, message):
    with pytest.raises(ParameterError, match=message):
        ElasticBandParams(**given_)
