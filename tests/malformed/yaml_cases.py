"""Malformed scene and scenario files."""

# ruff: noqa: E501 - tables: one case a line

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from malformed_case import Content, FileCase, sparse

from elastic_strips.errors import ConfigurationError, InputError, ParameterError, RobotError, ScenarioError, SceneError

SCENE = "version: 1\nobstacles:\n  - {shape: box, name: table, size: [1, 1, 1], at: [0, 3, 0.5]}\n"
SCENARIO = """version: 1
robot: silvermate
scene:
  obstacles:
    - {shape: box, name: table, size: [1, 1, 1], at: [2, 3, 0.5]}
start: {x: 0}
goal: {x: 4}
"""
_TABLE = "shape: box, name: table, size: [1, 1, 1], at: [2, 3, 0.5]"
_ALIASES = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
_SPHERE = "shape: sphere, radius: 1"
_FRAMES = "shape: sphere, radius: 1, motion: {keyframes: "

# name, content, what the message says: whatever kind of YAML file it is
_DOCUMENTS: tuple[tuple[str, Content, str], ...] = (
    ("empty", "", "empty"),
    ("only a comment", "# nothing here\n", "empty"),
    ("51 MB", sparse(51_000_000), "at most 50000000"),
    ("binary garbage", bytes(range(256)) * 4, "not UTF-8"),
    ("zero bytes", bytes(64), "not valid YAML"),
    ("UTF-16", SCENE.encode("utf-16"), "not UTF-8"),
    ("a tab as indent", "obstacles:\n\t- {}\n", "bad.yaml:2: not valid YAML: a tab; use spaces"),
    ("open bracket", "obstacles: [\n", "not valid YAML"),
    ("open quote", "obstacles: 'abc\n", "not valid YAML"),
    ("aliases of aliases", _ALIASES, "aliases are not allowed"),
    ("alias to itself", "obstacles: &a [*a]\n", "aliases are not allowed"),
    ("tag that runs code", "obstacles: !!python/object/apply:os.system ['true']\n", "tags are not allowed"),
    ("tag that binds a type", "obstacles: !!set {}\n", "tags are not allowed"),
    ("two documents", SCENE + "---\n" + SCENE, "second document"),
    ("nested 100 deep", "obstacles: " + "[" * 100 + "]" * 100 + "\n", "nested more than 32"),
    ("key that is a list", "? [a, b]\n: 1\n", "key must be a word"),
    ("a list", "- 1\n- 2\n", "must be a mapping"),
    ("a word", "scene\n", "must be a mapping"),
    ("JSON of another program", '{"nodes": [1]}', "'nodes'"),
)  # fmt: skip

# name, obstacle, what the message says
_OBSTACLES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("without a shape", "size: [1, 1, 1]", ("obstacles[0]", "'shape' is missing")),
    ("of an unknown shape", "shape: bax", ("obstacles[0].shape", "'bax'", "did you mean 'box'")),
    ("whose shape is a number", "shape: 5", ("obstacles[0].shape", "5")),
    ("with an unknown key", "shape: box, sise: [1, 1, 1]", ("obstacles[0].sise", "did you mean 'size'")),
    ("with another shape's key", "shape: box, radius: 1", ("obstacles[0].radius", "unknown key")),
    ("box without a size", "shape: box", ("obstacles[0]", "'size' is missing")),
    ("box of two lengths", "shape: box, size: [1, 1]", ("obstacles[0].size", "3 numbers")),
    ("box of negative size", "shape: box, size: [1, -1, 1]", ("obstacles[0]", "-1")),
    ("box without thickness", "shape: box, size: [1, 0, 1]", ("obstacles[0]", "0.0")),
    ("box that is NaN", "shape: box, size: [1, .nan, 1]", ("obstacles[0].size[1]", "nan")),
    ("box that is infinite", "shape: box, size: [1, .inf, 1]", ("obstacles[0].size[1]", "inf")),
    ("box in words", "shape: box, size: [1, one, 1]", ("obstacles[0].size[1]", "'one'")),
    ("box of truth", "shape: box, size: [1, true, 1]", ("obstacles[0].size[1]", "True")),
    ("box as large as a galaxy", "shape: box, size: [1, 1, 1e20]", ("obstacles[0]", "1e+20")),
    ("sphere without a radius", "shape: sphere", ("obstacles[0]", "'radius' is missing")),
    ("sphere of negative radius", "shape: sphere, radius: -0.3", ("obstacles[0].radius", "-0.3")),
    ("sphere smaller than an atom", "shape: sphere, radius: 1e-12", ("obstacles[0].radius", "1e-12")),
    ("sphere whose radius overflows", "shape: sphere, radius: 1e999", ("obstacles[0].radius", "inf")),
    ("cylinder without a length", "shape: cylinder, radius: 1", ("obstacles[0]", "'length' is missing")),
    ("cone of length 0", "shape: cone, radius: 1, length: 0", ("obstacles[0].length", "0")),
    ("hull of three points", "shape: convex, vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0]]", ("obstacles[0]", "3 points")),
    ("hull that is flat", "shape: convex, vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]", ("obstacles[0]", "hull")),
    ("hull with a ragged list", "shape: convex, vertices: [[0, 0, 0], [1, 0], [0, 1, 0], [0, 0, 1]]",
     ("obstacles[0].vertices[1]", "3 numbers")),
    ("mesh without anything", "shape: mesh", ("obstacles[0]", "missing")),
    ("mesh that is missing", "shape: mesh, file: gone.stl", ("gone.stl", "obstacles[0]")),
    ("mesh that is garbage", "shape: mesh, file: garbage.stl", ("garbage.stl",)),
    ("mesh of a kind nobody reads", "shape: mesh, file: garbage.docx", ("garbage.docx", "'.docx'")),
    ("mesh with a face too many", "shape: mesh, vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], faces: [[0, 1, 9]]",
     ("obstacles[0]", "9")),
    ("mesh scaled by 0", "shape: mesh, file: garbage.stl, scale: 0", ("obstacles[0].scale", "0")),
    ("voxels without centers", "shape: voxels, size: 0.1, centers: []", ("obstacles[0].centers", "empty")),
    ("voxels of negative size", "shape: voxels, size: -0.1, centers: [[0, 0, 0]]", ("obstacles[0]", "-0.1")),
    ("points given twice", "shape: points, radius: 0.1, points: [[0, 0, 0]], file: p.csv", ("obstacles[0]", "only one of")),
    ("points in a file that is missing", "shape: points, radius: 0.1, file: gone.csv", ("gone.csv", "No such file")),
    ("points in a pickle", "shape: points, radius: 0.1, file: pickle.npy", ("pickle.npy", "Python objects")),
    ("points in words", "shape: points, radius: 0.1, file: words.csv", ("words.csv",)),
    ("quaternion that is not of unit length", f"{_SPHERE}, quat: [0, 0, 0, 1.1]", ("obstacles[0].quat", "norm 1.1")),
    ("quaternion of zeros", f"{_SPHERE}, quat: [0, 0, 0, 0]", ("obstacles[0].quat", "norm 0")),
    ("quaternion of three numbers", f"{_SPHERE}, quat: [0, 0, 1]", ("obstacles[0].quat", "4 numbers")),
    ("orientation given twice", f"{_SPHERE}, quat: [0, 0, 0, 1], rpy: [0, 0, 0]", ("obstacles[0].rpy", "twice")),
    ("position that is NaN", f"{_SPHERE}, at: [.nan, 0, 0]", ("obstacles[0].at[0]", "nan")),
    ("position on the moon", f"{_SPHERE}, at: [3.8e8, 0, 0]", ("obstacles[0].at", "3.8e+08")),
    ("name that is a number", f"{_SPHERE}, name: 7", ("obstacles[0].name", "7")),
    ("name that is a bell", f'{_SPHERE}, name: "\\a"', ("obstacles[0].name", "x07")),
    ("two kinds of motion", f"{_SPHERE}, motion: {{twist: {{}}, keyframes: {{}}}}", ("obstacles[0].motion", "one of")),
    ("no kind of motion", f"{_SPHERE}, motion: {{}}", ("obstacles[0].motion", "one of")),
    ("unknown kind of motion", f"{_SPHERE}, motion: {{twitch: {{}}}}", ("'twitch'", "did you mean 'twist'")),
    ("twist that is infinite", f"{_SPHERE}, motion: {{twist: {{linear: [.inf, 0, 0]}}}}", ("linear[0]", "inf")),
    ("keyframes that go back in time", f"{_FRAMES}{{times: [1, 0], positions: [[0, 0, 0], [1, 0, 0]]}}}}", ("times", "increase")),
    ("keyframes without positions", f"{_FRAMES}{{times: [0, 1]}}}}", ("'positions' is missing",)),
    ("more times than positions", f"{_FRAMES}{{times: [0, 1], positions: [[0, 0, 0]]}}}}", ("1 positions", "2 times")),
    ("one mapping too deep", "shape: {box: 1}", ("obstacles[0].shape", "a mapping")),
)  # fmt: skip

# name, whole scene file, what the message says
_SCENES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("without obstacles", "version: 1\n", ("'obstacles'",)),
    ("whose obstacles are left out", "version: 1\nobstacles:\n", (":2: obstacles: nothing follows", "write []")),
    ("whose sources are left out", "obstacles: []\nsources: ~\n", (":2: sources: nothing follows",)),
    ("whose obstacles are a mapping", "obstacles: {a: 1}\n", ("obstacles", "must be a list")),
    ("whose obstacle is a word", "obstacles: [table]\n", ("obstacles[0]", "'table'")),
    ("of version 2", "version: 2\nobstacles: []\n", ("version", "2")),
    ("whose version is a word", "version: one\nobstacles: []\n", ("version", "'one'")),
    ("at no time", "time: .nan\nobstacles: []\n", ("time", "nan")),
    ("with a key twice", "obstacles: []\nobstacles: []\n", ("'obstacles' is given twice", "line 1")),
    ("with a key that is misspelt", "obstacels: []\n", ("'obstacels'", "did you mean 'obstacles'")),
    ("with a key of 1000 letters", f"{'k' * 1000}: 1\n", ("unknown key",)),
    ("with a name twice", f"obstacles:\n- {{{_SPHERE}, name: a}}\n- {{{_SPHERE}, name: a}}\n", ("'a'", "line 2")),
    ("with an obstacle key twice", "obstacles:\n- shape: sphere\n  radius: 1\n  radius: 2\n", ("'radius' is given twice",)),
)  # fmt: skip

# name, replaced text, by what, type of the error, what the message says
_SCENARIOS: tuple[tuple[str, str, str, type[InputError], tuple[str, ...]], ...] = (
    ("without a robot", "robot: silvermate\n", "", ScenarioError, ("'robot' is missing",)),
    ("without a scene", SCENARIO[SCENARIO.index("scene") : SCENARIO.index("start")], "", ScenarioError, ("'scene' is missing",)),
    ("without a start", "start: {x: 0}\n", "", ScenarioError, ("'start' is missing",)),
    ("without a goal", "goal: {x: 4}\n", "", ScenarioError, ("'goal' is missing",)),
    ("with an empty goal", "goal: {x: 4}", "goal:", ScenarioError, ("'goal' is missing",)),
    ("with a misspelt key", "version: 1", "sede: 1", ScenarioError, ("'sede'", "did you mean 'seed'")),
    ("of version 0", "version: 1", "version: 0", ScenarioError, ("version", "0")),
    ("for an unknown robot", "silvermate", "silvermat", RobotError, ("'silvermat'", "did you mean 'silvermate'")),
    ("for a robot that is a number", "silvermate", "7", ScenarioError, ("robot", "7")),
    ("for a robot file that is missing", "silvermate", "gone.urdf", ScenarioError, ("robot", "gone.urdf")),
    ("for a robot file that is a folder", "silvermate", "./", ScenarioError, ("robot", "no URDF file")),
    ("for a robot file that is broken", "silvermate", "broken.urdf", RobotError, ("broken.urdf", "not well-formed")),
    ("on an unknown base", "version: 1", "base: legs", ScenarioError, ("base", "'legs'")),
    ("on a fixed base that shall move", "version: 1", "base: fixed", ScenarioError, ("'bad'", "fixed")),
    ("with an unknown preset", "version: 1", "preset: papr", ScenarioError, ("preset", "did you mean 'paper'")),
    ("with parameters in a list", "version: 1", "params: [1]", ScenarioError, ("params", "a mapping")),
    ("with an unknown parameter", "version: 1", "params: {influense: 1}", ParameterError, ("'influense'", "did you mean 'influence'")),
    ("with a negative parameter", "version: 1", "params: {influence: -1}", ParameterError, ("influence=-1",)),
    ("with a parameter that is NaN", "version: 1", "params: {influence: .nan}", ScenarioError, ("params.influence", "nan")),
    ("with a parameter in words", "version: 1", "params: {influence: far}", ScenarioError, ("params.influence", "'far'")),
    ("with a clearance beyond the influence", "version: 1", "params: {clearance: 2}", ParameterError, ("clearance=2", "influence")),
    ("with spacings the wrong way round", "version: 1", "params: {min_spacing: 2}", ParameterError, ("min_spacing=2",)),
    ("with two nodes", "version: 1", "params: {max_nodes: 2}", ParameterError, ("max_nodes=2",)),
    ("with two ticks and a half", "version: 1", "params: {max_ticks: 2.5}", ParameterError, ("max_ticks=2.5",)),
    ("with a node and a half", "version: 1", "params: {max_nodes: 30.5}", ParameterError, ("max_nodes=30.5",)),
    ("with another preset in the parameters", "version: 1", "params: {preset: 1}", ParameterError, ("preset",)),
    ("with a negative seed", "version: 1", "seed: -1", ScenarioError, ("seed", "-1")),
    ("with a seed that is a word", "version: 1", "seed: random", ScenarioError, ("seed", "'random'")),
    ("with half a seed", "version: 1", "seed: 1.5", ScenarioError, ("seed", "1.5")),
    ("that starts at infinity", "start: {x: 0}", "start: {x: .inf}", ScenarioError, ("start.x", "inf")),
    ("that starts at NaN", "start: {x: 0}", "start: {yaw: .nan}", ScenarioError, ("start.yaw", "nan")),
    ("that starts on the moon", "start: {x: 0}", "start: {x: 3.8e8}", ScenarioError, ("start.x", "380000000")),
    ("that starts in three dimensions", "start: {x: 0}", "start: {x: 0, z: 1}", ScenarioError, ("start.z", "'z'")),
    ("that starts in a list", "start: {x: 0}", "start: [0, 0, 0]", ScenarioError, ("start", "a mapping")),
    ("with an unknown joint", "start: {x: 0}", "start: {joints: {elbow: 1}}", ConfigurationError, ("start", "'elbow'")),
    ("with a joint that is NaN", "start: {x: 0}", "start: {joints: {arm_4_joint: .nan}}", ScenarioError, ("arm_4_joint", "nan")),
    ("with a joint in words", "start: {x: 0}", "start: {joints: {arm_4_joint: up}}", ScenarioError, ("arm_4_joint", "'up'")),
    ("with a goal out of limits", "goal: {x: 4}", "goal: {x: 4, joints: {arm_4_joint: 30}}", ConfigurationError,
     ("goal", "'arm_4_joint' = 30", "limits")),
    ("that starts in collision", "start: {x: 0}", "start: {x: 2, y: 3}", ConfigurationError, ("start", "in collision", "'table'")),
    ("that ends in collision", "goal: {x: 4}", "goal: {x: 2, y: 3}", ConfigurationError, ("goal", "in collision", "'table'")),
    ("that ends too close", "goal: {x: 4}", "goal: {x: 2, y: 2.228}", ConfigurationError, ("goal", "too close", "'table'")),
    ("whose arm starts in itself", "start: {x: 0}",
     "start: {joints: {arm_1_joint: 0.47, arm_2_joint: -0.2, arm_3_joint: -1.69, arm_4_joint: 2.12, arm_5_joint: -2.41}}", ConfigurationError, ("start", "in collision", "mm deep")),
    ("with a scene that is missing", SCENARIO[SCENARIO.index("scene") : SCENARIO.index("start")], "scene: gone.yaml\n",
     ScenarioError, ("gone.yaml", "No such file")),
    ("with itself as the scene", SCENARIO[SCENARIO.index("scene") : SCENARIO.index("start")], "scene: bad.yaml\n",
     ScenarioError, ("is a scenario file",)),
    ("with a scene that is a number", SCENARIO[SCENARIO.index("scene") : SCENARIO.index("start")], "scene: 4\n",
     ScenarioError, ("scene", "4")),
    ("with an obstacle that is wrong", "size: [1, 1, 1]", "size: [1, 1, -1]", ScenarioError, ("scene.obstacles[0]", "-1")),
    ("cut in the middle", SCENARIO[60:], "", ScenarioError, ("not valid YAML",)),
)  # fmt: skip


def _pickle(path: Path) -> None:
    np.save(path, np.array([{"not": "numbers"}], dtype=object), allow_pickle=True)


def scene_cases() -> Iterator[FileCase]:
    """Every malformed scene file."""
    beside: dict[str, Content] = {
        "garbage.stl": bytes(range(256)), "garbage.docx": b"PK\3\4", "words.csv": "here,there,everywhere\n",
        "pickle.npy": _pickle,
    }  # fmt: skip
    for name, content, says in _DOCUMENTS:
        yield FileCase(f"scene: {name}", "bad.yaml", content, SceneError, (says,))
    for name, text, words in _OBSTACLES:
        yield FileCase(f"scene: {name}", "bad.yaml", f"obstacles:\n  - {{{text}}}\n", SceneError, words, beside)
    for name, text, words in _SCENES:
        yield FileCase(f"scene: {name}", "bad.yaml", text, SceneError, words)


def scenario_cases() -> Iterator[FileCase]:
    """Every malformed scenario file."""
    beside: dict[str, Content] = {"broken.urdf": "<robot>"}
    for name, old, new, error, words in _SCENARIOS:
        assert SCENARIO.count(old) == 1, name
        names = "gone.yaml" not in words
        yield FileCase(f"scenario: {name}", "bad.yaml", SCENARIO.replace(old, new), error, words, beside, names)
