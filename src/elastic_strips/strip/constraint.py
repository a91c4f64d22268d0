"""Orientation constraint: an axis of the robot that points in a given direction at every node of a strip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import ParameterError, RobotError, nearest_name
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.validation import Bound, Positive, check_array, check_fields

from .solver import System


@dataclass(frozen=True, slots=True, kw_only=True)
class OrientationConstraint:
    """An axis of a frame of the robot that is to point in a direction, such as that of a tray that stays level.

    Attributes:
        frame: of the robot.
        axis: in that frame, of any length.
        direction: in the world, where it is to point.
        tolerance: the constraint is satisfied where no node is further off than this [rad].
        gain: how strongly the strip is drawn to it, beside ``DeformParams.k_r``.
    """

    frame: str
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    tolerance: Annotated[float, Bound(above=0.0, high=np.pi, unit="rad")] = 0.1
    gain: Positive = 3.0

    def __post_init__(self) -> None:
        check_fields(self)
        for what, value in (("axis", self.axis), ("direction", self.direction)):
            if np.linalg.norm(check_array(f"OrientationConstraint.{what}", value, (3,))) < 1e-9:
                raise ParameterError(f"OrientationConstraint.{what}={value!r} must be three numbers, not all 0")

    @staticmethod
    def from_configuration(
        robot: RobotModel,
        q: ArrayLike,
        frame: str,
        *,
        direction: tuple[float, float, float] = (0.0, 0.0, 1.0),
        **values: float,
    ) -> OrientationConstraint:
        """A frame stays turned to a direction as it is at a configuration; by default as level as it is there.

        Args:
            robot: the robot.
            q: configuration (nq,).
            frame: of the robot.
            direction: in the world; any turn about it is free.
            **values: tolerance and gain.

        Raises:
            RobotError: the robot has no such frame.
        """
        index = _frame(robot, frame)
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, robot.check_q(q))
        rotation = pin.updateFramePlacement(robot.model, data, index).rotation
        x, y, z = rotation.T @ np.asarray(direction, dtype=float)
        return OrientationConstraint(frame=frame, axis=(float(x), float(y), float(z)), direction=direction, **values)


class ConstraintForce:
    """The force of a constraint on strips of one robot.

    Args:
        robot: whose frame it is.
        constraint: what is to be satisfied.

    Attributes:
        constraint: the same.
        active: whether it acts.

    Raises:
        RobotError: the robot has no such frame, or none of its joints turns it.
    """

    def __init__(self, robot: RobotModel, constraint: OrientationConstraint) -> None:
        frame = robot.model.frames[_frame(robot, constraint.frame)]
        self.constraint: OrientationConstraint = constraint
        self.active: bool = True
        self._joint = int(frame.parentJoint)
        if self._joint == 0:
            raise RobotError(f"constraint: no joint of {robot.name!r} moves frame {constraint.frame!r}")
        axis = np.asarray(constraint.axis, dtype=float)
        self._axis = robot.tree.align[self._joint].T @ (frame.placement.rotation @ (axis / np.linalg.norm(axis)))
        direction = np.asarray(constraint.direction, dtype=float)
        self._target = direction / np.linalg.norm(direction)

    def push(self, system: System, kin: Kinematics) -> None:
        """Add force and matrix of V = Σ ½ k ‖a − t‖², a the axis and t its target, if the constraint is active."""
        if not self.active:
            return
        n, gain = kin.n, self.constraint.gain
        a = self._in_world(kin)
        off = a - self._target
        turning = kin.J[:n, :, 3:] * kin.tree.support[self._joint][:, None]  # (N, nv, 3)
        rows = np.cross(turning, a[:, None, :]).transpose(0, 2, 1).reshape(3 * n, -1)  # ∂a/∂q, three rows a node
        system.add_rows(np.repeat(np.arange(n), 3), rows, -gain * off.reshape(-1), np.full(3 * n, gain))
        system.energies["constraint"] = 0.5 * gain * float((off**2).sum())

    def errors(self, kin: Kinematics) -> Array:
        """(N,) angle [rad] by which each node misses the constraint."""
        a = self._in_world(kin)
        return np.arctan2(np.linalg.norm(np.cross(a, self._target), axis=1), a @ self._target)

    def _in_world(self, kin: Kinematics) -> Array:
        """(N, 3) the axis in the world."""
        return kin.T[self._joint, : kin.n, :, :3] @ self._axis


def _frame(robot: RobotModel, name: str) -> int:
    index = find_frame(robot.model, name)
    if index is None:
        names = [frame.name for frame in robot.model.frames]
        raise RobotError(f"constraint: unknown frame {name!r}{nearest_name(name, names)}")
    return index
