"""Check a proof that a robot's path is free of collisions. It needs NumPy, and nothing else of this package.

    python proof_checker.py PROOF.npz [--robot DIGEST] [--scene DIGEST] [--path DIGEST]      (exits with 0, or with 3)

The proof says what the robot is (joints with convex bodies), what the obstacles are (convex shapes that stand still),
the rows of the path, and which way it goes between them; docs/certify.md describes the file. For each segment between
two rows and each pair of shapes that must not meet it has intervals, with directions at both ends. None is believed:

1.  It places the bodies at both ends of the interval. Along the direction n, body A ends at max n·a and shape B begins
    at min n·b: they are apart by the difference at least. A wrong direction makes this gap small, never too large.
2.  Between the ends no point moves further than L, the sum over the joints of how far each one turns times how far any
    point can be from its axis: a part of L from one end and the rest from the other. So the pair stays apart by the
    clearance c all along if gap + gap > L + 2 c.
3.  The intervals of each segment and pair cover it from 0 to 1 without a hole, and no pair is missing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
Part = dict[str, Any]  # of the header, as JSON has it
FORMAT, VERSION = "elastic_strips.proof", 2
ROUNDING = 1e-7  # [m] more than what floating point can add to any of these sums, as long as numbers are no larger than
LARGEST, FARTHEST, RIGHT = 1e4, 1e6, 1e-12  # [m, rad] sizes and joints; [m] places; what rotations may be off
HALF_TURN = np.pi - 1e-6  # a turn by more than this has no one direction
MOST, MOST_BYTES, MOST_TEXT, MOST_WORK = 1_000_000, 70_000_000, 10_000_000, 6e6  # intervals, pairs; bytes; of text; µs
SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "cone": 2, "ellipsoid": 3, "convex": 0}
ROBOT = {"name": str, "columns": list, "planar": bool, "joints": list, "circular": list, "bodies": list, "pairs": list}
JOINT: Part = {"parent": int, "column": int, "slides": bool, "offset": list, "multiplier": object, "constant": object}
SHAPE = dict.fromkeys(("sizes", "points", "rotation", "translation"), list) | dict(name=str, kind=str, grown=object)
HEADER: Part = {"format": str, "version": int, "way": str, "clearance": object, "self_clearance": object, "robot": dict}


class Refused(Exception):
    """The proof does not hold; the message says where."""


def digest(part: object) -> str:
    """A name for a part of the proof that no other part has."""
    return hashlib.sha256(json.dumps(part, sort_keys=True, separators=(",", ":")).encode()).hexdigest()[:32]


def path_digest(rows: object, way: str) -> str:
    """The name of a path: its rows (N, nv), as its owner has them, and which way it goes between them."""
    return digest({"rows": (np.array(rows, dtype=float) + 0.0).tolist(), "way": way})  # no negative zeros


def demand(holds: object, message: str) -> None:
    if not holds:
        raise Refused(message)


def table(parts: list[Part], kinds: Part, what: str) -> Part:
    """The values by key of parts that have these keys and no others, of these very types (object: a number)."""
    demand(all(type(p) is dict and p.keys() == kinds.keys() for p in parts), f"{what}: other keys than {list(kinds)}")
    demand(all(k in (object, type(p[key])) for p in parts for key, k in kinds.items()), f"{what}: of another type")
    return {key: [p[key] for p in parts] for key in kinds}


def numbers(value: object, shape: tuple[int | None, ...], what: str, most: float = LARGEST, kind: str = "fi") -> Array:
    """An array of finite numbers of this shape, none beyond ``most``; a size of None is any. (3, 3) is a rotation."""
    if not isinstance(value, np.ndarray):  # what JSON has: numbers all through, no text and no truth values
        kinds, empty = {type(entry) for entry in np.array(value, dtype=object).ravel()}, value == [] and None in shape
        value = np.zeros([n or 0 for n in shape], int) if empty else np.array(value if kinds <= {int, float} else "")
    fits = value.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, value.shape, strict=True))
    fits = fits and value.dtype.kind in kind and value.dtype.itemsize in (4, 8) and value.min(initial=0) >= -most
    demand(fits and value.max(initial=0) <= most, f"{what}: no array {shape} of numbers up to {most:g}")
    if shape[-2:] == (3, 3):
        off = np.abs(value @ np.swapaxes(value, -1, -2) - np.eye(3)).max(initial=0.0)
        demand(off < RIGHT and (np.linalg.det(value) > 0).all(), f"{what} is no rotation")
    return value.astype(float, copy=False)


class Shape:
    """A convex shape about the origin of its own frame, grown by the radius of a ball."""

    def __init__(self, part: Part, what: str) -> None:
        self.kind: str = part["kind"]
        demand(self.kind in SIZES, f"{what}: shape of kind {self.kind!a}")
        self.sizes: Array = numbers(part["sizes"], (SIZES[self.kind],), what)
        self.points: Array = numbers(part["points"], (None, 3), what)
        self.grown: float = float(numbers(part["grown"], (), what))
        self.rotation: Array = numbers(part["rotation"], (3, 3), what)
        self.at: Array = numbers(part["translation"], (3,), what, FARTHEST)
        whole = (self.sizes > 0).all() and self.grown >= 0.0 and (self.kind == "convex") == (len(self.points) > 0)
        demand(whole, f"{what}: a size is negative, or it has points and is no hull of them")
        half = self.sizes.sum() if self.kind == "capsule" else np.linalg.norm(self.sizes)
        corners = self.at + (self.points @ self.rotation.T if self.kind == "convex" else np.zeros((1, 3)))
        self.far = float(self.grown + half + np.linalg.norm(corners, axis=1).max())  # from the frame's origin, at most

    def support(self, n: Array) -> Array:
        """max n·x over the shape's points (K,), for directions n (K, 3) of length 1 in its own frame."""
        s, (x, y, z), parts = self.sizes, n.T, np.array_split(n, len(n) * len(self.points) // 4_000_000 + 1)
        far = {
            "box": lambda: np.abs(n) @ s,
            "sphere": lambda: np.full(len(n), s[0]),
            "capsule": lambda: s[0] + s[1] * np.abs(z),
            "cylinder": lambda: s[0] * np.hypot(x, y) + s[1] * np.abs(z),
            "cone": lambda: np.maximum(s[1] * z, s[0] * np.hypot(x, y) - s[1] * z),  # its tip is up
            "ellipsoid": lambda: np.sqrt(((s * n) ** 2).sum(axis=1)),
            "convex": lambda: np.concatenate([(self.points @ part.T).max(axis=0) for part in parts]),
        }
        return self.grown + far[self.kind]()


class World:
    """Joints about or along the z axes of their frames, by a factor times a column plus a constant; and all shapes."""

    def __init__(self, robot: Part, scene: list[Part]) -> None:
        table([robot], ROBOT, "robot")
        joints, bodies, columns = table(robot["joints"], JOINT, "joints"), robot["bodies"], robot["columns"]
        count, self.nv, shapes, turns = len(robot["joints"]), len(columns), [*bodies, *scene], robot["circular"]
        demand(max(len(bodies) * len(scene), (len(shapes) + count) * count) <= MOST, "too many pairs, or joints")
        self.planar, self.parent, self.slides = robot["planar"], joints["parent"], np.array(joints["slides"])
        self.offset: Array = numbers(joints["offset"], (count, 3, 4), "offsets of the joints")
        numbers(self.offset[:, :, :3], (count, 3, 3), "offset of a joint")
        self.factor, self.plus = (numbers(joints[key], (count,), key) for key in ("multiplier", "constant"))
        demand(count and all(-1 <= p < i for i, p in enumerate(self.parent)), "a joint comes before its parent")
        still = {"parent": -1, "column": -1, "slides": False, "offset": np.eye(3, 4).tolist(), "multiplier": 1}
        demand(not self.planar or robot["joints"][0] == still | {"constant": 0}, "the base is not the first joint")
        moved, named = set(joints["column"][self.planar :]), {name for name in columns if type(name) is str}
        demand(moved == set(range(3 * self.planar, self.nv)) and len(named) == self.nv, "a column of no joint, or name")
        self.column: Whole = np.array([2] * self.planar + joints["column"][self.planar :])
        circular = [type(turn) for turn in turns] == [bool] * self.nv and not (self.planar and any(turns[:2]))
        self.turns: NDArray[np.bool_] = np.array(turns) | (self.planar & (np.arange(self.nv) == 2))  # may wrap
        wraps = ~self.slides & (self.factor == np.round(self.factor)) | ~self.turns[self.column]
        demand(circular and wraps.all(), "circular columns, or one of a joint that slides, or of parts of turns")
        table(scene, SHAPE, "scene")
        self.joint: list[int] = table(bodies, SHAPE | {"joint": int}, "bodies")["joint"] + [-1] * len(scene)
        demand(all(-1 <= j < count for j in self.joint), "a body of no joint")
        self.shapes: list[Shape] = [Shape(part, f"shape {i}") for i, part in enumerate(shapes)]
        above = np.zeros((count + 1, count), dtype=bool)  # the joints that carry a joint; the last row is the world's
        for j, parent in enumerate(self.parent):
            above[j], above[j, j] = above[parent], True
        self.carries: NDArray[np.bool_] = above[self.joint]  # (shapes, joints)
        pairs = numbers(robot["pairs"], (None, 2), "pairs", kind="i").astype(int)
        demand(((pairs >= 0) & (pairs < len(bodies))).all(), "a pair of no bodies")
        across = np.indices((len(bodies), len(scene))).reshape(2, -1).T + np.array([0, len(bodies)])
        self.pairs, self.across = np.vstack((across, pairs)), len(across)

    def place(self, rows: Array) -> dict[int, tuple[Array, Array]]:
        """Rotations and translations of the joints' frames for rows (K, nv); of the world's as -1."""
        frames = {-1: (np.tile(np.eye(3), (len(rows), 1, 1)), np.zeros((len(rows), 3)))}
        for i, offset in enumerate(self.offset):
            R, t = frames[self.parent[i]]
            R, t = R @ offset[:, :3], t + R @ offset[:, 3]
            t[:, :2] += rows[:, :2] if self.planar and i == 0 else 0.0
            value = (self.factor[i] * rows[:, self.column[i]] + self.plus[i])[:, None]
            c, s, (x, y, z) = np.cos(value), np.sin(value), np.moveaxis(R, 2, 0)
            turned = np.stack((c * x + s * y, c * y - s * x, z), axis=2)
            frames[i] = (R, t + z * value) if self.slides[i] else (turned, t)
        return frames

    def radii(self, rows: Array, v: Array) -> Array:
        """(shapes, joints) how far a point of a shape moves at most for each unit of a joint's column, on this path."""
        most = np.abs(self.factor) * (np.abs(rows).max(axis=0) + np.abs(v).max(axis=0))[self.column] + np.abs(self.plus)
        demand((most <= LARGEST).all(), f"a joint beyond {LARGEST:g}")
        out = np.zeros(self.carries.shape)
        longer = (np.linalg.norm(self.offset[:, :, 3], axis=1) + np.where(self.slides, most, 0.0)).tolist()
        for g, (shape, joint) in enumerate(zip(self.shapes, self.joint, strict=True)):
            far = shape.far
            while joint >= 0:
                out[g, joint], far, joint = far, far + longer[joint], self.parent[joint]
            demand(self.joint[g] < 0 or far * len(self.parent) < LARGEST, "a robot too large for its rounding")
        return np.abs(self.factor) * np.where(self.slides, self.carries, out)


class Path:
    """Rows, and how far each column goes (N - 1, nv) between two: linearly, angles shortest, or the base on an arc."""

    def __init__(self, world: World, rows: object, way: str) -> None:
        self.world, self.arc = world, world.planar and way == "arc"
        self.rows: Array = numbers(rows, (None, world.nv), "rows", FARTHEST)
        demand(len(self.rows) >= 2 and way in ("values", "shortest", "arc"), "less than two rows, or no way to go")
        v, turns = np.diff(self.rows, axis=0), world.turns
        v[:, turns] -= 2.0 * np.pi * np.round(v[:, turns] / (2.0 * np.pi)) if way == "shortest" else 0.0
        demand(way == "values" or (np.abs(v[:, turns]) < HALF_TURN).all(), "half a turn or more: no one way to go")
        chord = np.sinc(0.5 * v[:, 2] / np.pi) if self.arc else 1.0  # for each unit of the arc
        self.base: Array = np.hypot(v[:, 0], v[:, 1]) / chord if world.planar else np.zeros(len(v))
        self.v, self.radii = v, world.radii(self.rows, v)

    def between(self, segment: Whole, t: Array) -> Array:
        """Rows (K, nv) at the parts t (K,) of segments; the chord of a part of an arc is shorter, and turned."""
        v = self.v[segment]
        out = self.rows[segment] + t[:, None] * v
        if self.arc:
            (x, y), half = v[:, :2].T, 0.5 * v[:, 2]
            far, turn = t * np.sinc(t * half / np.pi) / np.sinc(half / np.pi), (t - 1.0) * half
            c, s = far * np.cos(turn), far * np.sin(turn)
            out[:, :2] = self.rows[segment, :2] + np.column_stack((c * x - s * y, s * x + c * y))
        return out

    def motions(self, segment: Whole, pair: Whole) -> Array:
        """(K,) how far the shapes of a pair move towards each other at most on a segment."""
        one, two = self.world.pairs[pair].T
        apart = self.world.carries[one] != self.world.carries[two]  # a joint that carries both moves them as one
        moved = np.abs(self.v[segment][:, self.world.column]) * apart * (self.radii[one] + self.radii[two])
        return moved.sum(axis=1) + self.base[segment] * apart[:, 0]

    def gaps(self, segment: Whole, t: Array, pair: Whole, n: Array) -> Array:
        """How far apart (K,) [m] the shapes of pairs are at least along directions (K, 3), at parts t of segments."""
        size, out = np.linalg.norm(n, axis=1), np.zeros(len(pair))
        demand((size > 1e-3).all(), "a direction without length")
        _, first, where = np.unique(segment + 1j * t, return_index=True, return_inverse=True)
        frames = self.world.place(self.between(segment[first], t[first]))
        for to, shapes in zip((n / size[:, None], -n / size[:, None]), self.world.pairs[pair].T, strict=True):
            order = np.argsort(shapes, kind="stable")
            for k in np.split(order, np.flatnonzero(np.diff(shapes[order])) + 1)[: len(pair)]:
                g = shapes[k[0]]
                (R, at), shape = (array[where[k]] for array in frames[self.world.joint[g]]), self.world.shapes[g]
                local = np.einsum("kij,ki->kj", R, to[k])
                out[k] -= (at * to[k]).sum(axis=1) + local @ shape.at + shape.support(local @ shape.rotation)
        return out


def check(header: Part, rows: Array, segment: Whole, pair: Whole, span: Array, normal: Array) -> float:
    """The least that any interval proves beyond the clearance [m]; raises Refused where one does not."""
    demand([header.get("format"), header.get("version")] == [FORMAT, VERSION], f"not {FORMAT} {VERSION}: make it again")
    table([header], HEADER | {"scene": list}, "header")
    world = World(header["robot"], header["scene"])
    clearance, own = (float(numbers(header[key], (), key)) for key in ("clearance", "self_clearance"))
    span, pairs, segments = numbers(span, (None, 2), "span"), len(world.pairs), len(rows) - 1
    segment, pair = (numbers(k, (len(span),), "segment, pair", 1e9, "i").astype(int) for k in (segment, pair))
    normal = numbers(normal, (len(span), 2, 3), "normal")
    demand(len(span) >= segments * pairs > 0 and min(clearance, own) >= 0.0, "too few intervals, or less than nothing")
    demand(((segment >= 0) & (segment < segments) & (pair >= 0) & (pair < pairs)).all(), "an interval of no pair")
    points, bodies = np.array([len(shape.points) for shape in world.shapes]), len(header["robot"]["bodies"])
    work = (0.36 + bodies / 4000) * (len(world.parent) + 3) + 0.012 * points[world.pairs].sum(axis=1)[pair]  # [µs]
    demand(max(len(span), rows.size) <= MOST and work.sum() < MOST_WORK, "too much for one proof: make it of parts")
    path, step = Path(world, rows, header["way"]), 400_000 // (len(world.parent) + 3) + 1
    order = np.lexsort((span[:, 0], segment, pair, world.pairs[pair, 1]))  # what is of one obstacle comes together
    segment, pair, span = segment[order], pair[order], span[order]
    new = np.r_[True, (np.diff(segment) != 0) | (np.diff(pair) != 0), True]
    demand(new.sum() == segments * pairs + 1, "a pair of a segment is missing")
    begun, ended = span[:, 0] == np.where(new[:-1], 0.0, np.roll(span[:, 1], 1)), span[new[1:], 1] == 1.0
    demand(begun.all() and ended.all() and (span[:, 0] < span[:, 1]).all(), "the intervals of a pair leave a hole")
    spare = -np.where(pair < world.across, clearance, own) - ROUNDING
    for k in (slice(i, i + step) for i in range(0, len(span), step)):
        spare[k] -= 0.5 * (span[k, 1] - span[k, 0]) * path.motions(segment[k], pair[k])
        spare[k] += 0.5 * sum(path.gaps(segment[k], span[k, e], pair[k], normal[order[k], e]) for e in (0, 1))
    k = int(np.argmin(spare))
    demand(spare[k] > 0.0, f"segment {segment[k]}, pair {pair[k]}, {span[k].tolist()}: {-spare[k]:.3g} m short")
    return float(spare[k])


def read(name: str) -> tuple[Part, Part]:
    """Header and arrays of a file; nothing is unpacked before it is known how large it is."""
    names, parts = ("header", "rows", "segment", "pair", "span", "normal"), {}
    with open(name, "rb") as raw:  # NumPy's archives end so; one that does not may have a list of any length
        head, end, _ = raw.read(4), (raw.seek(-42, 2), raw.read())[1], raw.seek(0)
        if (head + end[20:24], end[34:36] + end[40:]) != (b"PK\3\4PK\5\6", bytes(4)) or end[:4] == b"PK\6\7":
            raise ValueError("no archive of a few arrays")
        file = np.load(raw, allow_pickle=False)
        found = sorted((e.filename, e.compress_type in (0, 8)) for e in file.zip.infolist())  # stored, or deflated
        demand(found == sorted((f"{n}.npy", True) for n in names), f"other arrays than {names}")
        demand(sum(e.file_size for e in file.zip.infolist()) <= MOST_BYTES, f"more than {MOST_BYTES} bytes, unpacked")
        for n in names:
            with file.zip.open(f"{n}.npy") as member:
                demand(member.peek(8)[:8] == b"\x93NUMPY\1\0", "no array, or one with a long header")
                parts[n] = np.lib.format.read_array(member, allow_pickle=False)
                demand(not member.read(1), "more than an array")
    text = parts.pop("header")
    demand(text.dtype.kind == "U" and text.shape == () and text.nbytes <= MOST_TEXT, "no header, or a long one")
    once = json.JSONDecoder(object_pairs_hook=lambda p: dict(p) if len(dict(p)) == len(p) else demand(0, "a key twice"))
    return once.decode(str(text)), parts


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Check a proof that a robot's path is free of collisions.")
    parser.add_argument("proof", help="file made by: elastic-strips certify … --proof FILE")
    for what in ("robot", "scene", "path"):
        parser.add_argument(f"--{what}", metavar="DIGEST", help=f"that the proof's {what} must have")
    given, header = parser.parse_args(arguments), None
    try:
        header, parts = read(given.proof)
        spare = check(header, **parts)
        names = {k: digest(header[k]) for k in ("robot", "scene")} | {"path": path_digest(parts["rows"], header["way"])}
        for what, found in names.items():
            demand(getattr(given, what) in (None, found), f"it is about another {what}: {found}")
    except Exception as problem:  # whatever breaks the checker is no proof
        print(f"REFUSED: {problem}" if isinstance(problem, (Refused, OSError)) else f"REFUSED: {problem!r}")
        return 2 if header is None and not isinstance(problem, Refused) else 3  # 2: nothing that can be read
    unsaid = [f"({what} not compared)" for what in names if getattr(given, what) is None]
    print(f"PROVEN: clear by {header['clearance']} m of obstacles and {header['self_clearance']} m of itself", *unsaid)
    print(f"{len(header['scene'])} obstacles, rows of {header['robot']['columns']!a}, way: {header['way']};", names)
    print(f"{len(parts['rows'])} rows, {len(parts['span'])} intervals, tightest with {1e3 * spare:.3g} mm to spare")
    return 0


if __name__ == "__main__":
    sys.exit(main())
