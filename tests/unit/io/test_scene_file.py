"""Scene files: the documented examples load, wrong files name file, line and key, writing and reading are inverse."""

import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cases import each, refused

from elastic_strips.errors import SceneError
from elastic_strips.io import read_scene, read_world, write_scene, write_world
from elastic_strips.scene import (
    Box,
    Capsule,
    Cone,
    ConvexHull,
    Cylinder,
    Keyframes,
    Mesh,
    Motion,
    Points,
    Scene,
    Sphere,
    Twist,
    UnknownMotion,
    Voxels,
    World,
)

DOCS = Path(__file__).parents[3] / "docs" / "scene-files.md"


def example(kind):
    """The example of that kind in the documentation."""
    found = re.findall(rf"```yaml {kind}\n(.*?)```", DOCS.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(found) == 1
    return found[0]


def read(tmp_path, text):
    path = tmp_path / "scene.yaml"
    path.write_text(text, encoding="utf-8")
    return read_scene(path)


def test_documented_example_loads(tmp_path):
    scene = read(tmp_path, example("scene"))
    assert [o.shape for o in scene] == [
        *("box", "sphere", "cylinder", "capsule", "cone", "convex", "mesh", "voxels", "points", "cylinder", "box")
    ]
    assert scene.names[:2] == ("table", "sphere-1")
    yaw = math.atan2(scene.obstacle("table").pose[1, 0], scene.obstacle("table").pose[0, 0])
    assert yaw == pytest.approx(0.4)
    assert scene.obstacle("scan").spec["radius"] == 1e-2
    assert len(scene.obstacle("shelf").parts[0].boxes) == 1
    assert scene.at(2.0).obstacle("cart").pose[1, 3] == pytest.approx(0.0)
    assert scene.at(2.0).obstacle("person").pose[0, 3] == pytest.approx(8 - 1.6)
    world = read_world(tmp_path / "scene.yaml")
    assert (dict(world.appears), dict(world.vanishes)) == ({"dog": 2.5}, {"dog": 9.0})
    assert world.at(0.0).names == scene.names
    assert world.at(3.0).obstacle("dog").motion.max_speed == 1.5


def test_a_scene_holds_what_exists_at_its_time_and_a_world_all(tmp_path):
    text = "time: 5\nobstacles:\n- {shape: sphere, radius: 1, vanishes: 5}\n- {shape: sphere, radius: 2, appears: 5}\n"
    text += "- {shape: sphere, radius: 3}\n"
    assert read(tmp_path, text).names == ("sphere-1", "sphere-2")
    world = read_world(tmp_path / "scene.yaml")
    assert world.scene.names == ("sphere-0", "sphere-1", "sphere-2")
    assert world.at(4.9).names == ("sphere-0", "sphere-2")


def test_worlds_are_written_and_read_back(tmp_path):
    world = World(Scene(every_shape(), time=0.5), {"true": 1.0, "null": -1 / 3}, {"true": 1e8})
    write_world(world, tmp_path / "out.yaml")
    back = read_world(tmp_path / "out.yaml")
    same(world.scene, back.scene)
    assert (dict(back.appears), dict(back.vanishes)) == (dict(world.appears), dict(world.vanishes))
    write_scene(world.at(0.5), tmp_path / "out.yaml")
    assert "true" not in read_world(tmp_path / "out.yaml").scene.names


def test_rpy_is_that_of_urdf(tmp_path):
    pin = pytest.importorskip("pinocchio")
    scene = read(tmp_path, "obstacles: [{shape: sphere, radius: 1, rpy: [0.3, -0.7, 2.1]}]")
    np.testing.assert_allclose(scene.obstacles[0].pose[:3, :3], pin.rpy.rpyToMatrix(0.3, -0.7, 2.1), atol=1e-12)


def box(text):
    return f"obstacles:\n- shape: box\n  size: [1, 1, 1]\n  {text}\n"


BAD = [
    ("[1, 2]", 1, "must be a mapping of a scene, not a list of 2"),
    ("time: 1\n", 1, "'obstacles'"),
    ("obstacles:\n", 1, "obstacles: nothing follows"),
    ("obstacle: []\n", 1, "unknown key 'obstacle' of a scene; did you mean 'obstacles'"),
    ("version: 2\nobstacles: []\n", 1, r"version: is 2, outside \[1, 1\]"),
    ("time: soon\nobstacles: []\n", 1, "time: must be a number, not 'soon'"),
    ("time: .nan\nobstacles: []\n", 1, "time: nan must be a finite number of s"),
    ("obstacles: 5\n", 1, "obstacles: must be a list, not 5"),
    ("obstacles:\n- 5\n", 2, r"obstacles\[0\]: must be a mapping"),
    ("obstacles:\n- {size: [1, 1, 1]}\n", 2, "'shape'"),
    ("obstacles:\n- shape: spere\n", 2, r"obstacles\[0\]\.shape: unknown value 'spere'; did you mean 'sphere'"),
    ("obstacles:\n- shape: 3\n", 2, "non-empty string"),
    ("obstacles:\n- shape: sphere\n", 2, "'radius'"),
    ("obstacles:\n- shape: sphere\n  radius: 0\n", 3, r"radius: 0 must be a finite number of m ≥ 1e-06 and ≤ 1e\+06"),
    ("obstacles:\n- shape: sphere\n  radius: -1\n", 3, "radius: -1 must be"),
    ("obstacles:\n- shape: sphere\n  radius: true\n", 3, "radius: must be a number, not True"),
    ("obstacles:\n- shape: sphere\n  radius: '1'\n", 3, "radius: must be a number, not '1' \\(a string\\)"),
    ("obstacles:\n- shape: sphere\n  radius: .inf\n", 3, "radius: inf must be a finite number"),
    ("obstacles:\n- shape: sphere\n  radius: 1e999\n", 3, "radius: inf must be a finite number"),
    ("obstacles:\n- shape: sphere\n  radius:\n", 3, "must be a number, not nothing"),
    ("obstacles:\n- shape: sphere\n  radius: 1\n  length: 1\n", 4, "unknown key 'length' of a sphere"),
    ("obstacles:\n- shape: box\n  size: [1, 1]\n", 3, "size: must be a list of 3 numbers, not a list of 2"),
    ("obstacles:\n- shape: box\n  size: [1, 1,\n   x]\n", 4, r"size\[2\]: must be a number, not 'x'"),
    ("obstacles:\n- shape: box\n  size: [1, 1, 0]\n", 3, "size: the value is .*at least 1e-06"),
    (box("ta: [0, 0, 0]"), 4, "unknown key 'ta' of a box; did you mean 'at'"),
    (box("at: [0, 0, 1e7]"), 4, r"at: at\[2\] is 1e\+07"),
    (box("quat: [0, 0, 0, 1.5]"), 4, "quat: the value is .* norm 1.5"),
    (box("quat: [0, 0, 0, 1]\n  rpy: [0, 0, 0]"), 5, "rpy: the orientation is given twice"),
    (box("name: 5"), 4, "name: must be a non-empty string, not 5 .*quote"),
    (box("name: ''"), 4, "name: must be a non-empty string"),
    (box("name: a\n- {shape: sphere, radius: 1, name: a}"), 5, r"obstacles\[1\]\.name: the name 'a' is taken.*line 4"),
    (box("motion: fast"), 4, "motion: must be a mapping of a motion"),
    (box("motion: {}"), 4, "one of 'twist', 'keyframes' and 'unknown'"),
    (box("motion: {unknown: {}}"), 4, "'max_speed' is missing"),
    (box("motion: {unknown: 1.5}"), 4, "must be a mapping of an unknown motion"),
    (box("motion: {unknown: {max_speed: -1}}"), 4, "max_speed: -1 must be a finite number of m/s ≥ 0"),
    (box("motion: {unknown: {maxspeed: 1}}"), 4, "did you mean 'max_speed'"),
    (box("appears: soon"), 4, r"obstacles\[0\]\.appears: must be a number, not 'soon'"),
    (box("appears: .nan"), 4, "appears: nan must be a finite number"),
    (box("vanish: 3"), 4, "unknown key 'vanish' of a box; did you mean 'vanishes'"),
    (box("appears: 3\n  vanishes: 3"), 5, r"vanishes: is 3 s; it must be later than 'appears', 3 s"),
    (box("motion: {twits: {}}"), 4, "unknown key 'twits' of a motion; did you mean 'twist'"),
    (box("motion: {twist: {linear: [1, 2]}}"), 4, r"motion\.twist\.linear: must be a list of 3 numbers"),
    (box("motion: {twist: {linear: [1, 2, 1e9]}}"), 4, "must be finite and within"),
    (box("motion: {keyframes: {times: [0, 1]}}"), 4, "'positions'"),
    (box("motion: {keyframes: {times: [1, 0], positions: [[0, 0, 0], [0, 0, 0]]}}"), 4, "increase strictly"),
    (
        box("motion: {keyframes: {times: [0, 1], positions: [[0, 0, 0], [0, 0]]}}"),
        4,
        r"positions\[1\]: must be a list of 3",
    ),
    (box("motion: {keyframes: {times: [0], positions: [[0, 0, 0]], loop: 1}}"), 4, "loop: must be true or false"),
    (box("at: [1, 0, 0]\n  motion: {keyframes: {times: [0], positions: [[0, 0, 0]]}}"), 2, "keyframes say"),
    ("obstacles:\n- shape: convex\n  vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]\n", 2, "flat"),
    (
        "obstacles:\n- shape: convex\n  vertices:\n  - [0, 0, 0]\n  - [1, 0, .nan]\n",
        5,
        r"vertices\[1\]\[2\]: nan must be a finite number",
    ),
    ("obstacles:\n- shape: voxels\n  size: 0.1\n", 2, "'centers' or 'file'"),
    ("obstacles:\n- shape: voxels\n  size: 0.1\n  centers: []\n", 4, "empty"),
    (
        "obstacles:\n- shape: voxels\n  size: 0.1\n  centers: [[0, 0, true]]\n",
        4,
        r"centers\[0\]\[2\]: must be a number",
    ),
    (
        "obstacles:\n- shape: voxels\n  size: 0.1\n  file: gone.npy\n",
        4,
        "gone.npy: cannot read the file of points: No such file",
    ),
    ("obstacles:\n- shape: voxels\n  size: 0.1\n  file: gone.pkl\n", 4, "not read"),
    ("obstacles:\n- shape: points\n  radius: 0.1\n  points: [[0, 0, 0]]\n  file: a.csv\n", 2, "only one of"),
    ("obstacles:\n- shape: mesh\n  file: gone.stl\n", 3, "gone.stl: cannot read"),
    ("obstacles:\n- shape: mesh\n  file: gone.step\n", 3, "kind '.step'"),
    ("obstacles:\n- shape: mesh\n  file: gone.stl\n  scale: 0\n", 4, "scale: 0 must be"),
    ("obstacles:\n- shape: mesh\n  file: gone.stl\n  faces: [[0, 1, 2]]\n", 4, "belongs to 'vertices'"),
    ("obstacles:\n- shape: mesh\n  vertices: [[0, 0, 0]]\n  scale: 2\n  faces: [[0, 0, 0]]\n", 4, "belongs to a mesh"),
    (
        "obstacles:\n- shape: mesh\n  vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\n  faces: [[0, 1, 3]]\n",
        2,
        r"\[0, 2\]",
    ),
]


@each("text, line, message", BAD)
def test_a_wrong_file_names_file_line_and_key(tmp_path, text, line, message):
    with pytest.raises(SceneError, match=message) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'scene.yaml'}:{line}: ")


def every_shape():
    quat = np.array([0.1, -0.4, 0.2, 0.7])
    quat /= np.linalg.norm(quat)
    box = trimesh.creation.box((1, 2, 3))
    return [
        Box((0.1, 1 / 3, 1e-5), at=(1e-7, -2 / 3, 1e5), quat=quat, name="1e-3"),
        Sphere(0.2, name="ball: 'ü' \"x\" #é😀", at=(1, 2, 3), motion=UnknownMotion(1 / 3)),
        Cylinder(0.2, 0.4, motion=Twist((0.1, 1 / 3, 0), (0, 0, 0.2)), quat=quat),
        Capsule(0.2, 0.4, motion=Keyframes([0, 1.5], [[0, 0, 0], [1, 2, 3]], quats=[quat, (0, 0, 0, 1)])),
        Cone(0.2, 0.4, quat=quat, motion=Keyframes([0, 1, 2], [[1, 0, 0], [1, 2, 3], [1, 0, 0]], loop=True)),
        ConvexHull(np.random.default_rng(0).normal(size=(12, 3))),
        Mesh(box.vertices, box.faces, at=(3, 0, 0)),
        Voxels([[0, 0, 0], [0.1, 0, 0.1]], 0.1, name="true"),
        Points([[0, 0, 0], [0.1, 0.03, 0.1]], 1e-3, name="null"),
    ]


def same(a, b):
    assert a.names == b.names
    assert a.time == b.time
    np.testing.assert_allclose(a.table.center, b.table.center, rtol=0, atol=1e-9)
    np.testing.assert_allclose(a.table.half_extents, b.table.half_extents, rtol=0, atol=1e-9)
    np.testing.assert_allclose(a.table.rotation, b.table.rotation, rtol=0, atol=1e-12)
    for x, y in zip(a, b, strict=True):
        assert x.shape == y.shape
        assert x.spec.keys() - {"path", "scale"} >= y.spec.keys() - {"path", "scale"}
        assert type(x.motion) is type(y.motion)


@pytest.mark.parametrize("time", [0.0, 0.7])
def test_writing_and_reading_are_inverse(tmp_path, time):
    scene = Scene(every_shape(), time=time)
    path = tmp_path / "out.yaml"
    write_scene(scene, path)
    back = read_scene(path)
    same(scene, back)
    same(scene.at(1.3), back.at(1.3))
    np.testing.assert_array_equal(back.obstacles[0].spec["size"], scene.obstacles[0].spec["size"])
    write_scene(back, tmp_path / "again.yaml")
    same(read_scene(tmp_path / "again.yaml"), scene)


def test_moved_obstacles_are_written_where_they_are(tmp_path):
    pose = np.eye(4)
    pose[:3, 3] = 10, 0, 0
    scene = Scene([Sphere(0.1, name="a", motion=Twist((1, 0, 0), (0, 0, 1))), Sphere(0.1, name="b")], time=2.0)
    scene = scene.moved("a", pose).moved("b", pose)
    write_scene(scene, tmp_path / "out.yaml")
    back = read_scene(tmp_path / "out.yaml")
    same(scene, back)
    same(scene.at(5), back.at(5))


def test_empty_scene_round_trip(tmp_path):
    write_scene(Scene([], time=3.0), tmp_path / "out.yaml")
    assert len(read_scene(tmp_path / "out.yaml")) == 0


def test_meshes_and_clouds_from_files_are_relative_to_the_scene_file(tmp_path, monkeypatch):
    parts = tmp_path / "parts"
    parts.mkdir()
    trimesh.creation.box((100, 200, 300)).export(parts / "crate.stl")
    cloud = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.3]])
    np.save(parts / "cloud.npy", cloud)
    np.savetxt(parts / "cloud.csv", cloud, delimiter=",")
    np.savetxt(parts / "cloud.xyz", cloud)
    text = "obstacles:\n- {shape: mesh, file: parts/crate.stl, scale: 1e-2, at: [0, 0, 1]}\n"
    text += "".join(f"- {{shape: points, radius: 0.1, file: parts/cloud.{s}}}\n" for s in ("npy", "csv", "xyz"))
    scene = read(tmp_path, text)
    np.testing.assert_allclose(scene.obstacles[0].parts[0].half_extents, (0.5, 1, 1.5), rtol=1e-6)
    for k in (1, 2, 3):
        np.testing.assert_allclose(scene.obstacles[k].spec["points"], cloud)
    sub = tmp_path / "sub"
    sub.mkdir()
    monkeypatch.chdir(sub)
    write_scene(scene, "out.yaml")
    assert "../parts/crate.stl" in (sub / "out.yaml").read_text()
    monkeypatch.chdir(tmp_path)
    same(read_scene(sub / "out.yaml"), scene)
    (parts / "crate.stl").unlink()
    write_scene(scene, sub / "out.yaml")  # the file is gone: the triangles are written
    same(read_scene(sub / "out.yaml"), scene)


@each("content", [b"", b"garbage", b"\x93NUMPY\x01\x00garbage"])
def test_broken_clouds_are_refused(tmp_path, content):
    (tmp_path / "cloud.npy").write_bytes(content)
    (tmp_path / "cloud.csv").write_bytes(content)
    for name in ("cloud.npy", "cloud.csv"):
        with pytest.raises(SceneError, match=name):
            read(tmp_path, f"obstacles:\n- {{shape: points, radius: 0.1, file: {name}}}\n")


def test_pickled_cloud_is_refused(tmp_path):
    np.save(tmp_path / "cloud.npy", np.array([[{}]], dtype=object), allow_pickle=True)
    with refused(SceneError, "Python objects"):
        read(tmp_path, "obstacles:\n- {shape: points, radius: 0.1, file: cloud.npy}\n")


def test_writing_is_all_or_nothing(tmp_path, monkeypatch):
    path = tmp_path / "out.yaml"
    write_scene(Scene([Sphere(1)]), path)
    path.chmod(0o600)
    before = path.read_bytes()

    def fail(*args):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail)
        with refused(SceneError, "out.yaml:"):
            write_scene(Scene([Sphere(2)]), path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["out.yaml"]
    write_scene(Scene([Sphere(2)]), path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_scene(path).obstacles[0].spec["radius"] == 2


def test_unwritable_places_and_motions_are_refused(tmp_path):
    with refused(SceneError, "folder"):
        write_scene(Scene([]), tmp_path / "gone" / "out.yaml")
    with refused(SceneError, "folder"):
        write_scene(Scene([]), tmp_path)

    class Wobble(Motion):
        def pose(self, initial_pose, t):
            return np.array(initial_pose)

        def velocity(self, initial_pose, t):
            return np.zeros(3), np.zeros(3)

        def speed_bound(self, radius, *, start=None, end=None):
            return 0.0

    with refused(SceneError, "Wobble"):
        write_scene(Scene([Sphere(1, motion=Wobble())]), tmp_path / "out.yaml")
    assert os.listdir(tmp_path) == []


def test_a_scenario_given_as_a_scene_says_which_file_its_scene_is(tmp_path):
    (tmp_path / "kitchen.yaml").write_text("robot: panda\nscene: room.yaml\nstart: {}\ngoal: {}\n")
    with refused(SceneError, "room.yaml"):
        read_scene(tmp_path / "kitchen.yaml")
    (tmp_path / "own.yaml").write_text("robot: panda\nscene: {obstacles: []}\n")
    with refused(SceneError, "scenario"):
        read_scene(tmp_path / "own.yaml")
