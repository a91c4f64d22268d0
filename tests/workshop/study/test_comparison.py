"""The comparison: rows come from the runs, in the order that was asked for; what is no case or method is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import refused

from elastic_strips import RobotModel
from elastic_strips.errors import ParameterError, ScenarioError
from elastic_strips.sim import SensorPerception
from elastic_strips.sim.scenarios import drive, get_scenario
from elastic_strips.sim.sensors import SensorConfig
from workshop.baselines import drive_by
from workshop.study import METHODS, TrialResult, compare
from workshop.study.comparison import Trial, _turns, attempt

POLE = "{shape: cylinder, name: pole, radius: 0.2, length: 1, at: [%s, 0.5]}"


def _case(folder: Path, at: str) -> str:
    """A way of 1.2 m with one cylinder."""
    path = folder / "short.yaml"
    path.write_text(f"robot: silvermate\nstart: {{}}\ngoal: {{x: 1.2}}\nscene:\n  obstacles:\n    - {POLE % at}\n")
    return str(path)


@pytest.fixture(scope="module")
def beside(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The cylinder stands 1.2 m beside the way."""
    return _case(tmp_path_factory.mktemp("beside"), "0.6, 1.2")


def test_a_row_is_what_the_run_gave(beside: str, silvermate: RobotModel) -> None:
    """Way, time, turning and end of a run of one's own with the same seed; clearance by hand."""
    row = attempt(Trial(beside, "apf", seed=3))
    outcome = drive_by(
        get_scenario(beside, seed=3), "apf", robot=silvermate, sensors=SensorConfig(), seed=3, time_limit=90.0
    )
    result = outcome.result
    rows = result.record.control
    assert (row.case, row.method, row.seed) == (beside, "apf", 3)
    assert row.reached
    assert row.contacts == ()
    assert row.reason == result.reason
    assert row.path == pytest.approx(np.hypot(*np.diff(rows.coordinates[:, :2], axis=0).T).sum(), rel=0.02)
    assert row.time == pytest.approx(rows.time[-1], abs=0.1)
    assert row.turning == pytest.approx(np.abs(np.diff(np.unwrap(rows.coordinates[:, 2]))).sum())
    middle = np.hypot(rows.coordinates[:, 0] - 0.6, rows.coordinates[:, 1] - 1.2).min() - 0.2
    assert middle - 0.5 < row.clearance < middle - 0.2
    assert attempt(Trial(beside, "apf", seed=4)).path != row.path


def test_the_strip_is_tried_with_and_without_sensors(beside: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sensors for one of the two alone; cases and methods in order, one note each."""
    notes, sensed = list[str](), list[str]()

    class Counted(SensorPerception):
        def __init__(self, *given: Any, **options: Any) -> None:
            sensed.append(f"after {len(notes)}")
            super().__init__(*given, **options)

    monkeypatch.setattr(drive, "SensorPerception", Counted)
    rows = compare([beside], ["strip", "strip-sensed"], seeds=[1], processes=1, step=notes.append)
    assert [row.method for row in rows] == ["strip", "strip-sensed"]
    assert all(row.reached and row.path > 1.0 and row.seed == 1 for row in rows)
    assert sensed == ["after 1"]
    assert notes == [f"{beside}, strip", f"{beside}, strip-sensed"]


def test_a_start_in_collision_is_a_row_that_says_so(tmp_path: Path) -> None:
    """The strip refuses it, and there is no clearance to tell; the potential field has touched at once."""
    case = _case(tmp_path, "0, 0")
    refused, touched = attempt(Trial(case, "strip")), attempt(Trial(case, "apf"))
    assert "start" in refused.reason
    assert math.isnan(refused.clearance)
    assert touched.contacts == ("pole",)
    assert touched.clearance < 0.0
    for row in (refused, touched):
        assert not row.reached
        assert row.path == row.time == 0.0


def test_a_limit_of_time_ends_a_trial(beside: str) -> None:
    """Half a second is not enough."""
    row: TrialResult = attempt(Trial(beside, "apf", time_limit=0.5))
    assert not row.reached
    assert "time limit of 0.5 s" in row.reason


def test_wrong_input_is_refused() -> None:
    """Before anything is driven."""
    with refused(ParameterError, "'apv'", "'apf'"):
        attempt(Trial("case-1", "apv"))
    with refused(ParameterError, "'rrt'"):
        compare(["case-1"], ["apf", "rrt"], processes=1)
    with refused(ScenarioError, "'case-8'"):
        compare(["case-8"], METHODS, processes=1)


def test_turning_and_roughness_of_known_yaws() -> None:
    """Even turning is not rough, across ±π too; a sine's are known."""
    time = np.arange(0.0, 20.0, 0.01)
    turning, roughness = _turns(time, (0.5 * time + np.pi) % (2.0 * np.pi) - np.pi)
    assert turning == pytest.approx(0.5 * time[-1])
    assert roughness == pytest.approx(0.0, abs=1e-9)
    turning, roughness = _turns(time, 0.3 * np.sin(0.5 * np.pi * time))
    assert turning == pytest.approx(4 * 0.3 * 5, rel=0.01)
    assert roughness == pytest.approx(0.3 * (0.5 * np.pi) ** 2 / np.sqrt(2.0), rel=0.02)
    assert _turns(np.array([0.0, 0.1]), np.zeros(2)) == (0.0, 0.0)
