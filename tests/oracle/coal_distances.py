"""Distances of whole robots to scenes by Pinocchio and Coal alone, of the obstacles as a file would describe them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import result_check

from elastic_strips import RobotModel, Scene
from elastic_strips.io.obstacle_document import obstacle_documents
from elastic_strips.scene.quantities import rotation_of

Array = npt.NDArray[np.float64]


def coal_distances(robot: RobotModel, scene: Scene, configurations: Array) -> Array:
    """(K, links, obstacles) signed distances [m] at configurations (K, nq)."""
    model = robot.collision_model.clone()
    model.removeAllCollisionPairs()
    links = len(model.geometryObjects)
    for entry in obstacle_documents(scene):
        x, y, z, *quat = entry["pose"]
        pose = pin.SE3(rotation_of(np.array(quat)), np.array([x, y, z]))
        model.addGeometryObject(pin.GeometryObject(entry["name"], 0, 0, pose, result_check.shape(entry)))
    for link in range(links):
        for k in range(len(scene)):
            model.addCollisionPair(pin.CollisionPair(link, links + k))
    data, geometry = robot.model.createData(), model.createData()
    out = []
    for q in configurations:
        pin.computeDistances(robot.model, data, model, geometry, q)
        out.append([r.min_distance for r in geometry.distanceResults])
    return np.array(out).reshape(len(configurations), links, len(scene))
