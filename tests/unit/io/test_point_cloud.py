"""Point clouds: PLY, PCD and XYZ give the same points; broken files are refused with line or byte; scenes of clouds."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from cases import each, refused
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from elastic_strips.errors import SceneError
from elastic_strips.io import cloud_scene, read_point_cloud, read_scene

POINTS = np.array([[0.5, -1.25, 2.0], [3.0, 4.0, -5.5], [1.0, 1.0, 1.0]])


def ply(points, kind="ascii", extra=False):
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    lines = ["ply", f"format {kind} 1.0", "comment made", f"element vertex {len(points)}", "property float x"]
    lines += ["property uchar red"] if extra else []
    lines += ["property float y", "property double z", "element face 1", "property list uchar int vertex_indices"]
    data = ("\n".join([*lines, "end_header"]) + "\n").encode()
    for x, y, z in points.tolist():
        if order:
            data += struct.pack(f"{order}fBfd", x, 7, y, z) if extra else struct.pack(f"{order}ffd", x, y, z)
        else:
            data += f"{x} {'7 ' if extra else ''}{y} {z}\n".encode()
    return data + (struct.pack(f"{order}Biii", 3, 0, 1, 2) if order else b"3 0 1 2\n")


def pcd(points, kind="ascii", fields="x y z rgb", sizes="4 4 8 4", types="F F F U", counts="1 1 1 1"):
    head = f"# .PCD v.7\nVERSION .7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\n"
    head += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {kind}\n"
    if kind == "ascii":
        return head.encode() + b"".join(f"{x} {y} {z} 9\n".encode() for x, y, z in points.tolist())
    return head.encode() + b"".join(struct.pack("<ffdI", x, y, z, 9) for x, y, z in points.tolist())


def lzf(data):
    """Pack greedily: the last place of every three bytes is looked up, and runs that are new stay as they are."""
    out, new, seen, at = b"", b"", {}, 0
    while at < len(data):
        start = seen.get(data[at : at + 3], -1)
        seen[data[at : at + 3]] = at
        length = 0
        if start >= 0 and at - start <= 8192 and at + 3 <= len(data):
            while at + length < len(data) and length < 264 and data[start + length] == data[at + length]:
                length += 1
        if length < 3:
            new, at = new + data[at : at + 1], at + 1
        if new and (length >= 3 or len(new) == 32 or at == len(data)):
            out, new = out + bytes([len(new) - 1]) + new, b""
        if length >= 3:
            back = at - start - 1
            top = min(length - 2, 7)
            out += bytes([top << 5 | back >> 8]) + (bytes([length - 9]) if top == 7 else b"") + bytes([back & 255])
            at += length
    return out


def packed_pcd(points, spoil=lambda data: data):
    head = pcd(points, "binary_compressed")[: -20 * len(points)]
    x, y, z = points.T
    raw = x.astype("<f4").tobytes() + y.astype("<f4").tobytes() + z.astype("<f8").tobytes() + b"\t\0\0\0" * len(points)
    data = spoil(lzf(raw))
    return head + struct.pack("<II", len(data), len(raw)) + data


def xyz(points):
    return b"# x y z\n" + b"".join(f"{x};{y}, {z} 255\n\n".encode() for x, y, z in points.tolist())


FILES = [
    ("c.ply", ply(POINTS)),
    ("c.ply", ply(POINTS, extra=True)),
    ("c.ply", ply(POINTS, "binary_little_endian")),
    ("c.ply", ply(POINTS, "binary_little_endian", extra=True)),
    ("c.ply", ply(POINTS, "binary_big_endian", extra=True)),
    ("c.ply", ply(POINTS).replace(b"\n", b"\r\n")),
    ("c.pcd", pcd(POINTS)),
    ("c.PCD", pcd(POINTS, "binary")),
    ("c.pcd", packed_pcd(POINTS)),
    ("c.xyz", xyz(POINTS)),
    ("c.txt", xyz(POINTS)),
]


def write(folder, name, data):
    (folder / name).write_bytes(data)
    return folder / name


@each("name, data", FILES)
def test_every_format_gives_the_points(tmp_path, name, data):
    cloud = read_point_cloud(write(tmp_path, name, data))
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert cloud.dropped == 0
    assert not cloud.points.flags.writeable
    np.testing.assert_allclose(read_point_cloud(tmp_path / name, scale=0.001).points, 0.001 * POINTS)


OLD_PCD = b"# .PCD v.5\nCOLUMNS x y z\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n1 2 3\n4 5 6\n"


def test_pcd_files_of_old_versions_and_of_windows(tmp_path, caplog):
    """No SIZE, TYPE and COUNT (then floats), empty lines, and what Windows prints for a point that is none."""
    for data in (OLD_PCD, OLD_PCD.replace(b"3\n4", b"3\n\n4"), OLD_PCD.replace(b"COLUMNS", b"FIELDS")):
        np.testing.assert_array_equal(read_point_cloud(write(tmp_path, "c.pcd", data)).points, [[1, 2, 3], [4, 5, 6]])
    for word in (b"-nan(ind)", b"-1.#IND", b"1.#QNAN0", b"1.#INF", b"nan"):
        cloud = read_point_cloud(write(tmp_path, "c.pcd", OLD_PCD.replace(b"1 2 3", word + b" 2 3")))
        assert (cloud.points.tolist(), cloud.dropped) == ([[4, 5, 6]], 1)
    assert not caplog.text


def test_a_signalling_nan_is_a_point_that_is_none(tmp_path, recwarn):
    data = pcd(POINTS, "binary")
    body = len(data) - 20 * len(POINTS)
    path = write(tmp_path, "c.pcd", data[:body] + b"\x01\x00\x80\x7f" + data[body + 4 :])
    assert read_point_cloud(path).dropped == 1
    assert not recwarn.list


def test_a_viewpoint_moves_nothing_and_is_said(tmp_path, caplog):
    for viewpoint, said in [("0 0 0 1 0 0 0", False), ("0 0 0.0 1.0 0 -0 0", False), ("1 0 0 1 0 0 0", True)]:
        caplog.clear()
        data = pcd(POINTS).replace(b"0 0 0 1 0 0 0", viewpoint.encode())
        np.testing.assert_array_equal(read_point_cloud(write(tmp_path, "c.pcd", data)).points, POINTS)
        assert (f"left out: VIEWPOINT {viewpoint}" in caplog.text) == said


def test_a_packed_cloud_of_many_points_comes_back(tmp_path):
    """Long copies, copies that overlap what they make, and long runs of new bytes: all that LZF has."""
    rng = np.random.default_rng(4)
    points = np.vstack((rng.uniform(-5, 5, (300, 3)), np.ones((400, 3)), np.tile(rng.uniform(-5, 5, (7, 3)), (60, 1))))
    points = points.astype(np.float32).astype(float)
    data = packed_pcd(points)
    assert len(data) < 0.8 * len(pcd(points, "binary"))
    np.testing.assert_array_equal(read_point_cloud(write(tmp_path, "c.pcd", data)).points, points)


def test_trimesh_reads_the_same_points(tmp_path):
    """An oracle: its own PLY writer and reader."""
    trimesh = pytest.importorskip("trimesh")
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (40, 3)).astype(np.float32)
    for encoding in ("ascii", "binary"):
        data = trimesh.PointCloud(points).export(file_type="ply", encoding=encoding)
        cloud = read_point_cloud(write(tmp_path, "t.ply", data))
        np.testing.assert_allclose(cloud.points, points, atol=1e-6)


@each("make", [ply, pcd, xyz, lambda p: ply(p, "binary_little_endian"), lambda p: pcd(p, "binary")])
def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path, make):
    points = np.vstack([POINTS, [[np.nan, 0, 0], [0, np.inf, 0]]])
    name = "c." + ("ply" if make(POINTS).startswith(b"ply") else "pcd" if b"FIELDS" in make(POINTS) else "xyz")
    cloud = read_point_cloud(write(tmp_path, name, make(points)))
    np.testing.assert_array_equal(cloud.points, POINTS)
    assert cloud.dropped == 2
    with refused(SceneError, "points"):
        read_point_cloud(write(tmp_path, name, make(points[3:])))


BAD = [
    ("c.las", b"1", r"c\.las: point clouds of kind '\.las' are not read"),
    ("c.xyz", b"", "is empty"),
    ("c.xyz", b"# nothing\n", "holds no points"),
    ("c.xyz", b"1 2 3\n1 2\n", r"c\.xyz:2: must begin with three numbers, not '1 2'"),
    ("c.xyz", b"1 2 x\n", r"c\.xyz:1: must begin with three numbers"),
    ("c.ply", b"plx\nend_header\n", r"c\.ply:1: .*PLY"),
    ("c.ply", b"ply\nformat ascii 1.0\n", "no line 'end_header'"),
    ("c.ply", b"\x00\x01\x02", "no line 'end_header'"),
    ("c.ply", ply(POINTS).replace(b"format ascii 1.0\n", b""), "names no format; valid: ascii, binary_little_endian"),
    (
        "c.ply",
        ply(POINTS).replace(b"ascii", b"morse"),
        r"c\.ply:2: not understood in a PLY header: 'format morse 1\.0'",
    ),
    ("c.ply", ply(POINTS).replace(b"float y", b"float v"), r"the points have no 'y'; they have x, v, z"),
    ("c.ply", ply(POINTS).replace(b"float y", b"float x"), r"the points have 'x' twice"),
    ("c.ply", ply(POINTS).replace(b"vertex 3", b"node 3"), "no element 'vertex'"),
    ("c.ply", ply(POINTS).replace(b"vertex 3", b"vertex 9"), r"c\.ply:\d+: "),
    ("c.ply", ply(POINTS).replace(b"3.0 4.0", b"3.0 four"), r"c\.ply:12: must hold 3 numbers, not '3\.0 four -5\.5'"),
    (
        "c.ply",
        ply(POINTS, "binary_little_endian")[:-30],
        r"byte \d+: the file ends; 3 points need 48 bytes from byte \d+",
    ),
    ("c.ply", ply(POINTS).replace(b"property float x", b"property list uchar int x"), "vertices hold lists"),
    ("c.pcd", b"VERSION .7\n", "no line 'DATA'"),
    ("c.pcd", pcd(POINTS).replace(b"FIELDS x y z rgb\n", b""), "header has no line 'FIELDS'"),
    ("c.pcd", pcd(POINTS, "binary")[:-5], r"byte \d+: the file ends; 3 points need 60 bytes from byte \d+ on"),
    ("c.pcd", pcd(POINTS)[:-12], r"c\.pcd:13: the file ends after 2 of 3 points|c\.pcd:\d+: must hold 4 numbers"),
    ("c.pcd", pcd(POINTS, "binary_packed"), r"c\.pcd:11: PCD files with DATA 'binary_packed' are not read"),
    ("c.pcd", packed_pcd(POINTS)[:-1], r"c\.pcd: byte \d+: the file ends; \d+ packed bytes"),
    ("c.pcd", pcd(POINTS, "binary_compressed")[:-60] + bytes(8), "0 bytes are packed; 3 points have 60"),
    ("c.pcd", packed_pcd(POINTS, lambda data: b"\xe0\x00\x05" + data), "packed points are damaged after 0 of 60 bytes"),
    ("c.pcd", packed_pcd(POINTS, lambda data: data[:-9]), "packed points are damaged"),
    ("c.pcd", pcd(POINTS, sizes="4 4 8"), "must have equally many entries"),
    ("c.pcd", pcd(POINTS, types="F F Q U"), "field 'z' of type 'Q', size '8' is not understood"),
    ("c.pcd", pcd(POINTS).replace(b"POINTS 3", b"POINTS many"), "does not say how many POINTS"),
]


@each("name, data, message", BAD)
def test_a_wrong_file_is_refused_with_its_place(tmp_path, name, data, message):
    with pytest.raises(SceneError, match=message):
        read_point_cloud(write(tmp_path, name, data))


def test_missing_files_and_wrong_scales(tmp_path):
    with refused(SceneError, "gone.ply:"):
        read_point_cloud(tmp_path / "gone.ply")
    with refused(SceneError, "scale=0"):
        read_point_cloud(write(tmp_path, "c.xyz", xyz(POINTS)), scale=0)


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, st.tuples(st.integers(1, 40), st.just(3)), elements=st.floats(-3, 3)), st.floats(0.03, 0.5))
def test_every_point_lies_in_the_scene_and_no_box_is_without_one(points, voxel):
    scene = cloud_scene(points, voxel)
    (obstacle,) = scene
    low = np.array([at - box.halfSide for part in obstacle.parts for box, at in part.boxes])
    high = np.array([at + box.halfSide for part in obstacle.parts for box, at in part.boxes])
    inside = ((points[:, None] >= low - 1e-9) & (points[:, None] <= high + 1e-9)).all(axis=2)
    assert inside.any(axis=1).all()
    assert inside.any(axis=0).all()
    cells = len(np.unique(np.floor(points / voxel), axis=0))
    assert np.prod(high - low, axis=1).sum() == pytest.approx(cells * voxel**3)


def test_scenes_leave_out_floor_ceiling_and_noise(tmp_path):
    points = np.array([[0, 0, 0.01], [1, 1, 1.0], [1.01, 1.01, 1.01], [2, 2, 1.0], [0, 0, 3.0]])
    assert len(cloud_scene(points).obstacle("cloud").spec["centers"]) == 4
    scene = cloud_scene(points, 0.1, low=0.05, high=2.0, min_points=2, name="shelf", time=3.0)
    assert scene.time == 3.0
    np.testing.assert_allclose(scene.obstacle("shelf").spec["centers"], [[1.05, 1.05, 1.05]])
    cloud = read_point_cloud(write(tmp_path, "c.xyz", xyz(POINTS)))
    assert len(cloud_scene(cloud)) == 1
    for arguments, message in (
        ((POINTS[:, :2],), r"shape \(n, 3\)"),
        ((np.zeros((0, 3)),), "points is empty"),
        ((np.array([[0.0, np.nan, 0.0]]),), r"points\[0, 1\] is nan; it must be finite"),
        ((POINTS, 0.0), "voxel=0.0 must be a finite number of m"),
    ):
        with pytest.raises(SceneError, match=message):
            cloud_scene(*arguments)
    with refused(SceneError, "3 points"):
        cloud_scene(POINTS, low=100.0)


@each("name, data", FILES[:8:3])
def test_scene_files_refer_to_clouds(tmp_path, name, data):
    write(tmp_path, name, data)
    text = f"version: 1\nobstacles:\n- {{shape: points, name: scan, radius: 0.02, file: {name}}}\n"
    scene = read_scene(write(tmp_path, "scene.yaml", text.encode()))
    np.testing.assert_array_equal(scene.obstacle("scan").spec["points"], POINTS)
    write(tmp_path, name, data[:20])
    with pytest.raises(SceneError, match=rf"scene\.yaml:3: .*file: .*{name}: "):
        read_scene(tmp_path / "scene.yaml")
