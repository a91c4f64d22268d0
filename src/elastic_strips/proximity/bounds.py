"""Motion bounds: how far the points of a body can travel when a configuration changes.

The radius of (degree of freedom, body) bounds the speed of any point of the body per unit speed of that degree of
freedom: 1 for sliding, the distance from the axis for turning. Static radii hold for all postures within the joint
limits; tight ones for one posture and the way to the next.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..robot import Kinematics
from ..robot.space import Array
from .bodies import BodySet


class MotionBounds:
    """Static motion radii of a body set.

    Attributes:
        radius: (nv, G) static radii; zero where the degree of freedom does not move the body.
            Rows 0 and 1 of a planar root are 0: its translation counts once, as ‖(v_x, v_y)‖.
        between: (S, nv) True where a degree of freedom lies between the bodies of a self pair, once :meth:`for_pairs`.
    """

    def __init__(self, bodies: BodySet) -> None:
        tree = bodies.tree
        self.bodies = bodies
        self.planar = tree.space.planar
        nv = tree.space.nv
        self.radius = np.zeros((nv, len(bodies)))
        for g in range(len(bodies)):
            self._chain(g)

    def _chain(self, g: int) -> None:
        """Walk from the body to the root, adding up how far the body can be from each joint's origin."""
        tree, space = self.bodies.tree, self.bodies.tree.space
        joint = int(self.bodies.joint[g])
        far = self.bodies.radius[g]
        planar_far = np.linalg.norm(self.bodies.ends[g][:, :2], axis=1).max() + far
        distance = np.linalg.norm(self.bodies.ends[g], axis=1).max() + far
        first = True
        while joint > 0:
            k = int(tree.chart_index[joint])
            if k < 0:
                self.radius[2, g] = planar_far if first else distance
            elif tree.prismatic[joint]:
                self.radius[k, g] = 1.0
                distance += max(abs(space.lower[k]), abs(space.upper[k]))
            else:
                self.radius[k, g] = planar_far if first else distance
            distance += float(np.linalg.norm(tree.offset[joint][:3, 3]))
            first = False
            joint = int(tree.parents[joint])

    def travel(self, v: Array) -> Array:
        """Bounds (N, G) [m] on the way of any point of each body along tangent vectors ``v`` (N, nv)."""
        speed = np.abs(v)
        out = speed @ self.radius
        if self.planar:
            out += np.hypot(v[:, 0], v[:, 1])[:, None]
        return out

    def tight_travel(self, kin: Kinematics, node: npt.NDArray[np.intp], body: npt.NDArray[np.intp], v: Array) -> Array:
        """Tighter bounds (K,) [m] for single bodies on the way from ``node`` along tangent vectors ``v`` (K, nv).

        The distance of a point from an axis changes only by the joints between them, so it is at most what it is at the
        node, plus what those joints move the point on the way.
        """
        bodies, tree = self.bodies, self.bodies.tree
        ends = bodies.ends_at(kin, node, body)
        columns = kin.J[node]  # (K, nv, 6), world origin
        linear, angular = columns[..., :3], columns[..., 3:]
        cross = np.cross(angular[:, None], ends[:, :, None, :]) + linear[:, None]
        reach = np.sqrt((cross**2).sum(axis=-1)).max(axis=1)  # speed of the capsule's ends per unit rate
        turning = np.abs(angular).max(axis=2) > 1e-9
        reach = np.where(turning, reach + bodies.radius[body][:, None], 1.0)
        speed = np.abs(v)
        static = self.radius[:, body].T * speed  # (K, nv)
        outer = np.zeros_like(static)
        # joints further out than k on the body's chain have larger chart columns: their motion adds to k's lever
        outer[:, :-1] = np.cumsum(static[:, :0:-1], axis=1)[:, ::-1]
        tight = np.minimum(np.where(turning, reach + outer, 1.0), self.radius[:, body].T)
        tight *= tree.support[bodies.joint[body]]
        if self.planar:
            tight[:, :2] = 0.0
            return (tight * speed).sum(axis=1) + np.hypot(v[:, 0], v[:, 1])
        return (tight * speed).sum(axis=1)

    def pair_radius(self, pairs: npt.NDArray[np.intp]) -> Array:
        """Radii (nv, S) for the distance between two bodies: the joints that move one of them and not the other."""
        support = self.bodies.tree.support[self.bodies.joint]
        one, two = support[pairs[:, 0]], support[pairs[:, 1]]
        only_one, only_two = one & ~two, two & ~one
        return self.radius[:, pairs[:, 0]] * only_one.T + self.radius[:, pairs[:, 1]] * only_two.T
