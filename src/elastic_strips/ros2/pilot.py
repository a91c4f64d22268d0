"""Pilot: velocities that somebody else commands, as the guard takes them: teleoperation, or another controller."""

from __future__ import annotations

import math

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.guard import Desired
from elastic_strips.robot import RobotModel

from .messages import MessageError, RosObject, check_frame

_BASE_FRAMES: tuple[str, ...] = ("base_link", "base_footprint")  # by REP 105 and 120
_SAME_PLACE = 1e-9  # [m, rad]


def base_frames(robot: RobotModel) -> frozenset[str]:
    """Names of frames in which a velocity of the base is one of its own frame: links that stand where it does."""
    base = 1 if robot.space.planar else 0
    names: set[str] = set(_BASE_FRAMES)
    for frame in robot.model.frames:
        place = frame.placement
        off = max(float(np.abs(place.rotation - np.eye(3)).max()), float(np.hypot(*place.translation[:2])))
        if frame.parentJoint == base and off < _SAME_PLACE:
            names.add(str(frame.name))
    return frozenset(names)


class PilotReader:
    """Workspace: the newest velocities that somebody commands.

    What is no command takes the place of the one before: the robot comes to rest at once, and not when that is old.

    Args:
        robot: the robot.
        base_frame: frame of velocities of the base; None: any that stands where the base does.
        oldest: age [s] from which on a velocity counts no more beside a newer one.
        backward: whether the base may go backwards; else that part of a velocity is left out.
    """

    def __init__(self, robot: RobotModel, base_frame: str | None, oldest: float, *, backward: bool) -> None:
        self._slowest = -math.inf if backward else 0.0  # [m/s] ahead
        self._frame, self._frames = base_frame, base_frames(robot)
        self._joints, self._oldest = len(robot.joint_names), oldest
        self._twist: tuple[float, Array] | None = None
        self._rates: tuple[float, Array] | None = None

    def check_frame(self, message: RosObject) -> None:
        """Check that a ``TwistStamped`` is in the base's frame; an empty name is that.

        Raises:
            MessageError: it is in another one.
        """
        frame = str(message.header.frame_id).strip("/")
        if self._frame:
            check_frame(message, self._frame if frame else "")
        elif frame and frame not in self._frames:
            raise MessageError(f"the frame is {frame!r}, which is not the base's: a parameter base_frame names that")

    def note_twist(self, t: float, twist: RosObject) -> None:
        """Take in a ``geometry_msgs/Twist`` of a time [s].

        Raises:
            MessageError: it is not finite, or out of order.
        """
        row = np.array([float(twist.linear.x), float(twist.linear.y), float(twist.angular.z)])
        row[0] = np.maximum(row[0], self._slowest)  # which keeps what is no number
        self._twist = t, _newer(t, self._twist, row)
        if not np.isfinite(row).all():
            raise MessageError(f"a velocity is not finite: {row}")

    def note_rates(self, t: float, values: object) -> None:
        """Take in velocities of the joints, in their order, of a time [s].

        Raises:
            MessageError: they are not as many as the joints, not finite, or out of order.
        """
        row = np.array(values, dtype=float).reshape(-1)
        sized = len(row) == self._joints
        self._rates = t, _newer(t, self._rates, row if sized else np.full(self._joints, math.nan))
        if not sized:
            raise MessageError(f"{len(row)} velocities came for {self._joints} joints")
        if not np.isfinite(row).all():
            raise MessageError(f"a joint's velocity is not finite: {row}")

    def desired(self, t: float) -> Desired | None:
        """What is wanted at ``t`` [s]; None where nothing has come yet."""
        given = {key: have for key, have in (("twist", self._twist), ("joints", self._rates)) if have is not None}
        if not given:
            return None
        newest = max(at for at, _ in given.values())
        counts = {key: row for key, (at, row) in given.items() if at == newest or t - at <= self._oldest}
        return Desired(twist=counts.get("twist"), joints=counts.get("joints"), time=min(newest, t))


def _newer(t: float, before: tuple[float, Array] | None, row: Array) -> Array:
    if before is not None and not t > before[0]:
        raise MessageError(f"a velocity of {t:.3f} s comes after, or twice, the one of {before[0]:.3f} s")
    return row
