"""A hand that stays level: plans satisfy it from end to end, by brute force too, or say what stands in the way."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from cases import refused

from elastic_strips.errors import ConfigurationError, GoalError, ParameterError
from elastic_strips.planning import BasePose, plan, plan_report
from elastic_strips.planning.joint_search import search_joints
from elastic_strips.planning.problem import Deadline, PlanningProblem
from elastic_strips.planning.validity import SatisfyingChecker, ValidityChecker
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Scene, Sphere
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, OrientationConstraint, Strip
from elastic_strips.strip.constraint import ConstraintForce

JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))
WALL = Scene([Box((0.7, 0.02, 0.5), at=(0.55, 0.0, 0.3), name="wall")])


def tilt(strip: Strip, constraint: OrientationConstraint) -> float:
    """The largest angle [rad] between axis and direction on a strip, by Pinocchio, densely."""
    model, data = strip.robot.model, strip.robot.model.createData()
    frame, worst = model.getFrameId(constraint.frame), 0.0
    axis, direction = (np.array(v) / np.linalg.norm(v) for v in (constraint.axis, constraint.direction))
    for q in strip.sample(0.02):
        pin.forwardKinematics(model, data, q)
        a = pin.updateFramePlacement(model, data, frame).rotation @ axis
        worst = max(worst, float(np.arctan2(np.linalg.norm(np.cross(a, direction)), a @ direction)))
    return worst


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda", joints=JOINTS)


def level_ends(panda: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    """The hand on both sides of the wall, as level as at home."""
    return panda.home(panda_joint1=-0.7), panda.home(panda_joint1=0.7)


def test_a_robot_drives_with_a_level_hand(silvermate):
    for seed in (0, 1):
        scenario = get_scenario("corridor", seed=seed)
        start, goal = scenario.ends(silvermate)
        level = OrientationConstraint.from_configuration(silvermate, start, "hand_frame", tolerance=0.05)
        report = plan_report(silvermate, scenario.scene, start, goal, constraint=level, timeout=60.0)
        assert report.certified, report.reason
        assert tilt(report.strip, level) <= 0.05
        assert Deformer(silvermate).certify(report.strip, scenario.scene).certified


def test_an_arm_moves_a_level_hand_over_a_wall(panda):
    start, goal = level_ends(panda)
    level = OrientationConstraint.from_configuration(panda, start, "panda_hand")
    report = plan_report(panda, WALL, start, goal, constraint=level, timeout=60.0)
    assert report.certified, report.reason
    assert tilt(report.strip, level) <= level.tolerance
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-15)


def test_a_search_that_projects_finds_a_path_that_can_be_projected(panda):
    start, goal = level_ends(panda)
    force = ConstraintForce(panda, OrientationConstraint.from_configuration(panda, start, "panda_hand"))
    checker = SatisfyingChecker(ValidityChecker(panda, WALL, margin=0.01), force)
    ends = panda.space.to_coordinates(np.stack((start, goal)))
    corners = search_joints(
        checker, ends, seed=1, planner="RRTConnect", step=0.1, timeout=60.0, deadline=Deadline(60.0)
    )
    assert corners is not None
    rows, off = force.project(corners)
    assert off.max() <= 0.5 * force.constraint.tolerance
    assert all(ValidityChecker(panda, WALL, margin=0.01).at(row) for row in rows)


def test_ends_that_do_not_satisfy_it_are_refused(panda):
    start, goal = level_ends(panda)
    level = OrientationConstraint.from_configuration(panda, start, "panda_hand")
    tilted = panda.home(panda_joint6=2.5)
    with refused(ConfigurationError, "goal", "constraint", "'panda_hand'"):
        plan(panda, Scene([]), start, tilted, constraint=level)
    with refused(ConfigurationError, "start"):
        plan(panda, Scene([]), tilted, goal, constraint=level)


def test_of_a_goal_only_what_satisfies_it_counts(silvermate):
    start = silvermate.home()
    level = OrientationConstraint.from_configuration(silvermate, start, "hand_frame")
    report = plan_report(silvermate, Scene([]), start, BasePose(2.0, 1.0), constraint=level)
    assert report.certified
    assert tilt(report.strip, level) <= level.tolerance
    with refused(GoalError, "'hand_frame'"):
        plan(silvermate, Scene([]), start, {"arm_6_joint": start[-2] + 0.8}, constraint=level)


def test_a_strip_that_misses_it_is_of_no_use(panda):
    start, goal = level_ends(panda)
    level = OrientationConstraint.from_configuration(panda, start, "panda_hand")
    problem = PlanningProblem(panda, Scene([]), start, goal, constraint=level)
    middle = panda.home(panda_joint6=2.2)  # the hand is level but here
    strip = Strip(panda, np.stack((start, middle, goal)))
    assert tilt(strip, level) > 0.3
    report = Deformer(panda).assess(strip, Scene([]))
    assert report.usable
    assert "panda_hand is up to" in problem.failure(report)


def test_a_deformer_brings_its_own(silvermate):
    start = silvermate.home()
    level = OrientationConstraint.from_configuration(silvermate, start, "hand_frame")
    with refused(ParameterError, "deformer"):
        plan_report(silvermate, Scene([]), start, start, deformer=Deformer(silvermate), constraint=level)
    ball = Scene([Sphere(0.2, at=(2.4, 0.15, 1.15))])  # in the way of the arm alone
    report = plan_report(
        silvermate, ball, start, silvermate.home(x=4.0), deformer=Deformer(silvermate, constraint=level)
    )
    assert report.certified
    assert tilt(report.strip, level) <= level.tolerance
