"""Wrong command lines, and the result files that ``view`` must refuse."""

# ruff: noqa: E501 - tables: one case a line

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from malformed_case import Content, FileCase

from elastic_strips.errors import InputError

RESULT: dict[str, Any] = {
    "format": "elastic-strips-result", "version": 1, "robot": "small", "base": "omni", "locked": {}, "urdf": None,
    "obstacles": [{"name": "b", "shape": "box", "size": [1, 1, 1], "pose": [3, 3, 0, 0, 0, 0, 1]}],
    "strip": {"q": [[0, 0, 1, 0, 0, 0.1], [1, 0, 1, 0, 0, 0.1]]},
}  # fmt: skip
"""A sound result, once ``urdf`` names the sound robot."""


@dataclass(frozen=True, slots=True)
class CommandCase:
    """One wrong command line; ``{out}`` is the folder that must stay as it is, ``{in}`` one that holds ``beside``."""

    name: str
    arguments: tuple[str, ...]
    says: tuple[str, ...]
    beside: dict[str, Content] = field(default_factory=dict)


def command_cases() -> Iterator[CommandCase]:
    """Every wrong command line."""
    for line, *says in (
        ("dance", "'dance'"),
        ("run", "NAME|FILE.yaml"),
        ("run case-1 case-2", "case-2"),
        ("run case-1 --json", "--json"),
        ("run gone.yaml", "gone.yaml", "No such file"),
        ("run no/such/scenario", "no/such/scenario"),
        ("run {in}", "{in}", "folder"),
        ("run case-1 --preset fast", "'fast'", "paper"),
        ("run case-1 --seed -1", "-1"),
        ("run case-1 --seed 99999999999", "99999999999"),
        ("run case-1 --timeout 0", "--timeout", "0.01"),
        ("run case-1 --timeout nan", "nan"),
        ("run case-1 --robot silvermat", "'silvermat'", "did you mean 'silvermate'"),
        ("run case-1 --robot {in}/gone.urdf", "gone.urdf", "No such file"),
        ("run case-1 --robot {in}", "folder"),
        ("run case-1 --base legs", "'legs'"),
        ("run case-1 --base fixed", "'case-1'", "fixed"),
        ("run case-1 --json {out}/no/r.json", "no/r.json", "there is no folder"),
        ("run case-1 --json {out}", "{out}", "is a folder"),
        ("run case-1 --json /dev/null", "/dev/null", "device"),
        ("run case-1 --json {out}/" + "x" * 300, "file name"),
        ("run case-1 --json {out}/r --html {out}/r", "named twice"),
        ("view", "NAME|FILE.yaml|RESULT.json"),
        ("view gone.json --html {out}/p.html", "gone.json", "No such file"),
        ("view case-1 --html {out}/no/p.html", "no/p.html", "there is no folder"),
        ("view case-1 --speed 2 --html {out}/p.html", "--speed", "a scenario"),
        ("view case-1 --begin nan --html {out}/p.html", "nan"),
        ("view gone.npz --html {out}/p.html", "gone.npz", "No such file"),
        ("view {in}/r.npz --html {in}/r.npz", "named twice"),
        ("drive case-8", "'case-8'", "did you mean"),
        ("drive gone.npz", "gone.npz", "scenario"),
        ("drive case-1 --time-limit nan", "--time-limit", "nan"),
        ("drive case-1 --fault scene_frozen@soon", "scene_frozen@soon"),
        ("drive case-1 --record {out}", "{out}", "is a folder"),
        ("drive case-1 --record {out}/r.txt", "r.txt", ".npz"),
        ("list everything", "everything"),
        ("sweep nowhere.yaml", "nowhere.yaml"),
        ("sweep", "FILE.yaml"),
        ("--loud run case-1", "--loud"),
    ):
        yield CommandCase(line[:60], tuple(line.split()), tuple(says))
    yield CommandCase("run with an empty name", ("run", ""), ("''",))
    yield CommandCase("run with an empty output", ("run", "case-1", "--json", ""), ("''",))
    yield CommandCase("run over its own scenario", ("run", "{in}/s.yaml", "--json", "{in}/s.yaml"), ("s.yaml", "named twice"),
                      {"s.yaml": "robot: silvermate\nscene: {obstacles: []}\nstart: {}\ngoal: {x: 1}\n"})  # fmt: skip


def _damaged(**changes: Any) -> str:
    return json.dumps(RESULT | {"urdf": "small.urdf"} | changes)


def _obstacle(**changes: Any) -> str:
    return _damaged(obstacles=[RESULT["obstacles"][0] | changes])


def _without(key: str) -> str:
    return json.dumps({k: v for k, v in (RESULT | {"urdf": "small.urdf"}).items() if k != key})


def result_cases(sound_urdf: str) -> Iterator[FileCase]:
    """Every result file that ``view`` must refuse."""
    contents: tuple[tuple[str, Content, str], ...] = (
        ("empty", "", "is not JSON"),
        ("truncated", json.dumps(RESULT)[:80], "is not JSON"),
        ("binary garbage", bytes(range(256)), "not UTF-8"),
        ("nested 100000 deep", "[" * 100_000, "is not JSON"),
        ("a list", "[]", "run --json"),
        ("of another program", '{"format": "something"}', "run --json"),
        ("of another version", _damaged(version=99), "99"),
        ("without a strip", _without("strip"), "'strip'"),
        ("without obstacles", _without("obstacles"), "'obstacles'"),
        ("of an unknown base", _damaged(base="legs"), "'legs'"),
        ("with an unknown locked joint", _damaged(locked={"elbow": 0}), "'elbow'"),
        ("whose locked joints are a list", _damaged(locked=[1]), "damaged"),
        ("with a node too short", _damaged(strip={"q": [[0, 0, 1], [1, 0, 1]]}), "(2, 3)"),
        ("with one node", _damaged(strip={"q": [RESULT["strip"]["q"][0]]}), "at least 2 nodes"),
        ("with a node that is NaN", _damaged(strip={"q": [[float("nan"), 0, 1, 0, 0, 0.1]] * 2}), "not finite"),
        ("with a heading of length 2", _damaged(strip={"q": [[0, 0, 2, 0, 0, 0.1]] * 2}), "(cos, sin)"),
        ("with a joint out of limits", _damaged(strip={"q": [[0, 0, 1, 0, 3, 0.1]] * 2}), "'shoulder' = 3"),
        ("with nodes in words", _damaged(strip={"q": "far away"}), "not an array"),
        ("with a strip in a list", _damaged(strip=[1, 2]), "damaged"),
        ("with an unknown shape", _obstacle(shape="torus"), "'torus'"),
        ("with a negative size", _obstacle(size=[1, 1, -1]), "-1"),
        ("with a size too few", _obstacle(shape="cylinder", size=[1]), "damaged"),
        ("with a short pose", _obstacle(pose=[0, 0, 0]), "quat"),
        ("with an obstacle that is a word", _damaged(obstacles=["box"]), "damaged"),
        ("whose obstacles are a number", _damaged(obstacles=5), "damaged"),
    )
    for name, content, says in contents:
        yield FileCase(f"result: {name}", "bad.json", content, InputError, (says,), {"small.urdf": sound_urdf})
