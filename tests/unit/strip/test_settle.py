"""Settling makes no strip worse: its energy falls, its clearance stays, it comes to rest, or says that it has not."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each

from elastic_strips.planning import plan_report
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, DeformReport, DeformStatus, strip_clearance
from elastic_strips.strip.forces import add_elastic, add_pieces, add_stretch
from elastic_strips.strip.solver import System


@each("name", ["corridor", "clutter", "bottleneck", "closing-side"])
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
    felt = 0.95 * deformer.params.influence
    had, has = (min(strip_clearance(strip, scenario.scene), felt) for strip in (planned.strip, after.strip))
    assert has > had - 0.0015, "between the nodes, too"
    assert after.node_clearance > min(before.node_clearance, felt) - 0.0015


def test_what_has_not_converged_says_so(silvermate):
    scenario = get_scenario("corridor", seed=3)
    planned = plan_report(silvermate, scenario.scene, *scenario.ends(silvermate))
    report = Deformer(silvermate).settle(planned.strip, scenario.scene, max_ticks=2)
    assert report.certified
    assert report.status is DeformStatus.DEFORMING


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


@pytest.mark.parametrize("robot_name", ["silvermate", "gantry"])
def test_a_node_that_is_put_in_changes_no_force(robot_name, request, rng):
    """Of a spring that is divided, energy and forces on the nodes that were there stay, and the new node feels none."""
    robot = request.getfixturevalue(robot_name)
    space = robot.space
    weight = rng.uniform(0.1, 1.0, space.nv)
    rows = np.clip(rng.normal(size=(4, space.nv)), np.maximum(space.lower, -1.5), np.minimum(space.upper, 1.5))
    between = space.interpolate(rows[1:2], rows[2:3], np.array([1.0, 2.0]) / 3.0)
    found = []
    for nodes, pieces in ((rows, np.ones(3)), (np.vstack((rows[:2], between, rows[2:])), np.array([1, 3, 3, 3, 1.0]))):
        system = System(len(nodes), space.nv)
        v = space.difference(nodes[:-1], nodes[1:])
        add_elastic(system, space, v, weight)
        add_pieces(system, space, v, weight, pieces)
        found.append((system.energies["elastic"], system.force))
    (before, force), (after, divided) = found
    assert after == pytest.approx(before, rel=1e-9)
    if not space.planar:  # a base's arc is no straight line, so that springs of it are only nearly so
        np.testing.assert_allclose(divided[[0, 1, 4, 5]], force, atol=1e-9)
        np.testing.assert_allclose(divided[2:4], 0.0, atol=1e-9)
