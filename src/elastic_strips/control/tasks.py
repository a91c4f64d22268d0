"""Control room, tasks: what a robot is told to do, before anybody has thought about how."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ParameterError
from ..validation import check_type, shown


@dataclass(frozen=True, slots=True)
class DriveTo:
    """Drive the base to a pose, the arm as it is.

    Attributes:
        x, y: [m]; yaw: [rad], in the world.
    """

    x: float
    y: float
    yaw: float

    def __post_init__(self) -> None:
        _finite("DriveTo", (self.x, self.y, self.yaw), 3)

    def __str__(self) -> str:
        return f"drive to ({self.x:g}, {self.y:g}) m, {self.yaw:g} rad"


@dataclass(frozen=True, slots=True)
class ReachHand:
    """Bring a frame of the robot to a pose; the base drives there where the arm alone does not reach.

    Attributes:
        position: (x, y, z) in the world [m].
        quaternion: (x, y, z, w) of the frame in the world; None leaves its orientation free.
        frame: of the robot.
    """

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None = None
    frame: str = "hand_frame"

    def __post_init__(self) -> None:
        _finite("ReachHand.position", self.position, 3)
        check_type("ReachHand.frame", self.frame, str)
        if self.quaternion is not None:
            _finite("ReachHand.quaternion", self.quaternion, 4)
            if not 0.99 < float(np.linalg.norm(self.quaternion)) < 1.01:
                raise ParameterError(f"ReachHand.quaternion={self.quaternion!r} must have unit length")

    def __str__(self) -> str:
        turned = "" if self.quaternion is None else " turned as asked"
        return f"reach ({', '.join(f'{v:g}' for v in self.position)}) m with {self.frame!r}{turned}"


@dataclass(frozen=True, slots=True)
class DriveAndReach:
    """Both at once: the base at a pose, the hand at another; one goal for the whole body."""

    drive: DriveTo
    reach: ReachHand

    def __post_init__(self) -> None:
        check_type("DriveAndReach.drive", self.drive, DriveTo)
        check_type("DriveAndReach.reach", self.reach, ReachHand)

    def __str__(self) -> str:
        return f"{self.drive} and {self.reach}"


Task = DriveTo | ReachHand | DriveAndReach


def _finite(what: str, values: tuple[float, ...], count: int) -> None:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ParameterError(f"{what}={shown(values)} must be {count} finite numbers")
