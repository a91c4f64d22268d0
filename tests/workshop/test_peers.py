"""Peers: they get the very robot and scene, and what they answer is measured here; who cannot is skipped with why."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import cast

import coal
import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, random_coordinates, self_distances
from cases import refused

from elastic_strips.collision.proof import scene_statement
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.sim.scenarios import get_scenario
from workshop.bench import peers
from workshop.bench.peers import bench_peers, environment, export_robot

LINE = """
import json, sys
folder = sys.argv[1]
given = json.load(open(folder + "/problems.json"))
runs = [{"ms": 1.0, "path": [p["start"], p["goal"]], "reason": ""} for p in given["problems"]]
runs[-1] = {"ms": 2.0, "path": None, "reason": "not in the mood"}
json.dump({"version": "0.1", "planner": "a line", "runs": runs}, open(folder + "/answer.json", "w"))
"""


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot("silvermate", base="omni")


def _problem(robot: RobotModel, seed: int) -> peers.Problem:
    found = get_scenario("corridor", seed=seed)
    return peers.Problem(found.scene, robot.space.to_coordinates(np.array(found.ends(robot))))


@pytest.mark.parametrize("name", ["silvermate", "panda"])
def test_the_urdf_of_the_peers_is_the_same_robot(name, tmp_path):
    """Pieces where they are here, and in collision with each other where they are here."""
    model = load_robot(name, base="omni" if name == "silvermate" else None)
    rng = np.random.default_rng(5)
    problem = peers.Problem(get_scenario("corridor", seed=0).scene, random_coordinates(model, rng, 2))
    joints = export_robot(tmp_path, model, [problem])
    file = str(tmp_path / "robot.urdf")
    other = pin.buildModelFromUrdf(file)
    shapes = pin.buildGeomFromUrdf(other, file, pin.GeometryType.COLLISION, package_dirs=[str(tmp_path)])
    shapes.addAllCollisionPairs()
    pin.removeCollisionPairs(other, shapes, str(tmp_path / "robot.srdf"))
    assert len(joints) == other.nv == model.nv
    columns = [other.joints[other.getJointId(joint)].idx_v for joint in joints]
    data, placed = other.createData(), shapes.createData()
    touching = 0
    for row in random_coordinates(model, rng, 600):
        q = np.zeros(other.nq)
        q[columns] = row
        distances = self_distances(model, configuration(model, row))
        if np.abs(distances).min(initial=1.0) < 2e-3:
            continue
        hit = pin.computeCollisions(other, data, shapes, placed, q, True)
        touching += hit
        assert hit == (distances.min(initial=1.0) < 0.0)
    assert touching
    assert (other.lowerPositionLimit[columns] <= problem.rows.min(axis=0)).all()


def test_obstacles_are_about_what_they_stand_for(robot, tmp_path):
    """Round shapes that go as meshes are a little larger, and no more than that."""
    (tmp_path / "meshes").mkdir()
    stated = [part for part in scene_statement(get_scenario("corridor", seed=1).scene) if part["kind"] == "cone"]
    assert stated
    (shape,) = peers.obstacles(tmp_path, "o", stated[:1])
    mesh = coal.MeshLoader().load(str(tmp_path / shape["mesh"]), np.ones(3))
    mesh.computeLocalAABB()
    radius, half = cast("list[float]", stated[0]["sizes"])
    size = np.array(mesh.aabb_local.max_) - np.array(mesh.aabb_local.min_)
    assert 2.0 * radius <= size[0] <= 2.02 * radius
    assert size[2] == pytest.approx(2.0 * half, rel=1e-5)


def test_a_peers_paths_are_certified_here(robot, tmp_path, monkeypatch):
    (tmp_path / "line_peer.py").write_text(LINE)
    monkeypatch.setattr(peers, "PROGRAMS", tmp_path)
    monkeypatch.setattr(peers, "REQUIREMENTS", {"line": ("line",), "none": ("none",)})
    ready = {"line": (Path(sys.executable), ""), "none": (None, "does not install: no")}
    monkeypatch.setattr(peers, "environment", lambda folder, name: ready[name])
    figures = bench_peers(robot, 2, peers=("line", "none"), environments=tmp_path, pushes=1)
    assert figures["planners"]["none"] == {"skipped": "does not install: no"}
    line = figures["planners"]["line"]
    assert line["version"] == "0.1"
    assert line["first"]["solved"] == 1
    assert line["first"]["touching"] == 1, "straight through the corridor's obstacles"
    assert line["first"]["runs"][1]["reason"] == "not in the mood"
    ours = figures["planners"]["elastic_strips"]
    assert ours["first"]["certified"] == 2
    assert ours["again"]["count"] == ours["again"]["certified"] == 2
    json.dumps(figures)
    with refused(ParameterError, "'moveit'"):
        bench_peers(robot, 1, peers=("moveit",), environments=tmp_path)


def test_a_variant_of_a_peer_is_its_program_told_so(robot, tmp_path, monkeypatch):
    (tmp_path / "line_peer.py").write_text(LINE.replace('"a line"', "sys.argv[2]"))
    monkeypatch.setattr(peers, "PROGRAMS", tmp_path)
    monkeypatch.setattr(peers, "REQUIREMENTS", {"line": ("line",), "short_line": ("line",)})
    monkeypatch.setattr(peers, "_LIKE", {"short_line": "line"})
    monkeypatch.setattr(peers, "environment", lambda folder, name: (Path(sys.executable), ""))
    planners = bench_peers(robot, 1, environments=tmp_path, peers=("line", "short_line"), pushes=1)["planners"]
    assert {name: planners[name]["planner"] for name in ("line", "short_line")} == {
        "line": "line",
        "short_line": "short_line",
    }


def test_a_peer_that_fails_is_skipped_with_its_last_words(robot, tmp_path, monkeypatch):
    (tmp_path / "line_peer.py").write_text("raise RuntimeError('no licence')")
    monkeypatch.setattr(peers, "PROGRAMS", tmp_path)
    monkeypatch.setattr(peers, "REQUIREMENTS", {"line": ("line",)})
    monkeypatch.setattr(peers, "environment", lambda folder, name: (Path(sys.executable), ""))
    figures = bench_peers(robot, 1, peers=("line",), environments=tmp_path, pushes=1)
    assert "no licence" in figures["planners"]["line"]["skipped"]


def test_what_does_not_install_says_why(tmp_path, monkeypatch):
    def run(call: list[str], **given: object) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(call, 1, "", "warning\nERROR: no matching distribution\n")

    monkeypatch.setattr(peers.venv, "create", lambda home, **given: None)
    monkeypatch.setattr(peers.subprocess, "run", run)
    assert environment(tmp_path, "roboplan") == (None, "does not install: ERROR: no matching distribution")
