"""Random postures of a robot, and in how many of them pairs of its shapes touch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import faces, support_points, vertices
from elastic_strips.decompose import Surface, one_of_each_body

from .geometry import LinkGeometry, joint_pose, pose_in_joint

LinkPair = frozenset[str]
POSTURES = 400  # that are sampled; a pair that touches in all of them is left out
_MESH_POSTURES = 40  # in which, at least, the meshes are asked, of pairs that are left out for their hulls
NEVER_POSTURES = 60  # in which pairs that never touch, as an SRDF says, are asked
_TOUCH_DISTANCE = 1.5e-3  # [m] shapes nearer than this count as touching, where it is asked whether they always do
GRAZING_DEPTH = 1e-3  # [m] by which what is held still may overlap: closed fingers do
_FOLDED_DEPTH = 5e-3  # [m] by which links that one joint joins are in each other where it folds them together
_FOLDED_POSTURES = 40  # of that joint, through its range
_FOLDED_SHARE = 0.75  # of these, at most, in which they touch
_BODIES_WITHIN = 8  # of a mesh that are looked for inside of another one, in each of many postures
_DOT = coal.Sphere(1e-6)  # [m]


class SampledPostures:
    """Workspace: random postures of a model within its limits, in which joints that mimic another follow it.

    Args:
        model: the model.
        shapes: convex shapes of its links.
        meshes: what they were made of, in the same order.
        followers: joint → (the joint that it mimics, multiplier, offset [rad or m]).
    """

    def __init__(
        self,
        model: pin.Model,
        shapes: Sequence[LinkGeometry],
        meshes: Sequence[coal.CollisionGeometry] = (),
        followers: Mapping[str, tuple[str, float, float]] | None = None,
    ) -> None:
        self._model, self._data = model, model.createData()
        self._shapes, self._meshes = shapes, meshes
        self._rng = np.random.default_rng(0)
        self._low, self._high = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
        wide = ~((np.abs(self._low) < 1e6) & (np.abs(self._high) < 1e6))
        self._low[wide], self._high[wide] = -np.pi, np.pi
        self._followers = []
        for name, (leader, multiplier, offset) in (followers or {}).items():
            if model.existJointName(name) and model.existJointName(leader):
                one, two = model.joints[model.getJointId(name)], model.joints[model.getJointId(leader)]
                if one.nq == two.nq == 1:
                    self._followers.append((one.idx_q, two.idx_q, multiplier, offset))
        # a ball about each shape: most pairs are too far apart to be measured
        self._middles = [0.5 * (p.capsule.a + p.capsule.b) for p in shapes]
        self._radii = np.array([0.5 * np.linalg.norm(p.capsule.b - p.capsule.a) + p.capsule.r for p in shapes])
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._poses: dict[int, coal.Transform3s] = {}
        self._joints: dict[int, coal.Transform3s] = {}
        self._in_joints = [pose_in_joint(p) for p in shapes]
        self._surfaces: dict[int, Surface] = {}  # of meshes, by their identity: parts of one share it
        self._corners: dict[int, Array] = {}
        self.place(pin.neutral(model))

    def place(self, q: Array) -> None:
        """Take a posture."""
        pin.forwardKinematics(self._model, self._data, q)
        self._poses.clear()
        self._joints.clear()

    def next(self) -> None:
        """Take the next random one."""
        q = pin.normalize(self._model, self._rng.uniform(self._low, self._high))
        for own, leader, multiplier, offset in self._followers:
            q[own] = multiplier * q[leader] + offset
        self.place(q)

    def through(self, joint: str, count: int) -> Iterator[None]:
        """Take postures through the range of one joint, the others in the middle; the neutral one first. None of a
        joint that turns in a plane or in space, or that does not move."""
        index = self._model.getJointId(joint)
        if not 0 < index < self._model.njoints or self._model.nvs[index] != 1:
            return
        at, size = self._model.idx_qs[index], self._model.nqs[index]
        q = np.clip(pin.neutral(self._model), self._low, self._high)
        low, high = (float(self._low[at]), float(self._high[at])) if size == 1 else (-np.pi, np.pi)
        for value in (float(q[at]) if size == 1 else 0.0, *np.linspace(low, high, count)):
            q[at : at + size] = (value,) if size == 1 else (np.cos(value), np.sin(value))
            self.place(q)
            yield

    def near(self, pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """The pairs whose balls touch."""
        first, second = np.asarray(pairs, dtype=np.intp).reshape(-1, 2).T
        at = [self._data.oMi[p.joint].act(c) for p, c in zip(self._shapes, self._middles, strict=True)]
        middles = np.array(at).reshape(-1, 3)
        apart = np.linalg.norm(middles[first] - middles[second], axis=1) - self._radii[first] - self._radii[second]
        return [pairs[n] for n in np.flatnonzero(apart <= _TOUCH_DISTANCE).tolist()]

    def touch(self, i: int, k: int) -> bool:
        """Whether two convex shapes touch."""
        return self._collide(self._shapes[i].geometry, self._pose(i), self._shapes[k].geometry, self._pose(k))

    def depth(self, i: int, k: int) -> float:
        """How deep [m] two convex shapes are in each other; below 0 where they are apart."""
        result = coal.DistanceResult()
        one, two = self._shapes[i].geometry, self._shapes[k].geometry
        return -coal.distance(one, self._pose(i), two, self._pose(k), coal.DistanceRequest(True), result)

    def meshes_touch(self, i: int, k: int, margin: float = _TOUCH_DISTANCE, most: int | None = _BODIES_WITHIN) -> bool:
        """Whether two shapes come nearer than a margin [m] as the file has them, or a body of one is inside the other:
        Coal's meshes are hollow. Of meshes of more bodies only the first ``most`` are looked for there."""
        if self._collide(self._meshes[i], self._pose(i), self._meshes[k], self._pose(k), margin):
            return True
        for inner, outer in ((i, k), (k, i)):
            if isinstance(self._meshes[outer], coal.BVHModelBase):
                for corner in self._bodies(inner)[:most]:
                    at = self._pose(inner).transform(corner)
                    dot = coal.Transform3s(np.eye(3), at)
                    if not self._collide(_DOT, dot, self._shapes[outer].geometry, self._pose(outer), margin):
                        continue
                    if self._within(outer, self._pose(outer).inverse().transform(at)):
                        return True
        return False

    def _bodies(self, i: int) -> Array:
        """A point (B, 3) of each body of a shape as the file has it, in its frame."""
        mesh = self._meshes[i]
        if not isinstance(mesh, coal.BVHModelBase):
            return support_points(mesh)[0][:1]
        if id(mesh) not in self._corners:
            self._corners[id(mesh)] = one_of_each_body(vertices(mesh), faces(mesh))
        return self._corners[id(mesh)]

    def _within(self, i: int, point: Array) -> bool:
        """Whether a mesh encloses a point (3,) in its frame."""
        mesh = self._meshes[i]
        if id(mesh) not in self._surfaces:
            self._surfaces[id(mesh)] = Surface.of(vertices(mesh), faces(mesh))
        return self._surfaces[id(mesh)].encloses(point)

    def _collide(
        self,
        one: coal.CollisionGeometry,
        at: coal.Transform3s,
        two: coal.CollisionGeometry,
        there: coal.Transform3s,
        margin: float = _TOUCH_DISTANCE,
    ) -> bool:
        self._request.security_margin = margin
        self._result.clear()
        return bool(coal.collide(one, at, two, there, self._request, self._result))

    def _pose(self, i: int) -> coal.Transform3s:
        if i not in self._poses:
            joint = self._shapes[i].joint
            if joint not in self._joints:
                self._joints[joint] = joint_pose(self._data, joint)
            self._poses[i] = self._joints[joint] * self._in_joints[i]
        return self._poses[i]


def touching_at_first(postures: SampledPostures, of: Mapping[LinkPair, list[tuple[int, int]]]) -> dict[LinkPair, int]:
    """In how many sampled postures each pair of links touches, by any of these shapes, before one where it does not."""
    counts, left = dict.fromkeys(of, 0), dict(of)
    for _ in range(POSTURES):
        if not left:
            break
        postures.next()
        close = set(postures.near([member for each in left.values() for member in each]))
        left = {pair: each for pair, each in left.items() if any(postures.touch(*m) for m in each if m in close)}
        for pair in left:
            counts[pair] += 1
    return counts


def folded(postures: SampledPostures, of: Mapping[LinkPair, tuple[str, list[tuple[int, int]]]]) -> set[LinkPair]:
    """Which links that a joint joins are apart as it is at first, and deep in each other where it folds them together.

    Those that touch in more than three quarters of its range are none: their shapes overlap on purpose. Nor are those
    whose hulls meet where their meshes do not: nothing could tell them apart.

    Args:
        postures: of the robot.
        of: pair of links → the joint, and pairs of their shapes.
    """
    found: set[LinkPair] = set()
    for pair, (joint, each) in of.items():
        deepest, touching = -np.inf, 0
        for k, _ in enumerate(postures.through(joint, _FOLDED_POSTURES)):
            depth = max(postures.depth(*member) for member in each)
            if depth <= 0.0:
                continue
            if k == 0 or not any(postures.meshes_touch(*member, 0.0) for member in each):
                deepest = -np.inf
                break
            deepest, touching = max(deepest, depth), touching + 1
        if deepest > _FOLDED_DEPTH and touching <= _FOLDED_SHARE * _FOLDED_POSTURES:
            found.add(pair)
    return found


def touching_in_some(postures: SampledPostures, of: Mapping[LinkPair, list[tuple[int, int]]]) -> dict[LinkPair, int]:
    """In how many sampled postures two links touch, shapes as in the file, for pairs that do in some and not in all."""
    hits = Counter[LinkPair]()
    for _ in range(NEVER_POSTURES if of else 0):
        postures.next()
        close = set(postures.near([member for each in of.values() for member in each]))
        for pair, each in of.items():
            hits[pair] += any(
                postures.depth(*m) > GRAZING_DEPTH and postures.meshes_touch(*m)
                for m in each
                if m in close and postures.touch(*m)
            )
    return {pair: count for pair, count in hits.items() if 0 < count < NEVER_POSTURES}


def mesh_shares(postures: SampledPostures, of: Mapping[LinkPair, list[tuple[int, int]]]) -> dict[LinkPair, float]:
    """Share of postures in which links touch with their shapes as in the file, and not only with their hulls.

    Links that touch in all of the first postures are tested further, up to a posture in which they do not.
    """
    hits, asked, left = Counter[LinkPair](), Counter[LinkPair](), dict(of)
    for k in range(POSTURES):
        if k >= _MESH_POSTURES:
            left = {pair: each for pair, each in left.items() if hits[pair] == asked[pair]}
        if not left:
            break
        postures.next()
        for pair, each in left.items():
            hits[pair] += any(postures.meshes_touch(*m) for m in each)
            asked[pair] += 1
    return {pair: hits[pair] / asked[pair] for pair in of}
