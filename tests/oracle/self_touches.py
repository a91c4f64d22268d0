"""Do a robot's links meet in postures that it calls free, and is that said? Pinocchio, Coal and the URDF's own shapes.

    python tests/oracle/self_touches.py [ROBOT …] [--postures 20000] [--held] [--seed 0]

For each robot, with all its joints planned and (``--held``) with each of them held still in turn at a random value,
random postures that ``RobotModel.self_collision`` calls free are placed by Pinocchio's full model. Every pair of links
that Coal finds in each other there, as the file's shapes are, by more than a millimetre, has to be one of
``RobotModel.unchecked_pairs``. How deep a pair of hollow meshes is cannot be asked: so its hulls' depth counts, which
is no less. Pairs that the robot looks at are asked as well, so that a hull that holds less than its mesh is found.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import logging
import time
from collections import Counter
from collections.abc import Mapping

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.catalogue import find_robot, robot_names
from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel, load_robot

DEEP = 1e-3  # [m]


class Shapes:
    """The URDF's own collision shapes on Pinocchio's full model, and the hulls of its meshes."""

    def __init__(self, path: str, package_dirs: list[str]) -> None:
        self.model = pin.buildModelFromUrdf(path)
        geometry = pin.buildGeomFromUrdf(self.model, path, pin.COLLISION, package_dirs=package_dirs)
        self.objects = list(geometry.geometryObjects)
        self.links = [self.model.frames[obj.parentFrame].name for obj in self.objects]
        self.data = self.model.createData()
        self.hulls = []
        for obj in self.objects:
            shape = obj.geometry
            if isinstance(shape, coal.BVHModelBase):
                with contextlib.suppress(RuntimeError):  # too many neighbours for Coal: all is deep
                    shape.buildConvexHull(True, "Qt")
                    shape = shape.convex
            self.hulls.append(shape)
        corners = [obj.geometry.aabb_local for obj in self.objects if not obj.geometry.computeLocalAABB()]
        self.radius = np.array([0.5 * np.linalg.norm(box.max_ - box.min_) for box in corners])
        self.middle = [0.5 * (box.max_ + box.min_) for box in corners]
        pairs = itertools.combinations(range(len(self.objects)), 2)
        self.pairs = np.array([p for p in pairs if self.links[p[0]] != self.links[p[1]]], dtype=int).reshape(-1, 2)
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()

    def configuration(self, values: Mapping[str, float]) -> np.ndarray:
        q = pin.neutral(self.model)
        for name, value in values.items():
            if self.model.existJointName(name):
                joint = self.model.joints[self.model.getJointId(name)]
                q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        return q

    def touching(self, q: np.ndarray, passed: set[frozenset[str]]) -> set[frozenset[str]]:
        """Pairs of links in each other, but for those that are ``passed`` over."""
        pin.forwardKinematics(self.model, self.data, q)
        placed = [self.data.oMi[obj.parentJoint] * obj.placement for obj in self.objects]
        at = np.array([T.act(m) for T, m in zip(placed, self.middle, strict=True)]).reshape(-1, 3)
        one, two = self.pairs.T
        near = np.linalg.norm(at[one] - at[two], axis=1) <= self.radius[one] + self.radius[two]
        found = set()
        for i, k in self.pairs[near].tolist():
            pair = frozenset((self.links[i], self.links[k]))
            if pair in passed or pair in found:
                continue
            poses = [coal.Transform3s(placed[n].rotation, placed[n].translation) for n in (i, k)]
            self._result.clear()
            if not coal.collide(
                self.objects[i].geometry, poses[0], self.objects[k].geometry, poses[1], self._request, self._result
            ):
                continue
            if self._depth(i, k, poses) > DEEP:
                found.add(pair)
        return found

    def _depth(self, i: int, k: int, poses: list[coal.Transform3s]) -> float:
        result = coal.DistanceResult()
        shapes = self.hulls[i], self.hulls[k]
        if any(isinstance(shape, coal.BVHModelBase) for shape in shapes):
            return np.inf
        return -coal.distance(shapes[0], poses[0], shapes[1], poses[1], coal.DistanceRequest(True), result)


def study(name: str, robot: RobotModel, shapes: Shapes, postures: int, rng: np.random.Generator) -> tuple[int, Counter]:
    """How many postures are free, and how often pairs of links that are not listed touch in them."""
    space, b = robot.space, robot.space.base_nv
    low, high = (np.clip(limit[b:], -np.pi, np.pi) for limit in (space.lower, space.upper))
    listed = {frozenset(pair.links) for pair in robot.unchecked_pairs}
    free, found = 0, Counter()
    for _ in range(postures):
        row = np.zeros(space.nv)
        row[b:] = rng.uniform(low, high)
        q = space.from_coordinates(row)
        if robot.self_collision(q) is not None:
            continue
        free += 1
        values = dict(zip(robot.joint_names, row[b:], strict=True)) | dict(robot.locked)
        found.update(shapes.touching(shapes.configuration(values), listed))
    return free, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*")
    parser.add_argument("--postures", type=int, default=20_000)
    parser.add_argument("--held", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    logging.disable(logging.CRITICAL)
    total, bad = 0, 0
    for name in given.robots or robot_names():
        known, rng, began = find_robot(name), np.random.default_rng(given.seed), time.perf_counter()
        try:
            whole = load_robot(name, base="fixed")
        except RobotError as problem:
            print(f"{name:28} not loaded: {str(problem)[-60:]}")
            continue
        shapes = Shapes(str(known.urdf), [str(folder) for folder in known.package_dirs])
        cases: list[dict[str, float]] = [{}]
        if given.held:
            b = whole.space.base_nv
            low, high = (np.clip(limit[b:], -np.pi, np.pi) for limit in (whole.space.lower, whole.space.upper))
            values = rng.uniform(low, high)
            cases += [{joint: float(value)} for joint, value in zip(whole.joint_names, values, strict=True)]
        free, found = 0, Counter()
        for held in cases:
            robot = whole if not held else load_robot(name, base="fixed", locked=held)
            if robot.nv == 0:
                continue
            some, touches = study(name, robot, shapes, max(1, given.postures // len(cases)), rng)
            free += some
            found.update(touches)
        total, bad = total + free, bad + sum(found.values())
        worst = "; ".join(f"{' and '.join(sorted(pair))} {count}" for pair, count in found.most_common(3))
        print(
            f"{name:28} {len(cases):3} robots, {free:6} free postures, {len(whole.unchecked_pairs):4} pairs listed, "
            f"{sum(found.values())} touches that are not {worst} ({time.perf_counter() - began:.0f} s)",
            flush=True,
        )
    print(f"{total} free postures, {bad} touches that no listed pair explains")


if __name__ == "__main__":
    main()
