"""First strips: lines, rows along a way, tucked arms and stages, relaxing, headings, and edges between samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances, random_configurations, self_distances
from cases import each
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.native import kernel
from elastic_strips.planning import grid_path, ompl_path, plan_report, straight_line
from elastic_strips.planning import search as search_module
from elastic_strips.planning.initial_strip import (
    STUCK_TICKS,
    forward_rows,
    line_strip,
    path_rows,
    path_strip,
    relax_path,
    staged_rows,
    tucked_rows,
    waypoint_rows,
)
from elastic_strips.planning.ompl_planner import certify_path
from elastic_strips.planning.problem import PlanningProblem
from elastic_strips.planning.search import PlanSearch
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Scene
from elastic_strips.strip import Deformer, DeformParams, Strip

# Straight lines

SPACING = 0.15


def rows_of(robot, a, b, spacing=SPACING):
    rows = straight_line(robot, a, b, spacing=spacing)
    Strip(robot, robot.space.from_coordinates(rows))  # sound configurations
    return rows


@settings(max_examples=80, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([1e-12, 1e-6, 0.01, 1.0, 5.0]))
def test_a_differential_drive_can_follow_exactly(silvermate, seed, scale):
    rng = np.random.default_rng(seed)
    a, b = random_configurations(silvermate, rng, 2)
    b[:2] = a[:2] + scale * rng.normal(size=2)
    rows = rows_of(silvermate, a, b)
    q = silvermate.space.from_coordinates(rows)
    np.testing.assert_allclose(q[0], a, atol=1e-15)
    np.testing.assert_allclose(q[-1], b, atol=1e-15)
    v = np.array([pin.difference(silvermate.model, x, y) for x, y in pairwise(q)])
    assert np.abs(v[:, 1]).max() <= 2e-9
    assert np.hypot(v[:, 0], v[:, 1]).max() <= SPACING + 1e-9
    assert np.abs(v[:, 2]).max() <= np.pi / 2
    assert len(rows) >= 3


def test_driving_is_straight_and_turning_in_place(silvermate):
    rows = rows_of(silvermate, silvermate.home(yaw=1.0), silvermate.home(x=2.0, y=2.0, yaw=-0.5))
    at_start = np.linalg.norm(rows[:, :2], axis=1) < 1e-12
    at_goal = np.linalg.norm(rows[:, :2] - 2.0, axis=1) < 1e-12
    assert at_start.sum() > 1
    assert at_goal.sum() > 1
    np.testing.assert_allclose(rows[:, 0], rows[:, 1], atol=1e-12)
    driving = ~at_start & ~at_goal
    np.testing.assert_allclose(rows[driving, 2], np.pi / 4, atol=1e-12)
    assert np.abs(np.diff(rows[:, 2])).max() < 0.36


def test_it_backs_up_where_that_turns_less(silvermate):
    rows = rows_of(silvermate, silvermate.home(), silvermate.home(x=-2.0))
    np.testing.assert_allclose(rows[:, 2], 0.0, atol=1e-12)
    assert (np.diff(rows[:, 0]) < 0).all()


def test_who_does_not_look_back_turns_instead(silvermate):
    start, goal = silvermate.home(), silvermate.home(x=-2.0)
    rows = straight_line(silvermate, start, goal, spacing=SPACING, backward=False)
    drives = np.abs(np.diff(rows[:, 0])) > 1e-9
    np.testing.assert_allclose(np.cos(rows[1:][drives, 2]), -1.0, atol=1e-12)
    for backward, sign in ((False, 1.0), (True, -1.0)):
        report = plan_report(silvermate, Scene([]), start, goal, backward=backward)
        assert report.certified
        nodes = report.strip.coordinates
        assert (sign * silvermate.space.difference(nodes[:-1], nodes[1:])[:, 0] > -1e-9).all()


def backed_up(robot, rows):
    return float(-np.minimum(robot.space.difference(rows[:-1], rows[1:])[:, 0], 0.0).sum())


@pytest.mark.parametrize("seed", [0, 1])
def test_so_it_does_on_a_way_that_a_planner_found(silvermate, seed):
    """Its curves lead backwards as readily as forwards."""
    wall = Scene([Box((0.3, 2.0, 1.0), at=(2.0, 0.0, 0.5), name="wall")])
    ends = silvermate.home(), silvermate.home(x=4.0, yaw=2.5)
    to_and_fro, forwards = (
        plan_report(silvermate, wall, *ends, seed=seed, line=False, grid=False, backward=backward, timeout=60.0)
        for backward in (True, False)
    )
    assert forwards.certified, forwards.reason
    assert forwards.method == "ompl"
    rows = forward_rows(silvermate, to_and_fro.initial.coordinates)
    assert backed_up(silvermate, to_and_fro.initial.coordinates) > 1.0, "else nothing is shown"
    assert backed_up(silvermate, rows) < 0.6
    assert backed_up(silvermate, forwards.strip.coordinates) < 0.6
    np.testing.assert_allclose(rows[[0, -1]], to_and_fro.initial.coordinates[[0, -1]], atol=1e-12)
    assert np.abs(np.diff(rows[:, 2])).max() < 0.6


def test_turning_in_place_stays_in_place(silvermate):
    rows = rows_of(silvermate, silvermate.home(x=1.0, y=2.0), silvermate.home(x=1.0, y=2.0, yaw=3.0))
    np.testing.assert_allclose(rows[:, :2], [[1.0, 2.0]] * len(rows), atol=1e-12)
    assert len(rows) >= 5


def test_joints_move_along_the_drive(silvermate):
    rows = rows_of(silvermate, silvermate.home(arm_1_joint=0.0), silvermate.home(x=3.0, arm_1_joint=1.0))
    np.testing.assert_allclose(rows[:, 3], rows[:, 0] / 3.0, atol=1e-9)
    only = rows_of(silvermate, silvermate.home(arm_1_joint=0.0), silvermate.home(arm_1_joint=1.0))
    assert (np.diff(only[:, 3]) > 0).all()
    np.testing.assert_array_equal(only[:, :3], 0.0)


def test_an_omnidirectional_base_slides(rover):
    rows = rows_of(rover, rover.home(), rover.home(x=1.0, y=2.0, yaw=1.0))
    s = rows[:, 0]
    np.testing.assert_allclose(rows[:, 1], 2.0 * s, atol=1e-12)
    np.testing.assert_allclose(rows[:, 2], s, atol=1e-12)


def test_an_omnidirectional_base_keeps_the_spacing(rover):
    rows = rows_of(rover, rover.home(), rover.home(x=1.0, y=2.0))
    assert np.hypot(*np.diff(rows[:, :2], axis=0).T).max() <= SPACING + 1e-9


def test_a_fixed_base_moves_its_joints(gantry, rng):
    a, b = random_configurations(gantry, rng, 2)
    rows = rows_of(gantry, a, b)
    expected = [pin.interpolate(gantry.model, a, b, s) for s in np.linspace(0, 1, len(rows))]
    np.testing.assert_allclose(gantry.space.from_coordinates(rows), expected, atol=1e-9)


@pytest.mark.parametrize("name", ["silvermate", "rover"])
def test_continuous_angles_take_the_short_way(name, request):
    robot = request.getfixturevalue(name)
    rows = rows_of(robot, robot.home(yaw=3.0), robot.home(yaw=-3.0))
    assert np.abs(np.diff(np.unwrap(rows[:, 2]))).sum() < 0.3 + 1e-6


# Start and goal headings

WALL = Scene([Box((0.2, 3.0, 1.5), at=(2.0, 0.6, 0.75)), Box((0.2, 3.0, 1.5), at=(2.0, -3.9, 0.75))])


@each("yaw", [np.pi, -np.pi, 3 * np.pi, np.nextafter(np.pi, 4), 7.0])
def test_the_planner_takes_any_heading(jackal_box, yaw):
    """OMPL calls a heading of exactly pi out of bounds; a goal that faces back must be found all the same."""
    start, goal = jackal_box.home(yaw=yaw), jackal_box.home(4.0, 0.0, yaw)
    path = ompl_path(jackal_box, WALL, start, goal, seed=0, margin=0.03, timeout=60.0).rows
    assert path is not None
    np.testing.assert_allclose(jackal_box.space.from_coordinates(path[[0, -1]]), [start, goal], atol=1e-9)
    report = plan_report(jackal_box, WALL, start, goal, line=False)
    assert report.certified, report.reason


# Rows along a way of the base

WAY = np.column_stack((np.linspace(0.0, 3.0, 31), 0.4 * np.sin(np.linspace(0.0, np.pi, 31))))


@each("name", ["silvermate", "tiago", "jackal_box"])
def test_the_arm_is_tucked_while_the_base_moves(name, request) -> None:
    robot = request.getfixturevalue(name)
    space = robot.space
    rng = np.random.default_rng(3)
    ends = space.to_coordinates(np.stack((robot.home(), robot.home(x=3.0))))
    joints = ends[:, 3:] + rng.uniform(-0.7, 0.7, ends[:, 3:].shape)
    ends[:, 3:] = np.clip(joints, space.lower[3:], space.upper[3:])
    start, goal = space.from_coordinates(ends)
    rows = tucked_rows(robot, start, goal, WAY, spacing=0.13)
    np.testing.assert_allclose(rows[[0, -1]], ends, atol=1e-12)
    steps = np.abs(space.difference(rows[:-1], rows[1:]))
    assert steps[:, 3:].max(initial=0.0) <= 0.3 + 1e-9
    home = space.to_coordinates(robot.home_q)[3:]
    away = np.abs(rows[:, 3:] - home).max(axis=1, initial=0.0) > 1e-9
    moves = steps[:, :3].max(axis=1) > 1e-9
    assert not (moves & (away[:-1] | away[1:])).any()
    assert moves.sum() > 20
    assert (steps.max(axis=1) > 1e-9).all()  # no row twice


def test_an_end_that_is_tucked_already_adds_no_rows(silvermate) -> None:
    start, goal = silvermate.home(), silvermate.home(x=3.0)
    one, two = (rows(silvermate, start, goal, WAY, spacing=0.13) for rows in (tucked_rows, waypoint_rows))
    np.testing.assert_array_equal(one, two)


# Relaxing

REACH = {
    "arm_1_joint": 0.61, "arm_2_joint": 0.25, "arm_3_joint": -0.58, "arm_4_joint": 1.53, "arm_5_joint": 0.46,
    "arm_6_joint": -0.36, "arm_7_joint": 0.55,
}  # fmt: skip
ASIDE = {
    "arm_1_joint": 1.85, "arm_2_joint": 1.47, "arm_3_joint": -0.23, "arm_4_joint": 1.39, "arm_5_joint": 0.95,
    "arm_6_joint": -0.32, "arm_7_joint": 0.3,
}  # fmt: skip
ZIGZAG = Scene(
    [
        Box((0.06, 4.0, 1.4), at=(x, y + s * 2.33, 0.7), name=f"{name} {'left' if s > 0 else 'right'}")
        for x, y, name in ((2.0, 0.9, "first"), (2.95, -0.3, "second"))
        for s in (1.0, -1.0)
    ]
)
"""Two doors 0.66 m wide, 0.95 m apart and 1.2 m aside: the robot has to turn between them."""


def test_the_arm_is_tucked_where_it_does_not_fit(silvermate) -> None:
    start, goal = silvermate.home(joints=ASIDE), silvermate.home(x=5.0, joints=ASIDE)
    report = plan_report(silvermate, ZIGZAG, start, goal, grid=True, line=False, timeout=60.0)
    assert report.certified
    assert report.method == "grid"
    assert "the grid's path with the arm tucked relaxed" in report.reason
    assert Deformer(silvermate).certify(report.strip, ZIGZAG).certified
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-12)


def test_rows_are_tucked_only_where_that_changes_something(silvermate, jackal_box) -> None:
    way = np.array([[0.0, 0.0], [3.0, 0.0]])
    for robot, joints, count in ((silvermate, {}, 1), (silvermate, REACH, 2), (jackal_box, {}, 1)):
        ends = robot.home(), robot.home(x=3.0, joints=joints)
        names = [what for _, what in path_rows(PlanningProblem(robot, Scene([]), *ends), way)]
        assert names == ["", " with the arm tucked"][:count]


def test_what_gets_no_clearer_is_given_up(silvermate) -> None:
    """A line through a box: patience makes it longer and slower, and leads nowhere."""
    scene = Scene([Box((0.8, 3.0, 1.4), at=(3.0, 0.0, 0.7), name="block")])
    problem = PlanningProblem(silvermate, scene, silvermate.home(), silvermate.home(x=6.0), timeout=60.0)
    strip = line_strip(problem)
    seen = []
    report = relax_path(problem, strip, stuck=STUCK_TICKS, watch=seen.append)
    assert not report.usable
    assert report.ticks == len(seen) < 25
    assert "block" in report.reason
    assert report.reason.endswith(f"(after {report.ticks} ticks)")
    assert relax_path(problem, strip, stuck=STUCK_TICKS, over=lambda: True).ticks == 1


@pytest.mark.parametrize("y", [0.9, -0.8])
def test_what_can_be_relaxed_comes_out_as_with_patience(silvermate, y) -> None:
    scene = Scene([Box((0.4, 0.4, 1.4), at=(3.0, 0.0, 0.7)), Box((0.4, 0.4, 1.4), at=(1.5, y, 0.7))])
    start, goal = silvermate.home(), silvermate.home(x=5.0)
    way = grid_path(silvermate, scene, start, goal).points
    assert way is not None
    problem = PlanningProblem(silvermate, scene, start, goal, timeout=60.0)
    rows, _ = next(path_rows(problem, way))
    strip = path_strip(problem, rows)
    one, two = (relax_path(problem, strip, stuck=stuck) for stuck in (None, STUCK_TICKS))
    assert one.usable
    np.testing.assert_array_equal(one.strip.q, two.strip.q)
    assert one.ticks == two.ticks


# Base and joints one after the other

JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))
BOX = [
    Box((0.4, 0.02, 0.46), at=(0.6, 0.24, 0.5), name="left"),
    Box((0.4, 0.02, 0.46), at=(0.6, -0.24, 0.5), name="right"),
    Box((0.4, 0.5, 0.02), at=(0.6, 0.0, 0.74), name="lid"),
    Box((0.4, 0.5, 0.02), at=(0.6, 0.0, 0.26), name="floor"),
    Box((0.02, 0.5, 0.5), at=(0.81, 0.0, 0.5), name="back"),
]
"""Open towards the robot alone."""


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda", base="diff_drive", joints=JOINTS)


@pytest.fixture(scope="module")
def inside(panda) -> np.ndarray:
    """The hand in the box, pointing into it."""
    ahead = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    found = panda.inverse_kinematics("panda_hand_tcp", (0.58, 0.0, 0.5), ahead, near=panda.home(), base=False).q
    assert found is not None
    return found


@pytest.fixture(autouse=True)
def _takes_its_time(monkeypatch):
    """No search of the joints is given up because a machine is busy."""
    monkeypatch.setattr(search_module, "_LONGEST_STAGE_SEARCH", 60.0)


def search(robot: RobotModel, scene: Scene, start: np.ndarray, goal: np.ndarray):
    problem = PlanningProblem(robot, scene, start, goal, timeout=60.0)
    found = PlanSearch(problem, None)
    found.initial = line_strip(problem)
    return found


def test_what_is_certified_as_it_was_found_keeps_to_the_bounds(jackal_box):
    """The way is free, and a part of it is outside: spheres that prove it do not say so."""
    start, goal = jackal_box.home(), jackal_box.home(4.0)
    inside, outside = ([(0.0, 0.0), (2.0, aside), (4.0, 0.0)] for aside in (0.2, 1.5))
    problem = PlanningProblem(jackal_box, Scene([]), start, goal, timeout=60.0, bounds=((-1.0, -1.0), (5.0, 1.0)))
    found = PlanSearch(problem, None)
    assert found.as_found(waypoint_rows(jackal_box, start, goal, inside, spacing=0.1), "path", "way") is not None
    rows = waypoint_rows(jackal_box, start, goal, outside, spacing=0.1)
    assert found.as_found(rows, "path", "way") is None
    assert Deformer(jackal_box).workspace.proves(path_strip(problem, rows), problem.scene) is (kernel() is not None)


def test_what_is_certified_as_it_was_found_can_be_driven(jackal_box, monkeypatch):
    start, goal = jackal_box.home(), jackal_box.home(1.0, 0.3)
    problem = PlanningProblem(jackal_box, Scene([]), start, goal, timeout=60.0)
    monkeypatch.setattr(search_module, "path_strip", lambda problem, rows: Strip.from_coordinates(problem.robot, rows))
    sideways = jackal_box.space.to_coordinates(np.stack((start, goal)))
    rows = sideways[0] + np.linspace(0.0, 1.0, 9)[:, None] * (sideways[1] - sideways[0])
    assert PlanSearch(problem, None).as_found(rows, "path", "way") is None


def test_spheres_prove_nothing_of_half_a_turn(jackal_box):
    rows = np.repeat(jackal_box.space.to_coordinates(jackal_box.home_q)[None], 2, axis=0)
    rows[1, 2] += np.pi
    assert not Deformer(jackal_box).workspace.proves(Strip.from_coordinates(jackal_box, rows), Scene([]))


def test_it_drives_there_and_then_reaches_in(panda, inside):
    scene, start = Scene(BOX), panda.home(x=-2.0, y=0.4)
    path = np.array([(-2.0, 0.4), (-1.0, 0.0), (0.0, 0.0)])
    looks = search(panda, scene, start, inside)
    report = looks.in_stages(path)
    assert report is not None, looks.reasons
    assert report.certified
    assert "the joints as at the start, and their own before and after" in report.reason
    least = report.report.certificate.clearance
    assert Deformer(panda, DeformParams(clearance=least)).certify(report.strip, scene).certified
    np.testing.assert_array_equal(report.strip.q[[0, -1]], [start, inside])
    for q in report.strip.sample(0.05):
        assert link_distances(panda, scene, q).min() > 0.0
        assert self_distances(panda, q).min() > 0.0


def test_where_the_joints_end_as_they_begin_there_are_no_stages(panda):
    looks = search(panda, Scene([]), panda.home(x=-2.0), panda.home())
    assert looks.in_stages(np.array([(-2.0, 0.0), (0.0, 0.0)])) is None
    assert looks.attempts == 0


def test_where_the_start_s_posture_does_not_fit_another_does(panda, inside):
    """An arm that is stretched out ahead would be in the box before it."""
    start = panda.home(x=-2.0, joints={"panda_joint2": 0.9, "panda_joint4": -0.6, "panda_joint6": 1.5})
    looks = search(panda, Scene(BOX), start, inside)
    report = looks.in_stages(np.array([(-2.0, 0.0), (0.0, 0.0)]))
    assert report is not None, looks.reasons
    assert "the joints at home" in report.reason


def test_rows_are_put_together_and_no_more_than_there_may_be(panda, inside):
    start = panda.home(x=-2.0)
    ends = panda.space.to_coordinates(np.stack((start, inside)))
    drive = ends.copy()
    drive[:, 3:] = ends[0, 3:]
    path = np.array([(-2.0, 0.0), (0.0, 0.0)])
    share = np.linspace(0.0, 1.0, 30)[:, None]
    after = drive[1] + share * (ends[1] - drive[1])
    for most in (400, 40, 12):
        problem = PlanningProblem(panda, Scene([]), start, inside, params=DeformParams(max_nodes=most))
        rows = staged_rows(problem, path, drive, ends[:1], after)
        assert len(rows) <= most
        np.testing.assert_allclose(rows[[0, -1]], ends, atol=1e-12)
        if most == 400:
            np.testing.assert_array_equal(rows[-30:], after)


# Edges of a path


def test_a_wire_between_two_samples_is_found(jackal_box) -> None:
    """A path whose nodes are all valid, with a thin plate between two of them."""
    start, goal = jackal_box.home(), jackal_box.home(x=4.0)
    coordinates = straight_line(jackal_box, start, goal, spacing=2.0)
    assert len(coordinates) == 5
    plate = Scene([Box((0.001, 2.0, 1.0), at=(1.5, 0.0, 0.5), name="plate")])
    valid = ValidityChecker(jackal_box, plate, margin=0.0)
    coordinates = coordinates[[0, 2, 4]]  # at 0, 2 and 4 m: half a robot is shorter than 0.5 m
    assert all(valid(q.copy()) for q in jackal_box.space.from_coordinates(coordinates))
    certificate = certify_path(Deformer(jackal_box), plate, coordinates)
    assert certificate.segments.tolist() == [False, True]
    assert certificate.broken is not None
    assert certificate.broken.obstacle == "plate"
    assert certify_path(Deformer(jackal_box), plate.without("plate"), coordinates).certified


def test_a_finer_path_checks_more(silvermate) -> None:
    scene = Scene([Cylinder(0.3, 1.5, at=(2.0, 0.0, 0.75))])
    checks = []
    for fineness in (1.0, 4.0):
        found = ompl_path(
            silvermate, scene, silvermate.home(), silvermate.home(x=4.0), seed=1, margin=0.03, timeout=60.0,
            fineness=fineness,
        )  # fmt: skip
        assert found.rows is not None
        checks.append(found.checks)
        assert np.isfinite(found.rows).all()
    assert checks[1] > 1.5 * checks[0]
