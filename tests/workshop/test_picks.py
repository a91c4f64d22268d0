"""Picks: cans that stand where a robot could take them, planned and driven, with what came of it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from brute_force import link_distances
from cases import refused
from shared_data import shared_data

from elastic_strips.errors import ParameterError
from workshop.bench.picks import DRIVEN, FOAM, STANDING, grasps, house_pick, summary, table_pick
from workshop.cli.group import run_cli


def test_cans_of_the_house_are_on_furniture_and_start_elsewhere(silvermate):
    root = str(shared_data("house"))
    picks = {seed: house_pick(root, silvermate, seed) for seed in (0, 5)}
    for seed, pick in picks.items():
        again = house_pick(root, silvermate, seed)
        np.testing.assert_array_equal(pick.can.pose, again.can.pose)
        np.testing.assert_array_equal(pick.start, again.start)
        assert link_distances(silvermate, pick.scene, pick.start).min() > 0.0
        piece = [o for o in pick.scene if str(o.name).startswith(pick.on)]
        tops = [np.asarray(o.spec["vertices"])[:, 2].max() for o in piece]
        assert min(abs(pick.surface - 0.015 - top) for top in tops) < 1e-9, "it is on foam of 15 mm"
        assert 0.3 < pick.surface < 1.25
    standing = house_pick(root, silvermate, 0, gap=0.0)
    assert standing.surface == pytest.approx(picks[0].surface - 0.015)


def test_grasps_hold_the_can_at_one_place(silvermate, jackal_box):
    pick = table_pick(silvermate, 3)
    poses = grasps(silvermate, pick.can)
    assert len({pose.frame for pose in poses}) == 1
    assert max(math.dist(pose.position, pick.can.pose[:3, 3]) for pose in poses) < 0.3
    with refused(ParameterError, "jackal-box"):
        grasps(jackal_box, pick.can)


def test_a_summary_counts_what_came_of_it():
    runs = [
        {"certified": True, "failures": {"the reach": 2}, "work_s": 1.0, "reached": True, "contacts": 0},
        {"certified": False, "failures": {"the reach": 1, "the drive": 1}, "work_s": 3.0},
        {"error": "RobotError: none"},
    ]
    figures = summary(runs)
    assert (figures["count"], figures["certified"], figures["reached"], figures["contacts"]) == (3, 1, 1, 0)
    assert figures["failures"] == {"the reach": 3, "the drive": 1}
    assert figures["errors"] == ["RobotError: none"]
    assert "reached" not in summary(runs[1:])


def test_picks_are_planned_and_driven(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "figures.json"
    line = f"goals --robot silvermate --case picks --seeds 1 --processes 1 --json {path}"
    with pytest.raises(SystemExit) as ended:
        run_cli(line.split())
    assert ended.value.code == 0
    figures = json.loads(path.read_text(encoding="utf-8"))
    assert sorted(run["way"] for run in figures["runs"]) == sorted(figures["ways"]) == sorted([FOAM, STANDING, DRIVEN])
    assert [some["certified"] for some in figures["ways"].values()] == [1, 1, 1]
    assert figures["ways"][DRIVEN]["reached"] == 1
    assert figures["ways"][DRIVEN]["contacts"] == 0
    assert "driven" in capsys.readouterr().out
