"""Benchmarks of published problems: driven by laser alone, by peers, and at several times of the obstacles' loops."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from elastic_strips.sim.sensors import named_sensors
from workshop.bench.problems import bench_problems

BARN = {
    "cylinder_radius": 0.075, "cylinder_length": 1.0, "cylinder_center_z": 0.0, "goal_tolerance": 0.5, "timeout": 20.0,
    "worlds": [
        {
            "id": 6, "start": [0.0, 0.0, 0.0], "goal": [3.0, 0.0], "cylinders_xy": [[1.6, 0.1]],
            "path": [[0.0, 0.0], [3.0, 0.0]], "path_length": 3.0,
        },
    ],
}  # fmt: skip
DYNABARN = {
    "cylinder_radius": 0.5, "cylinder_length": 1.0, "cylinder_center_z": 0.0, "goal_tolerance": 0.5, "timeout": 15.0,
    "worlds": [
        {
            "id": k, "start": [0, 0, 0], "goal": [3.0, 0], "difficulty": difficulty,
            "walls": [{"name": "side", "pose": [0.0, 6.0, 0.5, 0.0, 0.0, 0.0], "size": [20.0, 0.5, 1.0]}],
            "obstacles": [
                {"name": "disc", "period": 40, "keyframes": [[0, 1.5, -6], [9, 1.5, -6], [11, 1.5, 0], [40, 1.5, 0]]}
            ],
        }
        for k, difficulty in ((3, "easy"), (4, "hard"))
    ],
}  # fmt: skip


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name, document in (("barn", BARN), ("dynabarn", DYNABARN)):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}_worlds.json").write_text(json.dumps(document), encoding="utf-8")
    return tmp_path


def test_barn_by_laser_alone(root: Path) -> None:
    laser = named_sensors("laser", "jackal-box")
    figures = bench_problems("barn", root, sensors=laser, compute="work", processes=1)
    (run,) = figures["runs"]
    assert run["success"], run["reason"]
    assert run["min_clearance_m"] > 0.0
    assert figures["sensors"] == ["laser"]
    assert 0.0 < figures["score_2_8"] <= 0.5


def test_a_peer_at_two_times_of_the_loops(root: Path) -> None:
    """The way is free at first; ten seconds later the disc has come to stand on it."""
    figures = bench_problems("dynabarn", root, difficulty="hard", phases=2, method="dwa-predicting", processes=1)
    first, second = figures["runs"]
    assert [(r["id"], r["phase"]) for r in figures["runs"]] == [(4, 0), (4, 1)]
    assert (figures["method"], figures["compute"], figures["worlds"]) == ("dwa-predicting", "free", 1)
    assert first["success"]
    assert first["time_s"] < 4.0
    assert not second["contacts"] or second["collisions"]
    total = sum(r["collisions"] + r["contacts_at_rest"] for r in figures["runs"])
    assert figures["contacts_per_s"] == pytest.approx(total / (first["time_s"] + second["time_s"]))
