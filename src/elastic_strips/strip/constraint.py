"""Deform room, task: what a strip is asked to keep to besides its goal, such as a hand that stays level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array

from ..errors import ParameterError, RobotError, nearest_name
from ..robot import Kinematics, RobotModel
from ..robot.control_points import find_frame
from .forces import add_axis_task, axis_in_world
from .solver import System


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisTask:
    """An axis of a frame of the robot that is to point in a direction: a tray that is kept level.

    Attributes:
        frame: of the robot.
        axis: in that frame, of any length.
        direction: in the world, where it is to point.
        tolerance: the task is kept where no node is further off than this [rad].
        gain: how strongly the strip is drawn to it, beside ``DeformParams.k_r``.
    """

    frame: str
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    tolerance: float = 0.1
    gain: float = 3.0

    def __post_init__(self) -> None:
        for name in ("axis", "direction"):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all() or np.linalg.norm(value) < 1e-9:
                raise ParameterError(f"AxisTask.{name}={getattr(self, name)!r} must be three finite numbers, not all 0")
        if not 0.0 < self.tolerance <= np.pi:
            raise ParameterError(f"AxisTask.tolerance={self.tolerance!r} must lie in (0, π] rad")
        if not 0.0 < self.gain < np.inf:
            raise ParameterError(f"AxisTask.gain={self.gain!r} must be finite and > 0")


def kept_as_at(
    robot: RobotModel,
    q: npt.ArrayLike,
    frame: str,
    *,
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0),
    **values: float,
) -> AxisTask:
    """The task to keep a frame turned to a direction as it is at a configuration; by default as level as it is there.

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
    return AxisTask(frame=frame, axis=(float(x), float(y), float(z)), direction=direction, **values)


class TaskForce:
    """An axis task of one robot, ready to push.

    Args:
        robot: whose frame it is.
        task: what is asked for.

    Attributes:
        task: the same.
        active: whether it pushes.

    Raises:
        RobotError: the robot has no such frame, or none of its joints turns it.
    """

    def __init__(self, robot: RobotModel, task: AxisTask) -> None:
        frame = robot.model.frames[_frame(robot, task.frame)]
        self.task, self.active = task, True
        self._joint = int(frame.parentJoint)
        if self._joint == 0:
            raise RobotError(f"task: no joint of {robot.name!r} moves frame {task.frame!r}")
        axis = np.asarray(task.axis, dtype=float)
        self._axis = robot.tree.align[self._joint].T @ (frame.placement.rotation @ (axis / np.linalg.norm(axis)))
        direction = np.asarray(task.direction, dtype=float)
        self._target = direction / np.linalg.norm(direction)

    def push(self, system: System, kin: Kinematics) -> None:
        """Add its forces, if it is active."""
        if self.active:
            add_axis_task(system, kin, self._joint, self._axis, self._target, k_t=self.task.gain)

    def errors(self, kin: Kinematics) -> Array:
        """(N,) angle [rad] by which each node misses the task."""
        a = axis_in_world(kin, self._joint, self._axis)
        return np.arctan2(np.linalg.norm(np.cross(a, self._target), axis=1), a @ self._target)


def _frame(robot: RobotModel, name: str) -> int:
    index = find_frame(robot.model, name)
    if index is None:
        names = [frame.name for frame in robot.model.frames]
        raise RobotError(f"task: unknown frame {name!r}{nearest_name(name, names)}")
    return index
