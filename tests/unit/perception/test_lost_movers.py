"""Movers that nothing has seen for long: where they may be is in doubt for a while, until it is looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ray_caster import box_segments, scan

from elastic_strips.perception import NO_ANSWER, SceneEstimator, SceneEstimatorParams
from elastic_strips.scene import Scene

PARAMS = SceneEstimatorParams()
ROOM = box_segments(4, 0, 12, 8)
SCREEN = [(2.0, -0.4, 2.0, 3.5)]
SPEED = 0.5
HIDDEN_AT = 1.8  # [s] from when on the screen hides it wholly


def walker(t):
    """Behind the screen, from right to left."""
    return np.array([3.0, -1.3 + SPEED * t])


def seen_until(seconds, *, there=lambda t: True, pose_at=lambda t: (0.0, 0.0, 0.0)):
    """An estimator that has scanned at 10 Hz; yields (time, estimator)."""
    estimator, rng = SceneEstimator(PARAMS), np.random.default_rng(0)
    for k in range(round(10 * seconds) + 1):
        t, circles = 0.1 * k, []
        if there(t):
            circles = [(*walker(t), 0.25)]
        pose = pose_at(t)
        estimator.update(scan(pose, t, segments=ROOM + SCREEN, circles=circles, noise=0.01, rng=rng), pose)
        yield t, estimator


def in_doubt(scene):
    return [o for o in scene if o.name.startswith("unseen-track-")]


def covers(obstacles, points):
    """Which of the points (n, 2) lie under obstacles, from above."""
    inside = np.zeros(len(points), dtype=bool)
    for obstacle in obstacles:
        table = Scene([obstacle]).table
        for center, half in zip(table.center, table.half_extents, strict=True):
            inside |= (np.abs(points - center[:2]) <= half[:2] + 1e-9).all(axis=1)
    return inside


def test_where_who_went_behind_something_may_be_is_in_doubt_for_a_while():
    """Whether it went on, stopped at once, or went more slowly; as long as nothing sees it."""
    found, seen = [], 0.0
    for t, estimator in seen_until(HIDDEN_AT + PARAMS.coast_time + PARAMS.doubt_time + 1.0):
        doubts = in_doubt(estimator.scene())
        seen = max([seen, *(mover.seen for mover in estimator.movers)])
        if doubts:
            found.append(t)
            for part in (0.2, 0.6, 1.0):  # of its speed
                around = walker(seen) + np.array([0.0, part * SPEED * (t - seen)])
                around = around + 0.25 * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
                assert covers(doubts, around[around[:, 1] > -0.3]).all(), f"at {part:g} of its speed at {t:g} s"
    assert found[0] < seen + 0.5
    assert found[-1] == pytest.approx(seen + PARAMS.coast_time + PARAMS.doubt_time, abs=0.15)
    assert len(found) == pytest.approx(10.0 * (found[-1] - found[0]) + 1.0, abs=1)


def test_it_may_have_stopped_where_nothing_sees_it():
    """It should have come out at the other side by now: its track ends, and its way stays in doubt, where it is."""
    narrow, stops, params = [(2.0, -0.4, 2.0, 0.15)], HIDDEN_AT + 0.4, replace(PARAMS, coast_time=4.0)
    estimator, rng, ended = SceneEstimator(params), np.random.default_rng(0), 0
    for k in range(round(10 * (HIDDEN_AT + params.coast_time))):
        t = 0.1 * k
        there = walker(min(t, stops))
        reading = scan((0.0, 0.0, 0.0), t, segments=ROOM + narrow, circles=[(*there, 0.25)], noise=0.01, rng=rng)
        estimator.update(reading, (0.0, 0.0, 0.0))
        doubts = in_doubt(estimator.scene())
        if t > stops and not estimator.movers:
            ended += 1
            assert covers(doubts, there[None]).all(), f"not where it stands at {t:g} s"
            assert not covers(doubts, np.array([[3.0, 1.4]])).any(), "nobody came out"
    assert ended > 3, "its track did not end before it was lost for good"


def test_who_is_hidden_may_have_strayed():
    """Faster and faster to one side, as fast as is assumed of movers; and no wider than it has to be."""
    seen, radius = -1.0, 0.0
    for t, estimator in seen_until(HIDDEN_AT + PARAMS.coast_time):
        if not estimator.movers:
            continue
        (mover,) = estimator.movers
        if mover.seen == t:
            seen, radius = t, mover.radius
            assert radius == pytest.approx(0.25 + PARAMS.padding, abs=0.1)
        far = 0.5 * PARAMS.mover_acceleration * (t - seen) ** 2
        assert mover.radius >= radius + min(far, PARAMS.stray_width) - 0.06
        assert mover.radius <= radius + min(far, PARAMS.stray_width) + 0.06
    assert far > PARAMS.stray_width, "it was hidden for long enough to tell"


def test_what_is_seen_through_is_not_in_doubt():
    """The robot drives to where it sees past the screen: there is nobody any more."""
    behind = np.array([[3.0, 0.1], [3.0, 0.8]])

    def pose_at(t):
        return 0.0, -2.5 * float(np.clip((t - HIDDEN_AT - PARAMS.coast_time) / 1.5, 0.0, 1.0)), 0.6

    for t, estimator in seen_until(HIDDEN_AT + PARAMS.coast_time + 2.5, there=lambda t: t < HIDDEN_AT, pose_at=pose_at):
        doubts = in_doubt(estimator.scene())
        if t == pytest.approx(HIDDEN_AT + PARAMS.coast_time):
            assert covers(doubts, behind).all()
    assert t < HIDDEN_AT + PARAMS.coast_time + PARAMS.doubt_time - 0.3, "it would be over anyway"
    assert not covers(doubts, behind[:1]).any()


def test_who_was_seen_to_leave_is_not_looked_for():
    """In sight all the time, and gone at once."""
    for _, estimator in seen_until(6.0, there=lambda t: t < 0.9):
        assert not in_doubt(estimator.scene())


def test_who_went_to_where_the_robot_stands_may_still_come_there():
    """It stands in the way of somebody, and its laser says nothing. As long as they are followed they are not where it
    is; once they are not, they may come there at any time, also if they could have come earlier."""
    away = walker(HIDDEN_AT + PARAMS.coast_time)
    *_, (_, estimator) = seen_until(HIDDEN_AT + 0.3)
    blocked = {}
    for k in range(70):
        reading = scan((0.0, 0.0, 0.0), HIDDEN_AT + 0.4 + 0.1 * k)
        estimator.update(replace(reading, ranges=np.full_like(reading.ranges, NO_ANSWER)), (*away, 0.0))
        doubts, followed = in_doubt(estimator.scene()), bool(estimator.movers)
        if doubts:
            blocked.setdefault(followed, set()).add(bool(covers(doubts, away[None]).any()))
    assert blocked == {True: {False}, False: {True}}
    assert not doubts, "in the end it is over"


def test_it_is_the_same_obstacle_until_it_may_be_elsewhere():
    before, same = {}, 0
    for _, estimator in seen_until(HIDDEN_AT + PARAMS.coast_time + 2.0):
        now = {o.name: (o, tuple(map(tuple, Scene([o]).table.center))) for o in in_doubt(estimator.scene())}
        for name in before.keys() & now.keys():
            if before[name][1] == now[name][1]:
                assert now[name][0] is before[name][0]
                same += 1
        before = now
    assert same > 10
