"""What somebody else commands: as the guard takes it, and what is no command of the base or of these joints."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from cases import each

from elastic_strips.robot import RobotModel
from elastic_strips.ros2 import MessageError
from elastic_strips.ros2.pilot import PilotReader, base_frames


def reader(robot: RobotModel, frame: str | None = None, *, backward: bool = True) -> PilotReader:
    return PilotReader(robot, frame, 0.15, backward=backward)


def twist(x: float, turn: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(linear=SimpleNamespace(x=x, y=0.0), angular=SimpleNamespace(z=turn))


def stamped(frame: str) -> SimpleNamespace:
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame))


def test_nothing_is_wanted_before_something_came(silvermate: RobotModel):
    assert reader(silvermate).desired(1.0) is None


def test_base_and_joints_are_wanted_together_while_both_are_new(silvermate: RobotModel):
    pilot = reader(silvermate)
    pilot.note_twist(1.0, twist(0.3, 0.1))
    pilot.note_rates(1.1, np.full(7, 0.2))
    both = pilot.desired(1.1)
    assert both is not None
    assert both.twist is not None
    np.testing.assert_allclose(both.twist, [0.3, 0.0, 0.1])
    np.testing.assert_allclose(both.joints, 0.2)
    assert both.time == pytest.approx(1.1)
    late = pilot.desired(1.2)
    assert late is not None
    assert late.twist is None, "it is 0.2 s old"
    assert late.joints is not None
    old = pilot.desired(3.0)
    assert old is not None
    assert old.time == pytest.approx(1.1), "the guard sees how old it is"


def test_what_is_no_number_takes_the_place_of_what_was_wanted(silvermate: RobotModel):
    pilot = reader(silvermate)
    pilot.note_twist(1.0, twist(0.3))
    with pytest.raises(MessageError):
        pilot.note_twist(1.02, twist(math.nan))
    wanted = pilot.desired(1.03)
    assert wanted is not None
    assert not wanted.finite
    for values in ([0.1] * 6, [0.1] * 8, [0.1] * 6 + [math.inf], []):
        pilot.note_twist(1.04, twist(0.3))
        with pytest.raises(MessageError):
            pilot.note_rates(1.05, values)
        wanted = pilot.desired(1.05)
        assert wanted is not None
        assert not wanted.finite
        pilot = reader(silvermate)


def test_what_comes_late_or_twice_changes_nothing(silvermate: RobotModel):
    pilot = reader(silvermate)
    pilot.note_twist(1.0, twist(0.3))
    for t in (0.9, 1.0):
        with pytest.raises(MessageError):
            pilot.note_twist(t, twist(1.0))
    wanted = pilot.desired(1.0)
    assert wanted is not None
    assert wanted.twist is not None
    assert wanted.twist[0] == pytest.approx(0.3)


def test_nobody_is_driven_backwards_where_nothing_looks(silvermate: RobotModel):
    pilot = reader(silvermate, backward=False)
    pilot.note_twist(1.0, twist(-0.3, 0.5))
    wanted = pilot.desired(1.0)
    assert wanted is not None
    assert wanted.twist is not None
    np.testing.assert_allclose(wanted.twist, [0.0, 0.0, 0.5])


@each("frame", ("", "base_link", "/base_link", "base_footprint"))
def test_velocities_in_the_frame_of_the_base_count(frame: str, silvermate: RobotModel):
    reader(silvermate).check_frame(stamped(frame))


@each("frame", ("odom", "map", "laser_frame", "arm_7_link"))
def test_those_in_another_one_do_not(frame: str, silvermate: RobotModel):
    with pytest.raises(MessageError):
        reader(silvermate).check_frame(stamped(frame))


def test_a_frame_that_is_named_is_the_only_one(silvermate: RobotModel):
    pilot = reader(silvermate, "chassis")
    pilot.check_frame(stamped("chassis"))
    with pytest.raises(MessageError):
        pilot.check_frame(stamped("base_link"))
    assert "body_link" not in base_frames(silvermate) or "base_link" in base_frames(silvermate)
