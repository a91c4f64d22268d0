"""Others' paths: what a planner answers is certified, repaired and driven; who cannot be had is skipped with why."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from cases import refused

from elastic_strips.collision import certify
from elastic_strips.errors import ParameterError
from elastic_strips.robot import load_robot
from workshop.bench import others, peers
from workshop.bench.others import bench_others

LINE = """
import json, sys
folder = sys.argv[1]
given = json.load(open(folder + "/problems.json"))
runs = [{"ms": 1.0, "path": [p["start"], p["goal"]], "reason": ""} for p in given["problems"]]
runs[-1] = {"ms": 2.0, "path": None, "reason": "not in the mood"}
json.dump({"version": "0.1", "planner": "a line", "runs": runs}, open(folder + "/answer.json", "w"))
"""


def test_an_answer_is_certified_repaired_and_driven(tmp_path, monkeypatch):
    (tmp_path / "ompl_peer.py").write_text(LINE)
    ready = {"ompl": (Path(sys.executable), ""), "roboplan": (None, "does not install: no")}
    monkeypatch.setattr(peers, "PROGRAMS", tmp_path)
    monkeypatch.setattr(others, "environment", lambda folder, name: ready[name])
    robot = load_robot("panda")
    figures = bench_others(robot, [0, 1], planners=("ompl", "roboplan"), environments=tmp_path)
    assert figures["planners"]["roboplan"] == {"skipped": "does not install: no"}
    line = figures["planners"]["ompl"]
    assert (line["count"], line["solved"]) == (2, 1)
    assert line["refuted"] == 1, "problems are such that the straight line touches something"
    first, second = line["runs"]
    assert first["depth_m"] > 0.0
    assert first["driven"]["contacts_at_speed"] == line["contacts_at_speed"] == 0
    assert second["why"] == "not in the mood"
    json.dumps(figures)
    with refused(ParameterError, "'moveit'"):
        bench_others(robot, [0], planners=("moveit",), environments=tmp_path)


def test_problems_are_free_at_their_ends():
    robot = load_robot("panda")
    one, again, other = (others._boxes(robot, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.rows, again.rows)
    assert not np.array_equal(one.rows, other.rows)
    for row in one.rows:
        assert certify(robot, one.scene, [row, row]).certified
    assert not certify(robot, one.scene, one.rows).certified
