"""The examples run as they are, one process each, and end as they should."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "scripts" / "examples"
SAID = {
    "01_ten_lines": "settled: certified",
    "02_obstacle_in_motion": "8.0 s: certified True",
    "03_certificate": "mm deep in ball",
    "04_drive": "reached after",
    "05_own_driver": "reached after",
    "06_mujoco_as_robot": "reached after",
    "07_own_urdf": "forklift: tilt, lift; certified True",
    "08_scene_files": "read again: table, leg, person",
    "09_other_sides": "near",
    "10_laser": "moves at",
    "11_task_in_layers": "done",
    "13_level_hand": "certified True",
    "14_arm_on_a_table": "base fixed: certified True",
    "15_page": "case-1.html",
    "16_executor_process": "reached: at rest at the goal",
    "17_pick_and_place": "set down: ",
    "19_others_path": "0 contacts at speed",
}
ELSEWHERE = {"18_ros_node"}  # it needs ROS: tests/ros2
NEEDS = {"06_mujoco_as_robot": "mujoco", "11_task_in_layers": "py_trees"}


def test_each_example_is_run() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == SAID.keys() | ELSEWHERE


@pytest.mark.parametrize("name", SAID)
def test_an_example_ends_well(name: str, tmp_path: Path) -> None:
    pytest.importorskip(NEEDS.get(name, "elastic_strips"))
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py"], capture_output=True, text=True, cwd=tmp_path, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert SAID[name] in done.stdout
    assert list(tmp_path.iterdir()) == []
