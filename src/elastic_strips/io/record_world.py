"""IO room, worlds of records: the true obstacles of a run as plain values and arrays, and back again."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from elastic_strips.execution.record import RecordError
from elastic_strips.io.obstacle_document import obstacle_documents
from elastic_strips.robot.space import Array
from elastic_strips.scene import Box, Capsule, Cone, ConvexHull, Cylinder, Keyframes, Obstacle, Scene, Sphere, World

MAX_ROWS = 4_000_000
"""Most poses of moving pieces that a record's world is made of: their number times the control rows."""


def world_documents(world: World, time: Array) -> tuple[list[dict[str, Any]], list[str], Array, Array]:
    """A world as obstacle documents and tracks.

    Args:
        world: the obstacles.
        time: (T,) when moving ones are looked at [s].

    Returns:
        Documents as of ``obstacle_documents``, each with ``appears`` and ``vanishes`` [s] (None: always, never) and
        ``track``: None for a fixed one, else its place among the tracks, whose pose its own ``pose`` is relative to;
        the names of the obstacles that move (M), their positions (T, M, 3) [m] and quaternions (T, M, 4).
    """
    from scipy.spatial.transform import Rotation  # late: slow to import

    documents: list[dict[str, Any]] = []
    moving: list[Obstacle] = []
    taken: set[str] = set()
    for obstacle in world.scene:
        name = obstacle.name or ""
        when = {"appears": world.appears.get(name), "vanishes": world.vanishes.get(name)}
        moves = obstacle.motion is not None and not obstacle.motion.still
        for document in obstacle_documents(Scene([obstacle], time=obstacle.time)):
            while document["name"] in taken:  # "a#0" may be a piece of "a", or an obstacle's name
                document["name"] += "'"
            taken.add(document["name"])
            if moves:
                document["pose"] = _vector(
                    np.asarray(np.linalg.solve(obstacle.pose, _matrix(document["pose"])), dtype=float)
                )
            documents.append({**document, **when, "track": len(moving) if moves else None})
        if moves:
            moving.append(obstacle)
    poses = np.array([[o.at(float(t)).pose for o in moving] for t in time]).reshape(len(time), len(moving), 4, 4)
    quaternions = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat() if moving else np.zeros((0, 4))
    names = [o.name or "" for o in moving]
    return documents, names, poses[..., :3, 3].copy(), quaternions.reshape(len(time), len(moving), 4)


def world_from_documents(documents: Any, time: Array, position: Array, quaternion: Array) -> World:
    """The world of what `world_documents` gave: convex obstacles that follow the recorded poses.

    Raises:
        RecordError: the documents are damaged; a `SceneError` where an obstacle cannot be made.
    """
    from scipy.spatial.transform import Rotation

    obstacles: list[Obstacle] = []
    appears: dict[str, float] = {}
    vanishes: dict[str, float] = {}
    try:
        rows = len(time) * sum(document["track"] is not None for document in documents)
        if rows > MAX_ROWS:
            raise RecordError(f"the pieces of the obstacles that move need {rows} rows; at most {MAX_ROWS} are read")
        for document in documents:
            name, track = document["name"], document["track"]
            place = _matrix(document["pose"])
            if track is None:
                where: dict[str, Any] = {"at": place[:3, 3], "quat": document["pose"][3:]}
            elif isinstance(track, int) and 0 <= track < position.shape[1]:
                turned = Rotation.from_quat(quaternion[:, track])
                positions = position[:, track] + turned.apply(place[:3, 3])
                quats = (turned * Rotation.from_matrix(place[:3, :3])).as_quat()
                where = {"motion": Keyframes(time, positions, quats=quats)}
            else:
                raise RecordError(f"obstacle {name!r} follows track {track!r}; there are {position.shape[1]}")
            obstacles.append(_obstacle(document["shape"], document["size"], {**where, "name": name}))
            for times, key in ((appears, "appears"), (vanishes, "vanishes")):
                if document[key] is not None:
                    times[name] = document[key]
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, RecordError):
            raise
        raise RecordError(f"an obstacle is damaged: {type(error).__name__}: {error}") from None
    return World(Scene(obstacles, time=float(time[0])), appears, vanishes)


def _obstacle(shape: str, size: Any, where: dict[str, Any]) -> Obstacle:
    if shape == "box":
        return Box(size, **where)
    if shape == "convex":
        return ConvexHull(size, **where)
    return {"sphere": Sphere, "cylinder": Cylinder, "capsule": Capsule, "cone": Cone}[shape](*size, **where)


def _matrix(pose: Any) -> Array:
    from scipy.spatial.transform import Rotation

    values = np.array(pose, dtype=float)
    if values.shape != (7,) or not np.isfinite(values).all() or not math.isclose(np.linalg.norm(values[3:]), 1.0):
        raise RecordError(f"a pose is seven finite numbers with a unit quaternion, not {pose!s:.80}")
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = Rotation.from_quat(values[3:]).as_matrix(), values[:3]
    return result


def _vector(T: Array) -> list[float]:
    from scipy.spatial.transform import Rotation

    return [*map(float, T[:3, 3]), *map(float, Rotation.from_matrix(T[:3, :3]).as_quat())]
