"""Tasks become steps: who reaches from where it stands does not drive, and what cannot be reached is said."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances
from cases import refused

from elastic_strips.control.tasks import (
    DeliberativeLayer,
    DriveAndReach,
    DriveTo,
    ReachHand,
    StepKind,
)
from elastic_strips.errors import ParameterError, RobotError
from elastic_strips.scene import Box, Scene

TABLE = Box((0.8, 1.2, 0.05), at=(3.0, 0.0, 0.7), name="table")
CRATE = Box((0.4, 0.4, 1.0), at=(1.5, 0.3, 0.5), name="crate")
SCENE = Scene([TABLE, CRATE])


@pytest.fixture
def layer(silvermate):
    return DeliberativeLayer(silvermate, seed=1)


def placement(robot, q, frame="hand_frame"):
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, robot.model.getFrameId(frame))


def test_driving_keeps_the_arm(layer, silvermate):
    here = silvermate.home(joints={"arm_1_joint": 0.4})
    (step,) = layer.decompose(DriveTo(3.0, 2.0, 1.0), here, SCENE).steps
    assert step.kind is StepKind.NAVIGATION
    np.testing.assert_allclose(silvermate.space.to_coordinates(step.q)[:3], (3.0, 2.0, 1.0))
    np.testing.assert_array_equal(step.q[4:], here[4:])


def test_what_is_near_is_reached_from_here(layer, silvermate):
    here, target = silvermate.home(), (0.3, -0.1, 0.9)
    (step,) = layer.decompose(ReachHand(target), here, SCENE).steps
    assert step.kind is StepKind.MANIPULATION
    np.testing.assert_array_equal(step.q[:4], here[:4])
    np.testing.assert_allclose(placement(silvermate, step.q).translation, target, atol=2e-3)


def test_what_is_far_is_driven_to_first(layer, silvermate):
    target = (2.9, 0.1, 0.85)
    drive, reach = layer.decompose(ReachHand(target), silvermate.home(), SCENE).steps
    assert (drive.kind, reach.kind) == (StepKind.NAVIGATION, StepKind.MANIPULATION)
    np.testing.assert_allclose(drive.q[:4], reach.q[:4], atol=1e-12)
    np.testing.assert_array_equal(drive.q[4:], silvermate.home()[4:])
    np.testing.assert_allclose(placement(silvermate, reach.q).translation, target, atol=2e-3)
    for step in (drive, reach):
        assert link_distances(silvermate, SCENE, step.q).min() > 0.0


def test_the_arm_has_room_where_the_base_drives_to(silvermate):
    """The base drives with the arm as it is: there, too, nothing may be touched. Whatever the places it begins at."""
    scene = Scene([Box((0.5, 0.8, 0.05), at=(4.6, 0.0, 0.6), name="shelf")])
    target, home = (4.5, 0.1, 0.85), silvermate.home()
    for seed in range(6):
        plan = DeliberativeLayer(silvermate, seed=seed).decompose(ReachHand(target), home, scene)
        assert len(plan.steps) == 2, f"seed {seed}: {plan.reason}"
        drive, reach = (step.q for step in plan.steps)
        np.testing.assert_allclose(placement(silvermate, reach).translation, target, atol=2e-3)
        np.testing.assert_allclose(drive, np.concatenate((reach[:4], home[4:])), atol=1e-12)
        for q in (drive, reach):
            assert link_distances(silvermate, scene, q).min() > 0.0, seed


def test_both_at_once_is_one_goal(layer, silvermate):
    task = DriveAndReach(DriveTo(2.2, 0.0, 0.0), ReachHand((2.7, -0.1, 0.9), (0.0, 0.0, 0.0, 1.0)))
    (step,) = layer.decompose(task, silvermate.home(), SCENE).steps
    assert step.kind is StepKind.WHOLE_BODY
    there = placement(silvermate, step.q)
    np.testing.assert_allclose(there.translation, (2.7, -0.1, 0.9), atol=2e-3)
    assert np.linalg.norm(pin.log3(there.rotation)) < 1e-2
    np.testing.assert_allclose(silvermate.space.to_coordinates(step.q)[:3], (2.2, 0.0, 0.0))


def test_what_cannot_be_reached_is_said(layer, silvermate):
    deliberation = layer.decompose(ReachHand((2.9, 0.0, 2.9)), silvermate.home(), SCENE)
    assert deliberation.steps == ()
    assert "out of reach" in deliberation.reason
    inside = layer.decompose(ReachHand((3.0, 0.0, 0.7)), silvermate.home(), SCENE)
    assert inside.steps == ()
    assert "would touch something" in inside.reason
    assert "table" in inside.reason


def test_wrong_tasks_are_refused(layer, silvermate):
    with refused(ParameterError, "DriveTo"):
        DriveTo(0.0, np.nan, 0.0)
    with refused(ParameterError, "position"):
        ReachHand((0.0, 1.0))  # type: ignore[arg-type]
    with refused(ParameterError, "length"):
        ReachHand((0.0, 1.0, 1.0), (0.0, 0.0, 0.0, 2.0))
    with refused(RobotError, "hand_fram"):
        layer.decompose(ReachHand((0.3, 0.0, 0.9), frame="hand_fram"), silvermate.home(), SCENE)
