"""An attack on certificates in sensed scenes: is what is certified against what sensors saw free of the true world?

A robot with a laser and a depth camera on its head stands in a random world, looks about, and moves through what is
certified, where it looks again; what was not seen is blocked. Motions from where it stands are certified against the
estimated scene, each as long as the proof just holds. What is certified is walked along ``pin.interpolate``, and at
every step Coal is asked at Pinocchio's placements whether the robot's shapes overlap those of the *true* world.

An overlap counts, and makes a certificate false, where its place (Coal's contact) is

- in a voxel of which the map knows something: that it is free, or an obstacle;
- or, where what was not seen is blocked, no further than ``unseen_radius`` from where the base stood, above ``low`` and
  the laser's plane and two voxels, and below the map's top. What a laser alone speaks for, and the floor, is not asked.

Of every two worlds what was not seen is free in one: there the robot comes near to things much more often.

What the docs ask for is given: about where the robot stands at first nothing is, things are no thinner than
``VolumeMapParams.thinnest`` (corners are round), nothing moves, and the robot knows where it is. Robots keep 3 cm, more
than the half of a voxel that may be overlooked; ``--clearance`` for less.

    python tests/oracle/attack_sensed.py --segments 100000 --processes 2
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import product
from multiprocessing import get_context
from time import process_time

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from attack import Array, Checker
from attack import Figures as WalkFigures
from brute_force import link_distances, random_pose, scene_pieces
from free_way import outside_scene

import elastic_strips as es
from elastic_strips.perception import SceneEstimator, SceneEstimatorParams, VolumeMapParams
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Capsule, ConvexHull, Obstacle, Scene, Sphere, World
from elastic_strips.sim.sensed_perception import body_radius
from elastic_strips.sim.sensors import DepthParams, LaserParams, SensorConfig, SensorSuite, named_sensors
from elastic_strips.strip import Deformer, DeformParams, Strip

Mask = npt.NDArray[np.bool_]

ROBOTS, NOISES, UNSEEN = ("silvermate", "tiago"), ("exact", "noisy"), ("blocked", "free")
_LOOKING = {"tiago": ("head_1_joint", "head_2_joint"), "silvermate": ()}
_COARSER = 3  # times the steps of the attack: what overlaps by less than that is not looked for
_ROUND = 0.02  # [m] radius of every edge and corner
_THINGS, _ROUNDS, _PROPOSALS = 26, 14, 90
_HALVINGS = 5
_NEAR = 0.15  # [m] that what is certified ends beside a thing, if it is near; asked of one in ten
_BALL = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
_BALL = _BALL / np.linalg.norm(_BALL, axis=1, keepdims=True)


@dataclass
class Figures:
    """Counts by (robot, noise, what was not seen, what), and the false ones."""

    counts: Counter[tuple[str, str, str, str]] = field(default_factory=Counter)
    false: list[str] = field(default_factory=list)
    walked: WalkFigures = field(default_factory=WalkFigures)
    seconds: float = 0.0

    def add(self, other: Figures) -> None:
        self.counts.update(other.counts)
        self.false += other.false
        self.walked.add(other.walked)
        self.seconds += other.seconds

    def total(self, what: str) -> int:
        return sum(n for key, n in self.counts.items() if key[3] == what)

    def table(self) -> str:
        names = ("worlds", "images", "believed", "refused", "certified", "walked", "asked", "near", "beyond", "false")
        rows = [("robot", "noise", "unseen", *names), ("---",) * (3 + len(names))]
        for case in product(ROBOTS, NOISES, UNSEEN):
            rows.append((*case, *(str(self.counts[(*case, what)]) for what in names)))
        rows.append(("all", "", "", *(str(self.total(what)) for what in names)))
        return (
            "\n".join("| " + " | ".join(row) + " |" for row in rows)
            + f"\n\n{self.walked.samples} samples, {self.seconds:.0f} s of one core"
        )


class Truth(Checker):
    """Asks Coal whether a robot overlaps the true world where that counts."""

    def count(self, a: Array, b: Array) -> int:
        return max(math.ceil(super().count(a, b) / _COARSER), 1)

    def _look_at_steps(self, a: Array, b: Array, count: int) -> None:
        """They are as coarse as is said."""

    def contacts(self, a: Array, b: Array) -> list[tuple[float, str, Array]]:
        """All overlaps between two configurations: the fraction of the way, names of link and part, the place."""
        world, found = self.worlds[0], []
        count = self.count(a, b)
        for k in range(count + 1):
            q = pin.interpolate(self.model, a, b, k / count)
            pin.computeCollisions(self.model, self.data, world.model, world.data, q, False)
            for pair, result in zip(world.model.collisionPairs, world.data.collisionResults, strict=True):
                if result.isCollision():
                    names = " and ".join(world.model.geometryObjects[i].name for i in (pair.first, pair.second))
                    found.append((k / count, names, np.array(result.getContact(0).pos)))
        return found


@lru_cache(maxsize=2)
def load(name: str) -> RobotModel:
    """A robot that drives."""
    return es.load_robot(name, base="diff_drive", looking=_LOOKING[name])


def _thing(rng: np.random.Generator) -> Obstacle:
    """Something that stands or hangs about, with round edges."""
    away, angle = rng.uniform(0.9, 2.0), rng.uniform(-math.pi, math.pi)
    at, quat = random_pose(rng, (0, 0, 0.1), (0, 0, 1.8))
    at = np.array([away * math.cos(angle), away * math.sin(angle), at[2]])
    if rng.random() < 0.5:  # upright
        quat = np.array([0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)])
    kind = rng.choice(["box", "plate", "pole", "ball", "lump"])
    if kind == "ball":
        return Sphere(rng.uniform(0.04, 0.25), at=at)
    if kind == "pole":
        return Capsule(rng.uniform(0.02, 0.06), rng.uniform(0.2, 1.5), at=at, quat=quat)
    if kind == "lump":
        core = rng.normal(size=(8, 3)) * rng.uniform(0.03, 0.15, 3)
    else:
        half = rng.uniform(0.01, 0.25, 3) if kind == "box" else np.array([*rng.uniform(0.1, 0.4, 2), 0.005])
        core = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    return ConvexHull((core[:, None] + _ROUND * _BALL).reshape(-1, 3), at=at, quat=quat)


def world_about(robot: RobotModel, rng: np.random.Generator, params: VolumeMapParams) -> Scene:
    """A world in which nothing is where the robot stands at first."""
    things: list[Obstacle] = []
    q, room = robot.home(), 1.5 * params.cell
    while len(things) < _THINGS:
        thing = _thing(rng)
        if (
            _from_axis(thing) > params.start_radius + room
            and link_distances(robot, Scene([thing]), q).min() > params.start_margin + room
        ):
            things.append(thing.named(f"thing{len(things)}"))
    return Scene(things)


def _from_axis(thing: Obstacle) -> float:
    """At least how far a thing is from the z axis [m]."""
    (piece,) = scene_pieces(Scene([thing]))
    piece.geometry.computeLocalAABB()
    middle = piece.T[:3, :3] @ np.ravel(piece.geometry.aabb_center) + piece.T[:3, 3]
    return float(np.hypot(*middle[:2])) - float(piece.geometry.aabb_radius)


def _sensors(robot: str, noise: str, columns: int) -> SensorConfig:
    """Laser and head camera, at once and without delay."""
    made = []
    for sensor in named_sensors("laser,head-camera", robot).sensors:
        sensor = replace(sensor, rate=10.0, latency=0.0)
        if isinstance(sensor, DepthParams):
            sensor = replace(sensor, columns=columns, rows=3 * columns // 4)
        if noise == "exact":
            sensor = replace(sensor, noise=0.0, noise_ratio=0.0, dropout=0.0)
            if isinstance(sensor, DepthParams):
                sensor = replace(sensor, noise_growth=0.0, edge_dropout=0.0, bias=0.0, bias_ratio=0.0)
        made.append(sensor)
    return SensorConfig(sensors=tuple(made))


class Attack:
    """One robot in one world."""

    def __init__(self, name: str, noise: str, unseen: str, seed: int, clearance: float, figures: Figures) -> None:
        self.name, self.noise, self.unseen, self.seed, self.figures = name, noise, unseen, seed, figures
        self.robot, self.rng = load(name), np.random.default_rng(seed)
        self.params = VolumeMapParams(length=12.0, unseen=unseen, unseen_radius=2.0)
        self.true = world_about(self.robot, self.rng, self.params)
        config = _sensors(name, noise, int(self.rng.choice([80, 120, 160])))
        self.suite = SensorSuite(self.robot.seeing, World(self.true), config, seed=seed)
        self.estimator = SceneEstimator(
            SceneEstimatorParams(body_radius=body_radius(self.robot), height=0.4),
            robot=self.robot.seeing,
            volume=self.params,
        )
        self.deformer = Deformer(self.robot, DeformParams(clearance=clearance, max_nodes=400))
        self.truth = Truth(self.robot, figures.walked)
        self.truth.take(self.true, 2e-4, 2e-4)
        self.row = self.robot.space.to_coordinates(self.robot.home())
        self.time = 0.0
        data = self.robot.model.createData()
        laser = next(s for s in config.sensors if isinstance(s, LaserParams))
        pin.framesForwardKinematics(self.robot.model, data, self.robot.home())
        plane = float(data.oMf[self.robot.model.getFrameId(laser.frame)].translation[2])
        self.low = max(self.params.low, plane + 2.0 * self.params.cell)
        self.note("worlds")

    def note(self, what: str, by: int = 1) -> None:
        self.figures.counts[self.name, self.noise, self.unseen, what] += by

    def look(self, row: Array) -> None:
        """Readings of all sensors from a coordinate row, with the head anywhere."""
        eyes = self.robot.seeing
        if self.robot.looking:
            low, high = eyes.space.lower[-2:], eyes.space.upper[-2:]
            head = self.rng.uniform(np.maximum(low, (-1.2, -0.9)), np.minimum(high, (1.2, 0.3)))
            seeing = self.robot.seeing_row(row, head)
        else:
            seeing = row
        self.time += 0.1
        for reading in self.suite.observe(self.time, seeing):
            self.estimator.update(reading, row[:3])
            if reading.sensor in self.estimator.watched:
                self.note("images")
                self.note("believed", not self.estimator.watched[reading.sensor].reason)

    def motions(self) -> Array:
        """Tangent vectors (n, nv): drives and turns, and arms that reach anywhere or move a little; half of them end
        with a joint in a thing, or as near to one as it comes."""
        rng, space = self.rng, self.robot.space
        count = 6 * _PROPOSALS
        v = np.zeros((count, self.robot.nv))
        drives = rng.random(count) < 0.6
        v[drives, 0] = rng.uniform(-0.3, 0.8, drives.sum())
        v[drives, 2] = rng.normal(size=drives.sum()) * 0.6
        anywhere = rng.uniform(space.lower[3:], space.upper[3:], (count, self.robot.nv - 3)) - self.row[3:]
        little = 0.15 * rng.normal(size=anywhere.shape)
        moves = np.where(rng.random((count, 1)) < 0.7, anywhere, little)
        v[:, 3:] = np.where(rng.random((count, 1)) < 0.75, moves, 0.0)
        model, data = self.robot.model, self.truth.data
        joints = []
        for row in space.integrate(np.tile(self.row, (count, 1)), v):
            pin.forwardKinematics(model, data, space.from_coordinates(row))
            joints.append([data.oMi[j].translation for j in range(2, model.njoints)])
        off = outside_scene(np.array(joints).reshape(-1, 3), self.true).reshape(count, -1).min(axis=1)
        half = _PROPOSALS // 2
        return v[np.concatenate((np.arange(half), half + np.argsort(off[half:])[: _PROPOSALS - half]))]

    def certified(self, ends: Array, scene: Scene) -> tuple[Mask, Mask]:
        """Whether the motions from where it stands to rows (n, nv) are certified, and those back."""
        rows = np.repeat(ends, 2, axis=0)
        rows[1::2] = self.row
        strip = Strip.from_coordinates(self.robot, np.concatenate((self.row[None], rows)))
        segments = np.array(self.deformer.certify(strip, scene).segments, dtype=bool)
        return segments[::2], segments[1::2]

    def round(self) -> None:
        """Motions as long as the proof just holds; these are walked in the true world, and with them all that was
        certified of their beginnings."""
        scene, space = self.estimator.scene(), self.robot.space
        v = self.motions()
        low, high = np.zeros(len(v)), np.ones(len(v))
        fraction = high.copy()

        def put(part: Array) -> Array:
            ends = space.integrate(np.tile(self.row, (len(v), 1)), part[:, None] * v)
            return np.clip(ends, space.lower, space.upper)

        for _ in range(_HALVINGS):
            there, back = self.certified(put(fraction), scene)
            holds, new = there | back, fraction > low  # walked is what either of them says
            for each in (there, back):
                self.note("refused", int((~each).sum()))
                self.note("certified", int((each & new).sum()))
            low, high = np.where(holds, fraction, low), np.where(holds, high, fraction)
            fraction = np.where(low < 1.0, 0.5 * (low + high), 1.0)
        ends = put(low)[low > 0.0]
        start = space.from_coordinates(self.row)
        for end in ends:
            self.note("walked")
            if self.figures.total("walked") % 10 == 0:
                self.note("asked")
                near = link_distances(self.robot, self.true, space.from_coordinates(end)).min() < _NEAR
                self.note("near", int(near))
            self.check(start, space.from_coordinates(end), end)
        if len(ends):
            some = ends[self.rng.integers(len(ends), size=5)]
            self.row = some[np.hypot(some[:, 0], some[:, 1]).argmax()]  # away from where nothing can be

    def check(self, a: Array, b: Array, end: Array) -> None:
        """Whether a certified segment meets the true world."""
        if not self.truth.overlaps(a, b):
            return
        volume = self.estimator.volume
        assert volume is not None
        top = self.params.bottom + self.params.height
        blocked = self.params.unseen == "blocked"
        for s, names, place in self.truth.contacts(a, b):
            near = math.hypot(*(place[:2] - self.row[:2])) <= self.params.unseen_radius and self.low < place[2] < top
            known = int(volume.known(place[None])[0])
            if (near and blocked) or known >= 0:
                depth = -float(link_distances(self.robot, self.true, pin.interpolate(self.robot.model, a, b, s)).min())
                self.note("false")
                self.figures.false.append(
                    f"{self.name}, {self.noise}, seed {self.seed}, t {self.time:.1f}: {names} at "
                    f"{np.round(place, 3).tolist()} ({'neither' if known < 0 else 'free' if known == 0 else 'full'}), "
                    f"{1e3 * depth:.1f} mm deep, after {s:.2f} of the way from {self.row.tolist()} to {end.tolist()}"
                )
                return
        self.note("beyond")

    def run(self, segments: int) -> None:
        """Look about, then attack from one place after the other."""
        start = self.row.copy()
        for k in range(6):
            turned = start.copy()
            turned[2] += k * math.pi / 3.0
            for _ in range(2 if self.robot.looking else 1):
                self.look(turned)
        self.row = turned
        done = self.figures.total("certified")
        for _ in range(_ROUNDS):
            for _ in range(4 if self.robot.looking else 2):
                self.look(self.row)
            self.round()
            if self.figures.total("certified") - done >= segments:
                break


def run(seed: int, clearance: float = 0.03, segments: int = 10**9) -> Figures:
    """Attack one robot in one world."""
    began, figures = process_time(), Figures()
    Attack(ROBOTS[seed % 2], NOISES[seed // 2 % 2], UNSEEN[seed // 4 % 2], seed, clearance, figures).run(segments)
    figures.seconds = process_time() - began
    return figures


def run_all(segments: int, seed: int, processes: int = 1, clearance: float = 0.03) -> Figures:
    """Attack until so many segments were certified."""
    total, first = Figures(), 100_000 * seed
    one = partial(run, clearance=clearance)
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn")) if processes > 1 else None
    while total.total("certified") < segments:
        some = range(first, first + 4 * processes)
        for part in pool.map(one, some) if pool else map(one, some):
            total.add(part)
        first += len(some)
        print(f"{total.total('certified')} certified, {len(total.false)} false", file=sys.stderr, flush=True)
    if pool:
        pool.shutdown()
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--segments", type=int, default=5000, help="certified ones")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--clearance", type=float, default=0.03, help="that is certified [m]")
    parser.add_argument("--processes", type=int, default=min(2, os.cpu_count() or 1))
    given = parser.parse_args()
    figures = run_all(given.segments, given.seed, given.processes, given.clearance)
    for line in figures.false[:50]:
        print(line)
    print(figures.table())
    sys.exit(bool(figures.false))


if __name__ == "__main__":
    main()
