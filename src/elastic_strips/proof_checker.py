"""Check a proof that a robot's path is free of collisions. It needs NumPy, and nothing else of this package.

    python proof_checker.py PROOF.npz [--robot DIGEST] [--scene DIGEST] [--path DIGEST]

The proof says what the robot is (a tree of joints with convex bodies), what the obstacles are (convex shapes that stand
still), and the rows of the path. For each segment between two rows and each pair of shapes that must not meet it has
intervals of the segment, and at both ends of each a direction in space. The checker believes none of the latter:

1.  It places the bodies at both ends of the interval. Along the direction n, body A ends at max n·a and shape B begins
    at min n·b: they are apart by the difference at least. A wrong direction makes this gap small, never too large.
2.  Between the ends no point of a body moves further than L, the sum over the joints of how far each one turns times
    how far any point of the body can be from its axis. A place in the interval is a part of L away from one end and the
    rest from the other, so that the pair stays apart by the clearance c all along if gap + gap > L + 2 c.
3.  The intervals of each segment and pair cover it from 0 to 1 without a hole, and no pair is missing.

The file is a NumPy archive: ``header`` (JSON: robot, scene, clearances), ``rows`` (N, nv), and for each interval
``segment``, ``pair``, ``span`` (2,) and ``normal`` (2, 3), from the first to the second shape, in the world. Pairs are
numbered body * obstacles + obstacle, and then as the header lists the robot's own. Metres, radians. Exits with 0 or 3.
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
FORMAT, VERSION = "elastic_strips.proof", 1
ROUNDING = 1e-7  # [m] more than what floating point can add to any of these sums
HALF_TURN = np.pi - 1e-6  # a turn by more than this has no one direction
SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "cone": 2, "ellipsoid": 3, "convex": 0}


class Refused(Exception):
    """The proof does not hold; the message says where."""


def digest(part: object) -> str:
    """A name for a part of the proof that no other part has."""
    return hashlib.sha256(json.dumps(part, sort_keys=True, separators=(",", ":")).encode()).hexdigest()[:32]


def demand(holds: object, message: str) -> None:
    if not holds:
        raise Refused(message)


def numbers(value: object, shape: tuple[int | None, ...], what: str) -> Array:
    """An array of finite numbers of this shape; a size of None is any."""
    array = np.array(value, dtype=float)
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=False))
    demand(fits and np.isfinite(array).all(), f"{what} is not an array {shape} of finite numbers")
    return array


class Shape:
    """A convex shape about the origin of its own frame, grown by the radius of a ball."""

    def __init__(self, entry: Part, what: str) -> None:
        self.kind: str = entry["kind"]
        demand(self.kind in SIZES, f"{what}: shape of kind {self.kind!r}")
        self.sizes: Array = numbers(entry["sizes"], (SIZES[self.kind],), f"{what}: sizes")
        self.points: Array = numbers(np.reshape(entry["points"], (-1, 3)), (None, 3), f"{what}: points")
        self.grown: float = float(numbers(entry["grown"], (), f"{what}: grown"))
        positive = (self.sizes > 0).all() and self.grown >= 0.0 and (self.kind != "convex" or len(self.points) > 0)
        demand(positive, f"{what}: a size is negative, or there are no points")
        self.rotation: Array = numbers(entry["rotation"], (3, 3), f"{what}: rotation")
        self.translation: Array = numbers(entry["translation"], (3,), f"{what}: translation")
        demand_rotation(self.rotation, what)

    def support(self, n: Array) -> Array:
        """max n·x over the shape's points (K,), for directions n (K, 3) of length 1 in its own frame."""
        s, (x, y, z) = self.sizes, n.T
        if self.kind == "convex":
            parts = np.array_split(n, len(n) // 1000 + 1)
            return self.grown + np.concatenate([(part @ self.points.T).max(axis=1) for part in parts])
        far = {
            "box": lambda: np.abs(n) @ s,
            "sphere": lambda: np.full(len(n), s[0]),
            "capsule": lambda: s[0] + s[1] * np.abs(z),
            "cylinder": lambda: s[0] * np.hypot(x, y) + s[1] * np.abs(z),
            "cone": lambda: np.maximum(s[1] * z, s[0] * np.hypot(x, y) - s[1] * z),  # its tip is up
            "ellipsoid": lambda: np.sqrt(((s * n) ** 2).sum(axis=1)),
        }
        return self.grown + far[self.kind]()

    def farthest(self) -> float:
        """A bound of the distance of the shape's points from the origin of the frame that it is fixed to."""
        if self.kind == "convex":
            return self.grown + np.linalg.norm(self.points @ self.rotation.T + self.translation, axis=1).max()
        half = self.sizes.sum() if self.kind == "capsule" else np.linalg.norm(self.sizes)
        return self.grown + np.linalg.norm(self.translation) + half


def demand_rotation(R: Array, what: str) -> None:
    right = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0) < 1e-9 and (np.linalg.det(R) > 0).all()
    demand(right, f"{what}: no rotation")


class Robot:
    """Joints that turn about or slide along the z axis of their frame, and bodies; the base is a joint of the plane."""

    def __init__(self, part: Part) -> None:
        self.planar: bool = part["planar"] is True
        joints = part["joints"]
        self.parent: list[int] = [int(j["parent"]) for j in joints]  # the index in this list, or -1
        self.column: list[int] = [int(j["column"]) for j in joints]  # of the rows; the planar base has the first three
        self.slides: list[bool] = [j["slides"] is True for j in joints]
        self.offset: Array = numbers([j["offset"] for j in joints], (len(joints), 3, 4), "offsets of the joints")
        demand_rotation(self.offset[:, :, :3], "offset of a joint")
        self.nv: int = len(joints) + (2 if self.planar else 0)
        demand(all(-1 <= p < i for i, p in enumerate(self.parent)), "a joint comes before its parent")
        still = joints and self.column[0] == self.parent[0] == -1 and np.array_equal(self.offset[0], np.eye(3, 4))
        demand(not self.planar or still, "the base is not the first joint, in the world's frame")
        own = sorted(self.column[1:] if self.planar else self.column)
        demand(own == list(range(3 if self.planar else 0, self.nv)), "the joints do not have one column each")
        self.turns: NDArray[np.bool_] = np.array([c is True for c in part["circular"]])  # columns that may wrap
        demand(self.turns.shape == (self.nv,), "circular joints")
        self.turns[2:3] |= self.planar
        self.bodies: list[Shape] = [Shape(b, f"body {i}") for i, b in enumerate(part["bodies"])]
        self.joint: list[int] = [int(b["joint"]) for b in part["bodies"]]  # -1 is the world
        demand(all(-1 <= j < len(joints) for j in self.joint), "a body of no joint")
        self.pairs: NDArray[np.int64] = np.array(part["pairs"], dtype=int).reshape(-1, 2)
        demand(((self.pairs >= 0) & (self.pairs < len(self.bodies))).all(), "a pair of no bodies")

    def tangents(self, rows: Array) -> Array:
        """What each segment (N - 1, nv) does: constant speeds of joints, and of the base in its own frame."""
        v, turns = np.diff(rows, axis=0), self.turns
        v[:, turns] = (v[:, turns] + np.pi) % (2.0 * np.pi) - np.pi
        demand((np.abs(v[:, turns]) < HALF_TURN).all(), "a segment with half a turn, which has no one direction")
        if self.planar:
            a, half = rows[:-1, 2], 0.5 * v[:, 2]
            along = np.cos(a) * v[:, 0] + np.sin(a) * v[:, 1]
            aside = np.cos(a) * v[:, 1] - np.sin(a) * v[:, 0]
            k = np.where(np.abs(half) < 1e-6, 1.0, half / np.where(half == 0.0, 1.0, np.tan(half)))
            v[:, 0], v[:, 1] = k * along + half * aside, k * aside - half * along
        end = self.between(rows, v, np.arange(len(v)), np.ones(len(v))) - rows[1:]
        end[:, turns] = (end[:, turns] + np.pi) % (2.0 * np.pi) - np.pi
        demand(np.abs(end).max(initial=0.0) < ROUNDING, "a segment that does not end at the next row")
        return v

    def between(self, rows: Array, v: Array, segment: Whole, t: Array) -> Array:
        """Rows (K, nv) at the parts t (K,) of segments."""
        out = rows[segment] + t[:, None] * v[segment]
        if self.planar:
            a, turn = rows[segment, 2], t * v[segment, 2]
            small = np.abs(turn) < 1e-6
            s = np.where(small, 1.0, np.sin(turn) / np.where(small, 1.0, turn))
            c = np.where(small, 0.5 * turn, (1.0 - np.cos(turn)) / np.where(small, 1.0, turn))
            x, y = t * v[segment, 0], t * v[segment, 1]
            dx, dy = s * x - c * y, c * x + s * y
            out[:, 0] = rows[segment, 0] + np.cos(a) * dx - np.sin(a) * dy
            out[:, 1] = rows[segment, 1] + np.sin(a) * dx + np.cos(a) * dy
        return out

    def place(self, rows: Array) -> list[tuple[Array, Array]]:
        """Rotations and translations of the joints' frames for rows (K, nv)."""
        frames = []
        for i, offset in enumerate(self.offset):
            R, t = offset[:, :3], offset[:, 3]
            if self.parent[i] >= 0:
                above, at = frames[self.parent[i]]
                t, R = at + above @ t, above @ R
            R, t = np.broadcast_to(R, (len(rows), 3, 3)), np.broadcast_to(t, (len(rows), 3))
            if self.column[i] < 0:
                frames.append(turned(R, rows[:, 2], np.pad(rows[:, :2], ((0, 0), (0, 1)))))
            elif self.slides[i]:
                frames.append((R, t + R[:, :, 2] * rows[:, self.column[i], None]))
            else:
                frames.append(turned(R, rows[:, self.column[i]], t))
        return frames

    def radii(self, rows: Array) -> Array:
        """(bodies, nv) how far a point of a body moves at most for each unit that a column does, on this path."""
        most = np.abs(rows).max(axis=0) + np.abs(np.diff(rows, axis=0)).max(axis=0, initial=0.0)
        out = np.zeros((len(self.bodies), self.nv))
        for g, (body, joint) in enumerate(zip(self.bodies, self.joint, strict=True)):
            far = body.farthest()
            while joint >= 0:
                k = self.column[joint]
                out[g, 2 if k < 0 else k] = 1.0 if k >= 0 and self.slides[joint] else far
                far += np.linalg.norm(self.offset[joint][:, 3]) + (most[k] if k >= 0 and self.slides[joint] else 0.0)
                joint = self.parent[joint]
        return out


def turned(R: Array, angle: Array, t: Array) -> tuple[Array, Array]:
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.stack((c * R[:, :, 0] + s * R[:, :, 1], c * R[:, :, 1] - s * R[:, :, 0], R[:, :, 2]), axis=2), t


def reach(robot: Robot, frames: list[tuple[Array, Array]], where: Whole, g: int, n: Array) -> Array:
    """max n·x (K,) over the points of body g at the places ``where`` (K,) of the frames."""
    body, at, local = robot.bodies[g], np.zeros(len(n)), n
    if robot.joint[g] >= 0:
        R, t = (array[where] for array in frames[robot.joint[g]])
        at, local = (t * n).sum(axis=1), np.einsum("kij,ki->kj", R, n)
    return at + local @ body.translation + body.support(local @ body.rotation)


def gaps(
    robot: Robot, obstacles: list[Shape], rows: Array, v: Array, segment: Whole, t: Array, pair: Whole, n: Array
) -> Array:
    """How far apart (K,) [m] the shapes of pairs are at least along directions (K, 3), at the parts t of segments."""
    size, out = np.linalg.norm(n, axis=1), np.zeros(len(pair))
    demand((size > 1e-3).all(), "a direction without length")
    places, where = np.unique(np.column_stack((segment, t)), axis=0, return_inverse=True)
    frames = robot.place(robot.between(rows, v, places[:, 0].astype(np.int64), places[:, 1].astype(float)))
    for p in np.unique(pair):
        k = np.flatnonzero(pair == p)
        to, at, own = n[k] / size[k, None], where.reshape(-1)[k], p - len(robot.bodies) * len(obstacles)
        if own < 0:
            g, other = p // len(obstacles), obstacles[p % len(obstacles)]
            beyond = other.support(-to @ other.rotation) - to @ other.translation
        else:
            g, h = robot.pairs[own]
            beyond = reach(robot, frames, at, h, -to)
        out[k] = -reach(robot, frames, at, g, to) - beyond
    return out


def motions(robot: Robot, obstacles: list[Shape], rows: Array, v: Array) -> Array:
    """(segments, pairs) how far the shapes of a pair move towards each other at most."""
    radii, speed, moves = robot.radii(rows), np.abs(v), np.array([j >= 0 for j in robot.joint], dtype=float)
    base = np.hypot(v[:, 0], v[:, 1]) if robot.planar else np.zeros(len(v))
    alone = speed @ radii.T + base[:, None] * moves
    one, two = robot.pairs.T
    apart = (radii[one] > 0.0) != (radii[two] > 0.0)  # a joint before both of them moves them as one
    together = speed @ np.where(apart, radii[one] + radii[two], 0.0).T + base[:, None] * (moves[one] != moves[two])
    return np.hstack((np.repeat(alone, len(obstacles), axis=1), together))


def check(header: Part, rows: object, segment: Whole, pair: Whole, span: object, normal: object) -> float:
    """The least that any interval proves beyond the clearance [m]; raises Refused where one does not."""
    demand(header.get("format") == FORMAT and header.get("version") == VERSION, "no proof of this format and version")
    robot = Robot(header["robot"])
    obstacles = [Shape(o, f"obstacle {i}") for i, o in enumerate(header["scene"])]
    clearance, own = (float(numbers(header[key], (), key)) for key in ("clearance", "self_clearance"))
    rows = numbers(rows, (None, robot.nv), "rows")
    demand(min(clearance, own) >= 0.0 and len(rows) >= 2, "a clearance is negative, or the path has less than two rows")
    span, normal = numbers(span, (None, 2), "span"), numbers(normal, (None, 2, 3), "normal")
    demand(all(np.asarray(k).dtype.kind in "iu" for k in (segment, pair)), "a segment or pair is no whole number")
    segment, pair = np.asarray(segment).astype(np.int64), np.asarray(pair).astype(np.int64)
    demand(segment.shape == pair.shape == (len(span),) and len(normal) == len(span), "intervals of unequal number")
    across = len(robot.bodies) * len(obstacles)
    pairs, segments = across + len(robot.pairs), len(rows) - 1
    demand(((segment >= 0) & (segment < segments) & (pair >= 0) & (pair < pairs)).all(), "an interval of no pair")
    order = np.lexsort((span[:, 0], pair, segment))
    segment, pair, span, normal = segment[order], pair[order], span[order], normal[order]
    key = segment * pairs + pair
    demand(np.array_equal(np.unique(key), np.arange(segments * pairs)), "a pair of a segment is missing")
    begins, ends = np.r_[True, np.diff(key) > 0], np.r_[np.diff(key) > 0, True]
    if len(key):
        whole = (span[begins, 0] == 0.0).all() and (span[ends, 1] == 1.0).all() and (span[:, 0] < span[:, 1]).all()
        demand(whole and (span[1:, 0] == span[:-1, 1])[~begins[1:]].all(), "the intervals of a pair leave a hole")
    v = robot.tangents(rows)
    travel = (span[:, 1] - span[:, 0]) * motions(robot, obstacles, rows, v)[segment, pair]
    apart = sum(gaps(robot, obstacles, rows, v, segment, span[:, e], pair, normal[:, e]) for e in (0, 1))
    spare = 0.5 * (apart - travel) - np.where(pair < across, clearance, own) - ROUNDING
    for k in np.flatnonzero(~(spare > 0.0))[:1]:
        raise Refused(f"segment {segment[k]}, pair {pair[k]}, {span[k].tolist()}: {-spare[k]:.3g} m short")
    return float(spare.min(initial=np.inf))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Check a proof that a robot's path is free of collisions.")
    parser.add_argument("proof", help="file made by: elastic-strips certify … --proof FILE")
    for what in ("robot", "scene", "path"):
        parser.add_argument(f"--{what}", metavar="DIGEST", help=f"that the proof's {what} must have")
    given = parser.parse_args(arguments)
    try:
        with np.load(given.proof, allow_pickle=False) as file:
            parts = {name: file[name] for name in ("rows", "segment", "pair", "span", "normal")}
            header = json.loads(str(file["header"]))
            digests = {"robot": digest(header["robot"]), "scene": digest(header["scene"])}
            digests["path"] = digest(parts["rows"].tolist())
    except Exception as problem:  # whatever a file can be
        print(f"{given.proof}: is no proof: {problem}", file=sys.stderr)
        return 2
    try:
        for what, found in digests.items():
            demand(getattr(given, what) in (None, found), f"it is about another {what}: {found}")
        spare = check(header, **parts)
    except (Refused, LookupError, TypeError, ValueError, OverflowError, AttributeError) as problem:
        print(f"REFUSED: {problem}")
        return 3
    print(f"PROVEN: clear by {header['clearance']:g} m of obstacles and {header['self_clearance']:g} m of itself")
    print(f"{len(parts['span'])} intervals, {1e3 * spare:.3g} mm to spare;", digests)
    return 0


if __name__ == "__main__":
    sys.exit(main())
