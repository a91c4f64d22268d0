"""Planar footprint: a robot seen from above, as boxes, as discs about its base, and as a polygon that holds it."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.coal_shapes import support, support_points, supports
from elastic_strips.errors import RobotError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.work import count_work

from .model import RobotModel

DIRECTIONS = 32
"""Number of half planes that bound an outline, which is at most 0.5 % of its radius too large."""
_SIDES = 256  # directions in which a polygon may have a side
_SPARED = 2e-5  # of its area, for which a side is left out
_WIDEST = 2.4  # [rad] between the normals of two sides that meet
_FEWEST_SIDES = 6
_BEND = 1e-3  # [m] by which points may leave the straight line from one posture to the next
_ROUNDING = 1e-6  # [m] by which a polygon is larger: a message rounds its corners to 1e-7 of where they are
_AXES = np.vstack((np.eye(3), -np.eye(3)))
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


def footprint_polygon(robot: RobotModel, rows: ArrayLike, *, place: ArrayLike | None = None) -> Array:
    """A convex polygon that holds the robot, seen from above, with its arm and what that carries.

    It holds every point of the robot in one posture, or on the way along several: from each to the next all coordinates
    go at constant rates, as :meth:`.ConfigurationSpace.interpolate` has them. Its area is that of the points' convex
    hull and about 1 % more at most; on a way, 1 mm all around besides.

    Args:
        robot: the robot; `RobotModel.attached` makes the one that carries something.
        rows: (nv,) or (K, nv) coordinate rows.
        place: (3,) x, y [m], yaw [rad] of the frame of the corners; the base in the first row where None.

    Returns:
        (M, 2) corners [m], counterclockwise.

    Raises:
        RobotError: no rows, or not the robot's.
    """
    space = robot.space
    given = np.atleast_2d(np.array(rows, dtype=float))
    if given.ndim != 2 or given.shape[1] != space.nv or not len(given) or not np.isfinite(given).all():
        raise RobotError(f"rows of shape {np.shape(rows)}: finite coordinates (K, {space.nv}) are needed")
    way, pad = _divided(robot, given)
    if place is None:
        place = given[0, :3] if space.planar else np.zeros(3)
    x, y, yaw = (float(value) for value in np.asarray(place, dtype=float))
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    along = np.column_stack((np.cos(angle + yaw), np.sin(angle + yaw), np.zeros(_SIDES)))
    reach = np.full(_SIDES, -np.inf)
    data, placed = robot.model.createData(), robot.collision_model.createData()
    geometries = [piece.geometry for piece in robot.geometries]
    for q in space.from_coordinates(way):
        pin.updateGeometryPlacements(robot.model, data, robot.collision_model, placed, q)
        rotation = np.array([pose.rotation for pose in placed.oMg])
        translation = np.array([pose.translation for pose in placed.oMg])
        here = supports(geometries, along @ rotation) + translation @ along.T
        np.maximum(reach, here.max(axis=0), out=reach)
    reach += pad + _ROUNDING - along[:, :2] @ (x, y)
    return _corners(angle, reach)


def _corners(angle: Array, reach: Array) -> Array:
    """(M, 2) corners of the area within half planes, whose normals turn once around and which all touch it; without
    those that hardly cut anything off."""
    corner = _met(angle, reach, np.roll(angle, -1), np.roll(reach, -1))
    x, y = corner.T
    spared = _SPARED * 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
    while True:
        before = np.roll(corner, 1, axis=0)  # each side goes from there to its own corner
        tip = _met(np.roll(angle, 1), np.roll(reach, 1), np.roll(angle, -1), np.roll(reach, -1))
        (ax, ay), (bx, by) = (tip - before).T, (corner - before).T
        cut = 0.5 * np.abs(ax * by - ay * bx)
        cut[np.mod(np.roll(angle, -1) - np.roll(angle, 1), 2.0 * np.pi) > _WIDEST] = np.inf
        least = np.minimum(np.roll(cut, 1), np.roll(cut, -1))
        first = np.arange(len(cut)) % 2 == 0
        drop = (cut < spared) & ((cut < least) | ((cut == least) & first))
        drop &= ~np.roll(drop, 1)  # of two neighbours one stays
        if not drop.any() or len(cut) - np.count_nonzero(drop) < _FEWEST_SIDES:
            return corner
        angle, reach = angle[~drop], reach[~drop]
        corner = _met(angle, reach, np.roll(angle, -1), np.roll(reach, -1))


def _met(angle: Array, reach: Array, other: Array, further: Array) -> Array:
    """(M, 2) where lines meet that are so far from the origin along directions."""
    turn = other - angle
    out = (further - reach * np.cos(turn)) / np.sin(turn)  # along the line
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack((reach * c - out * s, reach * s + out * c))


def _divided(robot: RobotModel, rows: Array) -> tuple[Array, float]:
    """A way along rows (K, nv) in steps so small that no point is further than a length [m] from the straight line
    between where it is at both ends of its step; and that length.

    A point's acceleration along a step is at most ω² r + 2 ω v, of the turns ω and slides v of all joints that move it
    and of the length r of the chain to it, and it leaves the line by an eighth of that.
    """
    if len(rows) == 1:
        return rows, 0.0
    tree, space = robot.tree, robot.space
    steps = np.abs(space.difference(rows[:-1], rows[1:]))[:, tree.coordinate] * np.abs(tree.rate)
    slides = np.zeros(steps.shape[1], dtype=bool)
    slides[: 2 * space.planar] = True
    slides[tree.motion[tree.prismatic]] = True
    most = np.zeros(len(steps))
    for piece in robot.geometries:
        moves = tree.support[piece.joint]
        turn, slide = steps[:, moves & ~slides].sum(axis=1), steps[:, moves & slides].sum(axis=1)
        length = float(np.linalg.norm(piece.placement[:3, 3])) + _farthest(piece.geometry)
        joint = piece.joint
        while joint > space.planar:
            length += float(np.linalg.norm(tree.offset[joint][:3, 3]))
            if tree.prismatic[joint]:
                m = tree.motion[joint]
                length += float(np.abs(tree.rate[m] * rows[:, tree.coordinate[m]] + tree.shift[m]).max())
            joint = int(tree.parents[joint])
        np.maximum(most, 0.125 * turn * (turn * length + 2.0 * slide), out=most)
    parts = np.maximum(np.ceil(np.sqrt(most / _BEND)), 1.0).astype(int)
    way = [rows[:1]]
    for a, b, n in zip(rows[:-1], rows[1:], parts.tolist(), strict=True):
        way.append(np.array([space.interpolate(a, b, k / n) for k in range(1, n + 1)]))
    return np.concatenate(way), float((most / np.square(parts)).max())


def _farthest(geometry: coal.CollisionGeometry) -> float:
    """A distance [m] that no point of a shape exceeds, from the origin of its frame."""
    return float(np.sqrt(3.0)) * max(0.0, float(support(geometry, _AXES).max()))
