"""Recovery of broken strips: a step goes no farther than what is in the strip asks, and not through the own links."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each

from elastic_strips.planning import plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, Strip, displacement
from elastic_strips.strip import deformer as tick
from elastic_strips.strip.recovery import Intrusions, hold_joints
from elastic_strips.strip.solver import BandedSolver, System
from workshop.bench.plan import push_nearest

DEPTH = 0.035  # [m] of the obstacle in the strip
SEEDS = range(3)


@pytest.fixture(scope="module")
def broken(tiago_omni: RobotModel) -> list[tuple[Strip, Scene]]:
    """Certified strips, each with an obstacle that was pushed into it."""
    out = []
    for seed in SEEDS:
        problem = get_scenario("corridor", seed=seed)
        planned = plan_report(tiago_omni, problem.scene, *problem.ends(tiago_omni), deformer=Deformer(tiago_omni))
        assert planned.certified
        strip = (
            Deformer(tiago_omni).settle(planned.strip, problem.scene, max_ticks=5).strip
        )  # as near as it likes to be
        pushed = push_nearest(Deformer(tiago_omni), strip, problem.scene, DEPTH)
        assert pushed is not None
        out.append((strip, pushed))
    return out


def own_room(deformer: Deformer, strip: Strip, scene: Scene) -> float:
    """Least distance [m] of the robot's own links at the nodes of a strip."""
    deformer.assess(strip, scene)
    return float(deformer.workspace.self_pairs.bound.min())


def test_an_arm_that_is_pushed_does_not_go_through_the_body(tiago_omni, broken):
    """No tick costs the distances of the own links, though the obstacle pushes the arm; the strip is free soon."""
    for strip, scene in broken:
        deformer, looker = Deformer(tiago_omni), Deformer(tiago_omni)
        had = own_room(looker, strip, scene)
        for _ in range(5):
            report = deformer.step(strip, scene, nodes=False)
            strip = report.strip
            assert own_room(looker, strip, scene) > min(had, deformer.params.self_clearance) - 1e-3
        assert report.node_clearance > 0.0


def test_without_it_the_arm_does_go_through_the_body(tiago_omni, broken, monkeypatch):
    monkeypatch.setattr(tick, "_MOST_HOLDS", 0)
    least = [
        own_room(Deformer(tiago_omni), Deformer(tiago_omni).step(*what, nodes=False).strip, what[1]) for what in broken
    ]
    assert min(least) < -1e-3


def test_what_a_tick_divides_or_joins_is_certified_anew(tiago_omni, broken, monkeypatch):
    """Segments that stay keep what a tick found of them, all others are looked at: no more is certified than is true,
    while the arm goes through the body and nodes come where it does."""
    monkeypatch.setattr(tick, "_MOST_HOLDS", 0)
    changed = 0
    for strip, scene in broken:
        deformer = Deformer(tiago_omni)
        for _ in range(4):
            report = deformer.step(strip, scene)
            changed += len(report.strip) != len(strip) and not report.certified
            strip = report.strip
            fresh = Deformer(tiago_omni).certify(strip, scene)
            assert not (report.certificate.segments & ~fresh.segments).any()
    assert changed > 0


def test_a_step_goes_as_far_as_what_is_in_the_strip_asks(tiago_omni, broken, monkeypatch):
    for strip, scene in broken:
        near = Deformer(tiago_omni).step(strip, scene, nodes=False)
        with monkeypatch.context() as patch:
            patch.setattr(Intrusions, "share", lambda self, delta: 1.0)
            far = Deformer(tiago_omni).step(strip, scene, nodes=False)
        assert near.node_clearance > 0.0  # the obstacle was DEPTH in it
        assert displacement(strip, near.strip) <= displacement(strip, far.strip) + 1e-9
        if far.node_clearance > 0.05:
            assert displacement(strip, near.strip) < 0.95 * displacement(strip, far.strip)


def test_the_share_is_what_the_worst_of_them_needs():
    node, rows = np.array([1, 2]), np.array([[1.0, 0.0], [0.0, 1.0]])
    delta = np.array([[9.0, 9.0], [0.1, 0.0], [0.0, 0.2]])

    def share(*missing: float) -> float:
        return Intrusions(node, rows, np.array(missing)).share(delta)

    assert share(0.04, 0.1) == pytest.approx(0.5)
    assert share(0.07, 0.1) == pytest.approx(0.7)
    assert share(0.001, 0.001) == pytest.approx(0.25)  # some of it always
    assert share(0.2, 0.1) == 1.0  # it does not do
    assert Intrusions(node, -rows, np.array([0.01, 0.01])).share(delta) == 1.0  # it leads the wrong way
    assert Intrusions(node[:0], rows[:0], np.zeros(0)).share(delta) == 1.0  # nothing is near a node


def test_held_joints_leave_the_way_to_the_base():
    system = System(9, 4)
    system.force[4] = (1.0, 0.0, 0.0, 1.0)
    system.diagonal[:] = np.eye(4)
    lost = np.zeros(9, dtype=bool)
    lost[4] = True
    held = hold_joints(system, 3, lost)
    assert held.tolist() == [False, False, True, True, True, True, True, False, False]
    delta = BandedSolver().solve(system, np.full(4, 1e-3))
    assert delta[4, 0] == pytest.approx(1.0, rel=0.01)
    assert abs(delta[4, 3]) < 0.01


@each("nodes", [2, 3, 4, 5])
def test_short_strips_are_held_too(nodes):
    system, lost = System(nodes, 4), np.zeros(nodes, dtype=bool)
    lost[1] = True
    assert hold_joints(system, 3, lost).tolist() == [True] * min(nodes, 4) + [False] * (nodes - 4)


def test_what_is_not_broken_takes_steps_as_ever(tiago_omni, broken, monkeypatch):
    """A strip with a certificate is not asked."""
    strip, scene = broken[0]
    settled = Deformer(tiago_omni).settle(strip, scene, max_ticks=60)
    assert settled.certified
    deformer = Deformer(tiago_omni)
    monkeypatch.setattr(tick.Intrusions, "of", lambda *given: pytest.fail("asked"))
    assert deformer.step(settled.strip, scene).certified
