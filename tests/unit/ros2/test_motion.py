"""Odometry and joint states as measurements, and the rates that are enough."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace as Fields

import numpy as np
import pytest
from cases import each

from elastic_strips.control.estimation import StateEstimator
from elastic_strips.control.executor import MotionExecutor
from elastic_strips.control.interfaces import Measurement
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.ros2.driver import Ros2Driver
from elastic_strips.ros2.messages import BasePlace, MessageError
from elastic_strips.ros2.motion import MotionReader, carried, check_rate, correction_of
from elastic_strips.ros2.params import Ros2Params, drive_params
from elastic_strips.ros2.stamps import StampClock
from elastic_strips.trajectory import MotionLimits


def reader(robot: RobotModel) -> MotionReader:
    return MotionReader(robot, MotionLimits.for_robot(robot))


def at(x: float, yaw: float = 0.0) -> BasePlace:
    return BasePlace(np.array([x, 0.0, yaw]), None)


def joints(robot: RobotModel, value: float) -> dict[str, float]:
    return dict.fromkeys(robot.joint_names, value)


def test_there_is_a_measurement_only_where_something_new_came(silvermate: RobotModel):
    motion = reader(silvermate)
    assert "odometry" in motion.missing
    motion.note_odometry(0.00, at(0.0))
    assert motion.measure() is None
    motion.note_joints(0.00, joints(silvermate, 0.0))
    first = motion.measure()
    assert first is not None
    np.testing.assert_array_equal(first.drive, 0.0)
    assert motion.measure() is None
    motion.note_odometry(0.02, at(0.01))
    assert motion.measure() is None, "the joints of then are not known"
    motion.note_joints(0.03, joints(silvermate, 0.3))
    second = motion.measure()
    assert second is not None
    assert second.time == pytest.approx(0.02)
    np.testing.assert_allclose(second.drive, [0.01, 0.01])
    np.testing.assert_allclose(second.joints, 0.2)


def test_how_old_the_newest_of_each_is(silvermate: RobotModel):
    """By the joint that is behind all others, where joint states come from several."""
    motion, (first, *others) = reader(silvermate), silvermate.joint_names
    assert motion.ages(0.0) == (math.inf, math.inf)
    motion.note_odometry(0.1, at(0.0))
    motion.note_joints(0.2, {first: 0.0})
    assert motion.ages(0.5) == (pytest.approx(0.4), math.inf)
    motion.note_joints(0.3, dict.fromkeys(others, 0.0))
    motion.note_joints(0.4, {first: 0.0})
    assert motion.ages(0.5) == (pytest.approx(0.4), pytest.approx(0.2))


def test_no_travel_is_lost_between_measurements(silvermate: RobotModel):
    """As much as there is, by whatever steps it is measured; also around a bend."""
    motion, limits = reader(silvermate), MotionLimits.for_robot(silvermate)
    total = np.zeros(2)
    for k in range(60):
        t = 0.02 * k
        pose = np.array([math.sin(0.5 * t) / 0.5, (1.0 - math.cos(0.5 * t)) / 0.5, 0.5 * t])  # 1 m/s, 0.5 rad/s
        motion.note_odometry(t, BasePlace(pose, None))
        motion.note_joints(t + 0.007, joints(silvermate, 0.0))
        found = motion.measure() if k % 3 else None  # the first at 0.02 s
        if found is not None:
            total += found.drive
    np.testing.assert_allclose(total, limits.to_drive(np.array([1.0, 0.0, 0.5])) * 0.02 * 58, rtol=1e-6)


def test_joints_may_come_in_several_messages(silvermate: RobotModel):
    motion, names = reader(silvermate), silvermate.joint_names
    motion.note_odometry(0.0, at(0.0))
    motion.note_joints(0.0, dict.fromkeys(names[:3], 1.0))
    assert names[3] in motion.missing
    motion.note_joints(0.0, {**dict.fromkeys(names[3:], 2.0), "wheel": 7.0})
    found = motion.measure()
    assert found is not None
    np.testing.assert_array_equal(found.joints, [1.0] * 3 + [2.0] * (len(names) - 3))


def test_a_fix_is_told_once_and_when_its_time_is_known(jackal_box: RobotModel):
    motion = reader(jackal_box)
    motion.note_odometry(0.0, at(0.0))
    motion.measure()
    motion.note_fix(0.03, at(5.0))
    motion.note_odometry(0.02, at(0.0))
    early = motion.measure()
    motion.note_odometry(0.04, at(0.0))
    due = motion.measure()
    motion.note_odometry(0.06, at(0.0))
    later = motion.measure()
    assert early is not None and due is not None and later is not None  # noqa: PT018
    assert (early.pose, later.pose) == (None, None)
    assert due.pose is not None
    assert (due.pose[0], due.pose_time) == (5.0, 0.03)


def test_a_correction_carries_odometry_to_the_world():
    odometry, world = np.array([1.0, 2.0, 0.3]), np.array([-4.0, 0.5, 2.0])
    correction = correction_of(world, odometry)
    np.testing.assert_allclose(carried(correction, odometry), world)


def drive_on(motion: MotionReader, times: np.ndarray, speed: float = 1.0) -> list[Measurement]:
    """What is measured while odometry goes straight ahead."""
    found = []
    for t in times.tolist():
        motion.note_odometry(t, at(speed * t))
        found.append(motion.measure())
    return found


def test_a_transform_is_a_fix_with_odometry_of_its_time(jackal_box: RobotModel):
    motion, transform = reader(jackal_box), np.array([10.0, -2.0, 0.5 * np.pi])
    motion.note_transform(-0.4, transform, (0.04, 0.02))
    first = drive_on(motion, np.arange(0.0, 1.0, 0.02))
    assert all(measurement.pose is None for measurement in first), "nothing is known of then"
    motion.note_transform(0.95, transform, (0.04, 0.02))
    (found,) = drive_on(motion, np.array([1.0]))
    np.testing.assert_allclose(found.pose, (10.0, -2.0 + 0.95, 0.5 * np.pi), atol=1e-9)
    assert found.pose_time == pytest.approx(0.95)
    np.testing.assert_allclose(found.pose_covariance, np.diag((0.04**2, 0.04**2, 0.02**2)))
    assert drive_on(motion, np.array([1.02]))[0].pose is None
    motion.note_transform(1.5, transform + 0.01, (0.04, 0.02))  # it holds until then
    (found,) = drive_on(motion, np.array([1.04]))
    assert found.pose_time == pytest.approx(1.04)
    np.testing.assert_allclose(found.pose[1], -2.0 + 1.04 + 0.01, atol=0.02)


@each("changes, most", [(False, 3), (True, 21)])
def test_one_that_is_repeated_counts_no_more_than_it_is_measured(changes: bool, most: int, jackal_box: RobotModel):
    motion, fixes = reader(jackal_box), []
    for k in range(100):
        motion.note_transform(0.02 * k, np.array([1e-3 * k * changes, 0.0, 0.0]), (0.02, 0.01))
        fixes += [m for m in drive_on(motion, np.array([0.02 * k + 0.01])) if m.pose is not None]
    assert most - 2 <= len(fixes) <= most


def test_a_robot_that_stands_believes_a_transform_that_has_jumped_after_a_while(jackal_box: RobotModel):
    """As it does a fix of its own topic; one that jumps far it does not."""
    limits = MotionLimits.for_robot(jackal_box)
    for jump, believed in ((0.2, True), (0.6, False)):
        estimator, motion = StateEstimator(jackal_box, limits), reader(jackal_box)
        estimator.reset(np.zeros(3))
        for k in range(500):
            t = 0.02 * k
            motion.note_transform(t, np.array([jump if t > 3.0 else 0.0, 0.0, 0.0]), (0.02, 0.01))
            for measurement in drive_on(motion, np.array([t]), 0.0):
                if measurement is not None and k:
                    row = estimator.update(measurement)
            if 3.2 < t < 5.8:
                assert abs(row[0]) < 0.05
                assert estimator.doubt
        assert bool(abs(row[0] - jump) < 0.1) is believed
        assert bool(estimator.doubt) is not believed


def test_the_driver_takes_the_transform_of_its_frames(jackal_box: RobotModel):
    """With a stand-in for rclpy's node and for the message."""
    params = Ros2Params(world_frame="map", odom_frame="odom", fix_from_tf=True, scans=None)
    driver = Ros2Driver(jackal_box, MotionLimits.for_robot(jackal_box), params, [])
    now = 5_000_000_000
    driver._node = Fields(get_clock=lambda: Fields(now=lambda: Fields(nanoseconds=now)))
    driver._clock, driver._reader = StampClock(params.oldest), reader(jackal_box)
    driver._clock.epoch = time.monotonic() - 1.0

    def told(stamp: int, parent: str = "map") -> Fields:
        place = Fields(translation=Fields(x=3.0, y=0.0, z=0.0), rotation=Fields(x=0.0, y=0.0, z=0.0, w=1.0))
        header = Fields(frame_id=parent, stamp=Fields(sec=stamp // 10**9, nanosec=stamp % 10**9))
        return Fields(transforms=[Fields(header=header, child_frame_id="odom", transform=place)])

    driver._on_tf(told(now, "elsewhere"))
    assert drive_on(driver._reader, np.array([0.0]))[0].pose is None
    for wrong in (now - 2 * 10**9, now + 5 * 10**9):
        with pytest.raises(MessageError):
            driver._on_tf(told(wrong))
    driver._on_tf(told(now + 10**9))  # as localization has it, which says until when it holds
    (found,) = drive_on(driver._reader, np.array([0.9]))
    assert found.pose is not None
    assert found.pose[0] == pytest.approx(3.9)


@each("rate", (19.5, 20.0, 50.0, 100.0))
def test_twenty_hertz_are_enough(rate: float):
    assert check_rate(1.0 / rate) == pytest.approx(rate)


@each("rate", (18.0, 10.0, 1.0))
def test_less_is_refused(rate: float):
    with pytest.raises(ConfigurationError, match=f"{rate:.1f} Hz"):
        check_rate(1.0 / rate)


def test_silence_and_tracking_error_follow_from_the_rate(silvermate: RobotModel):
    limits = MotionLimits.for_robot(silvermate)
    found = [drive_params(Ros2Params(), limits, 1.0 / rate) for rate in (20.0, 50.0, 100.0)]
    assert [round(p.monitor.silence, 6) for p in found] == [0.2, 0.08, 0.05]
    assert [round(p.tracking_error, 6) for p in found] == [0.05, 0.02, 0.02]
    said = drive_params(Ros2Params(silence=0.3, tracking_error=0.04), limits, 0.01)
    assert (said.monitor.silence, said.tracking_error) == (0.3, 0.04)


def test_who_sees_only_ahead_turns_slowly_with_an_arm(silvermate: RobotModel, jackal_box: RobotModel):
    arm, none = (MotionLimits.for_robot(robot, wheel_speed=1.0) for robot in (silvermate, jackal_box))
    capped = drive_params(Ros2Params(), arm, 0.02).turn_speed
    assert capped < 1.5
    assert drive_params(Ros2Params(backward=True), arm, 0.02).turn_speed == np.inf
    assert drive_params(Ros2Params(), none, 0.02).turn_speed == np.inf


@each("silence", (0.4, 1.5, 2.5, 10.0))
@pytest.mark.parametrize("anew", [False, True])
def test_a_robot_goes_on_after_a_silence_of_odometry(silence: float, anew: bool, silvermate: RobotModel):
    """Odometry is summed up by the robot: whatever was not heard of it, the next message has it all. One that was
    silent for long may count from zero again, and is somewhere else then."""
    limits = MotionLimits.for_robot(silvermate)
    params = drive_params(Ros2Params(), limits, 0.02)
    row = silvermate.space.to_coordinates(silvermate.home())
    executor = MotionExecutor(silvermate, limits, params, row, row, params.tolerance)
    motion = reader(silvermate)
    for k in range(100 * round(silence + 2.0)):
        t = 0.01 * k
        if k % 2 == 0 and not 1.0 < t < 1.0 + silence:
            motion.note_odometry(t, at(-1.0 if anew and t > 1.0 else 0.0))
            motion.note_joints(t, dict(zip(silvermate.joint_names, row[3:].tolist(), strict=True)))
        executor.measure(t, motion.measure())
        executor.command(t)
    if not anew:
        assert executor.lost_for == 0.0
    elif silence > 2.0:
        assert executor.lost_for > 0.0
