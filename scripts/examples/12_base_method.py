"""What the paper builds on: a base steered by the vector field histogram, on its own range sensors."""

import elastic_strips as es
from workshop.baselines import base_simulation

robot = es.load_robot("silvermate")
pillar = es.Cylinder(0.3, 1.3, at=(2.0, 0.15, 0.65), name="pillar")
driven = base_simulation(robot, es.Scene([pillar]), robot.home(), robot.home(x=4.0), "vfh", seed=3)
result = driven.run(time_limit=40.0)
print(f"{result.state.label} after {result.record.duration:.1f} s: {result.reason}")
