"""An attack on the certificate: random robots, obstacles moved until the proof just holds, movers at their worst.

Each robot is a random URDF (prismatic, continuous, mimicking, branching joints, scaled and mirrored meshes, nv 3 … 16,
every kind of base; every other one has joints that follow planned ones). What the library certifies is then walked
along ``pin.interpolate`` in steps in which no point of the robot, and none of an obstacle, moves by more than a
millimetre, and at every step Coal is asked whether the shapes, grown by the clearance that was proven, overlap at
Pinocchio's placements. Nothing of the library's kinematics, bounds or searches is used for that.

    python tests/oracle/attack.py --segments 1000000 --processes 2
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise, product
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import NamedTuple

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from brute_force import configuration, make_obstacle, random_pose, scene_pieces
from random_robots import random_robot

from elastic_strips.collision import BodySet, Forecast, MotionBounds, MotionCertifier
from elastic_strips.collision.native_side import proven_segments
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Cylinder, Obstacle, Scene
from elastic_strips.strip import Deformer, DeformParams, Strip, strip_clearance

Array = npt.NDArray[np.float64]

STEP = 1e-3
"""No point moves further [m] between two samples."""
FREE = 2e-3
"""A segment that keeps this much more [m] than what is to be proven counts as truly free."""
_SOUND = 2e-5  # [m] what Coal's distances scatter by
_BASES = ("fixed", "omni", "diff_drive")
_SHAPES = ("box", "sphere", "cylinder", "capsule", "cone", "convex", "plate", "pole", "mesh", "voxels")
_OFTEN = np.array([4, 4, 4, 4, 2, 4, 3, 3, 0.5, 0.2])
KINDS = ("chain", "again", "others", "edge", "self", "self edge", "timed", "timed edge")
BY_SPHERES = ("spheres", "spheres edge", "spheres self", "least", "single")
"""Where spheres about the links take a part: segments that they prove, also by the measured least distance, and single
configurations of a planner."""
_SIGNS = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T


@dataclass
class Figures:
    """Counts of segments by (what was attacked, kind of base, nv), and what was wrong."""

    counts: Counter[tuple[str, str, int, str]] = field(default_factory=Counter)
    false: list[str] = field(default_factory=list)
    missing_pairs: list[str] = field(default_factory=list)
    robots: int = 0
    samples: int = 0
    longest_step: float = 0.0
    seconds: float = 0.0

    def note(self, key: tuple[str, str, int], what: str) -> None:
        self.counts[(*key, what)] += 1

    def total(self, what: str, **where: object) -> int:
        names = ("kind", "base", "nv")
        return sum(
            n for key, n in self.counts.items()
            if key[3] == what and all(key[names.index(k)] == v for k, v in where.items())
        )  # fmt: skip

    @property
    def segments(self) -> int:
        return self.total("certified") + self.total("refused")

    def add(self, other: Figures) -> None:
        self.counts.update(other.counts)
        self.false += other.false
        self.missing_pairs += other.missing_pairs
        self.robots += other.robots
        self.samples += other.samples
        self.longest_step = max(self.longest_step, other.longest_step)
        self.seconds += other.seconds

    @property
    def free_fraction(self) -> float:
        """Share of the truly free segments that were certified."""
        free = self.total("certified", kind="chain") + self.total("free but refused", kind="chain")
        return self.total("certified", kind="chain") / max(free, 1)

    def table(self) -> str:
        rows = [("attacked", "segments", "certified", "refused", "truly free but refused", "false")]

        def row(name: str, **where: object) -> None:
            n = [self.total(w, **where) for w in ("certified", "refused", "free but refused", "false")]
            if n[0] + n[1]:
                rows.append((name, str(n[0] + n[1]), *map(str, n)))

        for kind in (*KINDS, *BY_SPHERES):
            row(kind, kind=kind)
        for base in _BASES:
            row(base, base=base)
        for nv in range(3, 17):
            row(f"nv = {nv}", nv=nv)
        row("all")
        text = "\n".join("| " + " | ".join(r) + " |" for r in rows)
        return text.replace("\n", "\n|---|---|---|---|---|---|\n", 1) + (
            f"\n\n{self.robots} robots, {self.samples} samples, no point further than "
            f"{1000 * self.longest_step:.2f} mm from one to the next (looked at in one of 50); "
            f"of the truly free segments of chains {100 * self.free_fraction:.2f} % certified; "
            f"{self.seconds:.0f} s of one core"
        )


class _World(NamedTuple):
    """Grown shapes of robot and scene in Pinocchio's keeping."""

    model: pin.GeometryModel
    data: pin.GeometryData
    tree: pin.TreeBroadPhaseManager_DynamicAABBTreeCollisionManager
    standing: list[tuple[int, int]]
    """Pairs of one joint, the world: Pinocchio does not ask about them."""

    def stand_apart(self) -> bool:
        pieces, request = self.model.geometryObjects, coal.CollisionRequest()
        return not any(
            coal.collide(*_placed(pieces[i]), *_placed(pieces[k]), request, coal.CollisionResult())
            for i, k in self.standing
        )


class Checker:
    """Asks Coal, sample by sample, whether a robot and a scene, both grown, overlap."""

    def __init__(self, robot: RobotModel, figures: Figures) -> None:
        self.robot, self.figures = robot, figures
        self.model, self.data = robot.model, robot.model.createData()
        corners = []
        for piece in robot.geometries:
            piece.geometry.computeLocalAABB()
            box = piece.geometry.aabb_local
            low, high = np.array(box.min_), np.array(box.max_)
            own = low + _SIGNS * (high - low)
            corners.append(own @ piece.placement[:3, :3].T + piece.placement[:3, 3])
        self._corners = np.array(corners)  # (G, 8, 3) in the joints' frames: each piece lies in their hull
        self._used = sorted({piece.joint for piece in robot.geometries})
        self._of = [self._used.index(piece.joint) for piece in robot.geometries]
        self._walks = 0

    def take(self, scene: Scene, clearance: float, self_clearance: float, *, free: float = FREE) -> None:
        """Build the world of grown shapes: of what was certified, and of what counts as free, ``free`` [m] more."""
        self.worlds = [self._world(scene, clearance + d, self_clearance + d) for d in (-_SOUND, free)]
        self.still = [obj.placement.copy() for obj in self.worlds[0].model.geometryObjects]

    def _world(self, scene: Scene, clearance: float, self_clearance: float) -> _World:
        world = pin.GeometryModel()
        links = len(self.robot.geometries)
        for k, piece in enumerate(self.robot.geometries):
            pose = pin.SE3(piece.placement[:3, :3], piece.placement[:3, 3])
            shape = _grown(piece.geometry, 0.5 * self_clearance)
            world.addGeometryObject(pin.GeometryObject(f"link{k}", piece.joint, 0, pose, shape))
        for i, k in self.robot.self_pairs.tolist():
            world.addCollisionPair(pin.CollisionPair(i, k))
        self.owner, standing = [], []
        for p, piece in enumerate(scene_pieces(scene)):
            shape = _grown(piece.geometry, clearance - 0.5 * self_clearance)
            pose = pin.SE3(piece.T[:3, :3], piece.T[:3, 3])
            index = world.addGeometryObject(pin.GeometryObject(f"part{p}", 0, 0, pose, shape))
            self.owner.append(piece.obstacle)
            for link in range(links):
                world.addCollisionPair(pin.CollisionPair(link, index))
                if self.robot.geometries[link].joint == 0:
                    standing.append((link, index))
        data = world.createData()
        for request in data.collisionRequests:
            request.enable_contact = True  # without, Coal misses some pairs that are deep in each other
        # the tree must know of grown shapes: Coal's own margins are forgotten by it, swept-sphere radii are not
        tree = pin.TreeBroadPhaseManager_DynamicAABBTreeCollisionManager(self.model, world, data)
        return _World(world, data, tree, standing)

    def count(self, a: Array, b: Array) -> int:
        """How many samples no point of the robot moves by more than a millimetre between."""
        coarse = 5
        world = self._points(pin.interpolate(self.model, a, b, k / coarse) for k in range(coarse + 1))
        chord = float(np.sqrt(np.square(np.diff(world, axis=0)).sum(axis=-1).max()))
        return max(int(np.ceil(1.12 * coarse * chord / STEP)), 1)

    def _points(self, configurations: Iterable[Array]) -> Array:
        """World corners (K, G, 8, 3) of boxes about the pieces: of a rigid body these move furthest."""
        model, data, used = self.model, self.data, self._used
        poses = []
        for q in configurations:
            pin.forwardKinematics(model, data, q)
            poses.append([data.oMi[j].homogeneous for j in used])
        T = np.array(poses)[:, self._of]
        return np.matmul(self._corners, T[..., :3, :3].transpose(0, 1, 3, 2)) + T[..., None, :3, 3]

    def overlaps(self, a: Array, b: Array, *, free: bool = False, at: Callable[[float], None] | None = None) -> bool:
        """Whether the grown shapes overlap anywhere between two configurations.

        Args:
            a, b: configurations (nq,).
            free: ask for what counts as truly free.
            at: called with the fraction of the way before each sample, to move obstacles; their motion is counted in.
        """
        world = self.worlds[free]
        tree = world.tree
        model, kin, interpolate, collide = self.model, self.data, pin.interpolate, pin.computeCollisions
        count = self.count(a, b)
        self._walks += 1
        if self._walks % 50 == 0:
            self._look_at_steps(a, b, count)
        self.figures.samples += count + 1
        for k in range(count + 1):
            s = k / count
            if at is not None:
                at(s)
            if collide(model, kin, tree, interpolate(model, a, b, s), True):
                return True
            if world.standing and (at is not None or k == 0) and not world.stand_apart():
                return True
        return False

    def _look_at_steps(self, a: Array, b: Array, count: int) -> None:
        """Whether the samples are as dense as is said."""
        world = self._points(pin.interpolate(self.model, a, b, k / count) for k in range(count + 1))
        step = float(np.sqrt(np.square(np.diff(world, axis=0)).sum(axis=-1).max()))
        self.figures.longest_step = max(self.figures.longest_step, step)

    def move(self, name: str, shift: Array) -> None:
        """Put an obstacle off where it was sensed by a shift (3,) [m]."""
        links = len(self.robot.geometries)
        for world in self.worlds:
            for p, owner in enumerate(self.owner):
                if owner == name:
                    here = self.still[links + p]
                    world.model.geometryObjects[links + p].placement = pin.SE3(here.rotation, here.translation + shift)


def _placed(piece: pin.GeometryObject) -> tuple[coal.CollisionGeometry, coal.Transform3s]:
    return piece.geometry, coal.Transform3s(piece.placement.rotation, piece.placement.translation)


def _grown(shape: coal.CollisionGeometry, by: float) -> coal.CollisionGeometry:
    own = coal.Capsule(shape.radius, 0.0) if isinstance(shape, coal.Sphere) else shape.clone()
    own.setSweptSphereRadius(shape.getSweptSphereRadius() + by)
    own.computeLocalAABB()
    return own


def _obstacle(rng: np.random.Generator, low: Array, high: Array) -> Obstacle:
    shape = str(rng.choice(_SHAPES, p=_OFTEN / _OFTEN.sum()))
    at, quat = random_pose(rng, low, high)
    if shape == "plate":
        return Box((rng.uniform(0.2, 0.8), 0.004, rng.uniform(0.2, 0.8)), at=at, quat=quat)
    if shape == "pole":
        return Cylinder(0.003, rng.uniform(0.3, 1.5), at=at, quat=quat)
    return make_obstacle(shape, rng, low, high)


class Attack:
    """One robot under attack."""

    def __init__(self, robot: RobotModel, rng: np.random.Generator, figures: Figures, where: str) -> None:
        self.robot, self.rng, self.figures, self.where = robot, rng, figures, where
        self.params = DeformParams(
            clearance=float(rng.choice([0.001, 0.005, 0.03])), influence=float(rng.choice([0.1, 0.3]))
        )
        self.deformer = Deformer(robot, self.params)
        self.checker = Checker(robot, figures)
        space = robot.space
        self.low, self.high = space.lower.copy(), space.upper.copy()
        wide = ~np.isfinite(self.low)
        self.low[wide], self.high[wide] = -np.pi, np.pi

    def row(self) -> Array:
        row = self.rng.uniform(self.low, self.high)
        if self.robot.space.planar:
            row[:2] = self.rng.uniform(-0.8, 0.8, 2)
        return row

    def motion(self) -> Array:
        """A tangent vector (nv,): a drive, a turn, a motion of some joints."""
        rng, nv, b = self.rng, self.robot.nv, self.robot.space.base_nv
        v = np.zeros(nv)
        size = 10.0 ** rng.uniform(-2.0, -0.3)
        if b:
            if rng.random() < 0.7:
                v[0] = rng.normal() * 0.3 * size
                v[1] = rng.normal() * 0.3 * size * (rng.random() < 0.3)
            if rng.random() < 0.6:
                v[2] = rng.normal() * size
        if nv > b and rng.random() < 0.8:
            v[b:] = rng.normal(size=nv - b) * size * (rng.random(nv - b) < 0.6)
        return np.clip(v, -2.8, 2.8)

    def chain(self, count: int) -> Strip:
        """A strip (count + 1 nodes) of which each segment is another random motion."""
        space, rows = self.robot.space, [self.row()]
        for _ in range(count):
            rows.append(np.clip(space.integrate(rows[-1], self.motion()), space.lower, space.upper))
        return Strip(self.robot, np.array([configuration(self.robot, r) for r in rows]))

    def scene(self, count: int) -> Scene:
        reach = 1.3
        return Scene([_obstacle(self.rng, np.full(3, -reach), np.full(3, reach)) for _ in range(count)])

    def note(self, kind: str, certified: bool, a: Array, b: Array, at: Callable[[float], None] | None = None) -> None:
        key = (kind, self.robot.base_kind.value, self.robot.nv)
        self.figures.note(key, "certified" if certified else "refused")
        if certified:
            if self.checker.overlaps(a, b, at=at):
                self.figures.note(key, "false")
                self.figures.false.append(f"{kind}: {self.where}, {self.robot.base_kind.value}, nv {self.robot.nv}")
        elif at is None and not self.checker.overlaps(a, b, free=True):
            self.figures.note(key, "free but refused")

    def chains(self, count: int) -> None:
        """Strips among obstacles, by a workspace that has seen other strips; a little moved, and again; and once more
        where others have come and gone."""
        scene, strip = self.scene(int(self.rng.integers(3, 8))), self.chain(count)
        self.checker.take(scene, self.params.clearance, self.params.self_clearance)
        certificate = self.deformer.certify(strip, scene)
        for j, (a, b) in enumerate(pairwise(strip.q)):
            self.note("chain", bool(certificate.segments[j]), a, b)
        space = self.robot.space
        off = self.rng.normal(size=strip.coordinates.shape) * 10.0 ** self.rng.uniform(-6, -1.5)
        moved = Strip.from_coordinates(
            self.robot, np.clip(space.integrate(strip.coordinates, off), space.lower, space.upper)
        )
        name = str(self.rng.choice(scene.names))
        pose = scene.obstacle(name).pose.copy()
        pose[:3, 3] += self.rng.normal(size=3) * 10.0 ** self.rng.uniform(-5, -0.5)
        scene = scene.moved(name, pose)
        self.checker.take(scene, self.params.clearance, self.params.self_clearance)
        certificate = self.deformer.certify(moved, scene)
        for j, (a, b) in enumerate(pairwise(moved.q)):
            self.note("again", bool(certificate.segments[j]), a, b)
        stays = [o for o in scene if self.rng.random() < 0.7]
        others = [o.named(f"other{k}") for k, o in enumerate(self.scene(2))]
        scene = Scene([*others, *stays] if self.rng.random() < 0.5 else [*stays, *others])
        back = strip if self.rng.random() < 0.5 else moved
        self.checker.take(scene, self.params.clearance, self.params.self_clearance)
        certificate = self.deformer.certify(back, scene)
        for j, (a, b) in enumerate(pairwise(back.q)):
            self.note("others", bool(certificate.segments[j]), a, b)

    def edges(self, count: int) -> None:
        """An obstacle is moved towards a segment until the proof just holds."""
        for _ in range(count):
            scene, strip = self.scene(2), self.chain(1)
            if not self.deformer.certify(strip, scene).certified:
                continue
            name = scene.names[0]
            pose = scene.obstacle(name).pose.copy()
            target = self._point_of(strip)
            placed = self._bisect(
                lambda f, scene=scene, name=name, pose=pose, target=target: scene.moved(
                    name, _towards(pose, target, f)
                ),
                lambda scene, strip=strip: self.deformer.certify(strip, scene).certified,
            )
            for scene, certified in placed:
                self.checker.take(scene, self.params.clearance, self.params.self_clearance)
                self.note("edge", certified, *strip.q)

    def _point_of(self, strip: Strip) -> Array:
        """Somewhere in the robot half-way, in the world."""
        pin.forwardKinematics(
            self.robot.model, self.checker.data, pin.interpolate(self.robot.model, *strip.q[:2], self.rng.random())
        )
        piece = self.robot.geometries[int(self.rng.integers(len(self.robot.geometries)))]
        return (self.checker.data.oMi[piece.joint].homogeneous @ piece.placement)[:3, 3]

    def _bisect(
        self, put: Callable[[float], Scene], holds: Callable[[Scene], bool], steps: int = 12
    ) -> Iterator[tuple[Scene, bool]]:
        """The last scene that is certified and the first that is not."""
        low, high = 0.0, 1.0
        if holds(put(high)):
            yield put(high), True
            return
        for _ in range(steps):
            middle = 0.5 * (low + high)
            if holds(put(middle)):
                low = middle
            else:
                high = middle
        yield put(low), holds(put(low))
        yield put(high), False

    def selves(self, count: int) -> None:
        """The robot alone, and motions that go on until the proof just holds."""
        if len(self.robot.self_pairs) == 0:
            return
        empty, space = Scene([]), self.robot.space
        self.checker.take(empty, self.params.clearance, self.params.self_clearance)
        strip = self.chain(count)
        certificate = self.deformer.certify(strip, empty)
        for j, (a, b) in enumerate(pairwise(strip.q)):
            self.note("self", bool(certificate.segments[j]), a, b)
        ways: tuple[tuple[str, Callable[[Strip], bool]], ...] = (
            ("self edge", lambda strip: self.deformer.certify(strip, empty).certified),
            ("spheres self", lambda strip: bool(self.proven(strip, empty).all())),
        )
        for row, (kind, holds) in product(strip.coordinates[: count // 8], ways):
            v = self.motion()
            v[space.base_nv :] = self.rng.uniform(-1.5, 1.5, space.nv - space.base_nv)
            low, high = 0.0, 1.0
            for _ in range(12):
                middle = 0.5 * (low + high)
                end = np.clip(space.integrate(row, middle * v), space.lower, space.upper)
                if holds(Strip.from_coordinates(self.robot, np.stack((row, end)))):
                    low = middle
                else:
                    high = middle
            if low > 0.0:
                end = np.clip(space.integrate(row, low * v), space.lower, space.upper)
                self.note(kind, True, *(configuration(self.robot, r) for r in (row, end)))

    def proven(self, strip: Strip, scene: Scene) -> npt.NDArray[np.bool_]:
        """Segments that spheres about the links prove; none without the native kernel."""
        rows, space = strip.coordinates, self.robot.space
        v = space.difference(rows[:-1], rows[1:])
        found = proven_segments(
            self.deformer.workspace.bounds,
            scene,
            self.robot.pairs_within(self.params.self_clearance),
            rows,
            v,
            clearance=self.params.clearance,
            self_clearance=self.params.self_clearance,
        )
        return np.zeros(len(v), dtype=bool) if found is None else found & ~space.half_turn(v)

    def spheres(self, count: int) -> None:
        """What spheres prove alone, an obstacle that is moved until they just do, and configurations that are looked at
        by them first: of these a wrong refusal is false, too."""
        scene, strip = self.scene(4), self.chain(count)
        self.checker.take(scene, self.params.clearance, self.params.self_clearance)
        for j in np.flatnonzero(self.proven(strip, scene)).tolist():
            self.note("spheres", True, strip.q[j], strip.q[j + 1])
        valid = ValidityChecker(self.robot, scene, margin=self.params.clearance, self_margin=self.params.self_clearance)
        rows = np.array([self.row() for _ in range(count)])
        for row, clear in zip(rows, valid.each(rows).tolist(), strict=True):
            q = configuration(self.robot, row)
            self.note("single", clear, q, q)
            # what is fixed to one joint is no pair of Pinocchio's tree: a robot may touch itself in every posture
            if not clear and self.robot.self_collision(q) is None and not self.checker.overlaps(q, q, free=True):
                self.figures.false.append(f"single, free and refused: {self.where}")
        strip, scene = self.chain(1), self.scene(2)
        if not self.proven(strip, scene).all():
            return
        name, target = scene.names[0], self._point_of(strip)
        pose = scene.obstacle(name).pose.copy()
        put = self._bisect(
            lambda f: scene.moved(name, _towards(pose, target, f)), lambda moved: bool(self.proven(strip, moved).all())
        )
        nearest, holds = next(put)
        self.checker.take(nearest, self.params.clearance, self.params.self_clearance)
        self.note("spheres edge", holds, *strip.q)
        least = strip_clearance(strip, nearest)
        self.checker.take(nearest, least, self.params.self_clearance)
        self.note("least", True, *strip.q)

    def timed(self, count: int, kind: str) -> None:
        """A motion among movers, each of which does the worst that is assumed of it."""
        rng, space = self.rng, self.robot.space
        scene = self.scene(3)
        moving = np.array([0, 1])
        forecast = Forecast(
            moving,
            rng.normal(size=(2, 3)) * 0.5,
            rng.uniform(0, 0.02, 2),
            rng.uniform(0, 0.2, 2),
            rng.uniform(0, 0.5, 2),
        )
        start, v = self.row(), self.motion()
        end = np.clip(space.integrate(start, v), space.lower, space.upper)
        v = space.difference(start, end)
        if space.half_turn(v):
            return
        coordinates = space.integrate(np.tile(start, (count + 1, 1)), np.linspace(0, 1, count + 1)[:, None] * v)
        steps = np.tile(v / count, (count, 1))
        begin = rng.choice([0.0, 0.0, -rng.uniform(0.0, 1.0)])
        times = begin + np.cumsum(np.append(0.0, rng.uniform(0.02, 0.1, count)))
        ahead = forecast.predict(times)
        bodies = BodySet.links(self.robot)
        certifier = MotionCertifier(bodies, MotionBounds(bodies), self.robot.self_pairs)
        clearance, own = self.params.clearance, self.params.self_clearance

        def holds(scene: Scene) -> bool:
            return certifier.certify(
                coordinates, steps, scene, ahead, clearance=clearance, self_clearance=own
            ).certified

        certified = holds(scene)
        if kind == "timed edge":
            if not certified:
                return
            name, pose = scene.names[0], scene.obstacle(scene.names[0]).pose.copy()
            strip = Strip.from_coordinates(self.robot, np.stack((start, end)))
            target = self._point_of(strip) - forecast.velocity[0] * 0.5 * (times[0] + times[-1])
            scene, certified = next(self._bisect(lambda f: scene.moved(name, _towards(pose, target, f)), holds))
        if not certified:
            for _ in range(count):
                self.figures.note((kind, self.robot.base_kind.value, self.robot.nv), "refused")
            return
        self.checker.take(scene, clearance, own)
        middle = self._point_of(Strip.from_coordinates(self.robot, np.stack((start, end))))
        worst = [_unit(middle - scene.obstacles[k].pose[:3, 3]) if rng.random() < 0.7 else _unit(rng.normal(size=3))
                 for k in moving]  # fmt: skip
        q = [configuration(self.robot, row) for row in coordinates]
        for j in range(count):
            # finer than the robot's own motion needs, so that the movers do not jump either
            def at(s: float, j: int = j) -> None:
                t = (1.0 - s) * times[j] + s * times[j + 1]
                for m, k in enumerate(moving):
                    grown = forecast.offset[m] + forecast.speed[m] * abs(t) + 0.5 * forecast.acceleration[m] * t * t
                    self.checker.move(scene.names[k], forecast.velocity[m] * t + worst[m] * grown)

            fastest = max(
                float(np.linalg.norm(forecast.velocity[m])) + forecast.speed[m]
                + forecast.acceleration[m] * float(np.abs(times).max()) for m in range(2)
            )  # fmt: skip
            pieces = max(
                1, int(np.ceil(fastest * (times[j + 1] - times[j]) / (STEP * self.checker.count(q[j], q[j + 1]))))
            )
            for i in range(pieces):
                f, g = i / pieces, (i + 1) / pieces
                a, b = (pin.interpolate(self.robot.model, q[j], q[j + 1], x) for x in (f, g))
                if self.checker.overlaps(a, b, at=lambda s, f=f, g=g, at=at: at((1 - s) * f + s * g)):
                    self.figures.note((kind, self.robot.base_kind.value, self.robot.nv), "false")
                    self.figures.false.append(f"{kind}: {self.where}")
                    break
            self.figures.note((kind, self.robot.base_kind.value, self.robot.nv), "certified")

    def pairs(self) -> None:
        """Pairs of links that are not looked at, though they touch in some postures, and not by design (at home)."""
        own = {tuple(sorted(p)) for p in self.robot.self_pairs.tolist()}
        pieces = self.robot.geometries
        together = self._touching(self.robot.home_q)
        others = [
            (i, k) for k in range(len(pieces)) for i in range(k) if (i, k) not in own
            and pieces[i].joint != pieces[k].joint
            and self.robot.model.parents[pieces[k].joint] != pieces[i].joint
            and self.robot.model.parents[pieces[i].joint] != pieces[k].joint
            and frozenset((i, k)) not in together
        ]  # fmt: skip
        touched: Counter[frozenset[int]] = Counter()
        draws = 400
        for _ in range(draws):
            touched.update(self._touching(configuration(self.robot, self.row())) & {frozenset(p) for p in others})
        for pair, n in touched.items():
            if n < 0.9 * draws:
                names = " and ".join(pieces[i].name for i in sorted(pair))
                self.figures.missing_pairs.append(f"{self.where}: {names} touch in {n} of {draws} postures")

    def _touching(self, q: Array) -> set[frozenset[int]]:
        """All pairs of pieces that are nearer to each other than 2 mm."""
        pieces, data = self.robot.geometries, self.checker.data
        pin.forwardKinematics(self.robot.model, data, q)
        placed = [data.oMi[p.joint] * pin.SE3(p.placement[:3, :3], p.placement[:3, 3]) for p in pieces]
        poses = [coal.Transform3s(T.rotation, T.translation) for T in placed]
        request = coal.CollisionRequest()
        request.security_margin = 2e-3
        return {
            frozenset((i, k))
            for k in range(len(pieces)) for i in range(k)
            if coal.collide(pieces[i].geometry, poses[i], pieces[k].geometry, poses[k], request, coal.CollisionResult())
        }  # fmt: skip


def _towards(pose: Array, target: Array, fraction: float) -> Array:
    moved = pose.copy()
    moved[:3, 3] = (1.0 - fraction) * pose[:3, 3] + fraction * target
    return moved


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def run(segments: int, seed: int) -> Figures:
    """Attack one random robot with about so many segments."""
    began, rng, figures = process_time(), np.random.default_rng(seed), Figures()
    base = _BASES[seed % 3]
    nv = 3 + (seed // 3) % 14
    with tempfile.TemporaryDirectory() as folder:
        joints, followers = nv - (0 if base == "fixed" else 3), seed % 2 == 1
        robot = random_robot(rng, Path(folder), joints, base, followers=followers)
    attack = Attack(robot, rng, figures, f"seed {seed}")
    figures.robots = 1
    attack.pairs()
    while figures.segments < segments:
        attack.chains(40)
        attack.edges(1)
        attack.selves(16)
        attack.timed(8, "timed")
        attack.timed(8, "timed edge")
        attack.spheres(16)
    figures.seconds = process_time() - began
    return figures


def run_all(segments: int, seed: int, processes: int = 1, *, each: int = 3000) -> Figures:
    """Attack as many robots as it takes."""
    total, first = Figures(), 1000 * seed
    count = max(1, -(-segments // each))
    seeds = range(first, first + count)
    if processes <= 1:
        for s in seeds:
            total.add(run(min(each, segments), s))
        return total
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for k, part in enumerate(pool.map(run, [each] * count, seeds)):
            total.add(part)
            if (k + 1) % 10 == 0:
                print(
                    f"{k + 1}/{count}: {total.segments} segments, {len(total.false)} false", file=sys.stderr, flush=True
                )
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--segments", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--each", type=int, default=3000, help="segments a robot")
    parser.add_argument("--processes", type=int, default=min(2, os.cpu_count() or 1))
    given = parser.parse_args()
    figures = run_all(given.segments, given.seed, given.processes, each=given.each)
    for line in (*figures.false[:50], *figures.missing_pairs[:50]):
        print(line)
    print(figures.table())
    sys.exit(bool(figures.false or figures.missing_pairs))


if __name__ == "__main__":
    main()
