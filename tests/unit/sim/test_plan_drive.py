"""Driving a plan: what is certified is driven as it was planned, what is not is refused."""

from __future__ import annotations

import numpy as np
import pytest
from cases import refused

from elastic_strips.control import DriveParams
from elastic_strips.errors import ParameterError
from elastic_strips.planning import plan_report, plan_straight
from elastic_strips.scene import Box, Cylinder, Scene
from elastic_strips.sim import PlantParams, drive_plan
from elastic_strips.trajectory import MotionLimits

SCENE = Scene([Box((0.4, 0.4, 1.0), at=(1.6, 0.6, 0.5), name="crate")])


def test_a_plan_is_driven_to_its_end(silvermate):
    far = DriveParams()
    plan = plan_report(silvermate, SCENE, silvermate.home(), silvermate.home(x=3.0), params=far.strip)
    result, q = drive_plan(plan, SCENE, far, seed=3)
    assert result.reached, result.reason
    np.testing.assert_array_equal(silvermate.space.to_coordinates(q), result.last)
    off = silvermate.space.difference(result.last[None], plan.strip.coordinates[-1:])[0]
    assert np.hypot(*off[:2]) < far.goal_position + 1e-6
    assert result.record.robot == silvermate.name


def test_computing_costs_what_it_is_said_to(silvermate):
    far = DriveParams()
    plan = plan_report(silvermate, SCENE, silvermate.home(), silvermate.home(x=1.0), params=far.strip)
    result, _ = drive_plan(plan, SCENE, far, compute="work")
    assert result.reached, result.reason
    assert result.record.duration > 0.0
    with refused(ParameterError, "compute"):
        drive_plan(plan, SCENE, far, compute="later")


def test_what_is_held_is_driven_with_it(silvermate):
    near = DriveParams.standing()
    assert near.clearance < DriveParams().clearance
    can = Cylinder(0.03, 0.12, at=(0.0, 0.0, 0.1), name="can")
    laden = silvermate.attached(can, "hand_frame", mass=0.3)
    plan = plan_straight(laden, SCENE, laden.home(), "hand_frame", (0.0, 0.0, 0.05), params=near.strip)
    result, q = drive_plan(plan, SCENE, near, plant=PlantParams.seen_closely())
    assert result.reached, result.reason
    placed, wanted = laden.frame_pose(q, "hand_frame"), laden.frame_pose(plan.strip.q[-1], "hand_frame")
    assert np.linalg.norm(placed[:3, 3] - wanted[:3, 3]) < 0.03


def test_what_is_not_certified_is_not_driven(silvermate):
    wall = Scene([Box((0.1, 40.0, 2.0), at=(1.5, 0.0, 1.0), name="wall")])
    plan = plan_report(
        silvermate, wall, silvermate.home(), silvermate.home(x=3.0), timeout=0.2, bounds=((-1, -1), (4, 1))
    )
    assert not plan.certified
    with refused(ParameterError, "wall"):
        drive_plan(plan, wall)
    with refused(ParameterError, "plan"):
        drive_plan([], wall)  # type: ignore[arg-type]


def test_limits_are_those_of_robot_and_plant(silvermate):
    slow = MotionLimits.for_robot(silvermate).scaled(0.5, 0.5)
    plan = plan_report(silvermate, SCENE, silvermate.home(), silvermate.home(x=3.0), params=DriveParams().strip)
    fast_run, _ = drive_plan(plan, SCENE)
    slow_run, _ = drive_plan(plan, SCENE, limits=slow)
    assert slow_run.reached
    assert slow_run.record.duration > 1.2 * fast_run.record.duration


def test_the_parameters_of_a_base_that_stands_can_be_changed():
    assert DriveParams.standing(margin=0.004).clearance == pytest.approx(0.011)
    with refused(ParameterError, "speed_scale"):
        DriveParams.standing(speed_scale=0.0)
