"""TrajOpt plans the problems of a folder, as Tesseract wraps it: from the straight line, then with random waves on it.

Its paths are looked at once more every 2 cm or 0.02 rad with Tesseract's contact checker; what touches is not taken.
"""

import json
import sys
import time
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import numpy as np
import tesseract_robotics.tesseract_collision as collision  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_command_language as language  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_common as common  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_environment as world  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_geometry as geometry  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_motion_planners as planners  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_motion_planners_simple as simple  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_motion_planners_trajopt as trajopt  # pyright: ignore[reportMissingImports]
import tesseract_robotics.tesseract_scene_graph as graph  # pyright: ignore[reportMissingImports]

folder = Path(sys.argv[1]).resolve()
given = json.loads((folder / "problems.json").read_text())
steps, stride = 20, 0.02
waves = np.array([np.sin(k * np.pi * np.linspace(0.0, 1.0, steps + 1)) / k for k in (1, 2, 3)])
libraries = Path(str(common.__file__)).parents[2] / "tesseract_robotics.libs"
bullet = next(libraries.glob("libtesseract_collision_bullet_factories*")).stem.removeprefix("lib")
plugins: dict[str, object] = {"search_paths": [str(libraries)], "search_libraries": [bullet]}
for kind, manager in (("discrete", "BulletDiscreteBVHManager"), ("continuous", "BulletCastBVHManager")):
    plugins[f"{kind}_plugins"] = {"default": manager, "plugins": {manager: {"class": f"{manager}Factory"}}}
(folder / "plugins.yaml").write_text(json.dumps({"contact_manager_plugins": plugins}))  # JSON is YAML
checkers = f'<contact_managers_plugin_config filename="file://{folder / "plugins.yaml"}" /></robot>'
srdf = (folder / "robot.srdf").read_text().replace("<robot ", '<robot version="1.0.0" ').replace("</robot>", checkers)
urdf = (folder / "robot.urdf").read_text().replace("package://", f"file://{folder}/")
locator = common.GeneralResourceLocator()
# what the package's own OptimizeProblem calls; that one adds a plotter which is then refused
optimize = trajopt.tesseract_motion_planners_trajopt_python._tesseract_motion_planners_trajopt_python.OptimizeProblem


def shape_of(item):
    kinds = {"box": geometry.Box, "sphere": geometry.Sphere, "cylinder": geometry.Cylinder}
    if item["shape"] == "mesh":
        return geometry.createConvexMeshFromPath(str(folder / item["mesh"]), np.ones(3), True, False)[0]
    return kinds[item["shape"]](*item["size"])


def environment_with(obstacles):
    environment = world.Environment()
    environment.init(urdf, srdf, locator)
    for k, item in enumerate(obstacles):
        link, body, joint = graph.Link(f"obstacle{k}"), graph.Collision(), graph.Joint(f"joint_obstacle{k}")
        body.geometry, body.origin = shape_of(item), common.Isometry3d(np.array(item["pose"]))
        link.collision.append(body)
        joint.type, joint.parent_link_name, joint.child_link_name = graph.JointType_FIXED, "ground", f"obstacle{k}"
        environment.applyCommand(world.AddLinkCommand(link, joint, False))
    return environment


def construct(environment, names, ends):
    info = common.ManipulatorInfo()
    info.manipulator, info.working_frame = "all", "ground"
    info.tcp_frame = environment.getActiveLinkNames()[0]
    program = language.CompositeInstruction("DEFAULT")
    program.setManipulatorInfo(info)
    for q in ends:
        point = language.JointWaypointPoly_wrap_JointWaypoint(language.JointWaypoint(names, q))
        move = language.MoveInstruction(point, language.MoveInstructionType_FREESPACE, "DEFAULT")
        program.appendMoveInstruction(language.MoveInstructionPoly_wrap_MoveInstruction(move))
    whole = trajopt.TrajOptDefaultCompositeProfile()
    whole.smooth_accelerations = whole.smooth_jerks = False
    for term in (whole.collision_cost_config, whole.collision_constraint_config):
        term.use_weighted_sum, term.coeff = True, 1.0  # as is advised there; with 20 and each by itself OSQP fails
    whole.collision_constraint_config.safety_margin = 0.004  # what a robot keeps to itself may be less than 1 cm
    request = planners.PlannerRequest()
    request.env, request.profiles = environment, language.ProfileDictionary()
    for profile in (trajopt.TrajOptDefaultPlanProfile(), whole):
        request.profiles.addProfile("TrajOpt", "DEFAULT", profile)
    request.instructions = simple.generateInterpolatedProgram(program, environment, 100.0, 100.0, 100.0, steps)
    return trajopt.ConstructProblem(trajopt.TrajOptMotionPlanner("TrajOpt").createProblem(request))


def touches(environment, names, path):
    contacts, solver = environment.getDiscreteContactManager(), environment.getStateSolver()
    contacts.setActiveCollisionObjects(environment.getActiveLinkNames())
    contacts.setCollisionMarginData(common.CollisionMarginData(0.0))
    for a, b in pairwise(path):
        for q in np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / stride)):
            state = solver.getState(names, q)  # is kept: its transforms are only borrowed
            contacts.setCollisionObjectsTransform(state.link_transforms)
            found = collision.ContactResultMap()
            contacts.contactTest(found, collision.ContactRequest(collision.ContactTestType_FIRST))
            if found.count() > 0:
                return True
    return False


runs = []
for problem in [given["problems"][0], *given["problems"]]:  # the first one is not counted
    environment = environment_with(problem["obstacles"])
    group = environment.getJointGroup("all")
    names, (lower, upper) = group.getJointNames(), np.array(group.getLimits().joint_limits).T
    order = [given["joints"].index(name) for name in names]
    ends = np.array([problem["start"], problem["goal"]])[:, order]
    random = np.random.default_rng(1)
    began = time.perf_counter()
    construction = construct(environment, names, ends)
    guess, found = np.linspace(ends[0], ends[1], steps + 1), None
    while found is None and time.perf_counter() < began + given["timeout"]:
        construction.SetInitTraj(guess)
        path = np.array(optimize(construction).traj)
        found = None if touches(environment, names, path) else path
        guess = np.linspace(ends[0], ends[1], steps + 1) + waves.T @ random.normal(0.0, 0.25, (3, len(order)))
        guess = guess.clip(lower, upper)
    ms = 1e3 * (time.perf_counter() - began)
    path = None if found is None else found[:, np.argsort(order)].tolist()
    runs.append({"ms": ms, "path": path, "reason": "" if found is not None else "no path in time"})
planner = f"TrajOpt, {steps} steps, 4 mm as a constraint and 25 mm as a cost; from a line, then from waves on it"
answer = {"version": version("tesseract-robotics"), "planner": planner, "runs": runs[1:]}
(folder / "answer.json").write_text(json.dumps(answer))
