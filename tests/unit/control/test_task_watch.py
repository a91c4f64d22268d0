"""A task that cannot be kept is suspended with its reason, and taken up again."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from cases import refused

from elastic_strips.control.tasks.hybrid import ConstraintMonitor, ConstraintState
from elastic_strips.errors import ParameterError
from elastic_strips.planning import straight_line
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, OrientationConstraint, Strip
from elastic_strips.strip.constraint import ConstraintForce


def report(error: float, *, certified: bool = True):
    broken = None if certified else "segment 3: hand is 5.0 mm deep in shelf"
    certificate = SimpleNamespace(broken=broken)
    return SimpleNamespace(constraint_errors=np.array([0.0, error, 0.0]), certified=certified, certificate=certificate)


@pytest.fixture
def watch(silvermate):
    return ConstraintMonitor(
        ConstraintForce(silvermate, OrientationConstraint(frame="hand_frame", tolerance=0.1)), patience=3, retry=5
    )


def feed(watch: ConstraintMonitor, reports) -> list[ConstraintState]:
    begin = len(getattr(watch, "seen", []))
    watch.seen = getattr(watch, "seen", []) + [watch.update(0.1 * (begin + k), r) for k, r in enumerate(reports)]
    return watch.seen[begin:]


def test_a_task_that_is_kept_stays_on(watch):
    assert feed(watch, [report(0.3), report(0.05), report(0.05)]) == [
        ConstraintState.TRYING,
        ConstraintState.KEPT,
        ConstraintState.KEPT,
    ]
    assert (
        feed(watch, [report(0.2), report(0.2), report(0.05)] * 3)[-1] is ConstraintState.KEPT
    )  # now and then is no reason
    assert watch.force.active
    assert len(watch.events) == 1


@pytest.mark.parametrize("bad", [report(0.2), report(0.0, certified=False)], ids=["missed", "broken"])
def test_a_task_that_is_not_kept_is_suspended_and_resumed(watch, bad):
    feed(watch, [report(0.0)])
    assert feed(watch, [bad] * 3) == [ConstraintState.KEPT, ConstraintState.KEPT, ConstraintState.SUSPENDED]
    assert not watch.force.active
    assert "0.200 rad off, 0.1 allowed" in watch.reason or "deep in shelf" in watch.reason
    assert feed(watch, [report(0.4)] * 5)[-2:] == [ConstraintState.SUSPENDED, ConstraintState.TRYING]
    assert watch.force.active
    assert feed(watch, [report(0.05)]) == [ConstraintState.KEPT]
    assert [e.state.value for e in watch.events] == ["kept", "suspended", "trying", "kept"]
    assert all(e.reason for e in watch.events)


def test_attempts_in_vain_become_rarer_and_a_broken_strip_is_not_tried_with(watch):
    missed = [report(0.4)]
    feed(watch, missed * 3)
    seen = feed(watch, missed * 200)
    tries = [k for k, (a, b) in enumerate(pairwise(seen)) if b is ConstraintState.TRYING is not a]
    gaps = np.diff(tries)
    assert gaps[0] < gaps[1] < gaps[2]
    assert gaps.max() <= 8 * 5 + 3
    while watch.state is not ConstraintState.SUSPENDED:
        feed(watch, missed)
    assert ConstraintState.TRYING not in feed(watch, [report(0.0, certified=False)] * 100)


def test_a_deformer_without_a_task_is_refused(watch):
    with refused(ParameterError, "task"):
        watch.update(0.0, SimpleNamespace(constraint_errors=None))


def test_a_hand_stays_level_while_the_strip_gives_way(silvermate):
    """The shelf comes in from the side: without the task the hand tilts, with it it does not."""
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    walls = [Box((6.0, 0.1, 0.3), at=(2.0, side * 0.42, 0.15), name=f"wall{side:+d}") for side in (-1, 1)]
    worst = {}
    for gain in (1e-6, 3.0):
        deformer = Deformer(
            silvermate, constraint=OrientationConstraint.from_configuration(silvermate, start, "hand_frame", gain=gain)
        )
        assert deformer.constraint is not None
        watch = ConstraintMonitor(deformer.constraint, patience=1000)
        strip = Strip.from_coordinates(silvermate, straight_line(silvermate, start, goal, spacing=0.13))
        for k in range(60):
            bar = Box((0.1, 0.3, 0.5), at=(2.0, 0.55 - 0.006 * k, 0.85), name="bar")
            result = deformer.step(strip, Scene([*walls, bar]))
            strip = result.strip
            watch.update(0.05 * k, result)
        assert result.certified
        assert result.constraint_errors is not None
        worst[gain] = float(result.constraint_errors.max())
    assert worst[1e-6] > 0.05  # the shelf does tilt a hand that may
    assert worst[3.0] < 0.5 * worst[1e-6]
    assert watch.state is ConstraintState.KEPT
