"""Orientation constraint: an axis of the robot that points in a given direction at every node of a strip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError, nearest_name
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.validation import Bound, Positive, check_array, check_fields

from .solver import System
from .strip import Strip

_LOOK_ANGLE = 0.01  # [rad] that joints turn between looks along a segment
_MOST_NEWTON_STEPS = 30  # Newton's steps, at most
_PROJECTION_DAMPING, _LARGEST_JOINT_STEP = 1e-3, 0.3  # damping, and what a step turns a joint at most [rad]
_PROJECTION_SHARE = 0.2  # of the tolerance: so exactly rows are projected


@dataclass(frozen=True, slots=True, kw_only=True)
class OrientationConstraint:
    """An axis of a frame of the robot that is to point in a direction, such as that of a tray that stays level.

    Attributes:
        frame: frame of the robot.
        axis: axis in that frame, of any length.
        direction: direction in the world in which it is to point.
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
        """Keep a frame turned to a direction as it is at a configuration; by default as level as it is there.

        Args:
            robot: the robot.
            q: configuration (nq,).
            frame: frame of the robot.
            direction: direction in the world; any turn about it is free.
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
        robot: the robot of the frame.
        constraint: the constraint to satisfy.

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
        self._robot = robot
        self._joint = int(frame.parentJoint)
        if self._joint == 0:
            raise RobotError(f"constraint: no joint of {robot.name!r} moves frame {constraint.frame!r}")
        axis = np.asarray(constraint.axis, dtype=float)
        self._axis = robot.tree.align[self._joint].T @ (frame.placement.rotation @ (axis / np.linalg.norm(axis)))
        direction = np.asarray(constraint.direction, dtype=float)
        self._target = direction / np.linalg.norm(direction)
        turns = robot.tree.support[self._joint] * np.abs(robot.tree.rate)
        turns[robot.tree.motion[robot.tree.prismatic]] = 0.0
        if robot.space.planar:
            turns[:2] = 0.0
            turns[2] = np.hypot(*self._target[:2]) > 0.0  # turns about the target do not count
        self._turns = robot.tree.summed(turns)

    def push(self, system: System, kin: Kinematics) -> None:
        """Add force and matrix of V = Σ ½ k ‖a − t‖², with the axis a and its target t, if the constraint is active."""
        if not self.active:
            return
        n, gain = kin.n, self.constraint.gain
        off, turns = self._off(kin)
        rows = turns.reshape(3 * n, -1)
        system.add_rows(np.repeat(np.arange(n), 3), rows, -gain * off.reshape(-1), np.full(3 * n, gain))
        system.energies["constraint"] = 0.5 * gain * float((off**2).sum())

    def errors(self, kin: Kinematics) -> Array:
        """(N,) angle [rad] by which each node misses the constraint."""
        a = self._in_world(kin)
        return np.arctan2(np.linalg.norm(np.cross(a, self._target), axis=1), a @ self._target)

    def errors_at(self, coordinates: Array) -> Array:
        """(N,) angle [rad] by which coordinate rows (N, nv) miss the constraint."""
        kin = Kinematics(self._robot.tree, len(coordinates))
        kin.update(coordinates)
        return self.errors(kin)

    def bound(self, strip: Strip) -> tuple[float, int]:
        """Largest angle [rad] by which a strip misses the constraint, between its nodes too; and the segment of it.

        The axis turns by no more than the joints that turn it do together.
        """
        space, rows = self._robot.space, strip.coordinates
        v = space.difference(rows[:-1], rows[1:])
        turn = np.abs(v) @ self._turns
        parts = np.maximum(np.ceil(turn / _LOOK_ANGLE).astype(int), 1)
        segment = np.repeat(np.arange(len(parts)), parts)
        share = (np.arange(len(segment)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[segment]
        off = self.errors_at(np.vstack((space.integrate(rows[segment], share[:, None] * v[segment]), rows[-1:])))
        most = 0.5 * (off[:-1] + off[1:] + (turn / parts)[segment])
        worst = int(np.argmax(most))
        return float(most[worst]), int(segment[worst])

    def missed(self, strip: Strip) -> str:
        """Where a strip misses the constraint, between its nodes too, and by how much; empty where it does not."""
        off, segment = self.bound(strip)
        most = self.constraint.tolerance
        if off <= most:
            return ""
        return (
            f"segment {segment}: {self.constraint.frame} is up to {off:.3f} rad off, {most:g} are allowed (tolerance)"
        )

    def check(self, q: Array, what: Sequence[str]) -> None:
        """Refuse configurations (K, nq) that do not satisfy the constraint.

        Raises:
            ConfigurationError: one of them does not; the message says which, and by how much.
        """
        for name, off in zip(what, self.errors_at(self._robot.space.to_coordinates(q)), strict=True):
            if off > self.constraint.tolerance:
                raise ConfigurationError(
                    f"{name} does not satisfy the constraint: {self.constraint.frame!r} is {off:.3f} rad off, "
                    f"{self.constraint.tolerance:g} are allowed (tolerance)"
                )

    def project(self, coordinates: Array) -> tuple[Array, Array]:
        """Rows (N, nv) that satisfy the constraint, by the least motion of the joints, and by how much (N,) [rad] each
        misses it still.

        The base stays, because the path decides where it drives.
        """
        space, b = self._robot.space, self._robot.space.base_nv
        rows = coordinates.copy()
        kin = Kinematics(self._robot.tree, len(rows))
        for k in range(_MOST_NEWTON_STEPS + 1):
            kin.update(rows)
            angle = self.errors(kin)
            todo = angle > _PROJECTION_SHARE * self.constraint.tolerance
            if not todo.any() or k == _MOST_NEWTON_STEPS:
                break
            off, turns = self._off(kin)
            J = turns[todo][:, :, b:]  # (K, 3, n)
            step = np.linalg.solve(J @ J.transpose(0, 2, 1) + _PROJECTION_DAMPING * np.eye(3), off[todo][:, :, None])
            move = -(J.transpose(0, 2, 1) @ step)[:, :, 0]
            longest = np.abs(move).max(axis=1, keepdims=True)
            rows[todo, b:] += move * np.minimum(1.0, _LARGEST_JOINT_STEP / np.maximum(longest, _LARGEST_JOINT_STEP))
            np.clip(rows, space.lower, space.upper, out=rows)
        return rows, angle

    def _off(self, kin: Kinematics) -> tuple[Array, Array]:
        """By how much the axis misses its target, (N, 3), and the derivatives of that, (N, 3, nv)."""
        a = self._in_world(kin)
        turning = kin.columns(self._joint)[..., 3:]  # (N, nv, 3)
        return a - self._target, np.cross(turning, a[:, None, :]).transpose(0, 2, 1)

    def _in_world(self, kin: Kinematics) -> Array:
        """(N, 3) the axis in the world."""
        return kin.T[self._joint, : kin.n, :, :3] @ self._axis


def _frame(robot: RobotModel, name: str) -> int:
    index = find_frame(robot.model, name)
    if index is None:
        names = [frame.name for frame in robot.model.frames]
        raise RobotError(f"constraint: unknown frame {name!r}{nearest_name(name, names)}")
    return index
