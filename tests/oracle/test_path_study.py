"""A short study of certified paths; the long one is a command (see ``path_study.py``)."""

from __future__ import annotations

import numpy as np
import path_study
import pytest
import way_study
from path_study import KINDS, Findings, Study
from way_study import WAYS, WORLDS

from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Scene


@pytest.fixture
def study() -> tuple[Study, Scene, np.ndarray]:
    robot = load_robot("panda")
    scene = Scene([Box((0.6, 0.03, 0.5), at=(0.5, 0.0, 0.35), name="wall")])
    ends = robot.space.to_coordinates(np.array([robot.home(panda_joint1=-0.8), robot.home(panda_joint1=0.8)]))
    return Study(robot, Findings()), scene, ends


def test_what_touches_is_found_and_what_is_clear_is_certified(study):
    one, scene, ends = study
    one.scene("wall", scene, ends, np.random.default_rng(4))
    found = one.findings
    assert found.wrong == []
    assert {kind for kind, _, _ in found.counts} == set(KINDS)
    assert found.total("touching") > 0
    assert found.total("clear") > 0
    assert found.false_alarms <= 0.1
    assert found.walks.longest_step <= 1e-3
    assert f"| all | all | {found.total('paths')} |" in found.table()


def test_the_study_sees_what_a_blind_certificate_overlooks(study, monkeypatch):
    one, scene, ends = study
    certify = path_study.certify
    monkeypatch.setattr(path_study, "certify", lambda robot, _, q, **given: certify(robot, Scene([]), q, **given))
    one.findings = Findings()
    one.checker.take(scene, 2e-5, 2e-5, free=5e-3)
    one.judge("through the wall", "any line", 0.05, scene, ends)
    assert one.findings.total("missed") == len(one.findings.wrong) == 1


def test_ways_and_worlds_are_followed():
    found = path_study.ways(9, 4)
    assert found.wrong == []
    assert {kind for kind, _, _ in found.counts} == {*WAYS, *WORLDS}
    for what in ("clear", "certified", "unknown", "no way said", "proofs"):
        assert found.total(what) > 0, what
    assert found.total("certified", "half turn") == 0


def test_the_study_sees_what_a_certificate_blind_to_time_overlooks(monkeypatch):
    """One that takes the obstacles as they are at first, and where they are seen."""
    certify = way_study.certify

    def overlooking(robot, world, path, *, times=None, **given):
        there = [o.observed(o.pose, None) for o in world.scene if world.exists(o.name, 0.0)]
        return certify(robot, Scene(there), path, **given)

    monkeypatch.setattr(way_study, "certify", overlooking)
    assert path_study.ways(15, 2, kinds=WORLDS).total("missed") > 0
