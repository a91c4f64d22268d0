"""IO room, bags in: laser scans, point clouds, joint states and the base's pose from ROS 1 and ROS 2 bags.

Messages come one after the other, as the bag is read: none of the iterators holds more than a second of them. Where the
robot was when something was measured is interpolated between the transforms before and after.
"""

from __future__ import annotations

import importlib
import logging
import math
import os
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import ElasticStripsError, InputError, missing_extra, nearest_name
from elastic_strips.files import check_input, note_input, open_input
from elastic_strips.scene.quantities import check_pose, rotation_of
from elastic_strips.validation import check_array

from .laser_log import LoggedScan, scan_of
from .point_cloud import MAX_POINTS, PointCloud

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_log = logging.getLogger(__name__)
_MAX_BYTES = 2**42
_HEADS = {".bag": b"#ROSBAG V2.0\n", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}
_SCAN, _CLOUD, _JOINTS = (f"sensor_msgs/msg/{name}" for name in ("LaserScan", "PointCloud2", "JointState"))
_TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TRANSFORM_WAIT = 1.0  # [s] for the transforms after a measurement, on the bag's clock
_TRANSFORM_GAP = 1.0  # [s] between the transforms before and after, at most
_TRANSFORM_LIFE = 10.0  # [s] that transforms are kept
_FLAT_TOLERANCE = 1e-6  # norm of a quaternion, or angle [rad] between two, that is as good as 0
_FIELDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of PointField


class BagError(InputError):
    """A bag cannot be read, or does not hold what was requested; the message names the file."""


class BagTopic(NamedTuple):
    """A topic of a bag: the type of its messages, and how many there are."""

    type: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class BagCloud:
    """A point cloud of a bag.

    Attributes:
        time: its time stamp [s].
        frame: frame of its points.
        cloud: the points.
    """

    time: float
    frame: str
    cloud: PointCloud


@dataclass(frozen=True, slots=True, eq=False)
class BagJoints:
    """A JointState of a bag.

    Attributes:
        time: its time stamp [s].
        positions, velocities: those of the joints that have any, by name [rad or m; rad/s or m/s].
    """

    time: float
    positions: Mapping[str, float]
    velocities: Mapping[str, float]


class CloudMessage(Protocol):
    """The parts of a ``sensor_msgs/PointCloud2`` that are used, whichever library read it."""

    height: int
    width: int
    fields: Sequence[Any]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any


def cloud_of(message: CloudMessage) -> PointCloud:
    """The points of a message in its sensor's frame; there may be none. Those that are not finite are left out.

    Raises:
        InputError: it has no x, y and z, or more points than are read.
        ValueError: its data do not fit its fields.
    """
    fields = {f.name: f for f in message.fields}
    missing = [axis for axis in "xyz" if axis not in fields or fields[axis].datatype not in _FIELDS]
    count, step, rows = message.width * message.height, message.point_step, message.height
    if not count:  # some have no fields then
        return PointCloud(np.empty((0, 3)), 0)
    if missing:
        raise InputError(f"a cloud has no {', '.join(missing)}; it has {', '.join(fields) or 'nothing'}")
    if count > MAX_POINTS:
        raise InputError(f"a cloud has {count} points; at most {MAX_POINTS} are read")
    order = ">" if message.is_bigendian else "<"
    kinds = [order + _FIELDS[fields[axis].datatype] for axis in "xyz"]
    offsets = [int(fields[axis].offset) for axis in "xyz"]
    if max(at + np.dtype(kind).itemsize for at, kind in zip(offsets, kinds, strict=True)) > step:
        raise ValueError(f"its points have {step} bytes, too few for x, y, z at {', '.join(map(str, offsets))}")
    row = message.width * step
    stride = max(message.row_step, row)  # many drivers leave row_step at 0; the last row may end with its points
    data = np.asarray(message.data, dtype=np.uint8)
    if len(data) < stride * (rows - 1) + row:
        raise ValueError(f"its data have {len(data)} bytes; {rows} rows of {row} need more")
    if stride > row:  # rows with something behind them
        data = np.concatenate([data[k * stride : k * stride + row] for k in range(rows)])
    dtype = np.dtype({"names": ["x", "y", "z"], "formats": kinds, "offsets": offsets, "itemsize": int(step)})
    table = np.frombuffer(data.tobytes(), dtype, count)
    with np.errstate(invalid="ignore"):  # there are bytes that signal as they are cast
        points = np.column_stack([table[axis].astype(float) for axis in "xyz"])
    finite = np.isfinite(points).all(axis=1)
    return PointCloud(points[finite], int((~finite).sum()))


class BagReader:
    """Reads a bag: ``.bag`` of ROS 1; ``.mcap``, ``.db3`` or a folder with ``metadata.yaml`` of ROS 2.

    Where no topic is given, the bag must have exactly one of the requested kind.

    Attributes:
        path: the bag.
        topics: its topics by name.
        dropped: what the iterators left out or assumed so far, and how often.
    """

    def __init__(
        self, path: str | os.PathLike[str], *, base_frame: str = "base_link", world_frame: str | None = None
    ) -> None:
        """Open the bag and list its topics.

        Args:
            path: file or folder.
            base_frame: frame of the robot's base, whose poses are given and on which sensors are mounted.
            world_frame: frame of the base's poses; where None, the frame that all others hang on.

        Raises:
            BagError: no such file, another format, or a damaged one.
            MissingExtraError: rosbags is not installed.
        """
        self.path: Path = Path(path)
        self.dropped: Counter[str] = Counter()
        self._base, self._world = base_frame, world_frame
        if os.path.isdir(self.path):
            check_input(self.path / "metadata.yaml", "bag", _MAX_BYTES, BagError)
            for file in self.path.iterdir():  # that rosbags opens by itself
                note_input(file)
        else:
            self._check_head()
        self.topics: dict[str, BagTopic] = {}
        self._static = _Frames()
        for _, _, message in self._read(lambda t: t.type in _TRANSFORMS and t.topic.endswith("tf_static")):
            self._static.add(message, static=True)

    def _check_head(self) -> None:
        """The file begins as its name's ending says: a reader that looks for the end of a line reads all of another."""
        suffix = self.path.suffix.lower()
        with open_input(self.path, "bag", _MAX_BYTES, BagError) as (stream, _):
            if suffix not in _HEADS:
                raise BagError(f"{self.path}: bags of kind {suffix!r} are not read{nearest_name(suffix, _HEADS)}")
            if stream.read(len(_HEADS[suffix])) != _HEADS[suffix]:
                raise BagError(f"{self.path}: is not a {suffix} bag: it does not begin with {_HEADS[suffix]!r}")

    def scans(
        self, topic: str | None = None, *, frame: str | None = None, mount: ArrayLike | None = None
    ) -> Iterator[LoggedScan]:
        """The laser scans, each with the base's pose, as `read_laser_log` gives them.

        The sensor's mount comes from the transforms. Where they do not have it, ``mount`` is taken, or, with a warning
        in the log that names frames like it, the base's own place. The pose is None where the transforms do not say it.
        Both are counted in ``dropped``.

        Args:
            topic: topic of the scans.
            frame: frame of the sensor, if its messages name one that the transforms do not have.
            mount: pose (4, 4) of the sensor in the base's frame [m], where the transforms do not say it.

        Raises:
            BagError: no such topic, several of them, or a damaged bag.
            SceneError: a mount that is not a pose.
        """
        given = None if mount is None else check_pose(mount)
        for message, stamp, frames in self._stamped(_SCAN, topic):
            name = frame or message.header.frame_id
            at = frames.between(self._base, name, stamp)
            if at is None and given is None:
                said = "scans of a sensor whose mount is not known"
                if not self.dropped[said]:
                    self._warn(frames, name, self._base, "its scans are taken to be seen from the base's own place")
                self.dropped[said] += 1
            mounted = at if at is not None else np.eye(4) if given is None else given
            pose = self._pose(frames, stamp)
            if pose is None:
                self.dropped["scans without a pose"] += 1
            keys = ("angle_min", "angle_increment", "range_min", "range_max")
            head = {"stamp": stamp, **{key: float(getattr(message, key)) for key in keys}}
            try:
                yield scan_of(name or "laser", head, message.ranges, mounted), pose
            except ValueError as error:
                self.dropped[f"scans that are not valid ({error})"] += 1

    def clouds(self, topic: str | None = None, *, frame: str | None = None) -> Iterator[BagCloud]:
        """The point clouds; points that are not finite, and all fields except x, y and z, are left out.

        Args:
            topic: topic of the clouds.
            frame: frame into which the points are brought; the sensor's where None. Clouds are left out, and counted in
                ``dropped``, where the transforms do not say how, and where their data do not fit their fields.

        Raises:
            BagError: no such topic, several of them, a cloud without x, y and z, or a damaged bag.
        """
        for message, stamp, frames in self._stamped(_CLOUD, topic):
            try:
                cloud = cloud_of(message)
            except InputError as error:
                raise BagError(f"{self.path}: {error}") from None
            except ValueError as error:
                self.dropped[f"clouds that are not valid ({error})"] += 1
                continue
            points, name = cloud.points, message.header.frame_id
            if frame is not None:
                T = frames.between(frame, name, stamp)
                if T is None:
                    said = f"clouds whose place in {frame!r} is not known"
                    if not self.dropped[said]:
                        self._warn(frames, name, frame, "its clouds are left out")
                    self.dropped[said] += 1
                    continue
                points = points @ T[:3, :3].T + T[:3, 3]
            if not len(points):
                self.dropped["clouds without points"] += 1
                continue
            points.flags.writeable = False
            yield BagCloud(stamp, frame or name, PointCloud(points, cloud.dropped))

    def joint_states(self, topic: str | None = None) -> Iterator[BagJoints]:
        """The joint states; efforts are left out.

        Also left out, and counted in ``dropped``, are values that are not finite, and positions or velocities of a
        message that has a different number of them than of names.

        Raises:
            BagError: no such topic, several of them, or a damaged bag.
        """
        topic = self._topic(_JOINTS, topic)
        for _, _, message in self._read(lambda t: t.topic == topic):
            rows = (self._named(message.name, message, what) for what in ("position", "velocity"))
            yield BagJoints(_seconds(message.header.stamp), *rows)

    def _named(self, names: list[str], message: Any, what: str) -> dict[str, float]:
        """The values of a JointState by name; there may be none at all."""
        values = [float(value) for value in getattr(message, what)]
        if values and len(values) != len(names):
            self.dropped[f"{what} of joint states with another number of names"] += 1
            return {}
        if lost := sum(not math.isfinite(value) for value in values):
            self.dropped[f"{what} of a joint that is not finite"] += lost
        return {name: value for name, value in zip(names, values, strict=False) if math.isfinite(value)}

    def poses(self) -> Iterator[tuple[float, Array]]:
        """Time [s] and pose (3,) of the base (x, y [m], yaw [rad]), whenever one of its transforms comes.

        Raises:
            BagError: a damaged bag.
        """
        frames, last = self._static.copied(), -math.inf
        for _, _, message in self._read(lambda t: t.type in _TRANSFORMS and not t.topic.endswith("tf_static")):
            frames.add(message)
            stamp = frames.latest(self._base)
            pose = self._pose(frames, stamp) if stamp > last else None
            if pose is not None:
                last = stamp
                yield stamp, pose

    def _warn(self, frames: _Frames, source: str, target: str, so: str) -> None:
        """Say that no transforms lead from one frame to another, and which frames have such names."""
        known = sorted({*frames.parents, *frames.parents.values()})
        like = [
            f"{name!r} may be {', '.join(map(repr, found[:6]))}"
            for name in (source, target)
            if name.lstrip("/") not in known
            and (found := [k for k in known if _last(k) == _last(name)] or get_close_matches(name, known, n=2))
        ]
        _log.warning(
            "%s: no transforms lead from the frame %r to %r: %s%s; there are %s",
            self.path,
            source,
            target,
            so,
            "".join(f"; {each}" for each in like),
            ", ".join(known[:12]) or "none",
        )

    def _pose(self, frames: _Frames, stamp: float) -> Array | None:
        world = self._world or frames.root(self._base)
        T = None if world == self._base else frames.between(world, self._base, stamp)
        return None if T is None else check_array("pose", [T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])], (3,))

    def _stamped(self, kind: str, topic: str | None) -> Iterator[tuple[Any, float, _Frames]]:
        """Messages of a topic with their stamps, each once the transforms around its stamp are there."""
        topic = self._topic(kind, topic)
        frames = self._static.copied()
        waiting: deque[tuple[Any, float]] = deque()
        for name, now, message in self._read(
            lambda t: t.topic == topic or (t.type in _TRANSFORMS and not t.topic.endswith("tf_static"))
        ):
            if name in _TRANSFORMS:
                frames.add(message)
            else:
                waiting.append((message, _seconds(message.header.stamp)))
            while waiting:
                first, stamp = waiting[0]
                ready = frames.known_at(stamp, first.header.frame_id, self._base)
                if not ready and now - stamp < _TRANSFORM_WAIT and len(waiting) < 1000:
                    break
                waiting.popleft()
                yield first, stamp, frames
        for first, stamp in waiting:
            yield first, stamp, frames

    def _topic(self, kind: str, topic: str | None) -> str:
        """The topic that is given, or the only one of a kind."""
        fitting = [name for name, found in self.topics.items() if found.type == kind]
        if topic is not None:
            if topic not in fitting:
                raise BagError(f"{self.path}: has no topic {topic!r} of {kind}{nearest_name(topic, fitting)}")
            return topic
        if not fitting:
            said = ", ".join(f"{name} ({found.type})" for name, found in list(self.topics.items())[:12])
            raise BagError(f"{self.path}: has no topic of {kind}; it has {said or 'none at all'}")
        if len(fitting) > 1:
            raise BagError(f"{self.path}: has several topics of {kind}: {', '.join(sorted(fitting)[:12])}; name one")
        return fitting[0]

    def _read(self, wanted: Callable[[_Channel], bool]) -> Iterator[tuple[str, float, Any]]:
        """Type, time of recording [s] and message of all that is wanted, as the bag has them."""
        try:
            with self._opened() as reader:
                self.topics = {name: BagTopic(str(t.msgtype), t.msgcount) for name, t in reader.topics.items()}
                chosen = [c for c in reader.connections if wanted(_Channel(c.topic, c.msgtype))]
                known = reader.typestore.fielddefs
                if reader.is2 and any(
                    c.msgtype not in known for c in chosen
                ):  # others have definitions, these have none
                    usual = reader.default_typestore.fielddefs if reader.default_typestore is not None else {}
                    reader.typestore.register({kind: rules for kind, rules in usual.items() if kind not in known})
                for connection, at, data in reader.messages(connections=chosen) if chosen else ():
                    yield connection.msgtype, 1e-9 * at, reader.deserialize(data, connection.msgtype)
        except ElasticStripsError:
            raise
        except Exception as error:  # of rosbags, SQLite, zstd and lz4, of YAML: all of them about what the file holds
            said = " ".join(str(error).split())[:300] or type(error).__name__
            if isinstance(error, KeyError):
                said = f"rosbags does not know {said}"
            raise BagError(f"{self.path}: the bag cannot be read: {said}") from None

    def _opened(self) -> AnyReader:
        try:
            highlevel = importlib.import_module("rosbags.highlevel")
            typesys = importlib.import_module("rosbags.typesys")
        except ModuleNotFoundError:
            raise missing_extra(f"the bag {self.path.name}", "rosbags", "ros") from None
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)  # for bags that hold no definitions
        return highlevel.AnyReader([self.path], default_typestore=store)


def _last(frame: str) -> str:
    """A frame's name without its robot's: the part behind the last slash."""
    return frame.rpartition("/")[2]


class _Channel(NamedTuple):
    topic: str
    type: str


@dataclass(slots=True)
class _Frames:
    """The tree of frames over the last seconds."""

    parents: dict[str, str] = field(default_factory=dict)
    still: dict[str, Array] = field(default_factory=dict)  # T_parent_child (4, 4) that never change
    moving: dict[str, deque[tuple[float, Array]]] = field(default_factory=dict)  # time, x y z qx qy qz qw

    def copied(self) -> _Frames:
        return _Frames(dict(self.parents), dict(self.still))

    def add(self, message: Any, *, static: bool = False) -> None:
        for each in message.transforms:
            child, parent = each.child_frame_id.lstrip("/"), each.header.frame_id.lstrip("/")
            at, turn = each.transform.translation, each.transform.rotation
            row = np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w])
            norm = float(np.linalg.norm(row[3:]))
            if not np.isfinite(row).all() or norm < _FLAT_TOLERANCE or child == parent:
                continue
            row[3:] /= norm
            if self.parents.get(child, parent) != parent:  # what was under another one does not count any more
                self.moving.pop(child, None)
            self.parents[child] = parent
            if static:
                self.still[child] = _matrix(row)
                continue
            stamp, rows = _seconds(each.header.stamp), self.moving.setdefault(child, deque())
            if rows and stamp < rows[-1][0] - _TRANSFORM_LIFE:  # the clock was set back
                rows.clear()
            at = len(rows)
            while at and rows[at - 1][0] > stamp:  # it is late
                at -= 1
            if at and rows[at - 1][0] == stamp:  # again
                continue
            rows.insert(at, (stamp, row))
            while rows[0][0] < rows[-1][0] - _TRANSFORM_LIFE:
                rows.popleft()

    def chain(self, frame: str) -> list[str]:
        """The frame and those that it hangs on."""
        chain = [frame.lstrip("/")]
        while chain[-1] in self.parents and len(chain) < 100:
            chain.append(self.parents[chain[-1]])
        return chain

    def root(self, frame: str) -> str:
        return self.chain(frame)[-1]

    def latest(self, frame: str) -> float:
        """The time up to which the frame's place is known."""
        times = [self.moving[f][-1][0] for f in self.chain(frame) if f in self.moving and f not in self.still]
        return min(times, default=-math.inf)

    def known_at(self, t: float, *frames: str) -> bool:
        """Whether the transforms of the frames go on to a time; true only where there are any."""
        return all(self.latest(f) >= t or not self.moving.keys() & set(self.chain(f)) for f in frames) and bool(
            self.moving
        )

    def between(self, target: str, source: str, t: float) -> Array | None:
        """T_target_source (4, 4) at a time, or None where it is not known."""
        up, down = self.chain(source), self.chain(target)
        common = next((f for f in up if f in down), None)
        if common is None:
            return None
        left, right = (self._up(chain[: chain.index(common)], t) for chain in (down, up))
        return None if left is None or right is None else np.linalg.inv(left) @ right

    def _up(self, chain: list[str], t: float) -> Array | None:
        """T of the last frame's parent and the first frame."""
        T = np.eye(4)
        for frame in chain:
            step = self.still[frame] if frame in self.still else self._at(frame, t)
            if step is None:
                return None
            T = step @ T
        return T

    def _at(self, frame: str, t: float) -> Array | None:
        rows = self.moving[frame]
        after: tuple[float, Array] | None = None
        for before in reversed(rows):  # it is near the end
            if before[0] <= t:
                break
            after = before
        else:
            before = None
        if before is None or after is None:  # before the first, or after the last
            stamp, row = before or after or rows[0]
            return _matrix(row) if abs(stamp - t) <= 0.5 * _TRANSFORM_GAP else None
        (t0, a), (t1, b) = before, after
        if t1 - t0 > _TRANSFORM_GAP:
            return None
        s = (t - t0) / (t1 - t0)
        row = (1.0 - s) * a + s * b
        cos = float(a[3:] @ b[3:])
        angle = math.acos(min(abs(cos), 1.0))
        if angle > _FLAT_TOLERANCE:  # on the shorter way
            sign = math.copysign(1.0, cos)
            row[3:] = (math.sin((1.0 - s) * angle) * a[3:] + sign * math.sin(s * angle) * b[3:]) / math.sin(angle)
        row[3:] /= np.linalg.norm(row[3:])
        return _matrix(row)


def _matrix(row: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_of(row[3:]), row[:3]
    return T


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
