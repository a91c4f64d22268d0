"""IO room, obstacle documents: how obstacles, their motions and their convex pieces are written, and read again.

Scene files hold obstacles as they were made (`obstacle_entries`, `obstacle_from_node`). Results and records hold the
convex pieces that they consist of (`obstacle_documents`, `world_documents`, `world_from_documents`).
"""

from __future__ import annotations

import itertools
import logging
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypedDict

import coal
import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Document
from elastic_strips.coal_shapes import LONG_ROUND, ShapeKind, shape_of, vertices
from elastic_strips.errors import InputError, SceneError, nearest_name
from elastic_strips.scene import Box, Capsule, Cone, ConvexHull, Cylinder, Mesh, Points, Scene, Sphere, Voxels, World
from elastic_strips.scene.motion import MAX_SPEED, Keyframes, Motion, Twist, UnknownMotion
from elastic_strips.scene.obstacle import Obstacle, check_name
from elastic_strips.scene.quantities import (
    check_points,
    check_quaternion,
    check_sizes,
    quaternion_of,
)
from elastic_strips.validation import MAX_LENGTH, MIN_LENGTH

from .nodes import Node
from .point_cloud import LARGE_MESH, read_points, warn_of_units

MAX_ROWS = 4_000_000
"""Largest number of poses of moving pieces in a record's world: their number times the control rows."""

_log = logging.getLogger(__name__)
_COMMON = ("shape", "name", "at", "quat", "rpy", "motion", "appears", "vanishes")
_SIMPLE: dict[str, tuple[Callable[..., Obstacle], tuple[str, ...]]] = {
    "box": (Box, ("size",)),
    "sphere": (Sphere, ("radius",)),
    "cylinder": (Cylinder, ("radius", "length")),
    "capsule": (Capsule, ("radius", "length")),
    "cone": (Cone, ("radius", "length")),
    "convex": (ConvexHull, ("vertices",)),
}
"""Convex shape → its class, and the names of its arguments, which are the keys in a scene file."""

_KEYS: dict[str, tuple[str, ...]] = {
    **{shape: keys for shape, (_, keys) in _SIMPLE.items()},
    "mesh": ("file", "scale", "vertices", "faces"),
    "voxels": ("centers", "file", "size"),
    "points": ("points", "file", "radius"),
}


def obstacle_from_node(node: Node) -> Obstacle:
    """The obstacle that a mapping of a scene file describes; paths in it are relative to the node's own file.

    Raises:
        InputError: (of the type that the node's source raises) it does not fit; the message names file, line and key.
    """
    entries = node.mapping(what="an obstacle")
    if "shape" not in entries:
        node.fail(f"the key 'shape' is missing{nearest_name('', _KEYS)}")
    shape = entries["shape"].text(valid=_KEYS)
    node.mapping((*_COMMON, *_KEYS[shape]), what=f"a {shape}")
    common = _placement(entries)
    if shape in _SIMPLE:
        make, keys = _SIMPLE[shape]
        return node.checked(make, *(_READERS[key](_needed(node, entries, key)) for key in keys), **common)
    if shape == "mesh":
        return _mesh(node, entries, common)
    points = _cloud(_needed(node, entries, "centers" if shape == "voxels" else "points", "file"))
    if shape == "points":
        return node.checked(Points, points, _length(_needed(node, entries, "radius")), **common)
    edge = _needed(node, entries, "size")
    return node.checked(Voxels, points, (_size if isinstance(edge.value, list) else _length)(edge), **common)


def _placement(entries: dict[str, Node]) -> Document:
    """Keyword arguments that all shapes share."""
    common: Document = {}
    if "name" in entries:
        common["name"] = entries["name"].checked(check_name, entries["name"].text())
    if "at" in entries:
        common["at"] = entries["at"].checked(check_points, "at", entries["at"].vector(3), (3,))
    if "rpy" in entries and "quat" in entries:
        entries["rpy"].fail("the orientation is given twice: by 'rpy' and by 'quat'")
    if "quat" in entries:
        common["quat"] = entries["quat"].checked(check_quaternion, "the value", entries["quat"].vector(4))
    if "rpy" in entries:
        rpy = entries["rpy"].vector(3).tolist()
        warn_of_degrees(f"{entries['rpy'].source.path}: {entries['rpy'].key}", *rpy)
        common["quat"] = quaternion_of_rpy(*rpy)
    if "motion" in entries:
        common["motion"] = _motion(entries["motion"])
    return common


def _motion(node: Node) -> Motion:
    kinds = node.mapping(("twist", "keyframes", "unknown"), what="a motion")
    if len(kinds) != 1:
        node.fail(f"must hold one of 'twist', 'keyframes' and 'unknown', not {len(kinds)} keys")
    kind, inner = next(iter(kinds.items()))
    if kind == "unknown":
        entries = inner.mapping(("max_speed",), needed=("max_speed",), what="an unknown motion")
        return UnknownMotion(entries["max_speed"].number(low=0.0, high=MAX_SPEED, unit="m/s"))
    if kind == "twist":
        entries = inner.mapping(("linear", "angular"), what="a twist")
        return inner.checked(Twist, **{key: entry.vector(3) for key, entry in entries.items()})
    entries = inner.mapping(("times", "positions", "quats", "loop"), needed=("times", "positions"), what="keyframes")
    times, positions = entries["times"].vector(), entries["positions"].rows(3)
    quats = entries["quats"].rows(4) if "quats" in entries else None
    loop = entries["loop"].boolean() if "loop" in entries else False
    return inner.checked(Keyframes, times, positions, quats=quats, loop=loop)


def _motion_document(motion: Motion, name: str | None) -> Document:
    """What `_motion` reads."""
    if isinstance(motion, Twist):
        return {"twist": {"linear": motion.linear.tolist(), "angular": motion.angular.tolist()}}
    if isinstance(motion, UnknownMotion):
        return {"unknown": {"max_speed": motion.max_speed}}
    if isinstance(motion, Keyframes):
        entries = {"times": motion.times.tolist(), "positions": motion.positions.tolist()}
        if motion.quats is not None:
            entries["quats"] = motion.quats.tolist()
        return {"keyframes": {**entries, "loop": motion.loop}}
    raise SceneError(f"obstacle {name!r}: a motion of type {type(motion).__name__} cannot be written to a file")


def obstacle_entries(obstacle: Obstacle, folder: Path) -> Document:
    """The entry that `obstacle_from_node` reads, for a scene file in that folder.

    Twists are written with their pose at time 0. Meshes that came from a file are written as that file's relative path.

    Raises:
        SceneError: a motion that scene files cannot hold.
    """
    motion, pose = obstacle.motion, obstacle.pose
    spec = dict(obstacle.spec)
    if obstacle.shape == "mesh":
        origin, scale = spec.pop("path", None), spec.pop("scale", None)
        if isinstance(origin, str) and os.path.isfile(origin):
            spec = {"file": os.path.relpath(os.path.abspath(origin), os.path.abspath(folder)), "scale": scale}
    entries: Document = {"name": obstacle.name, "shape": obstacle.shape, **spec}
    if isinstance(motion, Twist):
        pose = motion.pose(obstacle.anchor, -obstacle.anchor_time)
    if motion is not None:
        entries["motion"] = _motion_document(motion, obstacle.name)
    if not isinstance(motion, Keyframes):
        entries["at"] = pose[:3, 3]
    if not (isinstance(motion, Keyframes) and motion.quats is not None):
        entries["quat"] = quaternion_of(pose[:3, :3])
    return entries


def _needed(node: Node, entries: dict[str, Node], *keys: str) -> Node:
    """The one entry of ``keys`` that is given."""
    given = [key for key in keys if key in entries]
    if len(given) != 1:
        names = " or ".join(repr(k) for k in keys)
        node.fail(f"the key {names} is missing" if not given else f"only one of {names} may be given")
    return entries[given[0]]


def _length(node: Node) -> float:
    return node.number(low=MIN_LENGTH, high=MAX_LENGTH)


def _size(node: Node) -> Array:
    return node.checked(check_sizes, "the value", node.vector(3), 3)


_READERS: dict[str, Callable[[Node], float | Array]] = {
    "size": _size,
    "radius": _length,
    "length": _length,
    "vertices": lambda node: node.rows(3),
}


def _mesh(node: Node, entries: dict[str, Node], common: Document) -> Obstacle:
    given = _needed(node, entries, "file", "vertices")
    if "file" in entries:
        if "faces" in entries:
            entries["faces"].fail("belongs to 'vertices', not to a mesh 'file'")
        scale = entries["scale"].number(low=1e-9, high=1e9, unit="") if "scale" in entries else 1.0
        mesh = given.checked(Mesh.from_file, _file(given), scale=scale, **common)
        warn_of_units(f"{_file(given)}", np.asarray(mesh.spec["vertices"], dtype=float), LARGE_MESH)
        return mesh
    if "scale" in entries:
        entries["scale"].fail("belongs to a mesh 'file', not to 'vertices'")
    faces = _needed(node, entries, "faces").rows(3)
    return node.checked(Mesh, given.rows(3), faces, **common)


def _cloud(node: Node) -> Array:
    """Points (n, 3) that are listed in the scene file, or that the file has which it names."""
    return node.rows(3) if isinstance(node.value, list) else node.checked(read_points, _file(node))


def _file(node: Node) -> Path:
    """Path that a node names, relative to the node's own file."""
    return node.source.path.parent / node.text()


def warn_of_degrees(what: str, *angles: float) -> None:
    """Say in the log that one of the angles [rad] of a pose is more than a turn: it may well be in degrees."""
    most = max(angles, key=abs)
    if abs(most) > 2.0 * math.pi + 1e-6:
        _log.warning(
            "%s: %g rad is more than a turn: angles are in radians; %g degrees would be %.6g",
            what,
            most,
            most,
            math.radians(most),
        )


def quaternion_of_rpy(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Unit quaternion of Rz(yaw) Ry(pitch) Rx(roll), as in URDF."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


class PieceDocument(TypedDict):
    """A convex shape.

    Attributes:
        name: Name of the obstacle; ``name#k`` for one of its pieces.
        shape: Shape as in a scene file.
        size: Size as in URDF: [x, y, z] of a box, [radius] of a sphere, [radius, length] of a cylinder, capsule (length
            without the caps) or cone, and the vertices [[x, y, z], …] of a convex hull.
        pose: [x, y, z, qx, qy, qz, qw].
    """

    name: str
    shape: str
    size: list[float] | list[list[float]]
    pose: list[float]


class TrackedPiece(PieceDocument):
    """A convex shape of a world that is recorded.

    Attributes:
        appears: When it appears [s]; None: it is always there.
        vanishes: When it vanishes [s]; None: never.
        track: Place among the tracks of the poses that its own ``pose`` is relative to; None for a fixed one.
    """

    appears: float | None
    vanishes: float | None
    track: int | None


def obstacle_documents(scene: Scene) -> list[PieceDocument]:
    """Every convex shape of a scene; a mesh or a set of voxels gives one entry a convex piece."""
    documents: list[PieceDocument] = []
    table = scene.table
    counts = np.bincount(table.obstacle_index, minlength=len(scene)) if len(scene) else np.zeros(0, dtype=int)
    numbers = [itertools.count() for _ in scene]
    for row, part in enumerate(table.parts):
        owner = int(table.obstacle_index[row])
        rotation, translation = table.rotation[row], table.translation[row]
        if part.geometry is None:
            pieces = [(box, translation + rotation @ np.asarray(at)) for box, at in part.boxes]
        else:
            pieces = [(part.geometry, translation)]
        for geometry, at in pieces:
            single = counts[owner] == 1 and len(pieces) == 1
            shape, size = _shape_document(geometry)
            name = scene.names[owner] if single else f"{scene.names[owner]}#{next(numbers[owner])}"
            documents.append({"name": name, "shape": shape, "size": size, "pose": _pose_entry(rotation, at)})
    return documents


def _shape_document(geometry: coal.CollisionGeometry) -> tuple[str, list[float] | list[list[float]]]:
    """Name and size of a Coal shape, as in `obstacle_documents`."""
    kind, size = shape_of(geometry)
    if kind is ShapeKind.BOX:
        return kind.value, [2 * h for h in size]
    if kind is ShapeKind.SPHERE:
        return kind.value, [*size]
    if kind in LONG_ROUND:
        return kind.value, [size[0], 2 * size[1]]
    return ShapeKind.CONVEX.value, vertices(geometry).tolist()


def obstacle_from_piece(piece: PieceDocument, motion: Motion | None = None) -> Obstacle:
    """The obstacle that a document of `obstacle_documents` describes.

    Args:
        piece: the document.
        motion: if given, it says where the obstacle is, and the document's pose does not count.

    Raises:
        InputError: it cannot be made; a damaged document raises the errors of damaged data (KeyError, TypeError, …).
    """
    place: Document = {"at": piece["pose"][:3], "quat": piece["pose"][3:]} if motion is None else {"motion": motion}
    make, keys = _SIMPLE[piece["shape"]]
    size = piece["size"]
    return make(*(size if keys[0] == "radius" else (size,)), **place, name=piece["name"])


def world_documents(world: World, time: Array) -> tuple[list[TrackedPiece], list[str], Array, Array]:
    """A world as obstacle documents and tracks.

    Args:
        world: the obstacles.
        time: (T,) times at which moving ones are recorded [s].

    Returns:
        Documents of the pieces; the names of the obstacles that move (M), their positions (T, M, 3) [m] and quaternions
        (T, M, 4).
    """
    from scipy.spatial.transform import Rotation  # late: slow to import

    documents: list[TrackedPiece] = []
    moving: list[Obstacle] = []
    taken: set[str] = set()
    for obstacle in world.scene:
        name = obstacle.name or ""
        appears, vanishes = world.appears.get(name), world.vanishes.get(name)
        moves = obstacle.motion is not None and not obstacle.motion.still
        track = len(moving) if moves else None
        for document in obstacle_documents(Scene([obstacle], time=obstacle.time)):
            while document["name"] in taken:  # "a#0" may be a piece of "a", or an obstacle's name
                document["name"] += "'"
            taken.add(document["name"])
            if moves:
                relative = np.asarray(np.linalg.solve(obstacle.pose, _pose_matrix(document["pose"])), dtype=float)
                document["pose"] = _pose_entry(relative[:3, :3], relative[:3, 3])
            documents.append({**document, "appears": appears, "vanishes": vanishes, "track": track})
        if moves:
            moving.append(obstacle)
    poses = np.array([[o.at(float(t)).pose for o in moving] for t in time]).reshape(len(time), len(moving), 4, 4)
    quaternions = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat() if moving else np.zeros((0, 4))
    names = [o.name or "" for o in moving]
    return documents, names, poses[..., :3, 3].copy(), quaternions.reshape(len(time), len(moving), 4)


def world_from_documents(documents: Sequence[TrackedPiece], time: Array, position: Array, quaternion: Array) -> World:
    """The world of the documents of `world_documents`: convex obstacles that follow the recorded poses.

    Args:
        documents: the pieces' documents as they were read; damage in them is found here.
        time: (T,) times of the poses [s].
        position: (T, M, 3) positions of the obstacles that move [m].
        quaternion: (T, M, 4) their quaternions.

    Raises:
        InputError: the documents are damaged, or an obstacle cannot be made.
    """
    from scipy.spatial.transform import Rotation

    obstacles: list[Obstacle] = []
    try:
        rows = len(time) * sum(document["track"] is not None for document in documents)
        if rows > MAX_ROWS:
            raise InputError(f"the pieces of the obstacles that move need {rows} rows; at most {MAX_ROWS} are read")
        for document in documents:
            name, track = document["name"], document["track"]
            place = _pose_matrix(document["pose"])
            motion = None
            if isinstance(track, int) and 0 <= track < position.shape[1]:
                turned = Rotation.from_quat(quaternion[:, track])
                positions = position[:, track] + turned.apply(place[:3, 3])
                quats = (turned * Rotation.from_matrix(place[:3, :3])).as_quat()
                motion = Keyframes(time, positions, quats=quats)
            elif track is not None:
                raise InputError(f"obstacle {name!r} follows track {track!r}; there are {position.shape[1]}")
            obstacles.append(obstacle_from_piece(document, motion))
        appears = {piece["name"]: piece["appears"] for piece in documents if piece["appears"] is not None}
        vanishes = {piece["name"]: piece["vanishes"] for piece in documents if piece["vanishes"] is not None}
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
        if type(error) is InputError:
            raise
        raise InputError(f"an obstacle is damaged: {type(error).__name__}: {error}") from None
    return World(Scene(obstacles, time=float(time[0])), appears, vanishes)


def _pose_matrix(pose: ArrayLike) -> Array:
    from scipy.spatial.transform import Rotation

    values = np.array(pose, dtype=float)
    if values.shape != (7,) or not np.isfinite(values).all() or not math.isclose(np.linalg.norm(values[3:]), 1.0):
        raise InputError(f"a pose is seven finite numbers with a unit quaternion, not {pose!s:.80}")
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = Rotation.from_quat(values[3:]).as_matrix(), values[:3]
    return result


def _pose_entry(rotation: Array, position: Sequence[float] | Array) -> list[float]:
    """A pose as [x, y, z, qx, qy, qz, qw]."""
    from scipy.spatial.transform import Rotation

    return [*map(float, position), *map(float, Rotation.from_matrix(rotation).as_quat())]
