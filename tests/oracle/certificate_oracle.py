"""Certificate oracle: are certified segments free of collision when they are sampled densely?

Random segments of Silvermate and TIAGo among random obstacles of every shape are certified by the library and walked
along ``pin.interpolate`` in steps in which no point of the robot moves more than a millimetre. Every pair of a link
with an obstacle's convex shape (and of two links) is measured by Coal at Pinocchio's placements, except where the
boxes about them at that sample are further apart than the distance of interest, or where the way since their last
measurement is shorter than what was measured. Nothing of the library's proximity or motion bounds is used.

    python tests/oracle/certificate_oracle.py --count 20000 --processes 2
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from brute_force import Array, configuration, make_obstacle, random_pose, scene_pieces, transform

from elastic_strips.planning import straight_line
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Obstacle, Scene
from elastic_strips.strip import Deformer, DeformParams, Strip

STEP = 1e-3
"""No point of the robot moves further [m] between two samples."""
FREE = 0.02
"""A segment with this clearance [m] counts as truly free."""
_REACH = FREE + 1e-3
_PER_SCENE = 24
_SHAPES = ("box", "sphere", "cylinder", "capsule", "cone", "convex", "mesh", "voxels", "points", "plate", "pole")


@dataclass
class Figures:
    """What the oracle found, by number of segments.

    ``collisions`` and ``shortfalls``: certified, but a sample is in collision, or nearer than what was certified;
    ``false_alarms``: refused for certain without cause.
    """

    segments: int = 0
    certified: int = 0
    refused: int = 0
    refused_certain: int = 0
    colliding: int = 0
    free: int = 0
    free_certified: int = 0
    samples: int = 0
    measured: int = 0
    seconds: float = 0.0
    collisions: list[str] = field(default_factory=list)
    shortfalls: list[str] = field(default_factory=list)
    false_alarms: list[str] = field(default_factory=list)

    @property
    def free_fraction(self) -> float:
        """Share of the truly free segments that were certified."""
        return self.free_certified / max(self.free, 1)

    def add(self, other: Figures) -> None:
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    def __str__(self) -> str:
        return (
            f"{self.segments} segments, {self.certified} certified, {self.refused} refused "
            f"({self.refused_certain} of them for certain), {self.colliding} collide when sampled, "
            f"{self.free} free by 2 cm of which {100 * self.free_fraction:.2f} % certified; "
            f"{len(self.collisions)} certified with a collision, {len(self.shortfalls)} nearer than certified, "
            f"{len(self.false_alarms)} refused for certain without cause; "
            f"{self.samples} samples, {self.measured} exact distances, {self.seconds:.0f} s"
        )


class Sampler:
    """Walks segments of one robot densely and measures by brute force."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self.data = robot.model.createData()
        self.measured = 0
        self.samples = 0
        self._request, self._result = coal.DistanceRequest(True), coal.DistanceResult()
        self.joint = np.array([g.joint for g in robot.geometries])
        self.shapes = [g.geometry for g in robot.geometries]
        self.placement = np.array([g.placement for g in robot.geometries])
        signs = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
        corners = []
        for piece in robot.geometries:
            piece.geometry.computeLocalAABB()
            low, high = np.array(piece.geometry.aabb_local.min_), np.array(piece.geometry.aabb_local.max_)
            corners.append(low + signs * (high - low))
        self.corners = np.array(corners)  # (G, 8, 3) in the shapes' frames: each link lies in their hull
        self.scene: Scene | None = None

    def poses(self, a: Array, b: Array, count: int) -> Array:
        """World poses (S, G, 4, 4) of the links at ``count`` samples."""
        model, data = self.robot.model, self.data
        joints = np.tile(np.eye(4), (count, model.njoints, 1, 1))
        for k, s in enumerate(np.linspace(0.0, 1.0, count)):
            pin.forwardKinematics(model, data, pin.interpolate(model, a, b, float(s)))
            for i in range(1, model.njoints):
                T = data.oMi[i]
                joints[k, i, :3, :3], joints[k, i, :3, 3] = T.rotation, T.translation
        return joints[:, self.joint] @ self.placement

    def _boxes(self, poses: Array) -> Array:
        """World corners (S, G, 8, 3) of boxes that hold the links."""
        turned = np.matmul(self.corners, poses[:, :, :3, :3].transpose(0, 1, 3, 2))
        return turned + poses[:, :, None, :3, 3]

    def walk(self, a: Array, b: Array) -> tuple[Array, Array, Array]:
        """Poses (S, G, 4, 4), box corners (S, G, 8, 3), and how far (S, G) each link moved in all since the start."""
        count = 17
        while True:
            poses = self.poses(a, b, count)
            world = self._boxes(poses)
            # the motion of a rigid body is convex in the point: the corners of a box about it move furthest
            step = np.linalg.norm(np.diff(world, axis=0), axis=3).max(axis=2)
            largest = float(step.max())
            if largest <= STEP:
                way = np.vstack([np.zeros((1, step.shape[1])), np.cumsum(step, axis=0)])
                self.samples += count
                return poses, world, way
            count = int(np.ceil((count - 1) * largest / STEP * 1.02)) + 2

    def take_scene(self, scene: Scene) -> None:
        if scene is self.scene:
            return
        self.scene = scene
        self.pieces = scene_pieces(scene)
        self.transforms = [transform(p.T) for p in self.pieces]
        low, high = [], []
        for p in self.pieces:
            p.geometry.computeLocalAABB()
            box = p.geometry.aabb_local
            c, h = 0.5 * (np.array(box.max_) + np.array(box.min_)), 0.5 * (np.array(box.max_) - np.array(box.min_))
            center, half = p.T[:3, :3] @ c + p.T[:3, 3], np.abs(p.T[:3, :3]) @ h
            low.append(center - half)
            high.append(center + half)
        self.low, self.high = np.array(low).reshape(-1, 3), np.array(high).reshape(-1, 3)

    def _smallest(self, one: Any, two: Any, near: Array, way: Array, T_one: Any, T_two: Any, best: float) -> float:
        """Smallest distance of a pair over samples ``near``; those that the way since the last measurement rules out
        to be below ``best`` are left out."""
        last, value = -1, 0.0
        for s in near.tolist():
            if last >= 0 and value - (way[s] - way[last]) > best:
                continue
            self._result.clear()
            value = coal.distance(one, T_one(s), two, T_two(s), self._request, self._result)
            self.measured += 1
            last = s
            best = min(best, value)
        return best

    def at(self, q: Array) -> float:
        """Smallest distance [m] of one configuration, at most 2.1 cm."""
        poses = self.poses(q, q, 1)
        return min(self._clearances(poses, self._boxes(poses), np.zeros((1, len(self.shapes)))))

    def clearances(self, a: Array, b: Array) -> tuple[float, float]:
        """Smallest distance [m] to obstacles and between self pairs over the dense samples, at most 2.1 cm."""
        return self._clearances(*self.walk(a, b))

    def _clearances(self, poses: Array, world: Array, way: Array) -> tuple[float, float]:
        low, high = world.min(axis=2), world.max(axis=2)  # (S, G, 3)
        cache: dict[tuple[int, int], Any] = {}

        def placed(g: int) -> Any:
            """The link's transform by sample, made where it is needed."""

            def at(s: int) -> Any:
                if (s, g) not in cache:
                    cache[s, g] = transform(poses[s, g])
                return cache[s, g]

            return at

        def standing(p: int) -> Any:
            return lambda s: self.transforms[p]

        obstacle = own = _REACH
        swept_low, swept_high = low.min(axis=0) - _REACH, high.max(axis=0) + _REACH
        overlap = (swept_low[:, None] <= self.high) & (swept_high[:, None] >= self.low)
        for g, p in np.argwhere(overlap.all(axis=2)).tolist():
            gap = np.maximum(low[:, g] - self.high[p], self.low[p] - high[:, g]).max(axis=1)
            near = np.flatnonzero(gap < obstacle)
            if len(near):
                obstacle = self._smallest(
                    self.shapes[g], self.pieces[p].geometry, near, way[:, g], placed(g), standing(p), obstacle
                )
        for i, k in self.robot.self_pairs.tolist():
            gap = np.maximum(low[:, i] - high[:, k], low[:, k] - high[:, i]).max(axis=1)
            near = np.flatnonzero(gap < own)
            if len(near):
                total = way[:, i] + way[:, k]
                own = self._smallest(self.shapes[i], self.shapes[k], near, total, placed(i), placed(k), own)
        return obstacle, own


def random_obstacle(shape: str, rng: np.random.Generator, low: Any, high: Any) -> Obstacle:
    """An obstacle of any shape; plates and poles are thin enough to be jumped over."""
    at, quat = random_pose(rng, low, high)
    if shape == "plate":
        return Box((rng.uniform(0.2, 0.8), 0.006, rng.uniform(0.2, 0.8)), at=at, quat=quat)
    if shape == "pole":
        return Cylinder(0.005, rng.uniform(0.3, 1.5), at=at, quat=quat)
    return make_obstacle(shape, rng, low, high)


def random_scene(rng: np.random.Generator) -> Scene:
    low, high = (-2.0, -2.0, 0.0), (2.0, 2.0, 1.5)
    return Scene([random_obstacle(str(s), rng, low, high) for s in rng.choice(_SHAPES, rng.integers(6, 13))])


def random_start(robot: RobotModel, scene: Scene, rng: np.random.Generator) -> Array:
    """A coordinate row (nv,) beside an obstacle, with a random posture or one near home."""
    space, home = robot.space, robot.space.to_coordinates(robot.home_q)
    row = home.copy()
    obstacle = scene.obstacles[rng.integers(len(scene))]
    angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 1.2)
    row[:2] = obstacle.pose[:2, 3] + far * np.array([np.cos(angle), np.sin(angle)])
    row[2] = rng.uniform(-np.pi, np.pi)
    if rng.random() < 0.3:
        row[3:] = rng.uniform(space.lower[3:], space.upper[3:])
    else:
        row[3:] = np.clip(home[3:] + rng.normal(size=space.nv - 3) * 0.3, space.lower[3:], space.upper[3:])
    return row


def random_motion(robot: RobotModel, kind: str, rng: np.random.Generator) -> Array:
    """A tangent vector (nv,): a drive, a turn, a motion of the arm, …"""
    nv = robot.space.nv
    v = np.zeros(nv)
    if kind == "tiny":
        return rng.normal(size=nv) * 1e-3
    if kind in ("drive", "all"):
        v[0], v[2] = rng.normal() * 0.4, rng.normal() * 0.4
    if kind == "slide":
        v[:2] = rng.normal(size=2) * 0.5
    if kind == "turn":
        v[2] = rng.normal() * 1.2
    if kind in ("arm", "all"):
        v[3:] = rng.normal(size=nv - 3) * rng.choice([0.1, 0.4, 1.0]) * (rng.random(nv - 3) < 0.5)
    return v


KINDS = ("drive", "turn", "arm", "arm", "all", "tiny", "slide")


def random_strip(robot: RobotModel, scene: Scene, sampler: Sampler, rng: np.random.Generator) -> Array:
    """Coordinate rows (2 to 5, nv) of a short way near the obstacles.

    Most starts are free. Of every two, one way is searched for whose ends are free and which passes through something
    or closely by it: the kind that a wrong bound would let through.
    """
    space = robot.space
    hard = rng.random() < 0.5
    for _ in range(60 if hard else 12):
        row = random_start(robot, scene, rng)
        if sampler.at(configuration(robot, row)) <= 0.002:
            continue
        rows = [row]
        for _ in range(1 if hard or rng.random() < 0.75 else 4):
            v = random_motion(robot, str(rng.choice(KINDS)), rng)
            rows.append(np.clip(space.integrate(rows[-1], v), space.lower, space.upper))
        if not hard:
            break
        a, b = (configuration(robot, r) for r in rows)
        if sampler.at(b) <= 0.005:
            continue
        inner = [sampler.at(pin.interpolate(robot.model, a, b, s)) for s in (0.2, 0.35, 0.5, 0.65, 0.8)]
        if min(inner) < 0.01:
            break
    else:
        rows = [random_start(robot, scene, rng)]
        rows.append(np.clip(space.integrate(rows[0], random_motion(robot, "all", rng)), space.lower, space.upper))
    return np.array(rows)


def _warm(deformer: Deformer, robot: RobotModel, scene: Scene, coordinates: Array, rng: np.random.Generator) -> None:
    """Give the workspace a history: the same strip a little off, or an obstacle elsewhere."""
    space = robot.space
    if rng.random() < 0.5:
        off = rng.normal(size=coordinates.shape) * 10.0 ** rng.uniform(-6, -1.5)
        moved = np.clip(space.integrate(coordinates, off), space.lower, space.upper)
        deformer.certify(Strip(robot, space.from_coordinates(moved)), scene)
    if rng.random() < 0.3:
        at, quat = random_pose(rng, (-2, -2, 0), (2, 2, 1.5))
        pose = pin.XYZQUATToSE3(np.r_[at, quat]).homogeneous
        other = scene.moved(str(rng.choice(scene.names)), pose)
        deformer.certify(Strip(robot, space.from_coordinates(coordinates)), other)


def run(count: int, seed: int, names: tuple[str, ...] = ("silvermate", "tiago")) -> Figures:
    """Certify and sample ``count`` segments of these robots in turn."""
    began, rng, figures = perf_counter(), np.random.default_rng(seed), Figures()
    params = DeformParams()
    robots = [load_robot(name) for name in names]
    benches = [(robot, Deformer(robot, params), Sampler(robot)) for robot in robots]
    turn = 0
    while figures.segments < count:
        robot, deformer, sampler = benches[turn % len(benches)]
        turn += 1
        scene = random_scene(rng)
        sampler.take_scene(scene)
        done = 0
        while done < _PER_SCENE and figures.segments < count:
            coordinates = random_strip(robot, scene, sampler, rng)
            _warm(deformer, robot, scene, coordinates, rng)
            strip = Strip(robot, robot.space.from_coordinates(coordinates))
            certificate = deformer.certify(strip, scene)
            for j, (a, b) in enumerate(pairwise(strip.q)):
                obstacle, own = sampler.clearances(a, b)
                _count(
                    figures, certificate, j, obstacle, own, params, f"{robot.name}, seed {seed}, strip {turn}.{done}"
                )
                done += 1
    figures.samples = sum(s.samples for _, _, s in benches)
    figures.measured = sum(s.measured for _, _, s in benches)
    figures.seconds = perf_counter() - began
    return figures


def run_ticks(count: int, seed: int, names: tuple[str, ...] = ("silvermate", "tiago")) -> Figures:
    """Sample ``count`` segments of strips that deform among moving obstacles, with all caches and edits at work."""
    began, rng, figures = perf_counter(), np.random.default_rng(seed), Figures()
    params = DeformParams()
    benches = [(robot, Sampler(robot)) for robot in (load_robot(name) for name in names)]
    turn = 0
    while figures.segments < count:
        robot, sampler = benches[turn % len(benches)]
        turn += 1
        length = 3.0
        obstacles = []
        for shape in rng.choice(_SHAPES, rng.integers(2, 7)):
            at = np.array([rng.uniform(0.6, length - 0.6), rng.choice([-1, 1]) * rng.uniform(0.3, 1.0), 0.0])
            obstacles.append(random_obstacle(str(shape), rng, at, at + np.array([0.01, 0.01, 1.2])))
        scene = Scene(obstacles)
        start, goal = robot.home(), robot.home(x=length, y=rng.uniform(-0.4, 0.4), yaw=rng.uniform(-0.5, 0.5))
        strip = Strip.from_coordinates(robot, straight_line(robot, start, goal, spacing=rng.uniform(0.1, 0.2)))
        deformer = Deformer(robot, params)
        for tick in range(12):
            report = deformer.step(strip, scene)
            strip = report.strip
            sampler.take_scene(scene)
            chosen = rng.choice(len(strip) - 1, min(4, len(strip) - 1), replace=False)
            for j in chosen.tolist():
                obstacle, own = sampler.clearances(strip.q[j], strip.q[j + 1])
                where = f"{robot.name}, seed {seed}, strip {turn}, tick {tick}"
                _count(figures, report.certificate, j, obstacle, own, params, where)
            if rng.random() < 0.6:
                name = str(rng.choice(scene.names))
                pose = scene.obstacle(name).pose.copy()
                pose[:3, 3] += rng.normal(size=3) * rng.choice([1e-4, 0.01, 0.05, 0.3])
                scene = scene.moved(name, pose)
    figures.samples = sum(s.samples for _, s in benches)
    figures.measured = sum(s.measured for _, s in benches)
    figures.seconds = perf_counter() - began
    return figures


def _count(
    figures: Figures, certificate: Any, j: int, obstacle: float, own: float, params: DeformParams, where: str
) -> None:
    sound = 2e-5  # what Coal's distances scatter by
    text = f"{where}, segment {j}: {1000 * obstacle:.4f} mm to obstacles, {1000 * own:.4f} mm between links"
    figures.segments += 1
    collides = min(obstacle, own) <= 0.0
    figures.colliding += collides
    free = min(obstacle, own) >= FREE
    figures.free += free
    if certificate.segments[j]:
        figures.certified += 1
        figures.free_certified += free
        if collides:
            figures.collisions.append(text)
        if obstacle < params.clearance - sound or own < params.self_clearance - sound:
            figures.shortfalls.append(text)
    else:
        figures.refused += 1
        certain = int(certificate.states[j]) == 2
        figures.refused_certain += certain
        if certain and obstacle > params.clearance + 2e-3 and own > params.self_clearance + 2e-3:
            figures.false_alarms.append(text)


def run_all(count: int, seed: int, processes: int = 1, *, ticks: bool = False) -> Figures:
    """Like :func:`run`, or :func:`run_ticks`, in several processes."""
    work = run_ticks if ticks else run
    if processes <= 1:
        return work(count, seed)
    total, chunk = Figures(), 500
    sizes = list(_chunks(count, chunk))
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for k, part in enumerate(pool.map(work, sizes, [seed + 1000 * i for i in range(len(sizes))])):
            total.add(part)
            print(f"{k + 1}/{len(sizes)}: {total}", file=sys.stderr, flush=True)
    return total


def _chunks(count: int, chunk: int) -> Iterator[int]:
    while count > 0:
        yield min(chunk, count)
        count -= chunk


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare certificates with dense sampling.")
    parser.add_argument("--count", type=int, default=2000, help="segments to check")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--ticks", action="store_true", help="segments of strips that deform among moving obstacles")
    given = parser.parse_args()
    figures = run_all(given.count, given.seed, given.processes, ticks=given.ticks)
    for line in (*figures.collisions, *figures.shortfalls, *figures.false_alarms):
        print(line)
    print(figures)
    sys.exit(bool(figures.collisions or figures.shortfalls))


if __name__ == "__main__":
    main()
