"""The controller alone, with a driver that is no simulator: measurements and scenes in, commands out."""

from __future__ import annotations

import gc
import itertools
from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest
from cases import each, refused
from simulated_time import planning_at_once

from elastic_strips.control import Command, Controller, DriveParams, Measurement, RunState, replanning
from elastic_strips.control.evasion import motion_to
from elastic_strips.control.itinerary import frames_of
from elastic_strips.control.strip_timer import PlanOutcome
from elastic_strips.errors import ConfigurationError, ParameterError, SceneError
from elastic_strips.io import load_path
from elastic_strips.planning import AllOf, BasePose, HandPose, straight_line
from elastic_strips.scene import Box, Cylinder, Scene, Twist
from elastic_strips.sim import KinematicPlant
from elastic_strips.strip import Strip, repair
from elastic_strips.trajectory import MotionLimits
from elastic_strips.trajectory.trajectory import stationary

CRATE = Box((0.4, 0.4, 1.0), at=(1.6, 0.45, 0.5), name="crate")
WALKER = Cylinder(0.2, 1.6, at=(0.0, 3.0, 0.8), name="walker", motion=Twist(np.zeros(3)))
DT = 0.01


class Wheels:
    """A machine that does what it is told at once, and counts what it did."""

    def __init__(self, robot):
        self.limits = MotionLimits.for_robot(robot)
        self.coordinates = robot.space.to_coordinates(robot.home())
        self.measured = None

    def drive(self, command, t):
        left, right = command.drive * DT
        way, turn = 0.5 * (left + right), (right - left) / self.limits.track
        x, y, yaw = self.coordinates[:3]
        self.coordinates = np.concatenate(
            ([x + way * np.cos(yaw + 0.5 * turn), y + way * np.sin(yaw + 0.5 * turn), yaw + turn],
             self.coordinates[3:] + command.joints * DT)
        )  # fmt: skip
        return Measurement(t, command.drive * DT, self.coordinates[3:])


def drive(controller, wheels, steps, see, first=0):
    """Steps ``first`` to ``first + steps``; ``see(t)`` is the scene. Returns the number of the last one."""
    for k in range(first, first + steps):
        command = controller.step(k * DT, wheels.measured, see(k * DT))
        wheels.measured = wheels.drive(command, (k + 1) * DT)
        if controller.ended:
            break
    return k


def still(*obstacles):
    return lambda t: Scene(obstacles, time=t)


def test_it_drives_a_machine_of_ones_own_to_its_goals(silvermate):
    goals = [silvermate.home(x=2.5), silvermate.home(x=2.5, yaw=1.0)]
    with Controller(silvermate, silvermate.home(), goals, Scene([CRATE]), workers=planning_at_once()) as controller:
        wheels = Wheels(silvermate)
        drive(controller, wheels, 3000, still(CRATE))
        assert controller.state is RunState.REACHED, controller.reason
        assert not controller.goals
        np.testing.assert_allclose(wheels.coordinates[:3], (2.5, 0.0, 1.0), atol=0.02)
        at_last = silvermate.space.from_coordinates(wheels.coordinates)
        here, there = (silvermate.frame_pose(q, "hand_frame")[:3, 3] for q in (at_last, goals[-1]))
        assert controller.goals_reached[-1].hand == pytest.approx(np.linalg.norm(here - there), abs=0.005)
        assert not controller.goals_reached[-1].frame
        assert [e.kind for e in controller.events if e.kind in ("goal", "fault")] == ["goal"]


def test_the_motion_comes_soon_after_a_tick_that_had_the_strip_alone(silvermate):
    goal, readings = silvermate.home(x=2.5), itertools.count()
    with Controller(silvermate, silvermate.home(), goal, Scene([CRATE]), workers=planning_at_once()) as controller:
        controller.pace.meter = lambda: 0.003 * next(readings)
        wheels, ticks = Wheels(silvermate), {}

        def see(t):
            if controller.tick is not None:
                ticks[controller.tick.time] = controller.planner.prepared
            return Scene([CRATE], time=t)

        drive(controller, wheels, 3000, see)
        assert controller.state is RunState.REACHED, controller.reason
        times, alone = np.array(sorted(ticks)), np.array([ticks[t] for t in sorted(ticks)])[:-1]
        period = controller.params.plan_every * controller.params.control_dt
        assert alone.sum() > 10
        assert np.diff(times)[alone].max() < 0.8 * period
        assert np.diff(times)[~alone].min() > 0.9 * period


def test_a_robot_sets_off_from_where_it_has_come_to_rest(silvermate):
    """Not from where it was to rest: such a motion begins beside the reference, and is refused."""
    start, goal = silvermate.home(), silvermate.home(x=2.0)
    with Controller(silvermate, start, goal, Scene([]), workers=planning_at_once()) as controller:
        wheels = Wheels(silvermate)
        controller.set_speed(0.0)
        k = drive(controller, wheels, 200, still())
        assert controller.state is RunState.STOPPED
        wheels.measured = replace(wheels.measured, joints=wheels.measured.joints + 0.004)
        wheels.coordinates[3:] += 0.004
        controller.set_speed(1.0)
        drive(controller, wheels, 100, still(), first=k + 1)
        assert controller.state is RunState.MOVING
        assert not [event for event in controller.events if event.kind == "refused" and event.time > k * DT]


@each("frame", ["arm_4_link", "hand_frame"])
def test_how_far_off_it_is_is_about_the_frame_that_was_asked_for(silvermate, frame):
    """Not about the last control point, which may be half a metre from there."""
    goal = HandPose(frame, tuple(silvermate.frame_pose(silvermate.home(x=2.0), frame)[:3, 3] + (0.0, 0.1, 0.05)))
    with Controller(silvermate, silvermate.home(), goal, Scene([]), workers=planning_at_once()) as controller:
        wheels = Wheels(silvermate)
        drive(controller, wheels, 3000, still())
        assert controller.state is RunState.REACHED, controller.reason
    (reached,) = controller.goals_reached
    at = silvermate.frame_pose(silvermate.space.from_coordinates(wheels.coordinates), frame)[:3, 3]
    assert reached.frame == frame
    assert reached.hand == pytest.approx(np.linalg.norm(at - goal.position), abs=0.005)


@each(
    "goal, frames",
    [
        (HandPose("a", (0, 0, 0)), ("a",)),
        ([HandPose("a", (0, 0, 0)), HandPose("b", (0, 0, 0))], ("a",)),
        (AllOf(HandPose("a", (0, 0, 0)), HandPose("b", (0, 0, 0)), BasePose(0, 0)), ("a", "b")),
        ({"a": HandPose("a", (0, 0, 0))}, ("a",)),
        ({"elbow": 0.3}, ()),
        (BasePose(0, 0), ()),
        (np.zeros(7), ()),
    ],
)
def test_which_frames_a_goal_is_about(goal, frames):
    assert frames_of(goal) == frames


def test_commands_keep_the_limits(silvermate):
    controller, wheels = Controller(silvermate, silvermate.home(), silvermate.home(x=1.5)), Wheels(silvermate)
    measurement, commands = None, []
    for k in range(400):
        commands.append(controller.step(k * DT, measurement, Scene([], time=k * DT)))
        measurement = wheels.drive(commands[-1], (k + 1) * DT)
    limits = controller.limits
    assert max(np.abs(c.drive).max() for c in commands) > 0.1
    for command in commands:
        assert (np.abs(command.drive) <= limits.drive_speed * (1 + 1e-9)).all()
        assert (np.abs(command.joints) <= limits.joint_speed * (1 + 1e-9)).all()


def test_without_a_scene_it_does_not_set_out_and_with_an_old_one_it_stops(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=3.0))
    wheels = Wheels(silvermate)
    k = drive(controller, wheels, 50, lambda t: None)
    assert (wheels.coordinates[:3] == 0.0).all()
    assert "no scene" in controller.reason
    k = drive(controller, wheels, 100, still(CRATE), first=k + 1)
    assert controller.state is RunState.MOVING
    drive(controller, wheels, 300, lambda t: None, first=k + 1)
    assert controller.state is RunState.STOPPED
    assert "stale scene" in controller.reason


def test_what_it_feels_and_what_it_does_not_measure_stop_it(silvermate):
    for options, word in (({"contact": "the left bumper"}, "the left bumper"), ({}, "odometry lost")):
        controller = Controller(silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([]))
        wheels = Wheels(silvermate)
        k = drive(controller, wheels, 150, still())
        assert controller.state is RunState.MOVING
        travel = np.zeros(2) if options else None
        for t in np.arange(k + 1, k + 160) * DT:  # later it backs off
            command = controller.step(t, Measurement(t, travel, wheels.coordinates[3:], **options), Scene([], time=t))
        assert controller.state is RunState.STOPPED
        assert np.abs(command.drive).max() < 0.05
        assert any(word in e.reason for e in controller.events if e.kind == "fault")


class Later:
    """Plans when it is told to."""

    def __init__(self):
        self.jobs = []

    def submit(self, fn, *arguments):
        self.jobs.append((Future(), fn, arguments))
        return self.jobs[-1][0]

    def work(self):
        for future, fn, arguments in self.jobs:
            if future.set_running_or_notify_cancel():
                future.set_result(fn(*arguments))
        self.jobs.clear()


def test_a_path_that_was_given_is_driven(silvermate):
    """It leads around where nothing stands, and no plan would."""
    rows = np.array(
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.6, 0.6, 0.8], [2.6, 0.6, -0.8], [3.2, 0.0, 0.0], [4.0, 0.0, 0.0]]
    )
    path = load_path(rows, silvermate, joint_names=("x", "y", "yaw"))
    np.testing.assert_allclose(path.q[0], silvermate.home())
    mended = repair(silvermate, Scene([]), path)
    assert mended.certified, mended.reason
    wheels = Wheels(silvermate)
    with Controller(silvermate, path.q[0], path.q[-1], Scene([]), strip=mended.strip) as controller:
        assert controller.first_plan is None
        seen = []
        for k in range(3000):
            command = controller.step(k * DT, wheels.measured, Scene([], time=k * DT))
            wheels.measured = wheels.drive(command, (k + 1) * DT)
            seen.append(wheels.coordinates[1])
            if controller.ended:
                break
        assert controller.state is RunState.REACHED
        assert controller.replans == 0
        assert max(seen) > 0.1


def test_another_robots_strip_is_refused(silvermate, tiago):
    other = Strip(tiago, [tiago.home(), tiago.home(x=1.0)])
    with refused(ConfigurationError, "tiago"):
        Controller(silvermate, silvermate.home(), silvermate.home(x=1.0), Scene([]), strip=other)


def test_it_does_not_wait_for_a_plan(silvermate):
    """The way is closed, and another strip is planned somewhere else: meanwhile the robot stands, step by step."""
    wall = Box((0.2, 3.0, 1.5), at=(2.0, 0.0, 0.75), name="wall")
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    through = Strip.from_coordinates(silvermate, straight_line(silvermate, start, goal, spacing=0.13))
    later, wheels = Later(), Wheels(silvermate)
    controller = Controller(
        silvermate, start, goal, Scene([wall]), strip=through, workers=later, params=DriveParams(replan_after=0.1)
    )
    k = 0
    while not (later.jobs and controller.executor.at_rest(controller.time)) and k < 1000:
        k = drive(controller, wheels, 5, still(wall), first=k) + 1
    assert later.jobs
    here = wheels.coordinates.copy()
    k = drive(controller, wheels, 200, still(wall), first=k) + 1
    np.testing.assert_allclose(wheels.coordinates, here, atol=1e-3)
    assert len(later.jobs) == 1
    later.work()
    drive(controller, wheels, 3000, still(wall), first=k)
    assert controller.state is RunState.REACHED, controller.reason
    assert controller.replans == 1


def evading(controller, motion_from):
    """What the controller plans with: always a manoeuvre, by ``motion_from(state)``."""
    planned = controller.planner.tick

    def tick(now, scene, active, begin):
        motion = motion_from(active.at(begin))
        certificate = controller.planner.certify(motion, scene)
        assert certificate.certified
        result = planned(now, scene, active, begin)
        controller.planner.off_strip = True
        return replace(result, outcome=PlanOutcome.EVADE, motion=motion, certificate=certificate)

    return tick


def replanned(controller):
    return [e for e in controller.events if e.kind == "replanned"]


def test_who_holds_still_for_what_moves_takes_its_plan(silvermate):
    """A manoeuvre that stands still ends later every time: no end of it is to be waited for."""
    later, wheels = Later(), Wheels(silvermate)
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    with Controller(silvermate, start, goal, Scene([WALKER]), workers=later) as controller:
        limits = controller.limits
        controller.plan_tick = evading(
            controller, lambda state: stationary(silvermate, limits, state.coordinates, state.time, 1.0)
        )
        controller.replanner.demand(0.0)
        k = drive(controller, wheels, 30, still(WALKER)) + 1
        assert len(later.jobs) == 1
        later.work()
        assert not controller.executor.at_rest(controller.time)
        drive(controller, wheels, 20, still(WALKER), first=k)
        assert len(replanned(controller)) == 1
        assert controller.replans == 1


def test_who_evades_takes_its_plan_from_wherever_it_is(silvermate):
    """It will stand elsewhere than where the plan begins, and joins it; so it need not stand first."""
    later, wheels = Later(), Wheels(silvermate)
    start, goal = silvermate.home(), silvermate.home(x=4.0, y=1.0)
    with Controller(silvermate, start, goal, Scene([WALKER]), workers=later) as controller:
        limits, tick = controller.limits, controller.plan_tick
        controller.plan_tick = evading(
            controller,
            lambda s: motion_to(silvermate, limits, s, np.array([0.3, 0.2]), part=0.8, duration=0.3, dt=0.02),
        )
        controller.replanner.demand(0.0)
        k = drive(controller, wheels, 60, still(WALKER)) + 1
        later.work()
        k = drive(controller, wheels, 10, still(WALKER), first=k) + 1
        assert len(replanned(controller)) == 1
        assert wheels.coordinates[0] > 0.1
        assert controller.reference.v.any()
        controller.plan_tick = tick
        drive(controller, wheels, 2000, still(WALKER), first=k)
        assert controller.state is RunState.REACHED, controller.reason
        assert controller.replans == 1


def test_who_brakes_on_the_way_to_where_a_plan_begins_plans_from_where_it_stands(silvermate):
    later, wheels = Later(), Wheels(silvermate)
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    with Controller(silvermate, start, goal, Scene([CRATE]), workers=later) as controller:
        k = drive(controller, wheels, 100, still(CRATE)) + 1
        controller.replanner.demand(0.0)
        k = drive(controller, wheels, 10, still(CRATE), first=k) + 1
        later.work()
        end = controller.executor.active.coordinates[-1].copy()
        controller.executor.brake("for a test")
        k = drive(controller, wheels, 100, still(CRATE), first=k) + 1
        assert controller.executor.at_rest(controller.time)
        assert wheels.coordinates[0] < end[0] - 0.02
        assert not replanned(controller)
        later.work()
        k = drive(controller, wheels, 10, still(CRATE), first=k) + 1
        assert len(replanned(controller)) == 1
        assert controller.replans == 1, "what was planned from elsewhere does not count"
        drive(controller, wheels, 2000, still(CRATE), first=k)
        assert controller.state is RunState.REACHED, controller.reason


def test_a_goal_that_nobody_can_reach_is_a_fault_and_no_crash(silvermate):
    controller, wheels = (
        Controller(
            silvermate,
            silvermate.home(),
            silvermate.home(x=1.0),
            Scene([CRATE]),
            workers=planning_at_once(),
        ),
        Wheels(silvermate),
    )
    k = drive(controller, wheels, 2000, still(CRATE))
    controller.retarget(silvermate.home(x=1.6, y=0.45))
    drive(controller, wheels, 100, still(CRATE), first=k + 1)
    assert controller.state is RunState.STOPPED
    assert "crate" in controller.reason
    assert any(e.kind == "fault" and "crate" in e.reason for e in controller.events)


@pytest.mark.parametrize("error", [RuntimeError("the planner broke"), ConfigurationError("nobody can be there")])
def test_whatever_fails_on_the_way_to_a_new_goal_it_does_not_go_back_to_the_old_one(silvermate, monkeypatch, error):
    """The strip that it has leads to the goal before: nothing may call that reached."""
    controller = Controller(
        silvermate,
        silvermate.home(),
        silvermate.home(x=1.0),
        Scene([CRATE]),
        workers=planning_at_once(),
    )
    wheels = Wheels(silvermate)
    k = drive(controller, wheels, 2000, still(CRATE))

    def fails(*_, **__):
        raise error

    monkeypatch.setattr(controller.replanner.planner, "first", fails)
    controller.retarget(silvermate.home(x=3.0))
    drive(controller, wheels, 100, still(CRATE), first=k + 1)
    assert controller.state is RunState.STOPPED
    assert str(error) in controller.reason


def test_a_strip_that_comes_too_late_for_its_goal_is_not_taken(silvermate):
    wall = Box((0.2, 3.0, 1.5), at=(2.0, 0.0, 0.75), name="wall")
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    through = Strip.from_coordinates(silvermate, straight_line(silvermate, start, goal, spacing=0.13))
    later, wheels, k = Later(), Wheels(silvermate), 0
    controller = Controller(
        silvermate, start, goal, Scene([wall]), strip=through, workers=later, params=DriveParams(replan_after=0.1)
    )
    while not (later.jobs and controller.executor.at_rest(controller.time)) and k < 1000:
        k = drive(controller, wheels, 5, still(wall), first=k) + 1
    controller.retarget(silvermate.home())
    later.work()  # the strip to the first goal, and the one to the second
    drive(controller, wheels, 3000, still(wall), first=k)
    assert controller.state is RunState.REACHED, controller.reason
    np.testing.assert_allclose(wheels.coordinates[:2], 0.0, atol=0.05)


def test_a_contact_between_two_planning_ticks_counts(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([]))
    wheels = Wheels(silvermate)
    first = drive(controller, wheels, 150, still()) + 1
    measurement = None
    for k in range(first, first + 20):
        command = controller.step(k * DT, measurement, Scene([], time=k * DT))
        felt = "the left bumper" if k == first + 2 else ""
        measurement = replace(wheels.drive(command, (k + 1) * DT), contact=felt)
    assert any("bumper" in e.reason for e in controller.events if e.kind == "braked")


def test_a_stop_can_be_taken_back(silvermate):
    controller, wheels = (
        Controller(silvermate, silvermate.home(), silvermate.home(x=2.0), Scene([]), workers=planning_at_once()),
        Wheels(silvermate),
    )
    k = drive(controller, wheels, 100, still())
    controller.stop("somebody asked")
    k = drive(controller, wheels, 400, still(), first=k + 1)
    assert controller.halted
    assert not controller.ended
    assert (controller.state, controller.reason) == (RunState.STOPPED, "somebody asked")
    controller.resume()
    drive(controller, wheels, 2000, still(), first=k + 1)
    assert controller.state is RunState.REACHED


@each("rate, unstamped", list(itertools.product([20.0, 50.0, 100.0, 200.0], [True, False])))
def test_a_loop_at_any_rate_with_a_map_that_never_changes(silvermate, rate, unstamped):
    """The period is measured; a map needs no time, whether it is handed over at every step or only once."""
    controller = Controller(
        silvermate, silvermate.home(), silvermate.home(x=1.0), Scene([CRATE]), workers=planning_at_once()
    )
    plant = KinematicPlant(silvermate, controller.limits, seed=2)
    plant.reset(silvermate.space.to_coordinates(silvermate.home()))
    measurement, t = None, 0.0
    for k in range(int(15.0 * rate)):
        t = k / rate
        command = controller.step(t, measurement, Scene([CRATE]) if unstamped else None)
        measurement = plant.step(command, 1.0 / rate)
        if controller.ended:
            break
    assert controller.ended, controller.reason
    assert [event for event in controller.events if event.kind == "fault"] == []


@each("rate", [20.0, 50.0, 100.0])
def test_planning_that_takes_time_is_in_time_at_any_rate(silvermate, rate):
    """What is ready between two steps is handed over at the second, and what is planned then continues it."""
    clock = iter(0.004 * k for k in range(10**9))  # each reading is 4 ms after the one before
    scene, home = Scene([CRATE]), silvermate.home()
    with Controller(silvermate, home, silvermate.home(x=2.0), scene, meter=lambda: next(clock)) as controller:
        plant, measurement = KinematicPlant(silvermate, controller.limits, seed=2), None
        plant.reset(silvermate.space.to_coordinates(home))
        for k in range(int(15.0 * rate)):
            measurement = plant.step(controller.step(k / rate, measurement, None), 1.0 / rate)
        assert controller.ended, controller.reason
        late = [e for e in controller.events if e.kind == "refused" and ("late" in e.reason or "beside" in e.reason)]
        assert all(e.time < 1.0 for e in late), late  # the rate is measured first


def test_a_loop_that_is_too_slow_gets_no_motions_and_says_so(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=2.0), Scene([CRATE]))
    plant = KinematicPlant(silvermate, controller.limits, seed=2)
    plant.reset(silvermate.space.to_coordinates(silvermate.home()))
    measurement, period = None, 1.25 * controller.params.monitor.longest_period
    for k in range(100):
        measurement = plant.step(controller.step(k * period, measurement, None), period)
    assert controller.state is RunState.STOPPED
    assert "Hz" in controller.reason
    assert plant.coordinates[0] < 0.5


def test_a_scene_in_which_something_moves_is_no_map(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([]))
    drive(controller, Wheels(silvermate), 200, lambda t: Scene([WALKER]))
    assert controller.state is RunState.STOPPED
    assert "time=" in controller.reason


def test_an_emergency_stop_stays_the_reason_until_it_is_resumed(silvermate):
    """Its wheels are cut while the button is pressed, so that the robot stops beside its reference."""
    controller = Controller(
        silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([]), workers=planning_at_once()
    )
    plant, reasons = KinematicPlant(silvermate, controller.limits, seed=3), {}
    plant.reset(silvermate.space.to_coordinates(silvermate.home()))
    measurement = None
    for k in range(1500):
        pressed = 150 <= k < 400
        if k == 600:
            controller.resume()
        command = controller.step(k * DT, measurement, None)
        measurement = plant.step(Command.rest(controller.limits) if pressed else command, DT)
        measurement = replace(measurement, emergency="button 3" if pressed else "")
        if controller.state is RunState.STOPPED and 151 < k < 600:
            reasons.setdefault("pressed" if k < 401 else "released", set()).add(controller.reason)
            assert command.stop or k < 300
        assert not (controller.ended and k < 600)
    assert reasons["pressed"] == {"button 3"}
    (released,) = reasons["released"]
    assert released.startswith("button 3: ")
    assert controller.state is RunState.REACHED


def test_a_goal_that_is_walled_in_is_said_once_and_by_what(silvermate, monkeypatch):
    for limit in ("_FIRST_TIMEOUT", "_WAITING_TIMEOUT"):  # OMPL takes all of it, and there is nothing to be found
        monkeypatch.setattr(replanning, limit, 0.5)
    walls = [Box((0.1, 2.4, 2.0), at=(x, 0.0, 1.0), name=f"wall {x:g}") for x in (1.8, 4.2)]
    walls += [Box((2.4, 0.1, 2.0), at=(3.0, y, 1.0), name=f"wall {y:g}") for y in (-1.2, 1.2)]
    params = DriveParams(replan_after=0.2, replan_time=0.1)
    home, goal = silvermate.home(), silvermate.home(x=3.0)
    with Controller(silvermate, home, goal, Scene(walls), params=params, workers=planning_at_once()) as controller:
        drive(controller, Wheels(silvermate), 400, lambda t: None)
        assert controller.state is RunState.STOPPED
        assert all(wall.name in controller.reason for wall in walls)
        said = [event for event in controller.events if event.kind == "refused" and event.reason == controller.reason]
        assert len(said) == 1


def test_parameters_are_not_assigned_in_silence(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([]))
    for owner in (controller, controller.planner.deformer):
        with pytest.raises(AttributeError):
            owner.params = owner.params


def test_wrong_steps_are_refused(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=2.0), Scene([]))
    controller.step(0.0, None, None)
    for t in (0.0, -1.0):
        with refused(ParameterError, "step"):
            controller.step(t, None, None)
    with refused(ParameterError, "finite"):
        controller.step(np.nan, None, None)
    with refused(SceneError, "list"):
        controller.step(1.0, None, [CRATE])
    with refused(ConfigurationError, "crate"):
        Controller(silvermate, silvermate.home(), silvermate.home(x=1.6, y=0.45), Scene([CRATE]))


def test_what_is_made_before_the_first_step_is_not_looked_through_in_a_tick(silvermate):
    """The collector's later rounds find only what is made later."""
    with Controller(silvermate, silvermate.home(), silvermate.home(x=2.5), Scene([])) as controller:
        gc.unfreeze()
        controller.warm_up()
        # and so it stays, for the tests that come after (tests/conftest.py)
        assert gc.get_freeze_count() > 0.9 * (gc.get_freeze_count() + len(gc.get_objects()))


def test_the_collector_waits_for_the_end_of_a_tick(silvermate, monkeypatch):
    """However often it is due."""
    inside, collected = [False], []
    with Controller(silvermate, silvermate.home(), silvermate.home(x=2.5), Scene([])) as controller:
        tick, ticks = controller.plan_tick, []

        def watched(*arguments):
            inside[0] = True
            ticks.append(arguments)
            try:
                return tick(*arguments)
            finally:
                inside[0] = False

        monkeypatch.setattr(controller, "plan_tick", watched)
        before, look = gc.get_threshold(), lambda phase, info: collected.append(inside[0])
        gc.callbacks.append(look)
        gc.set_threshold(1)
        try:
            drive(controller, Wheels(silvermate), 20, still())
        finally:
            gc.set_threshold(*before)
            gc.callbacks.remove(look)
    assert ticks
    assert collected
    assert not any(collected)
    assert gc.isenabled()


@each("room, brakes", [(True, False), (False, True)])
def test_before_it_brakes_for_its_deviation_its_motion_is_proven_again(silvermate, monkeypatch, room, brakes):
    """In two pushes, a planning tick between them: the first alone is no reason to brake, both together are."""
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=6.0), Scene([CRATE]))
    wheels = Wheels(silvermate)
    k = drive(controller, wheels, 204, still(CRATE))  # the next one but one has a planning tick
    assert wheels.measured.drive.min() > 0.5 * DT
    if not room:
        certify, usual = controller.planner.certify, controller.planner.margins.tracking_error

        def refuses(motion, scene, tracking_error=None):
            certificate = certify(motion, scene, tracking_error)
            near = tracking_error is not None and tracking_error > usual
            return replace(certificate, segments=np.zeros_like(certificate.segments)) if near else certificate

        monkeypatch.setattr(controller.planner, "certify", refuses)
    executor, most = controller.executor, 0.0
    for push in (0.018, 0.007):
        wheels.measured = replace(wheels.measured, drive=wheels.measured.drive + push)
        for _ in range(2):
            k = drive(controller, wheels, 1, still(CRATE), first=k + 1)
            most = max(most, executor.monitor.deviation)
    assert most > controller.planner.margins.tracking_error
    assert any(event.kind == "braked" for event in controller.events) is brakes
    if not brakes:
        assert executor.proven >= most
        drive(controller, wheels, 100, still(CRATE), first=k + 1)
        assert controller.state is RunState.MOVING
