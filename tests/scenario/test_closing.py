"""closing-side: the family changes to the other side when the first one closes, and says why."""

from __future__ import annotations

import numpy as np
from coal_distances import coal_distances

from elastic_strips import RobotModel
from elastic_strips.planning import StripSet, StripSetParams
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer


def test_the_family_changes_sides(silvermate: RobotModel) -> None:
    """Ten ticks a second: left of the box as long as that is open, then right of it, certified in every tick."""
    problem = get_scenario("closing-side")
    start, goal = problem.ends(silvermate)
    family = StripSet(silvermate, goal, params=StripSetParams(count=2, plan_every=0))
    report = family.plan(problem.scene, start)
    assert len(report.alternatives) == 2, report.events
    switches, sides = [], []
    for tick in range(1, 81):
        scene = problem.scene.at(0.1 * tick)
        report = family.step(scene)
        assert report.certified, (tick, report.events)
        best = report.best
        assert best is not None
        if tick % 20 == 0 or report.events:
            assert Deformer(silvermate).certify(best.strip, scene).certified
            assert coal_distances(silvermate, scene, best.strip.sample(0.05)).min() > 0.0
        switches += [(tick, e) for e in report.events if e.startswith("switched")]
        y = np.interp(3.0, best.strip.q[:, 0], best.strip.q[:, 1])
        sides.append("left" if y > -0.15 else "right")
    assert len(switches) == 1, switches
    when, why = switches[0]
    assert why.startswith("switched from left of box to right of it: ")
    assert "comes within" in why or "deep in" in why or "it costs" in why
    assert 20 < when <= 70
    assert set(sides[: when - 1]) == {"left"}
    assert set(sides[when - 1 :]) == {"right"}
