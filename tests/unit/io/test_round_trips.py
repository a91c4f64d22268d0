"""Round trips: what is lost by each format is what docs/formats.md says, and so is what a bag holds field by field."""

from __future__ import annotations

import dataclasses
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import elastic_strips as es
from elastic_strips import io
from elastic_strips.control.record import Record, Recorder
from elastic_strips.scene import Cone, ConvexHull, Keyframes, Points, Scene, Voxels, World
from elastic_strips.trajectory import Trajectory, retime

rosbags = pytest.importorskip("rosbags.highlevel")
PAGE = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
PERIOD = 0.05
CORNERS = np.array([[5, 5, 0], [5.4, 5, 0], [5, 5.4, 0], [5, 5, 0.4]])
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
TURNED = (0.1, 0.2, 0.3, 0.9273618495495703)


@pytest.fixture(scope="module")
def trajectory(silvermate) -> Trajectory:
    """More than a whole turn on a circle, from 2 s on, while the arm moves."""
    k = np.arange(60)
    rows = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (60, 1))
    turn = 0.12 * k
    rows[:, :3] = np.column_stack((np.sin(turn), 1.0 - np.cos(turn), turn))
    rows[:, 3:] += 0.2 * np.sin(0.1 * k[:, None] + np.arange(rows.shape[1] - 3))
    timed = retime(es.Strip.from_coordinates(silvermate, rows))
    return dataclasses.replace(timed, time=timed.time + 2.0)


@pytest.fixture(scope="module")
def record() -> Record:
    ball = Keyframes([0.0, 1.0], [[2, 0, 0.5], [2, 1, 0.5]])
    table = es.Box((1, 1, 1), at=(0, 3, 0.5), name="table")
    world = World(es.Scene([table, es.Sphere(0.2, motion=ball, name="ball")]), appears={"ball": 0.3})
    robot = es.load_robot("jackal-box")
    recorder = Recorder(robot, world)
    for k in range(121):
        row = np.array([np.sin(0.01 * k), 1.0 - np.cos(0.01 * k), 0.01 * k])
        recorder.control(0.01 * k, coordinates=row, v=np.array([1.0, 0.0, 1.0]), reference=row)
    return recorder.finish()


def scene() -> Scene:
    return es.Scene([
        es.Box((0.6, 0.5, 1.4), at=(1.5, 2, 0.7), quat=TURNED, name="box"), es.Sphere(0.2, at=(2, 3, 1), name="ball"),
        es.Capsule(0.1, 0.5, at=(3, 3, 1), name="capsule"), Cone(0.1, 0.5, at=(4, 3, 1), name="cone"),
        ConvexHull(CORNERS, name="hull"), Voxels([[7, 7, 0], [7, 7.3, 0]], 0.1, at=(0, 0, 0.2), name="cells"),
        Points(CORNERS, 0.05, name="cloud"), es.Cylinder(0.1, 0.5, at=(4, -3, 1), name="pole"),
        es.Mesh(CORNERS, FACES, name="wedge"),
    ])  # fmt: skip


def rows_of(table: str) -> list[list[str]]:
    """Cells of the table under a heading of the page."""
    part = PAGE.split(f"\n## {table}\n", 1)[1].split("\n## ", 1)[0]
    lines = [line for line in part.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def difference(a: object, b: object) -> float:
    return float(np.abs(np.asarray(a, dtype=float) - np.asarray(b, dtype=float)).max(initial=0.0))


def apart(rows: np.ndarray, wanted: np.ndarray, times: object, when: object) -> tuple[float, float, float, float]:
    """Largest difference of position, yaw (whole turns apart), joints, and time."""
    yaw = (rows[:, 2] - wanted[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    joints = difference(rows[:, 3:], wanted[:, 3:])
    return difference(rows[:, :2], wanted[:, :2]), float(np.abs(yaw).max()), joints, difference(times, when)


def from_bag(path: Path, joints: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) and coordinates (n, nv) of a bag's base and joints."""
    bag = io.BagReader(path, world_frame="map")
    times, poses = zip(*bag.poses(), strict=True)
    states = [[state.positions[name] for name in joints] for state in bag.joint_states()] if joints else []
    return np.array(times), np.column_stack((np.array(poses), np.array(states).reshape(len(times), -1)))


def losses(folder: Path, trajectory: Trajectory, record: Record) -> dict[str, tuple[float, float, float, float]]:
    """What each format loses, by its name in the table."""
    robot, wanted, when, found = trajectory.robot, trajectory.coordinates, trajectory.time, {}
    for suffix in ("csv", "npz", "json"):
        back = io.load_path(io.write_trajectory(folder / f"t.{suffix}", trajectory), robot)
        start = when[0] if suffix == "json" else 0.0  # as ROS has it, times are counted from the start
        found[f"trajectory, `.{suffix}`"] = apart(robot.space.to_coordinates(back.q), wanted, back.times, when - start)
    columns = io.trajectory_columns(trajectory)
    rows = np.column_stack([columns[name] for name in ("x", "y", "yaw", *robot.joint_names)])
    found["trajectory, columns and `DataFrame`"] = apart(rows, wanted, columns["time"], when)
    for suffix in ("csv", "json"):
        back = io.load_path(io.write_path(folder / f"p.{suffix}", robot, trajectory.q, when), robot)
        found[f"path, `.{suffix}`"] = apart(robot.space.to_coordinates(back.q), wanted, back.times, when)
    for name, motion, truth in (("trajectory", trajectory, trajectory), ("record", record, record.control)):
        joints = trajectory.robot.joint_names if name == "trajectory" else ()
        times, rows = from_bag(io.write_bag(folder / f"{name}.mcap", motion, period=PERIOD), joints)
        at = np.abs(times[:, None] - truth.time).argmin(axis=1)
        found[f"{name}, `.mcap`"] = apart(rows, truth.coordinates[at], times, truth.time[at])
        rows[:, 2] = np.unwrap(rows[:, 2])
        between = np.column_stack([np.interp(truth.time, times, column) for column in rows.T])
        found[f"{name}, `.mcap`, between messages"] = (*apart(between, truth.coordinates, 0.0, 0.0)[:3], 0.0)
    back = io.read_record(io.write_record(record, folder / "r.npz")).control
    found["record, `.npz`"] = apart(back.coordinates, record.control.coordinates, back.time, record.control.time)
    io.write_scene(scene(), folder / "s.yaml")
    ours = [(a.pose, b.pose, a.spec, b.spec) for a, b in zip(scene(), io.read_scene(folder / "s.yaml"), strict=True)]
    moved = max(difference(a[:3, 3], b[:3, 3]) for a, b, _, _ in ours)
    turned = max(difference(a[:3, :3], b[:3, :3]) for a, b, _, _ in ours)
    sizes = max(difference(value, two[key]) for _, _, one, two in ours for key, value in one.items())
    found["scene, `.yaml`"] = (max(moved, sizes), turned, 0.0, 0.0)
    return found


def test_no_format_loses_more_than_the_page_says(tmp_path, trajectory, record):
    found = losses(tmp_path, trajectory, record)
    for name, values in found.items():
        print(f"| {name} | " + " | ".join(f"{value:.2g}" for value in values))
    assert abs(trajectory.coordinates[-1, 2]) > 2.0 * np.pi
    stated = {row[0]: [float(cell) if cell != "–" else 0.0 for cell in row[1:5]] for row in rows_of("Round trips")}
    assert stated.keys() == found.keys()
    for name, values in found.items():
        assert (np.array(values) <= stated[name]).all(), name


def leaves(value: object, name: str = "") -> list[tuple[str, object]]:
    """Names and values of all plain fields of a message; of a list one after the other."""
    if dataclasses.is_dataclass(value) and not name.endswith(("stamp", "time_from_start", "lifetime")):
        parts = [
            (f.name, getattr(value, f.name))
            for f in dataclasses.fields(value)
            if f.name != "__msgtype__" and not f.name.isupper()
        ]
        return [leaf for part, of in parts for leaf in leaves(of, f"{name}.{part}".lstrip("."))]
    if isinstance(value, (list, np.ndarray)):
        return [leaf for each in value for leaf in leaves(each, f"{name}[]")]
    return [(name, value)]


def empty(value: object) -> bool:
    return (value.sec, value.nanosec) == (0, 0) if hasattr(value, "sec") else not value


def documented() -> dict[str, set[str]]:
    """Fields by topic and type, as the page lists them: ``a.x``, ``.y`` is a.x and a.y."""
    found: dict[str, set[str]] = defaultdict(set)
    topic = ""
    for first, fields, *_ in rows_of("Bags"):
        topic = re.sub(r"[`:,].*?(?=\S+/msg)|,.*", " ", first.replace("`", "", 1)).strip() if first else topic
        last = ""
        for name in re.findall(r"`([^`]+)`", fields):
            last = last.rpartition(".")[0] + name if name.startswith(".") else name
            found[" ".join(topic.split())].add(last)
    return found


def read(path: Path) -> dict[str, list[tuple[float, object]]]:
    found: dict[str, list[tuple[float, object]]] = defaultdict(list)
    with rosbags.AnyReader([path]) as reader:
        for connection, at, data in reader.messages():
            key = f"{connection.topic} {connection.msgtype}"
            found[key].append((1e-9 * at, reader.deserialize(data, connection.msgtype)))
    return found


def test_a_bag_has_the_fields_that_the_page_lists(tmp_path, trajectory, record):
    """Each that is listed is there, and no other that is not 0 or empty."""
    filled: dict[str, set[str]] = defaultdict(set)
    for name, motion, with_scene in (("t", trajectory, scene()), ("r", record, None)):
        for topic, messages in read(io.write_bag(tmp_path / f"{name}.mcap", motion, scene=with_scene)).items():
            filled[topic] |= {leaf for _, message in messages for leaf, value in leaves(message) if not empty(value)}
    page = documented()
    assert filled.keys() == page.keys()
    for topic, fields in filled.items():
        assert fields - {"markers[].id"} == page[topic], topic


def seconds(stamp: object) -> float:
    return stamp.sec + 1e-9 * stamp.nanosec


def vector(value: object) -> list[float]:
    return [getattr(value, axis) for axis in ("x", "y", "z", "w") if hasattr(value, axis)]


def check_pose(position: object, orientation: object, wanted: np.ndarray) -> None:
    """A pose is that of a matrix (4, 4)."""
    np.testing.assert_allclose(vector(position), wanted[:3, 3], atol=1e-12)
    np.testing.assert_allclose(pin.Quaternion(np.array(vector(orientation))).matrix(), wanted[:3, :3], atol=1e-12)


def test_each_field_of_a_bag_is_what_the_page_says(tmp_path, trajectory):
    robot, scene_ = trajectory.robot, scene()
    found = {key.split()[0]: messages for key, messages in read(
        io.write_bag(tmp_path / "t.mcap", trajectory, scene=scene_, frame="world", period=PERIOD)).items()}  # fmt: skip
    start, joints = trajectory.start_time, list(robot.joint_names)
    for topic in ("/plan", "/joint_trajectory", "/robot_description", "/obstacles"):
        ((at, _),) = found[topic]
        assert at == pytest.approx(start, abs=1e-9)
    for topic, messages in found.items():
        for at, message in messages:
            heads = [message.header] if hasattr(message, "header") else []
            heads += [each.header for name in ("transforms", "markers") for each in getattr(message, name, ())]
            for head in heads:
                assert seconds(head.stamp) == pytest.approx(at, abs=1e-9), topic
    ((_, plan),) = found["/plan"]
    assert plan.header.frame_id == "world"
    assert {pose.header.frame_id for pose in plan.poses} == {"world"}
    np.testing.assert_allclose([seconds(p.header.stamp) for p in plan.poses], trajectory.time, atol=1e-9)
    np.testing.assert_array_equal([vector(p.pose.position)[:2] for p in plan.poses], trajectory.coordinates[:, :2])
    half = 0.5 * trajectory.coordinates[:, 2]
    turns = np.array([vector(p.pose.orientation) for p in plan.poses])
    np.testing.assert_allclose(turns[:, 2:], np.column_stack((np.sin(half), np.cos(half))), atol=1e-12)

    ((_, timed),) = found["/joint_trajectory"]
    assert (timed.header.frame_id, timed.joint_names) == ("world", joints)
    for name, rows in (
        ("positions", trajectory.coordinates),
        ("velocities", trajectory.v),
        ("accelerations", trajectory.a),
    ):
        np.testing.assert_array_equal([getattr(p, name) for p in timed.points], rows[:, 3:])
    passed = [seconds(p.time_from_start) for p in timed.points]
    np.testing.assert_allclose(passed, trajectory.time - start, atol=1e-9)

    states, transforms = found["/joint_states"], found["/tf"]
    times = [at for at, _ in states]
    assert [at for at, _ in transforms] == times
    assert max(np.diff(times)) <= PERIOD + 0.01
    assert times[-1] == pytest.approx(trajectory.time[-1], abs=1e-9)
    data, frames = robot.model.createData(), robot.model.frames
    for (at, state), (_, moved) in zip(states, transforms, strict=True):
        k = int(np.abs(trajectory.time - at).argmin())
        assert trajectory.time[k] == pytest.approx(at, abs=1e-9)
        assert (state.header.frame_id, state.name) == ("world", joints)
        np.testing.assert_array_equal(state.position, trajectory.coordinates[k, 3:])
        np.testing.assert_array_equal(state.velocity, trajectory.v[k, 3:])
        pin.framesForwardKinematics(robot.model, data, trajectory.q[k])
        first, *others = moved.transforms
        places = {frames[i].name: data.oMf[i] for i in range(len(frames)) if frames[i].type == pin.FrameType.BODY}
        places.pop("universe", None)
        assert (first.header.frame_id, {t.header.frame_id for t in others}) == ("world", {first.child_frame_id})
        assert sorted(t.child_frame_id for t in moved.transforms) == sorted(places)
        for each in moved.transforms:
            parent = pin.SE3.Identity() if each is first else places[first.child_frame_id]
            wanted = parent.actInv(places[each.child_frame_id]).homogeneous
            check_pose(each.transform.translation, each.transform.rotation, wanted)

    ((_, obstacles),) = found["/obstacles"]
    markers = {marker.ns: marker for marker in obstacles.markers}
    assert list(markers) == list(scene_.names)
    kinds = {"box": 1, "ball": 2, "pole": 3, "cells": 6, "cloud": 6, "capsule": 11, "cone": 11, "hull": 11, "wedge": 11}
    sizes = {"box": [0.6, 0.5, 1.4], "ball": [0.4] * 3, "pole": [0.2, 0.2, 0.5], "cells": [0.1] * 3, "cloud": [0.1] * 3}
    for obstacle in scene_:
        marker = markers[obstacle.name]
        assert (marker.type, marker.action, marker.header.frame_id) == (kinds[obstacle.name], 0, "world")
        assert vector(marker.scale) == pytest.approx(sizes.get(obstacle.name, [1.0] * 3))
        assert (marker.color.r, marker.color.g, marker.color.b, marker.color.a) == pytest.approx((0.6, 0.6, 0.65, 0.9))
        check_pose(marker.pose.position, marker.pose.orientation, obstacle.pose)
        points = np.array([vector(point) for point in marker.points]).reshape(-1, 3)
        assert (len(points) > 0) == (marker.type in (6, 11))
        if marker.type == 11:  # corners in the obstacle's frame, where the shape ends
            low, high = np.full((2, 3), obstacle.spec.get("radius", 0.0)) * [[-1], [1]]
            if "length" in obstacle.spec:
                half = 0.5 * obstacle.spec["length"] + (obstacle.spec["radius"] if obstacle.shape == "capsule" else 0.0)
                low[2], high[2] = -half, half
            else:
                low, high = CORNERS.min(axis=0), CORNERS.max(axis=0)
            np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [low, high], atol=2e-3)
    np.testing.assert_array_equal([vector(p) for p in markers["cells"].points], [[7, 7, 0], [7, 7.3, 0]])
    np.testing.assert_array_equal([vector(p) for p in markers["cloud"].points], CORNERS)
    ((_, description),) = found["/robot_description"]
    assert description.data == Path(robot.urdf_path).read_text(encoding="utf-8")
