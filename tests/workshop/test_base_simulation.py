"""Base methods in the closed loop, on simulated sensors alone."""

from __future__ import annotations

import numpy as np
import pytest
from cases import refused

from elastic_strips.control import RunState
from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder, Scene
from elastic_strips.sim import evaluate
from workshop.baselines import base_simulation

PILLAR = Cylinder(0.3, 1.3, at=(2.0, 0.15, 0.65), name="pillar")


@pytest.mark.parametrize("method", ["apf", "vff", "vfh", "band"])
def test_reaches_a_goal_behind_a_pillar(silvermate, method):
    runner = base_simulation(silvermate, Scene([PILLAR]), silvermate.home(), silvermate.home(x=3.3), method, seed=3)
    result = runner.run(time_limit=40.0)
    assert result.state is RunState.REACHED, result.reason
    evaluation = evaluate(result.record, silvermate, runner.world, runner.limits)
    assert not evaluation.contacts
    assert evaluation.max_lateral_slip_m < 1e-5
    np.testing.assert_allclose(result.record.control.coordinates[-1, :2], (3.3, 0.0), atol=0.15)
    assert result.record.metadata["method"] == method


def test_a_closed_room_blocks(silvermate):
    walls = [Box((0.1, 4.0, 1.0), at=(1.2, 0.0, 0.5)), Box((4.0, 0.1, 1.0), at=(0.0, 2.0, 0.5)),
             Box((4.0, 0.1, 1.0), at=(0.0, -2.0, 0.5)), Box((0.1, 4.0, 1.0), at=(-2.0, 0.0, 0.5))]  # fmt: skip
    runner = base_simulation(
        silvermate, Scene(walls), silvermate.home(), silvermate.home(x=4.0), "vfh", seed=3, patience=3.0
    )
    result = runner.run(time_limit=60.0)
    assert result.state is RunState.STOPPED
    assert "blocked" in result.reason
    assert np.abs(result.record.control.v[-1]).max() < 0.01  # the plant comes to rest after the last sample
    assert not evaluate(result.record, silvermate, runner.world, runner.limits).contacts


def test_equal_seeds_give_equal_runs(silvermate):
    one, two = (
        base_simulation(silvermate, Scene([PILLAR]), silvermate.home(), silvermate.home(x=4.0), "vfh", seed=5)
        .run(time_limit=4.0)
        .record.control.coordinates
        for _ in range(2)
    )
    np.testing.assert_array_equal(one, two)


def test_wrong_runs_are_refused(silvermate):
    with refused(ParameterError, "vfg"):
        base_simulation(silvermate, Scene([]), silvermate.home(), silvermate.home(x=1.0), "vfg")
    rolling = load_robot("silvermate", base="omni")
    with refused(ConfigurationError, "differential drive"):
        base_simulation(rolling, Scene([]), rolling.home(), rolling.home(x=1.0), "vfh")
