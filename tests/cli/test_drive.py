"""``elastic-strips drive``: what it writes, how it ends, and what it says when something is wrong."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from cases import each
from command_line import CALL, interrupted

from elastic_strips.cli import main
from elastic_strips.cli.drive_command import laser_note, said_of_stops
from elastic_strips.control.process.log_stream import read_log
from elastic_strips.perception import LaserScan, SceneEstimator

SHORT = """\
name: short
robot: bridge-arm
scene:
  obstacles:
    - {shape: box, size: [0.3, 0.3, 1.0], at: [1.2, 0.6, 0.5], name: crate}
    - shape: cylinder
      radius: 0.2
      length: 1.6
      at: [1.5, -3.0, 0.8]
      name: walker
      motion: {twist: {linear: [0, 0.6, 0]}}
start: {x: 0.0, y: 0.0, yaw: 0.0}
goal: {x: 2.5, y: 0.0, yaw: 0.0}
"""


@pytest.fixture
def short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "short.yaml"
    file.write_text(SHORT)
    return file


def end_of(*arguments: str) -> int:
    """Exit code of the command, called in this process."""
    try:
        main(list(arguments))
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_drives_and_writes_everything(short: Path, tmp_path: Path) -> None:
    drive = [*CALL, "drive", str(short), "--json", "d.json", "--record", "d.npz", "--html", "d.html"]
    ended = subprocess.run(drive, capture_output=True, text=True, cwd=tmp_path, env=os.environ, timeout=120)
    assert ended.returncode == 0, ended.stderr
    assert "short · bridge-arm · kinematic plant: reached" in ended.stdout
    result = json.loads((tmp_path / "d.json").read_text())
    assert result["format"] == "elastic-strips-drive"
    assert result["reached"] is True
    assert result["collisions"] == 0
    assert set(result["tick_ms"]) == {"p50", "p95", "p99"}
    assert max(result["limit_excess"].values()) < 1e-3
    assert result["max_lateral_slip"] < 1e-5
    assert result["max_tracking_error_m"] < 0.025
    with np.load(tmp_path / "d.npz") as record:
        assert len(record["control_time"]) == pytest.approx(100 * result["time_s"], abs=3)
    assert (tmp_path / "d.html").stat().st_size > 100_000
    assert end_of("view", "d.npz", "--html", "again.html") == 0
    assert (tmp_path / "again.html").stat().st_size == pytest.approx((tmp_path / "d.html").stat().st_size, rel=0.01)


def test_a_fault_is_named(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert end_of("drive", str(short), "--fault", "scene_frozen@1:1", "--json", "d.json") == 0
    events = json.loads((tmp_path / "d.json").read_text())["events"]
    named = [e["reason"] for e in events if e["kind"] == "fault" and "stale scene" in e["reason"]]
    assert named
    assert named[0] in capsys.readouterr().out


def test_a_reason_that_names_what_a_laser_has_met_says_how_high_that_is_taken_to_be() -> None:
    estimator = SceneEstimator()
    angles = np.linspace(-3.0, 3.0, 50)
    estimator.update(LaserScan("laser", 0.0, np.eye(4), angles, np.full(50, 2.0), 0.05, 10.0), (0.0, 0.0, 0.0))
    names = estimator.scene().names
    assert len({name.count("-") for name in names}) > 1, "on both sides of the origin"
    for name in names:
        assert laser_note(f"all 234 configurations that were found would touch something: fore and {name}")
    assert not laser_note("all 234 configurations that were found would touch something: fore and mapboard-3")


def test_by_sensors(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = SHORT.replace("bridge-arm", "silvermate")  # its laser is on board, and does not see behind it
    own = own.replace("at: [1.5, -3.0, 0.8]", "at: [1.5, -7.0, 0.8]")
    short.write_text(own)
    assert end_of("drive", str(short), "--sensors", "laser", "--json", "d.json") == 0
    assert "driven by laser" in capsys.readouterr().out
    assert json.loads((tmp_path / "d.json").read_text())["sensors"] == ["laser"]
    assert json.loads((tmp_path / "d.json").read_text())["method"] == "strip"


def test_a_level_hand(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short.write_text(SHORT.replace("bridge-arm", "silvermate"))
    assert end_of("drive", str(short), "--level", "hand_frame", "--json", "d.json") == 0
    assert "°" in capsys.readouterr().out
    assert json.loads((tmp_path / "d.json").read_text())["max_constraint_error_rad"] < 0.1


def test_time_runs_out(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert end_of("drive", str(short), "--time-limit", "1.0") == 3
    assert "not reached: stopped, the time limit" in capsys.readouterr().out


@each(
    "arguments, message",
    [
        (["drive", "case-77"], "case-7"),
        (["drive", "case-1", "--fault", "scene_frozn@1"], "did you mean 'scene_frozen'"),
        (["drive", "case-1", "--record", "run.txt"], ".npz"),
        (["drive", "case-1", "--json", "no/such/folder/d.json"], "no/such/folder"),
        (["drive", "case-1", "--plant", "steam"], "steam"),
        (["drive", "case-1", "--time-limit", "nan"], "nan"),
        (["drive", "run.npz"], "run.npz"),
        (["drive", "case-1", "--sensors", "lasar"], "did you mean 'laser'"),
        (["drive", "case-1", "--sensors", "none.yaml"], "none.yaml"),
        (["drive", "case-1", "--level", "hand_fram"], "did you mean 'hand_frame'"),
        (["drive", "case-1", "--compute", "fast"], "'free', 'work', or a finite factor"),
        (["drive", "case-1", "--log", "l.jsonl"], "--realtime"),
        (["drive", "case-1", "--realtime", "--compute", "2"], "--compute"),
        (["drive", "case-1", "--realtime", "--log", "no/such/folder/l.jsonl"], "no/such/folder"),
    ],
)
def test_wrong_input_is_one_message(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_drive_in_the_browser_goes_on_with_its_replay_until_ctrl_c(tmp_path: Path) -> None:
    file = tmp_path / "d.json"

    def replays() -> bool:
        return file.exists() and time.time() > file.stat().st_mtime + 1.0

    drive = ["drive", "case-1", "--view", "--no-browser", "--time-limit", "1", "--json", "d.json"]
    ended = interrupted(drive, tmp_path, until=replays)
    assert ended.returncode == 3, ended
    assert "replay" in ended.stdout
    assert "Traceback" not in ended.stderr


def test_ctrl_c_stops_the_robot_and_writes_the_record(tmp_path: Path) -> None:
    log = tmp_path / "l.jsonl"

    def moves() -> bool:
        rows = read_log(log) if log.exists() else []
        return any(max(np.abs(row["drive"])) > 0.2 for row in rows if "drive" in row)

    drive = ["drive", "case-1", "--realtime", "--record", "d.npz", "--json", "d.json", "--log", "l.jsonl"]
    ended = interrupted(drive, tmp_path, until=moves)
    assert ended.returncode == 130, ended
    assert "Traceback" not in ended.stderr
    assert "stopping the robot" in ended.stderr
    assert "not reached: stopped, interrupted" in ended.stdout
    with np.load(tmp_path / "d.npz") as record:
        assert np.abs(record["control_v"][-1]).max() < 0.01
        assert np.abs(record["control_v"]).max() > 0.1
    assert json.loads((tmp_path / "d.json").read_text())["reached"] is False


CART = """<robot name="cart">
  <link name="base"><collision><geometry><box size="0.5 0.4 0.2"/></geometry></collision></link>
  <link name="left"><collision><geometry><cylinder radius="0.1" length="0.04"/></geometry></collision></link>
  <link name="right"><collision><geometry><cylinder radius="0.1" length="0.04"/></geometry></collision></link>
  <link name="turret"><collision><geometry><box size="0.2 0.1 0.1"/></geometry></collision></link>
  <joint name="wheel_left_joint" type="continuous"><parent link="base"/><child link="left"/>
    <origin xyz="0 0.25 0" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="wheel_right_joint" type="continuous"><parent link="base"/><child link="right"/>
    <origin xyz="0 -0.25 0" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="turret_joint" type="continuous"><parent link="base"/><child link="turret"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/></joint>
</robot>"""
"""A URDF as many are: its continuous joints have no limits."""


def test_speeds_that_a_urdf_does_not_state_are_given(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without them it says what the URDF lacks, and which options give them."""
    (tmp_path / "cart.urdf").write_text(CART)
    drive = ("drive", str(short), "--robot", "cart.urdf")
    assert end_of(*drive) == 2
    said = capsys.readouterr().err
    assert '<limit effort="…" velocity="…"/>' in said
    assert "--joint-speed turret_joint=… --wheel-speed …" in said
    given = ("--joint-speed", "turret_joint=1.5", "--wheel-speed", "0.6")
    assert end_of(*drive, *given, "--json", "d.json") == 0
    assert max(json.loads((tmp_path / "d.json").read_text())["limit_excess"].values()) < 1e-3
    assert "reached" in capsys.readouterr().out
    assert end_of("run", str(short), "--robot", "cart.urdf", "--trajectory", "t.csv") == 2
    assert end_of("run", str(short), "--robot", "cart.urdf", "--trajectory", "t.csv", *given) == 0


@pytest.mark.parametrize(
    "arguments, match",
    [
        (("--joint-speed", "turret_joint"), "NAME=VALUE"),
        (("--joint-speed", "turret_joint=0"), "range"),
        (("--joint-speed", "turret_joint=nan"), "NaN|nan|range"),
        (("--joint-speed", "turrt_joint=1"), "did you mean 'turret_joint'"),
        (("--base", "omni", "--wheel-speed", "1"), "--base-speed"),
        (("--base-speed", "1,1,1"), "--wheel-speed"),
        (("--base", "omni", "--base-speed", "1,1"), "X,Y,YAW"),
        (("--base", "omni", "--base-speed", "1,1,-1"), "range"),
        (("--joint-speed", "turret_joint=1", "--wheel-speed", "-1"), "range"),
    ],
)
def test_wrong_speeds_are_refused(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], match: str
) -> None:
    (tmp_path / "cart.urdf").write_text(CART)
    assert end_of("drive", str(short), "--robot", "cart.urdf", *arguments) == 2
    assert re.search(match, capsys.readouterr().err)


def test_limits_of_a_run_are_those_of_its_trajectory(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert end_of("run", str(short), "--joint-speed", "arm_1=1") == 2
    assert "--trajectory" in capsys.readouterr().err


def test_the_reasons_of_stops_are_said_however_often_others_came_before() -> None:
    stops = [(0.1 * k, f"{k} mm off its reference") for k in range(7)]
    stops += [(1.0 + k, "no way to the goal") for k in range(3)]
    said = said_of_stops(stops)
    assert len(said) == 2
    assert "no way to the goal" in said[1]
    assert "6 times" in said[0]
    many = said_of_stops([(float(k), "abcdefgh"[k]) for k in range(8)])
    assert len(many) == 6
    assert "3" in many[-1]
    assert said_of_stops([]) == []
