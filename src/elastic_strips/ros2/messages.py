"""Messages: what ROS 2 messages say, as values of this library, and back; any object with their fields will do.

Nothing here needs rclpy. What cannot be used raises a `MessageError`; who reads messages as they come counts these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.errors import InputError, without_numbers
from elastic_strips.io.laser_log import scan_of
from elastic_strips.io.nav2_map import WALL_HEIGHT
from elastic_strips.perception.readings import NO_ANSWER, NOTHING, DepthImage, LaserScan
from elastic_strips.scene import Obstacle, Voxels
from elastic_strips.scene.parts import MAX_CENTERS

_UNIT = 0.01  # by which the length of a quaternion may differ from 1: some drivers round
_LARGEST_TILT = 0.1  # [rad] of a base that is taken to stand upright
_UNKNOWN_VARIANCE = 1e4  # [m², rad²] from there on drivers mean that they do not know
_FULL = 100  # occupancy of a cell that is certainly occupied
_DEPTHS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}  # encoding → kind, unit [m]
_Depths = npt.NDArray[np.float32]
_OK, _WARN = 0, 1  # levels of diagnostic_msgs/DiagnosticStatus


def kind_of(error: Exception) -> str:
    """What is wrong with a message, without its numbers: what is wrong again and again is counted as one."""
    return without_numbers(str(error).split(":")[0])


class MessageError(InputError):
    """A message cannot be used; the text says why."""


class RosObject(Protocol):
    """A message, or another object of rclpy's, or whatever has the same attributes."""

    def __getattr__(self, name: str, /) -> Any: ...

    def __setattr__(self, name: str, value: Any, /) -> None: ...


class BasePlace(NamedTuple):
    """Where a message says that the base is.

    Attributes:
        pose: (3,) x, y [m], yaw [rad].
        covariance: (3, 3) of it, in the frame of the base [m², rad²]; None where the message does not say.
    """

    pose: Array
    covariance: Array | None


def nanoseconds(stamp: RosObject) -> int:
    """A time stamp as whole nanoseconds: as a float it would be off by up to 0.1 µs."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def check_frame(message: RosObject, wanted: str) -> None:
    """Check that a message is in a frame; an empty name is any frame.

    Raises:
        MessageError: it is in another one.
    """
    frame = str(message.header.frame_id).strip("/")
    if wanted and frame != wanted.strip("/"):
        raise MessageError(f"the frame is {frame!r}, and {wanted!r} is wanted")


def planar_pose(pose: RosObject) -> Array:
    """(3,) x, y [m], yaw [rad] of a ``geometry_msgs/Pose`` of something that stands upright.

    Raises:
        MessageError: it is not finite, not turned by a quaternion, or tilted by more than 0.1 rad.
    """
    return _upright(pose.position, pose.orientation)


def _upright(position: RosObject, orientation: RosObject) -> Array:
    at_x, at_y, _, x, y, z, w = _placed(position, orientation).tolist()
    tilt = 2.0 * math.atan2(math.hypot(x, y), math.hypot(z, w))
    if tilt > _LARGEST_TILT:
        raise MessageError(f"a pose is tilted by {tilt:.3g} rad; at most {_LARGEST_TILT:g} is taken for upright")
    return np.array([at_x, at_y, 2.0 * math.atan2(z, w)])


def spatial_pose(pose: RosObject) -> Array:
    """(7,) position [m] and unit quaternion x, y, z, w of a ``geometry_msgs/Pose``.

    Raises:
        MessageError: it is not finite, or not turned by a quaternion.
    """
    return _placed(pose.position, pose.orientation)


def _placed(at: RosObject, turn: RosObject) -> Array:
    found = np.array([float(value) for value in (at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w)])
    if not np.isfinite(found).all():
        raise MessageError(f"a pose is not finite: {', '.join(f'{value:g}' for value in found)}")
    length = float(np.linalg.norm(found[3:]))
    if abs(length - 1.0) > _UNIT:
        raise MessageError(f"a quaternion has the length {length:.4g}; 1 is needed within {_UNIT:g}")
    found[3:] /= length
    return found


def covariance_of(values: Sequence[float], yaw: float) -> Array | None:
    """(3, 3) covariance of x, y and yaw in the base's frame, from the 36 values of a message, which are of its own.

    None where the message does not know: they are 0, huge, not finite or no covariance.
    """
    full = np.asarray(values, dtype=float)
    if full.shape != (36,):
        return None
    part = full.reshape(6, 6)[np.ix_((0, 1, 5), (0, 1, 5))]
    diagonal = np.diag(part)
    if not np.isfinite(part).all() or (diagonal <= 0.0).any() or (diagonal >= _UNKNOWN_VARIANCE).any():
        return None
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    part = turn @ (0.5 * (part + part.T)) @ turn.T
    return None if np.linalg.eigvalsh(part)[0] < 0.0 else part


def place_of(message: RosObject) -> BasePlace:
    """Where the base is by an ``Odometry`` or a ``PoseWithCovarianceStamped``.

    Raises:
        MessageError: the pose cannot be used.
    """
    pose = planar_pose(message.pose.pose)
    return BasePlace(pose, covariance_of(message.pose.covariance, float(pose[2])))


class FrameTransform(NamedTuple):
    """A transform of ``tf``: where a frame is in another one.

    Attributes:
        stamp: its time stamp [ns].
        pose: (3,) x, y [m], yaw [rad].
    """

    stamp: int
    pose: Array


def transform_of(message: RosObject, parent: str, child: str) -> FrameTransform | None:
    """The newest transform of a ``TFMessage`` from a frame to its child; None where there is none.

    Raises:
        MessageError: it is not finite, not turned by a quaternion, or tilted.
    """
    found: FrameTransform | None = None
    for one in message.transforms:
        names = str(one.header.frame_id).strip("/"), str(one.child_frame_id).strip("/")
        stamp = nanoseconds(one.header.stamp)
        if names == (parent.strip("/"), child.strip("/")) and (found is None or stamp > found.stamp):
            place = one.transform
            found = FrameTransform(stamp, _upright(place.translation, place.rotation))
    return found


def joints_of(message: RosObject) -> dict[str, float]:
    """Positions [rad or m] by name of a ``JointState``; one without positions says nothing of them.

    Raises:
        MessageError: names and positions do not fit, or one is not finite.
    """
    names, values = list(message.name), [float(value) for value in message.position]
    if not values:
        return {}
    if len(names) != len(values):
        raise MessageError(f"a joint state has {len(names)} names and {len(values)} positions")
    for name, value in zip(names, values, strict=True):
        if not math.isfinite(value):
            raise MessageError(f"the position of {name!r} is {value:g}")
    return dict(zip(names, values, strict=True))


def laser_scan(message: RosObject, sensor: str, time: float, T_base_sensor: Array) -> LaserScan:
    """The scan of a ``LaserScan``, with ranges as in REP 117; one of whose ranges none is a number says nothing.

    Args:
        message: the message.
        sensor: name of the sensor.
        time: when it was measured, on the clock that scenes are on [s].
        T_base_sensor: (4, 4) pose of the sensor in the base's frame then.

    Raises:
        MessageError: its numbers do not make a scan.
    """
    keys = ("angle_min", "angle_increment", "range_min", "range_max")
    head = {"stamp": time, **{key: float(getattr(message, key)) for key in keys}}
    if not math.isfinite(sum(head.values())):
        raise MessageError(f"a scan of {sensor!r} has {', '.join(f'{k}={head[k]:g}' for k in keys)}")
    try:
        scan = scan_of(sensor, head, message.ranges, T_base_sensor)
    except (ValueError, TypeError) as error:
        raise MessageError(f"a scan of {sensor!r}: {error}") from None
    if np.isnan(scan.ranges).all():
        raise MessageError(f"a scan of {sensor!r} has no range at all: {len(scan.ranges)} are NaN or too short")
    return scan


def depth_image(
    message: RosObject,
    info: RosObject,
    sensor: str,
    time: float,
    T_base_sensor: Array,
    reach: tuple[float, float],
    q: Array | None = None,
    most: int | None = None,
) -> DepthImage:
    """The depths of an ``Image`` (16UC1 in millimetres, or 32FC1) with its ``CameraInfo``; REP 118.

    What is 0 or NaN, or nearer than the camera can tell, has no answer; what is further than that, or infinite, is
    nothing. Images have to be rectified: distortion is not looked at.

    Args:
        message, info: the image, and its camera's.
        sensor: name of the sensor.
        time: when it was exposed, on the clock that scenes are on [s].
        T_base_sensor: (4, 4) pose of the optical frame in the base's frame then.
        reach: shortest and longest depth that the camera can tell [m].
        q: (nq,) configuration of the robot then.
        most: pixels that it may have; of one with more, squares of pixels become one each: what is nearest in them, or
            no answer where most of them have none.

    Raises:
        MessageError: another encoding, too few data, or a camera without a focal length.
    """
    if message.encoding not in _DEPTHS:
        raise MessageError(f"an image of {sensor!r} is {message.encoding!r}; depths are {', '.join(_DEPTHS)}")
    kind, unit = _DEPTHS[message.encoding]
    rows, columns = int(message.height), int(message.width)
    dtype = np.dtype((">" if message.is_bigendian else "<") + kind)
    step = max(int(message.step), columns * dtype.itemsize)
    data = np.frombuffer(memoryview(message.data), np.uint8)
    if not rows * columns or len(data) < step * rows:
        raise MessageError(f"an image of {sensor!r} has {len(data)} bytes; {rows} rows of {step} are needed")
    if (int(info.height), int(info.width)) != (rows, columns):
        raise MessageError(
            f"an image of {sensor!r} has {rows} × {columns} pixels, and its camera {info.height} × {info.width}"
        )
    line = data[: step * rows].reshape(rows, step)[:, : columns * dtype.itemsize]
    raw = np.ascontiguousarray(line).view(dtype).reshape(rows, columns).astype(np.float32) * np.float32(unit)
    near, far = reach
    k = [float(value) for value in info.k]
    if len(k) != 9 or not (math.isfinite(sum(k)) and min(k[0], k[4]) > 0.0):
        raise MessageError(f"the camera {sensor!r} has the matrix {k}; focal lengths above 0 are needed")
    edge = 1 if most is None else max(math.ceil(math.sqrt(rows * columns / most)), 1)
    with np.errstate(invalid="ignore"):
        unknown = ~(raw >= near)  # of NaN, too
        depth: _Depths = np.where(raw > far, np.float32(NOTHING), raw)
    if edge > 1:
        depth, unknown = _in_squares(depth, unknown, edge)
    depth[unknown] = NO_ANSWER
    focal, center = (k[0] / edge, k[4] / edge), ((k[2] + 0.5) / edge - 0.5, (k[5] + 0.5) / edge - 0.5)
    return DepthImage(sensor, time, T_base_sensor, depth, focal, center, near, far, q)


def _in_squares(depth: _Depths, unknown: Mask, edge: int) -> tuple[_Depths, Mask]:
    """The nearest depth in each square of pixels, and where most of them are unknown; a border may be left out."""
    rows, columns = depth.shape[0] // edge, depth.shape[1] // edge
    whole = slice(rows * edge), slice(columns * edge)
    depth = np.where(unknown, np.float32(np.inf), depth)[whole]
    nearest, lost = np.full((rows, columns), np.inf, np.float32), np.zeros((rows, columns), np.int32)
    for i in range(edge):
        for k in range(edge):
            np.minimum(nearest, depth[i::edge, k::edge], out=nearest)
            lost += unknown[whole][i::edge, k::edge]
    return nearest, 2 * lost > edge * edge


def map_obstacles(
    message: RosObject, *, lethal: int = _FULL, unknown: str = "free", name: str = "map"
) -> list[Obstacle]:
    """The occupied cells of an ``OccupancyGrid`` as one obstacle of upright boxes, as `io.load_nav2_map` makes them.

    Args:
        message: the message.
        lethal: occupancy, 1 to 100, from which on a cell is occupied.
        unknown: how cells of −1 count: ``"free"`` or ``"occupied"``.
        name: name of the obstacle.

    Returns:
        The obstacle, or none where nothing is occupied.

    Raises:
        MessageError: its data do not fit its size, or too many cells are occupied.
    """
    info = message.info
    rows, columns, cell = int(info.height), int(info.width), float(info.resolution)
    data = np.asarray(message.data, dtype=np.int16)
    if len(data) != rows * columns or not (math.isfinite(cell) and cell > 0.0):
        raise MessageError(f"a map of {rows} × {columns} cells of {cell:g} m has {len(data)} values")
    x, y, yaw = planar_pose(info.origin).tolist()
    filled = (data >= lethal) | ((data < 0) & (unknown == "occupied"))
    index = np.flatnonzero(filled)
    if len(index) > MAX_CENTERS:
        raise MessageError(f"{len(index)} cells of a map are occupied; at most {MAX_CENTERS} are read")
    if not len(index):
        return []
    row, column = np.divmod(index, columns)
    centers = np.column_stack(((column + 0.5) * cell, (row + 0.5) * cell, np.zeros(len(index))))
    quat = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    return [Voxels(centers, (cell, cell, WALL_HEIGHT), at=(x, y, 0.5 * WALL_HEIGHT), quat=quat, name=name)]


def path_of(message: RosObject, frame: str = "") -> Array:
    """Waypoints (K, 3) x, y [m], yaw [rad] of a ``Path``.

    Raises:
        MessageError: another frame, fewer than two poses, or one that cannot be used.
    """
    check_frame(message, frame)
    if len(message.poses) < 2:
        raise MessageError(f"a path has {len(message.poses)} poses; at least 2 are needed")
    return np.array([planar_pose(pose.pose) for pose in message.poses])


# and back


def fill_stamp(stamp: RosObject, time: int) -> None:
    """Write whole nanoseconds into a ``builtin_interfaces/Time`` or ``Duration``."""
    stamp.sec, stamp.nanosec = divmod(time, 1_000_000_000)


def fill_twist(twist: RosObject, velocity: ArrayLike) -> None:
    """Write a planar velocity x, y [m/s], yaw [rad/s] into a ``geometry_msgs/Twist``."""
    x, y, turn = (float(value) for value in np.asarray(velocity, dtype=float))
    twist.linear.x, twist.linear.y, twist.angular.z = x, y, turn


def twist_of(twist: RosObject) -> Array:
    """(3,) planar velocity of a ``geometry_msgs/Twist``.

    Raises:
        MessageError: it is not finite.
    """
    found = np.array([float(twist.linear.x), float(twist.linear.y), float(twist.angular.z)])
    if not np.isfinite(found).all():
        raise MessageError(f"a velocity is not finite: {found}")
    return found


def fill_pose(pose: RosObject, place: ArrayLike) -> None:
    """Write x, y [m], yaw [rad] into a ``geometry_msgs/Pose``."""
    x, y, yaw = (float(value) for value in np.asarray(place, dtype=float))
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)


class TrajectoryPoint(NamedTuple):
    """A point of a ``JointTrajectory``: its time from the start [s], positions and velocities (n,)."""

    time: float
    positions: Array
    velocities: Array


def ending_at_rest(q: Array, rates: Array, acceleration: Array, hold: float) -> list[TrajectoryPoint]:
    """Go on at ``rates`` for ``hold`` [s], and come to rest: an arm whose commands stop coming stops by itself.

    Args:
        q: (n,) positions at its start [rad or m].
        rates: (n,) wanted speeds.
        acceleration: (n,) with which the joints may brake; all of them end at the same time.
        hold: how long the speeds last [s].
    """
    reached = q + rates * hold
    brake = max(float(np.max(np.abs(rates) / acceleration, initial=0.0)), 0.01)
    return [
        TrajectoryPoint(hold, reached, np.array(rates)),
        TrajectoryPoint(hold + brake, reached + 0.5 * rates * brake, np.zeros_like(rates)),
    ]


def fill_trajectory(
    message: RosObject, make_point: Callable[[], RosObject], names: Iterable[str], points: Iterable[TrajectoryPoint]
) -> None:
    """Write points into a ``JointTrajectory``, whose own are made by ``make_point``. It starts when it arrives."""
    message.joint_names = list(names)
    for time, positions, velocities in points:
        point = make_point()
        fill_stamp(point.time_from_start, round(1e9 * time))
        point.positions, point.velocities = positions.tolist(), velocities.tolist()
        message.points.append(point)


def fill_polygon(polygon: RosObject, make_point: Callable[[], RosObject], corners: ArrayLike) -> None:
    """Write corners (K, 2) [m] into a ``geometry_msgs/Polygon``, whose own points are made by ``make_point``."""
    for x, y in np.asarray(corners, dtype=float).tolist():
        point = make_point()
        point.x, point.y = x, y
        polygon.points.append(point)


def fill_path(path: RosObject, make_pose: Callable[[], RosObject], places: ArrayLike, frame: str, time: int) -> None:
    """Write places (K, 3) into a ``Path`` whose ``PoseStamped`` are made by ``make_pose``; stamped [ns], in a frame."""
    path.header.frame_id = frame
    fill_stamp(path.header.stamp, time)
    for place in np.asarray(places, dtype=float):
        pose = make_pose()
        pose.header.frame_id = frame
        fill_stamp(pose.header.stamp, time)
        fill_pose(pose.pose, place)
        path.poses.append(pose)


def fill_status(
    status: RosObject,
    make_value: Callable[[], RosObject],
    name: str,
    trouble: str,
    said: str,
    values: dict[str, object],
) -> None:
    """Write a ``DiagnosticStatus``: a warning where there is trouble. ``make_value`` makes a ``KeyValue``."""
    level = _WARN if trouble else _OK
    status.name, status.message = name, trouble or said
    status.level = bytes([level])  # rclpy's byte
    for key, value in values.items():
        entry = make_value()
        entry.key, entry.value = key, str(value)
        status.values.append(entry)
