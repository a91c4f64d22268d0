"""RoboPlan plans the problems of a folder: RRT-Connect as its examples set it."""

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
from roboplan.core import (  # pyright: ignore[reportMissingImports]
    Box,
    Cylinder,
    JointConfiguration,
    Mesh,
    Scene,
    Sphere,
    loadUrdfSceneDescription,
)
from roboplan.rrt import RRT, RRTOptions  # pyright: ignore[reportMissingImports]

folder = Path(sys.argv[1])
given = json.loads((folder / "problems.json").read_text())
color = np.array([0.5, 0.5, 0.5, 1.0])


def scene_with(obstacles):
    scene = Scene("peer", loadUrdfSceneDescription(folder / "robot.urdf", [folder]))
    scene.importSrdf((folder / "robot.srdf").read_text())
    for k, item in enumerate(obstacles):
        name, pose, size = f"obstacle{k}", np.array(item["pose"]), item["size"]
        if item["shape"] == "box":
            scene.addBoxGeometry(name, "universe", Box(*size), pose, color)
        elif item["shape"] == "sphere":
            scene.addSphereGeometry(name, "universe", Sphere(*size), pose, color)
        elif item["shape"] == "cylinder":
            scene.addCylinderGeometry(name, "universe", Cylinder(*size), pose, color)
        else:
            scene.addMeshGeometry(name, "universe", Mesh(folder / item["mesh"]), pose, color)
    for k in range(len(obstacles)):  # what stands may touch what stands
        for m in range(k):
            scene.setCollisions(f"obstacle{k}", f"obstacle{m}", False)
    return scene


def configuration(values):
    out = JointConfiguration()
    out.positions = np.array(values)
    return out


runs = []
for problem in [given["problems"][0], *given["problems"]]:  # the first one is not counted
    scene = scene_with(problem["obstacles"])
    options = RRTOptions()
    options.group_name = "all"
    options.rrt_connect = True
    options.max_nodes = 100_000
    options.max_connection_distance = 1.0
    options.collision_check_step_size = 0.05
    options.max_planning_time = given["timeout"]
    order = [scene.getJointGroupInfo("all").joint_names.index(name) for name in given["joints"]]
    inside = np.argsort(order)
    began = time.perf_counter()
    path, reason = None, ""
    try:
        planner = RRT(scene, options)
        planner.setRngSeed(1)
        start, goal = (configuration(np.array(problem[end])[inside]) for end in ("start", "goal"))
        found = planner.plan(start, goal)
        path = None if found is None else [np.asarray(q)[order].tolist() for q in found.positions]
    except RuntimeError as error:
        reason = str(error)
    runs.append({"ms": 1e3 * (time.perf_counter() - began), "path": path, "reason": reason})
answer = {"version": version("roboplan"), "planner": "RRT-Connect, checks every 0.05 rad", "runs": runs[1:]}
(folder / "answer.json").write_text(json.dumps(answer))
