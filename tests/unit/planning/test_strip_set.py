"""StripSet: alternatives side by side; which one to follow, and when it changes over."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.planning import StripSet, StripSetParams, StripSetReport
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer

pytestmark = pytest.mark.usefixtures("own_time")

WALLS = [
    Box((9.0, 0.1, 1.4), at=(3.0, 1.85, 0.7), name="wall-left"),
    Box((9.0, 0.1, 1.4), at=(3.0, -1.85, 0.7), name="wall-right"),
]
HALL = Scene([*WALLS, Box((0.7, 0.7, 1.4), at=(3.0, -0.15, 0.7), name="box")])


def check(report: StripSetReport, scene: Scene) -> None:
    """What a report claims of this tick's scene holds, asked of a fresh workspace."""
    if report.certified:
        best = report.best
        assert best is not None
        assert report.current in report.fresh
        assert Deformer(best.strip.robot).certify(best.strip, scene).certified
        assert best.strip.lateral_slip.max() <= 1e-6


def test_a_family_starts_with_the_best(silvermate) -> None:
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=2))
    report = family.plan(HALL, silvermate.home())
    assert len(report.alternatives) == 2
    assert report.current is not None
    assert report.alternatives[report.current].cost == min(a.cost for a in report.alternatives)
    assert report.planned
    assert "planned: 2 certified strips" in report.events[0]
    check(report, HALL)
    for _ in range(4):
        again = family.step(HALL)
        check(again, HALL)
        assert (again.events, again.current, again.planned) == ((), report.current, False)
        assert len(again.fresh) == 2


def test_others_are_deformed_in_turn(silvermate) -> None:
    """Three strips: each tick the current one and one of the others."""
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=3, plan_every=0))
    first = family.plan(HALL, silvermate.home())
    assert len(first.alternatives) == 3
    turns = [family.step(HALL).fresh for _ in range(4)]
    assert all(len(t) == 2 and t[0] == first.current for t in turns)
    assert turns[0] == turns[2] != turns[1] == turns[3]


def test_a_closed_side_is_left_at_once(silvermate, caplog) -> None:
    """A block appears in the gap that the current strip goes through: the tick that sees it changes over."""
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=2, plan_every=0))
    first = family.plan(HALL, silvermate.home())
    closed = HALL.with_obstacle(Box((1.0, 1.2, 1.4), at=(3.0, 0.8, 0.7), name="block"))
    with caplog.at_level(logging.INFO, logger="elastic_strips"):
        report = family.step(closed)
    check(report, closed)
    assert report.certified
    assert report.current != first.current
    text = "; ".join(report.events)
    assert "switched from left of box to right of it: segment " in text
    assert " deep in block" in text
    assert text in caplog.text or report.events[0] in caplog.text
    dropped = [e for _ in range(8) for e in family.step(closed).events]
    assert any(e.startswith("dropped a strip of") and "block" in e for e in dropped)


def test_a_better_side_is_taken_after_some_ticks(silvermate) -> None:
    """The box moves aside, so that the other side is much better: not at once, and not where it is little better."""
    params = StripSetParams(count=2, plan_every=0, patience=4, margin=0.05)
    wide = Scene([*WALLS, Box((0.7, 0.7, 1.4), at=(3.0, 0.0, 0.7), name="box")])
    for at, switches in ((0.55, True), (0.02, False)):
        family = StripSet(silvermate, silvermate.home(x=6.0), params=params)
        first = family.plan(wide, silvermate.home())
        side = 1.0 if np.abs(first.best.strip.q[:, 1]).max() == first.best.strip.q[:, 1].max() else -1.0
        when = []
        scene = wide
        for k in range(20):
            if k < 10:  # towards the current strip, so that it has to go a long way round
                scene = wide.moved("box", _pose(3.0, side * at * (k + 1) / 10))
            report = family.step(scene)
            check(report, scene)
            if any(e.startswith("switched") for e in report.events):
                when.append((k, report.events))
        assert bool(when) is switches, when
        if switches:
            assert len(when) == 1
            assert "it costs" in when[0][1][0]
            assert when[0][1][0].endswith(", 4 times in a row")
            assert when[0][0] >= params.patience - 1


def _pose(x: float, y: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, 0.7
    return pose


def test_the_robot_moves_on(silvermate) -> None:
    """The strips begin where the robot is; the one that it has left is dropped with the reason."""
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=2, plan_every=0))
    report = family.plan(HALL, silvermate.home())
    events: list[str] = []
    lengths = []
    for _ in range(26):
        strip = report.best.strip
        ahead = strip.sample(0.02)
        travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(ahead[:, :2], axis=0), axis=1))))
        q = ahead[int(np.searchsorted(travelled, 0.1))]
        report = family.step(HALL, q)
        check(report, HALL)
        assert report.certified
        for found in report.alternatives:
            np.testing.assert_allclose(found.strip.q[0], q, atol=1e-9)
        events += report.events
        lengths.append(report.best.length)
    assert len(report.alternatives) == 1
    assert any(e.startswith("dropped a strip of") and "the robot has passed where they part" in e for e in events)
    assert not any(e.startswith("switched") for e in events)
    assert lengths[0] - lengths[-1] > 2.2


def test_a_robot_beside_its_strip_is_taken_up(silvermate) -> None:
    """A start 6 cm and 0.1 rad off: the first tick after may not be certified, but it never claims what is not so."""
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=1, plan_every=0))
    family.plan(HALL, silvermate.home())
    q = silvermate.home(0.4, 0.06, 0.1)
    for _ in range(10):
        report = family.step(HALL, q)
        check(report, HALL)
    assert report.certified
    np.testing.assert_allclose(report.best.strip.q[0], q, atol=1e-9)


def test_nothing_left_is_said_once_and_planned_anew(silvermate) -> None:
    """Both sides are closed, then one opens again: it is replanned, with the reason."""
    family = StripSet(
        silvermate, silvermate.home(x=6.0), params=StripSetParams(count=1, plan_every=6, patience=2, timeout=1.0)
    )
    family.plan(HALL, silvermate.home())
    blocks = [Box((0.5, 14.0, 1.4), at=(3.0, 0.0, 0.7), name="block")]
    closed = Scene([*HALL, *blocks])
    events = []
    for _ in range(9):
        report = family.step(closed)
        assert not report.certified
        events += report.events
    assert sum(e.startswith("no alternative left: segment") for e in events) == 1
    assert sum(e.startswith("no strip: 0 certified") for e in events) == 1
    events = []
    opened = HALL.moved("box", _pose(3.0, 0.6))
    for _ in range(12):
        report = family.step(opened)
        check(report, opened)
        events += report.events
    assert report.certified, events


def test_a_start_in_collision_does_not_stop_the_family(silvermate) -> None:
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=2, plan_every=1, patience=1))
    family.plan(HALL, silvermate.home())
    blocked = HALL.with_obstacle(Box((0.2, 0.2, 1.0), at=(0.0, 0.0, 0.5), name="post"))
    report = family.step(blocked)
    assert not report.certified
    assert any(e.startswith("could not replan: start is in collision") and "'post'" in e for e in report.events)


def test_strips_that_come_to_the_same_side_are_one(silvermate) -> None:
    """The box vanishes: what passed it on its two sides is of one class, which the next call of the planner sees."""
    family = StripSet(
        silvermate, silvermate.home(x=6.0), params=StripSetParams(count=3, plan_every=3, timeout=60.0, patience=50)
    )
    first = family.plan(HALL, silvermate.home())
    assert len(first.alternatives) == 3
    family._members.pop()  # so that one is missing, and the planner is called
    reports = [family.step(Scene(WALLS)) for _ in range(3)]
    assert [r.planned for r in reports] == [False, False, True]
    events = [e for r in reports for e in r.events]
    assert sum("passes on the same sides as a better one" in e for e in events) == 1
    words = [a.homotopy_class for a in reports[-1].alternatives]
    assert len(set(words)) == len(words)


def test_wrong_input_is_named(silvermate) -> None:
    family = StripSet(silvermate, silvermate.home(x=6.0))
    with refused(ConfigurationError, "strips"):
        family.step(HALL)
    with refused(ConfigurationError, "start"):
        family.step(HALL, [0.0, 1.0])
    with refused(ConfigurationError, "goal"):
        StripSet(silvermate, [0.0])
    with refused(ParameterError, "seed=-1"):
        StripSet(silvermate, silvermate.home(), seed=-1)
    with refused(ConfigurationError, "goal"):
        StripSet(silvermate, silvermate.home(x=3.0)).plan(HALL, silvermate.home())


@each(
    "options, message",
    [
        ({"count": 0}, "count=0"),
        ({"patience": 1.5}, "patience=1.5"),
        ({"margin": 1.0}, r"margin=1\.0 must be a finite number ≥ 0 and < 1"),
        ({"divergence_distance": float("nan")}, "divergence_distance=nan"),
        ({"timeout": 0.0}, "timeout=0.0"),
        ({"plan_every": -1}, "plan_every=-1"),
    ],
)
def test_parameters_are_checked(options, message) -> None:
    with pytest.raises(ParameterError, match=message):
        StripSetParams(**options)


def test_without_deciding_the_current_strip_stays(silvermate) -> None:
    """Whoever follows it cannot leave it where it is: a broken one stays the current one, and says so."""
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=2, plan_every=0))
    first = family.plan(HALL, silvermate.home())
    closed = HALL.with_obstacle(Box((1.0, 1.2, 1.4), at=(3.0, 0.8, 0.7), name="block"))
    report = family.step(closed, decide=False)
    assert report.current == first.current
    assert not report.certified
    assert len(family) == 2


def test_a_strip_that_was_given_up_is_left(silvermate) -> None:
    """Nothing in the scene speaks against it; whoever follows it knows why."""
    family = StripSet(silvermate, silvermate.home(x=6.0), params=StripSetParams(count=2, plan_every=0))
    first = family.plan(HALL, silvermate.home())
    assert first.best is not None
    here = silvermate.home(x=0.4)
    report = family.leave(HALL, here, "somebody comes")
    check(report, HALL)
    assert report.events == ("switched from left of box to right of it: somebody comes",)
    assert report.best is not None
    np.testing.assert_allclose(report.best.strip.q[0], here, atol=1e-9)
    assert len(family) == 1
    nothing = family.leave(HALL, here, "somebody else")
    assert nothing.best is None
    assert nothing.events == ("no alternative left: somebody else",)
    assert len(family) == 0
