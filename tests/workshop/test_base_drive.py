"""Base methods in scenarios: driven by their names, evaluated as the strip is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cases import refused

from elastic_strips.errors import ParameterError
from elastic_strips.io import PoseSpec
from elastic_strips.scene import Box, Obstacle, Scene
from elastic_strips.sim import Simulation
from elastic_strips.sim.scenarios import drive_document
from elastic_strips.sim.scenarios.drive import conclude
from elastic_strips.sim.scenarios.scenario import Scenario
from elastic_strips.sim.sensors import SensorConfig
from workshop.baselines import BaseController, drive_by, make_base_simulation
from workshop.cli.group import run_cli

LASER = SensorConfig().only("laser")
PILLAR = Box((0.4, 0.4, 1.5), at=(1.5, 0.3, 0.75), name="pillar")
SHORT = """robot: silvermate
start: {}
goal: {x: 2}
scene:
  obstacles:
    - {shape: box, name: post, size: [0.2, 0.2, 1], at: [1.2, 1.0, 0.5]}
"""


def scenario(*obstacles: Obstacle) -> Scenario:
    return Scenario(
        name="short", summary="", scene=Scene(obstacles), start=PoseSpec(0.0, 0.0, 0.0), goal=PoseSpec(3.0, 0.0, 0.0)
    )


def test_what_was_seen_is_no_excuse(silvermate):
    """A method that runs into what its laser shows: the contact is one with something seen."""

    class Blind(BaseController):
        def _steer(self, t):
            super()._steer(t)
            self.command = type(self.command)(0.4, 0.0, "moving")

    problem = scenario(Box((0.4, 2.0, 1.5), at=(1.5, 0.0, 0.75), name="wall"))
    made = make_base_simulation(problem, "vfh", robot=silvermate, sensors=LASER)
    blind = Blind(silvermate, *problem.ends(silvermate), "vfh")
    driven = Simulation(blind, made.world, made.plant, made.perception, metadata={"method": "vfh"})
    outcome = conclude(problem, driven, driven.run(time_limit=20.0))
    assert [contact.obstacle for contact in outcome.evaluation.collisions] == ["wall"]
    assert outcome.unseen == ()
    assert outcome.seen_collisions == 1


def test_base_methods_are_driven_by_name(silvermate):
    outcome = drive_by(scenario(PILLAR), "vfh", robot=silvermate, time_limit=30.0)
    assert outcome.reached, outcome.result.reason
    assert (outcome.method, outcome.sensors) == ("vfh", ("laser", "sonar", "infrared"))
    assert outcome.separation is None
    document = drive_document(outcome)
    assert document["method"] == "vfh"
    assert document["protective_separation_m"] is None
    assert np.hypot(*(outcome.result.record.control.coordinates[-1, :2] - (3.0, 0.0))) < 0.15


def test_wrong_names_are_refused(silvermate):
    with refused(ParameterError, "'strip'"):
        drive_by(scenario(), "strop", robot=silvermate)
    with refused(ParameterError, "steam"):
        make_base_simulation(scenario(), "vfh", robot=silvermate, plant="steam")


def test_the_command_drives_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "short.yaml").write_text(SHORT)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        run_cli(["base", "short.yaml", "--method", "vfh", "--json", "d.json", "--record", "r.npz"])
    assert ended.value.code == 0
    found = json.loads((tmp_path / "d.json").read_text())
    assert (found["method"], found["reached"], found["max_constraint_error_rad"]) == ("vfh", True, None)
    assert (tmp_path / "r.npz").exists()
