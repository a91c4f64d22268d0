"""What a value says of itself: one short line, and a table for notebooks in which names are only text."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import elastic_strips as es
from elastic_strips.sim.scenarios import drive_scenario, get_scenario, run_scenario
from elastic_strips.trajectory import MotionLimits

LONGEST = 300
EVIL = "<script>alert(1)</script>&\"'"


@pytest.fixture(scope="module")
def values(silvermate) -> dict[str, Any]:
    """Everything that a session has in its hands: after planning, settling, running, driving."""
    scene = es.Scene(
        [es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7), name=EVIL), *(es.Sphere(0.1, at=(9, k, 9)) for k in range(40))]
    )
    plan = es.plan_report(silvermate, scene, silvermate.home(x=-1.0), silvermate.home(x=4.0))
    deformer = es.Deformer(silvermate)
    settled = deformer.settle(plan.strip, scene, detail=True)
    blocked = deformer.settle(es.Strip(silvermate, [silvermate.home(-1.0), silvermate.home(4.0)]), scene, max_ticks=2)
    drive = drive_scenario(get_scenario("case-1"), time_limit=0.3)
    hull = es.scene.ConvexHull(np.random.default_rng(0).normal(size=(400, 3)), name="x" * 200)
    return {
        "robot": silvermate, "space": silvermate.space, "tree": silvermate.tree, "scene": scene, "strip": plan.strip,
        "plan": plan, "settled": settled, "broken": blocked, "certificate": settled.certificate,
        "forces": settled.forces, "hulls": settled.hulls, "world": es.World(scene), "hull": hull,
        "alternatives": es.plan_report(silvermate, scene, silvermate.home(x=-1.0), silvermate.home(x=4.0), count=2),
        "scenario": drive.scenario, "run": run_scenario(get_scenario("case-1")), "drive": drive,
        "result": drive.result, "record": drive.result.record, "rows": drive.result.record.control,
        "verdict": drive.evaluation, "limits": MotionLimits.for_robot(silvermate),
        "named": replace(silvermate, name=EVIL),
        "track": es.scene.Keyframes(np.arange(500.0), np.zeros((500, 3))),
    }  # fmt: skip


def test_a_value_is_one_short_line(values):
    for what, value in values.items():
        text = repr(value)
        assert len(text) <= LONGEST, what
        assert "\n" not in text, what
        assert text.startswith(type(value).__name__), what


def test_a_table_is_sound_and_names_are_only_text(values):
    tables = {what: value._repr_html_() for what, value in values.items() if hasattr(value, "_repr_html_")}
    assert {"robot", "scene", "strip", "plan", "settled", "run", "drive", "record", "alternatives"} <= set(tables)
    for what, text in tables.items():
        root = ElementTree.fromstring(text)
        assert root.tag == "table", what
        assert {e.tag for e in root.iter()} <= {"table", "caption", "b", "tbody", "tr", "th", "td"}, what
        assert len(text) < 10_000, what
    assert EVIL in "".join(ElementTree.fromstring(tables["scene"]).itertext())
    assert EVIL in "".join(ElementTree.fromstring(tables["named"]).itertext())


def test_a_report_says_what_it_came_to(values):
    text = repr(values["broken"])
    assert values["broken"].status.value in text
    table = "".join(ElementTree.fromstring(values["settled"]._repr_html_()).itertext())
    assert f"{values['settled'].clearance:.3f} m" in table
