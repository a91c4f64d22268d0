"""Odometry and joint states as measurements, and the rates that are enough."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each

from elastic_strips.control.executor import MotionExecutor
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.ros2.messages import BasePlace
from elastic_strips.ros2.motion import MotionReader, carried, check_rate, correction_of
from elastic_strips.ros2.params import Ros2Params, drive_params
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


@each("silence", (0.4, 1.5, 2.5))
def test_a_robot_goes_on_after_a_silence_of_odometry(silence: float, silvermate: RobotModel):
    """Odometry is summed up by the robot: whatever was not heard of it, the next message has it all. One that was
    silent for long may count from zero again."""
    limits = MotionLimits.for_robot(silvermate)
    params = drive_params(Ros2Params(), limits, 0.02)
    row = silvermate.space.to_coordinates(silvermate.home())
    executor = MotionExecutor(silvermate, limits, params, row, row, params.tolerance)
    motion = reader(silvermate)
    for k in range(400):
        t = 0.01 * k
        if k % 2 == 0 and not 1.0 < t < 1.0 + silence:
            motion.note_odometry(t, at(0.0))
            motion.note_joints(t, dict(zip(silvermate.joint_names, row[3:].tolist(), strict=True)))
        executor.measure(t, motion.measure())
        executor.command(t)
    assert (executor.lost_for == 0.0) is (silence < 2.0)
