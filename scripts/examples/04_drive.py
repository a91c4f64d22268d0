"""The closed loop, simulated: drive past somebody who walks, and have it evaluated from what truly happened."""

import elastic_strips as es
from elastic_strips.sim import simulation
from elastic_strips.sim.evaluation import evaluate

robot = es.load_robot("silvermate")
crate = es.Box((0.4, 0.4, 1.0), at=(1.6, 0.45, 0.5), name="crate")
walker = es.Cylinder(0.25, 1.7, at=(2.0, -2.5, 0.85), name="walker", motion=es.Twist(linear=(0.0, 0.9, 0.0)))
driven = simulation(robot, es.Scene([crate, walker]), robot.home(), robot.home(x=4.0), seed=1)
result = driven.run()
evaluation = evaluate(result.record, robot)
print(f"{result.state.label} after {evaluation.time_s:.1f} s, {len(evaluation.collisions)} collisions")
print(f"never nearer than {evaluation.min_clearance_m:.3f} m; stops: {len(result.stops)}")
