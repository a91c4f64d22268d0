"""Markers: the strip, the motion ahead and what is around, as lines and boxes; any object with a marker's fields does.

Nothing here needs rclpy. A marker's number is its place in its namespace, so that the next ones take its place.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.scene import Scene
from elastic_strips.scene.obstacle import UNSEEN_LAYER
from elastic_strips.scene.quantities import quaternion_of

from .messages import RosObject, fill_stamp

_CUBE, _LINE_STRIP, _ADD = 1, 4, 0  # of visualization_msgs/Marker
_LIFETIME = 600_000_000  # [ns] three times as long as it takes until the next ones come
_FLOOR = 0.02  # [m] lines of the base are drawn above it
_THIN, _THICK = 0.02, 0.05  # [m] lines of the strip, and of the motion
_FAR = 5.0  # [m] from the base, beyond which nothing is shown
_MOST_BOXES = 200
Colour = tuple[float, float, float, float]
_GREEN: Colour = (0.1, 0.7, 0.2, 1.0)
_RED: Colour = (0.9, 0.1, 0.1, 1.0)
_BLUE: Colour = (0.1, 0.3, 0.9, 1.0)
_BOX: Colour = (0.9, 0.6, 0.2, 0.5)
_UNSEEN: Colour = (0.5, 0.5, 0.5, 0.2)
_IN_THE_WAY: Colour = (0.9, 0.1, 0.1, 0.7)


class Line(NamedTuple):
    """A line through points (K, 3) [m], K ≥ 2, in the world."""

    namespace: str
    points: Array
    width: float
    colour: Colour


class NearBox(NamedTuple):
    """A box about a part of an obstacle, or one of its boxes.

    Attributes:
        name: of the obstacle.
        center: (3,) its centre [m], in the world.
        quat: unit quaternion x, y, z, w.
        size: (3,) full lengths [m].
    """

    name: str
    center: Array
    quat: Array
    size: Array


def boxes_near(scene: Scene, place: Array, *, far: float = _FAR, most: int = _MOST_BOXES) -> list[NearBox]:
    """Boxes about what is within ``far`` [m] of a place (2,); of more than ``most`` those that are nearest.

    They are in the order of the scene.
    """
    table, names = scene.table, scene.names
    if not len(table):
        return []
    gap = _gap(table.center, table.half_extents, place)
    found: list[tuple[float, int, int, NearBox]] = []
    gaps: list[float] = []  # of what was found, the nearest first
    for row in np.argsort(gap, kind="stable").tolist():
        if gap[row] > far or (len(gaps) >= most and gap[row] > gaps[most - 1]):
            break
        k = int(table.obstacle_index[row])
        quat, boxes = quaternion_of(table.rotation[row]), table.parts[row].boxes
        centers, halves, each = table.center[row : row + 1], table.local_half[row : row + 1], gap[row : row + 1]
        if boxes:
            pose = scene.obstacles[k].pose
            centers = np.array([at for _, at in boxes]) @ pose[:3, :3].T + pose[:3, 3]
            halves = np.array([box.halfSide for box, _ in boxes])
            each = _gap(centers, halves @ np.abs(pose[:3, :3]).T, place)
        for i in np.flatnonzero(each <= far).tolist():
            found.append((float(each[i]), row, i, NearBox(names[k], centers[i], quat, 2.0 * halves[i])))
            insort(gaps, float(each[i]))
    nearest = sorted(found, key=lambda one: one[:3])[:most]
    return [box for *_, box in sorted(nearest, key=lambda one: one[1:3])]


def _gap(centers: Array, half: Array, place: Array) -> Array:
    """(P,) horizontal distance [m] of a place (2,) from upright boxes."""
    return np.hypot(*np.maximum(np.abs(centers[:, :2] - place) - half[:, :2], 0.0).T)


def hand_places(robot: RobotModel, rows: Array, frame: str | None = None) -> Array:
    """(N, 3) where a frame of the robot is [m] in coordinate rows (N, nv); None: its last control point."""
    found = None if frame is None else find_frame(robot.model, frame)
    if found is None:
        points = robot.control_point_set
        joint, local = int(points.joint[-1]), points.local[-1]
    else:
        placed = robot.model.frames[found]
        joint, local = int(placed.parentJoint), placed.placement.translation
    data, places = robot.model.createData(), np.empty((len(rows), 3))
    for k, q in enumerate(robot.space.from_coordinates(rows)):
        pin.forwardKinematics(robot.model, data, q)
        places[k] = data.oMi[joint].act(local)
    return places


class Lines:
    """The lines of base and hand.

    Args:
        robot: the robot.
        hand: frame of its hand; None: its last control point.
    """

    def __init__(self, robot: RobotModel, hand: str | None = None) -> None:
        self._robot, self._hand = robot, hand

    def strip(self, rows: Array, *, certified: bool) -> list[Line]:
        """Of a strip's coordinate rows (N, nv): green where it is certified, red where it is not."""
        return self._through("strip", rows, _THIN, _GREEN if certified else _RED)

    def motion(self, rows: Array) -> list[Line]:
        """Of the motion (N, nv) that the robot is on, which is certified down to its end."""
        return self._through("motion", rows, _THICK, _BLUE)

    def _through(self, name: str, rows: Array, width: float, colour: Colour) -> list[Line]:
        if len(rows) < 2:
            return []
        lines = [Line(f"{name}_hand", hand_places(self._robot, rows, self._hand), width, colour)]
        if self._robot.space.planar:
            base = np.column_stack([rows[:, :2], np.full(len(rows), _FLOOR)])
            lines.insert(0, Line(f"{name}_base", base, width, colour))
        return lines


def colour_of(name: str, in_the_way: str) -> Colour:
    """Of an obstacle: red for the one that is in the way, grey for what was not seen."""
    if name == in_the_way:
        return _IN_THE_WAY
    return _UNSEEN if name.startswith(f"{UNSEEN_LAYER}-") else _BOX


def fill_markers(
    message: RosObject,
    make: tuple[Callable[[], RosObject], Callable[[], RosObject]],
    lines: Sequence[Line],
    boxes: Sequence[NearBox],
    in_the_way: str,
    frame: str,
    time: int,
) -> None:
    """Write lines and boxes into a ``MarkerArray``.

    Args:
        message: the array.
        make: what make a ``Marker`` and a ``Point``.
        lines, boxes: what is shown.
        in_the_way: name of the obstacle that is.
        frame: their frame.
        time: of now [ns].
    """
    make_marker, make_point = make

    def marker(namespace: str, number: int, kind: int, colour: Colour) -> RosObject:
        one = make_marker()
        one.header.frame_id = frame
        fill_stamp(one.header.stamp, time)
        one.ns, one.id, one.type, one.action = namespace, number, kind, _ADD
        one.color.r, one.color.g, one.color.b, one.color.a = colour
        fill_stamp(one.lifetime, _LIFETIME)
        one.pose.orientation.w = 1.0
        message.markers.append(one)
        return one

    for line in lines:
        one = marker(line.namespace, 0, _LINE_STRIP, line.colour)
        one.scale.x = line.width
        for x, y, z in line.points.tolist():
            point = make_point()
            point.x, point.y, point.z = x, y, z
            one.points.append(point)
    for number, box in enumerate(boxes):
        one = marker("obstacles", number, _CUBE, colour_of(box.name, in_the_way))
        at, turn = one.pose.position, one.pose.orientation
        at.x, at.y, at.z = box.center.tolist()
        turn.x, turn.y, turn.z, turn.w = box.quat.tolist()
        one.scale.x, one.scale.y, one.scale.z = box.size.tolist()
