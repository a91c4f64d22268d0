"""Watched images: a camera that is dead, frozen, tilted, late or in fog holds the scene up and is named; one that is
well never does."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.control.controller import stale
from elastic_strips.errors import ParameterError
from elastic_strips.perception import NO_ANSWER, DepthImage, LaserScan, SceneEstimator, VolumeMapParams
from elastic_strips.perception.image_watch import ImageWatch
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim import Fault
from elastic_strips.sim.faults import FaultPlan, FaultySensors
from elastic_strips.sim.sensors import SensorSuite
from elastic_strips.sim.sensors.params import DepthParams, LaserParams, SensorConfig

CAMERA = DepthParams(frame="head_frame", axis="x", tilt=0.35, field_of_view=1.5, columns=64, rows=48, range_max=5.0)
CONFIG = SensorConfig(sensors=(LaserParams(rays=91), CAMERA))
ROOM = Scene(
    [
        Box((0.1, 8.0, 2.0), at=(3.2, 0.0, 1.0), name="end"),
        Box((8.0, 0.1, 2.0), at=(0.0, 2.2, 1.0), name="left"),
        Box((8.0, 0.1, 2.0), at=(0.0, -2.2, 1.0), name="right"),
        Box((0.6, 0.5, 0.7), at=(2.0, 1.0, 0.35), name="chest"),
        Box((0.4, 0.4, 1.6), at=(2.3, -1.2, 0.8), name="locker"),
    ]
)
BEGIN, END = 0.5, 1.5  # [s] of faults


def watched(robot, *faults: Fault, scene=ROOM, config=CONFIG, until=2.5, still=False, path=None, turned=None):
    """What holds scenes up, and how old they are, every 50 ms of a robot that drives a curve from 0.4 s on, or is where
    a path (x, y, yaw) says; it may believe that it is turned by as much as a function of time says [rad]."""
    suite = FaultySensors(SensorSuite(robot, World(scene), config, seed=3), FaultPlan(faults), seed=3)
    estimator = SceneEstimator(robot=robot, required=config.required)
    poses, found = {}, []
    for k in range(round(until / 0.01)):
        t = 0.01 * k
        yaw = 0.0 if still else 0.6 * max(t - 0.4, 0.0)
        pose = (0.0 if still else 0.4 * np.sin(yaw) / 0.6, 0.4 * (1.0 - np.cos(yaw)) / 0.6, yaw)
        pose = path(t) if path else pose
        poses[round(t, 6)] = (*pose[:2], pose[2] + (turned(t) if turned else 0.0))
        q = robot.home(x=pose[0], y=pose[1], yaw=pose[2])
        for reading in suite.observe(t, robot.space.to_coordinates(q)):
            estimator.update(reading, poses[round(reading.time, 6)])
        if estimator.times and t >= 0.2 and k % 5 == 0:
            now = estimator.scene()
            found.append((t, t - now.time, now.held_up))
    return estimator, found


def named(found, low=BEGIN, high=END, most=0.25) -> set[str]:
    return {held_up for t, age, held_up in found if low <= t <= high and age > most}


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("camera_dead", "nothing"),
        ("camera_frozen", "frozen"),
        ("camera_tilted", "tilted"),
        ("camera_late", "turned"),
        ("fog", "not there"),
    ],
)
def test_a_camera_that_fails_is_named_within_a_second_and_trusted_again(silvermate, kind, word):
    _, found = watched(silvermate, Fault(kind, BEGIN, END - BEGIN))
    reasons = named(found)
    assert any("'camera'" in reason and word in reason for reason in reasons), reasons
    assert not named(found, high=BEGIN)
    assert found[-1][1] < 0.25, found[-1]  # it is well again


@each("way", [lambda t: 0.13 * t * t - 1.0, lambda t: 0.28 * t - 1.0], ids=["faster", "slowly"])
def test_a_camera_that_is_late_is_named_by_what_a_laser_sees(silvermate, way):
    """On a straight way, with the speed that it has, each of its images fits to the one before; and a slow robot comes
    no further, in the time by which they are late, than a laser and a camera may differ otherwise."""
    late = Fault("camera_late", 0.4, 9.0)
    straight = partial(watched, silvermate, until=3.5, path=lambda t: (way(t), 0.0, 0.0))
    reasons = named(straight(late)[1], low=0.0, high=9.0)
    assert any("'camera'" in reason and "'laser'" in reason for reason in reasons), reasons
    alone = SensorConfig(sensors=(CAMERA,))
    assert not named(straight(late, config=alone)[1], low=0.0, high=9.0), "nothing else shows it"
    assert not named(straight()[1], low=0.0, high=9.0)


@each("sensors", [CONFIG.sensors, (CAMERA,)], ids=["laser", "alone"])
def test_what_was_remembered_wrongly_does_not_hold_a_camera_up_for_good(silvermate, sensors):
    """The robot believes that it is turned, and then learns better: what it saw before is displaced, and not what it
    sees. That the camera is right is told by the floor and by a laser; without it nothing tells, and it waits."""
    config = SensorConfig(sensors=sensors)
    _, found = watched(silvermate, config=config, still=True, until=3.0, turned=lambda t: 0.25 * (t < BEGIN))
    assert not named(found, low=0.0, high=BEGIN)
    assert any("turned" in reason for reason in named(found, high=1.5))
    assert bool(named(found, low=2.0, high=9.0)) is (len(sensors) == 1)


WALKER = Cylinder(0.25, 1.7, at=(2.4, -1.5, 0.85), name="walker", motion=Twist(np.array([0.0, 0.8, 0.0])))


@each("scene", [ROOM, ROOM.with_obstacle(WALKER)], ids=["still", "somebody walks"])
def test_a_camera_that_is_well_never_holds_a_scene_up(silvermate, scene):
    estimator, found = watched(silvermate, scene=scene)
    assert not named(found, low=0.0, high=9.0)
    assert not estimator.watched["camera"].reason


BOARD = Box((0.7, 1.6, 0.06), at=(1.3, 0.2, 0.03), name="board")


@each("board", [BOARD, Box((0.7, 1.6, 0.1), at=(1.6, 0.2, 0.05), name="step")], ids=["board", "step"])
def test_a_low_board_is_no_tilted_floor(silvermate, board):
    estimator, found = watched(silvermate, scene=ROOM.with_obstacle(board), still=True, until=1.0)
    assert not named(found, low=0.0, high=9.0)
    assert not estimator.watched["camera"].reason


def test_a_tilted_camera_before_a_board_is_named(silvermate):
    tilted = Fault("camera_tilted", BEGIN, 9.0, 0.1)
    _, found = watched(silvermate, tilted, scene=ROOM.with_obstacle(BOARD), still=True)
    assert any("tilted" in reason for reason in named(found))


def test_a_frozen_camera_is_found_while_the_robot_stands_where_images_have_noise(silvermate):
    _, found = watched(silvermate, Fault("camera_frozen", BEGIN, 1.0), still=True)
    assert any("frozen" in reason for reason in named(found))
    exact = replace(CAMERA, noise=0.0, noise_growth=0.0, dropout=0.0, edge_dropout=0.0)
    _, found = watched(silvermate, config=SensorConfig(sensors=(LaserParams(rays=91), exact)), still=True, until=1.0)
    assert not named(found, low=0.0, high=9.0)  # a picture without noise of what stands is always the same


def test_images_that_are_not_believed_do_not_enter_the_map(silvermate):
    estimator, _ = watched(silvermate, Fault("camera_tilted", BEGIN, 1.0, 0.1), still=True, until=1.4)
    well, _ = watched(silvermate, still=True, until=1.4)
    assert estimator.volume.counts[0] <= 1.1 * well.volume.counts[0]


@each("lost, seconds, doubted", [(0.7, 0.6, False), (0.7, 1.6, True), (0.98, 0.2, True), (0.3, 1.6, False)])
def test_what_says_little_is_doubted_once_it_goes_on(lost, seconds, doubted):
    """Beside a wall a camera that looks about sees little for a while; one that sees next to nothing is covered."""
    rng, watch, places = np.random.default_rng(0), ImageWatch(VolumeMapParams()), np.zeros((48, 64), dtype=bool)
    for k in range(round((0.5 + seconds) * 15)):
        t = k / 15
        depth = 2.0 + 0.005 * rng.standard_normal(places.shape)
        if t > 0.5:
            depth[:, : round(lost * 64)] = NO_ANSWER
        image = DepthImage("camera", t, np.eye(4), depth, (50.0, 50.0), (31.5, 23.5), 0.28, 6.0)
        far = np.full(places.shape, np.inf)
        report = watch.look(image, image, np.eye(4), far, places, lambda at, _: np.zeros(len(at), dtype=bool), {})
    assert bool(report.reason) is doubted, report.reason


def test_a_covered_camera_is_blind_and_not_frozen():
    """Images that say nothing at all are equal, too, however noisy the camera is."""
    rng, watch, places = np.random.default_rng(0), ImageWatch(VolumeMapParams()), np.zeros((48, 64), dtype=bool)
    far, reasons = np.full(places.shape, np.inf), []
    for k in range(14):
        depth = 2.0 + 0.005 * rng.standard_normal(places.shape) if k < 7 else np.full(places.shape, NO_ANSWER)
        image = DepthImage("camera", k / 15, np.eye(4), depth, (50.0, 50.0), (31.5, 23.5), 0.28, 6.0)
        report = watch.look(image, image, np.eye(4), far, places, lambda at, _: np.zeros(len(at), dtype=bool), {})
        reasons.append(report.reason)
    assert not any(reasons[:7])
    assert reasons[7]
    assert report.repeated > 3
    assert set(reasons[7:]) == {reasons[7]}, "it is not said to be frozen once it has come a third time"


def test_an_arm_that_is_not_where_it_should_be_in_the_picture_is_named(tiago):
    camera = DepthParams(frame="xtion_depth_optical_frame", tilt=0.5, columns=96, rows=72, range_min=0.1)
    suite = SensorSuite(tiago, World(ROOM), SensorConfig(sensors=(camera,)), seed=1)
    coordinates = np.array([0, 0, 0, 0.26, 1.58, -0.46, -0.73, 0.06, -0.75, 0.34, 0.29])
    (image,) = [reading for k in range(12) for reading in suite.observe(0.01 * k, coordinates)]

    def seen(image):
        estimator = SceneEstimator(robot=tiago)
        estimator.update(image, (0.0, 0.0, 0.0))
        return estimator.watched["camera"]

    report = seen(image)
    assert not report.reason
    assert report.through < 0.02
    turned, (c, s) = image.T_base_sensor.copy(), (np.cos(0.1), np.sin(0.1))
    turned[:3, :3] = turned[:3, :3] @ [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    report = seen(replace(image, T_base_sensor=turned))  # it hangs askew
    assert report.through > 0.4
    assert "body" in report.reason


def scan(name: str, t: float) -> LaserScan:
    return LaserScan(name, t, np.eye(4), np.linspace(-1, 1, 21), np.full(21, 2.0), 0.1, 8.0)


def test_a_scene_is_as_old_as_the_sensor_that_is_behind_all_others():
    estimator = SceneEstimator(required=("front", "rear"))
    estimator.update(scan("front", 1.0), (0, 0, 0))
    estimator.update(scan("front", 1.4), (0, 0, 0))
    assert estimator.scene().time == pytest.approx(1.0)  # the other one has not come yet
    assert "'rear'" in stale(1.5, estimator.scene(), 0.25)
    estimator.update(scan("rear", 1.3), (0, 0, 0))
    assert estimator.scene().time == pytest.approx(1.3)
    assert not stale(1.5, estimator.scene(), 0.25)
    alone = SceneEstimator()
    alone.update(scan("front", 1.4), (0, 0, 0))
    assert alone.scene().time == pytest.approx(1.4)  # it rests on those that have come
    with refused(ParameterError, "required='laser'"):
        SceneEstimator(required="laser")


def test_faults_of_cameras_need_a_camera(silvermate):
    from elastic_strips.sim.faults import FaultyPerception
    from elastic_strips.sim.sensed_perception import SensorPerception

    laser = SensorConfig(sensors=(LaserParams(),))
    perception = SensorPerception(silvermate, World(ROOM), silvermate.home(), sensors=laser, look=0.1)
    with refused(ParameterError, "camera_dead"):
        FaultyPerception(perception, FaultPlan([Fault("camera_dead", 1.0)]))
