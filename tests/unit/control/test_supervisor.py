"""Supervisor: nothing but a certified, continuous, timely motion that ends at rest takes the held one's place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_strips.collision import BrokenSegment, Certificate
from elastic_strips.control import RunState, Supervisor
from elastic_strips.planning import straight_line
from elastic_strips.trajectory import MotionLimits, Retimer, Trajectory
from elastic_strips.trajectory.trajectory import stationary


def good(motion) -> Certificate:
    steps = len(motion)
    return Certificate(0.02, np.ones(steps, dtype=bool), np.zeros(steps, dtype=np.int8), None, 0)


def bad(motion) -> Certificate:
    segments = np.arange(len(motion)) != 1
    broken = BrokenSegment(1, "palm", "post", -0.01, "obstacle", True)
    return Certificate(0.02, segments, 2 * (~segments).astype(np.int8), broken, 0)


@pytest.fixture(scope="module")
def limits(silvermate):
    return MotionLimits.for_robot(silvermate)


@pytest.fixture(scope="module")
def motion(silvermate, limits):
    coordinates = straight_line(silvermate, silvermate.home(), silvermate.home(x=1.0), spacing=0.1)
    return Retimer(silvermate, limits, dt=0.02).horizon(coordinates, start_time=0.1)


@pytest.fixture
def supervisor(silvermate, limits):
    return Supervisor(stationary(silvermate, limits, silvermate.space.to_coordinates(silvermate.home()), 0.0, 0.01))


def test_a_certified_motion_is_taken_and_driven_to_its_end(supervisor, motion):
    assert supervisor.submit(motion, good(motion), 0.05)
    assert supervisor.update(0.05) is RunState.MOVING
    assert supervisor.reference(0.3).v[0] > 0.1
    end = motion.end_time
    assert supervisor.update(end - 0.01) is RunState.MOVING
    assert supervisor.update(end) is RunState.STOPPED
    assert not supervisor.reference(end).v.any()
    assert [time for time, _ in supervisor.stops] == [end]


def test_the_motion_before_is_followed_until_the_new_one_begins(supervisor, motion, silvermate, limits):
    """Each new motion is taken some time before it begins, the next one perhaps before that: no step in between."""
    assert supervisor.submit(motion, good(motion), 0.05)
    retimer = Retimer(silvermate, limits, dt=0.02)
    coordinates = straight_line(silvermate, silvermate.home(), silvermate.home(x=1.0), spacing=0.1)
    places = [supervisor.reference(0.3).coordinates[0]]
    for k in range(30, 60):
        now, begin = 0.01 * k, 0.01 * k + 0.03
        state = supervisor.active.at(begin)
        ahead = np.vstack([state.coordinates, coordinates[coordinates[:, 0] > state.coordinates[0] + 0.02]])
        onward = retimer.horizon(ahead, state.v, a_start=state.a, start_time=begin)
        assert supervisor.submit(onward, good(onward), now)
        places += [supervisor.reference(t).coordinates[0] for t in (now, now + 0.005)]
        assert supervisor.reference(begin).coordinates[0] == pytest.approx(state.coordinates[0], abs=1e-9)
    steps = np.diff(places)
    assert steps[1:].min() > 0.5 * np.median(steps)
    assert steps.max() < 1.5 * np.median(steps)


def test_a_motion_to_the_goal_ends_in_reached(supervisor, motion):
    assert supervisor.submit(motion, good(motion), 0.0, at_goal=True)
    assert supervisor.update(motion.end_time) is RunState.REACHED
    assert not supervisor.stops


def test_what_is_refused_and_why(supervisor, motion, silvermate):
    def refused(offered, certificate=None, now=0.05) -> str:
        active = supervisor.active
        assert not supervisor.submit(offered, certificate or good(offered), now)
        assert supervisor.active is active
        return supervisor.events[-1].reason

    assert "post" in refused(motion, bad(motion))
    assert "the certificate is of 3 steps" in refused(motion, replace(good(motion), segments=np.ones(3, dtype=bool)))
    assert "m/s or rad/s faster than the motors" in refused(replace(motion, v=2.0 * motion.v))
    assert "late tick: the new motion was to begin 0.150 s ago" in refused(motion, now=0.25)
    cut = motion.time < motion.end_time - 0.3
    endless = replace(
        motion, time=motion.time[cut], coordinates=motion.coordinates[cut], v=motion.v[cut], a=motion.a[cut]
    )
    assert "does not end at rest" in refused(endless)
    aside = motion.coordinates.copy()
    aside[:, 1] += 0.01
    assert "begins 0.0100 m or rad beside" in refused(replace(motion, coordinates=aside))
    assert "jump in speed" in refused(Trajectory(
        silvermate, motion.limits, motion.time[:-20], np.vstack([motion.coordinates[:1], motion.coordinates[21:]]),
        motion.v[20:], motion.a[20:],
    ))  # fmt: skip


def test_without_a_new_motion_the_held_one_brakes_to_rest(supervisor, motion):
    supervisor.submit(motion, good(motion), 0.05)
    supervisor.update(0.1)
    supervisor.reject("scene too old", 0.3)
    assert supervisor.update(0.3) is RunState.BRAKING
    assert supervisor.update(motion.end_time + 0.1) is RunState.STOPPED
    assert supervisor.stops[0][1] == "scene too old"
    assert supervisor.reason == "scene too old"


def test_a_new_motion_ends_the_slowing(supervisor, motion):
    supervisor.submit(motion, good(motion), 0.05)
    supervisor.reject("scene too old", 0.3)
    assert supervisor.update(0.3) is RunState.BRAKING
    assert supervisor.submit(motion.tail(0.5), good(motion.tail(0.5)), 0.4)
    assert supervisor.update(0.4) is RunState.MOVING


def test_the_held_motion_braked_takes_its_place_without_a_certificate(supervisor, motion, silvermate, limits):
    supervisor.submit(motion, good(motion), 0.05, at_goal=True)
    supervisor.update(0.8)
    stop = Retimer(silvermate, limits, dt=0.02).brake(motion, 0.82)
    assert supervisor.brake(stop, "somebody came", 0.8)
    assert supervisor.update(0.8) is RunState.BRAKING
    assert stop.end_time < motion.end_time - 0.2
    assert supervisor.update(stop.end_time) is RunState.STOPPED  # not at the goal that the held motion led to
    assert supervisor.stops == [(stop.end_time, "somebody came")]
    assert supervisor.reference(stop.end_time).coordinates[0] < motion.coordinates[-1, 0] - 0.05


def test_what_does_not_stop_sooner_or_is_beside_the_held_motion_is_no_brake(supervisor, motion, silvermate, limits):
    supervisor.submit(motion, good(motion), 0.05)
    stop = Retimer(silvermate, limits, dt=0.02).brake(motion, 0.82)
    aside = stop.coordinates.copy()
    aside[:, 1] += 0.01
    for refused in (
        motion.tail(0.82),
        replace(stop, coordinates=aside),
        replace(stop, time=stop.time - stop.start_time - 0.1),
    ):
        assert not supervisor.brake(refused, "somebody came", 0.8)
        assert supervisor.active is motion
    assert supervisor.update(0.81) is RunState.BRAKING


def test_repeated_events_are_written_once(supervisor):
    for t in (0.0, 0.1, 0.2):
        supervisor.log(t, "fault", "stale scene")
    supervisor.log(0.3, "fault", "another")
    supervisor.log(0.4, "fault", "stale scene")  # two that alternate are not written down over and over
    assert [e.time for e in supervisor.events] == [0.0, 0.3]
    supervisor.log(3.0, "fault", "stale scene")
    assert [e.time for e in supervisor.events] == [0.0, 0.3, 3.0]


def test_a_long_run_keeps_the_newest_events_only(silvermate, limits):
    start = silvermate.space.to_coordinates(silvermate.home())
    supervisor = Supervisor(stationary(silvermate, limits, start, 0.0, 0.01), keep=10)
    for k in range(95):
        supervisor.log(0.1 * k, "refused", f"motion {k}")
    assert 10 <= len(supervisor.events) <= 20
    assert [event.reason for event in supervisor.events][-10:] == [f"motion {k}" for k in range(85, 95)]
