"""Geometry: where the threads, arrows, spheres and ribbons of a strip are, as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elastic_strips.robot import ConfigurationSpace, Kinematics, RobotModel
from elastic_strips.viewer.meshes import MeshData

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


class Poses:
    """Workspace: where a robot's bodies and control points are, for many configurations at once; one per thread.

    Bodies are placed by the *aligned* joint frames of ``elastic_strips.robot.Kinematics``.
    """

    def __init__(self, robot: RobotModel) -> None:
        """Allocate for a robot."""
        self.space = robot.space
        self._kinematics = Kinematics(robot.tree)
        points = robot.control_point_set
        self._joint = points.joint
        align = robot.tree.align[points.joint]
        self._local = np.matmul(np.swapaxes(align, -1, -2), points.local[..., None])[..., 0]

    def update(self, chart: Doubles) -> None:
        """Place chart rows (N, nv)."""
        self._kinematics.update(chart, jacobians=False)

    def points(self) -> Doubles:
        """Control points, (N, C, 3) [m]."""
        return self._kinematics.points(self._joint, self._local)

    def matrices(self, joints: Sequence[int], nodes: Sequence[int] | None = None) -> Floats:
        """Poses of the bodies of some joints at some nodes (all by default), (N, B, 16) column-major."""
        T = self._kinematics.T[list(joints), : self._kinematics.n]
        if nodes is not None:
            T = T[:, list(nodes)]
        result = np.zeros((T.shape[1], T.shape[0], 4, 4), dtype=np.float32)
        result[..., :3] = T.transpose(1, 0, 3, 2)
        result[..., 3, 3] = 1.0
        return result.reshape(T.shape[1], T.shape[0], 16)


def between(starts: ArrayLike, ends: ArrayLike, radius: ArrayLike) -> Floats:
    """Matrices (K, 16) that put a unit mesh along z between pairs of points (K, 3), with a radius [m] or (K,) radii."""
    starts, ends = np.asarray(starts, dtype=np.float32), np.asarray(ends, dtype=np.float32)
    along = ends - starts
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
    along = np.where(length > 1e-6, along, np.array([0, 0, 1e-6], dtype=np.float32))
    unit = along / length
    helper = np.where(
        np.abs(unit[:, 2:]) < 0.9, np.array([0, 0, 1], dtype=np.float32), np.array([1, 0, 0], dtype=np.float32)
    )
    x = np.cross(helper, unit)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(unit, x)
    width = np.broadcast_to(np.asarray(radius, dtype=np.float32).reshape(-1, 1), (len(starts), 1))
    result = np.zeros((len(starts), 4, 4), dtype=np.float32)
    result[:, 0, :3], result[:, 1, :3], result[:, 2, :3], result[:, 3, :3] = x * width, y * width, along, starts
    result[:, 3, 3] = 1.0
    return result.reshape(-1, 16)


def spheres(centers: ArrayLike, radii: ArrayLike) -> Floats:
    """Matrices (K, 16) that put unit spheres at centres (K, 3) [m] with radii (K,) [m]."""
    centers = np.asarray(centers, dtype=np.float32).reshape(-1, 3)
    result = np.zeros((len(centers), 16), dtype=np.float32)
    result[:, 0] = result[:, 5] = result[:, 10] = np.asarray(radii, dtype=np.float32).reshape(-1)
    result[:, 12:15], result[:, 15] = centers, 1.0
    return result


def arrows(points: ArrayLike, vectors: ArrayLike, longest: float = 0.45) -> Floats:
    """Matrices (K, 16) of arrows, the longest of them ``longest`` [m]; very small ones are left out."""
    points, vectors = np.asarray(points, dtype=float).reshape(-1, 3), np.asarray(vectors, dtype=float).reshape(-1, 3)
    size = np.linalg.norm(vectors, axis=1)
    size = np.where(np.isfinite(size), size, 0.0)
    keep = (size > 0.03 * size.max(initial=0.0)) & (size > 1e-9)
    if not keep.any():
        return np.zeros((0, 16), dtype=np.float32)
    scale = longest / size[keep].max()
    length = size[keep] * scale
    return between(points[keep], points[keep] + vectors[keep] * scale, np.clip(0.09 * length, 0.008, 0.03))


def spaced(points: Doubles, count: int) -> list[int]:
    """Choose at most ``count`` nodes, the last among them, evenly along the motion of control points (N, C, 3)."""
    n = len(points)
    if n - 1 <= count:
        return list(range(1, n))
    travelled = arc_length(points)
    chosen = np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count + 1)[1:-1])
    return sorted({*(int(i) for i in np.clip(chosen, 1, n - 2)), n - 1})


def arc_length(points: Doubles) -> Doubles:
    """How far the farthest control point has moved up to each node, (N,) [m], strictly growing."""
    step = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1, initial=1e-9)
    return np.concatenate(([0.0], np.cumsum(np.maximum(step, 1e-9))))


def interpolated(space: ConfigurationSpace, chart: Doubles, at: Doubles, where: Doubles) -> Doubles:
    """Chart rows (M, nv) at places ``where`` (M,) along nodes (N, nv) that lie at ``at`` (N,)."""
    if len(chart) == 1:
        return np.repeat(chart, len(where), axis=0)
    index = np.clip(np.searchsorted(at, where, side="right") - 1, 0, len(chart) - 2)
    s = np.clip((where - at[index]) / (at[index + 1] - at[index]), 0.0, 1.0)
    return space.interpolate(chart[index], chart[index + 1], s)


def ribbon(
    space: ConfigurationSpace, chart: Doubles, colors: Doubles, width: float = 0.06, steps: int = 4
) -> MeshData | None:
    """A flat band on the floor under a planar base, coloured per segment, along the arcs that the base drives.

    Args:
        space: The robot's configuration space.
        chart: Nodes (N, nv).
        colors: (N - 1, 3) linear RGB.
        width: Width of the band [m].
        steps: Pieces per segment, so that arcs look like arcs.

    Returns:
        None where the base does not move.
    """
    if len(chart) < 2 or not space.planar:
        return None
    s = np.broadcast_to(np.linspace(0.0, 1.0, steps + 1), (len(chart) - 1, steps + 1))
    path = space.interpolate(chart[:-1, None], chart[1:, None], s)[..., :2]
    flat = path.reshape(-1, 2)  # ((N - 1) (steps + 1), 2): the ends of a segment appear twice, once for each colour
    along = np.zeros_like(flat)
    along[1:-1] = flat[2:] - flat[:-2]
    along[0], along[-1] = flat[1] - flat[0], flat[-1] - flat[-2]
    size = np.linalg.norm(along, axis=1, keepdims=True)
    if size.max() < 1e-9:
        return None
    along = np.divide(along, size, out=np.zeros_like(along), where=size > 1e-9)
    side = 0.5 * width * np.column_stack((-along[:, 1], along[:, 0]))
    vertices = np.zeros((2 * len(flat), 3), dtype=np.float32)
    vertices[0::2, :2], vertices[1::2, :2] = flat + side, flat - side
    i = 2 * (np.arange(len(chart) - 1)[:, None] * (steps + 1) + np.arange(steps)[None]).reshape(-1)
    faces = np.vstack((np.column_stack((i, i + 1, i + 3)), np.column_stack((i, i + 3, i + 2)))).astype(np.uint32)
    normals = np.tile(np.array([0, 0, 1], dtype=np.float32), (len(vertices), 1))
    return MeshData(vertices, normals, faces, np.repeat(colors, 2 * (steps + 1), axis=0).astype(np.float32))


def threads(points: Doubles, radius: float) -> Floats:
    """Matrices (C (N - 1), 16) of rods along each control point's way through the nodes (N, C, 3)."""
    starts = np.swapaxes(points[:-1], 0, 1).reshape(-1, 3)
    ends = np.swapaxes(points[1:], 0, 1).reshape(-1, 3)
    return between(starts, ends, radius)
