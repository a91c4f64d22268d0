"""Proofs: a path's certificate in a form that :mod:`elastic_strips.proof_checker` can check, which needs NumPy alone.

For each segment and pair of shapes that must not meet there are intervals of the segment, and a direction at both ends,
along which the shapes are apart. Most pairs are far away, and the direction between their middles is enough; Coal finds
it for the others, and an interval that is still too long is halved. The checker's own functions say what a direction
is worth, so that the checker takes every proof that is made.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np

from elastic_strips import proof_checker as checker
from elastic_strips.arrays import Array, Document, Indices
from elastic_strips.coal_shapes import ShapeKind, shape_of, vertices
from elastic_strips.errors import InputError, ParameterError, RobotError, SceneError
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary
from elastic_strips.validation import check_choice, check_number, check_type, named_arguments

from .bounds import BodySet
from .path_rows import INTERPOLATIONS, PathLike, PathRows, column_names, path_rows

_MOST_HALVINGS = 24  # of a segment; what is still open then is not proven
_LEAST_SPARE = 2.0 * checker.ROUNDING  # [m] that an interval has to spare


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathProof(Summary):
    """A proof that a path keeps its clearances, as :mod:`elastic_strips.proof_checker` reads it.

    Attributes:
        header: the robot, the scene, the clearances and which way the path goes, as plain values for JSON.
        rows: (N, nv) the path, as it was given.
        segment, pair: (M,) segment and pair of each interval.
        span: (M, 2) where on the segment it begins and ends.
        normal: (M, 2, 3) directions at both ends, from the first to the second shape.
        spare: the least that an interval proves beyond the clearance [m].
    """

    header: Document
    rows: Array
    segment: Indices
    pair: Indices
    span: Array
    normal: Array
    spare: float

    def _summary(self) -> dict[str, object]:
        return {"segments": len(self.rows) - 1, "intervals": len(self.span), **self.digests}

    def _measured(self) -> dict[str, object]:
        return {"spare": f"{1e3 * self.spare:.3g} mm"}

    @property
    def digests(self) -> dict[str, str]:
        """Names of robot, scene and path: a proof about another one has other names."""
        parts = {name: checker.digest(self.header[name]) for name in ("robot", "scene")}
        return {**parts, "path": checker.path_digest(self.rows, str(self.header["way"]))}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the proof as a NumPy archive: the whole file or nothing.

        Raises:
            InputError: the file cannot be written.
        """
        target = check_writable(path)
        stream = io.BytesIO()
        np.savez_compressed(
            stream,
            header=np.array(json.dumps(self.header)),
            rows=self.rows,
            segment=self.segment.astype(np.int32),
            pair=self.pair.astype(np.int32),
            span=self.span,
            normal=self.normal.astype(np.float32),
        )
        return atomic_write(target, stream.getvalue())


@named_arguments
def prove(
    robot: RobotModel,
    scene: Scene,
    path: PathLike,
    *,
    clearance: float = 0.0,
    self_clearance: float = 0.0,
    interpolation: str = "arc",
) -> PathProof | None:
    """The proof that a path keeps its clearances, or None where it does not keep them, or too narrowly to be proven.

    Args:
        robot: the robot.
        scene: the obstacles, as they stand.
        path: configurations (N, nq), coordinate rows (N, nv), a strip, or a path file; see :func:`certify`. The proof
            is about these very rows.
        clearance, self_clearance: distances to prove [m].
        interpolation: as for :func:`certify`; there is no proof where it does not say which way the path goes.

    Raises:
        RobotError, SceneError: a shape that the checker does not know, or something other than a scene.
        ConfigurationError: a path of another shape.
        ParameterError: a clearance below 0, or an unknown interpolation.
        InputError: the proof would be larger than the checker takes, or take it too long; or there is nothing to
            prove, because neither the scene nor the robot has anything to keep away from.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; proofs are of a Scene, whose obstacles stand still")
    check_number("clearance", clearance, low=0.0, unit="m")
    check_number("self_clearance", self_clearance, low=0.0, unit="m")
    given = path_rows(robot, path)
    way = _way(robot, given, interpolation)
    if way is None:
        return None
    header: dict[str, Any] = {
        "format": checker.FORMAT,
        "version": checker.VERSION,
        "way": way,
        "clearance": float(clearance),
        "self_clearance": float(self_clearance),
        "robot": robot_statement(robot),
        "scene": scene_statement(scene),
    }
    pairs = len(header["robot"]["bodies"]) * len(header["scene"]) + len(header["robot"]["pairs"])
    if not pairs:
        raise InputError(
            f"there is nothing to prove of {robot.name}: it has no links that are kept apart, and the scene is empty"
        )
    _bounded("pairs on segments", pairs * (len(given.rows) - 1), checker.MOST)
    _bounded("numbers of the path", given.rows.size, checker.MOST)
    _bounded("bytes of robot and scene", 4 * len(json.dumps(header)), checker.MOST_TEXT)
    try:
        work = _Work(robot, scene, header, given.rows)
        found = work.intervals()
    except checker.Refused:
        return None  # half a turn, numbers beyond those that the checker takes
    if found is None:
        return None
    segment, pair, span, normal, spare = found
    normal = normal.astype(np.float32).astype(float)  # as the file has them, and as they were looked at
    try:
        checker.check(header, given.rows, segment, pair, span, normal)
    except checker.Refused as problem:
        raise InputError(f"the checker does not take the proof: {problem}") from None
    return PathProof(header, given.rows, segment, pair, span, normal, spare)


def _bounded(what: str, count: int, most: int) -> None:
    if count > most:
        raise InputError(f"the proof would have {count} {what}; at most {most}: prove the path in parts, or of less")


def path_digest(robot: RobotModel, path: PathLike, interpolation: str = "line") -> str:
    """The name of this path in a proof; it depends on the path's rows and on which way it goes, and on nothing else.

    Args:
        robot: the robot of the path.
        path: as :func:`prove` takes it.
        interpolation: as for :func:`certify`.

    Raises:
        RobotError: not a robot.
        ConfigurationError: a path of another shape.
        ParameterError: an unknown interpolation, or one that does not say which way this path goes.
    """
    check_type("robot", robot, RobotModel, RobotError)
    given = path_rows(robot, path)
    way = _way(robot, given, interpolation)
    if way is None:
        raise ParameterError("interpolation 'values' needs rows (N, nv): configurations have (cos, sin) of angles")
    return checker.path_digest(given.rows, way)


def _way(robot: RobotModel, path: PathRows, interpolation: str) -> str | None:
    """The name of an interpolation in proofs; None for one by values of a path that has none."""
    check_choice("interpolation", interpolation, INTERPOLATIONS)
    if interpolation == "values" and not path.stated:
        return None
    if interpolation in ("arc", "line"):
        # where no angle's values change by half a turn or more; else there is no proof
        far = np.abs(np.diff(path.rows, axis=0))[:, robot.space.turning].max(initial=0.0)
        if far >= checker.HALF_TURN:
            return None
        return "arc" if interpolation == "arc" and robot.space.planar else "values"
    return interpolation


class _Work:
    """Workspace: halves intervals until all are proven."""

    def __init__(self, robot: RobotModel, scene: Scene, header: dict[str, Any], rows: Array) -> None:
        self.world = world = checker.World(header["robot"], header["scene"])
        self.path = checker.Path(world, rows, header["way"])
        self.bodies, self.pairs = len(header["robot"]["bodies"]), len(world.pairs)
        clearances = header["clearance"], header["self_clearance"]
        self.needed = np.where(np.arange(self.pairs) < world.across, *clearances)
        self.geometries = [*BodySet.links(robot).geometries, *(shape for _, shape, _, _ in _pieces(scene))]
        self.middles, self.halves = _boxes(world.shapes)

    def intervals(self) -> tuple[Indices, Indices, Array, Array, float] | None:
        """Segment, pair, span and normals of intervals that prove everything, and how much the worst has to spare."""
        segments = len(self.path.v)
        segment = np.repeat(np.arange(segments), self.pairs)
        pair = np.tile(np.arange(self.pairs), segments)
        span = np.tile((0.0, 1.0), (len(pair), 1))
        done: list[tuple[Indices, Indices, Array, Array]] = []
        least, total = np.inf, 0
        for _ in range(_MOST_HALVINGS):
            if not len(pair):
                break
            _bounded("intervals", total + len(pair), checker.MOST)
            found = self._directions(segment, pair, span)
            if found is None:
                return None
            normal, spare = found
            proven = spare > _LEAST_SPARE
            total += int(proven.sum())
            least = min(least, float(spare[proven].min(initial=np.inf)))
            done.append((segment[proven], pair[proven], span[proven], normal[proven]))
            segment, pair, span = segment[~proven], pair[~proven], span[~proven]
            middle = 0.5 * (span[:, 0] + span[:, 1])
            halves = np.stack((np.column_stack((span[:, 0], middle)), np.column_stack((middle, span[:, 1]))), axis=1)
            segment, pair, span = np.repeat(segment, 2), np.repeat(pair, 2), halves.reshape(-1, 2)
        if len(pair):
            return None
        parts = [np.concatenate(arrays) for arrays in zip(*done, strict=True)]
        order = np.lexsort((parts[2][:, 0], parts[1], parts[0]))
        segment, pair, span, normal = (part[order] for part in parts)
        return segment, pair, span, normal, least

    def _directions(self, segment: Indices, pair: Indices, span: Array) -> tuple[Array, Array] | None:
        """Directions (K, 2, 3) at both ends of intervals, and what they prove beyond the clearance (K,) [m]; None where
        shapes are too near at an end."""
        normal = np.stack([self._between_middles(segment, span[:, e], pair) for e in (0, 1)], axis=1)
        gap = np.stack([self._gaps(segment, span[:, e], pair, normal[:, e]) for e in (0, 1)], axis=1)
        spare = self._spare(segment, pair, span, gap)
        near = np.flatnonzero(spare <= _LEAST_SPARE)
        for e in (0, 1):
            normal[near, e] = self._exact(segment[near], span[near, e], pair[near], normal[near, e])
            gap[near, e] = self._gaps(segment[near], span[near, e], pair[near], normal[near, e])
        if (gap[near] <= self.needed[pair[near], None]).any():
            return None
        spare[near] = self._spare(segment[near], pair[near], span[near], gap[near])
        return normal, spare

    def _spare(self, segment: Indices, pair: Indices, span: Array, gap: Array) -> Array:
        travel = (span[:, 1] - span[:, 0]) * self.path.motions(segment, pair)
        return 0.5 * (gap.sum(axis=1) - travel) - self.needed[pair] - checker.ROUNDING

    def _gaps(self, segment: Indices, t: Array, pair: Indices, normal: Array) -> Array:
        if not len(pair):
            return np.zeros(0)
        # as the file will have them
        single = normal.astype(np.float32).astype(float)
        return self.path.gaps(segment, t, pair, single)

    def _placed(self, segment: Indices, t: Array) -> tuple[list[tuple[Array, Array]], Indices]:
        """Poses of all shapes at the different places, and which place each entry is at."""
        places, where = np.unique(np.column_stack((segment, t)), axis=0, return_inverse=True)
        frames = self.world.place(self.path.between(places[:, 0].astype(np.int64), places[:, 1].astype(float)))
        out = []
        for shape, joint in zip(self.world.shapes, self.world.joint, strict=True):
            R, at = frames[joint]
            out.append((R @ shape.rotation, at + R @ shape.at))
        return out, where.reshape(-1)

    def _between_middles(self, segment: Indices, t: Array, pair: Indices) -> Array:
        """Directions (K, 3) from the middle of the first shape to the nearest place of a box about the second."""
        placed, where = self._placed(segment, t)
        way = np.zeros((len(pair), 3))
        for p in np.unique(pair):
            k = np.flatnonzero(pair == p)
            one, two = self.world.pairs[p]
            (R, at), (R_two, at_two) = ((turn[where[k]], place[where[k]]) for turn, place in (placed[one], placed[two]))
            begin = at + R @ self.middles[one]
            local = np.einsum("kji,kj->ki", R_two, begin - at_two) - self.middles[two]
            half = self.halves[two] if two >= self.bodies else 0.0  # of two bodies the middles
            way[k] = at_two + np.einsum("kij,kj->ki", R_two, np.clip(local, -half, half) + self.middles[two]) - begin
        way[(np.abs(way) < 1e-2).all(axis=1)] = (0.0, 0.0, 1.0)
        return way / np.linalg.norm(way, axis=1, keepdims=True)

    def _exact(self, segment: Indices, t: Array, pair: Indices, otherwise: Array) -> Array:
        """Coal's directions (K, 3); the former ones where shapes touch."""
        placed, where = self._placed(segment, t)
        request, out = coal.DistanceRequest(True), otherwise.copy()
        request.gjk_tolerance = 1e-9
        for k, (p, w) in enumerate(zip(pair.tolist(), where.tolist(), strict=True)):
            result = coal.DistanceResult()
            both = [
                (self.geometries[g], coal.Transform3s(placed[g][0][w], placed[g][1][w])) for g in self.world.pairs[p]
            ]
            distance = coal.distance(*both[0], *both[1], request, result)
            normal = np.asarray(result.normal)
            if distance > 0.0 and np.isfinite(normal).all():
                out[k] = normal
        return out


def robot_statement(robot: RobotModel) -> Document:
    """A robot in plain numbers, as proofs state it: its tree of joints, its convex bodies and the pairs of them.

    Raises:
        RobotError: a shape that proofs do not know.
    """
    tree, space, bodies = robot.tree, robot.space, BodySet.links(robot)
    return {
        "name": robot.name,
        "columns": list(column_names(robot)),
        "planar": bool(space.planar),
        "joints": [
            {
                "parent": int(tree.parents[i]) - 1,
                "column": int(tree.coordinate_index[i]),
                "slides": bool(tree.prismatic[i]),
                "offset": tree.offset[i, :3].tolist(),
                "multiplier": float(tree.multiplier[i]),
                "constant": float(tree.constant[i]),
            }
            for i in range(1, len(tree.parents))
        ],
        "circular": (space.turning & (np.arange(space.nv) >= space.base_nv)).tolist(),
        "bodies": [
            {
                "joint": int(bodies.joint[g]) - 1,
                **_shape_part(name, bodies.geometries[g], bodies.rotation[g], bodies.translation[g], RobotError),
            }
            for g, name in enumerate(bodies.names)
        ],
        "pairs": np.asarray(robot.self_pairs).reshape(-1, 2).tolist(),
    }


def scene_statement(scene: Scene) -> list[Document]:
    """A scene's convex pieces in plain numbers, as proofs state them.

    Raises:
        SceneError: a shape that proofs do not know.
    """
    return [_shape_part(*piece, SceneError) for piece in _pieces(scene)]


def _pieces(scene: Scene) -> Iterator[tuple[str, coal.CollisionGeometry, Array, Array]]:
    """Name, shape and pose of every convex piece."""
    table = scene.table
    for part, R, at, owner in zip(table.parts, table.rotation, table.translation, table.obstacle_index, strict=True):
        name = scene.names[int(owner)]
        if part.geometry is not None:
            yield name, part.geometry, R, at
        for box, shift in part.boxes:
            yield name, box, R, at + R @ np.asarray(shift)


def _boxes(shapes: list[checker.Shape]) -> tuple[Array, Array]:
    """Middles and half sizes (S, 3) [m] of boxes that hold shapes, in their own frames."""
    axes = np.vstack((np.eye(3), -np.eye(3)))
    reach = np.array([shape.support(axes) for shape in shapes]).reshape(-1, 2, 3)
    return 0.5 * (reach[:, 0] - reach[:, 1]), 0.5 * (reach[:, 0] + reach[:, 1])


def _shape_part(
    name: str, geometry: coal.CollisionGeometry, R: Array, t: Array, error: type[RobotError] | type[SceneError]
) -> Document:
    kind, half = shape_of(geometry)
    if kind.value not in checker.SIZES:
        raise error(f"{name!r} is a {kind.value}; proofs know {', '.join(checker.SIZES)}")
    return {
        "name": name,
        "kind": kind.value,
        "sizes": list(half),
        "grown": float(geometry.getSweptSphereRadius()),
        "points": vertices(geometry).tolist() if kind is ShapeKind.CONVEX else [],
        "rotation": np.asarray(R).tolist(),
        "translation": np.asarray(t).tolist(),
    }
