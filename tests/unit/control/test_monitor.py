"""The monitor: what cannot be true of inputs is taken out of them; motors that do not obey are found out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.monitor import Monitor, SceneMonitor
from elastic_strips.control.params import MonitorParams
from elastic_strips.scene import Box, Scene
from elastic_strips.trajectory.limits import MotionLimits

DT = 0.01


@pytest.fixture
def monitor(silvermate) -> Monitor:
    return Monitor(silvermate, MotionLimits.for_robot(silvermate), MonitorParams(), DT)


@pytest.fixture
def home(silvermate) -> np.ndarray:
    return silvermate.space.to_coordinates(silvermate.home_q)


def reading(home: np.ndarray, t: float = DT, **changes: object) -> Measurement:
    sound = Measurement(t, np.full(2, 0.005), home[3:].copy(), home[:3].copy(), t - 0.005)
    return replace(sound, **changes)


def test_a_sound_measurement_is_not_touched(monitor, home):
    raw = reading(home, pose_covariance=np.diag([1e-4, 1e-4, 1e-5]))
    got, faults = monitor.measurement(DT, raw, home)
    assert faults == ()
    assert got is not None
    for name in ("time", "drive", "joints", "pose", "pose_time", "pose_covariance"):
        np.testing.assert_array_equal(getattr(got, name), getattr(raw, name))
    assert monitor.silent is None


@pytest.mark.parametrize(
    ("changes", "fault", "gone"),
    [
        ({"drive": np.array([np.nan, 0.0])}, "odometry", "drive"),
        ({"drive": np.array([0.5, 0.0])}, "odometry", "drive"),
        ({"drive": np.zeros(3)}, "odometry", "drive"),
        ({"pose": np.array([0.0, np.inf, 0.0])}, "fix", "pose"),
        ({"pose": np.zeros(2)}, "fix", "pose"),
        ({"pose_time": 5.0}, "fix", "pose"),
        ({"pose_time": None}, "fix", "pose"),
        ({"pose_covariance": -np.eye(3)}, "covariance", "pose_covariance"),
        ({"pose_covariance": np.full((3, 3), np.nan)}, "covariance", "pose_covariance"),
    ],
)
def test_what_cannot_be_true_is_taken_out(monitor, home, changes, fault, gone):
    got, faults = monitor.measurement(DT, reading(home, **changes), home)
    assert got is not None
    assert getattr(got, gone) is None
    assert len(faults) == 1
    assert fault in faults[0]


@pytest.mark.parametrize("joints", [np.full(7, np.nan), np.zeros(6), "far"])
def test_misread_joints_are_those_of_before(monitor, home, joints):
    joints = home[3:] + 1.0 if isinstance(joints, str) else joints
    got, faults = monitor.measurement(DT, reading(home, joints=joints), home)
    assert got is not None
    np.testing.assert_array_equal(got.joints, home[3:])
    assert faults == ("joints are misread",)
    assert monitor.silent == DT
    monitor.measurement(2 * DT, reading(home, 2 * DT), home)
    assert monitor.silent is None


def test_times_are_checked(monitor, home):
    got, faults = monitor.measurement(DT, reading(home, 7.0, pose=None, pose_time=None), home)
    assert got is not None
    assert got.time == DT
    assert "still to come" in faults[0]
    got, faults = monitor.measurement(2 * DT, reading(home, DT), home)
    assert got is None
    assert "no newer" in faults[0]
    got, faults = monitor.measurement(1.0, reading(home, 1.0), home)
    assert got is not None
    assert got.drive is None
    assert "silent for 0.99 s" in faults[0]


def test_measurements_may_all_come_late(monitor, home):
    """By more than a control period, as over a network: the first of them, too, is one."""
    joints = home[3:]
    for k in range(20):
        t = k * DT
        kept, faults = monitor.measurement(t, Measurement(t - 0.05, np.zeros(2), joints), home)
        assert kept is not None
        assert not faults
    assert monitor.silent is None


def test_a_scene_of_the_future_is_refused():
    monitor = SceneMonitor(MonitorParams())
    assert monitor.doubt(1.0, Scene(time=1.01), at_rest=False) == ""
    assert "ahead" in monitor.doubt(1.0, Scene(time=2.0), at_rest=False)


def test_obstacles_that_vanish_all_at_once_are_missed():
    monitor = SceneMonitor(MonitorParams())
    boxes = [Box((0.2, 0.2, 0.2), at=(k, 3.0, 0.1), name=f"box {k}") for k in range(5)]
    assert monitor.doubt(0.0, Scene(boxes), at_rest=False) == ""
    assert "5 of 5" in monitor.doubt(0.1, Scene(time=0.1), at_rest=False)
    assert monitor.doubt(0.2, Scene(boxes, time=0.2), at_rest=False) == ""
    assert monitor.doubt(0.3, Scene(boxes[:2], time=0.3), at_rest=False) == ""  # some may go
    assert monitor.doubt(0.4, Scene(boxes, time=0.4), at_rest=False) == ""
    for k in range(5, 30):  # a robot that moves never believes it; one that stands does in the end
        assert monitor.doubt(0.1 * k, Scene(time=0.1 * k), at_rest=False)
    assert monitor.doubt(3.0, Scene(time=3.0), at_rest=True) == ""


@pytest.mark.parametrize("period", [0.004, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("obeys", [True, False])
def test_motors_that_hold_their_speed_are_found_out(monitor, home, obeys, period):
    """At any rate of the loop: the model goes by the times of its commands, and not by the nominal period."""
    wheels, t, seen, fine = np.zeros(2), 0.0, None, 0.001
    for _ in range(round(2.0 / period)):
        braking = t >= 1.0
        told, travel = np.full(2, 0.0 if braking else 0.6), np.zeros(2)
        monitor.commanded(t, Command(told, np.zeros(7)))
        for _ in range(round(period / fine)):
            if obeys or not braking:
                most = fine * monitor.limits.drive_acceleration
                wheels = wheels + np.clip((told - wheels) * (1.0 - np.exp(-fine / 0.04)), -most, most)
            travel = travel + wheels * fine
        t += period
        monitor.measurement(t, Measurement(t, travel, home[3:]), home)
        if monitor.motor_fault and seen is None:
            seen = t
    if obeys:
        assert seen is None
    else:
        assert seen is not None
        assert 1.0 < seen < 1.5
        assert "does not obey" in monitor.motor_fault


def test_joints_that_were_misread_for_long_may_be_elsewhere_then(monitor, home):
    """They went on while nobody could read them; a second later they are believed at their new place."""
    for t in DT * np.arange(1, 101):
        monitor.measurement(t, reading(home, t=t, joints=np.full(7, np.nan)), home)
    moved = home[3:] + 0.5 * monitor.limits.joint_speed
    got, faults = monitor.measurement(t + DT, reading(home, t=t + DT, joints=moved), home)
    assert not faults
    np.testing.assert_array_equal(got.joints, moved)


@pytest.mark.parametrize(
    ("went", "believed"),
    [((0.0, 0.0), True), ((0.1, -0.05), True), ((-1.5, -1.5), False), ((0.0, 0.4), False), ((np.nan, 0.0), False)],
)
def test_odometry_that_was_silent_for_long_is_believed_where_the_robot_ought_to_be(silvermate, home, went, believed):
    """It stood meanwhile; odometry that has begun anew says something else."""
    limits = MotionLimits.for_robot(silvermate)
    params = MonitorParams(longest_arc=2.0, same_place=0.15)
    for each, back in ((MonitorParams(longest_arc=2.0), False), (params, believed)):
        monitor = Monitor(silvermate, limits, each, DT)
        monitor.measurement(DT, reading(home, drive=np.zeros(2)), home)
        for t in DT * np.arange(1, 400):
            monitor.commanded(t, Command(np.zeros(2), np.zeros(7)))
            monitor.nothing(t)
        got, faults = monitor.measurement(4.0, reading(home, t=4.0, drive=np.array(went)), home)
        assert (got.drive is not None) is back is (not faults)
        assert not monitor.motor_fault


def test_odometry_that_was_silent_is_where_the_motors_were_told_to_go(silvermate, home):
    limits, params = MotionLimits.for_robot(silvermate), MonitorParams(longest_arc=2.0, same_place=0.15)
    monitor = Monitor(silvermate, limits, params, DT)
    monitor.measurement(DT, reading(home, drive=np.zeros(2)), home)
    for t in DT * np.arange(1, 400):
        monitor.commanded(t, Command(np.full(2, 0.5 if t < 2.0 else 0.0), np.zeros(7)))
    assert monitor.measurement(4.0, reading(home, t=4.0, drive=np.ones(2)), home)[0].drive is not None
    monitor.commanded(4.0, Command(np.zeros(2), np.zeros(7)))
    assert monitor.measurement(8.0, reading(home, t=8.0, drive=np.ones(2)), home)[0].drive is None


@pytest.mark.parametrize(
    "jump, within, believed", [(0.12, 0.15, True), (0.12, 0.0, False), (0.3, 0.15, False), (np.nan, 0.15, False)]
)
def test_odometry_whose_stamps_are_uneven_is_believed_where_the_motors_were_told_to_go(
    silvermate, home, jump, within, believed
):
    """A message with a late stamp: from it to the next one the robot seems faster than its motors can be."""
    limits = MotionLimits.for_robot(silvermate)
    monitor = Monitor(silvermate, limits, MonitorParams(longest_arc=2.0, same_place=within), DT)
    for t in DT * np.arange(1, 100):
        monitor.commanded(t, Command(np.full(2, 0.5), np.zeros(7)))
        monitor.measurement(t, reading(home, t=t, drive=np.full(2, 0.5 * DT)), home)
    monitor.commanded(t + DT, Command(np.full(2, 0.5), np.zeros(7)))
    got, faults = monitor.measurement(t + DT, reading(home, t=t + DT, drive=np.full(2, jump)), home)
    assert (got.drive is not None) is believed is (not faults)


def test_motors_stop_by_themselves_where_no_command_comes(silvermate, home):
    """As where the computer runs nothing for a while: they go on for as long as a command holds."""
    limits, params = MotionLimits.for_robot(silvermate), MonitorParams(longest_arc=2.0, same_place=0.15)
    for went, believed in ((0.2, True), (2.0, False)):
        monitor = Monitor(silvermate, limits, params, DT)
        for t in DT * np.arange(1, 100):
            monitor.commanded(t, Command(np.full(2, 0.5), np.zeros(7)))
            monitor.measurement(t, reading(home, t=t), home)
        assert not monitor.motor_fault
        later = t + 4.0
        got, _ = monitor.measurement(later, reading(home, t=later, drive=np.full(2, went)), home)
        assert (got.drive is not None) is believed
