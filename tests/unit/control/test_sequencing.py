"""The behaviour tree: steps in their order, waiting, asking for paths, giving up; and what it shows."""

from __future__ import annotations

import sys

import pytest
from cases import refused

from elastic_strips.control.tasks import Blackboard, Order, SequencingLayer
from elastic_strips.errors import MissingExtraError, ParameterError


@pytest.fixture
def layer():
    return SequencingLayer(["drive", "reach"], max_scene_age=0.2, max_attempts=3)


def test_steps_are_done_in_their_order(layer):
    assert layer.tick(Blackboard()) is Order.FOLLOW
    assert layer.tick(Blackboard(reached=1)) is Order.FOLLOW
    assert layer.tick(Blackboard(reached=2)) is Order.DONE


@pytest.mark.parametrize(
    "facts, order, reason",
    [
        (Blackboard(scene_age=0.5), Order.WAIT, "0.50 s old"),
        (Blackboard(localized=False), Order.WAIT, "odometry"),
        (Blackboard(trouble="box in the way"), Order.REQUEST_PATH, "box in the way"),
        (Blackboard(trouble="box in the way", planning=True), Order.WAIT, "planning"),
        (Blackboard(trouble="box in the way", attempts=3), Order.GIVE_UP, "box in the way"),
        (Blackboard(scene_age=0.5, trouble="box in the way"), Order.WAIT, "old"),
    ],
    ids=str,
)
def test_trouble_is_answered(layer, facts, order, reason):
    layer.tick(Blackboard())
    assert layer.tick(facts) is order
    assert reason in layer.reason


def test_trouble_that_is_over_is_forgotten(layer):
    layer.tick(Blackboard(trouble="box in the way"))
    assert layer.tick(Blackboard()) is Order.FOLLOW
    assert "box" not in layer.drawing()


def test_the_drawing_shows_what_runs(layer):
    layer.tick(Blackboard(scene_age=0.31, reached=1))
    text = layer.drawing(unicode=False)
    assert text.isascii()
    lines = {line.strip().split(" -- ")[0]: line for line in text.splitlines()}
    assert any("1. drive [o]" in key for key in lines)
    assert any("2. reach [*]" in key for key in lines)
    assert "0.31 s old" in text
    assert "digraph" in layer.dot()


@pytest.mark.parametrize("options", [{"steps": []}, {"steps": ["drive"], "max_attempts": 0}], ids=str)
def test_wrong_layers_are_refused(options):
    with pytest.raises(ParameterError):
        SequencingLayer(**options)


def test_the_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "py_trees", None)
    for name in [m for m in sys.modules if m.startswith("py_trees.")]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "elastic_strips.control.tasks.tree", raising=False)
    with refused(MissingExtraError, "[control]"):
        SequencingLayer(["drive"])
