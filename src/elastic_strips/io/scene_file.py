"""Scene files: YAML scenes and worlds in and out."""

from __future__ import annotations

import itertools
import json
import math
import os
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.errors import InputError, SceneError, nearest_name
from elastic_strips.input_file import open_input
from elastic_strips.io import schema
from elastic_strips.io.files import check_writable, write_whole
from elastic_strips.io.npy_source import NpyError, read_npy
from elastic_strips.io.point_cloud import read_point_cloud
from elastic_strips.io.yaml_source import Node, load_yaml
from elastic_strips.robot.coal_shapes import LONG_ROUND, ShapeKind, shape_of, vertices
from elastic_strips.scene import (
    Box,
    Capsule,
    Cone,
    ConvexHull,
    Cylinder,
    Keyframes,
    Mesh,
    Motion,
    Obstacle,
    Points,
    Scene,
    Sphere,
    Twist,
    Unknown,
    Voxels,
    World,
    checks,
)
from elastic_strips.scene.motion import MAX_SPEED
from elastic_strips.scene.parts import MAX_CENTERS
from elastic_strips.validation import check_type

VERSION = 1
MAX_ARRAY_BYTES = 100_000_000
MAX_LINE = 10_000  # bytes
_COMMON = ("shape", "name", "at", "quat", "rpy", "motion", "appears", "vanishes")
_MOTIONS = ("twist", "keyframes", "unknown")
_SHAPES: dict[str, tuple[str, ...]] = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "cone": ("radius", "length"),
    "convex": ("vertices",),
    "mesh": ("file", "scale", "vertices", "faces"),
    "voxels": ("centers", "file", "size"),
    "points": ("points", "file", "radius"),
}


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file: the obstacles that exist at the file's time.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.
    """
    return scene_from_node(load_yaml(path))


def read_world(path: str | os.PathLike[str]) -> World:
    """Read a scene file: all obstacles, and when they appear and vanish.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.
    """
    return world_from_node(load_yaml(path))


def scene_from_node(node: Node) -> Scene:
    """Scene of a mapping node, as a scene file or a scenario's ``scene`` holds it: what exists at its time.

    Paths in it are relative to the node's own file.
    """
    world = world_from_node(node)
    return world.at(world.scene.time)


def world_from_node(node: Node) -> World:
    """World of a mapping node, as a scene file or a scenario's ``scene`` holds it.

    Paths in it are relative to the node's own file.
    """
    entries = schema.mapping(node, ("version", "time", "obstacles"), needed=("obstacles",), what="a scene")
    if "version" in entries:
        schema.integer(entries["version"], low=VERSION, high=VERSION)
    time = schema.number(entries["time"], low=-1e9, high=1e9, unit="s") if "time" in entries else 0.0
    obstacles: list[Obstacle] = []
    named: dict[str, int] = {}
    items = schema.items(entries["obstacles"])
    for item in items:
        obstacle = _obstacle(item)
        if obstacle.name is not None:
            line = item.value["name"].line
            if obstacle.name in named:
                taken = f"the name {obstacle.name!r} is taken by the obstacle in line {named[obstacle.name]}"
                item.value["name"].fail(f"{taken}; names must be unique")
            named[obstacle.name] = line
        obstacles.append(obstacle)
    scene = schema.checked(node, Scene, obstacles, time=time)
    spans = dict(zip(scene.names, (_span(item) for item in items), strict=True))
    appears = {name: span[0] for name, span in spans.items() if span[0] is not None}
    vanishes = {name: span[1] for name, span in spans.items() if span[1] is not None}
    return schema.checked(node, World, scene, appears, vanishes)


def _span(node: Node) -> tuple[float | None, float | None]:
    """When an obstacle appears and vanishes [s]; None where the file does not say."""
    times = [
        schema.number(node.value[key], low=-1e9, high=1e9, unit="s") if key in node.value else None
        for key in ("appears", "vanishes")
    ]
    if times[0] is not None and times[1] is not None and not times[1] > times[0]:
        node.value["vanishes"].fail(f"is {times[1]:g} s; it must be later than 'appears', {times[0]:g} s")
    return times[0], times[1]


def _obstacle(node: Node) -> Obstacle:
    if not isinstance(node.value, dict):
        node.fail(f"must be a mapping of an obstacle, not {schema.kind(node)}")
    if "shape" not in node.value:
        node.fail(f"the key 'shape' is missing{nearest_name('', _SHAPES)}")
    shape = schema.string(node.value["shape"], valid=_SHAPES)
    entries = schema.mapping(node, (*_COMMON, *_SHAPES[shape]), what=f"a {shape}")
    common = _placement(entries)
    return schema.checked(node, _MAKERS[shape], node, entries, common)


def _placement(entries: dict[str, Node]) -> dict[str, Any]:
    """Keyword arguments that all shapes share."""
    common: dict[str, Any] = {}
    if "name" in entries:
        common["name"] = schema.checked(entries["name"], checks.name, schema.string(entries["name"]))
    if "at" in entries:
        common["at"] = schema.checked(entries["at"], checks.array, "at", schema.vector(entries["at"], 3), (3,))
    if "rpy" in entries and "quat" in entries:
        entries["rpy"].fail("the orientation is given twice: by 'rpy' and by 'quat'")
    if "quat" in entries:
        quat = schema.vector(entries["quat"], 4)
        common["quat"] = schema.checked(entries["quat"], checks.quaternion, "the value", quat)
    if "rpy" in entries:
        common["quat"] = _quat_of_rpy(*schema.vector(entries["rpy"], 3).tolist())
    if "motion" in entries:
        common["motion"] = _motion(entries["motion"])
    return common


def _motion(node: Node) -> Motion:
    kinds = schema.mapping(node, _MOTIONS, what="a motion")
    if len(kinds) != 1:
        node.fail(f"must hold one of 'twist', 'keyframes' and 'unknown', not {len(kinds)} keys")
    kind, inner = next(iter(kinds.items()))
    if kind == "unknown":
        entries = schema.mapping(inner, ("max_speed",), needed=("max_speed",), what="an unknown motion")
        return Unknown(schema.number(entries["max_speed"], low=0.0, high=MAX_SPEED, unit="m/s"))
    if kind == "twist":
        entries = schema.mapping(inner, ("linear", "angular"), what="a twist")
        values = {key: schema.vector(entry, 3) for key, entry in entries.items()}
        return schema.checked(inner, Twist, **values)
    entries = schema.mapping(
        inner, ("times", "positions", "quats", "loop"), needed=("times", "positions"), what="keyframes"
    )
    times = schema.vector(entries["times"], None)
    positions = schema.rows(entries["positions"], 3)
    quats = schema.rows(entries["quats"], 4) if "quats" in entries else None
    loop = schema.boolean(entries["loop"]) if "loop" in entries else False
    return schema.checked(inner, Keyframes, times, positions, quats=quats, loop=loop)


def _length(node: Node, entries: dict[str, Node], key: str) -> float:
    return schema.number(_need(node, entries, key), low=checks.MIN_LENGTH, high=checks.MAX_LENGTH)


def _need(node: Node, entries: dict[str, Node], *keys: str) -> Node:
    """The one entry of ``keys`` that is given."""
    given = [key for key in keys if key in entries]
    if len(given) != 1:
        names = " or ".join(repr(k) for k in keys)
        node.fail(f"the key {names} is missing" if not given else f"only one of {names} may be given")
    return entries[given[0]]


def _size(node: Node, entries: dict[str, Node]) -> NDArray[np.float64]:
    entry = _need(node, entries, "size")
    return schema.checked(entry, checks.sizes, "the value", schema.vector(entry, 3), 3)


def _mesh(node: Node, entries: dict[str, Node], common: dict[str, Any]) -> Obstacle:
    if _need(node, entries, "file", "vertices").key.endswith(".file"):
        if "faces" in entries:
            entries["faces"].fail("belongs to 'vertices', not to a mesh 'file'")
        scale = schema.number(entries["scale"], low=1e-9, high=1e9, unit="-") if "scale" in entries else 1.0
        path = _file(entries["file"])
        return schema.checked(entries["file"], Mesh.from_file, path, scale=scale, **common)
    if "scale" in entries:
        entries["scale"].fail("belongs to a mesh 'file', not to 'vertices'")
    faces = schema.rows(_need(node, entries, "faces"), 3)
    return Mesh(schema.rows(entries["vertices"], 3), faces, **common)


def _voxels(node: Node, entries: dict[str, Node], common: dict[str, Any]) -> Obstacle:
    centers = _cloud(_need(node, entries, "centers", "file"))
    edge = _need(node, entries, "size")
    return Voxels(
        centers, _size(node, entries) if isinstance(edge.value, list) else _length(node, entries, "size"), **common
    )


def _points(node: Node, entries: dict[str, Node], common: dict[str, Any]) -> Obstacle:
    return Points(_cloud(_need(node, entries, "points", "file")), _length(node, entries, "radius"), **common)


_MAKERS: dict[str, Callable[[Node, dict[str, Node], dict[str, Any]], Obstacle]] = {
    "box": lambda n, e, c: Box(_size(n, e), **c),
    "sphere": lambda n, e, c: Sphere(_length(n, e, "radius"), **c),
    "cylinder": lambda n, e, c: Cylinder(_length(n, e, "radius"), _length(n, e, "length"), **c),
    "capsule": lambda n, e, c: Capsule(_length(n, e, "radius"), _length(n, e, "length"), **c),
    "cone": lambda n, e, c: Cone(_length(n, e, "radius"), _length(n, e, "length"), **c),
    "convex": lambda n, e, c: ConvexHull(schema.rows(_need(n, e, "vertices"), 3), **c),
    "mesh": _mesh,
    "voxels": _voxels,
    "points": _points,
}


def _file(node: Node) -> Path:
    """Path that a node names, relative to the node's own file."""
    return node.source.path.parent / schema.string(node)


def _cloud(node: Node) -> NDArray[np.float64]:
    """Points (n, 3) that are listed in the file, or that the named .npy, .csv, .txt, .xyz, .ply or .pcd file holds."""
    if isinstance(node.value, list):
        return schema.rows(node, 3)
    path = _file(node)
    suffixes = (".npy", ".csv", ".txt", ".xyz", ".ply", ".pcd")
    if path.suffix.lower() not in suffixes:
        node.fail(f"{path}: files of kind {path.suffix!r} are not read{nearest_name(path.suffix, suffixes)}")
    if path.suffix.lower() in (".ply", ".pcd"):
        return schema.checked(node, lambda: read_point_cloud(path).points)
    read = _npy if path.suffix.lower() == ".npy" else _table
    cloud = schema.checked(node, read, path)
    return schema.checked(node, checks.array, str(path), cloud, (None, 3))


def _npy(path: Path) -> NDArray[Any]:
    with open_input(path, "file of points", MAX_ARRAY_BYTES, SceneError) as (stream, size):
        try:
            points = read_npy(stream, size, MAX_ARRAY_BYTES)
        except NpyError as problem:
            raise SceneError(f"{path}: the array {problem}") from None
    if points.shape[:1] > (MAX_CENTERS,):
        raise SceneError(f"{path}: the file has {len(points)} points; at most {MAX_CENTERS} are read")
    return points


def _table(path: Path) -> NDArray[np.float64]:
    comma = b"," if path.suffix.lower() == ".csv" else None
    values = array("d")
    with open_input(path, "file of points", MAX_ARRAY_BYTES, SceneError) as (stream, _):
        for number in itertools.count(1):
            line = stream.readline(MAX_LINE)
            if not line:
                break
            words = line.removeprefix(b"\xef\xbb\xbf").partition(b"#")[0].strip()
            if not words:
                continue
            try:
                x, y, z = words.split(comma, 3)
                values.extend((float(x), float(y), float(z)))
            except ValueError:
                shown = words[:60].decode("utf-8", "replace")
                raise SceneError(f"{path}:{number}: must hold three numbers, not {shown!r}") from None
            if len(values) > 3 * MAX_CENTERS:
                raise SceneError(f"{path}: the file has more than {MAX_CENTERS} points, which is the most that is read")
    if not values:
        raise SceneError(f"{path}: the file holds no points")
    return np.array(values).reshape(-1, 3)


def _quat_of_rpy(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
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


def obstacle_documents(scene: Scene) -> list[dict[str, Any]]:
    """Every convex shape of a scene: name, shape, size as in URDF, pose [x, y, z, qx, qy, qz, qw].

    ``size`` is [x, y, z] of a box, [radius] of a sphere, [radius, length] of a cylinder, capsule (length without the
    caps) or cone, and the vertices [[x, y, z], …] of a convex hull. A mesh or a set of voxels gives one entry a
    convex piece, ``name#k``.
    """
    from scipy.spatial.transform import Rotation  # late: slow to import

    documents = []
    table = scene.table
    counts = np.bincount(table.obstacle_index, minlength=len(scene)) if len(scene) else np.zeros(0, dtype=int)
    number: dict[int, int] = {}
    for row, part in enumerate(table.parts):
        owner = int(table.obstacle_index[row])
        rotation, translation = table.rotation[row], table.translation[row]
        if part.geometry is None:
            pieces = [(box, translation + rotation @ np.asarray(at)) for box, at in part.boxes]
        else:
            pieces = [(part.geometry, translation)]
        for geometry, at in pieces:
            k = number.get(owner, 0)
            number[owner] = k + 1
            single = counts[owner] == 1 and len(pieces) == 1
            shape, size = shape_document(geometry)
            documents.append(
                {
                    "name": scene.names[owner] if single else f"{scene.names[owner]}#{k}",
                    "shape": shape,
                    "size": size,
                    "pose": [*map(float, at), *map(float, Rotation.from_matrix(rotation).as_quat())],
                }
            )
    return documents


def shape_document(geometry: Any) -> tuple[str, list[Any]]:
    """Name and size of a Coal shape, as in :func:`obstacle_documents`."""
    kind, size = shape_of(geometry)
    if kind is ShapeKind.BOX:
        return kind.value, [2 * h for h in size]
    if kind is ShapeKind.SPHERE:
        return kind.value, [*size]
    if kind in LONG_ROUND:
        return kind.value, [size[0], 2 * size[1]]
    return ShapeKind.CONVEX.value, vertices(geometry).tolist()


def write_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene file that `read_scene` reads back; an existing file is replaced in one step.

    Twists are written with their pose at time 0. Meshes that came from a file are written as that file's relative path.

    Raises:
        SceneError: A motion is neither a twist nor keyframes nor unknown, or the file cannot be written.
    """
    check_type("scene", scene, Scene, SceneError)
    _write(scene, {}, path)


def write_world(world: World, path: str | os.PathLike[str]) -> None:
    """Write a scene file that `read_world` reads back: all obstacles, and when they appear and vanish.

    Raises:
        SceneError: As for `write_scene`.
    """
    check_type("world", world, World, SceneError)
    spans: dict[str, dict[str, str]] = {name: {} for name in world.scene.names}
    for key, times in (("appears", world.appears), ("vanishes", world.vanishes)):
        for name, time in times.items():
            spans[name][key] = _text(time)
    _write(world.scene, spans, path)


def _write(scene: Scene, spans: dict[str, dict[str, str]], path: str | os.PathLike[str]) -> None:
    """Write the obstacles, each with further keys by its name."""
    try:
        target = check_writable(path)
        write_whole(target, _document(scene, spans, target).encode())
    except SceneError:
        raise
    except InputError as error:
        raise SceneError(str(error)) from None


def _document(scene: Scene, spans: dict[str, dict[str, str]], target: Path) -> str:
    """The text of a scene file that is to stand at ``target``."""
    lines = [f"version: {VERSION}", f"time: {_text(scene.time)}", "obstacles:" if len(scene) else "obstacles: []"]
    for obstacle in scene:
        entries = _entries(obstacle, target) | spans.get(obstacle.name or "", {})
        lines += [f"  {'-' if k == 0 else ' '} {key}: {value}" for k, (key, value) in enumerate(entries.items())]
    return "\n".join(lines) + "\n"


def _text(value: Any) -> str:
    """JSON, which is YAML."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return json.dumps(value, ensure_ascii=False)


def _entries(obstacle: Obstacle, target: Path) -> dict[str, str]:
    """Keys of an obstacle in a file, with their values as text."""
    motion, pose = obstacle.motion, obstacle.pose
    entries = {"name": _text(obstacle.name), "shape": obstacle.shape}
    spec = dict(obstacle.spec)
    if obstacle.shape == "mesh":
        origin, scale = spec.pop("path", None), spec.pop("scale", None)
        if origin is not None and os.path.isfile(origin):
            spec = {"file": os.path.relpath(os.path.abspath(origin), os.path.abspath(target.parent)), "scale": scale}
    entries.update({key: _text(value) for key, value in spec.items()})
    if isinstance(motion, Twist):
        pose = motion.pose(obstacle.anchor, -obstacle.anchor_time)
        entries["motion"] = (
            f"{{twist: {_text({'linear': motion.linear.tolist(), 'angular': motion.angular.tolist()})}}}"
        )
    elif isinstance(motion, Keyframes):
        frames: dict[str, Any] = {"times": motion.times.tolist(), "positions": motion.positions.tolist()}
        if motion.quats is not None:
            frames["quats"] = motion.quats.tolist()
        frames["loop"] = motion.loop
        entries["motion"] = f"{{keyframes: {_text(frames)}}}"
    elif isinstance(motion, Unknown):
        entries["motion"] = f"{{unknown: {_text({'max_speed': motion.max_speed})}}}"
    elif motion is not None:
        raise SceneError(
            f"obstacle {obstacle.name!r}: a motion of type {type(motion).__name__} cannot be written to a file"
        )
    if not isinstance(motion, Keyframes):
        entries["at"] = _text(pose[:3, 3])
    if not (isinstance(motion, Keyframes) and motion.quats is not None):
        entries["quat"] = _text(checks.quaternion_of(pose[:3, :3]))
    return entries
