"""Paths among what appears, vanishes, moves, and moves as nobody knows: all times of the path are looked at."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import link_distances
from cases import each, refused

from elastic_strips.collision import Verdict, certify
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Keyframes, Obstacle, Scene, Sphere, Twist, UnknownMotion, World

UNKNOWN = UnknownMotion(0.1)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("silvermate", base="omni")


def _drive(robot: RobotModel, *x: float) -> list[np.ndarray]:
    return [robot.home(x=value) for value in x]


def _crate(x: float = 2.0, y: float = 0.0, motion: UnknownMotion | Twist | None = None) -> Box:
    return Box((0.4, 0.4, 1.0), at=(x, y, 0.5), name="crate", motion=motion)


def _least(robot: RobotModel, world: World, q: list[np.ndarray], times: list[float], count: int = 400) -> float:
    """The least distance less what unknown motions may have gone, at many times, by Pinocchio and Coal."""
    rows, least = robot.space.to_coordinates(np.array(q)), np.inf
    for t in np.linspace(times[0], times[-1], count):
        row = np.array([np.interp(t, times, column) for column in rows.T])
        for obstacle in world.scene:
            if not world.exists(obstacle.name, t):
                continue
            margin = 0.0
            if isinstance(obstacle.motion, UnknownMotion):
                margin = obstacle.motion.max_speed * abs(t - world.scene.time)
            one = Scene([obstacle.at(t)], time=t)
            least = min(least, link_distances(robot, one, robot.space.from_coordinates(row)).min() - margin)
    return float(least)


@each("appears", [0.5, 1.0, 1.9, 2.0, 2.1])
def test_what_appears_on_the_way_is_looked_at(robot, appears):
    """The robot is at the crate's place from about 1.2 s to 2.8 s; the crate is not there at first."""
    world = World(Scene([_crate()]), appears={"crate": appears})
    found = certify(robot, world, _drive(robot, 0.0, 4.0), times=[0.0, 4.0])
    assert _least(robot, world, _drive(robot, 0.0, 4.0), [0.0, 4.0]) < -0.1
    assert found.verdict is Verdict.REFUTED
    assert found.broken.obstacle == "crate"
    assert found.time >= appears - 1e-9
    assert link_distances(robot, world.at(found.time), found.q).min() <= 1e-6


@each(
    ("appears", "vanishes", "free"),
    [
        (3.5, None, True),  # when the robot has passed
        (None, 0.5, True),  # before it comes
        (None, 2.0, False),
        (1.9, 2.0, False),  # between two waypoints, for a moment
        (-3.0, 0.2, True),
        (4.0, None, True),  # when it has arrived, elsewhere
        (-2.0, 9.0, False),
        (5.0, 6.0, True),  # after the path
        (-6.0, -5.0, True),
    ],
)
def test_what_is_there_for_a_while_counts_then(robot, appears, vanishes, free):
    world = World(
        Scene([_crate()]),
        appears={} if appears is None else {"crate": appears},
        vanishes={} if vanishes is None else {"crate": vanishes},
    )
    q, times = _drive(robot, 0.0, 2.0, 4.0), [0.0, 2.0, 4.0]
    assert (_least(robot, world, q, times) > 0.0) == free
    assert certify(robot, world, q, times=times).certified == free


@each(
    ("appears", "vanishes"),
    [(1.9, float(np.nextafter(1.9, 2.0))), (2.0, 2.0 + 1e-9), (float(np.nextafter(2.0, 0.0)), 2.0)],
)
@each("motion", [None, UnknownMotion(1e-9), Twist((0.0, 0.1, 0.0))])
def test_what_is_there_between_two_numbers_is_there(robot, appears, vanishes, motion):
    """No number lies between the events: who asks in the middle, or by the share of the way, finds nobody."""
    world = World(Scene([_crate(motion=motion)]), appears={"crate": appears}, vanishes={"crate": vanishes})
    found = certify(robot, world, _drive(robot, 0.0, 4.0), times=[0.0, 4.0])
    assert found.verdict is Verdict.REFUTED
    assert found.time == pytest.approx(appears, abs=1e-6)
    assert certify(robot, world, _drive(robot, 8.0, 4.0), times=[0.0, 4.0]).certified


def test_what_appears_where_the_path_ends_is_met(robot):
    world = World(Scene([_crate(4.0)]), appears={"crate": 4.0})
    assert certify(robot, world, _drive(robot, 0.0, 4.0), times=[0.0, 4.0]).verdict is Verdict.REFUTED
    assert certify(robot, world, _drive(robot, 0.0, 4.0), times=[-1.0, 3.0]).certified
    still = certify(robot, world, _drive(robot, 0.0, 4.0, 4.0), times=[0.0, 3.0, 5.0])
    assert still.verdict is Verdict.REFUTED


def test_what_moves_and_appears_does_both(robot):
    motion = Twist(linear=(0.0, 1.0, 0.0))
    late = World(Scene([Sphere(0.3, at=(2.0, -2.0, 0.5), name="ball", motion=motion)]), appears={"ball": 1.9})
    gone = World(late.scene, vanishes={"ball": 0.9})
    q, times = _drive(robot, 0.0, 4.0), [0.0, 4.0]
    assert certify(robot, late, q, times=times).verdict is Verdict.REFUTED
    assert certify(robot, gone, q, times=times).certified


@each(
    ("speed", "y", "free", "kind"),
    [(*row, kind) for row in [(0.1, 1.2, True), (0.4, 1.2, False), (0.02, 0.0, False)] for kind in (World, Scene)],
)
def test_unknown_motion_may_have_gone_anywhere(robot, speed, y, free, kind):
    scene = Scene([_crate(2.0, y, UnknownMotion(speed))])
    world = World(scene)
    q, times = _drive(robot, 0.0, 4.0), [0.0, 4.0]
    assert (_least(robot, world, q, times) > 0.0) == free
    found = certify(robot, world if kind is World else scene, q, times=times)
    assert found.certified == free
    if not free:
        assert found.broken.obstacle == "crate"
        assert found.verdict is (Verdict.REFUTED if y == 0.0 else Verdict.UNKNOWN)


def test_unknown_motion_counts_from_the_time_of_the_scene(robot):
    q = _drive(robot, 0.0, 4.0)
    seen = Scene([_crate(2.0, 1.3, UnknownMotion(0.2))], time=10.0)
    assert certify(robot, seen, q, times=[9.0, 11.0]).certified
    assert not certify(robot, seen, q, times=[10.0, 20.0]).certified
    assert not certify(robot, seen, q, times=[0.0, 4.0]).certified  # nor before
    moved = Scene([_crate(2.0, 1.3, UnknownMotion(0.2))]).at(10.0).moved("crate", seen.obstacles[0].pose)
    assert not certify(robot, World(moved.at(16.0)), q, times=[15.0, 17.0]).certified  # it was seen at 10 s


def test_what_is_far_and_unknown_is_no_alarm(robot):
    """A large bound of one obstacle is not that of the others."""
    near = Box((0.4, 0.4, 1.0), at=(2.0, 1.0, 0.5), name="near", motion=UnknownMotion(0.01))
    slow = Sphere(0.1, at=(2.0, -1.0, 0.5), name="slow", motion=Twist(linear=(0.0, 0.01, 0.0)))
    far = Box((0.4, 0.4, 1.0), at=(2.0, 90.0, 0.5), name="far", motion=UnknownMotion(20.0))
    q, times = _drive(robot, 0.0, 4.0), [0.0, 4.0]
    assert certify(robot, Scene([near, slow, far]), q, times=times).certified
    found = certify(robot, Scene([near, slow, far]), q, times=[0.0, 8.0])
    assert found.verdict is Verdict.UNKNOWN
    assert found.broken.obstacle == "far"


def test_a_loop_that_jumps_is_on_one_side_or_the_other(robot):
    def world(y: float) -> World:
        hop = Keyframes([0.0, 1.0], [(2.0, y, 0.5), (2.0, y + 0.5, 0.5)], loop=True)
        return World(Scene([Sphere(0.2, name="hop", motion=hop)]))

    q, times = _drive(robot, 0.0, 4.0), [0.0, 4.0]
    assert certify(robot, world(1.5), q, times=times).certified
    assert certify(robot, world(-0.2), q, times=times).verdict is Verdict.REFUTED


def test_an_untimed_path_in_a_world_that_changes_is_refused(robot):
    q = _drive(robot, 0.0, 1.0)
    worlds = [
        World(Scene([_crate()]), appears={"crate": 1.0}),
        World(Scene([_crate()]), vanishes={"crate": -1.0}),
        World(Scene([_crate(motion=UNKNOWN)])),
    ]
    for world in worlds:
        with refused(ParameterError, "crate"):
            certify(robot, world, q)
        with refused(ParameterError, "crate"):
            certify(robot, world, q, times=[0.0, 0.0])
    assert certify(robot, World(Scene([_crate(4.0)])), q).certified


def test_a_scene_that_is_taken_as_it_stands_says_so(robot):
    q = _drive(robot, 0.0, 1.0)
    for motion in (UNKNOWN, Twist(linear=(1.0, 0.0, 0.0))):
        found = certify(robot, Scene([_crate(4.0, motion=motion)], time=0.5), q)
        assert found.certified
        assert any("crate" in note and "0.5 s" in note for note in found.notes)
        assert all(note in found.reason for note in found.notes)
    assert certify(robot, Scene([_crate(4.0)]), q).notes == ()


def _obstacle(rng: np.random.Generator, name: str) -> Obstacle:
    at = (*rng.uniform((0.0, -1.6), (4.0, 1.6)), 0.5)
    turn = float(rng.integers(3))
    if turn == 0.0:
        motion = Twist(linear=(*rng.normal(0.0, 0.4, 2), 0.0), angular=(0.0, 0.0, rng.normal()))
    else:
        motion = UnknownMotion(float(rng.uniform(0.0, 0.15))) if turn == 1.0 else None
    return Box((*rng.uniform(0.1, 0.5, 2), 1.0), at=at, name=name, motion=motion)


@pytest.mark.parametrize("seed", range(20))
def test_the_verdict_is_that_of_dense_sampling_in_time(robot, seed):
    rng = np.random.default_rng(seed)
    names = ["a", "b"]
    scene = Scene([_obstacle(rng, name) for name in names], time=float(rng.uniform(-1.0, 4.0)))
    appears = {name: float(rng.uniform(0.0, 3.0)) for name in names if rng.random() < 0.5}
    vanishes = {name: appears.get(name, 0.0) + float(rng.uniform(0.1, 3.0)) for name in names if rng.random() < 0.5}
    world = World(scene, appears, vanishes)
    q, times = _drive(robot, 0.0, *rng.uniform(0.0, 4.0, 2)), [0.0, 2.0, 4.0]
    if not (world.names_moving or appears or vanishes):
        return
    found, truth = certify(robot, world, q, times=times), _least(robot, world, q, times)
    if found.certified:
        assert truth > 0.0
    else:
        assert truth < 5e-3
    if found.verdict is Verdict.REFUTED:
        assert link_distances(robot, world.at(found.time), found.q).min() <= 1e-6
