"""Switching: a strip that is given up is changed for another one that was kept at hand, before a planner is asked."""

from __future__ import annotations

from concurrent.futures import Future

import numpy as np
import pytest

from elastic_strips.control import DriveParams, RunState
from elastic_strips.control import replanning as replanning_room
from elastic_strips.control.replanning import SwitchingReplanner, standing
from elastic_strips.errors import ConfigurationError
from elastic_strips.planning import StripSetParams
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim import simulation
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.strip import Deformer

pytestmark = pytest.mark.usefixtures("own_time")

WALLS = [
    Box((9.0, 0.1, 1.4), at=(3.0, 1.85, 0.7), name="wall-left"),
    Box((9.0, 0.1, 1.4), at=(3.0, -1.85, 0.7), name="wall-right"),
]
HALL = Scene([*WALLS, Box((0.7, 0.7, 1.4), at=(3.0, -0.15, 0.7), name="box")])
BLOCK = Box((1.0, 1.2, 1.4), at=(3.2, 0.8, 0.7), name="block")
"""Closes the wider side, the left one."""


def side(strip) -> str:
    return "left" if np.interp(3.0, strip.q[:, 0], strip.q[:, 1]) > -0.15 else "right"


def plan_anew(replanner, scene, start, goal):
    found = replanner.another(scene, start, goal)()
    replanner.take(found)
    return found.strip, found.reason


@pytest.fixture
def replanner(silvermate):
    return SwitchingReplanner(silvermate, DriveParams(), seed=0, grid=True, family=StripSetParams(count=2))


def test_another_side_is_taken_without_a_planner(replanner, silvermate, monkeypatch):
    start, goal = silvermate.home(), silvermate.home(x=6.0)
    first = replanner.first(HALL, start, goal)()
    assert first.certified
    assert side(first.strip) == "left"
    monkeypatch.setattr(replanning_room, "plan_report", lambda *_, **__: pytest.fail("a planner was asked"))
    closed = HALL.with_obstacle(BLOCK)
    here = silvermate.home(x=0.3)
    strip, reason = plan_anew(replanner, closed, here, goal)
    assert strip is not None
    assert side(strip) == "right"
    assert reason.startswith("switched from left of box to right of it")
    assert Deformer(silvermate).certify(strip, closed).certified
    np.testing.assert_allclose(strip.q[0], here, atol=1e-9)
    assert replanner.count == 1


def test_a_change_that_was_not_driven_is_offered_again(replanner, silvermate, monkeypatch):
    start, goal = silvermate.home(), silvermate.home(x=6.0)
    replanner.first(HALL, start, goal)()
    monkeypatch.setattr(replanning_room, "plan_report", lambda *_, **__: pytest.fail("a planner was asked"))
    closed = HALL.with_obstacle(BLOCK)
    replanner.discard(replanner.another(closed, silvermate.home(x=0.3), goal)())
    assert replanner.count == 0
    here = silvermate.home(x=0.4, y=0.1)
    strip, reason = plan_anew(replanner, closed, here, goal)
    assert strip is not None
    assert side(strip) == "right"
    assert reason.startswith("switched from left of box to right of it")
    np.testing.assert_allclose(strip.q[0], here, atol=1e-9)


def test_others_are_planned_beside_the_drive_and_not_before_it(replanner, silvermate):
    start, goal = silvermate.home(), silvermate.home(x=6.0)
    report = replanner.first(HALL, start, goal)()
    right = Box((0.3, 1.3, 1.4), at=(3.0, -1.15, 0.7), name="right-block")
    strip, _ = plan_anew(replanner, HALL.with_obstacle(BLOCK).with_obstacle(right), start, goal)
    assert strip is not None
    assert len(replanner.planner.family) == 0
    asked = []

    def submit(fn):
        asked.append(fn)
        done = Future()
        done.set_result(fn())
        return done

    replanner.work_beside(HALL, report.strip, submit)
    assert len(asked) == 1
    assert len(replanner.planner.family) == 2


def test_where_none_is_left_a_planner_is_asked(replanner, silvermate):
    start, goal = silvermate.home(), silvermate.home(x=6.0)
    replanner.first(HALL, start, goal)()
    right = Box((0.3, 1.3, 1.4), at=(3.0, -1.15, 0.7), name="right-block")
    shut = HALL.with_obstacle(BLOCK).with_obstacle(right)
    strip, reason = plan_anew(replanner, shut, start, goal)
    assert strip is not None
    assert np.abs(strip.q[:, 1]).max() > 1.9, "the hall's walls end: there is a way around them"
    assert not reason.startswith("switched")
    assert Deformer(silvermate).certify(strip, shut).certified


def test_what_is_fast_closes_nothing():
    scene = Scene(
        [
            Cylinder(0.2, 1.6, at=(3.0, 0.0, 0.8), name="runner", motion=Twist(np.array([0.9, 0.0, 0.0]))),
            Cylinder(0.2, 1.6, at=(4.0, 2.0, 0.8), name="cabinet", motion=Twist(np.array([0.1, 0.0, 0.0]))),
            Box((0.3, 0.3, 1.0), at=(2.0, 0.0, 0.5), name="crate"),
        ]
    )
    assert standing(scene, below=0.3).names == ("cabinet", "crate")
    assert all(obstacle.motion is None for obstacle in standing(scene, below=0.3))


def test_a_drive_changes_sides(silvermate):
    """The side that the robot drives to is closed before it is there: it stops, and follows the other strip."""
    params = DriveParams(replan_after=0.2)
    world = World(HALL.with_obstacle(BLOCK), appears={"block": 2.0})
    replanner = SwitchingReplanner(silvermate, params, seed=0, grid=True, family=StripSetParams(count=2))
    runner = simulation(
        silvermate, world, silvermate.home(), silvermate.home(x=6.0), params=params, replanner=replanner, seed=1
    )
    result = runner.run(time_limit=60.0)
    assert result.state is RunState.REACHED, result.reason
    assert evaluate(result.record, silvermate, world, runner.limits).collisions == ()
    reasons = [event.reason for event in result.events if event.kind == "replanned"]
    assert any(reason.startswith("switched from left of box to right of it") for reason in reasons), reasons


def test_a_family_that_fails_costs_no_proposal(replanner, silvermate, monkeypatch, caplog):
    runner = simulation(silvermate, World(HALL), silvermate.home(), silvermate.home(x=6.0), replanner=replanner)

    def fails(*_, **__):
        raise ConfigurationError("nobody can be there")

    monkeypatch.setattr(replanner.planner.family, "step", fails)

    result = runner.run(time_limit=2.0)
    assert "nobody can be there" in caplog.text
    assert not [e for e in result.events if e.kind == "fault"]
    assert result.record.control.coordinates[-1, 0] > 0.5
