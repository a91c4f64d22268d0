"""A short attack on certificates in sensed scenes; the long one is a command (see ``attack_sensed.py``)."""

from __future__ import annotations

import pytest
from attack_sensed import Figures, run

from elastic_strips.perception import VolumeMap


@pytest.fixture(scope="module")
def figures() -> Figures:
    """Both robots, with what was not seen blocked and free."""
    total = Figures()
    for seed in (2, 5):
        total.add(run(seed, segments=60))
    return total


def test_what_is_certified_in_a_sensed_scene_is_free_of_the_true_world(figures):
    assert figures.false == []
    assert {(robot, unseen) for robot, _, unseen, _ in figures.counts} == {("silvermate", "blocked"), ("tiago", "free")}
    assert figures.total("walked") > 30
    assert figures.total("refused") > 30
    assert figures.total("near") > 0


def test_a_map_that_leaves_obstacles_out_is_found_out(monkeypatch):
    monkeypatch.setattr(VolumeMap, "obstacles", lambda volume: [])
    assert run(6, segments=500).false
