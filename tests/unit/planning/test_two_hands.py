"""Several poses at once: both hands of a PR2, with its base or without; what is missed is said of each frame."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances
from cases import refused

from elastic_strips.errors import ConfigurationError, GoalError, ParameterError, RobotError
from elastic_strips.planning import AllOf, BasePose, HandPose, find_goals, plan, plan_report
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.inverse_kinematics import PoseSolver, PoseTarget
from elastic_strips.scene import Box, Cylinder, Scene

LEFT, RIGHT = "l_gripper_tool_frame", "r_gripper_tool_frame"
TABLE = Box((0.6, 1.4, 0.7), at=(3.5, 1.0, 0.35), name="table")
SCENE = Scene([TABLE, Cylinder(0.2, 1.5, at=(1.6, 0.4, 0.75), name="pillar")])
AHEAD = (0.0, 0.0, 0.0, 1.0)
TRAY = AllOf(HandPose(LEFT, (3.35, 1.2, 0.85), AHEAD), HandPose(RIGHT, (3.35, 0.8, 0.85), AHEAD))


@pytest.fixture(scope="module")
def pr2() -> RobotModel:
    return load_robot("pr2")


def missed(robot: RobotModel, q: np.ndarray, goal: HandPose) -> tuple[float, float]:
    """Distance [m] and angle [rad] of a frame from its pose, by Pinocchio."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    T = data.oMf[robot.model.getFrameId(goal.frame)]
    turn = np.zeros(3)
    if goal.orientation is not None:
        turn = pin.log3(T.rotation.T @ pin.Quaternion(np.array(goal.orientation)).matrix())
    return float(np.linalg.norm(T.translation - goal.position)), float(np.linalg.norm(turn))


def test_a_robot_drives_to_where_both_hands_are_at_their_poses(pr2):
    report = plan_report(pr2, SCENE, pr2.home(), TRAY)
    assert report.certified, report.reason
    for goal in TRAY.hands:
        distance, angle = missed(pr2, report.strip.q[-1], goal)
        assert distance < 2e-4
        assert angle < 2e-3
    assert report.method != "line", "the pillar is in the way"
    assert min(link_distances(pr2, SCENE, q).min() for q in report.strip.sample(0.2)) > 0.0


def test_poses_by_frame_are_the_same(pr2):
    named = {goal.frame: goal for goal in TRAY.hands}
    found = [find_goals(pr2, SCENE, pr2.home(), goal, seed=3).configurations for goal in (TRAY, named)]
    assert len(found[0]) > 1
    np.testing.assert_array_equal(*found)
    places = {goal.frame: goal.position for goal in TRAY.hands}
    poses = {goal.frame: pin.XYZQUATToSE3(np.array((*goal.position, *AHEAD))).homogeneous for goal in TRAY.hands}
    for given, turned in ((places, False), (poses, True)):
        q = find_goals(pr2, SCENE, pr2.home(), given).configurations[0]
        for goal in TRAY.hands:
            distance, angle = missed(pr2, q, goal)
            assert distance < 2e-4
            assert angle < 2e-3 or not turned


def test_a_base_that_stands_and_one_in_a_region(pr2):
    home = pr2.home()
    for q in find_goals(pr2, SCENE, home, AllOf(*TRAY.hands, BasePose(2.65, 1.0, 0.1))).configurations:
        np.testing.assert_allclose(pr2.space.to_coordinates(q)[:3], (2.65, 1.0, 0.1), atol=1e-12)
        assert max(missed(pr2, q, goal)[0] for goal in TRAY.hands) < 2e-4
    region = find_goals(pr2, SCENE, home, AllOf(*TRAY.hands, BasePose(2.65, 1.0, within=(0.05, 0.02)))).configurations
    assert len(region) > 1
    for q in region:
        assert (np.abs(q[:2] - (2.65, 1.0)) <= (0.0502, 0.0202)).all()
        assert max(missed(pr2, q, goal)[0] for goal in TRAY.hands) < 2e-4
    alone = find_goals(pr2, SCENE, home, AllOf(BasePose(1.0, -1.0, 0.2))).configurations
    np.testing.assert_array_equal(alone, find_goals(pr2, SCENE, home, BasePose(1.0, -1.0, 0.2)).configurations)


def test_hands_too_far_apart_are_said_one_by_one(pr2):
    far = AllOf(HandPose(LEFT, (3.35, 1.2, 0.85)), HandPose(RIGHT, (3.35, -3.8, 0.85)))
    search = find_goals(pr2, SCENE, pr2.home(), far)
    assert len(search.configurations) == 0
    assert set(search.misses) == {LEFT, RIGHT}
    assert sum(distance for distance, _ in search.misses.values()) > 1.5  # 5 m apart, and arms of less than 1.7 m
    assert search.distance == max(distance for distance, _ in search.misses.values())
    assert LEFT in search.reason
    assert RIGHT in search.reason
    with refused(GoalError, LEFT, RIGHT):
        plan(pr2, SCENE, pr2.home(), far)
    (one,) = find_goals(pr2, SCENE, pr2.home(), HandPose(LEFT, (3.0, 0.0, 4.0))).misses.items()
    assert one[0] == LEFT
    assert one[1][0] > 1.0


def test_a_list_is_for_one_frame_or_says_what_is_meant(pr2):
    left, right = TRAY.hands
    with refused(ParameterError, "AllOf", LEFT, RIGHT):
        plan(pr2, SCENE, pr2.home(), [left, right])
    beyond = HandPose(RIGHT, (0.0, 0.0, 5.0))
    (q, *_) = find_goals(pr2, SCENE, pr2.home(), [AllOf(beyond), AllOf(left)]).configurations
    assert missed(pr2, q, left)[0] < 2e-4
    either = find_goals(pr2, SCENE, pr2.home(), [left, HandPose(LEFT, (3.35, 0.8, 0.85))]).configurations
    assert len(either) > 1


def test_what_cannot_be_meant_is_refused(pr2, silvermate):
    left, right = TRAY.hands
    with refused(ParameterError, "AllOf"):
        AllOf()
    with refused(ParameterError, "ndarray"):
        AllOf(left, np.zeros(3))  # type: ignore[arg-type]
    with refused(ParameterError, LEFT):
        AllOf(left, right, HandPose(LEFT, (0.0, 0.0, 1.0)))
    with refused(ParameterError, "base"):
        AllOf(BasePose(0.0, 0.0), BasePose(1.0, 0.0))
    home = pr2.home()
    for wrong in ({LEFT: right}, {LEFT: left, "x": 1.0}, {LEFT: np.zeros(2)}, {LEFT: 2.0 * np.eye(4)}):
        with pytest.raises(ParameterError, match=LEFT):
            find_goals(pr2, SCENE, home, wrong)  # type: ignore[arg-type]
    with refused(RobotError, "'l_gripper'"):
        find_goals(pr2, SCENE, home, {"l_gripper": (1.0, 0.0, 1.0)})  # type: ignore[arg-type]
    fixed = load_robot("panda")
    with refused(ConfigurationError, "'panda'"):
        find_goals(fixed, Scene(), fixed.home(), AllOf(HandPose("panda_hand", (0.4, 0.0, 0.5)), BasePose(0.0, 0.0)))


def test_jacobians_of_two_frames_are_the_slopes_of_their_errors(pr2, rng):
    solver, space, h = PoseSolver(pr2, LEFT, RIGHT), pr2.space, 1e-6
    row = pr2.space.to_coordinates(pr2.home())
    row += 0.2 * rng.uniform(-1.0, 1.0, len(row))
    targets = [PoseTarget.of(frame, (1.0, 0.2, 0.8), None, np.zeros(3)) for frame in (LEFT, RIGHT)]
    solver.place(row[None])
    J = solver._jacobians(1, [False, True])[0]
    assert J.shape == (9, pr2.nv)
    for k in range(space.nv):
        step = h * np.eye(space.nv)[k]
        up, down = (
            np.concatenate([off[0] for off, _ in solver.errors(space.integrate(row[None], s * step[None]), targets)])
            for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(J[:6, k], (down - up) / (2.0 * h), atol=1e-6)
