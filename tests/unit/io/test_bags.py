"""Bags: what is written is read again, by this library and by others; scans meet transforms; what is refused."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.control.record import Recorder
from elastic_strips.errors import InputError
from elastic_strips.io import BagError, BagReader, cloud_scene, write_bag
from elastic_strips.scene import Cone, ConvexHull, Keyframes, Points, Voxels, World
from elastic_strips.trajectory import retime

rosbags = pytest.importorskip("rosbags.highlevel")
from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

STORES = {"ros2": get_typestore(Stores.ROS2_HUMBLE), "ros1": get_typestore(Stores.ROS1_NOETIC)}
TRANSFORMS = "tf2_msgs/msg/TFMessage"
STORES["ros1"].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))


class Made:
    """A bag made by hand, of ROS 1 or ROS 2."""

    def __init__(self, path: Path, kind: str) -> None:
        self.kind, self.store = ("ros1" if kind == ".bag" else "ros2"), STORES["ros1" if kind == ".bag" else "ros2"]
        plugin = StoragePlugin.MCAP if kind == ".mcap" else StoragePlugin.SQLITE3
        self.writer = Writer1(path) if kind == ".bag" else Writer(path, version=9, storage_plugin=plugin)
        self.connections: dict[str, object] = {}

    def make(self, name: str, *args: object) -> object:
        return self.store.types[name](*args)

    def header(self, t: float, frame: str) -> object:
        sec, nanosec = divmod(round(t * 1e9), 10**9)
        time = self.make("builtin_interfaces/msg/Time", sec, nanosec)
        return self.make("std_msgs/msg/Header", *((0,) if self.kind == "ros1" else ()), time, frame)

    def add(self, t: float, topic: str, kind: str, *args: object) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.kind == "ros1" else self.store.serialize_cdr
        self.writer.write(self.connections[topic], round(t * 1e9), serialize(self.make(kind, *args), kind))

    def tf(
        self, t: float, topic: str, parent: str, child: str, x: float, y: float, z: float, yaw: float,
        at: float | None = None,
    ) -> None:  # fmt: skip
        vector = self.make("geometry_msgs/msg/Vector3", x, y, z)
        turn = self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
        transform = self.make("geometry_msgs/msg/Transform", vector, turn)
        stamped = self.make("geometry_msgs/msg/TransformStamped", self.header(t, parent), child, transform)
        self.add(t if at is None else at, topic, TRANSFORMS, [stamped])

    def scan(
        self, t: float, topic: str, ranges: list[float], frame: str = "laser", *, at: float | None = None,
        start: float = -0.5, step: float = 0.5, low: float = 0.1, high: float = 8.0,
    ) -> None:  # fmt: skip
        head = (self.header(t, frame), start, start + step * (len(ranges) - 1), step, 0.0, 0.1, low, high)
        values = (np.array(ranges, np.float32), np.zeros(0, np.float32))
        self.add(t if at is None else at, topic, "sensor_msgs/msg/LaserScan", *head, *values)

    def cloud(self, t: float, topic: str, points: np.ndarray, frame: str = "laser", **other: object) -> None:
        """Points as floats from byte 4 on, 20 bytes each; ``other`` says what of the message is otherwise."""
        table = np.zeros((len(points), 5), "<f4")
        table[:, 1:4] = points
        given = {"fields": ("xyz", (4, 8, 12), 7), "height": 1, "width": len(points), "big": False, "step": 20,
                 "row": 20 * len(points), "data": table.tobytes(), **other}  # fmt: skip
        names, offsets, kind = given["fields"]
        at = zip(names, offsets, strict=True)
        fields = [self.make("sensor_msgs/msg/PointField", name, offset, kind, 1) for name, offset in at]
        head = (self.header(t, frame), given["height"], given["width"], fields, given["big"])
        data = np.frombuffer(given["data"], np.uint8)
        self.add(t, topic, "sensor_msgs/msg/PointCloud2", *head, given["step"], given["row"], data, True)

    def joints(self, t: float, topic: str, **positions: float) -> None:
        values = np.array(list(positions.values()))
        self.add(t, topic, "sensor_msgs/msg/JointState", self.header(t, ""), list(positions), values, 0.1 * values,
                 np.zeros(0))  # fmt: skip


CLOUD = np.array([[1.0, 2.0, 0.5], [np.nan, 0.0, 0.0], [3.0, -1.0, 0.25]])


def drive(path: Path, kind: str, *, steps: int = 60, cloud: float = 2.05) -> Path:
    """A base on a circle of radius 2, a turn in 20 s; scans between its transforms, a cloud, and joint states."""
    made = Made(path, kind)
    with made.writer:
        made.tf(0.0, "/tf_static", "base_link", "laser", 0.2, 0.0, 0.3, math.pi / 2)
        for k in range(steps):
            t = 0.1 * k
            a = t * math.pi / 10
            made.tf(t, "/tf", "map", "odom", 1.0, 0.0, 0.0, 0.0)
            made.tf(t, "/tf", "odom", "base_link", 2 * math.cos(a), 2 * math.sin(a), 0.0, a + math.pi / 2)
            if k % 5 == 1:
                made.scan(t + 0.05, "/scan", [1.5, float("nan"), 9.0])
            made.joints(t, "/joint_states", arm_1_joint=0.1 * k, wheel=t)
        made.cloud(cloud, "/points", CLOUD)
    return path if kind == ".bag" else next(path.glob(f"*{kind}")) if kind != "folder" else path


@each("kind", [".mcap", ".db3", ".bag", "folder"])
def test_scans_come_with_the_pose_at_their_stamp(tmp_path, kind):
    bag = BagReader(drive(tmp_path / ("b.bag" if kind == ".bag" else "b"), kind))
    scans = list(bag.scans())
    assert len(scans) == 12
    for scan, pose in scans:
        a = scan.time * math.pi / 10
        np.testing.assert_allclose(pose[:2], [1 + 2 * math.cos(a), 2 * math.sin(a)], atol=3e-4)  # a chord's sagitta
        assert math.remainder(pose[2] - a - math.pi / 2, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(scan.T_base_sensor[:3, 3], [0.2, 0, 0.3], atol=1e-12)
        np.testing.assert_allclose(scan.T_base_sensor[:3, 0], [0, 1, 0], atol=1e-12)
        np.testing.assert_array_equal(scan.ranges, [1.5, np.nan, np.inf])
    assert not bag.dropped
    assert bag.topics["/scan"] == ("sensor_msgs/msg/LaserScan", 12)


def test_clouds_are_brought_into_a_frame(tmp_path):
    bag = BagReader(drive(tmp_path / "b", ".mcap"))
    (raw,) = bag.clouds()
    np.testing.assert_allclose(raw.cloud.points, CLOUD[[0, 2]])
    assert (raw.cloud.dropped, raw.frame) == (1, "laser")
    (placed,) = bag.clouds(frame="base_link")
    np.testing.assert_allclose(placed.cloud.points, [[0.2 - 2.0, 1.0, 0.8], [0.2 + 1.0, 3.0, 0.55]], atol=1e-9)
    assert len(cloud_scene(placed.cloud)) == 1
    assert list(bag.clouds(frame="nowhere")) == []
    assert bag.dropped == {"clouds whose place in 'nowhere' is not known": 1}


def filled(path: Path, kind: str, fill) -> BagReader:
    made = Made(path, kind)
    with made.writer:
        fill(made)
    return BagReader(path if kind == ".bag" else next(path.glob(f"*{kind}")))


FOUR = np.arange(12.0).reshape(2, 2, 3)
SMALL = ("xyz", (0, 4, 8), 7)
TIGHT = {"fields": SMALL, "step": 12, "width": 2, "height": 2, "row": 24}


@each(
    "given",
    [
        {**TIGHT, "data": FOUR.astype("<f4").tobytes()},
        {**TIGHT, "data": FOUR.astype(">f4").tobytes(), "big": True},
        {**TIGHT, "data": FOUR.astype("<f4").tobytes(), "row": 0},
        {**TIGHT, "data": b"".join(row.astype("<f4").tobytes() + b"\xff" * 8 for row in FOUR), "row": 32},
        {**TIGHT, "data": b"\xff\xff".join(row.astype("<f4").tobytes() for row in FOUR), "row": 26},
        {**TIGHT, "data": FOUR.astype("<f8").tobytes(), "fields": ("xyz", (0, 8, 16), 8), "step": 24, "row": 48},
        {**TIGHT, "data": FOUR.astype("<i2").tobytes(), "fields": ("zyx", (4, 2, 0), 3), "step": 6, "row": 0},
    ],
    ids=["organised", "big-endian", "no row step", "padded rows", "last row not padded", "doubles", "integers zyx"],
)  # fmt: skip
def test_clouds_are_read_as_they_are_laid_out(tmp_path, given):
    bag = filled(tmp_path / "b", ".mcap", lambda made: made.cloud(1.0, "/points", FOUR.reshape(4, 3), **given))
    (found,) = bag.clouds()
    np.testing.assert_array_equal(found.cloud.points, FOUR.reshape(4, 3))
    assert not bag.dropped


def test_a_cloud_that_does_not_fit_its_fields_does_not_end_the_others(tmp_path):
    wrong = [
        ({"step": 12}, "its points have 12 bytes, too few for x, y, z at 4, 8, 12"),
        ({"step": 0, "row": 0}, "its points have 0 bytes"),
        ({"fields": ("xyz", (4, 8, 40), 7)}, "x, y, z at 4, 8, 40"),
        ({"width": 4}, "its data have 60 bytes; 1 rows of 80 need more"),
        ({"fields": ("", (), 7), "width": 0, "row": 0, "data": b""}, "clouds without points"),
    ]

    def fill(made):
        for k, (given, _) in enumerate(wrong):
            made.cloud(float(k), "/points", CLOUD, **given)
        made.cloud(9.0, "/points", CLOUD)

    bag = filled(tmp_path / "b", ".mcap", fill)
    assert [found.time for found in bag.clouds()] == [9.0]
    for count, said in zip(bag.dropped.values(), bag.dropped, strict=True):
        assert count == 1, said
    assert all(any(says in said for said in bag.dropped) for _, says in wrong)
    bag = filled(tmp_path / "c", ".mcap", lambda made: made.cloud(1.0, "/points", CLOUD, fields=("xy", (4, 8), 7)))
    with refused(BagError, "z", "x, y"):
        list(bag.clouds())


def test_joint_states_hold_what_fits_and_is_finite(tmp_path):
    def fill(made):
        for t, position, velocity in [(1.0, [1, 2], []), (2.0, [1], [3, 4]), (3.0, [1, math.nan], [math.inf, 4])]:
            made.add(t, "/j", "sensor_msgs/msg/JointState", made.header(t, ""), ["b", "a"], np.array(position, float),
                     np.array(velocity, float), np.zeros(0))  # fmt: skip

    bag = filled(tmp_path / "b", ".mcap", fill)
    states = [(state.positions, state.velocities) for state in bag.joint_states()]
    assert states == [({"b": 1, "a": 2}, {}), ({}, {"b": 3, "a": 4}), ({"b": 1}, {"a": 4})]
    assert bag.dropped == {
        "position of joint states with another number of names": 1,
        "position of a joint that is not finite": 1,
        "velocity of a joint that is not finite": 1,
    }


def test_transforms_that_come_late_count(tmp_path):
    """x = t²; between 0.1 and 0.3 s it would be 0.05 m at 0.2 s."""

    def fill(made):
        for k, t in enumerate([0.0, 0.1, 0.3, 0.2, 0.2, 0.4]):
            made.tf(t, "/tf", "odom", "base_link", t * t, 0.0, 0.0, 0.0, at=0.1 * k)
        made.scan(0.2, "/scan", [1.0, 2.0], frame="base_link", at=0.7)

    ((_, pose),) = filled(tmp_path / "b", ".mcap", fill).scans()
    assert pose[0] == pytest.approx(0.04, abs=1e-12)


def test_a_frame_that_gets_another_parent_is_not_between_the_two(tmp_path):
    def fill(made):
        made.tf(0.0, "/tf", "odom", "base_link", 0.0, 0.0, 0.0, 0.0)
        made.tf(0.2, "/tf", "map", "base_link", 5.0, 0.0, 0.0, 0.0)
        made.scan(0.1, "/scan", [1.0, 2.0], frame="base_link", at=0.7)

    ((_, pose),) = filled(tmp_path / "b", ".mcap", fill).scans()
    assert pose[0] == 5.0


@each(
    ("head", "ranges"),
    [
        ({"step": 0.2}, [1.5, np.nan, np.inf, np.nan, np.inf, np.nan]),
        ({"start": 0.5, "step": -0.2}, [np.nan, np.inf, np.nan, np.inf, np.nan, 1.5]),
        ({"step": 0.2, "low": 0.0, "high": math.inf}, [1.5, np.nan, 9.0, np.nan, np.inf, 0.05]),
        ({"start": 0.0, "step": 6.28319 / 5}, [1.5, np.nan, np.inf, np.nan, np.inf, np.nan]),
    ],
    ids=["counter-clockwise", "clockwise", "without bounds", "a turn of Gazebo"],
)
def test_ranges_mean_what_rep_117_says(tmp_path, head, ranges):
    """Beyond range_max is nothing; nearer than range_min, and what is no number, no answer."""
    given = [1.5, math.nan, 9.0, -math.inf, math.inf, 0.05]
    bag = filled(tmp_path / "b", ".mcap", lambda made: made.scan(1.0, "/scan", given, **head))
    ((scan, _),) = bag.scans()
    np.testing.assert_allclose(scan.ranges, ranges, rtol=1e-6)
    assert (np.diff(scan.angles) > 0.0).all()
    assert scan.angles[0] == pytest.approx(-0.5 if head.get("start", -0.5) else 0.0, abs=1e-6)


@each("head", [{"start": math.nan}, {"step": 0.0}, {"step": 1.3}, {"low": math.nan}, {"low": 8.0}])
def test_a_scan_that_is_none_is_counted(tmp_path, head):
    bag = filled(tmp_path / "b", ".mcap", lambda made: made.scan(1.0, "/scan", [1.0] * 6, **head))
    assert not list(bag.scans())
    assert any(said.startswith("scans that are not valid") for said in bag.dropped)


def test_types_without_a_definition_are_those_of_ros(tmp_path, monkeypatch):
    """In a bag where others have one; and in one where none has."""
    from rosbags.rosbag2 import storage_mcap
    from rosbags.typesys.store import Typestore

    plain = Typestore.generate_msgdef
    write = storage_mcap.write_schema
    monkeypatch.setattr(Typestore, "generate_msgdef", lambda s, k, **o: ("", "") if "Joint" in k else plain(s, k, **o))
    monkeypatch.setattr(storage_mcap, "write_schema", lambda b, s: write(b, s if s.data else s._replace(encoding="")))
    for k, others in enumerate((True, False)):

        def fill(made, others=others):
            made.joints(1.0, "/joint_states", arm=0.5)
            if others:
                made.scan(1.0, "/scan", [1.0, 2.0])

        (state,) = filled(tmp_path / f"b{k}", ".mcap", fill).joint_states()
        assert state.positions == {"arm": 0.5}


def test_schemas_of_others_are_named(tmp_path, monkeypatch):
    from rosbags.rosbag2 import storage_mcap

    write = storage_mcap.write_schema
    monkeypatch.setattr(storage_mcap, "write_schema", lambda b, s: write(b, s._replace(encoding="protobuf")))
    with refused(BagError, "b.mcap:", "'protobuf'"):
        filled(tmp_path / "b", ".mcap", lambda made: made.scan(1.0, "/scan", [1.0, 2.0]))


def test_joint_states_and_poses(tmp_path):
    bag = BagReader(drive(tmp_path / "b.bag", ".bag"))
    states = list(bag.joint_states())
    assert len(states) == 60
    assert states[7].positions == pytest.approx({"arm_1_joint": 0.7, "wheel": 0.7})
    assert states[7].velocities["wheel"] == pytest.approx(0.07)
    poses = list(bag.poses())
    assert [t for t, _ in poses] == pytest.approx([0.1 * k for k in range(60)])
    np.testing.assert_allclose(poses[0][1], [3.0, 0.0, math.pi / 2], atol=1e-9)
    in_odom = list(BagReader(tmp_path / "b.bag", world_frame="odom").poses())
    np.testing.assert_allclose(in_odom[0][1], [2.0, 0.0, math.pi / 2], atol=1e-9)


def test_what_is_not_known_is_counted(tmp_path):
    made = Made(tmp_path / "b", ".mcap")
    with made.writer:
        for t in (1.0, 2.0):
            made.scan(t, "/scan", [1.0, 2.0], frame="lidar")
        made.scan(3.0, "/scan", [1.0], frame="lidar")
        made.tf(30.0, "/tf", "odom", "base_link", 0.0, 0.0, 0.0, 0.0)
    bag = BagReader(next((tmp_path / "b").glob("*.mcap")))
    scans = list(bag.scans())
    assert [pose for _, pose in scans] == [None, None]
    np.testing.assert_array_equal(scans[0][0].T_base_sensor, np.eye(4))
    assert bag.dropped["scans of a sensor whose mount is not known"] == 3
    assert bag.dropped["scans without a pose"] == 3
    assert bag.dropped["scans that are not valid (a scan has 1 ranges; at least 2 are needed)"] == 1


@pytest.mark.parametrize("tf, scan", [("robot1/base_scan", "base_scan"), ("base_scan", "robot1/base_scan")])
def test_frames_with_a_prefix_are_offered_and_a_mount_can_be_said(tmp_path, caplog, tf, scan):
    made = Made(tmp_path / "b", ".mcap")
    with made.writer:
        made.tf(0.0, "/tf_static", "robot1/base_link", tf, 0.2, 0.0, 0.3, 0.0)
        made.scan(1.0, "/scan", [1.0, 2.0], frame=scan)
        made.scan(2.0, "/scan", [1.0, 2.0], frame=scan)
    path = next((tmp_path / "b").glob("*.mcap"))
    with caplog.at_level(logging.WARNING):
        assert len(list(BagReader(path).scans())) == 2
    assert caplog.text.count("no transforms lead") == 1
    assert repr(tf) in caplog.text
    assert repr("robot1/base_link") in caplog.text
    bag = BagReader(path, base_frame="robot1/base_link")
    for found, _ in bag.scans(frame=tf):
        np.testing.assert_allclose(found.T_base_sensor[:3, 3], [0.2, 0.0, 0.3])
    assert "scans of a sensor whose mount is not known" not in bag.dropped
    mount = np.eye(4)
    mount[:3, 3] = (0.1, 0.2, 0.3)
    for found, _ in BagReader(path).scans(mount=mount):
        np.testing.assert_allclose(found.T_base_sensor, mount)


def test_the_topic_is_found_or_named(tmp_path):
    made = Made(tmp_path / "b", ".mcap")
    with made.writer:
        made.scan(1.0, "/front", [1.0, 2.0])
        made.scan(1.0, "/rear", [1.0, 3.0])
    bag = BagReader(next((tmp_path / "b").glob("*.mcap")))
    assert [scan.ranges[1] for scan, _ in bag.scans("/rear")] == [3.0]
    for use, says in [
        (lambda: list(bag.scans()), r"several topics of sensor_msgs/msg/LaserScan: /front, /rear; name one"),
        (lambda: list(bag.scans("/raer")), r"no topic '/raer' .*; did you mean '/rear'\?"),
        (lambda: list(bag.clouds()), r"no topic of sensor_msgs/msg/PointCloud2; it has /front"),
    ]:
        with pytest.raises(BagError, match=says):
            use()


def test_a_long_bag_is_read_as_a_stream(tmp_path, monkeypatch):
    """What was read before the first scan is given is a second of the bag, not the bag."""
    from rosbags.highlevel import AnyReader

    taken = []
    deserialize = AnyReader.deserialize
    monkeypatch.setattr(AnyReader, "deserialize", lambda s, d, k: (taken.append(k), deserialize(s, d, k))[1])
    bag = BagReader(drive(tmp_path / "b", ".mcap"))
    taken.clear()
    next(bag.scans())
    assert len(taken) < 12


def test_what_is_no_bag_is_refused(tmp_path):
    sound = drive(tmp_path / "b", ".mcap").read_bytes()
    for name, data, says in [
        ("b.mcap", b"", "mcap bag"),
        ("b.mcap", sound[: len(sound) // 2], "cannot be read"),
        ("b.bag", sound, "bag bag"),
        ("b.db3", b"SQLite format 3\0" + sound, "cannot be read"),
        ("b.zip", sound, r"kind '.zip' are not read"),
    ]:
        (tmp_path / name).write_bytes(data)
        with pytest.raises(BagError, match=says):
            list(BagReader(tmp_path / name).scans())
    with refused(BagError, "No such file"):
        BagReader(tmp_path / "gone.mcap")
    with refused(BagError, "metadata.yaml"):
        BagReader(tmp_path)


def messages(path: Path) -> dict[str, list]:
    found: dict[str, list] = {}
    with rosbags.AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return found


@pytest.fixture(scope="module")
def driven(silvermate):
    strip = es.Strip(
        silvermate, [silvermate.home(x, 0.0, 0.0, arm_4_joint=1.0 + 0.1 * x) for x in np.arange(0, 2.1, 0.1)]
    )
    return retime(strip)


def test_a_trajectory_becomes_a_bag_that_others_read(tmp_path, silvermate, driven):
    corners = np.random.default_rng(0).uniform(0, 1, (9, 3)) + 5
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    scene = es.Scene([
        es.Box((0.6, 0.5, 1.4), at=(1.5, 2, 0.7), name="box"), es.Sphere(0.2, at=(2, 3, 1)), es.Capsule(0.1, 0.5),
        Cone(0.1, 0.5), ConvexHull(corners), Voxels([[7, 7, 0], [7, 7.3, 0]], 0.1), Points(corners, 0.05),
        es.Cylinder(0.1, 0.5), es.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], faces),
    ])  # fmt: skip
    path = write_bag(tmp_path / "t.mcap", driven, scene=scene)
    assert not [p for p in tmp_path.iterdir() if p != path]
    found = messages(path)
    (plan,), (timed,), (markers,) = found["/plan"], found["/joint_trajectory"], found["/obstacles"]
    assert [p.pose.position.x for p in plan.poses] == pytest.approx(driven.coordinates[:, 0])
    assert timed.joint_names == list(silvermate.joint_names)
    last = timed.points[-1]
    assert last.time_from_start.sec + 1e-9 * last.time_from_start.nanosec == pytest.approx(driven.duration, abs=1e-9)
    np.testing.assert_array_equal([p.positions for p in timed.points], driven.coordinates[:, 3:])
    np.testing.assert_array_equal([p.accelerations for p in timed.points], driven.a[:, 3:])
    kinds = {m.ns: m.type for m in markers.markers}
    assert len(kinds) == len(scene)
    assert kinds["box"] == 1
    assert (markers.markers[0].scale.y, markers.markers[0].pose.position.z) == (0.5, 0.7)
    capsule = np.array([[p.x, p.y, p.z] for p in markers.markers[2].points])
    np.testing.assert_allclose(
        [capsule.min(axis=0), capsule.max(axis=0)], [[-0.1, -0.1, -0.35], [0.1, 0.1, 0.35]], atol=2e-3
    )
    assert found["/robot_description"][0].data.startswith("<?xml")

    bag = BagReader(path, world_frame="map")  # the same bag, read as a recorded one
    states = list(bag.joint_states())
    rows = np.searchsorted(driven.time, [s.time for s in states] - np.array(1e-6))
    wanted = driven.coordinates[rows, 3:]
    np.testing.assert_array_equal([[s.positions[n] for n in silvermate.joint_names] for s in states], wanted)
    poses = np.array([pose for _, pose in bag.poses()])
    np.testing.assert_allclose(poses, driven.coordinates[rows, :3], atol=1e-12)


def test_the_links_are_where_the_robot_has_them(tmp_path, silvermate, driven):
    import pinocchio as pin

    found = messages(write_bag(tmp_path / "t.mcap", driven, period=1.0))
    last = {t.child_frame_id: t for t in found["/tf"][-1].transforms}
    data = silvermate.model.createData()
    pin.framesForwardKinematics(silvermate.model, data, driven.q[-1])
    hand = silvermate.model.getFrameId("arm_7_link")
    base = silvermate.model.getFrameId("base_link")
    at = last["arm_7_link"].transform.translation
    np.testing.assert_allclose([at.x, at.y, at.z], data.oMf[base].actInv(data.oMf[hand]).translation, atol=1e-12)
    assert last["base_link"].header.frame_id == "map"


def test_the_record_of_a_drive_has_its_obstacles_as_they_moved(tmp_path):
    robot = es.load_robot("jackal-box")
    ball = Keyframes([0.0, 1.0], [[2, 0, 0.5], [2, 1, 0.5]])
    world = World(es.Scene([es.Box((1, 1, 1), at=(0, 3, 0.5), name="table"), es.Sphere(0.2, motion=ball, name="ball")]),
                  appears={"ball": 0.3})  # fmt: skip
    recorder = Recorder(robot, world)
    for k in range(101):
        row = np.array([0.01 * k, 0.0, 0.0])
        recorder.control(0.01 * k, coordinates=row, v=0 * row, reference=row)
    found = messages(write_bag(tmp_path / "r.mcap", recorder.finish(), period=0.1))
    names = [[m.ns for m in message.markers if m.action == 0] for message in found["/obstacles"]]
    assert names == [["table"]] * 3 + [["table", "ball"]] * 8
    y = [m.markers[-1].pose.position.y for m in found["/obstacles"][4:]]
    np.testing.assert_allclose(y, np.arange(0.4, 1.05, 0.1), atol=0.011)  # a sample more or less
    assert all(m.markers[0].action == 3 for m in found["/obstacles"])  # all are deleted, then there are new ones
    assert "/joint_states" not in found


def test_a_bag_refuses_what_it_cannot_hold(tmp_path, silvermate, driven):
    from dataclasses import replace

    with refused(InputError, "-1 s"):
        write_bag(tmp_path / "t.mcap", replace(driven, time=driven.time - 1.0))
    with refused(InputError, "period=0"):
        write_bag(tmp_path / "t.mcap", driven, period=0.0)
    with refused(InputError, "motion"):
        write_bag(tmp_path / "t.mcap", driven.strip())
    assert not list(tmp_path.iterdir())
