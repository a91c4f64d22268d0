"""Start and goal headings: any value will do, half turns too."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.planning import ompl_path, plan_report
from elastic_strips.scene import Box, Scene

WALL = Scene([Box((0.2, 3.0, 1.5), at=(2.0, 0.6, 0.75)), Box((0.2, 3.0, 1.5), at=(2.0, -3.9, 0.75))])


@pytest.mark.parametrize("yaw", [np.pi, -np.pi, 3 * np.pi, np.nextafter(np.pi, 4), 7.0])
def test_the_planner_takes_any_heading(jackal_box, yaw):
    """OMPL calls a heading of exactly pi out of bounds; a goal that faces back must be found all the same."""
    start, goal = jackal_box.home(yaw=yaw), jackal_box.home(4.0, 0.0, yaw)
    path = ompl_path(jackal_box, WALL, start, goal, seed=0, margin=0.03, timeout=60.0).rows
    assert path is not None
    np.testing.assert_allclose(jackal_box.space.from_coordinates(path[[0, -1]]), [start, goal], atol=1e-9)
    report = plan_report(jackal_box, WALL, start, goal, line=False)
    assert report.certified, report.reason
