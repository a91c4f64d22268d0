"""MPlib plans the problems of a folder: its RRT-Connect with the defaults of `plan_qpos`, before retiming."""

import json
import sys
import time
from importlib.metadata import version
from pathlib import Path

import mplib  # pyright: ignore[reportMissingImports]
import numpy as np
from mplib.collision_detection import fcl  # pyright: ignore[reportMissingImports]

folder = Path(sys.argv[1])
given = json.loads((folder / "problems.json").read_text())


def collision_object(k, item):
    size = item["size"]
    if item["shape"] == "box":
        shape = fcl.Box(size)
    elif item["shape"] == "sphere":
        shape = fcl.Sphere(size[0])
    elif item["shape"] == "cylinder":
        shape = fcl.Cylinder(size[0], size[1])
    else:
        shape = fcl.load_mesh_as_Convex(str(folder / item["mesh"]), np.ones(3))
    shapes, poses = [fcl.CollisionObject(shape)], [mplib.Pose(np.array(item["pose"]))]
    return fcl.FCLObject(f"obstacle{k}", mplib.Pose(), shapes, poses)


runs = []
for problem in [given["problems"][0], *given["problems"]]:  # the first one is not counted
    objects = [collision_object(k, item) for k, item in enumerate(problem["obstacles"])]
    planner = mplib.Planner(
        str(folder / "robot.urdf"),
        f"link_{len(given['joints']) - 3}",
        srdf=str(folder / "robot.srdf"),
        new_package_keyword="",
        use_convex=True,
        user_joint_names=given["joints"],
        objects=objects,
    )
    for k in range(len(objects)):  # what stands may touch what stands
        for m in range(k):
            planner.planning_world.get_allowed_collision_matrix().set_entry(f"obstacle{k}", f"obstacle{m}", True)
    start, goal = np.array(problem["start"]), np.array(problem["goal"])
    planner.robot.set_qpos(start, True)
    began = time.perf_counter()
    status, path = planner.planner.plan(start, [goal], time=given["timeout"], range=0.1, simplify=True)
    ms = 1e3 * (time.perf_counter() - began)
    solved = status == "Exact solution"
    runs.append({"ms": ms, "path": np.asarray(path).tolist() if solved else None, "reason": "" if solved else status})
answer = {
    "version": version("mplib"),
    "planner": "RRT-Connect of OMPL, with FCL: range 0.1, simplified",
    "runs": runs[1:],
}
(folder / "answer.json").write_text(json.dumps(answer))
