"""Drake plans the problems of a folder: it has no sampling planner, so its kinematic trajectory optimization.

A B-spline must keep a distance at samples, first guessed as the straight line, then with random waves on it. Where
the result still touches in between, samples are added and the spline is optimized again from where it is.
"""

import json
import re
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pydrake.all as drake  # pyright: ignore[reportMissingImports]

folder = Path(sys.argv[1]).resolve()
given = json.loads((folder / "problems.json").read_text())
urdf, srdf = ((folder / name).read_text() for name in ("robot.urdf", "robot.srdf"))
controls, samples, rounds, rows = 12, 50, 3, np.linspace(0.0, 1.0, 100)
distance, influence = 0.002, 0.05  # [m] to keep; and beyond it, to be looked at
limits = {"iterations limit": 50, "step limit": 0.5, "feasibility tolerance": 1e-4, "optimality tolerance": 1e-2}
waves = np.array([np.sin(k * np.pi * np.linspace(0.0, 1.0, controls)) / k for k in (1, 2, 3)])


def as_obj(mesh):  # Drake reads no STL
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("flags", "<u2")])
    corners = np.frombuffer((folder / mesh).read_bytes()[84:], dtype=kind)["corners"].reshape(-1, 3)
    points, index = np.unique(corners, axis=0, return_inverse=True)
    text = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    text += [f"f {a} {b} {c}" for a, b, c in index.reshape(-1, 3) + 1]
    (folder / mesh).with_suffix(".obj").write_text("\n".join(text) + "\n")
    return (folder / mesh).with_suffix(".obj")


def shape_of(item):
    kinds = {"box": drake.Box, "sphere": drake.Sphere, "cylinder": drake.Cylinder}
    return kinds[item["shape"]](*item["size"]) if item["shape"] in kinds else drake.Convex(as_obj(item["mesh"]))


def checker_with(obstacles):
    builder = drake.RobotDiagramBuilder(time_step=0.0)
    plant = builder.plant()
    plant.set_adjacent_bodies_collision_filters(False)
    (robot,) = builder.parser().AddModelsFromString(urdf, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("ground"))
    for k, item in enumerate(obstacles):
        pose = drake.RigidTransform(np.array(item["pose"]))
        plant.RegisterCollisionGeometry(
            plant.world_body(), pose, shape_of(item), f"obstacle{k}", drake.CoulombFriction()
        )
    plant.Finalize()
    for pair in re.findall(r'<disable_collisions link1="([^"]+)" link2="([^"]+)"', srdf):
        links = (drake.GeometrySet(plant.GetCollisionGeometriesForBody(plant.GetBodyByName(name))) for name in pair)
        builder.scene_graph().collision_filter_manager().Apply(
            drake.CollisionFilterDeclaration().ExcludeBetween(*links)
        )
    return drake.SceneGraphCollisionChecker(model=builder.Build(), robot_model_instances=[robot], edge_step_size=0.02)


def optimized(checker, keep, ends, guess, until):
    plant = checker.plant()
    path = drake.KinematicTrajectoryOptimization(plant.num_positions(), controls, 4, 1.0)
    path.AddDurationConstraint(1.0, 1.0)
    path.AddPositionBounds(plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits())
    for q, at in zip(ends, (0.0, 1.0), strict=True):
        path.AddPathPositionConstraint(q, q, at)
    steps = np.diff(np.eye(controls), axis=0)
    for row in path.control_points():
        path.prog().AddQuadraticCost(0.002 * controls * steps.T @ steps, np.zeros(controls), row)
    touching = np.linspace(0.0, 1.0, samples)[1:-1]
    for _ in range(rounds):
        for at in touching:
            path.AddPathPositionConstraint(keep, at)
        options = drake.SolverOptions()
        for name, value in limits.items():
            options.SetOption(drake.SnoptSolver.id(), f"Major {name}", value)
        options.SetOption(drake.SnoptSolver.id(), "Time limit", max(until - time.perf_counter(), 0.01))
        path.prog().SetInitialGuess(path.control_points(), guess.T)
        path.prog().SetInitialGuess(path.duration(), 1.0)
        result = drake.SnoptSolver().Solve(path.prog(), path.prog().initial_guess(), options)
        q = path.ReconstructTrajectory(result).vector_values(rows).T
        q[[0, -1]] = ends
        touching = [r for r, a, b in zip(rows, q, q[1:], strict=False) if not checker.CheckEdgeCollisionFree(a, b)]
        if not 0 < len(touching) <= 15 or time.perf_counter() > until:
            return None if touching else q
        touching, guess = np.array(touching) + rows[1] / 2.0, result.GetSolution(path.control_points()).T
    return None


urdf = re.sub(r'package://([^"]+)', lambda found: f"file://{as_obj(found[1])}", urdf)
runs = []
for problem in [given["problems"][0], *given["problems"]]:  # the first one is not counted
    checker = checker_with(problem["obstacles"])
    plant = checker.plant()
    columns = [plant.GetJointByName(name).position_start() for name in given["joints"]]
    ends = np.array([problem["start"], problem["goal"]])[:, np.argsort(columns)]
    random = np.random.default_rng(1)
    began = time.perf_counter()
    keep = drake.MinimumDistanceLowerBoundConstraint(plant, distance, checker.plant_context(), None, influence)
    guess, found = np.linspace(ends[0], ends[1], controls), None
    while found is None and time.perf_counter() < began + given["timeout"]:
        found = optimized(checker, keep, ends, guess, began + given["timeout"])
        guess = np.linspace(ends[0], ends[1], controls) + waves.T @ random.normal(0.0, 0.25, (3, len(columns)))
        guess = np.clip(guess, plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits())
    ms = 1e3 * (time.perf_counter() - began)
    path = None if found is None else found[:, columns].tolist()
    runs.append({"ms": ms, "path": path, "reason": "" if found is not None else "no path in time"})
planner = f"trajectory optimization by SNOPT, {controls} control points, {1e3 * distance:.0f} mm at {samples} samples"
(folder / "answer.json").write_text(json.dumps({"version": version("drake"), "planner": planner, "runs": runs[1:]}))
