"""A hand that keeps looking at something: plans and drives satisfy it from end to end, by Pinocchio too."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from cases import refused

from elastic_strips.control import DriveParams
from elastic_strips.errors import GoalError, SceneError
from elastic_strips.planning import AllOf, BasePose, HandPose, find_goals, plan, plan_report
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Twist
from elastic_strips.sim import drive_plan
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, LookAt
from elastic_strips.strip.constraint import ConstraintForce

WALLS = [Box((9.0, 0.1, 1.2), at=(3.0, side * 1.6, 0.6), name=f"wall {side}") for side in (-1, 1)]
POSTS = [Cylinder(0.2, 1.2, at=(2.0 + 2.0 * k, 0.75 - 1.5 * k, 0.6), name=f"post {k}") for k in (0, 1)]


def off(robot: RobotModel, rows: np.ndarray, look: LookAt, places: np.ndarray) -> np.ndarray:
    """(N,) angle [rad] between axis and place at coordinate rows (N, nv), by Pinocchio."""
    model, data, out = robot.model, robot.model.createData(), []
    axis = np.array(look.axis) / np.linalg.norm(look.axis)
    for q, place in zip(robot.space.from_coordinates(rows), np.broadcast_to(places, (len(rows), 3)), strict=True):
        pin.forwardKinematics(model, data, q)
        T = pin.updateFramePlacement(model, data, model.getFrameId(look.frame))
        a, line = T.rotation @ axis, place - T.translation
        out.append(np.arctan2(np.linalg.norm(np.cross(a, line)), a @ line))
    return np.array(out)


@pytest.mark.parametrize(("seed", "at"), [(1, (5.0, -3.0, 1.0)), (3, (2.5, 3.0, 0.5))])
def test_a_robot_drives_a_corridor_and_looks_at_something_all_the_way(silvermate, seed, at):
    """At the side of the corridor: the hand turns by half a turn against the base."""
    scenario = get_scenario("corridor", seed=seed)
    target = Sphere(0.1, at=at, name="target")
    scene = scenario.scene.with_obstacle(target)
    look = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at="target")
    begin, end = (BasePose(*silvermate.space.to_coordinates(q)[:3].tolist()) for q in scenario.ends(silvermate))
    start = find_goals(silvermate, scene, silvermate.home(), begin, constraint=look).configurations[0]
    report = plan_report(silvermate, scene, start, end, constraint=look, timeout=60.0)
    assert report.certified, report.reason
    rows = silvermate.space.to_coordinates(report.strip.sample(0.02))
    assert off(silvermate, rows, look, np.array(at)).max() <= look.tolerance
    assert Deformer(silvermate).certify(report.strip, scene).certified


@pytest.mark.parametrize(
    ("at", "velocity"),
    [((9.0, -1.0, 1.5), (0.0, 0.4, 0.0)), ((9.0, -1.0, 1.5), (0.0, -0.6, 0.0)), ((3.0, -3.0, 1.5), None)],
    ids=str,
)
def test_a_driven_hand_follows_what_moves(silvermate, at, velocity):
    scene = Scene([*WALLS, *POSTS, Sphere(0.1, at=at, name="ball", motion=velocity and Twist(velocity))])
    look, worst = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at="ball"), {}
    start = find_goals(silvermate, scene, silvermate.home(), BasePose(0.0, 0.0, 0.0), constraint=look).configurations[0]
    later = scene.at(8.0)  # about when it is there: the goal's posture stays as it is
    end = find_goals(silvermate, later, start, BasePose(6.0, 0.0, 0.0), constraint=look).configurations[0]
    for keep in (look, None):
        params = DriveParams(constraint=keep)
        report = plan_report(silvermate, scene, start, end, params=params.strip, constraint=None if velocity else keep)
        result, _ = drive_plan(report, scene, params, seed=0)
        assert result.state.label == "reached"
        control = result.record.control
        places = np.array([scene.at(float(t)).obstacle("ball").pose[:3, 3] for t in control.time])
        worst[keep] = off(silvermate, control.coordinates, look, places).max()
    assert worst[look] <= look.tolerance
    assert worst[None] > 1.5 * look.tolerance, "else nothing was kept"


def test_hands_at_their_places_while_the_head_looks_at_them():
    robot = load_robot("pr2")
    left, right = HandPose("l_gripper_tool_frame", (3.0, 1.2, 0.9)), HandPose("r_gripper_tool_frame", (3.0, 0.8, 0.9))
    camera = LookAt(
        frame="wide_stereo_gazebo_l_stereo_camera_optical_frame", axis=(0.0, 0.0, 1.0), at=(3.0, 1.0, 0.9)
    )  # fmt: skip
    found = find_goals(robot, Scene(), robot.home(), AllOf(left, right), constraint=camera).configurations
    assert len(found) > 0
    rows = robot.space.to_coordinates(found)
    assert off(robot, rows, camera, np.array(camera.at)).max() <= camera.tolerance
    for hand in (left, right):
        for q in found:
            np.testing.assert_allclose(robot.frame_pose(q, hand.frame)[:3, 3], hand.position, atol=2e-4)


def test_a_base_s_goal_has_the_joints_that_look(silvermate):
    look = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at=(3.0, 2.0, 1.0), tolerance=0.05)
    home = silvermate.home()
    for goal in (BasePose(1.0, 0.5, 0.3), AllOf(BasePose(1.0, 0.5, 0.3)), BasePose(1.0, 0.5, within=(0.2, 0.1))):
        found = find_goals(silvermate, Scene(), home, goal, constraint=look).configurations
        assert len(found) > 0
        rows = silvermate.space.to_coordinates(found)
        assert off(silvermate, rows, look, np.array(look.at)).max() <= look.tolerance
    np.testing.assert_allclose(rows[:, :2], np.tile((1.0, 0.5), (len(rows), 1)), atol=0.2)
    behind = LookAt(frame="head_frame", axis=(1.0, 0.0, 0.0), at=(-3.0, 0.5, 1.0))  # no joint turns the head
    search = find_goals(silvermate, Scene(), home, BasePose(1.0, 0.5, 0.0), constraint=behind)
    assert len(search.configurations) == 0
    assert "constraint" in search.reason


def test_what_is_looked_at_has_to_be_there(silvermate):
    look = LookAt(frame="hand_frame", at="bal")
    scene = Scene([Sphere(0.1, at=(3.0, 2.0, 1.0), name="ball")])
    home = silvermate.home()
    with refused(SceneError, "ball"):
        plan(silvermate, scene, home, silvermate.home(x=1.0), constraint=look)
    with refused(SceneError, "ball"):
        plan(silvermate, scene, home, BasePose(1.0, 0.0), constraint=look)
    with refused(SceneError, "ball"):
        plan_report(silvermate, scene, home, silvermate.home(x=1.0), deformer=Deformer(silvermate, constraint=look))
    with refused(GoalError, "hand_frame"):
        there = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at="ball")
        plan(silvermate, scene, home, {"x": 1.0}, constraint=there)


def test_neighbours_on_a_path_are_projected_to_one_posture(silvermate):
    """Past the place the hand has to turn half about."""
    look = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at=(1.5, 3.0, 0.9))
    home, space = silvermate.home(), silvermate.space
    start, end = (
        find_goals(silvermate, Scene(), home, BasePose(x, 0.0, 0.0), constraint=look).configurations[0]
        for x in (0.0, 3.0)
    )
    rows = space.to_coordinates(np.stack((start, end)))
    path = space.interpolate(rows[:1], rows[1:], np.linspace(0.0, 1.0, 61))
    force = ConstraintForce(silvermate, look)
    together = force.project_path(path)
    np.testing.assert_array_equal(together[[0, -1]], path[[0, -1]])
    assert force.errors_at(together).max() <= look.tolerance
    assert np.abs(np.diff(together[:, 3:], axis=0)).max() < 0.3
