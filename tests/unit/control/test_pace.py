"""Pace: how soon a motion can begin follows from how long planning takes; a tick knows what it has time for."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each

from elastic_strips.control import Controller, DriveParams, RunState
from elastic_strips.control.pace import Pace
from elastic_strips.scene import Box, Cylinder, Scene, World
from elastic_strips.sim import KinematicPlant, evaluate, simulation
from elastic_strips.sim.computing import Computing

PARAMS = DriveParams()


class Watch:
    """A clock that the test sets."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def after(*seconds: float, transfer: int = 0) -> Pace:
    watch = Watch()
    pace = Pace(PARAMS, watch, transfer)
    for second in seconds:
        pace.begin()
        watch.now += second
        assert pace.finish(full=True) == pytest.approx(second)
    return pace


def test_without_a_meter_it_is_as_the_parameters_say():
    pace = Pace(PARAMS, None)
    pace.begin()
    assert pace.has(1e9)
    assert pace.finish(full=True) == 0.0
    assert (pace.periods, pace.every, pace.slow) == (PARAMS.latency, PARAMS.plan_every, False)


def test_fast_planning_is_expected_to_take_what_the_parameters_say():
    pace = after(*[0.004] * 10)
    assert (pace.periods, pace.slow) == (PARAMS.latency, False)
    assert after(*[0.004] * 10, transfer=1).periods == PARAMS.latency + 1


@each("seconds", [0.031, 0.12, 0.8])
def test_motions_begin_when_most_ticks_are_done(seconds):
    pace = after(*[seconds] * 10)
    assert pace.slow
    assert seconds <= pace.latency <= 1.3 * seconds + PARAMS.control_dt
    assert pace.every >= pace.periods >= PARAMS.latency


def test_one_long_tick_is_soon_forgotten():
    assert after(2.0, *[0.005] * 30).periods == PARAMS.latency


def test_what_planned_nothing_tells_nothing():
    watch = Watch()
    pace = Pace(PARAMS, watch)
    pace.begin()
    watch.now += 3.0
    pace.finish(full=False)
    assert pace.periods == PARAMS.latency


def test_a_tick_has_until_its_motion_begins():
    pace = after(*[0.1] * 5)
    assert isinstance(pace.meter, Watch)
    pace.begin(spent=0.04)
    left = pace.latency - 0.04
    assert pace.has(0.99 * left)
    assert not pace.has(1.01 * left)
    pace.meter.now += 0.5 * left
    assert not pace.has(0.6 * left)
    assert pace.has(0.4 * left)
    assert not pace.has(0.0, waits=True)  # more than half of the latency is over: what can wait, waits


def test_what_can_wait_has_less_than_half_of_the_time():
    pace = after(*[0.1] * 5)
    pace.begin()
    assert pace.has(0.39 * pace.latency, waits=True)
    assert not pace.has(0.41 * pace.latency, waits=True)


CRATE = Box((0.4, 0.4, 1.0), at=(1.6, 0.35, 0.5), name="crate")


def drive(robot, compute, goal=4.0, time_limit=60.0):
    driven = simulation(robot, Scene([CRATE]), robot.home(), robot.home(x=goal), compute=compute)
    return driven, driven.run(time_limit=time_limit)


def test_counted_work_is_charged_alike_every_time(silvermate, brief):
    times = [drive(silvermate, "work", time_limit=4.0 if brief else 60.0) for _ in range(2)]
    (_, one), (_, two) = times
    assert one.compute == two.compute == "work"
    np.testing.assert_array_equal(one.record.control.coordinates, two.record.control.coordinates)


def test_on_a_slow_computer_it_drives_slower_and_arrives(silvermate, monkeypatch):
    """As if it were ten times as slow; work is counted, so that this holds on every machine."""
    _, free = drive(silvermate, "free")
    reading = Computing.reading
    monkeypatch.setattr(Computing, "reading", lambda self: 25.0 * reading(self))
    driven, slow = drive(silvermate, "work")
    assert driven.controller.pace.slow
    assert slow.reached, slow.reason
    assert slow.record.duration > free.record.duration
    assert free.compute == "free"


def test_where_planning_is_slow_it_brakes_before_it_plans(silvermate, monkeypatch):
    """A post appears in the way of a robot at speed whose ticks take longer than it may wait."""
    reading = Computing.reading
    monkeypatch.setattr(Computing, "reading", lambda self: 25.0 * reading(self))
    before = drive(silvermate, "work", goal=7.0, time_limit=3.0)[1].record.control
    assert before.v[290, 0] > 0.5
    post_at = before.coordinates[290, 0] + 1.5
    post = Cylinder(0.15, 1.2, at=(post_at, 0.02, 0.6), name="post")
    world = World(Scene([CRATE, post]), appears={"post": 3.0})
    waits: list[tuple[float, float]] = []
    driven = simulation(
        silvermate, world, silvermate.home(), silvermate.home(x=7.0), compute="work",
        watch=lambda run: waits.append((run.time, run.controller.pace.latency)),
    )  # fmt: skip
    result = driven.run(time_limit=60.0)
    braked = [e.time for e in result.events if e.kind == "braked"]
    assert braked
    assert 3.0 <= braked[0] <= 3.0 + 2.5 * max(latency for time, latency in waits if 2.0 < time < 4.0)
    assert not evaluate(result.record, silvermate, driven.world, driven.limits).collisions
    assert result.reached, result.reason


def test_motions_arrive_when_they_are_planned_and_not_before(silvermate):
    """A controller whose every tick takes 80 ms: no motion is taken sooner after its tick."""
    watch = Watch()
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([CRATE]), meter=watch)
    plan, planned, taken = controller.plan_tick, [], []

    def slow(now, scene, active, begin):
        result = plan(now, scene, active, begin)
        watch.now += 0.08
        if result.accepted:
            planned.append((now, result.motion))
        return result

    controller.plan_tick = slow
    plant, measurement = KinematicPlant(silvermate, controller.limits), None
    for k in range(150):
        command = controller.step(0.01 * k, measurement, Scene([CRATE], time=0.01 * k))
        measurement = plant.step(command, 0.01)
        if not taken or controller.executor.active is not taken[-1][1]:
            taken.append((0.01 * k, controller.executor.active))
    made = {id(motion): now for now, motion in planned}
    delays = [t - made[id(motion)] for t, motion in taken if id(motion) in made]
    assert delays
    assert min(delays) >= 0.08 - 1e-9
    assert all(motion.start_time >= t - 1e-9 for t, motion in taken[1:])
    assert controller.state is not RunState.REACHED
