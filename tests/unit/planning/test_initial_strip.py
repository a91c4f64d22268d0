"""Relaxing of first strips: the arm tucked where it does not fit otherwise, and no patience with what leads nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.planning import grid_path, plan_report
from elastic_strips.planning.initial_strip import STUCK_TICKS, line_strip, path_rows, path_strip, relax_path
from elastic_strips.planning.problem import PlanningProblem
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer

REACH = {
    "arm_1_joint": 0.61, "arm_2_joint": 0.25, "arm_3_joint": -0.58, "arm_4_joint": 1.53, "arm_5_joint": 0.46,
    "arm_6_joint": -0.36, "arm_7_joint": 0.55,
}  # fmt: skip
ASIDE = {
    "arm_1_joint": 1.85, "arm_2_joint": 1.47, "arm_3_joint": -0.23, "arm_4_joint": 1.39, "arm_5_joint": 0.95,
    "arm_6_joint": -0.32, "arm_7_joint": 0.3,
}  # fmt: skip
ZIGZAG = Scene(
    [
        Box((0.06, 4.0, 1.4), at=(x, y + s * 2.33, 0.7), name=f"{name} {'left' if s > 0 else 'right'}")
        for x, y, name in ((2.0, 0.9, "first"), (2.95, -0.3, "second"))
        for s in (1.0, -1.0)
    ]
)
"""Two doors 0.66 m wide, 0.95 m apart and 1.2 m aside: the robot has to turn between them."""


def test_the_arm_is_tucked_where_it_does_not_fit(silvermate) -> None:
    start, goal = silvermate.home(joints=ASIDE), silvermate.home(x=5.0, joints=ASIDE)
    report = plan_report(silvermate, ZIGZAG, start, goal, grid=True, line=False, timeout=60.0)
    assert report.certified
    assert report.method == "grid"
    assert "the grid's path with the arm tucked relaxed" in report.reason
    assert Deformer(silvermate).certify(report.strip, ZIGZAG).certified
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-12)


def test_rows_are_tucked_only_where_that_changes_something(silvermate, jackal_box) -> None:
    way = np.array([[0.0, 0.0], [3.0, 0.0]])
    for robot, joints, count in ((silvermate, {}, 1), (silvermate, REACH, 2), (jackal_box, {}, 1)):
        ends = robot.home(), robot.home(x=3.0, joints=joints)
        names = [what for _, what in path_rows(PlanningProblem(robot, Scene([]), *ends), way)]
        assert names == ["", " with the arm tucked"][:count]


def test_what_gets_no_clearer_is_given_up(silvermate) -> None:
    """A line through a box: patience makes it longer and slower, and leads nowhere."""
    scene = Scene([Box((0.8, 3.0, 1.4), at=(3.0, 0.0, 0.7), name="block")])
    problem = PlanningProblem(silvermate, scene, silvermate.home(), silvermate.home(x=6.0), timeout=60.0)
    strip = line_strip(problem)
    seen = []
    report = relax_path(problem, strip, stuck=STUCK_TICKS, watch=seen.append)
    assert not report.usable
    assert report.ticks == len(seen) < 25
    assert "block" in report.reason
    assert report.reason.endswith(f"(after {report.ticks} ticks)")
    assert relax_path(problem, strip, stuck=STUCK_TICKS, over=lambda: True).ticks == 1


@pytest.mark.parametrize("y", [0.9, -0.8])
def test_what_can_be_relaxed_comes_out_as_with_patience(silvermate, y) -> None:
    scene = Scene([Box((0.4, 0.4, 1.4), at=(3.0, 0.0, 0.7)), Box((0.4, 0.4, 1.4), at=(1.5, y, 0.7))])
    start, goal = silvermate.home(), silvermate.home(x=5.0)
    way = grid_path(silvermate, scene, start, goal).points
    assert way is not None
    problem = PlanningProblem(silvermate, scene, start, goal, timeout=60.0)
    rows, _ = next(path_rows(problem, way))
    strip = path_strip(problem, rows)
    one, two = (relax_path(problem, strip, stuck=stuck) for stuck in (None, STUCK_TICKS))
    assert one.usable
    np.testing.assert_array_equal(one.strip.q, two.strip.q)
    assert one.ticks == two.ticks
