"""Base kinds: what moves the robot's root."""

from __future__ import annotations

from enum import Enum

from ..errors import RobotError, nearest_name


class BaseKind(str, Enum):
    """How the root moves.

    ``DIFF_DRIVE``: planar, and the wheels allow no sideways velocity (v_y = 0 in the base's frame).
    ``OMNI``: planar without that constraint. ``FIXED``: it does not move.
    """

    DIFF_DRIVE = "diff_drive"
    OMNI = "omni"
    FIXED = "fixed"

    @property
    def planar(self) -> bool:
        return self is not BaseKind.FIXED

    @staticmethod
    def parse(value: str | BaseKind) -> BaseKind:
        """Read a base kind.

        Raises:
            RobotError: an unknown kind.
        """
        try:
            return BaseKind(value)
        except ValueError:
            names = [k.value for k in BaseKind]
            raise RobotError(f"base={value!r} is no kind of base{nearest_name(value, names)}") from None
