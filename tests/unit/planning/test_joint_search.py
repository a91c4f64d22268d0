"""Arms among shelves: what is planned is certified, and clear by brute force; tight ends ask for less clearance."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from brute_force import link_distances, self_distances
from cases import each, refused

from elastic_strips.errors import ConfigurationError
from elastic_strips.native import twin
from elastic_strips.planning import plan_report
from elastic_strips.planning.joint_search import PLANNERS, divided, search_joints
from elastic_strips.planning.problem import Deadline
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Scene, Sphere
from elastic_strips.strip import Deformer, DeformParams
from elastic_strips.work import counted

JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda", joints=JOINTS)


WALL = Scene([Box((0.7, 0.02, 1.2), at=(0.55, 0.0, 0.6), name="wall"), Box((0.1, 0.1, 0.1), at=(-0.6, 0.3, 0.4))])
"""A wall between start and goal: the way is over it, or round behind the robot."""


def _ends(robot: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    return robot.home(panda_joint1=-1.0), robot.home(panda_joint1=1.0)


@each("seed", [0, 1])
@each("native", [True, False])
def test_a_way_round_a_wall_is_found_and_certified(panda, seed, native):
    start, goal = _ends(panda)
    if native:
        report = plan_report(panda, WALL, start, goal, seed=seed, timeout=60.0)
    else:
        with twin():
            report = plan_report(panda, WALL, start, goal, seed=seed, timeout=60.0)
    assert (report.certified, report.method) == (True, "trees"), report.reason
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-15)
    assert Deformer(panda, DeformParams()).certify(report.strip, WALL).certified
    for q in report.strip.sample(0.05):
        assert link_distances(panda, WALL, q).min() > 0.004
        assert self_distances(panda, q).min() > 0.0


@each("depth", [1, 2, 3, 4, 12])
def test_what_is_certified_as_it_was_found_is_so_by_its_own_certificate(panda, depth):
    """A certificate that may halve a segment only a few times proves less, and so do the spheres before it."""
    params = DeformParams(certificate_depth=depth)
    report = plan_report(panda, WALL, *_ends(panda), params=params, timeout=5.0)
    assert report.report.certified == report.certified
    if report.certified:
        assert Deformer(panda, params).certify(report.strip, WALL).certified


@each("seed", [2**64 - 1, 2**64, 2**70 + 3])
def test_any_seed_will_do(panda, seed):
    start, goal = _ends(panda)
    report = plan_report(panda, WALL, start, goal, seed=seed, timeout=60.0)
    assert report.certified, report.reason
    same = plan_report(panda, WALL, start, goal, seed=seed, timeout=60.0)
    np.testing.assert_array_equal(report.strip.q, same.strip.q)


def test_equal_seeds_give_equal_paths(panda):
    start, goal = _ends(panda)
    one, two = (plan_report(panda, WALL, start, goal, seed=3, timeout=60.0) for _ in range(2))
    np.testing.assert_array_equal(one.strip.q, two.strip.q)


@pytest.mark.parametrize("planner", sorted(set(PLANNERS)))
def test_a_path_is_valid_wherever_it_was_looked_at(panda, planner):
    valid = ValidityChecker(panda, WALL, margin=0.01)
    ends = panda.space.to_coordinates(np.array(_ends(panda)))
    corners = search_joints(valid, ends, seed=1, planner=planner, step=0.05, timeout=60.0, deadline=Deadline(60.0))
    assert corners is not None
    np.testing.assert_array_equal(corners[[0, -1]], ends)
    for a, b in itertools.pairwise(corners):
        assert valid.motion(a, b, 0.05)
    rows = divided(corners, 0.2)
    assert np.linalg.norm(np.diff(rows, axis=0), axis=1).max() <= 0.2 + 1e-12
    for corner in corners:
        assert np.abs(rows - corner).max(axis=1).min() < 1e-9


SHUT = Scene(
    [
        Box((1.0, 0.02, 1.4), at=(0.68, 0.0, 0.7), name="front"),
        Box((1.0, 0.02, 1.4), at=(-0.72, 0.0, 0.7), name="back"),
        Box((0.5, 0.02, 0.8), at=(0.0, 0.0, 0.98), name="top"),
    ]
)
"""Walls before, behind and above the robot: there is no way, and the strip that comes back is broken."""


def _sides(robot: RobotModel) -> list[np.ndarray]:
    return [robot.home(panda_joint1=a, panda_joint2=1.0, panda_joint4=-1.6) for a in (-1.5, 1.5)]


def test_a_search_ends_by_its_work_at_the_same_place(panda):
    """What was checked is work at once, else nothing would end the search; how long it takes does not matter."""
    found, work = [], 0.03
    for _ in range(2):
        before = counted()
        report = plan_report(panda, SHUT, *_sides(panda), timeout=np.inf, work=work)
        done = counted() - before
        assert not report.certified
        assert "Try more work" in report.reason
        assert done.looks > 0
        assert work <= done.seconds < 1.5 * work
        found.append((report.attempts, done))
    assert found[0] == found[1]


def test_a_search_ends_in_time_and_says_so(panda):
    report = plan_report(panda, SHUT, *_sides(panda), timeout=0.7)
    assert not report.certified
    assert report.method == "none"
    assert "no path of the joints" in report.reason
    assert report.report.certificate.broken is not None


def test_tight_ends_ask_for_less_clearance(panda):
    """4 mm at the goal: proven with half of it, and said; who states a clearance gets that one or an error."""
    start, goal = _ends(panda)
    reach = link_distances(panda, Scene([Sphere(0.05, at=(0.4, 0.9, 0.5), name="ball")]), goal)
    gap = float(reach.min())
    assert gap > 0.02
    low, high = 0.05, 0.05 + gap
    for _ in range(60):  # a ball that comes as near as 4 mm
        radius = 0.5 * (low + high)
        distance = link_distances(panda, Scene([Sphere(radius, at=(0.4, 0.9, 0.5))]), goal).min()
        low, high = (radius, high) if distance > 0.004 else (low, radius)
    scene = Scene([Sphere(low, at=(0.4, 0.9, 0.5), name="ball")])
    report = plan_report(panda, scene, start, goal, timeout=60.0)
    assert report.certified, report.reason
    assert "proven with 2 mm" in report.reason
    assert "'ball'" in report.reason
    assert report.report.certificate.clearance == pytest.approx(0.002, abs=1e-4)
    with refused(ConfigurationError, "goal", "4.0", "'ball'"):
        plan_report(panda, scene, start, goal, params=DeformParams())
