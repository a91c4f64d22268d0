"""Evaluation: as strict as brute force, also between samples, and fair to a robot that stands."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, distance, link_poses, make_scene, random_coordinates, scene_pieces
from cases import each, refused
from synthetic_run import moving_world, straight_run

from elastic_strips.control.record import Recorder, RecordError
from elastic_strips.errors import ParameterError
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder, Keyframes, Points, Scene, Sphere, Twist, Voxels, World
from elastic_strips.sim.evaluation.clearance_search import ClearanceSearch, LinkMotion
from elastic_strips.sim.evaluation.drive_evaluation import Tolerance, evaluate
from elastic_strips.trajectory.limits import MotionLimits


def at(robot, time, coordinates, t):
    """Configuration of a motion at any time."""
    k = min(int(np.searchsorted(time, t, side="right")) - 1, len(time) - 2)
    share = (t - time[k]) / (time[k + 1] - time[k])
    a, b = configuration(robot, coordinates[k]), configuration(robot, coordinates[k + 1])
    return pin.interpolate(robot.model, a, b, float(share))


def brute(robot, time, coordinates, world, t):
    """Smallest distance [m] at one time, by Coal alone."""
    poses = link_poses(robot, at(robot, time, coordinates, t))
    pieces = scene_pieces(world.at(t))
    return min(
        (
            distance(link.geometry, poses[g], piece.geometry, piece.T)[0]
            for g, link in enumerate(robot.geometries)
            for piece in pieces
        ),
        default=np.inf,
    )


def drive(robot, speed=0.5, seconds=4.0, dt=0.01, **where):
    """Time, coordinates and velocity of a base that drives straight on."""
    time = np.arange(0.0, seconds + 0.5 * dt, dt)
    coordinates = np.tile(robot.space.to_coordinates(robot.home(**where)), (len(time), 1))
    v = np.zeros_like(coordinates)
    coordinates[:, 0] += speed * time
    v[:, 0] = speed
    return time, coordinates, v


@pytest.mark.parametrize("case", range(2))
@pytest.mark.parametrize("name", ["silvermate", "tiago", "gantry", "rover"])
def test_the_clearance_is_that_of_brute_force(name, case, rng, request):
    """At steps of a tenth of a radian and more, among all shapes, moving, appearing and vanishing."""
    robot = request.getfixturevalue(name)
    rng = np.random.default_rng([case, len(name)])
    low, high = (1.5, -1.5, 0.0), (3.0, 1.5, 1.5)
    fixed = not robot.space.planar
    obstacles = list(make_scene(rng, 9, low=(0.5, -0.7, 0) if fixed else low, high=(1.3, 0.7, 1) if fixed else high))
    for k in (1, 4, 7):
        o = obstacles[k]
        motion = Twist(rng.normal(size=3) * 0.3, rng.normal(size=3))
        obstacles[k] = type(o)(**o.spec, at=o.pose[:3, 3], motion=motion) if o.shape != "mesh" else o
    names = Scene(obstacles).names
    world = World(Scene(obstacles), appears={names[2]: 0.33}, vanishes={names[5]: 0.71, names[1]: 0.9})
    start = random_coordinates(robot, rng, 1, low=(-0.5, -0.5), high=(0.5, 0.5))[0]
    steps = rng.normal(size=(8, robot.nv)) * 0.12
    coordinates = [start]
    for step in steps:
        coordinates.append(robot.space.integrate(coordinates[-1], step))
    time, coordinates = np.linspace(0.0, 1.2, 9), np.array(coordinates)
    evaluation = evaluate((time, coordinates, np.zeros_like(coordinates)), robot, world, accuracy=1e-3)
    sampled = min(brute(robot, time, coordinates, world, t) for t in np.linspace(0.0, 1.2, 33))
    assert evaluation.min_clearance_m <= sampled + 1e-3 + 1e-5
    assert evaluation.closest is not None
    moment = evaluation.closest.time
    assert evaluation.min_clearance_m == pytest.approx(
        min(brute(robot, time, coordinates, world, t) for t in (moment - 1e-9 if moment > 0 else 0.0, moment)), abs=2e-5
    )
    assert bool(evaluation.contacts) == (evaluation.min_clearance_m <= 0.0)
    assert evaluation.queries < 81 * len(robot.geometries) * len(scene_pieces(world.scene)) / 10


@each("name", ["silvermate", "tiago", "gantry"])
def test_no_point_travels_farther_than_its_bound(name, rng, request):
    robot = request.getfixturevalue(name)
    coordinates = [random_coordinates(robot, rng, 1)[0]]
    for step in rng.normal(size=(12, robot.nv)) * np.repeat([0.003, 0.2, 0.6], 4)[:, None]:
        coordinates.append(robot.space.integrate(coordinates[-1], step))
    time, coordinates = np.arange(13.0), np.array(coordinates)
    motion = LinkMotion(robot, time, coordinates, np.zeros(0))
    corners = np.array([link.corners for link in motion.links])
    bound = np.array([motion.travelled(k, k + 1) for k in range(12)])
    for k in range(12):
        poses = np.array([link_poses(robot, at(robot, time, coordinates, t)) for t in np.linspace(k, k + 1, 101)])
        world = corners @ np.swapaxes(poses[..., :3, :3], -1, -2) + poses[..., None, :3, 3]
        steps = np.linalg.norm(np.diff(world, axis=0), axis=-1).max(axis=-1)  # (100, G): evenly in time
        assert (steps.sum(axis=0) <= bound[k] + 1e-9).all()
        assert (steps <= bound[k] / 100 + 1e-9).all()
        if k < 4:  # small steps: hardly more than what they really move
            assert (bound[k] < 1.35 * steps.sum(axis=0) + 1e-3).all()


BOOM = """<robot name="boom">
  <link name="post"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="swivel"/>
  <link name="ball"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="swing" type="revolute"><parent link="post"/><child link="swivel"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <joint name="reach" type="prismatic"><parent link="swivel"/><child link="ball"/>
    <axis xyz="1 0 0"/><limit lower="0.1" upper="3" velocity="1" effort="1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def boom(tmp_path_factory):
    """A ball that slides far out: what turns it moves it as far as it is out."""
    path = tmp_path_factory.mktemp("boom") / "boom.urdf"
    path.write_text(BOOM)
    return load_robot(path, base="fixed")


@each("name", ["silvermate", "tiago", "gantry", "boom"])
def test_no_velocity_moves_a_link_more_than_its_lever(name, rng, request):
    robot = request.getfixturevalue(name)
    for coordinates in random_coordinates(robot, rng, 30):
        motion = LinkMotion(robot, np.zeros(1), coordinates[None], np.zeros(0))
        for i, e in enumerate(np.eye(robot.nv) * 1e-6):
            moved = LinkMotion(robot, np.zeros(1), robot.space.integrate(coordinates, e)[None], np.zeros(0))
            for g, link in enumerate(motion.links):
                out = link.corners - link.centre
                points = link.centre + out * link.radius / np.linalg.norm(out, axis=1, keepdims=True)
                ends = [T[0, g, :3, :3] @ points.T + T[0, g, :3, 3:] for T in (motion.poses, moved.poses)]
                speed = np.linalg.norm(ends[1] - ends[0], axis=0).max() / 1e-6
                assert speed <= link.lever[i] * 1.0001 + 1e-6
                turned = np.abs(moved.poses[0, g, :3, :3] - motion.poses[0, g, :3, :3]).max() > 1e-9
                assert not turned or link.turns[i] == 1.0


def _by_twist(x, t):
    return Twist(linear=(0.0, 100.0, 0.0)), (x, -100.0 * t, 0.7)


def _by_keyframes(x, t):
    return Keyframes([0.0, t - 0.002, t, t + 0.002], [[x, 2, 0.7], [x, 2, 0.7], [x, -2, 0.7], [x, 2, 0.7]]), (0, 0, 0)


@pytest.mark.parametrize("motion", [_by_twist, _by_keyframes])
def test_a_plate_that_flies_through_between_two_samples(silvermate, motion):
    """A plate 4 mm thick crosses the drive at 100 m/s and more: before it at one sample, behind it at the next."""
    time, coordinates, v = drive(silvermate, 0.5, 2.0)
    flight, where = motion(coordinates[0, 0] + 0.5 * 1.005, 1.005)
    plate = Box((0.004, 0.004, 0.3), at=where, motion=flight, name="plate")
    world = World(Scene([plate, Box((0.2, 0.2, 0.2), at=(0, 3, 0))]))
    assert min(brute(silvermate, time, coordinates, world, t) for t in time[95:107]) > 0.05
    evaluation = evaluate((time, coordinates, v), silvermate, world)
    assert [c.obstacle for c in evaluation.collisions] == ["plate"]
    hit = evaluation.collisions[0]
    assert 1.0 < hit.time <= hit.end < 1.01
    assert hit.speed == pytest.approx(0.5, abs=1e-9)
    assert evaluation.min_clearance_m <= 0.0


def test_a_pole_that_a_coarse_motion_jumps_over(silvermate):
    time, coordinates, v = drive(silvermate, 2.0, 3.0, dt=1.0)
    world = World(Scene([Cylinder(0.005, 1.0, at=(3.0, 0.0, 0.5), name="pole")]))
    assert min(brute(silvermate, time, coordinates, world, t) for t in time) > 0.5
    evaluation = evaluate((time, coordinates, v), silvermate, world)
    assert len(evaluation.collisions) == 1
    assert evaluation.min_clearance_m < -0.1  # it goes right through
    assert len(evaluate((time, coordinates, v), silvermate, world, accuracy=1.0).collisions) == 1  # however coarse


@pytest.mark.parametrize("gap", [3e-4, -3e-4])
def test_a_near_miss_is_no_contact_and_a_graze_is_one(silvermate, gap):
    """A third of a millimetre, beside the widest part, with samples before and behind only."""
    time, coordinates, v = drive(silvermate, 1.0, 3.0, dt=1.0)
    probe = World(Scene([Cylinder(0.05, 0.02, at=(1.5, 2.0, 0.05), name="post")]))
    width = 2.0 - evaluate((time, coordinates, v), silvermate, probe, accuracy=1e-6).min_clearance_m
    post = Cylinder(0.05, 0.02, at=(1.5, width + gap, 0.05), name="post")
    evaluation = evaluate((time, coordinates, v), silvermate, World(Scene([post])))
    assert bool(evaluation.contacts) == (gap < 0)
    assert evaluation.min_clearance_m == pytest.approx(gap, abs=1e-3)


def test_a_robot_that_stands_is_not_to_blame(silvermate):
    time, coordinates, v = drive(silvermate, 0.0, 5.0)
    person = Sphere(0.2, at=(2.0, 0.0, 0.3), motion=Twist(linear=(-0.8, 0.0, 0.0)), name="person")
    evaluation = evaluate((time, coordinates, v), silvermate, World(Scene([person])))
    assert evaluation.collisions == ()
    (contact,) = evaluation.rest_contacts
    assert contact.obstacle == "person"
    assert contact.speed == 0.0
    assert contact.depth > 0.1
    assert evaluation.rest_s == pytest.approx(5.0)


def test_a_robot_that_the_obstacle_stopped_is_to_blame(silvermate):
    """Its velocity is zero at the very sample where it touches first; at the one before it was not."""
    time, coordinates, v = drive(silvermate, 0.5, 4.0)
    wall = World(Scene([Box((0.2, 2.0, 1.0), at=(1.5, 0, 0.5), name="wall")]))
    touch = int(np.flatnonzero([brute(silvermate, time, coordinates, wall, t) <= 0 for t in time])[0])
    coordinates[touch:], v[touch:] = coordinates[touch], 0.0
    evaluation = evaluate((time, coordinates, v), silvermate, wall)
    (contact,) = evaluation.collisions
    assert contact.time == pytest.approx(time[touch])
    assert contact.end == time[-1]
    assert contact.speed == pytest.approx(0.5)
    assert 0.0 <= contact.depth <= 0.006


def test_the_speed_is_that_of_the_fastest_control_point(silvermate):
    time, coordinates, v = drive(silvermate, 0.0, 1.0)
    coordinates[:, 2] += 0.4 * time
    v[:, 2] = 0.4
    world = World(Scene([Box((0.05, 0.05, 0.05), at=(0.0, 0.0, 0.3), name="inside")]))
    (contact,) = evaluate((time, coordinates, v), silvermate, world).collisions
    points = silvermate.control_points(silvermate.space.from_coordinates(coordinates[0]))
    assert contact.speed == pytest.approx(0.4 * np.linalg.norm(points[:, :2], axis=1).max(), rel=1e-9)


def test_episodes_are_counted_once_each(silvermate):
    time = np.arange(0.0, 8.0, 0.01)
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home()), (len(time), 1))
    coordinates[:, 0] = 1.2 * np.sin(2.0 * np.pi * time / 4.0)  # forth, back, forth, back
    v = np.zeros_like(coordinates)
    v[:, 0] = 1.2 * 2.0 * np.pi / 4.0 * np.cos(2.0 * np.pi * time / 4.0)
    post = Cylinder(0.1, 1.5, at=(1.35, 0, 0.75), name="post")
    evaluation = evaluate(
        (time, coordinates, v), silvermate, World(Scene([post, Sphere(0.1, at=(0, 2.0, 1), name="far")]))
    )
    assert [c.obstacle for c in evaluation.collisions] == ["post", "post"]
    first, second = evaluation.collisions
    assert second.time - first.time == pytest.approx(4.0, abs=0.02)
    assert first.end < 2.0 < 4.0 < second.time


def test_what_touches_again_and_again_is_one_episode(silvermate):
    time, coordinates, v = drive(silvermate, 0.0, 2.0)
    beat = Keyframes([0.0, 0.05, 0.1], [[1.5, 0, 0.3], [0.2, 0, 0.3], [1.5, 0, 0.3]], loop=True)
    evaluation = evaluate(
        (time, coordinates, v), silvermate, World(Scene([Sphere(0.1, motion=beat, name="drumstick")]))
    )
    (contact,) = evaluation.rest_contacts
    assert contact.time < 0.06
    assert contact.end > 1.94


@pytest.mark.parametrize("name", ["silvermate", "gantry"])
def test_spheres_and_cylinders_penetrate_to_their_caps(name, request):
    """Coal's closed form for them knows the wall only: a ball in a wide, flat cylinder would be far inside."""
    robot = request.getfixturevalue(name)
    time = np.array([0.0])
    coordinates = robot.space.to_coordinates(robot.home_q)[None]
    poses = link_poses(robot, robot.home_q)
    kinds = {type(g.geometry).__name__ for g in robot.geometries}
    assert {"Sphere", "Cylinder"} <= kinds
    for g, link in enumerate(robot.geometries):
        at = poses[g, :3, 3] + [0.0, 0.0, 0.01]
        flat = Cylinder(5.0, 0.04, at=at, name="flat")
        ball = Sphere(0.02, at=at, name="ball")
        for obstacle in (flat, ball):
            world = World(Scene([obstacle]))
            search = ClearanceSearch(robot, time, coordinates, world)
            expected = distance(link.geometry, poses[g], obstacle.parts[0].geometry, obstacle.pose)[0]
            assert search.distance(g, 0, 0.0) == pytest.approx(expected, abs=2e-5)
            assert expected > -1.0


def test_what_does_not_exist_is_not_hit(silvermate):
    time, coordinates, v = drive(silvermate, 0.5, 4.0)
    box = Box((0.1, 0.1, 0.5), at=(1.0, 0.0, 0.25), name="box")
    hit = evaluate((time, coordinates, v), silvermate, World(Scene([box]))).collisions[0]
    inside = 0.5 * (hit.time + hit.end)
    for world, count in (
        (World(Scene([box]), vanishes={"box": hit.time - 0.004}), 0),
        (World(Scene([box]), vanishes={"box": hit.time + 0.004}), 1),
        (World(Scene([box]), appears={"box": hit.end + 0.004}), 0),
        (World(Scene([box]), appears={"box": inside + 0.0037}), 1),
        (World(Scene([box]), appears={"box": 100.0}), 0),
        (World(Scene([box]), vanishes={"box": -1.0}), 0),
    ):
        evaluation = evaluate((time, coordinates, v), silvermate, world)
        assert len(evaluation.contacts) == count
        if 0.0 < world.appears.get("box", 0.0) < 4.0 and count:
            assert evaluation.contacts[0].time == pytest.approx(inside + 0.0037, abs=1e-9)
    assert evaluate((time, coordinates, v), silvermate, World(Scene([box]), appears={"box": 100.0})).closest is None


def test_an_obstacle_that_jumps_does_not_cross_what_it_jumps_over(silvermate):
    time, coordinates, v = drive(silvermate, 0.0, 3.0)
    jump = Keyframes([0.0, 1.003], [[0, -2.5, 0.5], [0, -2.0, 0.5]], loop=True)
    there = Keyframes([0.0, 1.003], [[0, 2.5, 0.5], [0, -2.0, 0.5]], loop=True)
    apart = evaluate((time, coordinates, v), silvermate, World(Scene([Box((0.2, 0.2, 0.2), motion=jump, name="a")])))
    through = evaluate((time, coordinates, v), silvermate, World(Scene([Box((0.2, 0.2, 0.2), motion=there, name="a")])))
    assert apart.min_clearance_m > 1.0
    assert not apart.contacts
    assert len(through.rest_contacts) == 3  # on its way, and not when it jumps back


@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_the_depth_of_a_robot_deep_inside(name, request):
    """Deeper than the links are thick: no link's bounding sphere reaches out of the obstacle."""
    robot = request.getfixturevalue(name)
    time, coordinates, v = drive(robot, 0.1, 3.0)
    v *= 0.0
    world = World(Scene([Sphere(1.5, at=(0.15, 0.0, 0.6), name="ball"), Box((3, 2, 2.2), at=(9, 0, 0.9), name="box")]))
    evaluation = evaluate((time, coordinates, v), robot, world, accuracy=1e-4)
    sampled = [brute(robot, time, coordinates, world, t) for t in time[::4]]
    assert -2.5 < min(sampled) < -1.5
    assert evaluation.min_clearance_m == pytest.approx(min(sampled), abs=1.5e-3)
    assert evaluation.min_clearance_m <= min(sampled) + 1e-4 + 1e-5
    (contact,) = evaluation.rest_contacts
    assert contact.depth == pytest.approx(-evaluation.min_clearance_m, abs=2e-4)


def test_many_small_parts_are_asked_about_only_where_they_are_near(silvermate, rng):
    grid = np.stack(np.meshgrid(*[np.arange(14)] * 3), axis=-1).reshape(-1, 3) * 0.1
    voxels = Voxels(grid[rng.random(len(grid)) < 0.5], 0.1, at=(0.5, 0.9, 0.0))
    cloud = Points(rng.uniform(0, 1, (400, 3)), 0.02, at=(2.5, -1.6, 0.0))
    world = World(Scene([voxels, cloud]))
    time, coordinates, v = drive(silvermate, 0.5, 6.0, dt=0.05)
    evaluation = evaluate((time, coordinates, v), silvermate, world)
    moments = [*np.linspace(0, 6, 13), evaluation.closest.time]
    sampled = [brute(silvermate, time, coordinates, world, t) for t in moments]
    assert evaluation.min_clearance_m == pytest.approx(sampled[-1], abs=2e-5)
    assert evaluation.min_clearance_m <= min(sampled) + 1e-3
    assert evaluation.queries < 3000


def test_an_ordinary_run_costs_few_questions(silvermate):
    record = straight_run(silvermate, moving_world(), wave=0.3)
    evaluation = evaluate(record, silvermate)
    assert evaluation.queries < 300  # of 1,100 samples × 16 links × 15 obstacles
    assert 0.0 < evaluation.min_clearance_m < 0.2
    assert evaluation.closest.obstacle == "person"


def test_the_figures_of_a_run(silvermate):
    limits = MotionLimits.for_robot(silvermate, wheel_speed=1.0)
    world = moving_world()
    record = straight_run(silvermate, world, wave=0.1)
    evaluation = evaluate(record, silvermate, limits=limits, tolerance=Tolerance(position=0.02))
    coordinates = record.control.coordinates
    assert evaluation.path_m == pytest.approx(np.hypot(*np.diff(coordinates[:, :2], axis=0).T).sum(), rel=1e-6)
    assert evaluation.time_s == record.duration
    assert evaluation.reached is True
    away = np.hypot(*(coordinates[:, :2] - record.goal[:2]).T) > 0.02
    assert evaluation.reached_s == pytest.approx(record.control.time[np.flatnonzero(away)[-1] + 1])
    assert evaluation.max_lateral_slip_m < 1e-12  # the reference's, not the truth's
    assert set(evaluation.excess.values()) == {0.0}
    json.dumps(evaluation.as_dict(), allow_nan=False)
    fastest = np.abs(record.control.v[:, 0]).max()
    slow = MotionLimits.for_robot(silvermate, wheel_speed=0.8 * fastest)
    excess = evaluate(record, silvermate, limits=slow).excess
    assert excess["drive"] == pytest.approx(0.25)
    assert excess["command_drive"] == pytest.approx(0.25)
    assert excess["joints"] == 0.0
    goal = record.goal + np.eye(silvermate.nv)[4] * 0.2
    beside = evaluate(record, silvermate, goal=goal)
    assert beside.reached is False
    assert beside.reached_s is None
    assert evaluate(record, silvermate, goal=goal, tolerance=Tolerance(joints=0.21)).reached is True


def test_commands_that_ask_for_too_much(silvermate):
    limits = MotionLimits.for_robot(silvermate)
    recorder = Recorder(silvermate, Scene())
    row = silvermate.space.to_coordinates(silvermate.home())
    sideways = row.copy()
    sideways[1] += 0.003
    none = np.zeros(silvermate.nv)
    rates = np.eye(7)[2] * 1.5 * limits.joint_speed[2]
    rim = np.array([0.0, 2.0 * limits.drive_acceleration[1] * 0.01])
    still = np.zeros(2)
    recorder.control(0.0, coordinates=row, v=none, reference=row, drive=still, joints=rates, motors=still)
    recorder.control(0.01, coordinates=row, v=none, reference=sideways, drive=rim, joints=rates, motors=rim)
    recorder.control(0.02, coordinates=row, v=none, motors=rim)
    moved = sideways + 0.1  # taken up again where the robot stands: nobody drives there
    for k, rows in enumerate((sideways, moved)):
        recorder.control(0.03 + 0.01 * k, coordinates=row, v=none, reference=rows, reference_v=none, motors=rim)
    evaluation = evaluate(recorder.finish(), silvermate, limits=limits)
    assert evaluation.excess["command_joints"] == pytest.approx(0.5)
    assert evaluation.excess["joints_acceleration"] == 0.0
    assert evaluation.excess["drive_acceleration"] == pytest.approx(1.0)
    assert evaluation.max_lateral_slip_m == pytest.approx(0.003)
    assert evaluation.min_clearance_m == np.inf
    assert evaluation.as_dict()["min_clearance_m"] is None
    assert evaluation.reached is None


def test_one_sample_is_a_motion(silvermate):
    time, coordinates, v = drive(silvermate, 0.0, 0.0)
    assert len(time) == 1
    box = Box((0.2, 0.2, 0.2), at=(1.0, 0, 0.2))
    evaluation = evaluate((time, coordinates, v), silvermate, World(Scene([box])))
    assert evaluation.min_clearance_m == pytest.approx(
        brute(silvermate, np.r_[0, 1], coordinates[[0, 0]], World(Scene([box])), 0)
    )
    assert evaluation.path_m == evaluation.time_s == 0.0


def test_bounds_are_lower_bounds(silvermate, rng):
    """What is not asked about may be left out: no bound of a block exceeds a distance in it."""
    record = straight_run(silvermate, moving_world(), wave=0.3)
    search = ClearanceSearch(silvermate, record.control.time, record.control.coordinates, record.world)
    lower, blocks = search._lower, search._blocks
    for block, g, p in np.argwhere(np.isfinite(lower))[rng.choice(np.isfinite(lower).sum(), 400, replace=False)]:
        for place in rng.uniform(*blocks[block], 3):
            assert search.distance(int(g), int(p), float(place)) >= lower[block, g, p] - 1e-5


def test_wrong_input_is_refused(silvermate, tiago):
    time, coordinates, v = drive(silvermate, 0.0, 0.1)
    world = World(Scene())
    for broken, match in (
        ((time, coordinates), r"arrays \(time, coordinates, v\)"),
        ((time[::-1], coordinates, v), "ascending"),
        ((time, coordinates[:, :-1], v), "coordinates has shape"),
        ((time, coordinates, np.full_like(v, np.nan)), r"v\[0\] at 0 s is not finite"),
        ((np.zeros(0), coordinates[:0], v[:0]), "T >= 1"),
    ):
        with pytest.raises(RecordError, match=match):
            evaluate(broken, silvermate, world)
    with refused(ParameterError, "world"):
        evaluate((time, coordinates, v), silvermate)
    with refused(ParameterError, "accuracy=0"):
        evaluate((time, coordinates, v), silvermate, world, accuracy=0)
    with refused(ParameterError, "goal"):
        evaluate((time, coordinates, v), silvermate, world, goal=[1, 2])
    with refused(ParameterError, "Tolerance", "yaw=-1"):
        Tolerance(yaw=-1)
    with refused(RecordError, "'silvermate'"):
        evaluate(straight_run(silvermate, world), tiago)
