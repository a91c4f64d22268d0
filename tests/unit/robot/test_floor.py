"""The floor is no obstacle: where an arm is led into it, that is said."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pytest
from cases import each

from elastic_strips import Scene, certify, load_robot, plan
from elastic_strips.robot import RobotModel
from elastic_strips.robot.floor import below_floor

SHOULDER, LENGTH, RADIUS = 0.5, 0.8, 0.03  # [m]


@pytest.fixture
def reacher(tmp_path: Path) -> RobotModel:
    """A base on wheels 4 cm below its frame, and a rod that a shoulder pitches down."""
    parts = [
        '<link name="base"><collision><origin xyz="0 0 0.06"/><geometry><box size="0.3 0.3 0.2"/></geometry>'
        "</collision></link>",
        f'<link name="rod"><collision><origin xyz="{0.5 * LENGTH} 0 0" rpy="0 1.5707963267948966 0"/><geometry>'
        f'<cylinder radius="{RADIUS}" length="{LENGTH}"/></geometry></collision></link>',
        f'<joint name="shoulder" type="revolute"><origin xyz="0.1 0 {SHOULDER - 0.04}"/><parent link="base"/>'
        '<child link="rod"/><axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>',
    ]
    path = tmp_path / "reacher.urdf"
    path.write_text(f'<robot name="reacher">{"".join(parts)}</robot>')
    return load_robot(path, base="omni")


def lowest(pitch: float) -> float:
    """Height of the rod's lowest point over the floor [m]."""
    return SHOULDER - LENGTH * math.sin(pitch) - RADIUS * math.cos(pitch)


@each("pitch", [0.0, 0.5, 0.65, 0.7, 0.9])
def test_how_far_a_link_is_below_the_floor(reacher: RobotModel, pitch: float):
    row = reacher.space.to_coordinates(reacher.home(x=3.0, yaw=1.0, shoulder=pitch))
    found = below_floor(reacher, row[None])
    if lowest(pitch) > 0.0:
        assert found is None
    else:
        assert found is not None
        assert found.link == "rod"
        assert found.depth == pytest.approx(-lowest(pitch), abs=1e-6)
        assert found.level == pytest.approx(-0.04)


def test_a_path_into_it_is_certified_and_says_so(reacher: RobotModel):
    """It is there between two configurations that are free of it."""
    down = [reacher.home(shoulder=-0.4), reacher.home(x=1.0, shoulder=0.9), reacher.home(x=2.0, shoulder=-0.4)]
    found = certify(reacher, Scene([]), down)
    assert found.certified
    (below,) = [below_floor(reacher, np.array([reacher.space.to_coordinates(q) for q in down]))]
    assert below is not None
    assert str(below) in found.reason
    free = certify(reacher, Scene([]), [down[0], down[2]])
    assert "floor" not in free.reason


def test_a_plan_into_it_is_warned_about(reacher: RobotModel, caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        plan(reacher, Scene([]), reacher.home(), reacher.home(x=1.0, shoulder=0.6))
        assert not caplog.records
        plan(reacher, Scene([]), reacher.home(), reacher.home(x=1.0, shoulder=1.0))
    assert any("rod" in record.getMessage() for record in caplog.records)


def test_a_robot_on_legs_stands_on_its_feet():
    """Its base is a trunk that moves in the plane, with legs that are planned."""
    robot = load_robot("go1", base="omni")
    row = robot.space.to_coordinates(robot.home_q)
    assert below_floor(robot, row[None]) is None
    assert robot.tree.parents.size > 12


def test_a_base_that_stands_on_a_table_has_no_floor():
    panda = load_robot("panda")
    assert below_floor(panda, np.zeros((1, panda.nv))) is None
