"""One meaning of clearance wherever people read it, and a picture that points at what is wrong."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import umsgpack

import elastic_strips as es
from elastic_strips.cli.run_command import _summary
from elastic_strips.planning import straight_line
from elastic_strips.sim.scenarios import get_scenario, result_document, run_scenario
from elastic_strips.strip import DeformStatus, strip_clearance
from elastic_strips.viewer.drawing import Drawing, Snapshot


def drawn(
    robot: es.RobotModel, scene: es.Scene, report: es.DeformReport, *, live: bool = False
) -> list[dict[str, Any]]:
    """The commands that a page of a report holds."""
    drawing = Drawing(title="t", ghosts=3)
    snapshot = Snapshot(robot, scene, report.strip.q, report, frame=True, live=live)
    return [umsgpack.unpackb(packed) for _, packed in drawing.draw(snapshot)]


def card(commands: list[dict[str, Any]]) -> dict[str, Any]:
    return next(c for c in commands if c["type"] == "hud")


@pytest.mark.parametrize(("case", "preset"), [("case-3", "paper"), ("case-7", "default")])
def test_page_command_report_and_document_agree(case, preset, capsys):
    """There, what the nodes alone say is another number."""
    result = run_scenario(get_scenario(case), preset=preset)
    clearance = strip_clearance(result.report.strip, result.scenario.scene)
    assert result.report.node_clearance >= clearance
    assert result.clearance == result.report.clearance == clearance
    assert result_document(result)["clearance_m"] == clearance
    _summary(result)
    told = re.search(r"clearance (\S+) m", capsys.readouterr().out)
    assert told is not None
    assert told[1] == f"{clearance:.3f}"
    rows = dict(card(drawn(result.robot, result.scenario.scene, result.report))["rows"])
    assert rows["clearance"] == f"{clearance:.3f} m"
    rows = dict(card(drawn(result.robot, result.scenario.scene, result.report, live=True))["rows"])
    assert "clearance" not in rows
    assert rows["clearance at the nodes"] == f"{result.report.node_clearance:.3f} m"


def pin(commands: list[dict[str, Any]]) -> np.ndarray | None:
    """Where (3,) the ball is that marks the place; None where there is none."""
    found = [c for c in commands if c["type"] == "instances" and c["path"] == "/trouble/spot"]
    if not found:
        return None
    data = found[-1]["matrices"]
    return np.frombuffer(data.data if hasattr(data, "data") else data, dtype=np.float32).reshape(-1, 16)[0, 12:15]


def test_a_broken_strip_shows_where_and_why(silvermate):
    wall = es.Box((0.2, 3.0, 1.4), at=(2.0, 0.0, 0.7), name="wall")
    scene = es.Scene([wall])
    rows = straight_line(silvermate, silvermate.home(0.0), silvermate.home(4.0), spacing=0.13)
    report = es.Deformer(silvermate).settle(es.Strip.from_coordinates(silvermate, rows), scene, max_ticks=3)
    assert report.status is DeformStatus.BROKEN
    commands = drawn(silvermate, scene, report)
    assert card(commands)["note"] == report.reason
    assert "wall" in report.reason
    at = pin(commands)
    assert at is not None
    j = report.certificate.broken.segment
    assert np.linalg.norm(at[:2] - report.strip.coordinates[j, :2]) < 1.0  # within the robot's reach of that node
    assert abs(at[0] - 2.0) < 1.0


def test_a_blocked_strip_shows_the_gap_and_why():
    result = run_scenario(get_scenario("case-3"), preset="paper")
    report = result.report
    assert report.status is DeformStatus.BLOCKED
    commands = drawn(result.robot, result.scenario.scene, report)
    assert card(commands)["note"] == report.reason
    assert any(name == "where the strip is blocked" for name, _ in card(commands)["legend"])
    at = pin(commands)
    assert at is not None
    middle = np.mean([o.pose[:2, 3] for o in result.scenario.scene], axis=0)
    assert np.linalg.norm(at[:2] - middle) < 1.0  # between the two obstacles


def test_a_sound_strip_has_no_pin(silvermate):
    report = es.Deformer(silvermate).settle(es.Strip(silvermate, [silvermate.home(), silvermate.home(0.3)]), es.Scene())
    commands = drawn(silvermate, es.Scene(), report)
    assert pin(commands) is None
    assert "note" not in card(commands)
