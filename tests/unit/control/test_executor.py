"""Executor: it follows what is certified, refuses the rest, and comes to rest where anything fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cases import refused
from pretend import Machine, certificate_of, straight

from elastic_strips.control.executor import MotionExecutor
from elastic_strips.control.interfaces import Command, RunState
from elastic_strips.control.params import DriveParams
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, Trajectory
from elastic_strips.trajectory.trajectory import stationary

DT = DriveParams().control_dt
FAR = 4.0  # [m]


class Rig:
    """An executor on a machine that obeys at once."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.limits = robot, MotionLimits.for_robot(robot)
        params, space = DriveParams(), robot.space
        start, goal = space.to_coordinates(robot.home()), space.to_coordinates(robot.home(x=FAR))
        self.executor = MotionExecutor(robot, self.limits, params, start, goal, params.tolerance)
        self.machine = Machine(robot, Path("unused"))
        self.k = 0
        self.command = Command.rest(self.limits)

    @property
    def time(self) -> float:
        return self.k * DT

    def step(self, seconds: float = DT, meanwhile: Callable[[], object] = lambda: None) -> None:
        """So many periods; ``meanwhile`` is what planning does in each of them."""
        for _ in range(round(seconds / DT)):
            t = self.time
            self.executor.measure(t, self.machine.measure(t))
            meanwhile()
            self.command = self.executor.command(t)
            self.machine.send(t, self.command)
            self.k += 1

    def submit(self, motion: Trajectory, *, good: bool = True, at_goal: bool = True) -> None:
        self.executor.submit(motion, certificate_of(motion, good=good), at_goal=at_goal, proven=0.02)

    def until(self, true: Callable[[], object], seconds: float = 20.0) -> None:
        while not true():
            self.step()
            assert self.time < seconds, self.executor.run.events

    def says(self, text: str) -> bool:
        return any(text in event.reason for event in self.executor.run.events)


@pytest.fixture
def rig(jackal_box: RobotModel) -> Rig:
    return Rig(jackal_box)


@pytest.fixture
def moving(rig: Rig) -> Rig:
    """One that drives straight ahead."""
    rig.step(0.05)
    rig.submit(straight(rig.robot, FAR, rig.time + 0.03))
    rig.until(lambda: rig.command.drive.min() > 0.4)
    return rig


def test_a_certified_motion_is_followed_to_the_goal(moving: Rig):
    moving.until(lambda: moving.executor.run.state is RunState.REACHED)
    assert moving.executor.estimate[0] == pytest.approx(FAR, abs=0.03)
    assert not moving.command.drive.any()
    assert moving.executor.run.stops == []


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: (m, False), "not certified"),
        (lambda m: (replace(m, time=m.time - 1.0), True), "late tick"),
        (lambda m: (replace(m, coordinates=m.coordinates + np.array([0.05, 0.0, 0.0])), True), "beside the held one"),
        (lambda m: (replace(m, v=m.v * 0.5), True), "jump in speed"),
        (lambda m: (replace(m, v=m.v + np.array([0.5, 0.0, 0.0])), True), "does not end at rest"),
    ],
)
def test_anything_else_is_refused_and_the_held_motion_goes_on(moving: Rig, change, reason: str):
    held = moving.executor.active
    onward, good = change(held.tail(moving.time + 0.03))
    moving.submit(onward, good=good)
    assert moving.executor.active is held
    assert moving.says(reason)
    moving.step(0.1)
    assert moving.executor.run.state is RunState.BRAKING
    assert reason in moving.executor.run.reason
    moving.until(lambda: moving.executor.at_rest(moving.time))
    assert moving.executor.estimate[0] == pytest.approx(FAR, abs=0.03)


def test_what_is_no_number_is_no_motion(rig: Rig):
    motion = straight(rig.robot, FAR, 0.1)
    with pytest.raises(ParameterError):
        replace(motion, coordinates=np.where(motion.coordinates > 1.0, np.nan, motion.coordinates))


def test_a_contact_brakes_in_the_same_period(moving: Rig):
    end = moving.executor.active.end_time
    moving.machine.contact = "bumper"
    moving.step()
    assert moving.executor.run.state is RunState.BRAKING
    assert moving.executor.active.end_time < end - 1.0
    moving.submit(straight(moving.robot, FAR, moving.time + 0.03))
    assert moving.says("bumper")
    moving.until(lambda: moving.executor.run.state is RunState.STOPPED)
    assert moving.executor.estimate[0] < FAR - 0.5
    assert moving.executor.waits == "bumper"
    moving.machine.contact = ""
    moving.step()
    assert not moving.executor.waits


def test_an_emergency_stop_stays_until_resume(moving: Rig):
    moving.machine.emergency = "red button"
    moving.step()
    assert moving.executor.run.state is RunState.BRAKING
    moving.until(lambda: moving.executor.at_rest(moving.time))
    moving.step()
    assert moving.command.stop
    moving.machine.emergency = ""
    moving.step(1.5)
    assert moving.executor.waits == "red button"
    assert moving.command.stop
    here = float(moving.executor.estimate[0])
    moving.submit(straight(moving.robot, FAR, moving.time + 0.03, near=here))
    assert moving.says("red button")
    assert moving.executor.at_rest(moving.time)
    moving.executor.resume()
    moving.step(0.5)
    assert not moving.executor.waits
    assert not moving.command.stop
    here = float(moving.executor.estimate[0])
    moving.submit(straight(moving.robot, FAR, moving.time + 0.03, near=here))
    moving.until(lambda: moving.executor.run.state is RunState.REACHED)


def test_stop_and_resume(moving: Rig):
    moving.executor.stop("asked to stop")
    held = moving.executor.active
    moving.submit(held.tail(moving.time + 0.03))
    assert moving.executor.active is held
    moving.step()
    assert (moving.executor.run.state, moving.executor.run.reason) == (RunState.BRAKING, "asked to stop")
    moving.executor.resume()
    moving.submit(held.tail(moving.time + 0.03))
    moving.step()
    assert moving.executor.run.state is RunState.MOVING


def test_silence_brakes_and_the_robot_goes_on_from_where_it_is(moving: Rig):
    executor, end = moving.executor, moving.executor.active.end_time
    moving.machine.fixes = True  # what was travelled meanwhile is not known by the wheels
    t = moving.time
    while executor.active.end_time == end:  # nothing is measured
        executor.measure(t, None)
        moving.machine.send(t, executor.command(t))
        t += DT
    assert moving.says("no usable measurement")
    moving.k = round(t / DT)
    moving.until(lambda: executor.recoveries == 1)
    here = float(executor.estimate[0])
    assert here < FAR - 0.5
    moving.submit(straight(moving.robot, FAR, moving.time + 0.03, near=here))
    moving.until(lambda: executor.run.state is RunState.REACHED)


def test_a_robot_that_was_pushed_recovers_beside_its_reference(moving: Rig):
    moving.machine.travel = moving.machine.travel + np.array([0.0, 0.03])  # one wheel slid on
    moving.step()
    assert moving.says("off its reference")
    assert moving.executor.run.state is RunState.BRAKING
    moving.until(lambda: moving.executor.recoveries == 1)
    off = moving.executor.estimate - moving.executor.reference(moving.time).coordinates
    assert np.abs(off).max() < 1e-6
    assert not moving.executor.waits


def test_a_robot_that_is_found_beside_its_reference_again_and_again_stands(moving: Rig):
    """As fixes do that are believed and wrong, each time: nobody can say where it is."""
    executor, most = moving.executor, moving.executor.params.monitor.recoveries

    def slides(count: int) -> None:
        before = executor.recoveries
        for k in range(count):
            moving.until(lambda: not executor.waits, 200.0)
            here = float(executor.estimate[0])
            begin, row = moving.time + 0.03, np.array(executor.active.coordinates[-1])
            motion = straight(moving.robot, here + 2.0, begin, near=here)
            motion = replace(motion, coordinates=motion.coordinates + row * np.array([0.0, 1.0, 1.0]))
            moving.submit(motion, at_goal=False)
            moving.step(0.5)
            moving.machine.travel = moving.machine.travel + np.array([0.03, 0.03])
            moving.step()
            assert executor.waits
            late = begin + 6.0
            moving.until(lambda n=before + k + 1, late=late: executor.recoveries == n or moving.time > late, 200.0)

    moving.machine.travel = moving.machine.travel + np.array([0.03, 0.03])
    moving.step()
    moving.until(lambda: executor.recoveries == 1)
    slides(most - 1)
    assert executor.recoveries == most
    slides(1)
    assert executor.recoveries == most
    moving.step(0.5)
    assert executor.waits
    executor.resume()
    moving.step()
    assert executor.recoveries == most + 1
    assert not executor.waits


def test_what_is_due_is_proven_before_the_robot_has_to_brake(moving: Rig):
    """A motion that is certified anew for a larger error goes on; that of another motion is no help."""
    executor = moving.executor
    for far, announced in ((0.009, None), (0.018, 0.025), (0.023, 0.035)):
        moving.machine.travel = moving.machine.travel + np.full(2, far - executor.monitor.deviation)
        if announced is not None:
            assert executor.due_error >= 0.02
        moving.step()
        if announced is not None:
            assert executor.due_error >= announced
            executor.hold("", executor.active.tail(moving.time), executor.due_error)
            assert executor.proven < announced, "another motion"
            executor.hold("", executor.active, executor.due_error)
        assert executor.run.state is RunState.MOVING
    fresh = executor.active.tail(moving.time + 0.03)
    moving.submit(fresh)
    assert executor.active is not fresh, "certified for less than the robot is off"
    executor.hold("", executor.active, 0.02)  # what is seen now refutes the larger one
    moving.step()
    assert executor.run.state is RunState.BRAKING


def test_an_anchor_is_taken_at_rest_and_near(rig: Rig):
    executor = rig.executor
    rig.step(0.1)

    def anchored(x: float) -> bool:
        row = executor.estimate + np.array([x, 0.0, 0.0])
        resting = stationary(rig.robot, rig.limits, row, rig.time, DT)
        executor.anchor(resting)
        return executor.active is resting

    assert anchored(0.01)
    assert not anchored(0.2)
    motion = straight(rig.robot, FAR, rig.time + 0.03)
    executor.anchor(motion)
    assert executor.active is not motion, "an anchor does not move"
    rig.step(0.05)
    rig.submit(straight(rig.robot, FAR, rig.time + 0.03, near=float(executor.active.coordinates[0, 0])))
    rig.step(0.5)
    assert not executor.at_rest(rig.time)
    assert not anchored(0.0)


def test_time_ascends(rig: Rig):
    rig.step(0.05)
    with refused(ParameterError, "later"):
        rig.executor.measure(rig.time - DT, None)
