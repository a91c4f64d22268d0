"""Strips on different sides of the obstacles, each certified, the cheapest first."""

import elastic_strips as es
from elastic_strips.planning import plan_alternatives

robot = es.load_robot("silvermate")
boxes = [es.Box((0.6, 0.6, 1.4), at=(x, y, 0.7), name=name) for x, y, name in ((2.0, 0.0, "near"), (4.0, 0.3, "far"))]
found = plan_alternatives(robot, es.Scene(boxes), robot.home(), robot.home(x=6.0), count=3)
for way in found.alternatives:
    print(f"{way.base_class} by {way.method}: {way.length:.2f} m, clearance {way.clearance:.2f} m, cost {way.cost:.2f}")
