"""Results of the command line hold before a checker that shares no code with the library; and the checker can fail."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import result_check
from cases import each

from elastic_strips.cli import main

Document = dict[str, Any]
Run = Callable[..., Document]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs the command once for each set of arguments; gives a copy of the result."""
    folder = tmp_path_factory.mktemp("results")
    done: dict[tuple[str, ...], Document] = {}

    def result(*arguments: str) -> Document:
        if arguments not in done:
            path = folder / f"{len(done)}.json"
            with pytest.raises(SystemExit):
                main(["run", *arguments, "--json", str(path)])
            done[arguments] = json.loads(path.read_text(encoding="utf-8"))
        return copy.deepcopy(done[arguments])

    return result


def _silvermate_q(document: Document, x: float, y: float, yaw: float) -> np.ndarray:
    """The home posture of silvermate.srdf at a pose of the base."""
    state = ET.parse(Path(document["urdf"]).with_suffix(".srdf")).find("group_state[@name='home']")
    assert state is not None
    home = {joint.get("name"): float(joint.get("value", "nan")) for joint in state.iter("joint")}
    return np.array([x, y, np.cos(yaw), np.sin(yaw), *(home[name] for name in document["strip"]["joint_names"])])


def _assert_holds(
    document: Document, start: np.ndarray | None = None, goal: np.ndarray | None = None
) -> result_check.Check:
    found = result_check.check(document, start=start, goal=goal)
    assert found.faults == []
    assert found.samples > 1000
    return found


@each("name", ["case-3", "case-5", "case-7"])
def test_the_cases_hold(run: Run, name: str) -> None:
    """Certified, free, drivable, from (−3, −3, 30°) to (6, 6, 45°)."""
    document = run(name)
    found = _assert_holds(
        document, _silvermate_q(document, -3, -3, np.pi / 6), _silvermate_q(document, 6, 6, np.pi / 4)
    )
    assert document["certified"]
    assert found.slip <= result_check.SLIP
    assert found.self_clearance > 0.0


@pytest.mark.parametrize("name, certified", [("case-2", True), ("case-3", False)])
def test_the_papers_preset_holds(run: Run, name: str, certified: bool) -> None:
    """What the paper's equations make is as free as it says, the blocked strip of case 3, too."""
    document = run(name, "--preset", "paper")
    found = _assert_holds(
        document, _silvermate_q(document, -3, -3, np.pi / 6), _silvermate_q(document, 6, 6, np.pi / 4)
    )
    assert document["certified"] is certified
    assert found.clearance > 0.0


@pytest.mark.parametrize("seed", range(2))
def test_the_corridors_hold(run: Run, seed: int) -> None:
    """Certified between 32 obstacles of all shapes, from (0, 0, 0) to (8, 0, 0)."""
    document = run("corridor", "--seed", str(seed))
    assert document["certified"]
    assert len(document["obstacles"]) == 32
    _assert_holds(document, _silvermate_q(document, 0, 0, 0), _silvermate_q(document, 8, 0, 0))


def test_a_corridor_of_tiago_holds(run: Run) -> None:
    """A robot of meshes: its hulls keep the clearance."""
    document = run("corridor", "--robot", "tiago")
    assert document["certified"]
    assert document["locked"]
    assert _assert_holds(document).meshes


def test_a_fixed_base_holds(run: Run, gantry_urdf: Path, tmp_path: Path) -> None:
    """A robot that does not drive, with prismatic, revolute and continuous joints."""
    path = tmp_path / "reach.yaml"
    path.write_text(
        f"robot: {gantry_urdf}\nbase: fixed\nstart: {{joints: {{spin: -1.2, bend: 0.3, nod: 0.3}}}}\n"
        "goal: {joints: {spin: 1.2, bend: 0.3, slide: 0.2, nod: 0.3}}\n"
        "scene: {obstacles: [{shape: sphere, radius: 0.05, at: [2, 0, 1]}]}\n"
    )
    document = run(str(path))
    assert document["base"] == "fixed"
    assert document["certified"], document["reason"]
    found = result_check.check(document)
    assert found.faults == []
    assert found.samples > 100


def _tampered(run: Run, change: Callable[[Document], object], name: str = "case-7") -> list[str]:
    document = run(name)
    change(document)
    return result_check.check(document).faults


def _shift(document: Document, node: int, column: int, by: float) -> None:
    document["strip"]["q"][node][column] += by


def _onto_the_way(document: Document) -> None:
    x, y = document["strip"]["q"][50][:2]
    document["obstacles"][0]["pose"][:2] = [x, y]


def _between_two_nodes(document: Document) -> None:
    """A post as thin as a finger where the arm passes between two nodes."""
    a, b = (np.array(document["strip"]["q"][k][:2]) for k in (50, 51))
    at = 0.5 * (a + b)
    document["obstacles"].append(
        {"name": "post", "shape": "cylinder", "size": [0.001, 2.0], "pose": [*at, 1, 0, 0, 0, 1]}
    )


def _arm_in_the_body(document: Document) -> None:
    for row in document["strip"]["q"][1:-1]:
        row[5:9] = [-0.2, -1.69, 2.12, -2.41]


_TAMPERED: dict[str, tuple[Callable[[Document], object], str]] = {
    "obstacle on the way": (_onto_the_way, "certified for"),
    "post between two nodes": (_between_two_nodes, "certified for"),
    "node pushed sideways": (lambda d: _shift(d, 40, 1, 0.01), "slips"),
    "joint out of limits": (lambda d: _shift(d, 40, 7, 5.0), "limits"),
    "heading not normalised": (lambda d: _shift(d, 40, 2, 0.1), "unit length"),
    "node that is NaN": (lambda d: _shift(d, 40, 5, float("nan")), "not finite"),
    "node removed": (lambda d: d["strip"]["q"].pop(40), "nodes"),
    "segment removed": (lambda d: d["segments"].pop(), "segments"),
    "segment refused": (lambda d: d["segments"].__setitem__(3, False), "not all of its segments"),
    "blocked": (lambda d: d.update(status="blocked"), "status is blocked"),
    "longer": (lambda d: d.update(length_m=d["length_m"] + 1e-3), "length"),
    "clearance overstated": (lambda d: d.update(clearance_m=d["clearance_m"] + 5e-3), "clearance"),
    "clearance understated": (lambda d: d.update(clearance_m=d["clearance_m"] - 5e-3), "clearance"),
    "clearance left out": (lambda d: d.update(clearance_m=None), "no clearance is stated"),
    "slip understated": (lambda d: d.update(max_lateral_slip_m=1e-3), "slip"),
    "joints renamed": (lambda d: d["strip"]["joint_names"].reverse(), "joints"),
    "arm in the body": (_arm_in_the_body, "touches itself"),
}


@each("name", _TAMPERED)
def test_the_checker_finds_what_was_tampered_with(run: Run, name: str) -> None:
    """Each false statement is a fault, named."""
    change, fault = _TAMPERED[name]
    faults = _tampered(run, change)
    assert any(fault in found for found in faults), faults


def test_the_checker_looks_between_the_nodes(run: Run) -> None:
    """Two free nodes on both sides of the obstacles of case 5, and nothing between: the sweep finds the collision."""
    document = run("case-5")
    row = document["strip"]["q"][0]
    document["strip"]["q"] = [[*end, np.cos(np.pi / 4), np.sin(np.pi / 4), *row[4:]] for end in ((-3, -3), (6, 6))]
    document |= {"nodes": 2, "segments": [True], "length_m": 9 * np.sqrt(2), "max_lateral_slip_m": 0.0}
    found = result_check.check(document)
    assert found.clearance < 0.0
    assert any("certified for" in fault for fault in found.faults)


def test_the_checker_compares_start_and_goal(run: Run) -> None:
    """A strip to somewhere else is a fault."""
    document = run("case-1")
    faults = result_check.check(document, goal=_silvermate_q(document, 6, 6, np.pi / 3)).faults
    assert any("misses the goal" in fault for fault in faults)


def test_the_checker_is_a_script_without_the_library(run: Run, tmp_path: Path) -> None:
    """Exit code 0 for what holds and 1 for what does not, in a process where the library cannot be imported."""
    document = run("case-1")
    script = Path(result_check.__file__)
    (tmp_path / "elastic_strips.py").write_text("raise ImportError('the checker must not import this')")
    for change, code in ((0.0, 0), (0.01, 1)):
        path = tmp_path / "r.json"
        path.write_text(json.dumps(document | {"clearance_m": document["clearance_m"] + change}))
        call = [sys.executable, str(script), str(path), "--step", "0.02"]
        ended = subprocess.run(
            call, capture_output=True, text=True, timeout=240, check=False, env={"PYTHONPATH": str(tmp_path)}
        )
        assert ended.returncode == code, ended
        assert ("FAULT clearance" in ended.stdout) == bool(code)
