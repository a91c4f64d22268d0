"""A task for the hand: the deliberative layer divides it, a behaviour tree watches it, the strip drives it.

It needs the extra control: pip install 'elastic-strips[control]'.
"""

import elastic_strips as es
from elastic_strips.control.tasks import ReachHand
from elastic_strips.sim import TaskSimulation

robot = es.load_robot("silvermate")
shelf = es.Box((0.5, 0.8, 0.05), at=(2.1, 0.0, 0.6), name="shelf")
task = TaskSimulation(robot, es.Scene([shelf]), robot.home(), ReachHand((2.0, 0.1, 0.85)), seed=2)
for step in task.deliberation.steps:
    print(step)
result = task.run(time_limit=40.0)
print("done" if result.done else "not done", "·", result.reason)
