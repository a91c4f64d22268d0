"""Scans, clouds and maps as they come: the scene that they show, and what is wrong with them, which is counted."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace as Fields

import numpy as np
import pinocchio as pin
import pytest
from cases import refused

import elastic_strips as es
from elastic_strips.errors import ParameterError
from elastic_strips.perception import DepthImage
from elastic_strips.robot import RobotModel
from elastic_strips.ros2 import MessageError, Ros2Params
from elastic_strips.ros2.sensing import Mounts, Sensing
from elastic_strips.sim.sensors import SensorConfig, SensorSuite, named_sensors
from elastic_strips.strip import strip_clearance

CRATE = es.Box((0.4, 0.4, 1.0), at=(1.6, 0.35, 0.5), name="crate")
ALWAYS = (-math.inf, math.inf)


def scans(robot: RobotModel, row: np.ndarray, times: list[float]) -> list[tuple[float, Fields]]:
    (laser,) = named_sensors("laser", robot.name).sensors
    config = SensorConfig(sensors=(replace(laser, latency=0.0),))
    suite, found = SensorSuite(robot, es.World(es.Scene([CRATE])), config, seed=1), []
    for t in times:
        for scan in suite.observe(t, row):
            step = float(scan.angles[1] - scan.angles[0])
            message = Fields(header=Fields(frame_id="laser_frame"), angle_min=float(scan.angles[0]))
            message.angle_increment, message.ranges = step, scan.ranges.tolist()
            message.range_min, message.range_max = scan.range_min, scan.range_max
            found.append((scan.time, message))
    return found


@pytest.fixture
def row(silvermate: RobotModel) -> np.ndarray:
    return silvermate.space.to_coordinates(silvermate.home())


@pytest.fixture
def sensing(silvermate: RobotModel) -> Sensing:
    return Sensing(silvermate, Ros2Params())


def test_scans_become_a_scene_of_their_own_time(sensing: Sensing, silvermate: RobotModel, row: np.ndarray):
    for t, message in scans(silvermate, row, [0.05 * k for k in range(8)]):
        sensing.offer("scan", "scan", message, t)
        assert sensing.work(lambda _: row, ALWAYS)
    assert sensing.scene is not None
    assert sensing.scene.time == pytest.approx(t)
    assert not sensing.counts
    standing = es.Strip.from_coordinates(silvermate, np.stack([row, row]))
    assert 0.5 < strip_clearance(standing, sensing.scene) < 1.3, "the crate is seen, and the robot is not"


def test_a_scan_waits_until_it_is_known_where_the_robot_was(sensing: Sensing, silvermate: RobotModel, row: np.ndarray):
    (t, message), *_ = scans(silvermate, row, [0.0, 0.05])
    sensing.offer("scan", "scan", message, t + 1.0)
    assert not sensing.work(lambda _: row, (0.0, 0.9))
    assert sensing.work(lambda _: row, (0.0, 1.1))


def test_what_is_wrong_is_counted_and_the_rest_goes_on(sensing: Sensing, silvermate: RobotModel, row: np.ndarray):
    found = scans(silvermate, row, [0.05 * k for k in range(5)])
    times = [t for t, _ in found]
    found[1][1].header.frame_id = "nowhere"
    found[2][1].ranges = [math.nan] * len(found[2][1].ranges)
    for (_, message), t in zip(found, [times[0], times[1], times[2], -1.0, times[4]], strict=True):
        sensing.offer("scan", "scan", message, t)
    assert sensing.work(lambda _: row, ALWAYS)
    assert sensing.counts.total() == 3
    assert sensing.scene is not None
    assert sensing.scene.time == pytest.approx(times[4])


def test_what_is_wrong_again_and_again_is_counted_as_one(sensing: Sensing):
    """However the numbers in it differ: a topic that is out of order for hours is one line, and no list."""
    for t in (1.0, 2.5, -3.25):
        sensing.count("odom", MessageError(f"a message of {t:.3f} s comes after, or twice, the one of {t + 1:.3f} s"))
    sensing.count("odom", MessageError("a pose is not finite: nan, 0, 0"))
    assert sorted(sensing.counts.values()) == [1, 3]


def test_what_was_not_looked_at_in_time_can_be_excused(sensing: Sensing, silvermate: RobotModel, row: np.ndarray):
    """As nobody looks while the node gets ready; what was wrong stays counted."""
    found = scans(silvermate, row, [0.05 * k for k in range(30)])
    found[-1][1].header.frame_id = "nowhere"
    for t, message in found:
        sensing.offer("scan", "scan", message, t)
    sensing.work(lambda _: row, ALWAYS)
    assert sensing.counts.total() > 1
    sensing.excuse()
    assert sensing.counts.total() == 1
    assert sensing.scene is not None


def test_depth_images_with_their_camera_are_seen(silvermate: RobotModel, row: np.ndarray):
    (camera,) = named_sensors("head-camera", silvermate.name).sensors
    config = SensorConfig(sensors=(replace(camera, latency=0.0),))
    suite = SensorSuite(silvermate, es.World(es.Scene([CRATE])), config, seed=1)
    sensing: Sensing | None = None
    for t in (0.0, 0.1, 0.2):
        (image,) = suite.observe(t, row)
        assert isinstance(image, DepthImage)
        if sensing is None:
            values = [*image.T_base_sensor[:3, 3], *pin.rpy.matrixToRpy(image.T_base_sensor[:3, :3])]
            mount = ":".join(["optical", *(f"{value:.9f}" for value in values)])
            sensing = Sensing(silvermate, Ros2Params(depths=("depth/image",), mounts=(mount,)))
        rows, columns = image.depth.shape
        (fx, fy), (cx, cy) = image.focal, image.center
        info = Fields(height=rows, width=columns, k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])
        depth = np.where(np.isfinite(image.depth), image.depth, np.nan).astype("<f4")
        message = Fields(header=Fields(frame_id="optical"), height=rows, width=columns, encoding="32FC1")
        message.step, message.is_bigendian, message.data = 4 * columns, 0, depth.tobytes()
        sensing.offer("depth", "depth/image", (message, info), t)
        sensing.work(lambda _: row, ALWAYS)
    assert sensing is not None
    assert not sensing.counts
    assert sensing.scene is not None
    seen = [part.center for obstacle in sensing.scene for part in obstacle.parts]
    assert any(1.3 < x < 1.9 and 0.1 < y < 0.6 for x, y, _ in seen)


def test_a_pose_that_is_not_known_is_counted(sensing: Sensing, silvermate: RobotModel, row: np.ndarray):
    def unknown(t: float) -> np.ndarray:
        raise MessageError("nothing is known of then")

    sensing.offer("scan", "scan", scans(silvermate, row, [0.0, 0.05])[0][1], 0.0)
    assert not sensing.work(unknown, ALWAYS)
    assert sensing.counts.total() == 1


def test_a_map_stands_in_each_scene(sensing: Sensing, silvermate: RobotModel, row: np.ndarray):
    origin = Fields(position=Fields(x=3.0, y=0.0, z=0.0), orientation=Fields(x=0.0, y=0.0, z=0.0, w=1.0))
    grid = Fields(info=Fields(height=1, width=1, resolution=0.5, origin=origin), data=[100])
    sensing.offer("map", "map", grid, 0.0)
    for t, message in scans(silvermate, row, [0.0, 0.05, 0.1]):
        sensing.offer("scan", "scan", message, t)
    sensing.work(lambda _: row, ALWAYS)
    assert sensing.scene is not None
    assert "map" in sensing.scene.names


def test_a_mount_says_where_a_sensor_is_that_no_link_is_named_after(silvermate: RobotModel, row: np.ndarray):
    mounts = Mounts(silvermate, Ros2Params(mounts=("my_laser:0.2:0.1:0.3:0:0:1.5",)))
    mounts.posture.place(row)
    T = mounts.on_base("my_laser")
    np.testing.assert_allclose(T[:3, 3], [0.2, 0.1, 0.3])
    assert math.atan2(T[1, 0], T[0, 0]) == pytest.approx(1.5)
    with pytest.raises(MessageError, match="nowhere"):
        mounts.on_base("nowhere")


def test_parameters_that_cannot_be_are_named():
    for named, value in (("arm", "leg"), ("mounts", ("laser:1:2",)), ("speed", 0.0), ("oldest", -1.0)):
        with refused(ParameterError, named):
            Ros2Params(**{named: value})


def cloud(points: np.ndarray) -> Fields:
    fields = [Fields(name=axis, offset=4 * k, datatype=7) for k, axis in enumerate("xyz")]
    data = np.frombuffer(points.astype("<f4").tobytes(), np.uint8)
    return Fields(
        header=Fields(frame_id="base_link"), fields=fields, width=len(points), height=1, point_step=12,
        row_step=12 * len(points), is_bigendian=False, data=data,
    )  # fmt: skip


def test_a_cloud_whose_topic_dies_makes_scenes_old(silvermate: RobotModel, row: np.ndarray):
    """As old as the last one of it, and one that has never come as old as the first scan."""
    sensing = Sensing(silvermate, Ros2Params(clouds=("points",)))
    found = scans(silvermate, row, [0.05 * k for k in range(8)])
    wall = np.column_stack((np.full(50, 1.5), np.linspace(-0.5, 0.5, 50), np.full(50, 0.9)))
    for k, (t, message) in enumerate(found):
        sensing.offer("scan", "scan", message, t)
        if 2 <= k < 5:
            sensing.offer("cloud", "points", cloud(wall), t)
        sensing.work(lambda _: row, ALWAYS)
        assert sensing.scene is not None
        assert sensing.scene.time == pytest.approx(found[0 if k < 2 else min(k, 4)][0])
        assert ("cloud-points" in sensing.scene.names) is (k >= 2)
    assert "points" in sensing.scene.held_up
    assert "scan" in sensing.scene.names[0] or len(sensing.scene) > 1, "what scans show is in it, too"


def test_a_robot_may_have_clouds_alone(silvermate: RobotModel, row: np.ndarray):
    sensing = Sensing(silvermate, Ros2Params(scans=None, clouds=("points",)))
    sensing.offer("cloud", "points", cloud(np.array([[1.5, 0.0, 0.9]])), 0.3)
    assert sensing.work(lambda _: row, ALWAYS)
    assert sensing.scene is not None
    assert sensing.scene.time == pytest.approx(0.3)
    assert sensing.scene.names == ("cloud-points",)
