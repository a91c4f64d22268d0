"""Strips on different sides of the obstacles, each certified, the cheapest first."""

import elastic_strips as es

robot = es.load_robot("silvermate")
boxes = [es.Box((0.6, 0.6, 1.4), at=(x, y, 0.7), name=name) for x, y, name in ((2.0, 0.0, "near"), (4.0, 0.3, "far"))]
found = es.plan_report(robot, es.Scene(boxes), robot.home(), robot.home(x=6.0), count=3)
for one in found.alternatives:
    sides = one.homotopy_class
    print(f"{sides} by {one.method}: {one.length:.2f} m, clearance {one.clearance:.2f} m, cost {one.cost:.2f}")
