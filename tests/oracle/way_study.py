"""Paths of random robots that turn: half turns, whole turns, values and (cos, sin); and worlds with timetables.

Each path is certified, and then followed the way that its values say (or the shorter way, or the arc, where that is
what was certified), at the times that it has: Pinocchio places the robot, Coal measures, and no step is longer than
what is measured allows, by a bound of its own: no point of a robot is further from a joint than all its links are long.
Nothing of the certificate's ways, bounds or searches is used. See ``path_study.py``, which runs it.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Protocol

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from attack import Figures
from brute_force import distance, link_poses
from random_robots import random_urdf

from elastic_strips import proof_checker as checker
from elastic_strips.collision import Verdict, certify, prove
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Capsule, Obstacle, Scene, Sphere, Twist, UnknownMotion, World

Array = npt.NDArray[np.float64]
Place = Callable[[int, float], Array]
"""The configuration (nq,) at a part of a segment."""

WAYS = ("line", "values", "shortest", "arc", "configurations", "half turn")
WORLDS = ("appears, vanishes", "unknown motion", "all of it")
FREE = 5e-3  # [m]
_TOUCH = 2e-5  # [m]
_STEP = 5e-4  # [m] shortest step; what touches less deep for a shorter way may be missed by the walk


class Notes(Protocol):
    """What a study found; counts by (kind, resolution, what)."""

    counts: Counter[tuple[str, float, str]]
    wrong: list[str]
    milliseconds: list[float]
    walks: Figures


@dataclass
class Walk:
    """What was measured along a path: the least distance beyond what was to be kept."""

    least: float
    samples: int


class Walker:
    """Follows one robot's paths."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, model = robot, robot.model
        self.reach = sum(float(np.linalg.norm(model.jointPlacements[i].translation)) for i in range(1, model.njoints))
        self.reach += float(np.abs(np.clip(np.r_[robot.space.lower, robot.space.upper], -1.0, 1.0)).sum())  # slides
        self.shapes = [piece.geometry for piece in robot.geometries]
        balls = [_ball(shape) for shape in self.shapes]
        self.middles, self.radii = np.array([b[0] for b in balls]), np.array([b[1] for b in balls])
        far = [
            np.linalg.norm(p.placement[:3, :3] @ middle + p.placement[:3, 3]) + radius
            for p, (middle, radius) in zip(robot.geometries, balls, strict=True)
        ]
        self.reach += float(max(far))
        self.slides = np.array([j.shortname().startswith("JointModelP") for j in model.joints[1:]])

    def walk(self, place: Place, v: Array, world: World, when: Array) -> Walk:
        """Along segments that go v (N − 1, nv) each, from ``when`` (N,) on."""
        found = Walk(np.inf, 0)
        b = self.robot.space.base_nv
        events = np.array([*world.appears.values(), *world.vanishes.values()])
        for j, move in enumerate(v):
            joints = np.abs(move[b:])
            slides = self.slides[1:] if b else self.slides
            rate = float((joints * np.where(slides, 1.0, self.reach)).sum())
            if b:
                rate += 0.5 * np.pi * float(np.hypot(move[0], move[1])) + self.reach * abs(move[2])
            span = float(when[j + 1] - when[j])
            rate += span * max((_speed(o) for o in world.scene), default=0.0)
            cuts = (events[(events > when[j]) & (events < when[j + 1])] - when[j]) / span if span > 0.0 else []
            bounds = np.unique(np.r_[0.0, cuts, 1.0])
            for low, high in pairwise(bounds):
                s = low
                while True:
                    # the end of a piece belongs to the next one: what appears there is not there before
                    among = 0.5 * (low + high) if s in (low, high) else s
                    room = self.measure(place(j, s), world, when[j] + s * span, when[j] + among * span)
                    found.least, found.samples = min(found.least, room), found.samples + 1
                    if s >= high or found.least < -FREE:
                        break
                    s = min(s + max(room - FREE, _STEP) / max(rate, 1e-9), high)
        return found

    def measure(self, q: Array, world: World, t: float, there: float) -> float:
        """Distance [m] of the robot from what is there, less what that may have moved, and of its own links.

        Coal is asked about pairs in the order of their balls, until those are further apart than the nearest so far.
        """
        poses = link_poses(self.robot, q)
        middles = np.einsum("gij,gj->gi", poses[:, :3, :3], self.middles) + poses[:, :3, 3]
        pairs: list[tuple[float, float, coal.CollisionGeometry, Array, coal.CollisionGeometry, Array]] = []
        for a, b in self.robot.self_pairs.tolist():
            gap = float(np.linalg.norm(middles[a] - middles[b])) - self.radii[a] - self.radii[b]
            pairs.append((gap, 0.0, self.shapes[a], poses[a], self.shapes[b], poses[b]))
        for obstacle in world.scene:
            if not world.exists(str(obstacle.name), there):
                continue
            motion = obstacle.motion
            margin = motion.max_speed * abs(t - world.scene.time) if isinstance(motion, UnknownMotion) else 0.0
            pose = obstacle.at(t).pose
            for part in obstacle.parts:
                assert part.geometry is not None
                T = pose @ part.T_obstacle_part
                middle, radius = _ball(part.geometry)
                gaps = np.linalg.norm(middles - (T[:3, :3] @ middle + T[:3, 3]), axis=1) - self.radii - radius - margin
                pairs += [
                    (float(gap), margin, self.shapes[g], poses[g], part.geometry, T) for g, gap in enumerate(gaps)
                ]
        least = np.inf
        for gap, margin, one, T_one, two, T_two in sorted(pairs, key=lambda pair: pair[0]):
            if gap >= least:
                break
            least = min(least, distance(one, T_one, two, T_two)[0] - margin)
        return least


def _ball(shape: coal.CollisionGeometry) -> tuple[Array, float]:
    """A ball about the box about a shape: its middle (3,), and radius."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))


def _speed(obstacle: Obstacle) -> float:
    if isinstance(obstacle.motion, UnknownMotion):
        return obstacle.motion.max_speed
    if isinstance(obstacle.motion, Twist):
        return float(np.linalg.norm(obstacle.motion.linear) + 2.0 * np.linalg.norm(obstacle.motion.angular))
    return 0.0


def shorter(angle: Array) -> Array:
    """The shorter way (−π, π] of changes of angles."""
    return np.arctan2(np.sin(angle), np.cos(angle))


class WayStudy:
    """One random robot's paths."""

    def __init__(self, seed: int, notes: Notes, folder: Path) -> None:
        self.rng, self.notes, self.wrong, self.seed = np.random.default_rng(seed), notes, notes.wrong, seed
        base = ("fixed", "omni", "diff_drive")[seed % 3]
        shapes = ("box", "sphere", "cylinder")
        nv = 2 + (seed // 3) % 4
        self.robot = load_robot(random_urdf(self.rng, folder, nv, shapes=shapes), base=base)
        self.walker = Walker(self.robot)
        self.turning = np.zeros(self.robot.nv, dtype=bool)
        self.turning[self.robot.space.base_nv :] = self.robot.space.circular
        if self.robot.space.planar:
            self.turning[2] = True

    def note(self, kind: str, what: str) -> None:
        self.notes.counts[kind, 0.0, what] += 1

    def rows(self, kind: str) -> Array:
        """Three rows; angles by values, whole turns and more."""
        rng, space = self.rng, self.robot.space
        far = {"values": 7.0, "shortest": 7.0, "line": 3.3, "arc": 3.3}.get(kind, 1.5)
        low = np.where(np.isfinite(space.lower), space.lower, -1.0)
        high = np.where(np.isfinite(space.upper), space.upper, 1.0)
        rows = rng.uniform(low, high, (3, self.robot.nv))
        rows[1:, ~self.turning] = np.clip(
            rows[0, ~self.turning] + 0.4 * rng.normal(size=(2, int((~self.turning).sum()))),
            low[~self.turning], high[~self.turning],
        )  # fmt: skip
        steps = rng.normal(size=(3, int(self.turning.sum()))) * far * 0.5
        if kind == "values" and rng.random() < 0.3:
            steps[1] = 2.0 * np.pi * rng.integers(-2, 3, steps.shape[1])
        rows[:, self.turning] = np.cumsum(steps, axis=0)
        if kind == "half turn":
            k = int(rng.choice(np.flatnonzero(self.turning)))
            rows[2, k] = rows[1, k] + np.pi * rng.choice([-1.0, 1.0, 3.0])
        return rows

    def scene(self, kind: str) -> World:
        rng, obstacles, appears, vanishes = self.rng, [], {}, {}
        for k in range(int(rng.integers(2, 6))):
            at, name = rng.uniform(-0.9, 0.9, 3), f"o{k}"
            motion = None
            if kind in ("unknown motion", "all of it") and rng.random() < 0.7:
                motion = UnknownMotion(float(rng.uniform(0.0, 0.1)))
            elif kind == "all of it" and rng.random() < 0.5:
                motion = Twist(linear=rng.normal(0.0, 0.2, 3), angular=rng.normal(0.0, 0.3, 3))
            shape = int(rng.integers(3))
            if shape == 0:
                obstacles.append(Box(rng.uniform(0.05, 0.4, 3), at=at, name=name, motion=motion))
            elif shape == 1:
                obstacles.append(Sphere(float(rng.uniform(0.05, 0.25)), at=at, name=name, motion=motion))
            else:
                obstacles.append(Capsule(0.05, float(rng.uniform(0.1, 0.6)), at=at, name=name, motion=motion))
            if kind in ("appears, vanishes", "all of it"):
                begin = float(rng.uniform(-1.0, 4.0))
                if rng.random() < 0.6:
                    appears[name] = begin
                if rng.random() < 0.6:
                    vanishes[name] = begin + float(10.0 ** rng.uniform(-2.0, 0.5))
        return World(Scene(obstacles, time=float(rng.uniform(-0.5, 4.0)) if kind in WORLDS else 0.0), appears, vanishes)

    def run(self, paths: int, kinds: tuple[str, ...]) -> None:
        if not self.turning.any():
            kinds = tuple(kind for kind in kinds if kind == "line" or kind in WORLDS)
        for k in range(paths):
            self.one(kinds[k % len(kinds)], f"robot {self.seed}, path {k}")

    def one(self, kind: str, name: str) -> None:
        rng, space = self.rng, self.robot.space
        rows, world = self.rows(kind), self.scene(kind)
        changes = bool(world.names_moving or world.appears or world.vanishes)
        times = np.array([0.0, 2.0, 4.0]) if changes else None
        interpolation = str(rng.choice(["line", "arc", "shortest"])) if kind == "half turn" else kind
        interpolation = interpolation if interpolation in ("arc", "values", "shortest") else "line"
        as_q = kind == "configurations" or (kind == "half turn" and rng.random() < 0.5)
        path = space.from_coordinates(rows) if as_q else rows
        began = perf_counter()
        found = certify(self.robot, world, path, interpolation=interpolation, times=times, measure=False)
        self.notes.milliseconds.append(1e3 * (perf_counter() - began))
        self.note(kind, "paths")
        self.note(kind, found.verdict.value)
        v = np.diff(rows, axis=0)
        short = np.where(self.turning, shorter(v), v)
        apart = np.abs(np.abs(short[:, self.turning]) - np.pi).min(initial=np.inf)
        more = np.abs(v[:, self.turning]).max(initial=0.0) > np.pi and not as_q
        if interpolation != "values" and (apart < 1e-6 or (more and interpolation != "shortest")):
            self.note(kind, "no way said")
            if found.certified:
                self.wrong.append(f"{name}, {kind}: certified, and which way was not said")
            return
        if interpolation == "shortest" or as_q:
            v = short

        def place(j: int, s: float) -> Array:
            if interpolation == "arc":
                return pin.interpolate(self.robot.model, *space.from_coordinates(rows[j : j + 2]), s)
            return space.from_coordinates(rows[j] + s * v[j])

        walk = self.walker.walk(place, v, world, np.array([0.0, 2.0, 4.0]))
        self.notes.walks.samples += walk.samples
        if walk.least < -_TOUCH:
            self.note(kind, "touching")
            if found.certified:
                self.note(kind, "missed")
                self.wrong.append(f"{name}, {kind}: certified, and touches by {walk.least:g} m")
        elif walk.least >= FREE:
            self.note(kind, "clear")
            if not found.certified:
                self.note(kind, "alarm")
        if found.verdict is Verdict.REFUTED and found.q is not None:
            t = 0.0 if found.time is None else found.time
            if self.walker.measure(found.q, world, t, t) > _TOUCH:
                self.wrong.append(f"{name}, {kind}: refuted by a configuration that is free")
        if times is None:
            self.prove(path, world.scene, interpolation, walk, f"{name}, {kind}", kind)

    def prove(self, path: Array, scene: Scene, interpolation: str, walk: Walk, name: str, kind: str) -> None:
        proof = prove(self.robot, scene, path, interpolation=interpolation)
        if proof is None:
            return
        self.note(kind, "proofs")
        checker.check(proof.header, proof.rows, proof.segment, proof.pair, proof.span, proof.normal)
        if walk.least < -_TOUCH:
            self.wrong.append(f"{name}: proven, and touches by {walk.least:g} m")


def study_ways(
    paths: int, seed: int, notes: Notes, kinds: tuple[str, ...] = (*WAYS, *WORLDS), *, each: int = 45
) -> None:
    """So many paths of as many random robots as it takes."""
    for k in range(-(-paths // each)):
        with tempfile.TemporaryDirectory() as folder:
            WayStudy(100_000 * seed + k, notes, Path(folder)).run(min(each, paths - k * each), kinds)
