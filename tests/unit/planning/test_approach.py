"""Approaches: the hand drives to before a place and goes straight to it, both certified, or it says why not."""

from __future__ import annotations

from itertools import count

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances
from cases import refused

from elastic_strips.errors import ConfigurationError, GoalError, ParameterError, RobotError
from elastic_strips.planning import BasePose, HandPose, initial_strip, plan_approach, problem
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, DeformParams, OrientationConstraint
from elastic_strips.strip.constraint import ConstraintForce

HAND = "hand_frame"
TABLE = Box((0.8, 1.2, 0.7), at=(2.8, 0.0, 0.35), name="table")
CRATE = Box((0.1, 0.1, 0.1), at=(2.6, 0.0, 0.8), name="crate")


def placed(robot: RobotModel, q: np.ndarray) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(HAND)].copy()


def turned(robot: RobotModel) -> list[np.ndarray]:
    """As at home, by any angle about the vertical."""
    here = placed(robot, robot.home()).rotation
    return [pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ here for yaw in np.arange(0.0, 6.2, 0.5)]


def places(robot: RobotModel, at: tuple[float, float, float]) -> list[HandPose]:
    return [HandPose(HAND, at, tuple(pin.Quaternion(R).coeffs())) for R in turned(robot)]


@pytest.mark.parametrize("axes", ["hand", "world"])
def test_the_hand_goes_straight_to_the_place(silvermate, axes):
    scene, at = Scene([TABLE]), (2.55, 0.0, 0.95)
    by = (
        np.array((0.0, 0.0, -0.1))
        if axes == "world"
        else placed(silvermate, silvermate.home()).rotation.T @ (0.1, 0, 0)
    )
    report = plan_approach(
        silvermate, scene, silvermate.home(), places(silvermate, at), by, axes=axes, beyond=scene.with_obstacle(CRATE)
    )  # fmt: skip
    assert report.certified, report.reason
    assert report.drive is not None
    assert report.reach is not None
    drive, reach = report.drive.strip, report.reach.strip
    np.testing.assert_array_equal(drive.q[0], silvermate.home())
    np.testing.assert_array_equal(drive.q[-1], reach.q[0])
    assert report.reach.report.strip is reach
    first, last = placed(silvermate, reach.q[0]), placed(silvermate, reach.q[-1])
    np.testing.assert_allclose(last.translation, at, atol=2e-4)
    way = last.translation - first.translation
    np.testing.assert_allclose(way, by if axes == "world" else last.rotation @ by, atol=3e-4)
    np.testing.assert_array_equal(reach.q[0, :4], reach.q[-1, :4])  # the base stands
    assert Deformer(silvermate, DeformParams()).certify(drive, scene.with_obstacle(CRATE)).certified
    for strip, world in ((drive, scene.with_obstacle(CRATE)), (reach, scene)):
        assert min(link_distances(silvermate, world, q).min() for q in strip.sample(0.1)) > 0.0


def test_a_drive_keeps_what_it_has_to(silvermate):
    start = silvermate.home()
    level = OrientationConstraint.from_configuration(silvermate, start, HAND)
    report = plan_approach(
        silvermate, Scene([TABLE]), start, places(silvermate, (2.55, 0.0, 0.95)), (0.0, 0.0, -0.1), axes="world",
        constraint=level,
    )  # fmt: skip
    assert report.certified, report.reason
    assert report.drive is not None
    assert ConstraintForce(silvermate, level).missed(report.drive.strip) == ""


def test_a_place_from_which_there_is_no_way_says_why(silvermate):
    lid = Box((1.6, 2.0, 0.05), at=(2.8, 0.0, 1.35), name="lid")  # from above there is no room
    report = plan_approach(
        silvermate, Scene([TABLE, lid]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95)), (0.0, 0.0, -0.5),
        axes="world",
    )  # fmt: skip
    assert not report.certified
    assert "configurations has a way to it: " in report.reason
    assert "lid" in report.reason or "gets no further than" in report.reason


def test_how_busy_a_machine_is_changes_nothing(silvermate, monkeypatch):
    """Time goes a second further whenever anybody looks, or none at all."""
    box = Box((0.4, 0.8, 1.2), at=(1.2, 0.0, 0.6), name="box")  # the straight line is not free
    found = []
    for step in (0.0, 1.0):
        clock = count(0.0, step)
        for module in (problem, initial_strip):
            monkeypatch.setattr(module, "perf_counter", lambda clock=clock: next(clock))
        report = plan_approach(
            silvermate, Scene([TABLE, box]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95)),
            (0.0, 0.0, -0.1), axes="world",
        )  # fmt: skip
        assert report.certified, report.reason
        assert report.drive is not None
        assert report.reach is not None
        found.append((report.drive.strip.q, report.reach.strip.q, report.reason))
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


def test_wrong_input_is_refused(silvermate):
    scene, start, by = Scene([]), silvermate.home(), (0.1, 0.0, 0.0)
    one = HandPose(HAND, (2.0, 0.0, 0.9))
    with refused(ParameterError, "HandPoses"):
        plan_approach(silvermate, scene, start, [], by)
    with refused(ParameterError, "HandPoses"):
        plan_approach(silvermate, scene, start, [one, HandPose("base_link", (0.0, 0.0, 0.0))], by)
    with refused(ParameterError, "HandPoses"):
        plan_approach(silvermate, scene, start, [one, BasePose(1.0, 0.0)], by)  # type: ignore[list-item]
    with refused(ParameterError, "axes='tool'"):
        plan_approach(silvermate, scene, start, one, by, axes="tool")
    with refused(ParameterError, "by"):
        plan_approach(silvermate, scene, start, one, (0.1, 0.0))
    with refused(ParameterError, "work=0.0"):
        plan_approach(silvermate, scene, start, one, by, work=0.0)
    with refused(ParameterError, "timeout=nan"):
        plan_approach(silvermate, scene, start, one, by, timeout=np.nan)
    with pytest.raises(RobotError, match="did you mean"):
        plan_approach(silvermate, scene, start, HandPose("hand_fram", (2.0, 0.0, 0.9)), by)
    with refused(ConfigurationError, "start"):
        plan_approach(silvermate, scene, start, one, by, beyond=Scene([Box((1.0, 1.0, 1.0), at=(0.0, 0.0, 0.5))]))
    with refused(GoalError, "reach"):
        plan_approach(silvermate, scene, start, HandPose(HAND, (2.0, 0.0, 9.0)), by)
