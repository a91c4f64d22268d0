"""A short attack on the certificate; the long one is a command (see ``attack.py``)."""

from __future__ import annotations

import numpy as np
import pytest
from attack import BY_SPHERES, KINDS, Checker, Figures, run

from elastic_strips.native import kernel
from elastic_strips.scene import Box, Scene


@pytest.fixture(scope="module")
def figures() -> Figures:
    """One robot on each kind of base, among them one with eight degrees of freedom."""
    total = Figures()
    for seed in (9, 16, 8):
        total.add(run(250, seed))
    return total


def test_nothing_that_is_certified_comes_nearer_than_was_proven(figures):
    assert figures.false == []
    assert {base for _, base, _, _ in figures.counts} == {"fixed", "omni", "diff_drive"}
    for kind in KINDS if kernel() is None else (*KINDS, *BY_SPHERES):
        assert figures.total("certified", kind=kind) > 0, kind
    assert figures.total("refused", kind="chain") > 0.1 * figures.total("certified", kind="chain")


def test_what_is_free_is_certified(figures):
    assert figures.total("certified", kind="chain") > 50
    assert figures.free_fraction >= 0.9


def test_no_pair_of_links_is_overlooked(figures):
    assert figures.missing_pairs == []


def test_the_checker_looks_at_links_that_never_move(gantry):
    """Pinocchio asks no pair whose shapes belong to one joint: the root of a fixed robot and an obstacle, say."""
    q, checker = gantry.home_q, Checker(gantry, Figures())
    for y, touches in ((0.1, True), (1.0, False)):
        checker.take(Scene([Box((0.1, 0.1, 0.02), at=(0.25, y, 0.05), name="brick")]), 0.005, 0.005)
        assert checker.overlaps(q, q) is touches
    assert checker.overlaps(q, q, at=lambda s: checker.move("brick", np.array([0.0, -0.9, 0.0])))


def test_the_samples_are_as_dense_as_they_claim(figures):
    assert 0.0 < figures.longest_step <= 1e-3
