"""Tick benchmark: one control tick against Pinocchio's distances over every pair, and how it scales."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.planning import plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Obstacle, Scene
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, DeformParams, Strip

from .measure import Figures, Note, head, percentiles, silent

OBSTACLE_STEP = 0.02
"""How far the obstacle moves in a tick [m]."""
_COLD_TICK_PERIOD = 10  # of so many ticks, after one the baseline is timed
_NODE_COUNTS = (32, 64, 128, 256, 512, 1024)  # of strips whose ticks are timed
_OBSTACLE_COUNTS = (10, 100, 1000, 10_000, 60_000)  # of scenes


def bench_tick(robot: RobotModel, ticks: int = 200, step: Note = silent, *, scaling: bool = True) -> Figures:
    """A whole tick, certificate included, with an obstacle that moves 2 cm in each, on 64 nodes and 32 obstacles.

    After every tenth tick, in the same loop: ``pin.computeDistances`` over every pair on the nodes of the same strip.
    That empties the processor's caches, so the tick after it does not count: the benchmark measures a tick among ticks.

    Args:
        robot: the robot.
        ticks: number of measured ticks; 20 warm up.
        step: called now and then with a note.
        scaling: whether to measure the cost against nodes and obstacles too.
    """
    scene = get_scenario("corridor", seed=0).scene
    strip = _strip(robot, scene, 64)
    main = _measure(robot, strip, scene, ticks, baseline=True)
    step("tick")
    document: Figures = {
        **head("tick", robot=robot.name),
        "nodes": len(strip),
        "obstacles": len(scene),
        "links": len(robot.geometries),
        "ticks": ticks,
        **main,
    }
    if scaling:
        document["nodes_scaling"] = {}
        for n in _NODE_COUNTS:
            document["nodes_scaling"][str(n)] = _measure(robot, _strip(robot, scene, n), scene, max(ticks // 4, 20))[
                "tick_ms"
            ]
            step(f"{n} nodes")
        document["obstacles_scaling"] = {}
        near = Scene([*list(scene)[:2], *sorted(list(scene)[2:], key=lambda o: abs(o.pose[0, 3] - 4.0))[:8]])
        strip = _strip(robot, near, 64)
        for m in _OBSTACLE_COUNTS:
            crowd = Scene([*near, *_far(m - len(near))])
            document["obstacles_scaling"][str(m)] = _measure(robot, strip, crowd, max(ticks // 4, 20))["tick_ms"]
            step(f"{m} obstacles")
    return document


def _far(count: int) -> list[Obstacle]:
    """Boxes far from the corridor."""
    rng = np.random.default_rng(0)
    at = rng.uniform(-40.0, 40.0, (count, 3))
    at[:, 1] += np.where(at[:, 1] > 0, 8.0, -8.0)
    at[:, 2] = np.abs(at[:, 2]) * 0.05
    return [Box((0.1, 0.1, 0.1), at=p) for p in at]


def _params(nodes: int) -> DeformParams:
    return DeformParams(max_spacing=12.0 / nodes * 3.0, min_spacing=0.0)


def _strip(robot: RobotModel, scene: Scene, nodes: int) -> Strip:
    """A relaxed strip of exactly this many nodes."""
    problem = get_scenario("corridor", seed=0)
    start, goal = problem.ends(robot)
    planned = plan_report(robot, scene, start, goal, seed=0).strip
    space, v = robot.space, planned.velocities
    along = np.r_[0.0, np.cumsum(np.abs(v) @ np.where(np.arange(space.nv) < 3, 1.0, 0.25))]
    at = np.linspace(0.0, along[-1], nodes)
    j = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(v) - 1)
    s = (at - along[j]) / np.maximum(along[j + 1] - along[j], 1e-12)
    coordinates = space.integrate(planned.coordinates[j], s[:, None] * v[j])
    coordinates[0], coordinates[-1] = planned.coordinates[0], planned.coordinates[-1]
    deformer = Deformer(robot, _params(nodes))
    strip = Strip.from_coordinates(robot, coordinates)
    for _ in range(60):
        strip = deformer.step(strip, scene, nodes=False).strip
    return strip


def _measure(robot: RobotModel, strip: Strip, scene: Scene, ticks: int, *, baseline: bool = False) -> Figures:
    deformer = Deformer(robot, _params(len(strip)))
    name, direction = _mover(deformer, strip, scene)
    every_pair = _EveryPair(robot, scene) if baseline else None
    seconds, base, certified, queries = [], [], 0, 0
    phases: dict[str, list[float]] = {}
    warm, cold = 20, False
    for k in range(warm + ticks):
        sign = 1.0 if (k // 5) % 2 == 0 else -1.0
        pose = scene.obstacle(name).pose.copy()
        pose[:3, 3] += sign * OBSTACLE_STEP * direction
        scene = scene.moved(name, pose)
        _ = scene.table  # made by the perception, not by the tick
        began = perf_counter()
        report = deformer.step(strip, scene)
        elapsed = perf_counter() - began
        strip = report.strip
        if k < warm:
            continue
        if not cold:  # the caches are those of a tick, not of the baseline
            seconds.append(elapsed)
            for phase, value in report.timings.items():
                phases.setdefault(phase, []).append(value)
        cold = every_pair is not None and k % _COLD_TICK_PERIOD == 0
        certified += report.certified
        queries += report.queries
        if every_pair is not None and cold:
            base.append(every_pair.seconds(strip, name, pose))
    out: Figures = {
        "tick_ms": percentiles(seconds, scale=1e3),
        "certified": certified / ticks,
        "queries_per_tick": queries / ticks,
        "phases_ms": {p: float(np.sum(v) / len(seconds) * 1e3) for p, v in phases.items()},
        "phases_sum_ms": float(sum(np.sum(v) for v in phases.values()) / len(seconds) * 1e3),
        "tick_mean_ms": float(np.mean(seconds) * 1e3),
        "final_nodes": len(strip),
    }
    if every_pair is not None:
        out["every_pair"] = {"pairs_per_node": every_pair.pairs, "ms": percentiles(base, scale=1e3)}
        out["ratio_p50"] = float(np.median(seconds) / np.median(base))
    return out


def _mover(deformer: Deformer, strip: Strip, scene: Scene) -> tuple[str, Array]:
    """The obstacle nearest to the strip, and the horizontal direction towards it."""
    deformer.assess(strip, scene)
    contacts = deformer.workspace.obstacles.contacts()
    inner = np.flatnonzero((contacts.node > 5) & (contacts.node < len(strip) - 6))
    k = inner[int(np.argmin(contacts.distance[inner]))]
    return deformer.workspace.obstacles.obstacle_name(int(contacts.part[k])), contacts.direction[k] * [1.0, 1.0, 0.0]


class _EveryPair:
    """``pin.computeDistances`` over every pair of links and obstacles, and the robot's self pairs."""

    def __init__(self, robot: RobotModel, scene: Scene) -> None:
        self.robot = robot
        self.model = robot.collision_model.clone()
        links = len(robot.geometries)
        self.index: dict[str, list[tuple[int, Array]]] = {}
        for obstacle in scene:
            for part in obstacle.parts:
                T = obstacle.pose @ part.T_obstacle_part
                item = pin.GeometryObject(f"{obstacle.name}-part", 0, 0, pin.SE3(T[:3, :3], T[:3, 3]), part.geometry)
                index = self.model.addGeometryObject(item)
                self.index.setdefault(str(obstacle.name), []).append((index, part.T_obstacle_part))
                for link in range(links):
                    self.model.addCollisionPair(pin.CollisionPair(link, index))
        self.pairs = len(self.model.collisionPairs)
        self.data, self.geometry = robot.model.createData(), self.model.createData()

    def seconds(self, strip: Strip, name: str, pose: Array) -> float:
        for index, T_obstacle_part in self.index[name]:
            T = pose @ T_obstacle_part
            self.model.geometryObjects[index].placement = pin.SE3(T[:3, :3], T[:3, 3])
        began = perf_counter()
        for q in strip.q:
            pin.computeDistances(self.robot.model, self.data, self.model, self.geometry, q)
        return perf_counter() - began
