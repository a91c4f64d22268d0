"""``elastic-strips calibrate``: what a record and a log show, what is to be set, and what is no record."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import moving_world, straight_run

from elastic_strips.cli import main
from elastic_strips.io import read_record, write_record
from elastic_strips.robot import RobotModel


def call(*arguments: object) -> int:
    """Exit code of a command line in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture
def file(silvermate: RobotModel, tmp_path: Path) -> Path:
    return write_record(straight_run(silvermate, moving_world(), length=1.0), tmp_path / "run.npz")


def test_a_record_is_measured(file, tmp_path, capsys):
    out = tmp_path / "found.json"
    assert call("calibrate", file, "--json", out) in (0, 3)
    said = capsys.readouterr().out
    assert "off the reference" in said
    found = json.loads(out.read_text())
    assert found["robot"] == "silvermate"
    assert found["truth"]
    assert {one["what"] for one in found["findings"]} >= {"off the reference, largest", "lag of the drive"}
    assert found["exceeded"] == sum(one["exceeds"] for one in found["findings"])


def test_what_is_worse_than_assumed_says_what_to_set(silvermate, file, tmp_path, capsys):
    """A log of a robot that is 5 cm beside its reference."""
    rows, control = [], read_record(file).control
    for k, t in enumerate(control.time.tolist()):
        beside = control.coordinates[k].copy()
        beside[1] += 0.05
        rows.append(
            {
                "t": t, "reference": control.coordinates[k].tolist(), "estimate": beside.tolist(), "stop": False,
                "drive": np.zeros(2).tolist(), "joints": np.zeros(silvermate.nv - 3).tolist(),
            }
        )  # fmt: skip
    log = tmp_path / "drive.jsonl"
    log.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert call("calibrate", log, "--robot", "silvermate") == 3
    said = capsys.readouterr().out
    assert "DriveParams.tracking_error" in said
    assert "by the estimate alone" in said
    assert call("calibrate", log, "--robot", "silvermate", "--tracking-error", "0.2") == 0


def test_what_is_no_record_is_refused(file, tmp_path, capsys):
    log = tmp_path / "drive.jsonl"
    log.write_text('{"t": 0.0}\n')
    assert call("calibrate", log) == 2  # of which robot?
    assert call("calibrate", log, "--robot", "silvermate") == 2
    assert call("calibrate", file, "--base", "omni") == 2
    assert call("calibrate", file, "--robot", "tiago") == 2
    assert call("calibrate", tmp_path / "none.npz") == 2
    assert "Traceback" not in capsys.readouterr().err
