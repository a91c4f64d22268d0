"""Tracking bound: largest distance of any point of the robot from its place by the reference."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision.bounds import BodySet
from elastic_strips.robot import Kinematics, RobotModel

DEFAULT_TRACKING_ERROR = 0.02
"""Bound of that distance [m] with the default plant, gains and estimator; default of ``DriveParams.tracking_error``.

Measured on planned and retimed corridors (Silvermate: 26, every other one ending with an outstretched arm; TIAGo: 13),
at all of the limits and at 95 % of the speeds and 75 % of the accelerations, 220 seeds each, 880 runs or 3.5 hours of
driving: half of all samples within 0.0029 m, 99 % within 0.0091 m, the largest 0.0179 m (Silvermate: 0.0169 m). It is
caused by the slip of the wheels: without noise and slip it is 0.0014 m. With other plants, largest of 60 runs: twice
the slip 0.025 m, motors with 1.5 or 0.5 times the assumed lag 0.025 m, fixes twice as noisy 0.021 m. On the MuJoCo
plant, largest of 30 runs: Silvermate 0.0203 m, TIAGo with wheels sped up by at most 0.8 m/s² 0.028 m.
"""


class Displacement:
    """Workspace: upper bounds of the displacement of any point of a robot between two configurations.

    A body lies within its capsule. A point of it is a point of the capsule's segment plus a vector of at most its
    radius r: between two poses it moves by at most the larger displacement of the segment's two ends, plus
    ``2 r sin(φ/2)``, φ the angle between the poses. It is an upper bound, loose by at most that second part.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._bodies = BodySet.links(robot)
        self._one, self._two = Kinematics(robot.tree), Kinematics(robot.tree)

    def __call__(self, a: Array, b: Array) -> Array:
        """Bounds (S,) [m] between the coordinate rows ``a`` and ``b`` (S, nv)."""
        self._one.update(a, jacobians=False)
        self._two.update(b, jacobians=False)
        bodies = self._bodies
        ends = bodies.capsule_ends(self._two) - bodies.capsule_ends(self._one)  # (S, G, 2, 3)
        way = np.sqrt((ends**2).sum(axis=-1)).max(axis=-1)
        R_one, R_two = self._one.T[:, : self._one.n, :, :3], self._two.T[:, : self._two.n, :, :3]
        # 2 sin(φ/2) is the norm of R_two − R_one as a map: its Frobenius norm over √2
        turn = np.sqrt(((R_two - R_one) ** 2).sum(axis=(-2, -1)) * 0.5).T  # (S, njoints)
        return (way + bodies.radius * turn[:, bodies.joint]).max(axis=1, initial=0.0)
