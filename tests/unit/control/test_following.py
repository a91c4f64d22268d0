"""A path that is followed: the robot keeps to it within a distance, and waits where it cannot go on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from cases import each, refused
from hypothesis import example, given
from hypothesis import strategies as st
from simulated_time import planning_at_once

from elastic_strips import load_robot
from elastic_strips.control import Controller, DriveParams, RunState
from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.scene import Box, Scene
from elastic_strips.sim import KinematicPlant
from elastic_strips.strip import OrientationConstraint
from elastic_strips.strip.followed import FollowedPath
from elastic_strips.strip.solver import System

PATH = np.array([(0.0, 0.0), (1.5, 0.0), (3.0, 1.0), (4.5, 1.0), (6.0, 0.0)])
BESIDE = Box((0.4, 0.4, 1.0), at=(1.9, -0.3, 0.5), name="beside")
GATE = Box((0.2, 2.5, 1.0), at=(4.3, 1.0, 0.5), name="gate")
DT = 0.01


def off_path(places):
    """Distance of places (N, 2) from the path, by looking at it every millimetre."""
    dense = np.vstack([np.linspace(a, b, 1500) for a, b in pairwise(PATH)])
    return np.array([np.hypot(*(dense - place).T).min() for place in places])


def followed(robot, within, scene, *, path=PATH, wait=True, seconds=60.0):
    """A controller that has followed a path until it ended or halted, and the true places of the base."""
    controller = Controller(robot, robot.home(), robot.home(), scene(0.0), workers=planning_at_once())
    plant = KinematicPlant(robot, controller.limits, seed=1)
    plant.reset(robot.space.to_coordinates(robot.home()))
    measured, places = None, []
    for k in range(round(seconds / DT)):
        if k == 5:
            controller.follow(path, within=within, wait=wait)
        measured = plant.step(controller.step(k * DT, measured, scene(k * DT)), DT)
        places.append(plant.coordinates[:2].copy())
        if k > 10 and (controller.ended or controller.halted):
            break
    return controller, np.array(places)


@each("name", ["silvermate", "tiago_omni"])
def test_it_keeps_to_the_path_past_what_stands_beside_it(request, name):
    controller, places = followed(request.getfixturevalue(name), 0.4, lambda t: Scene([BESIDE], time=t))
    assert controller.state is RunState.REACHED, controller.reason
    assert off_path(places).max() <= 0.4
    np.testing.assert_allclose(places[-1], PATH[-1], atol=0.06)


def test_it_waits_for_what_is_in_the_way_and_says_for_what(silvermate):
    opens = 10.0
    controller, places = followed(silvermate, 0.3, lambda t: Scene([GATE] if t < opens else [], time=t))
    assert controller.state is RunState.REACHED, controller.reason
    assert off_path(places).max() <= 0.3
    waits = [event for event in controller.events if event.kind == "waiting"]
    assert waits
    assert any("gate" in event.reason for event in waits)
    assert all(event.time < opens + 0.5 for event in waits)
    assert controller.replans == 0


def test_next_to_what_bounds_it_the_robot_turns_on_the_spot(silvermate):
    """It looks out of the border, and any arc from there leads beyond it."""
    along, left = np.array((np.cos(0.5), -np.sin(0.5))), np.array((np.sin(0.5), np.cos(0.5)))
    path = np.array([-0.27 * left - along, -0.27 * left + 4.0 * along])
    controller, places = followed(silvermate, 0.3, lambda t: Scene([], time=t), path=path)
    assert controller.state is RunState.REACHED, controller.reason
    assert FollowedPath(path, 0.3).off(places).max() <= 0.3
    np.testing.assert_allclose(places[-1], path[-1], atol=0.06)


def test_where_it_is_not_to_wait_the_path_is_given_up_with_the_reason(silvermate):
    controller, places = followed(silvermate, 0.3, lambda t: Scene([GATE], time=t), wait=False)
    assert controller.halted
    assert controller.state is RunState.STOPPED
    assert "gate" in controller.reason
    assert places[-1][0] < 4.2
    assert controller.time - controller.stops[0][0] < 10.0, "to and fro is not on"
    controller.retarget(silvermate.home())
    assert not controller.halted


def test_it_arrives_with_the_heading_that_is_given(silvermate):
    path = np.column_stack([PATH[:3], [0.0, 0.0, -1.5]])
    controller, places = followed(silvermate, 0.3, lambda t: Scene([], time=t), path=path)
    assert controller.state is RunState.REACHED, controller.reason
    assert controller.goal[2] == pytest.approx(-1.5)
    np.testing.assert_allclose(places[-1], PATH[2], atol=0.06)


class Following:
    """A robot that is asked for something while it drives, and where it was at each step."""

    def __init__(self, robot, scene=lambda t: Scene([], time=t), params=None):
        self.scene = scene
        self.controller = Controller(
            robot, robot.home(), robot.home(), scene(0.0), params=params, workers=planning_at_once()
        )
        self.plant = KinematicPlant(robot, self.controller.limits, seed=1)
        self.plant.reset(robot.space.to_coordinates(robot.home()))
        self.k, self.measured, self.rows, self.speeds = 0, None, [], []

    def run(self, seconds, until=lambda: False):
        end = self.k + round(seconds / DT)
        while self.k < end and not until():
            command = self.controller.step(self.k * DT, self.measured, self.scene(self.k * DT))
            self.measured = self.plant.step(command, DT)
            self.rows.append(self.plant.coordinates.copy())
            self.speeds.append(abs(float(command.drive.mean())))
            self.k += 1
        return self


def posture(robot, name="reach"):
    q = robot.home() if name is None else robot.state(name)
    return robot.space.to_coordinates(q)[robot.space.base_nv :]


def test_the_joints_are_moved_first_and_stay_so_on_the_path(silvermate):
    drive, wanted = Following(silvermate), posture(silvermate)
    drive.run(0.1)
    drive.controller.follow(PATH[:3], within=0.3, joints=wanted)
    assert not drive.controller.ended
    drive.run(60.0, lambda: drive.controller.ended)
    rows = np.array(drive.rows)
    assert drive.controller.ended, drive.controller.reason
    np.testing.assert_allclose(rows[-1, :2], PATH[2], atol=0.06)
    np.testing.assert_allclose(rows[-1, 3:], wanted, atol=0.06)
    left = np.flatnonzero(np.hypot(*rows[:, :2].T) > 0.1)[0]
    assert np.abs(rows[left:, 3:] - wanted).max() < 0.15, "they are there before it sets out, and stay"
    ends = [reached.goal for reached in drive.controller.goals_reached if np.allclose(reached.goal[3:], wanted)]
    assert len(ends) == 1, "only the path's end is a goal"


def test_the_arm_keeps_to_its_task_while_it_gives_way_on_the_path(silvermate):
    """A hand that stays level, past a beam at its height; without the task it tilts there."""
    tilts, beam = [], Box((0.3, 1.2, 0.1), at=(2.2, -0.75, 0.95), name="beam")
    level = OrientationConstraint.from_configuration(silvermate, silvermate.home(), "palm_link")
    for constraint in (level, None):
        drive = Following(silvermate, lambda t: Scene([beam], time=t), DriveParams(constraint=constraint))
        drive.run(0.1)
        drive.controller.follow(PATH, within=0.3)
        drive.run(60.0, lambda controller=drive.controller: controller.ended)
        assert drive.controller.ended, drive.controller.reason
        tilts.append(max(tilt(silvermate, row, level) for row in drive.rows))
    assert tilts[0] < 2.0 * level.tolerance
    assert tilts[1] > 2.0 * tilts[0]


def tilt(robot, row, level):
    """Angle [rad] between the axis that is to point up, and up; from the robot's own kinematics."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.space.from_coordinates(row))
    axis = data.oMf[robot.model.getFrameId(level.frame)].rotation @ np.array(level.axis)
    return float(np.arccos(np.clip(axis[2] / np.linalg.norm(axis), -1.0, 1.0)))


def test_another_path_at_speed_goes_on_with_the_joints_as_they_are_to_be(silvermate):
    drive, wanted = Following(silvermate), posture(silvermate)
    drive.run(0.1)
    drive.controller.follow(PATH, within=0.3, joints=wanted)
    drive.run(1.0)
    drive.controller.follow(PATH, within=0.3, joints=wanted)  # while they move
    drive.run(40.0, lambda: bool(drive.rows) and drive.rows[-1][0] > 1.0)
    since = drive.k
    for joints in (wanted, None):
        drive.controller.follow(PATH, within=0.3, joints=joints)
        drive.run(0.8)
    assert min(drive.speeds[since:]) > 0.2, "nothing stops it"
    drive.run(40.0, lambda: drive.controller.ended)
    np.testing.assert_allclose(drive.rows[-1][3:], wanted, atol=0.06)


def test_at_speed_it_comes_to_rest_to_move_its_joints(silvermate):
    drive, wanted = Following(silvermate), posture(silvermate)
    drive.run(0.1)
    drive.controller.follow(PATH, within=0.3)
    drive.run(2.5)
    assert drive.speeds[-1] > 0.2
    drive.controller.follow(PATH, within=0.3, joints=wanted)
    drive.run(60.0, lambda: drive.controller.ended)
    rows = np.array(drive.rows)
    there = np.flatnonzero(np.abs(rows[:, 3:] - wanted).max(axis=1) < 0.1)[0]
    assert rows[there, 0] < 3.0, "not on the way"
    assert min(drive.speeds[250:there]) < 0.01
    np.testing.assert_allclose(rows[-1, :2], PATH[-1], atol=0.06)
    assert off_path(rows[:, :2]).max() <= 0.3


def test_it_waits_where_the_joints_cannot_be_moved_yet(silvermate):
    """Something hangs where the hand is to be, for a while."""
    wanted, frees = posture(silvermate), 8.0
    before = Box((0.1, 0.6, 0.5), at=(0.56, -0.2, 0.85), name="before")
    drive = Following(silvermate, lambda t: Scene([before] if t < frees else [], time=t))
    drive.run(0.1)
    drive.controller.follow(PATH, within=0.3, joints=wanted)
    drive.run(frees - 0.5)
    assert np.hypot(*drive.rows[-1][:2]) < 0.3
    assert "no way" in drive.controller.reason
    assert not drive.controller.ended
    drive.run(60.0, lambda: drive.controller.ended)
    assert drive.controller.ended, drive.controller.reason
    np.testing.assert_allclose(drive.rows[-1][3:], wanted, atol=0.06)


def test_where_it_is_not_to_wait_for_its_joints_the_path_is_given_up(silvermate):
    before = Box((0.1, 0.6, 0.5), at=(0.56, -0.2, 0.85), name="before")
    drive = Following(silvermate, lambda t: Scene([before], time=t))
    drive.run(0.1)
    drive.controller.follow(PATH, within=0.3, joints=posture(silvermate), wait=False)
    drive.run(10.0, lambda: drive.controller.halted)
    assert drive.controller.halted
    assert "before" in drive.controller.reason


def test_a_robot_without_joints_has_its_posture(jackal_box):
    controller = Controller(jackal_box, jackal_box.home(), jackal_box.home(), Scene([]))
    controller.follow(PATH, within=0.3, joints=posture(jackal_box, None))
    assert controller.keeper.path is not None


def test_what_is_no_posture_is_refused(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=1.0), Scene([]))
    for joints, error in (
        (np.zeros(3), ParameterError),
        (np.full(7, np.nan), ParameterError),
        (np.full(7, 9.0), ConfigurationError),
    ):
        with pytest.raises(error):
            controller.follow(PATH, within=0.3, joints=joints)


def test_what_cannot_be_followed_is_refused(silvermate):
    controller = Controller(silvermate, silvermate.home(), silvermate.home(x=1.0), Scene([]))
    for path, within, error in (
        (PATH + np.array((0.0, 0.5)), 0.3, ConfigurationError),
        (PATH, 0.01, ParameterError),
        (PATH, float("nan"), ParameterError),
        (PATH[:1], 0.3, ParameterError),
        (np.full((3, 2), np.nan), 0.3, ParameterError),
        (np.zeros((3, 4)), 0.3, ParameterError),
    ):
        with pytest.raises(error):
            controller.follow(path, within=within)
    assert controller.goals == []
    arm = load_robot("panda")
    fixed = Controller(arm, arm.home(), arm.home(), Scene([]))
    with refused(ConfigurationError, "fixed"):
        fixed.follow(PATH, within=0.3)


places = st.lists(st.tuples(st.floats(-1.0, 7.0), st.floats(-2.0, 3.0)), min_size=2, max_size=8)


@given(places)
def test_distances_from_a_path(xy):
    np.testing.assert_allclose(FollowedPath(PATH, 0.3).off(np.array(xy)), off_path(np.array(xy)), atol=2e-3)


def arc_of(start, length, turn):
    """41 poses on an arc of a length [m] that turns by an angle [rad], from a pose on."""
    part = np.linspace(0.0, 1.0, 41)
    step, towards = part * length * np.sinc(0.5 * part * turn / np.pi), start[2] + 0.5 * part * turn
    return np.column_stack(
        [start[0] + step * np.cos(towards), start[1] + step * np.sin(towards), start[2] + part * turn]
    )


@given(places, st.floats(0.001, 2.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
@example([(0.3, 0.1), (0.0, 0.0)], 0.8, 0.75, -1.5)  # bulges away from a straight part of the path
@example([(1.2, 0.0), (0.0, 0.0)], 0.6, 0.3, 0.0)  # cuts a corner of it
@example([(5.5, 1.0 / 3.0), (0.0, 0.0)], 1.0, 2.3, 0.0)  # across the loop at its end
def test_no_point_of_an_arc_is_further_from_the_path_than_its_bound(xy, length, towards, turn):
    path = FollowedPath([*PATH, (4.0, 0.5), (2.9, 0.95)], 0.3)
    arc = arc_of((*xy[0], towards), length, turn)
    assert path.off(arc[:, :2]).max() <= float(path.bound(arc[[0, -1]])[0]) + 1e-9
    short = arc_of((*xy[0], towards), 0.02, 0.02 * turn)
    assert float(path.bound(short[[0, -1]])[0]) <= path.off(short[[0, -1], :2]).max() + 0.011


def test_the_rest_of_a_path():
    path = FollowedPath(PATH, 0.3)
    np.testing.assert_allclose(path.ahead(0.0), PATH)
    np.testing.assert_allclose(path.ahead(0.5)[0], (0.5, 0.0))
    np.testing.assert_allclose(path.ahead(1.5), PATH[1:])
    np.testing.assert_allclose(path.ahead(99.0), PATH[-1:])


def test_it_is_drawn_back_where_it_is_far_off(silvermate):
    path, nv = FollowedPath(PATH, 0.4), silvermate.nv
    rows = np.zeros((5, nv))
    rows[:, 0] = np.linspace(0.2, 1.0, 5)
    rows[2, 1], rows[3, 1] = 0.15, 0.35
    rows[:, 2] = 0.7
    system = System(5, nv)
    path.push(system, rows)
    assert not system.force[[0, 1, 2, 4]].any()
    cos, sin = np.cos(0.7), np.sin(0.7)
    in_world = np.array([[cos, -sin], [sin, cos]]) @ system.force[3, :2]
    np.testing.assert_allclose(in_world[0], 0.0, atol=1e-12)
    assert in_world[1] < 0.0

    def energy(y):
        moved = rows.copy()
        moved[3, 1] = y
        other = System(5, nv)
        path.push(other, moved)
        return other.energies["path"]

    assert in_world[1] == pytest.approx(-(energy(0.351) - energy(0.349)) / 0.002, rel=1e-3)
