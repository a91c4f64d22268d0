"""A hand that stays as level as it is at home while the strip gives way: one more term of the strip's potential."""

import numpy as np

import elastic_strips as es
from elastic_strips.strip import OrientationConstraint

robot = es.load_robot("silvermate")
ball = es.Sphere(0.2, at=(2.4, 0.15, 1.15), name="ball")  # in the way of the arm alone
start, scene = robot.home(), es.Scene([ball])
strip = es.plan(robot, scene, start, robot.home(x=4.0))
deformer = es.Deformer(robot, constraint=OrientationConstraint.from_configuration(robot, start, "hand_frame"))
for _ in range(100):
    report = deformer.step(strip, scene)
    strip = report.strip
assert report.constraint_errors is not None
print(f"{report.status.value}, certified {report.certified}, clearance {report.clearance:.2f} m")
print(f"the hand is tilted by at most {np.degrees(report.constraint_errors.max()):.1f}° from level")
