"""What no sensor has seen: obstacles near the robot, until it is looked at; and where a head looks first."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from free_way import outside_scene

import elastic_strips as es
from elastic_strips.perception import DepthImage, LaserScan, SceneEstimator, VolumeMap, VolumeMapParams
from elastic_strips.perception.gaze import Gaze
from elastic_strips.scene import UNSEEN_LAYER, Scene, World
from elastic_strips.sim.sensed_perception import SensorPerception
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.sim.sensors.params import LaserParams

BLOCKED = VolumeMapParams(length=8.0, height=1.6, unseen="blocked", unseen_radius=1.5)
LASER = LaserParams(frame="base_link", rays=31)
AHEAD = np.eye(4)  # of a camera that looks along the base's x
AHEAD[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
AHEAD[:3, 3] = 0.2, 0.0, 1.0


def wall(t: float, depth: float = 3.0, q=None) -> DepthImage:
    image = np.full((60, 80), depth, dtype=np.float32)
    return DepthImage("camera", t, AHEAD, image, (50.0, 50.0), (39.5, 29.5), 0.2, 6.0, q)


def test_what_is_in_doubt_is_blocked_and_nothing_else():
    volume = VolumeMap(BLOCKED)
    volume.add(wall(0.0), np.eye(4))
    scene, cell = Scene(volume.in_doubt(0.0, 0.0)), 0.5 * BLOCKED.cell
    axes = np.arange(-56, 56), np.arange(-56, 56), np.arange(4, 64)
    points = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * cell
    points = points[np.hypot(points[:, 0], points[:, 1]) < BLOCKED.unseen_radius]
    points = np.random.default_rng(1).permutation(points)[:20_000]
    inside, doubtful = outside_scene(points, scene) < 0.0, volume.doubtful(points)
    assert 0 < (~doubtful).sum() < len(points)
    assert np.array_equal(inside, doubtful)


def test_blocks_in_which_nothing_changes_stay_the_same_objects():
    volume = VolumeMap(BLOCKED)
    volume.add(wall(0.0), np.eye(4))
    first = volume.in_doubt(0.0, 0.0)
    before = {id(o) for o in first}
    volume.grant(np.array([[-1.0, 0.0, 1.0]]))
    after = volume.in_doubt(0.05, 0.0)
    assert sum(id(o) not in before for o in after if o.name == "unseen--3-0-2") == 1
    assert sum(id(o) not in before for o in after) < 10


def test_a_robot_may_stand_where_it_stands_and_not_back_off_unseen():
    robot = es.load_robot("silvermate")
    estimator = SceneEstimator(robot=robot, volume=BLOCKED)
    angles = np.linspace(-0.5, 0.5, 11)
    scan = LaserScan("laser", 0.0, np.eye(4), angles, np.full(11, 3.0), 0.1, 8.0)
    estimator.update(scan, np.zeros(3))
    assert any((o.name or "").startswith(UNSEEN_LAYER) for o in estimator.scene())  # no image yet: all is in doubt
    for k in range(3):
        estimator.update(wall(0.1 * (k + 1), q=robot.home()), np.zeros(3))
    scene = Scene([o for o in estimator.scene() if (o.name or "").startswith(UNSEEN_LAYER)])
    places = np.array([[0.02, 0.02, 0.52], [1.22, 0.02, 1.02], [-1.22, 0.02, 1.02], [0.02, 1.22, 1.02]])
    off = outside_scene(places, scene)
    assert off[0] > 0.1  # itself
    assert off[1] > 0.1  # ahead, where the camera looks
    assert (off[2:] < 0.0).all()  # behind and beside


@pytest.mark.parametrize(("t", "sets_off"), [(0.2, True), (2.0, False)])
@pytest.mark.parametrize("by", ["image", "scan"])
def test_a_robot_may_set_off_from_where_somebody_stood_beside_it(monkeypatch, by, t, sets_off):
    """Where they were is not known, but for what is so near to the robot that nothing else can be there: as long as it
    is known how it stands, which an image tells, and a scan only soon after one."""
    robot = es.load_robot("silvermate")
    estimator, q = SceneEstimator(robot=robot, volume=BLOCKED), robot.home()
    estimator.update(wall(0.1, q=q), np.zeros(3))
    axes = np.arange(-1.0, 0.0, 0.02), np.arange(-0.3, 0.3, 0.02), np.arange(0.15, 1.2, 0.02)
    behind = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    monkeypatch.setattr(estimator.tracker, "traces", lambda: behind)
    angles = np.linspace(-0.5, 0.5, 11)
    scan = LaserScan("laser", t, np.eye(4), angles, np.full(11, 3.0), 0.1, 8.0)
    estimator.update(scan if by == "scan" else wall(t, q=q), np.zeros(3))
    assert estimator.volume is not None
    in_doubt = behind[estimator.volume.doubtful(behind)]
    known = sets_off or by == "image"
    assert len(in_doubt) > 0
    assert (len(in_doubt) < len(behind)) is known
    unseen = Scene(estimator.volume.in_doubt(0.0, 0.0))
    assert es.certify(robot, unseen, [q, q], clearance=0.03).certified is known
    assert not es.certify(robot, unseen, [q, q], clearance=0.15).certified


@pytest.fixture(scope="module")
def tiago(looking_tiago):
    return looking_tiago


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_head_looks_where_the_robot_is_about_to_go(tiago, side):
    gaze = Gaze(tiago, "xtion_depth_optical_frame", np.eye(4), (1.02, 0.8), (0.3, 3.5))
    row = tiago.space.to_coordinates(tiago.home())
    ahead = np.tile(row, (7, 1))
    ahead[:, 0] += 0.2 * np.arange(2, 9) * math.cos(0.9)
    ahead[:, 1] += side * 0.2 * np.arange(2, 9) * math.sin(0.9)
    volume = VolumeMap(BLOCKED)
    wanted = gaze.look(0.0, row, ahead, np.zeros(2), volume)
    assert side * wanted[0] > 0.3
    assert gaze.target is not None
    assert side * gaze.target[1] > 0.2
    assert (gaze.lower <= wanted).all()
    assert (wanted <= gaze.upper).all()


def test_what_is_looked_at_in_vain_is_left_after_a_while(tiago):
    gaze = Gaze(tiago, "xtion_depth_optical_frame", np.eye(4), (1.02, 0.8), (0.3, 3.5))
    row, volume = tiago.space.to_coordinates(tiago.home()), VolumeMap(BLOCKED)
    seen = set()
    head = np.zeros(2)
    for k in range(20):  # nothing is ever seen
        head = gaze.look(0.3 * k, row, np.zeros((0, tiago.nv)), head, volume)
        seen.add(tuple(head.round(3).tolist()))
    assert len(seen) > 5


def test_who_sees_nothing_looks_where_they_saw_last(tiago):
    """A wall nearer than the camera sees hides what it wants to look at: it does not stare at that."""
    gaze = Gaze(tiago, "xtion_depth_optical_frame", np.eye(4), (1.02, 0.8), (0.3, 3.5))
    row, volume = tiago.space.to_coordinates(tiago.home()), VolumeMap(BLOCKED)
    none = np.zeros((0, tiago.nv))

    def image(t, head, blind):
        gaze.note(t, tiago.seeing.space.from_coordinates(tiago.seeing_row(row, head)), blind=blind)

    image(0.0, np.zeros(2), False)
    away = gaze.look(0.0, row, none, np.zeros(2), volume).copy()
    assert np.abs(away).max() > 0.3
    image(0.1, 0.2 * away, True)  # it is on its way
    np.testing.assert_array_equal(gaze.wanted, away)
    image(0.5, away, True)
    for t in (0.5, 0.9, 1.4):
        np.testing.assert_allclose(gaze.look(t, row, none, np.zeros(2), volume), 0.0, atol=1e-12)
    image(1.6, np.zeros(2), False)
    again = gaze.look(1.7, row, none, np.zeros(2), volume)
    assert np.abs(again - away).max() > 0.2


def test_a_head_without_a_camera_is_no_trouble(tiago):
    perception = SensorPerception(
        tiago, World(Scene([])), tiago.home(), sensors=SensorConfig(sensors=(LASER,)), look=0.2
    )
    assert perception.gaze is None
    assert perception.known().time is not None


def all_seen_but(left):
    """A map in which all has been seen but the voxels whose middles satisfy a condition."""
    volume = VolumeMap(BLOCKED)
    axes = np.arange(-80, 80), np.arange(-80, 80), np.arange(0, 36)
    middles = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * BLOCKED.cell
    volume.grant(middles[~left(middles)])
    return volume


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_last_that_was_not_seen_of_a_way_is_looked_at_before_all_that_is_beside_it(tiago, side):
    """It stops a motion as surely as the first of it."""
    gaze = Gaze(tiago, "xtion_depth_optical_frame", np.eye(4), (1.02, 0.8), (0.3, 3.5))
    row = tiago.space.to_coordinates(tiago.home())
    ahead = np.tile(row, (10, 1))
    ahead[:, 0] += np.linspace(0.0, 1.0, 10)
    ahead[:, 1] += side * np.linspace(0.0, 0.8, 10)

    def left(at):
        on_the_way = np.linalg.norm(at - (1.0, side * 0.8, 0.22), axis=1) < 0.08
        return on_the_way | ((side * at[:, 1] < -0.6) & (at[:, 2] > 0.2))

    wanted = gaze.look(0.0, row, ahead, np.zeros(2), all_seen_but(left))
    assert side * wanted[0] > 0.2
    assert side * gaze.target[1] > 0.3


def test_what_the_robot_hides_is_not_looked_at(tiago):
    gaze = Gaze(tiago, "xtion_depth_optical_frame", np.eye(4), (1.02, 0.8), (0.3, 3.5))
    row = tiago.space.to_coordinates(tiago.home())
    robot, data = tiago.seeing, tiago.seeing.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.space.from_coordinates(tiago.seeing_row(row, np.zeros(2))))
    eye, hand = (
        data.oMf[robot.model.getFrameId(name)].translation for name in ("xtion_depth_optical_frame", "wrist_ft_link")
    )
    behind = eye + 1.6 * (hand - eye)
    assert behind[2] > 0.15
    ahead = np.tile(row, (10, 1))
    ahead[:, :2] += np.linspace(0.0, 1.0, 10)[:, None] * behind[:2]
    aside = np.array([1.0, -0.8 * np.sign(behind[1]), 0.8])

    def left(at):
        return np.minimum(np.linalg.norm(at - behind, axis=1), np.linalg.norm(at - aside, axis=1)) < 0.1

    gaze.look(0.0, row, ahead, np.zeros(2), all_seen_but(left))
    assert np.linalg.norm(gaze.target - aside) < 0.3
