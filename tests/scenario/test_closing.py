"""closing-side: the family changes to the other side when the first one closes, and says why."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import result_check

from elastic_strips import RobotModel, Scene, Strip, get_scenario
from elastic_strips.deform import Deformer
from elastic_strips.io import obstacle_documents
from elastic_strips.planning import FamilyParams, StripFamily
from elastic_strips.scene import checks


def _depth(robot: RobotModel, scene: Scene, strip: Strip) -> float:
    """Smallest distance [m] of the interpolated strip to the obstacles, by Pinocchio and Coal alone."""
    model = robot.collision_model.clone()
    links = len(model.geometryObjects)
    for entry in obstacle_documents(scene):
        x, y, z, *quat = entry["pose"]
        pose = pin.SE3(checks.rotation_of(np.array(quat)), np.array([x, y, z]))
        index = model.addGeometryObject(pin.GeometryObject(entry["name"], 0, 0, pose, result_check.shape(entry)))
        for link in range(links):
            model.addCollisionPair(pin.CollisionPair(link, index))
    data, geometry = robot.model.createData(), model.createData()
    lowest = np.inf
    for q in strip.sample(0.05):
        pin.computeDistances(robot.model, data, model, geometry, q)
        lowest = min(lowest, min(r.min_distance for r in geometry.distanceResults))
    return lowest


def test_the_family_changes_sides(silvermate: RobotModel) -> None:
    """Ten ticks a second: left of the box as long as that is open, then right of it, certified in every tick."""
    problem = get_scenario("closing-side")
    start, goal = problem.ends(silvermate)
    family = StripFamily(silvermate, goal, family=FamilyParams(count=2, plan_every=0))
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
            assert _depth(silvermate, scene, best.strip) > 0.0
        switches += [(tick, e) for e in report.events if e.startswith("switched")]
        y = np.interp(3.0, best.strip.q[:, 0], best.strip.q[:, 1])
        sides.append("left" if y > -0.15 else "right")
    assert len(switches) == 1, switches
    when, why = switches[0]
    assert why.startswith("switched from left of box to right of it: ")
    assert "comes within" in why or "it costs" in why
    assert 20 < when <= 70
    assert set(sides[: when - 1]) == {"left"}
    assert set(sides[when - 1 :]) == {"right"}
