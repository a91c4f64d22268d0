"""Planar footprint: a robot seen from above, as boxes and as discs about its base."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import support, support_points
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.work import count_work

from .model import RobotModel

DIRECTIONS = 32
"""Number of half planes that bound an outline, which is at most 0.5 % of its radius too large."""
_UP_DOWN = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])


_POINTS: WeakKeyDictionary[RobotModel, list[tuple[Array, float]]] = WeakKeyDictionary()
"""For each body of each robot: points and a radius whose sphere-swept hull contains it."""
_OUTLINES: WeakKeyDictionary[RobotModel, dict[bytes, Array]] = WeakKeyDictionary()
"""For each robot in its last postures: how far each body reaches, as `PlanarFootprint.outlines` gives it."""
_POSTURES_KEPT = 64  # that are kept of a robot


class PlanarFootprint(OneThread):
    """Workspace: a robot seen from above in one posture of its joints, in the frame of its base.

    There are two descriptions. The *boxes* hold each body, and round bodies as the polygons about them: they are for
    separations from obstacles. The *discs* follow the bodies' exact outlines: a grid closes cells by them, and polygons
    would close doors that the robot fits through.

    Args:
        robot: the robot; it is in its home posture at first.
    """

    def __init__(self, robot: RobotModel) -> None:
        count_work(batches=1)
        self._robot = robot
        self._buffers: tuple[pin.Data, pin.GeometryData] | None = None  # slow to make, and seldom needed
        points = _POINTS.get(robot)
        if points is None:
            points = _POINTS[robot] = [support_points(piece.geometry) for piece in robot.geometries]
        self._points = points
        self._posture: Array | None = None
        self._place(robot.home_q.copy())

    @staticmethod
    def of(robot: RobotModel, q: Array) -> PlanarFootprint:
        """The footprint in the posture of the configuration ``q`` (nq,)."""
        footprint = PlanarFootprint(robot)
        footprint._place(q.copy())
        return footprint

    @exclusive
    def update(self, coordinates: Array) -> None:
        """Take the posture of the joints from coordinates (nv,)."""
        row = np.array(coordinates, dtype=float)
        row[: self._robot.space.base_nv] = 0.0
        if self._posture is None or not np.array_equal(row, self._posture):
            self._place(self._robot.space.from_coordinates(row))
            self._posture = row

    def _place(self, q: Array) -> None:
        if self._robot.space.planar:
            q[:4] = 0.0, 0.0, 1.0, 0.0
        self._q: Array = q
        self._boxes: tuple[Array, Array, Array, Array] | None = None

    def _poses(self) -> list[pin.SE3]:
        robot = self._robot
        if self._buffers is None:
            self._buffers = robot.model.createData(), robot.collision_model.createData()
        data, placed = self._buffers
        pin.updateGeometryPlacements(robot.model, data, robot.collision_model, placed, self._q)
        return list(placed.oMg)

    @exclusive
    def boxes(self) -> tuple[Array, Array, Array, Array]:
        """Centres and half sizes (K, 2), lowest and highest points (K,) of the boxes [m], less those within others."""
        if self._boxes is None:
            index = np.arange(len(self._points))
            boxes = np.empty((len(index), 2, 3))
            for k, ((points, radius), pose) in enumerate(zip(self._points, self._poses(), strict=True)):
                placed = points @ pose.rotation.T + pose.translation
                boxes[k] = placed.min(axis=0) - radius, placed.max(axis=0) + radius
            inside = (boxes[:, None, 0] >= boxes[None, :, 0]).all(axis=2)
            inside &= (boxes[:, None, 1] <= boxes[None, :, 1]).all(axis=2) & ~np.eye(len(index), dtype=bool)
            boxes = boxes[~(inside & ~(inside.T & (index[:, None] < index))).any(axis=1)]
            middle, half = boxes.mean(axis=1)[:, :2].copy(), 0.5 * (boxes[:, 1, :2] - boxes[:, 0, :2])
            self._corner = np.hypot(*(np.abs(middle) + half).T)  # radii about the base's origin that hold them
            self._boxes = middle, half, boxes[:, 0, 2].copy(), boxes[:, 1, 2].copy()
        return self._boxes

    @property
    def middle(self) -> Array:
        """Centres (K, 2) of the boxes [m]."""
        return self.boxes()[0]

    @property
    def half(self) -> Array:
        """Half sizes (K, 2) of the boxes [m]."""
        return self.boxes()[1]

    @property
    def low(self) -> Array:
        """Lowest points (K,) of the boxes [m]."""
        return self.boxes()[2]

    @property
    def high(self) -> Array:
        """Highest points (K,) of the boxes [m]."""
        return self.boxes()[3]

    @property
    def inner(self) -> float:
        """Radius [m] of the largest disc about the base's origin within one of the bodies."""
        return self.inner_below(np.inf)

    def inner_below(self, height: float) -> float:
        """Radius [m] of the largest such disc within one of the bodies that reach below ``height`` [m]."""
        reach = self.outlines()
        at = -reach[:, DIRECTIONS + 1] < height
        return float(reach[at, :DIRECTIONS].min(axis=1).max(initial=0.0))

    @property
    def outer(self) -> float:
        """Radius [m] of a disc about the base's origin that holds the robot."""
        return float(self.outlines()[:, :DIRECTIONS].max(initial=0.0) / np.cos(np.pi / DIRECTIONS))

    @property
    def height(self) -> float:
        """Height of the highest point [m]."""
        return float(self.outlines()[:, DIRECTIONS].max(initial=0.0))

    def reach(self, low: float = -np.inf, high: float = np.inf) -> float:
        """Radius [m] about the base's origin of a disc that holds the boxes between two heights [m]."""
        at = (self.low <= high) & (self.high >= low)
        return float(self._corner[at].max(initial=0.0))

    def reaches(self, low: Array, high: Array) -> Array:
        """(M,) such radii [m] for several pairs of heights (M,) [m]."""
        at = (self.low <= high[:, None]) & (self.high >= low[:, None])
        return np.where(at, self._corner, 0.0).max(axis=1, initial=0.0)

    @exclusive
    def outlines(self) -> Array:
        """How far [m] each body reaches from the base's origin: (bodies, DIRECTIONS + 2) all around, up, and down."""
        known = _OUTLINES.setdefault(self._robot, {})
        key = self._q.tobytes()
        reach = known.get(key)
        if reach is None:
            along = np.vstack((outline_directions(), _UP_DOWN))
            reach = np.array(
                [
                    support(piece.geometry, along @ pose.rotation) + along @ pose.translation
                    for piece, pose in zip(self._robot.geometries, self._poses(), strict=True)
                ]
            ).reshape(-1, DIRECTIONS + 2)
            if len(known) >= _POSTURES_KEPT:
                known.clear()
            known[key] = reach
        return reach


def outline_directions() -> Array:
    """(DIRECTIONS, 3) horizontal unit vectors all around."""
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return np.column_stack((np.cos(angle), np.sin(angle), np.zeros(DIRECTIONS)))


def box_distance(x: Array, y: Array, a: Array | float, b: Array | float) -> Array:
    """Signed distances [m] of points (x, y) from rectangles of half sizes a, b about the origin."""
    x, y = np.abs(x) - a, np.abs(y) - b
    outside = np.sqrt(np.square(np.maximum(x, 0.0)) + np.square(np.maximum(y, 0.0)))
    return outside + np.minimum(np.maximum(x, y), 0.0)
