"""Scene room, obstacles: immutable values of a solid, its pose, its motion and its name; and the shapes they have."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TypeVar

import coal
import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Document, Indices
from elastic_strips.decompose import convex_pieces, load_mesh
from elastic_strips.errors import SceneError
from elastic_strips.summary import shortened
from elastic_strips.validation import MAX_LENGTH, check_number, named_arguments, shown

from .motion import Motion, check_motion
from .parts import Part, Solid, cluster_solid, grid_solid, hull_part, primitive
from .quantities import (
    POSE_TOLERANCE,
    check_length,
    check_points,
    check_pose,
    check_sizes,
    check_time,
    pose_of,
)

UNSEEN_LAYER = "unseen"
"""Names of obstacles that stand for what no sensor has seen begin with this and a hyphen."""
LOST_LAYER = f"{UNSEEN_LAYER}-track"
"""The same of those of them that stand for where a mover may be that nothing sees."""
STOOD_LAYER = f"{UNSEEN_LAYER}-stood"
"""The same of those of them that stand for what stood where things move, and may have gone since it was seen."""

_Self = TypeVar("_Self", bound="Obstacle")


class Obstacle:
    """A rigid solid obstacle in the world; make one by `Box`, `Sphere`, … (each of them is an `Obstacle`).

    Sizes of the shapes are full lengths [m]. All shapes take these keywords:

    Args:
        at: Position (3,) of the obstacle's origin [m], world frame.
        quat: Its unit quaternion (x, y, z, w), world frame.
        name: Unique in a scene, which names obstacles that have no name.
        motion: How it moves; None where it does not.
        time: Time [s] at which it is at ``at``, where it moves: for what is measured, that at which it was seen. A
            scene takes it on from there to its own time.

    Attributes:
        name: Name, or None as long as no scene has named it.
        shape: "box", "sphere", "cylinder", "capsule", "cone", "convex", "mesh", "voxels" or "points".
        pose: Pose T_world_obstacle (4, 4) at `time` [m], read-only.
        motion: How the obstacle moves; None if it does not.
        time: Time [s] that `pose` belongs to.
        anchor: Pose (4, 4) at `anchor_time`, from which `motion` starts.
        anchor_time: Time [s]; 0 unless another ``time`` was given, or the obstacle was `moved` at one.
        solid: Parts and bounds in the obstacle's frame, shared by all copies.
        spec: Parameters of the shape, such as {"radius": 0.2}; not to be changed.
    """

    __slots__ = ("_named", "anchor", "anchor_time", "motion", "name", "pose", "shape", "solid", "spec", "time")

    name: str | None
    shape: str
    pose: Array
    motion: Motion | None
    time: float
    anchor: Array
    anchor_time: float
    solid: Solid
    spec: Document
    _named: Obstacle | None  # its last copy with a name: scenes that are made of the same obstacles name them alike

    def _fill(
        self,
        shape: str,
        spec: Document,
        solid: Solid,
        at: ArrayLike,
        quat: ArrayLike,
        name: str | None,
        motion: Motion | None,
        time: float,
    ) -> None:
        anchor, time = pose_of(at, quat), check_time("time", time)
        _put(self, shape=shape, spec=spec, solid=solid, name=check_name(name), motion=check_motion(motion))
        if motion is None:
            time = 0.0  # of no time in particular
        elif time != 0.0 and not motion.relative:
            raise SceneError(f"time is {time:g} s, but a motion by {type(motion).__name__} has times of its own")
        pose = _pose_at(motion, anchor, 0.0)
        if motion is not None and not motion.relative:
            _check_agreement(anchor, pose)
        _put(self, pose=pose, time=time, anchor=anchor, anchor_time=time, _named=None)

    def _copy(self: _Self, **changes: object) -> _Self:
        new = object.__new__(type(self))
        _put(new, **self._values() | changes)
        return new

    def _values(self) -> Document:
        """What a copy has as well."""
        values: Document = {key: getattr(self, key) for key in Obstacle.__slots__}
        return values | {"_named": None}

    @property
    def parts(self) -> tuple[Part, ...]:
        """The convex parts in the obstacle's frame; the same objects in all copies of the obstacle."""
        return self.solid.parts

    @property
    def reach(self) -> float:
        """Radius [m] of a sphere about the obstacle's origin that holds the obstacle."""
        return self.solid.reach

    def speed_bound(self, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of any point of the obstacle between ``start`` and ``end`` [s] (None: for ever)."""
        if self.motion is None:
            return 0.0
        shift = self._origin_time()
        return self.motion.speed_bound(
            self.reach, start=None if start is None else start - shift, end=None if end is None else end - shift
        )

    def velocity(self) -> tuple[Array, Array]:
        """Velocity of the origin (3,) [m/s] and angular velocity (3,) [rad/s] at `time`, world frame."""
        if self.motion is None:
            return np.zeros(3), np.zeros(3)
        return self.motion.velocity(self.anchor, self.time - self._origin_time())

    def moved(self: _Self, pose: object, *, time: float | None = None) -> _Self:
        """Copy at ``pose`` (4, 4) (or a ``pin.SE3``) [m] now, sharing the parts; a twist goes on from there.

        `Keyframes` are absolute: the copy is back on its track at the next `at`. ``time`` [s] is the copy's, which is
        the obstacle's own where None.
        """
        pose, time = check_pose(pose), self.time if time is None else time
        return self._copy(pose=pose, time=time, anchor=pose, anchor_time=time)

    def observed(self: _Self, pose: Array, motion: Motion | None) -> _Self:
        """Copy as a sensor sees it: now at ``pose`` (4, 4) [m], and moving from there by ``motion``.

        It shares the parts; ``pose`` and ``motion`` are not checked.
        """
        return self._copy(pose=pose, anchor=pose, anchor_time=self.time, motion=motion)

    def at(self: _Self, t: float) -> _Self:
        """Copy at its pose at time ``t`` [s], or itself if it does not move."""
        t = check_time("time", t)
        if self.motion is None or self.motion.still or t == self.time:
            return self
        pose = _pose_at(self.motion, self.anchor, t - self._origin_time())
        return self._copy(pose=pose, time=t)

    def named(self: _Self, name: str) -> _Self:
        """Copy with another name; the same copy as the last time where that had this name.

        Raises:
            SceneError: None, empty, not printable, or longer than 200 characters.
        """
        if check_name(name) is None:
            raise SceneError("name must be a non-empty printable string, not None")
        known = self._named
        if known is None or known.name != name:
            known = self._copy(name=name)
            _put(self, _named=known)
        return known  # type: ignore[return-value]

    def _origin_time(self) -> float:
        """Time [s] at which the motion's own clock is zero."""
        return self.anchor_time if self.motion is None or self.motion.relative else 0.0

    def __repr__(self) -> str:
        values = ", ".join(
            f"{k}={v.tolist() if v.size <= 4 else f'<{len(v)} rows>'}" if isinstance(v, np.ndarray) else f"{k}={v!r}"
            for k, v in self.spec.items()
        )
        moving = "" if self.motion is None else f", motion={type(self.motion).__name__}"
        at = [round(x, 6) for x in self.pose[:3, 3].tolist()]
        return f"{type(self).__name__}({shortened(f'{values}, at={at}, name={self.name!r}{moving}')})"

    def __setattr__(self, key: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable; {key!r} cannot be set. Use moved, at or named")

    def __delattr__(self, key: str) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable; {key!r} cannot be deleted")

    def __reduce__(self) -> tuple[object, ...]:
        return _restored, (type(self), self._values())


class Box(Obstacle):
    """A box.

    Args:
        size: Full lengths (3,) along its x, y, z axes [m].
        at, quat, name, motion, time: See `Obstacle`.

    Examples:
        >>> shelf = es.Box((0.6, 0.3, 1.4), at=(1.5, 0.1, 0.7), name="shelf")
        >>> across = es.Box((0.6, 0.3, 1.4), at=(1.5, 0.1, 0.7), quat=(0.0, 0.0, 2**-0.5, 2**-0.5))  # turned by 90°
    """

    __slots__ = ()

    @named_arguments
    def __init__(
        self,
        size: ArrayLike,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> None:
        lengths = check_sizes("Box size", size, 3)
        half = 0.5 * lengths
        solid = primitive(coal.Box(*lengths.tolist()), half, float(np.linalg.norm(half)))
        self._fill("box", {"size": lengths}, solid, at, quat, name, motion, time)


class Sphere(Obstacle):
    """A sphere.

    Args:
        radius: Radius [m].
        at, quat, name, motion, time: See `Obstacle`.

    Examples:
        >>> lamp = es.Sphere(0.25, at=(2.4, 0.8, 1.0), name="lamp")
    """

    __slots__ = ()

    @named_arguments
    def __init__(
        self,
        radius: float,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> None:
        r = check_length("Sphere radius", radius)
        self._fill("sphere", {"radius": r}, primitive(coal.Sphere(r), (r, r, r), r), at, quat, name, motion, time)


class _Round(Obstacle):
    """A solid that is round about its z axis, of a radius and a length."""

    __slots__ = ()
    _form: type[coal.CollisionGeometry]
    _caps = False  # whether half spheres add to the length

    @named_arguments
    def __init__(
        self,
        radius: float,
        length: float,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> None:
        kind = self._form.__name__
        r, z = check_length(f"{kind} radius", radius), check_length(f"{kind} length", length)
        half = 0.5 * z + r if self._caps else 0.5 * z
        solid = primitive(self._form(r, z), (r, r, half), half if self._caps else math.hypot(r, half))
        self._fill(kind.lower(), {"radius": r, "length": z}, solid, at, quat, name, motion, time)


class Cylinder(_Round):
    """A cylinder about its z axis; the origin is at half its length.

    Args:
        radius: Radius [m].
        length: Full length along z [m].
        at, quat, name, motion, time: See `Obstacle`.

    Examples:
        >>> pillar = es.Cylinder(0.15, 2.0, at=(1.0, 0.5, 1.0), name="pillar")  # it stands on the floor
    """

    __slots__ = ()
    _form = coal.Cylinder


class Capsule(_Round):
    """A capsule about its z axis; the origin is at its centre.

    Args:
        radius: Radius [m].
        length: Length [m] of the cylindrical part along z, without the two half spheres.
        at, quat, name, motion, time: See `Obstacle`.

    Examples:
        >>> person = es.Capsule(0.25, 1.2, at=(2.0, -2.0, 0.85), name="person")  # 1.7 m high in all
    """

    __slots__ = ()
    _form = coal.Capsule
    _caps = True


class Cone(_Round):
    """A cone about its z axis, apex at +z; the origin is at half its height.

    Args:
        radius: Radius of the base [m].
        length: Height [m].
        at, quat, name, motion, time: See `Obstacle`.
    """

    __slots__ = ()
    _form = coal.Cone


class ConvexHull(Obstacle):
    """The convex hull of points.

    Args:
        vertices: Points (V, 3) [m] in the obstacle's frame, at least four, not in one plane.
        at, quat, name, motion, time: See `Obstacle`.
    """

    __slots__ = ()

    @named_arguments
    def __init__(
        self,
        vertices: ArrayLike,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> None:
        points = check_points("ConvexHull vertices", vertices, (None, 3))
        solid = Solid([hull_part(points, "ConvexHull vertices")])
        self._fill("convex", {"vertices": points}, solid, at, quat, name, motion, time)


class Mesh(Obstacle):
    """A solid triangle mesh, made of convex parts; see `elastic_strips.decompose` for how well they fit.

    Args:
        vertices: Vertices (V, 3) [m] in the obstacle's frame.
        faces: Triangles (F, 3), indices of vertices.
        at, quat, name, motion, time: See `Obstacle`.

    Examples:
        >>> corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
        >>> wedge = es.Mesh(corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], at=(2.0, 0.0, 0.0), name="wedge")
    """

    __slots__ = ()

    @named_arguments
    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> None:
        points = check_points("Mesh vertices", vertices, (None, 3))
        raw = check_points("Mesh faces", faces, (None, 3), limit=float(2**31))
        triangles = raw.astype(np.int64)
        if (triangles != raw).any() or triangles.min() < 0 or triangles.max() >= len(points):
            raise SceneError(
                f"Mesh faces must be integers in [0, {len(points) - 1}] (there are {len(points)} vertices); "
                f"they range from {raw.min():g} to {raw.max():g}"
            )
        triangles.flags.writeable = False
        solid = Solid([hull_part(piece, "Mesh piece") for piece in convex_pieces(points, triangles)])
        spec = {"vertices": points, "faces": triangles}
        self._fill("mesh", spec, solid, at, quat, name, motion, time)

    @classmethod
    def from_file(
        cls,
        path: str | os.PathLike[str],
        *,
        scale: float = 1.0,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> Mesh:
        """Read an STL, OBJ, PLY or DAE file.

        Args:
            path: The file.
            scale: Its numbers times this are metres.
            at, quat, name, motion, time: See `Obstacle`.

        Raises:
            SceneError: The file is missing, unreadable, empty, corrupt or of another kind.
        """
        factor = check_number("Mesh scale", scale, low=1e-9, high=1e9, error=SceneError)
        vertices, faces = load_mesh(Path(path))
        try:
            mesh = cls(vertices * factor, faces, at=at, quat=quat, name=name, motion=motion, time=time)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None
        mesh.spec.update(path=str(path), scale=factor)
        return mesh


class Voxels(Obstacle):
    """Equal axis-aligned boxes, such as the occupied cells of a grid map; merged into larger boxes where possible.

    Args:
        centers: Centres of the voxels (V, 3) [m] in the obstacle's frame.
        size: Edge of a voxel [m], or its lengths (3,) along x, y, z.
        at, quat, name, motion, time: See `Obstacle`.
    """

    __slots__ = ("_grid",)

    _grid: tuple[Indices, Indices, float, str]  # what it was made of, where it is as it was made by `of_boxes`

    @named_arguments
    def __init__(
        self,
        centers: ArrayLike,
        size: ArrayLike,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> None:
        points = check_points("Voxels centers", centers, (None, 3))
        edges = check_sizes("Voxels size", size, 3) if np.ndim(size) else np.full(3, check_length("Voxels size", size))
        edges.flags.writeable = False
        spec = {"centers": points, "size": edges}
        self._fill("voxels", spec, cluster_solid(points, edges), at, quat, name, motion, time)

    @classmethod
    def of_boxes(cls, low: Indices, high: Indices, cell: float, name: str) -> Voxels:
        """Voxels of a grid in the world that are merged already; all of them are one part.

        Args:
            low, high: (B, 3) first cell and the one after the last along each axis, of boxes that do not overlap.
            cell: edge of a voxel [m].
            name: name of the obstacle.
        """
        low, high = np.ascontiguousarray(low), np.ascontiguousarray(high)
        solid, centers = grid_solid(low, high, cell)
        edges = np.full(3, cell)
        edges.flags.writeable = False
        made = object.__new__(cls)
        _put(
            made,
            shape="voxels",
            spec={"centers": centers, "size": edges},
            solid=solid,
            name=check_name(name),
            motion=None,
            pose=_AT_ORIGIN,
            time=0.0,
            anchor=_AT_ORIGIN,
            anchor_time=0.0,
            _named=None,
            _grid=(low, high, cell, name),
        )
        return made

    def __reduce__(self) -> tuple[object, ...]:
        grid = getattr(self, "_grid", None)  # copies do not have it
        return super().__reduce__() if grid is None else (Voxels.of_boxes, grid)


class Points(Obstacle):
    """A point cloud; each point is a box of edge 2 ``radius``, which holds the ball of that radius.

    Args:
        points: Points (V, 3) [m] in the obstacle's frame.
        radius: Half the edge of a point's box [m].
        at, quat, name, motion, time: See `Obstacle`.
    """

    __slots__ = ()

    @named_arguments
    def __init__(
        self,
        points: ArrayLike,
        radius: float,
        *,
        at: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        name: str | None = None,
        motion: Motion | None = None,
        time: float = 0.0,
    ) -> None:
        cloud = check_points("Points points", points, (None, 3))
        r = check_length("Points radius", radius)
        solid = cluster_solid(cloud, np.full(3, 2.0 * r))
        self._fill("points", {"points": cloud, "radius": r}, solid, at, quat, name, motion, time)


_AT_ORIGIN = np.eye(4)
_AT_ORIGIN.flags.writeable = False


def check_name(value: object) -> str | None:
    """Check an obstacle's name: ``None`` or a non-empty printable string of at most 200 characters."""
    if value is None:
        return None
    if not isinstance(value, str) or not value.strip() or not value.isprintable() or len(value) > 200:
        raise SceneError(f"name must be a non-empty printable string of at most 200 characters, not {shown(value)}")
    return value


def _put(obstacle: Obstacle, **values: object) -> None:
    for key, value in values.items():
        object.__setattr__(obstacle, key, value)


def _restored(kind: type[Obstacle], state: Document) -> Obstacle:
    """Rebuild a pickled obstacle."""
    _freeze(state)
    new = object.__new__(kind)
    _put(new, **state)
    return new


def _pose_at(motion: Motion | None, anchor: Array, t: float) -> Array:
    if motion is None:
        return anchor
    pose = motion.pose(anchor, t)
    if not np.abs(pose[:3, 3]).max() <= MAX_LENGTH:
        raise SceneError(f"at t = {t:g} s a motion leads to {pose[:3, 3].tolist()}, beyond {MAX_LENGTH:g} m")
    pose.flags.writeable = False
    return pose


def _check_agreement(given: Array, begin: Array) -> None:
    """A motion with absolute poses says where the obstacle is: a pose that is given as well must not contradict it."""
    at, quat = given[:3, 3], given[:3, :3]
    if at.any() and np.abs(at - begin[:3, 3]).max() > POSE_TOLERANCE:
        where = begin[:3, 3].tolist()
        raise SceneError(f"at is {at.tolist()}, but the keyframes say {where} at time 0; with keyframes leave 'at' out")
    if not np.array_equal(quat, np.eye(3)) and np.abs(quat - begin[:3, :3]).max() > POSE_TOLERANCE:
        raise SceneError("quat contradicts the keyframes' quats at time 0; leave 'quat' out with keyframes' quats")


def _freeze(value: object) -> None:
    """Numpy pickles no read-only flag: set it again."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, dict):
        for entry in value.values():
            _freeze(entry)
