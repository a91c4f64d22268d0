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


def test_the_way_of_who_went_behind_something_is_in_doubt_for_a_while():
    found = []
    for t, estimator in seen_until(HIDDEN_AT + PARAMS.coast_time + PARAMS.doubt_time + 1.0):
        doubts = in_doubt(estimator.scene())
        assert not (doubts and estimator.movers), "followed and lost"
        if doubts:
            found.append(t)
            around = walker(t) + 0.25 * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
            assert covers(doubts, around).all(), f"not where it is at {t:g} s"
    assert found[0] > PARAMS.coast_time
    assert found[-1] - found[0] == pytest.approx(PARAMS.doubt_time, abs=0.15)
    assert len(found) == pytest.approx(10.0 * PARAMS.doubt_time, abs=2)


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
    last, behind = None, np.array([[3.0, 0.4], [3.0, 0.8]])

    def pose_at(t):
        return 0.0, -2.5 * float(np.clip((t - HIDDEN_AT - PARAMS.coast_time) / 1.5, 0.0, 1.0)), 0.6

    for t, estimator in seen_until(HIDDEN_AT + PARAMS.coast_time + 2.5, there=lambda t: t < HIDDEN_AT, pose_at=pose_at):
        doubts = in_doubt(estimator.scene())
        if doubts and last is None:
            assert covers(doubts, behind).all(), f"at {t:g} s"
        last = doubts or last
    assert last
    assert not covers(last, behind[:1]).any()


def test_who_was_seen_to_leave_is_not_looked_for():
    """In sight all the time, and gone at once."""
    for _, estimator in seen_until(6.0, there=lambda t: t < 0.9):
        assert not in_doubt(estimator.scene())


def test_nothing_is_in_doubt_where_the_robot_stands():
    """It has come to where it thinks that somebody went, and its laser says nothing there."""
    away, found = walker(HIDDEN_AT + PARAMS.coast_time), False
    *_, (_, estimator) = seen_until(HIDDEN_AT + 0.3)
    for k in range(30):
        reading = scan((0.0, 0.0, 0.0), HIDDEN_AT + 0.4 + 0.1 * k)
        estimator.update(replace(reading, ranges=np.full_like(reading.ranges, NO_ANSWER)), (*away, 0.0))
        doubts = in_doubt(estimator.scene())
        found |= bool(doubts)
        assert not covers(doubts, away[None]).any()
    assert found


def test_it_is_the_same_obstacle_until_something_of_it_is_seen():
    before = None
    for _, estimator in seen_until(HIDDEN_AT + PARAMS.coast_time + 2.0):
        doubts = in_doubt(estimator.scene())
        if before:
            assert [id(o) for o in doubts] == [id(o) for o in before]
        before = doubts
    assert before
