"""MuJoCo as if it were a real robot: the controller gets measurements and scenes, and never the true state.

It needs the extra sim: pip install 'elastic-strips[sim]'. Run it: python scripts/examples/06_mujoco_as_robot.py
"""

from __future__ import annotations

import numpy as np

import elastic_strips as es
from elastic_strips.sim.mujoco.plant import MujocoPlant

robot = es.load_robot("silvermate")
limits = es.MotionLimits.for_robot(robot)
crate = es.Box((0.4, 0.4, 1.0), at=(1.6, 0.35, 0.5), name="crate")
walker = es.Cylinder(0.25, 1.7, at=(2.2, -2.0, 0.85), name="walker", motion=es.Twist(linear=(0.0, 0.8, 0.0)))
world = es.World(es.Scene([crate, walker]))

machine = MujocoPlant(robot, limits, world, seed=1)
machine.reset(robot.space.to_coordinates(robot.home()))
with es.Controller(robot, robot.home(), robot.home(x=3.0), world.at(0.0), limits=limits) as controller:
    t, measurement = 0.0, None
    while not controller.ended and t < 30.0:
        command = controller.step(t, measurement, world.at(t))  # a perception without errors
        measurement = machine.step(command, controller.params.control_dt)  # encoders, and where it localizes itself
        t = measurement.time
    print(f"{controller.state.label} after {t:.1f} s: {controller.reason}")
    off = 1e3 * np.hypot(*(controller.estimate[:2] - machine.coordinates[:2]))
    print(f"the robot believes to be {off:.0f} mm from where it is; it touched {len(machine.contact_events)} things")
machine.close()
