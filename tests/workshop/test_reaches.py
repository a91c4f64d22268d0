"""Reaches in the house: people walk where it is free, and a drive is evaluated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from free_way import outside_scene
from shared_data import shared_data

from elastic_strips.errors import ScenarioError
from elastic_strips.sim.sensors.params import named_sensors
from workshop.bench import reaches
from workshop.bench.picks import house_pick
from workshop.bench.reaches import bench_reaches, people
from workshop.cli.group import run_cli


def test_people_walk_smoothly_and_not_through_furniture(silvermate):
    root = str(shared_data("house"))
    pick = house_pick(root, silvermate, 0)
    start = silvermate.space.to_coordinates(pick.start)
    found = people(root, silvermate, pick.scene, start, 3, seed=4)
    assert [one.name for one in found] == ["person-0", "person-1", "person-2"]
    for one in found:
        places = np.array([one.at(t).pose[:3, 3] for t in np.arange(0.0, 60.0, 0.1)])
        v = np.diff(places, axis=0) / 0.1
        assert np.linalg.norm(v, axis=1).max() < 0.8
        assert np.linalg.norm(np.diff(v, axis=0) / 0.1, axis=1).max() < 3.0
        assert np.ptp(places[:, :2], axis=0).max() > 1.0
        assert outside_scene(places[::5], pick.scene).min() > 0.1


def test_nobody_begins_in_touch_with_the_robot(silvermate):
    root = str(shared_data("house"))
    scene, start = house_pick(root, silvermate, 0).scene, np.zeros(silvermate.nv)
    for one in people(root, silvermate, scene, start, 3, seed=4):
        start[:2] = one.at(0.0).pose[:2, 3]  # a robot that stands on somebody's way
        found = people(root, silvermate, scene, start, 3, seed=4)
        assert min(np.hypot(*(other.at(0.0).pose[:2, 3] - start[:2])) for other in found) > 0.9


def test_a_drive_that_is_too_short_is_a_failure_with_its_kind():
    root, sensors = str(shared_data("house").parent), named_sensors("laser", "silvermate")
    figures = bench_reaches("silvermate", [0], root=root, walkers=1, sensors=sensors, seconds=1.0, processes=1)
    assert figures["reached"] == 0
    assert sum(figures["failures"].values()) == 1
    assert figures["contacts_seen"] == figures["contacts_unseen"] == 0
    assert (figures["sensors"], figures["walkers"]) == (["laser"], 1)


def test_a_start_from_which_there_is_nothing_to_pick_is_drawn_anew(silvermate, monkeypatch):
    root, tried = str(shared_data("house")), []

    def picked(root, robot, seed):
        tried.append(seed)
        if len(tried) == 1 or nothing:
            raise ScenarioError("nothing to pick")
        return house_pick(root, robot, seed)

    monkeypatch.setattr(reaches, "house_pick", picked)
    nothing = False
    assert reaches.reach(root, silvermate, 0)[0].on
    assert len(set(tried)) == len(tried) > 1
    nothing = True
    with pytest.raises(ScenarioError):
        reaches.reach(root, silvermate, 0)


def test_what_is_reached_for_can_be_driven_to(looking_tiago, monkeypatch):
    """One draw of this seed starts outside, in a corner of the house's box, with the can behind a wall."""
    drawn = []

    def picked(root, robot, seed):
        drawn.append(house_pick(root, robot, seed))
        return drawn[-1]

    monkeypatch.setattr(reaches, "house_pick", picked)
    pick, _ = reaches.reach(str(shared_data("house")), looking_tiago, 2724)
    outside = [one.start[0] < -3.0 and one.start[1] > 4.0 for one in (*drawn, pick)]
    assert any(outside)
    assert not outside[-1]


def test_walkers_are_for_reaches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = shared_data("house").parent
    with pytest.raises(SystemExit) as ended:
        run_cli(["house", "--root", str(root), "--walkers", "2", "--json", str(tmp_path / "f.json")])
    assert ended.value.code == 2
    assert "--reach" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
