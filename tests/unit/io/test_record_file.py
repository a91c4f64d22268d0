"""Record files: what is read is what was written, by numpy alone as well, and what is damaged is refused."""

from __future__ import annotations

import csv
import dataclasses
import json
import os
import stat
import tracemalloc
import zipfile

import numpy as np
import pytest
from brute_force import make_scene, scene_pieces
from cases import each, refused
from synthetic_run import moving_world, straight_run

from elastic_strips.control.record import Record, Recorder, RecordError
from elastic_strips.errors import InputError, MissingExtraError
from elastic_strips.io import obstacle_document, record_file
from elastic_strips.io.obstacle_document import world_from_documents
from elastic_strips.io.record_file import (
    FORMAT_VERSION,
    check_record_file,
    read_record,
    record_columns,
    record_csv,
    record_frame,
    record_robot,
    write_record,
)
from elastic_strips.scene import Box, Keyframes, Mesh, Scene, Sphere, Twist, World


@pytest.fixture(scope="module")
def record(silvermate) -> Record:
    return straight_run(silvermate, moving_world(), length=1.0, wave=0.2)


@pytest.fixture
def file(record, tmp_path):
    return write_record(record, tmp_path / "run.npz")


def changed(file, target, **arrays):
    """A copy of a file with arrays replaced, or left out where None."""
    with np.load(file) as loaded:
        kept = {name: loaded[name] for name in loaded.files}
    kept |= arrays
    np.savez_compressed(target, **{name: array for name, array in kept.items() if array is not None})
    return target


def with_metadata(file, target, **values):
    with np.load(file) as loaded:
        document = json.loads(str(loaded["metadata"]))
    document |= values
    return changed(file, target, metadata=np.array(json.dumps(document)))


def test_a_record_reads_back_to_the_last_bit(record, file):
    again = read_record(file)
    for part in ("control", "planning"):
        for field in dataclasses.fields(getattr(record, part)):
            one, two = (getattr(getattr(r, part), field.name) for r in (record, again))
            if isinstance(one, np.ndarray):
                np.testing.assert_array_equal(one, two, err_msg=field.name)
                assert one.dtype == two.dtype
                assert not two.flags.writeable
            else:
                assert one == two
    for name in ("robot", "base", "joint_names", "locked", "urdf", "events", "states", "metadata"):
        assert getattr(record, name) == getattr(again, name), name
    np.testing.assert_array_equal(record.goal, again.goal)


def seen_record(robot) -> Record:
    recorder = Recorder(robot, Scene())
    coordinates = robot.space.to_coordinates(robot.home_q)
    for k in range(200):
        recorder.control(0.01 * k, coordinates=coordinates, v=0.0 * coordinates)
        posts = [Sphere(0.1, at=(0.1 * (k // 50), 1.0, 1.0), name="post"), Box((1.0, 0.1, 1.0), name="wall")]
        recorder.seen(0.01 * k, Scene(posts, time=0.01 * k))
    return recorder.finish()


def test_what_was_seen_reads_back(record, silvermate, tmp_path):
    seen = seen_record(silvermate)
    again = read_record(write_record(seen, tmp_path / "run.npz"))
    assert len(seen.seen) == 5
    for field in dataclasses.fields(seen.seen):
        one, two = (getattr(r.seen, field.name) for r in (seen, again))
        np.testing.assert_array_equal(one, two, err_msg=field.name)
        assert one.dtype == two.dtype
    assert len(record.seen) == 0
    assert len(read_record(write_record(record, tmp_path / "known.npz")).seen) == 0


def test_what_was_seen_has_to_make_sense(silvermate, tmp_path):
    file, target = write_record(seen_record(silvermate), tmp_path / "run.npz"), tmp_path / "x.npz"
    rows = read_record(file).seen
    for name, array in (
        ("shape", np.full_like(rows.shape, 3)),
        ("end", rows.begin - 1.0),
        ("size", -rows.size),
        ("quaternion", 2.0 * rows.quaternion),
        ("position", rows.position[:-1]),
        ("position", np.where(rows.position == 1.0, np.nan, rows.position)),
        ("moves", rows.shape),
        ("size", None),
    ):
        with refused(RecordError, f"seen_{name}"):
            read_record(changed(file, target, **{f"seen_{name}": array}))


def test_obstacles_are_where_they_were(record, file):
    world = read_record(file).world
    assert world.scene.names == record.world.scene.names
    assert dict(world.appears) == dict(record.world.appears) == {"ball": 3.0, "bin": 4.0}
    assert dict(world.vanishes) == dict(record.world.vanishes)
    for t in record.control.time[::37]:
        then, now = record.world.at(float(t)), world.at(float(t))
        assert then.names == now.names
        for one, two in zip(then, now, strict=True):
            np.testing.assert_allclose(two.pose, one.pose, atol=1e-12)
            assert one.shape == two.shape
    middle = 0.5 * (record.control.time[10] + record.control.time[11])
    for one, two in zip(record.world.at(middle), world.at(middle), strict=True):
        np.testing.assert_allclose(two.pose, one.pose, atol=1e-9)


def test_every_shape_comes_back_as_convex_pieces_at_the_same_places(silvermate, tmp_path, rng):
    """A mesh, voxels and points come back as their pieces, also where they turn while they move."""
    still = make_scene(rng, 9)
    spin = Twist((0.3, -0.1, 0.2), (0.4, 1.0, -0.5))
    moving = [type(o)(**o.spec, at=o.pose[:3, 3], motion=spin) for o in make_scene(rng, 9) if o.shape != "mesh"]
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    moving.append(Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], at=(0, 1, 0), motion=spin))
    world = World(Scene([*still, *(o.named(f"moving {k}#0") for k, o in enumerate(moving))]))
    recorder = Recorder(silvermate, world)
    row = silvermate.space.to_coordinates(silvermate.home())
    for t in (0.5, 0.7, 1.1):
        recorder.control(t, coordinates=row, v=0 * row)
    again = read_record(write_record(recorder.finish(), tmp_path / "x.npz")).world
    for t in (0.5, 0.7, 1.1):
        for scenes in (world.at(t), again.at(t)):
            assert len(scene_pieces(scenes)) > 40
        one, two = scene_pieces(world.at(t)), scene_pieces(again.at(t))
        assert len(one) == len(two)
        for a, b in zip(one, two, strict=True):
            assert type(a.geometry) is type(b.geometry)
            corner = np.array([*a.geometry.aabb_local.min_, 1.0])
            np.testing.assert_allclose(a.T @ corner, b.T @ np.array([*b.geometry.aabb_local.min_, 1.0]), atol=1e-9)


def test_a_piece_may_be_turned_within_its_obstacle():
    """Whoever writes such a file: the shape is at the track's pose times its own."""
    half = np.sqrt(0.5)
    along_x, about_z = [0.0, half, 0.0, half], [0.0, 0.0, half, half]
    base = {"shape": "cylinder", "size": [0.1, 1.0], "appears": None, "vanishes": None}
    document = {**base, "name": "log", "pose": [1.0, 0, 0, *along_x], "track": 0}
    time = np.array([0.0, 1.0])
    world = world_from_documents([document], time, np.full((2, 1, 3), 5.0), np.tile(about_z, (2, 1, 1)))
    pose = world.at(0.5).obstacle("log").pose
    np.testing.assert_allclose(pose[:3, 3], [5.0, 6.0, 5.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(pose[:3, 2]), [0.0, 1.0, 0.0], atol=1e-12)


def test_names_that_clash_with_those_of_pieces(silvermate, tmp_path):
    cloud = make_scene(np.random.default_rng(1), 1, shapes=("points",)).obstacles[0].named("a")
    world = World(Scene([Box((1, 1, 1), at=(3, 3, 0), name="a#1"), cloud]), appears={"a#1": 1.0})
    recorder = Recorder(silvermate, world)
    recorder.control(0.0, coordinates=np.zeros(10), v=np.zeros(10))
    again = read_record(write_record(recorder.finish(), tmp_path / "x.npz")).world
    assert len(again.scene) == 1 + len(scene_pieces(Scene([cloud])))
    assert dict(again.appears) == {"a#1": 1.0}
    assert again.scene.obstacle("a#1").shape == "box"


def test_numpy_alone_can_read_it(record, file):
    with np.load(file, allow_pickle=False) as loaded:
        assert all(loaded[name].dtype.kind in "fiubU" for name in loaded.files)
        document = json.loads(str(loaded["metadata"]))
        x = loaded["control_chart"][:, document["columns"]["chart"].index("x")]
        person = loaded["track_position"][:, document["tracks"].index("person")]
        drive = dict(zip(document["columns"]["drive"], loaded["control_drive"].T, strict=True))
    np.testing.assert_array_equal(x, record.control.coordinates[:, 0])
    np.testing.assert_allclose(person[:, 1], -2.4 + 0.55 * record.control.time, atol=1e-12)
    np.testing.assert_array_equal(drive["left"], record.control.drive[:, 0])
    assert document["version"] == FORMAT_VERSION == 1
    assert {d["name"]: d["track"] for d in document["obstacles"]}["cart"] == document["tracks"].index("cart")
    assert set(document["units"]) >= {"time", "chart", "velocity", "drive"}


def test_the_robot_comes_back(record, file, silvermate, gantry, gantry_urdf, tmp_path):
    robot = record_robot(read_record(file))
    assert robot.joint_names == silvermate.joint_names
    assert robot.base_kind is silvermate.base_kind
    recorder = Recorder(gantry, Scene())
    recorder.control(0.0, coordinates=np.zeros(gantry.nv), v=np.zeros(gantry.nv))
    fixed = read_record(write_record(recorder.finish(), tmp_path / "fixed.npz"))
    assert fixed.control.drive.shape == (1, 0)
    assert record_robot(fixed).joint_names == gantry.joint_names
    assert record_robot(dataclasses.replace(fixed, urdf="/moved"), str(gantry_urdf)).nv == gantry.nv
    with refused(InputError, "/moved"):
        record_robot(dataclasses.replace(fixed, urdf="/moved"))
    with refused(InputError, "URDF"):
        record_robot(dataclasses.replace(fixed, urdf=None))
    with refused(RecordError, "record"):
        record_robot(read_record(file), "tiago")


def test_a_csv_file_holds_the_control_rows(record, tmp_path):
    target = write_record(record, tmp_path / "run.CSV")
    rows = list(csv.DictReader(target.read_text().splitlines()))
    assert len(rows) == len(record.control)
    assert list(rows[0]) == list(record_columns(record))
    assert len(set(rows[0])) == 2 + 5 * 10 + 2 + 7 + 2
    for k in (0, 57, len(rows) - 1):
        assert float(rows[k]["time"]) == record.control.time[k]
        assert float(rows[k]["vx"]) == record.control.v[k, 0]
        assert float(rows[k]["reference_arm_2_joint"]) == record.control.reference[k, 4]
        assert float(rows[k]["estimate_yaw"]) == record.control.estimate[k, 2]
        assert float(rows[k]["command_right"]) == record.control.drive[k, 1]
        assert float(rows[k]["command_arm_7_joint_rate"]) == record.control.joints[k, 6]
        assert rows[k]["state"] == record.states[record.control.state[k]]


def test_nan_is_nothing_in_csv(gantry, rover):
    for robot, drive in ((gantry, 0), (rover, 3)):
        recorder = Recorder(robot, Scene())
        recorder.control(0.25, coordinates=np.zeros(robot.nv), v=np.ones(robot.nv))
        record = recorder.finish()
        header, row = record_csv(record).splitlines()
        values = dict(zip(header.split(","), row.split(","), strict=True))
        assert values["time"] == "0.25"
        assert values["slide_rate"] == "1.0"
        assert values["reference_slide"] == values["command_slide_rate"] == ""
        assert ("x" in values) is (drive > 0)
        assert len(values) == 2 + 5 * robot.nv + 2 * drive + len(robot.joint_names)


def test_a_frame_where_pandas_is(record, monkeypatch):
    pandas = pytest.importorskip("pandas")
    frame = record_frame(record)
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == list(record_columns(record))
    np.testing.assert_array_equal(frame["x"], record.control.coordinates[:, 0])
    assert frame["state"].iloc[-1] == "reached"


def test_no_frame_where_pandas_is_not(record, monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(record_file.importlib, "import_module", missing)
    with refused(MissingExtraError, "pandas"):
        record_frame(record)
    assert len(record_columns(record)["x"]) == len(record.control)


def test_a_file_is_whole_or_not_there(record, tmp_path, monkeypatch):
    target = write_record(record, tmp_path / "run.npz")
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    before = target.read_bytes()
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with refused(InputError, "No space left"):
        write_record(record, target)
    assert target.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.npz"]


def test_where_nothing_can_be_written(record, tmp_path):
    for name, match in (("run.json", "not '.json'"), ("run", "not ''"), ("nowhere/run.npz", "there is no folder")):
        for attempt in (lambda p: write_record(record, p), check_record_file):
            with pytest.raises(InputError, match=match):
                attempt(tmp_path / name)
    assert check_record_file(tmp_path / "run.npz") == tmp_path / "run.npz"
    with refused(RecordError, "JSON"):
        write_record(dataclasses.replace(record, metadata={"robot": object()}), tmp_path / "run.npz")
    with refused(RecordError, "JSON"):
        write_record(dataclasses.replace(record, metadata={"cost": np.inf}), tmp_path / "run.npz")
    assert os.listdir(tmp_path) == []


def test_what_is_no_record_is_refused(tmp_path):
    target = tmp_path / "x.npz"
    with refused(RecordError, "x.npz:"):
        read_record(target)
    with refused(RecordError, "folder"):
        read_record(tmp_path)
    for content in (b"", b"P", b"time,state\n0.0,moving\n", b"\x93NUMPY\x01\x00"):
        target.write_bytes(content)
        with refused(RecordError, ".npz"):
            read_record(target)
    np.savez(target, time=np.zeros(3))
    with refused(RecordError, "'metadata'"):
        read_record(target)
    for metadata in (np.array("{"), np.array("[]"), np.zeros(3), np.array('{"format": "other"}')):
        np.savez(target, metadata=metadata)
        with refused(RecordError, "record"):
            read_record(target)
    np.savez(target, metadata=np.array([{"a": 1}], dtype=object))
    with refused(RecordError, "read"):
        read_record(target)


def test_another_version_is_refused(file, tmp_path):
    with refused(RecordError, "version"):
        read_record(with_metadata(file, tmp_path / "x.npz", version=2))


@each("share", [0.001, 0.3, 0.9, 0.999])
def test_a_file_that_is_cut_off_is_refused(file, share):
    data = file.read_bytes()
    file.write_bytes(data[: max(int(share * len(data)), 2)])
    with refused(RecordError, "run.npz:"):
        read_record(file)


def test_a_file_with_a_flipped_byte_is_refused(file):
    with zipfile.ZipFile(file) as archive:
        info = archive.getinfo("control_chart.npy")
    data = bytearray(file.read_bytes())
    data[info.header_offset + 100 + info.compress_size // 2] ^= 0xFF
    file.write_bytes(bytes(data))
    with refused(RecordError, "run.npz:"):
        read_record(file)


def test_every_array_is_needed_and_must_fit(file, tmp_path):
    target = tmp_path / "x.npz"
    with np.load(file) as loaded:
        names = [name for name in loaded.files if name != "metadata"]
        arrays = {name: loaded[name] for name in names}
    assert len(names) == 22
    for name in names:
        with pytest.raises(RecordError, match=f"'{name}' is missing"):
            read_record(changed(file, target, **{name: None}))
        with pytest.raises(RecordError, match=r"(has|have) shape"):
            read_record(changed(file, target, **{name: arrays[name][None]}))
        with refused(RecordError, "complex128"):
            read_record(changed(file, target, **{name: arrays[name].astype(complex)}))
        if name != "planning_nodes":
            with pytest.raises(RecordError, match=r"shape|nodes"):
                read_record(changed(file, target, **{name: arrays[name][:-1]}))


def test_arrays_that_contradict_themselves_are_refused(record, file, tmp_path):
    target = tmp_path / "x.npz"
    rows, planning = record.control, record.planning
    for name, array, match in (
        ("control_time", rows.time[::-1], "ascend"),
        ("control_time", np.where(rows.time == 0, np.nan, rows.time), r"holds nan at \[0\]"),
        ("control_state", np.full_like(rows.state, 77), "goes from 77 to 77; there are names for 0 to 4"),
        ("planning_reason", planning.reason - 1, "'planning_reason' goes from -1"),
        ("planning_status", planning.status + 9, "'planning_status' goes"),
        ("planning_node_offset", planning.node_offset[::-1], "ascend from 0"),
        ("planning_nodes", planning.nodes[:-1], "ascend from 0"),
        ("track_quaternion", np.zeros((len(rows), 3, 4)), "damaged"),
    ):
        with pytest.raises(RecordError, match=match):
            read_record(changed(file, target, **{name: array}))
    for values, match in (
        ({"base": "legs"}, "metadata: base: unknown value 'legs'"),
        ({"joint_names": "arm"}, "list of names"),
        ({"goal": [1.0]}, "goal: must be a list of 10 numbers, not a list of 1"),
        ({"events": [[1]]}, r"events\[0\]: must be a list of time, kind and reason"),
        ({"obstacles": [{"name": "x"}]}, "an obstacle is damaged"),
        ({"obstacles": 3}, "an obstacle is damaged"),
        ({"tracks": ["a", "b", "c", "d"]}, "track_position"),
        ({"locked": [1]}, "locked: must be a mapping"),
    ):
        with pytest.raises(RecordError, match=match):
            read_record(with_metadata(file, target, **values))
    box = {"shape": "box", "size": [1, 1, 1], "pose": [0, 0, 0, 0, 0, 0, 1], "appears": None, "vanishes": None}
    for entry, match in (
        ({"track": 3}, "follows track 3; there are 3"),
        ({"track": None, "shape": "torus"}, "torus"),
        ({"track": None, "size": [-1, 1, 1]}, "damaged"),
        ({"track": None, "pose": [0, 0, 0, 0, 0, 0, 2]}, "unit quaternion"),
        ({"track": None, "pose": [0, 0]}, "seven finite numbers"),
        ({"track": None, "appears": 2.0, "vanishes": 1.0}, "vanishes at 1"),
    ):
        with pytest.raises(RecordError, match=match):
            read_record(with_metadata(file, target, obstacles=[{**box, "name": "b", **entry}]))


def test_a_loop_of_keyframes_is_kept_as_it_was_driven(silvermate, tmp_path):
    """Between rows a motion is taken as even: what turns back in between is cut short by less than v dt / 2."""
    to_and_fro = Keyframes([0.0, 0.333, 0.666], [[2, 0, 1], [2, 1, 1], [2, 0, 1]], loop=True)
    world = World(Scene([Sphere(0.1, motion=to_and_fro, name="ball")]))
    recorder = Recorder(silvermate, world)
    for t in np.arange(0.0, 3.0, 0.01):
        recorder.control(t, coordinates=np.zeros(10), v=np.zeros(10))
    again = read_record(write_record(recorder.finish(), tmp_path / "x.npz")).world
    apart = [
        np.abs(again.at(t).obstacles[0].pose - world.at(t).obstacles[0].pose).max() for t in np.arange(0, 2.9, 1e-3)
    ]
    assert 0.0 < max(apart) < 0.5 * 3.01 * 0.01


def test_what_is_not_finite_is_refused_with_its_place(record, file, tmp_path):
    """NaN stands for what was not known, in the columns that docs/record-format.md names, and nowhere else."""
    target = tmp_path / "x.npz"
    with np.load(file) as loaded:
        arrays = {name: loaded[name] for name in loaded.files if loaded[name].dtype.kind == "f" and loaded[name].size}
    unknown = {f"control_{n}" for n in ("reference", "reference_v", "estimate", "drive", "joints", "motors")}
    unknown |= {f"planning_{n}" for n in ("tick_ms", "phase_ms", "clearance", "horizon_end")}
    assert unknown < set(arrays)
    for name, array in arrays.items():
        place = tuple(n - 1 for n in array.shape)
        for value in (np.nan, np.inf):
            array = array.copy()
            array[place] = value
            changed(file, target, **{name: array})
            if np.isnan(value) and name in unknown:
                read_record(target)
            else:
                with pytest.raises(
                    RecordError, match=rf"x\.npz: the array '{name}' holds {value} at \[.*{place[-1]}\]"
                ):
                    read_record(target)
    for values in (
        {"goal": [np.nan] * len(record.goal)},
        {"events": [[np.nan, "start", ""]]},
        {"locked": {"arm": np.inf}},
    ):
        with refused(RecordError, "finite"):
            read_record(with_metadata(file, target, **values))


def test_a_small_file_of_large_arrays_is_refused_before_memory_is_taken(file, tmp_path, monkeypatch):
    """What the members claim counts, all together; arrays that no one asks for are not even looked at."""
    target = changed(file, tmp_path / "x.npz", huge=np.zeros(50_000_000))
    assert target.stat().st_size < 1_000_000
    tracemalloc.start()
    read_record(target)
    assert tracemalloc.get_traced_memory()[1] < 100_000_000
    bomb = changed(file, target, control_chart=np.zeros((4_000_000, 10)))
    tracemalloc.reset_peak()
    with refused(RecordError, "250000000"):
        read_record(bomb)
    assert tracemalloc.get_traced_memory()[1] < 100_000_000
    tracemalloc.stop()
    monkeypatch.setattr(record_file, "MAX_ARRAY_BYTES", 100_000)
    with refused(RecordError, "100000"):
        read_record(file)


def test_obstacles_that_follow_one_track_are_bounded(file, tmp_path, monkeypatch):
    """A line of metadata each, and all of them would hold the track's poses."""
    entry = {"shape": "sphere", "size": [1.0], "pose": [0, 0, 0, 0, 0, 0, 1], "appears": None, "vanishes": None}
    many = [{**entry, "name": f"b{k}", "track": 0} for k in range(20)]
    monkeypatch.setattr(obstacle_document, "MAX_ROWS", 1000)
    with refused(RecordError, "1000"):
        read_record(with_metadata(file, tmp_path / "x.npz", obstacles=many))


def test_members_that_lie_are_refused(file, tmp_path, monkeypatch):
    """Another shape than there are bytes, another compression, a list of members without end, too long a text."""
    target = tmp_path / "x.npz"

    def rewritten(name, data, compression=zipfile.ZIP_DEFLATED):
        with zipfile.ZipFile(file) as old, zipfile.ZipFile(target, "w") as new:
            for member in old.namelist():
                own = member == f"{name}.npy"
                new.writestr(member, data(old.read(member)) if own else old.read(member), compression if own else None)

    def shape(text):
        return lambda data: data.replace(b"'shape': (", b"'shape': (" + text, 1).replace(b" " * len(text), b"", 1)

    for data, match in (
        (shape(b"99999999, "), "has .* bytes; float64 of the shape"),
        (shape(b"-1, "), "has .* bytes; float64 of the shape"),
        (lambda d: d[:6] + b"\3" + d[7:], "version"),
        (lambda d: d.replace(b"<f8", b"|O8"), "Python objects"),
        (lambda d: d.replace(b"{", b"("), "no sound header"),
        (lambda d: d[:-8], "bytes; float64 of the shape"),
    ):
        rewritten("control_chart", data)
        with pytest.raises(RecordError, match=rf"x\.npz: cannot read: the array 'control_chart' .*{match}"):
            read_record(target)
    rewritten("control_chart", bytes, zipfile.ZIP_LZMA)
    with refused(RecordError, "'deflate'"):
        read_record(target)
    with zipfile.ZipFile(target, "w") as archive:
        for k in range(3000):
            archive.writestr(f"{k}.npy", b"")
    with refused(RecordError, "100000"):
        read_record(target)
    monkeypatch.setattr(record_file, "MAX_TEXT", 100)
    with refused(RecordError, "100"):
        read_record(file)
