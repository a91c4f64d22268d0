"""Alternatives: certified strips of different classes, the cheapest first; where there are fewer, the reason."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.planning import plan_report
from elastic_strips.planning.homotopy.alternatives import AlternativesSearch, base_path, strip_cost
from elastic_strips.planning.homotopy.classes import homotopy_class, separating_obstacles
from elastic_strips.planning.problem import PlanningProblem
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, DeformParams

HALL = Scene(
    [
        Box((9.0, 0.1, 1.4), at=(3.0, 1.85, 0.7), name="wall-left"),
        Box((9.0, 0.1, 1.4), at=(3.0, -1.85, 0.7), name="wall-right"),
        Box((0.7, 0.7, 1.4), at=(3.0, -0.15, 0.7), name="box"),
    ]
)


@pytest.mark.parametrize("name", ["silvermate", "jackal_box"])
def test_a_box_is_passed_on_both_sides(name, request) -> None:
    robot = request.getfixturevalue(name)
    start, goal = robot.home(), robot.home(x=6.0)
    report = plan_report(robot, HALL, start, goal, count=2)
    assert len(report.alternatives) == 2, report.reason
    one, two = report.alternatives
    assert report.strip is one.strip
    assert report.method == one.method
    assert one.homotopy_class != two.homotopy_class
    assert one.cost <= two.cost
    assert separating_obstacles(base_path(one.strip), base_path(two.strip), report.clusters) == {"box": "left"}
    for found in report.alternatives:
        assert found.report.usable
        assert Deformer(robot).certify(found.strip, HALL).certified
        np.testing.assert_allclose(found.strip.q[[0, -1]], [start, goal], atol=1e-12)
        assert found.strip.lateral_slip.max() <= 1e-6
        assert found.homotopy_class == homotopy_class(base_path(found.strip), report.clusters)
        assert found.length == found.strip.length
        assert found.cost == strip_cost(found.report, DeformParams())
        assert found.length <= found.cost <= found.length + 1.0
        assert found.method in ("line", "grid", "ompl")
    assert report.reason == "2 certified strips of different classes"
    assert set(report.timings) == {"line", "planner", "relaxation"}
    assert sum(report.timings.values()) <= report.seconds


def test_clearance_costs(silvermate) -> None:
    """A strip with little clearance costs more than a slightly longer one with much."""
    report = plan_report(silvermate, HALL, silvermate.home(), silvermate.home(x=6.0), count=2)
    found = report.alternatives[0]
    nodes = found.report.node_clearance
    wide, narrow = (strip_cost(found.report, DeformParams(influence=d)) for d in (nodes, 0.9))
    assert wide == pytest.approx(found.length)
    assert narrow == pytest.approx(found.length + 1.0 - nodes / 0.9)
    assert found.clearance == found.report.clearance <= nodes + 1e-6


def test_what_is_there_already_is_not_found_again(silvermate) -> None:
    def search(count: int, **options) -> AlternativesSearch:
        problem = PlanningProblem(silvermate, HALL, silvermate.home(), silvermate.home(x=6.0), timeout=60.0)
        search = AlternativesSearch(problem, count, **options)
        search.run()
        return search

    first = search(1).alternatives
    more = search(1, without=[first[0].homotopy_class])
    assert len(more.alternatives) == 1
    assert more.alternatives[0].homotopy_class != first[0].homotopy_class
    assert more.attempts == 1  # what is of a known class is not even relaxed
    both = {a.homotopy_class for a in (*first, *more.alternatives)}
    none = search(9, without=both, ompl_attempts=2)
    assert not both & {a.homotopy_class for a in none.alternatives}
    assert "relaxed into a class" in none.reason


def test_where_nothing_stands_one_is_all_there_is(silvermate) -> None:
    report = plan_report(silvermate, Scene([]), silvermate.home(), silvermate.home(x=3.0), count=3)
    assert [a.method for a in report.alternatives] == ["line"]
    assert report.reason.startswith("1 certified strip of different classes, not 3: nothing stands in the way")


def test_a_fixed_base_has_one_class(gantry) -> None:
    report = plan_report(gantry, Scene([]), gantry.home(bend=-1.0), gantry.home(bend=1.5, slide=0.2), count=3)
    assert [a.homotopy_class for a in report.alternatives] == [()]
    assert "the base is fixed: there is one class only" in report.reason


def test_a_side_that_is_too_narrow_is_named(silvermate) -> None:
    """The right gap is 0.55 m wide: the grid lets the base's disc through, the robot with its arm does not fit."""
    scene = HALL.without("wall-right").with_obstacle(Box((9.0, 3.0, 1.4), at=(3.0, -2.57, 0.7), name="wall-right"))
    scene = scene.without("wall-left").with_obstacle(Box((9.0, 6.0, 1.4), at=(3.0, 4.8, 0.7), name="wall-left"))
    report = plan_report(silvermate, scene, silvermate.home(), silvermate.home(x=6.0), count=4, timeout=4.0)
    assert 1 <= len(report.alternatives) < 4
    assert "not 4: the grid knows" in report.reason or "time" in report.reason
    words = [a.homotopy_class for a in report.alternatives]
    assert len(set(words)) == len(words)


def test_no_strip_at_all_is_said(silvermate, caplog) -> None:
    walls = [Box((0.2, 14.0, 1.4), at=(2.0, 0.0, 0.7), name="across")]
    with caplog.at_level("WARNING", logger="elastic_strips"):
        report = plan_report(silvermate, Scene(walls), silvermate.home(), silvermate.home(x=4.0), count=3, timeout=1.0)
    assert report.alternatives == ()
    assert not report.certified
    assert report.method == "none"
    assert len(report.strip) == len(report.report.strip)
    assert report.reason.startswith("0 certified strips")
    assert "across" in report.reason
    assert any("0 certified strips" in r.message for r in caplog.records)


@each(
    "options, message",
    [
        ({"count": 0}, "count=0 must be a whole number ≥ 1"),
        ({"count": True}, "count=True"),
        ({"seed": -1}, "seed=-1"),
        ({"timeout": 0.0}, "timeout=0.0"),
    ],
)
def test_wrong_options_are_named(silvermate, options, message) -> None:
    with pytest.raises(ParameterError, match=message):
        plan_report(silvermate, Scene([]), silvermate.home(), silvermate.home(x=1.0), **options)


def test_ends_in_collision_are_named(silvermate) -> None:
    with refused(ConfigurationError, "goal", "'box'"):
        plan_report(silvermate, HALL, silvermate.home(), silvermate.home(x=3.0))


def test_all_options_hold_for_several(silvermate) -> None:
    """A path that is given is relaxed first; neither line nor grid where they are not wanted."""
    ticks = []
    report = plan_report(
        silvermate, HALL, silvermate.home(), silvermate.home(x=6.0), count=2, line=False, grid=False, timeout=2.0,
        path=[[0.0, 0.0], [3.0, 1.0], [6.0, 0.0]], watch=ticks.append,
    )  # fmt: skip
    assert report.alternatives
    assert {a.method for a in report.alternatives} <= {"path", "ompl"}
    assert len(ticks) > 1
