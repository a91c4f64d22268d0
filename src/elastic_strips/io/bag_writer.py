"""IO room, bags out: a trajectory or the record of a drive as an MCAP file of ROS 2 messages, which Foxglove opens.

=====================  ================================  =========================================================
/plan                  nav_msgs/Path                     the base's way, once
/joint_trajectory      trajectory_msgs/JointTrajectory   all samples of the joints, once
/joint_states          sensor_msgs/JointState            over time
/tf                    tf2_msgs/TFMessage                the robot's first link in the world, and its links in that
/obstacles             visualization_msgs/MarkerArray    once, and over time where something moves
/robot_description     std_msgs/String                   the URDF, where there is one
=====================  ================================  =========================================================
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin
import trimesh

from elastic_strips.arrays import Array, Document
from elastic_strips.control.record import Record
from elastic_strips.errors import InputError, missing_extra
from elastic_strips.files import atomic_write, check_writable, read_input, scratch_folder
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle, Scene, World
from elastic_strips.scene.quantities import quaternion_of
from elastic_strips.trajectory import Trajectory
from elastic_strips.validation import check_number, check_type
from elastic_strips.xacro_process import MAX_BYTES

from .record_file import record_robot
from .trajectory_data import heading, nanoseconds, stamp, trajectory_document

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2 import Writer
    from rosbags.typesys.store import Typestore

_CUBE, _SPHERE, _CYLINDER, _CUBE_LIST, _TRIANGLES, _DELETE_ALL = 1, 2, 3, 6, 11, 3  # of visualization_msgs/Marker
_GREY = {"r": 0.6, "g": 0.6, "b": 0.65, "a": 0.9}
_BASE, _NAME, _ARRAY = 1, 2, 3  # kinds of fields in rosbags: plain, a message, of fixed length
_Rule: TypeAlias = tuple[int, Any]


def write_bag(
    path: str | os.PathLike[str],
    motion: Trajectory | Record,
    *,
    robot: RobotModel | None = None,
    scene: Scene | World | None = None,
    frame: str = "map",
    period: float = 0.05,
) -> Path:
    """Write a motion and its obstacles as one MCAP file.

    Args:
        path: the file; an existing one is replaced in one step.
        motion: a trajectory, or the record of a drive with the obstacles as they moved.
        robot: the robot of a record; the recorded one where None.
        scene: obstacles; those of the record where None.
        frame: ``frame_id`` of the world.
        period: time between two messages of things that change [s].

    Raises:
        InputError: the file cannot be written, the motion begins before time 0, or the robot is not that of the record.
        MissingExtraError: rosbags is not installed.
    """
    target = check_writable(path)
    if not isinstance(motion, Record):
        check_type("motion", motion, Trajectory, InputError)
    check_number("period", period, low=1e-3, high=10.0, unit="s", error=InputError)
    if isinstance(motion, Record):
        robot = record_robot(motion) if robot is None else robot
        motion.check_robot(robot)
        rows = motion.control
        times, coordinates, v = rows.time, rows.coordinates, rows.v
        document = _driven(robot, times, coordinates, frame)
        scene = motion.world if scene is None else scene
    else:
        robot, times, coordinates, v = motion.robot, motion.time, motion.coordinates, motion.v
        document = trajectory_document(motion, frame=frame)
    if times[0] < 0.0:
        raise InputError(f"{target}: the motion begins at {times[0]:g} s; a bag's time begins at 0")
    world = World(Scene([])) if scene is None else World(scene) if isinstance(scene, Scene) else scene
    chosen = np.unique(np.append(np.searchsorted(times, np.arange(times[0], times[-1], period)), len(times) - 1))
    with scratch_folder(target) as folder:
        bag = _Bag(folder / "bag", frame)
        with bag.writer:
            _write(bag, robot, document, times[chosen], coordinates[chosen], v[chosen], world)
        data = next((folder / "bag").glob("*.mcap")).read_bytes()
    return atomic_write(target, data)


def _driven(robot: RobotModel, times: Array, coordinates: Array, frame: str) -> Document:
    """The base's way of a record."""
    if not robot.space.planar:
        return {}
    poses = [
        {
            "header": {"stamp": stamp(t), "frame_id": frame},
            "pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": heading(yaw)},
        }
        for t, (x, y, yaw) in zip(times.tolist(), coordinates[:, :3].tolist(), strict=True)
    ]
    return {"path": {"header": {"stamp": stamp(float(times[0])), "frame_id": frame}, "poses": poses}}


def _write(
    bag: _Bag, robot: RobotModel, document: dict[str, Any], times: Array, coordinates: Array, v: Array, world: World
) -> None:
    start = float(times[0])
    if robot.urdf_path is not None and os.path.isfile(robot.urdf_path):
        text = read_input(robot.urdf_path, "URDF file", MAX_BYTES, InputError).decode("utf-8", "replace")
        bag.add(start, "/robot_description", "std_msgs/msg/String", {"data": text})
    if "path" in document:
        bag.add(start, "/plan", "nav_msgs/msg/Path", document["path"])
    if robot.joint_names and "joint_trajectory" in document:
        bag.add(start, "/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", document["joint_trajectory"])
    moving, links = bool(world.names_moving or world.appears or world.vanishes), _Links(robot)
    b = robot.space.base_nv
    for k, t in enumerate(times.tolist()):
        header = {"stamp": stamp(t), "frame_id": bag.frame}
        if robot.joint_names:
            state = {"name": list(robot.joint_names), "position": coordinates[k, b:], "velocity": v[k, b:]}
            bag.add(t, "/joint_states", "sensor_msgs/msg/JointState", {"header": header, **state})
        bag.add(t, "/tf", "tf2_msgs/msg/TFMessage", {"transforms": links.transforms(coordinates[k], t, bag.frame)})
        if k == 0 or moving:
            # what vanished would stay: all are deleted first, in the same message
            markers: list[Document] = [{"header": header, "action": _DELETE_ALL}] if moving else []
            for obstacle in world.at(t):
                shared = {"header": header, "ns": obstacle.name or "obstacle", "color": _GREY}
                markers += [{**shared, "id": i, **marker} for i, marker in enumerate(_markers(obstacle))]
            if markers:
                bag.add(t, "/obstacles", "visualization_msgs/msg/MarkerArray", {"markers": markers})


class _Links:
    """Where a robot's links are."""

    def __init__(self, robot: RobotModel) -> None:
        self._robot, self._data = robot, robot.model.createData()
        frames = robot.model.frames
        bodies = [
            k for k in range(len(frames)) if frames[k].type == pin.FrameType.BODY and frames[k].name != "universe"
        ]
        self._root, self._others = bodies[0], bodies[1:]

    def transforms(self, row: Array, t: float, world: str) -> list[Document]:
        """The first link in the world, and the others in the first."""
        model, data = self._robot.model, self._data
        pin.framesForwardKinematics(model, data, self._robot.space.from_coordinates(row))
        at, name = data.oMf[self._root], model.frames[self._root].name
        found = [_transform(at.homogeneous, t, world, name)]
        for k in self._others:
            found.append(_transform(at.actInv(data.oMf[k]).homogeneous, t, name, model.frames[k].name))
        return found


def _transform(pose: Array, t: float, parent: str, child: str) -> Document:
    place = _pose(pose)
    return {
        "header": {"stamp": stamp(t), "frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": place["position"], "rotation": place["orientation"]},
    }


def _pose(pose: Array) -> dict[str, dict[str, float]]:
    x, y, z = pose[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_of(pose[:3, :3]).tolist()
    return {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}


def _markers(obstacle: Obstacle) -> list[Document]:
    """The marker that draws an obstacle."""
    spec: dict[str, Any] = dict(obstacle.spec)
    place = _pose(obstacle.pose)

    def marker(kind: int, scale: object, **more: object) -> Document:
        x, y, z = np.broadcast_to(np.asarray(scale, dtype=float), 3).tolist()
        return {"type": kind, "pose": place, "scale": {"x": x, "y": y, "z": z}, **more}

    if obstacle.shape == "box":
        return [marker(_CUBE, spec["size"])]
    if obstacle.shape == "sphere":
        return [marker(_SPHERE, 2.0 * spec["radius"])]
    if obstacle.shape == "cylinder":
        return [marker(_CYLINDER, (2.0 * spec["radius"], 2.0 * spec["radius"], spec["length"]))]
    if obstacle.shape in ("voxels", "points"):
        size = spec["size"] if obstacle.shape == "voxels" else 2.0 * spec["radius"]
        return [marker(_CUBE_LIST, size, points=_points(spec["centers" if obstacle.shape == "voxels" else "points"]))]
    return [marker(_TRIANGLES, 1.0, points=_points(_triangles(obstacle)))]


def _triangles(obstacle: Obstacle) -> Array:
    """Corners (3 F, 3) of the faces of a mesh, a hull, a cone or a capsule in the obstacle's frame."""
    spec: dict[str, Any] = dict(obstacle.spec)
    if obstacle.shape == "mesh":
        return spec["vertices"][spec["faces"]].reshape(-1, 3)
    if obstacle.shape == "convex":
        return trimesh.convex.convex_hull(spec["vertices"]).triangles.reshape(-1, 3)
    radius, length = spec["radius"], spec["length"]
    make = trimesh.creation.cone if obstacle.shape == "cone" else trimesh.creation.capsule
    solid = make(height=length, radius=radius)
    solid.apply_translation((0.0, 0.0, -float(solid.bounds[:, 2].mean())))  # versions differ in where they put it
    return solid.triangles.reshape(-1, 3)


def _points(points: Array) -> list[Document]:
    return [{"x": x, "y": y, "z": z} for x, y, z in np.asarray(points, dtype=float).tolist()]


class _Bag:
    """A bag that is being written: messages from plain data, with zeros for the fields that are not given."""

    def __init__(self, path: Path, frame: str) -> None:
        try:
            rosbag2 = importlib.import_module("rosbags.rosbag2")
            typesys = importlib.import_module("rosbags.typesys")
        except ModuleNotFoundError:
            raise missing_extra("an MCAP file", "rosbags", "ros") from None
        self.frame = frame
        self._store: Typestore = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self.writer: Writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
        self.writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
        self._connections: dict[str, Connection] = {}
        self._makers: dict[str, Callable[[Mapping[str, object]], object]] = {}

    def add(self, t: float, topic: str, kind: str, values: Mapping[str, object]) -> None:
        """Write a message of a kind at time ``t`` [s]."""
        if topic not in self._connections:
            self._connections[topic] = self.writer.add_connection(topic, kind, typestore=self._store)
        data = self._store.serialize_cdr(self._maker(kind)(values), kind)
        self.writer.write(self._connections[topic], nanoseconds(t), data)

    def _maker(self, kind: str) -> Callable[[Mapping[str, object]], object]:
        """A function that makes a message of plain data."""
        if kind not in self._makers:
            fields = [(name, self._field(rule)) for name, rule in self._store.fielddefs[kind][1]]
            message: Any = self._store.types[kind]
            self._makers[kind] = lambda values: message(*[make(values.get(name)) for name, make in fields])
        return self._makers[kind]

    def _field(self, rule: _Rule) -> Callable[[Any], object]:
        """A function that makes a field's value of plain data, or of None."""
        kind, of = int(rule[0]), rule[1]
        if kind == _NAME:
            make = self._maker(of)
            return lambda value: make({} if value is None else value)
        if kind == _BASE:
            zero: object = {"string": "", "bool": False}.get(of[0], 0.0 if "float" in of[0] else 0)
            return lambda value: zero if value is None else value
        entry, count = of[0], of[1] if kind == _ARRAY else 0
        if int(entry[0]) == _BASE and entry[1][0] not in ("string", "bool"):
            dtype = np.dtype({"byte": "uint8", "char": "uint8", "octet": "uint8"}.get(entry[1][0], entry[1][0]))
            return lambda value: np.zeros(count, dtype) if value is None else np.asarray(value, dtype=dtype)
        make_entry = self._field(entry)
        return lambda value: [make_entry(each) for each in value or ()]
