"""A robot whose base stands still: the strip is of the joints alone."""

import elastic_strips as es

robot = es.load_robot("panda")
start = robot.home()
goal = robot.home(panda_joint1=1.6)
post = es.Cylinder(0.06, 1.2, at=(0.4, 0.4, 0.6), name="post")
report = es.plan_report(robot, es.Scene([post]), start, goal)
print(f"{robot.name}, base {robot.base_kind.value}: certified {report.certified} by {report.method}")
settled = es.Deformer(robot).settle(report.strip, es.Scene([post]))
print(f"{settled.status.value}, {settled.strip.length:.2f} rad long, clearance {settled.clearance:.3f} m")
