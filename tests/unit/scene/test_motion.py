"""Motions: poses against closed forms, the speed bound against sampled trajectories."""

import math

import numpy as np
import pytest
from cases import each, refused
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.errors import SceneError
from elastic_strips.scene import Box, Keyframes, Scene, Sphere, Twist, UnknownMotion

EYE = np.eye(4)


def yaw_quat(angle):
    return (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))


def test_twist_moves_the_origin_and_turns_about_it_in_the_world_frame():
    start = Box((1, 1, 1), at=(1, 0, 0), quat=(math.sqrt(0.5), 0, 0, math.sqrt(0.5))).pose
    pose = Twist((1, 2, 0), (0, 0, math.pi / 2)).pose(start, 1.0)
    np.testing.assert_allclose(pose[:3, 3], (2, 2, 0))
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(pose[:3, :3], turn @ start[:3, :3], atol=1e-15)


def test_twist_composes():
    twist = Twist((0.3, -0.2, 0.1), (0.4, 1.5, -0.7))
    np.testing.assert_allclose(twist.pose(twist.pose(EYE, 0.8), 1.7), twist.pose(EYE, 2.5), atol=1e-12)
    np.testing.assert_allclose(twist.pose(twist.pose(EYE, 123.4), -123.4), EYE, atol=1e-11)


def test_keyframes_interpolate_and_rest_outside():
    motion = Keyframes([1, 2, 4], [[0, 0, 0], [1, 0, 0], [1, 2, 0]], quats=[yaw_quat(0), yaw_quat(1), yaw_quat(0)])
    for t, position, yaw in [(0, (0, 0, 0), 0), (1.5, (0.5, 0, 0), 0.5), (3, (1, 1, 0), 0.5), (9, (1, 2, 0), 0)]:
        pose = motion.pose(EYE, t)
        np.testing.assert_allclose(pose[:3, 3], position)
        assert math.atan2(pose[1, 0], pose[0, 0]) == pytest.approx(yaw)


def test_keyframes_slerp_the_short_way():
    motion = Keyframes([0, 1], [[0, 0, 0]] * 2, quats=[yaw_quat(0.2), np.negative(yaw_quat(0.6))])
    pose = motion.pose(EYE, 0.5)
    assert math.atan2(pose[1, 0], pose[0, 0]) == pytest.approx(0.4)
    assert motion.speed_bound(2.0) == pytest.approx(0.8)


def test_keyframes_without_quats_keep_the_orientation_and_one_keyframe_rests():
    start = Box((1, 1, 1), quat=yaw_quat(0.7)).pose
    pose = Keyframes([3], [[1, 2, 3]]).pose(start, 10)
    np.testing.assert_allclose(pose[:3, 3], (1, 2, 3))
    np.testing.assert_array_equal(pose[:3, :3], start[:3, :3])
    assert Keyframes([3], [[1, 2, 3]]).speed_bound(1) == 0.0


def test_closed_loop_repeats_and_is_continuous():
    motion = Keyframes([1, 2, 4], [[0, 0, 0], [1, 0, 0], [0, 0, 0]], loop=True)
    assert not motion.jumps
    for t in (0.3, 1.4, 2.9):
        for turns in (-2, 1, 5):
            np.testing.assert_allclose(motion.pose(EYE, t + 3 * turns), motion.pose(EYE, t), atol=1e-12)
    assert motion.speed_bound(1.0) == pytest.approx(1.0)


def test_open_loop_jumps_and_only_the_interval_with_the_jump_is_unbounded():
    motion = Keyframes([0, 10], [[0, 0, 0], [5, 0, 0]], loop=True)
    assert motion.jumps
    assert motion.speed_bound(1.0) == math.inf
    assert motion.speed_bound(1.0, start=2, end=9) == pytest.approx(0.5)
    assert motion.speed_bound(1.0, start=0, end=9) == pytest.approx(0.5)  # at 0 it is there already
    assert motion.speed_bound(1.0, start=-1e-12, end=9) == math.inf
    assert motion.speed_bound(1.0, start=9, end=11) == math.inf
    assert motion.speed_bound(1.0, start=32, end=39) == pytest.approx(0.5)
    assert motion.speed_bound(1.0, start=32, end=40) == math.inf
    assert motion.speed_bound(1.0, start=-8, end=-1) == pytest.approx(0.5)
    assert motion.speed_bound(1.0, start=3, end=14) == math.inf
    assert motion.speed_bound(1.0, start=3) == math.inf


def test_interval_of_the_speed_bound_counts_only_its_pieces():
    motion = Keyframes([0, 1, 2, 3], [[0, 0, 0], [1, 0, 0], [1, 0, 0], [4, 0, 0]])
    assert motion.speed_bound(0) == 3
    assert motion.speed_bound(0, end=0.5) == 1
    assert motion.speed_bound(0, start=1.2, end=1.8) == 0
    assert motion.speed_bound(0, start=3.5) == 0
    assert motion.speed_bound(0, start=-2, end=-1) == 0
    with refused(SceneError, "start", "end"):
        motion.speed_bound(0, start=2, end=1)
    with refused(SceneError, "radius"):
        motion.speed_bound(-1)


def fastest(motion, radius, start, end, rng):
    """Largest speed [m/s] of sampled points of a ball along a sampled trajectory, from finite differences."""
    points = rng.normal(size=(100, 3))
    points *= radius / np.linalg.norm(points, axis=1)[:, None]
    times = np.linspace(start, end, 800)
    poses = np.array([motion.pose(EYE, t) for t in times])
    paths = np.einsum("tij,pj->tpi", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    return (np.linalg.norm(np.diff(paths, axis=0), axis=2) / np.diff(times)[:, None]).max()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_speed_bound_of_a_twist_holds_and_is_nearly_reached(seed):
    rng = np.random.default_rng(seed)
    motion = Twist(rng.normal(size=3), rng.normal(size=3) * 2)
    seen, bound = fastest(motion, 0.7, 0.0, 4.0, rng), motion.speed_bound(0.7)
    assert seen <= bound * (1 + 1e-9)
    assert seen >= 0.6 * bound


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_speed_bound_of_keyframes_holds_on_intervals(seed, loop):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    times = np.cumsum(rng.uniform(0.2, 2.0, count))
    positions, quats = rng.normal(size=(count, 3)), rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    if loop:
        positions[-1], quats[-1] = positions[0], quats[0]
    motion = Keyframes(times, positions, quats=quats, loop=loop)
    assert not motion.jumps
    start = rng.uniform(-1, times[-1])
    end = start + rng.uniform(0.1, 3.0)
    assert fastest(motion, 0.7, start, end, rng) <= motion.speed_bound(0.7, start=start, end=end) * (1 + 1e-6) + 1e-6
    assert motion.speed_bound(0.7, start=start, end=end) <= motion.speed_bound(0.7)
    everywhere = fastest(motion, 0.7, times[0] + 1e-6, times[-1] - 1e-6, rng)
    assert 0.5 * motion.speed_bound(0.7) <= everywhere * 1.2


def seen_velocity(motion, pose, t, step=1e-6):
    """Linear and angular velocity [m/s, rad/s], world frame, by finite differences just after ``t``."""
    before, after = motion.pose(pose, t), motion.pose(pose, t + step)
    turn = (after[:3, :3] - before[:3, :3]) @ before[:3, :3].T / step
    return (after[:3, 3] - before[:3, 3]) / step, np.array([turn[2, 1], turn[0, 2], turn[1, 0]])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_velocity_is_the_right_sided_derivative_of_the_pose(seed, turning, loop):
    """Twists and keyframes, between keyframes, at them, before the first and after the last; loops too."""
    rng = np.random.default_rng(seed)
    pose = Box((1, 1, 1), at=rng.normal(size=3), quat=yaw_quat(rng.uniform(-3, 3))).pose
    count = int(rng.integers(2, 6))
    times = np.round(np.cumsum(rng.uniform(0.2, 2.0, count)), 3)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    frames = Keyframes(times, rng.normal(size=(count, 3)), quats=quats if turning else None, loop=loop)
    twist = Twist(rng.normal(size=3), rng.normal(size=3) if turning else (0, 0, 0))
    for motion in (frames, twist):
        for t in (times[0] - 0.50037, *times[:-1], times[-1] + 0.30037, *rng.uniform(times[0], times[-1] - 1e-4, 10)):
            linear, angular = motion.velocity(pose, t)
            seen = seen_velocity(motion, pose, t)
            np.testing.assert_allclose(linear, seen[0], atol=1e-4)
            np.testing.assert_allclose(angular, seen[1], atol=1e-4)
    if not loop:
        assert not np.any(frames.velocity(pose, times[-1]))
    assert Keyframes([1.0], [[0, 0, 0]]).velocity(pose, 1.0)[0].tolist() == [0, 0, 0]


def test_velocity_never_exceeds_the_speed_bound():
    motion = Keyframes([0, 1, 3], [[0, 0, 0], [2, 0, 0], [2, 3, 0]], quats=[yaw_quat(a) for a in (0, 1, -1)])
    for t in np.linspace(-1, 4, 60):
        linear, angular = motion.velocity(EYE, t)
        bound = motion.speed_bound(0.5, start=t, end=t + 1e-9)
        assert np.linalg.norm(linear) + 0.5 * np.linalg.norm(angular) <= bound + 1e-9


def test_velocity_of_an_obstacle_is_that_of_its_own_time():
    """A twist goes on from where an obstacle was moved to; keyframes keep their own clock."""
    motion = Keyframes([0, 1, 3], [[0, 0, 0], [2, 0, 0], [2, 3, 0]])
    scene = Scene([Sphere(0.1, name="a", motion=motion), Sphere(0.1, name="b", motion=Twist((1, 0, 0)))], time=2.0)
    moved = scene.moved("a", EYE).moved("b", EYE)
    np.testing.assert_allclose(moved.obstacle("a").velocity()[0], (0, 1.5, 0))
    np.testing.assert_allclose(moved.obstacle("b").velocity()[0], (1, 0, 0))
    np.testing.assert_allclose(scene.at(0.5).obstacle("a").velocity()[0], (2, 0, 0))
    assert not np.any(Sphere(0.1).velocity())


def test_an_unknown_motion_stays_but_may_move():
    """Its pose is the last one and its velocity 0; its bound holds at all times and for any shape."""
    ball = Sphere(0.4, at=(1, 2, 3), motion=UnknownMotion(1.2))
    for t in (-5.0, 0.0, 7.0):
        np.testing.assert_array_equal(ball.at(t).pose, ball.pose)
        assert not np.any(UnknownMotion(1.2).velocity(ball.pose, t))
    assert ball.speed_bound() == ball.speed_bound(start=3, end=4) == UnknownMotion(1.2).speed_bound(9.0) == 1.2
    assert UnknownMotion(0).max_speed == 0.0


BAD = [
    (lambda: UnknownMotion(-0.1), r"UnknownMotion max_speed=-0\.1 must be .* ≥ 0"),
    (lambda: UnknownMotion(math.nan), "finite"),
    (lambda: UnknownMotion(True), "must be a finite number"),
    (lambda: UnknownMotion(1.0).speed_bound(-1), "radius"),
    (lambda: Sphere(1, motion=1.0), "Twist, Keyframes, UnknownMotion, PedestrianMotion or None"),
    (lambda: Twist((1, 2)), "Twist linear"),
    (lambda: Twist((0, 0, 0), (0, 0, math.inf)), "Twist angular"),
    (lambda: Twist((0, 0, 1e5)), "within"),
    (lambda: Keyframes([0, 0], [[0, 0, 0]] * 2), "increase strictly"),
    (lambda: Keyframes([1, 0], [[0, 0, 0]] * 2), "increase strictly"),
    (lambda: Keyframes([0, 1], [[0, 0, 0]]), "one position per time"),
    (lambda: Keyframes([], np.zeros((0, 3))), "numbers|empty"),
    (lambda: Keyframes([0, 1], [[0, 0]] * 2), "shape"),
    (lambda: Keyframes([0, 1], [[0, 0, 0]] * 2, quats=[[0, 0, 0, 1]]), "one quaternion per time"),
    (lambda: Keyframes([0, 1], [[0, 0, 0]] * 2, quats=[[0, 0, 0, 1], [0, 0, 0, 2]]), r"quats\[1\]"),
    (lambda: Keyframes([0, 1], [[0, 0, 0]] * 2, loop="yes"), "true or false"),
    (lambda: Keyframes([0], [[0, 0, 0]], loop=True), "at least two"),
    (lambda: Keyframes([0, 1e-9], [[0, 0, 0], [1, 0, 0]]), "at most"),
]


@each("make, message", BAD)
def test_bad_motions_are_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_obstacle_at_is_absolute_in_time():
    ball = Sphere(0.1, at=(1, 0, 0), motion=Twist((1, 0, 0)))
    assert ball.at(2).at(5).pose[0, 3] == pytest.approx(6)
    assert ball.at(2).at(0).pose[0, 3] == pytest.approx(1)
    assert ball.at(0) is ball
    assert Sphere(1).at(7).pose[0, 3] == 0


def test_a_moved_obstacle_goes_on_from_there():
    pose = np.eye(4)
    pose[:3, 3] = 10, 0, 0
    moved = Sphere(0.1, motion=Twist((1, 0, 0))).at(2).moved(pose)
    assert moved.at(5).pose[0, 3] == pytest.approx(13)
    track = Sphere(0.1, motion=Keyframes([0, 10], [[0, 0, 0], [10, 0, 0]])).at(2).moved(pose)
    assert track.pose[0, 3] == 10
    assert track.at(3).pose[0, 3] == pytest.approx(3)


def test_keyframes_give_the_pose_at_time_zero():
    assert Sphere(0.1, motion=Keyframes([0, 1], [[3, 0, 0], [4, 0, 0]])).pose[0, 3] == 3


def test_obstacle_speed_bound_covers_its_own_points():
    box = Box((2, 0.2, 0.2), motion=Twist((1, 0, 0), (0, 0, 2)))
    assert box.speed_bound() == pytest.approx(1 + 2 * np.linalg.norm((1, 0.1, 0.1)))
    assert Box((1, 1, 1)).speed_bound() == 0.0
    jumping = Sphere(0.1, motion=Keyframes([0, 10], [[0, 0, 0], [5, 0, 0]], loop=True))
    assert jumping.speed_bound() == math.inf
    assert jumping.speed_bound(start=1, end=2) == pytest.approx(0.5)


def test_motion_that_leaves_the_world_is_refused():
    with refused(SceneError, "beyond"):
        Sphere(0.1, motion=Twist((1e4, 0, 0))).at(1e4)
