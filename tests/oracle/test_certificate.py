"""The certificate against dense sampling: nothing that is certified may collide, and what is free must be certified."""

from __future__ import annotations

import os

import pytest
from certificate_oracle import Figures, run_all

FULL = os.environ.get("ELASTIC_STRIPS_FULL") == "1"
COUNT = 20_000 if FULL else 90


@pytest.fixture(scope="module")
def figures() -> Figures:
    return run_all(COUNT, seed=1, processes=2 if FULL else 1)


@pytest.mark.timeout(3600 if FULL else 300)
def test_no_certified_segment_collides(figures):
    assert figures.collisions == []
    assert figures.segments == COUNT


def test_no_certified_segment_is_nearer_than_its_clearance(figures):
    assert figures.shortfalls == []


def test_the_sampler_saw_collisions_and_the_certificate_refused(figures):
    """Otherwise the two tests above would prove nothing."""
    assert figures.colliding > 0.1 * COUNT
    assert figures.refused >= figures.colliding
    assert figures.certified > 0.3 * COUNT


def test_free_segments_are_certified(figures):
    assert figures.free > 0.1 * COUNT
    assert figures.free_fraction >= 0.9


def test_no_segment_is_called_colliding_without_cause(figures):
    assert figures.false_alarms == []


@pytest.mark.timeout(3600 if FULL else 300)
def test_segments_of_deforming_strips_hold_what_they_are_certified_for():
    """Not single segments from a fresh start, but what ticks among moving obstacles hand out."""
    figures = run_all(4000 if FULL else 60, seed=2, processes=2 if FULL else 1, ticks=True)
    assert figures.collisions == []
    assert figures.shortfalls == []
    assert figures.colliding > 0
    assert figures.free_fraction >= 0.9
