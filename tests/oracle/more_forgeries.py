"""More forged proofs, by somebody who has read the checker for what it does not ask.

Each claim is of something false, and what is geometry in it is false by :func:`touches`, which walks the path by
itself: nothing of the checker is in it. What is like them and is true is in :func:`true_claims`, and is taken.

    python tests/oracle/more_forgeries.py     # makes all of them; each in a process of its own: seconds and memory
"""

from __future__ import annotations

import io
import json
import os
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from forgeries import ALONG_X, TURN, Claim, Part, Robot, ball, beside, cart, claim, joint, rail, wheel

from elastic_strips import proof_checker as checker

Array = npt.NDArray[Any]
Forge = Callable[[], Claim]
HALF = np.nextafter(0.5, 1.0)


# --- what is true, without the checker --------------------------------------
def _at(rows: Array, way: str, robot: Part, segment: int, t: float) -> Array:
    one, two = rows[segment], rows[segment + 1]
    v = two - one
    if way == "shortest":
        turning = np.array(robot["circular"]) | (robot["planar"] & (np.arange(len(v)) == 2))
        v = np.where(turning, np.arctan2(np.sin(v), np.cos(v)), v)
    out = one + t * v
    if way == "arc" and robot["planar"] and abs(v[2]) > 1e-9:
        # the twist that leads from the one pose to the other, integrated for a part of the time
        turn = v[2]
        left = np.array([[np.sin(turn), np.cos(turn) - 1.0], [1.0 - np.cos(turn), np.sin(turn)]]) / turn
        speed = np.linalg.solve(left, v[:2])
        part = np.array([[np.sin(t * turn), np.cos(t * turn) - 1], [1 - np.cos(t * turn), np.sin(t * turn)]]) / turn
        out[:2] = one[:2] + part @ speed
    return out


def _poses(robot: Part, row: Array) -> dict[int, Array]:
    poses = {-1: np.eye(4)}
    for i, made in enumerate(robot["joints"]):
        offset, move = np.vstack((np.array(made["offset"], dtype=float), [0, 0, 0, 1])), np.eye(4)
        column = made["column"]
        if robot["planar"] and i == 0:
            move[:2, 3], column = row[:2], 2
        value = made["multiplier"] * row[column] + made["constant"]
        if made["slides"]:
            move[2, 3] = value
        else:
            move[:2, :2] = [[np.cos(value), -np.sin(value)], [np.sin(value), np.cos(value)]]
        poses[i] = poses[made["parent"]] @ offset @ move
    return poses


def _depth(part: Part, x: Array) -> float:
    """At least how far it is from a place [m] to a shape in its own frame; 0 or less within it."""
    s, out = part["sizes"], np.inf
    kind, radial = part["kind"], float(np.hypot(x[0], x[1]))
    if kind == "sphere":
        out = np.linalg.norm(x) - s[0]
    elif kind == "capsule":
        out = np.hypot(radial, max(abs(x[2]) - s[1], 0.0)) - s[0]
    elif kind == "box":
        out = np.linalg.norm(np.maximum(np.abs(x) - s, 0.0))
    elif kind == "cylinder":
        out = np.hypot(max(radial - s[0], 0.0), max(abs(x[2]) - s[1], 0.0))
    elif kind == "ellipsoid":
        out = 0.0 if np.linalg.norm(x / np.array(s)) <= 1.0 else np.inf
    elif kind == "cone":
        out = 0.0 if abs(x[2]) <= s[1] and radial <= s[0] * (s[1] - x[2]) / (2.0 * s[1]) else np.inf
    else:
        out = np.linalg.norm(np.array(part["points"]) - x, axis=1).min()
    return float(out) - part["grown"]


def touches(made: Claim, samples: int = 101) -> bool:
    """Whether two shapes of a claim come nearer than it claims, one of which is a ball; looked at in steps."""
    robot, scene, rows = made.header["robot"], made.header["scene"], made.parts["rows"]
    bodies = robot["bodies"]
    pairs = [(b, o, made.header["clearance"]) for b in bodies for o in scene]
    pairs += [(bodies[i], bodies[j], made.header["self_clearance"]) for i, j in robot["pairs"]]
    for segment in range(len(rows) - 1):
        for t in np.linspace(0.0, 1.0, samples):
            poses = _poses(robot, _at(rows, made.header["way"], robot, segment, float(t)))
            for one, two, apart in pairs:
                if one["kind"] != "sphere":
                    one, two = two, one
                places = [poses[part.get("joint", -1)] @ np.append(part["translation"], 1.0) for part in (one, two)]
                R = poses[two.get("joint", -1)][:3, :3] @ np.array(two["rotation"])
                local = R.T @ (places[0] - places[1])[:3]
                if _depth(two, local) - one["sizes"][0] - one["grown"] < apart:
                    return True
    return False


# --- geometry ---------------------------------------------------------------
def solid(kind: str, sizes: list[float], at: tuple[float, float, float] = (1.0, 0.0, 0.0), **others: object) -> Part:
    return {**ball(at), "kind": kind, "sizes": sizes, "name": kind, **others}


def hull(points: object, at: tuple[float, float, float] = (1.0, 0.0, 0.0), **others: object) -> Part:
    return solid("convex", [], at, points=np.array(points, dtype=float).tolist(), **others)


CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05
TILTED = [[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]
ROLLED = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]


def _past(obstacle: Part, clearance: float = 0.0, pieces: int = 64) -> Forge:
    """The rail's ball goes past, or through, something."""

    def forge() -> Claim:
        made = claim(rail(), [obstacle], [[0.0], [2.0]], pieces=pieces)
        made.header["clearance"] = clearance
        return made

    return forge


def _carried(body: Part) -> Forge:
    """A body of some shape is slid into a ball."""

    def forge() -> Claim:
        return claim(
            Robot([joint(-1, 0, ALONG_X, slides=True)], [{**body, "joint": 0}], 1), beside(1.0), [[0.0], [2.0]]
        )

    return forge


def _of(
    robot: Robot, scene: list[Part], rows: object, way: str = "values", pieces: int = 16, **header: object
) -> Forge:
    def forge() -> Claim:
        made = claim(robot, scene, rows, way, pieces)
        made.header.update(header)
        return made

    return forge


def _base(*bodies: Part, **others: Any) -> Robot:
    return Robot(
        [joint(-1, -1)], [{**body, "joint": 0} for body in bodies or (ball((0, 0, 0)),)], 3, planar=True, **others
    )


def _turning(*circular: int, **others: object) -> Robot:
    robot = wheel(**others)
    robot.circular = circular
    return robot


def _on_base(column: int, **others: object) -> Robot:
    """A base, with an arm whose joint goes by a column of the base."""
    return Robot([joint(-1, -1), joint(0, column, **others)], [ball((1, 0, 0), joint=1)], 3, planar=True)


def _tree(*joints: Part, at: tuple[float, float, float] = (0, 0, 0), columns: int = 1, **others: Any) -> Robot:
    return Robot(list(joints), [ball(at, joint=len(joints) - 1)], columns, **others)


def _two_bodies(apart: float, **others: Any) -> Robot:
    return Robot([joint(-1, 0)], [ball((0, 0, 0), joint=0), ball((apart, 0, 0), joint=0, **others)], 1, pairs=[[0, 1]])


SLIDE = joint(-1, 0, ALONG_X, slides=True)
LIFTED = np.column_stack((np.eye(3), (-0.5, 0.0, 0.0)))  # upwards, behind SLIDE

GEOMETRY: dict[str, dict[str, Forge]] = {
    "solids": {
        "box": _past(solid("box", [0.05, 0.05, 0.05])), "capsule": _past(solid("capsule", [0.05, 0.5])),
        "lying capsule": _past(
            solid("capsule", [0.01, 0.5], (1, 0.55, 0), rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]])
        ),
        "cylinder": _past(solid("cylinder", [0.1, 0.1])),
        "rim of a cylinder": _past(solid("cylinder", [0.5, 0.01], (1, 0.55, 0))),
        "cone": _past(solid("cone", [0.2, 0.2])), "tip of a cone": _past(solid("cone", [0.5, 0.5], (1, 0, -0.5))),
        "ellipsoid": _past(solid("ellipsoid", [0.01, 0.02, 0.3])), "hull": _past(hull(CUBE)),
        "tilted box": _past(solid("box", [0.5, 0.01, 0.01], rotation=TILTED)),
        "thin box": _past(solid("box", [5e-324, 5.0, 5.0])), "plate": _past(solid("box", [1e-300, 1e4, 1e4])),
        "rolled cylinder": _past(solid("cylinder", [0.01, 0.5], rotation=ROLLED)),
        "carried box": _carried(solid("box", [0.05, 0.3, 0.3], (0, 0, 0))),
        "carried capsule": _carried(solid("capsule", [0.05, 0.3], (0, 0, 0))),
        "carried cone": _carried(solid("cone", [0.3, 0.3], (0, 0, 0))),
        "carried hull": _carried(hull(CUBE, (0, 0, 0))), "carried far": _carried(hull(CUBE - [[0, 0, 1]], (0, 0, 1))),
    },
    "degenerate": {
        "needle": _past(solid("capsule", [5e-324, 1e-300])), "hull of a point": _past(hull([[0, 0, 0]])),
        "hull of twice a point": _past(hull([[0, 0, 0], [0, 0, 0]])),
        "hull of a line": _past(hull([[0, 0, 0], [0, 0, 1]])),
        "flat hull": _past(hull([[0, 0, 0], [0, 1, 0], [0, 0, 1]])), "far point": _past(hull([[0.0, 0, 0], [1, 0,
        0]])),
        "a point of the robot": _carried(hull([[0, 0, 0]], (0, 0, 0))),
        "a point that turns": _of(
            Robot([joint(-1, 0)], [hull([[1, 0, 0]], (0, 0, 0), joint=0)], 1), [ball((0, 1, 0))], [[0.0], [3.0]]
        ),
        "tiny ball": _past(ball((1, 0, 0), 5e-324)),
    },
    "grown": {
        "point": _past(hull([[0, 0, 0]], (1, 0.5, 0), grown=0.45)),
        "box": _past(solid("box", [0.1, 0.1, 0.1], (1, 0.5, 0), grown=0.35)),
        "cylinder": _past(solid("cylinder", [0.1, 0.1], (1, 0, 0.5), grown=0.35)),
        "ball": _past(ball((1, 0.5, 0), 0.1, grown=0.35)),
        "body": _carried(ball((0, 0.5, 0), 0.1, grown=0.35)),
        "capsule": _past(solid("capsule", [0.1, 0.1], (1, 0.5, 0), grown=0.35)),
        "body that turns": _of(
            Robot([joint(-1, 0)], [ball((1, 0, 0), grown=0.3, joint=0)], 1), [ball((0, 1.45, 0))], [[0.0], [3.0]],
            pieces=64
        ),
        "of two bodies": _of(_two_bodies(0.5, grown=0.35), [], [[0.0], [1.0]]),
    },
    "clearances": {
        "of an obstacle": _past(ball((1, 0.5, 0)), 0.3001), "by a micrometre": _past(ball((1, 0.5, 0)), 0.300001),
        "of its own": _of(_two_bodies(0.5), [], [[0.0], [1.0]], self_clearance=0.301),
        "of its own, for the other": _of(
            _two_bodies(0.5), beside(5.0), [[0.0], [1.0]], self_clearance=0.5, clearance=0.0
        ),
        "of the other, for its own": _of(_two_bodies(0.5), [ball((0.5, 0.5, 0))], [[0.0], [1.0]], clearance=0.5),
        "far away": _past(ball((1, 5e5, 0)), 9e3 + 5e5), "grown by less": _past(ball((1, 0.5, 0), grown=0.1), 0.201),
    },
    "ways": {
        "line through, arc around": _of(_base(), [ball((0.5, 0.5, 0))], [[0, 0, 0], [1, 1, 1.5]], "values", 64),
        "arc through, line beside": _of(
            _base(), [ball((np.sin(0.75) / 1.5, (1 - np.cos(0.75)) / 1.5, 0), 0.05)], [[0, 0, 0],
            [np.sin(1.5) / 1.5, (1 - np.cos(1.5)) / 1.5, 1.5]], "arc", 64
        ),
        "arc that ends where it began to turn": _of(
            _base(ball((1, 0, 0))), [ball((0, 1, 0))], [[0, 0, 0], [0, 0, 3.0]], "arc", 64
        ),
        "whole turn of a base": _of(_base(ball((1, 0, 0))), [ball((-1, 0, 0))], [[0, 0, 0], [0, 0, TURN]],
        "values", 1),
        "two whole turns": _of(wheel(), [ball((-1, 0, 0))], [[0.0], [2 * TURN]], "values", 1),
        "the shorter way of the values": _of(wheel(), [ball((-1, 0, 0))], [[0.3], [6.0]], "values", 64),
        "the longer way round": _of(_turning(0), [ball((1, 0, 0))], [[0.3], [6.0]], "shortest", 64),
        "shortest of what has limits": _of(wheel(), [ball((-1, 0, 0))], [[0.3], [6.0]], "shortest", 64),
        "a base the shorter way": _of(
            _base(ball((1, 0, 0))), [ball((1, 0, 0))], [[0, 0, 0.3], [0, 0, 6.0]], "shortest", 64
        ),
        "a turn more of what wraps": _of(_turning(0), [ball((1, 0, 0))], [[-0.3 + 3 * TURN], [0.3]], "shortest", 64),
        "a follower of twice, wrapped": _of(
            _turning(0, multiplier=2.0), [ball((1, 0, 0))], [[-2.0], [2.0]], "shortest", 64
        ),
        "in the second segment": _of(rail(), beside(1.0), [[0.0], [0.5], [1.5], [0.0]]),
        "there and back": _of(rail(), beside(1.0), [[0.0], [2.0], [0.0]], pieces=1),
        "standing in it": _of(rail(), beside(0.1), [[0.0], [0.0]], pieces=1),
        "at the very end": _of(rail(), beside(1.0), [[0.0], [0.81]], pieces=64),
        "at the very beginning": _of(rail(), beside(1.0), [[1.19], [3.0]], pieces=64),
    },
    "chains": {
        "fast arm": _of(
            _tree(joint(-1, 0, multiplier=100.0), at=(1, 0, 0)), [ball((-1, 0, 0))], [[0.0], [TURN / 100]], pieces=1
        ),
        "backwards": _of(_tree(joint(-1, 0, ALONG_X, slides=True, multiplier=-1.0)), beside(-1.0), [[0.0], [2.0]]),
        "shifted": _of(_tree(joint(-1, 0, ALONG_X, slides=True, constant=5.0)), beside(6.0), [[0.0], [2.0]]),
        "that stands, by 0": _of(
            _tree(SLIDE, joint(0, 0, multiplier=0.0, constant=np.pi / 2), at=(1, 0, 0)), [ball((1, 1, 0))], [[0.0],
            [2.0]]
        ),
        "three of one column": _of(
            _tree(SLIDE, joint(0, 0), joint(1, 0, slides=True)), [ball((1, 0, 0))], [[0.0], [1.0]]
        ),
        "lifted": _of(_tree(SLIDE, joint(0, 1, LIFTED), columns=2), [ball((1, 0, 0.5))], [[0, 0], [2, 0]]),
        "sliding out while it turns": _of(
            _tree(joint(-1, 0), joint(0, 1, ALONG_X, slides=True), columns=2), [ball((0, 1, 0))], [[0, 0.5],
            [np.pi, 1.5]], pieces=64
        ),
        "far slide, small turn": _of(
            _tree(joint(-1, 0), joint(0, 1, ALONG_X, slides=True), columns=2), [ball((99.9, 1, 0))], [[0, 100],
            [0.02, 100]]
        ),
        "a follower on another root": _of(
            _tree(SLIDE, joint(-1, 0, ALONG_X, slides=True, multiplier=3.0)), beside(3.0), [[0.0], [2.0]]
        ),
        "of two branches": _of(
            Robot([joint(-1, 0), joint(0, 1), joint(0, 2)], [ball((1, 0, 0), joint=1), ball((0, 1, 0), joint=2)],
            3, pairs=[[0, 1]]), [], [[0, 0, 0], [0, 2, 0]], pieces=64
        ),
        "of parent and child": _of(
            Robot([joint(-1, 0), joint(0, 1)], [ball((0, 1, 0), joint=0), ball((1, 0, 0), joint=1)], 2, pairs=[[0,
            1]]), [], [[0, 0], [0, 3]], pieces=64
        ),
        "of child and parent": _of(
            Robot([joint(-1, 0), joint(0, 1)], [ball((0, 1, 0), joint=0), ball((1, 0, 0), joint=1)], 2, pairs=[[1,
            0]]), [], [[0, 0], [0, 3]], pieces=64
        ),
        "a body with itself": _of(
            Robot([joint(-1, 0)], [ball((1, 0, 0), joint=0)], 1, pairs=[[0, 0]]), [], [[0.0], [1.0]]
        ),
        "a body of the world in an obstacle": _of(
            Robot([joint(-1, 0)], [ball((1, 0, 0), joint=-1)], 1), beside(1.1), [[0.0], [1.0]]
        ),
        "base against a root of its own": _of(
            cart(second_root=True), beside(9.0), [[-1, 0, 0, 0], [1, 0, 0, 0]], pieces=1
        ),
        "a base that drives an arm": _of(
            _base(ball((3, 0, 0))), [ball((3, 0.5, 0))], [[0, 0, 0], [0, 0, 0.4]], pieces=64
        ),
    },
}  # fmt: skip
"""What is false because something touches, or is nearer than is claimed."""


# --- what a statement, an array or a text may not be ----------------------------------------------------------------
def _free(pieces: int = 8) -> Claim:
    return claim(rail(), beside(3.0), [[0.0], [1.0]], pieces=pieces)


def _said(change: Callable[[Part], object], robot: Robot | None = None) -> Forge:
    def forge() -> Claim:
        made = claim(robot, beside(9.0), np.zeros((2, robot.columns)), pieces=2) if robot else _free()
        change(made.header)
        return made

    return forge


def _written(change: Callable[[str], str]) -> Forge:
    def forge() -> Claim:
        made = _free()
        made.text = change(json.dumps(made.header))
        assert made.text != json.dumps(made.header)
        return made

    return forge


def _held(**changes: Callable[[Array], Array]) -> Forge:
    def forge() -> Claim:
        made = _free()
        for name, change in changes.items():
            made.parts[name] = change(made.parts[name].copy())
        return made

    return forge


COVER = ("segment", "pair", "span", "normal")


def _uncovered(change: Callable[[Claim], object] = lambda _: None, pieces: int = 20, **others: Any) -> Forge:
    """Of a path through an obstacle all is proven but where it touches: what is left out is hidden somehow."""

    def forge() -> Claim:
        made = claim(rail(), [*beside(1.0), *others.get("more", [])], others.get("rows", [[0.0], [2.0]]), pieces=pieces)
        middle = made.parts["span"].mean(axis=1)
        keep = (np.abs(middle - 0.5) > 0.12) | (made.parts["pair"] > 0)
        for name in COVER:
            made.parts[name] = made.parts[name][keep]
        change(made)
        return made

    return forge


def _span(change: Callable[[Array], object]) -> Callable[[Claim], object]:
    return lambda made: change(made.parts["span"])


def _repeat(made: Claim) -> None:
    """As many intervals as there were."""
    for name in COVER:
        made.parts[name] = np.concatenate((made.parts[name], made.parts[name][:5]))


def _bridge(begin: float, end: float, pair: int = 0, segment: int = 0) -> Callable[[Claim], object]:
    def change(made: Claim) -> None:
        p = made.parts
        p["span"] = np.vstack((p["span"], [[begin, end]]))
        p["segment"], p["pair"] = np.append(p["segment"], segment), np.append(p["pair"], pair)
        p["normal"] = np.concatenate((p["normal"], p["normal"][:1]))

    return change


def _nudged(k: int, e: int, to: float) -> Forge:
    return _held(
        span=lambda s: np.array([[to if (i, j) == (k, e) else s[i, j] for j in (0, 1)] for i in range(len(s))])
    )


def _robot(**changes: object) -> Callable[[Part], object]:
    return lambda header: header["robot"].update(changes)


def _first(where: str, **changes: object) -> Callable[[Part], object]:
    return lambda header: (header["scene"] if where == "scene" else header["robot"][where])[0].update(changes)


def _framed(R: npt.ArrayLike, t: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Callable[[Part], object]:
    return _first("joints", offset=np.column_stack((R, t)).tolist())


def _joints(*parents: int) -> Callable[[Part], object]:
    return lambda header: [made.update(parent=p) for made, p in zip(header["robot"]["joints"], parents, strict=True)]


_TWO = Robot([joint(-1, 0), joint(0, 1)], [ball((0, 0, 0), joint=1)], 2)
_ABOUT = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])

STATEMENTS: dict[str, dict[str, Forge]] = {
    "intervals by an ulp": {
        "a hole": _nudged(4, 0, float(HALF)), "an overlap": _nudged(4, 0, float(np.nextafter(0.5, 0.0))),
        "begins after 0": _nudged(0, 0, 5e-324), "begins before 0": _nudged(0, 0, -5e-324),
        "ends before 1": _nudged(7, 1, float(np.nextafter(1, 0))),
        "ends after 1": _nudged(7, 1, float(np.nextafter(1, 2))),
        "of no length": _held(span=lambda s: np.where(s == 0.5, 0.625, s)),
        "single precision": _held(
            span=lambda s: np.where(s == 0.5, [0.5, np.float32(0.5) + np.float32(1e-7)], s).astype("f4")
        ),
    },
    "cover": {
        "a hole where it touches": _uncovered(), "filled with doubles": _uncovered(_repeat),
        "bridged backwards": _uncovered(_bridge(0.65, 0.35)),
        "bridged by the other pair": _uncovered(_bridge(0.35, 0.65, 1), more=beside(9.0)),
        "bridged in another segment": _uncovered(_bridge(0.35, 0.65, 0, 1), rows=[[0.0], [2.0], [2.0]]),
        "bridged in none": _uncovered(_bridge(0.35, 0.65, 0, -1)), "bridged whole": _uncovered(_bridge(0.35, 0.65)),
        "bridged by the whole": _uncovered(_bridge(0.0, 1.0)),
        "bridged by NaN": _uncovered(_bridge(0.35, float("nan"))),
        "bridged by infinity": _uncovered(_bridge(0.35, float("inf"))),
        "moved together": _uncovered(_span(lambda s: np.copyto(s, np.where(s > 0.5, s - 0.3, s)))),
        "said to be one": _uncovered(_span(lambda s: s.__setitem__((6, 1), s[7, 0]))),
        "a pair of numbers too large": _uncovered(lambda made: made.parts.update(pair=made.parts["pair"] + 2**32)),
        "a segment that wraps": _uncovered(
            lambda made: made.parts.update(segment=made.parts["segment"] + np.iinfo(np.int64).min)
        ),
    },
    "names": {
        "of two columns": _said(_robot(columns=["a", "a"]), _TWO), "that is none": _said(_robot(columns=[None])),
        "that is a number": _said(_robot(columns=[0])), "that is a list": _said(_robot(columns=[[]])),
        "less than columns": _said(_robot(columns=["a"]), _TWO), "no list": _said(_robot(columns="a")),
        "of a body, no text": _said(_first("bodies", name=0)),
        "of an obstacle, no text": _said(_first("scene", name=None)),
        "of the robot, no text": _said(_robot(name=["robot"])), "keys": _said(_robot(columns={"a": 0})),
    },
    "points": {
        "of a ball": _said(_first("scene", points=[[-3.0, 0.0, 0.0]])),
        "of a body": _said(_first("bodies", points=[[3.0, 0.0, 0.0]])),
        "within lists": _said(_first("scene", points=[[], []])), "deep": _said(_first("scene", points=[[[]]])),
        "in the plane": _said(_first("scene", kind="convex", sizes=[], points=[[0.0, 0.0]])),
        "flat": _said(_first("scene", kind="convex", sizes=[], points=[0.0, 0.0, 0.0])),
        "with a size": _said(_first("scene", kind="convex", sizes=[0.1], points=[[0.0, 0.0, 0.0]])),
        "not finite": _said(_first("scene", kind="convex", sizes=[], points=[[float("nan"), 0, 0]])),
        "true": _said(_first("scene", kind="convex", sizes=[], points=[[True, False, 0.0]])),
        "far": _said(_first("scene", kind="convex", sizes=[], points=[[1e5, 0, 0]])),
        "sizes within lists": _said(_first("scene", kind="convex", sizes=[[]], points=[[0.0, 0.0, 0.0]])),
        "pairs within lists": _said(_robot(pairs=[[], []])),
    },
    "frames": {
        "scaled": _said(_framed(np.eye(3) * 0.5)), "mirrored": _said(_framed(np.diag([1.0, 1.0, -1.0]))),
        "sheared": _said(_framed([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]])), "of zeros": _said(_framed(np.zeros((3, 3)))),
        "a little scaled": _said(_framed(np.eye(3) * (1 - 1e-9))),
        "a little sheared": _said(_framed(_ABOUT + np.eye(3, k=1) * 1e-10)),
        "of a projection": _said(_framed(np.diag([1.0, 1.0, 0.0]))),
        "not finite": _said(_framed(np.eye(3), (np.nan, 0, 0))),
        "of four rows": _said(_first("joints", offset=np.eye(4).tolist())),
        "of three columns": _said(_first("joints", offset=np.eye(3).tolist())),
        "of a body, scaled": _said(_first("bodies", rotation=(2.0 * np.eye(3)).tolist())),
        "of a body, transposed twice": _said(_first("bodies", rotation=np.ones((3, 3)).tolist())),
        "of an obstacle, mirrored": _said(_first("scene", rotation=(-np.eye(3)).tolist())),
        "complex": _said(_first("bodies", rotation=[["1j", 0, 0], [0, 1, 0], [0, 0, 1]])),
        "a base elsewhere": _said(lambda h: h["robot"]["joints"][0].update(offset=LIFTED.tolist()), _base()),
        "a base turned": _said(_framed(_ABOUT), _base()),
    },
    "trees": {
        "a cycle": _said(_joints(1, 0), _TWO),
        "parent after child": _said(_joints(1, -1), _TWO),
        "of itself": _said(_joints(-1, 1), _TWO),
        "of none": _said(_joints(-1, 2), _TWO),
        "far below": _said(_joints(-1, -2**63), _TWO),
        "in text": _said(_first("joints", parent="-1")),
        "true": _said(_first("joints", parent=False)),
        "a column twice, one never": _said(lambda h: h["robot"]["joints"][1].update(column=0), _TWO),
        "a base that slides": _said(_first("joints", slides=True), _base()),
        "a base by twice": _said(_first("joints", multiplier=2.0), _base()),
        "a base shifted": _said(_first("joints", constant=1.0), _base()),
        "a base by a column": _said(_first("joints", column=2), _base()),
        "an arm by the base's x": lambda: claim(_on_base(0), beside(9.0), np.zeros((2, 3)), pieces=2),
        "an arm by the base's yaw": lambda: claim(_on_base(2), beside(9.0), np.zeros((2, 3)), pieces=2),
        "a slide by the base's y": lambda: claim(_on_base(1, slides=True), beside(9.0), np.zeros((2, 3)), pieces=2),
        "two bases": _said(
            lambda h: h["robot"]["joints"][1].update(column=-1), Robot([joint(-1, -1), joint(0, 3)], [ball((0, 0,
            0), joint=1)], 4, planar=True)
        ),
        "circular by one and a half": lambda: claim(
            _turning(0, multiplier=1.5), [ball((0, 0, 9))], [[0.0], [TURN]], "shortest", 2
        ),
        "circular as a follower slides": lambda: claim(
            _tree(joint(-1, 0), joint(0, 0, slides=True, multiplier=0.0), circular=(0,)), [ball((0, 0, 9))],
            [[0.0], [TURN]], "shortest", 2
        ),
        "half a turn back": lambda: claim(_turning(0), [ball((0, 0, 9))], [[0.0], [-np.pi]], "shortest", 2),
        "half a turn on an arc": lambda: claim(_base(), [ball((0, 0, 9))], [[0, 0, 0], [1, 0, np.pi]], "arc", 8),
        "a whole turn on an arc": lambda: claim(_base(), [ball((0, 0, 9))], [[0, 0, 0], [0, 0, TURN]], "arc", 8),
    },
    "arrays": {
        "objects": _held(segment=lambda s: s.astype(object)), "long": _held(rows=lambda r: r.astype(np.longdouble)),
        "complex rows": _held(rows=lambda r: r + 0j), "half precision": _held(normal=lambda n: n.astype("f2")),
        "spans in bytes": _held(span=lambda s: s.astype("i1")),
        "spans in short": _held(span=lambda s: s.astype("i2")),
        "short pairs": _held(pair=lambda p: p.astype("i2")),
        "unsigned segments": _held(segment=lambda s: s.astype("u8")),
        "segments in parts": _held(segment=lambda s: s.astype(float)), "bytes": _held(rows=lambda r: r.astype("S8")),
        "void": _held(rows=lambda r: r.view("V8")), "durations": _held(pair=lambda p: p.astype("m8[s]")),
        "spans of three": _held(span=lambda s: np.column_stack((s, s[:, 1]))),
        "flat normals": _held(normal=lambda n: n.reshape(-1, 6)),
        "no dimension": _held(rows=lambda _: np.array(0.0)), "further dimension": _held(rows=lambda r: r[None]),
        "no intervals": _held(**{n: lambda a: a[:0] for n in COVER}),
        "records of spans": _held(span=lambda s: s.view([("a", "f8"), ("b", "f8")])),
        "infinite rows": _held(rows=lambda r: r + np.inf), "normals of 1e5": _held(normal=lambda n: 1e5 * n),
        "half of the normals": _held(normal=lambda n: n[::2]), "normals of one end": _held(normal=lambda n: n[:, :1]),
        "normals in the plane": _held(normal=lambda n: n[:, :, :2]),
        "tiny normals": _held(normal=lambda n: 5e-324 * n),
    },
    "text": {
        "a key in escapes": _written(lambda t: t[:-1] + ', "\\u0073cene": []}'),
        "a key that looks alike": _written(lambda t: t.replace('"scene"', '"\u0455cene"')),
        "a key and one that looks alike": _written(lambda t: t[:-1] + ', "\u0455cene": []}'),
        "a key with a blank": _written(lambda t: t.replace('"scene"', '"scene "')),
        "in capitals": _written(lambda t: t.replace('"scene"', '"Scene"')),
        "a body's key twice": _written(lambda t: t.replace('"joint": 0', '"joint": 0, "joint": -1')),
        "a joint's key twice": _written(
            lambda t: t.replace('"multiplier": 1.0', '"multiplier": 1.0, "multiplier": 0.0')
        ),
        "two documents": _written(lambda t: t + t),
        "and more": _written(lambda t: t + ","),
        "in a list": _written(lambda t: f"[{t}]"),
        "nothing": _written(lambda _: ""),
        "null": _written(lambda _: "null"),
        "half": _written(lambda t: t[: len(t) // 2]),
        "a mark of byte order": _written(lambda t: "\ufeff" + t), "a comment": _written(lambda t: "// proof\n" + t),
        "digits without end": _written(lambda t: t.replace('"version": 2', '"version": ' + "2" * 5000)),
        "infinity": _written(lambda t: t.replace('"constant": 0.0', '"constant": -Infinity')),
        "NaN in a frame": _written(lambda t: t.replace("0.0, 0.0, 1.0", "0.0, 0.0, NaN", 1)),
        "overflow": _written(lambda t: t.replace('"constant": 0.0', '"constant": 1e999')),
        "the format in capitals": _written(lambda t: t.replace("elastic_strips.proof", "Elastic_strips.proof")),
        "of a later version": _written(lambda t: t.replace('"version": 2', '"version": 3')),
        "of no version": _written(lambda t: t.replace('"version": 2, ', "")),
    },
}  # fmt: skip
"""What is no statement, no cover or no array of a proof."""


# --- what is no archive, or too much ----------------------------------------
def _npy(array: object, version: tuple[int, int] = (1, 0)) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), version=version)
    return stream.getvalue()


def _head(text: str, version: int = 1) -> bytes:
    return b"\x93NUMPY" + bytes((version, 0)) + struct.pack("<H" if version == 1 else "<I", len(text)) + text.encode()


def _listing(shape: str, descr: str = "'<f8'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}\n"


def archives(folder: Path, large: bool = False) -> dict[str, Path]:
    """Files that are not what NumPy writes; those that are large on purpose, if asked for,
    are larger than it takes."""
    honest, out, scale = _free(), {}, 10 if large else 1
    members = {"header": _npy(np.array(json.dumps(honest.header))), **{n: _npy(a) for n, a in honest.parts.items()}}

    def zipped(name: str, tail: bytes = b"", further: int = 0, **changes: bytes) -> Path:
        file = folder / f"{name.replace(' ', '_')}.npz"
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for key, data in {**members, **changes}.items():
                archive.writestr(f"{key}.npy", data)
            for k in range(further):
                archive.writestr(zipfile.ZipInfo(f"{k}"), b"")
        with file.open("ab") as stream:
            stream.write(tail)
        out[name] = file
        return file

    rows = members["rows"]
    zipped("data after an array", rows=rows + bytes(8))
    zipped("a long header", rows=_head(_listing("(2, 1)") + " " * 1_000_000 * scale, 2) + rows[-16:])
    zipped("another version of arrays", rows=_npy(honest.parts["rows"], (2, 0)))
    zipped("a shape that overflows", rows=_head(_listing(f"({2**32}, {2**32})")) + rows[-16:])
    zipped("a shape below zero", rows=_head(_listing("(-1, 1)")) + rows[-16:])
    zipped("an array of arrays", rows=_head(_listing("(2,)", "'(1000000000,)f8'")) + rows[-16:])
    zipped("a shape of much that is nothing", rows=_head(_listing("(10000000000,)", "'<U0'")))
    zipped("a shape in code", rows=_head(_listing("(2, __import__('os').getpid())")) + rows[-16:])
    zipped("header in bytes", header=_npy(np.array(json.dumps(honest.header).encode())))
    zipped("header in a list", header=_npy(np.array([json.dumps(honest.header)])))
    zipped("no array", rows=b"rows" * 1000)
    zipped("many members", further=2000 * scale**2)
    zipped("something after the archive", tail=b"PK")
    data = bytearray(zipped("a wrong sum").read_bytes())
    at = data.index(b"PK\x01\x02")
    data[at + 16] ^= 1  # of the first member's data, as the list of members has it
    out["a wrong sum"].write_bytes(data)
    data = bytearray(zipped("a locked member").read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    out["a locked member"].write_bytes(data)
    with (folder / "list.npz").open("wb") as stream:  # an array, not of any archive; and a hole in the file
        stream.write(_head(_listing(f"({scale * 2_000_000 * (20 if large else 1)},)")))
        stream.truncate(scale * 16_000_000 * (20 if large else 1))
        stream.seek(0, 2)
        stream.write(zipped("end of another").read_bytes()[-22:])
    out["end of another"].unlink()
    out["end of another"] = folder / "list.npz"
    return out


def _crowd(bodies: int, obstacles: int, joints: int = 1, pairs: int = 0, points: int = 0, segments: int = 1) -> Claim:
    """A statement of many parts, with intervals of all, none of which is proven."""
    links = [joint(k - 1, k) for k in range(joints)]
    shapes = [hull(np.ones((points, 3))) if points else ball((1, 0, 0)) for _ in range(2)]
    robot = Robot(links, [{**shapes[0], "joint": k % joints} for k in range(bodies)], joints)
    robot.pairs = np.column_stack((np.arange(pairs) % bodies, np.arange(pairs) * 7 % bodies)).tolist() if pairs else []
    made = claim(Robot([joint(-1, 0)], [ball((0, 0, 0), joint=0)], 1), beside(3.0), [[0.0], [0.0]])
    made.header.update(robot=robot.part(), scene=[shapes[1]] * obstacles)
    segment, pair = (a.ravel() for a in np.indices((segments, bodies * obstacles + pairs), dtype=np.int32))
    normal = np.zeros((len(pair), 2, 3), dtype=np.float32)
    normal[:, :, 0] = 1.0
    made.parts = {
        "rows": np.zeros((segments + 1, joints)), "segment": segment, "pair": pair,
        "span": np.tile((0.0, 1.0), (len(pair), 1)), "normal": normal,
    }  # fmt: skip
    return made


def _long(text: str, where: str = "columns") -> Claim:
    made = _free()
    made.header["robot"][where] = "HERE"
    made.text = json.dumps(made.header).replace('"HERE"', text)
    return made


CROWDS: dict[str, Forge] = {
    "pairs": lambda: _crowd(1500, 1500), "joints": lambda: _crowd(1500, 1, joints=1500),
    "own pairs": lambda: _crowd(3000, 1, pairs=100_000, segments=8),
    "points": lambda: _crowd(1, 1, points=50_000, segments=9_000),
    "points of many": lambda: _crowd(60, 60, points=250, segments=250),
    "obstacles": lambda: _crowd(1, 14_000, segments=60),
    "bodies": lambda: _crowd(12_000, 1, segments=70),
    "joints times intervals": lambda: _crowd(1, 1, joints=700, segments=20_000),
    "intervals": lambda: _crowd(1, 1, segments=1_100_000),
    "numbers of rows": lambda: _crowd(1, 1, joints=30, segments=120_000),
    "as many as it takes": lambda: _crowd(40, 40, joints=8, segments=600),
    "at the border": lambda: _crowd(30, 30, segments=1100),
    "lists": lambda: _long("[" + "[]," * 800_000 + "[]]"),
    "a long text": lambda: _long("[" + "[]," * 4_000_000 + "[]]"),
    "pairs of nothing": lambda: _long("[" + "[[],[]]," * 300_000 + "[]]", "pairs"),
    "numbers": lambda: _long("[" + "5e9," * 600_000 + "0]", "pairs"),
    "digits": lambda: _long("[" + ("7" * 4000 + ",") * 600 + "0]", "pairs"),
    "names": lambda: _long("[" + '"a",' * 600_000 + '"a"]'),
    "objects": lambda: _long("[" + '{"a":0},' * 300_000 + "0]", "joints"),
    "deep": lambda: _long("[" * 1_000_000, "joints"),
}  # fmt: skip
"""What would take a checker long, or much memory, if it looked."""


def true_claims() -> dict[str, Claim]:
    """What is like a forgery, and is so."""
    made = {
        name: _free()
        for name in ("big end first", "single precision", "as Fortran has it", "in another order", "whole numbers")
    }
    for name in ("rows", *COVER):
        parts = made["big end first"].parts
        parts[name] = parts[name].astype(parts[name].dtype.newbyteorder(">"))
    made["single precision"].parts = {
        n: a.astype("f4" if a.dtype.kind == "f" else "i4") for n, a in _free().parts.items()
    }
    made["as Fortran has it"].parts = {n: np.asfortranarray(a) for n, a in _free().parts.items()}
    made["in another order"].parts.update({n: made["in another order"].parts[n][::-1] for n in COVER})
    made["whole numbers"].parts["rows"] = made["whole numbers"].parts["rows"].astype(int)
    made["whole numbers"].header.update(clearance=0, self_clearance=0)
    one = claim(rail(), beside(3.0), [[0.0], [1.0]], pieces=8)
    one.parts["span"][one.parts["span"] == 0.5] = HALF
    text = _free()
    text.text = json.dumps(text.header, indent=1, sort_keys=True, ensure_ascii=False).replace(
        '"scene"', '"\\u0073cene"'
    )
    out = {
        **made, "an ulp beside the middle": one, "other spelling": text,
        "of a needle": _past(solid("capsule", [5e-324, 1e-300], (1, 0.5, 0)))(),
        "flat hull": _past(hull([[0, 0, 0], [0, 1, 0], [0, 0, 1]], (1, 0.2, 0)))(),
        "clearance": _past(ball((1, 0.5, 0)), 0.29, 256)(),
        "of its own": _of(_two_bodies(0.5), [], [[0.0], [1.0]], pieces=64, self_clearance=0.2)(),
        "grown": _past(ball((1, 0.5, 0), grown=0.25))(),
        "arc around": _of(_base(), [ball((0.5, 0.5, 0))], [[0, 0, 0], [1, 1, 1.5]], "arc", 128)(),
        "line beside": _of(_base(), [ball((0.5, 0.1, 0), 0.05)], [[0, 0, 0], [1, 1, 1.5]], "values", 128)(),
        "twice round, beside": _of(wheel(), [ball((-1, 0, 0.5))], [[0.0], [2 * TURN]], "values", 256)(),
        "the shorter way": _of(_turning(0), [ball((-1, 0, 0))], [[0.3], [6.0]], "shortest", 64)(),
        "far slide": _of(
            _tree(joint(-1, 0), joint(0, 1, ALONG_X, slides=True), columns=2), [ball((99.9, 3, 0))], [[0, 100],
            [0.02, 100]], pieces=64
        )(),
        "lifted": _of(_tree(SLIDE, joint(0, 1, LIFTED), columns=2), [ball((1, 0, 0))], [[0, 0], [2, 0]], pieces=64)(),
        "a hull of the robot": _of(
            Robot([SLIDE], [hull(CUBE, (0, 0, 0), joint=0)], 1), [ball((1, 0.3, 0))], [[0.0], [2.0]], pieces=128
        )(),
    }  # fmt: skip
    return out


_MEASURED = """
import resource, runpy, sys
sys.argv = sys.argv[1:]
try:
    runpy.run_path(sys.argv[0], run_name="__main__")
except SystemExit as code:
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(f"{code} {used.ru_utime + used.ru_stime:.1f} s {used.ru_maxrss / 1000:.0f} MB", file=sys.stderr)
"""


def main() -> None:
    """Peak memory of a process counts that of the one which started it: the files are made by one that has ended."""
    if sys.argv[1:]:
        folder = Path(sys.argv[1])
        claims = {f"true {name}": made for name, made in true_claims().items()}
        for kind, forges in {**GEOMETRY, **STATEMENTS, "crowds": CROWDS}.items():
            claims.update({f"{kind}: {name}": forge() for name, forge in forges.items()})
        for k, (name, made) in enumerate(claims.items()):
            made.save(folder / f"{k:03d} {name.replace('/', ' ')}.npz")
        archives(folder, large=True)
        return
    wrong = count = 0
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, __file__, folder], check=True, env=os.environ)
        for file in sorted(Path(folder).iterdir()):
            run = [sys.executable, "-c", _MEASURED, str(checker.__file__), str(file)]
            done = subprocess.run(run, capture_output=True, text=True, check=False)
            said, measured = done.stdout.splitlines()[0], done.stderr.splitlines()[-1].split()
            bad = (measured[0] == "0") != (" true " in file.name) or float(measured[1]) > 10 or float(measured[3]) > 300
            wrong, count = wrong + bad, count + 1
            print("WRONG" if bad else "right", *measured, file.stem, "|", said[:100], flush=True)
    print(f"{count} files, {wrong} wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
