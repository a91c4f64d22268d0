"""Base and joints one after the other: into a shelf that nobody reaches into while driving; certified and clear."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import link_distances, self_distances

from elastic_strips.planning import search as search_module
from elastic_strips.planning.initial_strip import line_strip, staged_rows
from elastic_strips.planning.problem import PlanningProblem
from elastic_strips.planning.search import PlanSearch
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, DeformParams

JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))
BOX = [
    Box((0.4, 0.02, 0.46), at=(0.6, 0.24, 0.5), name="left"),
    Box((0.4, 0.02, 0.46), at=(0.6, -0.24, 0.5), name="right"),
    Box((0.4, 0.5, 0.02), at=(0.6, 0.0, 0.74), name="lid"),
    Box((0.4, 0.5, 0.02), at=(0.6, 0.0, 0.26), name="floor"),
    Box((0.02, 0.5, 0.5), at=(0.81, 0.0, 0.5), name="back"),
]
"""Open towards the robot alone."""


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda", base="diff_drive", joints=JOINTS)


@pytest.fixture(scope="module")
def inside(panda) -> np.ndarray:
    """The hand in the box, pointing into it."""
    ahead = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    found = panda.inverse_kinematics("panda_hand_tcp", (0.58, 0.0, 0.5), ahead, near=panda.home(), base=False).q
    assert found is not None
    return found


@pytest.fixture(autouse=True)
def _takes_its_time(monkeypatch):
    """No search of the joints is given up because a machine is busy."""
    monkeypatch.setattr(search_module, "_LONGEST_STAGE_SEARCH", 60.0)


def search(robot: RobotModel, scene: Scene, start: np.ndarray, goal: np.ndarray):
    problem = PlanningProblem(robot, scene, start, goal, timeout=60.0)
    found = PlanSearch(problem, None)
    found.initial = line_strip(problem)
    return found


def test_it_drives_there_and_then_reaches_in(panda, inside):
    scene, start = Scene(BOX), panda.home(x=-2.0, y=0.4)
    path = np.array([(-2.0, 0.4), (-1.0, 0.0), (0.0, 0.0)])
    looks = search(panda, scene, start, inside)
    report = looks.in_stages(path)
    assert report is not None, looks.reasons
    assert report.certified
    assert "the joints as at the start, and their own before and after" in report.reason
    least = report.report.certificate.clearance
    assert Deformer(panda, DeformParams(clearance=least)).certify(report.strip, scene).certified
    np.testing.assert_array_equal(report.strip.q[[0, -1]], [start, inside])
    for q in report.strip.sample(0.05):
        assert link_distances(panda, scene, q).min() > 0.0
        assert self_distances(panda, q).min() > 0.0
    assert looks.in_stages(path) is None, "it is tried once"


def test_where_the_joints_end_as_they_begin_there_are_no_stages(panda):
    looks = search(panda, Scene([]), panda.home(x=-2.0), panda.home())
    assert looks.in_stages(np.array([(-2.0, 0.0), (0.0, 0.0)])) is None
    assert looks.attempts == 0


def test_where_the_start_s_posture_does_not_fit_another_does(panda, inside):
    """An arm that is stretched out ahead would be in the box before it."""
    start = panda.home(x=-2.0, joints={"panda_joint2": 0.9, "panda_joint4": -0.6, "panda_joint6": 1.5})
    looks = search(panda, Scene(BOX), start, inside)
    report = looks.in_stages(np.array([(-2.0, 0.0), (0.0, 0.0)]))
    assert report is not None, looks.reasons
    assert "the joints at home" in report.reason


def test_rows_are_put_together_and_no_more_than_there_may_be(panda, inside):
    start = panda.home(x=-2.0)
    ends = panda.space.to_coordinates(np.stack((start, inside)))
    drive = ends.copy()
    drive[:, 3:] = ends[0, 3:]
    path = np.array([(-2.0, 0.0), (0.0, 0.0)])
    share = np.linspace(0.0, 1.0, 30)[:, None]
    after = drive[1] + share * (ends[1] - drive[1])
    for most in (400, 40, 12):
        problem = PlanningProblem(panda, Scene([]), start, inside, params=DeformParams(max_nodes=most))
        rows = staged_rows(problem, path, drive, ends[:1], after)
        assert len(rows) <= most
        np.testing.assert_allclose(rows[[0, -1]], ends, atol=1e-12)
        if most == 400:
            np.testing.assert_array_equal(rows[-30:], after)
