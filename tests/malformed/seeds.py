"""Sound small files of every kind that is read, and how each kind is read: what the mutations start from."""

# ruff: noqa: E501 - tables

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from urdf_cases import SOUND, SOUND_SRDF
from yaml_cases import SCENARIO

import elastic_strips as es
from elastic_strips import io
from elastic_strips.cli.view_command import _from_result
from elastic_strips.control.record import Record, Recorder
from elastic_strips.errors import InputError
from elastic_strips.scene import Keyframes, World
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.sim.sensors import read_sensors, sensor_file
from elastic_strips.sim.sweep import read_sweep
from workshop import datasets

for folder in ("oracle", "unit/io"):  # who makes bags are the tests of bags
    sys.path.append(str(Path(__file__).parents[1] / folder))

PLAN_SECONDS = 0.3
Use = Callable[[Path], object]


@dataclass(frozen=True, slots=True)
class Seed:
    """A sound input.

    Attributes:
        kind: what it is, for the table; reader: how it is read.
        file: name of the file that is mutated; content: what it holds.
        beside: further files by name, which stay as they are.
        weight: share of the inputs that are made of it.
    """

    kind: str
    file: str
    content: bytes
    reader: Use
    beside: Mapping[str, bytes]
    weight: float = 1.0


def _plan(robot: es.RobotModel, scene: es.Scene) -> None:
    """A tiny plan with what was accepted: a report, or a typed error about its ends."""
    home = robot.space.to_coordinates(robot.home_q)
    if not len(home):
        return
    goal = home.copy()
    goal[0] += 1.0 if robot.space.base_nv else 0.05
    with suppress(InputError):  # it collides at home, say
        es.plan(robot, scene, robot.home_q, robot.space.from_coordinates(goal), timeout=PLAN_SECONDS)


def _robot(path: Path) -> None:
    """Under every kind of base in turn, by the file's own size: a mutation is reproducible."""
    size = path.stat().st_size if path.is_file() else 0
    _plan(es.load_robot(path, base=("omni", "diff_drive", "fixed")[size % 3]), es.Scene([]))


@cache
def _small() -> es.RobotModel:
    return es.load_robot("jackal-box")


def _scene(path: Path) -> None:
    world = io.read_world(path)
    _plan(_small(), world.at(world.scene.time + 0.5))


def _scenario(path: Path) -> None:
    problem = get_scenario(path)
    robot = problem.load_robot()
    _plan(robot, problem.scene)


def _cloud(path: Path) -> None:
    cloud = io.read_point_cloud(path)
    with suppress(InputError):  # too far away, or more cells than a scene may hold
        io.cloud_scene(cloud, 0.1)


def _record(path: Path) -> None:
    record = io.read_record(path)
    record.world.at(float(record.control.time[-1]))
    io.record_file.record_csv(record)


def _ply(*, binary: bool) -> bytes:
    points = np.random.default_rng(1).uniform(-2, 2, (40, 3))
    head = "ply\nformat {} 1.0\ncomment made\nelement vertex 40\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    if binary:
        return head.format("binary_little_endian").encode() + points.astype("<f4").tobytes()
    return (head.format("ascii") + "".join(f"{x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in points)).encode()


def _pcd(*, binary: bool) -> bytes:
    points = np.random.default_rng(2).uniform(-2, 2, (40, 3))
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 40\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 40\nDATA {'binary' if binary else 'ascii'}\n"
    )
    rows = points.astype("<f4").tobytes() if binary else "".join(f"{x} {y} {z}\n" for x, y, z in points).encode()
    return head.encode() + rows


def _npy(array: np.ndarray) -> bytes:
    stream = BytesIO()
    np.save(stream, array)
    return stream.getvalue()


_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0.2]]) * 0.2
_FACES = np.array([[0, 2, 1], [1, 2, 4], [0, 1, 3], [0, 3, 2], [1, 4, 3], [2, 3, 4]])


def meshes() -> dict[str, bytes]:
    """The same small solid in every format that is read, by name."""
    import trimesh

    mesh = trimesh.Trimesh(_CORNERS, _FACES, process=False)
    plain = mesh.export(file_type="obj")
    return {
        "binary.stl": mesh.export(file_type="stl"),
        "text.stl": str(mesh.export(file_type="stl_ascii")).encode(),
        "m.obj": (plain if isinstance(plain, bytes) else str(plain).encode()),
        "m.ply": mesh.export(file_type="ply"),
        "text.ply": mesh.export(file_type="ply", encoding="ascii"),
        "m.dae": mesh.export(file_type="dae"),
    }


def _record_bytes() -> bytes:
    robot = es.load_robot("jackal-box")
    cart = Keyframes([0.0, 1.0], [[2, 0, 0.5], [2, 1, 0.5]])
    world = World(
        es.Scene([es.Box((1, 1, 1), at=(0, 3, 0.5), name="table"), es.Sphere(0.2, motion=cart, name="ball")]),
        appears={"ball": 0.1},
    )
    recorder = Recorder(robot, world, metadata={"scenario": "made"})
    row = robot.space.to_coordinates(robot.home())
    for k in range(12):
        recorder.control(0.01 * k, coordinates=row, v=0 * row, reference=row)
        if k % 4 == 0:
            recorder.planning(0.01 * k, tick_ms=3.0, phase_ms={"solve": 1.0}, status="x", strip=np.array([row, row]))
    recorder.event(0.02, "start", "ahead")
    return _record_file(recorder.finish())


def _record_file(record: Record) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return io.write_record(record, Path(folder) / "r.npz").read_bytes()


_MAP = "image: map.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.0, -2.0, 0.3]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
_PGM = b"P5\n# made\n8 6\n255\n" + bytes([0, 255, 205, 0, 90, 255] * 8)
_PGM_TEXT = b"P2\n4 3\n255\n" + b"\n".join(b"0 255 205 90" for _ in range(3)) + b"\n"

_MOVEIT = (
    "made\n* table top\n0 0 0\n0 0 0 1\n2\nbox\n1 1 0.1\n2 3 0.5\n0 0 0.1 1\n1 0 0 1\ncylinder\n0.1 0.5\n2 3 0.3\n0 0 0 1\n"
    "0 0 0 0\n1\ngrip\n0 0 1\n0 0 0 1\n* wedge\n0 0 0\n0 0 0 1\n3\nmesh\n4 4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 2 1\n0 1 3\n0 3 2\n1 2 3\n"
    "5 5 0\n0 0 0 1\n0 0 0 0\nsphere\n0.2\n4 3 1\n0 0 0 1\n0 0 0 0\ncone\n0.2 0.5\n4 5 1\n0 0 0 1\n0 0 0 0\n0\n.\n"
)
_MOVEIT_OLD = (
    "made\n* ball\n1\nsphere\n0.2\n4 3 1\n0 0 0 1\n0 0 0 0\n* floor\n1\nplane\n0 0 1 0\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n"
)
_XACRO = SOUND.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1).replace(
    "</robot>", '<xacro:arg name="a" default="0.1"/><xacro:property name="b" value="${2 * 0.3}"/>'
    '<xacro:macro name="m" params="name:=tip size"><link name="${name}"><collision><geometry><box size="${size} $(arg a) ${b}"/>'
    '</geometry></collision></link><joint name="${name}_joint" type="fixed"><parent link="base"/><child link="${name}"/>'
    '<origin xyz="0 0 ${b + 1}"/></joint></xacro:macro><xacro:if value="${b > 0.5}"><xacro:m size="0.2"/></xacro:if></robot>',
)  # fmt: skip


_MOVEIT_MANY = "(noname)+\n" + "".join(
    f"* Box_{k}\n{k} 0 0.5\n0 0 0 1\n1\nbox\n0.2 0.45 0.2\n0 0 0\n0 0 0.7071 0.7071\n0 0 0 0\n0\n" for k in range(8)
) + ".\n"  # fmt: skip
_XACRO_INCLUDES = """<robot name="made" xmlns:xacro="http://ros.org/wiki/xacro">
<xacro:include filename="part.xacro"/><xacro:property name="n" value="3"/>
<xacro:macro name="chain" params="k:=1 *at"><link name="l${k}"><collision><geometry><sphere radius="${0.1 / k}"/></geometry>
</collision></link><joint name="j${k}" type="revolute"><parent link="l${k - 1}"/><child link="l${k}"/><xacro:insert_block name="at"/>
<axis xyz="0 ${k % 2} ${1 - k % 2}"/><limit lower="-1" upper="${pi / 2}" velocity="1" effort="9"/></joint>
<xacro:if value="${k &lt; n}"><xacro:chain k="${k + 1}"><origin xyz="0 0 0.3"/></xacro:chain></xacro:if></xacro:macro>
<xacro:foot/><xacro:chain><origin xyz="0 0 0.1" rpy="0 ${radians(30)} 0"/></xacro:chain></robot>
"""
_XACRO_PART = """<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:macro name="foot"><link name="l0"><collision><geometry>
<box size="0.4 0.4 0.2"/></geometry></collision></link></xacro:macro></robot>
"""


def _pose(x: float) -> dict[str, object]:
    return {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}


_PATHS = {
    "p.json": json.dumps({"joint_names": ["slide", "x", "y", "yaw"], "points": [
        {"positions": [0.05 * k, 0.2 * k, 1.0, 0.1], "time_from_start": {"sec": k, "nanosec": 5}} for k in range(4)]}),
    "p.csv": "time,x,y,yaw,slide\n" + "".join(f"{k}.0,0.{k},1.0,0.1,0.05\n" for k in range(4)),
    "p.txt": "Geometric path with 2 states\nCompound state [\nSE2 state [0 1 0.5]\nRealVector state [0.1 0.1]\n]\n"
             "Compound state [\nSE2 state [1 1 0.5]\nRealVector state [0.1 0.2]\n]\n",
    "p.yaml": "joint_names: [slide]\npoints:\n" + "".join(f"- positions: [0.0{k}]\n  time_from_start: {k}.5\n" for k in range(4)),
    "plan.json": json.dumps({
        "trajectory_start": {
            "joint_state": {"name": ["slide"], "position": [0.05]},
            "multi_dof_joint_state": {"joint_names": ["world_joint"], "transforms": [_pose(0.0)]}},
        "trajectory": [{
            "joint_trajectory": {"joint_names": ["slide"], "points": [
                {"positions": [0.05 * k + 0.05], "time_from_start": {"sec": k, "nanosec": 0}} for k in (j, j + 1)]},
            "multi_dof_joint_trajectory": {"joint_names": ["world_joint"], "points": [
                {"transforms": [_pose(0.5 * k)], "time_from_start": {"sec": k, "nanosec": 0}} for k in (j, j + 1)]}}
            for j in (0, 1)]}),
    "units.csv": '"time_ms";"x [m]";"y_mm";"yaw (deg)";"slide";"slide_vel";"index";"lamp"\n'
                 + "".join(f"{1000 * k};0,{k};100;10,5;0,05;0;{k};1\n" for k in range(4)),
}  # fmt: skip


def _npz() -> bytes:
    stream = BytesIO()
    rows = np.array([[0.0, 1.0, 0.5, 0.1], [1.0, 1.0, 0.5, 0.2]])
    np.savez(stream, time=np.array([0.0, 1.0]), joint_names=np.array(["x", "y", "yaw", "slide"]), positions=rows)
    return stream.getvalue()


def _octree(*, binary: bool, colour: bytes = b"") -> bytes:
    """Two cells at the middle of the map, which is 16 levels down."""
    first, second = [7] + [0] * 14, [0] + [7] * 14  # children on the way to the two, from the root
    nodes = b"" if binary else np.float32(0.5).tobytes() + colour + b"\x81"
    if binary:
        nodes = (0b11 | 0b11 << 14).to_bytes(2, "little")
    for way in (second, first):
        for child, after in zip(way[1:], [*way[2:], None], strict=True):
            if binary:
                nodes += ((0b11 if after is not None else 0b10) << 2 * child).to_bytes(2, "little")
            else:
                nodes += np.float32(0.5).tobytes() + colour + bytes([1 << child])
        nodes += b"" if binary else np.float32(0.9).tobytes() + colour + b"\0"
    kind = "OcTree binary file" if binary else "OcTree file"
    return (
        f"# Octomap {kind}\nid {'ColorOcTree' if colour else 'OcTree'}\nsize {1 + 2 * 15}\nres 0.1\ndata\n".encode()
        + nodes
    )


def _packed_pcd() -> bytes:
    """Four points, packed: 4 bytes as they are, and a copy of 12 that overlaps them, for each column."""
    packed = b"".join(b"\x03" + np.float32(x).tobytes() + b"\xe0\x03\x03" for x in (1.5, -0.5, 0.25))
    head = b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\nPOINTS 4\nDATA binary_compressed\n"
    return head + len(packed).to_bytes(4, "little") + (48).to_bytes(4, "little") + packed


def _png() -> bytes:
    import PIL.Image

    stream = BytesIO()
    PIL.Image.fromarray(np.array([[0, 255, 205, 0], [90, 255, 0, 254]], np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def _bag(suffix: str) -> bytes:
    """A scan, its transforms, a cloud and joint states."""
    from test_bags import drive

    with tempfile.TemporaryDirectory() as folder:
        return drive(Path(folder) / ("b.bag" if suffix == ".bag" else "b"), suffix, steps=12, cloud=0.6).read_bytes()


_ROBOTS: list[es.RobotModel] = []
_CRATE = es.Scene([es.Box((0.5, 0.5, 0.5), at=(3.0, 3.0, 0.25), name="crate")])


def _small() -> es.RobotModel:
    if not _ROBOTS:
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "small.urdf").write_text(SOUND)
            _ROBOTS.append(es.load_robot(Path(folder) / "small.urdf", base="omni"))
    return _ROBOTS[0]


def _path(path: Path) -> None:
    es.certify(_small(), _CRATE, io.load_path(path, _small()), interpolation="line", measure=False)


def _read_bag(path: Path) -> None:
    bag = io.BagReader(path)
    for each in (bag.scans, bag.clouds, bag.joint_states, bag.poses):
        for _ in each():
            pass


def _planning(path: Path) -> None:
    found = io.read_scene_file(path)
    if found.held:
        found.held_by(_small())


_AT = {"position": {"x": 1.0, "y": 0.5, "z": 0.25}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}
_MOVE = {"translation": _AT["position"], "rotation": _AT["orientation"]}
_PLANNING = {
    "name": "made", "robot_model_name": "small", "is_diff": False,
    "robot_state": {
        "joint_state": {"name": ["slide", "shoulder"], "position": [0.1, 0.2]},
        "multi_dof_joint_state": {"joint_names": ["world"], "transforms": [_MOVE]},
        "attached_collision_objects": [{
            "link_name": "tool", "touch_links": ["tool", "base"], "weight": 0.5,
            "object": {"id": "cup", "header": {"frame_id": "map"}, "pose": _AT,
                       "primitives": [{"type": 3, "dimensions": [0.2, 0.05]}], "primitive_poses": [_AT]},
        }],
    },
    "fixed_frame_transforms": [{"header": {"frame_id": "map"}, "child_frame_id": "shelf", "transform": _MOVE}],
    "allowed_collision_matrix": {"entry_names": ["a", "tool"], "entry_values": [{"enabled": [True, False]}]},
    "link_padding": [{"link_name": "tool", "padding": 0.01}], "link_scale": [], "object_colors": [],
    "world": {
        "collision_objects": [
            {"id": "a", "header": {"frame_id": "shelf"}, "pose": _AT, "operation": 0,
             "primitives": [{"type": 1, "dimensions": [0.1, 0.2, 0.3]}, {"type": 5, "dimensions": [0.3], "polygon": {
                 "points": [{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0}, {"x": 0, "y": 1, "z": 0}]}}],
             "primitive_poses": [_AT, _AT], "planes": [{"coef": [0, 0, 1, 0.5]}], "plane_poses": [_AT],
             "subframe_names": ["tip"], "subframe_poses": [_AT]},
            {"id": "b", "header": {"frame_id": "a/tip"}, "operation": "\0", "mesh_poses": [_AT], "meshes": [{
                "vertices": [{"x": 0, "y": 0, "z": 0}, {"x": 1, "y": 0, "z": 0}, {"x": 0, "y": 1, "z": 0}, {"x": 0, "y": 0, "z": 1}],
                "triangles": [{"vertex_indices": t} for t in ([0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3])]}]},
            {"id": "a", "header": {"frame_id": "map"}, "pose": _AT, "operation": 3},
        ],
        "octomap": {"header": {"frame_id": "map"}, "origin": _AT, "octomap": {
            "binary": True, "id": "OcTree", "resolution": 0.1, "data": [2, -128]}},
    },
}  # fmt: skip
_SOURCES = """sources:
- {file: m.yaml, at: [1, 2, 0, 0.5], low: 0.1, high: 2.0, unknown: occupied, outside: blocked, lethal: 90}
- {file: s.scene, at: [0, 0, 1], rpy: [0.1, 0.2, 0.3], planes: free}
- {file: m.bt, at: [0, 0, 0, 0, 0, 0.6, 0.8], low: -1.0, high: 5, occupied: 0.7}
- {file: c.xyz, voxel: 0.1, scale: 2.0, min_points: 1, low: 0}
- {file: own.yaml, at: [0, 0, 1], quat: [0, 0, 0.6, 0.8]}
obstacles: [{shape: sphere, radius: 0.1}]
"""
_BARN = {
    "cylinder_radius": 0.075, "cylinder_length": 1.0, "cylinder_center_z": 0.0, "goal_tolerance": 1.0, "timeout": 100.0,
    "worlds": [
        {"id": 0, "start": [-2.25, 3.0, 1.57], "goal": [-2.25, 13.0], "cylinders_xy": [[-0.1, 0.1], [-0.2, 0.1]],
         "path": [[-2.25, 3.0], [-2.0, 8.0], [-3.0, 9.0]], "path_length": 10.5},
    ],
}  # fmt: skip
_DYNABARN = {
    "cylinder_radius": 0.5, "cylinder_length": 1.0, "cylinder_center_z": 0.0, "goal_tolerance": 1.0, "timeout": 100.0,
    "worlds": [
        {"id": 0, "start": [11, 0, 3.14], "goal": [-9, 0], "difficulty": "easy",
         "walls": [{"name": "back", "pose": [-10.0, 0.0, 0.5, 0.0, 0.0, 0.0], "size": [0.5, 20.0, 1.0]}],
         "obstacles": [{"name": "disc", "period": 20.0, "keyframes": [[0.0, -8, -10], [10.0, 0, -3], [20.0, 8, 4]]}]},
    ],
}  # fmt: skip
_BRIDGE = {
    "robot": {"max_joint_acc": 3.14},
    "start": {"xy": [-2, 1.5], "yaw_deg": 0, "arm_deg": [0, -90, 110, 0, -110, 0]},
    "goals": [{"xy": [2, 1.5], "yaw_deg": 0}, {"xy": [-2, 1.5], "yaw_deg": 180}],
    "boxes": [{"name": "deck", "size": [0.6, 1.5, 0.1], "position": [0.0, 0.0, 0.75]}],
}
_SCENE = {
    "version": 1, "time": 0.0,
    "obstacles": [
        {"shape": "box", "name": "table", "size": [1, 1, 1], "at": [0, 3, 0.5], "rpy": [0, 0, 0.3]},
        {"shape": "sphere", "radius": 0.3, "at": [3, 2, 1], "motion": {"twist": {"linear": [0.1, 0, 0], "angular": [0, 0, 1]}}},
        {"shape": "cylinder", "radius": 0.2, "length": 1.0, "at": [4, -2, 0.5], "appears": 0.1, "vanishes": 9.0,
         "motion": {"keyframes": {"times": [0, 1, 2], "positions": [[4, -2, 0.5], [4, -1, 0.5], [4, 0, 0.5]], "loop": False}}},
        {"shape": "capsule", "radius": 0.2, "length": 1.0, "at": [4, 3, 0.5], "quat": [0, 0, 0, 1], "motion": {"unknown": {"max_speed": 1.0}}},
        {"shape": "cone", "radius": 0.2, "length": 1.0, "at": [-4, 3, 0.5]},
        {"shape": "convex", "vertices": [[5, 5, 0], [6, 5, 0], [5, 6, 0], [5, 5, 1]]},
        {"shape": "mesh", "vertices": [[5, -5, 0], [6, -5, 0], [5, -4, 0], [5, -5, 1]], "faces": [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]},
        {"shape": "voxels", "size": 0.1, "centers": [[7, 7, 0], [7, 7, 0.1], [7.1, 7, 0]]},
        {"shape": "points", "radius": 0.05, "points": [[-7, 7, 0], [-7, 7.3, 0.1]]},
    ],
}  # fmt: skip
_SCAN = {
    "stamp": 12.5, "angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 8.0,
    "ranges": [1.5, None, 9.0, 2.0, 0.0], "pose": [1.0, 2.0, 0.3], "mount": [0.2, 0.0, 0.3, math.pi], "sensor": "rear",
}  # fmt: skip
_CSV = (
    "stamp,angle_min,angle_increment,range_min,range_max,x,y,yaw,ranges\n" + "1.0,-0.5,0.5,0.1,8,1,2,0.3,1.5,,2.5\n" * 4
)
_CARMEN = (
    "# made\nPARAM robot_length 0.5\n"
    + "FLASER 4 1.0 2.0 81.9 0.0 5.0 6.0 0.5 4.0 6.0 0.5 976052857.3 host 0.7\n" * 2
    + "ROBOTLASER1 0 -1.57 3.14 1.0 8.0 0.01 0 4 1.0 2.0 3.0 4.0 0 1 2 0.1 1 2 0.1 0 0 0 0 0 12.5 host 0.7\n"
    + "RAWLASER1 0 -1.57 3.14 1.0 8.0 0.01 0 4 1.0 2.0 3.0 4.0 0 12.5 host 0.7\n"
)
_RESULT: dict[str, Any] = {
    "format": "elastic-strips-result", "version": 1, "robot": "small", "base": "omni", "locked": {}, "urdf": "small.urdf",
    "obstacles": [{"name": "b", "shape": "box", "size": [1, 1, 1], "pose": [3, 3, 0, 0, 0, 0, 1]}],
    "strip": {"q": [[0, 0, 1, 0, 0, 0.1], [1, 0, 1, 0, 0, 0.1]]},
}  # fmt: skip
_MIMIC = SOUND.replace("</robot>", (
    '<link name="pad"><inertial><mass value="1"/><origin xyz="0 0 0.1" rpy="0 0.1 0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    '<collision><geometry><cylinder radius="0.05" length="0.1"/></geometry></collision></link>'
    '<joint name="turn" type="continuous"><parent link="base"/><child link="pad"/><origin xyz="-0.5 0 0.5"/><axis xyz="0.6 0 0.8"/></joint>'
    '<link name="finger"/><joint name="follow" type="revolute"><parent link="tool"/><child link="finger"/><axis xyz="0 1 0"/>'
    '<limit lower="-1" upper="1" velocity="1" effort="9"/><mimic joint="slide" multiplier="2" offset="0.1"/></joint></robot>'
))  # fmt: skip


_SWEEP = """kind: drive
scenarios: [case-1, room.yaml]
robots: [jackal-box]
seeds: {first: 1, count: 3}
grid: {deform.influence: [0.3, 0.4], speeds: [[1.0, 0.5], [1.0]], evade: [true, false]}
fixed: {compute: work, time_limit: 5.0}
plot: {x: speeds, y: time_s}
"""


def _json(document: object) -> bytes:
    return json.dumps(document, indent=1).encode()


def seeds() -> tuple[Seed, ...]:
    """All of them."""

    def seed(
        kind: str, file: str, content: bytes | str, reader: Use, weight: float = 1.0, **beside: bytes | str
    ) -> Seed:
        def binary(text: bytes | str) -> bytes:
            return text.encode() if isinstance(text, str) else text

        others = {name.replace("__", "."): binary(text) for name, text in beside.items()}
        return Seed(kind, file, binary(content), reader, others, weight)

    def srdf(path: Path) -> None:
        es.load_robot(path.parent / "small.urdf", base="omni", srdf=path)

    def cloud_file(path: Path) -> None:
        io.read_scene(path.parent / f"{path.suffix[1:]}.yaml")

    def fixed(path: Path) -> None:
        es.load_robot(path, base="fixed")

    def robot_mesh(path: Path) -> None:
        _robot(path.parent / "small.urdf")

    box = '<box size="0.5 0.06 0.06"/>'
    result = [
        seed("URDF", "r.urdf", SOUND, _robot, 6.0),
        seed("URDF", "r.urdf", _MIMIC, _robot, 6.0),
        seed("SRDF", "r.srdf", SOUND_SRDF, srdf, 3.0, small__urdf=SOUND),
        seed("scene", "s.yaml", json.dumps(_SCENE), _scene, 4.0),
        seed("scene", "s.yaml", yaml_text(_SCENE), _scene, 5.0),
        seed("scenario", "s.yaml", SCENARIO.replace("silvermate", "jackal-box"), _scenario, 4.0),
        seed("scenario", "s.yaml", json.dumps({"robot": "jackal-box", "base": "omni", "preset": "default", "seed": 3, "params":
             {"influence": 0.4}, "scene": "s2.yaml", "start": {"x": 0, "yaw": 0.1}, "goal": {"x": 3, "y": 1}}), _scenario, 2.0,
             s2__yaml=json.dumps({"obstacles": _SCENE["obstacles"][:1]})),
        seed("sensors", "s.yaml", sensor_file().read_bytes(), read_sensors, 5.0),
        seed("sweep", "sweep.yaml", _SWEEP, read_sweep, 3.0, room__yaml=SCENARIO.replace("silvermate", "jackal-box")),
        seed("point cloud", "c.ply", _ply(binary=False), _cloud),
        seed("point cloud", "c.ply", _ply(binary=True), _cloud, 1.5),
        seed("point cloud", "c.pcd", _pcd(binary=False), _cloud),
        seed("point cloud", "c.pcd", _pcd(binary=True), _cloud, 1.5),
        seed("point cloud", "c.pcd", _packed_pcd(), _cloud, 1.5),
        seed("MoveIt scene", "s.scene", _MOVEIT, _scene, 3.0),
        seed("MoveIt scene", "s.scene", _MOVEIT_OLD, _scene),
        seed("MoveIt scene", "s.scene", _MOVEIT_MANY, _scene),
        seed("planning scene", "p.json", json.dumps(_PLANNING), _planning, 3.0),
        seed("planning scene", "p.yaml", yaml_text(json.loads(json.dumps(_PLANNING))) + "---\n", _planning, 3.0),
        seed("sources", "all.yaml", _SOURCES, _scene, 3.0, m__yaml=_MAP, map__pgm=_PGM, s__scene=_MOVEIT, own__yaml=yaml_text(_SCENE),
             m__bt=_octree(binary=True), c__xyz="1 2 0.5\n2 1 0.5\n"),
        seed("OctoMap", "m.bt", _octree(binary=True), _scene, 1.5),
        seed("OctoMap", "m.ot", _octree(binary=False), _scene, 1.5),
        seed("OctoMap", "c.ot", _octree(binary=False, colour=b"rgb"), _scene),
        seed("xacro", "r.urdf.xacro", _XACRO, _robot, 3.0),
        seed("xacro", "r.urdf.xacro", _XACRO_INCLUDES, fixed, 1.0, part__xacro=_XACRO_PART),
        seed("xacro", "part.xacro", _XACRO_PART, lambda p: fixed(p.parent / "r.urdf.xacro"), 1.0,
             r__urdf__xacro=_XACRO_INCLUDES),
        *(seed("path", name, text, _path, 0.5) for name, text in _PATHS.items()),
        seed("path", "p.npz", _npz(), _path),
        seed("bag", "b.mcap", _bag(".mcap"), _read_bag, 2.0),
        seed("bag", "b.db3", _bag(".db3"), _read_bag, 1.0),
        seed("bag", "b.bag", _bag(".bag"), _read_bag, 2.0),
        seed("point cloud", "c.xyz", "# made\n" + "1.0 2.0 0.5 9\n2.0,1.0;0.5\n" * 20, _cloud),
        seed("scene's points", "p.npy", _npy(np.random.default_rng(3).uniform(-1, 1, (30, 3))), cloud_file, 2.0,
             npy__yaml="obstacles: [{shape: points, radius: 0.05, file: p.npy}]"),
        seed("scene's points", "p.csv", "# made\n" + "1.0,2.0,0.5\n" * 20, cloud_file, 1.0,
             csv__yaml="obstacles: [{shape: voxels, size: 0.1, file: p.csv}]"),
        seed("laser log", "l.jsonl", (json.dumps(_SCAN) + "\n") * 3, io.read_laser_log, 2.0),
        seed("laser log", "l.csv", _CSV, io.read_laser_log),
        seed("laser log", "l.log", _CARMEN, io.read_laser_log, 2.0),
        seed("Nav2 map", "m.yaml", _MAP, io.load_nav2_map, 2.0, map__pgm=_PGM),
        seed("Nav2 map", "map.pgm", _PGM, lambda p: io.load_nav2_map(p.parent / "m.yaml"), 1.5, m__yaml=_MAP),
        seed("Nav2 map", "map.pgm", _PGM_TEXT, lambda p: io.load_nav2_map(p.parent / "m.yaml"), 1.5, m__yaml=_MAP),
        seed("Nav2 map", "map.png", _png(), lambda p: io.load_nav2_map(p.parent / "m.yaml"), 1.5,
             m__yaml=_MAP.replace("map.pgm", "map.png").replace("trinary", "scale")),
        seed("BARN", "barn.json", _json(_BARN), lambda p: (datasets.barn_ids(p), datasets.load_barn(p, 0)), 2.0),
        seed("DynaBARN", "dyna.json", _json(_DYNABARN), lambda p: (datasets.dynabarn_ids(p), datasets.load_dynabarn(p, 0)), 2.0),
        seed("bridge", "bridge.json", _json(_BRIDGE), datasets.load_bridge, 2.0),
        seed("result", "r.json", _json(_RESULT), lambda p: _from_result(p, str(p.parent / "small.urdf")), 4.0, small__urdf=SOUND),
        seed("record", "r.npz", _record_bytes(), _record, 8.0),
    ]  # fmt: skip
    for name, content in meshes().items():
        result.append(seed("mesh", name, content, es.Mesh.from_file, 0.7))
        if name.endswith(".ply"):  # not read for robots
            continue
        urdf = SOUND.replace(box, f'<mesh filename="{name}"/>')
        result.append(seed("robot's mesh", name, content, robot_mesh, 1.0, small__urdf=urdf))
    return tuple(result)


def yaml_text(document: object) -> str:
    """The document in YAML's own style."""
    import yaml

    return yaml.safe_dump(document, sort_keys=False)
