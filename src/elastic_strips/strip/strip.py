"""Strip: a frozen chain of whole-body configurations, and its clearance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.collision.strip_certificate import coordinate_clearance
from elastic_strips.errors import ConfigurationError, RobotError, SceneError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary
from elastic_strips.validation import check_number, check_type, named_arguments


@dataclass(frozen=True, eq=False, repr=False)
class Strip(Summary):
    """An elastic strip: configurations q (N, nq) of one robot, N ≥ 2, from start to goal.

    Between two nodes the robot follows ``pin.interpolate``: a screw arc of the base and a straight line of the joints.

    Attributes:
        robot: the robot of the configurations.
        q: (N, nq) Pinocchio configurations, read-only.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> strip = es.Strip(robot, [robot.home(), robot.home(x=0.5), robot.home(x=1.0)])
        >>> len(strip), round(strip.length, 3)
        (3, 1.0)
    """

    robot: RobotModel
    q: Array

    def __init__(self, robot: RobotModel, q: npt.ArrayLike) -> None:
        """Check and freeze the nodes.

        Raises:
            ConfigurationError: fewer than two nodes, wrong size, not finite, not normalised, or outside the joint
                limits.
        """
        check_type("robot", robot, RobotModel, RobotError)
        array = robot.check_q(q, what="strip q")
        if array.ndim != 2 or len(array) < 2:
            raise ConfigurationError(f"a strip has at least 2 nodes, given as (N, {robot.nq}); got shape {array.shape}")
        array.setflags(write=False)
        object.__setattr__(self, "robot", robot)
        object.__setattr__(self, "q", array)

    @staticmethod
    def from_coordinates(robot: RobotModel, coordinates: Array, *, ends: Array | None = None) -> Strip:
        """A strip of coordinate rows that are known to be valid (no checks).

        Args:
            robot: the robot of the strip.
            coordinates: (N, nv) nodes.
            ends: (2, nq) configurations of the first and the last node, if these are to stay the same to the bit.
        """
        strip = object.__new__(Strip)
        q = robot.space.from_coordinates(coordinates)
        if ends is not None:
            q[0], q[-1] = ends
        q.setflags(write=False)
        object.__setattr__(strip, "robot", robot)
        object.__setattr__(strip, "q", q)
        frozen = coordinates.copy()
        frozen.setflags(write=False)
        strip.__dict__["coordinates"] = frozen
        return strip

    def _summary(self) -> dict[str, object]:
        unit = "m" if self.robot.space.planar else "rad"
        return {"robot": self.robot.name, "nodes": len(self), "length": f"{self.length:.3f} {unit}"}

    def __len__(self) -> int:
        return len(self.q)

    @cached_property
    def coordinates(self) -> Array:
        """(N, nv) coordinate rows: x, y, yaw, joints."""
        coordinates = self.robot.space.to_coordinates(self.q)
        coordinates.setflags(write=False)
        return coordinates

    @cached_property
    def velocities(self) -> Array:
        """(N−1, nv) tangent vectors ``pin.difference(q_j, q_{j+1})`` of the segments."""
        return self.robot.space.difference(self.coordinates[:-1], self.coordinates[1:])

    @property
    def length(self) -> float:
        """Length of the base's path [m]; of the joints' path [rad] for a fixed base."""
        v = self.velocities
        if self.robot.space.planar:
            return float(np.hypot(v[:, 0], v[:, 1]).sum())
        return float(np.linalg.norm(v, axis=1).sum())

    @property
    def lateral_slip(self) -> Array:
        """(N−1,) sideways travel |v_y| [m] of each segment; zeros unless the base is a differential drive."""
        if self.robot.base_kind is not BaseKind.DIFF_DRIVE:
            return np.zeros(len(self) - 1)
        return np.abs(self.velocities[:, 1])

    def reversed(self) -> Strip:
        """The strip from its goal to its start."""
        return Strip.from_coordinates(self.robot, self.coordinates[::-1], ends=self.q[[-1, 0]])

    def sample(self, step: float) -> Array:
        """Configurations (M, nq) along the strip, at most ``step`` [m or rad] > 0 of any coordinate apart."""
        check_number("step", step, above=0.0)
        v = self.velocities
        counts = np.maximum(np.ceil(np.abs(v).max(axis=1) / step).astype(int), 1)
        rows = [
            self.robot.space.interpolate(self.coordinates[j][None], self.coordinates[j + 1][None], np.arange(n) / n)
            for j, n in enumerate(counts)
        ]
        return self.robot.space.from_coordinates(np.vstack([*rows, self.coordinates[-1:]]))


@named_arguments
def strip_clearance(strip: Strip, scene: Scene, *, tolerance: float = 1e-4) -> float:
    """Smallest distance [m] between robot and obstacles along the interpolated strip; negative in penetration.

    It is a lower bound of the true value, at most ``tolerance`` [m] below it (for a segment of half a turn, whose arc
    is not defined, as far below as the robot could reach). It is infinite without obstacles; what is more than 10 km
    away counts as 10 km away.

    Args:
        strip: the strip.
        scene: the obstacles.
        tolerance: accuracy [m].

    Raises:
        ConfigurationError, SceneError: not a strip, or not a scene.
        ParameterError: a tolerance that is not positive.
    """
    check_type("strip", strip, Strip, ConfigurationError)
    check_type("scene", scene, Scene, SceneError)
    check_number("tolerance", tolerance, above=0.0, unit="m")
    return coordinate_clearance(strip.robot, strip.coordinates, scene, tolerance=tolerance)
