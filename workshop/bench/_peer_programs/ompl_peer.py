"""OMPL plans the problems of a folder: RRT-Connect with its defaults, Pinocchio and Coal for what is valid.

As ``ompl_simplified`` it also simplifies each path that it finds, as OMPL's ``SimpleSetup`` does and MoveIt has it do.
The robot's and the scene's shapes are there before the clock starts; what is made for the two together (the placed
shapes and the tree of their boxes) counts, as it does here.
"""

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import cast

import coal
import numpy as np
import pinocchio as pin
from ompl import base as ob
from ompl import geometric as og

folder, simplified = Path(sys.argv[1]), sys.argv[2] == "ompl_simplified"
given = json.loads((folder / "problems.json").read_text())
model = pin.buildModelFromUrdf(str(folder / "robot.urdf"))
columns = [model.joints[model.getJointId(name)].idx_q for name in given["joints"]]


def shape_of(item):
    size = item["size"]
    if item["shape"] == "box":
        return coal.Box(*size)
    if item["shape"] == "sphere":
        return coal.Sphere(*size)
    if item["shape"] == "cylinder":
        return coal.Cylinder(*size)
    mesh = coal.MeshLoader().load(str(folder / item["mesh"]), np.ones(3))
    mesh.buildConvexHull(False, "Qt")
    return mesh.convex


def world(obstacles):
    geometry = pin.buildGeomFromUrdf(model, str(folder / "robot.urdf"), pin.GeometryType.COLLISION, [str(folder)])
    for item in geometry.geometryObjects:
        if isinstance(item.geometry, coal.BVHModelBase):
            item.geometry.buildConvexHull(False, "Qt")
            item.geometry = item.geometry.convex
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(model, geometry, str(folder / "robot.srdf"))
    links = geometry.ngeoms
    for k, item in enumerate(obstacles):
        pose = pin.SE3(np.array(item["pose"]))
        index = geometry.addGeometryObject(pin.GeometryObject(f"obstacle{k}", 0, pose, shape_of(item)))
        for link in range(links):
            geometry.addCollisionPair(pin.CollisionPair(link, index))
    return geometry


count = len(columns)


def row(state):
    return np.array(state[0:count]).tolist()


runs = []
for problem in [given["problems"][0], *given["problems"]]:  # the first one is not counted
    geometry = world(problem["obstacles"])
    began = time.perf_counter()
    data, placed = model.createData(), geometry.createData()
    tree = pin.TreeBroadPhaseManager_DynamicAABBTreeCollisionManager(model, geometry, placed)
    q = pin.neutral(model)

    def valid(state, data=data, tree=tree, q=q):
        q[columns] = state[0:count]
        return not pin.computeCollisions(model, data, tree, q, True)

    space = ob.RealVectorStateSpace(count)
    bounds = ob.RealVectorBounds(count)
    for k, column in enumerate(columns):
        bounds.setLow(k, float(model.lowerPositionLimit[column]))
        bounds.setHigh(k, float(model.upperPositionLimit[column]))
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(valid)
    start, goal = (cast("ob.RealVectorStateType", space.allocState()) for _ in range(2))
    for state, values in ((start, problem["start"]), (goal, problem["goal"])):
        for k, value in enumerate(values):
            state[k] = value
    setup.setStartAndGoalStates(start, goal, 1e-9)
    setup.setPlanner(og.RRTConnect(setup.getSpaceInformation()))
    found = setup.solve(given["timeout"]) and setup.haveExactSolutionPath()
    if found and simplified:
        setup.simplifySolution()
    ms = 1e3 * (time.perf_counter() - began)
    path = [row(state) for state in setup.getSolutionPath().getStates()] if found else None
    runs.append({"ms": ms, "path": path, "reason": "" if found else "no path in time"})
planner = f"RRT-Connect{', simplified' if simplified else ''}, motions checked at 1 % of the space"
answer = {"version": version("ompl"), "planner": planner, "runs": runs[1:]}
(folder / "answer.json").write_text(json.dumps(answer))
