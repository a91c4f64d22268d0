"""Reach problems: what the files say is planned; what is missing or wrong is named; the benchmark counts right."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from cases import each, refused
from shared_data import shared_data

from elastic_strips.errors import ScenarioError
from elastic_strips.native import kernel
from elastic_strips.scene import Box, Cylinder
from workshop.bench.looks import bench_looks
from workshop.bench.reach import bench_mbm
from workshop.reach_problems import load_mbm

_SRDF = """<robot name="gantry"><disable_collisions link1="column" link2="hand" reason="never"/></robot>"""


def _problem(n, goal, obstacles):
    return {"scene": "bench", "n": n, "start": [-1.0, 0.0], "goal": goal, "obstacles": obstacles}


def _write(root: Path, urdf: Path, problems: list, joints=("bend", "slide")) -> Path:
    folder = root / "mbm" / "panda"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "panda.urdf").write_text(urdf.read_text())
    (folder / "panda.srdf").write_text(_SRDF)
    document = json.dumps({"robot": "panda", "joints": list(joints), "problems": problems})
    (folder / "problems.json.gz").write_bytes(gzip.compress(document.encode()))
    return root


FAR = ["far", "box", [0.2, 0.4, 0.6], [5.0, 0.0, 0.5, 0.0, 0.0, 0.7071068, 0.7071068]]
CAN = ["can", "cylinder", [0.14, 0.03], [4.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]]
INSIDE = ["inside", "box", [3.0, 3.0, 3.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]


def test_problems_are_read(gantry_urdf, tmp_path):
    root = _write(tmp_path, gantry_urdf, [_problem(7, [1.0, 0.1], [FAR, CAN])])
    robot, (problem,) = load_mbm(root, "panda")
    assert (problem.name, problem.kind) == ("bench-7", "bench")
    start, goal = problem.ends(robot)
    assert robot.space.to_coordinates(goal)[robot.joint_names.index("bend")] == 1.0
    assert robot.space.to_coordinates(start)[robot.joint_names.index("slide")] == 0.0
    far, can = problem.scene
    assert isinstance(far, Box)
    assert isinstance(can, Cylinder)
    np.testing.assert_allclose(far.pose[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(can.pose[:3, 3], [4.0, 0.0, 0.5])
    low, high = (np.min(problem.scene.table.half_extents, axis=0), np.max(problem.scene.table.half_extents, axis=0))
    np.testing.assert_allclose(low, [0.03, 0.03, 0.07], atol=1e-6)  # the can's height is its first size
    np.testing.assert_allclose(high, [0.2, 0.1, 0.3], atol=1e-6)


def test_the_benchmark_counts(gantry_urdf, tmp_path):
    problems = [_problem(k, [1.0, 0.1], [FAR]) for k in range(3)] + [_problem(9, [1.0, 0.1], [INSIDE])]
    problems.append(_problem(10, [0.5, 0.0], [CAN]))
    notes = []
    figures = bench_mbm(_write(tmp_path, gantry_urdf, problems), "panda", notes.append)
    assert (figures["total"], figures["valid"], figures["certified"]) == (5, 4, 4)
    assert figures["kinds"] == {"bench": {"valid": 4, "certified": 4}}
    assert [entry["name"] for entry in figures["invalid"]] == ["bench-9"]
    assert "in collision" in figures["invalid"][0]["reason"]
    assert len(notes) == 5
    assert bench_mbm(tmp_path, "panda", stride=2)["total"] == 3


@pytest.mark.skipif(kernel() is None, reason="the native kernel is not compiled here")
def test_looks_are_right_and_counted(gantry_urdf, tmp_path):
    problems = [_problem(k, [1.0, 0.1], [CAN]) for k in range(2)]
    figures = bench_looks(_write(tmp_path, gantry_urdf, problems), "panda", stride=1, each=40)
    assert figures["wrong"] == 0
    assert sum(figures["configurations"].values()) == 2 * 2 * 40
    assert {"bench", "anywhere"} == set(figures["shares"])
    for shares in figures["shares"].values():
        assert sum(shares.values()) == pytest.approx(1.0)
    assert figures["leaves"]["of all"] >= figures["leaves"]["links"]


WRONG = {
    "joint": ({"joints": ("bend", "knee")}, "knee"),
    "length": ({"problems": [_problem(1, [1.0], [])]}, r"problems\[0\].goal: must be a list of 2 numbers"),
    "shape": ({"problems": [_problem(1, [1.0, 0.0], [["a", "torus", [1], [0] * 7]])]}, "torus"),
    "sizes": ({"problems": [_problem(1, [1.0, 0.0], [["a", "box", [1], [0, 0, 0, 0, 0, 0, 1]]])]}, "a box has 3 sizes"),
    "turn": ({"problems": [_problem(1, [1.0, 0.0], [["a", "sphere", [1], [0] * 7]])]}, "norm 0, not 1"),
    "entries": ({"problems": [_problem(1, [1.0, 0.0], [["a", "box"]])]}, "has 2 entries"),
}


@each("what", WRONG)
def test_what_is_wrong_is_named(gantry_urdf, tmp_path, what):
    changes, message = WRONG[what]
    problems = changes.get("problems", [_problem(1, [1.0, 0.0], [])])
    root = _write(tmp_path, gantry_urdf, problems, changes.get("joints", ("bend", "slide")))
    with pytest.raises(ValueError, match=message):
        load_mbm(root, "panda")


def test_what_is_missing_or_no_gzip_is_named(gantry_urdf, tmp_path):
    with refused(ScenarioError, "'fetch'"):
        load_mbm(_write(tmp_path, gantry_urdf, []), "fetch")
    with refused(ScenarioError, "'pr2'"):
        load_mbm(tmp_path, "pr2")
    (tmp_path / "mbm" / "panda" / "problems.json.gz").write_bytes(b"{}")
    with refused(ScenarioError, "gzip"):
        load_mbm(tmp_path, "panda")
    (tmp_path / "mbm" / "panda" / "problems.json.gz").write_bytes(gzip.compress(b" " * 30_000_000))
    with refused(ScenarioError, "20000000"):
        load_mbm(tmp_path, "panda")


@pytest.mark.parametrize("robot", ["fetch", "panda"])
def test_some_of_the_real_ones_are_planned(robot):
    figures = bench_mbm(shared_data("mbm"), robot, stride=90, timeout=30.0)
    assert figures["certified"] == figures["valid"] >= 3


def test_a_base_begins_two_metres_off(gantry_urdf, tmp_path):
    behind = ["behind", "box", [0.5, 0.5, 2.0], [-2.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]]
    root = _write(tmp_path, gantry_urdf, [_problem(0, [1.0, 0.1], [FAR]), _problem(1, [1.0, 0.1], [FAR, behind])])
    robot, (problem, _) = load_mbm(root, "panda", base="omni")
    start, goal = problem.ends(robot, (-2.0, 0.5))
    np.testing.assert_allclose(start[:2], (-2.0, 0.5))
    np.testing.assert_allclose(goal[:2], (0.0, 0.0))
    figures = bench_mbm(root, "panda", base="omni", timeout=30.0)
    assert figures["base"] == "omni"
    assert (figures["valid"], figures["certified"]) == (2, 2)
