"""Rejoining: a strip begins where the robot is; two strips lead apart."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each

from elastic_strips.planning import plan_report
from elastic_strips.planning.homotopy.strip_set import divergence_angle, reconnect
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, Strip

SCENE = Scene([Box((0.3, 0.3, 1.0), at=(2.0, 0.6, 0.5), name="box")])


@each("name", ["silvermate", "jackal_box"])
@each("aside, turn", [(0.0, 0.0), (0.05, -0.1), (-0.03, 2 * np.pi)])
def test_what_the_robot_has_passed_goes(name, aside, turn, request) -> None:
    robot = request.getfixturevalue(name)
    planned = plan_report(robot, SCENE, robot.home(), robot.home(x=4.0))
    deformer = Deformer(robot)
    report = deformer.step(planned.strip, SCENE)
    coordinates = report.strip.coordinates[5].copy()
    coordinates[1] += aside
    coordinates[2] += turn
    new = reconnect(deformer, report, coordinates).strip
    np.testing.assert_allclose(robot.space.difference(new.coordinates[:1], coordinates[None]), 0.0, atol=1e-12)
    assert np.abs(np.diff(new.coordinates[:, 2])).max() < 1.0  # no turn is wound up
    np.testing.assert_array_equal(new.q[-1], report.strip.q[-1])
    assert len(new) <= len(report.strip) - 4
    assert new.length == pytest.approx(report.strip.length - report.strip.coordinates[5, 0], abs=0.1)
    assert new.lateral_slip.max() <= 1e-6
    after = deformer.step(new, SCENE)
    np.testing.assert_allclose(after.strip.q[0], robot.space.from_coordinates(coordinates), atol=1e-12)
    fresh = Deformer(robot).certify(after.strip, SCENE)
    assert after.usable is fresh.certified is True
    assert after.slip == pytest.approx(after.strip.lateral_slip.max(), abs=1e-9)


def test_at_the_goal_two_nodes_are_left(jackal_box) -> None:
    planned = plan_report(jackal_box, SCENE, jackal_box.home(), jackal_box.home(x=4.0))
    deformer = Deformer(jackal_box)
    report = deformer.step(planned.strip, SCENE)
    new = reconnect(deformer, report, report.strip.coordinates[-1] - [0.01, 0.0, 0.0]).strip
    assert len(new) == 2


def test_directions_part(silvermate, gantry) -> None:
    def strip(*xy: tuple[float, float]) -> Strip:
        coordinates = np.zeros((len(xy), silvermate.nv))
        coordinates[:, :2] = xy
        coordinates[:, 3:] = silvermate.space.to_coordinates(silvermate.home_q)[3:]
        return Strip.from_coordinates(silvermate, coordinates)

    east, north, west = strip((0, 0), (2, 0)), strip((0, 0), (0, 2)), strip((0, 0), (-0.3, 0))
    assert divergence_angle(east, east, 0.6) == 0.0
    assert divergence_angle(east, north, 0.6) == pytest.approx(np.pi / 2)
    assert divergence_angle(east, west, 0.6) == pytest.approx(np.pi)
    bend = strip((0, 0), (0.3, 0), (0.3, 5.0))
    assert divergence_angle(east, bend, 0.6) == pytest.approx(np.arctan2(0.3, 0.3))
    q = gantry.home(bend=-1.0), gantry.home(bend=1.0)
    assert divergence_angle(Strip(gantry, np.stack(q)), Strip(gantry, np.stack(q[::-1])), 0.6) == 0.0
