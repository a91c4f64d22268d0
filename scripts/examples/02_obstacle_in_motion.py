"""Tick by tick: the strip gives way to somebody who walks across, and stays certified."""

import numpy as np

import elastic_strips as es

robot = es.load_robot("silvermate")
person = es.Cylinder(0.25, 1.7, at=(2.5, -2.5, 0.85), name="person", motion=es.Twist(linear=(0.0, 0.5, 0.0)))
scene = es.Scene([person])
strip = es.plan(robot, es.Scene([]), start=robot.home(), goal=robot.home(x=5.0))
deformer = es.Deformer(robot)
for tick in range(500):
    report = deformer.step(strip, scene.at(0.02 * tick))  # at 50 Hz, with the scene as it is then
    strip = report.strip
    if tick % 100 == 0:
        aside = np.abs(strip.q[:, 1]).max()
        print(f"{0.02 * tick:4.1f} s: certified {report.certified}, at most {aside:.2f} m aside")
