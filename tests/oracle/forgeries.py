"""Forged proofs, as somebody makes them who has read the checker: of robots that touch something on the way.

A claim is what a proof file holds. The honest ones here are true, and taken; each forgery is of something false, and
uses one thing that a checker could take on trust: what a column may wrap, who moves with the base, how large numbers
are, what an archive or JSON may hold. Nothing of the library is used to make them but the checker's own functions,
which a forger has.

    python tests/oracle/forgeries.py          # makes all of them, and says what the checker says
"""

from __future__ import annotations

import contextlib
import copy
import io
import json
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elastic_strips import proof_checker as checker

Array = npt.NDArray[Any]
Part = dict[str, Any]
TURN = 2.0 * np.pi
ALONG_X = ((0.0, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0, 0.0), (-1.0, 0.0, 0.0, 0.0))
"""The frame of a joint that slides along, or turns about, the x axis."""
UPRIGHT = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))


@dataclass
class Claim:
    """What a proof file holds."""

    header: Part
    parts: dict[str, Array]
    text: str | None = None
    """The header as it is written, where it is not simply the header."""

    def save(self, file: Path) -> Path:
        text = json.dumps(self.header) if self.text is None else self.text
        np.savez_compressed(file, header=np.array(text), **self.parts)
        return file


def joint(parent: int, column: int, frame: object = UPRIGHT, **others: object) -> Part:
    made = {"parent": parent, "column": column, "slides": False, "multiplier": 1.0, "constant": 0.0}
    return {**made, "offset": np.array(frame, dtype=float).tolist(), **others}


def ball(at: tuple[float, float, float], radius: float = 0.1, **others: object) -> Part:
    return {
        "name": "ball", "kind": "sphere", "sizes": [radius], "points": [], "grown": 0.0,
        "rotation": np.eye(3).tolist(), "translation": list(at), **others,
    }  # fmt: skip


@dataclass
class Robot:
    joints: list[Part]
    bodies: list[Part]
    columns: int
    planar: bool = False
    circular: tuple[int, ...] = ()
    pairs: list[list[int]] = field(default_factory=list)

    def part(self) -> Part:
        return {
            "name": "robot", "columns": [f"c{k}" for k in range(self.columns)], "planar": self.planar,
            "joints": self.joints, "circular": [k in self.circular for k in range(self.columns)],
            "bodies": self.bodies, "pairs": self.pairs,
        }  # fmt: skip


def claim(robot: Robot, scene: list[Part], rows: object, way: str = "values", pieces: int = 1) -> Claim:
    """So many equal intervals a pair and segment, each with the best of many directions."""
    header = {
        "format": checker.FORMAT, "version": checker.VERSION, "way": way, "clearance": 0.0, "self_clearance": 0.0,
        "robot": robot.part(), "scene": scene,
    }  # fmt: skip
    values = np.array(rows, dtype=float)
    pairs = len(robot.bodies) * len(scene) + len(robot.pairs)
    segment, pair, piece = (a.ravel() for a in np.indices((len(values) - 1, pairs, pieces)))
    span = np.column_stack((piece, piece + 1)) / pieces
    normal = np.zeros((len(span), 2, 3))
    normal[:, :, 0] = 1.0
    with contextlib.suppress(Exception):  # a statement that the checker refuses to look at has any
        path = checker.Path(checker.World(copy.deepcopy(header["robot"]), scene), values, way)
        best = np.full((len(span), 2), -np.inf)
        for n in np.vstack((np.eye(3), -np.eye(3), np.random.default_rng(0).normal(size=(40, 3)))):
            for e in (0, 1):
                gap = path.gaps(segment, span[:, e], pair, np.tile(n, (len(span), 1)))
                better = gap > best[:, e]
                best[better, e], normal[better, e] = gap[better], n
    parts = {"rows": values, "segment": segment, "pair": pair, "span": span, "normal": normal}
    return Claim(header, parts)


def rail(**others: object) -> Robot:
    """A ball that slides along x."""
    return Robot([joint(-1, 0, ALONG_X, slides=True, **others)], [ball((0, 0, 0), joint=0)], 1)


def wheel(**others: object) -> Robot:
    """A ball one metre from an upright axis."""
    return Robot([joint(-1, 0, **others)], [ball((1, 0, 0), joint=0)], 1)


def beside(x: float) -> list[Part]:
    return [ball((x, 0.0, 0.0))]


def cart(second_root: bool = False) -> Robot:
    """A base with a ball; and another ball, on the base or on a joint that is fixed to the world."""
    joints = [joint(-1, -1), joint(-1 if second_root else 0, 3)]
    return Robot(joints, [ball((0, 0, 0), joint=0), ball((0, 0, 0), joint=1)], 4, planar=True, pairs=[[0, 1]])


def true_claims() -> dict[str, Claim]:
    """What is so, and has to be taken."""
    leader = joint(-1, 0, ALONG_X, slides=True)
    two = Robot([leader, joint(0, 0, multiplier=-2.0, constant=0.3)], [ball((0.3, 0, 0), joint=1)], 1)
    base = Robot([joint(-1, -1)], [ball((0.5, 0, 0), joint=0)], 3, planar=True)
    return {
        "rail": claim(rail(), beside(3.0), [[0.0], [2.0]], pieces=16),
        "wheel by its values": claim(wheel(), beside(3.0), [[0.0], [2.0 * TURN]], pieces=64),
        "wheel the shorter way": claim(
            Robot(wheel().joints, wheel().bodies, 1, circular=(0,)), [ball((-1, 0, 0))], [[0.3], [6.1]], "shortest", 16
        ),
        "leader and follower": claim(two, beside(3.0), [[0.0], [1.0]], pieces=16),
        "base on an arc": claim(base, [ball((0.0, 3.0, 0.0))], [[0, 0, 0], [1, 1, 1.5]], "arc", 16),
        "base on a line": claim(base, [ball((0.0, 3.0, 0.0))], [[0, 0, 0], [1, 0, 7.0]], "values", 32),
        "second root": claim(cart(second_root=True), [], [[1, 0, 0, 0], [2, 0, 0, 0]], pieces=4),
    }


def _touching(pieces: int = 1) -> Claim:
    """The rail's ball goes through another one, half-way."""
    return claim(rail(), beside(1.0), [[0.0], [2.0]], pieces=pieces)


def _edited(key: str, value: object) -> Callable[[], Claim]:
    def forge() -> Claim:
        made = _touching()
        made.header[key] = value
        return made

    return forge


def _statement(change: Callable[[Part], object], honest: bool = True) -> Callable[[], Claim]:
    """A true claim whose statement was changed into what no statement may be; or one that is not true to begin with."""

    def forge() -> Claim:
        made = claim(rail(), beside(3.0), [[0.0], [1.0]], pieces=8) if honest else _touching(8)
        change(made.header)
        return made

    return forge


def _arrays(**changes: Callable[[Array], Array]) -> Callable[[], Claim]:
    def forge() -> Claim:
        made = _touching(4)
        for name, change in changes.items():
            made.parts[name] = change(made.parts[name].copy())
        return made

    return forge


def _circular_slide() -> Claim:
    """A slide of 2π that is said to be a turn, and so to go nowhere."""
    robot = rail()
    robot.circular = (0,)
    return claim(robot, beside(np.pi), [[0.0], [TURN]], "shortest")


def _circular_base() -> Claim:
    """A base that drives 2π along x, where x is said to be an angle."""
    robot = Robot([joint(-1, -1)], [ball((0, 0, 0), joint=0)], 3, planar=True, circular=(0,))
    return claim(robot, beside(np.pi), [[0, 0, 0], [TURN, 0, 0]], "shortest")


def _circular_follower() -> Claim:
    """A joint that goes half as far as its circular column: a whole turn of the column is half a turn of it."""
    robot = wheel(multiplier=0.5)
    robot.circular = (0,)
    return claim(robot, [ball((0.0, 1.0, 0.0))], [[0.0], [TURN]], "shortest")


def _circular_shared() -> Claim:
    """The leader turns, and wraps; a follower slides by the same column."""
    robot = Robot([joint(-1, 0), joint(-1, 0, ALONG_X, slides=True)], [ball((0, 0, 0), joint=1)], 1, circular=(0,))
    return claim(robot, beside(np.pi), [[0.0], [TURN]], "shortest")


def _second_root() -> Claim:
    """The base passes through a body that stands on a root of its own, and is said to move with it."""
    return claim(cart(second_root=True), [], [[-1, 0, 0, 0], [1, 0, 0, 0]])


def _world_body() -> Claim:
    """The same with a body of the world."""
    robot = cart()
    robot.bodies[1]["joint"] = -1
    return claim(robot, [], [[-1, 0, 0, 0], [1, 0, 0, 0]])


def _follower() -> Claim:
    """A follower that goes four times as far as its leader: back through the obstacle and beyond."""
    robot = Robot([joint(-1, 0, ALONG_X, slides=True, multiplier=4.0)], [ball((0, 0, 0), joint=0)], 1)
    return claim(robot, beside(1.0), [[0.0], [0.5]])


def _chain() -> Claim:
    """Leader and follower in one chain move a body by the sum of both."""
    joints = [joint(-1, 0, ALONG_X, slides=True), joint(0, 0, slides=True)]
    return claim(Robot(joints, [ball((0, 0, 0), joint=1)], 1), beside(1.0), [[0.0], [1.0]])


def _two_followers() -> Claim:
    """Two bodies on joints of one column, which move towards each other."""
    joints = [joint(-1, 0, ALONG_X, slides=True), joint(-1, 0, ALONG_X, slides=True, multiplier=-1.0, constant=2.0)]
    robot = Robot(joints, [ball((0, 0, 0), joint=0), ball((0, 0, 0), joint=1)], 1, pairs=[[0, 1]])
    return claim(robot, [], [[0.0], [2.0]])


def _whole_turn() -> Claim:
    """A whole turn by the values passes through what the shorter way does not."""
    return claim(wheel(), [ball((-1.0, 0.0, 0.0))], [[0.0], [TURN]])


def _half_turn() -> Claim:
    robot = Robot(wheel().joints, wheel().bodies, 1, circular=(0,))
    return claim(robot, [ball((0.0, -1.0, 0.0))], [[0.0], [np.pi]], "shortest", 8)


def _rounding(at: float) -> Callable[[], Claim]:
    """Numbers so large that a metre is lost in them."""

    def forge() -> Claim:
        return claim(rail(constant=at), beside(at + 1.0), [[0.0], [2.0]])

    return forge


def _far_rows() -> Claim:
    return claim(rail(), beside(1e17), [[1e17], [1e17]])


def _far_base() -> Claim:
    robot = Robot([joint(-1, -1)], [ball((0, 0, 0), joint=0)], 3, planar=True)
    return claim(robot, beside(1e17), [[1e17, 0, 0], [1e17, 0, 0]])


def _far_offset() -> Claim:
    frame = np.array(ALONG_X)
    frame[:, 3] = (1e17, 0.0, 0.0)
    robot = Robot([joint(-1, 0, frame, slides=True)], [ball((0, 0, 0), joint=0)], 1)
    return claim(robot, beside(1e17), [[0.0], [2.0]])


def _two_scenes() -> Claim:
    """JSON with a key that is there twice: one reader takes the first, another one the last."""
    made = claim(rail(), beside(3.0), [[0.0], [1.0]], pieces=8)
    made.text = json.dumps(made.header)[:-1] + ', "scene": ' + json.dumps(made.header["scene"]) + "}"
    return made


def _nan_text() -> Claim:
    made = _touching()
    made.text = json.dumps(made.header).replace('"clearance": 0.0', '"clearance": NaN')
    return made


def _deep_text() -> Claim:
    made = _touching()
    made.text = "[" * 200_000 + "]" * 200_000
    return made


def _huge_number() -> Claim:
    made = _touching()
    made.text = json.dumps(made.header).replace('"clearance": 0.0', '"clearance": -1' + "0" * 400)
    return made


def _nothing() -> Claim:
    """A proof of nothing about nothing."""
    made = claim(Robot(rail().joints, [], 1), [], [[0.0], [2.0]])
    made.parts["normal"] = np.zeros((0, 2, 3))
    return made


def _no_pairs() -> Claim:
    return claim(rail(), [], [[0.0], [2.0]])


def _unused_rows() -> Claim:
    """A row more than intervals are given for, in which the robot touches."""
    made = claim(rail(), beside(1.0), [[0.0], [0.5]], pieces=8)
    made.parts["rows"] = np.array([[0.0], [0.5], [1.0]])
    return made


def _set_joint(key: str, value: object) -> Callable[[Part], object]:
    return lambda header: header["robot"]["joints"][0].update({key: value})


def _set_body(key: str, value: object) -> Callable[[Part], object]:
    return lambda header: header["robot"]["bodies"][0].update({key: value})


def _set_obstacle(key: str, value: object) -> Callable[[Part], object]:
    return lambda header: header["scene"][0].update({key: value})


def _set_robot(key: str, value: object) -> Callable[[Part], object]:
    return lambda header: header["robot"].update({key: value})


_SKEW = [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
_MIRROR = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

FORGERIES: dict[str, dict[str, Callable[[], Claim]]] = {
    "columns that wrap": {
        "slide": _circular_slide, "base's x": _circular_base, "half follower": _circular_follower,
        "sliding follower": _circular_shared, "half a turn": _half_turn,
        "text": _statement(_set_robot("circular", ["yes"])), "number": _statement(_set_robot("circular", [1])),
        "too many": _statement(_set_robot("circular", [False, True])),
    },
    "who moves": {
        "second root": _second_root, "body of the world": _world_body, "follower": _follower, "chain": _chain,
        "two followers": _two_followers, "whole turn": _whole_turn,
    },
    "large numbers": {
        "constant": _rounding(1e17), "constant of 1e9": _rounding(1e9), "rows": _far_rows, "base": _far_base,
        "offset": _far_offset, "multiplier": _statement(_set_joint("multiplier", 1e17)),
        "infinite": _statement(_set_joint("constant", float("inf"))), "in JSON": _huge_number,
        "size": _statement(_set_obstacle("sizes", [1e17])),
        "place": _statement(_set_obstacle("translation", [1e17, 0, 0])),
    },
    "clearances": {
        "text": _edited("clearance", "0.0"), "true": _edited("clearance", True), "none": _edited("clearance", None),
        "list": _edited("clearance", [0.0]), "negative": _edited("clearance", -1.0), "NaN": _nan_text,
        "infinite": _edited("clearance", float("-inf")), "own, negative": _edited("self_clearance", -1.0),
    },
    "nothing": {"no bodies": _nothing, "no pairs": _no_pairs, "rows without intervals": _unused_rows},
    "intervals": {
        "reversed": _arrays(span=lambda s: s[:, ::-1]), "outside": _arrays(span=lambda s: s * 0.4 + 0.3),
        "of length 0": _arrays(span=lambda s: np.repeat(s[:, :1], 2, axis=1)),
        "NaN": _arrays(span=lambda s: s * np.nan),
        "a hole": _arrays(span=lambda s: np.where(s == 0.5, 0.4, s)[:, [0, 1]] + [[0, 0], [0, 0], [0.1, 0], [0, 0]]),
        "only the ends": _arrays(**{n: lambda a: a[[0, -1]] for n in ("segment", "pair", "span", "normal")}),
        "twice the ends": _arrays(**{n: lambda a: a[[0, 0, -1, -1]] for n in ("segment", "pair", "span", "normal")}),
        "overlapping": _arrays(span=lambda s: np.array([[0.0, 0.6], [0.4, 1.0], [0.0, 0.6], [0.4, 1.0]])),
    },
    "numbers of pairs": {
        "negative": _arrays(pair=lambda p: p - 1), "beyond": _arrays(pair=lambda p: p + 1),
        "fractions": _arrays(pair=lambda p: p + 0.5), "wrapped": _arrays(pair=lambda p: p.astype(np.uint64) + 2**63),
        "truth values": _arrays(pair=lambda p: p.astype(bool)), "other segment": _arrays(segment=lambda s: s + 1),
        "another shape": _arrays(segment=lambda s: s[:, None]),
    },
    "directions": {
        "none": _arrays(normal=lambda n: 0.0 * n), "NaN": _arrays(normal=lambda n: np.nan * n),
        "infinite": _arrays(normal=lambda n: np.inf * n), "huge": _arrays(normal=lambda n: 1e200 * n),
        "tiny": _arrays(normal=lambda n: 1e-200 * n), "complex": _arrays(normal=lambda n: n * (1 + 1j)),
        "text": _arrays(normal=lambda n: n.astype(str)), "dates": _arrays(normal=lambda n: n.astype("M8[s]")),
        "one": _arrays(normal=lambda n: n[:1]),
    },
    "shapes": {
        "negative radius": _statement(_set_obstacle("sizes", [-0.5]), honest=False),
        "no radius": _statement(_set_obstacle("sizes", []), honest=False),
        "shrunk": _statement(_set_obstacle("grown", -0.5), honest=False),
        "no points": _statement(lambda h: h["scene"][0].update(kind="convex", sizes=[]), honest=False),
        "unknown": _statement(_set_obstacle("kind", "plane")), "kinds": _statement(_set_obstacle("kind", ["sphere"])),
        "skewed": _statement(_set_obstacle("rotation", _SKEW)),
        "mirrored": _statement(_set_obstacle("rotation", _MIRROR)),
        "text": _statement(_set_obstacle("sizes", ["0.1"])), "true": _statement(_set_obstacle("sizes", [True])),
        "no place": _statement(_set_obstacle("translation", [])),
        "ragged": _statement(_set_obstacle("rotation", [[1, 0, 0], [0, 1], [0, 0, 1]])),
        "further key": _statement(_set_obstacle("radius", 0.1)),
        "less keys": _statement(lambda h: h["scene"][0].pop("grown")),
    },
    "joints": {
        "of itself": _statement(_set_joint("parent", 0)), "below the world": _statement(_set_joint("parent", -2)),
        "in parts": _statement(_set_joint("parent", -1.0)), "text": _statement(_set_joint("column", "0")),
        "of no column": _statement(_set_joint("column", -1)), "of another column": _statement(_set_joint("column", 1)),
        "slides a little": _statement(_set_joint("slides", 1)),
        "skewed": _statement(_set_joint("offset", [[2, 0, 0, 0]] * 3)),
        "no multiplier": _statement(_set_joint("multiplier", [])), "true": _statement(_set_joint("multiplier", True)),
        "body of no joint": _statement(_set_body("joint", 1)), "body below": _statement(_set_body("joint", -2)),
        "body of part": _statement(_set_body("joint", 0.0)), "none": _statement(_set_robot("joints", [])),
        "no base": _statement(_set_robot("planar", True)), "planar as text": _statement(_set_robot("planar", "")),
        "pair in parts": _statement(_set_robot("pairs", [[0.0, 0.0]])),
        "pair of none": _statement(_set_robot("pairs", [[0, 1]])),
        "pair of truth": _statement(_set_robot("pairs", [[False, False]])),
        "more columns": _statement(_set_robot("columns", ["a", "b"])),
    },
    "JSON": {
        "a key twice": _two_scenes, "deep": _deep_text, "a further key": _edited("note", "0"),
        "version as text": _edited("version", "2"), "version with point": _edited("version", 2.0),
        "true version": _edited("version", True), "version before": _edited("version", 1),
        "way": _edited("way", "line"),
        "ways": _edited("way", ["values"]), "scene is one": _edited("scene", {}), "no robot": _edited("robot", None),
    },
    "types": {
        "small whole numbers": _arrays(rows=lambda r: r.astype(np.int8)),
        "halves": _arrays(span=lambda s: s.astype("f2")),
        "objects": _arrays(pair=lambda p: p.astype("S4")), "unsigned": _arrays(pair=lambda p: p.astype(np.uint32)),
        "times": _arrays(segment=lambda s: s.astype("m8[s]")), "records": _arrays(rows=lambda r: r.view([("a", "f8")])),
    },
    "rows": {
        "one": _arrays(rows=lambda r: r[:1]), "none": _arrays(rows=lambda r: r[:0]),
        "NaN": _arrays(rows=lambda r: r * np.nan),
        "wide": _arrays(rows=lambda r: np.hstack((r, r))), "text": _arrays(rows=lambda r: r.astype(str)),
        "truth values": _arrays(rows=lambda r: r.astype(bool)), "flat": _arrays(rows=lambda r: r.ravel()),
    },
}  # fmt: skip
"""By kind, and by what was done. All of them are to be refused."""


def _zipped(file: Path, members: list[tuple[str, bytes]], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return file


def _members(made: Claim) -> list[tuple[str, bytes]]:
    out = []
    for name, array in {"header": np.array(json.dumps(made.header)), **made.parts}.items():
        stream = io.BytesIO()
        np.lib.format.write_array(stream, np.asarray(array), allow_pickle=True)
        out.append((f"{name}.npy", stream.getvalue()))
    return out


def archives(folder: Path, bomb_megabytes: int = 2400) -> dict[str, Path]:
    """Files that are no honest archives; each is to be refused, or is no proof."""
    honest = claim(rail(), beside(3.0), [[0.0], [1.0]], pieces=8)
    members = _members(honest)
    pickled = copy.deepcopy(honest)
    pickled.parts["rows"] = np.array([[0.0], [print]], dtype=object)
    zeros = np.lib.format.header_data_from_array_1_0(np.zeros(1))
    with io.BytesIO() as stream:
        np.lib.format.write_array_header_1_0(stream, {**zeros, "shape": (300_000_000, 1)})
        claimed = stream.getvalue()
    bomb = folder / "bomb.npz"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members:
            if name != "rows.npy":
                archive.writestr(name, data)
        with archive.open("rows.npy", "w", force_zip64=True) as into:  # zeros: a thousandth of it, as a file
            into.write(claimed)
            for _ in range(bomb_megabytes // 8):
                into.write(bytes(8_000_000))
    return {
        "bomb": bomb,
        "a shape without its numbers": _zipped(
            folder / "claimed.npz", [(n, claimed if n == "rows.npy" else d) for n, d in members]
        ),
        "an array twice": _zipped(folder / "twice.npz", [*members, members[-1]]),
        "a further array": _zipped(folder / "more.npz", [*members, ("extra.npy", members[-1][1])]),
        "an array less": _zipped(folder / "less.npz", members[:-1]),
        "another compression": _zipped(folder / "bz2.npz", members, zipfile.ZIP_BZIP2),
        "pickled": _zipped(folder / "pickled.npz", _members(pickled)),
        "an archive within": _zipped(
            folder / "within.npz",
            [(n, (folder / "less.npz").read_bytes() if n == "rows.npy" else d) for n, d in members],
        ),
        "no array": _zipped(folder / "none.npz", [(n, b"" if n == "rows.npy" else d) for n, d in members]),
        "header of numbers": _zipped(
            folder / "numbers.npz", [(n, members[-1][1] if n == "header.npy" else d) for n, d in members]
        ),
    }  # fmt: skip


def verdict(file: Path) -> tuple[int, str]:
    """What the checker's command says of a file."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(out):
        code = checker.main([str(file)])
    return code, out.getvalue().strip()


def main() -> None:
    taken = count = 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "proof.npz"
        for name, made in true_claims().items():
            code, said = verdict(made.save(file))
            print(f"true     {name}: {said.splitlines()[0]}")
            taken += code != 0
        entries = [(f"{k}: {n}", make().save) for k, kind in FORGERIES.items() for n, make in kind.items()]
        for name, save in entries:
            code, said = verdict(save(file))
            count, taken = count + 1, taken + (code == 0)
            print(f"{'TAKEN' if code == 0 else 'refused':8} {name}: {said.splitlines()[0][:150]}")
        for name, path in archives(Path(folder)).items():
            code, said = verdict(path)
            count, taken = count + 1, taken + (code == 0)
            print(f"{'TAKEN' if code == 0 else 'refused':8} archive, {name}: {said.splitlines()[0][:150]}")
    print(f"{count} forgeries of {len(FORGERIES) + 1} kinds, {taken} wrong")
    sys.exit(bool(taken))


if __name__ == "__main__":
    main()
