"""A robot, a scene, a goal: plan a strip, let it give way until it has converged, and see that it is certified."""

import elastic_strips as es

robot = es.load_robot("silvermate")
scene = es.Scene([es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7)), es.Sphere(0.25, at=(2.4, 0.8, 1.0))])
strip = es.plan(robot, scene, start=robot.home(x=-1.0), goal=robot.home(x=6.0))
report = es.Deformer(robot).settle(strip, scene)
print(f"{report.status.value}: {report.reason}, clearance {report.clearance:.3f} m")
