"""From laser scans to a scene: what stands becomes a map, what moves a track with a velocity."""

import numpy as np

import elastic_strips as es
from elastic_strips.perception import SceneEstimator
from elastic_strips.sim.sensors import SensorConfig, SensorSuite

robot = es.load_robot("silvermate")
wall = es.Box((0.1, 6.0, 1.5), at=(4.0, 0.0, 0.75), name="wall")
person = es.Cylinder(0.2, 1.7, at=(3.0, -1.5, 0.85), name="person", motion=es.Twist(linear=(0.0, 0.6, 0.0)))
laser = SensorSuite(robot, es.World(es.Scene([wall, person])), SensorConfig().only("laser"), seed=1)
estimator, here = SceneEstimator(), robot.space.to_coordinates(robot.home())  # the robot stands
for step in range(200):
    for reading in laser.observe(0.01 * step, here):
        estimator.update(reading, here[:3])  # the pose (x, y, yaw) that it was taken at
scene = estimator.scene()
print(f"{len(scene.names)} obstacles at {scene.time:.2f} s")
for mover in estimator.movers:
    print(f"{mover.name} at {np.round(mover.position, 2)} m moves at {np.round(mover.velocity, 2)} m/s")
