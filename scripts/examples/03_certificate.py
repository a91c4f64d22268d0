"""What a certificate says: which segments are proven clear, and where and why one is not."""

import numpy as np

import elastic_strips as es

robot = es.load_robot("silvermate")
straight = es.Strip(robot, [robot.home(x=x) for x in np.linspace(0.0, 4.0, 30)])
deformer = es.Deformer(robot, es.DeformParams(clearance=0.02))
for y in (1.0, 0.4, 0.2):
    certificate = deformer.certify(straight, es.Scene([es.Sphere(0.15, at=(2.0, y, 0.5), name="ball")]))
    proven = f"{certificate.segments.sum()} of {len(certificate.segments)} segments keep {certificate.clearance} m"
    print(f"ball at y = {y}: {proven}; {certificate.broken or 'certified'}")
