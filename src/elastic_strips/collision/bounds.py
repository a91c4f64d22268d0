"""Bounds: bodies of a robot as capsules, and how far any of their points moves between two configurations.

The radius of (degree of freedom, body) bounds the speed of any point of the body per unit speed of that degree of
freedom: 1 for sliding, the distance from the axis for turning. Of one that joints follow it is the sum of what its
joints do, each times its multiplier. Static radii hold for all postures within the joint limits; tight ones for one
posture and the motion to the next.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.constants import SLIDING_TURN
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.robot.geometry import link_labels
from elastic_strips.robot.kinematics import KinematicTree

from .native_side import native_bodies

if TYPE_CHECKING:
    from elastic_strips.native import _native

_POINT_RADIUS = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class BodySet:
    """Convex bodies fixed to joints of a kinematic tree.

    Attributes:
        names: (G,) names.
        labels: (G,) their names in messages.
        geometries: Coal shapes.
        joint: (G,) Pinocchio joint index.
        rotation: (G, 3, 3), translation: (G, 3) pose of the shape in the aligned joint frame.
        ends: (G, 2, 3) end points of a capsule that contains the body, in the aligned joint frame [m].
        radius: (G,) radius of that capsule [m].
        skin: distance [m] to add to Coal's distances (control points are tiny spheres).
        boxes: centres and half sizes (G, 3) [m] of the boxes about the shapes, in the shapes' own frames.
    """

    tree: KinematicTree
    names: tuple[str, ...]
    labels: tuple[str, ...]
    geometries: tuple[coal.CollisionGeometry, ...]
    joint: Indices
    rotation: Array
    translation: Array
    ends: Array
    radius: Array
    skin: float = 0.0
    boxes: tuple[Array, Array] = field(init=False, repr=False)
    _kept: list[_native.Bodies] = field(default_factory=list, init=False, repr=False)
    _radii: list[Array] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        for each in self.geometries:
            each.computeLocalAABB()  # a shape that was just made has none, and its box would be inside out
        low = np.array([each.aabb_local.min_ for each in self.geometries]).reshape(-1, 3)
        high = np.array([each.aabb_local.max_ for each in self.geometries]).reshape(-1, 3)
        object.__setattr__(self, "boxes", (0.5 * (low + high), 0.5 * (high - low)))

    def __len__(self) -> int:
        return len(self.names)

    @staticmethod
    def links(robot: RobotModel) -> BodySet:
        """The robot's convex pieces; made once for each robot."""
        known = _LINKS.get(robot)
        if known is not None:
            return known
        tree, pieces = robot.tree, robot.geometries
        placements = np.array([tree.to_aligned(p.joint, p.placement) for p in pieces])
        ends = np.array([[p.capsule.a, p.capsule.b] for p in pieces])
        align = tree.align[[p.joint for p in pieces]]
        links = BodySet(
            tree=tree,
            names=tuple(p.name for p in pieces),
            labels=link_labels(pieces),
            geometries=tuple(p.geometry for p in pieces),
            joint=np.array([p.joint for p in pieces], dtype=np.intp),
            rotation=placements[:, :3, :3].copy(),
            translation=placements[:, :3, 3].copy(),
            ends=np.einsum("gji,gej->gei", align, ends),
            radius=np.array([p.capsule.r for p in pieces]),
        )
        _LINKS[robot] = links
        return links

    @staticmethod
    def control_points(robot: RobotModel) -> BodySet:
        """The robot's control points, each a tiny sphere."""
        tree, points = robot.tree, robot.control_point_set
        local = np.einsum("cji,cj->ci", tree.align[points.joint], points.local)
        n = len(points.names)
        return BodySet(
            tree=tree,
            names=points.names,
            labels=points.names,
            geometries=tuple(coal.Sphere(_POINT_RADIUS) for _ in range(n)),
            joint=points.joint,
            rotation=np.tile(np.eye(3), (n, 1, 1)),
            translation=local,
            ends=np.repeat(local[:, None, :], 2, axis=1),
            radius=np.full(n, _POINT_RADIUS),
            skin=_POINT_RADIUS,
        )

    def native(self) -> _native.Bodies | None:
        """The bodies as the native kernel takes them, or None where there is none; made once."""
        return native_bodies(self, self._kept)

    def only(self, index: int) -> BodySet:
        """One of the bodies alone."""
        k = slice(index, index + 1)
        return replace(
            self,
            names=self.names[k],
            labels=self.labels[k],
            geometries=self.geometries[k],
            joint=self.joint[k],
            rotation=self.rotation[k],
            translation=self.translation[k],
            ends=self.ends[k],
            radius=self.radius[k],
        )

    def capsule_ends(self, kin: Kinematics) -> Array:
        """World capsule ends (N, G, 2, 3) [m] at the nodes of ``kin``."""
        n, g = kin.n, len(self)
        points = kin.points(np.repeat(self.joint, 2), self.ends.reshape(2 * g, 3))
        return points.reshape(n, g, 2, 3)

    def ends_at(self, kin: Kinematics, node: Indices, body: Indices) -> Array:
        """World capsule ends (K, 2, 3) [m] of bodies ``body`` (K,) at nodes ``node`` (K,) of ``kin``."""
        frame = kin.T[self.joint[body], node]
        return np.matmul(frame[:, None, :, :3], self.ends[body][..., None])[..., 0] + frame[:, None, :, 3]

    def placements(self, kin: Kinematics, node: Indices, body: Indices) -> tuple[Array, Array]:
        """World rotations (K, 3, 3) and translations (K, 3) [m] of bodies ``body`` (K,) at nodes ``node`` (K,)."""
        frame = kin.T[self.joint[body], node]
        rotation = np.matmul(frame[..., :3], self.rotation[body])
        translation = np.matmul(frame[..., :3], self.translation[body][..., None])[..., 0] + frame[..., 3]
        return rotation, translation


_LINKS: WeakKeyDictionary[RobotModel, BodySet] = WeakKeyDictionary()


class MotionBounds:
    """Bounds on how far bodies move between configurations; see Schwarzer, Saha and Latombe.

    Args:
        bodies: the bodies whose motion is bounded, for all postures within the joint limits.

    Attributes:
        radius: (nv, G) static radii; zero where the degree of freedom does not move the body.
            Rows 0 and 1 of a planar root are 0: its translation counts once, as ‖(v_x, v_y)‖.
        of_motion: (M, G) the same for each motion, per unit of its coordinate; ``radius`` where no joint follows.
    """

    def __init__(self, bodies: BodySet) -> None:
        tree = bodies.tree
        self.bodies = bodies
        self.planar: bool = tree.space.planar
        if not bodies._radii:  # walked once
            self.of_motion: Array = np.zeros((len(tree.coordinate), len(bodies)))
            for g in range(len(bodies)):
                self._chain(g)
            folded = tree.summed(self.of_motion.T).T.copy() if tree.follows else self.of_motion
            bodies._radii.extend((folded, self.of_motion))
            for radius in bodies._radii:
                radius.setflags(write=False)
        self.radius: Array = bodies._radii[0]
        self.of_motion = bodies._radii[1]

    def _chain(self, g: int) -> None:
        """Walk from the body to the root, adding up how far the body can be from each joint's origin."""
        tree = self.bodies.tree
        lower, upper = tree.to_motions(tree.space.lower), tree.to_motions(tree.space.upper)
        joint = int(self.bodies.joint[g])
        far = self.bodies.radius[g]
        planar_far = np.linalg.norm(self.bodies.ends[g][:, :2], axis=1).max() + far
        distance = np.linalg.norm(self.bodies.ends[g], axis=1).max() + far
        first = True
        while joint > 0:
            k = int(tree.motion[joint])
            if k < 0:
                self.of_motion[2, g] = planar_far if first else distance
            elif tree.prismatic[joint]:
                self.of_motion[k, g] = abs(tree.rate[k])
                distance += max(abs(lower[k]), abs(upper[k]))
            else:
                self.of_motion[k, g] = abs(tree.rate[k]) * (planar_far if first else distance)
            distance += float(np.linalg.norm(tree.offset[joint][:3, 3]))
            first = False
            joint = int(tree.parents[joint])

    def travel(self, v: Array) -> Array:
        """Bounds (N, G) [m] on the travel of any point of each body along tangent vectors ``v`` (N, nv)."""
        speed = np.abs(v)
        out = speed @ self.radius
        if self.planar:
            out += np.hypot(v[:, 0], v[:, 1])[:, None]
        return out

    def tight_travel(self, kin: Kinematics, node: Indices, body: Indices, v: Array) -> Array:
        """Tighter bounds (K,) [m] on the travel of any point of single bodies.

        The distance of a point from an axis changes only by the joints between them, so it is at most what it is at the
        node, plus what those joints move the point meanwhile.

        Args:
            kin: kinematics of the nodes, with Jacobians.
            node, body: (K,) the node where each motion starts, and the body that moves.
            v: (K, nv) tangent vectors of the motions.
        """
        bodies, tree = self.bodies, self.bodies.tree
        ends = bodies.ends_at(kin, node, body)
        columns = kin.J[node]  # (K, M, 6), world origin
        rate = np.abs(tree.rate)
        linear, angular = columns[..., :3], columns[..., 3:]
        cross = np.cross(angular[:, None], ends[:, :, None, :]) + linear[:, None]
        reach = np.sqrt((cross**2).sum(axis=-1)).max(axis=1)  # speed of the capsule's ends per unit rate
        turning = np.abs(angular).max(axis=2) > SLIDING_TURN * rate
        reach = np.where(turning, reach + rate * bodies.radius[body][:, None], rate)
        speed = np.abs(v)[:, tree.coordinate]
        static = self.of_motion[:, body].T * speed  # (K, M)
        outer = np.zeros_like(static)
        # joints further out than k on the body's chain are larger motions: what they do adds to k's lever
        outer[:, :-1] = np.cumsum(static[:, :0:-1], axis=1)[:, ::-1]
        tight = np.minimum(np.where(turning, reach + rate * outer, rate), self.of_motion[:, body].T)
        tight *= tree.support[bodies.joint[body]]
        if self.planar:
            tight[:, :2] = 0.0
            return (tight * speed).sum(axis=1) + np.hypot(v[:, 0], v[:, 1])
        return (tight * speed).sum(axis=1)

    def pair_radius(self, pairs: Indices) -> Array:
        """Radii (nv, S) for the distance of two bodies: only joints that move one of them and not the other count."""
        support = self.bodies.tree.support[self.bodies.joint]
        one, two = support[pairs[:, 0]], support[pairs[:, 1]]
        only_one, only_two = one & ~two, two & ~one
        radius = self.of_motion[:, pairs[:, 0]] * only_one.T + self.of_motion[:, pairs[:, 1]] * only_two.T
        radius = self.bodies.tree.summed(radius.T).T if self.bodies.tree.follows else radius
        return np.ascontiguousarray(radius)  # by rows, as the kernel reads them


class Displacement(OneThread):
    """Workspace: upper bounds of the displacement of any point of a robot between two configurations.

    A body lies within its capsule. A point of it is a point of the capsule's segment plus a vector of at most its
    radius r: between two poses it moves by at most the larger displacement of the segment's two ends, plus
    ``2 r sin(φ/2)``, φ the angle between the poses. It is an upper bound, loose by at most that second part.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._bodies = BodySet.links(robot)
        self._kin = Kinematics(robot.tree)  # of a, then of b: together they take little longer than one

    @exclusive
    def __call__(self, a: Array, b: Array) -> Array:
        """Bounds (S,) [m] between the coordinate rows ``a`` and ``b`` (S, nv)."""
        n, bodies, kin = len(a), self._bodies, self._kin
        kin.update(np.concatenate((a, b)), jacobians=False)
        self._ends = bodies.capsule_ends(kin)  # (2 S, G, 2, 3)
        way = np.sqrt(((self._ends[n:] - self._ends[:n]) ** 2).sum(axis=-1)).max(axis=-1)
        R_one, R_two = kin.T[:, :n, :, :3], kin.T[:, n : kin.n, :, :3]
        # 2 sin(φ/2) is the norm of R_two − R_one as a map: its Frobenius norm over √2
        turn = np.sqrt(((R_two - R_one) ** 2).sum(axis=(-2, -1)) * 0.5).T  # (S, njoints)
        return (way + bodies.radius * turn[:, bodies.joint]).max(axis=1, initial=0.0)

    @exclusive
    def reach(self) -> float:
        """Largest horizontal distance [m] of a point of any body from the base's origin, at the last ``b``."""
        n = self._kin.n // 2
        ends = self._ends[n:, ..., :2] - self._kin.coordinates[n : 2 * n, None, None, :2]
        return float((np.sqrt((ends**2).sum(axis=-1)).max(axis=-1) + self._bodies.radius).max(initial=0.0))
