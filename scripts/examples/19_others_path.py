"""Another planner's path: certified as it is, repaired, and followed online while a ball comes into it."""

from ompl import base, geometric, util

import elastic_strips as es
from elastic_strips.sim import evaluate, simulation
from elastic_strips.strip import repair

robot = es.load_robot("panda")
start, goal = robot.home(panda_joint1=-0.9), robot.home(panda_joint1=0.9)
post = es.Box((0.04, 0.04, 0.6), at=(0.3, 0.0, 0.3), name="post")

# OMPL plans with a checker of its own: here each state by itself, and nothing between two of them
util.setLogLevel(util.LOG_NONE)
util.RNG.setSeed(1)
space = base.RealVectorStateSpace(robot.nv)
bounds = base.RealVectorBounds(robot.nv)
for k, name in enumerate(robot.joint_names):
    bounds.setLow(k, float(robot.space.lower[k]))
    bounds.setHigh(k, float(robot.space.upper[k]))
    space.setDimensionName(k, name)
space.setBounds(bounds)
setup = geometric.SimpleSetup(space)
setup.setStateValidityChecker(lambda s: es.certify(robot, es.Scene([post]), [s[0:7]] * 2, measure=False).certified)
ends = [space.allocState(), space.allocState()]
for state, q in zip(ends, (start, goal), strict=True):
    for k in range(robot.nv):
        state[k] = float(q[k])
setup.setStartAndGoalStates(*ends)
setup.setPlanner(geometric.RRTConnect(setup.getSpaceInformation()))
setup.solve(10.0)

path = es.load_path(setup, robot)  # or a JointTrajectory, RoboPlan's JointPath, VAMP's result, rows with joint_names=
print(f"as it is: {es.certify(robot, es.Scene([post]), path).reason}")
mended = repair(robot, es.Scene([post]), path)
print(f"repaired: certified {mended.certified}, moved by {mended.moved:.3f} m, {len(mended.strip)} nodes")

ball = es.Sphere(0.08, at=(0.3, 1.0, 0.65), name="ball", motion=es.Twist(linear=(0.0, -0.2, 0.0)))
world = es.Scene([post, ball])  # with a robot: es.Controller(robot, start, goal, scene, strip=mended.strip)
driven = simulation(robot, world, path.q[0], path.q[-1], strip=mended.strip, seed=1)
result = driven.run()
evaluation = evaluate(result.record, robot)
print(f"{result.state.label} after {evaluation.time_s:.1f} s, {len(evaluation.collisions)} contacts at speed")
