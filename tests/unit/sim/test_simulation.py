"""The loop: drives to the goal, waits for what crosses, ends at rest whatever fails; evaluated from the true states."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import configuration, link_distances
from cases import each

from elastic_strips.collision.bounds import Displacement
from elastic_strips.control import DriveParams, RunState, replanning
from elastic_strips.planning import straight_line
from elastic_strips.scene import Box, Cylinder, Scene, Twist, UnknownMotion, World
from elastic_strips.sim import FAULTS, Fault, PerceptionError, PerceptionParams, evaluate, simulation
from elastic_strips.sim.evaluation.drive_evaluation import REST_SPEED
from elastic_strips.sim.faults import SENSOR_FAULTS
from elastic_strips.strip import Strip
from elastic_strips.trajectory import MotionLimits

CLUTTER = [
    Box((0.4, 0.4, 1.0), at=(1.6, 0.45, 0.5), name="crate"),
    Cylinder(0.2, 1.4, at=(2.6, -0.5, 0.7), name="pillar"),
]
WALKER = Cylinder(0.25, 1.7, at=(2.0, -2.5, 0.85), name="walker", motion=Twist((0.0, 0.9, 0.0)))
COARSE = DriveParams(control_dt=0.02)
"""Half the steps and half the planning ticks of a drive in which neither is looked at one by one."""


def ends(robot, x: float = 4.0):
    return robot.home(), robot.home(x=x)


def through(robot) -> Strip:
    """The straight line, whatever stands on it."""
    return Strip.from_coordinates(robot, straight_line(robot, *ends(robot), spacing=0.13))


def drive(robot, obstacles, seconds: float = 40.0, x: float = 4.0, **options):
    runner = simulation(robot, World(Scene(obstacles)), *ends(robot, x), seed=2, **options)
    result = runner.run(time_limit=seconds)
    return runner, result, evaluate(result.record, robot, runner.world, runner.limits)


@each("name", ["silvermate", "tiago", "rover"])
def test_drives_to_the_goal(name, request):
    robot = request.getfixturevalue(name)
    limits = MotionLimits.for_robot(robot, joint_speed={"spin": 1.0}) if name == "rover" else None
    runner, result, evaluation = drive(robot, CLUTTER, limits=limits)
    assert result.state is RunState.REACHED, result.reason
    assert evaluation.reached
    assert not evaluation.contacts
    assert evaluation.max_lateral_slip_m < 1e-5
    rows = result.record.control
    assert np.abs(rows.v[-1]).max() < REST_SPEED
    # by brute force at some moments, and never nearer than what is certified minus the tracking error
    for k in range(0, len(rows), 193):
        d = link_distances(robot, runner.world.at(rows.time[k]), configuration(robot, rows.coordinates[k])).min()
        assert d > runner.params.margin
        assert d >= evaluation.min_clearance_m - 1e-3


def test_waits_for_what_crosses_and_equal_seeds_give_equal_runs(silvermate, brief):
    _, result, evaluation = drive(silvermate, [*CLUTTER, WALKER], params=COARSE)
    assert result.state is RunState.REACHED, result.reason
    assert not evaluation.collisions
    again = drive(silvermate, [*CLUTTER, WALKER], 6.0 if brief else 40.0, params=COARSE)[1]  # past the walker
    one, two = result.record.control, again.record.control
    rows = 290 if brief else len(one)
    assert two.time[rows - 1] < 6.0 or not brief  # before it brakes for the end of its time
    np.testing.assert_array_equal(one.coordinates[:rows], two.coordinates[:rows])
    np.testing.assert_array_equal(one.drive[:rows], two.drive[:rows])
    assert not [e for e in result.events if e.kind in ("fault", "localization", "unproven")]


@pytest.mark.parametrize("kind", sorted(set(FAULTS) - {"viewer_killed", *SENSOR_FAULTS}))
def test_faults_end_at_rest_or_at_the_goal(silvermate, kind):
    duration = 0.5 if kind == "lost_odometry" else 2.0
    faults = [Fault(kind, 1.5, duration)]
    _, result, evaluation = drive(silvermate, [*CLUTTER, WALKER], x=3.3, faults=faults, params=COARSE)
    assert not evaluation.collisions
    assert np.abs(result.record.control.v[-1]).max() < REST_SPEED
    assert result.state is RunState.REACHED, result.reason  # once the fault is over, it goes on
    named = {
        "scene_frozen": "stale scene", "scene_late": "stale scene", "nan_obstacle": "not finite",
        "planning_exception": "planning exception", "slow_tick": "late tick", "lost_odometry": "odometry lost",
        "slip": "slip", "slip_left": "slip", "slip_right": "slip", "spin": "slip", "scene_empty": "vanished",
        "scene_future": "ahead", "nan_fix": "fix is misread", "nan_odometry": "odometry is misread",
        "nan_joints": "joints are misread", "driver_exception": "driver exception",
        "sensing_exception": "sensing exception", "localization_lost": "known to", "localization_jump": "fixes are",
        "localization_coarse": "", "amplifier_holds": "does not obey", "amplifier_dead": "does not obey",
        "fix_drift": "fixes drift", "scene_without_motion": "'walker'", "scene_reversed": "'walker'",
    }[kind]  # fmt: skip
    faults = [e for e in result.events if e.kind in ("fault", "localization")]
    assert any(named in e.reason for e in faults)
    assert 1.5 <= faults[0].time < 1.5 + duration + 0.5


@each("faults", [[Fault("scene_frozen", 1.5, 1.5)], [Fault("slip_left", 1.5, 1.0)]])
def test_the_reference_of_wheels_moves_sideways_only_while_the_robot_stands(silvermate, faults):
    """At rest it is set to where the robot is estimated to be; on the way it rolls as the wheels do."""
    _, result, _ = drive(silvermate, [*CLUTTER, WALKER], faults=faults, params=DriveParams(evasion=None))
    assert result.stops
    rows = result.record.control
    sideways = np.abs(silvermate.space.difference(rows.reference[:-1], rows.reference[1:])[:, 1])
    rolls = rows.reference_v[:-1].any(axis=1) & rows.reference_v[1:].any(axis=1)
    assert rolls.sum() > 300
    assert sideways[rolls].max() < 1e-9
    set_anew = sideways > 1e-6
    assert set_anew.any()
    assert not rows.reference_v[:-1][set_anew].any()
    assert np.abs(rows.v[:-1][set_anew, 0]).max() < 0.05


@each("seed, start", [(1, 1.5), (2, 2.3), (3, 3.0)])
def test_without_odometry_it_stays_on_its_way(silvermate, seed, start):
    """It brakes by what it was told, not by an estimate that stands still: the wheels' slip alone takes it off."""
    faults, world = [Fault("lost_odometry", start, 0.5)], World(Scene(CLUTTER))
    runner = simulation(silvermate, world, *ends(silvermate), seed=seed, faults=faults, params=COARSE)
    result = runner.run(time_limit=40.0)
    rows = result.record.control
    moving = np.abs(rows.v[np.searchsorted(rows.time, start), 0])
    assert moving > 0.3
    assert Displacement(silvermate)(rows.coordinates, rows.reference).max() < 0.04
    assert result.state is RunState.REACHED


def test_a_fault_that_stays_leaves_the_robot_at_rest(silvermate):
    _, result, evaluation = drive(silvermate, CLUTTER, seconds=6.0, faults=[Fault("scene_frozen", 1.5, 100.0)])
    assert result.state is RunState.STOPPED
    assert "stale scene" in result.stops[0][1]
    rows = result.record.control
    assert np.abs(rows.v[rows.time > 4.0]).max() < REST_SPEED
    assert not evaluation.contacts


def test_a_watcher_that_dies_does_not_stop_the_robot(silvermate):
    def watch(runner) -> None:
        if runner.time > 1.0:
            raise BrokenPipeError("the page is gone")

    _, result, _ = drive(silvermate, CLUTTER, watch=watch)
    assert result.state is RunState.REACHED
    assert any(e.reason == "viewer lost" for e in result.events)


def test_stop_brings_it_to_rest(silvermate):
    def watch(runner) -> None:
        if runner.time > 1.5:
            runner.stop()

    _, result, evaluation = drive(silvermate, CLUTTER, watch=watch)
    assert result.state is RunState.STOPPED
    assert result.reason == "asked to stop"
    assert result.record.control.time[-1] < 4.5
    assert np.abs(result.record.control.v[-1]).max() < REST_SPEED
    assert not evaluation.contacts


def test_the_time_limit_brings_it_to_rest(silvermate):
    _, result, _ = drive(silvermate, [], seconds=1.5)
    assert result.state is RunState.STOPPED
    assert result.reason == "time limit of 1.5 s"
    assert [reason for _, reason in result.stops] == [result.reason]
    assert np.abs(result.record.control.v[-1]).max() < REST_SPEED


def test_a_closed_way_is_not_driven(silvermate):
    """The strip stays broken at the wall: the robot stops, says why, and does not wander about."""
    wall = Box((0.2, 60.0, 1.5), at=(2.0, 0.0, 0.75), name="wall")
    params = DriveParams(replan_time=50.0)
    _, result, evaluation = drive(silvermate, [wall], seconds=8.0, params=params, strip=through(silvermate))
    assert result.state is RunState.STOPPED
    assert not evaluation.contacts
    assert "wall" in result.reason
    rows = result.record.control
    assert np.abs(rows.v[rows.time > 4.0]).max() < REST_SPEED
    assert any(e.kind == "replanning" for e in result.events)


def test_who_might_walk_on_and_does_not_is_planned_around_again_and_again(silvermate, monkeypatch):
    """At rest the held motion is made anew now and then: that must not count as if the robot had moved."""
    monkeypatch.setattr(replanning, "_WAITING_TIMEOUT", 1.0)  # OMPL takes all of it: the room is closed
    queue = Box((0.2, 6.0, 1.5), at=(2.0, 0.0, 0.75), name="queue", motion=UnknownMotion(0.1))
    walls = ((0.2, 6.0, -2.0, 0.0), (4.2, 0.2, 0.0, 3.0), (4.2, 0.2, 0.0, -3.0))
    room = [Box((a, b, 1.5), at=(x, y, 0.75)) for a, b, x, y in walls]
    params = DriveParams(replan_after=0.6, control_dt=0.02)
    _, result, evaluation = drive(silvermate, [queue, *room], seconds=17.0, params=params, strip=through(silvermate))
    assert result.state is RunState.STOPPED
    assert not evaluation.contacts
    assert result.replans >= 2


def test_a_delayed_scene_is_driven_on_more_carefully(silvermate):
    """The walker of above, seen later."""
    _, result, evaluation = drive(silvermate, [*CLUTTER, WALKER], perception=PerceptionParams(delay=0.2), params=COARSE)
    assert result.state is RunState.REACHED
    assert not evaluation.collisions


class Feeling:
    """A perceiver that knows all; from a time on it sees nothing, or feels a contact."""

    def __init__(self, scene: Scene, error: str, contact: str, since: float) -> None:
        self.params, self._scene, self._since = PerceptionParams(), scene, since
        self._error, self._contact, self.contact = error, contact, ""

    def known(self) -> Scene:
        return self._scene

    def observe(self, t: float, coordinates: np.ndarray, estimate: np.ndarray) -> None:
        self.contact = self._contact if t >= self._since else ""

    def sense(self, t: float) -> Scene:
        if t >= self._since and self._error:
            raise PerceptionError(self._error)
        return Scene(self._scene, time=t)


def test_who_feels_a_contact_stops_sooner_than_who_is_blind(silvermate):
    ends_at = {}
    for error, contact in (("nothing came", ""), ("", "the bumper is pressed")):
        _, result, _ = drive(silvermate, CLUTTER, 6.0, perception=Feeling(Scene(CLUTTER), error, contact, 2.0))
        assert result.state is RunState.STOPPED
        assert result.reason == error + contact
        ends_at[contact] = result.stops[0][0]
        rows = result.record.control
        stands = (rows.time > ends_at[contact] + 0.2) & (rows.time < ends_at[contact] + 0.9)  # later it backs off
        assert np.abs(rows.v[stands]).max() < REST_SPEED
    assert ends_at["the bumper is pressed"] < ends_at[""] - 0.1
