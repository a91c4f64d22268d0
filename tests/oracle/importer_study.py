"""Importers of scenes against an independent reading by points: what a format says is occupied must be in the scene.

``python tests/oracle/importer_study.py --scenes 300 --seed 1`` writes random files of every format (``--format`` names
one), says with plain NumPy, from the format's definition, which points of the world are occupied, reads the file, and
asks with Coal and NumPy which of them the scene does not hold. It prints points, missed ones, and, of grids, points of
free cells that the scene holds. Nothing here uses the importers' own code.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import struct
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import coal
import numpy as np
import yaml

import elastic_strips as es
from elastic_strips.io.scene_source import SceneOptions

Rng = np.random.Generator
TOLERANCE = 2e-6
"""By which a point may be outside of a scene [m]: Coal's own."""
POINTS = 120
"""Points that are looked at, of a scene at most ten times as many."""


@dataclass
class Case:
    """A file, how it is read, and points of the world that are occupied, or free (N, 3)."""

    path: Path
    occupied: np.ndarray
    free: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    options: SceneOptions = field(default_factory=SceneOptions)


@dataclass
class Count:
    """What came of a format's files."""

    scenes: int = 0
    points: int = 0
    missed: int = 0
    free: int = 0
    extra: int = 0
    seconds: float = 0.0
    worst: float = 0.0
    bad: list[str] = field(default_factory=list)


# Poses


def turn(axis: Any, angle: float) -> np.ndarray:
    """Rodrigues' rotation."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


class Pose:
    """A rotation about an axis, and a place."""

    def __init__(self, rng: Rng | None = None, *, far: float = 3.0, upright: bool = False, at: Any = None) -> None:
        self.axis, self.angle, self.at = np.array([0.0, 0.0, 1.0]), 0.0, np.zeros(3)
        if rng is not None:
            self.axis = np.array([0.0, 0.0, 1.0]) if upright else rng.normal(size=3)
            self.axis = self.axis / np.linalg.norm(self.axis)
            self.angle = float(rng.choice([0.0, math.pi / 2, -math.pi, rng.uniform(-math.pi, math.pi)]))
            self.at = rng.uniform(-far, far, 3)
        if at is not None:
            self.at = np.asarray(at, dtype=float)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return points @ turn(self.axis, self.angle).T + self.at

    @property
    def quat(self) -> np.ndarray:
        return np.array([*(math.sin(self.angle / 2) * self.axis), math.cos(self.angle / 2)])

    def message(self, position: str = "position", orientation: str = "orientation") -> dict[str, Any]:
        return {
            position: dict(zip("xyz", self.at.tolist(), strict=True)),
            orientation: dict(zip("xyzw", self.quat.tolist(), strict=True)),
        }

    @property
    def row(self) -> list[float]:
        return [*self.at.tolist(), *self.quat.tolist()]


# Points of shapes, in their own frames


def in_box(rng: Rng, size: Any, n: int) -> np.ndarray:
    p = rng.uniform(-0.5, 0.5, (n, 3))
    k = np.arange(n // 2)
    p[k, rng.integers(0, 3, len(k))] = rng.choice([-0.5, 0.5], len(k))  # half of them on faces
    return p * np.asarray(size)


def in_sphere(rng: Rng, r: float, n: int) -> np.ndarray:
    p = rng.normal(size=(n, 3))
    return p / np.linalg.norm(p, axis=1)[:, None] * r * rng.choice([1.0, 0.9, 0.3], (n, 1))


def in_cylinder(rng: Rng, r: float, length: float, n: int) -> np.ndarray:
    a, s = rng.uniform(0, 2 * math.pi, n), r * np.sqrt(rng.choice([1.0, 0.5, 0.1], n))
    return np.column_stack((s * np.cos(a), s * np.sin(a), length * rng.choice([-0.5, 0.5, 0.1, -0.3], n)))


def in_cone(rng: Rng, r: float, length: float, n: int) -> np.ndarray:
    a, h = rng.uniform(0, 2 * math.pi, n), rng.uniform(0, 1, n)
    s = r * (1 - h) * rng.choice([1.0, 0.5], n)
    return np.column_stack((s * np.cos(a), s * np.sin(a), length * (h - 0.5)))


def on_triangles(rng: Rng, vertices: np.ndarray, faces: np.ndarray, n: int) -> np.ndarray:
    w = rng.dirichlet(np.ones(3), n)
    return np.einsum("nk,nkd->nd", w, vertices[faces[rng.integers(0, len(faces), n)]])


def some_mesh(rng: Rng, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles and points: a hull of many corners, a ring, an L of two boxes, or a bowl that is open."""
    kind = rng.integers(0, 4)
    if kind == 0:
        from scipy.spatial import ConvexHull

        points = rng.normal(size=(int(rng.integers(8, 60)), 3)) * rng.uniform(0.1, 0.5, 3)
        hull = ConvexHull(points)
        a, b, c = points[hull.simplices].transpose(1, 0, 2)
        inward = np.einsum("nk,nk->n", np.cross(b - a, c - a), a - points.mean(axis=0)) < 0.0
        faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
        inside = rng.dirichlet(np.ones(len(points)) * 0.1, n // 2) @ points
        return points, faces, np.vstack((on_triangles(rng, points, faces, n), inside))
    if kind == 1:  # a ring: concave, closed
        R, r, N, M = rng.uniform(0.3, 0.6), rng.uniform(0.05, 0.15), int(rng.integers(6, 14)), int(rng.integers(4, 8))
        u, v = (2 * math.pi * np.arange(k) / k for k in (N, M))
        U, V = np.meshgrid(u, v, indexing="ij")
        points = np.stack(((R + r * np.cos(V)) * np.cos(U), (R + r * np.cos(V)) * np.sin(U), r * np.sin(V)), -1)
        index = np.arange(N * M).reshape(N, M)
        a, b = index, np.roll(index, -1, 0)
        c, d = np.roll(index, -1, 1), np.roll(np.roll(index, -1, 0), -1, 1)
        faces = np.concatenate([np.stack((a, b, d), -1).reshape(-1, 3), np.stack((a, d, c), -1).reshape(-1, 3)])
        points = points.reshape(-1, 3)
        return points, faces, on_triangles(rng, points, faces, n)
    if kind == 2:  # two boxes that touch along a face
        size = rng.uniform(0.2, 0.8, 3)
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
        one, two = corners * size, corners * size * [0.4, 1.0, 1.0] + size * [0.0, 0.0, 1.0]
        points = np.vstack((one, two))
        some = rng.uniform(0, 1, (2, n // 2, 3)) * size
        inside = np.vstack((some[0], some[1] * [0.4, 1, 1] + size * [0, 0, 1]))
        return points, np.vstack((faces, faces + 8)), inside
    N, M = int(rng.integers(5, 12)), int(rng.integers(3, 6))  # an open bowl
    ring = [(math.sin(0.5 * math.pi * k / M), 1 - math.cos(0.5 * math.pi * k / M)) for k in range(1, M + 1)]
    points = np.array(
        [[0.0, 0.0, 0.0]]
        + [[s * math.cos(2 * math.pi * i / N), s * math.sin(2 * math.pi * i / N), h] for s, h in ring for i in range(N)]
    ) * rng.uniform(0.1, 0.5)
    faces = [(0, 1 + (i + 1) % N, 1 + i) for i in range(N)]
    for k in range(M - 1):
        for i in range(N):
            a, b = 1 + k * N + i, 1 + k * N + (i + 1) % N
            faces += [(a, b, b + N), (a, b + N, a + N)]
    return points, np.array(faces), on_triangles(rng, points, np.array(faces), n)


# Nav2


def nav2_map(rng: Rng, folder: Path) -> Case:
    """Nav2's map_io: occupancy of a pixel, and where the cell of (row, column) is."""
    rows, columns = rng.integers(1, 40, 2).tolist()
    resolution = float(rng.choice([0.05, 0.1, 1.0 / 3.0, 0.5]))
    x, y = rng.uniform(-20, 20, 2)
    yaw = float(rng.choice([0.0, rng.uniform(-math.pi, math.pi), rng.uniform(-30.0, 30.0)]))
    top = int(rng.choice([255, 255, 100, 65535]))
    image = rng.choice(
        [0, top, top * 205 // 255, int(rng.integers(0, top + 1))], (rows, columns), p=[0.2, 0.5, 0.2, 0.1]
    )
    negate = bool(rng.integers(0, 2))
    occupied, free = float(rng.uniform(0.5, 0.9)), float(rng.uniform(0.05, 0.4))
    mode = str(rng.choice(["trinary", "scale", "raw"])) if top == 255 else "trinary"
    end = str(rng.choice(["\n", "\r\n"]))
    comment = str(rng.choice(["", f"# made by somebody{end}"]))
    ascii = bool(rng.integers(0, 2))
    head = f"{'P2' if ascii else 'P5'}{end}{comment}{columns} {rows}{end}{top}{end}".encode()
    body = image.astype(np.uint8 if top < 256 else ">u2").tobytes()
    (folder / "m.pgm").write_bytes(head + (" ".join(map(str, image.ravel())).encode() if ascii else body))
    document = {
        "image": "m.pgm", "resolution": resolution, "origin": [float(x), float(y), yaw], "negate": int(negate),
        "occupied_thresh": occupied, "free_thresh": free, "mode": mode,
    }  # fmt: skip
    (folder / "m.yaml").write_text(yaml.safe_dump(document))
    shade = image / top
    p = shade if negate else 1.0 - shade
    full = (p > occupied) if mode != "raw" else (np.rint(shade * 255) == 100)
    empty = (p < free) if mode != "raw" else (np.rint(shade * 255) == 0)
    options: SceneOptions = {"outside": "free"}
    low, high = 0.0, 3.0
    place = Pose()
    if rng.integers(0, 2):
        place = Pose(rng, upright=True)
        options["at"] = [*place.at.tolist(), math.remainder(place.angle, 2 * math.pi)]
    if rng.integers(0, 2):
        low, high = sorted(rng.uniform(-1.0, 2.5, 2).tolist())
        options.update(low=low, high=high)

    def points(cells: np.ndarray) -> np.ndarray:
        found = np.argwhere(cells)
        if not len(found):
            return np.zeros((0, 3))
        row, column = found[rng.integers(0, len(found), POINTS)].T
        u, v = rng.uniform(0.02, 0.98, (2, POINTS))
        mx, my = (column + u) * resolution, (rows - 1 - row + v) * resolution
        wx = x + math.cos(yaw) * mx - math.sin(yaw) * my
        wy = y + math.sin(yaw) * mx + math.cos(yaw) * my
        world = place(np.column_stack((wx, wy, np.zeros(POINTS))))
        world[:, 2] = rng.uniform(low, high, POINTS)
        return world

    return Case(folder / "m.yaml", points(full), points(empty), options)


# OctoMap


def octree(rng: Rng) -> tuple[dict, float, np.ndarray, np.ndarray]:
    """A tree of nested dicts, its resolution, and the occupied and free leaves (n, 4): low corner and edge [m]."""
    resolution = float(rng.choice([0.05, 0.1, 0.25]))
    root: dict = {}
    leaves = []
    for _ in range(int(rng.integers(5, 80))):
        depth = int(rng.choice([16, 16, 16, 15, 14, 13]))
        span = 1 << (16 - depth)
        keys = (rng.integers(-24, 24, 3) // span * span + 32768).tolist()
        node, path = root, []
        for level in range(15, 16 - depth - 1, -1):
            path.append(sum((key >> level & 1) << axis for axis, key in enumerate(keys)))
        for child in path[:-1]:
            step = node.setdefault(child, {})
            if not isinstance(step, dict):
                break
            node = step
        else:
            if path[-1] in node:
                continue
            value = float(rng.choice([2.0, 0.5, -0.4, -2.0]))
            node[path[-1]] = value
            leaves.append([*((np.array(keys) - 32768) * resolution), span * resolution, value])
    found = np.array(leaves).reshape(-1, 5)
    return root, resolution, found[found[:, 4] >= 0][:, :4], found[found[:, 4] < 0][:, :4]


def tree_bytes(node: Any, binary: bool) -> bytes:
    if binary:

        def bits(child: Any) -> int:
            return 0 if child is None else 3 if isinstance(child, dict) else 2 if child >= 0 else 1

        word = sum(bits(node.get(k)) << 2 * k for k in range(8))
        inner = [node[k] for k in range(8) if isinstance(node.get(k), dict)]
        return struct.pack("<H", word) + b"".join(tree_bytes(child, True) for child in inner)
    if not isinstance(node, dict):
        return struct.pack("<fB", node, 0)
    head = struct.pack("<fB", 0.3, sum(1 << k for k in node))
    return head + b"".join(tree_bytes(node[k], False) for k in sorted(node))


def nodes_of(node: Any) -> int:
    return 1 + (sum(map(nodes_of, node.values())) if isinstance(node, dict) else 0)


def leaf_points(rng: Rng, leaves: np.ndarray, n: int = POINTS) -> np.ndarray:
    if not len(leaves):
        return np.zeros((0, 3))
    chosen = leaves[rng.integers(0, len(leaves), n)]
    return chosen[:, :3] + rng.uniform(0.02, 0.98, (n, 3)) * chosen[:, 3:]


def octomap(rng: Rng, folder: Path) -> Case:
    binary = bool(rng.integers(0, 2))
    while True:
        root, resolution, full, empty = octree(rng)
        if len(full):
            break
    what = "OcTree binary file" if binary else "OcTree file"
    head = f"# Octomap {what}\n# made\nid OcTree\nsize {nodes_of(root)}\nres {resolution}\ndata\n"
    path = folder / ("m.bt" if binary else "m.ot")
    path.write_bytes(head.encode() + tree_bytes(root, binary))
    options: SceneOptions = {}
    place = Pose()
    if rng.integers(0, 2):
        place = Pose(rng)
        options["at"] = place.row
    occupied, free = place(leaf_points(rng, full)), place(leaf_points(rng, empty))
    if rng.integers(0, 2):
        low, high = np.sort(
            np.quantile(occupied[:, 2], rng.uniform(0.0, 1.0, 2)) + rng.uniform(-0.05, 0.05, 2)
        ).tolist()
        keep = (occupied[:, 2] > low) & (occupied[:, 2] < high)
        if keep.any():
            options.update(low=low, high=high)
            occupied = occupied[keep]
    return Case(path, occupied, free, options)


# Clouds


def cloud(rng: Rng, folder: Path) -> Case:
    """Points as they are in the file, in single precision where the format has that; times scale; at the pose."""
    n = int(rng.integers(1, 200))
    scale = float(rng.choice([1.0, 0.001, 2.5]))
    points = (rng.uniform(-3, 3, (n, 3)) + rng.uniform(-5, 5, 3)) / scale
    if rng.integers(0, 3) == 0:
        points = np.round(points * scale, 1) / scale  # on the edges of cells
    kind = str(rng.choice(["xyz", "ply", "plyb", "pcd", "pcdb", "npy", "csv"]))
    single = points.astype(np.float32).astype(float)
    path = folder / f"c.{kind[:3]}"
    text = "\n".join(" ".join(map(repr, row)) for row in points.tolist()) + "\n"
    if kind == "xyz":
        path.write_text("# x y z\n" + text)
    elif kind == "csv":
        path.write_text(text.replace(" ", ","))
    elif kind == "npy":
        np.save(path, points)
    elif kind == "ply":
        head = f"ply\nformat ascii 1.0\nelement vertex {n}\n" + "".join(f"property double {a}\n" for a in "xyz")
        path.write_text(f"{head}end_header\n{text}")
    elif kind == "plyb":
        head = f"ply\nformat binary_big_endian 1.0\nelement vertex {n}\nproperty uchar c\n"
        head += "".join(f"property float {a}\n" for a in "zxy") + "end_header\n"
        path.write_bytes(head.encode() + b"".join(struct.pack(">Bfff", 3, z, x, y) for x, y, z in single.tolist()))
        points = single
    else:
        bad = rng.integers(0, 2)  # points that are none
        rows = [*single.tolist(), *([[math.nan] * 3] if bad else [])]
        head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x i y z\nSIZE 4 2 4 4\nTYPE F U F F\nCOUNT 1 2 1 1\n"
        head += f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\n"
        if kind == "pcd":
            path.write_text(head + "DATA ascii\n" + "".join(f"{x!r} 1 2 {y!r} {z!r}\n" for x, y, z in rows))
        else:
            body = b"".join(struct.pack("<fHHff", x, 1, 2, y, z) for x, y, z in rows)
            path.write_bytes((head + "DATA binary\n").encode() + body)
        points = single
    voxel = float(rng.choice([0.02, 0.05, 0.1, 0.3]))
    options: SceneOptions = {"voxel": voxel, "scale": scale}
    place = Pose()
    if rng.integers(0, 2):
        place = Pose(rng)
        options["at"] = place.row
    world = place(points * scale)
    if rng.integers(0, 2):
        low, high = sorted(rng.uniform(world[:, 2].min() - 0.1, world[:, 2].max() + 0.1, 2).tolist())
        keep = (world[:, 2] >= low) & (world[:, 2] <= high)
        if keep.any():
            options.update(low=low, high=high)
            world = world[keep]
    probes = world[rng.integers(0, len(world), POINTS)] + rng.normal(size=(POINTS, 3)) * 0.5
    gap = np.linalg.norm(probes[:, None] - world[None], axis=2).min(axis=1)
    return Case(path, world, probes[gap > voxel * math.sqrt(3.0) + 1e-6], options)


# MoveIt


def shape(rng: Rng, *, plane: bool = True, prism: bool = True) -> tuple[str, list[float], Any, np.ndarray]:
    """Kind, sizes as the text format has them, more of it, and points in the shape's frame."""
    kinds = ["box", "sphere", "cylinder", "cone", "mesh", *(["plane"] if plane else []), *(["prism"] if prism else [])]
    kind = str(rng.choice(kinds))
    a, b, c = rng.uniform(0.05, 0.8, 3).tolist()
    n = 12
    if kind == "box":
        return kind, [a, b, c], None, in_box(rng, (a, b, c), n)
    if kind == "sphere":
        return kind, [a], None, in_sphere(rng, a, n)
    if kind == "cylinder":
        return kind, [a, b], None, in_cylinder(rng, a, b, n)
    if kind == "cone":
        return kind, [a, b], None, in_cone(rng, a, b, n)
    if kind == "mesh":
        vertices, faces, points = some_mesh(rng, n)
        return kind, [], (vertices, faces), points
    if kind == "prism":
        count = int(rng.integers(3, 8))
        angles = np.sort(rng.uniform(0, 2 * math.pi, count)) if count > 3 else np.array([0.1, 2.0, 4.5])
        outline = a * np.column_stack((np.cos(angles), np.sin(angles)))
        inside = rng.dirichlet(np.ones(count), n) @ outline
        return kind, [b], outline, np.column_stack((inside, b * rng.uniform(-0.5, 0.5, n)))
    normal = rng.normal(size=3) * rng.choice([1.0, 2.0])
    d = float(rng.uniform(-2, 2))
    one = np.cross(normal, rng.normal(size=3))
    two = np.cross(normal, one)
    u, v = rng.uniform(-30, 30, (2, n, 1))
    points = -d * normal / (normal @ normal) + u * one / np.linalg.norm(one) + v * two / np.linalg.norm(two)
    return kind, [*normal.tolist(), d], None, points


def moveit_text(rng: Rng, folder: Path) -> Case:
    posed = bool(rng.integers(0, 2))
    lines, occupied = ["room"], []
    for k in range(int(rng.integers(1, 7))):
        lines.append(f"* thing {k}")
        whole = Pose(rng) if posed else Pose()
        if posed:
            lines += [" ".join(map(repr, whole.row[:3])), " ".join(map(repr, whole.row[3:]))]
        count = int(rng.integers(1, 4))
        lines.append(str(count))
        for _ in range(count):
            kind, sizes, more, points = shape(rng, prism=False)
            place = Pose(rng)
            lines.append(kind)
            if kind == "mesh":
                lines.append(f"{len(more[0])} {len(more[1])}")
                lines += [" ".join(map(repr, row)) for row in more[0].tolist()]
                lines += [" ".join(map(str, row)) for row in more[1].tolist()]
            else:
                lines.append(" ".join(map(repr, sizes)))
            lines += [" ".join(map(repr, place.row[:3])), " ".join(map(repr, place.row[3:])), "0 0 0 0"]
            occupied.append(whole(place(points)))
        if posed:
            lines += ["1", "grip", " ".join(map(repr, Pose(rng).row[:3])), "0 0 0 1"]
    (folder / "s.scene").write_text("\n".join([*lines, "."]) + "\n")
    return _placed(rng, folder / "s.scene", np.vstack(occupied))


def _placed(rng: Rng, path: Path, points: np.ndarray) -> Case:
    """The same read at a pose, or as it is."""
    if rng.integers(0, 2):
        return Case(path, points)
    place = Pose(rng)
    return Case(path, place(points), options={"at": place.row})


def _message_shapes(rng: Rng, count: int) -> tuple[dict[str, Any], list[np.ndarray]]:
    """The arrays of a CollisionObject, and points of its shapes in the object's frame."""
    types = {"box": 1, "sphere": 2, "cylinder": 3, "cone": 4, "prism": 5}
    keys = ("primitives", "primitive_poses", "meshes", "mesh_poses", "planes", "plane_poses")
    made: dict[str, list[Any]] = {key: [] for key in keys}
    points = []
    for _ in range(count):
        kind, sizes, more, found = shape(rng)
        place = Pose(rng)
        if kind == "mesh":
            made["meshes"].append({
                "vertices": [dict(zip("xyz", row, strict=True)) for row in more[0].tolist()],
                "triangles": [{"vertex_indices": row} for row in more[1].tolist()],
            })  # fmt: skip
            made["mesh_poses"].append(place.message())
        elif kind == "plane":
            made["planes"].append({"coef": sizes})
            made["plane_poses"].append(place.message())
        else:
            one: dict[str, Any] = {"type": types[kind], "dimensions": sizes[::-1] if len(sizes) == 2 else sizes}
            if kind == "prism":
                one["polygon"] = {"points": [{"x": x, "y": y, "z": 9.0} for x, y in more.tolist()]}
            made["primitives"].append(one)
            made["primitive_poses"].append(place.message())
        points.append(place(found))
    return made, points


def transform(parent: str, child: str, step: Pose) -> dict[str, Any]:
    """A ``geometry_msgs/TransformStamped``."""
    move = step.message("translation", "rotation")
    return {"header": {"frame_id": parent}, "child_frame_id": child, "transform": move}


def planning_scene(rng: Rng, folder: Path) -> Case:
    """A message: frames that hang on each other, objects in frames, in other objects, and in their subframes."""
    world = str(rng.choice(["world", "map", "base_footprint"]))
    frames: dict[str, list[Pose]] = {world: []}
    transforms = []
    for name in ("table", "camera", "shelf")[: int(rng.integers(0, 4))]:
        parent = str(rng.choice(list(frames)))
        step = Pose(rng)
        frames[name] = [*frames[parent], step]
        transforms.append(transform(parent, name, step))
    rng.shuffle(transforms)
    if not transforms or rng.integers(0, 2):
        transforms.append(transform(world, world, Pose()))

    def to_world(frame: str, points: np.ndarray) -> np.ndarray:
        for step in reversed(frames[frame]):
            points = step(points)
        return points

    objects, occupied = [], []
    for k in range(int(rng.integers(1, 6))):
        frame = str(rng.choice(list(frames)))
        made, points = _message_shapes(rng, int(rng.integers(1, 4)))
        header = {"frame_id": str(rng.choice(["/", ""])) + frame, "stamp": {"sec": 0, "nanosec": 0}}
        one = {"id": f"thing{k}", "header": header, **made, "operation": 0}
        pose = Pose()
        if rng.integers(0, 3):
            pose = Pose(rng)
            one["pose"] = pose.message()
        if rng.integers(0, 2):
            sub = Pose(rng)
            one.update(subframe_names=["grip"], subframe_poses=[sub.message()])
            frames[f"thing{k}/grip"] = [*frames[frame], pose, sub]
        frames[f"thing{k}"] = [*frames[frame], pose]
        occupied += [to_world(frame, pose(p)) for p in points]
        objects.append(one)
    inner: dict[str, Any] = {"collision_objects": objects}
    if rng.integers(0, 3) == 0:
        root, resolution, full, _ = octree(rng)
        binary = bool(rng.integers(0, 2))
        data = np.frombuffer(tree_bytes(root, binary), np.int8).tolist()
        frame, origin = str(rng.choice([f for f in frames if "thing" not in f])), Pose(rng)
        tree = {"header": {"frame_id": ""}, "binary": binary, "id": "OcTree", "resolution": resolution, "data": data}
        inner["octomap"] = {"header": {"frame_id": frame}, "origin": origin.message(), "octomap": tree}
        occupied.append(to_world(frame, origin(leaf_points(rng, full, 40))))
    else:
        inner["octomap"] = {"header": {"frame_id": ""}, "origin": Pose().message(), "octomap": {"data": []}}
    document = {"name": "made", "robot_model_name": "panda", "fixed_frame_transforms": transforms, "world": inner}
    if rng.integers(0, 3) == 0:
        document = {"scene": document}
    if rng.integers(0, 2):
        path = folder / "p.json"
        path.write_text(json.dumps(document))
    else:
        path = folder / "p.yaml"
        path.write_text(yaml.safe_dump(document, sort_keys=False) + ("---\n" if rng.integers(0, 2) else ""))
    return _placed(rng, path, np.vstack(occupied))


# The library's own scene files


def scene_file(rng: Rng, folder: Path) -> Case:
    """Obstacles of all shapes, as docs/scene-files.md has them."""
    obstacles, occupied = [], []
    for _ in range(int(rng.integers(1, 8))):
        kind, sizes, more, points = shape(rng, plane=False, prism=False)
        place = Pose(rng)
        one: dict[str, Any] = {"shape": kind, "at": place.at.tolist()}
        if rng.integers(0, 2):
            one["quat"] = place.quat.tolist()
        else:  # of Rz Ry Rx
            R = turn(place.axis, place.angle)
            pitch = -math.asin(min(max(R[2, 0], -1), 1))
            one["rpy"] = [math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])]
            if abs(R[2, 0]) > 0.999:
                one["quat"] = place.quat.tolist()
                del one["rpy"]
        if kind == "box":
            one["size"] = sizes
        elif kind == "mesh":
            one.update(vertices=more[0].tolist(), faces=more[1].tolist())
        else:
            one.update(zip(("radius", "length"), sizes, strict=False))
        obstacles.append(one)
        occupied.append(place(points))
    (folder / "s.yaml").write_text(yaml.safe_dump({"obstacles": obstacles}))
    return _placed(rng, folder / "s.yaml", np.vstack(occupied))


def sources(rng: Rng, folder: Path) -> Case:
    """Several of the others in one scene, each with what is said of it."""
    entries, occupied = [], []
    kinds = [nav2_map, octomap, cloud, moveit_text, planning_scene, scene_file]
    for k in range(int(rng.integers(2, 5))):
        make = kinds[int(rng.integers(0, len(kinds)))]
        inner = folder / f"part{k}"
        inner.mkdir()
        case = make(rng, inner)
        options: dict[str, Any] = dict(case.options)
        occupied.append(case.occupied)
        name = str(case.path.relative_to(folder))
        entries.append({"file": name, **options} if options else name)
    (folder / "all.yaml").write_text(yaml.safe_dump({"sources": entries}))
    return Case(folder / "all.yaml", np.vstack(occupied))


FORMATS: dict[str, Callable[[Rng, Path], Case]] = {
    "nav2": nav2_map, "octomap": octomap, "cloud": cloud, "moveit": moveit_text, "planning-scene": planning_scene,
    "scene": scene_file, "sources": sources,
}  # fmt: skip


def depths(scene: es.Scene, points: np.ndarray) -> np.ndarray:
    """How far outside of the scene points are [m], or 0 and below: boxes by NumPy, all else by Coal."""
    out = np.full(len(points), np.inf)
    ball, here = coal.Sphere(1e-9), coal.Transform3s()
    request = coal.DistanceRequest()
    for part, R, t in zip(scene.table.parts, scene.table.rotation, scene.table.translation, strict=True):
        local = (points - t) @ R
        for box, at in part.boxes:
            gap = (np.abs(local - at) - np.asarray(box.halfSide)).max(axis=1)
            np.minimum(out, gap, out=out)
        if part.geometry is None:
            continue
        box = part.geometry.aabb_local
        near = ((local >= np.ravel(box.min_) - 1e-4) & (local <= np.ravel(box.max_) + 1e-4)).all(axis=1)
        for k in np.flatnonzero(near & (out > 0.0)).tolist():
            found = coal.DistanceResult()
            place = coal.Transform3s(np.eye(3), local[k])
            out[k] = min(out[k], coal.distance(part.geometry, here, ball, place, request, found) + 1e-9)
    return out


def run(name: str, scenes: int, seed: int) -> Count:
    """Read so many random files of a format."""
    count = Count()
    began = time.perf_counter()
    for k in range(scenes):
        rng = np.random.default_rng([seed, list(FORMATS).index(name), k])
        with tempfile.TemporaryDirectory() as folder:
            case = FORMATS[name](rng, Path(folder))
            try:
                scene = es.read_scene(case.path, options=case.options)
            except es.errors.SceneError as error:
                count.bad.append(f"{name} {k}: refused: {error}")
                continue
        gap, extra = depths(scene, case.occupied), depths(scene, case.free)
        count.scenes += 1
        count.points += len(gap)
        count.missed += int((gap > TOLERANCE).sum())
        count.worst = max(count.worst, float(gap.max(initial=0.0)))
        count.free += len(extra)
        count.extra += int((extra < -TOLERANCE).sum())
        if (gap > TOLERANCE).any():
            count.bad.append(f"{name} {k}: {(gap > TOLERANCE).sum()} of {len(gap)} missed, by {gap.max():.3g} m")
        if (extra < -TOLERANCE).any():
            count.bad.append(f"{name} {k}: {(extra < -TOLERANCE).sum()} of {len(extra)} free points are held")
    count.seconds = time.perf_counter() - began
    return count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--format", choices=FORMATS, action="append")
    given = parser.parse_args()
    logging.disable(logging.WARNING)
    heads = ("files", "points", "missed", "worst [m]", "free", "held", "time [s]")
    print(f"{'format':15}" + "".join(f"{head:>10}" for head in heads))
    for name in given.format or FORMATS:
        c = run(name, given.scenes, given.seed)
        values = (c.scenes, c.points, c.missed, f"{c.worst:.2g}", c.free, c.extra, f"{c.seconds:.1f}")
        print(f"{name:15}" + "".join(f"{value:>10}" for value in values), flush=True)
        for line in c.bad[:8]:
            print(f"    {line[:400]}")


if __name__ == "__main__":
    main()
