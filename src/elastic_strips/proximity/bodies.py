"""What of the robot is measured: its convex links, or its control points, as flat arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import coal
import numpy as np
import numpy.typing as npt

from ..robot import Kinematics, KinematicTree, RobotModel
from ..robot.space import Array

_POINT_RADIUS = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class BodySet:
    """Convex bodies fixed to joints of a kinematic tree.

    Attributes:
        names: (G,) names.
        geometries: Coal shapes.
        joint: (G,) Pinocchio joint index.
        rotation: (G, 3, 3), translation: (G, 3) pose of the shape in the aligned joint frame.
        ends: (G, 2, 3) end points of a capsule that contains the body, in the aligned joint frame [m].
        radius: (G,) radius of that capsule [m].
        skin: distance [m] to add to what Coal says (control points are tiny spheres).
    """

    tree: KinematicTree
    names: tuple[str, ...]
    geometries: tuple[coal.CollisionGeometry, ...]
    joint: npt.NDArray[np.intp]
    rotation: Array
    translation: Array
    ends: Array
    radius: Array
    skin: float = 0.0

    def __len__(self) -> int:
        return len(self.names)

    @staticmethod
    def links(robot: RobotModel) -> BodySet:
        """The robot's convex links."""
        tree, pieces = robot.tree, robot.geometries
        placements = np.array([tree.to_aligned(p.joint, p.placement) for p in pieces])
        ends = np.array([[p.capsule.a, p.capsule.b] for p in pieces])
        align = tree.align[[p.joint for p in pieces]]
        return BodySet(
            tree=tree,
            names=tuple(p.name for p in pieces),
            geometries=tuple(p.geometry for p in pieces),
            joint=np.array([p.joint for p in pieces], dtype=np.intp),
            rotation=placements[:, :3, :3].copy(),
            translation=placements[:, :3, 3].copy(),
            ends=np.einsum("gji,gej->gei", align, ends),
            radius=np.array([p.capsule.r for p in pieces]),
        )

    @staticmethod
    def control_points(robot: RobotModel) -> BodySet:
        """The robot's control points, each a tiny sphere."""
        tree, points = robot.tree, robot.control_point_set
        local = np.einsum("cji,cj->ci", tree.align[points.joint], points.local)
        n = len(points.names)
        return BodySet(
            tree=tree,
            names=points.names,
            geometries=tuple(coal.Sphere(_POINT_RADIUS) for _ in range(n)),
            joint=points.joint,
            rotation=np.tile(np.eye(3), (n, 1, 1)),
            translation=local,
            ends=np.repeat(local[:, None, :], 2, axis=1),
            radius=np.full(n, _POINT_RADIUS),
            skin=_POINT_RADIUS,
        )

    def only(self, index: int) -> BodySet:
        """One of the bodies alone."""
        k = slice(index, index + 1)
        return replace(
            self, names=self.names[k], geometries=self.geometries[k], joint=self.joint[k], rotation=self.rotation[k],
            translation=self.translation[k], ends=self.ends[k], radius=self.radius[k],
        )  # fmt: skip

    def capsule_ends(self, kin: Kinematics) -> Array:
        """World capsule ends (N, G, 2, 3) [m] at the nodes of ``kin``."""
        n, g = kin.n, len(self)
        points = kin.points(np.repeat(self.joint, 2), self.ends.reshape(2 * g, 3))
        return points.reshape(n, g, 2, 3)

    def ends_at(self, kin: Kinematics, node: npt.NDArray[np.intp], body: npt.NDArray[np.intp]) -> Array:
        """World capsule ends (K, 2, 3) [m] of single bodies at nodes."""
        frame = kin.T[self.joint[body], node]
        return np.matmul(frame[:, None, :, :3], self.ends[body][..., None])[..., 0] + frame[:, None, :, 3]

    def placements(
        self, kin: Kinematics, node: npt.NDArray[np.intp], body: npt.NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """World rotations (K, 3, 3) and translations (K, 3) of the shapes ``body`` at ``node``."""
        frame = kin.T[self.joint[body], node]
        rotation = np.matmul(frame[..., :3], self.rotation[body])
        translation = np.matmul(frame[..., :3], self.translation[body][..., None])[..., 0] + frame[..., 3]
        return rotation, translation
