"""What all base methods have in common: interface, limits, the goal, symmetry, and driving without contact."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from cases import each, refused
from flat_world import World, door, drive, moved, patience, placed, ring, scan

from elastic_strips.errors import ParameterError
from elastic_strips.perception import NO_ANSWER, NOTHING, LaserScan, RangeRing
from elastic_strips.trajectory.limits import MotionLimits
from workshop.baselines import BASE_METHODS, BaseLimits, BaseMethod, GoalParams, make_base_method
from workshop.baselines.base_method import CommandLimiter
from workshop.baselines.certainty_grid import SensedPoints, planar_rays

LIMITS = BaseLimits()
NAMES = list(BASE_METHODS)


def test_registry():
    assert NAMES == ["apf", "vff", "vfh", "band"]
    for name in NAMES:
        method = make_base_method(name, LIMITS)
        assert isinstance(method, BaseMethod)
        assert method.name == name
    with refused(ParameterError, "'vhf'", "'vfh'"):
        make_base_method("vhf", LIMITS)


@each("name", NAMES)
def test_an_empty_room(name):
    goal = np.array([2.0, 1.0, -1.0])
    run = drive(make_base_method(name, LIMITS), World(), (0.0, 0.0, 2.5), goal, rate=10.0)
    assert run.arrived
    assert not run.blocked
    assert np.hypot(*(run.poses[-1, :2] - goal[:2])) < 0.2
    assert abs(math.remainder(run.poses[-1, 2] - goal[2], 2.0 * math.pi)) <= 0.08


@each("name", NAMES)
def test_around_a_round_obstacle(name):
    world = World(circles=[(2.0, 0.1, 0.3)])
    run = drive(make_base_method(name, LIMITS), world, (0.0, 0.0, 0.0), (4.0, 0.0, math.nan), rate=12.0)
    assert run.arrived
    assert run.clearance > 0.05


@each("name", NAMES)
def test_limits_are_kept(name):
    world = World(circles=[(2.0, 0.1, 0.3)])
    run = drive(make_base_method(name, LIMITS), world, (0.0, 0.0, 1.0), (4.0, 0.0, 1.0), rate=10.0, seconds=12.0)
    v = np.array([0.0, *(c.v for c in run.commands)])
    omega = np.array([0.0, *(c.omega for c in run.commands)])
    assert v.min() >= 0.0
    assert v.max() <= LIMITS.max_speed + 1e-12
    assert np.abs(omega).max() <= LIMITS.max_turn + 1e-12
    assert np.abs(np.diff(v)).max() <= LIMITS.acceleration * 0.1 + 1e-9
    assert np.abs(np.diff(omega)).max() <= LIMITS.turn_acceleration * 0.1 + 1e-9


@each("name", NAMES)
def test_a_symmetric_scene_gives_a_straight_command(name):
    # the goal and the door are straight ahead; the base is in the middle of a cell of the grids
    pose, goal = np.array([1.55, 0.05, 0.0]), np.array([5.05, 0.05, 0.0])
    world = World(walls=[(2.55, -2.95, 2.55, -0.45), (2.55, 0.55, 2.55, 3.05)])
    method = make_base_method(name, LIMITS)
    for k in range(3):
        method.update(scan(world, pose), pose)
        method.update(ring(world, pose), pose)
        assert abs(method.command(0.1 * k, pose, np.zeros(2), goal).omega) < 1e-6


@each("name", NAMES)
def test_a_mirrored_scene_gives_the_mirrored_command(name):
    pose, goal = np.array([0.05, 0.05, 0.0]), np.array([4.05, 0.05, 0.0])
    omegas = []
    for side in (1.0, -1.0):
        world = World(circles=[(1.05, 0.05 + 0.23 * side, 0.2), (0.55, 0.05 + 0.93 * side, 0.2)])
        method = make_base_method(name, LIMITS)
        for k in range(4):
            method.update(scan(world, pose), pose)
            command = method.command(0.1 * k, pose, np.zeros(2), goal)
        omegas.append(command.omega)
    assert omegas[0] == pytest.approx(-omegas[1], abs=1e-6)
    assert omegas[0] < -1e-3  # away from the nearer one, which is to the left


@each("name", NAMES[:3])  # the planner's grid of the band is aligned with start and goal
def test_a_moved_world_gives_the_same_drive(name):
    # by whole cells and a quarter turn, after which the grids are the same
    by, start, goal = np.array([3.0, -2.0, 0.5 * math.pi]), (0.05, 0.05, 0.2), (3.05, 0.05, 0.0)
    a, b = World(circles=[(1.62, 0.17, 0.23)]), World(circles=[(*moved(by, (1.62, 0.17, 0.0))[:2], 0.23)])
    first = drive(make_base_method(name, LIMITS), a, start, goal, rate=10.0, seconds=4.0)
    second = drive(make_base_method(name, LIMITS), b, moved(by, start), moved(by, goal), rate=10.0, seconds=4.0)
    shifted = np.array([moved(by, p) for p in first.poses])
    np.testing.assert_allclose(second.poses[:20], shifted[:20], atol=1e-3)


@each("name", NAMES)
def test_a_wall_across_the_way_blocks_without_contact(name):
    world = World(
        walls=[(1.5, -6.0, 1.5, 6.0), (-1.0, -6.0, -1.0, 6.0), (-1.0, 6.0, 1.5, 6.0), (-1.0, -6.0, 1.5, -6.0)]
    )
    start, goal = (0.0, 0.0, 0.0), (3.0, 0.0, 0.0)
    method, enough = make_base_method(name, LIMITS), patience(start, goal)
    run = drive(method, world, start, goal, seconds=enough, rate=10.0, until_blocked=True)
    assert run.blocked
    assert not run.arrived
    assert run.clearance > 0.0


def test_only_some_pass_the_narrow_door():
    passed = {}
    for name in NAMES:
        run = drive(
            make_base_method(name, LIMITS), door(0.8), (0.6, 0.0, 0.0), (5.0, 0.0, math.nan), seconds=14.0, rate=10.0
        )
        passed[name] = run.arrived
        assert run.clearance > 0.0
    assert passed == {"apf": False, "vff": False, "vfh": True, "band": True}


def test_helm_ramps_and_brakes():
    limiter = CommandLimiter(BaseLimits(acceleration=1.0, turn_acceleration=2.0))
    goal, still = np.array([9.0, 0.0, 0.0]), np.zeros(2)
    out, velocity = [], still
    for k in range(4):
        assert limiter.at_goal(0.1 * k, np.zeros(3), velocity, goal) is None
        command = limiter.drive(0.1 * k, velocity, 0.25, -9.0, 9.0)
        velocity = np.array([command.v, command.omega])
        out.append(velocity)
    np.testing.assert_allclose(out, [[0.1, -0.2], [0.2, -0.4], [0.25, -0.6], [0.25, -0.8]])
    assert limiter.halt(0.4, velocity, "why").v == pytest.approx(0.15)
    assert limiter.halt(0.5, velocity, "why").reason == "why"
    # a base that was stopped by something else starts from where it is, not from the last command
    assert limiter.drive(0.6, np.array([-2.0, 0.0]), 0.6, 0.0, 9.0).v < 0.0


def test_goal_tolerances_and_turning():
    limiter = CommandLimiter(LIMITS, GoalParams(position_tolerance=0.1, yaw_tolerance=0.1))
    goal = np.array([1.0, 0.0, 3.0])
    assert limiter.at_goal(0.0, np.array([0.89, 0.0, 0.0]), np.zeros(2), goal) is None
    turning = limiter.at_goal(0.1, np.array([0.91, 0.0, -3.0]), np.zeros(2), goal)
    assert turning is not None
    assert (turning.status, turning.v) == ("moving", 0.0)
    assert turning.omega < 0.0  # −3 → 3 rad is shorter clockwise
    drifted = limiter.at_goal(0.2, np.array([0.85, 0.0, 2.95]), np.zeros(2), goal)
    assert drifted is not None  # once there, twice the tolerance
    done = limiter.at_goal(2.0, np.array([0.85, 0.0, 2.95]), np.zeros(2), goal)
    assert done is not None
    assert (done.status, done.v, done.omega) == ("arrived", 0.0, 0.0)
    anywhere = CommandLimiter(LIMITS).at_goal(
        0.0, np.array([1.0, 0.0, 0.0]), np.zeros(2), np.array([1.0, 0.0, math.nan])
    )
    assert anywhere is not None
    assert anywhere.status == "arrived"


def test_no_progress_is_blocked_until_there_is():
    limiter, still = CommandLimiter(LIMITS, GoalParams(progress=0.1, patience=2.0)), np.zeros(2)
    status = [limiter.drive(t, still, 0.1, 0.0, 5.0).status for t in (0.0, 1.0, 2.0, 2.1)]
    assert status == ["moving", "moving", "moving", "blocked"]
    assert limiter.drive(2.2, still, 0.1, 0.0, 4.95).status == "blocked"
    assert limiter.drive(2.3, still, 0.1, 0.0, 4.8).status == "moving"


def test_rays_in_the_plane():
    T = placed(0.1, 0.0, 0.0)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])  # mounted upside down
    scan_ = LaserScan("l", 0.0, T, [0.0, 0.5 * math.pi, 1.8], [1.0, 2.0, NO_ANSWER], 0.0, 5.0)
    rays = planar_rays(scan_, np.array([1.0, 0.0, 0.5 * math.pi]))
    np.testing.assert_allclose(rays.ends, [[1.0, 1.1], [3.0, 0.1]], atol=1e-12)
    tilted = np.eye(4)
    tilted[:3, 0] = [0.8, 0.0, -0.6]
    beam = planar_rays(RangeRing("s", "infrared", 0.0, tilted[None], [NOTHING], 0.05, 0.0, 2.0), np.zeros(3))
    assert (beam.length[0], beam.hit[0]) == (pytest.approx(1.6), False)


def test_a_scan_explains_a_sonar_echo_from_the_rim_of_its_cone():
    sensed, echo = SensedPoints(), RangeRing("s", "sonar", 0.0, np.eye(4)[None], [1.0], 0.3, 0.0, 2.0)
    sensed.update(echo, np.zeros(3))
    np.testing.assert_allclose(sensed.points, [[1.0, 0.0]])
    sensed.update(LaserScan("l", 0.0, np.eye(4), [0.0, 0.25], [1.9, 1.02], 0.0, 5.0), np.zeros(3))
    assert len(sensed.points) == 2  # the echo came from the point beside the axis
    sensed.update(LaserScan("l", 0.0, np.eye(4), [0.0, 0.25], [1.9, 1.9], 0.0, 5.0), np.zeros(3))
    assert len(sensed.points) == 3  # something that the laser does not see
    sensed.update(LaserScan("l", 0.0, np.eye(4), [0.0, 0.25], [NO_ANSWER] * 2, 0.0, 5.0), np.zeros(3))
    assert len(sensed.points) == 3


def test_limits_are_checked():
    names = ("radius", "max_speed", "max_turn", "acceleration", "turn_acceleration")
    for name, value in itertools.product(names, (0.0, -1.0, math.nan, math.inf, True, None)):
        with pytest.raises(ParameterError, match=rf"BaseLimits\.{name}={value}.* must be a finite number > 0"):
            BaseLimits(**{name: value})


def test_limits_of_a_robot(silvermate):
    motion = MotionLimits.for_robot(silvermate)
    limits = BaseLimits.of(motion, max_speed=99.0, max_turn=99.0)
    assert limits.max_speed == pytest.approx(motion.drive_speed[0])
    assert limits.max_turn == pytest.approx(2.0 * motion.drive_speed[0] / motion.track)
    assert limits.acceleration == pytest.approx(1.2)
    assert BaseLimits.of(motion).max_speed <= 0.6
