"""Proofs: what makes a path's certificate checkable by :mod:`elastic_strips.proof_checker`, which needs NumPy alone.

For each segment and pair of shapes that must not meet, intervals of the segment and a direction at both ends of each,
along which the shapes are apart. Most pairs are far away, and the direction between their middles will do; Coal finds
it for the others, and an interval that is still too long is halved. The checker's own functions say what a direction
is worth, so that a proof that is made is one that it takes.
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
from elastic_strips.errors import InputError, RobotError, SceneError
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.robot import RobotModel
from elastic_strips.robot.coal_shapes import ShapeKind, shape_of, vertices
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary

from .bounds import BodySet

_DEPTH = 24  # most halvings of a segment; what is still open then is not proven
_MOST = 3_000_000  # intervals of a proof
_GAIN = 2.0 * checker.ROUNDING  # that an interval has to spare


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathProof(Summary):
    """A proof that a path keeps its clearances, as :mod:`elastic_strips.proof_checker` reads it.

    Attributes:
        header: the robot, the scene and the clearances, as JSON has them.
        rows: (N, nv) the path.
        segment, pair: (M,) what each interval is of.
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
        """Names of robot, scene and path: what is proven about another one has other ones."""
        parts = {"robot": self.header["robot"], "scene": self.header["scene"], "path": self.rows.tolist()}
        return {name: checker.digest(part) for name, part in parts.items()}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the proof as a NumPy archive: the whole file or none.

        Raises:
            InputError: the file cannot be written.
        """
        target = check_writable(path)
        stream = io.BytesIO()
        np.savez_compressed(
            stream, header=np.array(json.dumps(self.header)), rows=self.rows, segment=self.segment.astype(np.int32),
            pair=self.pair.astype(np.int32), span=self.span, normal=self.normal.astype(np.float32),
        )  # fmt: skip
        return atomic_write(target, stream.getvalue())


def prove(
    robot: RobotModel, scene: Scene, coordinates: Array, *, clearance: float = 0.0, self_clearance: float = 0.0
) -> PathProof | None:
    """The proof that a path keeps its clearances, or None where it does not, or too narrowly to be proven.

    Args:
        robot: the robot.
        scene: the obstacles, standing still.
        coordinates: (N, nv) rows; between two of them the robot moves along the tangent: joints linearly, a base on
            an arc.
        clearance, self_clearance: to prove [m].

    Raises:
        RobotError, SceneError: a shape that the checker does not know.
        InputError: more intervals would be needed than a proof may have.
    """
    rows = np.array(coordinates, dtype=float)
    header: dict[str, Any] = {
        "format": checker.FORMAT, "version": checker.VERSION, "clearance": clearance, "self_clearance": self_clearance,
        "robot": robot_statement(robot), "scene": scene_statement(scene),
    }  # fmt: skip
    try:
        work = _Work(robot, scene, header, rows, clearance, self_clearance)
        found = work.intervals()
    except checker.Refused:
        return None  # half a turn
    if found is None:
        return None
    segment, pair, span, normal, spare = found
    normal = normal.astype(np.float32).astype(float)  # as the file has them, and as they were looked at
    return PathProof(header, rows, segment, pair, span, normal, spare)


class _Work:
    """Workspace: halves intervals until all are proven."""

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        header: dict[str, Any],
        rows: Array,
        clearance: float,
        self_clearance: float,
    ) -> None:
        self.robot = checker.Robot(header["robot"])
        self.obstacles = [checker.Shape(o, "obstacle") for o in header["scene"]]
        self.rows, self.v = rows, self.robot.tangents(rows)
        self.across = len(self.robot.bodies) * len(self.obstacles)
        self.pairs = self.across + len(self.robot.pairs)
        self.moves = checker.motions(self.robot, self.obstacles, rows, self.v)
        self.needed = np.where(np.arange(self.pairs) < self.across, clearance, self_clearance)
        self.body_shapes = list(BodySet.links(robot).geometries)
        self.obstacle_shapes = [shape for _, shape, _, _ in _pieces(scene)]
        self.body_boxes, self.obstacle_boxes = (_boxes(shapes) for shapes in (self.robot.bodies, self.obstacles))

    def intervals(self) -> tuple[Indices, Indices, Array, Array, float] | None:
        """Segment, pair, span and normals of intervals that prove everything, and what the worst has to spare."""
        segments = len(self.rows) - 1
        segment = np.repeat(np.arange(segments), self.pairs)
        pair = np.tile(np.arange(self.pairs), segments)
        span = np.tile((0.0, 1.0), (len(pair), 1))
        done: list[tuple[Indices, Indices, Array, Array]] = []
        least, total = np.inf, 0
        for _ in range(_DEPTH):
            if not len(pair):
                break
            total += len(pair)
            if total > _MOST:
                raise InputError(f"the proof would have more than {_MOST} intervals; prove the path in parts")
            normal = np.stack([self._between_middles(segment, span[:, e], pair) for e in (0, 1)], axis=1)
            gap = np.stack([self._gaps(segment, span[:, e], pair, normal[:, e]) for e in (0, 1)], axis=1)
            spare = self._spare(segment, pair, span, gap)
            near = np.flatnonzero(spare <= _GAIN)
            for e in (0, 1):
                normal[near, e] = self._exact(segment[near], span[near, e], pair[near], normal[near, e])
                gap[near, e] = self._gaps(segment[near], span[near, e], pair[near], normal[near, e])
            if (gap[near] <= self.needed[pair[near], None]).any():
                return None
            spare[near] = self._spare(segment[near], pair[near], span[near], gap[near])
            proven = spare > _GAIN
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

    def _spare(self, segment: Indices, pair: Indices, span: Array, gap: Array) -> Array:
        travel = (span[:, 1] - span[:, 0]) * self.moves[segment, pair]
        return 0.5 * (gap.sum(axis=1) - travel) - self.needed[pair] - checker.ROUNDING

    def _gaps(self, segment: Indices, t: Array, pair: Indices, normal: Array) -> Array:
        if not len(pair):
            return np.zeros(0)
        # as the file will have them
        single = normal.astype(np.float32).astype(float)
        return checker.gaps(self.robot, self.obstacles, self.rows, self.v, segment, t, pair, single)

    def _placed(self, segment: Indices, t: Array) -> tuple[list[tuple[Array, Array]], Indices]:
        """Poses of all bodies at the different places, and which place each entry is at."""
        places, where = np.unique(np.column_stack((segment, t)), axis=0, return_inverse=True)
        rows = self.robot.between(self.rows, self.v, places[:, 0].astype(np.int64), places[:, 1].astype(float))
        frames = self.robot.place(rows)
        out = []
        for body, joint in zip(self.robot.bodies, self.robot.joint, strict=True):
            R = np.tile(np.eye(3), (len(rows), 1, 1)) if joint < 0 else frames[joint][0]
            t0 = np.zeros((len(rows), 3)) if joint < 0 else frames[joint][1]
            out.append((R @ body.rotation, t0 + R @ body.translation))
        return out, where.reshape(-1)

    def _between_middles(self, segment: Indices, t: Array, pair: Indices) -> Array:
        """Directions (K, 3) from the middle of the first shape to the nearest place of a box about the second."""
        placed, where = self._placed(segment, t)
        middles = np.stack([R @ middle + at for middle, (R, at) in zip(self.body_boxes[0], placed, strict=True)])
        first = np.concatenate(
            (np.repeat(np.arange(len(self.robot.bodies)), len(self.obstacles)), self.robot.pairs[:, 0])
        )
        one = middles[first[pair], where]
        two = np.empty_like(one)
        own = pair >= self.across
        two[own] = middles[self.robot.pairs[pair[own] - self.across, 1], where[own]]
        if len(self.obstacles):
            R = np.stack([o.rotation for o in self.obstacles])
            at = np.stack([o.translation for o in self.obstacles])
            middle, half = self.obstacle_boxes
            k = pair[~own] % len(self.obstacles)
            local = np.einsum("kji,kj->ki", R[k], one[~own] - at[k]) - middle[k]
            two[~own] = at[k] + np.einsum("kij,kj->ki", R[k], np.clip(local, -half[k], half[k]) + middle[k])
        way = two - one
        way[(np.abs(way) < 1e-2).all(axis=1)] = (0.0, 0.0, 1.0)
        return way / np.linalg.norm(way, axis=1, keepdims=True)

    def _exact(self, segment: Indices, t: Array, pair: Indices, otherwise: Array) -> Array:
        """Coal's directions (K, 3); the former ones where shapes touch."""
        placed, where = self._placed(segment, t)
        request, out = coal.DistanceRequest(True), otherwise.copy()
        request.gjk_tolerance = 1e-9
        for k, (p, w) in enumerate(zip(pair.tolist(), where.tolist(), strict=True)):
            result = coal.DistanceResult()
            if p < self.across:
                g, o = divmod(p, len(self.obstacles))
                two, pose = self.obstacle_shapes[o], (self.obstacles[o].rotation, self.obstacles[o].translation)
            else:
                g, h = self.robot.pairs[p - self.across]
                two, pose = self.body_shapes[h], (placed[h][0][w], placed[h][1][w])
            one = coal.Transform3s(placed[g][0][w], placed[g][1][w])
            distance = coal.distance(self.body_shapes[g], one, two, coal.Transform3s(*pose), request, result)
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
    circular = np.zeros(space.nv, dtype=bool)
    circular[space.base_nv :] = space.circular
    return {
        "name": robot.name,
        "planar": bool(space.planar),
        "joints": [
            {
                "parent": int(tree.parents[i]) - 1, "column": int(tree.coordinate_index[i]),
                "slides": bool(tree.prismatic[i]), "offset": tree.offset[i, :3].tolist(),
            }
            for i in range(1, len(tree.parents))
        ],
        "circular": circular.tolist(),
        "bodies": [
            {
                "joint": int(bodies.joint[g]) - 1,
                **_shape_part(name, bodies.geometries[g], bodies.rotation[g], bodies.translation[g], RobotError),
            }
            for g, name in enumerate(bodies.names)
        ],
        "pairs": np.asarray(robot.self_pairs).reshape(-1, 2).tolist(),
    }  # fmt: skip


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
        "name": name, "kind": kind.value, "sizes": list(half), "grown": float(geometry.getSweptSphereRadius()),
        "points": vertices(geometry).tolist() if kind is ShapeKind.CONVEX else [],
        "rotation": np.asarray(R).tolist(), "translation": np.asarray(t).tolist(),
    }  # fmt: skip
