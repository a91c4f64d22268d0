"""Paths: where a robot has to stop, and how near a path that it can follow comes to its nodes."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import random_configurations
from cases import each, each_robot, refused
from drivable import arcs, distance_from_strip, limits_of, motor_travel

from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import path as following
from elastic_strips.trajectory.path import RetimingError, integrate_travel, metric, polyline, smooth_path


def line_of(robot: RobotModel, nodes: np.ndarray, heading: np.ndarray | None = None):
    limits = limits_of(robot)
    return polyline(robot, limits, metric(robot, limits), nodes, heading)


def path_of(robot: RobotModel, nodes: np.ndarray, **options):
    limits = limits_of(robot)
    weight = metric(robot, limits)
    line = polyline(robot, limits, weight, nodes, options.get("heading"))
    return smooth_path(robot, limits, line, float(line.s[line.stops[0]]), weight=weight, **options)


def driven(robot: RobotModel, path, points: int = 3000) -> np.ndarray:
    y, _, _ = path.curve(np.linspace(0.0, path.curve.length, points))
    return integrate_travel(robot, limits_of(robot), path.start, y)


def base_nodes(robot: RobotModel, moves: list[tuple[float, float]], **joints: float) -> np.ndarray:
    """Nodes along travels (ds [m], dφ [rad]), each an exact arc; from home."""
    rows = [robot.space.to_coordinates(robot.home(joints=joints))]
    for ds, turn in moves:
        v = np.zeros(robot.nv)
        v[0], v[2] = ds, turn
        rows.append(robot.space.integrate(rows[-1], v))
    return np.array(rows)


@each_robot
def test_travel_of_the_nodes(robot):
    nodes = arcs(robot, 1)
    line = line_of(robot, nodes)
    limits = limits_of(robot)
    travel = motor_travel(robot, limits, robot.space.difference(nodes[:-1], nodes[1:]))
    np.testing.assert_allclose(np.diff(line.y, axis=0), travel, atol=1e-12)
    np.testing.assert_allclose(np.diff(line.s), np.linalg.norm(travel * metric(robot, limits), axis=1), atol=1e-12)
    s = np.array([0.0, 0.3 * line.s[3] + 0.7 * line.s[4], line.s[-1]])
    poses = line.pose(robot.space, s)
    np.testing.assert_allclose(poses[[0, 2]], nodes[[0, -1]], atol=1e-12)
    between = robot.space.interpolate(nodes[3][None], nodes[4][None], 0.7)[0]
    np.testing.assert_allclose(poses[1], between, atol=1e-12)
    np.testing.assert_allclose(line.travel(s)[1], 0.3 * line.y[3] + 0.7 * line.y[4], atol=1e-12)


def test_the_metric_counts_metres(silvermate, tiago, rover):
    straight = base_nodes(silvermate, [(0.7, 0.0)])
    assert line_of(silvermate, straight).s[-1] == pytest.approx(0.7)
    in_place = base_nodes(silvermate, [(0.0, 1.0)])
    assert line_of(silvermate, in_place).s[-1] == pytest.approx(0.2)
    weight = metric(tiago, limits_of(tiago))
    np.testing.assert_allclose(weight, [np.sqrt(0.5)] * 2 + [1.0] + [0.25] * 7)
    np.testing.assert_allclose(metric(rover, limits_of(rover))[:4], [1.0, 1.0, 0.25, 1.0])


FORWARD, BACK, TURN = (0.15, 0.0), (-0.15, 0.0), (0.0, 0.4)


@each(
    "moves, stops",
    [
        ([FORWARD] * 5, [5]),
        ([FORWARD] * 3 + [BACK] * 2, [3, 5]),
        ([TURN] * 2 + [FORWARD] * 3 + [TURN] * 2, [2, 5, 7]),
        ([FORWARD, (0.15, 0.2), (0.15, 0.35), (0.15, 0.2), FORWARD], [5]),
        ([FORWARD, (0.1, 0.0), (0.05, 1.2), FORWARD], [2, 3, 4]),
        ([FORWARD, (0.0, 0.0), (0.0, 0.0), FORWARD, (1e-4, 0.0), BACK], [4, 6]),
        ([(0.1, 0.1), (0.09, 0.2), (0.06, 0.35), (0.02, 0.4), (-0.02, 0.4), (-0.06, 0.35), (-0.09, 0.2)], [7]),
        ([(0.0, 0.0)] * 4, [4]),
    ],
    ids=["straight", "cusp", "in place", "bends", "corner", "duplicates", "cusp that no wheel notices", "standstill"],
)
def test_where_the_robot_has_to_stop(silvermate, moves, stops):
    assert line_of(silvermate, base_nodes(silvermate, moves)).stops.tolist() == stops


def test_a_cusp_right_ahead_of_a_moving_robot(silvermate):
    """At rest a first node 1 mm ahead is as good as none; a moving robot has to stop at it to turn back."""
    nodes = base_nodes(silvermate, [(1e-3, 0.0), BACK, BACK])
    assert line_of(silvermate, nodes).stops.tolist() == [3]
    heading = np.zeros(9)
    heading[:2] = 0.05
    assert line_of(silvermate, nodes, heading).stops.tolist() == [1, 3]


def test_joints_that_turn_back_stop(gantry):
    nodes = np.tile(gantry.space.to_coordinates(gantry.home_q), (7, 1))
    nodes[:, 2] = 0.0, 0.3, 0.6, 0.9, 0.6, 0.3, 0.0
    assert line_of(gantry, nodes).stops.tolist() == [3, 6]


@each("name", ["silvermate", "tiago", "rover", "gantry"])
def test_a_path_ends_at_its_first_stop(name, request):
    robot = request.getfixturevalue(name)
    for seed in range(12):
        nodes = arcs(robot, seed)
        stop = line_of(robot, nodes).stops[0]
        gap = robot.space.difference(driven(robot, path_of(robot, nodes))[-1], nodes[stop])
        assert np.abs(gap[: robot.space.base_nv]).max(initial=0.0) < 1e-4, seed
        assert np.abs(gap).max() < 1e-4, seed


def test_without_shapes_the_base_drifts(silvermate, monkeypatch):
    """What the shapes are for: the test above would fail by millimetres."""
    nodes = arcs(silvermate, 3)
    monkeypatch.setattr(following, "_MOST_ITERATIONS", 1)
    end = driven(silvermate, path_of(silvermate, nodes))[-1]
    assert 1e-3 < np.hypot(*silvermate.space.difference(end, nodes[-1])[:2]) < 0.05


def test_how_near_it_stays(silvermate, tiago):
    """Half a metre of corner rounding and leading back: measured over 8 strips with bends of up to 2.3 rad/m."""
    worst = np.zeros(3)
    for robot in (silvermate, tiago):
        for seed in range(4):
            nodes = arcs(robot, seed)
            rows = driven(robot, path_of(robot, nodes), points=300)
            worst = np.maximum(worst, distance_from_strip(robot, rows, nodes))
    assert worst[0] < 0.006
    assert max(worst[1:]) < 0.05


def test_a_start_beside_the_strip_is_led_back(silvermate):
    nodes = base_nodes(silvermate, [FORWARD] * 12)
    nodes[0, 1] += 0.03
    nodes[0, 2] -= 0.02
    path = path_of(silvermate, nodes)
    rows = driven(silvermate, path)
    np.testing.assert_array_equal(rows[0], nodes[0])
    assert np.hypot(*silvermate.space.difference(rows[-1], nodes[-1])[:2]) < 1e-4
    late = rows[rows[:, 0] > 1.2]
    assert np.abs(late[:, 1]).max() < 2e-3


def test_it_begins_with_the_velocity_and_the_bend(silvermate):
    weight = metric(silvermate, limits_of(silvermate))
    nodes = arcs(silvermate, 2)
    heading = np.zeros(9)
    heading[:2] = 0.8, 0.9
    heading[4] = 0.1
    unit = heading / np.linalg.norm(heading * weight)
    bend = np.zeros(9)
    bend[:2] = -0.3, 0.3
    path = path_of(silvermate, nodes, heading=heading, bend=bend)
    np.testing.assert_allclose(path.y1[0], unit, atol=1e-12)
    np.testing.assert_allclose(path.y2[0], bend, atol=1e-9)


def test_a_velocity_that_points_away_is_refused(silvermate):
    heading = np.zeros(9)
    heading[:2] = -0.5
    with refused(RetimingError, "75°"):
        path_of(silvermate, base_nodes(silvermate, [FORWARD] * 4), heading=heading, bend=None)


def test_joints_stay_within_their_range(silvermate, rng):
    """A strip that runs along the limits: a spline through its nodes would overshoot them."""
    space = silvermate.space
    low, high = space.lower[3:], space.upper[3:]
    for seed in range(8):
        nodes = arcs(silvermate, seed, swing=6.0)
        nodes[:, 3:] = nodes[:, 3:].clip(low, high)
        assert ((nodes[:, 3:] == low) | (nodes[:, 3:] == high)).any()
        line = line_of(silvermate, nodes)
        rows = driven(silvermate, path_of(silvermate, nodes[: line.stops[0] + 1]))
        assert (rows[:, 3:] >= low - 1e-9).all()
        assert (rows[:, 3:] <= high + 1e-9).all()


def test_a_joint_too_fast_at_its_limit_is_refused(silvermate):
    nodes = base_nodes(silvermate, [FORWARD] * 4, arm_1_joint=float(silvermate.space.upper[3]) - 1e-3)
    heading = np.zeros(9)
    heading[:2], heading[2] = 0.3, 1.5
    with refused(RetimingError, "arm_1_joint"):
        path_of(silvermate, nodes, heading=heading)


def test_a_joint_that_glides_to_its_limit_stays_within(silvermate):
    """What is left of its speed and bend would take it out by a micrometre and by a millimetre."""
    upper = float(silvermate.space.upper[3])
    nodes = base_nodes(silvermate, [FORWARD] * 6, arm_1_joint=upper - 1e-7)
    heading, bend = np.zeros(9), np.zeros(9)
    heading[:2], heading[2], bend[2] = 0.5, 1e-5, 1.0
    rows = driven(silvermate, path_of(silvermate, nodes, heading=heading, bend=bend))
    assert rows[:, 3].max() <= upper + 1e-12
    assert rows[:, 3].max() > upper - 1e-7, "it does move"


@each_robot
def test_integration_is_exact(robot, rng):
    """Between any two rows the base moves on the arc of its travel: the same as node by node."""
    limits = limits_of(robot)
    y = np.cumsum(0.1 * rng.normal(size=(40, limits.drive_dim + len(limits.joint_speed))), axis=0)
    start = robot.space.to_coordinates(random_configurations(robot, rng, 1)[0])
    rows = integrate_travel(robot, limits, start, y)
    row = start
    for i in range(39):
        row = robot.space.integrate(row, limits.to_tangent(y[i + 1] - y[i]))
        np.testing.assert_allclose(rows[i + 1], row, atol=1e-12)
