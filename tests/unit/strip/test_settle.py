"""Settling makes no strip worse: its energy falls, its clearance stays, it comes to rest, or says that it has not."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.planning import plan_report
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, DeformReport, DeformStatus
from elastic_strips.strip.forces import add_stretch
from elastic_strips.strip.solver import System


@pytest.mark.parametrize("name", ["corridor", "clutter", "bottleneck", "closing-side"])
def test_the_energy_falls_and_the_clearance_stays(silvermate, name):
    scenario = get_scenario(name, seed=3)
    planned = plan_report(silvermate, scenario.scene, *scenario.ends(silvermate))
    assert planned.certified, planned.reason
    ticks: list[DeformReport] = []
    deformer = Deformer(silvermate)
    before = deformer.assess(planned.strip, scenario.scene)
    after = deformer.settle(planned.strip, scenario.scene, watch=ticks.append)
    assert after.status is DeformStatus.SETTLED, after.reason
    assert after.certified
    assert len(after.strip) < 2 * len(planned.strip)
    for former, one, two in zip(ticks, ticks[1:], ticks[2:], strict=False):
        if len(former.strip) == len(one.strip):  # no node came or went
            first, second = (sum(report.energies.values()) for report in (one, two))
            assert second <= first + 1e-3 * max(first, 1.0)
    assert after.node_clearance > min(before.node_clearance, 0.3) - 0.005


def test_what_is_not_at_rest_says_so(silvermate):
    scenario = get_scenario("corridor", seed=3)
    planned = plan_report(silvermate, scenario.scene, *scenario.ends(silvermate))
    report = Deformer(silvermate).settle(planned.strip, scenario.scene, max_ticks=2)
    assert report.certified
    assert report.status is DeformStatus.DEFORMING
    assert "not yet at rest" in report.reason


@pytest.mark.parametrize("robot_name", ["silvermate", "gantry"])
def test_stretch_is_minus_its_gradient(robot_name, request, rng):
    robot = request.getfixturevalue(robot_name)
    space = robot.space
    weight = rng.uniform(0.1, 1.0, space.nv)
    rows = np.clip(rng.normal(size=(5, space.nv)), np.maximum(space.lower, -2.0), np.minimum(space.upper, 2.0))

    def energy(coordinates: np.ndarray) -> float:
        system = System(5, space.nv)
        v = space.difference(coordinates[:-1], coordinates[1:])
        add_stretch(system, space, v, weight, stiffness=7.0, length=0.8)
        return system.energies["stretch"]

    system, h = System(5, space.nv), 1e-6
    v = space.difference(rows[:-1], rows[1:])
    add_stretch(system, space, v, weight, stiffness=7.0, length=0.8)
    assert system.energies["stretch"] > 0.0
    for node in range(5):
        for k in range(space.nv):
            step = np.zeros_like(rows)
            step[node, k] = h
            slope = (energy(space.integrate(rows, step)) - energy(space.integrate(rows, -step))) / (2.0 * h)
            assert system.force[node, k] == pytest.approx(-slope, abs=1e-5 * max(1.0, abs(slope)))
